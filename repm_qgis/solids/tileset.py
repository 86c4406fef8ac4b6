"""What 3-D Tiles of surfaces and of clouds have in common: the folder, the axes, boxes, and the list of the tiles.

Coordinates are metres in a local east, north, up frame, which the root's ``transform`` takes to geocentric coordinates
(EPSG:4978).

Tiles are listed one by one and not by implicit tiling, which QGIS 3.40 does not read; so each has a box and an error of
its own.

References
----------
Open Geospatial Consortium, 3D Tiles Specification 1.1, OGC 22-025r4, 2023.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np
import pyproj

from ..contracts.arrays import AnyArray, FloatArray
from ..contracts.documents import JsonObject
from ..contracts.findings import Finding
from ..geometry.frames import EnuFrame, flat_crs, geodetic_from_projected
from ..geometry.vertical import ELLIPSOID, HeightDatum, stated_datum
from ..runtime.progress import Progress
from ..runtime.workspace import require_no_strangers

_ENTRIES = ("tileset.json", "tiles")
_BOX_MARGIN = 1e-6  # of its size: vertices are in single precision


def require_tiles3d_place(path: str) -> None:
    """Check that a folder that a tileset replaces holds nothing else; raises WorkspaceError."""
    require_no_strangers(Path(path), _ENTRIES.__contains__, "does not belong to a tileset", option="TILES3D")


@dataclass(frozen=True)
class Globe:
    """From the ground of a file to a tileset's axes: the horizontal CRS (WKT), the datum of the heights, the frame."""

    crs: str
    datum: HeightDatum
    frame: EnuFrame

    @classmethod
    def at(cls, middle: Sequence[float], path: str, system: pyproj.CRS, tag: str, progress: Progress) -> Globe:
        """Axes at the x, y of a place, on the ellipsoid, for a file with the CRS ``system`` and the item ``tag`` of
        its metadata (geometry/vertical.py). Warns where neither states a datum."""
        datum = stated_datum(system, tag)
        if datum is None:
            progress.warn(
                Finding(
                    "datum-unknown",
                    f"'{path}' does not state its vertical datum: its heights are taken to be above the ellipsoid.",
                )
            )
        crs = flat_crs(system).to_wkt("WKT2_2019")
        lon, lat = map(float, geodetic_from_projected(crs, np.array(middle)))
        return cls(crs, datum or HeightDatum("", ELLIPSOID), EnuFrame(lon, lat))

    def enu(self, xy: FloatArray, heights: AnyArray) -> FloatArray:
        """(N, 3) east, north and up, m, of (N, 2) places in the CRS with heights above the datum, m.

        Raises MissingPackageError where PROJ lacks the grid of the geoid.
        """
        above = heights + self.datum.undulation(self.crs, xy, "convert the heights to the ellipsoid first")
        return self.frame.from_geodetic(np.column_stack([geodetic_from_projected(self.crs, xy), above]))


def box(low: FloatArray, high: FloatArray) -> Dict[str, List[float]]:
    """The bounding volume of a tile between two (3,) corners, east, north and up in metres."""
    middle, half = (low + high) / 2, (high - low) / 2
    half = half + _BOX_MARGIN * (np.abs(low) + np.abs(high)) + 1e-3
    return {"box": [*middle.tolist(), *np.diag(half).ravel().tolist()]}


def write_tileset(folder: Path, frame: EnuFrame, root: JsonObject, refine: str, size_m: float) -> None:
    """Write ``tileset.json``, the last file: ``root`` with all tiles below it in the axes of ``frame``; ``refine`` is
    REPLACE or ADD, and ``size_m`` what a viewer lacks that draws nothing."""
    document = {
        "asset": {"version": "1.1"},
        "geometricError": max(size_m, root["geometricError"]),
        "root": {"transform": frame.ecef_from_enu.T.ravel().tolist(), "refine": refine, **root},  # column by column
    }
    (folder / "tileset.json").write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
