"""Means of a DSM's heights over coarse cells, summed while its tiles are written, so that nothing is read again."""

from __future__ import annotations

import math

import numpy as np

from ..contracts.arrays import FloatArray, Floats, Window
from ..geometry.cell_grid import CellGrid


class CoarseMeans:
    """Sums and counts of the heights in blocks of ``factor`` x ``factor`` cells of a grid."""

    def __init__(self, grid: CellGrid, most_cells: int) -> None:
        """Blocks of so many cells that there are at most about ``most_cells`` of them."""
        self.factor = max(1, math.ceil(math.sqrt(grid.shape[0] * grid.shape[1] / most_cells)))
        rows, columns = (math.ceil(count / self.factor) for count in grid.shape)
        self.grid = CellGrid(grid.west, grid.north, self.factor * grid.cell, (rows, columns))
        self._sum, self._count = np.zeros((rows, columns)), np.zeros((rows, columns))

    def add(self, height: Floats, window: Window) -> None:
        """Add the heights (rows, columns; NaN: unknown) of a window of the grid."""
        if not height.size:
            return
        known = np.isfinite(height)
        first = window.row // self.factor, window.col // self.factor
        # Where the blocks begin, in the window: the first may have begun before it.
        starts = [
            np.maximum(np.arange(at, -(-(begin + count) // self.factor)) * self.factor - begin, 0)
            for at, begin, count in zip(first, (window.row, window.col), height.shape)
        ]
        target = tuple(slice(at, at + len(start)) for at, start in zip(first, starts))
        for total, values in ((self._sum, np.where(known, height, 0.0)), (self._count, known.astype(np.float64))):
            total[target] += np.add.reduceat(np.add.reduceat(values, starts[0], axis=0), starts[1], axis=1)

    def means(self, covered: float) -> FloatArray:
        """(rows, columns) means of the known heights, NaN where less than ``covered`` of a block is known."""
        enough = self._count >= max(covered * self.factor**2, 1.0)
        return np.where(enough, self._sum / np.maximum(self._count, 1.0), np.nan)
