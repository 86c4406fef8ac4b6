"""Gridding in closed form: planes stay planes, edges keep their top, windows partition the cells."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.gridding import grid_points, surface_step, widening
from repm_qgis.geometry.parameters import GRIDDING


def lattice(spacing, phase, size=40.0):
    """x, y of a regular lattice of points over a square."""
    axis = np.arange(-2.0 + phase, size + 2.0, spacing)
    x, y = np.meshgrid(axis, axis)
    return x.ravel(), y.ravel()


def plane(x, y):
    return 100.0 + 0.3 * x - 0.2 * y


GRID = CellGrid(0.0, 40.0, 1.0, (40, 40))


def residual(x, y, function=plane, grid=GRID):
    heights, _, _ = grid_points(grid, x, y, height=function(x, y), score=np.ones_like(x))
    cx, cy = grid.centres()
    return heights - function(*np.meshgrid(cx, cy))


@pytest.mark.parametrize("phase", (0.0, 0.13, 0.31, 0.5))
@pytest.mark.parametrize("spacing", (0.5, 0.25, 1.0))
def test_a_tilted_plane_is_exact_where_points_divide_the_cell(spacing, phase):
    difference = residual(*lattice(spacing, phase))
    assert np.isfinite(difference).all()
    if spacing < 1 or phase == 0.5:
        assert np.abs(difference).max() < 1e-3
    assert abs(difference.mean()) < 0.02 * 0.5 or spacing == 1.0


@pytest.mark.parametrize("spacing", (0.37, 0.61, 0.83))
def test_other_spacings_do_not_shift_the_surface(spacing):
    """Single cells may sit a little beside; the surface as a whole must not: less than a fiftieth of a cell."""
    x, y = lattice(spacing, 0.1)
    angle = 0.3
    u, v = x - 20, y - 20
    x, y = 20 + np.cos(angle) * u - np.sin(angle) * v, 20 + np.sin(angle) * u + np.cos(angle) * v
    inner = np.s_[12:28, 12:28]
    for slope in ((1.0, 0.0), (0.0, 1.0)):
        difference = residual(x, y, lambda a, b, s=slope: s[0] * a + s[1] * b)[inner]
        assert abs(difference.mean()) < 0.02 and np.abs(difference).max() < 0.3


def test_random_points_do_not_shift_the_surface():
    numbers = np.random.default_rng(0)
    x, y = numbers.uniform(-2, 42, (2, 20000))
    for slope in ((1.0, 0.0), (0.0, 1.0)):
        difference = residual(x, y, lambda a, b, s=slope: s[0] * a + s[1] * b)
        assert abs(difference.mean()) < 0.02


def test_gaps_stay_gaps():
    x, y = lattice(0.5, 0.25)
    keep = ~((x > 10) & (x < 20) & (y > 10) & (y < 20))
    heights, scores, _ = grid_points(GRID, x[keep], y[keep], height=plane(x, y)[keep], score=np.full(keep.sum(), 0.5))
    assert np.isnan(heights[21:29, 11:19]).all() and np.isfinite(heights[:19]).all()
    np.testing.assert_allclose(scores[np.isfinite(heights)], 0.5)
    assert (np.isfinite(heights) == np.isfinite(scores)).all()
    x = np.append(x, 5.0)
    y = np.append(y, 5.0)
    height = np.append(plane(x[:-1], y[:-1]), np.nan)
    assert np.isfinite(grid_points(GRID, x, y, height=height, score=np.ones(len(x)))[0]).all()


def edge_points(walls):
    """A roof of 20 m over the western half, ground before it, and points of the wall between them."""
    x, y = lattice(0.4, 0.05)
    numbers = np.random.default_rng(1)
    wall = numbers.uniform(0, 20, walls)
    height = np.append(np.where(x < 20.3, 20.0, 0.0), wall)
    return np.append(x, np.full(walls, 20.35)), np.append(y, numbers.uniform(0, 40, walls)), height


@pytest.mark.parametrize("walls", (0, 100, 400))
def test_no_cell_lies_between_roof_and_ground(walls):
    x, y, height = edge_points(walls)
    found, _, _ = grid_points(GRID, x, y, height=height, score=np.ones(len(x)), spacing=0.4)
    np.testing.assert_allclose(found[:, :19], 20.0, atol=1e-9)
    np.testing.assert_allclose(found[:, 21:], 0.0, atol=1e-9)
    # The roof's edge at 20.3 m lies in the cell from 20 to 21: most of that is ground.
    np.testing.assert_allclose(found[:, 19], 20.0, atol=3.0 * GRID.cell)
    shared = found[:, 20]
    assert ((shared > 20 - 3) | (shared < 3) | (walls > 100)).mean() > 0.9
    if not walls:
        np.testing.assert_allclose(shared, 0.0, atol=1e-9)


@pytest.mark.parametrize("spacing", (0.25, 0.5, 1.0))
def test_footprints_place_an_edge_to_half_a_cell(spacing):
    """Roofs neither grow nor shrink: over edges at all phases, the mean place of the step is the true one."""
    shifts = []
    for phase in np.arange(0, 1, 0.1):
        x, y = lattice(spacing, 0.03)
        edge = 20 + phase
        found, _, _ = grid_points(
            GRID, x, y, height=np.where(x < edge, 30.0, 0.0), score=np.ones(len(x)), spacing=spacing
        )
        shifts.append((found[20] > 15).sum() - edge)
    assert abs(np.mean(shifts)) < 0.5 * spacing and np.abs(shifts).max() <= 0.5 + spacing


def test_no_points_no_heights():
    nothing = np.empty(0)
    assert np.isnan(grid_points(GRID, nothing, nothing, height=nothing, score=nothing)[0]).all()
    outside = np.array([500.0])
    assert np.isnan(grid_points(GRID, outside, outside, height=outside, score=outside)[0]).all()


@pytest.mark.parametrize("cell", (0.5, 0.3, 1.0, 2.5))
@pytest.mark.parametrize("corner", ((500000.0, 4800000.0), (499999.7, 4800000.4), (-1234.5, -987.6)))
def test_windows_of_adjoining_tiles_partition_the_cells(cell, corner):
    """Every cell belongs to exactly one tile, wherever the borders lie."""
    edges_x, edges_y = corner[0] + np.array([0, 33, 71.3, 120]), corner[1] + np.array([0, 28.4, 90])
    grid = CellGrid.covering((edges_x[0], edges_y[0], edges_x[-1], edges_y[-1]), cell)
    owners = np.zeros(grid.shape, int)
    xs, ys = grid.centres()
    for x0, x1 in zip(edges_x, edges_x[1:]):
        for y0, y1 in zip(edges_y, edges_y[1:]):
            col, row, width, height = grid.window((x0, y0, x1, y1))
            owners[row : row + height, col : col + width] += 1
            part = grid.part((col, row, width, height))
            px, py = part.centres()
            np.testing.assert_allclose(px, xs[col : col + width])
            assert px.min() >= x0 - 1e-6 and px.max() <= x1 + 1e-6 and py.min() >= y0 - 1e-6 and py.max() <= y1 + 1e-6
    inside = (ys[:, None] > edges_y[0]) & (ys[:, None] < edges_y[-1]) & (xs > edges_x[0]) & (xs < edges_x[-1])
    assert (owners[inside] == 1).all() and owners.max() == 1


def test_the_grid_covers_and_lies_on_whole_cells():
    grid = CellGrid.covering((10.3, 20.2, 15.1, 24.0), 0.5)
    assert (grid.west, grid.north, grid.shape) == (10.0, 24.0, (8, 11))
    assert grid.geotransform == (10.0, 0.5, 0.0, 24.0, 0.0, -0.5)
    same = CellGrid.covering((10.0, 20.0, 15.0, 24.0), 0.5)
    assert (same.west, same.north, same.shape) == (10.0, 24.0, (8, 10))
    assert grid.window((10.0, 20.0, 11.0, 24.0), 3) == (0, 0, 5, 8)
    assert grid.window((100.0, 20.0, 110.0, 24.0))[2] == 0


def one_by_one(grid, x, y, height, score, spacing, numbers):
    """What grid_points must give, from areas of squares and lists of each cell."""
    rows, columns = grid.shape
    # Where points are sparser than cells, a cell takes what lies in a wider one around its centre.
    factor = max(1, int(np.ceil(spacing / grid.cell - numbers.wider))) if np.isfinite(spacing) else 1
    cell, before = factor * grid.cell, (factor - 1) / 2 * grid.cell
    side, step = min(spacing, cell), numbers.surface_step * max(cell, numbers.surface_step_cell_m)
    inside = {}
    for px, py, z, s in zip(x, y, height, score):
        if np.isnan(z):
            continue
        for row in range(rows):
            south = grid.north - (row + 1) * grid.cell - before
            tall = min(py + side / 2, south + cell) - max(py - side / 2, south)
            for column in range(columns):
                west = grid.west + column * grid.cell - before
                wide = min(px + side / 2, west + cell) - max(px - side / 2, west)
                if tall > 0 and wide > 0:
                    inside.setdefault((row, column), []).append((tall * wide / side**2, z, np.nan_to_num(s)))
    found = np.full((3, rows, columns), np.nan)
    found[2] = 0.0
    for place, points in inside.items():
        weight, z, s = np.array(points).T
        found[(2, *place)] = weight.sum() / factor**2
        if weight.sum() < numbers.cell_weight:
            continue
        if np.average((z - np.average(z, weights=weight)) ** 2, weights=weight) > (numbers.mixed * step) ** 2:
            evidence = weight > numbers.surface_weight
            surfaces = [evidence & (z >= start) & (z <= start + step) for start in sorted(z[evidence])]
            most = max(weight[surface].sum() for surface in surfaces)
            chosen = [surface for surface in surfaces if weight[surface].sum() >= most - 1e-9][-1]
            weight, z, s = weight[chosen], z[chosen], s[chosen]
        found[(0, *place)], found[(1, *place)] = np.average(z, weights=weight), np.average(s, weights=weight)
    return found


@pytest.mark.parametrize("spacing", (0.3, 0.5, 1.0, np.inf))
@pytest.mark.parametrize("cell, relief", ((0.5, 0.0), (0.5, 1.0), (0.5, 6.0), (0.2, 2.0)))
def test_every_cell_is_what_its_points_one_by_one_give(spacing, cell, relief):
    """Sparse and dense, one surface and several, over the borders of the grid, with missing heights and scores."""
    numbers = np.random.default_rng(3)
    grid = CellGrid(-1.0, 7.0, cell, (7, 9))
    count = 160
    x = grid.west + numbers.uniform(-1.2, 10.2, count) * cell
    y = grid.north - numbers.uniform(-1.2, 8.2, count) * cell
    height = 500.0 + 0.2 * x + relief * numbers.choice([0.0, 0.4, 1.0], count) + 0.01 * numbers.normal(size=count)
    score = numbers.uniform(0.2, 1.0, count)
    height[::17], score[::13] = np.nan, np.nan
    expected = one_by_one(grid, x, y, height, score, spacing, GRIDDING)
    found = grid_points(grid, x, y, height=height, score=score, spacing=spacing)
    assert np.isfinite(expected[0]).mean() > 0.2
    for ours, naive in zip(found, expected):
        np.testing.assert_allclose(ours, naive, atol=1e-9)


def test_of_two_surfaces_that_cover_the_same_the_upper_one_is_taken():
    grid = CellGrid(0.0, 1.0, 1.0, (1, 1))
    middle = np.full(4, 0.5)
    heights, scores, weights = grid_points(
        grid, middle, middle, height=np.array([10.0, 20.0, 10.2, 20.2]), score=np.array([0.1, 0.7, 0.1, 0.9])
    )
    assert (heights.item(), scores.item(), weights.item()) == pytest.approx((20.1, 0.8, 4.0))


def test_points_within_a_step_are_one_surface_and_its_mean():
    """3 m for a cell of 1 m: as far apart as that is one surface, farther is not."""
    grid = CellGrid(0.0, 1.0, 1.0, (1, 1))
    for apart, expected in ((3.0, 11.0), (3.01, 10.0)):
        height = np.array([10.0, 10.0, 10.0 + apart])
        heights, _, _ = grid_points(grid, np.full(3, 0.5), np.full(3, 0.5), height=height, score=np.ones(3))
        assert heights.item() == pytest.approx(expected)


@pytest.mark.parametrize("covered, known", ((0.14, False), (0.16, True)))
def test_a_cell_that_is_hardly_covered_has_no_height(covered, known):
    """A point that represents a whole cell, beside the first cell's middle by one minus that share of a cell."""
    grid = CellGrid(0.0, 1.0, 1.0, (1, 2))
    x, y, height, score = (np.array([value]) for value in (1.5 - covered, 0.5, 7.0, 0.5))
    heights, scores, weights = grid_points(grid, x, y, height=height, score=score)
    assert weights[0].tolist() == pytest.approx([covered, 1 - covered])
    assert np.isfinite(heights[0, 0]) == np.isfinite(scores[0, 0]) == known
    assert heights[0, 1] == pytest.approx(7.0, abs=1e-12)


def test_small_cells_have_the_step_of_larger_ones():
    """1 m at least: noise within it is no second surface, however small the cell is."""
    assert surface_step(0.1, GRIDDING) == surface_step(0.33, GRIDDING) == pytest.approx(0.99)
    assert surface_step(2.0, GRIDDING) == pytest.approx(6.0)


@pytest.mark.parametrize("cell", (0.51, 0.4, 0.34, 0.25))
@pytest.mark.parametrize("turned", (0.0, 0.4))
def test_cells_that_are_finer_than_the_points_all_have_heights(cell, turned):
    """A metre between points: no cell is empty, the plane is where it is, and the points are as many as before."""
    x, y = lattice(1.0, 0.3)
    u, v = x - 20, y - 20
    x, y = 20 + np.cos(turned) * u - np.sin(turned) * v, 20 + np.sin(turned) * u + np.cos(turned) * v
    side = int(20 / cell)
    grid = CellGrid(10.0, 30.0, cell, (side, side + 3))
    heights, scores, weights = grid_points(grid, x, y, height=plane(x, y), score=np.ones_like(x), spacing=1.0)
    assert np.isfinite(heights).all() and np.isfinite(scores).all()
    away = heights - plane(*np.meshgrid(*grid.centres()))
    assert abs(away.mean()) < 0.002 and np.abs(away).max() < 0.25 * 0.36  # a quarter of a metre on that slope
    assert weights.mean() == pytest.approx(cell**2, rel=0.02)


def test_fine_cells_keep_gaps_and_edges():
    """What no point is near to stays empty, and a wall stays a wall: no cell lies between roof and ground."""
    x, y = lattice(1.0, 0.5)
    z = np.where(x < 20, 120.0, 100.0)
    z[(np.abs(x - 10) < 4) & (np.abs(y - 10) < 4)] = np.nan
    grid = CellGrid(0.0, 40.0, 0.25, (160, 160))
    heights, _, _ = grid_points(grid, x, y, height=z, score=np.ones_like(x), spacing=1.0)
    cx, cy = np.meshgrid(*grid.centres())
    hole = (np.abs(cx - 10) < 3) & (np.abs(cy - 10) < 3)
    assert np.isnan(heights[hole]).all() and np.isfinite(heights[(np.abs(cx - 10) > 5) | (np.abs(cy - 10) > 5)]).all()
    known = heights[np.isfinite(heights)]
    assert set(known.round(6)) == {100.0, 120.0}
    roof = np.isfinite(heights) & (heights > 110)
    assert roof[20, :].sum() * 0.25 == pytest.approx(20.0, abs=0.25)


def test_points_that_are_farther_apart_in_one_direction_leave_no_holes():
    """Pixels of 0.06 x 0.5 m, as of RPCs that are moved to 85 degrees of latitude: rows of cells were empty."""
    x, y = (values.ravel() for values in np.meshgrid(np.arange(0.03, 20, 0.06), np.arange(0.25, 20, 0.5)))
    grid, gsd = CellGrid(0.0, 20.0, 0.2, (100, 100)), np.sqrt(0.06 * 0.5)
    facts = {"height": 2 * x + y, "score": np.ones_like(x), "spacing": gsd}
    holes, _, _ = grid_points(grid, x, y, **facts)
    whole, _, covered = grid_points(grid, x, y, **facts, apart=0.5)
    assert np.isnan(holes).mean() > 0.15 and np.isfinite(whole).all()
    cx, cy = np.meshgrid(*grid.centres())
    inner = np.s_[2:-2, 2:-2]
    assert np.abs(whole - (2 * cx + cy))[inner].max() < 0.3
    assert covered[inner].mean() == pytest.approx((grid.cell / gsd) ** 2, rel=0.1)


def test_cells_as_wide_as_points_are_apart_are_gridded_as_before():
    assert [widening(cell, 0.51) for cell in (1.0, 0.51, 0.5, 0.37, 0.36, 0.25, 0.128)] == [1, 1, 1, 1, 2, 2, 4]
    assert widening(0.1, np.inf) == 1
