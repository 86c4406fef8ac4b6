"""What one image hides from the other is filled from the background.

Which of the two images hides something shows in the sign of the step in disparity: from left to right, disparities
(first column minus second) rise over what the second image hides, and fall where the first hides the ground itself.
"""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatImage

STEP_PX = 1.5
"""A smaller difference of disparity between neighbouring pixels is a slope, not a step."""

_SLACK_PX, _FACTOR = 6, 1.6  # how much longer than the jump of disparity an occlusion's gap may be
_NARROW_PX = 8  # gaps from row to row that matching leaves along edges


def with_background(
    disparity: FloatImage, nearer: float, lean: float = 0.0, own: Optional[FloatImage] = None
) -> FloatImage:
    """Gaps that a step in height explains, filled with the lower surface beside them.

    Along a row, a step hides about as many pixels of the ground behind it as the disparity jumps; gaps much longer
    than that are no occlusions and stay. Where edges run along the rows, matching leaves narrow gaps too. Gaps take
    the lower of the surfaces at their two ends in the row; between two roofs that is still a roof, so they take the
    second lowest of all four ends (up, down, left, right) if that is lower.

    ``lean`` is by how many columns the first image moves what rises by one px of disparity. A first image that looks
    from the side sees walls that the second does not: the part of a gap between a step's upper end and the foot of the
    vertical below it. That is no ground, and stays.

    ``own`` are the disparities by matching the first image alone, unchecked. Where the first image hides the ground,
    the two surfaces meet in it and both are seen in the second: gaps there are failures, and each pixel takes the end
    that its own disparity is nearer to.
    """
    known = np.isfinite(disparity)
    left, right, long = _ends(np.float32(nearer) * disparity, known)
    up, down, high = (part.T for part in _ends(np.float32(nearer) * disparity.T, known.T))
    with np.errstate(invalid="ignore"):
        explained = (long <= np.abs(left - right) * _FACTOR + _SLACK_PX) | (high <= _NARROW_PX)
        wall = _on_wall(known, left, right, nearer * lean)
    gap = ~known & explained & ~wall
    ends = np.stack([end[gap] for end in (left, right, up, down)])
    chosen = np.fmin(np.fmin(ends[0], ends[1]), np.sort(ends, axis=0)[1])
    if own is not None:
        upper, said = np.fmax(ends[0], ends[1]), np.float32(nearer) * own[gap]
        with np.errstate(invalid="ignore"):
            meet = (np.float32(nearer) * (ends[1] - ends[0]) < -STEP_PX) & (upper - said < said - chosen)
        chosen = np.where(meet, upper, chosen)
    filled = disparity.copy()
    filled[gap] = np.float32(nearer) * chosen
    return filled


def _on_wall(known: NDArray[np.bool_], left: FloatImage, right: FloatImage, lean: float) -> NDArray[np.bool_]:
    """Pixels of gaps between the upper end of a step in their row and the foot of the vertical below it.

    ``lean`` is by how many columns a px of height, as the ends ``left`` and ``right`` have it, moves a pixel.
    """
    if not lean:
        return np.zeros(known.shape, dtype=bool)
    width = known.shape[1]
    columns = np.arange(width, dtype=np.float32)[None, :]
    # The foot lies in the gap only where verticals lean from there to the upper end.
    upper, lower = (right, left) if lean > 0 else (left, right)
    beside = np.where(known, columns, np.float32(np.nan))
    if lean > 0:
        end = np.fmin.accumulate(beside[:, ::-1], axis=1)[:, ::-1]
    else:
        end = np.fmax.accumulate(beside, axis=1)
    return np.abs(columns - end) < abs(lean) * (upper - lower)


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
