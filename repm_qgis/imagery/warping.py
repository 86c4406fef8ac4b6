"""Resampling an image through a map of pixels, by window and in strips: memory does not grow with the image."""

from __future__ import annotations

from typing import Callable, Iterator, Optional, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray
from osgeo import gdal

from .raster import read
from .sampling import upsample_grid

FloatArray = NDArray[np.float64]
PixelMap = Callable[[FloatArray], FloatArray]

_GRID_STEP = 16     # px between exact points of the map; what lies between is interpolated
_STRIP = 512        # rows a pass
_MAX_SIDE = 32000   # OpenCV's remap counts source pixels in 16 bits

KERNELS = {"bilinear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC, "lanczos": cv2.INTER_LANCZOS4}


def source_positions(to_source: PixelMap, size: Tuple[int, int], first_row: int = 0,
                     rows: Optional[int] = None) -> FloatArray:
    """(rows, width, 2) source positions of all pixels of an image of ``size`` (width, height).

    The map is evaluated on a grid of 16 px and interpolated bilinearly: the maps here are so smooth (homographies
    and low polynomials over a tile) that this costs less than 1e-3 px.
    """
    width, height = size
    rows = height - first_row if rows is None else rows
    nodes_x = max(2, -(-(width - 1) // _GRID_STEP) + 1)
    nodes_y = max(2, -(-(rows - 1) // _GRID_STEP) + 1)
    x = np.linspace(0, max(width - 1, 1), nodes_x)
    y = np.linspace(first_row, first_row + max(rows - 1, 1), nodes_y)
    coarse = to_source(np.stack(np.meshgrid(x, y), axis=-1))
    return upsample_grid(coarse, (rows, width))


def warp(dataset: gdal.Dataset, band: int, to_source: PixelMap, size: Tuple[int, int],
         kernel: str = "bilinear") -> NDArray[np.float32]:
    """Resample an image: pixel p of the result takes the source's value at ``to_source(p)``.

    Returns (height, width) float32; NaN where the source has nodata or ends. Nodata never bleeds: a pixel whose
    kernel touches it is NaN.
    """
    width, height = size
    result = np.full((height, width), np.nan, dtype=np.float32)
    for row, strip in warp_strips(dataset, band, to_source, size, kernel):
        result[row:row + len(strip)] = strip
    return result


def warp_strips(dataset: gdal.Dataset, band: int, to_source: PixelMap, size: Tuple[int, int],
                kernel: str = "bilinear") -> Iterator[Tuple[int, NDArray[np.float32]]]:
    """:func:`warp` by strips of rows, for images that do not fit into memory: first row and pixels of each."""
    width, height = size
    for row in range(0, height, _STRIP):
        rows = min(_STRIP, height - row)
        yield row, sample_source(dataset, band, source_positions(to_source, size, row, rows), kernel)


def sample_source(dataset: gdal.Dataset, band: int, positions: FloatArray, kernel: str) -> NDArray[np.float32]:
    """Values of an image at (rows, columns, 2) positions; only the window that they span is read."""
    rows, columns = positions.shape[:2]
    with np.errstate(invalid="ignore"):
        inside = ((positions > -0.5) & (positions < (dataset.RasterXSize - 0.5, dataset.RasterYSize - 0.5))).all(-1)
    if not inside.any():
        return np.full((rows, columns), np.nan, dtype=np.float32)
    within = positions[inside]
    low = np.maximum(np.floor(within.min(axis=0)).astype(int) - 4, 0)
    high = np.minimum(np.ceil(within.max(axis=0)).astype(int) + 5, (dataset.RasterXSize, dataset.RasterYSize))
    if (high - low > _MAX_SIDE).any():  # a strip across a huge, turned scene: halve it until it fits
        half = columns // 2
        return np.hstack([sample_source(dataset, band, positions[:, :half], kernel),
                          sample_source(dataset, band, positions[:, half:], kernel)])
    source = read(dataset, (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])), band)
    return sample_array(source, positions - low, kernel)


def sample_array(source: NDArray[np.float32], positions: FloatArray, kernel: str) -> NDArray[np.float32]:
    """Values of an array (height, width) at (rows, columns, 2) positions; NaN outside and beside NaN."""
    u, v = positions[..., 0].astype(np.float32), positions[..., 1].astype(np.float32)
    flags = KERNELS[kernel]
    missing = ~np.isfinite(source)
    if not missing.any():
        return cv2.remap(source, u, v, flags, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    filled = np.where(missing, np.float32(0), source)
    values = cv2.remap(filled, u, v, flags, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    reach = {"bilinear": 1, "cubic": 2, "lanczos": 4}[kernel]
    touched = cv2.dilate(missing.astype(np.uint8), np.ones((2 * reach - 1, 2 * reach - 1), np.uint8))
    near = cv2.remap(touched.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=1)
    values[near > 0] = np.nan
    return values
