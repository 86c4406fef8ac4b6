"""The errors of each date, from what pairs of dates differ where nothing changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..change.errors import fitted_model
from ..change.parameters import CHANGE
from ..contracts.arrays import FloatArray, FloatImage
from ..contracts.errors import EmptyResultError
from ..runtime.progress import Progress
from .surfaces import SeriesCells, Stack

_STEPS = (1, 2, 3)  # between the dates of a pair: triangles are needed, and the third makes them surer
_ROUNDS = 200  # of a solution in which each date's variance follows from those of the others
_LEAST_SHARE = 0.05  # of a pair's variance that each of its dates has at least


@dataclass(frozen=True)
class DateErrors:
    """(dates,) each: what stated errors are multiplied by (m where nothing is stated), the horizontal error, m, the
    offset that was not removed, m, and ``usual``, the error of a height on level ground, m."""

    scale: FloatArray
    horizontal_m: FloatArray
    offset_m: FloatArray
    usual_m: FloatArray

    def of_cells(self, cells: SeriesCells, dates: Sequence[int] = (), offsets: bool = True) -> FloatImage:
        """(dates, rows, columns) standard deviations of the heights of all dates or of some, m, with or without those
        offsets."""
        chosen = list(dates or range(len(self.scale)))
        plan = CHANGE.errors
        steep = np.minimum(np.nan_to_num(cells.gradient), np.float32(plan.steepest))
        of_dates = (self.scale, self.horizontal_m, self.offset_m)
        scale, horizontal, offset = (values[chosen].astype(np.float32)[:, None, None] for values in of_dates)
        heights = np.maximum(scale * cells.stated, np.float32(plan.least_error_m))
        errors = np.hypot(heights, horizontal * steep)
        return np.hypot(errors, offset) if offsets else errors


def errors_of_dates(stack: Stack, offsets: FloatArray, progress: Progress) -> DateErrors:
    """Solve the variances of all dates from those of pairs of dates at most three places apart.

    ``offsets`` (dates,) is how far each date lies above the first where nothing changed, m. What the user has not had
    removed counts as an error of its own, about the median of all dates. Raises EmptyResultError where a date has too
    few heights in common with its neighbours.
    """
    count = len(stack)
    stated = _usual_stated(stack)
    heights: Dict[Tuple[int, int], float] = {}
    places: Dict[Tuple[int, int], float] = {}
    failed: Optional[EmptyResultError] = None
    pairs = [(i, j) for step in _STEPS for i, j in zip(range(count), range(step, count))]
    for index, (before, after) in enumerate(pairs):
        progress.check_cancelled()
        progress.step(index / len(pairs), f"pair {index + 1} of {len(pairs)}")
        pair = stack.pair(before, after)
        apart = np.float32(offsets[after] - offsets[before])
        cells = [pair.read(window) for window in pair.samples()]
        try:
            model = fitted_model([replace(each, after=each.after - apart) for each in cells], stack.cell_m2**0.5)
        except EmptyResultError as error:
            failed = error
            continue
        heights[before, after] = model.scale**2 * float(stated[before] ** 2 + stated[after] ** 2)
        places[before, after] = model.horizontal_m**2
    for date in range(count):
        if failed is not None and not any(date in pair for pair in heights):
            raise failed
    usual = np.maximum(np.sqrt(_shared(heights, count)), CHANGE.errors.least_error_m)
    left = offsets - np.median(offsets)
    return DateErrors(usual / stated, np.sqrt(_shared(places, count)), left, usual)


def _usual_stated(stack: Stack) -> FloatArray:
    """(dates,) the median of the stated errors of each date, m; 1 where nothing is stated."""
    found = []
    for date in range(len(stack)):
        parts: List[FloatArray] = []
        for window in stack.samples():
            heights, stated = stack.read_date(date, window)
            parts.append(stated[np.isfinite(heights) & np.isfinite(stated)])
        values = np.concatenate(parts)
        found.append(max(float(np.median(values)), 1e-6) if values.size else 1.0)
    return np.array(found)


def _shared(variances: Dict[Tuple[int, int], float], count: int) -> FloatArray:
    """(dates,) variances whose sums are those of the pairs, by least squares, none below a small share of a pair's.

    The variance of a pair is known to a share of itself, so that noisy pairs count for less.
    """
    values = np.full(count, np.mean(list(variances.values())) / 2)
    known = variances.items()
    of_date = [[(sum(pair) - date, value) for pair, value in known if date in pair] for date in range(count)]
    for _ in range(_ROUNDS):
        for date, others in enumerate(of_date):
            if others:
                least = _LEAST_SHARE * min(value for _, value in others)
                own = [value - values[other] for other, value in others]
                values[date] = max(least, float(np.average(own, weights=[value**-2.0 for _, value in others])))
    return values
