"""The orthophoto as the picture of a mesh, and coordinates that single precision can hold."""

from __future__ import annotations

import math
from typing import List

import numpy as np

from ..contracts.arrays import FloatArray, Window
from ..reports.pictures import jpeg_bytes
from .lattice import Surface
from .painting import Colours, Paint

_LONGEST_PX = 4096  # of the picture's sides: what graphics cards of phones still take; chosen
_JPEG_QUALITY = 90  # chosen


def middle(surface: Surface) -> FloatArray:
    """(3,) x, y and 0 of the middle of the DSM, in whole metres: heights stay what they are."""
    x0, cell_x, _, y0, _, cell_y = surface.dataset.GetGeoTransform()
    width, height = surface.dataset.RasterXSize, surface.dataset.RasterYSize
    return np.array([round(x0 + cell_x * width / 2), round(y0 + cell_y * height / 2), 0.0])


def picture_places(surface: Surface, places: FloatArray) -> FloatArray:
    """(N, 2) places of vertices (N, 3) in the picture, 0..1 to the right and down."""
    dataset = surface.paint.dataset if surface.paint is not None else surface.dataset
    x0, cell_x, _, y0, _, cell_y = dataset.GetGeoTransform()
    width, height = dataset.RasterXSize, dataset.RasterYSize
    x, y, _ = places.T
    return np.column_stack([(x - x0) / (cell_x * width), (y - y0) / (cell_y * height)])


def picture(paint: Paint) -> bytes:
    """The orthophoto as JPEG, every second, third, ... cell of a large one."""
    width, height = paint.dataset.RasterXSize, paint.dataset.RasterYSize
    step = max(1, math.ceil(max(width, height) / _LONGEST_PX))
    parts: List[Colours] = [
        paint.cells(Window(0, row, width, min(step, height - row)))[:1, ::step] for row in range(0, height, step)
    ]
    pixels = (np.concatenate(parts) >> 8).astype(np.uint8)
    return jpeg_bytes(pixels, _JPEG_QUALITY)
