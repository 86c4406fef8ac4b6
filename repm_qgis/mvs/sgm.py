"""Backend ``sgm``: semi-global matching on the CPU (Hirschmueller 2008, in OpenCV's implementation).

Both images are matched against each other; what the two disagree on by more than a pixel is dropped, small islands
too. Then every disparity is sharpened on the brightness itself, and what one image hides is filled from the
background and marked. Each choice was measured on ``truth_urban``, a simulated town and a real pair
(docs/benchmarks.md).
"""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .matching import Matched

FloatImage = NDArray[np.float32]

_BLOCK = 3
_P1, _P2 = 16 * _BLOCK * _BLOCK, 64 * _BLOCK * _BLOCK
_AGREE_PX = 1.0             # between the two directions
_SPECKLE_PIXELS, _SPECKLE_PX = 80, 1.0
_MEDIAN = 5
_SHARPEN_PASSES = 3
_SHARPEN_SIGMA_PX = 2.0
_SHARPEN_REACH_PX = 0.5     # semi-global matching is never farther off where it is right
_SHARPEN_NOISE = 1e-3       # variance of gradients that sensor noise makes, of a brightness of 0..1
_SHADOW_SLACK_PX, _SHADOW_FACTOR = 6, 1.6
_SCORE_WINDOW = 7
_RIM = 9                    # px: block, pre-filter and median together reach 4 px to each side


def match(first: FloatImage, second: FloatImage, disparities: Tuple[int, int], nearer: float) -> Matched:
    """Disparities of a rectified pair.

    Parameters
    ----------
    first : (H, W) brightness in 0..1, NaN where there is none.
    second : (H, W + high - low), brightness whose column c shows the rectified column c - high.
    disparities : low, high: whole px, least and greatest first column minus second column.
    nearer : +1 if greater disparities are higher ground, -1 if lower.
    """
    low, high = disparities
    a, b = _grey(first), _grey(second)
    forth, back = _forth(a, b, low, high), _back(a, b, low, high)
    first, second = _without_rim(first), _without_rim(second)
    forth[~np.isfinite(first)] = np.nan
    disparity = _without_islands(np.where(_agree(forth, back, high), forth, np.float32(np.nan)), low)
    disparity = _median(_sharpened(disparity, first, second, high))
    score = _score(first, second, disparity, high)
    # Where the second image has nothing, the matcher has only made something up.
    disparity[~np.isfinite(score)] = np.nan
    whole = _with_background(disparity, nearer)
    whole[~np.isfinite(first)] = np.nan
    filled = np.isfinite(whole) & ~np.isfinite(disparity)
    whole = np.where(filled, _median(whole), whole)
    return Matched(whole, np.where(np.isfinite(disparity), np.clip(score, 0, 1), np.float32(np.nan)), filled)


def _grey(image: FloatImage) -> NDArray[np.uint8]:
    return (np.nan_to_num(image, nan=0.0) * 255).astype(np.uint8)


def _without_rim(image: FloatImage) -> FloatImage:
    """The image without the pixels whose neighbourhood reaches beyond it: costs there compare with nothing."""
    missing = (~np.isfinite(image)).astype(np.uint8)
    return np.where(cv2.dilate(missing, np.ones((_RIM, _RIM), np.uint8)) > 0, np.float32(np.nan), image)


def _matcher(count: int) -> cv2.StereoSGBM:
    """Three-way aggregation: as good as eight ways here, in a quarter of the time. No checks: ours are stricter."""
    return cv2.StereoSGBM_create(
        minDisparity=0, numDisparities=-(-count // 16) * 16, blockSize=_BLOCK, P1=_P1, P2=_P2, disp12MaxDiff=-1,
        preFilterCap=31, uniquenessRatio=0, speckleWindowSize=0, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)


def _forth(first: NDArray[np.uint8], second: NDArray[np.uint8], low: int, high: int) -> FloatImage:
    """(H, W) disparity of each pixel of the first image; NaN without one."""
    span = high - low
    padded = cv2.copyMakeBorder(first, 0, 0, span, 0, cv2.BORDER_CONSTANT)
    raw = _matcher(span).compute(padded, second)[:, span:]
    disparity = np.where(raw >= 0, raw / np.float32(16), np.float32(np.nan)).astype(np.float32) + np.float32(low)
    disparity[disparity > high] = np.nan
    return disparity


def _back(first: NDArray[np.uint8], second: NDArray[np.uint8], low: int, high: int) -> FloatImage:
    """(H, W + high - low) disparity of each pixel of the second image; NaN without one.

    Its column c meets the first image's column c - e with e = high - disparity, from 0 to high - low.
    """
    span = high - low
    margin = -(-span // 16) * 16
    a = cv2.copyMakeBorder(first, 0, 0, margin, second.shape[1] - first.shape[1], cv2.BORDER_CONSTANT)
    b = cv2.copyMakeBorder(second, 0, 0, margin, 0, cv2.BORDER_CONSTANT)
    raw = _matcher(span).compute(b, a)[:, margin:]
    return np.where(raw >= 0, np.float32(high) - raw / np.float32(16), np.float32(np.nan)).astype(np.float32)


def _agree(forth: FloatImage, back: FloatImage, high: int) -> NDArray[np.bool_]:
    """Pixels whose match in the second image points back to them."""
    rows = np.arange(forth.shape[0])[:, None]
    columns = np.arange(forth.shape[1], dtype=np.float32) - forth + np.float32(high)
    target = np.rint(np.nan_to_num(columns, nan=-1.0)).astype(np.intp)
    inside = (target >= 0) & (target < back.shape[1])
    with np.errstate(invalid="ignore"):
        return inside & (np.abs(back[rows, np.where(inside, target, 0)] - forth) <= _AGREE_PX)


def _without_islands(disparity: FloatImage, low: int) -> FloatImage:
    """Connected pieces of fewer than 80 px dropped; a chimney on a roof is connected to it by its wall's slope."""
    steps = np.where(np.isfinite(disparity), (disparity - (low - 1)) * 16, 0).astype(np.int16)
    cv2.filterSpeckles(steps, 0, _SPECKLE_PIXELS, int(16 * _SPECKLE_PX))
    return np.where(steps > 0, disparity, np.float32(np.nan)).astype(np.float32)


def _median(disparity: FloatImage) -> FloatImage:
    """Median of known neighbours' disparities; what is unknown stays so."""
    known = np.isfinite(disparity)
    low = np.float32(-1e6)
    filtered = cv2.medianBlur(np.where(known, disparity, low), _MEDIAN)
    return np.where(known & (filtered > low / 2), filtered, disparity)


def _smooth(image: FloatImage) -> FloatImage:
    return cv2.GaussianBlur(image, (0, 0), _SHARPEN_SIGMA_PX)


def _positions(disparity: FloatImage, high: int) -> Tuple[FloatImage, FloatImage]:
    """Columns and rows of the second image that the first image's pixels are matched to; -9 where unknown."""
    columns = np.arange(disparity.shape[1], dtype=np.float32)[None, :] - disparity + np.float32(high)
    rows = np.repeat(np.arange(disparity.shape[0], dtype=np.float32)[:, None], disparity.shape[1], axis=1)
    return np.nan_to_num(columns, nan=-9.0), rows


def _sharpened(disparity: FloatImage, first: FloatImage, second: FloatImage, high: int) -> FloatImage:
    """Disparities moved, by up to half a pixel, to where the brightness of the two neighbourhoods agrees best.

    Gauss-Newton on the difference of brightness in a Gaussian window, with the mean taken out (Lucas and Kanade
    1981): free of the integer bias that parabolas through costs have. Each pixel of the window is shifted by its own
    disparity, so slopes and roofs do not blur; without texture the step dies out.
    """
    known = np.isfinite(disparity)
    weight = known.astype(np.float32)
    share = _smooth(weight) + np.float32(1e-6)

    def mean(image: FloatImage) -> FloatImage:
        return _smooth(image * weight) / share

    a, b = np.nan_to_num(first), np.nan_to_num(second)
    slope = cv2.Sobel(b, cv2.CV_32F, 1, 0, ksize=1) * np.float32(0.5)
    start = np.where(known, disparity, np.float32(0))
    current = start
    mean_a = mean(a)
    for _ in range(_SHARPEN_PASSES):
        columns, rows = _positions(current, high)
        matched = cv2.remap(b, columns, rows, cv2.INTER_CUBIC)
        g = cv2.remap(slope, columns, rows, cv2.INTER_LINEAR)
        mean_g = mean(g)
        against = mean((a - matched) * g) - (mean_a - mean(matched)) * mean_g
        power = mean(g * g) - mean_g * mean_g
        step = np.clip(against / (power + np.float32(_SHARPEN_NOISE)), -0.3, 0.3)
        current = np.clip(current - step, start - np.float32(_SHARPEN_REACH_PX), start + np.float32(_SHARPEN_REACH_PX))
    return np.where(known, current, np.float32(np.nan)).astype(np.float32)


def _with_background(disparity: FloatImage, nearer: float) -> FloatImage:
    """Gaps that an occlusion explains, filled with the lower of the surfaces at their two ends.

    A step in height hides about as many pixels of the ground behind it as the disparity jumps; gaps much longer than
    that are no occlusions and stay.
    """
    width = disparity.shape[1]
    known = np.isfinite(disparity)
    columns = np.arange(width)[None, :]
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    rows = np.arange(disparity.shape[0])[:, None]
    ends = (np.where(before >= 0, disparity[rows, np.maximum(before, 0)], np.float32(np.nan)),
            np.where(after < width, disparity[rows, np.minimum(after, width - 1)], np.float32(np.nan)))
    lower = np.where(nearer * ends[0] < nearer * ends[1], ends[0], ends[1])
    with np.errstate(invalid="ignore"):
        explained = after - before - 1 <= np.abs(ends[0] - ends[1]) * _SHADOW_FACTOR + _SHADOW_SLACK_PX
    return np.where(~known & explained, lower, disparity)


def _score(first: FloatImage, second: FloatImage, disparity: FloatImage, high: int) -> FloatImage:
    """Normalised cross-correlation of each pixel's neighbourhood with the one it was matched to; NaN without data."""
    columns, rows = _positions(disparity, high)
    matched = cv2.remap(second, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                        borderValue=float("nan"))
    known = np.isfinite(matched) & np.isfinite(first) & np.isfinite(disparity)
    a, b = np.where(known, first, np.float32(0)), np.where(known, matched, np.float32(0))
    n = np.maximum(_box(known.astype(np.float32)), 1e-6)
    ma, mb = _box(a) / n, _box(b) / n
    va, vb = _box(a * a) / n - ma * ma, _box(b * b) / n - mb * mb
    covariance = _box(a * b) / n - ma * mb
    # 1e-6 of the full brightness range squared is below a 12-bit sensor's noise: no texture, no score.
    score = covariance / np.sqrt(np.maximum(va * vb, 1e-12))
    return np.where(known, score, np.float32(np.nan)).astype(np.float32)


def _box(image: FloatImage) -> FloatImage:
    return cv2.boxFilter(image, cv2.CV_32F, (_SCORE_WINDOW, _SCORE_WINDOW), normalize=True,
                         borderType=cv2.BORDER_CONSTANT)
