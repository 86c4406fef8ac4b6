"""Brightness: one stretch for a whole view, so that no tile border shows, and none of the long tail's glare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ImageError
from .raster import opened, read

_SAMPLE_SIDE = 1024


@dataclass(frozen=True)
class Stretch:
    """Brightness of ``low`` and below becomes 0, of ``high`` and above 1, square roots between.

    The root compresses the long tail (paper, Section 3.1, image enhancement) and makes photon noise even.
    """

    low: float
    high: float

    def apply(self, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
        """(height, width) brightness to 0..1; NaN stays NaN."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.clip((pixels - np.float32(self.low)) / np.float32(self.high - self.low), 0, 1))


def view_stretch(path: str, band: int) -> Stretch:
    """The stretch of a whole image, from its overviews or a decimated reading.

    Raises ImageError where the image holds only nodata or one value.
    """
    with opened(path) as dataset:
        factor = max(1.0, max(dataset.RasterXSize, dataset.RasterYSize) / _SAMPLE_SIDE)
        size = (max(1, int(dataset.RasterXSize / factor)), max(1, int(dataset.RasterYSize / factor)))
        pixels = read(dataset, None, band, size)
    known = pixels[np.isfinite(pixels)]
    if known.size < 100:
        raise ImageError(f"'{path}' has only nodata in band {band}: choose another image or band.")
    low, high = np.percentile(known, (0.1, 99.5))
    if high <= low:
        raise ImageError(f"'{path}' has the same value ({low:g}) almost everywhere in band {band}: it shows nothing to "
                         "match.")
    return Stretch(float(low), float(high))
