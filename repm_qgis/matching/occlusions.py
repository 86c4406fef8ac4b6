"""Occlusion filling: pixels that one of the images hides take the disparity of the background.

The sign of a step in disparity says which of the two images hides something: from left to right, disparities (first
column minus second) rise over what the second image hides, and fall where the first hides the ground itself.
"""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, IntArray, Mask
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
    longer are no occlusions, but shadows for example, and stay empty. Matching also leaves narrow gaps where edges run
    along the rows. Gaps take the lower of the surfaces at their two ends in the row. Between two roofs that is still a
    roof, so they take the second lowest of all four ends (left, right, up, down) if that is lower.

    Parameters
    ----------
    height_sign, relief_displacement : as of a :class:`repm_qgis.matching.disparity_map.PairMatcher`. A first image
        that looks from the side shows walls that the second does not show: the part of a gap between a step's upper
        end and the foot of the vertical below it. That is no ground, and stays empty.
    unchecked : the disparities of the first image before the consistency check. Where the disparity falls along the
        row, the first image hides the ground, the two surfaces meet in it and the second shows both: a gap there is a
        failure of the check, and each pixel takes the surface whose disparity is nearer to its own unchecked one. In a
        long gap the unchecked disparity must be that of the surface.
    """
    sign, known = np.float32(height_sign), np.isfinite(disparity)
    gaps = np.nonzero(~known)
    left, right, before, after, length = _around_gaps(sign * disparity, known, gaps, 1)
    up, down, _, _, rows = _around_gaps(sign * disparity, known, gaps, 0)
    displacement = height_sign * relief_displacement
    # Verticals lead from the foot of a wall to its upper end, at the left or at the right of the gap.
    upper, lower, end = (right, left, after) if displacement > 0 else (left, right, before)
    with np.errstate(invalid="ignore"):
        rise = sign * (right - left)
        explained = length <= np.abs(rise) * parameters.factor + parameters.slack_px
        long = (rise < 0) & (length > parameters.slack_px) & (rows > parameters.narrow_px)
        wall = np.abs(gaps[1] - end) < abs(displacement) * (upper - lower)
    lower_row, lower_column = np.fmin(left, right), np.fmin(up, down)
    second = np.fmin(np.maximum(lower_row, lower_column), np.fmin(np.maximum(left, right), np.maximum(up, down)))
    chosen = np.fmin(lower_row, second)
    own = np.full_like(chosen, np.nan) if unchecked is None else sign * unchecked[gaps]
    higher = np.fmax(left, right)
    with np.errstate(invalid="ignore"):
        meet = (rise < -parameters.step_px) & (higher - own < own - chosen)
        chosen = np.where(meet, higher, chosen)
        chosen[long & ~(np.abs(own - chosen) <= parameters.step_px)] = np.nan
    filled = disparity.copy()
    filled[gaps] = np.where((explained | (rows <= parameters.narrow_px)) & ~wall, sign * chosen, np.float32(np.nan))
    return filled


def _around_gaps(
    surface: FloatImage, known: Mask, gaps: Tuple[IntArray, ...], axis: int
) -> Tuple[FloatImage, FloatImage, FloatArray, FloatArray, FloatArray]:
    """For (N,) unknown pixels, along an axis: the known values before and after each (NaN: none), their places (NaN),
    and how many unknown ones lie between: infinite where the image's end comes first."""
    size = known.shape[axis]
    place = np.arange(size, dtype=np.int32)
    place = place if axis else place[:, None]
    backwards = (slice(None),) * axis + (slice(None, None, -1),)
    before = np.maximum.accumulate(np.where(known, place, np.int32(-1)), axis=axis)[gaps]
    after = np.minimum.accumulate(np.where(known, place, np.int32(size))[backwards], axis=axis)[backwards][gaps]
    values = []
    for end in (np.maximum(before, 0), np.minimum(after, size - 1)):
        at = (gaps[0], end) if axis else (end, gaps[1])
        values.append(surface[at])  # NaN where the pixel at the end of the gap is unknown
    first, last = (np.where(ok, end, np.nan) for ok, end in ((before >= 0, before), (after < size, after)))
    between = np.where((before >= 0) & (after < size), after - before - 1, np.inf)
    return values[0], values[1], first, last, between
