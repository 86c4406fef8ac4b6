"""The own surface as references see it: means over their supports, and slopes, against sums over the cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.registration.surfaces import Reference, SupportMeans, _filtered, _kernel, _line

WEST, NORTH, CELL = 1000.0, 5000.0, 2.0


@pytest.mark.parametrize("width", (0.0, 0.5, 1.0, 1.4, 2.0, 3.0, 3.7, 6.0, 9.1))
def test_a_line_is_as_wide_as_its_support(width):
    line = _line(width)
    assert len(line) % 2 == 1 and line.sum() == pytest.approx(max(width, 1.0)) and (line == line[::-1]).all()
    assert (line[1:-1] == 1.0).all() and (len(line) == 1 or 0 < line[0] <= 1)


@pytest.mark.parametrize("width", (6.0, 9.4, 12.5))
def test_a_disc_has_its_area_and_no_cells_beyond(width):
    kernel = _kernel(width, width, True)
    assert kernel.sum() == pytest.approx(1.0) and kernel.max() == pytest.approx(4 / (math.pi * width**2), rel=0.06)
    assert kernel.shape == (2 * math.ceil(width / 2 - 0.5) + 1,) * 2 and kernel[0].sum() > 0
    assert (kernel == kernel.T).all() and (kernel == kernel[::-1]).all()
    at = np.arange(len(kernel)) - len(kernel) // 2
    second = (kernel.sum(axis=0) * at**2).sum()
    assert second == pytest.approx(width**2 / 16 + 1 / 12, rel=0.03)  # of a disc and of a cell


def test_a_point_is_its_cell():
    assert _kernel(0.0, 0.0, True).shape == _kernel(0.0, 0.0, False).shape == (1, 1)


@pytest.mark.parametrize("disc", (True, False))
def test_filtered_values_are_weighted_sums(disc):
    rng = np.random.default_rng(0)
    values, kernel = rng.normal(size=(20, 24)), _kernel(5.0, 3.4, disc)
    found, reach = _filtered(values, kernel), np.array(kernel.shape) // 2
    padded = np.pad(values, [(n, n) for n in reach])
    for row, column in ((0, 0), (7, 11), (19, 23)):
        part = padded[row : row + kernel.shape[0], column : column + kernel.shape[1]]
        assert found[row, column] == pytest.approx((part * kernel).sum())


def means(height, width=(6.0, 6.0), covered=0.6, disc=False):
    grid = CellGrid(WEST, NORTH, CELL, height.shape)
    return SupportMeans(grid, height, Reference("made", np.empty((0, 3)), width, disc), covered)


def places(rows, columns):
    return WEST + (np.asarray(columns, float) + 0.5) * CELL, NORTH - (np.asarray(rows, float) + 0.5) * CELL


def test_a_mean_is_that_of_the_cells_in_its_support():
    rng = np.random.default_rng(1)
    height = rng.normal(700.0, 3.0, (30, 40))
    value, _, _ = means(height).at(*places([10, 15], [12, 30]))
    assert value == pytest.approx([height[9:12, 11:14].mean(), height[14:17, 29:32].mean()], abs=1e-6)
    wide, _, _ = means(height, (10.0, 2.0)).at(*places([10], [12]))
    assert wide == pytest.approx([height[10, 10:15].mean()], abs=1e-6)


def test_slopes_are_those_of_the_plane():
    rows, columns = np.indices((30, 40))
    height = 300.0 + 0.3 * columns * CELL - 0.1 * rows * CELL
    surface = means(height)
    value, east, north = surface.at(*places([10.25, 14.5], [12.75, 25.0]))
    assert value == pytest.approx(300 + np.array([0.6 * 12.75 - 0.2 * 10.25, 0.6 * 25.0 - 0.2 * 14.5]), abs=1e-3)
    assert east == pytest.approx([0.3, 0.3], abs=1e-3) and north == pytest.approx([0.1, 0.1], abs=1e-3)
    assert surface.middle == (WEST + 40.0, NORTH - 30.0) and surface.extent_m == (80.0, 60.0)
    assert surface.resolution_m == 6.0 and means(height, (1.0, 0.5)).resolution_m == CELL


def test_slopes_are_the_derivatives_of_the_means():
    rng = np.random.default_rng(2)
    surface = means(rng.normal(0, 3.0, (30, 40)), (10.0, 10.0))
    x, y = places([12.3], [17.6])
    value, east, north = surface.at(x, y)
    right, up = surface.at(x + 1.0, y)[0], surface.at(x, y + 1.0)[0]
    left, down = surface.at(x - 1.0, y)[0], surface.at(x, y - 1.0)[0]
    assert east == pytest.approx((right - left) / 2.0) and north == pytest.approx((up - down) / 2.0)
    assert np.isfinite(value).all()


def test_a_mean_needs_its_share_of_heights_and_is_that_of_what_is_known():
    height = np.full((30, 40), 50.0)
    height[:, 20:] = np.nan
    height[:, 19] = 80.0
    surface = means(height)
    value, _, _ = surface.at(*places([10, 10, 10], [17, 18, 19]))
    assert value == pytest.approx([50.0, 60.0, 65.0], abs=1e-6)  # the last sees two thirds of its support
    assert np.isnan(means(height, covered=0.7).at(*places([10], [19]))[0]).all()
    assert np.isnan(surface.at(*places([10, 10], [19.5, 20]))[0]).all()  # one of the neighbours is unknown
    assert not np.isnan(surface.at(*places([10], [18.5]))[0]).any()


def test_beyond_the_cells_nothing_is_known():
    surface = means(np.full((30, 40), 5.0), (0.0, 0.0))
    rows, columns = [0, 0, -0.01, 29, 29.01, 0], [0, 39, 5, 39, 3, -0.01]
    assert np.isfinite(surface.at(*places(rows, columns))[0]).tolist() == [True, True, False, True, False, False]
    assert np.isnan(surface.at(*places([10], [39.01]))[0]).all()
    assert np.isnan(means(np.full((5, 6), np.nan)).at(*places([2], [3]))[0]).all()
