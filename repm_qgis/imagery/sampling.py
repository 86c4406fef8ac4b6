"""Bilinear sampling and box means of arrays, in numpy alone: for the light stages, which have no OpenCV."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats


def sample(image: Floats, cols: Floats, rows: Floats) -> Floats:
    """Bilinear values of ``image`` (height, width) at pixel positions; the first pixel's centre is (0, 0).

    NaN outside the image and wherever one of the four neighbours is NaN.
    """
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        inside = (cols >= 0) & (cols <= width - 1) & (rows >= 0) & (rows <= height - 1)
    c = np.where(inside, cols, cols.dtype.type(0))
    r = np.where(inside, rows, rows.dtype.type(0))
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


def box_mean(values: Floats, radius: int) -> Floats:
    """Means over (2 radius + 1) squares of (..., height, width) arrays without NaN; borders take what there is.

    In the arrays' own precision.
    """
    height, width = values.shape[-2:]
    padded = np.zeros(values.shape[:-2] + (height + 2 * radius, width + 2 * radius), values.dtype)
    padded[..., radius : radius + height, radius : radius + width] = values
    total = _window_sums(_window_sums(padded, radius, columns=False), radius, columns=True)
    rows, columns = (
        np.minimum(place + radius + 1, len(place)) - np.maximum(place - radius, 0)
        for place in (np.arange(height), np.arange(width))
    )
    return total / (rows[:, None] * columns).astype(values.dtype)


def _window_sums(part: Floats, radius: int, columns: bool) -> Floats:
    """Sums of 2 radius + 1 neighbours along columns or rows, made of sums of 1, 2, 4, ... of them."""

    def cut(array: Floats, begin: int, length: int) -> Floats:
        return array[..., begin : begin + length] if columns else array[..., begin : begin + length, :]

    axis, width = -1 if columns else -2, 2 * radius + 1
    size = part.shape[axis] - 2 * radius
    result, begin, length = None, 0, 1
    while True:
        if width & length:
            own = cut(part, begin, size)
            result = own if result is None else result + own
            begin += length
        if 2 * length > width:
            return result
        rest = part.shape[axis] - length
        part = cut(part, 0, rest) + cut(part, length, rest)
        length *= 2


def upsample_grid(grid: Floats, shape: tuple[int, int]) -> Floats:
    """Bilinear interpolation of a coarse (m, n, ...) grid, corners on corners, to (height, width, ...)."""
    m, n = grid.shape[:2]
    return interpolate_grid(grid, np.linspace(0, m - 1, shape[0]), np.linspace(0, n - 1, shape[1]))


def interpolate_grid(grid: Floats, rows: Floats, columns: Floats) -> Floats:
    """Bilinear interpolation of a (m, n, ...) grid at (H,) rows and (W,) columns, in units of nodes; ends extended."""
    m, n = grid.shape[:2]
    i = np.clip(rows.astype(int), 0, m - 2)
    j = np.clip(columns.astype(int), 0, n - 2)
    extra, dtype = (1,) * (grid.ndim - 2), np.result_type(grid, np.float32)
    fi, fj = ((rows - i).astype(dtype).reshape(-1, 1, *extra), (columns - j).astype(dtype).reshape(1, -1, *extra))
    # Rows first: they are few, and the wide passes that follow run along memory.
    tall = grid[i] * (1 - fi) + grid[i + 1] * fi
    return tall[:, j] * (1 - fj) + tall[:, j + 1] * fj
