"""The stretch of intensities: one for all tiles of a view, so that they have no visible borders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from ..contracts.arrays import FloatImage, Window
from ..contracts.errors import ImageError
from .parameters import STRETCH, StretchParameters
from .raster import opened_masked, read


@dataclass(frozen=True)
class Stretch:
    """Intensities to 0..1: square roots from ``low`` to the threshold ``high``, and the long tail above compressed.

    The paper (Section 3.1, image enhancement) sets a threshold of brightness and compresses what exceeds it. The root
    makes photon noise even over the range; above the threshold, brighter pixels approach 1 and never reach it, so that
    white roofs keep their texture. ``knee`` is the value of the threshold.
    """

    low: float
    high: float
    knee: float = STRETCH.knee

    def apply(self, pixels: FloatImage) -> FloatImage:
        """(height, width) intensities to 0..1; NaN stays NaN."""
        room = np.float32(1.0 - self.knee)
        with np.errstate(invalid="ignore"):
            root = np.sqrt(np.maximum((pixels - np.float32(self.low)) / np.float32(self.high - self.low), 0))
            tail = 1 - room * np.exp(np.minimum(1 - root, 0) * (self.knee / room))
            return np.where(root > 1, tail, root * self.knee).astype(np.float32)


def view_stretch(
    path: str, band: int, mask: str = "", parameters: StretchParameters = STRETCH, part: Optional[Window] = None
) -> Stretch:
    """The stretch of an image of any bit depth, from a reduced reading of its pixels that are not masked.

    ``part`` is the window that is used of the image, where it is not the whole: pixels outside do not count, unless the
    window itself shows nothing. Raises ImageError where the image holds only nodata or one value.
    """
    known, (low, high) = _sampled(path, band, mask, part, parameters)
    if part is not None and high <= low:
        known, (low, high) = _sampled(path, band, mask, None, parameters)
    if known < parameters.least_pixels:
        raise ImageError(f"'{path}' has only nodata in band {band}: choose another image, band or mask.")
    if high <= low:
        nearly = f"has the same value ({low:g}) almost everywhere in band {band}"
        raise ImageError(f"'{path}' {nearly}: it shows nothing to match.")
    return Stretch(float(low), float(high), parameters.knee)


def _sampled(
    path: str, band: int, mask: str, part: Optional[Window], parameters: StretchParameters
) -> Tuple[int, Tuple[float, float]]:
    """How many pixels of a reduced part (None: of the whole) have a value, and the ends of the stretch; (0, 0) where
    they are too few."""
    with opened_masked(path, mask) as dataset:
        width, height = part[2:] if part else (dataset.RasterXSize, dataset.RasterYSize)
    factor = max(1.0, max(width, height) / parameters.sample_px)
    with opened_masked(path, mask, overviews=width * height > parameters.overviews_px) as dataset:
        pixels = read(dataset, part, band, (max(1, int(width / factor)), max(1, int(height / factor))))
    known = pixels[np.isfinite(pixels)]
    if known.size < parameters.least_pixels:
        return known.size, (0.0, 0.0)
    low, high = np.percentile(known, (parameters.low_percent, parameters.high_percent))
    return known.size, (low, high)
