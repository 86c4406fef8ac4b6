"""The cells of a raster on the ground, and blocks of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds, FloatArray, Floats, IntArray, Mask, Size, Window


@dataclass(frozen=True)
class CellGrid:
    """A north-up grid: ``west``, ``north`` are its corner, multiples of the cell size; ``shape`` is rows, columns."""

    west: float
    north: float
    cell: float
    shape: Tuple[int, int]

    @classmethod
    def covering(cls, bounds: Sequence[float], cell: float) -> CellGrid:
        """The grid of whole multiples of the cell size that covers bounds (xmin, ymin, xmax, ymax)."""
        west, south = math.floor(bounds[0] / cell + 1e-9), math.floor(bounds[1] / cell + 1e-9)
        east, north = math.ceil(bounds[2] / cell - 1e-9), math.ceil(bounds[3] / cell - 1e-9)
        return cls(west * cell, north * cell, cell, (north - south, east - west))

    @property
    def geotransform(self) -> Tuple[float, float, float, float, float, float]:
        return self.west, self.cell, 0.0, self.north, 0.0, -self.cell

    @property
    def size(self) -> Size:
        return self.shape[1], self.shape[0]

    @property
    def bounds(self) -> Bounds:
        south, east = self.north - self.shape[0] * self.cell, self.west + self.shape[1] * self.cell
        return Bounds(self.west, south, east, self.north)

    @property
    def middle(self) -> Tuple[float, float]:
        """The middle of all cells."""
        west, south, east, north = self.bounds
        return 0.5 * (west + east), 0.5 * (south + north)

    def window(self, bounds: Sequence[float], margin: int = 0) -> Window:
        """The cells whose centres lie in bounds, and a margin of cells, cut to the grid."""
        c0 = math.ceil((bounds[0] - self.west) / self.cell - 0.5 - 1e-9) - margin
        c1 = math.ceil((bounds[2] - self.west) / self.cell - 0.5 - 1e-9) + margin
        r0 = math.ceil((self.north - bounds[3]) / self.cell - 0.5 - 1e-9) - margin
        r1 = math.ceil((self.north - bounds[1]) / self.cell - 0.5 - 1e-9) + margin
        c0, r0 = max(c0, 0), max(r0, 0)
        c1, r1 = min(c1, self.shape[1]), min(r1, self.shape[0])
        return Window(c0, r0, max(c1 - c0, 0), max(r1 - r0, 0))

    def part(self, window: Window) -> CellGrid:
        """The sub-grid of a window."""
        col, row, width, height = window
        return CellGrid(self.west + col * self.cell, self.north - row * self.cell, self.cell, (height, width))

    def centres(self) -> Tuple[FloatArray, FloatArray]:
        """(columns,) x and (rows,) y of the cells' centres."""
        right, down = ((np.arange(count) + 0.5) * self.cell for count in self.size)
        return self.west + right, self.north - down

    def cells_of(self, x: Floats, y: Floats) -> Tuple[IntArray, IntArray, Mask]:
        """(N,) row and column of the cells in which N places lie, and which of them lie in the grid at all."""
        column = np.floor((x - self.west) / self.cell).astype(np.int64)
        row = np.floor((self.north - y) / self.cell).astype(np.int64)
        inside: Mask = (column >= 0) & (column < self.shape[1]) & (row >= 0) & (row < self.shape[0])
        return row, column, inside


def overlapping_blocks(size: Size, side: int, halo: int = 0) -> Iterator[Tuple[Window, Window]]:
    """Windows that cover an image or grid of a size, row by row: each one's own pixels, and these with a halo.

    Work in blocks needs bounded memory; results of a block's own pixels may depend on neighbours within the halo.
    """
    for row in range(0, size[1], side):
        for col in range(0, size[0], side):
            own = Window.spanning(col, row, min(col + side, size[0]), min(row + side, size[1]))
            yield own, own.grown(halo, size)
