"""Subpixel disparities on made-up pairs whose disparities are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.matching.parameters import MATCHING
from repm_qgis.matching.subpixel import subpixel_disparity

HEIGHT, WIDTH, HIGH = 160, 200, 12
INNER = np.s_[12:-12, 24:-24]
SMOOTHING = replace(MATCHING.subpixel, operations=("median", "mean"))


def pair_of(disparity, contrast=0.02, noise=0.003, seed=0):
    """Both images, about as in mountains at noon: the first shows at a column what the second has at its match."""
    rng = np.random.default_rng(seed)
    texture = ndimage.gaussian_filter(rng.normal(size=(HEIGHT, WIDTH + 2 * HIGH)), 1.0)
    texture = 0.5 + contrast * texture / texture.std()
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    first = ndimage.map_coordinates(texture, [rows, columns - disparity + HIGH], order=5)
    return tuple((image + rng.normal(0, noise, image.shape)).astype(np.float32) for image in (first, texture))


def hills(length, height=0.4):
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return 3.0 + height * np.sin(2 * np.pi * columns / length) * np.cos(2 * np.pi * rows / length)


def rms(found, truth):
    return float(np.sqrt(np.mean((found - truth)[INNER] ** 2)))


def test_weak_texture_is_sharpened_as_far_as_its_noise_allows():
    """A window of 18 px tells a disparity to noise / (gradient sqrt 18); smoothing makes it better, relief worse."""
    truth = hills(24.0)
    first, second = pair_of(truth)
    gradient = np.gradient(second, axis=1).std()
    bound = 0.003 * np.sqrt(2) / (gradient * np.sqrt(18))
    found = subpixel_disparity(np.rint(truth).astype(np.float32), first, second, HIGH)
    assert rms(np.rint(truth), truth) > 0.19
    assert rms(found, truth) < 1.5 * bound + 0.03


@pytest.mark.parametrize("factor", (0.5, 4.0))
def test_contrast_alone_changes_nothing(factor):
    """The noise decides what texture is worth, not how bright or contrasty an image is stretched."""
    truth = hills(30.0)
    first, second = pair_of(truth)
    start = np.rint(truth).astype(np.float32)
    other = subpixel_disparity(
        start, *(np.float32(0.5) + np.float32(factor) * (image - np.float32(0.5)) for image in (first, second)), HIGH
    )
    assert np.abs(other - subpixel_disparity(start, first, second, HIGH))[INNER].max() < 0.02


def test_relief_that_smoothing_takes_away_comes_back():
    """Smoothing would cost the very truth more than is left of it where the images tell it."""
    truth = hills(14.0)
    first, second = pair_of(truth, contrast=0.1)
    assert rms(subpixel_disparity(truth.astype(np.float32), first, second, HIGH, SMOOTHING), truth) > 0.1
    start = ndimage.gaussian_filter(truth, 2.0).astype(np.float32)
    assert rms(subpixel_disparity(start, first, second, HIGH), truth) < 0.08


def test_noise_without_texture_moves_nothing_far():
    truth = np.full((HEIGHT, WIDTH), 3.0)
    first, second = pair_of(truth, contrast=1e-6)
    assert rms(subpixel_disparity(truth.astype(np.float32), first, second, HIGH), truth) < 0.1


def test_steps_stay_where_they_are():
    truth = np.where(np.arange(WIDTH) < 100, 2.25, 8.25) * np.ones((HEIGHT, 1))
    first, second = pair_of(truth)
    found = subpixel_disparity(truth.astype(np.float32), first, second, HIGH)
    assert np.abs(found - truth)[INNER].max() < 0.5


def test_what_is_unknown_stays_so_and_counts_for_nothing():
    truth = hills(24.0)
    first, second = pair_of(truth)
    start = np.rint(truth).astype(np.float32)
    start[60:90, 80:120] = np.nan
    first[60:90, 80:120] = np.nan
    found = subpixel_disparity(start, first, second, HIGH)
    assert (np.isnan(found) == np.isnan(start)).all()
    around = np.s_[50:100, 70:130]
    whole = subpixel_disparity(np.rint(truth).astype(np.float32), *pair_of(truth), HIGH)
    error, without = np.abs(found - truth)[around], np.abs(whole - truth)[around]
    assert np.nanpercentile(error, 95) < np.percentile(without, 95) + 0.03
    nothing = subpixel_disparity(np.full_like(start, np.nan), first, second, HIGH)
    assert np.isnan(nothing).all()
