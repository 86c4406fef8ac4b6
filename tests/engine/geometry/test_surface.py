"""Coarse surfaces, and what the terrain-aware refinement makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from repm_qgis.contracts.errors import OptionError
from repm_qgis.geometry.equivalent_error import fit_pinhole, refine_pinhole, surface_grid, virtual_grid
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.geometry.parameters import VIRTUAL_GRID
from repm_qgis.geometry.refinement import Terrain, TerrainMap, map_from_mapping
from repm_qgis.geometry.surface import Surface

WINDOW = (20000, 18000, 900, 700)


@pytest.mark.parametrize("shape", ((4, 6), (2, 2), (2, 5)))
@pytest.mark.parametrize("lon", (10.0, 179.99, -179.985))
def test_heights_are_scipys_bilinear_ones_and_go_on_level(shape, lon):
    heights = np.random.default_rng(1).uniform(100, 900, shape)
    surface = Surface(lon, 45.0, 0.01, 0.02, heights)
    east, south = np.random.default_rng(2).uniform(-0.03, 0.12, (2, 300))
    expected = RegularGridInterpolator((np.arange(shape[0]), np.arange(shape[1])), heights)(
        np.column_stack([np.clip(south / 0.02, 0, shape[0] - 1), np.clip(east / 0.01, 0, shape[1] - 1)])
    )
    around = (lon + east + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(surface.height(around, 45.0 - south), expected, atol=1e-6)
    np.testing.assert_allclose(surface.height(around + 360.0, 45.0 - south), expected, atol=1e-6)
    assert surface.height(np.array(lon), np.array(45.0)) == pytest.approx(heights[0, 0])


@pytest.mark.parametrize("shape", ((1, 1), (1, 4), (4, 1)))
def test_a_surface_of_one_row_or_column(shape):
    surface = Surface(10.0, 45.0, 0.01, 0.01, np.arange(4.0)[: max(shape)].reshape(shape))
    east, south = (0.02 if shape[1] > 1 else 0.0), (0.02 if shape[0] > 1 else 0.0)
    assert surface.height(np.array([10.0 + east]), np.array([45.0 - south]))[0] == pytest.approx(
        2.0 if max(shape) > 1 else 0.0
    )


def test_unknown_places_have_no_height():
    surface = Surface(10.0, 45.0, 0.01, 0.01, np.full((3, 3), 7.0))
    found = surface.height(np.array([np.nan, 10.0, np.nan, 10.0]), np.array([45.0, np.nan, np.nan, 45.0]))
    np.testing.assert_array_equal(found, [np.nan, np.nan, np.nan, 7.0])


@pytest.fixture(scope="module")
def slope(synthetic_rpc):
    """The RPC's frame, and a surface that falls to the east by 30 m over the window; the pinhole of the window."""
    rpc = synthetic_rpc()
    frame = EnuFrame(rpc.lon_off, rpc.lat_off, 0.0)
    lon = rpc.lon_off + np.linspace(-0.02, 0.02, 9)
    heights = np.tile(500.0 - 4000.0 * (lon - rpc.lon_off), (9, 1)) + 3.0 * np.sin(np.arange(9))[:, None]
    surface = Surface(lon[0], rpc.lat_off + 0.02, lon[1] - lon[0], 0.005, heights)
    grid = virtual_grid(rpc.localise, WINDOW, (400.0, 600.0), frame)
    return Terrain(rpc, frame, surface), fit_pinhole(grid).camera, grid


def on_ground(terrain, count=200):
    """(N, 3) points of the surface that the window sees."""
    rpc, surface = terrain.sensor, terrain.surface
    pixels = np.random.default_rng(4).uniform((20000, 18000), (20900, 18700), (count, 2))
    points = rpc.localise(pixels, 500.0)
    points[:, 2] = surface.height(points[:, 0], points[:, 1])
    return points


def test_on_the_surface_the_terrain_map_is_exact(slope):
    """With a camera of the whole image, which is off by pixels, and differently at other heights."""
    terrain, _, _ = slope
    whole = virtual_grid(terrain.sensor.localise, (0, 0, 41500, 38000), (100.0, 900.0), terrain.frame)
    camera = fit_pinhole(whole).camera.without_skew()
    ground = on_ground(terrain)
    refined, original = camera.project(terrain.frame.from_geodetic(ground)), terrain.sensor.project(ground)
    assert np.abs(refined - original).max() > 0.05
    terrain_map = TerrainMap(camera, terrain)
    np.testing.assert_allclose(terrain_map.original_from_refined(refined), original, atol=3e-5)
    np.testing.assert_allclose(terrain_map.refined_from_original(original), refined, atol=3e-5)
    shaped = refined.reshape(20, 10, 2)
    np.testing.assert_array_equal(
        terrain_map.original_from_refined(shaped).reshape(-1, 2), terrain_map.original_from_refined(refined)
    )
    moved = terrain_map.moved(100, 250)
    np.testing.assert_allclose(moved.original_from_refined(refined - [100, 250]), original, atol=3e-5)
    np.testing.assert_allclose(moved.refined_from_original(original), refined - [100, 250], atol=3e-5)


def test_the_terrain_map_is_made_again_from_its_surroundings(slope):
    terrain, camera, _ = slope
    again = map_from_mapping(TerrainMap(camera, terrain).to_mapping(), camera, lambda: terrain)
    assert again.terrain is terrain and again.camera is camera
    with pytest.raises(OptionError, match="MODEL is 'terrain': it needs a surface"):
        refine_pinhole("terrain", camera, None, window=WINDOW)


def test_the_terrain_models_error_is_measured_near_the_surface(slope):
    terrain, camera, _ = slope
    grid = surface_grid(terrain, WINDOW, VIRTUAL_GRID)
    assert len(grid.pixels) == np.prod(VIRTUAL_GRID.scene)
    above = grid.ground[:, 2] - terrain.surface.height(grid.ground[:, 0], grid.ground[:, 1])
    np.testing.assert_allclose(np.unique(np.round(above, 1)), np.linspace(-10, 10, VIRTUAL_GRID.scene[2]), atol=0.05)
    np.testing.assert_allclose(terrain.sensor.project(grid.ground), grid.pixels, atol=1e-6)
    np.testing.assert_allclose(grid.enu, terrain.frame.from_geodetic(grid.ground), atol=1e-9)


class Counted:
    """A sensor that counts the points that it is asked for."""

    def __init__(self, sensor):
        self.sensor, self.asked = sensor, 0

    def project(self, points):
        self.asked += points.size // 3
        return self.sensor.project(points)

    def localise(self, pixels, height):
        self.asked += np.size(height)
        return self.sensor.localise(pixels, height)


@pytest.fixture(scope="module")
def great_relief(synthetic_rpc):
    """A sensor that counts, and 8600 m of relief within its image: a slope of 40 degrees, rough by 15 m in 80 m."""
    sensor = Counted(synthetic_rpc())
    rng, lon = np.random.default_rng(5), sensor.sensor.lon_off + np.linspace(-0.06, 0.06, 120)
    up = np.linspace(200.0, 8800.0, 120)[None, :] + rng.uniform(-15.0, 15.0, (120, 120))
    surface = Surface(lon[0], sensor.sensor.lat_off + 0.06, lon[1] - lon[0], 0.12 / 119, up)
    return Terrain(sensor, EnuFrame(sensor.sensor.lon_off, sensor.sensor.lat_off), surface)


def test_lines_of_sight_meet_great_relief_exactly_and_soon(great_relief):
    """Points are followed on parabolas, and the sensor is asked for few of them more than once."""
    sensor = great_relief.sensor
    sensor.asked = 0
    grid = surface_grid(great_relief, WINDOW, VIRTUAL_GRID)
    above = grid.ground[:, 2] - great_relief.surface.height(grid.ground[:, 0], grid.ground[:, 1])
    levels = np.tile(np.linspace(-10, 10, VIRTUAL_GRID.scene[2]), len(grid.pixels) // VIRTUAL_GRID.scene[2])
    np.testing.assert_allclose(above, levels, atol=2e-3)
    np.testing.assert_allclose(sensor.sensor.project(grid.ground), grid.pixels, atol=1e-6)
    # Asked at every step from the mean height on, it would be for 15 times as many.
    assert sensor.asked < 5 * len(grid.pixels)


def test_the_map_through_great_relief_goes_there_and_back(great_relief):
    camera = fit_pinhole(virtual_grid(great_relief.sensor.localise, WINDOW, (200.0, 8800.0), great_relief.frame)).camera
    terrain_map = TerrainMap(camera.without_skew(), great_relief)
    original = np.random.default_rng(6).uniform((20000, 18000), (20900, 18700), (500, 2))
    great_relief.sensor.asked = 0
    refined = terrain_map.refined_from_original(original)
    assert great_relief.sensor.asked < 8 * len(original)
    np.testing.assert_allclose(terrain_map.original_from_refined(refined), original, atol=1e-4)


def test_the_refined_image_holds_the_window_and_no_more(slope):
    terrain, camera, grid = slope
    for model in ("none", "homography", "polynomial", "terrain"):
        refined = refine_pinhole(model, camera, grid, window=WINDOW, terrain=terrain)
        assert refined.camera.K[0, 1] == 0.0
        edge = np.linspace(0, 1, 50)
        around = np.concatenate([[(t, 0.0), (t, 1.0), (0.0, t), (1.0, t)] for t in edge]) * [899, 699] + [20000, 18000]
        inside = refined.to_original.refined_from_original(around)
        assert inside.min() > -0.01 and (inside.max(axis=0) < np.array(refined.size) - 1 + 0.01).all()
        assert inside.min(axis=0).max() < 1.0 and (inside.max(axis=0) > np.array(refined.size) - 2).all()
        # The camera and the map belong to each other: ground points are seen where M says.
        ground = terrain.frame.from_geodetic(on_ground(terrain, 50))
        seen = refined.to_original.original_from_refined(refined.camera.project(ground))
        expected = terrain.sensor.project(on_ground(terrain, 50))
        assert np.abs(seen - expected).max() < refined.error.max + 0.01
