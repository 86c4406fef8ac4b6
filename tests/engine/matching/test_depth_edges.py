"""Steps in height: where they lie after matching, what becomes of towers, and what fills the ground behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.matching.depth_edges import correct_depth_edges
from repm_qgis.matching.disparity_checks import speckle_filter
from repm_qgis.matching.disparity_map import match_score
from repm_qgis.matching.occlusions import fill_occlusions
from repm_qgis.matching.parameters import MATCHING
from repm_qgis.matching.sgm import match
from repm_qgis.matching.subpixel import subpixel_disparity

HEIGHT, WIDTH = 120, 160
LOW, HIGH = -8, 16
GROUND, ROOF = 1, 9


def smoothed(disparity):
    blank = np.zeros_like(disparity)
    return subpixel_disparity(disparity, blank, blank, 0, replace(MATCHING.subpixel, operations=("median", "mean")))


def texture(seed, level):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH + 80)), 0.8)
    return level + 0.04 * noise / noise.std()


def scene(*blocks):
    """First image, second image and the first's disparities: blocks (row, column, rows, columns) on a plain.

    The second image's column c shows the rectified column c - HIGH.
    """
    ground, roof = texture(1, 0.35), texture(2, 0.6)[:, 40 : 40 + WIDTH]
    first, truth = ground[:, 40 : 40 + WIDTH].copy(), np.full((HEIGHT, WIDTH), GROUND)
    columns = np.arange(WIDTH + HIGH - LOW) - HIGH
    second = ground[:, columns + GROUND + 40].copy()
    for row, column, rows, width in blocks:
        block = (slice(row, row + rows), slice(column, column + width))
        first[block] = roof[block]
        truth[block] = ROOF
        left = column - ROOF + HIGH
        second[row : row + rows, left : left + width] = roof[block]
    noise = np.random.default_rng(3)
    first, second = (
        np.clip(image + noise.normal(scale=0.01, size=image.shape), 0, 1).astype(np.float32)
        for image in (first, second)
    )
    return first, second, truth


@pytest.mark.parametrize("mirrored", (False, True))
def test_roofs_are_neither_fattened_nor_thinned_by_more_than_a_pixel(mirrored):
    first, second, truth = scene((30, 60, 50, 45), (50, 20, 14, 12))
    if mirrored:
        found = match(first[:, ::-1].copy(), second[:, ::-1].copy(), (-HIGH, -LOW), -1.0)
        disparity = -found.disparity[:, ::-1]
    else:
        disparity = match(first, second, (LOW, HIGH), 1.0).disparity
    roof = truth == ROOF
    with np.errstate(invalid="ignore"):
        upper = disparity > (ROOF + GROUND) / 2
    assert not (upper & ~ndimage.binary_dilation(roof, np.ones((3, 3)))).any()
    assert (upper & ~roof).sum() < 0.02 * roof.sum()
    assert upper[ndimage.binary_erosion(roof, np.ones((3, 3)))].mean() > 0.995


def test_the_ground_that_a_roof_hides_is_filled_with_the_ground():
    first, second, truth = scene((30, 60, 50, 45))
    found = match(first, second, (LOW, HIGH), 1.0)
    # The second image shows the roof 8 px farther left over the ground: that much of it is hidden on its left.
    hidden = (slice(33, 77), slice(60 - (ROOF - GROUND) + 1, 59))
    assert found.filled[hidden].mean() > 0.9
    assert (np.abs(found.disparity[hidden] - GROUND) < 0.5).mean() > 0.97


@pytest.mark.parametrize("row, column", ((40, 70), (41, 33), (77, 102)))
def test_towers_stay(row, column):
    """Five pixels wide and eight pixels of disparity high: two storeys higher than wide, at a base-to-height of 0.4."""
    first, second, truth = scene((row, column, 5, 5))
    disparity = match(first, second, (LOW, HIGH), 1.0).disparity
    assert (np.abs(disparity[row : row + 5, column : column + 5] - ROOF) < 1).sum() >= 20
    away = np.ones(disparity.shape, bool)
    away[row - 1 : row + 6, column - 1 : column + 6] = False
    with np.errstate(invalid="ignore"):
        assert not (away & (disparity > GROUND + 2)).any()


def without_speckles(disparity, first, second):
    sgm = MATCHING.sgm
    return speckle_filter(disparity, LOW, lambda of: match_score(first, second, of, HIGH, sgm.score_window_px), sgm)


def test_a_tower_of_four_pixels_that_was_matched_is_not_lost_again():
    first, second, truth = scene((40, 70, 4, 4))
    found = correct_depth_edges(truth.astype(np.float32), first, second, (-1.0, HIGH), 1.0)
    np.testing.assert_allclose(found, truth, atol=1e-3)
    alone = without_speckles(found, first, second)
    np.testing.assert_array_equal(alone, found)
    np.testing.assert_allclose(smoothed(alone), truth, atol=1e-2)


def test_small_pieces_that_match_badly_go():
    first, second, truth = scene()
    wrong = truth.astype(np.float32)
    wrong[40:46, 70:76] = ROOF
    kept = without_speckles(wrong, first, second)
    assert np.isnan(kept[40:46, 70:76]).mean() > 0.9 and np.isfinite(kept).sum() >= kept.size - 36


def test_steps_that_lie_wrong_are_moved_to_where_the_images_have_them():
    first, second, truth = scene((30, 60, 50, 45))
    roof = truth == ROOF
    wrong = np.where(ndimage.binary_dilation(roof, np.ones((3, 3)), iterations=4), ROOF, GROUND).astype(np.float32)
    wrong[10, 10] = np.nan
    found = correct_depth_edges(wrong, first, second, (-1.0, HIGH), 1.0)
    assert np.isnan(found[10, 10]) and np.isfinite(found).sum() == found.size - 1
    # Left of the roof the second image shows nothing of the ground, so there is nothing to go by.
    seen = np.ones(truth.shape, bool)
    seen[20:90, 45:60] = False
    before, after = ((np.abs(part - truth) > 1) & seen for part in (wrong, found))
    assert before.sum() > 500 and after.sum() < 0.05 * before.sum()
    assert not (after & ~ndimage.binary_dilation(roof, np.ones((3, 3)), iterations=1)).any()


def test_a_slope_is_left_alone():
    first, second, _ = scene()
    slope = np.repeat(np.linspace(0, 12, WIDTH, dtype=np.float32)[None], HEIGHT, axis=0)
    np.testing.assert_allclose(
        correct_depth_edges(slope, first, second, (-1.0, HIGH), 1.0)[:, 2:-2], slope[:, 2:-2], atol=1e-6
    )


def test_noise_goes_and_steps_stay():
    noise = np.random.default_rng(4).normal(scale=0.1, size=(60, 60)).astype(np.float32)
    step = np.where(np.arange(60) < 30, 2.0, 5.0).astype(np.float32)[None] + np.zeros((60, 1), np.float32)
    noisy = step + noise
    noisy[20:24, 10:14] = np.nan
    calm = smoothed(noisy)
    assert np.isnan(calm[20:24, 10:14]).all() and np.isfinite(calm).sum() == calm.size - 16
    assert np.nanstd(calm - step) < 0.04 and np.nanmax(np.abs(calm - step)) < 0.2
    assert np.isnan(smoothed(np.full((9, 9), np.nan, np.float32))).all()


def test_gaps_take_the_background():
    plain = np.full((40, 80), 3.0, np.float32)
    plain[10:30, 30:45] = 12.0
    surface = plain.copy()
    surface[10:30, 21:30] = np.nan  # hidden behind the roof: as long as the rise to it
    surface[2:5] = np.nan  # a narrow band along a row
    surface[33:38, 0:30] = np.nan  # open to the image's border, and narrow
    filled = fill_occlusions(surface, 1.0)
    np.testing.assert_array_equal(filled, plain)
    wide = plain.copy()
    wide[10:30, 10:30] = np.nan  # far longer than the rise explains
    wide[10:30, 50:] = np.nan  # no other end
    assert np.isnan(fill_occlusions(wide, 1.0)[10:30, 10:30]).all()
    assert np.isnan(fill_occlusions(wide, 1.0)[10:30, 50:]).all()
    np.testing.assert_array_equal(fill_occlusions(-surface[:, ::-1], -1.0), -plain[:, ::-1])


def test_a_long_gap_over_which_disparities_fall_is_filled_only_with_what_its_pixels_say():
    """The first image hides the ground there and shows none of it, so no occlusion explains the gap."""
    plain = np.full((40, 80), 3.0, np.float32)
    plain[:, 30:45] = 12.0
    rising, falling, short = plain.copy(), plain.copy(), plain.copy()
    rising[:, 20:30] = falling[:, 45:55] = short[:, 45:50] = np.nan
    for surface in (rising, short):
        np.testing.assert_array_equal(fill_occlusions(surface, 1.0), plain)
    assert np.isnan(fill_occlusions(falling, 1.0)[:, 45:55]).all()
    own = np.where(np.arange(80) < 50, np.float32(4.0), np.float32(6.0)) * np.ones_like(plain)
    filled = fill_occlusions(falling, 1.0, 0.0, own)
    assert (filled[:, 45:50] == 3.0).all() and np.isnan(filled[:, 50:55]).all()


def test_an_alley_between_two_roofs_takes_the_street():
    plain = np.full((40, 60), 3.0, np.float32)
    plain[10:30, 10:26], plain[10:30, 34:50] = 12.0, 20.0
    surface = plain.copy()
    surface[10:30, 26:34] = np.nan
    np.testing.assert_array_equal(fill_occlusions(surface, 1.0), plain)
