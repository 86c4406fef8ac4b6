"""A part of an image as a picture on the screen."""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import FloatArray, Size, Window
from .raster import opened_image, read

_ENDS_PERCENT = (0.5, 99.5)  # of the window's own values: the contrast of what is shown


def window_picture(
    path: str, band: int, centre: FloatArray, scale: float, size: Size
) -> Optional[Tuple[NDArray[np.uint8], Window]]:
    """The part of an image that a screen of ``size`` (width, height) shows at ``scale`` screen px for each image px.

    ``centre`` (2,) is the pixel in the screen's middle, ``band`` as :func:`read` takes it. Gives (height, width) grey
    values, reduced where ``scale`` is below 1, and the window of the image that they cover; None where the screen shows
    no part of the image. Raises ImageError.
    """
    with opened_image(path) as dataset:
        half, sides = np.array(size) / (2.0 * scale) + 1.0, (dataset.RasterXSize, dataset.RasterYSize)
        low = np.maximum(np.floor(centre - half), 0).astype(int)
        high = np.minimum(np.ceil(centre + half) + 1, sides).astype(int)
        if (high <= low).any():
            return None
        window = Window.spanning(*map(int, (*low, *high)))
        reduced = None
        if scale < 1.0:
            reduced = (max(1, math.ceil(window.width * scale)), max(1, math.ceil(window.height * scale)))
        values = read(dataset, window, band, reduced)
    known = values[np.isfinite(values)]
    first, last = np.percentile(known, _ENDS_PERCENT) if known.size else (0.0, 1.0)
    grey = np.clip((np.nan_to_num(values, nan=first) - first) / max(last - first, 1e-6), 0.0, 1.0)
    return np.ascontiguousarray((255.0 * grey).astype(np.uint8)), window
