"""One height for each cell of a town, chosen among all that may be there.

Up to here each cell has its own maps alone for witnesses, and all of them may be wrong alike: in a deep shadow there is
nothing to match, and every pair continues the roof into it. A cell's height is chosen from its own candidates, the
ground in a shadow, and the heights of its neighbours, as the one with the least sum of

- what the maps have against it (``aggregation.py``), in units of a map's evidence. Pairs share images, so that the sum
  of n maps counts as the root of n;
- how far it lies from the heights around it, carried on along the slope there, in a truncated linear norm (Boykov,
  Veksler and Zabih 2001, "Fast approximate energy minimization via graph cuts"), each weighted by how alike the images
  show the two cells, as in adaptive support weights (Yoon and Kweon 2006);
- at steps, how little the cell looks like the surface whose height it would have: the negative logarithm of its
  brightness's density among the cells of that surface within some metres (a kernel estimate, as in "GrabCut", Rother,
  Kolmogorov and Blake 2004). This is what tells a roof from the shadow beside it.

All cells are decided at once, sweep after sweep (Besag's iterated conditional modes, 1986), and neighbours pass their
heights on (as in PatchMatch stereo, Bleyer, Rhemann and Rother 2011). A sweep depends on cells within a fixed reach, so
that heights do not depend on the blocks in which they are made. Level ground and relief without steps stay as they are,
and so does all of a scene without walls (``walls.py``): there these terms would take away relief.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import cv2
import numpy as np

from ..arrays import FloatImage, IntArray, Mask
from .aggregation import FusedCells, objection
from .parameters import FUSION, ChoiceParameters, EvidenceParameters

_NEIGHBOURS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)
_NOTHING, _INFINITE = np.float32(np.nan), np.float32(np.inf)
Offsets = Sequence[Tuple[int, int]]
Witness = Tuple[FloatImage, FloatImage, FloatImage]
"""(N,) heights of cells (m), the evidence for them, and their standard deviations (m)."""


@dataclass(frozen=True)
class Problem:
    """The cells of a grid of the side ``cell`` (m): what their maps say, the ``ground`` of shadows (H, W) (m, NaN =
    none), and their ``brightness`` (H, W), NaN = unknown (:func:`.brightness.brightness`)."""

    fused: FusedCells
    ground: FloatImage
    brightness: FloatImage
    cell: float
    evidence: EvidenceParameters = FUSION.evidence
    parameters: ChoiceParameters = FUSION.choice

    def witnesses(self, cells: IntArray) -> List[Witness]:
        """What speaks for the candidates of (N,) cells, and for the ground. In a shadow the images show little, so that
        maps have less evidence there."""
        ground, p = self.ground.ravel()[cells], self.evidence
        shaded = np.isfinite(ground)
        less = np.where(shaded, np.float32(p.in_shadow), np.float32(1))
        found = []
        for each in (self.fused.first, self.fused.second):
            height, evidence, sigma = (part.ravel()[cells] for part in (each.height, each.evidence, each.sigma))
            found.append((height, evidence * less, sigma))
        return [*found, (ground, shaded.astype(np.float32), np.full(len(cells), p.ground_m, np.float32))]


def reach_cells(cell: float, parameters: ChoiceParameters = FUSION.choice) -> int:
    """How many cells away from a cell of the side ``cell`` (m) its height may depend on, in all sweeps."""
    return parameters.sweeps * _farthest(_near(cell, parameters), _far(cell, parameters))


def chosen(problem: Problem) -> FloatImage:
    """(H, W) heights, m; NaN where no map has a height and no shadow lies on ground."""
    height = np.where(np.isfinite(problem.ground), problem.ground, problem.fused.height)
    sweeper = _Sweeper(problem, height)
    asked = sweeper.uneven(height)
    for _ in range(problem.parameters.sweeps):
        cells = np.flatnonzero(asked)
        found = sweeper.sweep(height, cells)
        moved = np.zeros(height.shape, np.uint8)
        moved.ravel()[cells] = found != height.ravel()[cells]
        if not moved.any():
            break
        height = height.copy()
        height.ravel()[cells] = found
        asked = (cv2.dilate(moved, sweeper.around) > 0) & (asked | sweeper.uneven(height))
    return height


def near_reach(cell: float, parameters: ChoiceParameters = FUSION.choice) -> int:
    """Half the side of the window of a cell's neighbours, in cells of the side ``cell`` (m)."""
    return max(1, min(round(parameters.near_m / cell), parameters.near_cells))


def _near(cell: float, parameters: ChoiceParameters) -> Offsets:
    """The cells around a cell whose heights its own should have."""
    reach = near_reach(cell, parameters)
    places = range(-reach, reach + 1)
    return [(down, right) for down in places for right in places if down or right]


def _far(cell: float, parameters: ChoiceParameters) -> Offsets:
    """The places around a cell that show what the surfaces there look like: rings, the directions of which differ."""
    places = []
    for number, radius in enumerate(parameters.rings_m):
        cells = min(radius / cell, parameters.far_cells)
        for k in range(parameters.directions):
            turn = 2 * math.pi * (k + 0.5 * (number % 2)) / parameters.directions
            places.append((round(cells * math.sin(turn)), round(cells * math.cos(turn))))
    return sorted(set(places) - {(0, 0)})


def _farthest(*offsets: Offsets) -> int:
    """How many rows or columns away the farthest place is."""
    return max(max(map(abs, place)) for part in offsets for place in part)


class _Sweeper:
    """Decides cells of a problem, given the heights of all others."""

    def __init__(self, problem: Problem, start: FloatImage) -> None:
        p, self._problem = problem.parameters, problem
        self._near, self._far = _near(problem.cell, p), _far(problem.cell, p)
        self._rim = _farthest(self._near, self._far)
        self._width = problem.brightness.shape[1] + 2 * self._rim
        self._brightness = self._padded(problem.brightness)
        squares = np.array([down**2 + right**2 for down, right in self._near], np.float32)
        self._closeness = np.exp(-squares * np.float32((problem.cell / p.near_m) ** 2 / 2))[:, None]
        reach = near_reach(problem.cell, p)
        self.around = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        level, steepest = p.level * problem.cell, p.steepest * problem.cell
        self._slopes = [_slope(start, axis, reach, level, steepest) for axis in (0, 1)]
        self._limits = np.float32(1) / np.sqrt(np.maximum(problem.fused.evidence, np.float32(1)))

    def uneven(self, height: FloatImage) -> Mask:
        """(H, W) known cells with other candidates, or with a neighbour at another height."""
        p, known = self._problem.parameters, np.isfinite(height)
        low, high = extremes(height, known)
        others = np.isfinite(self._problem.fused.second.height) | np.isfinite(self._problem.ground)
        with np.errstate(invalid="ignore", over="ignore"):
            result: Mask = known & ((high - low > p.scale_m) | others)
        return result

    def sweep(self, height: FloatImage, cells: IntArray) -> FloatImage:
        """(N,) the heights of cells with the least cost, given the present heights (H, W)."""
        p = self._problem.parameters
        padded = self._padded(height)
        low, _ = extremes(height, np.isfinite(height))
        with np.errstate(invalid="ignore"):
            front = (height - low > p.step_m).ravel()[cells]
        result = np.empty(len(cells), np.float32)
        for first in range(0, len(cells), p.at_once):
            part = slice(first, first + p.at_once)
            result[part] = self._decided(padded, cells[part], front[part])
        return result

    def _decided(self, padded: FloatImage, cells: IntArray, front: Mask) -> FloatImage:
        p, problem = self._problem.parameters, self._problem
        row, column = np.divmod(cells, problem.brightness.shape[1])
        place = (row + self._rim) * self._width + column + self._rim
        own = padded.ravel()[place]
        candidates = [own, problem.fused.first.height.ravel()[cells], problem.fused.second.height.ravel()[cells]]
        candidates.append(problem.ground.ravel()[cells])
        slopes = [slope.ravel()[cells] for slope in self._slopes]
        for neighbour in _NEIGHBOURS:
            there = padded.ravel()[place + neighbour[0] * self._width + neighbour[1]]
            candidates.append(there - _rise(slopes, neighbour))
        witnesses = problem.witnesses(cells)
        around, alike = self._surroundings(padded, place, self._near)
        for height, offset in zip(around, self._near):
            height -= _rise(slopes, offset)
        alike = np.where(np.isnan(alike), np.float32(math.exp(-1.0)), alike) * self._closeness
        alike[np.isnan(around)] = 0
        around = np.nan_to_num(around)
        alike /= np.maximum(alike.sum(axis=0), np.float32(1e-6))
        seen = self._surroundings(padded, place[front], self._far)
        limits = self._limits.ravel()[cells]
        least = np.full(len(cells), _INFINITE)
        best: FloatImage = own.copy()
        for candidate in candidates:
            cost = np.zeros(len(cells), np.float32)
            for witness in witnesses:
                cost += objection(candidate, *witness, problem.evidence)
            cost *= limits
            away = np.abs(around - candidate)
            away *= np.float32(1 / p.scale_m)
            np.minimum(away, np.float32(p.most), out=away)
            away *= alike
            cost += np.float32(p.smoothness) * away.sum(axis=0)
            cost[front] += np.float32(p.appearance) * self._unlike(candidate[front], *seen)
            better = cost < least - np.float32(1e-6)
            least, best = np.where(better, cost, least), np.where(better, candidate, best)
        return best

    def _unlike(self, candidate: FloatImage, around: FloatImage, alike: FloatImage) -> FloatImage:
        """(N,) the negative logarithm of how alike a cell is to those around that have the candidate's surface."""
        p = self._problem.parameters
        with np.errstate(invalid="ignore"):
            same = (np.abs(around - candidate) < p.step_m) & np.isfinite(alike)
        count = same.sum(axis=0)
        # Laplace's rule of succession: of a surface that no cell shows, half may look like this one.
        share = (np.where(same, alike, np.float32(0)).sum(axis=0) + 1) / (count + 2)
        cost: FloatImage = -np.log(share).astype(np.float32)
        return cost

    def _surroundings(self, padded: FloatImage, place: IntArray, offsets: Offsets) -> Tuple[FloatImage, FloatImage]:
        """(offsets, N) the heights around cells, and how alike the images show them, 0 to 1, NaN = unknown."""
        light = self._brightness.ravel()
        shape = len(offsets), len(place)
        around, alike = np.empty(shape, np.float32), np.empty(shape, np.float32)
        own = light[place]
        for k, (down, right) in enumerate(offsets):
            there = place + (down * self._width + right)
            around[k] = padded.ravel()[there]
            alike[k] = light[there]
        alike -= own
        np.abs(alike, out=alike)
        alike *= np.float32(-1 / self._problem.parameters.contrast)
        np.exp(alike, out=alike)
        return around, alike

    def _padded(self, values: FloatImage) -> FloatImage:
        padded: FloatImage = np.pad(values.astype(np.float32), self._rim, constant_values=_NOTHING)
        return padded


def _rise(slopes: Sequence[FloatImage], offset: Tuple[int, int]) -> FloatImage:
    """(N,) by how much the ground rises from cells to those so many rows and columns away, m."""
    rise: FloatImage = np.float32(offset[0]) * slopes[0] + np.float32(offset[1]) * slopes[1]
    return rise


def _slope(height: FloatImage, axis: int, reach: int, level: float, steepest: float) -> FloatImage:
    """(H, W) the mean difference between neighbours along an axis, m a cell, of the surface around each cell: larger
    differences than ``steepest`` are steps between surfaces, and have no part in it; what rises by less than ``level``
    is level."""
    difference = np.diff(height, axis=axis, append=np.float32(np.nan))
    with np.errstate(invalid="ignore"):
        known = np.abs(difference) < steepest
    sums = [np.where(known, difference, np.float32(0)), known.astype(np.float32)]
    for along in (0, 1):
        sums = [_running_sum(part, along, reach) for part in sums]
    slope: FloatImage = sums[0] / np.maximum(sums[1], np.float32(1))
    return np.where(np.abs(slope) < level, np.float32(0), slope)


def _running_sum(values: FloatImage, axis: int, reach: int) -> FloatImage:
    """The sum of values up to so many places away along an axis, in an order that is the same everywhere."""
    rows, columns = values.shape
    wide = np.pad(values, [(reach, reach) if along == axis else (0, 0) for along in (0, 1)])
    total = np.zeros_like(values)
    for step in range(2 * reach + 1):
        total += wide[step : step + rows] if axis == 0 else wide[:, step : step + columns]
    return total


def extremes(height: FloatImage, known: Mask, reach: int = 1) -> Tuple[FloatImage, FloatImage]:
    """(H, W) the lowest and the highest known height up to so many rows and columns away from each cell."""
    around = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    low = cv2.erode(np.where(known, height, _INFINITE), around)
    high = cv2.dilate(np.where(known, height, -_INFINITE), around)
    return low, high
