"""Fractions of a pixel: disparities sharpened on the brightness itself, and their noise taken out, in turns."""

from __future__ import annotations

from typing import Callable, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatImage

_STEPS = 4
_STEP_PX = 0.3  # at most
_SIGMA_PX = 1.2  # of the window: it holds 4 pi sigma^2 = 18 independent pixels
_PRIOR_PX = 0.27  # standard deviation of what semi-global matching leaves in such a window: 0.2 to 0.3
_LEAST_NOISE = 1e-6  # variance of a brightness of 0..1: below a 12-bit sensor's noise
_MEDIAN = 5
_EDGE_PX = 0.7  # what the median would move farther is an edge, no noise
_SMOOTH_PX, _ALIKE_PX, _SMOOTH_WINDOW = 1.5, 0.5, 7


def positions(disparity: FloatImage, high: int) -> Tuple[FloatImage, FloatImage]:
    """Columns and rows of the second image that the first image's pixels are matched to; -9 where unknown."""
    columns = np.arange(disparity.shape[1], dtype=np.float32)[None, :] - disparity + np.float32(high)
    rows = np.repeat(np.arange(disparity.shape[0], dtype=np.float32)[:, None], disparity.shape[1], axis=1)
    return np.nan_to_num(columns, nan=-9.0), rows


def refined(disparity: FloatImage, first: FloatImage, second: FloatImage, high: int) -> FloatImage:
    """Disparities to a fraction of a pixel: moved to where the brightness agrees, and their noise taken out, in turns.

    Smoothing alone would also level what the ground is really like within the window; a step on the brightness after
    it brings back what the images prove (half-quadratic splitting, Geman and Yang 1995). The first steps lead off the
    whole pixels that semi-global matching draws to, before anything is averaged.
    """
    a, b = np.nan_to_num(first), np.nan_to_num(second)
    slope = cv2.Sobel(b, cv2.CV_32F, 1, 0, ksize=1) * np.float32(0.5)
    mean = _mean_of(np.isfinite(disparity))
    result = disparity
    for clean in (None, denoised, _smoothed, _smoothed):
        result = _moved(result, a, b, slope, high, mean)
        result = clean(result) if clean else result
    return result


def _moved(
    disparity: FloatImage,
    first: FloatImage,
    second: FloatImage,
    slope: FloatImage,
    high: int,
    mean: Callable[[FloatImage], FloatImage],
) -> FloatImage:
    """Disparities one step nearer to where the brightness of the two neighbourhoods agrees best.

    Gauss-Newton on the difference of brightness in a Gaussian window, with the mean taken out (Lucas and Kanade
    1981): free of the integer bias that parabolas through costs have. Each pixel of the window is shifted by its own
    disparity, so slopes and roofs do not blur.

    A step is as large as the window can prove. From n pixels with gradients g and noise of variance s^2 the disparity
    has the variance s^2 / (n g^2) (Cramer and Rao's bound), and beforehand that of ``_PRIOR_PX``, shared out among the
    steps; weighing the two multiplies the step by g^2 / (g^2 + s^2 / (n prior^2)). The noise is what the window's
    brightness still differs by: so weak texture in a clean image counts as much as strong texture in a noisy one,
    and no contrast is asked for. Without texture the step dies out.
    """
    columns, rows = positions(disparity, high)
    off = first - cv2.remap(second, columns, rows, cv2.INTER_CUBIC)
    g = cv2.remap(slope, columns, rows, cv2.INTER_LINEAR)
    mean_g, mean_off = mean(g), mean(off)
    against = mean(off * g) - mean_off * mean_g
    power = mean(g * g) - mean_g * mean_g
    noise = np.maximum(mean(off * off) - mean_off * mean_off, np.float32(_LEAST_NOISE))
    share_of_noise = np.float32(_STEPS / (4 * np.pi * _SIGMA_PX**2 * _PRIOR_PX**2))
    return disparity - np.clip(against / (power + share_of_noise * noise), -_STEP_PX, _STEP_PX)


def _mean_of(known: NDArray[np.bool_]) -> Callable[[FloatImage], FloatImage]:
    """The mean in a Gaussian window, over what is known of it."""
    weight = known.astype(np.float32)
    share = cv2.GaussianBlur(weight, (0, 0), _SIGMA_PX) + np.float32(1e-6)
    return lambda image: cv2.GaussianBlur(image * weight, (0, 0), _SIGMA_PX) / share


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
    calm = median(disparity)
    with np.errstate(invalid="ignore"):
        calm = np.where(np.abs(calm - disparity) <= np.float32(_EDGE_PX), calm, disparity)
    return _smoothed(calm)


def _smoothed(disparity: FloatImage) -> FloatImage:
    """The mean of neighbours alike."""
    known = np.isfinite(disparity)
    if not known.any():
        return disparity
    # Ten of the filter's deviations below the least: no weight is left, and its table of weights stays fine.
    absent = np.float32(disparity[known].min() - 10 * _ALIKE_PX)
    mean = cv2.bilateralFilter(np.where(known, disparity, absent), _SMOOTH_WINDOW, _ALIKE_PX, _SMOOTH_PX)
    return np.where(known, mean, np.float32(np.nan)).astype(np.float32)
