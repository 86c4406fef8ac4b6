"""How far a surface is from the truth: the paper's metrics, and two that outliers and datums do not change.

With e = DSM - reference over the cells where both have a height (N of them), and M cells where the reference has one:

- RMSE = sqrt(sum(e²) / N). A few gross errors dominate it; it contains the bias.
- MedAE = median(\\|e\\|), the paper's "median error" ME. Elsewhere ME is the mean error, signed.
- MAE = sum(\\|e\\|) / N.
- bias = median(e), signed: positive where the DSM is too high.
- LE90: the quantile of 90 % of \\|e\\|, as contracts ask for (:mod:`repm_qgis.numerics.accuracy`).
- NMAD = 1.4826 median(\\|e - median(e)\\|): the standard deviation that the bulk of the cells has, without the bias.
- valid = 100 N / M.
- completeness(t) = 100 count(\\|e\\| < t) / M, over *all* reference cells: a hole counts as a miss, so that leaving
  difficult cells out improves RMSE but not completeness. Always read the two together.

RMSE, MedAE, MAE, completeness: Hong et al. (the method's paper), Section 4.1. NMAD: Höhle and Höhle (2009), ISPRS J.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Floats, IntArray
from ..numerics.accuracy import SHARE, le90
from ..numerics.robust import NMAD_FACTOR, nmad

THRESHOLDS_M = (1.0, 2.5, 5.0)


@dataclass(frozen=True)
class HeightMetrics:
    """Errors in metres, shares in per cent; errors are NaN where no cell could be compared (``cells`` is 0).

    ``completeness`` holds (threshold m, per cent) in the order of the thresholds asked for.
    """

    cells: int
    reference_cells: int
    rmse: float
    medae: float
    mae: float
    nmad: float
    bias: float
    le90: float
    completeness: Tuple[Tuple[float, float], ...]

    @property
    def valid(self) -> float:
        return 100.0 * self.cells / self.reference_cells if self.reference_cells else 0.0


def height_metrics(error: Floats, reference_cells: int, thresholds: Sequence[float] = THRESHOLDS_M) -> HeightMetrics:
    """Metrics of errors (any shape, m, NaN where there is none) in an area with ``reference_cells`` cells.

    Raises ValueError where there are more errors than reference cells.
    """
    collected = ErrorCollector(thresholds)
    collected.add(error, reference_cells)
    return collected.metrics()


class ErrorCollector:
    """Collects errors block by block, and computes their metrics.

    Sums and counts are exact. So are medians while the errors are kept (4 bytes per cell, up to ``keep`` of them).
    Beyond, medians come from a histogram with bins of ``bin_m`` within ``±range_m``, linear inside a bin, and are good
    to ``bin_m``. ``keep`` 0 never keeps errors.
    """

    def __init__(
        self, thresholds: Sequence[float], keep: int = 16_000_000, bin_m: float = 0.0005, range_m: float = 500.0
    ) -> None:
        self._thresholds = tuple(float(t) for t in thresholds)
        self._keep, self._bin, self._half = keep, bin_m, int(round(range_m / bin_m))
        self._blocks: List[Floats] = []
        self._counts: Optional[IntArray] = None if keep > 0 else np.zeros(2 * self._half, np.int64)
        self._n = self._reference = 0
        self._squares = self._absolutes = 0.0
        self._within = np.zeros(len(self._thresholds), np.int64)

    @classmethod
    def of_part(cls, thresholds: Sequence[float]) -> ErrorCollector:
        """For one class of many: it keeps no errors, and its medians are good to 5 mm."""
        return cls(thresholds, keep=0, bin_m=0.005, range_m=200.0)

    @property
    def exact(self) -> bool:
        """Whether medians come from all errors, not from a histogram."""
        return self._counts is None

    def add(self, error: Floats, reference_cells: int) -> None:
        """Errors of a block (NaN = none) and how many cells the reference has there."""
        values = np.asarray(error).ravel()
        values = values[np.isfinite(values)]
        if values.size > reference_cells:
            raise ValueError(f"{values.size} errors cannot come from {reference_cells} reference cells.")
        size = np.abs(values.astype(np.float64))
        self._n += values.size
        self._reference += int(reference_cells)
        self._squares += float((size**2).sum())
        self._absolutes += float(size.sum())
        self._within += np.array([np.count_nonzero(size < t) for t in self._thresholds], np.int64)
        if self._counts is None:
            self._blocks.append(values)
            if self._n > self._keep:
                self._counts = np.zeros(2 * self._half, np.int64)
                while self._blocks:
                    self._count(self._blocks.pop(), self._counts)
        else:
            self._count(values, self._counts)

    def metrics(self) -> HeightMetrics:
        shares = 100.0 * self._within / self._reference if self._reference else np.zeros(len(self._thresholds))
        bias, medae, spread, most = self._quantiles() if self._n else (math.nan,) * 4
        n = self._n or math.nan
        return HeightMetrics(
            cells=self._n,
            reference_cells=self._reference,
            rmse=math.sqrt(self._squares / n) if self._n else math.nan,
            medae=medae,
            mae=self._absolutes / n,
            nmad=spread,
            bias=bias,
            le90=most,
            completeness=tuple(zip(self._thresholds, map(float, shares))),
        )

    def _quantiles(self) -> Tuple[float, float, float, float]:
        """Bias, MedAE, NMAD and LE90."""
        if self._counts is None:
            values = np.concatenate(self._blocks)
            self._blocks = [values]
            return float(np.median(values)), float(np.median(np.abs(values))), nmad(values), le90(values)
        filled = np.flatnonzero(self._counts)
        middles, counts = (filled - self._half + 0.5) * self._bin, self._counts[filled]
        bias = _weighted_quantile(middles, counts, self._bin)
        spread = NMAD_FACTOR * _weighted_quantile(np.abs(middles - bias), counts, self._bin)
        medae, most = (_weighted_quantile(np.abs(middles), counts, self._bin, share) for share in (0.5, SHARE))
        return bias, medae, spread, most

    def _count(self, values: Floats, counts: IntArray) -> None:
        if values.size:
            bins = np.clip(np.floor(values / self._bin), -self._half, self._half - 1).astype(np.int64) + self._half
            low = int(bins.min())
            found = np.bincount(bins - low)
            counts[low : low + found.size] += found


def _weighted_quantile(middles: Floats, counts: IntArray, width: float, quantile: float = 0.5) -> float:
    """A quantile of a histogram; values are taken as evenly spread inside their bin."""
    order = np.argsort(middles, kind="stable")
    total = np.cumsum(counts[order])
    half = quantile * total[-1]
    at = int(np.searchsorted(total, half))
    before = float(total[at - 1]) if at else 0.0
    share = (half - before) / float(counts[order][at])
    return float(middles[order][at] + (share - 0.5) * width)
