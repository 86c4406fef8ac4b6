"""What heights determine is never dropped: gaps of every kind, weak information, copies and contradictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyproj
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.records import GroundShift
from repm_qgis.evaluation.coregistration import align
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.registration import estimation
from repm_qgis.registration.adjustment import Observation, contradictions
from repm_qgis.registration.copies import are_same, copies
from repm_qgis.registration.found import FoundHeights
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.rasters import read_raster, slopes_of
from repm_qgis.registration.solve import Prior, half_spread, solve_shift
from repm_qgis.registration.surfaces import Reference, SupportMeans
from tests.engine.registration.test_placing import placed, shift

CELL, SIDE, WEST, NORTH = 2.0, 160, 500_000.0, 4_000_000.0
PRIOR = Prior(8.0, 5.0, 40.0)
MOVED = np.array([3.0, -2.0, 2.37])


def hills(x, y):
    """Ground with slopes in both directions, m."""
    return 12.0 * np.sin(x / 31.0) * np.cos(y / 23.0) + 4.0 * np.sin((x + y) / 11.0)


def own_surface(rng, wanted):
    """The hills' own surface, which has to be moved by MOVED, with noise."""
    grid = CellGrid(WEST, NORTH, CELL, (SIDE, SIDE))
    x, y = np.meshgrid(*grid.centres())
    height = hills(x + MOVED[0], y + MOVED[1]) - MOVED[2] + rng.normal(0, 0.3, x.shape)
    return SupportMeans(grid, height, wanted, REGISTRATION.covered)


def reference(kind, rng, side=2.0):
    """Cells of the true hills, of which only some are known."""
    count = int(CELL * SIDE / side)
    x, y = np.meshgrid(WEST + (np.arange(count) + 0.5) * side, NORTH - (np.arange(count) + 0.5) * side)
    row, column = np.indices(x.shape)
    height = hills(x, y) + rng.normal(0, 0.05, x.shape)
    known = {
        "checker": (row + column) % 2 == 0,
        "stripes": column % 2 == 0,
        "rows": row % 2 == 1,
        "lattice": (row % 2 == 0) & (column % 2 == 0),
        "single": rng.random(x.shape) < 0.1,
    }[kind]
    height[~known] = np.nan
    slopes = slopes_of(height, np.diag([side, -side]))
    xyz = np.column_stack([x[known], y[known], height[known]])
    return Reference(kind, xyz, (side, side), slopes=slopes[known])


@pytest.mark.parametrize("kind", ("checker", "stripes", "rows", "lattice", "single"))
def test_gaps_of_a_reference_leave_no_direction_out(kind):
    """Without slopes beside gaps the height was spread over the position, and the scene moved by nothing."""
    rng = np.random.default_rng(1)
    wanted = reference(kind, rng)
    solved = solve_shift(own_surface(rng, wanted), wanted, PRIOR)
    error = np.abs(solved.moved - MOVED)
    assert len(solved.determined) == 2 and (error < [0.15, 0.15, 0.05]).all()
    assert (solved.deviations > 0.002).all() and (error < 4 * solved.deviations).all()


def test_slopes_beside_gaps_are_those_of_the_cells_around():
    rows, columns = np.indices((30, 40)).astype(float)
    plane = 0.4 * columns - 0.2 * rows
    for known in (columns % 2 == 0, rows % 3 == 0, (rows + columns) % 2 == 0):
        slopes = slopes_of(np.where(known, plane, np.nan), np.diag([2.0, -2.0]))
        assert np.isfinite(slopes[known]).all()
        np.testing.assert_allclose(slopes[known], np.broadcast_to([0.2, 0.1], slopes[known].shape), atol=1e-9)
    line = np.where(rows == 7, plane, np.nan)  # cells on a line tell nothing across it
    assert np.isnan(slopes_of(line, np.diag([2.0, -2.0]))).all()
    whole = slopes_of(plane, np.diag([2.0, -2.0]))  # and without gaps they are as before
    assert np.isnan(whole[0]).all() and np.isfinite(whole[1:-1, 1:-1]).all()


def test_what_has_no_information_keeps_its_value_and_is_uncertain():
    basis = np.eye(5)[:, :3]
    normal = np.zeros((3, 3))
    normal[2] = 0.3, -0.2, 400.0  # instruments without slopes: the height alone
    step = estimation.step(normal, np.array([0.0, 0.0, 400.0 * 2.37]), basis)
    assert step == pytest.approx([0.0, 0.0, 2.37, 0.0, 0.0], abs=1e-5)
    covariance = estimation.sandwich(normal, np.diag([0.0, 0.0, 400.0]), basis)
    assert np.sqrt(np.diag(covariance))[:2] == pytest.approx([1e4, 1e4], rel=1e-3)
    alone = estimation.sandwich(normal[2:, 2:], np.array([[400.0]]), basis[:, 2:])  # the position stays as it was
    assert np.sqrt(alone[2, 2]) == pytest.approx(0.05)


def test_a_height_counts_beside_a_tilt_that_is_certain():
    """1e-7 m per m and five metres of height: 1e14 and 0.04 as information."""
    information = np.diag([4.0, 0.0, 0.04, 1e14, 0.0])
    covariance, rest = estimation.split(information, np.array([1.0, 1.0, 1.0, 1e-3, 1e-3]))
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.5, 0.0, 5.0, 1e-7, 0.0])
    assert np.diag(rest) == pytest.approx([0.0, 1.0, 0.0, 0.0, 1.0])
    assert estimation.deviations_of(np.diag([0.0, 0.0, 4.0])) == pytest.approx([1e4, 1e4, 0.5], rel=1e-4)


def test_sources_that_disagree_are_as_uncertain_as_they_differ():
    """Half of the difference, which is the standard deviation of the mean of both; and a warning."""
    near, far = shift((0.0, 0.0, 0.0), (0.002,) * 3), shift((0.0, 0.0, 33.9), (0.002,) * 3)
    both = [Observation.of_shift("a", near, 0), Observation.of_shift("b", far, 0)]
    (found,) = placed(*both)
    assert found.ground.moved[2] == pytest.approx(16.95)
    assert found.deviations[2] == pytest.approx(16.95) and found.deviations[:2] == pytest.approx([0.002 / 2**0.5] * 2)
    assert len(contradictions(both)) == 1
    poor = Observation.of_shift("c", shift((0.0, 0.0, 10.0), (1.0,) * 3), 0)  # ten deviations of a poor one away
    (found,) = placed(both[0], poor)
    assert abs(found.ground.moved[2]) < 0.001 and found.deviations[2] == pytest.approx(5.0)
    control = Observation.of_control(np.eye(3) / 0.1**2, 0)
    (found,) = placed(control, Observation.of_shift("b", shift((0.0, 0.0, 4.0), (0.1,) * 3), 0))
    assert found.deviations[2] == pytest.approx(2.0)


def test_disagreement_of_a_scene_is_that_of_its_neighbours_and_of_no_other():
    told = Observation.of_shift("dem", shift((0.0, 0.0, 0.0), (0.1,) * 3), 0)
    other = Observation.of_shift("lidar", shift((0.0, 0.0, 2.0), (0.1,) * 3), 1)
    overlap = Observation.of_shift("overlap", shift((0.0, 0.0, 0.0), (0.1,) * 3), 1, 0)
    alone = Observation.of_shift("dem", shift((1.0, 1.0, 1.0), (0.1,) * 3), 2)
    first, second, third = placed(told, other, overlap, alone, count=3)
    assert third.deviations == pytest.approx([0.1] * 3)
    for each in (first, second):
        assert each.deviations[2] > 0.5 and each.deviations[:2] == pytest.approx([0.1 * (2 / 3) ** 0.5] * 2)


def points(rng, count=3000):
    xy = rng.uniform(0.0, 500.0, (count, 2)) + [WEST, NORTH]
    return FoundHeights("a.csv", xy, hills(*xy.T) + rng.normal(0, 0.1, count), (0.0, 0.0))


def test_a_copy_is_known_whatever_its_file_and_another_survey_is_none():
    rng = np.random.default_rng(3)
    first = points(rng)
    order = rng.permutation(3000)
    copy = replace(first, name="b.csv", xy=first.xy[order] + 1e-4, height=first.height[order] + 5e-4)
    part = replace(copy, xy=copy.xy[:900], height=copy.height[:900])
    survey = replace(first, height=hills(*first.xy.T) + rng.normal(0, 0.1, 3000))  # of the same lattice
    assert are_same(first, copy) and are_same(part, first) and not are_same(first, survey)
    assert not are_same(first, points(rng))
    assert copies([first, survey, copy, part]) == [(2, 0), (3, 0)]


@pytest.mark.parametrize(
    ("change", "named"),
    (
        (lambda z, rng: z, False),
        (lambda z, rng: z + 40.0, False),
        (lambda z, rng: z + rng.normal(0, 1.5, z.shape), False),
        (lambda z, rng: -z, True),
        (lambda z, rng: np.full(z.shape, 12.0), True),
        (lambda z, rng: rng.normal(0, 10.0, z.shape), True),
        (lambda z, rng: z[::-1, ::-1], True),
        (lambda z, rng: np.roll(z, (31, 47), (0, 1)), True),
        (lambda z, rng: z / 0.3048, True),
    ),
)
def test_a_reference_that_explains_nothing_is_named(change, named):
    """However level it is: it may be constant, or noise."""
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(WEST + (np.arange(80) + 0.5) * 4.0, NORTH - (np.arange(80) + 0.5) * 4.0)
    height = change(hills(x, y), rng)
    slopes = slopes_of(height, np.diag([4.0, -4.0])).reshape(-1, 2)
    xyz = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    wanted = Reference("dem", xyz, (4.0, 4.0), slopes=slopes)
    solved = solve_shift(own_surface(rng, wanted), wanted, replace(PRIOR, up_m=50.0))
    assert (solved.other_relief is not None) == named


def test_houses_on_a_plain_agree_with_its_bare_ground():
    rng = np.random.default_rng(5)
    grid = CellGrid(WEST, NORTH, CELL, (SIDE, SIDE))
    own = rng.normal(0, 0.3, grid.shape)
    for row, column in rng.integers(0, SIDE - 12, (60, 2)):
        own[row : row + 10, column : column + 8] += rng.uniform(4, 12)
    x, y = np.meshgrid(*grid.centres())
    ground = np.column_stack([x.ravel(), y.ravel(), rng.normal(2.0, 0.1, x.size)])
    wanted = Reference("dtm", ground, (CELL, CELL), slopes=np.zeros((x.size, 2)))
    solved = solve_shift(SupportMeans(grid, own, wanted, REGISTRATION.covered), wanted, PRIOR)
    assert solved.other_relief is None and solved.moved[2] == pytest.approx(2.0, abs=0.1)
    assert half_spread(np.random.default_rng(0).normal(0, 2.0, 100_000)) == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("step", (1, 3, 8))
def test_a_raster_of_narrow_stripes_has_heights(step, tmp_path):
    """Blocks of 3 x 3 cells of which one column is known had too few of them: "no heights over the scene"."""
    rng = np.random.default_rng(6)
    row, column = np.indices((300, 300))
    x, y = WEST + column + 0.5, NORTH - row - 0.5
    height = np.where(column % step == 0, hills(x, y), np.nan).astype(np.float32)
    path = str(tmp_path / "stripes.tif")
    dataset = gdal.GetDriverByName("GTiff").Create(path, 300, 300, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((WEST, 1.0, 0.0, NORTH, 0.0, -1.0))
    dataset.SetProjection(pyproj.CRS("EPSG:32631").to_wkt())
    dataset.GetRasterBand(1).WriteArray(height)
    dataset = None
    found = read_raster(path, "EPSG:32631", Bounds(WEST, NORTH - 300.0, WEST + 300.0, NORTH), 3.0)
    assert np.abs(found.height - hills(*found.xy.T)).max() < 0.35  # a mean of a block, at the mean place of its cells
    wanted = Reference("stripes", np.column_stack([found.xy, found.height]), found.width_m, slopes=found.slopes)
    solved = solve_shift(own_surface(rng, wanted), wanted, PRIOR)
    assert (np.abs(solved.moved - MOVED) < [0.2, 0.2, 0.1]).all() and len(solved.determined) == 2


def test_an_alignment_takes_stripes_and_single_cells():
    """Of comparedsm and change: no cell had a gradient, and the alignment said that no cell had a height."""
    rng = np.random.default_rng(7)
    grid = CellGrid(WEST, NORTH, CELL, (SIDE, SIDE))
    x, y = np.meshgrid(*grid.centres())
    dsm = (hills(x + MOVED[0], y + MOVED[1]) - MOVED[2] + rng.normal(0, 0.1, x.shape)).astype(np.float32)
    row, column = np.indices(x.shape)
    for known in (column % 2 == 0, (row + column) % 2 == 0):
        truth = np.where(known, hills(x, y), np.nan).astype(np.float32)
        found = align("3d", [(dsm, truth)], (CELL, CELL))
        assert [found.dx, found.dy, found.dz] == pytest.approx(MOVED, abs=0.1)


def test_a_move_is_measured_again():
    from repm_qgis.geometry.vertical import HeightDatum
    from repm_qgis.registration.laying import Laid

    rng = np.random.default_rng(8)
    wanted = reference("checker", rng)
    means = own_surface(rng, wanted)
    solved = solve_shift(means, wanted, PRIOR)
    laid = Laid(wanted, means, HeightDatum.of(""), "", solved)
    assert abs(laid.left_m(solved.ground)) < 3 * solved.deviations[2]
    assert laid.left_m(GroundShift((3.0, -2.0, 0.0))) == pytest.approx(2.37, abs=0.1)
    assert laid.covered(10) == 1.0
    some = wanted.xyz[:, 0] < WEST + 40.0
    strip = replace(wanted, xyz=wanted.xyz[some], slopes=wanted.slopes[some])
    part = Laid(strip, means, HeightDatum.of(""), "", solve_shift(means, strip, PRIOR))
    assert 0.1 <= part.covered(10) <= 0.25
