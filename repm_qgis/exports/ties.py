"""The tie points of a reconstructed scene, as 3-D points in its frame."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..files.vector import read_points
from ..geometry.frames import geodetic_from_projected
from ..pointing.parameters import POINTING
from ..scene import Scene, Tile


def tie_points(scene: Scene, tile: Tile, most_px: float = POINTING.good_px) -> Tuple[FloatArray, FloatArray]:
    """(N, 3) points in the scene's frame and (N,) residuals, px, of the ties on a tile with residuals below a limit.

    Empty where the scene was not reconstructed, or the file of its tie points does not exist.
    """
    rows = read_points(scene.tie_points, ("height", "residual"))
    xy, bounds = rows[:, :2], np.array(tile.bounds)
    rows = rows[((xy >= bounds[:2]) & (xy <= bounds[2:])).all(axis=1) & (rows[:, 3] < most_px)]
    if not len(rows):
        return np.empty((0, 3)), np.empty(0)
    ground = np.column_stack([geodetic_from_projected(scene.crs, rows[:, :2]), rows[:, 2]])
    return scene.frame.from_geodetic(ground), rows[:, 3]
