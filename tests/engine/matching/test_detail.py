"""Detail that is no more than noise goes, relief and edges stay; and what the images say of the noise is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.matching.detail import tail, without_noise
from repm_qgis.matching.parameters import MATCHING
from repm_qgis.matching.subpixel import _Step, subpixel_disparity

NUMBERS = MATCHING.subpixel
WHOLE = replace(NUMBERS, detail=replace(NUMBERS.detail, noise_share=1.0))  # no filter has been there before
SHAPE, HIGH = (200, 240), 6
INNER = np.s_[20:-20, 24:-24]
WINDOW_PX = 1.44  # variance of the Gaussian window of the noise below


def noisy(surface, deviation, seed=3):
    """A surface with noise of this standard deviation, white noise after a Gaussian window; and its variance."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=surface.shape), np.sqrt(WINDOW_PX))
    noise *= deviation / noise.std()
    return (surface + noise).astype(np.float32), np.full(surface.shape, deviation**2, np.float32)


def rms(found, truth):
    return float(np.sqrt(np.nanmean((found - truth)[INNER] ** 2)))


@pytest.mark.parametrize("deviation", (0.05, 0.15))
def test_a_plain_roof_becomes_plain_and_its_edges_stay(deviation):
    roof = np.where(np.indices(SHAPE)[1] < 120, 2.0, 6.0)
    start, variance = noisy(roof, deviation)
    found = without_noise(start, variance, WINDOW_PX, WHOLE)
    assert rms(found, roof) < 0.4 * deviation
    assert np.abs(found - roof)[40:160, 116:124].max() < 3 * deviation


def test_a_slope_stays_a_slope():
    rows, columns = np.indices(SHAPE)
    slope = 1.0 + 0.05 * columns - 0.03 * rows
    start, variance = noisy(slope, 0.1)
    assert rms(without_noise(start, variance, WINDOW_PX, WHOLE), slope) < 0.06


@pytest.mark.parametrize("length", (12.0, 24.0, 48.0))
def test_relief_that_is_more_than_its_noise_stays(length):
    rows, columns = np.indices(SHAPE)
    relief = 3.0 + 0.25 * np.sin(2 * np.pi * columns / length) * np.cos(2 * np.pi * rows / length)
    start, variance = noisy(relief, 0.03)
    assert rms(without_noise(start, variance, WINDOW_PX, WHOLE), relief) < 0.035
    # The very same relief is removed where the images cannot tell it from noise.
    told = without_noise(start, np.full(SHAPE, 4.0, np.float32), WINDOW_PX, WHOLE)
    assert rms(told, relief) > 0.06


def test_unknown_disparities_stay_unknown_and_touch_nobody():
    level = np.full(SHAPE, 2.0)
    start, variance = noisy(level, 0.1)
    start[60:90, 100:130] = np.nan
    found = without_noise(start, variance, WINDOW_PX, WHOLE)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(start))
    assert rms(found, level) < 0.05 and np.nanmax(np.abs(found[55:95, 95:135] - 2.0)) < 0.3
    nothing = np.full(SHAPE, np.nan, np.float32)
    assert np.isnan(without_noise(nothing, variance, WINDOW_PX, WHOLE)).all()


def images(noise_sigma_px, noise=0.01, seed=8):
    """Both images of a level ground at two px, each with noise of its own, which is alike over some pixels."""
    rng = np.random.default_rng(seed)
    wide = ndimage.gaussian_filter(rng.normal(size=(SHAPE[0], SHAPE[1] + 2 * HIGH)), 1.5)
    wide = 0.5 + 0.05 * wide / wide.std()
    rows, columns = np.indices(SHAPE).astype(float)
    first = ndimage.map_coordinates(wide, [rows, columns - 2.0 + HIGH], order=5)

    def own(image):
        more = rng.normal(size=image.shape)
        more = ndimage.gaussian_filter(more, noise_sigma_px) if noise_sigma_px else more
        return (image + noise * more / more.std()).astype(np.float32)

    return own(first), own(wide)


@pytest.mark.parametrize("noise_sigma_px, least, most", ((0.0, 1.0, 1.6), (0.7, 2.0, 6.0)))
def test_how_far_noise_is_alike_shows_in_the_images(noise_sigma_px, least, most):
    """White noise has one pixel (resampling makes it a little more); a Gaussian window of 0.7 px 4 pi 0.7^2 = 6."""
    start = np.full(SHAPE, 2.0, np.float32)
    step = _Step(*images(noise_sigma_px), HIGH, np.ones(SHAPE, bool), NUMBERS)
    alike = step.noise(start)[1] / NUMBERS.sigma_px**2
    assert least <= alike <= most


@pytest.mark.parametrize("noise_sigma_px", (0.0, 0.7))
def test_the_variance_is_that_of_what_steps_find(noise_sigma_px):
    """Steps without a prior and without filters, so that the images alone decide."""
    numbers = replace(NUMBERS, operations=("step",) * 6, prior_px=10.0)
    first, second = images(noise_sigma_px)
    start = np.full(SHAPE, 2.0, np.float32)
    found = subpixel_disparity(start, first, second, HIGH, numbers)
    variance, _ = _Step(first, second, HIGH, np.ones(SHAPE, bool), numbers).noise(found)
    # Over the median of chi-square with one degree of freedom. Noise in the slopes is taken for texture: up to 3.
    ratio = np.median(((found - 2.0) ** 2 / variance)[INNER]) / 0.4549
    assert 0.4 < ratio < 3.0


def test_the_last_operation_removes_more_than_means_do():
    start, roof = np.full(SHAPE, 2.2, np.float32), 2.0
    first, second = images(0.7, noise=0.02)
    means = replace(NUMBERS, operations=(*NUMBERS.operations[:-1], "mean"))
    found, before = (subpixel_disparity(start, first, second, HIGH, numbers) for numbers in (NUMBERS, means))
    assert NUMBERS.operations[-1] == "detail"
    assert rms(found, roof) < 0.8 * rms(before, roof)


def roofs():
    """Ground of two px of disparity, with houses of six."""
    rows, columns = np.indices(SHAPE)
    return np.where((rows % 60 > 25) & (columns % 70 > 30), 6.0, 2.0)


def relief(seed=5):
    """Natural relief: its amplitude falls with the square of the frequency."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SHAPE[1]), np.fft.fftfreq(SHAPE[0])))
    frequency[0, 0] = np.inf
    surface = np.fft.ifft2(np.fft.fft2(rng.normal(size=SHAPE)) / frequency**2).real
    return 3.0 + 1.5 * surface / surface.std()


def test_a_town_has_its_detail_at_its_walls_and_natural_ground_everywhere():
    most = NUMBERS.planes.least_tail
    assert tail(noisy(roofs(), 0.1)[0], NUMBERS) > 1.5 * most
    assert tail(noisy(relief(), 0.1)[0], NUMBERS) < 0.7 * most
    assert tail(noisy(np.full(SHAPE, 2.0), 0.1)[0], NUMBERS) < 0.5 * most
    assert tail(np.full(SHAPE, np.nan, np.float32), NUMBERS) == 1.0


def test_only_narrow_pairs_are_made_of_planes():
    narrow, wide = NUMBERS.of_pair(0.13), NUMBERS.of_pair(0.25)
    assert wide == NUMBERS
    assert narrow.operations == (*NUMBERS.operations[:-1], "planes")


def seen(surface, noise, seed=8):
    """Two images of a surface of disparities, with texture of their own noise."""
    rng = np.random.default_rng(seed)
    wide = ndimage.gaussian_filter(rng.normal(size=(SHAPE[0], SHAPE[1] + 2 * HIGH)), 1.5)
    wide = 0.5 + 0.05 * wide / wide.std()
    rows, columns = np.indices(SHAPE).astype(float)
    first = ndimage.map_coordinates(wide, [rows, columns - surface + HIGH], order=5)
    return [
        (image + ndimage.gaussian_filter(noise * 3 * rng.normal(size=image.shape), 0.7)).astype(np.float32)
        for image in (first, wide)
    ]


def found_by(numbers, surface):
    start = (surface + 0.2 * np.random.default_rng(2).normal(size=SHAPE)).astype(np.float32)
    return subpixel_disparity(start, *seen(surface, 0.02), HIGH, numbers)


def test_a_narrow_pairs_roofs_become_plainer_and_keep_their_edges():
    true = roofs()
    one, two = (found_by(numbers, true) for numbers in (NUMBERS, NUMBERS.of_pair(0.1)))
    edge = ndimage.maximum_filter(true, 7) != ndimage.minimum_filter(true, 7)
    away, near = ~edge & np.isfinite(one), edge & np.isfinite(one)
    assert np.std((two - true)[away]) < 0.8 * np.std((one - true)[away])
    off = [np.mean(np.abs(found - true)[near] > 0.5) for found in (one, two)]
    assert off[1] <= off[0] + 0.01


def test_a_narrow_pairs_natural_ground_is_left_as_it_was():
    true = relief()
    one, two = (found_by(numbers, true) for numbers in (NUMBERS, NUMBERS.of_pair(0.1)))
    np.testing.assert_array_equal(one, two)
