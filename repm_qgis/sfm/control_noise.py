"""How far ground control points can be trusted: their noise from their own residuals, and which of them are wrong.

Points may come from a total station and be marked to 0.1 px, or from a map and be 2 px off; a fixed weight beside the
tie points is wrong for both. So the noise is estimated with everything else: first from the median of the residuals,
which wrong points do not move, then as a variance component (Helmert 1907; Förstner 1979): the squared residuals over
their redundancy, which is what the corrections cannot adapt themselves to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import List, Sequence

import numpy as np

from ..arrays import FloatArray

_PRIOR_PX = 0.1  # the noise that one observation more speaks for, where a single point has no redundancy
LEAST_NOISE_PX = 0.02  # below that, RPCs themselves are no better
_WRONG_PX = 0.5  # nobody need be told of less
_FALSE_ALARM = 0.01  # chance that any good point of a table is called wrong
_SUSPECT = 2.5  # robust standard deviations from which on a point has to prove itself


@dataclass(frozen=True)
class ControlEquations:
    """A control point's linearised observations: (m,) misclosures, px, and (m, parameters) their design."""

    misclosure: FloatArray
    design: FloatArray

    def after(self, step: FloatArray) -> FloatArray:
        """(m,) residuals once the parameters have moved, px."""
        return self.misclosure - self.design @ step

    def redundancy(self, covariance: FloatArray, noise_px: float, weight: float = 1.0) -> float:
        """How many of the observations the parameters do not take up; ``covariance`` of the parameters in px²."""
        taken = float(np.sum((self.design @ covariance) * self.design)) * weight / noise_px**2
        return len(self.misclosure) - taken


def first_noise(residuals: Sequence[FloatArray]) -> float:
    """A coordinate's standard deviation from the median of all residuals, px: wrong points do not move it."""
    return max(1.4826 * float(np.median(np.abs(np.concatenate(list(residuals))))), LEAST_NOISE_PX)


def variance_component(residuals: Sequence[FloatArray], redundancy: float) -> float:
    """A coordinate's standard deviation from squared residuals and their redundancy, px."""
    square = sum(float(residual @ residual) for residual in residuals)
    return max(float(np.sqrt((square + _PRIOR_PX**2) / (max(redundancy, 0.0) + 1.0))), LEAST_NOISE_PX)


def robust_weight(residual: FloatArray, noise_px: float) -> float:
    """Nearly that of least absolute residuals: the best start where some points are wrong."""
    return min(1.0, noise_px / max(_size(residual), 1e-9))


def suspects(residuals: Sequence[FloatArray], noise_px: float) -> List[int]:
    """The points that a robust adjustment leaves far away, worst first; half of them at most, and two stay."""
    size = np.array([_size(residual) for residual in residuals])
    far = [int(k) for k in np.argsort(-size, kind="stable") if size[k] > _SUSPECT * noise_px]
    return far[: max(min(len(size) // 2, len(size) - 2), 0)]


def contradicts(
    point: ControlEquations, covariance: FloatArray, noise_px: float, redundancy: float, points: int
) -> bool:
    """Whether a point that took no part lies where an adjustment from the others cannot put it (an F test).

    ``covariance`` of the others' parameters in px², ``noise_px`` theirs with its ``redundancy``; ``points`` is the
    number of all, for the chance of a false alarm is that of a whole table.
    """
    off = point.misclosure
    if _largest(off) < _WRONG_PX:
        return False
    expected = noise_px**2 * np.eye(len(off)) + point.design @ covariance @ point.design.T
    statistic = float(off @ np.linalg.solve(expected, off)) / len(off)
    return statistic > f_quantile(1.0 - _FALSE_ALARM / max(points, 1), len(off), max(redundancy, 0.0) + 1.0)


def f_quantile(probability: float, first: float, second: float) -> float:
    """Fisher's F for two degrees of freedom, by Paulson's approximation (1942); infinite where ``second`` is too small
    to tell anything (some 2)."""
    z = NormalDist().inv_cdf(probability)
    a, b = 2.0 / (9.0 * first), 2.0 / (9.0 * second)
    lead = (1.0 - b) ** 2 - b * z**2
    if lead <= 0.0:
        return math.inf
    root = ((1.0 - a) * (1.0 - b) + z * math.sqrt(b * (1.0 - a) ** 2 + a * (1.0 - b) ** 2 - a * b * z**2)) / lead
    return root**3


def _size(residual: FloatArray) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _largest(residual: FloatArray) -> float:
    """The longest of a point's residual vectors."""
    return float(np.linalg.norm(residual.reshape(-1, 2), axis=1).max())
