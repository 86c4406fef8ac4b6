"""A step on the intensities against the theory of its size, and the filters against their definitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.matching.parameters import MATCHING
from repm_qgis.matching.subpixel import known_median, subpixel_disparity

NUMBERS = MATCHING.subpixel
HIGH = 6
INNER = np.s_[12:-12, 20:-20]


def images(shift, shape=(120, 160), noise=0.0, contrast=0.05):
    """First and second image of one disparity everywhere, each with noise of its own."""
    rng = np.random.default_rng(8)
    wide = ndimage.gaussian_filter(rng.normal(size=(shape[0], shape[1] + 2 * HIGH)), 1.5)
    wide = 0.5 + contrast * wide / wide.std()
    rows, columns = np.indices(shape).astype(float)
    first = ndimage.map_coordinates(wide, [rows, columns - shift + HIGH], order=5)
    return tuple((image + rng.normal(0, noise, image.shape)).astype(np.float32) for image in (first, wide))


def after(operations, start, first, second, **changes):
    return subpixel_disparity(start, first, second, HIGH, replace(NUMBERS, operations=operations, **changes))


@pytest.mark.parametrize("off", (-0.2, -0.1, 0.1, 0.25))
def test_one_step_on_clean_images_goes_most_of_the_way_and_three_all_of_it(off):
    """OpenCV's cubic is up to half as steep again as the central differences: a first step may go too far."""
    first, second = images(2.0)
    start = np.full(first.shape, 2.0 + off, np.float32)
    assert np.abs(after(("step",), start, first, second) - 2.0)[INNER].mean() < 0.5 * abs(off)
    assert np.abs(after(("step",) * 3, start, first, second) - 2.0)[INNER].mean() < 0.015


@pytest.mark.parametrize("off", (-1.0, 1.0))
def test_no_step_is_longer_than_it_may_be(off):
    first, second = images(2.0)
    start = np.full(first.shape, 2.0 + off, np.float32)
    moved = (after(("step",), start, first, second) - start)[INNER]
    assert np.abs(moved).max() == pytest.approx(NUMBERS.most_step_px, abs=1e-6)
    assert np.median(moved) == pytest.approx(-np.sign(off) * NUMBERS.most_step_px, abs=1e-6)


def test_brightness_of_one_image_alone_changes_nothing():
    first, second = images(2.0)
    start = np.full(first.shape, 2.1, np.float32)
    brighter = after(("step",), start, first, second + np.float32(0.2))
    np.testing.assert_allclose(brighter[INNER], after(("step",), start, first, second)[INNER], atol=2e-3)


def test_unknown_disparities_do_not_disturb_their_neighbours():
    """Their pixels are matched to nothing; the images differ in brightness, so that this is far from no difference."""
    first, second = images(2.0)
    start = np.full(first.shape, 2.1, np.float32)
    start[50:70, 70:90] = np.nan
    found = after(("step",) * 4, start, first, second + np.float32(0.2))
    np.testing.assert_array_equal(np.isnan(found), np.isnan(start))
    assert np.nanmax(np.abs(found[45:75, 65:95] - 2.0)) < 0.05


@pytest.mark.parametrize("noise", (0.01, 0.02))
@pytest.mark.parametrize("steps", (1, 4))
def test_noise_shortens_steps_as_the_two_variances_say(steps, noise):
    """By the share g^2 / (h^2 + steps s^2 / (n prior^2)): s^2 is the variance of the difference of intensity, and
    n = 4 pi sigma^2 pixels have the mean square gradients g^2, and h^2 with the noise. All steps share the prior."""
    off, shape = 0.3, (240, 320)
    first, second = images(2.0, shape, noise)
    signal, power = (np.gradient(image, axis=1).var() for image in (images(2.0, shape)[1], second))
    variance, pixels = 2 * noise**2 + off**2 * signal, 4 * np.pi * NUMBERS.sigma_px**2
    share = signal / (power + steps * variance / (pixels * NUMBERS.prior_px**2))
    start = np.full(shape, 2.0 + off, np.float32)
    left = (after(("step",) * steps, start, first, second, most_step_px=10.0) - 2.0)[INNER].mean() / off
    assert left == pytest.approx((1 - share) ** steps, abs=0.04 if steps == 1 else 0.08)


def test_the_median_is_that_of_the_window():
    image = np.random.default_rng(2).normal(size=(30, 40)).astype(np.float32)
    for side in (3, 5):
        inner = np.s_[side:-side, side:-side]
        np.testing.assert_array_equal(known_median(image, side)[inner], ndimage.median_filter(image, side)[inner])


def test_unknown_pixels_stay_so_and_lonely_ones_keep_their_own():
    image = np.full((20, 20), np.nan, np.float32)
    image[4, 4], image[10:17, 8:15] = 3.0, 5.0
    image[13, 11], image[12, 10] = 50.0, np.nan
    found = known_median(image, 5)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(image))
    assert found[4, 4] == 3.0 and found[13, 11] == 5.0 and np.nanmax(found) == 5.0


@pytest.mark.parametrize("away, stays", ((0.65, False), (0.75, True), (-0.65, False), (-0.75, True)))
def test_the_median_moves_nothing_as_far_as_an_edge(away, stays):
    first, second = images(2.0)
    start = np.full(first.shape, 2.0, np.float32)
    start[50, 60] += away
    found = after(("median",), start, first, second)
    assert (found[50, 60] == start[50, 60]) == stays
    found[50, 60] = start[50, 60]
    np.testing.assert_array_equal(found, start)


def test_the_mean_is_the_bilateral_one_of_what_is_known():
    """Tomasi and Manduchi, in a disc of the window's diameter; OpenCV reads the weights from a table."""
    numbers = np.random.default_rng(5)
    image = (np.where(np.arange(30) < 14, 3.0, 5.0) + numbers.normal(0, 0.3, (24, 30))).astype(np.float32)
    image[numbers.uniform(size=image.shape) < 0.15] = np.nan
    found = after(("mean",), image, *images(3.0, image.shape))
    np.testing.assert_array_equal(np.isnan(found), np.isnan(image))
    radius, space, alike = NUMBERS.smooth_window_px // 2, NUMBERS.smooth_sigma_px, NUMBERS.alike_sigma_px
    for row, column in np.argwhere(np.isfinite(image)):
        if not (radius <= row < 24 - radius and radius <= column < 30 - radius):
            continue
        total = weights = 0.0
        for i in range(-radius, radius + 1):
            for j in range(-radius, radius + 1):
                value = image[row + i, column + j]
                if i * i + j * j <= radius * radius and np.isfinite(value):
                    away = value - image[row, column]
                    weight = np.exp(-(i * i + j * j) / (2 * space**2) - away**2 / (2 * alike**2))
                    total, weights = total + weight * value, weights + weight
        assert found[row, column] == pytest.approx(total / weights, abs=2e-3)
