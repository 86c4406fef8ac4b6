"""The own surface as a reference sees it: means over the supports of the reference's heights, and their gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Floats
from ..geometry.cell_grid import CellGrid


@dataclass(frozen=True)
class Reference:
    """Heights of known place: (N, 3) ``xyz`` in the scene's CRS and metres above the ellipsoid.

    Each is the mean over a rectangle (a raster's cell) or a disc (a laser's footprint) that is ``width_m`` wide from
    west to east and from south to north; 0 for points. ``slopes`` (N, 2), of a raster, are its own slopes to the east
    and to the north (m per m), NaN where unknown. ``name`` is its name in messages.
    """

    name: str
    xyz: FloatArray
    width_m: Tuple[float, float]
    disc: bool = False
    slopes: Optional[FloatArray] = None


class SupportMeans:
    """A surface averaged over supports of one kind, and its gradient, at any place."""

    def __init__(self, grid: CellGrid, height: Floats, reference: Reference, covered: float) -> None:
        """``height`` (rows, columns) of ``grid``, NaN where unknown; the supports are those of the reference.

        Means have a value where ``covered`` of the support's area is known; they are means of what is known.
        """
        from scipy import ndimage

        self._grid, self.cell_m = grid, grid.cell
        self.resolution_m = max(grid.cell, *reference.width_m)
        known = np.isfinite(height)
        level = float(np.median(height[known])) if known.any() else 0.0
        kernel = _kernel(reference.width_m[0] / grid.cell, reference.width_m[1] / grid.cell, reference.disc)
        weights = _filtered(known.astype(np.float64), kernel)
        total = _filtered(np.where(known, height - level, 0.0).astype(np.float64), kernel)
        mean = total / np.maximum(weights, 1e-9) + level
        mean[weights < covered] = np.nan
        self._unknown = ~np.isfinite(mean)
        # A spline rings at borders of unknown parts: they are continued with the nearest known mean.
        if self._unknown.all():
            self._filled = np.zeros_like(mean)
        else:
            nearest = ndimage.distance_transform_edt(self._unknown, return_distances=False, return_indices=True)
            self._filled = mean[tuple(nearest)]
        self._spline = ndimage.spline_filter(self._filled, 3)

    @property
    def middle(self) -> Tuple[float, float]:
        """The middle of the surface's cells, in its CRS."""
        return self._grid.middle

    @property
    def extent_m(self) -> Tuple[float, float]:
        """How long the surface is from west to east and from south to north."""
        rows, columns = self._unknown.shape
        return columns * self._grid.cell, rows * self._grid.cell

    def shared(self, x: FloatArray, y: FloatArray, parts: int) -> float:
        """The share of the surface's parts with means, of so many along a side, in which some of (N,) places lie."""
        rows, columns = self._unknown.shape
        known, there = np.zeros((2, parts, parts), dtype=bool)
        step = max(1, min(rows, columns) // (8 * parts))
        row, column = (step * each for each in np.nonzero(~self._unknown[::step, ::step]))
        known[row * parts // rows, column * parts // columns] = True
        row, column = (self._grid.north - y) / self._grid.cell / rows, (x - self._grid.west) / self._grid.cell / columns
        there[tuple(np.clip((each * parts).astype(int), 0, parts - 1) for each in (row, column))] = True
        return float((known & there).sum() / max(known.sum(), 1))

    def at(self, x: FloatArray, y: FloatArray) -> Tuple[FloatArray, FloatArray, FloatArray]:
        """(N,) means (NaN where unknown), and their slopes to the east and to the north (m per m)."""
        from scipy import ndimage

        col, row = (x - self._grid.west) / self._grid.cell - 0.5, (self._grid.north - y) / self._grid.cell - 0.5
        rows, columns = self._unknown.shape
        inside = (col >= 0) & (col <= columns - 1) & (row >= 0) & (row <= rows - 1)
        c, r = np.where(inside, col, 0.0), np.where(inside, row, 0.0)
        near = (np.floor(r).astype(int), np.floor(c).astype(int))
        far = (np.ceil(r).astype(int), np.ceil(c).astype(int))
        pairs = [(a[0], b[1]) for a in (near, far) for b in (near, far)]
        inside &= ~np.logical_or.reduce([self._unknown[pair] for pair in pairs])
        half = 0.5
        places = ((r, c), (r, c + half), (r, c - half), (r + half, c), (r - half, c))
        value, right, left, below, above = (
            ndimage.map_coordinates(self._spline, place, order=3, prefilter=False, mode="mirror") for place in places
        )
        value[~inside] = np.nan
        return value, (right - left) / self._grid.cell, (above - below) / self._grid.cell


def _kernel(width: float, height: float, disc: bool) -> FloatArray:
    """Weights of cells in a support of so many cells around a cell's centre; sum 1."""
    if disc:
        fine, reach = 8, max(math.ceil(width / 2 - 0.5), 0)  # parts of a cell's side
        at = (np.arange((2 * reach + 1) * fine) + 0.5) / fine - reach - 0.5
        inside = np.hypot(at[:, None], at[None, :]) <= max(width, 1.0) / 2
        kernel = inside.reshape(2 * reach + 1, fine, 2 * reach + 1, fine).mean(axis=(1, 3))
    else:
        kernel = np.outer(_line(height), _line(width))
    return np.asarray(kernel / kernel.sum())


def _line(width: float) -> FloatArray:
    """Parts of cells within so many cells' width."""
    reach = max(math.ceil(width / 2 - 0.5), 0)
    line = np.ones(2 * reach + 1)
    if reach:
        line[[0, -1]] = width / 2 - reach + 0.5
    return line


def _filtered(values: FloatArray, kernel: FloatArray) -> FloatArray:
    from scipy import ndimage

    across, down = kernel.sum(axis=0), kernel.sum(axis=1)
    if np.allclose(kernel, np.outer(down, across)):
        once = ndimage.correlate1d(values, across, axis=1, mode="constant")
        return np.asarray(ndimage.correlate1d(once, down, axis=0, mode="constant"))
    return np.asarray(ndimage.correlate(values, kernel, mode="constant"))
