"""Sampling and means of arrays in which values may be missing (NaN), in numpy alone: light stages have no OpenCV."""

from __future__ import annotations

from functools import reduce
from typing import Callable, List, Tuple, Union

import numpy as np

from ..contracts.arrays import Floats, Mask
from ..geometry.interpolation import bilinear


def sample(image: Floats, cols: Floats, rows: Floats) -> Floats:
    """Bilinear values of an image (height, width) at pixel positions; the first pixel's centre is (0, 0).

    NaN outside the image and wherever one of the four neighbours is NaN.
    """
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        inside = (cols >= 0) & (cols <= width - 1) & (rows >= 0) & (rows <= height - 1)
    zero = cols.dtype.type(0)
    result = bilinear(image, np.where(inside, cols, zero), np.where(inside, rows, zero))
    result[~inside] = np.nan
    return result


def quantile_of_known(stack: Floats, share: Union[float, Floats], least: int = 1) -> Floats:
    """A quantile along the first axis of what is not NaN, the lower of two values; NaN where fewer than ``least``
    values are known. ``share`` (0 to 1) of the others lie below it: one number, or one for each place."""
    count = np.isfinite(stack).sum(axis=0)
    ordered = np.sort(stack, axis=0)  # NaN last
    place = np.floor(share * np.maximum(count - 1, 0)).astype(np.intp)
    found = np.take_along_axis(ordered, place[None], axis=0)[0]
    return np.where(count >= least, found, np.float32(np.nan))


def median_of_known(stack: Floats, least: int = 1) -> Floats:
    """Median along the first axis of what is not NaN, the lower of two middle values; NaN where fewer than ``least``
    values are known."""
    return quantile_of_known(stack, 0.5, least)


def known_or_zero(image: Floats) -> Floats:
    """The image with 0 for NaN."""
    return np.where(np.isnan(image), image.dtype.type(0), image)


def median_of_neighbours(image: Floats, side: int, least: int) -> Floats:
    """:func:`median_of_known` of the square of ``side`` pixels around each pixel."""
    return median_of_known(neighbours(image, side), least)


def neighbours(image: Floats, side: int) -> Floats:
    """(side^2, rows, columns) the square of ``side`` pixels around each pixel; NaN outside the image."""
    rows, columns = image.shape
    padded = np.pad(image, side // 2, constant_values=np.nan)
    return np.stack([padded[i : i + rows, j : j + columns] for i in range(side) for j in range(side)])


def mean_of_known(
    image: Floats, known: Mask, window_mean: Callable[[Floats], Floats], least: float
) -> Tuple[Floats, Floats]:
    """The mean of the known pixels around each pixel, and their share of its window; 0 where there are none.

    ``window_mean`` averages a whole window (cv2.blur, or :func:`box_mean`); shares below ``least`` count as that.
    """
    share = window_mean(known.astype(np.float32))
    total = window_mean(np.where(known, image, np.float32(0)))
    return total / np.maximum(share, np.float32(least)), share


def box_mean(values: Floats, radius: int) -> Floats:
    """Means over squares of (2 radius + 1) pixels of (..., height, width) arrays without NaN, in their own precision.

    At borders the part of the square inside the array counts.
    """
    height, width = values.shape[-2:]
    padded = np.zeros(values.shape[:-2] + (height + 2 * radius, width + 2 * radius), values.dtype)
    padded[..., radius : radius + height, radius : radius + width] = values
    total = _window_sums(_window_sums(padded, radius, columns=False), radius, columns=True)
    rows, columns = (
        np.minimum(place + radius + 1, len(place)) - np.maximum(place - radius, 0)
        for place in (np.arange(height), np.arange(width))
    )
    mean: Floats = total / (rows[:, None] * columns).astype(values.dtype)
    return mean


def _window_sums(part: Floats, radius: int, columns: bool) -> Floats:
    """Sums of 2 radius + 1 neighbours along columns or rows, composed of sums of 1, 2, 4, ... of them."""

    def cut(array: Floats, begin: int, length: int) -> Floats:
        return array[..., begin : begin + length] if columns else array[..., begin : begin + length, :]

    axis, width = -1 if columns else -2, 2 * radius + 1
    size = part.shape[axis] - 2 * radius
    sums: List[Floats] = []
    begin, length = 0, 1
    while True:
        if width & length:
            sums.append(cut(part, begin, size))
            begin += length
        if 2 * length > width:
            return reduce(np.add, sums)
        rest = part.shape[axis] - length
        part = cut(part, 0, rest) + cut(part, length, rest)
        length *= 2
