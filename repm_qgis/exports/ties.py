"""The tie points of a reconstructed scene, as 3-D points in its frame."""

from __future__ import annotations

from pathlib import Path
from typing import Tuple

import numpy as np
from osgeo import gdal

from ..arrays import FloatArray
from ..geometry.frames import geodetic_from_projected
from ..imagery.raster import quiet
from ..scene import Scene, Tile
from ..sfm.parameters import POINTING


def tie_points(scene: Scene, tile: Tile, most_px: float = POINTING.good_px) -> Tuple[FloatArray, FloatArray]:
    """(N, 3) points in the scene's frame and (N,) residuals, px, of the ties on a tile with residuals below a limit.

    Empty where the scene was not reconstructed, or the file of its tie points does not exist.
    """
    path = Path(scene.tie_points)
    rows = _read(path) if path.is_file() else np.empty((0, 4))
    xy, bounds = rows[:, :2], np.array(tile.bounds)
    rows = rows[((xy >= bounds[:2]) & (xy <= bounds[2:])).all(axis=1) & (rows[:, 3] < most_px)]
    if not len(rows):
        return np.empty((0, 3)), np.empty(0)
    ground = np.column_stack([geodetic_from_projected(scene.crs, rows[:, :2]), rows[:, 2]])
    return scene.frame.from_geodetic(ground), rows[:, 3]


def _read(path: Path) -> FloatArray:
    """(N, 4) x, y, height, residual; empty for a layer without these fields."""
    rows = []
    with quiet():
        try:
            dataset = gdal.OpenEx(str(path), gdal.OF_VECTOR | gdal.OF_READONLY)
            layer = dataset.GetLayer(0)
            for feature in layer:
                point = feature.GetGeometryRef()
                rows.append((point.GetX(), point.GetY(), feature["height"], feature["residual"]))
        except (RuntimeError, AttributeError, KeyError, TypeError):
            rows = []
        feature = layer = dataset = None  # noqa: F841 - in this order, because OGR's objects must not outlive their file
    return np.array(rows, dtype=np.float64).reshape(-1, 4)
