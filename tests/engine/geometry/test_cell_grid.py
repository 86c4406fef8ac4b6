"""Cells and blocks counted one by one, with fractions in place of rounding."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds, Window
from repm_qgis.geometry.cell_grid import CellGrid, overlapping_blocks

TENTHS = [(-37, -12, 41, 58), (3, 6, 7, 9), (0, 0, 30, 30), (-30, -21, -9, -3), (11, 12, 12, 13)]


@pytest.mark.parametrize("cell", (1, 3, 4, 25))
@pytest.mark.parametrize("bounds", TENTHS)
def test_the_grid_is_the_smallest_of_whole_cells_that_covers(bounds, cell):
    """Bounds and cells in tenths, which floats do not hold exactly."""
    grid = CellGrid.covering([value / 10 for value in bounds], cell / 10)
    west, south, east, north = (
        round_(Fraction(value, cell)) for round_, value in zip((math.floor, math.floor, math.ceil, math.ceil), bounds)
    )
    assert grid.shape == (north - south, east - west) and grid.size == (east - west, north - south)
    np.testing.assert_allclose(grid.bounds, np.array([west, south, east, north]) * cell / 10, atol=1e-12)
    np.testing.assert_allclose(grid.geotransform, (west * cell / 10, cell / 10, 0, north * cell / 10, 0, -cell / 10))


def test_sums_of_rounded_numbers_add_no_cells():
    step = 0.1
    assert 3 * step > 0.3
    assert CellGrid.covering((0.0, 0.0, 3 * step, 3 * step), step).shape == (3, 3)
    assert CellGrid.covering((3 * step, 3 * step, 0.6, 0.6), step).shape == (3, 3)


@pytest.mark.parametrize("margin", (0, 2))
@pytest.mark.parametrize("bounds", [(-50, 0, 9, 40), (5, 15, 15, 25), (7, 11, 23, 35), (-80, -70, -60, -50), *TENTHS])
def test_a_window_holds_the_cells_whose_centres_lie_in_it(bounds, margin):
    """West and north borders belong to the window, east and south ones to its neighbours; in tenths."""
    cell, west, north, rows, columns = 10, -40, 60, 9, 12
    grid = CellGrid(west / 10, north / 10, cell / 10, (rows, columns))
    inside_c = [c for c in range(-30, 40) if bounds[0] <= west + cell * c + 5 < bounds[2]]
    inside_r = [r for r in range(-30, 40) if bounds[1] < north - cell * r - 5 <= bounds[3]]
    found = grid.window([value / 10 for value in bounds], margin)
    if inside_c and inside_r:
        c0, c1 = max(inside_c[0] - margin, 0), min(inside_c[-1] + 1 + margin, columns)
        r0, r1 = max(inside_r[0] - margin, 0), min(inside_r[-1] + 1 + margin, rows)
        if c0 < c1 and r0 < r1:
            assert found == Window(c0, r0, c1 - c0, r1 - r0)
            return
    if not margin:
        assert found.width * found.height == 0
    assert min(found) >= 0


def test_a_part_lies_where_the_whole_has_it():
    grid = CellGrid(100.0, 80.0, 0.5, (20, 30))
    part = grid.part(Window(4, 6, 10, 8))
    assert part == CellGrid(102.0, 77.0, 0.5, (8, 10)) and part.bounds == Bounds(102.0, 73.0, 107.0, 77.0)
    x, y = part.centres()
    assert (x[0], x[-1], y[0], y[-1]) == (102.25, 106.75, 76.75, 73.25)


def test_blocks_come_row_by_row_without_a_halo_of_their_own():
    blocks = list(overlapping_blocks((5, 3), 2))
    assert [own for own, _ in blocks] == [
        (0, 0, 2, 2), (2, 0, 2, 2), (4, 0, 1, 2), (0, 2, 2, 1), (2, 2, 2, 1), (4, 2, 1, 1)
    ]  # fmt: skip
    assert all(own == wide for own, wide in blocks)
    assert [wide for _, wide in overlapping_blocks((5, 3), 2, 1)][1] == (1, 0, 4, 3)
