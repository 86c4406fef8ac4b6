"""Cells in which one map sees two surfaces, the lower one under the other.

A surface has one height in each place, so a roof stands on a wall. Of a wall that an image shows, matching knows
nothing: its pixels take the height of the roof above or of the ground below. Those with the height of the roof lie
before the wall, above ground that other pixels show; those with the height of the ground lie behind it, under the
roof. Together these places are as long as the wall's image, and matching gives about a quarter of it to the roof. So a
place is under the roof if the line of sight to the lower surface is below roofs a quarter of its way up; else what is
seen there is the ground, and nothing stands above it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ..arrays import FloatArray, Floats, IntArray, Mask
from ..geometry.cell_grid import CellGrid
from ..geometry.gridding import surface_step
from ..stereo.height_maps import HeightMap
from .parameters import FUSION, FusionParameters


def without_overhangs(
    grid: CellGrid,
    heights: HeightMap,
    matched: Floats,
    height: FloatArray,
    score: FloatArray,
    metres_per_px: float,
    spacing: float,
    parameters: FusionParameters = FUSION,
) -> Tuple[FloatArray, FloatArray]:
    """The cells' heights (m) and scores, (rows, columns) each, with one surface where there were two.

    ``matched`` (H, W) are the map's own heights, m, NaN = none; ``height`` and ``score`` are what most of each cell
    has, and stay where the map sees one surface. Points lie ``spacing`` metres apart: cells that are much wider hold
    edges of roofs as they are, and nothing is changed. In wide pairs, one image hides much of the ground before walls
    from the other, so that only ground under roofs gives way there.
    """
    p = parameters.overhangs
    if grid.cell > p.widest_cell * spacing:
        return height, score
    step = max(surface_step(grid.cell, parameters.gridding), p.step_px * metres_per_px)
    pairs = _pairs(grid, heights, matched, step, p.least_share)
    if not pairs.cell.size:
        return height, score
    height, score = height.copy(), score.copy()
    known = np.isfinite(height.ravel()[pairs.cell])
    top = height.copy()
    top.ravel()[pairs.cell] = np.fmax(pairs.top, top.ravel()[pairs.cell])
    blocked, decided = _blocked(grid, top, pairs, heights.ray, step, p.along)
    decided &= known & (blocked | (spacing <= p.widest_base_to_height * metres_per_px))
    for values, upper, lower in ((height, pairs.upper, pairs.lower), (score, *pairs.scores)):
        values.ravel()[pairs.cell[decided]] = np.where(blocked, upper, lower)[decided]
    return height, score


@dataclass(frozen=True)
class _Pairs:
    """Cells (N,) with two surfaces: the highest of their points, the mean heights and scores of both surfaces."""

    cell: IntArray
    top: FloatArray
    upper: FloatArray
    lower: FloatArray
    scores: Tuple[FloatArray, FloatArray]


def _pairs(grid: CellGrid, heights: HeightMap, matched: Floats, step: float, least_share: float) -> _Pairs:
    """The cells whose points lie more than ``step`` m apart, with at least a share of them on either side."""
    rows, columns = grid.shape
    known = np.flatnonzero(np.isfinite(matched))
    row, column, inside = grid.cells_of(heights.x.ravel()[known], heights.y.ravel()[known])
    known, cell = known[inside], (row * columns + column)[inside]
    z = matched.ravel()[known].astype(np.float64)
    z -= z.mean() if z.size else 0.0  # squares keep their precision
    count, total, square = (np.bincount(cell, weight, rows * columns) for weight in (None, z, z * z))
    many = np.maximum(count, 1)
    # Two points so far apart have at least this variance, whatever lies between them.
    mixed = square / many - (total / many) ** 2 > 0.5 * step**2 / many
    mine = mixed[cell]
    known, cell = known[mine], cell[mine]
    z, s = matched.ravel()[known].astype(np.float64), np.nan_to_num(heights.score.ravel()[known]).astype(np.float64)
    mixed_cells, number = np.unique(cell, return_inverse=True)
    low, high = (np.full(len(mixed_cells), limit) for limit in (np.inf, -np.inf))
    np.minimum.at(low, number, z)
    np.maximum.at(high, number, z)
    above = z >= 0.5 * (low + high)[number]
    part = [np.bincount(number[side], minlength=len(low)) for side in (above, ~above)]
    means = [
        np.bincount(number[side], values[side], len(low)) / np.maximum(some, 1)
        for values in (z, s)
        for side, some in zip((above, ~above), part)
    ]
    two = (high - low > step) & (np.minimum(*part) >= least_share * (part[0] + part[1]))
    upper, lower, upper_score, lower_score = (mean[two] for mean in means)
    return _Pairs(mixed_cells[two], high[two], upper, lower, (upper_score, lower_score))


def _blocked(
    grid: CellGrid, top: FloatArray, pairs: _Pairs, ray: Tuple[float, float], step: float, along: Tuple[float, ...]
) -> Tuple[Mask, Mask]:
    """(N,) whether the line of sight to the lower surface is below others on its way up to the upper one; and where
    that says something, because it leaves its cell.

    ``top`` (rows, columns) is the highest of each cell; ``along`` are shares of the way up.
    """
    rows, columns = grid.shape
    row, column = np.divmod(pairs.cell, columns)
    blocked, leaves = np.zeros(len(row), dtype=bool), np.ones(len(row), dtype=bool)
    for share in along:
        up = share * (pairs.upper - pairs.lower)
        c = np.rint(column + up * ray[0] / grid.cell).astype(np.int64)
        r = np.rint(row - up * ray[1] / grid.cell).astype(np.int64)
        inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
        there = top[np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)]
        leaves &= (r != row) | (c != column)
        with np.errstate(invalid="ignore"):
            blocked |= inside & (there > pairs.lower + up + step)
    return blocked, leaves
