"""Waves of a view's lines: splines, their inverse, and refined images that are free of them."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.checks import Misfit
from repm_qgis.geometry.jitter import ORDER, Jitter, splines
from repm_qgis.geometry.pinhole import PinholeCamera
from repm_qgis.geometry.refinement import HomographyMap, JitteredMap, TerrainMap, map_from_mapping, translation

LINES = np.linspace(0.0, 2000.0, 4001)


def sine(rows):
    angle = 2 * np.pi * rows / 420.0
    return np.stack([0.7 * np.sin(angle), 0.4 * np.cos(angle)], axis=-1)


@pytest.fixture(scope="module")
def jitter():
    count = 25
    first, weights = splines(LINES, (0.0, 2000.0), count)
    design = np.zeros((len(LINES), count))
    np.put_along_axis(design, first[:, None] + np.arange(ORDER), weights, axis=1)
    return Jitter(0.0, 2000.0, np.linalg.lstsq(design, sine(LINES), rcond=None)[0])


def test_splines_follow_a_wave_and_sum_to_one(jitter):
    first, weights = splines(LINES, (0.0, 2000.0), 25)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert weights.min() >= 0 and first.min() == 0 and first.max() == 25 - ORDER
    assert np.abs(jitter.at(LINES) - sine(LINES)).max() < 0.01
    assert 0.4 < jitter.rms_px[0] < 0.6 and 0.2 < jitter.rms_px[1] < 0.35 and 0.65 < jitter.most_px < 0.75


def test_waves_are_smooth_and_go_on_level_beyond_their_ends(jitter):
    step = 1e-3
    slope = (jitter.at(LINES[5:-5] + step) - jitter.at(LINES[5:-5] - step)) / (2 * step)
    assert np.abs(np.diff(slope, axis=0)).max() < 2e-4  # of a curvature of 1.6e-4 px for each line and half a line
    np.testing.assert_allclose(jitter.at(np.array([-50.0, 2300.0])), jitter.at(np.array([0.0, 2000.0])))
    assert np.isnan(jitter.at(np.array([np.nan]))).all()


def test_what_was_removed_is_added_again(jitter):
    pixels = np.random.default_rng(0).uniform(-20, 2020, (500, 2))
    steady = jitter.removed(pixels)
    np.testing.assert_allclose(steady, pixels - jitter.at(pixels[:, 1]))
    np.testing.assert_allclose(jitter.added(steady), pixels, atol=1e-8)
    assert np.abs(steady - pixels).max() > 0.5


def test_what_no_satellite_does_is_refused(jitter):
    assert not jitter.contradiction()
    assert "steep" in Jitter(0.0, 100.0, np.array([[0.0, 0.0], [90.0, 0], [0.0, 0], [0.0, 0]])).contradiction()
    assert "fewer than 4" in Jitter(0.0, 100.0, np.zeros((3, 2))).contradiction()
    assert "last line" in Jitter(100.0, 100.0, np.zeros((9, 2))).contradiction()
    assert Jitter.from_mapping(jitter.to_mapping()).at(LINES).tolist() == jitter.at(LINES).tolist()


def test_a_refined_image_is_free_of_the_waves(jitter):
    camera = PinholeCamera(np.diag([1e6, 1e6, 1.0]), np.eye(3), np.zeros(3))
    steady = HomographyMap(translation(30.0, 200.0))
    found = JitteredMap(steady, jitter)
    points = np.random.default_rng(1).uniform(0, 900, (200, 2))
    original = found.original_from_refined(points)
    np.testing.assert_allclose(found.refined_from_original(original), points, atol=1e-8)
    np.testing.assert_allclose(original - steady.original_from_refined(points), jitter.at(original[:, 1]), atol=1e-8)
    np.testing.assert_allclose(found.moved(5.0, 7.0).original_from_refined(points - (5.0, 7.0)), original, atol=1e-8)
    again = map_from_mapping(found.to_mapping(), camera, lambda: None)
    np.testing.assert_array_equal(again.original_from_refined(points), original)
    assert not isinstance(again, TerrainMap)
    twice = {"kind": "jittered", "steady": found.to_mapping(), "jitter": jitter.to_mapping()}
    with pytest.raises(Misfit, match="twice"):
        map_from_mapping(twice, camera, lambda: None)
