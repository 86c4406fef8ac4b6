from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.evaluation import coregistration as c

CELL = 0.5


def bilinear(z, columns, rows):
    """z displaced right and down, by an own few lines; NaN spreads."""
    y, x = np.mgrid[: z.shape[0], : z.shape[1]].astype(float)
    x, y = x - columns, y - rows
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    inside = (x0 >= 0) & (y0 >= 0) & (x0 < z.shape[1] - 1) & (y0 < z.shape[0] - 1)
    x0, y0, u, v = np.where(inside, x0, 0), np.where(inside, y0, 0), x - x0, y - y0
    out = (z[y0, x0] * (1 - u) + z[y0, x0 + 1] * u) * (1 - v) + (z[y0 + 1, x0] * (1 - u) + z[y0 + 1, x0 + 1] * u) * v
    return np.where(inside, out, np.nan).astype(np.float32)


@pytest.mark.parametrize(
    "dx, dy, dz, noise", [(0, 0, 0, 0), (0.25, -0.25, 3, 0.2), (-1.15, 2.4, -7, 0.5), (9.1, 6.3, 1, 0)]
)
def test_known_shift_of_smooth_terrain(dx, dy, dz, noise, terrain):
    rng = np.random.default_rng(2)
    reference = terrain(320, 360).astype(np.float32)
    dsm = (terrain(320, 360, dx, dy) + dz + rng.normal(0, noise, reference.shape)).astype(np.float32)
    found = c.align("3d", [(dsm, reference)], (CELL, CELL))
    # what must be added is the opposite of what was done
    assert found.dx == pytest.approx(-dx, abs=0.05 * CELL)
    assert found.dy == pytest.approx(-dy, abs=0.05 * CELL)
    assert found.dz == pytest.approx(-dz, abs=0.02)


def urban_truth(shared_data):
    dataset = gdal.Open(str(shared_data / "truth_urban" / "truth.tif"))
    z = dataset.ReadAsArray(200, 200, 640, 640).astype(np.float32)
    z[z < -9000] = np.nan
    return z


@pytest.mark.parametrize(
    "columns, rows, dz, noise",
    [(0.5, 0.5, -3, 0.3), (2.3, -1.7, 1.2, 0), (-7.4, 11.6, 5, 0.3), (20.25, -15.1, 0, 0.2), (0, 0, 0, 0.3)],
)
@pytest.mark.long
def test_known_shift_of_a_city(shared_data, columns, rows, dz, noise):
    rng = np.random.default_rng(3)
    truth = urban_truth(shared_data)
    dsm = bilinear(truth, columns, rows) + dz + rng.normal(0, noise, truth.shape).astype(np.float32)
    wrong = rng.random(dsm.shape) < 0.05
    dsm[wrong] += rng.uniform(-15, 15, wrong.sum()).astype(np.float32)
    dsm[100:200, 50:200] = np.nan
    found = c.align("3d", [(dsm.astype(np.float32), truth)], (CELL, CELL))
    assert found.dx == pytest.approx(-columns * CELL, abs=0.05 * CELL)
    assert found.dy == pytest.approx(rows * CELL, abs=0.05 * CELL)
    assert found.dz == pytest.approx(-dz, abs=0.02)
    assert found.nmad_after <= found.nmad_before + 1e-3


def test_patches_share_one_shift(terrain):
    reference, dsm = terrain(900, 400), terrain(900, 400, 1.3, -0.85)
    patches = [(dsm[r : r + 200].astype(np.float32), reference[r : r + 200].astype(np.float32)) for r in (0, 350, 700)]
    found = c.align("3d", patches, (CELL, CELL))
    assert (found.dx, found.dy) == pytest.approx((-1.3, 0.85), abs=0.05 * CELL)


def test_vertical_is_the_median(terrain):
    reference = terrain(60, 60).astype(np.float32)
    dsm = reference + 2
    dsm[:20] += 50
    dsm[-5:] = np.nan
    assert c.align("vertical", [(dsm, reference)], (CELL, CELL)).dz == pytest.approx(-2, abs=1e-4)


def test_whole_cells_are_found_and_applied(terrain):
    """The alignment of the benchmarks: a shift that is no whole number of cells goes to the nearest one."""
    reference = terrain(120, 130).astype(np.float32)
    dsm = terrain(120, 130, 2.9 * CELL, -1.1 * CELL).astype(np.float32) + 4
    found = c.align("cells", [(dsm, reference)], (CELL, CELL))
    assert (found.dx, found.dy) == (-3 * CELL, CELL) and found.dz == pytest.approx(-4, abs=0.3)
    applied = found.applied(dsm, (CELL, CELL))
    assert np.array_equal(applied[:-1, :-3], dsm[1:, 3:] + np.float32(found.dz))
    assert np.isnan(applied[-1]).all() and np.isnan(applied[:, -3:]).all()


def test_a_shift_is_cubic_and_never_invents():
    y, x = np.mgrid[:40, :50].astype(np.float32)
    plane = 2 * x + 3 * y
    got = c.shifted(plane, 1.25, -2.5)
    inside = np.isfinite(got)
    assert inside.sum() > 1400
    assert np.abs(got - (plane - 2 * 1.25 + 3 * 2.5))[inside].max() < 1e-4
    plane[20, 20] = np.nan
    hole = ~np.isfinite(c.shifted(plane, 1.25, -2.5))
    assert hole[16:20, 20:24].all() and not hole[16:20, 26:40].any()
    assert np.array_equal(c.shifted(plane, 3, 0)[:, 3:], plane[:, :-3], equal_nan=True)


@pytest.mark.parametrize("reference", [np.full((150, 150), 5.0), np.mgrid[:150, :150][1] * 0.1])
def test_ground_without_relief_is_refused(reference):
    rng = np.random.default_rng(0)
    dsm = (reference + rng.normal(0, 0.3, reference.shape)).astype(np.float32)
    with pytest.raises(EmptyResultError, match="too little relief.*ALIGN to vertical"):
        c.align("3d", [(dsm, reference.astype(np.float32))], (CELL, CELL))


def test_too_few_cells_are_refused():
    z = np.full((50, 50), np.nan, np.float32)
    z[0, :9] = 1
    for align in (
        lambda: c.align("vertical", [(z, z)], (1, 1)),
        lambda: c.align("3d", [(z, z)], (1, 1)),
        lambda: c.align("vertical", [], (1, 1)),
    ):
        with pytest.raises(EmptyResultError, match="Cells with a height in both the DSM and the reference: (9|0);"):
            align()


def test_shrunk_takes_means_of_what_is_there():
    z = np.arange(16, dtype=np.float32).reshape(4, 4)
    z[0, 0] = z[2, 2] = z[2, 3] = z[3, 2] = np.nan
    got = c.block_means(z, 2)
    assert got[0, 0] == pytest.approx((1 + 4 + 5) / 3) and got[0, 1] == pytest.approx((2 + 3 + 6 + 7) / 4)
    assert np.isnan(got[1, 1])
