"""Heights that stray from their surface: what goes, what stays, and what the brightness decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.strays import SurfaceAround

CELL, GROUND, ROOF = 0.5, 20.0, 32.0
UNKNOWN = np.full((60, 60), np.nan, np.float32)


def without_strays(height, brightness, cell, parameters=FUSION.strays):
    return SurfaceAround(height, brightness, cell, parameters).without_strays()


def plain(noise=0.02, seed=0):
    return GROUND + noise * np.random.default_rng(seed).normal(size=(60, 60))


def test_single_cells_that_stray_take_the_height_around_them():
    true = plain()
    height = true.copy()
    cells = ([5, 20, 20, 41, 59], [7, 30, 31, 0, 59])  # one alone, two together, one at a border, one in a corner
    height[cells] += (9.0, -6.0, -6.0, 3.0, -30.0)
    found = without_strays(height, UNKNOWN, CELL)
    np.testing.assert_allclose(found[cells], GROUND, atol=0.1)
    others = np.ones(height.shape, bool)
    others[cells] = False
    np.testing.assert_array_equal(found[others], true[others])


@pytest.mark.parametrize("angle", (0.0, 0.3, 1.2))
def test_a_slope_stays_as_it_is(angle):
    rows, columns = np.mgrid[:60, :60] * CELL
    height = GROUND + 0.8 * (columns * np.cos(angle) + rows * np.sin(angle))
    found = without_strays(height, UNKNOWN, CELL)
    inner = np.s_[5:-5, 5:-5]  # at the border, the windows are one-sided
    np.testing.assert_array_equal(found[inner], height[inner])


def test_rough_ground_stays_as_it_is():
    """Relief of a metre in each cell is no stray, because all cells have it: nearly nothing is replaced."""
    height = plain(noise=1.0)
    assert (without_strays(height, UNKNOWN, CELL) == height).mean() > 0.97


def test_the_corner_of_a_roof_stays_where_the_image_shows_it():
    height = plain(noise=0.0)
    height[20:40, 20:40] = ROOF
    brightness = np.where(height == ROOF, 0.9, 0.2).astype(np.float32)
    np.testing.assert_array_equal(without_strays(height, brightness, CELL), height)
    rounded = without_strays(height, UNKNOWN, CELL)
    assert rounded[20, 20] == GROUND and rounded[30, 30] == ROOF


def test_a_ragged_edge_becomes_that_of_the_image():
    """The roof ends in the middle by its brightness; in every other row matching made it 1 m longer or shorter."""
    height, brightness = np.full((60, 60), GROUND), np.full((60, 60), 0.1, np.float32)
    brightness[:, :30] = 0.8
    for row in range(60):
        height[row, : 30 + (2, 0, -2)[row % 3]] = ROOF
    found = without_strays(height, brightness, CELL)
    before, after = ((heights == ROOF) != (brightness > 0.5) for heights in (height, found))
    assert before.sum() == 80 and after.sum() < 10


def test_holes_stay_and_have_no_weight():
    height = plain()
    height[10:50, 10:50] = np.nan
    height[30, 30] = 90.0  # alone in the hole: there is nothing that it strays from
    found = without_strays(height, UNKNOWN, CELL)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(height))
    assert found[30, 30] == 90.0
    nothing = np.full((60, 60), np.nan)
    assert np.isnan(without_strays(nothing, UNKNOWN, CELL)).all()


def test_cells_of_unknown_brightness_do_not_outvote_those_of_the_same():
    """A roof of two cells' width with unknown ground around it keeps its height: what is unknown is unlike."""
    height = plain(noise=0.0)
    height[:, 29:31] = ROOF
    brightness = np.where(height == ROOF, np.float32(0.9), np.float32(np.nan))
    alike = replace(FUSION.strays, unknown=0.0)
    np.testing.assert_array_equal(without_strays(height, brightness, CELL), height)
    assert (without_strays(height, brightness, CELL, alike) == GROUND).all()


def test_blocks_of_rows_change_nothing():
    height, brightness = plain(noise=0.5), np.random.default_rng(1).random((60, 60)).astype(np.float32)
    height[::7, ::5] += 8.0
    few = replace(FUSION.strays, at_once=200)
    np.testing.assert_array_equal(
        without_strays(height, brightness, CELL, few), without_strays(height, brightness, CELL)
    )


@pytest.mark.parametrize("cell, reach", ((0.1, 5), (0.5, 3), (1.0, 2), (2.0, 1), (10.0, 1)))
def test_the_window_is_one_on_the_ground(cell, reach):
    assert FUSION.strays.reach(cell) == reach


def test_towns_have_walls_and_mountains_have_none(urban, mountains):
    """True heights, with the noise of matching."""
    for scene, expected in ((urban, True), (mountains, False)):
        noise = 0.1 * np.random.default_rng(2).normal(size=scene.surface.shape)
        light = np.full(scene.surface.shape, np.nan, np.float32)
        cell = scene.transform[1]
        assert SurfaceAround(scene.surface + noise, light, cell).walls == expected
    assert not SurfaceAround(np.full((9, 9), np.nan), np.full((9, 9), np.nan, np.float32), CELL).walls
