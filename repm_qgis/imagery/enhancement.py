"""Brightness: one stretch for a whole view, so that no tile border shows, and none of the long tail's glare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ImageError
from .raster import opened_masked, read

_SAMPLE_SIDE = 1024
_KNEE = 0.9  # the threshold's place in 0..1: a tenth is left for the tail


@dataclass(frozen=True)
class Stretch:
    """Brightness to 0..1: square roots from ``low`` up to the threshold ``high``, and the long tail above compressed.

    The paper (Section 3.1, image enhancement) sets a brightness threshold and treats what exceeds it. The root makes
    photon noise even over the range; above the threshold, ever brighter pixels approach 1 and never reach it, so
    that white roofs keep their texture.
    """

    low: float
    high: float

    def apply(self, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
        """(height, width) brightness to 0..1; NaN stays NaN."""
        with np.errstate(invalid="ignore"):
            root = np.sqrt(np.maximum((pixels - np.float32(self.low)) / np.float32(self.high - self.low), 0))
            room = np.float32(1.0 - _KNEE)
            return np.where(root > 1, 1 - room * np.exp(np.minimum(1 - root, 0) * (_KNEE / room)), root * _KNEE).astype(
                np.float32
            )


def view_stretch(path: str, band: int, mask: str = "") -> Stretch:
    """The stretch of a whole image of any bit depth, from its overviews or a decimated reading; without masked pixels.

    Raises ImageError where the image holds only nodata or one value.
    """
    with opened_masked(path, mask) as dataset:
        factor = max(1.0, max(dataset.RasterXSize, dataset.RasterYSize) / _SAMPLE_SIDE)
        size = (max(1, int(dataset.RasterXSize / factor)), max(1, int(dataset.RasterYSize / factor)))
        pixels = read(dataset, None, band, size)
    known = pixels[np.isfinite(pixels)]
    if known.size < 100:
        raise ImageError(f"'{path}' has only nodata in band {band}: choose another image, band or mask.")
    low, high = np.percentile(known, (0.1, 99.5))
    if high <= low:
        raise ImageError(
            f"'{path}' has the same value ({low:g}) almost everywhere in band {band}: it shows nothing to match."
        )
    return Stretch(float(low), float(high))
