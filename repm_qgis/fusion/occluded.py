"""The ground that is hidden from a view: behind each step in height, as far as the line of sight passes above it.

A height map has a height for each pixel of one image. The ground that a building hides in this image has no pixels, but
the extent of this strip of ground is known: the line of sight that just passes the edge of the roof meets the ground at
its end. The strip takes the height and the slope of the ground next to it, as the ground that the other image does not
see (``matching/occlusions``).
"""

from __future__ import annotations

from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Floats, IntArray
from ..stereo.height_maps import HeightMap


def occluded_ground(heights: HeightMap, step_m: float) -> Tuple[FloatArray, FloatArray, FloatArray]:
    """(N,) x, y, height of points a pixel apart on the ground behind steps of more than ``step_m``.

    They continue the ground in front of the step, and lie on the rays of the pixels that hide them.
    """
    low = _ground_behind(heights.height, heights.relief_displacement, step_m)
    row, column = np.nonzero(np.isfinite(low))
    z = low[row, column].astype(np.float64)
    down = z - heights.height[row, column]
    return heights.x[row, column] + down * heights.ray[0], heights.y[row, column] + down * heights.ray[1], z


def _ground_behind(height: Floats, displacement: Tuple[float, float], step_m: float) -> FloatImage:
    """(H, W) heights of the ground that pixels hide; NaN where they hide none, or no ground is known next to them.

    An object that is higher by dz lies ``displacement * dz`` px (columns, rows) away and covers so much of the ground.
    """
    low = np.full(height.shape, np.nan, np.float32)
    reach = max(abs(displacement[0]), abs(displacement[1]))
    if not reach:
        return low
    to_column, to_row = -displacement[0] / reach, -displacement[1] / reach
    along_rows = _steps(height, int(np.sign(to_column)), 0, abs(displacement[0]), step_m)
    along_columns = _steps(height, 0, int(np.sign(to_row)), abs(displacement[1]), step_m)
    row, column = (np.concatenate((along_rows[i], along_columns[i])) for i in (0, 1))
    jump = np.concatenate((along_rows[2], along_columns[2]))
    ground = np.concatenate((along_rows[3], along_columns[3]))
    count = np.rint(reach * jump).astype(np.int64)
    before = [np.rint((count + 1) * share).astype(np.int64) for share in (to_row, to_column)]
    rise = _rise(height, row - before[0], column - before[1], ground)
    level = np.abs(rise) <= step_m
    row, column, count = (part[level] for part in (row, column, count))
    ground, slope = ground[level], rise[level] / (count + 1)
    # The nearest step decides: it is written last.
    for i in range(int(count.max(initial=0)) - 1, -1, -1):
        far = np.flatnonzero(count > i)
        r, c = row[far] + int(np.rint(i * to_row)), column[far] + int(np.rint(i * to_column))
        inside = (r >= 0) & (r < height.shape[0]) & (c >= 0) & (c < height.shape[1])
        far, r, c = far[inside], r[inside], c[inside]
        continued = ground[far] + (i + 1) * slope[far]
        with np.errstate(invalid="ignore"):
            above = height[r, c] - continued > step_m
        low[r[above], c[above]] = continued[above]
    return low


def _rise(height: Floats, row: IntArray, column: IntArray, ground: FloatImage) -> FloatImage:
    """(N,) by how much the ground rises from these places to the step; 0 where they have no height."""
    inside = (row >= 0) & (row < height.shape[0]) & (column >= 0) & (column < height.shape[1])
    there = height[np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.where(inside & np.isfinite(there), ground - there, 0.0).astype(np.float32)


def _steps(
    height: Floats, right: int, down: int, displacement: float, step_m: float
) -> Tuple[IntArray, IntArray, Floats, FloatImage]:
    """(N,) row and column of the upper pixels of steps whose lower side lies one px back; their height and ground.

    Only steps that hide half a pixel or more in that direction, where a vertical moves by ``displacement`` px a metre.
    """
    upper, lower = (_shifted(height, sign * right, sign * down) for sign in (1, -1))
    with np.errstate(invalid="ignore"):
        row, column = np.nonzero(upper - lower > max(step_m, 0.5 / max(displacement, 1e-9)))
    jump, ground = (upper - lower)[row, column], lower[row, column].astype(np.float32)
    return row + max(down, 0), column + max(right, 0), jump, ground


def _shifted(image: Floats, right: int, down: int) -> Floats:
    """The image without its first columns and rows (without its last ones for negative numbers)."""
    return image[max(down, 0) : image.shape[0] + min(down, 0), max(right, 0) : image.shape[1] + min(right, 0)]
