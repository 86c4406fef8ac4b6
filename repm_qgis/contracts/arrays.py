"""Types that all modules share: arrays by what they hold, and rectangles on the ground and in images."""

from __future__ import annotations

from typing import Any, Iterable, NamedTuple, Optional, Tuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Coordinates, heights and other quantities that need double precision."""
FloatImage = NDArray[np.float32]
"""Intensities, disparities and scores; NaN where there is none."""
Floats = NDArray[np.floating[Any]]
"""Of single or double precision, which the result keeps."""
AnyArray = NDArray[Any]
"""Of any kind of numbers, which the result keeps."""
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

    @classmethod
    def spanning(cls, col: int, row: int, end_col: int, end_row: int) -> Window:
        """From the first column and row to the end ones, which no longer belong to it."""
        return cls(col, row, end_col - col, end_row - row)

    def grown(self, margin: int, size: Size) -> Window:
        """Wider by a margin on each side, as far as an image of a size reaches."""
        return Window.spanning(
            max(self.col - margin, 0),
            max(self.row - margin, 0),
            min(self.col + self.width + margin, size[0]),
            min(self.row + self.height + margin, size[1]),
        )

    def common(self, other: Window) -> Optional[Window]:
        """The pixels of both windows; None where they share none."""
        col, row = max(self.col, other.col), max(self.row, other.row)
        width = min(self.col + self.width, other.col + other.width) - col
        height = min(self.row + self.height, other.row + other.height) - row
        return Window(col, row, width, height) if width > 0 and height > 0 else None

    def within(self, outer: Window) -> Window:
        """This window, counted from the first column and row of an outer one."""
        return Window(self.col - outer.col, self.row - outer.row, self.width, self.height)

    @property
    def slices(self) -> Tuple[slice, slice]:
        """Rows and columns of this window in the whole array."""
        return slice(self.row, self.row + self.height), slice(self.col, self.col + self.width)

    def inside(self, outer: Window) -> Tuple[slice, slice]:
        """Rows and columns of this window in an array that holds the pixels of an outer one."""
        return self.within(outer).slices


class Bounds(NamedTuple):
    """A rectangle on the ground, in the units of a CRS."""

    xmin: float
    ymin: float
    xmax: float
    ymax: float

    @classmethod
    def between(cls, low: Iterable[float], high: Iterable[float]) -> Bounds:
        """From the least x and y to the largest ones, (2,) each."""
        (xmin, ymin), (xmax, ymax) = low, high
        return cls(float(xmin), float(ymin), float(xmax), float(ymax))

    def grown(self, margin: float) -> Bounds:
        """Wider by a margin on each side."""
        return Bounds(self.xmin - margin, self.ymin - margin, self.xmax + margin, self.ymax + margin)
