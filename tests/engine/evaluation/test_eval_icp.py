"""Alignment by points, and point clouds in comparisons: known shifts, rasters of clouds, and what cannot be aligned."""

from __future__ import annotations

import sys

import laspy
import numpy as np
import pyproj
import pytest

from repm_qgis.contracts.errors import EmptyResultError, ImageError, MissingPackageError, OverlapError
from repm_qgis.evaluation.icp import shift_onto
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage

WEST, NORTH = 500000.0, 5000000.0
SHIFT = np.array([1.37, -2.21, 0.83])


def roofs(x, y):
    """Gabled roofs in two directions, 6 m high, on rolling ground; metres."""
    u, v = np.mod(x, 40) - 20, np.mod(y, 40) - 20
    east = np.mod(np.floor(x / 40) + np.floor(y / 40), 2) == 0
    across, along = np.where(east, u, v), np.where(east, v, u)
    roof = (np.abs(across) < 8) & (np.abs(along) < 12)
    return 50 + 0.5 * np.sin(x / 30) * np.cos(y / 25) + np.where(roof, 10 - 0.5 * np.abs(across), 0.0)


def scattered(count, seed, side=240.0):
    """(N, 3) places with heights, at random: no lattice that the other surface could lock onto."""
    numbers = np.random.default_rng(seed)
    x, y = numbers.uniform(0, side, (2, count))
    return np.column_stack([x, y, roofs(x, y) + numbers.normal(0, 0.05, count)])


def las(path, xyz, crs="EPSG:32631", returns=1, kind=1):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [WEST, NORTH, 0]
    if crs:
        header.add_crs(pyproj.CRS(crs))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = WEST + xyz[:, 0], NORTH - 240 + xyz[:, 1], xyz[:, 2]
    cloud.return_number = cloud.number_of_returns = np.broadcast_to(np.uint8(returns), len(xyz))
    cloud.classification = np.broadcast_to(np.uint8(kind), len(xyz))
    cloud.write(str(path))
    return str(path)


@pytest.fixture
def dsm(make_raster):
    """The roofs on cells of 0.5 m, moved by ``SHIFT``, with noise."""
    row, column = np.mgrid[:480, :480]
    x, y = (column + 0.5) * 0.5 - SHIFT[0], 240 - (row + 0.5) * 0.5 - SHIFT[1]
    heights = roofs(x, y) + SHIFT[2] + np.random.default_rng(2).normal(0, 0.1, x.shape)
    return make_raster("dsm.tif", heights, (WEST, NORTH))


def compare(dsm, reference, **options):
    return run_stage("comparedsm", {"dsm": dsm, "reference": reference, **options}, Silent())


def added(result):
    return np.array([result.dx, result.dy, result.dz])


@pytest.mark.long
def test_points_find_a_known_shift():
    for start in (np.zeros(3), -SHIFT + [0.8, -0.9, 0.3]):
        near = SHIFT if start.any() else np.array([0.3, -0.4, 0.2])
        found = shift_onto(scattered(60_000, 1) + near, scattered(120_000, 2), start)
        np.testing.assert_allclose(found, -near, atol=0.02)


@pytest.mark.slow
def test_a_clouds_points_lay_a_dsm_onto_it(dsm, tmp_path):
    reference = las(tmp_path / "lidar.laz", scattered(230_000, 3))
    found = compare(dsm, reference, align="icp", report=str(tmp_path / "r.html"))
    np.testing.assert_allclose(added(found), -SHIFT, atol=0.02)
    assert found.nmad < 0.15 and abs(found.bias) < 0.02 and found.cells > 100_000
    assert "point to plane" in (tmp_path / "r.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_moving_the_dsm_moves_the_answer_and_nothing_else(make_raster, tmp_path):
    """Neither surface is resampled: the same DSM elsewhere finds the same place to a few millimetres."""
    reference = las(tmp_path / "lidar.laz", scattered(230_000, 3))
    row, column = np.mgrid[:480, :480]
    heights = roofs((column + 0.5) * 0.5, 240 - (row + 0.5) * 0.5)
    heights += np.random.default_rng(5).normal(0, 0.2, heights.shape)
    places = []
    for number, (dx, dy, dz) in enumerate(((0, 0, 0), (0.31, -0.17, 1.0), (-1.13, 0.77, -3.0))):
        moved = make_raster(f"{number}.tif", heights + dz, (WEST + dx, NORTH + dy))
        places.append(added(compare(moved, reference, align="icp")) + [dx, dy, dz])
    assert np.ptp(places, axis=0).max() < 0.01


@pytest.mark.slow
def test_a_cloud_is_a_dsm_too(dsm, tmp_path, make_raster):
    cloud = las(tmp_path / "matched.laz", scattered(230_000, 4) + [0.4, 0.3, -0.5])
    row, column = np.mgrid[:480, :480]
    reference = make_raster("ref.tif", roofs((column + 0.5) * 0.5, 240 - (row + 0.5) * 0.5), (WEST, NORTH))
    np.testing.assert_allclose(added(compare(cloud, reference, align="icp")), [-0.4, -0.3, 0.5], atol=0.02)
    both = las(tmp_path / "lidar.laz", scattered(230_000, 3))
    np.testing.assert_allclose(added(compare(cloud, both, align="icp")), [-0.4, -0.3, 0.5], atol=0.02)


def test_a_clouds_raster_has_first_returns_without_noise(make_raster, tmp_path):
    """Means of a cell of the DSM's; echoes from below crowns, and birds, do not count."""
    numbers = np.random.default_rng(1)
    xyz = np.column_stack([*numbers.uniform(0, 50, (2, 40_000)), np.full(40_000, 20.0)])
    returns, kind = np.ones(40_000, np.uint8), np.ones(40_000, np.uint8)
    returns[::3], xyz[::3, 2] = 2, 5.0
    kind[1::9], xyz[1::9, 2] = 7, 500.0
    reference = las(tmp_path / "lidar.las", xyz, returns=returns, kind=kind)
    flat = make_raster("flat.tif", np.full((100, 100), 21.5), (WEST, NORTH - 190), cell=0.5)
    found = compare(flat, reference)
    assert found.bias == pytest.approx(1.5, abs=1e-4) and found.rmse == pytest.approx(1.5, abs=1e-4)
    assert found.cells > 8500


@pytest.mark.long
def test_what_cannot_be_aligned_is_shortage_as_error(dsm, make_raster, tmp_path, monkeypatch):
    numbers = np.random.default_rng(1)
    x, y = numbers.uniform(0, 240, (2, 50_000))
    plane = np.column_stack([x, y, 0.1 * x])
    with pytest.raises(EmptyResultError, match="too similar orientations for ALIGN=icp"):
        shift_onto(plane, plane + [0, 0, 0.2], np.zeros(3))
    with pytest.raises(EmptyResultError, match="Points of the DSM near flat parts of the reference: 0;"):
        shift_onto(plane, plane + [0, 0, 90.0], np.zeros(3))
    with pytest.raises(ImageError, match="no coordinate reference system"):
        compare(dsm, las(tmp_path / "none.las", plane, crs=None))
    with pytest.raises(OverlapError, match="far.las"):
        compare(dsm, las(tmp_path / "far.las", plane + [9000, 0, 0]))
    monkeypatch.setitem(sys.modules, "scipy.spatial", None)
    with pytest.raises(MissingPackageError, match="ALIGN=icp needs the package 'scipy'.*or set ALIGN to 3d"):
        shift_onto(plane, plane, np.zeros(3))
