"""Attitude jitter as unknowns of the adjustment: splines of each view's lines, and whether ties show waves at all.

Ties show the jitter across the parallax, because lines of sight then miss each other. Along the parallax it
changes heights; where three views look from different directions, their disagreement shows that too, and relief
separates the views' waves, because points of different heights lie in different lines (Teshima and Iwasaki 2008; Tong
et al. 2015; docs/method.md, "Jitter").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..geometry.jitter import ORDER, Jitter, splines
from ..scene import View
from .parameters import POINTING, JitterParameters


@dataclass(frozen=True)
class Waves:
    """``count`` splines in each direction of each view, between the lines ``ends`` of the view that ties show."""

    ends: Tuple[Tuple[float, float], ...]
    count: int

    def values(self, i: int, rows: FloatArray) -> FloatArray:
        """(..., count) of the view number i in lines (...)."""
        first, weights = splines(rows.ravel(), self.ends[i], self.count)
        dense = np.zeros((rows.size, self.count))
        np.put_along_axis(dense, first[:, None] + np.arange(ORDER), weights, axis=1)
        return dense.reshape(rows.shape + (self.count,))

    def jitter(self, i: int, coefficients: FloatArray) -> Jitter:
        """The waves of the view number i, from (2, count) coefficients."""
        first, last = self.ends[i]
        return Jitter(first, last, np.ascontiguousarray(coefficients.T))

    def prior(self, parameters: JitterParameters) -> FloatArray:
        """(count, count) inverse covariance of the coefficients of one direction, px^-2: waves of usual size without a
        mean and a trend of their own."""
        trend = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, self.count), 2))[0]
        matrix: FloatArray = np.eye(self.count) / parameters.usual_px**2
        return matrix + trend @ trend.T / parameters.trend_px**2


def waves_over(
    rows: Sequence[FloatArray], knots_lines: float, parameters: JitterParameters = POINTING.jitter
) -> Optional[Waves]:
    """Splines with knots about so many lines apart over the lines (N,) of each view's ties; None where lines or ties
    are too few for them."""
    if not rows or min(map(len, rows)) < 2:
        return None
    ends = tuple((float(each.min()), float(each.max())) for each in rows)
    lines = max(last - first for first, last in ends)
    most = min(parameters.most_intervals, parameters.most_unknowns // (2 * len(rows)))
    intervals = min(round(lines / knots_lines), most)
    count = intervals + ORDER - 1
    few = min(map(len, rows)) < parameters.ties_per_spline * count
    short = intervals < parameters.least_intervals or min(last - first for first, last in ends) < lines / 4
    return None if few or short else Waves(ends, count)


def can_jitter(views: Sequence[View]) -> bool:
    """Whether the lines of all views are lines of their sensors: those of ortho-ready images are lines of a map."""
    return all(view.plane is None for view in views)


def ladder(rows: Sequence[FloatArray], parameters: JitterParameters = POINTING.jitter) -> List[Waves]:
    """The splines to choose among, the fewest first."""
    found = [waves_over(rows, lines, parameters) for lines in parameters.knots_lines]
    return [each for k, each in enumerate(found) if each is not None and each not in found[:k]]
