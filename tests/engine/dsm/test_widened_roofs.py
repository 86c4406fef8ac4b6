"""Roofs that are too wide over the shadow beside them end where the images show it; all other edges stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.dsm.parameters import FUSION
from repm_qgis.dsm.widened_roofs import widened_over_shadow

CELL, GROUND, ROOF = 0.5, 20.0, 45.0
HOUSE, SHADE = np.s_[40:80, 30:90], np.s_[20:40, 30:90]  # the shadow lies north of the house


def town(roof=0.8, lit=0.5, shade=0.05):
    """The true heights of a house on level ground, and the brightness with its shadow."""
    height = np.full((120, 120), GROUND, np.float32)
    light = np.full((120, 120), lit, np.float32)
    height[HOUSE], light[HOUSE], light[SHADE] = ROOF, roof, shade
    return height, light


def widened(height, rows=8):
    """The same with the roof continued into its shadow."""
    wide = height.copy()
    wide[40 - rows : 40, 30:90] = ROOF
    return wide


def test_the_roof_ends_where_the_shadow_begins():
    height, light = town()
    found = widened_over_shadow(widened(height), light, CELL)
    over = np.zeros(height.shape, bool)
    over[32:40, 30:90] = True
    np.testing.assert_array_equal(np.isfinite(found), over)
    np.testing.assert_array_equal(found[over], GROUND)


@pytest.mark.parametrize("turns", (1, 2, 3))
def test_it_does_so_on_all_sides(turns):
    height, light = town()
    straight = widened_over_shadow(widened(height), light, CELL)
    turned = widened_over_shadow(np.rot90(widened(height), turns), np.rot90(light, turns), CELL)
    np.testing.assert_array_equal(turned, np.rot90(straight, turns))


def test_a_true_roof_stays():
    height, light = town()
    assert np.isnan(widened_over_shadow(height, light, CELL)).all()


def test_a_dark_roof_stays_beside_its_shadow():
    """It is darker than the lit ground, and no brighter than the shadow by enough to tell where it ends."""
    height, light = town(roof=0.3)
    assert np.isnan(widened_over_shadow(widened(height), light, CELL)).all()


def test_a_dark_terrace_within_the_roof_stays():
    """It is dark as the shadow, but the bright edge of the roof lies between them."""
    height, light = town()
    light[44:54, 40:60] = 0.05
    assert np.isnan(widened_over_shadow(height, light, CELL)).all()


def test_a_bright_edge_over_bright_ground_stays():
    """Only what is darker than the roof can be a shadow: a bright parapet round a dark roof is a part of it."""
    height, light = town(roof=0.1, lit=0.9, shade=0.9)
    light[40:42, 30:90] = 0.9
    assert np.isnan(widened_over_shadow(height, light, CELL)).all()


def test_low_steps_stay():
    height, light = town()
    low = np.where(height == ROOF, np.float32(GROUND + 2.5), height)
    wide = widened(low)
    wide[32:40, 30:90] = GROUND + 2.5
    assert np.isnan(widened_over_shadow(wide, light, CELL)).all()


def test_what_is_unknown_stays():
    height, light = town()
    wide = widened(height)
    assert np.isnan(widened_over_shadow(wide, np.full_like(light, np.nan), CELL)).all()
    wide[32:40, 30:60] = np.nan
    found = widened_over_shadow(wide, light, CELL)
    assert np.isnan(found[32:40, 30:60]).all() and (found[33:39, 62:88] == GROUND).all()


def test_a_roof_is_cut_back_by_so_much_and_no_more():
    height, light = town()
    near = replace(FUSION, widened=replace(FUSION.widened, reach_m=2.0))
    found = widened_over_shadow(widened(height), light, CELL, near)
    assert np.isfinite(found[32:36, 40:80]).all() and np.isnan(found[36:40, 40:80]).all()


def test_chunks_change_nothing():
    height, light = town()
    few = replace(FUSION, widened=replace(FUSION.widened, at_once=50))
    np.testing.assert_array_equal(
        widened_over_shadow(widened(height), light, CELL, few), widened_over_shadow(widened(height), light, CELL)
    )


@pytest.mark.parametrize("cell, step, reach", ((0.5, 2, 16), (0.1, 2, 16), (2.0, 1, 4), (30.0, 1, 1)))
def test_the_window_holds_at_most_seventeen_places_along_a_side(cell, step, reach):
    assert FUSION.widened.window(cell) == (step, reach)
    assert len(range(0, 2 * reach + 1, step)) <= 17
