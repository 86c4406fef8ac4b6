"""The DSM's cells, and how matched points become heights of cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_SURFACE_M_PER_CELL = 3.0   # points of one cell farther below its top belong to another surface: wall or ground
_LEAST_WEIGHT = 0.15        # of a whole point: below that a cell is only brushed by its neighbours' points


@dataclass(frozen=True)
class CellGrid:
    """A north-up grid: ``west``, ``north`` are its corner, multiples of the cell size; ``shape`` is rows, columns."""

    west: float
    north: float
    cell: float
    shape: Tuple[int, int]

    @classmethod
    def covering(cls, bounds: Sequence[float], cell: float) -> "CellGrid":
        """The grid of whole multiples of the cell size that holds bounds xmin, ymin, xmax, ymax."""
        west, south = math.floor(bounds[0] / cell + 1e-9), math.floor(bounds[1] / cell + 1e-9)
        east, north = math.ceil(bounds[2] / cell - 1e-9), math.ceil(bounds[3] / cell - 1e-9)
        return cls(west * cell, north * cell, cell, (north - south, east - west))

    @property
    def geotransform(self) -> Tuple[float, float, float, float, float, float]:
        return self.west, self.cell, 0.0, self.north, 0.0, -self.cell

    def window(self, bounds: Sequence[float], margin: int = 0) -> Tuple[int, int, int, int]:
        """First column and row, width and height of the cells whose centres lie in bounds, cut to the grid."""
        c0 = math.ceil((bounds[0] - self.west) / self.cell - 0.5 - 1e-9) - margin
        c1 = math.ceil((bounds[2] - self.west) / self.cell - 0.5 - 1e-9) + margin
        r0 = math.ceil((self.north - bounds[3]) / self.cell - 0.5 - 1e-9) - margin
        r1 = math.ceil((self.north - bounds[1]) / self.cell - 0.5 - 1e-9) + margin
        c0, r0 = max(c0, 0), max(r0, 0)
        c1, r1 = min(c1, self.shape[1]), min(r1, self.shape[0])
        return c0, r0, max(c1 - c0, 0), max(r1 - r0, 0)

    def part(self, window: Tuple[int, int, int, int]) -> "CellGrid":
        """The sub-grid of a window."""
        col, row, width, height = window
        return CellGrid(self.west + col * self.cell, self.north - row * self.cell, self.cell, (height, width))

    def centres(self) -> Tuple[FloatArray, FloatArray]:
        """(columns,) x and (rows,) y of the cells' centres."""
        return (self.west + (np.arange(self.shape[1]) + 0.5) * self.cell,
                self.north - (np.arange(self.shape[0]) + 0.5) * self.cell)


def grid_points(grid: CellGrid, x: FloatArray, y: FloatArray, height: FloatArray,
                score: NDArray[np.floating]) -> Tuple[FloatArray, FloatArray]:
    """Heights of cells from points, with their mean matching score; both of the grid's shape, NaN where no point is.

    Each point gives to the four cells around it, bilinearly, so that neither combs nor shifts arise. Where a cell
    has points of several surfaces (a roof and the ground before it), those of the highest make its height: a DSM
    shows what is on top, and means between surfaces would smear every edge.
    """
    known = np.isfinite(height)
    column = (x[known] - grid.west) / grid.cell - 0.5
    row = (grid.north - y[known]) / grid.cell - 0.5
    z, s = height[known], score[known].astype(np.float64)
    inside = (column > -1) & (column < grid.shape[1]) & (row > -1) & (row < grid.shape[0])
    column, row, z, s = column[inside], row[inside], z[inside], s[inside]
    size = grid.shape[0] * grid.shape[1]
    splats = list(_splats(grid, column, row))
    top = _top(size, splats, z)
    floor = top - _SURFACE_M_PER_CELL * max(grid.cell, 0.33)
    weights, heights, scores = np.zeros(size), np.zeros(size), np.zeros(size)
    for cells, weight, chosen in splats:
        h = z[chosen]
        on_top = h >= floor[cells]
        cells, weight, h = cells[on_top], weight[on_top], h[on_top]
        weights += np.bincount(cells, weight, size)
        heights += np.bincount(cells, weight * h, size)
        scores += np.bincount(cells, weight * s[chosen][on_top], size)
    with np.errstate(invalid="ignore", divide="ignore"):
        empty = weights < _LEAST_WEIGHT
        heights, scores = heights / weights, scores / weights
    heights[empty] = np.nan
    scores[empty] = np.nan
    return heights.reshape(grid.shape), scores.reshape(grid.shape)


def _splats(grid: CellGrid, column: FloatArray, row: FloatArray):
    """For each of the four neighbours: cell numbers, bilinear weights, and which points they belong to."""
    c0, r0 = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    a, b = column - c0, row - r0
    for dr in (0, 1):
        for dc in (0, 1):
            weight = (b if dr else 1 - b) * (a if dc else 1 - a)
            r, c = r0 + dr, c0 + dc
            chosen = np.flatnonzero((weight > 0.02) & (r >= 0) & (r < grid.shape[0]) & (c >= 0) & (c < grid.shape[1]))
            yield (r[chosen] * grid.shape[1] + c[chosen]), weight[chosen], chosen


def _top(size: int, splats: Sequence[Tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]],
         z: FloatArray) -> FloatArray:
    """(size,) height of the topmost point that belongs to each cell; of those that brush it, where none does."""
    own, brushed = np.full(size, -np.inf), np.full(size, -np.inf)
    order = np.argsort(z, kind="stable")
    rank = np.empty(len(z), dtype=np.int64)
    rank[order] = np.arange(len(z))
    for cells, weight, chosen in splats:
        # Written in order of height, the last that stays is the highest.
        by_height = np.argsort(rank[chosen], kind="stable")
        cells, weight, h = cells[by_height], weight[by_height], z[chosen][by_height]
        mine = weight >= 0.25
        level = np.full(size, -np.inf)
        level[cells[mine]] = h[mine]
        np.maximum(own, level, out=own)
        level = np.full(size, -np.inf)
        level[cells] = h
        np.maximum(brushed, level, out=brushed)
    return np.where(np.isfinite(own), own, brushed)
