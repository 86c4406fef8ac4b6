"""A plane through the heights around each cell: how steep it is, and how far the heights are from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..contracts.arrays import FloatArray, FloatImage, Mask


@dataclass(frozen=True)
class LocalPlanes:
    """(rows, columns) of each cell's plane: rise to the east and to the north, m per m, and RMS of the heights, m; NaN
    where fewer than six cells of the window are used."""

    east: FloatArray
    north: FloatArray
    rms: FloatArray

    @property
    def slope(self) -> FloatArray:
        return np.hypot(self.east, self.north)


_LEAST = 6


def local_planes(height: FloatImage, used: Mask, half: int, cell: float) -> LocalPlanes:
    """Least-squares planes through the ``used`` heights (rows, columns), m, of windows of 2 ``half`` + 1 cells of a
    side ``cell`` (m), by moments, as Hoffman and Jain (1987) fit them to range images."""
    x = np.arange(-half, half + 1.0)
    powers = (np.ones_like(x), x, x * x)
    level = float(height[used].mean()) if used.any() else 0.0
    weight = used.astype(np.float64)
    z = np.where(used, height - level, 0.0)

    def moment(values: FloatArray, across: int, down: int) -> FloatArray:
        rows = ndimage.correlate1d(values, powers[across], axis=1, mode="constant")
        return np.asarray(ndimage.correlate1d(rows, powers[down], axis=0, mode="constant"))

    with np.errstate(invalid="ignore", divide="ignore"):
        count = moment(weight, 0, 0)
        mean_x, mean_y = moment(weight, 1, 0) / count, moment(weight, 0, 1) / count
        mean_z = moment(z, 0, 0) / count
        xx = moment(weight, 2, 0) / count - mean_x**2
        yy = moment(weight, 0, 2) / count - mean_y**2
        xy = moment(weight, 1, 1) / count - mean_x * mean_y
        xz = moment(z, 1, 0) / count - mean_x * mean_z
        yz = moment(z, 0, 1) / count - mean_y * mean_z
        zz = moment(z * z, 0, 0) / count - mean_z**2
        determinant: FloatArray = xx * yy - xy * xy
        right, down = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
        rms = np.sqrt(np.maximum(zz - right * xz - down * yz, 0.0))
    few = (count < _LEAST - 0.5) | ~(determinant > 1e-6)
    right, down, rms = (np.where(few, np.nan, each) for each in (right, down, rms))
    return LocalPlanes(right / cell, -down / cell, rms)
