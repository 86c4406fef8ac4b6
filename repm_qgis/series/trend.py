"""The trend of each cell, robust and with its error, and the dates at which it changed.

The trend is the median of the slopes between all pairs of dates (Theil 1950), its interval the one of Sen (1968,
Journal of the American Statistical Association 63), from the exact distribution of Kendall's statistic: a series is too
short for the normal one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist
from typing import Iterator, Tuple

import numpy as np

from ..change.parameters import CHANGE
from ..contracts.arrays import FloatArray, FloatImage, Floats, IntArray, Mask
from .parameters import SERIES, SeriesParameters

NORMAL_LEVEL = NormalDist().inv_cdf(0.975)
"""Standard deviations to both sides that hold 95 % of normal errors."""


@dataclass(frozen=True)
class Trends:
    """(rows, columns) each: m per year, NaN where fewer than three dates have a height.

    ``error`` is the standard error that the dates' own errors give; ``low`` and ``high`` the ends of Sen's interval,
    NaN where the dates are too few for one (fewer than five for 95 %). ``count``: dates with a height.
    """

    slope: FloatImage
    error: FloatImage
    low: FloatImage
    high: FloatImage
    count: FloatImage

    @property
    def signs(self) -> IntArray:
        """1 where the surface rises significantly, -1 where it falls, 0 elsewhere: by both its errors."""
        with np.errstate(invalid="ignore"):
            beyond = np.abs(self.slope) > NORMAL_LEVEL * self.error
            beyond &= ~((self.low <= 0) & (self.high >= 0))  # where there is no interval, the error alone tells
        return np.where(beyond, np.sign(np.nan_to_num(self.slope)), 0).astype(np.int64)


@lru_cache(maxsize=256)
def interval_rank(dates: int, share: float) -> int:
    """Which of the sorted slopes, from 1, begins an interval that holds the true one with at least this probability;
    its end is as far from the last. 0 where all slopes together hold it more rarely.

    The number of slopes below the true one is that of inversions in a random order (Kendall 1938).
    """
    ways = [1]
    for length in range(2, dates + 1):
        more = [0] * (len(ways) + length - 1)
        for index, count in enumerate(ways):
            for by in range(length):
                more[index + by] += count
        ways = more
    total, below, rank = math.factorial(dates), 0, 0
    for count in ways:
        below += count
        if 2 * below > (1 - share) * total:
            return rank
        rank += 1
    return rank


def trends(years: FloatArray, heights: FloatImage, errors: FloatImage, parameters: SeriesParameters = SERIES) -> Trends:
    """Trends of (dates, rows, columns) heights in m at times (dates,) in years, NaN where a date has none; ``errors``
    are their standard deviations, m."""
    shape = heights.shape[1:]
    flat, spread = (values.reshape(len(years), -1) for values in (heights, errors))
    found = [np.full(flat.shape[1], np.nan, np.float32) for _ in range(5)]
    for part in _parts(len(years), flat.shape[1], parameters):
        for target, values in zip(found, _of_cells(years, flat[:, part], spread[:, part], parameters)):
            target[part] = values
    slope, error, low, high, count = (values.reshape(shape) for values in found)
    return Trends(slope=slope, error=error, low=low, high=high, count=count)


def _parts(dates: int, cells: int, parameters: SeriesParameters) -> Iterator[slice]:
    """Parts of all cells whose slopes fit into memory together."""
    pairs = dates * (dates - 1) // 2
    step = max(1, parameters.values_at_once // pairs)
    for first in range(0, cells, step):
        yield slice(first, min(first + step, cells))


def _of_cells(
    years: FloatArray, heights: Floats, errors: Floats, parameters: SeriesParameters
) -> Tuple[Floats, Floats, Floats, Floats, Floats]:
    """Slope, error, low, high and number of dates of cells in a row, (dates, cells)."""
    known = np.isfinite(heights)
    count = known.sum(axis=0)
    first, second = np.triu_indices(len(years), 1)
    apart = (years[second] - years[first]).astype(np.float32)[:, None]
    slopes = (heights[second] - heights[first]) / apart
    slopes.sort(axis=0)  # what is unknown comes last
    pairs = count * (count - 1) // 2
    ranks = np.array([interval_rank(dates, parameters.share) for dates in range(len(years) + 1)])[count]

    def at(index: IntArray, good: Mask) -> Floats:
        taken = np.take_along_axis(slopes, np.clip(index, 0, len(slopes) - 1)[None], axis=0)[0]
        return np.where(good, taken, np.float32(np.nan))

    enough = count >= 3
    middle = 0.5 * (at((pairs - 1) // 2, enough) + at(pairs // 2, enough))
    low, high = at(ranks - 1, enough & (ranks > 0)), at(pairs - ranks, enough & (ranks > 0))
    error = np.where(enough, _standard_error(years, known, errors, parameters), np.nan)
    return middle, error.astype(np.float32), low, high, np.where(count > 0, count, np.nan)


def _standard_error(years: FloatArray, known: Mask, errors: Floats, parameters: SeriesParameters) -> Floats:
    """The standard deviation of the slopes, from that of least squares, whose errors are independent.

    The median of slopes is less efficient, by as much as the times differ from their ranks (Sen 1968, section 6).
    """
    weights = known.astype(np.float64)
    count = np.maximum(weights.sum(axis=0), 1)

    def centred(values: FloatArray) -> FloatArray:
        return np.asarray(weights * (values - (weights * values).sum(axis=0) / count))

    away, ranks = centred(years[:, None]), centred(np.cumsum(weights, axis=0))
    with np.errstate(invalid="ignore", divide="ignore"):
        squares = (away**2).sum(axis=0)
        alike = (away * ranks).sum(axis=0) ** 2 / (squares * (ranks**2).sum(axis=0))
        spread = np.sqrt(((away * np.where(known, errors, 0.0)) ** 2).sum(axis=0)) / squares
        return np.asarray(spread * np.sqrt(parameters.efficiency / alike))


# Dates of change --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ChangeDates:
    """(rows, columns): the numbers, from 1, of the first date that shows a significant change and of the last one, 0
    where nothing changed; ``sign`` is 1 where the surface is higher at the end, -1 where it is lower."""

    first: IntArray
    last: IntArray
    sign: IntArray


def change_dates(heights: FloatImage, errors: FloatImage, parameters: SeriesParameters = SERIES) -> ChangeDates:
    """When (dates, rows, columns) heights, m, left their first level, and when they had reached their last.

    A height that neither the date before nor the one after confirms is taken as wrong (running median of three); the
    first and the last date have only one neighbour, so that a change of which they alone tell must be
    ``parameters.unconfirmed`` times as large.
    """
    dates, shape = len(heights), heights.shape[1:]
    order = np.argsort(~np.isfinite(heights), axis=0, kind="stable")  # known dates first, in their order
    values, spread = (np.take_along_axis(array, order, axis=0) for array in (heights, errors))
    count = np.isfinite(values).sum(axis=0)
    smooth = _confirmed(values, count)
    left = _departure(smooth, spread, count, parameters)
    reversed_order = np.clip(count[None] - 1 - np.arange(dates)[(...,) + (None,) * len(shape)], 0, None)
    back, back_spread = (np.take_along_axis(array, reversed_order, axis=0) for array in (smooth, spread))
    reached = count - 1 - _departure(back, back_spread, count, parameters) + 1
    good = (count >= 3) & (left < count) & (reached > 0) & (left <= reached)
    last_known = np.take_along_axis(smooth, np.clip(count - 1, 0, None)[None], axis=0)[0]
    sign = np.where(good, np.sign(np.nan_to_num(last_known - smooth[0])), 0).astype(np.int64)

    def number(index: IntArray) -> IntArray:
        date = np.take_along_axis(order, np.clip(index, 0, dates - 1)[None], axis=0)[0]
        return np.where(good, date + 1, 0)

    return ChangeDates(number(left), number(reached), sign)


def _confirmed(values: FloatImage, count: IntArray) -> FloatImage:
    """The running median of three of the known values, which come first; the first and the last stay as they are."""
    smooth = values.copy()
    for index in range(1, len(values) - 1):
        low, middle, high = np.sort(values[index - 1 : index + 2], axis=0)
        smooth[index] = np.where(index < count - 1, middle, values[index])
    return smooth


def _departure(smooth: FloatImage, errors: FloatImage, count: IntArray, parameters: SeriesParameters) -> IntArray:
    """The index of the first value that differs from the level of the first; ``count`` or more where none does."""
    result = np.full(count.shape, len(smooth) + 1, np.int64)
    level = _levels(len(smooth), parameters.share)[count]
    with np.errstate(invalid="ignore", divide="ignore"):

        def beyond(one: int, other: int) -> FloatImage:
            return np.asarray(np.abs(smooth[one] - smooth[other]) / (level * np.hypot(errors[one], errors[other])))

        for index in range(len(smooth) - 1, 0, -1):
            size = beyond(index, 0)
            found = size > parameters.unconfirmed
            if index >= 2:  # the second date confirms the first, and the next one this
                found |= (size > 1) & (beyond(index, 1) > 1) & (index < count - 1)
            result = np.where(found & (index < count), index, result)
    return result


@lru_cache(maxsize=64)
def _levels(dates: int, share: float) -> FloatArray:
    """By the number of known dates: how many standard deviations all but ``1 - share`` of unchanged cells stay within
    at all comparisons with one date (Sidak 1967)."""
    normal = NormalDist()
    return np.array(
        [normal.inv_cdf(0.5 + 0.5 * share ** (1 / max(count - 1, 1))) for count in range(dates + 1)], np.float32
    )


# Coherence ---------------------------------------------------------------------------------------------------------


def coherent_signs(signs: IntArray) -> IntArray:
    """Signs (rows, columns) where enough of the neighbours have the same (the coherence of Wheaton et al. 2010),
    and those beside them; 0 elsewhere."""
    plan = CHANGE.detection
    side = 2 * plan.coherent_radius + 1
    least, result = math.ceil(plan.coherent_share * side**2), np.zeros_like(signs)
    for sign in (1, -1):
        own = signs == sign
        core = own & (around(own, plan.coherent_radius) >= least)
        result[own & (around(core, plan.coherent_radius) > 0)] = sign
    return result


def around(cells: Mask, radius: int) -> IntArray:
    """How many cells are true in the square around each."""
    side = 2 * radius + 1
    total = np.pad(cells.astype(np.int64), ((radius + 1, radius), (radius + 1, radius))).cumsum(axis=0).cumsum(axis=1)
    return np.asarray(total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side])
