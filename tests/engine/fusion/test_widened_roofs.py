"""Roofs that are too wide over the shadow beside them end where the images show it; all other edges stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.widened_roofs import widened_over_shadow

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


MIDDLE = np.s_[:, 46:74]  # where only shadow lies before the wall, not the lit ground beside it


def cut_back(height, light, weak=None, parameters=FUSION):
    """What is cut back, where by default the images support all heights."""
    weak = np.zeros(height.shape, bool) if weak is None else weak
    return widened_over_shadow(height, light, weak, CELL, parameters)


def test_the_roof_ends_where_the_shadow_begins():
    height, light = town()
    found = cut_back(widened(height), light)
    over = np.zeros(height.shape, bool)
    over[32:40, 30:90] = True
    np.testing.assert_array_equal(np.isfinite(found), over)
    np.testing.assert_array_equal(found[over], GROUND)


@pytest.mark.parametrize("turns", (1, 2, 3))
def test_it_does_so_on_all_sides(turns):
    height, light = town()
    straight = cut_back(widened(height), light)
    turned = cut_back(np.rot90(widened(height), turns), np.rot90(light, turns))
    np.testing.assert_array_equal(turned, np.rot90(straight, turns))


def test_a_true_roof_stays():
    height, light = town()
    assert np.isnan(cut_back(height, light)).all()


def test_a_dark_roof_stays_beside_its_shadow():
    """It is darker than the lit ground, and no brighter than the shadow by enough to tell where it ends."""
    height, light = town(roof=0.3)
    assert np.isnan(cut_back(widened(height), light)).all()


def test_less_contrast_will_do_where_the_images_hardly_support_the_height():
    height, light = town(roof=0.4)
    wide = widened(height)
    weak = wide != height
    assert np.isnan(cut_back(wide, light)).all()
    np.testing.assert_array_equal(np.isfinite(cut_back(wide, light, weak))[MIDDLE], weak[MIDDLE])
    even_darker = town(roof=0.3)[1]
    assert np.isnan(cut_back(wide, even_darker, weak)).all()


def test_a_roof_is_as_bright_as_its_sure_cells_are():
    """What is too wide is four times as wide as the roof, which would be dark in the median."""
    height, light = town()
    narrow = np.s_[44:80, 30:90]
    height[narrow], light[narrow] = GROUND, 0.5
    wide = widened(height, 12)
    weak = wide != height
    assert np.isnan(cut_back(wide, light)[30:40]).all()
    np.testing.assert_array_equal(np.isfinite(cut_back(wide, light, weak)), weak)


def test_a_sure_roof_half_in_the_dark_stays_and_a_weak_one_goes_by_its_bright_part():
    height, light = town(roof=0.4)
    light[40:48, 30:90] = 0.05
    light[56:80, 30:90] = 0.05
    wide = widened(height, 4)
    weak = wide != height
    assert np.isnan(cut_back(wide, light)).all()
    found = cut_back(wide, light, weak)
    np.testing.assert_array_equal(np.isfinite(found)[MIDDLE], weak[MIDDLE])


def test_a_dark_terrace_within_the_roof_stays():
    """It is dark as the shadow, but the bright edge of the roof lies between them."""
    height, light = town()
    light[44:54, 40:60] = 0.05
    assert np.isnan(cut_back(height, light)).all()


def test_a_bright_edge_over_bright_ground_stays():
    """Only what is darker than the roof can be a shadow: a bright parapet round a dark roof is a part of it."""
    height, light = town(roof=0.1, lit=0.9, shade=0.9)
    light[40:42, 30:90] = 0.9
    assert np.isnan(cut_back(height, light)).all()


def test_low_steps_stay():
    height, light = town()
    low = np.where(height == ROOF, np.float32(GROUND + 2.5), height)
    wide = widened(low)
    wide[32:40, 30:90] = GROUND + 2.5
    assert np.isnan(cut_back(wide, light)).all()


def test_what_is_unknown_stays():
    height, light = town()
    wide = widened(height)
    assert np.isnan(cut_back(wide, np.full_like(light, np.nan))).all()
    wide[32:40, 30:60] = np.nan
    found = cut_back(wide, light)
    assert np.isnan(found[32:40, 30:60]).all() and (found[33:39, 62:88] == GROUND).all()


def test_a_roof_is_cut_back_by_so_much_and_no_more():
    height, light = town()
    near = replace(FUSION, widened=replace(FUSION.widened, reach_m=2.0))
    found = cut_back(widened(height), light, parameters=near)
    assert np.isfinite(found[32:36, 40:80]).all() and np.isnan(found[36:40, 40:80]).all()


def test_chunks_change_nothing():
    height, light = town()
    few = replace(FUSION, widened=replace(FUSION.widened, at_once=50))
    np.testing.assert_array_equal(cut_back(widened(height), light, parameters=few), cut_back(widened(height), light))


@pytest.mark.parametrize("cell, step, reach", ((0.5, 2, 16), (0.1, 2, 16), (2.0, 1, 4), (30.0, 1, 1)))
def test_the_window_holds_at_most_seventeen_places_along_a_side(cell, step, reach):
    assert FUSION.widened.window(cell) == (step, reach)
    assert len(range(0, 2 * reach + 1, step)) <= 17
