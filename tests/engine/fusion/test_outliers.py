from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.fusion.outliers import remove_isolated_points


def brute(height, tolerance):
    """The rule, neighbour by neighbour."""
    result = height.copy()
    for row, column in np.argwhere(np.isfinite(height)):
        near = height[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        with np.errstate(invalid="ignore"):
            if (np.abs(near - height[row, column]) <= tolerance).sum() - 1 < 2:
                result[row, column] = np.nan
    return result


@pytest.mark.parametrize("seed", (1, 2, 3))
def test_the_rule_is_that_of_counting_neighbours(seed):
    rng = np.random.default_rng(seed)
    height = 500.0 + rng.choice([0.0, 3.0, 20.0], (23, 31), p=[0.6, 0.2, 0.2]) + rng.uniform(0, 0.1, (23, 31))
    height[rng.random(height.shape) < 0.2] = np.nan
    np.testing.assert_array_equal(remove_isolated_points(height, 1.0), brute(height, 2.0))


def test_roofs_towers_and_walls_stay_and_single_points_go():
    height = np.zeros((40, 40))
    height[10:20, 10:20] = 12.0
    height[30:32, 30:32] = 40.0  # a chimney of four pixels
    clean = height.copy()
    height[5, 5], height[15, 15] = 30.0, -25.0
    found = remove_isolated_points(height, 1.3)
    assert np.isnan(found[5, 5]) and np.isnan(found[15, 15])
    found[5, 5], found[15, 15] = 0.0, 12.0
    np.testing.assert_array_equal(found, clean)


def test_nothing_stays_nothing():
    assert np.isnan(remove_isolated_points(np.full((5, 6), np.nan), 1.0)).all()
