"""Blocks cover a grid once, windows meet where they should, and lattices are exact for bilinear functions."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds, Window
from repm_qgis.geometry.cell_grid import CellGrid, overlapping_blocks
from repm_qgis.geometry.interpolation import bilinear, interpolate_grid, interpolate_steps, on_lattice
from repm_qgis.imagery.sampling import mean_of_known, median_of_known, median_of_neighbours, quantile_of_known


@pytest.mark.parametrize(
    "size, side, halo", (((100, 70), 32, 5), ((10, 10), 32, 5), ((64, 64), 32, 0), ((1, 90), 7, 90))
)
def test_blocks_cover_each_pixel_once_and_know_their_halo(size, side, halo):
    values = np.arange(size[0] * size[1]).reshape(size[1], size[0])
    whole, found = Window(0, 0, *size), np.zeros_like(values)
    for own, wide in overlapping_blocks(size, side, halo):
        assert own.width <= side and own.height <= side and wide == own.grown(halo, size) and own.common(wide) == own
        found[own.inside(whole)] += values[wide.inside(whole)][own.inside(wide)]
    np.testing.assert_array_equal(found, values)


def test_windows_and_bounds():
    assert Window(2, 3, 4, 5).common(Window(4, 1, 9, 4)) == Window(4, 3, 2, 2)
    assert Window(0, 0, 4, 4).common(Window(4, 0, 4, 4)) is None
    assert Bounds(0.0, 1.0, 2.0, 3.0).grown(0.5) == (-0.5, 0.5, 2.5, 3.5)
    grid = CellGrid(10.0, 50.0, 2.0, (5, 8))
    assert grid.bounds == (10.0, 40.0, 26.0, 50.0) and grid.window(grid.bounds) == Window(0, 0, *grid.size)


def test_a_lattice_is_exact_for_bilinear_functions():
    grid = CellGrid(500.0, 900.0, 0.5, (40, 60))

    def function(xy):
        x, y = xy[..., 0] - 500.0, xy[..., 1] - 880.0
        return np.stack([1 + 2 * x - y + 0.1 * x * y, x], axis=-1)

    x, y = grid.centres()
    exact = function(np.stack(np.meshgrid(x, y), axis=-1))
    for nodes in ((2, 2), (17, 17), (5, 3)):
        np.testing.assert_allclose(on_lattice(x, y, function, nodes), exact, atol=1e-9)


def test_three_ways_to_interpolate_agree():
    grid = np.random.default_rng(1).uniform(size=(6, 8))
    rows, columns = np.arange(40) / 8, np.arange(56) / 8
    expected = interpolate_grid(grid, rows, columns)
    np.testing.assert_allclose(interpolate_steps(grid, (40, 56), 8), expected, atol=1e-12)
    np.testing.assert_allclose(bilinear(grid, *np.meshgrid(columns, rows)), expected, atol=1e-12)


@pytest.mark.parametrize("shape", ((40, 21), (9, 56), (37, 50), (1, 1)))
def test_steps_may_end_before_the_last_node(shape):
    nodes = np.random.default_rng(1).uniform(size=(6, 8))
    whole = interpolate_steps(nodes, (40, 56), 8)
    np.testing.assert_array_equal(interpolate_steps(nodes, shape, 8), whole[: shape[0], : shape[1]])


def test_a_lattice_has_17_nodes_each_way():
    """Where nothing else is said: few enough for a function that takes long."""
    asked = []
    on_lattice(np.arange(50.0), np.arange(40.0), lambda xy: asked.append(xy.shape) or xy[..., 0])
    assert asked == [(17, 17, 2)]


def test_means_and_medians_of_what_is_known():
    stack = np.random.default_rng(2).uniform(size=(7, 20, 30))
    stack[np.random.default_rng(3).uniform(size=stack.shape) < 0.4] = np.nan
    count = np.isfinite(stack).sum(axis=0)
    found = median_of_known(stack, 3)
    odd = (count % 2 == 1) & (count >= 3)
    np.testing.assert_array_equal(found[odd], np.nanmedian(stack, axis=0)[odd])
    assert (np.isnan(found) == (count < 3)).all()
    assert median_of_neighbours(np.full((5, 5), np.nan), 3, 1).shape == (5, 5)
    image, known = np.nan_to_num(stack[0]).astype(np.float32), np.isfinite(stack[0])
    mean, share = mean_of_known(image, known, lambda values: np.full(values.shape, values.mean()), 1e-6)
    np.testing.assert_allclose(mean, np.nanmean(stack[0]), rtol=1e-5)
    np.testing.assert_allclose(share, known.mean(), rtol=1e-6)


def test_quantiles_of_what_is_known_differ_from_place_to_place():
    nan = np.nan
    stack = np.array([[4.0, nan, 1.0], [1.0, 7.0, nan], [3.0, nan, nan], [2.0, 5.0, nan], [nan, nan, nan]])
    np.testing.assert_array_equal(quantile_of_known(stack, 0.75), [3.0, 5.0, 1.0])
    np.testing.assert_array_equal(quantile_of_known(stack, np.array([1.0, 1.0, 0.5]), 2), [4.0, 7.0, nan])
    np.testing.assert_array_equal(quantile_of_known(stack[:4], np.array([0.0, 0.5, 0.5])), [1.0, 5.0, 1.0])
