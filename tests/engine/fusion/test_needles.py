from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Window
from repm_qgis.fusion.needles import largest_needle, needles
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.geometry.cell_grid import overlapping_blocks

CELL, LARGEST = 0.6, 20


def town():
    """A square with a hall, a kiosk and a tower on slightly rough ground, each seen by one pair."""
    rng = np.random.default_rng(7)
    height = (rng.normal(0.0, 0.2, (60, 70)) - 25.0).astype(np.float32)
    height[5:25, 5:25] += 22.0
    height[40:44, 10:14] += 3.0  # a kiosk of 2.4 m
    height[40:46, 30:36] += 60.0  # a tower of 3.6 m, larger than what is asked
    return height, np.ones_like(height)


def test_nothing_of_a_town_is_a_needle():
    assert not needles(*town(), CELL, LARGEST).any()


@pytest.mark.parametrize("at_m", (71.0, -66.0))
@pytest.mark.parametrize("shape", ((1, 1), (2, 3), (1, 9), (4, 5)))
def test_a_few_cells_far_above_or_below_all_others_are_one(shape, at_m):
    """As on jax_068: with the images 009, 011, 012 eight cells up to 71 m where roofs end at 22, with 009, 012 a pit of
    17 cells in a roof, 30 m deep."""
    height, count = town()
    place = np.s_[50 : 50 + shape[0], 50 : 50 + shape[1]]
    height[place] = at_m
    height[49, 49], height[51, 60] = np.nan, np.nan  # holes beside it say nothing
    wanted = np.zeros(height.shape, bool)
    wanted[place] = True
    np.testing.assert_array_equal(needles(height, count, CELL, LARGEST), wanted)


def test_a_second_map_is_support():
    height, count = town()
    height[50:53, 50:53] = 30.0  # a chimney
    assert needles(height, count, CELL, LARGEST).sum() == 9
    count[51, 51] = 2.0
    assert not needles(height, count, CELL, LARGEST).any()


def test_what_stands_beside_something_as_high_is_none():
    """The last cells of a tower's roof behind a hole."""
    height, count = town()
    height[40:46, 37] = np.nan
    height[41:44, 36:38] = 35.0 - 1.0
    assert not needles(height, count, CELL, LARGEST).any()


def test_a_shaft_that_two_views_can_see_is_none():
    """A yard in the hall, not quite five times as deep as it is wide, and a gap between houses."""
    height, count = town()
    height[10:14, 10:14] = -3.0 - 11.5
    height[16:18, 5:25] = -25.0
    assert not needles(height, count, CELL, LARGEST).any()
    height[10:14, 10:14] = -3.0 - 14.0
    assert needles(height, count, CELL, LARGEST).sum() == 16


def test_steep_ground_is_none():
    """A cliff of 80 degrees, and single peaks of rock as high as they are wide."""
    x = np.arange(80, dtype=np.float32) * CELL
    height = np.tile(np.clip((x - 20.0) * 5.7, 0.0, 60.0), (50, 1)).astype(np.float32)
    height[10:40:10, 5:30:8] += 1.5
    assert not needles(height, np.ones_like(height), CELL, LARGEST).any()


def test_cells_without_any_neighbour_tell_nothing():
    height = np.full((30, 30), np.nan, np.float32)
    height[10:12, 10:12] = 70.0
    assert not needles(height, np.ones_like(height), CELL, LARGEST).any()
    assert not needles(np.full((9, 9), np.nan, np.float32), np.full((9, 9), np.nan), CELL, LARGEST).any()


def test_they_do_not_depend_on_blocks():
    rng = np.random.default_rng(3)
    height, count = rng.choice([0.0, 30.0, 33.5, 90.0], (90, 110), p=[0.7, 0.1, 0.1, 0.1]).astype(np.float32), None
    height[rng.random(height.shape) < 0.1] = np.nan
    count = rng.choice([1.0, 2.0], height.shape, p=[0.9, 0.1])
    whole = needles(height, count, CELL, LARGEST)
    assert whole.any()
    joined = np.zeros_like(whole)
    for own, wide in overlapping_blocks((110, 90), 32, LARGEST + FUSION.needles.around_cells):
        everything = Window(0, 0, 110, 90)
        part = wide.inside(everything)
        joined[own.inside(everything)] = needles(height[part], count[part], CELL, LARGEST)[own.inside(wide)]
    np.testing.assert_array_equal(joined, whole)


def test_the_largest_is_what_matching_removes():
    assert largest_needle(0.62, 0.31) == 20 and largest_needle(1.0, 1.0) == 80
    assert largest_needle(0.01, 1.0) == FUSION.needles.most_cells and largest_needle(100.0, 1.0) == 1
    assert largest_needle(1.0, 1.0, replace(FUSION.needles, speckle_px=40)) == 40
