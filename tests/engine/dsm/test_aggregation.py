"""Fusing cells against numpy's medians, and the radius filter against a k-d tree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from repm_qgis.dsm.aggregation import aggregate, automatic_radius, lonely

NUMBERS = np.random.default_rng(8)


def maps(count, spread=0.1, gaps=0.2):
    truth = 200 + 30 * NUMBERS.uniform(size=(30, 40))
    stack = truth + NUMBERS.normal(0, spread, (count, 30, 40))
    stack[NUMBERS.uniform(size=stack.shape) < gaps] = np.nan
    return truth, stack


@pytest.mark.parametrize("count", (1, 2, 3, 4, 5, 7))
def test_equal_maps_give_numpys_median(count):
    _, stack = maps(count)
    # A floor so wide that no value is thrown out.
    found = aggregate(list(stack), [np.full((30, 40), 0.7)] * count, [10.0] * count, "median")
    known = np.isfinite(stack).any(axis=0)
    expected = np.full((30, 40), np.nan)
    expected[known] = np.nanmedian(stack[:, known], axis=0)
    np.testing.assert_allclose(found.height, expected, atol=1e-9)
    assert (found.count == np.isfinite(stack).sum(axis=0)).all()
    np.testing.assert_allclose(found.score[known], 0.7)
    several = found.count > 1
    np.testing.assert_allclose(found.spread[several], np.nanstd(stack[:, several], axis=0), atol=1e-9)
    assert np.isnan(found.spread[~several]).all()


def test_the_mean():
    _, stack = maps(4)
    found = aggregate(list(stack), [np.ones((30, 40))] * 4, [10.0] * 4, "mean")
    known = np.isfinite(stack).any(axis=0)
    np.testing.assert_allclose(found.height[known], np.nanmean(stack[:, known], axis=0), atol=1e-9)


def test_narrow_pairs_weigh_less():
    """Two maps: their mean, weighted by 1 / metres_per_px."""
    a, b = np.full((5, 5), 100.0), np.full((5, 5), 101.0)
    found = aggregate([a, b], [a, a], [2.0, 6.0], "median")
    np.testing.assert_allclose(found.height, (100 / 2 + 101 / 6) / (1 / 2 + 1 / 6))


@pytest.mark.parametrize("method", ("median", "mean"))
def test_outliers_are_thrown_out(method):
    truth, stack = maps(6, gaps=0.0)
    wrong = NUMBERS.uniform(size=truth.shape) < 0.5
    stack[2][wrong] += 25.0
    stack[5][wrong] -= 60.0
    found = aggregate(list(stack), [np.ones_like(truth)] * 6, [1.0] * 6, method)
    assert np.abs(found.height - truth).max() < 0.3
    assert (found.count[wrong] <= 4).all() and found.spread[wrong].max() < 0.5
    assert np.median(found.count[~wrong]) == 6


def test_nothing_stays_nothing():
    found = aggregate([np.full((4, 4), np.nan)] * 3, [np.ones((4, 4))] * 3, [1.0] * 3, "median")
    assert np.isnan(found.height).all() and (found.count == 0).all() and np.isnan(found.score).all()


@pytest.mark.parametrize("cell, radius", ((0.5, 1.5), (1.0, 3.0), (0.3, 2.0), (2.0, 2.0)))
def test_lonely_cells_are_those_a_tree_finds(cell, radius):
    """Neighbours count within a radius on the ground and the same radius in height."""
    height = NUMBERS.uniform(0, 8, (60, 70))
    height[NUMBERS.uniform(size=height.shape) < 0.3] = np.nan
    found, needed = lonely(height, cell, radius)
    rows, cols = np.nonzero(np.isfinite(height))
    places, z = np.column_stack([rows, cols]) * cell, height[rows, cols]
    expected = np.zeros(height.shape, bool)
    for k, near in enumerate(cKDTree(places).query_ball_point(places, radius + 1e-6)):
        count = (np.abs(z[near] - z[k]) <= radius).sum() - 1
        expected[rows[k], cols[k]] = count < needed
    assert (found == expected).all() and 0 < found.sum() < len(rows)


def test_islands_go_and_surfaces_stay():
    height = np.full((50, 50), np.nan)
    height[5:45, 5:25] = 100 + np.arange(20) * 0.8  # a steep slope
    height[20, 40], height[30:32, 35:37] = 120.0, 90.0
    height[10, 10] = 160.0
    found, needed = lonely(height, 1.0, automatic_radius(1.0))
    assert needed == 6
    assert found[20, 40] and found[30:32, 35:37].all() and found[10, 10]
    assert found[5:45, 5:25].sum() == 1


def test_the_automatic_radius():
    assert automatic_radius(0.3) == 1.5 and automatic_radius(1.0) == 3.0
