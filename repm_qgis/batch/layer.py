"""The footprints of many scenes, with their figures and verdicts, as a layer."""

from __future__ import annotations

from typing import Dict, Sequence

from osgeo import ogr

from ..files.vector import Features, write_layer
from ..reports.styles import write_style
from .records import KeptScene

_CRS = "EPSG:4326"
_TEXTS = ("scene", "verdict", "findings", "error", "report", "dsm", "taken", "vertical_datum")
_FIGURES = ("valid_percent", "le90_m", "height_deviation_m", "resolution", "seconds")


def write_footprints(scenes: Sequence[KeptScene], path: str) -> None:
    """Write a feature for each scene, also for one that failed, which has no shape where its images say none.

    Raises WorkspaceError.
    """
    fields: Dict[str, type] = {
        **dict.fromkeys(_TEXTS, str),
        **dict.fromkeys(("images", "pairs"), int),
        **dict.fromkeys(_FIGURES, float),
    }

    def features() -> Features:
        for scene in scenes:
            made = scene.outcome
            texts = [made.scene, made.verdict, "\n".join(made.findings), made.error, made.report, made.dsm]
            texts += [", ".join(made.taken), made.vertical_datum]
            figures = [getattr(made, name) for name in _FIGURES]
            shape = ogr.ForceToMultiPolygon(ogr.CreateGeometryFromWkt(scene.area)) if scene.area else None
            yield shape, [*(text or None for text in texts), made.images, made.pairs, *figures]

    write_layer(path, _CRS, ogr.wkbMultiPolygon, fields, features())
    write_style("scenes", path)
