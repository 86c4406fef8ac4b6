"""Bilinear sampling and box means of arrays, in numpy alone: for the light stages, which have no OpenCV."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]


def sample(image: FloatArray, cols: FloatArray, rows: FloatArray) -> FloatArray:
    """Bilinear values of ``image`` (height, width) at pixel positions; the first pixel's centre is (0, 0).

    NaN outside the image and wherever one of the four neighbours is NaN.
    """
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        inside = (cols >= 0) & (cols <= width - 1) & (rows >= 0) & (rows <= height - 1)
    c = np.where(inside, cols, 0.0)
    r = np.where(inside, rows, 0.0)
    c0 = np.minimum(c.astype(np.intp), max(width - 2, 0))
    r0 = np.minimum(r.astype(np.intp), max(height - 2, 0))
    fc, fr = (c - c0).astype(image.dtype), (r - r0).astype(image.dtype)
    flat = image.ravel()
    index = r0 * width + c0
    right, below = min(1, width - 1), width * min(1, height - 1)
    top = flat[index] * (1 - fc) + flat[index + right] * fc
    bottom = flat[index + below] * (1 - fc) + flat[index + below + right] * fc
    result = top * (1 - fr) + bottom * fr
    result[~inside] = np.nan
    return result


def box_mean(values: FloatArray, radius: int) -> FloatArray:
    """Means over (2 radius + 1) squares of a (height, width) array without NaN; borders take what there is."""
    height, width = values.shape
    padded = np.zeros((height + 1, width + 1))
    padded[1:, 1:] = values.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
    r0, r1 = np.clip(np.arange(height) - radius, 0, height), np.clip(np.arange(height) + radius + 1, 0, height)
    c0, c1 = np.clip(np.arange(width) - radius, 0, width), np.clip(np.arange(width) + radius + 1, 0, width)
    total = padded[r1][:, c1] - padded[r0][:, c1] - padded[r1][:, c0] + padded[r0][:, c0]
    return total / ((r1 - r0)[:, None] * (c1 - c0)[None, :])


def upsample_grid(grid: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Bilinear interpolation of a coarse (m, n, ...) grid, corners on corners, to (height, width, ...)."""
    m, n = grid.shape[:2]
    return interpolate_grid(grid, np.linspace(0, m - 1, shape[0]), np.linspace(0, n - 1, shape[1]))


def interpolate_grid(grid: FloatArray, rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Bilinear interpolation of a (m, n, ...) grid at (H,) rows and (W,) columns, in units of nodes; ends extended."""
    m, n = grid.shape[:2]
    i = np.clip(rows.astype(int), 0, m - 2)
    j = np.clip(columns.astype(int), 0, n - 2)
    extra = (1,) * (grid.ndim - 2)
    fi, fj = (rows - i).reshape(-1, 1, *extra), (columns - j).reshape(1, -1, *extra)
    # Rows first: they are few, and the wide passes that follow run along memory.
    tall = grid[i] * (1 - fi) + grid[i + 1] * fi
    return tall[:, j] * (1 - fj) + tall[:, j + 1] * fj
