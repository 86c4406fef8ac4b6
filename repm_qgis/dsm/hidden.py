"""The ground that a view does not see itself: behind each step in height, as far as its line of sight passes over it.

A height map has a height for each pixel of one image. Behind a building as that image sees it there are no pixels; but
how far that strip of ground reaches is known: the view's line of sight that just passes the edge of the roof meets the
ground at its end. It takes the height of the ground beside it, as what the other image hides does
(``matching/occlusions``), and its slope.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..stereo.height_maps import HeightMap


def hidden_ground(heights: HeightMap, step_m: float) -> Tuple[Floats, Floats, Floats]:
    """(N,) x, y, height of points a pixel apart on the ground behind steps of more than ``step_m``.

    They continue the ground in front of the step, and lie on the rays of the pixels that hide them.
    """
    low = _behind(heights.height, heights.lean, step_m)
    row, column = np.nonzero(np.isfinite(low))
    z = low[row, column].astype(np.float64)
    down = z - heights.height[row, column]
    return heights.x[row, column] + down * heights.ray[0], heights.y[row, column] + down * heights.ray[1], z


def _behind(height: Floats, lean: Tuple[float, float], step_m: float) -> NDArray[np.float32]:
    """(H, W) heights of the ground that pixels hide; NaN where they hide none, or none is known beside them.

    What stands up by dz is moved by ``lean * dz`` px (columns, rows), so that much of the ground before it is under it.
    """
    low = np.full(height.shape, np.nan, np.float32)
    reach = max(abs(lean[0]), abs(lean[1]))
    if not reach:
        return low
    to_column, to_row = -lean[0] / reach, -lean[1] / reach
    row, column, jump, ground = (
        np.concatenate(parts)
        for parts in zip(
            _steps(height, int(np.sign(to_column)), 0, abs(lean[0]), step_m),
            _steps(height, 0, int(np.sign(to_row)), abs(lean[1]), step_m),
        )
    )
    rows, columns = height.shape
    count = np.rint(reach * jump).astype(np.int64)
    rise = _rise(
        height,
        row - np.rint((count + 1) * to_row).astype(np.int64),
        column - np.rint((count + 1) * to_column).astype(np.int64),
        ground,
    )
    level = np.abs(rise) <= step_m
    row, column, ground, count, rise = (part[level] for part in (row, column, ground, count, rise / (count + 1)))
    # The nearest step decides: it is written last.
    for i in range(int(count.max(initial=0)) - 1, -1, -1):
        far = np.flatnonzero(count > i)
        r, c = row[far] + int(np.rint(i * to_row)), column[far] + int(np.rint(i * to_column))
        inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
        far, r, c = far[inside], r[inside], c[inside]
        goes_on = ground[far] + (i + 1) * rise[far]
        with np.errstate(invalid="ignore"):
            above = height[r, c] - goes_on > step_m
        low[r[above], c[above]] = goes_on[above]
    return low


def _rise(
    height: Floats, row: NDArray[np.int64], column: NDArray[np.int64], ground: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(N,) by how much the ground rises from these places to the step; 0 where they have no height."""
    inside = (row >= 0) & (row < height.shape[0]) & (column >= 0) & (column < height.shape[1])
    there = height[np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.where(inside & np.isfinite(there), ground - there, 0.0).astype(np.float32)


def _steps(
    height: Floats, right: int, down: int, lean: float, step_m: float
) -> Tuple[NDArray[np.intp], NDArray[np.intp], Floats, NDArray[np.float32]]:
    """(N,) row and column of pixels one px above a step whose lower side lies one px back; how high, and its ground.

    Only steps that hide half a pixel or more in that direction, where a vertical moves by ``lean`` px a metre.
    """
    upper, lower = (_cut(height, sign * right, sign * down) for sign in (1, -1))
    with np.errstate(invalid="ignore"):
        row, column = np.nonzero(upper - lower > max(step_m, 0.5 / max(lean, 1e-9)))
    jump, ground = (upper - lower)[row, column], lower[row, column].astype(np.float32)
    return row + max(down, 0), column + max(right, 0), jump, ground


def _cut(image: Floats, right: int, down: int) -> Floats:
    """The image without its first columns and rows (without its last ones for negative numbers)."""
    return image[max(down, 0) : image.shape[0] + min(down, 0), max(right, 0) : image.shape[1] + min(right, 0)]
