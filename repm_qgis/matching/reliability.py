"""Which matches the images support: water and clouds become nodata, plain roofs and fields stay.

A matcher answers everywhere, and where both images show only noise its answer is made of smoothness. Three questions
are asked of what it found:

- *Do the images say the same?* The correlation of small windows, averaged over large ones, is about zero where noise
  was matched with noise, whatever smoothness made of it; where nothing was matched at all, it counts as zero.
- *Do neighbours say the same?* A plain roof correlates no better than water, but smoothness carries its edges' height
  across it, even; over water each place has found a height of its own. So what the images do not support is dropped
  only in large pieces whose disparities scatter, or in pieces larger than any roof.
- *Does it stand on the ground?* A cloud within the range of altitudes matches well. It is bright, and its surroundings
  lie far below it on all sides, farther than any building of that size stands.

Measured in docs/benchmarks.md (``make bench-masks``).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

import cv2
import numpy as np

from ..arrays import FloatImage, Mask
from ..imagery.sampling import mean_of_known
from .disparity_map import DisparityMap

_CORRELATION_PX = 7  # windows that are correlated,
_SUPPORT_PX = 25  # and the window over which their correlations are averaged:
_SUPPORT = 0.3  # noise has 0.1 to 0.2, the weakest hundredth of real fields and mountains 0.55 and more
_OWN_PX, _OWN = 9, 0.5  # a large window reaches over the shore by half its side: pieces grow back by that much,
_GROWTH_PX = 14  # as far as no good correlation stops them
_PIECE_PX = 4000  # smaller pieces (32 m x 32 m at 0.5 m) stay: roofs, shadows, swimming pools
_LARGEST_PX = 20000  # larger ones (70 m x 70 m) go: smoothness carries no height so far
_SCATTER_PX, _SCATTER_WINDOW_PX = 0.7, 41
_SCATTERED = 0.25  # share of a piece's pixels; plain roofs have 0.1 at most, water 0.45 and more
_SHORE_PX, _SHORE_WINDOW_PX, _SHORE = 6, 5, 0.8  # the bank's own texture carries its height over the water

_BRIGHT, _BRIGHT_SHARE = 0.6, 0.5
_CLOUD_M = 80.0  # above nearly all that is around it: white roofs of that size are never so high
_STEP_PX = 2.0
_AROUND_PX, _AROUND_SHARE = 30, 0.8


def without_unsupported(
    matched: DisparityMap,
    first: FloatImage,
    second: FloatImage,
    disparities: Tuple[int, int],
    nearer: float,
    metres_per_px: float,
) -> DisparityMap:
    """The matches without those that the images do not support, and without clouds.

    Parameters
    ----------
    matched, first, second, disparities, nearer : as of a matcher (``matching/sgm.py``).
    metres_per_px : of height for a px of disparity.

    Returns
    -------
    As ``matched``, with what is dropped NaN and not filled either. All else is untouched.
    """
    known = np.isfinite(matched.disparity) & ~matched.filled
    correlation, known = _correlation(matched.disparity, known, first, second, disparities[1])
    seen = _seen_twice(first, second, disparities)
    dropped = _unsupported(matched, correlation, known, seen)
    dropped |= _floating(
        matched.disparity * np.float32(nearer * metres_per_px), first, known & ~dropped, _STEP_PX * metres_per_px
    )
    if not dropped.any():
        return matched
    matches = np.isfinite(matched.disparity) & ~matched.filled
    dropped = np.where(matched.filled, _with_lost_ends(matches, matches & dropped), dropped)
    return replace(
        matched,
        disparity=np.where(dropped, np.float32(np.nan), matched.disparity),
        score=np.where(dropped, np.float32(np.nan), matched.score),
        filled=matched.filled & ~dropped,
    )


def _with_lost_ends(matches: Mask, dropped: Mask) -> Mask:
    """Pixels whose next match to the left or right in the row was dropped: what it explained is no occlusion."""
    width = matches.shape[1]
    columns, rows = np.arange(width, dtype=np.int32)[None, :], np.arange(matches.shape[0])[:, None]
    before = np.maximum.accumulate(np.where(matches, columns, 0), axis=1)
    after = np.minimum.accumulate(np.where(matches, columns, width - 1)[:, ::-1], axis=1)[:, ::-1]
    return dropped[rows, before] | dropped[rows, after]


def _box(image: FloatImage, side: int) -> FloatImage:
    return cv2.boxFilter(image, cv2.CV_32F, (side, side), normalize=True, borderType=cv2.BORDER_REFLECT)


def _correlation(
    disparity: FloatImage, known: Mask, first: FloatImage, second: FloatImage, high: int
) -> Tuple[FloatImage, Mask]:
    """Correlation of each matched pixel's window with its match, -1..1, 0 elsewhere; and which pixels have one."""
    columns = np.arange(first.shape[1], dtype=np.float32)[None, :] - disparity + np.float32(high)
    rows = np.repeat(np.arange(first.shape[0], dtype=np.float32)[:, None], first.shape[1], axis=1)
    met = cv2.remap(
        second,
        np.where(known, columns, np.float32(-9)),
        rows,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=float("nan"),
    )
    known = known & np.isfinite(met) & np.isfinite(first)
    a, b = np.where(known, first, np.float32(0)), np.where(known, met, np.float32(0))
    share = np.maximum(_box(known.astype(np.float32), _CORRELATION_PX), np.float32(1e-6))
    mean_a, mean_b = (_box(image, _CORRELATION_PX) / share for image in (a, b))
    against = _box(a * b, _CORRELATION_PX) / share - mean_a * mean_b
    power_a = _box(a * a, _CORRELATION_PX) / share - mean_a * mean_a
    power_b = _box(b * b, _CORRELATION_PX) / share - mean_b * mean_b
    # 1e-6 of the full brightness range squared is below a sensor's noise: saturated clouds correlate with nothing.
    correlation = against / np.sqrt(np.maximum(power_a * power_b, np.float32(1e-12)))
    return np.where(known, np.clip(correlation, -1, 1), np.float32(0)), known


def _seen_twice(first: FloatImage, second: FloatImage, disparities: Tuple[int, int]) -> Mask:
    """Pixels that have something to be matched with: elsewhere nothing speaks for a match, and nothing against it."""
    span, width = disparities[1] - disparities[0], first.shape[1]
    count = np.zeros((second.shape[0], second.shape[1] + 1), dtype=np.int32)
    np.cumsum(np.isfinite(second), axis=1, out=count[:, 1:])
    ends = np.minimum(np.arange(width) + span + 1, second.shape[1])
    return np.isfinite(first) & (count[:, ends] > count[:, :width])


def _unsupported(matched: DisparityMap, correlation: FloatImage, known: Mask, seen: Mask) -> Mask:
    """Large pieces that correlate with nothing and whose disparities scatter."""
    # What an occlusion explains need not be matched.
    expected = (seen & ~matched.filled).astype(np.float32)

    def support(side: int) -> FloatImage:
        return _box(correlation, side) / np.maximum(_box(expected, side), np.float32(1e-3))

    weak = _grown(seen & (support(_SUPPORT_PX) < _SUPPORT), seen & (support(_OWN_PX) < _OWN), _GROWTH_PX)
    count, piece, facts, _ = cv2.connectedComponentsWithStats(weak.astype(np.uint8), connectivity=4)
    inside = weak & known
    scattered = inside & (_scatter(matched.disparity, inside) > _SCATTER_PX)
    answers, apart = (np.bincount(piece[which], minlength=count) for which in (inside, scattered))
    area = facts[:, cv2.CC_STAT_AREA]
    bad = (area >= _LARGEST_PX) | (area >= _PIECE_PX) & (apart > _SCATTERED * answers)
    bad[0] = False
    if not bad.any():
        return np.zeros(weak.shape, dtype=bool)
    return _grown(bad[piece], ~matched.filled & (support(_SHORE_WINDOW_PX) < _SHORE), _SHORE_PX)


def _scatter(disparity: FloatImage, inside: Mask) -> FloatImage:
    """How far disparities lie from the mean of their neighbours within the same mask; a slope does not count."""
    mean, _ = mean_of_known(disparity, inside, lambda image: _box(image, _SCATTER_WINDOW_PX), 1e-6)
    return np.where(inside, np.abs(disparity - mean), np.float32(0))


def _grown(seed: Mask, into: Mask, pixels: int) -> Mask:
    """A mask with all that is connected to it within so many px through another one."""
    mask, allowed, cross = seed.astype(np.uint8), (seed | into).astype(np.uint8), np.ones((3, 3), np.uint8)
    for _ in range(pixels):
        mask = cv2.dilate(mask, cross) & allowed
    return mask > 0


def _floating(height: FloatImage, first: FloatImage, known: Mask, step_m: float) -> Mask:
    """Bright pieces that stand far above nearly all of their surroundings; ``height`` in m above some plane.

    Pieces end where neighbours differ by more than ``step_m``.
    """
    even = known.copy()
    with np.errstate(invalid="ignore"):
        even[:, 1:] &= np.abs(np.diff(height, axis=1)) <= step_m
        even[1:] &= np.abs(np.diff(height, axis=0)) <= step_m
        bright = even & (first > _BRIGHT)
    count, piece, facts, _ = cv2.connectedComponentsWithStats(even.astype(np.uint8), connectivity=4)
    shine = np.bincount(piece[bright], minlength=count) > _BRIGHT_SHARE * facts[:, cv2.CC_STAT_AREA]
    shine[0] = False
    result = np.zeros(known.shape, dtype=bool)
    for number in np.flatnonzero(shine & (facts[:, cv2.CC_STAT_AREA] >= _PIECE_PX)):
        col, row, width, tall = facts[number, :4]
        part = (
            slice(max(row - _AROUND_PX, 0), row + tall + _AROUND_PX),
            slice(max(col - _AROUND_PX, 0), col + width + _AROUND_PX),
        )
        cloud = piece[part] == number
        around = _grown(cloud, np.ones_like(cloud), _AROUND_PX)
        level = np.median(height[part][cloud])
        ground = around & even[part] & ~cloud
        with np.errstate(invalid="ignore"):
            below = level - height[part] > _CLOUD_M
        if (ground & below).sum() > _AROUND_SHARE * ground.sum() and ground.sum() > 0.2 * (around & ~cloud).sum():
            result[part] |= around & ~(ground & below)
    return result
