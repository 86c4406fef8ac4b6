"""The steps between the levels of a pyramid of grids, whose cells have twice the side from one level to the next."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from ..contracts.arrays import Floats


def halved(values: Floats) -> Floats:
    """Sums over 2 x 2 cells, in the grid's precision; a last row or column without a partner stands alone."""
    rows, columns = values.shape
    padded = np.pad(values, ((0, rows % 2), (0, columns % 2)))
    return np.asarray((padded[::2, ::2] + padded[1::2, ::2]) + (padded[::2, 1::2] + padded[1::2, 1::2]))


def doubled(values: Floats, shape: Tuple[int, ...]) -> Floats:
    """Values on cells of half the side, cut to ``shape``, in the grid's precision; values at the border of ``values``
    only serve their neighbours and are not in the result.

    Bilinear between the cells' centres, which is quadratic B-spline subdivision.
    """
    for axis in (0, 1):
        values = np.moveaxis(values, axis, 0)
        inner, near, far = values[1:-1], values[:-2], values[2:]
        fine = np.empty((2 * len(inner), *values.shape[1:]), values.dtype)
        fine[::2] = 0.75 * inner + 0.25 * near
        fine[1::2] = 0.75 * inner + 0.25 * far
        values = np.moveaxis(fine[: shape[axis]], 0, axis)
    return values
