"""How matched points become heights of cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Tuple, Union

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .cell_grid import CellGrid

_SURFACE_M_PER_CELL = 3.0  # points of one cell farther apart belong to two surfaces: roof, wall, ground
_MIXED = 0.3  # spread within a cell, as a share of that step, from which on it is looked at
_BRUSHED = 0.02  # of a whole point: less is no evidence of another surface
_LEAST_WEIGHT = 0.15  # of a whole point: below that a cell is only brushed by its neighbours' points


def surface_step(cell: float) -> float:
    """Metres of height that part the surfaces of one cell."""
    return _SURFACE_M_PER_CELL * max(cell, 0.33)


def grid_points(
    grid: CellGrid,
    x: FloatArray,
    y: FloatArray,
    height: FloatArray,
    score: NDArray[np.floating],
    spacing: float = math.inf,
) -> Tuple[FloatArray, FloatArray, FloatArray]:
    """Heights of cells from points, their mean matching score, NaN where no point is, and how many points they hold.

    A point stands for a square of ``spacing`` metres (the distance between neighbouring points; at most a cell) and
    gives to each cell what of the square lies in it, so that neither combs nor shifts arise. Where a cell has points
    of several surfaces (a roof and the ground before it), those of the surface that covers most of it make its
    height: means between surfaces would smear every edge, and the topmost would make every roof too wide.
    """
    footprint = min(spacing / grid.cell, 1.0)
    points = _placed(grid, x, y, height, score)
    padded = (grid.shape[0] + 2) * (grid.shape[1] + 2)
    sums = np.zeros((4, padded))
    for cells, weight, chosen in _splats(grid, points, footprint):
        z, s = points.height[chosen], points.score[chosen]
        part = weight * z
        for total, values in zip(sums, (weight, part, part * z, weight * s)):
            total += np.bincount(cells, values, padded)
    weights = sums[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        heights, scores = sums[1] / weights, sums[3] / weights
        mixed = sums[2] / weights - heights**2 > (_MIXED * surface_step(grid.cell)) ** 2
    if mixed.any():
        _largest_surfaces(grid, points, footprint, mixed, heights, scores)
    empty = weights < _LEAST_WEIGHT
    heights[empty] = np.nan
    scores[empty] = np.nan
    inner = np.s_[1:-1, 1:-1]
    shape = grid.shape[0] + 2, grid.shape[1] + 2
    return (
        heights.reshape(shape)[inner] + points.offset,
        scores.reshape(shape)[inner].copy(),
        weights.reshape(shape)[inner].copy(),
    )


@dataclass(frozen=True)
class _Points:
    """Points on the grid, (N,) each: ``cell`` number, in the grid with a rim of one cell, of the one before, and how
    far ``right`` and ``below`` of that one's centre (0..1); ``height`` above ``offset``, ``score``."""

    cell: NDArray[np.int64]
    right: FloatArray
    below: FloatArray
    height: FloatArray
    score: FloatArray
    offset: float


def _placed(grid: CellGrid, x: FloatArray, y: FloatArray, height: FloatArray, score: NDArray[np.floating]) -> _Points:
    known = np.flatnonzero(np.isfinite(height))
    column = (x.ravel()[known] - (grid.west - 0.5 * grid.cell)) / grid.cell
    row = ((grid.north + 0.5 * grid.cell) - y.ravel()[known]) / grid.cell
    inside = (column > 0) & (column < grid.shape[1] + 1) & (row > 0) & (row < grid.shape[0] + 1)
    if not inside.all():
        known, column, row = known[inside], column[inside], row[inside]
    left, top = column.astype(np.int64), row.astype(np.int64)
    z = height.ravel()[known].astype(np.float64)
    # Squares of heights are summed: from the middle they lose nothing.
    offset = float(z.mean()) if z.size else 0.0
    return _Points(
        top * (grid.shape[1] + 2) + left,
        column - left,
        row - top,
        z - offset,
        np.nan_to_num(score.ravel()[known]).astype(np.float64),
        offset,
    )


def _splats(
    grid: CellGrid, points: _Points, footprint: float
) -> Iterator[Tuple[NDArray[np.int64], FloatArray, Union[slice, NDArray[np.int64]]]]:
    """For each of the four neighbours: cell numbers, weights, and which points they belong to."""
    across, down = (_shares(near, footprint) for near in (points.right, points.below))
    for rows, vertical in zip((0, grid.shape[1] + 2), down):
        for columns, horizontal in zip((0, 1), across):
            weight = vertical * horizontal
            if footprint == 1.0:
                yield points.cell + (rows + columns), weight, slice(None)
                continue
            chosen = np.flatnonzero(weight)
            yield points.cell[chosen] + (rows + columns), weight[chosen], chosen


def _shares(after: FloatArray, footprint: float) -> Tuple[FloatArray, FloatArray]:
    """What of a side of length ``footprint`` lies in the cell before and in the one after.

    ``after`` (0..1) is how far its middle lies beyond the middle of the cell before.
    """
    share = after if footprint == 1.0 else np.clip((after - (1 - footprint) / 2) / footprint, 0, 1)
    return 1 - share, share


def _largest_surfaces(
    grid: CellGrid, points: _Points, footprint: float, mixed: NDArray[np.bool_], heights: FloatArray, scores: FloatArray
) -> None:
    """Set the mixed cells' heights and scores to those of the surface with most weight, the upper where two tie.

    A surface is all points of the cell within a step in height: the wall between two would join them if it were
    all points that lie close to the next.
    """
    parts = []
    for cells, weight, chosen in _splats(grid, points, footprint):
        taken = np.flatnonzero(mixed[cells] & (weight > _BRUSHED))
        parts.append((cells[taken], weight[taken], points.height[chosen][taken], points.score[chosen][taken]))
    cell, weight, z, score = (np.concatenate(values) for values in zip(*parts))
    if not cell.size:
        return
    step = surface_step(grid.cell)
    # One number that sorts by cell, then height, with more than a step between the heights of two cells.
    place = cell * (4.0 * step + float(np.ptp(z))) + (z - z.min())
    order = np.argsort(place, kind="stable")
    cell, place = cell[order], place[order]
    end = np.searchsorted(place, place + step, side="right")
    sums = np.zeros((3, len(cell) + 1))
    np.cumsum([weight[order], (weight * z)[order], (weight * score)[order]], axis=1, out=sums[:, 1:])
    total, heights_of, scores_of = sums[:, end] - sums[:, :-1]
    first = np.flatnonzero(np.append(True, np.diff(cell) != 0))
    most = np.repeat(np.maximum.reduceat(total, first), np.diff(np.append(first, len(cell))))
    best = np.flatnonzero(total >= most - 1e-9)
    best = best[np.append(np.diff(cell[best]) != 0, True)]
    heights[cell[best]] = heights_of[best] / total[best]
    scores[cell[best]] = scores_of[best] / total[best]
