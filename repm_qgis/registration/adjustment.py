"""The shifts of all scenes together: from references, ground control points, and where two scenes overlap.

Each scene has one shift (and tilt) of the ground as unknowns. A reference observes that of one scene, ground control
points observe that it is zero (they are in the pointing already), and two overlapping surfaces observe the difference
of two shifts. Each observation is weighted by its covariance. A direction that no observation determines stays as it
is: of all solutions, that with the smallest shifts is taken.

Where sources disagree by more than their covariances explain, these are too small: the deviations of the result grow
by the Birge ratio (Birge 1932, Physical Review 40) of each axis, and cover half of what two sources contradict each
other by, because nothing says which of them is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Iterator, List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.findings import Finding
from ..contracts.records import GroundShift
from .estimation import split
from .parameters import REGISTRATION, RegistrationParameters
from .solve import Prior, Shift

_UNKNOWNS = 5  # of a scene: east, north, up, and the tilt to the east and to the north
_SIZES = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3])  # usual ones of them, m and m per m
_AXES = ("to the east", "to the north", "in height")


@dataclass(frozen=True)
class Observation:
    """The observation of one source: ``value`` (5,) is the shift of the scene with the number ``first``, less that of
    ``second`` where there is one; ``basis`` (5, k) are the unknowns it observes, ``covariance`` (k, k) of these.
    ``source`` is its name in messages."""

    source: str
    first: int
    second: int  # -1: none
    value: FloatArray
    basis: FloatArray
    covariance: FloatArray

    @classmethod
    def of_shift(cls, source: str, shift: Shift, first: int, second: int = -1) -> Observation:
        """A surface laid on a reference, or on another scene's surface."""
        basis = np.zeros((_UNKNOWNS, len(shift.determined) + 1))
        basis[:2, :-1] = shift.determined.T
        basis[2, -1] = 1.0
        if second < 0 and any(shift.ground.tilt):
            basis = np.column_stack([basis, np.eye(_UNKNOWNS)[:, 3:]])
        value = np.array([*shift.ground.moved, *shift.ground.tilt])
        return cls(source, first, second, value, basis, basis.T @ shift.covariance @ basis)

    @classmethod
    def of_control(cls, information: FloatArray, scene: int) -> Observation:
        """Ground control points, by the (3, 3) information that they have of a shift, 1 / m²."""
        values, vectors = np.linalg.eigh(information)
        good = values > 1e-9 * max(values[-1], 1e-12)
        basis = np.zeros((_UNKNOWNS, int(good.sum())))
        basis[:3] = vectors[:, good]
        return cls("the ground control points", scene, -1, np.zeros(_UNKNOWNS), basis, np.diag(1.0 / values[good]))

    def left(self, solution: FloatArray) -> FloatArray:
        """(5,) what it says less what a solution (scenes, 5) does, of what it observes."""
        of_solution = solution[self.first] - (solution[self.second] if self.second >= 0 else 0.0)
        return np.asarray(self.basis @ (self.basis.T @ (self.value - of_solution)))

    def design(self, scenes: int) -> FloatArray:
        """(k, 5 scenes) derivatives of what is observed."""
        design = np.zeros((self.basis.shape[1], _UNKNOWNS * scenes))
        design[:, _UNKNOWNS * self.first : _UNKNOWNS * (self.first + 1)] = self.basis.T
        if self.second >= 0:
            design[:, _UNKNOWNS * self.second : _UNKNOWNS * (self.second + 1)] = -self.basis.T
        return design


@dataclass(frozen=True)
class Placed:
    """The shift of one scene, around a centre that its observations share; (5, 5) its covariance, and the (k, 2)
    horizontal directions that are determined."""

    ground: GroundShift
    covariance: FloatArray
    determined: FloatArray

    @property
    def deviations(self) -> FloatArray:
        """(3,) standard deviations of east, north and up, m."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[:3]))


def place_scenes(
    centres: Sequence[Tuple[float, float]],
    priors: Sequence[Prior],
    observations: Sequence[Observation],
    parameters: RegistrationParameters = REGISTRATION,
) -> List[Placed]:
    """The shifts of scenes that fit best to all observations; ``centres`` are those of their tilts."""
    count = len(centres)
    normal, right = np.zeros((_UNKNOWNS * count,) * 2), np.zeros(_UNKNOWNS * count)
    for each in observations:
        weighted = each.design(count).T @ np.linalg.inv(each.covariance)
        normal += weighted @ each.design(count)
        right += weighted @ each.basis.T @ each.value
    inverse, unknown = split(normal, np.tile(_SIZES, count))
    solution = inverse @ right
    placed = []
    for number, (centre, prior) in enumerate(zip(centres, priors)):
        own = slice(_UNKNOWNS * number, _UNKNOWNS * number + _UNKNOWNS)
        east, north, up, tilt_x, tilt_y = map(float, solution[own])
        ground = GroundShift((east, north, up), (tilt_x, tilt_y), centre)
        share, directions = np.linalg.eigh(unknown[own, own][:2, :2])
        deviations = np.array([prior.horizontal_m, prior.horizontal_m, prior.up_m, 0.0, 0.0])
        more = _disagreement(number, observations, solution, inverse, parameters)
        covariance = inverse[own, own] * np.outer(more, more) + unknown[own, own] * np.outer(deviations, deviations)
        placed.append(Placed(ground, covariance, directions[:, share < 0.5].T))
    return placed


def _disagreement(
    scene: int,
    observations: Sequence[Observation],
    solution: FloatArray,
    inverse: FloatArray,
    parameters: RegistrationParameters,
) -> FloatArray:
    """(5,) by how much the deviations of a scene's unknowns must grow, because its sources disagree."""
    linked, more = _linked(scene, observations), np.ones(_UNKNOWNS)
    scenes = len(solution) // _UNKNOWNS
    for axis in range(_UNKNOWNS):
        telling = [each for each in linked if _observes(each, axis)]
        unknowns = len({number for each in telling for number in (each.first, each.second) if number >= 0})
        anchored = any(each.second < 0 for each in telling)
        free = len(telling) - (unknowns if anchored else unknowns - 1)
        left = [(each.left(solution.reshape(scenes, _UNKNOWNS))[axis], _variance(each, axis)) for each in telling]
        if free > 0:
            more[axis] = max(1.0, math.sqrt(sum(off**2 / variance for off, variance in left) / free))
    for first, second, axis, apart, _ in _contradicting(linked, parameters):
        own = math.sqrt(inverse[_UNKNOWNS * scene + axis, _UNKNOWNS * scene + axis])
        if scene in (first.first, second.first) and own > 0:
            more[axis] = max(more[axis], abs(apart) / 2.0 / own)
    return more


def _linked(scene: int, observations: Sequence[Observation]) -> List[Observation]:
    """The observations that a scene has a part in, by way of overlaps too."""
    reached, grown = {scene}, True
    while grown:
        of_pairs = [{each.first, each.second} for each in observations if each.second >= 0]
        more = set().union(*(pair for pair in of_pairs if pair & reached))
        grown, reached = not more <= reached, reached | more
    return [each for each in observations if each.first in reached]


def contradictions(
    observations: Sequence[Observation], parameters: RegistrationParameters = REGISTRATION
) -> List[Finding]:
    """Sentences about two sources that contradict each other about one scene."""
    texts = [
        f"{first.source} and {second.source} contradict each other by {abs(apart):.2f} m {_AXES[axis]}, where "
        f"{deviation:.2f} m are expected (one standard deviation): check the places, dates and vertical datums of both."
        for first, second, axis, apart, deviation in _contradicting(observations, parameters)
    ]
    return [Finding("references-contradict", text, "doubt") for text in texts]


_Contradiction = Tuple[Observation, Observation, int, float, float]


def _contradicting(observations: Sequence[Observation], parameters: RegistrationParameters) -> Iterator[_Contradiction]:
    """Two sources about one scene, an axis, by how much they differ there, and one deviation of that, m."""
    alone = [each for each in observations if each.second < 0]
    for first, second in combinations(alone, 2):
        for axis in range(len(_AXES)) if first.first == second.first else ():
            if _observes(first, axis) and _observes(second, axis):
                apart = float(first.value[axis] - second.value[axis])
                deviation = float(np.sqrt(_variance(first, axis) + _variance(second, axis)))
                if abs(apart) > parameters.contradiction * deviation + parameters.least_contradiction_m:
                    yield first, second, axis, apart, deviation


def _observes(observation: Observation, axis: int) -> bool:
    return bool(np.linalg.norm(observation.basis[axis]) > 0.99)


def _variance(observation: Observation, axis: int) -> float:
    row = observation.basis[axis]
    return float(row @ observation.covariance @ row)
