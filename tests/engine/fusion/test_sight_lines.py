"""Heights that other views look through are replaced, or dropped."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.fusion.aggregation import HeightLayer, aggregate
from repm_qgis.fusion.parameters import FUSION
from repm_qgis.fusion.sight_lines import SightLines, Witnesses
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.stereo.height_maps import HeightMap

GRID = CellGrid(1000.0, 2000.0, 1.0, (40, 60))
GROUND, ROOF, METRES_PER_PX = 100.0, 130.0, 1.0


def seen_by(ray, surface=lambda x, y: np.full(x.shape, GROUND), size=(90, 110)):
    """A map with pixels of half a metre, whose lines of sight cross the ground height at places on a grid."""
    row, column = np.mgrid[: size[0], : size[1]].astype(float)
    x, y = GRID.west + 2 + 0.5 * column, GRID.north - 2 - 0.5 * row
    height = surface(x, y)
    up = height - GROUND
    return HeightMap(
        x + up * ray[0], y + up * ray[1], height, np.full(size, 0.9, np.float32), np.zeros(size, bool), ray
    )


def sight(ray, **how):
    return SightLines.of(seen_by(ray, **how), METRES_PER_PX)


@pytest.mark.parametrize("ray", [(0.3, -0.2), (0.0, 0.0), (-0.5, 0.4)])
def test_a_point_lies_on_the_line_of_sight_of_the_pixel_that_sees_it(ray):
    lines = sight(ray, surface=lambda x, y: GROUND + 10 * np.sin(x / 9) * np.cos(y / 7))
    row, column = np.array([5, 40, 80]), np.array([7, 50, 100])
    for z in (GROUND - 20, GROUND + 60):
        x = GRID.west + 2 + 0.5 * column + (z - GROUND) * ray[0]
        y = GRID.north - 2 - 0.5 * row + (z - GROUND) * ray[1]
        u, v = lines.pixels(x, y, np.full(3, z))
        assert u.tolist() == column.tolist() and v.tolist() == row.tolist()
    u, v = lines.pixels(np.array([GRID.west - 50]), np.array([GRID.north]), np.array([GROUND]))
    assert u.tolist() == [-1]


def test_a_map_with_hardly_a_match_is_not_heard():
    heights = seen_by((0.1, 0.1))
    heights.height[:] = np.nan
    heights.height[:5, :5] = GROUND
    assert SightLines.of(heights, METRES_PER_PX) is None


def test_what_stands_in_a_line_of_sight_is_looked_through_and_what_it_ends_at_is_seen():
    witnesses = Witnesses(GRID, [sight((0.3, -0.2)), sight((-0.4, 0.1))])
    cells = np.array([20 * 60 + 25, 20 * 60 + 26])
    seen, through = witnesses.counts(cells, np.array([ROOF - 15, GROUND + 0.5]))
    assert seen.tolist() == [0, 2] and through.tolist() == [2, 0]


def test_an_edge_a_pixel_away_is_not_looked_through():
    """A view's own edges are a pixel or so off: only what its neighbours too see far below is looked through."""
    edge = GRID.west + 24.9

    def house(x, y):
        return np.where(x >= edge, ROOF, GROUND)

    witnesses = Witnesses(GRID, [sight((0.0, 0.0), surface=house)])
    column = np.array([20, 22, 24])  # cells whose centres lie 4.4, 2.4 and 0.4 m outside the house
    _, through = witnesses.counts(20 * 60 + column, np.full(3, ROOF))
    assert through.tolist() == [1, 1, 0]


def layer(height, background=np.nan):
    full = [np.broadcast_to(np.asarray(value, float), GRID.shape).copy() for value in (height, 0.9, background)]
    return HeightLayer(*full, METRES_PER_PX)


def roof_that_is_not_there():
    """Heights of a map that has a roof on a patch of level ground."""
    height = np.full(GRID.shape, GROUND)
    height[18:23, 22:28] = ROOF - 15
    return height


def test_a_height_that_the_others_look_through_gives_way_to_theirs():
    """Three maps have the same wrong roof, and outvote the one that has the ground there."""
    wrong = roof_that_is_not_there()
    layers = [layer(wrong), layer(wrong), layer(wrong), layer(GROUND)]
    patch = (slice(19, 22), slice(23, 27))
    assert aggregate(layers, "mean").height[patch] == pytest.approx(ROOF - 15)
    witnesses = Witnesses(GRID, [sight(ray) for ray in ((0.3, -0.2), (-0.4, 0.1), (0.1, 0.3))])
    fused = aggregate(layers, "mean", FUSION, witnesses)
    assert fused.height == pytest.approx(GROUND)
    assert (fused.count[patch] == 1).all() and (fused.count[0] == 4).all()


def test_a_height_that_the_others_look_through_is_dropped_where_there_is_no_other():
    wrong = roof_that_is_not_there()
    hole = np.where(wrong == GROUND, GROUND, np.nan)
    witnesses = Witnesses(GRID, [sight((0.3, -0.2)), sight((-0.4, 0.1))])
    fused = aggregate([layer(wrong), layer(hole)], "mean", FUSION, witnesses)
    patch = np.isfinite(hole)
    assert np.isnan(fused.height[~patch]).all() and not fused.count[~patch].any()
    assert fused.height[patch] == pytest.approx(GROUND)


def test_witnesses_who_see_the_same_change_nothing():
    slope = GROUND + 0.8 * np.arange(GRID.shape[1])[None, :] * np.ones(GRID.shape)
    layers = [layer(slope), layer(slope + 0.05)]

    def hill(x, y):
        return GROUND + 0.8 * (x - GRID.west - 0.5)

    fused = aggregate(layers, "mean", FUSION, Witnesses(GRID, [sight((0.0, 0.0), surface=hill)] * 2))
    np.testing.assert_array_equal(fused.height, aggregate(layers, "mean").height)
