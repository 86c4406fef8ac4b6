"""Cells in which one map sees roof and ground."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.fusion.overhangs import without_overhangs
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.gridding import grid_points
from repm_qgis.stereo.height_maps import HeightMap

CELL, PIXEL, GROUND, ROOF, METRES_PER_PX = 0.5, 0.3, 100.0, 120.0, 2.0
GRID = CellGrid(1000.0, 2000.0, CELL, (100, 80))
SLANT = 0.4  # m to the south for each m up: the image looks from the south, and sees southern walls
SOUTH, NORTH, WEST, EAST = 1966.0, 1978.0, 1010.0, 1030.0  # of the house


def seen(given_to_roof, slant=SLANT):
    """The map of a house whose southern wall was matched as roof in its upper part, and as ground in the rest."""
    row, column = np.mgrid[:180, :140].astype(float)
    x, y = 1000.0 + PIXEL * column, 2000.0 - PIXEL * row  # where lines of sight cross the ground
    long = (ROOF - GROUND) * slant
    within = (x >= WEST) & (x <= EAST)
    wall = within & (y >= SOUTH) & (y < SOUTH + long)
    roof = within & (y >= SOUTH + long) & (y <= NORTH + long)
    roof |= wall & (y >= SOUTH + long * (1 - given_to_roof))
    height = np.where(roof, ROOF, GROUND)
    score = np.full(height.shape, 0.9, np.float32)
    up = height - GROUND
    return HeightMap(x, y - up * slant, height, score, np.zeros(height.shape, bool), (0.0, -slant))


def gridded(heights, grid=GRID, metres_per_px=METRES_PER_PX):
    height, score, _ = grid_points(grid, heights.x, heights.y, heights.height, heights.score, PIXEL)
    return height, score, without_overhangs(grid, heights, heights.height, height, score, metres_per_px, PIXEL)


def truth():
    x, y = np.meshgrid(*GRID.centres())
    house = (x > WEST) & (x < EAST) & (y > SOUTH) & (y < NORTH)
    # Behind the house the image shows nothing.
    hidden = (x > WEST - 1) & (x < EAST + 1) & (y >= NORTH - 1) & (y < NORTH + 9)
    return np.where(hidden, np.nan, np.where(house, ROOF, GROUND))


def wrong(height, true):
    known = np.isfinite(true) & np.isfinite(height)
    return int((np.abs(height - true)[known] > 1).sum())


@pytest.mark.parametrize("given_to_roof", [0.15, 0.25, 0.35])
def test_a_wall_matched_as_roof_and_ground_leaves_a_roof_on_its_ground(given_to_roof):
    height, _, (mended, score) = gridded(seen(given_to_roof))
    true = truth()
    # The edge lies where a quarter of the wall ends: what matching gave more or less of it is wrong, and a row.
    rows = abs(given_to_roof - 0.25) * (ROOF - GROUND) * SLANT / CELL + 1
    assert wrong(mended, true) <= round(40 * rows)
    assert wrong(mended, true) < 0.7 * wrong(height, true)
    assert np.nanmax(np.abs(score - np.float32(0.9))) < 1e-6


def test_ground_under_a_roof_is_none():
    heights = seen(0.0)
    heights.height[(heights.height == ROOF) & (np.arange(140) % 2 == 0)] = np.nan  # so that most points are ground
    height, _, (mended, _) = gridded(heights)
    far_in = (np.abs(np.subtract.outer(GRID.centres()[1], np.zeros(80)) - (SOUTH + 5.0)) < 3.0) & (truth() == ROOF)
    assert (height[far_in] < ROOF - 1).all()
    # Cells without any point of the roof stay as they are.
    assert (mended[far_in] < ROOF - 1).mean() < 0.2


def test_a_wide_pairs_roofs_keep_what_they_have_over_ground():
    height, _, (mended, _) = gridded(seen(0.35), metres_per_px=0.6)
    assert not (mended < height - 1).any()
    narrow = gridded(seen(0.35))[2][0]
    assert (narrow < height - 1).sum() > 50
    heights = seen(0.0)
    heights.height[(heights.height == ROOF) & (np.arange(140) % 2 == 0)] = np.nan
    height, _, (mended, _) = gridded(heights, metres_per_px=0.6)
    assert (mended > height + 1).sum() > 200


def test_a_view_from_above_changes_nothing():
    height, _, (mended, _) = gridded(seen(0.25, slant=0.0))
    np.testing.assert_array_equal(mended, height)


def test_cells_that_hold_the_edges_of_roofs_stay():
    coarse = CellGrid(1000.0, 2000.0, 2.0, (25, 20))
    height, _, (mended, _) = gridded(seen(0.25), coarse)
    np.testing.assert_array_equal(mended, height)


def test_maps_without_a_match_stay_empty():
    heights = seen(0.25)
    heights.height[:] = np.nan
    height, _, (mended, _) = gridded(heights)
    assert np.isnan(height).all() and np.isnan(mended).all()
