"""Cells finer than a surface's, over the same ground: what lies between is interpolated, but for the walls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Tuple

import numpy as np

from ..contracts.arrays import AnyArray, Floats, IntArray, Window
from .cell_grid import CellGrid


def finer_cell(cell: float, wanted: float, near: float) -> float:
    """The side of cells about as wide as ``wanted``, and no coarser than ``cell``: whole parts of a cell where these
    are ``near`` it (a share of it), so that each cell holds as many; else two significant digits."""
    part = cell / max(1, round(cell / wanted))
    return part if abs(part - wanted) <= near * wanted else min(float(f"{wanted:.2g}"), cell)


@dataclass(frozen=True)
class FinerCells:
    """The ``fine`` cells over the ``coarse`` ones of a surface; both begin in one corner, north-west."""

    coarse: CellGrid
    fine: CellGrid

    @classmethod
    def over(cls, coarse: CellGrid, cell: float) -> FinerCells:
        """Cells of a side, in units of the CRS, whose centres all lie in a grid: its own where they are its own."""
        ratio = coarse.cell / cell
        rows, columns = (max(1, math.ceil(count * ratio - 0.5 - 1e-6)) for count in coarse.shape)
        own = abs(cell - coarse.cell) <= 1e-9 * cell
        return cls(coarse, coarse if own else CellGrid(coarse.west, coarse.north, cell, (rows, columns)))

    @property
    def same(self) -> bool:
        """Whether they are the surface's own."""
        return self.fine == self.coarse

    def around(self, window: Window) -> Window:
        """The surface's cells that a window of fine cells lies between."""
        if self.same:
            return window
        ends = self._on_axes(window)
        (left, right), (top, bottom) = ((int(low.min()), int(low.max()) + 2) for low, _ in ends)
        return Window.spanning(left, top, min(right, self.coarse.size[0]), min(bottom, self.coarse.size[1]))

    def nearest(self, values: AnyArray, place: Window, window: Window) -> AnyArray:
        """(window.height, window.width) values of the surface's nearest cells; arguments as of :meth:`spread`."""
        if self.same:
            return values[window.inside(place)].copy()
        (columns, right), (rows, down) = self._from(place, window)
        found: AnyArray = values[rows + (down > 0.5)][:, columns + (right > 0.5)]
        return found

    def spread(self, values: Floats, place: Window, window: Window, step: float) -> Floats:
        """Values of the surface's cells on the fine cells of a window.

        Parameters
        ----------
        values : (H, W) of the cells ``place``, which hold those of :meth:`around` this window; NaN where there are
            none, which stays as wide as these cells.
        step : what differs by more than this from the nearest cell's value is another surface, and has no part:
            walls stay where they are, upright.

        Returns
        -------
        (window.height, window.width), bilinear between the cells of one surface.
        """
        if self.same:
            return values[window.inside(place)]
        (columns, right), (rows, down) = self._from(place, window)
        beside, below = (np.minimum(low + 1, size - 1) for low, size in zip((columns, rows), values.shape[::-1]))
        nearest = self.nearest(values, place, window)
        total, weights = np.zeros(nearest.shape), np.zeros(nearest.shape)
        for row, part in ((rows, 1 - down), (below, down)):
            line = values[row]
            for column, share in ((columns, 1 - right), (beside, right)):
                corner = line[:, column]
                with np.errstate(invalid="ignore"):
                    weight = np.where(np.abs(corner - nearest) <= step, part[:, None] * share, 0.0)
                total += weight * np.where(weight > 0, corner, 0.0)
                weights += weight
        with np.errstate(invalid="ignore"):
            spread: Floats = np.where(weights > 0, total / weights, np.nan)
        return spread

    def _on_axes(self, window: Window) -> Tuple[Tuple[IntArray, Floats], Tuple[IntArray, Floats]]:
        """As :meth:`_between`, of the columns and of the rows of a window."""
        columns, rows = self.coarse.size
        return self._between(window.col, window.width, columns), self._between(window.row, window.height, rows)

    def _from(self, place: Window, window: Window) -> List[Tuple[IntArray, Floats]]:
        """As :meth:`_on_axes`, counted from a place's first column and row."""
        return [(low - first, share) for (low, share), first in zip(self._on_axes(window), (place.col, place.row))]

    def _between(self, first: int, count: int, size: int) -> Tuple[IntArray, Floats]:
        """(count,) the surface's cell before each fine one's centre, and the share of the next one, 0..1."""
        place = (np.arange(first, first + count) + 0.5) * (self.fine.cell / self.coarse.cell) - 0.5
        low = np.clip(np.floor(place + 1e-9).astype(np.int64), 0, max(size - 2, 0))
        return low, np.clip(place - low, 0.0, 1.0 if size > 1 else 0.0)
