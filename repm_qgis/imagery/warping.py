"""Resampling an image through a map of pixels, by window and in strips: memory does not grow with the image."""

from __future__ import annotations

from typing import Callable, Iterator, Optional, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray
from osgeo import gdal

from ..arrays import FloatArray, Size, Window
from ..errors import ImageError
from ..geometry.interpolation import interpolate_steps
from .raster import read

PixelMap = Callable[[FloatArray], FloatArray]

GRID_STEP = 16  # px between exact points of the map; what lies between is interpolated
_STRIP = 512  # rows a pass
_BLOCK = 1024  # columns a pass, whole grid steps
_MAX_SIDE = 32000  # OpenCV's remap counts source pixels in 16 bits

KERNELS = {"bilinear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC, "lanczos": cv2.INTER_LANCZOS4}
_REACH = {"bilinear": 1, "cubic": 2, "lanczos": 4}  # pixels on either side that a kernel touches


def source_positions(to_source: PixelMap, size: Size, first_row: int = 0, rows: Optional[int] = None) -> FloatArray:
    """(rows, width, 2) source positions of all pixels of an image of ``size`` (width, height).

    The map is evaluated on a grid of 16 px and interpolated bilinearly: the maps here are so smooth (homographies
    and low polynomials over a tile) that this costs less than 1e-3 px.
    """
    rows = size[1] - first_row if rows is None else rows
    nodes = _nodes(to_source, size[0], first_row, rows)
    return np.stack([interpolate_steps(nodes[..., axis], (rows, size[0]), GRID_STEP) for axis in (0, 1)], axis=-1)


def _nodes(to_source: PixelMap, width: int, first_row: int, rows: int) -> FloatArray:
    """(m, n, 2) exact source positions every 16 px, the last nodes at or beyond the last pixel."""
    x = np.arange(0, width + GRID_STEP, GRID_STEP, dtype=np.float64)
    y = np.arange(first_row, first_row + rows + GRID_STEP, GRID_STEP, dtype=np.float64)
    return to_source(np.stack(np.meshgrid(x, y), axis=-1))


def warp(
    dataset: gdal.Dataset, band: int, to_source: PixelMap, size: Size, kernel: str = "bilinear"
) -> NDArray[np.float32]:
    """Resample an image: pixel p of the result takes the source's value at ``to_source(p)``.

    Returns (height, width) float32; NaN where the source has nodata or ends. Nodata never bleeds: a pixel whose
    kernel touches it is NaN.
    """
    width, height = size
    result = np.full((height, width), np.nan, dtype=np.float32)
    for row, strip in warp_strips(dataset, band, to_source, size, kernel):
        result[row : row + len(strip)] = strip
    return result


def warp_strips(
    dataset: gdal.Dataset, band: int, to_source: PixelMap, size: Size, kernel: str = "bilinear"
) -> Iterator[Tuple[int, NDArray[np.float32]]]:
    """:func:`warp` by strips of rows, for images that do not fit into memory: first row and pixels of each."""
    width, height = size
    for row in range(0, height, _STRIP):
        rows = min(_STRIP, height - row)
        yield row, _warp_strip(dataset, band, _nodes(to_source, width, row, rows), (rows, width), kernel)


def _warp_strip(
    dataset: gdal.Dataset, band: int, nodes: FloatArray, shape: Tuple[int, int], kernel: str
) -> NDArray[np.float32]:
    """One strip, in blocks of columns: each block reads only what its own nodes span."""
    result = np.full(shape, np.nan, dtype=np.float32)
    for col in range(0, shape[1], _BLOCK):
        columns = min(_BLOCK, shape[1] - col)
        own = nodes[:, col // GRID_STEP : -(-(col + columns) // GRID_STEP) + 1]
        window = _window(dataset, own, kernel)
        if window is None:
            continue
        # In the window's own pixels float32 is good to 1e-4 px, and half the work.
        local = (own - window[:2]).astype(np.float32)
        u, v = (interpolate_steps(local[..., axis], (shape[0], columns), GRID_STEP) for axis in (0, 1))
        result[:, col : col + columns] = _remapped(read(dataset, window, band), u, v, kernel)
    return result


def _window(dataset: gdal.Dataset, positions: FloatArray, kernel: str) -> Optional[Window]:
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
            f"'{dataset.GetDescription()}': its RPC does not fit its pixels; is it another image's?"
        )
    return Window.spanning(int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def sample_source(dataset: gdal.Dataset, band: int, positions: FloatArray, kernel: str) -> NDArray[np.float32]:
    """Values of an image at (rows, columns, 2) positions; only the window that they span is read."""
    inside = np.where(
        ((positions > -1) & (positions < (dataset.RasterXSize, dataset.RasterYSize))).all(axis=-1, keepdims=True),
        positions,
        np.nan,
    )
    window = _window(dataset, inside, kernel)
    if window is None:
        return np.full(positions.shape[:2], np.nan, dtype=np.float32)
    return sample_array(read(dataset, window, band), positions - window[:2], kernel)


def sample_array(source: NDArray[np.float32], positions: FloatArray, kernel: str) -> NDArray[np.float32]:
    """Values of an array (height, width) at (rows, columns, 2) positions; NaN outside and beside NaN."""
    return _remapped(source, positions[..., 0].astype(np.float32), positions[..., 1].astype(np.float32), kernel)


def _remapped(
    source: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32], kernel: str
) -> NDArray[np.float32]:
    flags = KERNELS[kernel]
    missing = ~np.isfinite(source)
    if not missing.any():
        return cv2.remap(source, u, v, flags, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    filled = np.where(missing, np.float32(0), source)
    values = cv2.remap(filled, u, v, flags, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    side = 2 * _REACH[kernel] - 1
    touched = cv2.dilate(missing.astype(np.uint8), np.ones((side, side), np.uint8))
    near = cv2.remap(touched.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=1)
    values[near > 0] = np.nan
    return values
