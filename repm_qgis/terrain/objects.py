"""What stands on the ground: houses, trees and cars, found by openings with growing windows.

A morphological opening removes everything narrower than its window. From one window to the next a house sinks to the
ground at once, and a hill only little by little (Zhang et al. 2003, IEEE TGRS 41-4; Pingel, Clarke and McBride 2013,
ISPRS J. 77, who also name the slope and the pits). Steep hill tops still sink by more than such a threshold, so the
outline decides too: an object has walls around it, and a hill top has none.

All that a cell depends on lies within :func:`reach`, so the result does not depend on the blocks it is made in.
"""

from __future__ import annotations

import math
from typing import List

import cv2
import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import AnyArray, FloatImage, Floats, Mask
from .parameters import TERRAIN, ObjectParameters

_HIGH = np.float32(1e30)  # stands for no height where the lowest is looked for, and -_HIGH where the highest is


def reach(cell: float, largest: float, parameters: ObjectParameters = TERRAIN.objects) -> int:
    """How many cells (of ``cell`` m) around a cell decide whether it belongs to an object of ``largest`` m or less."""
    opening = 2 * _half_windows(cell, largest, parameters)[-1]
    outlines = opening * parameters.nearby // 2 + _cells(parameters.wall_m, cell)
    return opening + outlines + _cells(parameters.wall_m, cell) + 4 * _cells(parameters.pit_m, cell)


def objects_on(
    height: Floats, cell: float, largest: float, slope: float, parameters: ObjectParameters = TERRAIN.objects
) -> Mask:
    """Which cells belong to objects, or to pits that are wrong heights.

    Parameters
    ----------
    height : (H, W) m, NaN = none.
    cell : side of a cell, m.
    largest : the width of the largest object, m. Wider objects are ground.
    slope : the steepest ground, m per m: a steeper outline around an object is its wall.

    Returns
    -------
    (H, W) bool; False where there is no height.
    """
    known = np.isfinite(height)
    pits = _pits(height.astype(np.float32), known, cell, parameters)
    known &= ~pits
    found = np.zeros(height.shape, bool)
    upper = np.where(known, height, np.float32(0)).astype(np.float32)
    defined, before, done = known, 0, 0
    eroded = np.where(known, upper, _HIGH)
    for half in _half_windows(cell, largest, parameters):
        eroded = _lowest(eroded, half - done)
        opened = _highest(np.where(eroded < _HIGH, eroded, -_HIGH), half)
        reached = opened > -_HIGH
        sunk = np.where(defined & reached, upper - opened, np.float32(0))
        threshold = parameters.least_m + parameters.rise * (half - before) * cell
        above = sunk > threshold
        if half * cell > parameters.walled_m and above.any():
            above &= _walled(above, sunk, defined & reached, half=half, cell=cell, slope=slope, parameters=parameters)
        found |= above
        upper, defined, before, done = opened, reached, half, half
    return np.asarray((found & known) | pits)


def _walled(
    above: Mask, sunk: FloatImage, known: Mask, *, half: int, cell: float, slope: float, parameters: ObjectParameters
) -> Mask:
    """Where enough of the outlines nearby are walls."""
    side = _cells(parameters.wall_m, cell)
    outline = grown(above, side) & grown(known & ~above, side)
    step = _highest(sunk, side) - _lowest(np.where(known, sunk, _HIGH), side)
    walls = outline & (step > parameters.wall_noise_m + slope * 2 * side * cell)
    nearby = parameters.nearby * half
    # Half a cell less, so that cells without any outline (their object fills all known cells) keep their class.
    return np.asarray(_count(walls, nearby) >= parameters.wall_share * _count(outline, nearby) - np.float32(0.5))


def _pits(height: FloatImage, known: Mask, cell: float, parameters: ObjectParameters) -> Mask:
    """Narrow places that lie far below all that is around them: wrong matches, which an opening would spread."""
    half = _cells(parameters.pit_m, cell)
    highest = _highest(np.where(known, height, -_HIGH), half)
    closed = _lowest(np.where(highest > -_HIGH, highest, _HIGH), half)
    depth = np.where(known, closed - np.where(known, height, np.float32(0)), np.float32(0))
    return np.asarray(depth > parameters.pit_depth_m + 4 * parameters.rise * half * cell)


def _half_windows(cell: float, largest: float, parameters: ObjectParameters) -> List[int]:
    """Half the sides of the windows in cells, from the narrowest to that of the largest object."""
    last, step = max(1, math.ceil(largest / 2 / cell)), _cells(parameters.step_m, cell)
    return [*range(min(_cells(parameters.first_m, cell), last), last, step), last]


def _cells(length: float, cell: float) -> int:
    return max(1, round(length / cell))


def _square(half: int) -> NDArray[np.uint8]:
    return np.ones((2 * half + 1, 2 * half + 1), np.uint8)


def _lowest(values: AnyArray, half: int) -> FloatImage:
    if not half:
        return np.asarray(values)
    border = {"borderType": cv2.BORDER_CONSTANT, "borderValue": float(_HIGH)}
    return np.asarray(cv2.erode(values.astype(np.float32), _square(half), **border))


def _highest(values: AnyArray, half: int) -> FloatImage:
    border = {"borderType": cv2.BORDER_CONSTANT, "borderValue": -float(_HIGH)}
    return np.asarray(cv2.dilate(values.astype(np.float32), _square(half), **border))


def grown(mask: Mask, half: int) -> Mask:
    """A mask with so many cells more on each side."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), _square(half)) > 0)


def _count(mask: Mask, half: int) -> FloatImage:
    """How many cells of a mask a window has; whole numbers that float32 holds exactly, in whatever order they come."""
    side = (2 * half + 1, 2 * half + 1)
    shape = {"normalize": False, "borderType": cv2.BORDER_CONSTANT}
    return np.asarray(cv2.boxFilter(mask.astype(np.float32), cv2.CV_32F, side, **shape))
