"""Which points of height maps are kept: on the DSM, and on the walls between its cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.solids.cloud_points import cloud_points
from repm_qgis.solids.parameters import SOLIDS
from repm_qgis.stereo.height_maps import HeightMap

GRID = CellGrid(500.0, 900.0, 1.0, (20, 20))
ROOF_M, EDGE = 10.0, 10  # a roof on the western half, ground at 0 m on the other
ALL = np.ones(GRID.shape, dtype=bool)


def surface():
    height = np.zeros(GRID.shape)
    height[:, :EDGE] = ROOF_M
    return height


def source(x, z, rows=range(2, 12)):
    """A height map whose rows are profiles across the edge: metres from the western border, and heights."""
    x, z = np.asarray(x, dtype=float), np.asarray(z, dtype=float)
    shape = len(rows), len(x)
    y = GRID.north - 0.5 - np.asarray(rows, dtype=float)
    known = np.broadcast_to(z, shape).copy()
    places = np.broadcast_to(GRID.west + x, shape), np.broadcast_to(y[:, None], shape)
    heights = HeightMap(*places, known, np.full(shape, 0.9, np.float32), np.zeros(shape, bool))
    return heights


def kept(heights, height=None, own=ALL, scale=1.0, normals=False, **cloud):
    height = surface() if height is None else height
    return cloud_points(
        heights, scale, GRID, surface=height, own=own, with_normals=normals, parameters=replace(SOLIDS.cloud, **cloud)
    )


def profile(points):
    """Heights of the points by row, as one profile: all rows are alike."""
    return sorted({round(float(z), 6) for z in points[:, 2]})


FACADE = [10.0, 10.0, 8.5, 7.0, 5.5, 4.0, 2.5, 0.2, 0.0]
ACROSS = [8.5, 9.5, 10.1, 10.2, 10.1, 10.3, 10.2, 11.5, 12.5]


def test_a_facade_is_kept_with_roof_and_ground():
    assert profile(kept(source(ACROSS, FACADE))) == sorted(set(FACADE))
    assert profile(kept(source(ACROSS, FACADE), wall_cells=0)) == [0.0, 0.2, 10.0]  # those on the DSM


def test_points_keep_their_place_and_score():
    points = kept(source(ACROSS, FACADE))
    assert points.shape == (10 * len(FACADE), 4) and (points[:, 3] == np.float32(0.9)).all()
    first = points[np.isclose(points[:, 2], 7.0)]
    assert np.allclose(first[:, 0], 510.2) and np.allclose(np.sort(first[:, 1]), 888.5 + np.arange(10))


def test_walls_reach_two_cells_and_lie_between_their_ends():
    middle = [5.0, 5.5, 5.0]
    for away, found in ((11.9, True), (12.1, False)):  # cells 11 and 12: the roof's last cell is 9
        assert bool(len(kept(source([away, away, away], middle)))) == found
    assert not len(kept(source([10.5, 10.5, 10.5], [10.2, 10.3, 10.2])))  # above the roof: the roof made wider
    assert not len(kept(source([10.5, 10.5, 10.5], [9.7, 9.8, 9.7])))  # and within half a px of it
    assert len(kept(source([10.5, 10.5, 10.5], [9.7, 9.8, 9.7]), wall_px=0.0))


def test_a_point_that_the_map_does_not_go_on_from_is_no_wall():
    lone = source(ACROSS, FACADE)
    lone.height[:, 2:7] = np.nan
    lone.height[4, 4] = 5.5
    assert 5.5 not in profile(kept(lone))
    assert len(kept(lone)) == 40


def test_what_was_filled_is_no_point():
    filled = source(ACROSS, FACADE)
    filled.filled[:, 2:7] = True
    assert profile(kept(filled)) == [0.0, 0.2, 10.0]


@pytest.mark.parametrize("hole", (9, 10))
def test_a_hole_at_the_edge_does_not_lose_the_wall(hole):
    height = surface()
    height[:, hole] = np.nan
    assert {8.5, 7.0, 5.5, 4.0, 2.5} <= set(profile(kept(source(ACROSS, FACADE), height=height)))


def test_only_own_cells_have_points_and_neighbours_count():
    own = ALL.copy()
    own[:, :EDGE] = False  # the roof is another tile's
    points = kept(source(ACROSS, FACADE), own=own)
    assert points[:, 0].min() > GRID.west + EDGE
    assert profile(points) == [0.0, 0.2, 2.5, 4.0, 5.5, 7.0, 8.5]


def test_a_map_without_points_has_none():
    empty = source(ACROSS, np.full(len(ACROSS), np.nan))
    assert kept(empty).shape == (0, 4) and kept(empty, normals=True).shape == (0, 7)


def test_a_roof_that_the_dsm_cut_back_goes_and_the_wall_stays():
    """Where a strip of the roof became ground, its points lie on nothing; those of a wall stand at the edge."""
    strip = source([*ACROSS, 5.2, 6.2, 7.2], [*FACADE, 10.0, 10.0, 10.0])
    assert len(kept(strip)) == 10 * (len(FACADE) + 3)
    cut = surface()
    cut[:, 5:EDGE] = 0.0
    left = kept(strip, height=cut)
    assert profile(left) == [0.0, 0.2]
    wall = source([5.1, 5.2, 5.3, 5.2, 5.1], [8.0, 6.5, 5.0, 3.5, 2.0])
    assert len(kept(wall, height=cut)) == 50 and not len(kept(wall))
