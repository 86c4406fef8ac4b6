"""Ray casting against planes, boxes and slow marching; blur, noise and bits against their definitions."""

import math
from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.errors import Cancelled
from repm_qgis.geometry.frames import geodetic_from_ecef, projected_from_geodetic
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.parameters import SIMULATION
from repm_qgis.simulation.render import RayCaster, _expose, render_view
from repm_qgis.simulation.scene import SceneSpec, make_surface
from repm_qgis.simulation.sensor import PLEIADES, aim
from repm_qgis.simulation.surface import SimulatedSurface

CRS = "EPSG:32631"
CENTRE = (1.44, 43.60)


def _view(number, size, height=200.0, sensor=PLEIADES):
    return aim(
        sensor, sensor.looks[number], (*CENTRE, height), size=(size, size), heading_deg=191.0, seed=3, name=f"v{number}"
    )


def _surface(height, cell=0.5, wall=math.inf):
    east, north = projected_from_geodetic(CRS, np.array(CENTRE))
    rows, cols = height.shape
    plain = np.full_like(height, 500.0)
    return SimulatedSurface(
        CRS,
        round(east) - cols // 2 * cell,
        round(north) + rows // 2 * cell,
        cell,
        wall,
        height,
        plain,
        height - 1,
        np.zeros_like(height),
    )


def _whole(surface, view, seed):
    return np.concatenate([strip for _, strip in render_view(surface, view, seed, Silent())])


def _true_heights(surface, view, pixels, step=0.02):
    """First meetings by marching down each exact ray in ECEF in steps of 2 cm of length: slow and simple."""
    position, direction = view.rays(pixels)
    low, high = surface.height_range()
    result = np.full(len(pixels), np.nan)
    for n in range(len(pixels)):
        start = np.linalg.norm(_ecef(view.localise(pixels[n : n + 1], high + 0.5)) - position[n])
        stop = np.linalg.norm(_ecef(view.localise(pixels[n : n + 1], low - 0.5)) - position[n])
        along = np.arange(start, stop, step)
        ground = geodetic_from_ecef(position[n] + along[:, None] * direction[n])
        inside = surface.heights(*surface.grid(ground)) >= ground[:, 2]
        result[n] = ground[np.argmax(inside), 2]
    return result


def _ecef(lon_lat_h):
    from repm_qgis.geometry.frames import ecef_from_geodetic

    return ecef_from_geodetic(lon_lat_h)


def test_rays_meet_a_plane_where_it_is():
    rows, cols = np.mgrid[:600, :600]
    surface = _surface((200 + 0.12 * cols - 0.05 * rows).astype(np.float32))
    for number in range(3):
        view = _view(number, 200)
        grid = np.linspace(0, 199, 40)
        _, heights = RayCaster(surface, view).cast(grid, grid)
        pixels = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        x, y = surface.grid(view.localise(pixels, heights.reshape(-1)))
        np.testing.assert_allclose(200 + 0.12 * x - 0.05 * y, heights.reshape(-1), atol=2e-3)
        assert np.ptp(heights) > 5


@pytest.mark.parametrize("kind", ["urban", "mountains"])
@pytest.mark.long
def test_rays_stop_at_the_first_thing_they_meet(kind):
    east, north = projected_from_geodetic(CRS, np.array(CENTRE))
    bounds = (east - 130, north - 130, east + 130, north + 130)
    cell, base, relief = (0.25, 190.0, 0.0) if kind == "urban" else (1.0, 150.0, 90.0)
    surface = make_surface(SceneSpec(kind, 240, 2, PLEIADES, cell, 1, base, relief), bounds, Silent())
    rng = np.random.default_rng(0)
    for number in (0, 1, 2):
        view = _view(number, 240, 195.0)
        cols, rows = np.sort(rng.uniform(0, 239, 12)), np.sort(rng.uniform(0, 239, 12))
        _, heights = RayCaster(surface, view).cast(cols, rows)
        pixels = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
        error = heights.reshape(-1) - _true_heights(surface, view, pixels)
        assert (np.abs(error) < 0.06).mean() > 0.98  # a ray that grazes an edge may pass it
        assert np.median(np.abs(error)) < 0.02


def test_a_tower_hides_the_ground_behind_it_and_shows_its_front():
    height = np.full((800, 800), 200.0, np.float32)
    height[380:421, 380:421] = 240.0  # 20 m wide
    surface = _surface(height, 0.5, 0.9)
    view = _view(0, 300)  # looking ahead, southwards: the satellite stands in the north
    grid = np.arange(300.0)
    rays, seen = RayCaster(surface, view).cast(grid, grid)
    wall = (seen > 200.5) & (seen < 239.5)
    roof = np.abs(seen - 240) < 0.05
    pixel = 0.25  # m2
    assert roof.sum() * pixel == pytest.approx(20.5**2, rel=0.03)
    # A metre of height moves the image by so many metres east and north: so wide do the walls lie in it.
    low, high = view.localise(np.full((2, 2), 149.5), np.array([200.0, 240.0]))
    shift = np.abs(projected_from_geodetic(CRS, high) - projected_from_geodetic(CRS, low)) / 40.0
    assert shift[1] > 4 * shift[0]
    assert wall.sum() * pixel == pytest.approx(20.5 * 39.0 * shift.sum(), rel=0.04)
    x, y = rays.at(seen, (slice(None), slice(None)))
    # The walls seen are the northern one and a little of the one in the east; behind the tower nothing is seen.
    assert (y[wall] < 381).mean() > 0.75 and (y[wall] < 421).all() and (x[wall] > 379).all()
    hidden = (np.abs(x - 400) < 12) & (y > 421) & (y < 421 + 0.9 * 40.0 * shift[1] / 0.5)
    assert not (hidden & (seen < 200.5)).any()


def test_point_spread_at_the_nyquist_frequency():
    view = _view(1, 128)
    quiet = replace(view, sensor=replace(PLEIADES, read_noise_dn=0.0, photon_gain=0.0))
    place = -3.25 + 0.5 * np.arange((128 + 6) * 2)
    for axis in (0, 1):
        wave = (1000 + 800 * np.cos(np.pi * place)).astype(np.float32)
        fine = np.broadcast_to(wave if axis else wave[:, None], (wave.size, wave.size))
        image = _expose(fine, quiet, np.random.default_rng(0), SIMULATION.render).astype(float)
        contrast = (image.max() - image.min()) / 1600
        assert 0.09 < contrast < 0.16


def test_noise_is_as_stated():
    view = _view(1, 256)
    fine = np.full(((256 + 6) * 2,) * 2, 1500.0, np.float32)
    image = _expose(fine, view, np.random.default_rng(0), SIMULATION.render).astype(float)
    assert image.mean() == pytest.approx(1500, abs=0.3)
    expected = math.sqrt(PLEIADES.read_noise_dn**2 + PLEIADES.photon_gain * 1500 + 1 / 12)
    assert image.std() == pytest.approx(expected, rel=0.02)


def test_strips_and_whole_image_agree_and_views_differ():
    rows, cols = np.mgrid[:800, :800]
    rng = np.random.default_rng(1)
    surface = _surface((200 + 0.02 * cols + rng.normal(0, 0.1, cols.shape)).astype(np.float32))
    surface = replace(surface, radiance=rng.uniform(200, 2000, cols.shape).astype(np.float32))
    view = _view(0, 280)
    strips = dict(render_view(surface, view, 9, Silent()))
    assert sorted(strips) == [0, 256] and strips[256].shape == (24, 280)
    image = _whole(surface, view, 9)
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(np.concatenate([strips[0], strips[256]]), image)
    other = _whole(surface, view, 10)
    assert (other != image).mean() > 0.5
    # No seam between strips: the step across it is like any other.
    steps = np.abs(np.diff(image.astype(float), axis=0)).mean(axis=1)
    assert steps[255] < 1.3 * np.median(steps)


def test_cancel_stops_at_the_next_block():
    class Stop(Silent):
        blocks = 0

        def check_cancelled(self):
            self.blocks += 1
            if self.blocks == 3:
                raise Cancelled

    progress = Stop()
    surface = _surface(np.full((900, 900), 200.0, np.float32))
    with pytest.raises(Cancelled):
        list(render_view(surface, _view(0, 600), 1, progress))
    assert progress.blocks == 3


def test_pixels_lie_where_the_sensor_says():
    rows, cols = np.mgrid[:800, :800]
    wave = 1000 + 200 * np.sin(cols / 9.0) + 200 * np.cos(rows / 7.0)
    surface = replace(_surface(np.full((800, 800), 200.0, np.float32)), radiance=wave.astype(np.float32))
    for number in (0, 1, 2):
        view = _view(number, 300)
        image = _whole(surface, view, 2)
        grid = np.arange(20.0, 280.0)
        pixels = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        x, y = surface.grid(view.localise(pixels, 200.0))
        expected = (1000 + 200 * np.sin(x / 9.0) + 200 * np.cos(y / 7.0)).reshape(260, 260)
        down, right = np.gradient(expected)
        design = np.stack([right.ravel(), down.ravel(), expected.ravel() - 1000], axis=1)
        error = (image[20:280, 20:280] - expected).ravel()
        shift = np.linalg.lstsq(design, error, rcond=None)[0]
        assert np.abs(shift[:2]).max() < 0.01  # px
        assert -0.02 < shift[2] <= 0.0  # contrast lost to the blur
