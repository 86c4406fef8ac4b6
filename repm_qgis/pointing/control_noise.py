"""The noise of ground control points, from their own residuals, and which of them are wrong.

Points may come from a total station and be measured to 0.1 px, or from a map and be wrong by 2 px; a fixed weight
beside the tie points is wrong for both. So the noise is estimated too: first from the median of the residuals, which
gross errors do not change, then as a variance component (Helmert 1907; Förstner 1979): the squared residuals over
their redundancy, which is the part of the observations that the corrections cannot fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import List, Sequence

import numpy as np

from ..contracts.arrays import FloatArray
from ..numerics.robust import huber, nmad
from .parameters import ControlParameters


@dataclass(frozen=True)
class ControlEquations:
    """A control point's linearised observations: (m,) misclosures, px, and (m, parameters) their design."""

    misclosure: FloatArray
    design: FloatArray

    def after(self, step: FloatArray) -> FloatArray:
        """(m,) residuals after a step of the parameters, px."""
        return np.asarray(self.misclosure - self.design @ step)

    def redundancy(self, covariance: FloatArray, noise_px: float, weight: float = 1.0) -> float:
        """How many of the observations the parameters do not fit; ``covariance`` of the parameters in px²."""
        taken = float(np.sum((self.design @ covariance) * self.design)) * weight / noise_px**2
        return len(self.misclosure) - taken


def first_noise(residuals: Sequence[FloatArray], parameters: ControlParameters) -> float:
    """A coordinate's standard deviation from the median of all residuals, px: gross errors do not change it."""
    return max(nmad(np.concatenate(list(residuals)), 0.0), parameters.least_noise_px)


def variance_component(residuals: Sequence[FloatArray], redundancy: float, parameters: ControlParameters) -> float:
    """A coordinate's standard deviation from squared residuals and their redundancy, px."""
    square = sum(float(residual @ residual) for residual in residuals) + parameters.prior_px**2
    return max(float(np.sqrt(square / (max(redundancy, 0.0) + 1.0))), parameters.least_noise_px)


def robust_weight(residual: FloatArray, noise_px: float) -> float:
    """Nearly the weight of least absolute residuals, the best start where some points are wrong."""
    return float(huber(_size(residual), noise_px))


def suspects(residuals: Sequence[FloatArray], noise_px: float, parameters: ControlParameters) -> List[int]:
    """The points with large residuals of a robust adjustment, worst first; half of all at most, and two remain."""
    size = np.array([_size(residual) for residual in residuals])
    far = [int(k) for k in np.argsort(-size, kind="stable") if size[k] > parameters.suspect * noise_px]
    return far[: most_set_aside(len(size))]


def most_set_aside(points: int) -> int:
    """Of so many control points, how many wrong ones can be found by the others: half of all, and two remain."""
    return max(min(points // 2, points - 2), 0)


def contradicts(
    point: ControlEquations,
    covariance: FloatArray,
    noise_px: float,
    redundancy: float,
    points: int,
    parameters: ControlParameters,
) -> bool:
    """Whether a point that was left out disagrees with the adjustment from the others (an F test).

    ``covariance`` of the others' parameters in px², their ``noise_px`` with its ``redundancy``; ``points`` is the
    number of all, because the probability of a false alarm is that of a whole table.
    """
    off = point.misclosure
    if np.linalg.norm(off.reshape(-1, 2), axis=1).max() < parameters.wrong_px:
        return False
    expected = noise_px**2 * np.eye(len(off)) + point.design @ covariance @ point.design.T
    statistic = float(off @ np.linalg.solve(expected, off)) / len(off)
    probability = 1.0 - parameters.false_alarm / max(points, 1)
    return statistic > f_quantile(probability, len(off), max(redundancy, 0.0) + 1.0)


def f_quantile(probability: float, first: float, second: float) -> float:
    """Fisher's F by Paulson's approximation (1942); infinite where ``second`` is too small for a decision (some 2)."""
    z = NormalDist().inv_cdf(probability)
    a, b = 2.0 / (9.0 * first), 2.0 / (9.0 * second)
    lead = (1.0 - b) ** 2 - b * z**2
    if lead <= 0.0:
        return math.inf
    root = ((1.0 - a) * (1.0 - b) + z * math.sqrt(b * (1.0 - a) ** 2 + a * (1.0 - b) ** 2 - a * b * z**2)) / lead
    return root**3


def _size(residual: FloatArray) -> float:
    return float(np.sqrt(np.mean(residual**2)))
