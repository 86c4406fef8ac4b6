"""The surface of the ground through the cells that show it: smooth between them, and weighted by their expected errors.

It minimises the sum of w (z - h)^2 over the cells with a height h and weight w, and of s (z - z')^2 + 2 s f z over all
neighbours z': a stretched membrane, whose Laplacian is f where no height holds it. Where the ground is seen, f is its
own Laplacian; below a house it goes on and fades away, so that hill tops below houses are not cut off, and depressions
are not filled. This is a spline in tension (Smith and Wessel 1990, Geophysics 55) without a system of the fourth order.

It is solved on ever finer levels, each from the
one before with a few relaxations (cascadic multigrid: Bornemann and Deuflhard 1996, Numer. Math. 75). The coarse levels
are those of the whole DSM; on the finer ones a cell depends on few neighbours, so these are done block by block.
"""

from __future__ import annotations

from typing import List, Tuple

import numpy as np
from scipy import ndimage

from ..contracts.arrays import FloatArray, Mask
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


def whole_surface(
    sums: Sums, laplacian: FloatArray, stiffness: float, parameters: GroundParameters = TERRAIN.ground
) -> FloatArray:
    """The surface (rows, columns) of a level for all of the ground, m; the weights must not all be zero.

    ``laplacian`` is what a cell's four neighbours, less four times the cell, should be where no height says, m.
    """
    levels, laplacians = [sums], [laplacian]
    while max(laplacians[-1].shape) > 4:
        levels.append((halved(levels[-1][0]), halved(levels[-1][1])))
        laplacians.append(halved(laplacians[-1]))  # on twice the distance, four times the mean
    weighted, weights = levels.pop()
    surface = np.full(weighted.shape, weighted.sum() / weights.sum())
    surface = _relaxed(surface, (weighted, weights), laplacians.pop(), stiffness, parameters.coarsest_relaxations)
    while levels:
        surface = finer(surface, laplacians[-1].shape)
        surface = _relaxed(surface, levels.pop(), laplacians.pop(), stiffness, parameters.relaxations)
    return surface


def finer_surface(
    surface: FloatArray,
    laplacian: FloatArray,
    levels: List[Sums],
    stiffness: float,
    parameters: GroundParameters = TERRAIN.ground,
) -> FloatArray:
    """The surface on the first of the levels from that, and its Laplacian, on the level that follows the last one."""
    for level in reversed(levels):
        surface, laplacian = (finer(values, level[0].shape) for values in (surface, laplacian))
        laplacian /= 4
        surface = _relaxed(surface, level, laplacian, stiffness, parameters.relaxations)
    return surface


def laplacian_of(
    height: FloatArray, seen: Mask, cell: float, parameters: GroundParameters = TERRAIN.ground
) -> FloatArray:
    """The Laplacian of a surface (m, see :func:`whole_surface`) where the ground is seen with all four neighbours, and
    elsewhere that of the ground around, which fades away with the distance; ``cell`` is the side of a cell, m."""
    known = ndimage.binary_erosion(seen).astype(np.float64)
    sums = ndimage.laplace(height, mode="nearest") * known, known + (parameters.curved_m / parameters.fading_m) ** 2
    return whole_surface(sums, np.zeros_like(height), (parameters.curved_m / cell) ** 2, parameters)


def reach(level: int, parameters: GroundParameters = TERRAIN.ground) -> int:
    """How many cells around a cell of the finest level its height depends on, below the surface of a level."""
    return sum((parameters.relaxations + 2) << step for step in range(level)) + (2 << level)


def finer(values: FloatArray, shape: Tuple[int, ...]) -> FloatArray:
    """Values of cells on cells of half the side, bilinear between the cells' centres; beyond the border they go on as
    steeply as they reach it."""
    return np.ascontiguousarray(doubled(_with_rim(values), shape))


def _with_rim(values: FloatArray) -> FloatArray:
    """With a cell more on each side, which continues the slope: terrain does not become level at the DSM's border."""
    return np.pad(values, 1, mode="reflect", reflect_type="odd")


def _relaxed(surface: FloatArray, sums: Sums, laplacian: FloatArray, stiffness: float, times: int) -> FloatArray:
    """Jacobi's iterations, whose result does not depend on the order of the cells."""
    weighted, weights = sums
    pulled, under = weighted.copy(), weights + 4 * stiffness
    pulled[1:-1, 1:-1] -= stiffness * laplacian[1:-1, 1:-1]  # beyond the border there is nothing to bend towards
    for _ in range(times):
        padded = _with_rim(surface)
        beside = (padded[:-2, 1:-1] + padded[2:, 1:-1]) + (padded[1:-1, :-2] + padded[1:-1, 2:])
        surface = (pulled + stiffness * beside) / under
    return surface
