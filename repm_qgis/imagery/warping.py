"""Resampling an image through a map of pixels, by window and in strips: memory does not grow with the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Iterator, Optional, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Mask, Size, Window
from ..contracts.errors import ImageError
from ..geometry.interpolation import interpolate_steps
from .parameters import SAMPLING, WARPING
from .raster import Image, read

PixelMap = Callable[[FloatArray], FloatArray]

_NARROWEST = 1.5  # sigma of a Gaussian in a reduced image, in its pixels
_MAX_SIDE = 32000  # OpenCV's remap counts source pixels in 16 bits

KERNELS = {"bilinear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC, "lanczos": cv2.INTER_LANCZOS4}
_REACH = {"bilinear": 1, "cubic": 2, "lanczos": 4}  # pixels on either side that a kernel touches


def box_filter(side: int, border: int = cv2.BORDER_REFLECT) -> Callable[[FloatImage], FloatImage]:
    """A function that gives the means of squares of ``side`` px; ``border`` is how OpenCV continues the image."""
    return lambda image: cv2.blur(image, (side, side), borderType=border)


def gaussian_mean(known: Mask, sigma_px: float) -> Callable[[FloatImage], FloatImage]:
    """A function that takes an image to the means of its known pixels in a Gaussian window.

    Wide means are smooth, so that they are made of a reduced image: the means of squares, their Gaussian, and the
    linear interpolation together have the variance of the requested window.
    """
    weight = known.astype(np.float32)
    factor = 1
    while factor * 2.0 * _NARROWEST <= sigma_px and factor * 4 <= min(known.shape):
        factor *= 2
    size = known.shape[::-1]
    reduced = tuple(-(-side // factor) for side in size)
    sigma = math.sqrt((sigma_px / factor) ** 2 - (0.25 if factor > 1 else 0.0))

    def smooth(image: FloatImage) -> FloatImage:
        small = cv2.resize(image, reduced, interpolation=cv2.INTER_AREA) if factor > 1 else image
        blurred: FloatImage = cv2.GaussianBlur(small, (0, 0), sigma)
        return cv2.resize(blurred, size, interpolation=cv2.INTER_LINEAR) if factor > 1 else blurred

    share = smooth(weight) + np.float32(1e-6)
    return lambda image: smooth(image * weight) / share


def source_positions(to_source: PixelMap, size: Size) -> FloatArray:
    """(height, width, 2) source positions of all pixels of an image of ``size`` (width, height).

    The map is evaluated at nodes and interpolated bilinearly: the maps here are smooth (homographies and low
    polynomials over a tile).
    """
    nodes = _nodes(to_source, size[0], 0, size[1])
    return np.stack([interpolate_steps(nodes[..., k], size[::-1], WARPING.node_step_px) for k in (0, 1)], axis=-1)


def _nodes(to_source: PixelMap, width: int, first_row: int, rows: int) -> FloatArray:
    """(m, n, 2) exact source positions on nodes, the last ones at or beyond the last pixel."""
    step = WARPING.node_step_px
    x = np.arange(0, width + step, step, dtype=np.float64)
    y = np.arange(first_row, first_row + rows + step, step, dtype=np.float64)
    return to_source(np.stack(np.meshgrid(x, y), axis=-1))


def warp(dataset: Image, band: int, to_source: PixelMap, size: Size, kernel: str = "bilinear") -> FloatImage:
    """Resample an image: pixel p of the result takes the source's value at ``to_source(p)``.

    Returns (height, width) float32; NaN beyond the centres of the source's outermost pixels, and where the kernel
    touches nodata.
    """
    result = np.full(size[::-1], np.nan, dtype=np.float32)
    for row, strip in warp_strips(dataset, band, to_source, size, kernel):
        result[row : row + len(strip)] = strip
    return result


@dataclass(frozen=True)
class SourcePixels:
    """The part of an image that a map of pixels spans, read once for all that is sampled from it.

    ``pixels`` (height, width) begin at the pixel ``origin`` (column, row) of the image; each stands for ``factor`` px.
    """

    pixels: FloatImage
    origin: Tuple[int, int]
    factor: int = 1

    def sampled(self, to_source: PixelMap, size: Size, kernel: str) -> FloatImage:
        """What :func:`warp` gives, of these pixels."""
        width, height = size
        nodes = (_nodes(to_source, width, 0, height) - self.origin + 0.5) / self.factor - 0.5
        u, v = (
            interpolate_steps(nodes[..., k].astype(np.float32), (height, width), WARPING.node_step_px) for k in (0, 1)
        )
        return _remapped(self.pixels, u, v, kernel)

    def reduced(self, factor: int) -> SourcePixels:
        """Means of ``factor`` x ``factor`` px; NaN where one of them is, and incomplete ones at the ends dropped."""
        return SourcePixels(reduced(self.pixels, factor), self.origin, self.factor * factor)


def reduced(image: FloatImage, factor: int) -> FloatImage:
    """Means over ``factor`` x ``factor`` px; NaN where one of them is, and incomplete ones at the ends dropped."""
    height, width = (n // factor for n in image.shape)
    whole = image[: height * factor, : width * factor]
    if not whole.size:
        return np.full((1, 1), np.nan, dtype=np.float32)
    small: FloatImage = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    return small


def coarsened(image: FloatImage, ratio: float) -> FloatImage:
    """An image that can be sampled at steps of ``ratio`` px without aliasing; NaN stays NaN, and 1 changes nothing."""
    if ratio <= 1.0:
        return image
    known = np.isfinite(image)
    sigma = SAMPLING.blur * math.sqrt(ratio**2 - 1.0)
    if known.all():
        blurred: FloatImage = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return blurred
    smooth = gaussian_mean(known, sigma)(np.where(known, image, np.float32(0)))
    return np.where(known, smooth, np.float32(np.nan)).astype(np.float32)


def warp_coarsened(dataset: Image, band: int, to_source: PixelMap, size: Size, kernel: str, ratio: float) -> FloatImage:
    """:func:`warp` of an image that is finer than the result by a ratio, as :func:`coarsened` makes it; a ratio of 1
    changes nothing."""
    if ratio <= 1.0:
        return warp(dataset, band, to_source, size, kernel)
    source = source_pixels(dataset, band, to_source, size, lambda pixels: coarsened(pixels, ratio))
    return source.sampled(to_source, size, kernel)


def source_pixels(
    dataset: Image, band: int, to_source: PixelMap, size: Size, change: Callable[[FloatImage], FloatImage]
) -> SourcePixels:
    """The pixels of an image that all pixels of a result of ``size`` (width, height) are sampled from, after a
    ``change`` of their values, such as a stretch."""
    window = _window(dataset, _nodes(to_source, size[0], 0, size[1]), "lanczos")
    if window is None:
        return SourcePixels(np.full((1, 1), np.nan, dtype=np.float32), (0, 0))
    return SourcePixels(change(read(dataset, window, band)), (window[0], window[1]))


def warp_strips(
    dataset: Image, band: int, to_source: PixelMap, size: Size, kernel: str = "bilinear"
) -> Iterator[Tuple[int, FloatImage]]:
    """:func:`warp` by strips of rows, for images that do not fit into memory: first row and pixels of each."""
    width, height = size
    for row in range(0, height, WARPING.strip_rows):
        rows = min(WARPING.strip_rows, height - row)
        yield row, _warp_strip(dataset, band, _nodes(to_source, width, row, rows), (rows, width), kernel)


def _warp_strip(dataset: Image, band: int, nodes: FloatArray, shape: Tuple[int, int], kernel: str) -> FloatImage:
    """One strip, in blocks of columns: each block reads only what its own nodes span."""
    result = np.full(shape, np.nan, dtype=np.float32)
    step = WARPING.node_step_px
    for col in range(0, shape[1], WARPING.block_columns):
        columns = min(WARPING.block_columns, shape[1] - col)
        own = nodes[:, col // step : -(-(col + columns) // step) + 1]
        window = _window(dataset, own, kernel)
        if window is None:
            continue
        # Relative to the window, float32 is exact to 1e-4 px, and half the work.
        local = (own - window[:2]).astype(np.float32)
        u, v = (interpolate_steps(local[..., axis], (shape[0], columns), step) for axis in (0, 1))
        result[:, col : col + columns] = _remapped(read(dataset, window, band), u, v, kernel)
    return result


def _window(dataset: Image, positions: FloatArray, kernel: str) -> Optional[Window]:
    """The window of an image that positions span, with the kernel's reach; None where they miss it."""
    known = np.isfinite(positions).all(axis=-1)
    if not known.any():
        return None
    within = positions[known]
    reach = _REACH[kernel] + 1
    low = np.maximum(np.floor(within.min(axis=0)).astype(int) - reach, 0)
    high = np.minimum(np.ceil(within.max(axis=0)).astype(int) + reach + 1, (dataset.RasterXSize, dataset.RasterYSize))
    if (high <= low).any():
        return None
    if (high - low > _MAX_SIDE).any():
        raise ImageError(
            f"A block of the refined image spans {high[0] - low[0]} x {high[1] - low[1]} px of "
            f"'{dataset.GetDescription()}': its RPC does not fit its pixels. Is it the RPC of another image?"
        )
    return Window.spanning(int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def sample_source(dataset: Image, band: int, positions: FloatArray, kernel: str) -> FloatImage:
    """Values of an image at (rows, columns, 2) positions; only the window that they span is read."""
    inside = ((positions > -1) & (positions < (dataset.RasterXSize, dataset.RasterYSize))).all(axis=-1, keepdims=True)
    window = _window(dataset, np.where(inside, positions, np.nan), kernel)
    if window is None:
        return np.full(positions.shape[:2], np.nan, dtype=np.float32)
    return sample_array(read(dataset, window, band), positions - window[:2], kernel)


def sample_array(source: FloatImage, positions: FloatArray, kernel: str) -> FloatImage:
    """Values of an array (height, width) at (rows, columns, 2) positions; NaN beyond the outermost pixels' centres,
    and next to NaN."""
    return _remapped(source, positions[..., 0].astype(np.float32), positions[..., 1].astype(np.float32), kernel)


def _remapped(source: FloatImage, u: FloatImage, v: FloatImage, kernel: str) -> FloatImage:
    """Values between the centres of the outermost pixels: kernels that reach beyond find these pixels again there."""
    height, width = source.shape
    missing = ~np.isfinite(source)
    filled = np.where(missing, np.float32(0), source) if missing.any() else source
    values: FloatImage = cv2.remap(filled, u, v, KERNELS[kernel], borderMode=cv2.BORDER_REPLICATE)
    values[~((u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1))] = np.nan
    if filled is source:
        return values
    side = 2 * _REACH[kernel] - 1
    touched = cv2.dilate(missing.astype(np.uint8), np.ones((side, side), np.uint8))
    near = cv2.remap(touched.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values[near > 0] = np.nan
    return values
