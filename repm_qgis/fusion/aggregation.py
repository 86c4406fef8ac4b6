"""The heights that several maps give a cell, and the evidence for each of them (paper, "DSMs aggregation").

Each map is one observation. Its height has the standard deviation that matching leaves at its score, or is a gross
error. So the cost of a height that differs from a map's grows with the square of the difference, in standard
deviations, up to a limit (the truncated quadratic of Blake and Zisserman 1987, "Visual reconstruction"). Gross errors
are hardly recognised by their scores, but by their places: of matched heights 5 % are gross errors, of those beside a
step down or a hole of their own map 20 to 60 %, on real and simulated towns, mountains and three-line images alike.
Such heights have less evidence, and so have backgrounds of occlusions.

The height with the least cost is the first candidate of a cell; the height of the maps that contradict it is the second
one. ``choice.py`` decides between them, and neighbours, where the scene has walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Iterable, Optional, Sequence, Tuple, Union

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Floats, IntArray, Mask
from .parameters import FUSION, EvidenceParameters

_AROUND = np.ones((3, 3), np.uint8)
_SURER = np.float32(1e-3)  # of evidence for each m of a standard deviation
_ALIKE = np.float32(1e-5)  # of evidence: more than the order of sums changes


@dataclass(frozen=True)
class HeightLayer:
    """A height map on the cells: ``height`` (m, NaN = not matched) with its ``score``, ``background`` (m, NaN = none)
    where an occlusion hides the cell, the height of one px of disparity, and the ``spacing`` of pixels on the ground
    (m). ``partial`` cells are covered by matched points to less than half, ``partial_background`` by the background's
    (None: no cells are). ``alike``: of a map by learned features, how alike its images are, 1 for the most alike."""

    height: Floats
    score: Floats
    background: Floats
    metres_per_px: float
    spacing: float
    partial: Optional[Mask] = None
    partial_background: Optional[Mask] = None
    alike: Optional[float] = None

    @property
    def unit(self) -> float:
        """The unit of the standard deviations of heights, m: it falls with the root of the base only, because images of
        pairs with a wider base differ more (measured on towns, mountains, three-line images)."""
        return math.sqrt(self.metres_per_px * self.spacing)


@dataclass(frozen=True)
class Candidate:
    """A height of cells (m, NaN = none), all fields of one shape: the ``evidence`` for it (that of a matched height is
    1), the standard deviation ``sigma`` (m) of one of its maps, the ``count`` of maps that have it matched (0:
    backgrounds alone), their ``spread`` (m, NaN for one alone) and mean ``score``."""

    height: FloatImage
    evidence: FloatImage
    sigma: FloatImage
    count: FloatImage
    spread: FloatImage
    score: FloatImage

    @classmethod
    def none(cls, shape: Tuple[int, ...]) -> Candidate:
        """Without a height anywhere."""
        known = ("evidence", "count")
        return cls(**{name: np.full(shape, 0.0 if name in known else np.nan, np.float32) for name in _NAMES})

    @classmethod
    def of(cls, arrays: Iterable[FloatImage]) -> Candidate:
        """From the arrays of :meth:`arrays`."""
        return cls(**dict(zip(_NAMES, arrays)))

    def arrays(self) -> Tuple[FloatImage, ...]:
        """All fields, in their order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def without(self, cells: Mask) -> Candidate:
        """The same with no heights in some cells."""
        nothing = vars(Candidate.none(()))
        return Candidate(**{name: np.where(cells, nothing[name], values) for name, values in vars(self).items()})

    @property
    def filled(self) -> Mask:
        """Which heights are backgrounds: no map has them matched."""
        result: Mask = np.isfinite(self.height) & (self.count == 0)
        return result


_NAMES = tuple(field.name for field in fields(Candidate))
FIELDS = len(_NAMES)
"""How many arrays a candidate has."""


@dataclass(frozen=True)
class FusedCells:
    """What the maps give for cells: the ``first`` candidate, the ``second`` one, and the ``evidence`` of all maps."""

    first: Candidate
    second: Candidate
    evidence: FloatImage

    @classmethod
    def of(cls, arrays: Sequence[FloatImage]) -> FusedCells:
        """From the arrays of :meth:`arrays` or :meth:`without_choice`."""
        first, second, evidence = arrays[:FIELDS], arrays[FIELDS:-1], arrays[-1]
        return cls(Candidate.of(first), Candidate.of(second) if second else Candidate.none(evidence.shape), evidence)

    def arrays(self) -> Tuple[FloatImage, ...]:
        """All fields of both candidates and the evidence, in their order."""
        return (*self.first.arrays(), *self.second.arrays(), self.evidence)

    def without_choice(self) -> Tuple[FloatImage, ...]:
        """The same without the second candidates."""
        return (*self.first.arrays(), self.evidence)

    @property
    def height(self) -> FloatImage:
        """The first candidate's height, m; NaN = none."""
        return self.first.height

    def with_height(self, height: FloatImage) -> FusedCells:
        """The same with other heights of the first candidate."""
        return replace(self, first=replace(self.first, height=height))

    def without(self, cells: Mask) -> FusedCells:
        """The same with no candidates in some cells."""
        evidence = np.where(cells, np.float32(0), self.evidence)
        return FusedCells(self.first.without(cells), self.second.without(cells), evidence)

    def without_backgrounds(self) -> FusedCells:
        """The same where backgrounds are no candidates: a matched second one takes the place of a first one."""
        second, filled = self.second.without(self.second.filled), self.first.filled
        other = vars(second)
        first = Candidate(**{name: np.where(filled, other[name], own) for name, own in vars(self.first).items()})
        return replace(self, first=first, second=second.without(filled))


def rim_cells(spacing: float, cell: float, parameters: EvidenceParameters = FUSION.evidence) -> int:
    """How many cells of ``cell`` m matching may widen an object beyond its edge, with pixels of ``spacing`` m."""
    return max(1, round(parameters.rim_px * spacing / cell))


def aggregate(
    layers: Sequence[HeightLayer], method: str, rim: int, parameters: EvidenceParameters = FUSION.evidence
) -> FusedCells:
    """The candidates of cells from height maps on them.

    ``method`` is ``mean`` or ``median`` of the heights that agree, weighted by their inverse variances in both.
    ``rim`` is as of :func:`rim_cells`.
    """
    shape = layers[0].height.shape
    observations = _Observations.of(layers, rim, parameters)
    first, second = (Candidate.none((layers[0].height.size,)) for _ in range(2))
    known = np.flatnonzero(np.isfinite(observations.height).any(axis=0))
    every = observations.of_cells(known)
    mean = every.mean(np.isfinite(every.height))
    agreed = every.all_near(mean)
    _put(first, known[agreed], every.of_cells(agreed).described(mean[agreed], method))
    if not agreed.all():
        known, every = known[~agreed], every.of_cells(~agreed)
        _put(first, known, every.described(every.best(), method))
        rest = every.apart_from(first.height[known])
        other = np.isfinite(rest.height).any(axis=0)
        known, rest = known[other], rest.of_cells(other)
        _put(second, known, rest.described(rest.best(), method))
    arrays = (*first.arrays(), *second.arrays(), observations.evidence.sum(axis=0))
    return FusedCells.of([values.reshape(shape) for values in arrays])


def _put(target: Candidate, cells: IntArray, values: Candidate) -> None:
    for whole, part in zip(target.arrays(), values.arrays()):
        whole[cells] = part


@dataclass(frozen=True)
class _Observations:
    """The observations (maps, N) of N cells: ``height`` (m, NaN = none), ``evidence`` (0 = none),
    standard deviation ``sigma`` (m), its ``score``, and whether it is ``matched`` or a background."""

    height: FloatImage
    evidence: FloatImage
    sigma: FloatImage
    score: FloatImage
    matched: Mask
    parameters: EvidenceParameters

    @classmethod
    def of(cls, layers: Sequence[HeightLayer], rim: int, parameters: EvidenceParameters) -> _Observations:
        parts = zip(*(_observed(layer, rim, parameters) for layer in layers))
        height, evidence, sigma, score, matched = (np.stack([values.ravel() for values in part]) for part in parts)
        return cls(height, evidence, sigma, score, matched > 0, parameters)

    def of_cells(self, cells: Union[IntArray, Mask]) -> _Observations:
        """The same of some of the N cells."""
        height, evidence, sigma, score = (
            part[:, cells] for part in (self.height, self.evidence, self.sigma, self.score)
        )
        return _Observations(height, evidence, sigma, score, self.matched[:, cells], self.parameters)

    def mean(self, members: Mask) -> FloatImage:
        """(N,) the mean of the members' heights, weighted by their inverse variances; NaN without any."""
        total, value = np.zeros((2, members.shape[1]))
        for height, sigma, member in zip(self.height, self.sigma, members):
            weight = np.where(member, 1.0 / sigma.astype(np.float64) ** 2, 0.0)
            total += weight
            value += np.where(member, weight * height, 0.0)
        with np.errstate(invalid="ignore"):
            mean: FloatImage = (value / total).astype(np.float32)
        return mean

    def near(self, height: FloatImage) -> Mask:
        """(maps, N) which observations belong to the same surface as a height (m) of each cell."""
        with np.errstate(invalid="ignore"):
            result: Mask = np.abs(self.height - height) <= self.parameters.same * self.sigma
        return result

    def all_near(self, height: FloatImage) -> Mask:
        """(N,) where all observations lie so close to a height that none may belong to another surface."""
        with np.errstate(invalid="ignore"):
            far = np.abs(self.height - height) > 0.5 * self.parameters.same * self.sigma
        result: Mask = ~far.any(axis=0)
        return result

    def apart_from(self, height: FloatImage) -> _Observations:
        """The same without those that belong to the same surface as a height (m) of each cell."""
        return replace(self, height=np.where(self.near(height), np.float32(np.nan), self.height))

    def best(self) -> FloatImage:
        """(N,) the observed height with the least cost; NaN without any."""
        least = np.full(self.height.shape[1], np.inf, np.float32)
        result = np.full(least.shape, np.nan, np.float32)
        for candidate, sigma in zip(self.height, self.sigma):
            # Of two with equal cost, the more precise one, or else the lower one: so the order of the maps,
            # and of sums, does not matter.
            cost = np.where(np.isfinite(candidate), self._against(candidate) + _SURER * sigma, np.float32(np.inf))
            with np.errstate(invalid="ignore"):
                better = (cost < least - _ALIKE) | (cost < least + _ALIKE) & (candidate < result)
            least, result = np.where(better, cost, least), np.where(better, candidate, result)
        return result

    def _against(self, height: FloatImage) -> FloatImage:
        cost = np.zeros(height.shape, np.float32)
        for own, evidence, sigma in zip(self.height, self.evidence, self.sigma):
            cost += disagreement(height, own, evidence, sigma, self.parameters)
        return cost

    def described(self, height: FloatImage, method: str) -> Candidate:
        """The candidates on the surface of a height (m) of each cell: all observations of this surface are their
        maps."""
        members = self.near(height)
        matched = members & self.matched
        count = matched.sum(axis=0)
        mean = self.mean(members)
        weight = np.where(members, self.evidence, np.float32(0))
        evidence = weight.sum(axis=0)
        share = weight / np.maximum(evidence, np.float32(1e-9))
        deviation = (share * np.where(members, self.sigma, np.float32(0))).sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            score = np.where(matched, self.score, np.float32(0)).sum(axis=0) / count
            variance = np.where(matched, (self.height - mean) ** 2, np.float32(0)).sum(axis=0) / count
        spread = np.where(count > 1, np.sqrt(variance), np.float32(np.nan))
        if method == "median" and len(self.height) > 2:
            several = members.sum(axis=0) > 2
            inverse = np.where(members[:, several], 1.0 / self.sigma[:, several] ** 2, 0.0)
            mean[several] = _weighted_median(self.height[:, several], inverse)
        found = {"height": mean, "evidence": evidence, "sigma": deviation}
        found.update(count=count, spread=spread, score=score)
        return Candidate(**{name: values.astype(np.float32) for name, values in found.items()})


def disagreement(
    height: FloatImage, own: FloatImage, evidence: FloatImage, sigma: FloatImage, parameters: EvidenceParameters
) -> FloatImage:
    """(N,) the cost of heights (m) of N cells by an observation with its ``own`` heights (m, NaN = none): zero for its
    own height, its ``evidence`` for heights that are too far from it."""
    with np.errstate(invalid="ignore"):
        apart = (height - own) / (np.float32(parameters.same) * sigma)
    return np.where(np.isnan(apart), np.float32(0), evidence * np.minimum(apart * apart, np.float32(1)))


def _observed(layer: HeightLayer, rim: int, p: EvidenceParameters) -> Tuple[FloatImage, ...]:
    """Height, evidence, standard deviation and score of a map's cells, and which of them are matched."""
    height, background, score = (
        np.asarray(values, np.float32) for values in (layer.height, layer.background, layer.score)
    )
    known = np.isfinite(height)
    side = 2 * rim + 1
    lowest = cv2.erode(np.where(known, height, np.float32(np.inf)), np.ones((side, side), np.uint8))
    holes = cv2.dilate((~known).astype(np.uint8), _AROUND) > 0
    with np.errstate(invalid="ignore"):
        doubtful = (height - lowest > max(p.step_m, p.step_px * layer.metres_per_px)) | holes
    half, half_background = (False if part is None else part for part in (layer.partial, layer.partial_background))
    evidence = np.where(doubtful | half, np.float32(p.doubtful), np.float32(1))
    behind = np.float32(p.background) * np.where(half_background, np.float32(p.doubtful), np.float32(1))
    evidence = np.where(known, evidence, np.where(np.isfinite(background), behind, np.float32(0)))
    loss = 1.0 - np.clip(np.nan_to_num(score), 0.0, 1.0)
    per_score = p.per_score
    if layer.alike is not None:  # correlations, and the pair's own, say how much a height counts, not its deviation
        per_score, trust = p.per_learned_score, np.maximum((1 - loss) ** 2, np.float32(p.least_trust))
        evidence = np.where(known, evidence * trust * np.float32(layer.alike**2), evidence)
    sigma = np.where(known, p.best + per_score * loss, p.of_background) * layer.unit
    return np.where(known, height, background), evidence, sigma.astype(np.float32), score, known.astype(np.float32)


def _weighted_median(stack: Floats, weight: Floats) -> Floats:
    """Weighted median along the first axis: where the weights below and above balance, linear between.

    With two values that is their weighted mean, with equal weights the ordinary median.
    """
    order = np.argsort(np.where(weight > 0, stack, np.inf), axis=0)
    values, weights = np.take_along_axis(stack, order, axis=0), np.take_along_axis(weight, order, axis=0)
    total = weights.sum(axis=0)
    # Each value sits in the middle of its own weight on the cumulative axis.
    middle = weights.cumsum(axis=0) - weights / 2
    half = total / 2
    result = np.where(total > 0, values[0], np.nan)
    for k in range(1, len(stack)):
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((half - middle[k - 1]) / (middle[k] - middle[k - 1]), 0.0, 1.0)
        within = (weights[k] > 0) & (half > middle[k - 1])
        result = np.where(within, values[k - 1] + share * (values[k] - values[k - 1]), result)
    return result
