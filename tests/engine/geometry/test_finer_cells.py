"""Cells between a surface's: planes stay planes, walls stay upright and where they are, holes as wide as they were."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Window
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.finer_cells import FinerCells, finer_cell

COARSE = CellGrid(1000.0, 2000.0, 0.62, (40, 50))


def spread(cells, values, step=2.0, window=None):
    window = window or Window(0, 0, *cells.fine.size)
    place = cells.around(window)
    return cells.spread(values[place.slices], place, window, step)


@pytest.mark.parametrize("cell", (0.31, 0.155, 0.4, 0.5, 0.62))
def test_a_plane_stays_one_in_its_place(cell):
    """A surface whose heights are known everywhere: they are a function of the ground, not of the cells."""
    cells = FinerCells.over(COARSE, cell)
    (x, y), (fx, fy) = COARSE.centres(), cells.fine.centres()
    values = 0.3 * (x - 1000)[None] + 0.5 * (y - 2000)[:, None]
    found = spread(cells, values)
    inner = ((fx >= x[0]) & (fx <= x[-1]))[None] & ((fy <= y[0]) & (fy >= y[-1]))[:, None]
    np.testing.assert_allclose(found[inner], (0.3 * (fx - 1000)[None] + 0.5 * (fy - 2000)[:, None])[inner], atol=1e-6)
    assert inner.mean() > 0.9 and np.isfinite(found).all()


@pytest.mark.parametrize("cell", (0.31, 0.2, 0.45))
def test_walls_stay_upright_between_the_cells_that_have_them(cell):
    """A roof that slopes on level ground: no height lies between the two, and the roof is as large as it was."""
    cells = FinerCells.over(COARSE, cell)
    x, y = COARSE.centres()
    values = np.zeros(COARSE.shape)
    values[10:30, 12:35] = 8.0 + 0.4 * (x[12:35] - x[12])
    found = spread(cells, values)
    fx, fy = cells.fine.centres()
    roof = found > 4.0
    assert ((found == 0) | (found >= 8.0 - 1e-9)).all()
    west, north = COARSE.west + 12 * COARSE.cell, COARSE.north - 10 * COARSE.cell
    inside = ((fx > west) & (fx < west + 23 * COARSE.cell))[None] & ((fy < north) & (fy > north - 20 * COARSE.cell))[
        :, None
    ]
    np.testing.assert_array_equal(roof, inside)
    # It goes on along the wall, too: the eaves have the roof's slope and no steps.
    within = inside & ((fx > x[12]) & (fx < x[34]))[None]
    truth = np.broadcast_to(8.0 + 0.4 * (fx - x[12]), found.shape)
    np.testing.assert_allclose(found[within], truth[within], atol=1e-6)


def test_holes_stay_as_wide_as_their_cells():
    cells = FinerCells.over(COARSE, 0.155)
    values = np.full(COARSE.shape, 3.0)
    values[5, 6] = np.nan
    found = spread(cells, values)
    assert np.isnan(found[20:24, 24:28]).all() and np.isnan(found).sum() == 16
    assert (found[np.isfinite(found)] == 3.0).all()


def test_windows_have_what_the_whole_has():
    cells = FinerCells.over(COARSE, 0.23)
    values = np.random.default_rng(1).normal(0, 3, COARSE.shape)
    whole = spread(cells, values)
    for window in (Window(0, 0, 7, 9), Window(31, 17, 40, 25), Window(100, 80, 34, 27)):
        np.testing.assert_allclose(spread(cells, values, window=window), whole[window.slices], atol=1e-9)


def test_its_own_cells_are_the_same_ones_to_the_bit():
    cells = FinerCells.over(COARSE, 0.62)
    assert cells.same and cells.fine is COARSE
    values = np.random.default_rng(2).normal(0, 3, COARSE.shape)
    assert spread(cells, values) is not None
    np.testing.assert_array_equal(spread(cells, values), values)


@pytest.mark.parametrize("cell", (0.31, 0.2, 0.33, 0.6))
def test_all_centres_lie_on_the_surface_and_cover_it(cell):
    cells = FinerCells.over(COARSE, cell)
    fx, fy = cells.fine.centres()
    west, south, east, north = COARSE.bounds
    assert (fx > west).all() and (fx < east).all() and (fy > south).all() and (fy < north).all()
    assert east - fx[-1] <= cell and fy[-1] - south <= cell


@pytest.mark.parametrize(
    ("cell", "gsd", "wanted"),
    [
        (0.62, 0.312, 0.31),  # half a cell is near enough, and nests
        (0.5, 0.312, 0.31),  # half is not
        (1.0, 0.333, 1.0 / 3),
        (0.3, 0.312, 0.3),
        (0.25, 0.5, 0.25),  # not coarser than the surface
        (2.4, 0.3, 0.3),
    ],
)
def test_cells_nest_where_they_nearly_do(cell, gsd, wanted):
    assert finer_cell(cell, gsd, 0.05) == pytest.approx(wanted)
