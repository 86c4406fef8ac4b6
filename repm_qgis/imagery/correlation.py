"""Normalised cross-correlation of windows of two images that may have gaps, in numpy alone."""

from __future__ import annotations

from typing import Callable, NamedTuple

import numpy as np

from ..contracts.arrays import FloatImage, Mask

_LEAST_POWER = 1e-12  # product of two variances of intensities 0..1: below the noise of a sensor of 12 bits


class WindowStatistics(NamedTuple):
    """Moments of two images over the known pixels of each pixel's window, and the ``share`` of these pixels."""

    share: FloatImage
    mean_a: FloatImage
    mean_b: FloatImage
    variance_a: FloatImage
    variance_b: FloatImage
    covariance: FloatImage

    def correlation(self) -> FloatImage:
        """-1..1; about 0 where an image has no contrast, and without meaning where no pixel is known."""
        power = np.maximum(self.variance_a * self.variance_b, np.float32(_LEAST_POWER))
        found: FloatImage = self.covariance / np.sqrt(power)
        return found


def window_statistics(
    a: FloatImage, b: FloatImage, known: Mask, window_mean: Callable[[FloatImage], FloatImage]
) -> WindowStatistics:
    """The moments of two images of one shape where ``known``; ``window_mean`` averages a whole window.

    Sums of squares are in the images' precision: in single precision, intensities should be 0..1 or have no mean.
    """
    a, b = np.where(known, a, np.float32(0)), np.where(known, b, np.float32(0))
    share = window_mean(known.astype(np.float32))
    safe = np.maximum(share, np.float32(1e-6))
    mean_a, mean_b = window_mean(a) / safe, window_mean(b) / safe
    variance_a, variance_b = window_mean(a * a) / safe - mean_a * mean_a, window_mean(b * b) / safe - mean_b * mean_b
    return WindowStatistics(share, mean_a, mean_b, variance_a, variance_b, window_mean(a * b) / safe - mean_a * mean_b)
