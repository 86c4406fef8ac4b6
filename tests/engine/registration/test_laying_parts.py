"""What a scene that is laid on a reference says of it: differences before and after, and how fine cells must be."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from repm_qgis.contracts.records import GroundShift
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.imagery.raster import write
from repm_qgis.registration.found import FoundHeights
from repm_qgis.registration.laying import Laid, factor_for, overlaps
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.stable import stable_cells
from repm_qgis.registration.surfaces import Reference

UTM = "EPSG:32631"


class Slope:
    """A surface of 100 x 100 m that rises by 0.05 to the east."""

    @staticmethod
    def at(x, y):
        inside = (np.abs(x - 500.0) <= 50.0) & (np.abs(y - 800.0) <= 50.0)
        return np.where(inside, 100.0 + 0.05 * (x - 500.0), np.nan), np.full(x.shape, 0.05), np.zeros(x.shape)


def test_differences_are_the_reference_minus_the_surface_before_and_after():
    x, y = np.array([480.0, 520.0, 455.0, 900.0]), np.array([790.0, 810.0, 800.0, 800.0])
    reference = Reference("dem", np.column_stack([x, y, 102.0 + 0.05 * (x - 500.0)]), (1.0, 1.0))
    laid = Laid(reference, Slope(), HeightDatum("", "ellipsoid"), "", None)
    places, before, after = laid.differences(GroundShift((10.0, -4.0, 1.5)))
    np.testing.assert_array_equal(places, np.column_stack([x, y])[:3])
    np.testing.assert_allclose(before, [2.0, 2.0, 2.0])
    # The surface moves 10 m to the east, where it is 0.5 m lower then, and 1.5 m up.
    np.testing.assert_allclose(after, [1.0, 1.0, np.nan])


def test_cells_are_as_wide_as_references_need():
    def found(width_m):
        return FoundHeights("dem", np.zeros((1, 2)), np.zeros(1), (width_m, 2 * width_m))

    across = REGISTRATION.cells_across
    assert factor_for([found(3.0 * across * 0.5)], 0.5) == 3
    assert factor_for([found(2.9 * across * 0.5)], 0.5) == 2
    assert factor_for([found(0.1)], 0.5) == 1
    assert factor_for([found(90.0), found(4.0 * across * 0.5)], 0.5) == 4, "the finest reference counts"
    assert factor_for([], 0.5) == int(REGISTRATION.averaged_cells)


@pytest.mark.parametrize(
    ("away", "shared"),
    (((60.0, 0.0), True), ((-60.0, 0.0), True), ((0.0, 60.0), True), ((0.0, -60.0), True), ((100.0, 0.0), False))
    + (((-100.0, 0.0), False), ((0.0, 100.0), False), ((0.0, -100.0), False), ((-60.0, 60.0), True)),
)
def test_surfaces_that_may_share_ground_are_found_in_all_directions(away, shared):
    grids = [
        CellGrid(500_000.0 + east, 4_800_000.0 + north, 10.0, (8, 8)) for east, north in ((0.0, 0.0), away)
    ]  # 80 m wide
    surfaces = [SimpleNamespace(grid=grid, crs=UTM) for grid in grids]
    assert overlaps(surfaces) == ([(0, 1)] if shared else [])


def test_what_a_raster_does_not_cover_is_not_stable(tmp_path):
    grid = CellGrid(500_000.0, 4_800_080.0, 10.0, (8, 8))
    values = np.array([[1, 0], [2, 1]], dtype=np.float32)
    path = write(str(tmp_path / "stable.tif"), [values], (500_020.0, 20.0, 0.0, 4_800_060.0, 0.0, -20.0), UTM)
    wanted = np.zeros((8, 8), dtype=bool)
    wanted[2:6, 2:6] = np.kron(values > 0, np.ones((2, 2))) > 0
    np.testing.assert_array_equal(stable_cells(path, grid, UTM), wanted)
