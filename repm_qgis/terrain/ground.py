"""The surface of the ground through the cells that show it: smooth where there is none, and by their weights else.

It minimises the sum of w (z - h)^2 over the cells with a height h and weight w, and of s (z - z')^2 over all pairs of
neighbours: a stretched membrane, which under a building is Laplace's. It is solved on ever finer levels, each from the
one before with a few relaxations (cascadic multigrid: Bornemann and Deuflhard 1996, Numer. Math. 75). The coarse levels
are those of the whole DSM; on the finer ones a cell depends on few neighbours, so these are done block by block.
"""

from __future__ import annotations

from typing import List, Tuple

import numpy as np

from ..arrays import FloatArray
from ..geometry.levels import doubled, halved
from .parameters import TERRAIN, GroundParameters

Sums = Tuple[FloatArray, FloatArray]
"""(rows, columns) of a level: the sum of the weighted heights in each of its cells (m), and that of the weights."""


def levels_of(sums: Sums, count: int) -> List[Sums]:
    """A level, and so many coarser ones."""
    found = [sums]
    for _ in range(count):
        found.append((halved(found[-1][0]), halved(found[-1][1])))
    return found


def whole_surface(sums: Sums, stiffness: float, parameters: GroundParameters = TERRAIN.ground) -> FloatArray:
    """The surface (rows, columns) of a level for all of the ground, m; the weights must not all be zero."""
    levels = [sums]
    while max(levels[-1][0].shape) > 4:
        levels.append((halved(levels[-1][0]), halved(levels[-1][1])))
    weighted, weights = levels[-1]
    start = np.full(weighted.shape, weighted.sum() / weights.sum())
    surface = _relaxed(start, levels[-1], stiffness, parameters.coarsest_relaxations)
    return finer_surface(surface, levels[:-1], stiffness, parameters)


def finer_surface(
    surface: FloatArray, levels: List[Sums], stiffness: float, parameters: GroundParameters = TERRAIN.ground
) -> FloatArray:
    """The surface on the first of the levels from that on the level that follows the last one."""
    for level in reversed(levels):
        surface = _relaxed(finer(surface, level[0].shape), level, stiffness, parameters.relaxations)
    return surface


def reach(level: int, parameters: GroundParameters = TERRAIN.ground) -> int:
    """How many cells around a cell of the finest level its height depends on, below the surface of a level."""
    return sum((parameters.relaxations + 2) << step for step in range(level)) + (2 << level)


def finer(values: FloatArray, shape: Tuple[int, ...]) -> FloatArray:
    """Values of cells on cells of half the side, bilinear between the cells' centres, and level beyond the border."""
    return np.ascontiguousarray(doubled(np.pad(values, 1, mode="edge"), shape))


def _relaxed(surface: FloatArray, sums: Sums, stiffness: float, times: int) -> FloatArray:
    """Jacobi's iterations, whose result does not depend on the order of the cells."""
    weighted, weights = sums
    under = weights + 4 * stiffness
    for _ in range(times):
        padded = np.pad(surface, 1, mode="edge")
        beside = (padded[:-2, 1:-1] + padded[2:, 1:-1]) + (padded[1:-1, :-2] + padded[1:-1, 2:])
        surface = (weighted + stiffness * beside) / under
    return surface
