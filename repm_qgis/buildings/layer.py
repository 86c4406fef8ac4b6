"""Footprints as a vector layer."""

from __future__ import annotations

from typing import Dict, Iterator, List, Sequence, Tuple

from osgeo import ogr

from ..files.vector import write_layer
from .building import Building
from .cityjson import attributes

FIELDS: Dict[str, type] = {
    "id": int,
    **dict.fromkeys(("ground_m", "eave_m", "median_m", "ridge_m", "height_m", "error_m", "residual_m"), float),
    **dict.fromkeys(("area_m2", "volume_m3", "measured", "gaps"), float),
    "roof": str,
    "planes": int,
    "lod": int,
    "source": str,
}
"""The fields of the footprints: heights in the datum of the DSM, ``height_m`` above the ground."""


def write_footprints(path: str, crs: str, buildings: Sequence[Building], source: str) -> str:
    """Write the footprints in a CRS (any text of PROJ); ``source`` names the DSM. Raises WorkspaceError."""

    def rows() -> Iterator[Tuple[ogr.Geometry, List[object]]]:
        for each in buildings:
            values = {**attributes(each), "id": each.number, "source": source}
            yield ogr.CreateGeometryFromWkb(each.outline), [values[name] for name in FIELDS]

    return write_layer(path, crs, ogr.wkbPolygon, FIELDS, rows())
