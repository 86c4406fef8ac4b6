"""Types that all modules share: arrays by what they hold, and rectangles on the ground and in images."""

from __future__ import annotations

from typing import Any, NamedTuple, Tuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Coordinates, heights and other quantities that need double precision."""
FloatImage = NDArray[np.float32]
"""Brightness, disparities and scores; NaN where there is none."""
Floats = NDArray[np.floating[Any]]
"""Of either precision, which the result keeps."""
IntArray = NDArray[np.int64]
ByteImage = NDArray[np.uint8]
Mask = NDArray[np.bool_]

Size = Tuple[int, int]
"""Width and height, px."""
Altitudes = Tuple[float, float]
"""Least and greatest height above the ellipsoid, m."""


class Window(NamedTuple):
    """A rectangle of pixels or cells: its first column and row, and how many there are of each."""

    col: int
    row: int
    width: int
    height: int


class Bounds(NamedTuple):
    """A rectangle on the ground, in the units of a CRS."""

    xmin: float
    ymin: float
    xmax: float
    ymax: float
