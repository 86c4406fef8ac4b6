"""Numpy's own sampling against scipy and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.geometry.interpolation import upsample_grid
from repm_qgis.imagery.sampling import box_mean, sample

NUMBERS = np.random.default_rng(11)


def test_sample_is_scipys_bilinear():
    image = NUMBERS.normal(size=(40, 50))
    cols, rows = NUMBERS.uniform(0, 49, 500), NUMBERS.uniform(0, 39, 500)
    expected = ndimage.map_coordinates(image, [rows, cols], order=1)
    np.testing.assert_allclose(sample(image, cols, rows), expected, atol=1e-12)
    np.testing.assert_array_equal(
        sample(image, np.array([0.0, 49.0, 49.0]), np.array([0.0, 0.0, 39.0])),
        [image[0, 0], image[0, 49], image[39, 49]],
    )


def test_sample_outside_and_beside_gaps_is_nan():
    image = NUMBERS.normal(size=(10, 10))
    image[5, 5] = np.nan
    assert np.isnan(sample(image, np.array([-0.01, 9.01, 3.0, np.nan]), np.array([3.0, 3.0, 9.5, 3.0]))).all()
    assert np.isnan(sample(image, np.array([4.5, 5.0, 5.9]), np.array([5.0, 5.0, 4.1]))).all()
    assert np.isfinite(sample(image, np.array([3.9, 6.1]), np.array([5.0, 6.5]))).all()


@pytest.mark.parametrize("shape", ((1, 1), (1, 5), (5, 1)))
def test_sample_of_thin_images(shape):
    image = NUMBERS.normal(size=shape)
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    np.testing.assert_allclose(sample(image, cols.ravel().astype(float), rows.ravel().astype(float)), image.ravel())


@pytest.mark.parametrize("radius", (1, 3, 30))
def test_box_mean_is_the_mean_of_the_box(radius):
    values = NUMBERS.normal(size=(17, 23))
    found = box_mean(values, radius)
    for row in range(17):
        for col in range(23):
            part = values[max(row - radius, 0) : row + radius + 1, max(col - radius, 0) : col + radius + 1]
            assert found[row, col] == pytest.approx(part.mean(), abs=1e-12)


@pytest.mark.parametrize("shape", ((2, 2), (9, 5), (31, 64)))
def test_upsampling_is_bilinear_with_corners_on_corners(shape):
    grid = NUMBERS.normal(size=(4, 6, 2))
    rows, cols = np.meshgrid(np.linspace(0, 3, shape[0]), np.linspace(0, 5, shape[1]), indexing="ij")
    found = upsample_grid(grid, shape)
    for band in range(2):
        np.testing.assert_allclose(
            found[..., band], ndimage.map_coordinates(grid[..., band], [rows, cols], order=1), atol=1e-12
        )
    np.testing.assert_allclose(upsample_grid(grid[..., 0], shape), found[..., 0])
