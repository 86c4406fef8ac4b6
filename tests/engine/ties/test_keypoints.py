"""Keypoints lie where they are, by the middles of known spots and by COLMAP's SIFT, which is other code (VLFeat's)."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.ties.keypoints import detect
from repm_qgis.ties.parameters import TIES
from tests.engine.versions import needs_pycolmap_4


def blobs(places, size=128, sigma=4.0):
    rows, cols = np.indices((size, size))
    return (30 + sum(150 * np.exp(-((cols - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2)) for x, y in places)).astype(
        np.uint8
    )


@pytest.fixture(scope="module")
def grey(urban):
    pixels = gdal.Open(urban.images[0]).ReadAsArray()
    return (view_stretch(urban.images[0], 1).apply(pixels.astype(np.float32)) * 255).astype(np.uint8)


def test_blobs_are_found_at_their_middles():
    places = np.array([(x, y) for x in (26.25, 63.0, 101.75) for y in (25.0, 64.25, 100.5)])
    found = detect(blobs(places), np.ones((128, 128), np.uint8), 200)
    away = np.linalg.norm(found.points[None] - places[:, None], axis=2).min(axis=1)
    assert np.median(away) < 0.05 and away.max() < 0.25


def test_keypoints_of_an_image(grey):
    mask = np.zeros(grey.shape, np.uint8)
    mask[50:300, 100:350] = 1
    found = detect(grey, mask, 2000)
    assert len(found.points) == len(found.descriptors) > 100
    assert (found.points > (99, 49)).all() and (found.points < (350, 300)).all()
    assert found.descriptors.shape[1] == 128 and found.descriptors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1, atol=1e-3)
    assert len(np.unique(found.points, axis=0)) == len(found.points)
    again = detect(grey, mask, 2000)
    np.testing.assert_array_equal(found.points, again.points)
    np.testing.assert_array_equal(found.descriptors, again.descriptors)


def of_colmap(grey):
    """(N, 2) places of COLMAP's SIFT on the CPU; the centre of its first pixel is (0.5, 0.5)."""
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = 1, False
    options.sift.octave_resolution = TIES.keypoints.layers
    options.sift.peak_threshold = TIES.keypoints.contrast / TIES.keypoints.layers
    found, _ = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu).extract_from_uint8_array(grey)
    return np.array([(k.x, k.y) for k in found]) - 0.5


@needs_pycolmap_4
@pytest.mark.long
def test_colmap_finds_the_same_places(grey):
    ours, theirs = detect(grey, np.ones(grey.shape, np.uint8), 4000).points, of_colmap(grey)
    offset = theirs[:, None] - ours[None]
    away = np.linalg.norm(offset, axis=2)
    nearest = offset[away.argmin(axis=0), np.arange(len(ours))]
    close = nearest[np.linalg.norm(nearest, axis=1) < 0.35]
    assert len(close) > 0.95 * len(ours)
    assert np.abs(np.median(close, axis=0)).max() < 0.02


def test_an_empty_image_has_no_keypoints():
    found = detect(np.full((64, 64), 90, np.uint8), np.ones((64, 64), np.uint8), 100)
    assert found.points.shape == (0, 2) and found.descriptors.shape[0] == 0


def test_only_what_is_chosen_gets_the_descriptors_it_has_among_all(grey):
    mask = np.ones(grey.shape, np.uint8)
    whole = detect(grey, mask, 2000)
    part = detect(grey, mask, 2000, choose=lambda points, strength: np.flatnonzero(strength > 0)[::3])
    np.testing.assert_array_equal(part.points, whole.points[::3])
    np.testing.assert_array_equal(part.descriptors, whole.descriptors[::3])
