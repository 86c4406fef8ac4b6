"""Occlusion filling: what one image hides from the other takes the disparity of the background.

The sign of a step in disparity says which of the two images hides something: from left to right, disparities (first
column minus second) rise over what the second image hides, and fall where the first hides the ground itself.
"""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from ..arrays import FloatArray, FloatImage, Mask
from .parameters import MATCHING, OcclusionParameters


def fill_occlusions(
    disparity: FloatImage,
    height_sign: float,
    relief_displacement: float = 0.0,
    unchecked: Optional[FloatImage] = None,
    parameters: OcclusionParameters = MATCHING.occlusions,
) -> FloatImage:
    """Gaps that a step in height explains, filled with the lower surface beside them.

    Along a row, a step hides about as many pixels of the ground behind it as the disparity rises; gaps that are much
    longer are no occlusions and stay: they lie in shadows, say. Matching also leaves narrow gaps where edges run along
    the rows. Gaps take the lower of the surfaces at their two ends in the row. Between two roofs that is still a roof,
    so they take the second lowest of all four ends (left, right, up, down) if that is lower.

    Parameters
    ----------
    height_sign, relief_displacement : as of a :class:`repm_qgis.matching.disparity_map.PairMatcher`. A first image
        that looks from the side shows walls that the second does not show: the part of a gap between a step's upper
        end and the foot of the vertical below it. That is no ground, and stays empty.
    unchecked : the disparities of the first image before the consistency check. Where the disparity falls along the
        row, the first image hides the ground, the two surfaces meet in it and the second shows both: a gap there is a
        failure of the check, and each pixel takes the end that its unchecked disparity is nearer to. In a long gap it
        must be that surface's.
    """
    sign = np.float32(height_sign)
    known = np.isfinite(disparity)
    left, right, length = _ends(sign * disparity, known)
    up, down, rows = (part.T for part in _ends(sign * disparity.T, known.T))
    with np.errstate(invalid="ignore"):
        rise = sign * (right - left)
        explained = length <= np.abs(rise) * parameters.factor + parameters.slack_px
        long = (rise < 0) & (length > parameters.slack_px) & (rows > parameters.narrow_px)
        wall = _on_wall(known, left, right, height_sign * relief_displacement)
    gap = ~known & (explained | (rows <= parameters.narrow_px)) & ~wall
    ends = np.stack([end[gap] for end in (left, right, up, down)])
    chosen = np.fmin(np.fmin(ends[0], ends[1]), np.sort(ends, axis=0)[1])
    own = np.full_like(chosen, np.nan) if unchecked is None else sign * unchecked[gap]
    upper = np.fmax(ends[0], ends[1])
    with np.errstate(invalid="ignore"):
        meet = (rise[gap] < -parameters.step_px) & (upper - own < own - chosen)
        chosen = np.where(meet, upper, chosen)
        chosen[long[gap] & ~(np.abs(own - chosen) <= parameters.step_px)] = np.nan
    filled = disparity.copy()
    filled[gap] = sign * chosen
    return filled


def _on_wall(known: Mask, left: FloatImage, right: FloatImage, displacement: float) -> Mask:
    """Pixels of gaps between the upper end of a step in their row and the foot of the vertical below it.

    ``displacement`` is in columns for each px of height, as the ends ``left`` and ``right`` have it.
    """
    if not displacement:
        return np.zeros(known.shape, dtype=bool)
    columns = np.arange(known.shape[1], dtype=np.float32)[None, :]
    # The foot lies in the gap only where verticals lead from there to the upper end.
    upper, lower = (right, left) if displacement > 0 else (left, right)
    places = np.where(known, columns, np.float32(np.nan))
    if displacement > 0:
        end = np.fmin.accumulate(places[:, ::-1], axis=1)[:, ::-1]
    else:
        end = np.fmax.accumulate(places, axis=1)
    wall: Mask = np.abs(columns - end) < abs(displacement) * (upper - lower)
    return wall


def _ends(surface: FloatImage, known: Mask) -> Tuple[FloatImage, FloatImage, FloatArray]:
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
