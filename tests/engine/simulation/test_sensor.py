"""The simulated sensor against plain geometry and pyproj."""

import math
from dataclasses import replace

import numpy as np
import pyproj
import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.simulation.sensor import GF7, PLEIADES, PRESETS, ZY3, JitterSine, Look, aim, jitter_px

TARGET = (1.44, 43.60, 200.0)


def _views(sensor, size=1000, heading=191.0):
    return [
        aim(sensor, look, TARGET, size=(size, size), heading_deg=heading, seed=7, name=f"v{i}")
        for i, look in enumerate(sensor.looks)
    ]


def _xyz(lon_lat_h):
    """An independent way to ECEF: the closed formulas with WGS 84's constants."""
    lon, lat, h = np.radians(lon_lat_h[:, 0]), np.radians(lon_lat_h[:, 1]), lon_lat_h[:, 2]
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return np.stack(
        [(n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon), (n * (1 - e2) + h) * np.sin(lat)],
        axis=1,
    )


@pytest.mark.parametrize("sensor", PRESETS.values(), ids=PRESETS)
@pytest.mark.parametrize("size", [200, 20000])
def test_project_undoes_localise(sensor, size):
    rng = np.random.default_rng(0)
    for view in _views(sensor, size):
        pixels = rng.uniform(-5, size + 5, (500, 2))
        heights = rng.uniform(-100, 3000, 500)
        ground = view.localise(pixels, heights)
        np.testing.assert_array_equal(ground[:, 2], heights)
        np.testing.assert_allclose(view.project(ground), pixels, atol=1e-5)


def test_localised_points_lie_on_their_rays():
    view = _views(PLEIADES)[0]
    pixels = np.random.default_rng(1).uniform(0, 999, (200, 2))
    position, direction = view.rays(pixels)
    for height in (0.0, 1500.0):
        sight = _xyz(view.localise(pixels, height)) - position
        miss = np.linalg.norm(np.cross(sight, direction), axis=1)
        assert miss.max() < 1e-6
        assert (np.einsum("ni,ni->n", sight, direction) > 0.9 * PLEIADES.altitude_m).all()


def test_middle_pixel_sees_the_target():
    for view in _views(PLEIADES):
        centre = view.project(np.array([TARGET]))[0]
        assert np.abs(centre - 499.5).max() < 3.0  # the wobble moves it by a pixel or two


@pytest.mark.parametrize("sensor", PRESETS.values(), ids=PRESETS)
def test_altitude_gsd_and_orientation(sensor):
    to_map = pyproj.Transformer.from_crs(4326, 32631, always_xy=True)
    for view in _views(sensor):
        position, _ = view.rays(np.array([[499.5, 499.5]]))
        assert abs(np.linalg.norm(position[0]) - np.linalg.norm(_xyz(np.array([TARGET]))) - sensor.altitude_m) < 1.0
        ground = view.localise(np.array([[499.5, 499.5], [500.5, 499.5], [499.5, 500.5]]), TARGET[2])
        east, north = to_map.transform(ground[:, 0], ground[:, 1])
        by_col = np.array([east[1] - east[0], north[1] - north[0]])
        by_row = np.array([east[2] - east[0], north[2] - north[0]])
        assert abs(np.hypot(*by_row) / view.look.gsd_m - 1) < 0.02
        assert abs(np.hypot(*by_col) / view.look.gsd_m - 1) < 0.02
        # A flight to the south: columns go east, rows go south, and the image is no mirror image of the map.
        assert by_col[0] > 0 > by_row[1]
        assert by_col[0] * by_row[1] - by_col[1] * by_row[0] < 0
        heading = math.degrees(math.atan2(by_row[0], by_row[1])) % 360
        assert abs(heading - 191.0) < 1.5


def _base_to_height(one, other):
    """Tangents of the angles between the middle rays and the local vertical, along the flight, put together."""
    slopes = []
    for view in (one, other):
        ground = view.localise(np.array([[499.5, 499.5]] * 2), np.array([200.0, 300.0]))
        xyz = _xyz(ground)
        slopes.append((xyz[1] - xyz[0]) / 100.0)
    return np.linalg.norm(slopes[0] - slopes[1])


def test_base_to_height_of_the_triplets():
    fore, nadir, aft = _views(PLEIADES)
    # 12 degrees at the satellite are 13.3 degrees at the ground.
    assert _base_to_height(fore, aft) == pytest.approx(2 * math.tan(math.radians(13.33)), abs=0.01)
    assert 0.2 < _base_to_height(fore, nadir) < 0.28
    fore, _, aft = _views(ZY3)
    assert 0.8 < _base_to_height(fore, aft) < 0.95
    assert 0.5 < _base_to_height(*_views(GF7)) < 0.75


def test_roll_looks_to_the_right_of_the_flight():
    view = aim(PLEIADES, Look(0.0, 0.5, 20.0), TARGET, size=(100, 100), heading_deg=0.0, seed=1, name="v")
    ground = view.localise(np.array([[49.5, 49.5]] * 2), np.array([200.0, 1200.0]))
    # Flying north and looking right, the satellite stands in the west: higher points on the ray lie westwards.
    assert ground[1, 0] < ground[0, 0]
    east = (ground[0, 0] - ground[1, 0]) * math.cos(math.radians(43.6)) * 111320
    assert east == pytest.approx(1000 * math.tan(math.radians(22.3)), rel=0.03)


def test_a_look_beyond_the_horizon_is_refused():
    with pytest.raises(OptionError, match="horizon"):
        aim(PLEIADES, Look(70.0, 0.5), TARGET, size=(100, 100), heading_deg=191.0, seed=1, name="v")


def test_jitter_moves_lines_as_its_sines_say():
    sines = (JitterSine(400.0, (0.7, 0.0), (0.3, 0.0)), JitterSine(900.0, (0.2, 0.6), (1.0, 2.0)))
    view = replace(_views(ZY3, 2000)[1], jitter=sines)
    pixels = np.random.default_rng(5).uniform(0, 1999, (400, 2))
    ground = view.localise(pixels, 800.0)
    np.testing.assert_allclose(view.project(ground), pixels, atol=1e-5)
    moved = pixels - view.steady.project(ground)
    # A line is as long on the ground as a detector only where the camera looks straight down on flat ground.
    np.testing.assert_allclose(moved, jitter_px(sines, pixels[:, 1]), atol=0.1 * 0.8)
    assert np.abs(moved).max() > 0.6 and view.steady.jitter == ()
