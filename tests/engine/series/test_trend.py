"""Trends and dates of change against scipy, against counts over all orders, and against simulated truth."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import kendalltau, theilslopes

from repm_qgis.series.parameters import SeriesParameters
from repm_qgis.series.trend import change_dates, coherent_signs, interval_rank, trends

YEARS = np.array([0.0, 0.8, 2.1, 3.0, 4.4, 5.0, 6.3, 7.1, 8.2, 9.9])


def surfaces(rng, years, slope, sigma, side=60):
    """Cells that rise by ``slope`` m a year, with errors of ``sigma`` (dates,) m."""
    sigma = np.asarray(sigma, float)[:, None, None]
    heights = 50 + slope * years[:, None, None] + rng.normal(0, 1, (len(years), side, side)) * sigma
    return heights.astype(np.float32), np.broadcast_to(sigma, heights.shape).astype(np.float32)


@pytest.mark.parametrize("dates", (3, 4, 5, 7, 10))
def test_the_slope_is_scipys_whatever_dates_are_missing(dates):
    rng = np.random.default_rng(dates)
    heights, errors = surfaces(rng, YEARS[:dates], 0.4, np.ones(dates), 12)
    heights[rng.uniform(size=heights.shape) < 0.2] = np.nan
    found = trends(YEARS[:dates], heights, errors, SeriesParameters(values_at_once=500))
    for row, column in itertools.product(range(12), range(12)):
        known = np.isfinite(heights[:, row, column])
        if known.sum() < 3:
            assert np.isnan(found.slope[row, column]) and np.isnan(found.low[row, column])
            continue
        expected = theilslopes(heights[known, row, column], YEARS[:dates][known], 0.95)
        assert found.slope[row, column] == pytest.approx(expected[0], abs=1e-4)
        assert found.count[row, column] == known.sum()


def test_the_interval_is_within_a_rank_of_scipys_normal_one():
    heights, errors = surfaces(np.random.default_rng(1), YEARS, 0.4, np.ones(10), 8)
    found = trends(YEARS, heights, errors)
    first, second = np.triu_indices(10, 1)
    for row, column in itertools.product(range(8), range(8)):
        cell = heights[:, row, column].astype(float)
        slopes = np.sort((cell[second] - cell[first]) / (YEARS[second] - YEARS[first]))
        _, _, low, high = theilslopes(cell, YEARS, 0.95)
        for ours, theirs in ((found.low[row, column], low), (found.high[row, column], high)):
            assert abs(np.abs(slopes - ours).argmin() - np.abs(slopes - theirs).argmin()) <= 1


@pytest.mark.parametrize("dates", (3, 4, 5, 6, 7))
def test_the_rank_of_the_interval_is_exact(dates):
    """All orders of so many values, counted."""
    inversions = []
    for order in itertools.permutations(range(dates)):
        inversions.append(sum(order[i] > order[j] for i, j in itertools.combinations(range(dates), 2)))
    rank = interval_rank(dates, 0.95)
    outside = [np.mean(np.array(inversions) <= most) for most in (rank - 1, rank)]
    assert 2 * outside[0] <= 0.05 < 2 * outside[1]
    assert (rank > 0) == (dates >= 5)


def test_the_rank_agrees_with_kendalls_exact_test():
    """A cell whose interval just excludes zero is one that the exact test finds significant."""
    rng = np.random.default_rng(2)
    heights, errors = surfaces(rng, YEARS, 0.2, np.ones(10), 20)
    found = trends(YEARS, heights, errors)
    for row, column in itertools.product(range(20), range(20)):
        p = kendalltau(YEARS, heights[:, row, column], method="exact").pvalue
        excluded = found.low[row, column] > 0 or found.high[row, column] < 0
        assert excluded == (p <= 0.05), p


@pytest.mark.parametrize("dates", (5, 6, 8, 10))
def test_intervals_and_standard_errors_cover_the_truth_at_their_rates(dates):
    rng = np.random.default_rng(10 + dates)
    heights, errors = surfaces(rng, YEARS[:dates], -1.3, np.full(dates, 0.5), 150)
    found = trends(YEARS[:dates], heights, errors)
    covered = ((found.low <= -1.3) & (found.high >= -1.3)).mean()
    standard = (found.slope + 1.3) / found.error
    print(f"{dates} dates: interval covers {100 * covered:.1f} %, standardised errors {standard.std():.3f}")
    assert 0.945 <= covered <= 0.99
    assert 0.9 < standard.std() < 1.1 and abs(standard.mean()) < 0.02


def test_one_wrong_date_moves_the_trend_little():
    rng = np.random.default_rng(3)
    heights, errors = surfaces(rng, YEARS, 0.5, np.full(10, 0.1), 80)
    wrong = heights.copy()
    wrong[6] += 8.0
    plain, robust = (trends(YEARS, each, errors).slope for each in (heights, wrong))
    squares = np.polyfit(YEARS, wrong.reshape(10, -1), 1)[0]
    assert abs(np.median(robust) - 0.5) < 0.03 < 0.1 < abs(np.median(squares) - 0.5)
    assert abs(np.median(plain) - 0.5) < 0.002


def test_noise_has_no_dates_of_change_and_few_significant_trends():
    rng = np.random.default_rng(4)
    for dates in (3, 5, 10):
        heights, errors = surfaces(rng, YEARS[:dates], 0.0, np.linspace(0.2, 0.6, dates), 200)
        found = change_dates(heights, errors)
        assert (found.first > 0).mean() < 0.01 and ((found.first > 0) == (found.last > 0)).all()
        assert (trends(YEARS[:dates], heights, errors).signs != 0).mean() < 0.06


@pytest.mark.parametrize("gone", ((), (2,), (5, 6)))
def test_a_step_and_a_ramp_have_their_dates(gone):
    """A pit between the fourth and the fifth date; a heap that grows from the third to the eighth."""
    rng = np.random.default_rng(5)
    heights, errors = surfaces(rng, YEARS, 0.0, np.full(10, 0.15), 60)
    heights[4:, :20] -= 3.0
    heights[:, 30:50] += np.interp(np.arange(10), [1, 7], [0, 6])[:, None, None].astype(np.float32)
    heights[list(gone)] = np.nan
    found = change_dates(heights, errors)
    step = 4 if 4 not in gone else 5
    assert (found.first[:20] == step + 1).mean() > 0.99 and (found.last[:20] == step + 1).mean() > 0.99
    rising = slice(30, 50)
    first = next(date for date in (2, 3) if date not in gone)
    last = 7
    assert (found.first[rising] == first + 1).mean() > 0.95 and (found.last[rising] == last + 1).mean() > 0.95
    assert (found.sign[:20] == -1).mean() > 0.99 and (found.sign[rising] == 1).all()
    assert (found.first[20:30] == 0).mean() > 0.99


def test_an_outlier_within_the_series_is_no_change_and_one_at_its_end_must_be_large():
    rng = np.random.default_rng(6)
    heights, errors = surfaces(rng, YEARS, 0.0, np.full(10, 0.1), 40)
    within = heights.copy()
    within[5] += 7.0
    assert (change_dates(within, errors).first > 0).mean() < 0.001
    for size, share in ((0.5, 0.0), (2.0, 1.0)):  # the level is about 0.4 m, and twice that is needed
        late = heights.copy()
        late[9] += size
        found = change_dates(late, errors)
        assert abs((found.first == 10).mean() - share) < 0.02


def test_lone_cells_are_not_significant_and_squares_keep_their_corners():
    signs = np.zeros((40, 40), np.int64)
    signs[5, 5] = signs[8, 9] = 1
    signs[20:30, 12:22] = -1
    found = coherent_signs(signs)
    assert (found[:15] == 0).all() and (found[20:30, 12:22] == -1).all() and (found != 0).sum() == 100
