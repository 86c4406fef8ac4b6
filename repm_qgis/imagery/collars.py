"""Black collars and stripes that no nodata value marks: found from an image's ends, and left out by a mask.

Vendors pad images with zeros, and lossy compression makes ones, twos and threes of them. Where neither a nodata value
nor a mask says so, they are ground as black as night: the altitude sweep finds false matches there, and brightness is
stretched to them.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import Callable, Iterator, Tuple

import numpy as np

from ..arrays import FloatImage, Mask, Window
from .parameters import COLLARS, CollarParameters
from .raster import Image, created, opened_masked, read


def write_collar_mask(
    image: str,
    band: int,
    mask: str,
    target: str,
    check: Callable[[], None] = lambda: None,
    parameters: CollarParameters = COLLARS,
) -> float:
    """Write a mask (1 where a pixel is not to be used) of an image's black ends and of its own ``mask`` ("": none).

    Black are runs of pixels from the left or right end of a row, or from the top of a column, that the vendor's own
    mask does not hide. Gives the share of the image that they are; 0 where they are too few to matter, and nothing is
    written. ``check`` is called between parts, and may raise to stop.

    Raises ImageError for an image or mask that cannot be read, WorkspaceError where the mask cannot be written.
    """
    with opened_masked(image, mask) as dataset:
        if not _may_have_any(dataset, band, parameters):
            return 0.0
        width, height = dataset.RasterXSize, dataset.RasterYSize
        black = 0
        with created(target, (height, width), np.dtype(np.uint8), 1, None, "", nodata=None) as raster:
            for row, hidden, found in _strips(dataset, band, check, parameters):
                black += int(found.sum())
                raster.write((hidden | found).astype(np.uint8), 0, row)
    share = float(black / (width * height))
    if share < parameters.least_share:
        with suppress(OSError):
            os.remove(target)
        return 0.0
    return share


def _may_have_any(dataset: Image, band: int, parameters: CollarParameters) -> bool:
    """Whether some of the image's rows begin or end black: nearly all images have none, and cost no more than this."""
    width, height = dataset.RasterXSize, dataset.RasterYSize
    side, least = min(width, parameters.end_px), parameters.least_px
    if _is_black(read(dataset, Window(0, 0, width, 1), band), parameters).sum() >= least:
        return True
    for row in np.unique(np.linspace(0, height - 1, min(height, parameters.looked_at)).astype(int)):
        for col in (0, width - side):
            values = read(dataset, Window(col, int(row), side, 1), band)
            black = _is_black(values, parameters)
            left, right = _runs(black | ~np.isfinite(values), least)
            if (black & (right if col else left)).sum() >= least:
                return True
    return False


def _strips(
    dataset: Image, band: int, check: Callable[[], None], parameters: CollarParameters
) -> Iterator[Tuple[int, Mask, Mask]]:
    """The first row of each strip, what is hidden already, and what is black from an end."""
    width, height = dataset.RasterXSize, dataset.RasterYSize
    falling = np.ones(width, dtype=bool)  # columns that are black, or hidden, from the top down to here
    first = True
    for row in range(0, height, parameters.strip_rows):
        check()
        count = min(parameters.strip_rows, height - row)
        values = read(dataset, Window(0, row, width, count), band)
        hidden = ~np.isfinite(values)
        black = _is_black(values, parameters)
        left, right = _runs(black | hidden, parameters.least_px)
        down = np.logical_and.accumulate(np.vstack([falling, black | hidden]), axis=0)[1:]
        if first and count >= parameters.least_px:
            down &= down[parameters.least_px - 1]  # columns whose black ends sooner are dark ground
        falling, first = down[-1], False
        yield row, hidden, (left | right | down) & black


def _is_black(values: FloatImage, parameters: CollarParameters) -> Mask:
    """Zeros, and in whole numbers what lossy compression makes of them."""
    whole = bool((values[np.isfinite(values)] % 1 == 0).all())
    with np.errstate(invalid="ignore"):
        return np.asarray(values <= (parameters.black if whole else 0.0))


def _runs(black: Mask, least: int) -> Tuple[Mask, Mask]:
    """(rows, columns) what is black from the left end of its row without a break, and from the right end; rows whose
    run is shorter than ``least`` have none."""
    left = np.logical_and.accumulate(black, axis=1)
    right = np.logical_and.accumulate(black[:, ::-1], axis=1)[:, ::-1]
    return left & (left.sum(axis=1) >= least)[:, None], right & (right.sum(axis=1) >= least)[:, None]
