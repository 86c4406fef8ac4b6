"""Collars and stripes that no nodata value marks: found from an image's ends, and left out by a mask.

Vendors pad images with zeros, and lossy compression makes ones, twos and threes of them; other software pads with
-9999, 65535 or any other value. Where neither a nodata value nor a mask marks them, they count as ground: the altitude
sweep finds false matches there, and the stretch of intensities is distorted.
"""

from __future__ import annotations

import math
import os
from contextlib import suppress
from dataclasses import replace
from typing import Callable, Counter, Iterator, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatImage, Mask, Size, Window
from .parameters import COLLARS, CollarParameters
from .raster import Image, MaskedImage, RasterFrame, created, opened_masked, read


def write_collar_mask(
    image: str,
    band: int,
    mask: str,
    *,
    target: str,
    check: Callable[[], None] = lambda: None,
    parameters: CollarParameters = COLLARS,
    part: Optional[Window] = None,
    told: Callable[[float], None] = lambda fill: None,
) -> float:
    """Write a mask (1 where a pixel is not to be used) of an image's empty ends and of its own ``mask`` ("": none).

    Empty are runs of pixels from the left or right end of a row, or from the top of a column, that the vendor's own
    mask does not hide: black ones, and those of one other value where none in the image is larger, or none smaller.
    Only a ``part`` of the image is looked at (None: the whole); its empty runs count where they continue to the image's
    end. Gives the share of the part that they are; 0 where they are too few to matter, and nothing is written.
    ``check`` is called between parts, and may raise to stop; ``told`` gets the other value.

    Raises ImageError for an image or mask that cannot be read, WorkspaceError where the mask cannot be written.
    """
    with opened_masked(image, mask) as dataset:
        width, height = dataset.RasterXSize, dataset.RasterYSize
        looked_at = _to_near_ends(part, (width, height), parameters.least_px)
        first = read(dataset, Window(looked_at.col, looked_at.row, looked_at.width, 1), band)
        ends = _row_ends(dataset, looked_at, band, parameters)
        parameters = replace(parameters, fill=_fill_of(dataset, looked_at, band, ends, parameters))
        if not _may_have_any(first, ends, parameters):
            return 0.0
        black = 0
        with created(target, RasterFrame((height, width), np.uint8), nodata=None) as raster:
            if part is not None and isinstance(dataset, MaskedImage):
                for row in range(0, height, parameters.strip_rows):  # it holds outside the part, too
                    strip = Window(0, row, width, min(parameters.strip_rows, height - row))
                    raster.write(dataset.excluded(strip).astype(np.uint8), 0, row)
            for row, hidden, found in _strips(dataset, looked_at, band, check, parameters):
                black += int(found.sum())
                raster.write((hidden | found).astype(np.uint8), looked_at.col, row)
    share = float(black / (looked_at.width * looked_at.height))
    if share < parameters.least_share:
        with suppress(OSError):
            os.remove(target)
        return 0.0
    if math.isfinite(parameters.fill):
        told(parameters.fill)
    return share


def _to_near_ends(part: Optional[Window], size: Size, near: int) -> Window:
    """The part, or the whole image; to the image's ends where they are near."""
    if part is None:
        return Window(0, 0, *size)
    low = [0 if value < near else value for value in part[:2]]
    ends = [value + side for value, side in zip(part[:2], part[2:])]
    high = [whole if value > whole - near else value for value, whole in zip(ends, size)]
    return Window.spanning(*low, *high)


def _row_ends(
    dataset: Image, part: Window, band: int, parameters: CollarParameters
) -> List[Tuple[FloatImage, FloatImage]]:
    """(1, n) the left and the right ends of some of the part's rows, evenly spread."""
    side = min(part.width, parameters.end_px)
    rows = np.unique(np.linspace(0, part.height - 1, min(part.height, parameters.looked_at)).astype(int))
    cols = part.col, part.col + part.width - side
    ends = [[read(dataset, Window(col, part.row + int(row), side, 1), band) for col in cols] for row in rows]
    return [(left, right) for left, right in ends]


def _fill_of(
    dataset: Image,
    part: Window,
    band: int,
    ends: Sequence[Tuple[FloatImage, FloatImage]],
    parameters: CollarParameters,
) -> float:
    """The value, other than black, that rows of a part begin or end with and that is an extreme of its values; NaN for
    none."""
    counts: Counter[float] = Counter()
    for left, right in ends:
        for run in (left[0, : parameters.least_px], right[0, -parameters.least_px :]):
            if run.size == parameters.least_px and (run == run[0]).all() and not _is_black(run, parameters).any():
                counts[float(run[0])] += 1
    for value, count in counts.most_common(2):  # one of the two may be a cloud
        if count >= parameters.least_rows:
            size = min(part.width, parameters.looked_at), min(part.height, parameters.looked_at)
            sample = read(dataset, part, band, size, nearest=True)
            known = sample[np.isfinite(sample)]
            above, below = (known > value).mean(), (known < value).mean()
            left, right = _runs(sample == value, 1)
            inside = ((sample == value) & ~left & ~right).mean()  # saturated ground lies there, too
            sure = inside <= parameters.beyond_share or count >= parameters.sure_share * 2 * len(ends)
            if sure and above + below and min(above, below) <= parameters.beyond_share:  # neither: without content
                return value
    return math.nan


def _may_have_any(
    first: FloatImage, ends: Sequence[Tuple[FloatImage, FloatImage]], parameters: CollarParameters
) -> bool:
    """Whether some of a part's rows begin or end black, or its first row is: nearly all images have none, and cost no
    more than this."""
    least = parameters.least_px
    if _is_black(first, parameters).sum() >= least:
        return True
    for sides in ends:
        for side, values in enumerate(sides):
            run = _runs(_dark(values, parameters), least)[side]
            if (_is_black(values, parameters) & run).sum() >= least:
                return True
    return False


def _strips(
    dataset: Image, part: Window, band: int, check: Callable[[], None], parameters: CollarParameters
) -> Iterator[Tuple[int, Mask, Mask]]:
    """The first row of each strip of a part, what is hidden there already, and what is black from an image's end."""
    above = Window(part.col, 0, part.width, part.row)
    top = read(dataset, Window(part.col, part.row, part.width, 1), band)
    # Columns that are black, or hidden, from the image's top down to here.
    falling = _black_throughout(
        dataset, above, 0, among=_dark(top, parameters)[0], band=band, check=check, parameters=parameters
    )
    end_row, end_col = part.row + part.height, part.col + part.width
    for row in range(part.row, end_row, parameters.strip_rows):
        check()
        count = min(parameters.strip_rows, end_row - row)
        values = read(dataset, Window(part.col, row, part.width, count), band)
        hidden, dark = ~np.isfinite(values), _dark(values, parameters)
        left, right = _runs(dark, parameters.least_px)
        for run, edge, col, stop in ((left, 0, 0, part.col), (right, -1, end_col, dataset.RasterXSize)):
            outside = Window(col, row, stop - col, count)
            run &= _black_throughout(
                dataset, outside, 1, among=run[:, edge], band=band, check=check, parameters=parameters
            )[:, None]
        down = np.logical_and.accumulate(np.vstack([falling, dark]), axis=0)[1:]
        if row == 0 and count >= parameters.least_px:
            down &= down[parameters.least_px - 1]  # columns whose black ends sooner are dark ground
        falling = down[-1]
        yield row, hidden, (left | right | down) & dark & ~hidden


def _black_throughout(
    dataset: Image,
    window: Window,
    axis: int,
    *,
    among: Mask,
    band: int,
    check: Callable[[], None],
    parameters: CollarParameters,
) -> Mask:
    """(n,) which ``among`` the columns (axis 0) or rows (axis 1) of a window are black or hidden all along.

    It is read in blocks, and no further than any of them is; all are where the window is empty.
    """
    found, along = among.copy(), (window.row, window.col)[axis]
    end, step = along + (window.height, window.width)[axis], parameters.strip_rows
    for start in range(along, end, step):
        if not found.any():
            break
        check()
        count = min(step, end - start)
        block = window._replace(row=start, height=count) if axis == 0 else window._replace(col=start, width=count)
        found &= _dark(read(dataset, block, band), parameters).all(axis=axis)
    return found


def _dark(values: FloatImage, parameters: CollarParameters) -> Mask:
    """What is black or hidden."""
    return _is_black(values, parameters) | ~np.isfinite(values)


def _is_black(values: FloatImage, parameters: CollarParameters) -> Mask:
    """Zeros, in whole numbers what lossy compression makes of them, and what else fills the image's ends."""
    whole = bool((values[np.isfinite(values)] % 1 == 0).all())
    with np.errstate(invalid="ignore"):
        return np.asarray((values <= (parameters.black if whole else 0.0)) | (values == parameters.fill))


def _runs(black: Mask, least: int) -> Tuple[Mask, Mask]:
    """(rows, columns) what is black from the left end of its row without a break, and from the right end; rows whose
    run is shorter than ``least`` have none."""
    left = np.logical_and.accumulate(black, axis=1)
    right = np.logical_and.accumulate(black[:, ::-1], axis=1)[:, ::-1]
    return left & (left.sum(axis=1) >= least)[:, None], right & (right.sum(axis=1) >= least)[:, None]
