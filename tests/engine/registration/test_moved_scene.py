"""A shift put into the pointing: what was seen somewhere is seen where the shift has moved it."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.records import GcpFigures, GroundShift, PointingFigures
from repm_qgis.geometry.footprints import box
from repm_qgis.geometry.frames import EnuFrame, geodetic_from_projected, projected_from_geodetic
from repm_qgis.geometry.jitter import Jitter
from repm_qgis.registration.moved_scene import moved_scene, moved_view
from repm_qgis.scene import Scene, Tile


@pytest.fixture
def ground(urban):
    """The scene's ground, and points in it."""
    middle = projected_from_geodetic(urban.crs, np.array([[urban.views[0].rpc.lon_off, urban.views[0].rpc.lat_off]]))[0]
    bounds = Bounds(*(middle - 100.0), *(middle + 100.0))
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(*ends, 50) for ends in zip(bounds[:2], bounds[2:])])
    return bounds, np.column_stack([points, rng.uniform(*urban.height_range, 50)])


@pytest.mark.parametrize(
    "moved, tilt", (((12.0, -7.0, 5.0), (0, 0)), ((0.0, 0.0, 0.0), (3e-3, -2e-3)), ((30, 30, 20), (0, 0)))
)
def test_points_are_seen_where_the_shift_has_moved_them(urban, ground, moved, tilt):
    bounds, points = ground
    shift = GroundShift(moved, tilt, tuple(points[:, :2].mean(axis=0)))
    there = shift.applied(points)
    for view in urban.views:
        waves = Jitter(0.0, view.height - 1.0, np.random.default_rng(0).normal(0, 0.2, (6, 2)))
        turned = view.with_pointing(np.array([[1.0001, 0.0, 1.5], [0.0, 0.9999, -2.0]]), waves)
        changed, error = moved_view(turned, urban.crs, bounds, urban.height_range, shift)
        before = turned.project(np.column_stack([geodetic_from_projected(urban.crs, points[:, :2]), points[:, 2]]))
        after = changed.project(np.column_stack([geodetic_from_projected(urban.crs, there[:, :2]), there[:, 2]]))
        assert np.abs(after - before).max() < 0.01 and error < 0.01
        back = changed.localise(before, there[:, 2])
        np.testing.assert_allclose(projected_from_geodetic(urban.crs, back), there[:, :2], atol=0.01)
    assert (
        np.abs(
            after - view.project(np.column_stack([geodetic_from_projected(urban.crs, points[:, :2]), points[:, 2]]))
        ).max()
        > 0.4
    )


def test_a_scene_takes_its_heights_along(urban, ground):
    bounds, _ = ground
    tile = Tile("r000c000", tuple(bounds), (150.0, 250.0), {view.name: None for view in urban.views})
    lon, lat = urban.views[0].rpc.lon_off, urban.views[0].rpc.lat_off
    area = box(bounds).ExportToWkt()
    points = (GcpFigures("A", "control", False, 0.5, -0.25, 1.0),)
    ties = PointingFigures(0, 0.0, 0.0, "", "", {}, (), gcps=points)
    scene = Scene(list(urban.views), EnuFrame(lon, lat), urban.crs, area, (140.0, 260.0), [tile], pointing=ties)
    moved, error = moved_scene(scene, GroundShift((5.0, -3.0, 7.0), (0.0, 0.0)))
    assert moved.altitudes == (147.0, 267.0) and moved.tiles[0].altitudes == (157.0, 257.0) and error < 0.01
    assert moved.pointing.gcps == (GcpFigures("A", "control", False, 5.5, -3.25, 8.0),)
    assert tuple(moved.tiles[0].bounds) == tuple(bounds + np.array([5.0, -3.0, 5.0, -3.0]))
