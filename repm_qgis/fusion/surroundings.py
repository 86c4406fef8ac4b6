"""The cells around a cell: at which places, and how high they lie."""

from __future__ import annotations

from typing import Sequence, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask

Offsets = Sequence[Tuple[int, int]]
"""Rows and columns from a cell to others."""

_EACH_SIDE = 3  # places: 49 in all are enough for means and medians, and bound the time on small cells


def places(reach_m: float, cell: float) -> Offsets:
    """The cell itself and evenly spaced places around it, up to about ``reach_m`` to each side: at most seven by seven
    cells of the side ``cell`` (m)."""
    step = max(1, round(reach_m / cell / _EACH_SIDE))
    farthest = max(1, min(round(reach_m / cell / step), _EACH_SIDE)) * step
    along = range(-farthest, farthest + 1, step)
    return [(down, right) for down in along for right in along]


def others(offsets: Offsets) -> Offsets:
    """The same without the cell itself."""
    return [place for place in offsets if place != (0, 0)]


def farthest(offsets: Offsets) -> int:
    """How many rows or columns away the farthest place is."""
    return max(max(map(abs, place)) for place in offsets)


def extremes(height: FloatImage, known: Mask, reach: int = 1) -> Tuple[FloatImage, FloatImage]:
    """(H, W) the lowest and the highest known height up to so many rows and columns away from each cell."""
    around, infinite = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8), np.float32(np.inf)
    low = cv2.erode(np.where(known, height, infinite), around)
    high = cv2.dilate(np.where(known, height, -infinite), around)
    return low, high
