"""Subpixel disparities: steps on the intensities of the images, and filters of the noise, in turns."""

from __future__ import annotations

from typing import Callable, Dict, Optional, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask
from ..imagery.sampling import known_or_zero
from ..imagery.warping import gaussian_mean
from ..numerics.robust import NMAD_FACTOR
from ..runtime.spare_cores import side_by_side
from .detail import bilateral_mean, tail, without_noise
from .disparity_map import matched_positions
from .parameters import MATCHING, DetailParameters, SubpixelParameters


def subpixel_disparity(
    disparity: FloatImage,
    first: FloatImage,
    second: FloatImage,
    high: int,
    parameters: SubpixelParameters = MATCHING.subpixel,
) -> FloatImage:
    """(H, W) disparities to a fraction of a pixel, of images as a :class:`.disparity_map.PairMatcher` gets them.

    Smoothing alone would also flatten real relief within the window; the next step on the intensities restores what the
    images show (half-quadratic splitting, Geman and Yang 1995). At the end, detail that noise explains is removed.
    Unknown disparities stay unknown and have no weight.
    """
    p = parameters
    step = _Step(first, second, high, np.isfinite(disparity), p)
    operations: Dict[str, Callable[[FloatImage], FloatImage]] = {
        "step": step.moved,
        "median": lambda found: _edge_preserving_median(found, p),
        "mean": lambda found: bilateral_mean(found, p.smooth_sigma_px, p.alike_sigma_px, p.smooth_window_px),
        "detail": lambda found: step.without_noise(found, p),
        "planes": lambda found: _planes(found, step, p),
    }
    for operation in parameters.operations:
        disparity = operations[operation](disparity)
    return disparity


def _planes(disparity: FloatImage, step: _Step, parameters: SubpixelParameters) -> FloatImage:
    """Disparities of a narrow pair: detail that noise may explain is removed where walls show that there is a town."""
    p = parameters.planes
    if tail(disparity, parameters) <= p.least_tail:
        return step.without_noise(disparity, parameters)
    for _ in range(p.passes):  # with less noise, more neighbours are alike
        disparity = step.without_noise(disparity, parameters, p.kept)
    return disparity


_Statistics = Tuple[FloatImage, FloatImage, FloatImage, FloatImage]


class _Step:
    """Gauss-Newton on the difference of intensity in a Gaussian window, without its mean (Lucas and Kanade 1981).

    It does not have the integer bias of parabolas through costs. Each pixel of the window is shifted by its own
    disparity, so that slopes and roofs do not blur.

    A step is as large as the window justifies. From n pixels with gradients g and noise of variance s^2, the disparity
    has the variance s^2 / (n g^2) (the bound of Cramer and Rao), and beforehand that of ``prior_px``, which the steps
    share. The weights of the two multiply the step by g^2 / (g^2 + s^2 / (n prior^2)). The noise is the difference of
    intensity that remains in the window: so weak texture in a clean image has the same weight as strong texture in a
    noisy one, without a threshold of contrast. Without texture the step becomes zero.
    """

    def __init__(
        self,
        first: FloatImage,
        second: FloatImage,
        high: int,
        known: Mask,
        parameters: SubpixelParameters,
    ) -> None:
        self._first, self._second = known_or_zero(first), known_or_zero(second)
        self._slope = cv2.Sobel(self._second, cv2.CV_32F, 1, 0, ksize=1) * np.float32(0.5)
        self._high, self._known, self._parameters = high, known, parameters
        self._mean = gaussian_mean(known, parameters.sigma_px)
        window_px = 4 * np.pi * parameters.sigma_px**2 * parameters.prior_px**2
        self._noise_share = np.float32(parameters.operations.count("step") / window_px)
        self._last: Optional[_Statistics] = None

    def moved(self, disparity: FloatImage) -> FloatImage:
        """Disparities one step nearer to where the intensities of the two neighbourhoods agree best."""
        most = self._parameters.most_step_px
        self._last = _, covariance, power, noise = self._statistics(disparity)
        moved: FloatImage = disparity - np.clip(covariance / (power + self._noise_share * noise), -most, most)
        return moved

    def without_noise(
        self, disparity: FloatImage, parameters: SubpixelParameters, chosen: Optional[DetailParameters] = None
    ) -> FloatImage:
        """Disparities without the detail that is no more than the noise of these images."""
        variance, area_px = self.noise(disparity)
        return without_noise(disparity, variance, area_px, parameters, chosen)

    def noise(self, disparity: FloatImage) -> Tuple[FloatImage, float]:
        """(H, W) variance of the disparities, px^2, and the variance of the Gaussian window that makes white noise
        like theirs, px^2.

        Noise of neighbouring pixels that is alike (of a sensor's optics, of pansharpening, of compression) averages out
        like that of fewer pixels: the differences of the images show how alike it is. They are those before the last
        step, which changes little of them.
        """
        p = self._parameters
        off, _, power, noise = self._last or self._statistics(disparity)
        alike = _correlated_px(off - gaussian_mean(self._known, p.correlation_sigma_px)(off), self._known, p)
        pixels = np.float32(4 * np.pi * p.sigma_px**2 / alike)
        information = pixels * power / noise + np.float32(p.prior_px**-2)
        around = gaussian_mean(self._known, p.variance_sigma_px)
        return around(1 / information), p.sigma_px**2 * alike

    def _statistics(self, disparity: FloatImage) -> _Statistics:
        """(H, W) each: the first image less the second where it was matched; of windows, its covariance with the
        second's slope there, that slope's variance, and its own."""
        columns, rows = matched_positions(disparity, self._high)
        seen, g = side_by_side(
            lambda: cv2.remap(self._second, columns, rows, cv2.INTER_CUBIC),
            lambda: cv2.remap(self._slope, columns, rows, cv2.INTER_LINEAR),
        )
        off = self._first - seen
        mean = self._mean
        mean_g, mean_off, mean_both, power, noise = side_by_side(
            lambda: mean(g), lambda: mean(off), lambda: mean(off * g), lambda: mean(g * g), lambda: mean(off * off)
        )
        covariance, power = mean_both - mean_off * mean_g, power - mean_g * mean_g
        noise = np.maximum(noise - mean_off * mean_off, np.float32(self._parameters.least_noise))
        return off, covariance, power, noise


def _correlated_px(noise: FloatImage, known: Mask, parameters: SubpixelParameters) -> float:
    """How many pixels have noise that counts as one independent value: the sum of its correlations over columns times
    that over rows, 1 for white noise. Differences beyond three standard deviations are no noise."""
    size = np.abs(noise[known])
    usable = known & (np.abs(noise) < 3.0 * NMAD_FACTOR * np.median(size)) if size.size else known
    if not usable.any():
        return 1.0
    values, total = np.where(usable, noise, np.float32(0)), 1.0
    variance = float((values[usable] ** 2).mean())
    for axis in (0, 1):
        reach = 0.0
        for lag in range(1, min(parameters.correlation_lags, values.shape[axis] - 1) + 1):
            late, early = ((slice(None),) * axis + (part,) for part in (slice(lag, None), slice(-lag)))
            both = usable[late] & usable[early]
            if both.any() and variance > 0:
                reach += max(float((values[late] * values[early])[both].mean()) / variance, 0.0)
        total *= 1.0 + 2.0 * reach
    return total


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
