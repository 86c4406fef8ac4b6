"""How much two DSMs differ where nothing changed, and over which distances their errors are correlated.

The error of a difference consists of two independent parts: that of heights, which confidence rasters state (or which
is the same everywhere), and a horizontal one, which counts as much as the ground is steep (Nuth and Kääb 2011). Both
are scaled so that they explain the robust spread of differences in classes of slope. Differences that are divided by
their error are alike everywhere, so that one variogram describes them (Hugonnet et al. 2022, IEEE JSTARS 15).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Floats
from ..contracts.errors import EmptyResultError
from ..numerics.robust import NMAD_FACTOR, nmad
from .parameters import CHANGE, ErrorModelParameters
from .surfaces import Cells

_ROUNDS = 5  # of a fit whose parts change each other by a tenth


@dataclass(frozen=True)
class SlopeClass:
    """Cells of some slopes (degrees): how many, the spread of their differences, and the error that is expected, m."""

    low: float
    high: float
    cells: int
    spread: float
    expected: float


@dataclass(frozen=True)
class ErrorModel:
    """The error of a difference: ``scale`` times the stated error of its heights (metres where nothing is stated), and
    ``horizontal_m`` times the gradient."""

    scale: float
    horizontal_m: float
    classes: Tuple[SlopeClass, ...] = ()
    parameters: ErrorModelParameters = CHANGE.errors

    def of_heights(self, cells: Cells) -> FloatImage:
        """The error that level ground has, m; NaN where a height is interpolated."""
        return np.maximum(np.float32(self.scale) * cells.error, np.float32(self.parameters.least_error_m))

    def of_cells(self, cells: Cells) -> FloatImage:
        """The error with its horizontal part, m; beside holes, where no gradient is known, that of level ground."""
        steep = np.minimum(np.nan_to_num(cells.gradient), np.float32(self.parameters.steepest))
        return np.hypot(self.of_heights(cells), np.float32(self.horizontal_m) * steep)


def fitted_model(
    samples: Sequence[Cells], cell_m: float, parameters: ErrorModelParameters = CHANGE.errors
) -> ErrorModel:
    """The model that explains the differences of samples of both DSMs; raises EmptyResultError for too few of them."""
    difference, error, gradient = (_known(samples, name) for name in ("difference", "error", "gradient"))
    rows: List[Tuple[float, float, int, float, float, float]] = []
    slope = np.degrees(np.arctan(gradient))
    for low, high in zip(parameters.slope_edges_deg, parameters.slope_edges_deg[1:]):
        inside = (slope >= low) & (slope < high)
        count = int(inside.sum())
        if count >= parameters.least_cells:
            spread = max(nmad(difference[inside], 0.0), parameters.least_error_m)
            stated, rise = (float(np.sqrt(np.median(values[inside] ** 2))) for values in (error, gradient))
            rows.append((low, high, count, spread, stated, float(np.clip(rise, 1e-3, parameters.steepest))))
    if not rows:
        raise EmptyResultError(
            f"Cells with heights in both DSMs that were not interpolated: {difference.size}, too few to find stable "
            "ground: choose DSMs of the same ground, with fewer holes or smaller cells."
        )
    spreads, errors, rises = (np.array([row[index] for row in rows]) for index in (3, 4, 5))
    scale, horizontal = _explained(spreads, errors, rises)
    horizontal = max(horizontal, parameters.least_horizontal_cells * cell_m)
    expected = np.hypot(scale * errors, horizontal * rises)
    classes = tuple(
        SlopeClass(low=low, high=high, cells=count, spread=spread, expected=float(error))
        for (low, high, count, spread, _, _), error in zip(rows, expected)
    )
    return ErrorModel(scale, horizontal, classes, parameters)


def _known(samples: Sequence[Cells], name: str) -> FloatArray:
    parts = []
    for cells in samples:
        values = getattr(cells, name)
        good = cells.measured & np.isfinite(cells.error) & np.isfinite(cells.gradient)
        parts.append(values[good & np.isfinite(cells.difference)])
    return np.concatenate([np.empty(0), *parts])


def _explained(spreads: FloatArray, stated: FloatArray, rises: FloatArray) -> Tuple[float, float]:
    """Scale and horizontal error: the one from the two flattest classes, the other the median of all others.

    Each is found after the part that the other one explains is subtracted; spreads of walls cannot move them far.
    """
    scale, horizontal = float(np.median(spreads[:2] / stated[:2])), 0.0
    for _ in range(_ROUNDS):
        rest = np.sqrt(np.maximum(spreads**2 - (scale * stated) ** 2, 0.0)) / rises
        horizontal = float(np.median(rest[2:])) if rest.size > 2 else 0.0
        flat = np.maximum(spreads**2 - (horizontal * rises) ** 2, (0.5 * spreads) ** 2)
        scale = float(np.median((np.sqrt(flat) / stated)[:2]))
    return scale, horizontal


# Correlation ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Correlation:
    """The correlation of errors: ``values`` (0..1, falling) at ``distances`` in metres; 1 at distance zero, the last
    value beyond."""

    distances: FloatArray
    values: FloatArray

    def variance_share(self, area_m2: float) -> float:
        """The variance of the mean error over an area, as a share of that of one cell.

        It is 1 / the effective number of independent cells, and the mean correlation of any two places (Rolstad et al.
        2009, Journal of Glaciology 55; Hugonnet et al. 2022), here in a disc of that area: the distances of two places
        in it have a known distribution.
        """
        share = (np.arange(4000) + 0.5) / 4000  # of the diameter
        often = share * (np.arccos(share) - share * np.sqrt(1 - share**2))
        distances = share * 2 * math.sqrt(area_m2 / math.pi)
        alike = np.interp(distances, np.concatenate([[0.0], self.distances]), np.concatenate([[1.0], self.values]))
        return float((alike * often).sum() / often.sum())


def correlation_of(
    parts: Sequence[FloatImage], thinned: FloatImage, cell_m: float, step: int, parameters: ErrorModelParameters
) -> Correlation:
    """From standardised differences of stable ground, NaN elsewhere.

    ``parts`` are windows of all cells, for short distances; ``thinned`` has every ``step``-th cell of the whole ground.
    """
    found: List[Tuple[float, float]] = []
    for arrays, unit, lags in (
        (parts, 1, parameters.lags),
        ([thinned], step, [2**power for power in range(parameters.long_lags)]),
    ):
        for lag in lags:
            distance = lag * unit * cell_m
            if (found and distance <= found[-1][0] * 1.2) or lag > max(max(a.shape) for a in arrays) // 2:
                continue
            pairs = np.concatenate([_apart(array, lag) for array in arrays])
            if pairs.size >= parameters.least_pairs:
                found.append((distance, 0.5 * (NMAD_FACTOR * float(np.median(pairs))) ** 2))
    values = np.concatenate([np.empty(0), *(part[np.isfinite(part)] for part in parts)])
    sill = max(nmad(values, 0.0) ** 2 if values.size else 1.0, 1e-12)
    distances, half_variances = np.array(found or [(cell_m, sill)]).T
    alike = np.minimum.accumulate(np.clip(1.0 - half_variances / sill, 0.0, 1.0))
    return Correlation(distances, alike)


def _apart(values: Floats, lag: int) -> Floats:
    """Absolute differences of all values that lie ``lag`` cells apart along a row or a column (Dowd's estimator takes
    their median, which outliers do not move)."""
    parts = np.abs(values[:, lag:] - values[:, :-lag]), np.abs(values[lag:] - values[:-lag])
    return np.concatenate([part[np.isfinite(part)] for part in parts])
