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

_MOST_RESIDUAL_PX = 1.5  # as in reconstruct: beyond it a tie is a wrong match


def tie_points(scene: Scene, tile: Tile) -> Tuple[FloatArray, FloatArray]:
    """(N, 3) points in the scene's frame and (N,) residuals, px, of the trustworthy ties on a tile.

    Empty where the scene was not reconstructed, or its tie points' file is gone.
    """
    path = Path(scene.tie_points)
    rows = _read(path) if path.is_file() else np.empty((0, 4))
    xmin, ymin, xmax, ymax = tile.bounds
    rows = rows[
        (rows[:, 0] >= xmin)
        & (rows[:, 0] <= xmax)
        & (rows[:, 1] >= ymin)
        & (rows[:, 1] <= ymax)
        & (rows[:, 3] < _MOST_RESIDUAL_PX)
    ]
    if not len(rows):
        return np.empty((0, 3)), np.empty(0)
    ground = np.column_stack([geodetic_from_projected(scene.crs, rows[:, :2]), rows[:, 2]])
    return scene.frame.from_geodetic(ground), rows[:, 3]


def _read(path: Path) -> FloatArray:
    """(N, 4) x, y, height, residual; empty for a layer that is not of ours."""
    rows = []
    with quiet():
        try:
            dataset = gdal.OpenEx(str(path), gdal.OF_VECTOR | gdal.OF_READONLY)
            layer = dataset.GetLayer(0) if dataset is not None else None
            fields = (
                {layer.GetLayerDefn().GetFieldDefn(i).GetName() for i in range(layer.GetLayerDefn().GetFieldCount())}
                if layer is not None
                else set()
            )
            if {"height", "residual"} <= fields:
                for feature in layer:
                    point = feature.GetGeometryRef()
                    rows.append((point.GetX(), point.GetY(), feature["height"], feature["residual"]))
        except RuntimeError:
            rows = []
        feature = layer = dataset = None  # noqa: F841 - in this order, or OGR's objects outlive their file
    return np.array(rows, dtype=np.float64).reshape(-1, 4)
