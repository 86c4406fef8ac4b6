"""Fractions of a pixel: disparities sharpened on the brightness itself, and their noise taken out."""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]

_PASSES = 3
_SIGMA_PX = 1.2             # of the window: it holds 4 pi sigma^2 = 18 independent pixels
_REACH_PX = 1.0             # as far as the two directions of matching may disagree
_PRIOR_PX = 0.24            # standard deviation of what semi-global matching leaves in such a window: 0.19 to 0.30
_LEAST_NOISE = 1e-6         # variance of a brightness of 0..1: below a 12-bit sensor's noise
_MEDIAN = 5
_STEP_PX = 0.7              # what the median would move farther is an edge, no noise
_SMOOTH_PX, _ALIKE_PX, _SMOOTH_WINDOW = 1.5, 0.5, 7


def positions(disparity: FloatImage, high: int) -> Tuple[FloatImage, FloatImage]:
    """Columns and rows of the second image that the first image's pixels are matched to; -9 where unknown."""
    columns = np.arange(disparity.shape[1], dtype=np.float32)[None, :] - disparity + np.float32(high)
    rows = np.repeat(np.arange(disparity.shape[0], dtype=np.float32)[:, None], disparity.shape[1], axis=1)
    return np.nan_to_num(columns, nan=-9.0), rows


def sharpened(disparity: FloatImage, first: FloatImage, second: FloatImage, high: int) -> FloatImage:
    """Disparities moved, by up to a pixel, to where the brightness of the two neighbourhoods agrees best.

    Gauss-Newton on the difference of brightness in a Gaussian window, with the mean taken out (Lucas and Kanade
    1981): free of the integer bias that parabolas through costs have. Each pixel of the window is shifted by its own
    disparity, so slopes and roofs do not blur.

    A step is as large as the window can prove. From n pixels with gradients g and noise of variance s^2 the disparity
    has the variance s^2 / (n g^2) (Cramer and Rao's bound), and beforehand that of ``_PRIOR_PX``, shared out among the
    passes; weighing the two multiplies the step by g^2 / (g^2 + s^2 / (n prior^2)). The noise is what the window's
    brightness still differs by: so weak texture in a clean image counts as much as strong texture in a noisy one,
    and no contrast is asked for. Without texture the step dies out.
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
    share_of_noise = np.float32(_PASSES / (4 * np.pi * _SIGMA_PX ** 2 * _PRIOR_PX ** 2))
    for _ in range(_PASSES):
        columns, rows = positions(current, high)
        matched = cv2.remap(b, columns, rows, cv2.INTER_CUBIC)
        g = cv2.remap(slope, columns, rows, cv2.INTER_LINEAR)
        off = a - matched
        mean_g, mean_off = mean(g), mean(off)
        against = mean(off * g) - mean_off * mean_g
        power = mean(g * g) - mean_g * mean_g
        noise = np.maximum(mean(off * off) - mean_off * mean_off, np.float32(_LEAST_NOISE))
        step = np.clip(against / (power + share_of_noise * noise), -0.3, 0.3)
        current = np.clip(current - step, start - np.float32(_REACH_PX), start + np.float32(_REACH_PX))
    return np.where(known, current, np.float32(np.nan)).astype(np.float32)


def _smooth(image: FloatImage) -> FloatImage:
    return cv2.GaussianBlur(image, (0, 0), _SIGMA_PX)


def median(disparity: FloatImage) -> FloatImage:
    """Median of the known neighbours' disparities; what is unknown stays so."""
    known = np.isfinite(disparity)
    low = np.float32(-1e6)
    filtered = cv2.medianBlur(np.where(known, disparity, low), _MEDIAN)
    return np.where(known & (filtered > low / 2), filtered, disparity)


def denoised(disparity: FloatImage) -> FloatImage:
    """Less noise and the same edges: a median that moves nothing by a step, then a mean of neighbours alike.

    Bilateral filter after Tomasi and Manduchi (1998). What is unknown stays so and counts for nothing.
    """
    known = np.isfinite(disparity)
    if not known.any():
        return disparity
    calm = median(disparity)
    with np.errstate(invalid="ignore"):
        calm = np.where(np.abs(calm - disparity) <= np.float32(_STEP_PX), calm, disparity)
    # Ten of the filter's deviations below the least: no weight is left, and its table of weights stays fine.
    absent = np.float32(calm[known].min() - 10 * _ALIKE_PX)
    mean = cv2.bilateralFilter(np.where(known, calm, absent), _SMOOTH_WINDOW, _ALIKE_PX, _SMOOTH_PX)
    return np.where(known, mean, np.float32(np.nan)).astype(np.float32)
