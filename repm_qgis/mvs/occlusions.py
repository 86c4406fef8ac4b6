"""What one image hides from the other is filled from the background."""

from __future__ import annotations

from typing import Tuple

import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]

_SLACK_PX, _FACTOR = 6, 1.6     # how much longer than the jump of disparity an occlusion's gap may be
_NARROW_PX = 8                  # gaps from row to row that matching leaves along edges


def with_background(disparity: FloatImage, nearer: float) -> FloatImage:
    """Gaps that a step in height explains, filled with the lower surface beside them.

    Along a row, a step hides about as many pixels of the ground behind it as the disparity jumps; gaps much longer
    than that are no occlusions and stay. Where edges run along the rows, matching leaves narrow gaps too. Gaps take
    the lower of the surfaces at their two ends in the row; between two roofs that is still a roof, so they take the
    second lowest of all four ends (up, down, left, right) if that is lower.
    """
    known = np.isfinite(disparity)
    left, right, long = _ends(np.float32(nearer) * disparity, known)
    up, down, high = (part.T for part in _ends(np.float32(nearer) * disparity.T, known.T))
    with np.errstate(invalid="ignore"):
        explained = (long <= np.abs(left - right) * _FACTOR + _SLACK_PX) | (high <= _NARROW_PX)
    gap = ~known & explained
    ends = np.stack([end[gap] for end in (left, right, up, down)])
    filled = disparity.copy()
    filled[gap] = np.float32(nearer) * np.fmin(np.fmin(ends[0], ends[1]), np.sort(ends, axis=0)[1])
    return filled


def _ends(surface: FloatImage, known: NDArray[np.bool_]) -> Tuple[FloatImage, FloatImage, NDArray[np.float64]]:
    """The known values before and after each pixel of a row (NaN: none), and how many unknown ones lie between.

    That number is infinite where the row's end comes first.
    """
    width = surface.shape[1]
    columns, rows = np.arange(width)[None, :], np.arange(surface.shape[0])[:, None]
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    left = np.where(before >= 0, surface[rows, np.maximum(before, 0)], np.float32(np.nan))
    right = np.where(after < width, surface[rows, np.minimum(after, width - 1)], np.float32(np.nan))
    return left, right, np.where((before >= 0) & (after < width), after - before - 1, np.inf)
