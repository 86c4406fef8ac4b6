"""The shifts of all scenes together: from references, ground control points, and where two scenes overlap.

Each scene has one shift (and tilt) of the ground as unknowns. A reference observes that of one scene, ground control
points observe that it is zero (they are in the pointing already), and two overlapping surfaces observe the difference
of two shifts. Each observation is weighted by its covariance. A direction that no observation determines stays as it
is: of all solutions, that with the smallest shifts is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.findings import Finding
from ..contracts.records import GroundShift
from .parameters import REGISTRATION, RegistrationParameters
from .solve import Prior, Shift

_UNKNOWNS = 5  # of a scene: east, north, up, and the tilt to the east and to the north


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
    centres: Sequence[Tuple[float, float]], priors: Sequence[Prior], observations: Sequence[Observation]
) -> List[Placed]:
    """The shifts of scenes that fit best to all observations; ``centres`` are those of their tilts."""
    count = len(centres)
    normal, right = np.zeros((_UNKNOWNS * count,) * 2), np.zeros(_UNKNOWNS * count)
    for each in observations:
        weighted = each.design(count).T @ np.linalg.inv(each.covariance)
        normal += weighted @ each.design(count)
        right += weighted @ each.basis.T @ each.value
    values, vectors = np.linalg.eigh(normal)
    known = values > 1e-9 * max(float(values[-1]), 1e-12)
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    solution = inverse @ right
    placed = []
    for number, (centre, prior) in enumerate(zip(centres, priors)):
        own = slice(_UNKNOWNS * number, _UNKNOWNS * number + _UNKNOWNS)
        unknown = vectors[own][:, ~known] @ vectors[own][:, ~known].T  # not observed
        east, north, up, tilt_x, tilt_y = map(float, solution[own])
        ground = GroundShift((east, north, up), (tilt_x, tilt_y), centre)
        share, directions = np.linalg.eigh(unknown[:2, :2])
        deviations = np.array([prior.horizontal_m, prior.horizontal_m, prior.up_m, 0.0, 0.0])
        covariance = inverse[own, own] + unknown * np.outer(deviations, deviations)
        placed.append(Placed(ground, covariance, directions[:, share < 0.5].T))
    return placed


def contradictions(
    observations: Sequence[Observation], parameters: RegistrationParameters = REGISTRATION
) -> List[Finding]:
    """Sentences about two sources that contradict each other about one scene."""
    found = []
    alone = [each for each in observations if each.second < 0]
    for index, first in enumerate(alone):
        for second in alone[index + 1 :]:
            if first.first != second.first:
                continue
            for axis, name in enumerate(("to the east", "to the north", "in height")):
                if _observes(first, axis) and _observes(second, axis):
                    apart = float(first.value[axis] - second.value[axis])
                    deviation = float(np.sqrt(_variance(first, axis) + _variance(second, axis)))
                    if abs(apart) > parameters.contradiction * deviation + parameters.least_contradiction_m:
                        text = (
                            f"{first.source} and {second.source} contradict each other by {abs(apart):.2f} m {name}, "
                            f"where {deviation:.2f} m are expected (one standard deviation): check the places, "
                            "dates and vertical datums of both."
                        )
                        found.append(Finding("references-contradict", text, "doubt"))
    return found


def _observes(observation: Observation, axis: int) -> bool:
    return bool(np.linalg.norm(observation.basis[axis]) > 0.99)


def _variance(observation: Observation, axis: int) -> float:
    row = observation.basis[axis]
    return float(row @ observation.covariance @ row)
