"""The vertical offsets of all DSMs of a mosaic, solved together from the differences where two of them overlap.

A least-squares adjustment of the medians, as for the strips of REMA (Howat et al. 2019, The Cryosphere 13, 665-674):
each overlap says how much higher one DSM lies than the other, with a weight by its area and spread. Overlaps that
contradict the others (water, snow, a building site) lose weight by Huber's function.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Collection, Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.findings import Finding
from ..contracts.records import OtherRelief
from ..numerics.robust import NMAD_FACTOR
from .parameters import MOSAIC, OffsetParameters

_LEAST_STATED_M = 0.01  # no DSM's absolute height is known better


@dataclass(frozen=True)
class Overlap:
    """Two DSMs by their numbers: the cells that both have, and the median and NMAD of first - second there, m.

    ``displaced`` is how far the second lies east and north of the first, m; None where the relief is too weak to find
    it. ``other_relief``: the second does not have the first one's relief. ``findings``: what else tells the two apart.
    """

    first: int
    second: int
    cells: int
    median: float
    nmad: float
    displaced: Optional[Tuple[float, float]] = None
    other_relief: Optional[OtherRelief] = None
    findings: Tuple[Finding, ...] = ()

    def after(self, added: FloatArray) -> float:
        """The median difference after the offsets are added, m."""
        return float(self.median + added[self.first] - added[self.second])


@dataclass(frozen=True)
class Offsets:
    """What is to be added to each DSM, m, and its standard deviation; 0 where a DSM is fixed or overlaps none.

    ``groups`` are the DSMs that overlaps connect; ``anchored`` says for each group whether it has a fixed DSM.
    """

    added: FloatArray
    deviation: FloatArray
    groups: Tuple[Tuple[int, ...], ...]
    anchored: Tuple[bool, ...]


def solve_offsets(
    count: int,
    overlaps: Sequence[Overlap],
    fixed: Collection[int],
    parameters: OffsetParameters = MOSAIC.offsets,
    stated: Sequence[Optional[float]] = (),
) -> Offsets:
    """Offsets of ``count`` DSMs that leave the least differences; those that are ``fixed`` have 0.

    A group without a fixed DSM keeps its mean height. Where all of its DSMs have a ``stated`` standard deviation of
    their absolute height, m, each counts for that mean by its inverse variance.
    """
    added, deviation = np.zeros(count), np.zeros(count)
    groups = _groups(count, overlaps)
    for group in groups:
        inside = [overlap for overlap in overlaps if overlap.first in group]
        free = [number for number in group if number not in fixed]
        if inside and free:
            anchored = len(free) < len(group)
            known = [stated[number] for number in free] if stated else []
            added[free], deviation[free] = _solved(free, inside, anchored, _shares(known, len(free)), parameters)
    return Offsets(added, deviation, groups, tuple(any(number in fixed for number in group) for group in groups))


def _groups(count: int, overlaps: Sequence[Overlap]) -> Tuple[Tuple[int, ...], ...]:
    """The numbers that overlaps connect, in their order."""
    group_of: Dict[int, List[int]] = {number: [number] for number in range(count)}
    for overlap in overlaps:
        first, second = group_of[overlap.first], group_of[overlap.second]
        if first is not second:
            first += second
            group_of.update({number: first for number in second})
    found = {id(group): tuple(sorted(group)) for group in group_of.values()}
    return tuple(sorted(found.values()))


def _shares(stated: Sequence[Optional[float]], count: int) -> FloatArray:
    """How much each DSM of a group without a fixed one counts for its mean height; together one."""
    known = [each for each in stated if each is not None]
    if len(known) < count:
        return np.full(count, 1.0 / count)
    weights = 1.0 / np.maximum(known, _LEAST_STATED_M) ** 2
    shares: FloatArray = weights / weights.sum()
    return shares


def _solved(
    free: List[int], overlaps: Sequence[Overlap], anchored: bool, shares: FloatArray, parameters: OffsetParameters
) -> Tuple[FloatArray, FloatArray]:
    """Offsets of the free DSMs of a group, and their standard deviations, by reweighted least squares."""
    place = {number: column for column, number in enumerate(free)}
    design = np.zeros((len(overlaps), len(free)))
    for row, overlap in enumerate(overlaps):
        for number, sign in ((overlap.first, 1.0), (overlap.second, -1.0)):
            if number in place:
                design[row, place[number]] = sign
    wanted = -np.array([overlap.median for overlap in overlaps])
    sigma = np.array([_deviation(overlap, parameters) for overlap in overlaps])
    # Where none is fixed, the sum of all is 0: this row makes the equations solvable and changes no difference.
    level = 0.0 if anchored else 1.0 / len(free)
    robust = np.ones(len(overlaps))
    solution, scale = np.zeros(len(free)), 1.0
    inverse = np.zeros((len(free), len(free)))
    for _ in range(parameters.reweightings):
        weights = robust / sigma**2
        mean = weights.mean()
        normal = design.T @ (weights[:, None] * design) / mean + level
        inverse = (np.linalg.inv(normal) - level) / mean
        before, solution = solution, inverse @ (design.T @ (weights * wanted))
        residuals = np.abs(design @ solution - wanted) / sigma
        redundant = len(overlaps) - len(free) + (0 if anchored else 1)
        scale = max(1.0, math.sqrt(float((robust * residuals**2).sum()) / redundant)) if redundant > 0 else 1.0
        usual = max(1.0, NMAD_FACTOR * float(np.median(residuals)))
        robust = np.minimum(1.0, parameters.huber * usual / np.maximum(residuals, 1e-12))
        if np.abs(solution - before).max() < 1e-5:
            break
    if not anchored:  # the solution is known up to a constant: the weighted mean becomes 0
        centred = np.eye(len(free)) - shares
        solution, inverse = centred @ solution, centred @ inverse @ centred.T
    return solution, scale * np.sqrt(np.maximum(np.diag(inverse), 0.0))


def _deviation(overlap: Overlap, parameters: OffsetParameters) -> float:
    """The standard deviation of an overlap's median, m: 1.2533 times that of a mean."""
    independent = max(overlap.cells / parameters.independent, 1.0)
    return max(1.2533 * overlap.nmad / math.sqrt(independent), parameters.least_deviation_m)
