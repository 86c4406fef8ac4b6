"""Depths in single precision to heights: against ground points, projected by GDAL and intersected independently."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from repm_qgis.colmap.depth_heights import depth_geometry
from repm_qgis.colmap.projective_frame import FrameView, ProjectiveFrame, TileFrame, tile_frame
from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.stereo.parameters import STEREO


def at(table, points):
    return np.array([table.on_grid(np.array([c]), np.array([r]), np.array([[t]]))[0, 0] for c, r, t in points])


@pytest.fixture(scope="session")
def tile(case):
    names, stereo = [view.name for view in case.views], replace(STEREO, tile_margin_px=16)
    return tile_frame(case.scene, names, case.bounds, case.altitudes, stereo=stereo)


def test_a_float32_depth_gives_its_height_back_through_t(case, tile):
    """The pinhole's own round trip: ENU to depth, float32, and through T^-1 again."""
    points = case.points(400, 8)
    enu = case.scene.frame.from_geodetic(
        np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    )
    there = tile.frame.from_enu(enu)
    for view in tile.views:
        camera = view.camera
        depth = camera.depth(there).astype(np.float32)
        rays = np.column_stack([camera.project(there), np.ones(len(points))]) @ np.linalg.inv(camera.K).T
        to_enu = ProjectiveFrame(np.linalg.inv(tile.frame.matrix)).from_enu
        back = to_enu((rays * depth.astype(np.float64)[:, None] - camera.t) @ camera.R)
        assert np.abs(case.scene.frame.to_geodetic(back)[:, 2] - points[:, 2]).max() < 0.01
        assert np.abs(back - enu).max() < 0.01


def test_the_depth_that_fits_the_images_gives_the_ground_s_height(case, tile, gdal_pixels):
    """Pixels by GDAL, the depth by a search of its own over the reprojection error, then our tables."""
    first, second = tile.views
    table = depth_geometry(case.scene, tile, first, sources=[second], crs=case.crs)
    points = case.points(60, 3)
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    a = first.from_original(gdal_pixels(case.views[0].rpc, ground))
    b = second.from_original(gdal_pixels(case.views[1].rpc, ground))
    depths = []
    for pixel, seen in zip(a, b):
        ray = np.linalg.solve(first.camera.K, np.append(pixel, 1.0))

        def misfit(depth, ray=ray, seen=seen):
            return np.linalg.norm(second.camera.project((ray * depth - first.camera.t) @ first.camera.R) - seen)

        depths.append(minimize_scalar(misfit, bounds=(0.9, 2.2), method="bounded", options={"xatol": 1e-9}).x)
    depths = np.array(depths, dtype=np.float32).astype(np.float64)
    height = at(table.height, np.column_stack([a, 1 / depths]))
    assert np.abs(height - points[:, 2]).max() < 0.01
    places = np.column_stack([a, points[:, 2]])
    assert np.abs(at(table.x, places) - points[:, 0]).max() < 0.01
    assert np.abs(at(table.y, places) - points[:, 1]).max() < 0.01
    assert table.error_m < 0.01 and table.vertical_parallax_px < 0.05 and table.best == 0


def test_a_px_of_the_source_is_so_much_height(case, tile):
    first, second = tile.views
    table = depth_geometry(case.scene, tile, first, sources=[second], crs=case.crs)
    x, y = (case.bounds[0] + case.bounds[2]) / 2, (case.bounds[1] + case.bounds[3]) / 2
    lon_lat = geodetic_from_projected(case.crs, np.array([x, y]))
    start = np.append(lon_lat, sum(case.altitudes) / 2)
    up = first.view.localise(first.view.project(start), start[2] + 10.0)
    seen = second.from_original(second.view.project(np.stack([start, up])))
    assert table.metres_per_px == pytest.approx(10.0 / np.linalg.norm(seen[1] - seen[0]), rel=0.1)


def test_several_sources_share_one_depth(urban):
    from tests.engine.colmap.truth_depths import true_frame

    scene, tile = true_frame(urban, 50.0)
    one = depth_geometry(scene, tile, tile.views[0], sources=[tile.views[1]], crs=scene.crs)
    all_ = depth_geometry(scene, tile, tile.views[0], sources=tile.views[1:], crs=scene.crs)
    inverse = np.full(tile.views[0].size[::-1], 0.75)
    rows, columns = (np.arange(n, dtype=np.float64) for n in inverse.shape)
    assert np.abs(one.height.on_grid(columns, rows, inverse) - all_.height.on_grid(columns, rows, inverse)).max() < 0.01
    assert all_.metres_per_px <= one.metres_per_px + 1e-9


def test_a_reference_that_sees_nothing_says_so(case, tile):
    first, second = tile.views

    class Blind:
        name = "blind"

        def localise(self, pixels, height):
            return np.full(pixels.shape[:-1] + (3,), np.nan)

    blind = FrameView(Blind(), first.refined, first.camera, first.from_refined, first.size)
    with pytest.raises(EmptyResultError, match="blind sees no ground"):
        around = TileFrame(tile.frame, (blind, second), tile.bounds, tile.wide, tile.altitudes)
        depth_geometry(case.scene, around, blind, sources=[second], crs=case.crs)
