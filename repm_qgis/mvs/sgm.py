"""Backend ``sgm``: semi-global matching on the CPU (Hirschmueller 2008, in OpenCV's implementation).

Measured on ``truth_urban`` and a real Pleiades pair (docs/benchmarks.md): OpenCV's three-way mode with 3 x 3 blocks
and a 5 x 5 median is as good as its eight-way mode and takes a quarter of the time.
"""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]

_BLOCK = 3
_P1, _P2 = 16 * _BLOCK * _BLOCK, 64 * _BLOCK * _BLOCK
_UNIQUENESS = 5
_SPECKLE_CELLS, _SPECKLE_PX = 80, 2
_MEDIAN = 5
_SCORE_WINDOW = 7
_MIN_SCORE = 0.15
"""Correlation under which a match is noise: water, cloud, saturation."""


def match(first: FloatImage, second: FloatImage, disparities: Tuple[int, int]) -> Tuple[FloatImage, FloatImage]:
    """Disparities of a rectified pair.

    Parameters
    ----------
    first : (H, W) brightness in 0..1, NaN where there is none.
    second : (H, W + high - low), brightness whose column c shows the rectified column c - high.
    disparities : low, high: whole px, least and greatest first column minus second column.

    Returns
    -------
    disparity (H, W) in px, NaN where there is no trustworthy match, and score (H, W): the correlation of the matched
    neighbourhoods, 0..1.
    """
    low, high = disparities
    span = high - low
    count = -(-span // 16) * 16
    padded = np.full((first.shape[0], first.shape[1] + span), np.nan, dtype=np.float32)
    padded[:, span:] = first
    matcher = cv2.StereoSGBM_create(
        minDisparity=0, numDisparities=count, blockSize=_BLOCK, P1=_P1, P2=_P2, disp12MaxDiff=1, preFilterCap=31,
        uniquenessRatio=_UNIQUENESS, speckleWindowSize=_SPECKLE_CELLS, speckleRange=_SPECKLE_PX,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    raw = matcher.compute(_grey(padded), _grey(second))[:, span:]
    disparity = np.where(raw >= 0, raw / np.float32(16), np.float32(np.nan)).astype(np.float32) + np.float32(low)
    disparity[disparity > high] = np.nan
    disparity = _median(disparity)
    score = _score(first, second, disparity, high)
    # Where either image has nothing, the matcher has only made something up.
    disparity[~np.isfinite(score) | (score < _MIN_SCORE)] = np.nan
    return disparity, np.where(np.isfinite(disparity), np.clip(score, 0, 1), np.float32(np.nan))


def _grey(image: FloatImage) -> NDArray[np.uint8]:
    return (np.nan_to_num(image, nan=0.0) * 255).astype(np.uint8)


def _median(disparity: FloatImage) -> FloatImage:
    """Median of known neighbours' disparities; what is unknown stays so."""
    known = np.isfinite(disparity)
    low = np.float32(-1e6)
    filtered = cv2.medianBlur(np.where(known, disparity, low), _MEDIAN)
    return np.where(known & (filtered > low / 2), filtered, disparity)


def _score(first: FloatImage, second: FloatImage, disparity: FloatImage, high: int) -> FloatImage:
    """Normalised cross-correlation of each pixel's neighbourhood with the one it was matched to; NaN without data."""
    height, width = first.shape
    columns = np.arange(width, dtype=np.float32)[None, :] - disparity + np.float32(high)
    rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)
    matched = cv2.remap(second, np.nan_to_num(columns, nan=-9.0), rows, cv2.INTER_LINEAR,
                        borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    known = np.isfinite(matched) & np.isfinite(first) & np.isfinite(disparity)
    weight = known.astype(np.float32)
    a, b = np.where(known, first, np.float32(0)), np.where(known, matched, np.float32(0))

    def mean(image: FloatImage) -> FloatImage:
        return cv2.boxFilter(image, cv2.CV_32F, (_SCORE_WINDOW, _SCORE_WINDOW), normalize=True,
                             borderType=cv2.BORDER_CONSTANT)

    n = np.maximum(mean(weight), 1e-6)
    ma, mb = mean(a) / n, mean(b) / n
    va, vb = mean(a * a) / n - ma * ma, mean(b * b) / n - mb * mb
    covariance = mean(a * b) / n - ma * mb
    # 1e-6 of the full brightness range squared is below a 12-bit sensor's noise: no texture, no score.
    score = covariance / np.sqrt(np.maximum(va * vb, 1e-12))
    return np.where(known, score, np.float32(np.nan)).astype(np.float32)
