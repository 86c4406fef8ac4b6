"""Surfaces that are right or wrong as a whole, for the trials on DSMs in benchmarks/input_second.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj

from repm_qgis.geometry.vertical import ELLIPSOID, TAG
from repm_qgis.imagery.raster import write

_SIDE = 300
WRONG = {"times 3.28": 3.28, "upside down": -1.0, "displaced by 20 m": 1.0, "mirrored": 1.0, "right": 1.0}


def relief() -> np.ndarray:
    """A hilly place that is not its own mirror image, m, in cells of 1 m."""
    v, u = np.mgrid[:_SIDE, :_SIDE]
    return (300 + 40 * np.sin(u / 31.0 + 1.0) + 25 * np.cos(v / 23.0) + 0.1 * u).astype(np.float32)


def surface(folder: Path, name: str, wrong: str = "right", start: int = 0) -> str:
    """A DSM of that place from a column on, which is wrong in the named way; gives its path."""
    heights = WRONG[wrong] * relief()
    heights = np.roll(heights, 20, axis=1) if wrong == "displaced by 20 m" else heights
    heights = heights[:, ::-1] if wrong == "mirrored" else heights
    place = (500000.0 + start, 1.0, 0.0, 4800000.0, 0.0, -1.0)
    crs, datum = pyproj.CRS("EPSG:32631").to_wkt("WKT1_GDAL"), {TAG: ELLIPSOID}
    return write(str(folder / f"{name}.tif"), [np.ascontiguousarray(heights[:, start:])], place, crs, metadata=datum)
