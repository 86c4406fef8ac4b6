"""Reliability mask: disparities without support in the images (over water) and those of clouds are removed; roofs and
fields stay.

A matcher gives a disparity everywhere, and where both images show only noise, it results from the smoothness term
alone. Each disparity is tested three times:

- *Do the images agree?* The correlation of small windows, averaged over large ones, is about zero where noise was
  matched with noise, however smooth the disparities are; where nothing was matched at all, it counts as zero.
- *Do neighbours agree?* A plain roof correlates no better than water, but smoothness extends the height of its edges
  evenly across it; over water each place has another height. So disparities without support are removed only in large
  components that scatter, or in components that are larger than any roof.
- *Does it stand on the ground?* A cloud within the range of altitudes matches well. It is bright, and its surroundings
  lie far below it on all sides, farther than any building of that size is high.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Optional, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask
from ..imagery.sampling import mean_of_known
from ..imagery.warping import box_filter
from .disparity_map import DisparityMap, match_correlation
from .parameters import MATCHING, ReliabilityParameters


def mask_unreliable(
    matched: DisparityMap,
    first: FloatImage,
    second: FloatImage,
    *,
    disparities: Tuple[int, int],
    height_sign: float,
    metres_per_px: float,
    parameters: ReliabilityParameters = MATCHING.reliability,
    wider: Optional[Callable[[Mask], DisparityMap]] = None,
    full_disparity: Optional[Callable[[FloatImage], FloatImage]] = None,
) -> DisparityMap:
    """The disparity map without clouds and without disparities that the images do not support: NaN there, and not
    filled.

    Parameters
    ----------
    matched, first, second, disparities, height_sign : as of a :class:`repm_qgis.matching.disparity_map.PairMatcher`.
    metres_per_px : of height for a px of disparity.
    wider : gives the disparities that wide windows support within a mask (H, W): those of large components without
        support are taken from it.
    full_disparity : gives the disparities of the rectified images from those of the map, where the second image was
        resampled on a disparity prior; the result and those of ``wider`` have these.
    """
    disparity = np.where(matched.filled, np.float32(np.nan), matched.disparity)
    side, high = parameters.correlation_px, disparities[1]
    score, known = match_correlation(first, second, disparity, high, side, cv2.BORDER_REFLECT)
    score = np.where(known, np.clip(score, -1, 1), np.float32(0))
    shown = shown_twice(first, second, disparities)
    removed = _unsupported(matched, score, known, shown, parameters)
    matches = np.isfinite(disparity)
    if full_disparity is not None:
        matched = replace(matched, disparity=full_disparity(matched.disparity))
    if wider is not None:
        missing = large_components(shown & (removed | ~np.isfinite(matched.disparity)), parameters.least_px)
        if missing.any():
            wide = wider(missing)
            taken = missing & np.isfinite(wide.disparity)
            matched = _replaced(matched, wide, taken)
            removed, known, matches = removed & ~taken, known | taken, matches | taken
    height = matched.disparity * np.float32(height_sign * metres_per_px)
    step_m = parameters.cloud_step_px * metres_per_px
    removed |= _clouds(height, first, known & ~removed, step_m, parameters)
    if not removed.any():
        return matched
    removed = np.where(matched.filled, _next_to_removed(matches, matches & removed), removed)
    disparity, score = (np.where(removed, np.float32(np.nan), part) for part in (matched.disparity, matched.score))
    return DisparityMap(disparity, score, matched.filled & ~removed)


def large_components(mask: Mask, least_px: float) -> Mask:
    """The mask's components of so many pixels or more."""
    _, component, facts, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = facts[:, cv2.CC_STAT_AREA] >= least_px
    large[0] = False
    found: Mask = large[component]
    return found


def _replaced(matched: DisparityMap, other: DisparityMap, where: Mask) -> DisparityMap:
    disparity, score = (
        np.where(where, theirs, ours)
        for ours, theirs in ((matched.disparity, other.disparity), (matched.score, other.score))
    )
    return DisparityMap(disparity, score, matched.filled & ~where)


def _next_to_removed(matches: Mask, removed: Mask) -> Mask:
    """Pixels whose next match to the left or right in the row was removed: a fill between them is no longer
    justified."""
    width = matches.shape[1]
    columns, rows = np.arange(width, dtype=np.int32)[None, :], np.arange(matches.shape[0])[:, None]
    before = np.maximum.accumulate(np.where(matches, columns, 0), axis=1)
    after = np.minimum.accumulate(np.where(matches, columns, width - 1)[:, ::-1], axis=1)[:, ::-1]
    found: Mask = removed[rows, before] | removed[rows, after]
    return found


def shown_twice(first: FloatImage, second: FloatImage, disparities: Tuple[int, int]) -> Mask:
    """Pixels that the second image can show: a missing match says something about these only."""
    span, width = disparities[1] - disparities[0], first.shape[1]
    count = np.zeros((second.shape[0], second.shape[1] + 1), dtype=np.int32)
    np.cumsum(np.isfinite(second), axis=1, out=count[:, 1:])
    ends = np.minimum(np.arange(width) + span + 1, second.shape[1])
    shown: Mask = np.isfinite(first) & (count[:, ends] > count[:, :width])
    return shown


def _unsupported(
    matched: DisparityMap, score: FloatImage, known: Mask, shown: Mask, parameters: ReliabilityParameters
) -> Mask:
    """Large components without correlation whose disparities scatter."""
    # What an occlusion explains need not be matched.
    expected = (shown & ~matched.filled).astype(np.float32)

    def support(side: int) -> FloatImage:
        mean = box_filter(side)
        share: FloatImage = mean(score) / np.maximum(mean(expected), np.float32(1e-3))
        return share if matched.support is None else share + mean(matched.support)

    weak = shown & (support(parameters.support_px) < parameters.least_support)
    weak = _grown(weak, shown & (support(parameters.own_px) < parameters.own_support), parameters.growth_px)
    count, component, facts, _ = cv2.connectedComponentsWithStats(weak.astype(np.uint8), connectivity=4)
    inside = weak & known
    scattered = inside & (_scatter(matched.disparity, inside, parameters) > parameters.scatter_px)
    matches, apart = (np.bincount(component[which], minlength=count) for which in (inside, scattered))
    area = facts[:, cv2.CC_STAT_AREA]
    scatters = (area >= parameters.least_px) & (apart > parameters.scatter_share * matches)
    bad = (area >= parameters.endless_px) | scatters
    bad[0] = False
    if not bad.any():
        return np.zeros(weak.shape, dtype=bool)
    shore = ~matched.filled & (support(parameters.shore_window_px) < parameters.shore_support)
    return _grown(bad[component], shore, parameters.shore_px)


def _scatter(disparity: FloatImage, inside: Mask, parameters: ReliabilityParameters) -> FloatImage:
    """How far disparities lie from the mean of their neighbours within the same mask; a slope does not count."""
    mean, _ = mean_of_known(disparity, inside, box_filter(parameters.scatter_window_px), 1e-6)
    return np.where(inside, np.abs(disparity - mean), np.float32(0))


def _grown(seed: Mask, into: Mask, pixels: int) -> Mask:
    """A mask with what is connected to it within so many px through another one."""
    mask, allowed, cross = seed.astype(np.uint8), (seed | into).astype(np.uint8), np.ones((3, 3), np.uint8)
    for _ in range(pixels):
        mask = cv2.dilate(mask, cross) & allowed
    return mask > 0


def _clouds(height: FloatImage, first: FloatImage, known: Mask, step_m: float, p: ReliabilityParameters) -> Mask:
    """Bright components that stand far above nearly all of their surroundings; ``height`` in m above some plane.

    Components end where neighbours differ by more than ``step_m``.
    """
    even = known.copy()
    with np.errstate(invalid="ignore"):
        even[:, 1:] &= np.abs(np.diff(height, axis=1)) <= step_m
        even[1:] &= np.abs(np.diff(height, axis=0)) <= step_m
        bright = even & (first > p.bright)
    count, component, facts, _ = cv2.connectedComponentsWithStats(even.astype(np.uint8), connectivity=4)
    area, reach = facts[:, cv2.CC_STAT_AREA], p.around_px
    shine = np.bincount(component[bright], minlength=count) > p.bright_share * area
    result = np.zeros(known.shape, dtype=bool)
    for number in np.flatnonzero(shine & (area >= p.cloud_px)):
        col, row, width, tall = facts[number, :4]
        part = np.s_[max(row - reach, 0) : row + tall + reach, max(col - reach, 0) : col + width + reach]
        cloud = component[part] == number
        around = _grown(cloud, np.ones_like(cloud), reach)
        ground = around & even[part] & ~cloud
        with np.errstate(invalid="ignore"):
            below = np.median(height[part][cloud]) - height[part] > p.cloud_m
        far_below = (ground & below).sum() > p.around_share * ground.sum()
        if far_below and ground.sum() > p.least_ground * (around & ~cloud).sum():
            result[part] |= around & ~(ground & below)
    return result
