"""A hole filled from its rim with the membrane that is stretched over it: Laplace's equation with the rim's heights.

This is the guided interpolation of Pérez, Gangnet and Blake 2003 (ACM Transactions on Graphics 22-3) without a guidance
field: no height within is above the highest of the rim or below the lowest, and there are no parameters to choose. Each
cell is the mean of its four neighbours; beyond the raster's border, and beside cells without a height, there is none.

The system is solved with conjugate gradients and one cycle over ever coarser grids as preconditioner (Braess 1995,
Computing 55): a coarse cell stands for 2 x 2 cells, and half of the links that cross its border are its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Mask
from ..geometry.levels import halved
from .parameters import EDITING, EditingParameters

_SMALLEST = 4  # cells a side of the coarsest grid
_DAMPING = 0.8
_SWEEPS, _LAST_SWEEPS = 2, 40


def filled(height: FloatImage, hole: Mask, parameters: EditingParameters = EDITING) -> Tuple[FloatArray, Mask]:
    """The heights of a hole (H, W), and which of its cells the rim reaches; elsewhere the heights are 0.

    ``height`` (H, W) m, NaN = none; what it has within the ``hole`` does not count.
    """
    known = np.isfinite(height) & ~hole
    rim, links = _beside(np.where(known, height, 0.0).astype(np.float64)), _beside(known.astype(np.float64))
    reached = _reached(hole, hole & (links > 0))
    if not reached.any():
        return np.zeros(hole.shape), reached
    ends = height[known & (_beside(reached.astype(np.float64)) > 0)]
    lowest, highest = float(ends.min()), float(ends.max())
    middle = 0.5 * (lowest + highest)  # of small numbers the sums are more exact
    level = _Level.of(reached, np.where(reached, links, 0.0))
    pulled = np.where(reached, rim - links * middle, 0.0)
    solved = _solved(level, pulled, parameters) + middle
    return np.where(reached, np.clip(solved, lowest, highest), 0.0), reached


def relaxed(height: FloatImage, hole: Mask, start: FloatArray, times: int) -> FloatArray:
    """Some of the relaxations of a hole that has a good ``start`` (H, W): each depends on one more cell around it."""
    known = np.isfinite(height) & ~hole
    used = (known | hole).astype(np.float64)
    count = np.maximum(_beside(used), 1.0)
    surface = np.where(hole, start, np.where(known, height, 0.0)).astype(np.float64)
    for _ in range(times):
        surface = np.where(hole, _beside(surface) / count, surface)
    return surface


def _beside(values: FloatArray) -> FloatArray:
    """The sum of the four neighbours; beyond the border there is nothing."""
    total = np.zeros_like(values)
    total[1:] += values[:-1]
    total[:-1] += values[1:]
    total[:, 1:] += values[:, :-1]
    total[:, :-1] += values[:, 1:]
    return total


def _reached(hole: Mask, start: Mask) -> Mask:
    """The cells of a hole that are connected with the start: swept in four directions until nothing is new."""
    found, before = start.copy(), -1
    while before != (before := int(found.sum())):
        ways = (found, hole), (found[::-1], hole[::-1]), (found.T, hole.T), (found.T[::-1], hole.T[::-1])
        for mask, inside in ways:
            for row in range(1, len(mask)):
                mask[row] |= mask[row - 1] & inside[row]
    return found


@dataclass(frozen=True)
class _Level:
    """A grid's system: weights of the links to the right neighbour (H, W - 1) and the lower one (H - 1, W), and the
    cell's own sum of all weights, those to the rim among them; 0 for cells that are not solved."""

    right: FloatArray
    below: FloatArray
    own: FloatArray

    @classmethod
    def of(cls, unknown: Mask, rim: FloatArray) -> _Level:
        right = (unknown[:, 1:] & unknown[:, :-1]).astype(np.float64)
        below = (unknown[1:] & unknown[:-1]).astype(np.float64)
        return cls.with_own(right, below, rim)

    @classmethod
    def with_own(cls, right: FloatArray, below: FloatArray, rim: FloatArray) -> _Level:
        own = rim.copy()
        own[:, :-1] += right
        own[:, 1:] += right
        own[:-1] += below
        own[1:] += below
        return cls(right, below, own)

    @property
    def inverse(self) -> FloatArray:
        return np.divide(1.0, self.own, out=np.zeros_like(self.own), where=self.own > 0)

    def neighbours(self, values: FloatArray) -> FloatArray:
        """The weighted sum of the neighbours."""
        total = np.zeros_like(values)
        total[:, :-1] += self.right * values[:, 1:]
        total[:, 1:] += self.right * values[:, :-1]
        total[:-1] += self.below * values[1:]
        total[1:] += self.below * values[:-1]
        return total

    def applied(self, values: FloatArray) -> FloatArray:
        return self.own * values - self.neighbours(values)

    def coarser(self) -> _Level:
        rim = self.applied(np.ones_like(self.own))  # the rest of the sum, without the links inside
        crossing = self.right[:, 1::2], self.below[1::2].T  # links between cells of different coarse ones
        right, below = (np.add.reduceat(links, range(0, len(links), 2)) for links in crossing)
        return self.with_own(0.5 * right, 0.5 * below.T, 0.5 * halved(rim))


def _solved(level: _Level, pulled: FloatArray, parameters: EditingParameters) -> FloatArray:
    """Conjugate gradients; the preconditioned residual, which is about the error, says when it is enough."""
    levels = [level]
    while max(levels[-1].own.shape) > _SMALLEST:
        levels.append(levels[-1].coarser())
    found, residual = np.zeros_like(pulled), pulled
    direction, before = np.zeros_like(pulled), 1.0
    for _ in range(parameters.most_iterations):
        error = _cycle(levels, residual)
        if float(np.abs(error).max()) <= parameters.accurate_m:
            return found + error
        product = float(np.sum(error * residual))
        direction = error + (product / before) * direction
        applied = level.applied(direction)
        step = product / float(np.sum(direction * applied))
        found, residual, before = found + step * direction, residual - step * applied, product
    return found


def _cycle(levels: List[_Level], residual: FloatArray) -> FloatArray:
    """About the error that leaves this residual: smoothed, with that of the coarser grids in between."""
    level, rest = levels[0], levels[1:]
    inverse = _DAMPING * level.inverse
    error: FloatArray = inverse * residual
    for _ in range((_SWEEPS if rest else _LAST_SWEEPS) - 1):
        error = error + inverse * (residual - level.applied(error))
    if not rest:
        return error
    coarse = _cycle(rest, halved(residual - level.applied(error)))
    rows, columns = error.shape
    step = coarse.repeat(2, axis=0)[:rows].repeat(2, axis=1)[:, :columns]
    error = error + np.where(level.own > 0, step, 0.0)
    for _ in range(_SWEEPS):
        error = error + inverse * (residual - level.applied(error))
    return error
