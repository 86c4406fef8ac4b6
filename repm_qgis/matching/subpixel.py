"""Subpixel disparities: steps on the intensities of the images, and filters of the noise, in turns."""

from __future__ import annotations

from typing import Callable

import cv2
import numpy as np

from ..arrays import FloatImage, Mask
from .disparity_map import matched_positions
from .parameters import MATCHING, SubpixelParameters


def subpixel_disparity(
    disparity: FloatImage,
    first: FloatImage,
    second: FloatImage,
    high: int,
    parameters: SubpixelParameters = MATCHING.subpixel,
) -> FloatImage:
    """(H, W) disparities to a fraction of a pixel, of images as a :class:`.disparity_map.PairMatcher` gets them.

    Smoothing alone would also level real relief within the window; the next step on the intensities restores what the
    images show (half-quadratic splitting, Geman and Yang 1995). Unknown disparities stay unknown and have no weight.
    """
    step = _Step(first, second, high, _mean_of(np.isfinite(disparity), parameters.sigma_px), parameters)
    for operation in parameters.operations:
        if operation == "step":
            disparity = step.moved(disparity)
        else:
            disparity = (_edge_preserving_median if operation == "median" else _bilateral_mean)(disparity, parameters)
    return disparity


class _Step:
    """Gauss-Newton on the difference of intensity in a Gaussian window, without its mean (Lucas and Kanade 1981).

    It does not have the integer bias of parabolas through costs. Each pixel of the window is shifted by its own
    disparity, so that slopes and roofs do not blur.

    A step is as large as the window justifies. From n pixels with gradients g and noise of variance s^2, the disparity
    has the variance s^2 / (n g^2) (the bound of Cramer and Rao), and beforehand that of ``prior_px``, which the steps
    share. The weights of the two multiply the step by g^2 / (g^2 + s^2 / (n prior^2)). The noise is the difference of
    intensity that remains in the window: so weak texture in a clean image counts as much as strong texture in a noisy
    one, without a threshold of contrast. Without texture the step becomes zero.
    """

    def __init__(
        self,
        first: FloatImage,
        second: FloatImage,
        high: int,
        mean: Callable[[FloatImage], FloatImage],
        parameters: SubpixelParameters,
    ) -> None:
        self._first, self._second = np.nan_to_num(first), np.nan_to_num(second)
        self._slope = cv2.Sobel(self._second, cv2.CV_32F, 1, 0, ksize=1) * np.float32(0.5)
        self._high, self._mean, self._parameters = high, mean, parameters
        window_px = 4 * np.pi * parameters.sigma_px**2 * parameters.prior_px**2
        self._noise_share = np.float32(parameters.operations.count("step") / window_px)

    def moved(self, disparity: FloatImage) -> FloatImage:
        """Disparities one step nearer to where the intensities of the two neighbourhoods agree best."""
        mean, most = self._mean, self._parameters.most_step_px
        columns, rows = matched_positions(disparity, self._high)
        off = self._first - cv2.remap(self._second, columns, rows, cv2.INTER_CUBIC)
        g = cv2.remap(self._slope, columns, rows, cv2.INTER_LINEAR)
        mean_g, mean_off = mean(g), mean(off)
        covariance = mean(off * g) - mean_off * mean_g
        power = mean(g * g) - mean_g * mean_g
        noise = np.maximum(mean(off * off) - mean_off * mean_off, np.float32(self._parameters.least_noise))
        moved: FloatImage = disparity - np.clip(covariance / (power + self._noise_share * noise), -most, most)
        return moved


def _mean_of(known: Mask, sigma_px: float) -> Callable[[FloatImage], FloatImage]:
    """The mean of the known pixels in a Gaussian window."""
    weight = known.astype(np.float32)
    share = cv2.GaussianBlur(weight, (0, 0), sigma_px) + np.float32(1e-6)
    return lambda image: cv2.GaussianBlur(image * weight, (0, 0), sigma_px) / share


def known_median(disparity: FloatImage, side_px: int) -> FloatImage:
    """Median of the known neighbours' disparities; unknown pixels stay unknown."""
    known = np.isfinite(disparity)
    low = np.float32(-1e6)
    filtered = cv2.medianBlur(np.where(known, disparity, low), side_px)
    return np.where(known & (filtered > low / 2), filtered, disparity)


def _edge_preserving_median(disparity: FloatImage, parameters: SubpixelParameters) -> FloatImage:
    """The median, except where it would move a disparity so far that there must be an edge."""
    median = known_median(disparity, parameters.median_px)
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(median - disparity) <= np.float32(parameters.edge_px), median, disparity)


def _bilateral_mean(disparity: FloatImage, parameters: SubpixelParameters) -> FloatImage:
    """The mean of neighbours with similar disparities: bilateral filter of Tomasi and Manduchi (1998)."""
    known = np.isfinite(disparity)
    if not known.any():
        return disparity
    alike = parameters.alike_sigma_px
    # Ten deviations below the least disparity: such pixels have no weight, and the filter's table stays fine.
    absent = np.float32(disparity[known].min() - 10 * alike)
    filled = np.where(known, disparity, absent)
    mean = cv2.bilateralFilter(filled, parameters.smooth_window_px, alike, parameters.smooth_sigma_px)
    return np.where(known, mean, np.float32(np.nan)).astype(np.float32)
