"""Light and noise on surfaces, against hand-made cases."""

import math

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.scene import SceneSpec, make_surface
from repm_qgis.simulation.sensor import PLEIADES
from repm_qgis.simulation.surface import Sun, fractal, interpolate, shadow_height


def test_interpolation_is_bilinear_but_keeps_walls():
    heights = np.array([[0, 1, 2], [0, 1, 2], [10, 11, 12]], np.float32)
    col, row = np.array([0.25, 1.5, 0.25, 0.25]), np.array([0.5, 0.0, 1.4, 1.6])
    np.testing.assert_allclose(interpolate(heights, col, row), [0.25, 1.5, 4.25, 6.25])
    np.testing.assert_allclose(interpolate(heights, col, row, 3.0), [0.25, 1.5, 0.0, 10.0])
    outside = np.array([-5.0, 99.0])
    np.testing.assert_allclose(interpolate(heights, outside, outside, 3.0), [0, 12], atol=0.02)


@pytest.mark.parametrize("azimuth", [152.0, 90.0, 237.0])
def test_shadow_of_a_box_has_the_length_that_the_sun_gives_it(azimuth):
    cell, tall = 0.5, 20.0
    height = np.zeros((301, 301), np.float32)
    height[140:161, 140:161] = tall
    sun = Sun(azimuth, 40.0)
    shade = shadow_height(height, cell, sun)
    # Walk from the box's middle away from the sun, and see how far the ground lies in shadow.
    away = -np.array([math.sin(math.radians(azimuth)), -math.cos(math.radians(azimuth))])
    steps = np.arange(0, 120, 0.25)
    shadow = interpolate(shade, 150 + steps * away[0], 150 + steps * away[1]) > 0
    box = 10.0 / np.abs(away).max()  # cells from the middle to the edge on this way
    expected = box + tall / math.tan(math.radians(40.0)) / cell
    assert steps[shadow].max() == pytest.approx(expected, abs=2.0)  # cells of half a metre
    assert not (shade[:100] > 0).any() or azimuth > 90
    # Half-way along the shadow, it reaches half as high as the box.
    middle = box + 0.5 * (expected - box)
    at = interpolate(shade, np.array([150 + middle * away[0]]), np.array([150 + middle * away[1]]))
    assert at[0] == pytest.approx(tall / 2, abs=0.8)


def test_fractal_is_normalised_seeded_and_band_limited():
    one = fractal(np.random.default_rng(3), (300, 257), 1.0, 64.0, 16.0)
    assert one.shape == (300, 257) and one.dtype == np.float32
    assert abs(one.mean()) < 1e-4 and abs(one.std() - 1) < 1e-3
    np.testing.assert_array_equal(one, fractal(np.random.default_rng(3), (300, 257), 1.0, 64.0, 16.0))
    power = np.abs(np.fft.fft2(one[:256, :256] * np.hanning(256)[:, None] * np.hanning(256))) ** 2
    radius = np.hypot(*np.meshgrid(np.fft.fftfreq(256), np.fft.fftfreq(256)))
    assert power[radius > 1 / 4].sum() < 1e-3 * power.sum()


def test_mountains_have_the_relief_asked_for_and_weak_and_strong_texture():
    spec = SceneSpec("mountains", 800, 4, PLEIADES, 1.0, 1, 900.0, 240.0, lon=6.65, lat=44.38)
    surface = make_surface(spec, Bounds(500000, 4900000, 500800, 4900800), Silent())
    low, high = surface.height_range()
    assert 895 < low < 905 and 1130 < high < 1150
    slope = np.hypot(*np.gradient(surface.height))
    assert 0.2 < np.median(slope) < 1.5
    assert ((surface.shade > surface.height + 0.5).mean()) > 0.01  # some cast shadow
    assert 100 < np.percentile(surface.radiance, 1) < np.percentile(surface.radiance, 99) < 3500


def test_town_has_roofs_gables_towers_streets_and_plain_parts():
    spec = SceneSpec("urban", 800, 4, PLEIADES, 0.25, 1, 190.0, 0.0)
    surface = make_surface(spec, Bounds(374000, 4828500, 374400, 4828900), Silent())
    low, high = surface.height_range()
    assert low > 170 and 215 < high < 275
    above = surface.height - np.median(surface.height)
    assert 0.15 < (above > 3.5).mean() < 0.6  # built over, but with open ground
    slope = np.hypot(*np.gradient(surface.height, 0.25))
    roof = above > 3.5
    assert (roof & (slope < 0.03)).mean() > 0.03  # flat roofs
    assert (roof & (slope > 0.45) & (slope < 0.85)).mean() > 0.02  # gables of 25 to 40 degrees
    blocks = surface.radiance[:1600, :1600].reshape(80, 20, 80, 20).std(axis=(1, 3))  # 5 m
    assert (blocks < 25).mean() > 0.01 and (blocks > 150).mean() > 0.2
    assert 0.08 < (surface.shade > surface.height + 0.5).mean() < 0.5
