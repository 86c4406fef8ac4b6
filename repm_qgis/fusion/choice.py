"""One height for each cell of a town, chosen among its possible heights. Until this step a cell only has the height
maps as observations, and all of them may have the same error: in a deep shadow there is no texture to match, and every
pair continues the roof into it. A cell's height is chosen from its own candidates, the ground in a shadow, and the
heights of its neighbours, as the one with the least sum of

- the cost of the maps' observations (``aggregation.py``), in units of a map's evidence. Pairs share images, so that the
sum
  of n maps counts as the root of n;
- how far it lies from the heights around it, in a truncated linear norm (Boykov, Veksler and Zabih 2001, "Fast
  approximate energy minimization via graph cuts"), each weighted by the similarity of the two cells' intensities, as in
  adaptive support weights (Yoon and Kweon 2006);
- at steps, how little the cell resembles the surface whose height it would have: the negative logarithm of the density
of its intensity among the cells of that surface within some metres (a kernel estimate, as in "GrabCut", Rother,
  Kolmogorov and Blake 2004). This term separates a roof from the shadow beside it.

All cells are decided at once, sweep after sweep (Besag's iterated conditional modes, 1986), and neighbours pass their
heights on (as in PatchMatch stereo, Bleyer, Rhemann and Rother 2011). A sweep depends on cells within a fixed reach, so
that heights do not depend on the blocks in which they are made. Ground without steps stays as it is, and so does all of
a scene without walls (``walls.py``): there these terms would flatten relief.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, IntArray, Mask
from .aggregation import FusedCells, disagreement
from .parameters import FUSION, ChoiceParameters, EvidenceParameters
from .surroundings import Offsets, extremes, farthest, others, places

_NEIGHBOURS = ((-1, 0), (0, -1), (0, 1), (1, 0))
_AT_ONCE = 1 << 13  # cells whose arrays fit into a processor's cache
_NOTHING, _INFINITE = np.float32(np.nan), np.float32(np.inf)
Observation = Tuple[FloatImage, FloatImage, FloatImage]
"""(N,) heights of cells (m), the evidence for them, and their standard deviations (m)."""


@dataclass(frozen=True)
class Problem:
    """The cells of a grid of the side ``cell`` (m): what their maps give, the ``ground`` of shadows (H, W) (m, NaN =
    none), and their ``brightness`` (H, W), NaN = unknown (:func:`.brightness.brightness`)."""

    fused: FusedCells
    ground: FloatImage
    brightness: FloatImage
    cell: float
    evidence: EvidenceParameters = FUSION.evidence
    parameters: ChoiceParameters = FUSION.choice

    def observations(self, cells: IntArray) -> List[Observation]:
        """The observations of (N,) cells: their candidates, and the ground. In a shadow the images show little, so that
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
    return parameters.sweeps * max(near_reach(cell, parameters), farthest(places(parameters.far_m, cell)))


def chosen(problem: Problem) -> FloatImage:
    """(H, W) heights, m; NaN where no map has a height and no ground in a shadow is known."""
    height = np.where(np.isfinite(problem.ground), problem.ground, problem.fused.height)
    sweeper = _Sweeper(problem)
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
    return farthest(places(parameters.near_m, cell))


class _Sweeper:
    """Decides cells of a problem, given the heights of all others."""

    def __init__(self, problem: Problem) -> None:
        p, self._problem = problem.parameters, problem
        self._near, self._far = (others(places(reach, problem.cell)) for reach in (p.near_m, p.far_m))
        self._rim = farthest([*self._near, *self._far])
        self._width = problem.brightness.shape[1] + 2 * self._rim
        self._brightness = self._padded(problem.brightness)
        squares = np.array([down**2 + right**2 for down, right in self._near], np.float32)
        self._closeness = np.exp(-squares * np.float32((problem.cell / p.near_m) ** 2 / 2))[:, None]
        side = 2 * near_reach(problem.cell, p) + 1
        self.around = np.ones((side, side), np.uint8)
        self._limits = np.float32(1) / np.sqrt(np.maximum(problem.fused.evidence, np.float32(1)))

    def uneven(self, height: FloatImage) -> Mask:
        """(H, W) known cells with other candidates, or with a neighbour at another height."""
        p, known = self._problem.parameters, np.isfinite(height)
        low, high = extremes(height, known)
        choice = np.isfinite(self._problem.fused.second.height) | np.isfinite(self._problem.ground)
        with np.errstate(invalid="ignore", over="ignore"):
            result: Mask = known & ((high - low > p.scale_m) | choice)
        return result

    def sweep(self, height: FloatImage, cells: IntArray) -> FloatImage:
        """(N,) the heights of cells with the least cost, given the present heights (H, W)."""
        p = self._problem.parameters
        padded = self._padded(height)
        low, _ = extremes(height, np.isfinite(height))
        with np.errstate(invalid="ignore"):
            front = (height - low > p.step_m).ravel()[cells]
        result = np.empty(len(cells), np.float32)
        for first in range(0, len(cells), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            result[part] = self._decided(padded, cells[part], front[part])
        return result

    def _decided(self, padded: FloatImage, cells: IntArray, front: Mask) -> FloatImage:
        p, problem = self._problem.parameters, self._problem
        row, column = np.divmod(cells, problem.brightness.shape[1])
        place = (row + self._rim) * self._width + column + self._rim
        own = padded.ravel()[place]
        candidates = [own, problem.fused.first.height.ravel()[cells], problem.fused.second.height.ravel()[cells]]
        candidates.append(problem.ground.ravel()[cells])
        candidates += [padded.ravel()[place + down * self._width + right] for down, right in _NEIGHBOURS]
        observations = problem.observations(cells)
        around, alike = self._surroundings(padded, place, self._near)
        alike = np.where(np.isnan(alike), np.float32(math.exp(-1.0)), alike) * self._closeness
        alike[np.isnan(around)] = 0
        around = np.nan_to_num(around)
        alike /= np.maximum(alike.sum(axis=0), np.float32(1e-6))
        far, far_alike = self._surroundings(padded, place[front], self._far)
        limits = self._limits.ravel()[cells]
        least = np.full(len(cells), _INFINITE)
        best: FloatImage = own.copy()
        for candidate in candidates:
            cost = np.zeros(len(cells), np.float32)
            for height, evidence, sigma in observations:
                cost += disagreement(candidate, height, evidence, sigma, problem.evidence)
            cost *= limits
            away = np.abs(around - candidate)
            away *= np.float32(1 / p.scale_m)
            np.minimum(away, np.float32(p.most), out=away)
            away *= alike
            cost += np.float32(p.smoothness) * away.sum(axis=0)
            cost[front] += np.float32(p.appearance) * self._unlike(candidate[front], far, far_alike)
            better = cost < least - np.float32(1e-6)
            least, best = np.where(better, cost, least), np.where(better, candidate, best)
        return best

    def _unlike(self, candidate: FloatImage, around: FloatImage, alike: FloatImage) -> FloatImage:
        """(N,) the negative logarithm of a cell's similarity to the cells around it that have the candidate's
        surface."""
        p = self._problem.parameters
        with np.errstate(invalid="ignore"):
            same = (np.abs(around - candidate) < p.step_m) & np.isfinite(alike)
        count = same.sum(axis=0)
        # Laplace's rule of succession: a surface without any cell has the similarity of one half.
        share = (np.where(same, alike, np.float32(0)).sum(axis=0) + 1) / (count + 2)
        cost: FloatImage = -np.log(share).astype(np.float32)
        return cost

    def _surroundings(self, padded: FloatImage, place: IntArray, offsets: Offsets) -> Tuple[FloatImage, FloatImage]:
        """(offsets, N) the heights around cells, and the similarity of their intensities, 0 to 1, NaN = unknown."""
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
