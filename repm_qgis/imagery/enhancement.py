"""The stretch of intensities: one for a whole view, so that tiles have no visible borders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatImage
from ..errors import ImageError
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


def view_stretch(path: str, band: int, mask: str = "", parameters: StretchParameters = STRETCH) -> Stretch:
    """The stretch of a whole image of any bit depth, from its overviews or a reduced reading; without masked pixels.

    Raises ImageError where the image holds only nodata or one value.
    """
    with opened_masked(path, mask) as dataset:
        factor = max(1.0, max(dataset.RasterXSize, dataset.RasterYSize) / parameters.sample_px)
        size = (max(1, int(dataset.RasterXSize / factor)), max(1, int(dataset.RasterYSize / factor)))
        pixels = read(dataset, None, band, size)
    known = pixels[np.isfinite(pixels)]
    if known.size < parameters.least_pixels:
        raise ImageError(f"'{path}' has only nodata in band {band}: choose another image, band or mask.")
    low, high = np.percentile(known, (parameters.low_percent, parameters.high_percent))
    if high <= low:
        nearly = f"has the same value ({low:g}) almost everywhere in band {band}"
        raise ImageError(f"'{path}' {nearly}: it shows nothing to match.")
    return Stretch(float(low), float(high), parameters.knee)
