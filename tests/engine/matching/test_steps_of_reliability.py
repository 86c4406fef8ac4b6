"""The steps of the reliability mask, pixel by pixel against their definitions, and its limits from both sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.matching import reliability
from repm_qgis.matching.disparity_map import DisparityMap
from repm_qgis.matching.parameters import MATCHING
from repm_qgis.matching.reliability import mask_unreliable

LOW, HIGH = -3, 4
NUMBERS = MATCHING.reliability


def masks(*shares, shape=(25, 31), seed=0):
    numbers = np.random.default_rng(seed)
    return [numbers.uniform(size=shape) < share for share in shares]


def test_a_fill_loses_its_reason_with_the_next_match_to_either_side():
    matches, drawn = masks(0.3, 0.4)
    matches[3] = False
    removed = matches & drawn
    expected = np.zeros(matches.shape, bool)
    for row, column in np.ndindex(matches.shape):
        before = [c for c in range(column, -1, -1) if matches[row, c]][:1]
        after = [c for c in range(column, matches.shape[1]) if matches[row, c]][:1]
        expected[row, column] = any(removed[row, c] for c in before + after)
    np.testing.assert_array_equal(reliability._next_to_removed(matches, removed), expected)


def test_what_the_second_image_can_show():
    there, other = masks(0.9, 0.1)
    wide = np.pad(other, ((0, 0), (0, HIGH - LOW)), constant_values=False)
    wide[5, -2:] = True
    first, second = (np.where(known, 0.5, np.nan).astype(np.float32) for known in (there, wide))
    expected = np.zeros(there.shape, bool)
    for row, column in np.ndindex(there.shape):
        places = [column - d + HIGH for d in range(LOW, HIGH + 1)]
        expected[row, column] = there[row, column] and any(wide[row, place] for place in places)
    np.testing.assert_array_equal(reliability.shown_twice(first, second, (LOW, HIGH)), expected)
    assert 0.2 < expected.mean() < 0.8


@pytest.mark.parametrize("pixels", (0, 1, 4))
def test_growing_follows_what_is_connected(pixels):
    seed, into = masks(0.02, 0.45, seed=3)
    expected = seed
    if pixels:
        expected = ndimage.binary_dilation(seed, np.ones((3, 3)), iterations=pixels, mask=seed | into)
    np.testing.assert_array_equal(reliability._grown(seed, into, pixels), expected)


def test_a_slope_does_not_scatter_and_noise_does():
    rows, columns = np.indices((120, 130))
    inside = np.ones(rows.shape, bool)
    inside[:, 90:] = False
    slope = (0.1 * columns - 0.05 * rows).astype(np.float32)
    middle = np.s_[25:-25, 25:60]
    assert reliability._scatter(slope, inside, NUMBERS)[middle].max() < 1e-3
    noise = slope + np.random.default_rng(1).normal(0, 2.0, rows.shape).astype(np.float32)
    found = reliability._scatter(noise, inside, NUMBERS)
    half = NUMBERS.scatter_window_px // 2
    for row, column in ((60, 40), (50, 80), (60, 89)):
        window = np.s_[row - half : row + half + 1, column - half : min(column + half + 1, 90)]
        assert found[row, column] == pytest.approx(abs(noise[row, column] - noise[window].mean()), abs=1e-3)
    assert not found[:, 90:].any()


# --- limits of clouds -----------------------------------------------------------------------------------------------

SHAPE = (240, 260)


def texture(seed=0):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), 1.0)
    return 0.4 + 0.05 * noise / noise.std()


def cloud(rise=10.0, metres=10.0, side=80, bright=0.85, sign=1.0, ground=None, hidden=None, top=70):
    """Share of a cloud's inside that stays, and of the ground far from it: a plateau of so many px, perfectly matched.

    ``ground``: columns of the surroundings that are as high as the cloud; ``hidden``: surroundings without a height.
    """
    rows, columns = np.indices(SHAPE)
    inside = (rows >= top) & (rows < top + side) & (columns >= 90) & (columns < 90 + side)
    first = np.where(inside, texture() - 0.4 + bright, texture()).astype(np.float32)
    disparity = np.where(inside, sign * rise, 0.0).astype(np.float32)
    if ground is not None:
        disparity[ground & ~ndimage.binary_dilation(inside, iterations=3)] = sign * rise
    if hidden is not None:
        disparity[hidden & ~inside] = np.nan
    known = np.isfinite(disparity)
    height = disparity * np.float32(sign * metres)
    gone = reliability._clouds(height, first, known, 2.0 * metres, NUMBERS)
    return gone[ndimage.binary_erosion(inside, iterations=4)].mean(), gone[:20, :20].mean()


def test_clouds_are_high_bright_and_large():
    assert cloud() == (1.0, 0.0)
    assert cloud(metres=8.1) == (1.0, 0.0) and cloud(metres=7.9) == (0.0, 0.0)  # 80 m
    assert cloud(side=66) == (1.0, 0.0) and cloud(side=62) == (0.0, 0.0)  # 4000 px, without the rim that ends it
    assert cloud(bright=0.7) == (1.0, 0.0) and cloud(bright=0.5) == (0.0, 0.0)
    assert cloud(top=0) == (1.0, 0.0)  # at the image's border


def test_a_clouds_surroundings_lie_below_it_nearly_all_around():
    rows, columns = np.indices(SHAPE)
    assert cloud(ground=columns < 75)[0] == 1.0  # a little of the left
    assert cloud(ground=columns < 90)[0] == 0.0 and cloud(ground=(columns < 90) | (columns > 170))[0] == 0.0
    assert cloud(hidden=(rows < 70) | (columns > 170))[0] == 1.0
    assert cloud(hidden=(rows < 70) | (columns > 170) | (columns < 90) | (rows > 165))[0] == 0.0  # no evidence


def test_a_cloud_goes_with_its_rim_and_the_ground_stays():
    first = texture().astype(np.float32)
    second = np.full((SHAPE[0], SHAPE[1] + 40), 0.4, np.float32)
    inside = np.zeros(SHAPE, bool)
    inside[70:150, 90:170] = True
    first[inside] += 0.45
    disparity = np.where(inside, np.float32(-15), np.float32(0))
    columns = np.indices(SHAPE)[1]
    target = (columns - disparity + 20).astype(int)
    rows = np.indices(SHAPE)[0]
    second[rows, target] = first
    second[rows[inside], target[inside]] = first[inside]
    matched = DisparityMap(disparity, np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool))
    matched.filled[90:100, 30:90] = True  # a fill that leads farther than the surroundings of the cloud
    for sign, gone in ((-1.0, True), (1.0, False)):  # lower disparities are higher ground, or a deep hole
        left = mask_unreliable(matched, first, second, disparities=(-20, 20), height_sign=sign, metres_per_px=10.0)
        assert np.isnan(left.disparity[inside]).all() == gone
        assert np.isfinite(left.disparity[:60]).all() and np.isfinite(left.disparity[:, 210:]).all()
        assert (np.isnan(left.disparity) <= np.isnan(left.score)).all() or not gone
        assert not (left.filled & np.isnan(left.disparity)).any()
        assert np.isnan(left.disparity[90:100, 30:90]).all() == gone
    strict = replace(NUMBERS, cloud_m=149.0)
    left = mask_unreliable(
        matched, first, second, disparities=(-20, 20), height_sign=-1.0, metres_per_px=10.0, parameters=strict
    )
    assert np.isnan(left.disparity[inside]).all()
    left = mask_unreliable(
        matched,
        first,
        second,
        disparities=(-20, 20),
        height_sign=-1.0,
        metres_per_px=10.0,
        parameters=replace(NUMBERS, cloud_m=151.0),
    )
    assert np.isfinite(left.disparity[inside]).all()


# --- limits of what has no support ----------------------------------------------------------------------------------


def unsupported(side, wobble=3.0, numbers=NUMBERS):
    """Share of a square of noise that stays: correlations 0 in it and 1 around it."""
    inside = np.zeros(SHAPE, bool)
    inside[40 : 40 + side, 40 : 40 + side] = True
    score = np.where(inside, np.float32(0), np.float32(1))
    patches = ndimage.gaussian_filter(np.random.default_rng(2).normal(size=SHAPE), 4)
    disparity = np.where(inside, wobble * patches / patches.std(), 0.0).astype(np.float32)
    matched = DisparityMap(disparity, score, np.zeros(SHAPE, bool))
    everywhere = np.ones(SHAPE, bool)
    gone = reliability._unsupported(matched, score, everywhere, everywhere, numbers)
    return 1 - gone[inside].mean(), 1 - gone[~ndimage.binary_dilation(inside, iterations=12)].mean()


def test_what_has_no_support_goes_if_it_is_large_and_scatters():
    assert unsupported(100)[0] < 0.02 and unsupported(100)[1] == 1.0
    assert unsupported(100, wobble=0.3) == (1.0, 1.0)  # even, as a roof
    assert unsupported(50) == (1.0, 1.0)  # 2500 px
    assert unsupported(100, wobble=0.3, numbers=replace(NUMBERS, endless_px=9000))[0] < 0.02
    assert unsupported(100, wobble=0.3, numbers=replace(NUMBERS, endless_px=15000))[0] == 1.0
    assert unsupported(100, numbers=replace(NUMBERS, least_px=15000))[0] == 1.0
    assert unsupported(100, numbers=replace(NUMBERS, scatter_share=0.99))[0] == 1.0


def test_occlusions_need_no_support():
    """Of a large square three quarters are filled, in stripes: what was to be matched between them matches well."""
    filled = np.zeros(SHAPE, bool)
    filled[40:200, 40:200] = np.arange(160) % 20 < 15
    score = np.where(filled, np.float32(0), np.float32(1))
    matched = DisparityMap(np.zeros(SHAPE, np.float32), score, filled)
    everywhere = np.ones(SHAPE, bool)
    assert not reliability._unsupported(matched, score, ~filled, everywhere, NUMBERS).any()
    unfilled = DisparityMap(matched.disparity, score, np.zeros(SHAPE, bool))
    assert reliability._unsupported(unfilled, score, ~filled, everywhere, NUMBERS)[50:190, 50:190].all()


def test_the_shore_goes_too():
    """Windows of 5 px beside the square: the first pixel has support 0.6, the second 0.8, which is enough."""
    score = np.ones(SHAPE, np.float32)
    score[40:140, 40:140] = 0
    patches = ndimage.gaussian_filter(np.random.default_rng(2).normal(size=SHAPE), 4)
    matched = DisparityMap((3 * patches / patches.std()).astype(np.float32), score, np.zeros(SHAPE, bool))
    everywhere = np.ones(SHAPE, bool)
    gone = reliability._unsupported(matched, score, everywhere, everywhere, NUMBERS)
    assert gone[39:141, 60:120].all() and not gone[:38, 60:120].any() and not gone[142:, 60:120].any()


def whole_pair(disparity, first):
    """A second image for a whole disparity between -20 and 20; the higher surface hides the other."""
    second = np.full((SHAPE[0], SHAPE[1] + 40), 0.4, np.float32)
    rows, columns = np.indices(SHAPE)
    order = np.argsort(disparity, axis=None, kind="stable")
    target = (columns - disparity + 20).astype(int)
    second[rows.ravel()[order], target.ravel()[order]] = first.ravel()[order]
    return second


def test_pixels_without_a_match_have_no_support():
    """Where only every fourth pixel was matched, well, the share of good matches is a quarter."""
    first = texture().astype(np.float32)
    disparity = np.zeros(SHAPE, np.float32)
    disparity[40:200:2, 40:200] = disparity[40:200, 40:200:2] = np.nan
    matched = DisparityMap(disparity, np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool))
    left = mask_unreliable(
        matched, first, whole_pair(np.zeros(SHAPE), first), disparities=(-20, 20), height_sign=1.0, metres_per_px=1.0
    )
    assert np.isnan(left.disparity[50:190, 50:190]).all() and np.isfinite(left.disparity[:30]).all()


def test_an_island_in_water_is_no_cloud():
    """Water has heights that nothing supports: they say nothing about how high the island is."""
    rows, columns = np.indices(SHAPE)
    island = (rows >= 80) & (rows < 150) & (columns >= 100) & (columns < 170)
    first = np.where(island, texture() + 0.45, 0.1).astype(np.float32)
    disparity = np.where(island, np.float32(15), np.float32(0))
    second = whole_pair(disparity, first)
    second[second < 0.3] = 0.1
    noise = np.random.default_rng(3)
    first, second = (image + noise.normal(0, 0.004, image.shape).astype(np.float32) for image in (first, second))
    matched = DisparityMap(disparity, np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool))
    left = mask_unreliable(matched, first, second, disparities=(-20, 20), height_sign=1.0, metres_per_px=10.0)
    assert np.isfinite(left.disparity[90:140, 110:160]).all() and np.isnan(left.disparity[:60, :80]).all()
