"""How matched points become heights of cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Tuple, Union

import numpy as np

from ..contracts.arrays import FloatArray, Floats, IntArray, Mask
from .cell_grid import CellGrid
from .parameters import GRIDDING, GriddingParameters

Parts = Tuple[IntArray, FloatArray, FloatArray, FloatArray]


def surface_step(cell: float, parameters: GriddingParameters) -> float:
    """The difference in height, m, between points of a cell that belong to two surfaces."""
    return parameters.surface_step * max(cell, parameters.surface_step_cell_m)


def widening(cell: float, spacing: float, parameters: GriddingParameters = GRIDDING) -> int:
    """How many cells wide a cell must be that always holds points which are ``spacing`` metres apart; inf: one."""
    return max(1, math.ceil(spacing / cell - parameters.wider)) if math.isfinite(spacing) else 1


def grid_points(
    grid: CellGrid,
    x: FloatArray,
    y: FloatArray,
    *,
    height: FloatArray,
    score: Floats,
    spacing: float = math.inf,
    apart: float = 0.0,
    parameters: GriddingParameters = GRIDDING,
) -> Tuple[FloatArray, FloatArray, FloatArray]:
    """Heights of cells from points, their mean matching score, NaN where no point is, and how many points they hold.

    A point represents a square of ``spacing`` metres (the distance between neighbouring points; inf: a cell), and
    each cell gets the part of the square that lies in it, so that there are no comb patterns and no shifts. Cells that
    are finer than that, or than the distance ``apart`` of neighbours in the direction where it is longest (m; 0: it is
    ``spacing``), get what a cell as wide as the distance would get around their centre. Where a
    cell has points of several surfaces (a roof and the ground before it), the surface that covers most of it gives the
    height: means between surfaces would smear every edge, and the topmost would make every roof too wide.
    """
    factor = widening(grid.cell, max(spacing, apart), parameters)
    if factor > 1:
        return _wide_cells(factor, grid, x, y=y, height=height, score=score, spacing=spacing, parameters=parameters)
    footprint, step = min(spacing / grid.cell, 1.0), surface_step(grid.cell, parameters)
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
        mixed = sums[2] / weights - heights**2 > (parameters.mixed * step) ** 2
    if mixed.any():
        parts = _splats_into(mixed, grid, points, footprint, parameters.surface_weight)
        _largest_surfaces(parts, step, heights, scores)
    empty = weights < parameters.cell_weight
    heights[empty] = np.nan
    scores[empty] = np.nan
    shape = grid.shape[0] + 2, grid.shape[1] + 2
    heights, scores, weights = (values.reshape(shape)[1:-1, 1:-1].copy() for values in (heights, scores, weights))
    return heights, scores, weights


def _wide_cells(
    factor: int,
    grid: CellGrid,
    x: FloatArray,
    *,
    y: FloatArray,
    height: FloatArray,
    score: Floats,
    spacing: float,
    parameters: GriddingParameters,
) -> Tuple[FloatArray, FloatArray, FloatArray]:
    """The same for cells so many times as wide around the centre of each cell, which overlap: those whose centres are
    so many cells apart are a grid of their own. The number of points is that of one fine cell."""
    heights, scores, weights = (np.full(grid.shape, np.nan), np.full(grid.shape, np.nan), np.zeros(grid.shape))
    wide, before = factor * grid.cell, (factor - 1) / 2 * grid.cell
    for row in range(min(factor, grid.shape[0])):
        for column in range(min(factor, grid.shape[1])):
            west, north = grid.west + column * grid.cell - before, grid.north - row * grid.cell + before
            shape = len(range(row, grid.shape[0], factor)), len(range(column, grid.shape[1], factor))
            every = CellGrid(west, north, wide, shape)
            found = grid_points(
                every, x, y, height=height, score=score, spacing=min(spacing, wide), parameters=parameters
            )
            for whole, part in zip((heights, scores, weights), found):
                whole[row::factor, column::factor] = part
    return heights, scores, weights / factor**2


@dataclass(frozen=True)
class _Points:
    """Points on the grid, (N,) each: the number of the ``cell`` to the upper left, in the grid with a rim of one cell,
    and how far ``right`` and ``below`` its centre the point lies (0..1); ``height`` and ``score``."""

    cell: IntArray
    right: FloatArray
    below: FloatArray
    height: FloatArray
    score: FloatArray


def _placed(grid: CellGrid, x: FloatArray, y: FloatArray, height: FloatArray, score: Floats) -> _Points:
    known = np.flatnonzero(np.isfinite(height))
    column = (x.ravel()[known] - (grid.west - 0.5 * grid.cell)) / grid.cell
    row = ((grid.north + 0.5 * grid.cell) - y.ravel()[known]) / grid.cell
    inside = (column > 0) & (column < grid.shape[1] + 1) & (row > 0) & (row < grid.shape[0] + 1)
    if not inside.all():
        known, column, row = known[inside], column[inside], row[inside]
    left, top = column.astype(np.int64), row.astype(np.int64)
    z = height.ravel()[known].astype(np.float64)
    cell, scores = top * (grid.shape[1] + 2) + left, np.nan_to_num(score.ravel()[known]).astype(np.float64)
    return _Points(cell, column - left, row - top, z, scores)


def _splats(
    grid: CellGrid, points: _Points, footprint: float
) -> Iterator[Tuple[IntArray, FloatArray, Union[slice, IntArray]]]:
    """For each of the four nearest cells: cell numbers, weights, and which points they belong to."""
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
    """How much of a side of length ``footprint`` lies in the first cell, and how much in the second.

    ``after`` (0..1) is the distance of its middle from the middle of the first cell.
    """
    share: FloatArray = after if footprint == 1.0 else np.clip((after - (1 - footprint) / 2) / footprint, 0, 1)
    return 1 - share, share


def _splats_into(mixed: Mask, grid: CellGrid, points: _Points, footprint: float, least_weight: float) -> Parts:
    """(N,) cells, weights, heights and scores of all that points give to mixed cells, a point up to four times."""
    parts = []
    for cells, weight, chosen in _splats(grid, points, footprint):
        taken = np.flatnonzero(mixed[cells] & (weight > least_weight))
        parts.append((cells[taken], weight[taken], points.height[chosen][taken], points.score[chosen][taken]))
    cell, weights, heights, scores = (np.concatenate(values) for values in zip(*parts))
    return cell, weights, heights, scores


def _largest_surfaces(parts: Parts, step: float, heights: FloatArray, scores: FloatArray) -> None:
    """Set the mixed cells' heights and scores to those of the surface with most weight, the upper where two have it.

    A surface is all points of the cell within a step in height. (Chains of points that lie close to each other would
    be joined by the wall between two surfaces.)
    """
    cell, weight, z, score = parts
    if not cell.size:
        return
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
