"""The steps around semi-global matching, pixel by pixel against their definitions."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.matching import disparity_checks, sgm
from repm_qgis.matching.disparity_map import match_score
from repm_qgis.matching.parameters import MATCHING

LOW, HIGH = -6, 9
SGM = MATCHING.sgm


def texture(shape, seed=0):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.0)
    return np.clip(0.5 + 0.15 * noise / noise.std(), 0, 1).astype(np.float32)


def pair(disparity):
    """Images of a whole disparity that is the same in each row: the second shows at c - d + HIGH what the first has."""
    first = texture((60, 120), 1)
    second = texture((60, 120 + HIGH - LOW), 2)
    for column in np.argsort(disparity, kind="stable"):
        second[:, column - disparity[column] + HIGH] = first[:, column]
    return first, second


def test_bytes_of_intensities():
    found = sgm.intensity_bytes(np.array([[0.0, 1.0, 0.5, np.nan]], np.float32))
    assert found.tolist() == [[0, 255, 127, 0]] and found.dtype == np.uint8


@pytest.mark.parametrize("rim", (3, 9))
def test_the_rim_is_what_a_window_with_missing_pixels_reaches(rim):
    image = texture((30, 40))
    image[10, 20] = image[0, 39] = np.nan
    rows, columns = np.indices(image.shape)
    half = rim // 2
    near = [(np.abs(rows - r) <= half) & (np.abs(columns - c) <= half) for r, c in ((10, 20), (0, 39))]
    found = disparity_checks.without_rim(image, rim)
    np.testing.assert_array_equal(np.isnan(found), near[0] | near[1])
    np.testing.assert_array_equal(found[np.isfinite(found)], image[np.isfinite(found)])


@pytest.mark.parametrize("shift", (LOW, LOW + 1, 0, 5, HIGH - 1, HIGH))
def test_both_directions_find_a_shift_up_to_the_ends_of_the_range(shift):
    first, second = pair(np.full(120, shift))
    a, b = sgm.intensity_bytes(first), sgm.intensity_bytes(second)
    left, right = sgm._left_to_right(a, b, LOW, HIGH, SGM), sgm._right_to_left(a, b, LOW, HIGH, SGM)
    assert left.shape == first.shape and right.shape == second.shape
    assert (np.abs(left[:, 20:-20] - shift) < 0.6).mean() > 0.97
    there = np.arange(120) - shift + HIGH  # where the second image shows the first one's columns
    assert (np.abs(right[:, there][:, 20:-20] - shift) < 0.6).mean() > 0.97
    for found in (left, right):
        assert np.nanmin(found) >= LOW - 0.5 and np.nanmax(found) <= HIGH + 0.5
    assert np.nanmax(left) <= HIGH


def test_nothing_beyond_the_range_is_found():
    """OpenCV searches whole multiples of 16 px: a surface at 9 px is not found where 5 px are the most."""
    first, second = pair(np.full(120, HIGH))
    a, b = sgm.intensity_bytes(first), sgm.intensity_bytes(second)[:, 4:]
    left = sgm._left_to_right(a, b, LOW, 5, SGM)
    assert np.nanmax(left) <= 5 and np.isnan(left[:, 20:-20]).mean() > 0.8


def test_a_match_must_point_back():
    numbers = np.random.default_rng(4)
    left = numbers.uniform(LOW - 1, HIGH + 1, (20, 30)).astype(np.float32)
    right = numbers.uniform(LOW, HIGH, (20, 30 + HIGH - LOW)).astype(np.float32)
    left[numbers.uniform(size=left.shape) < 0.1] = np.nan
    right[numbers.uniform(size=right.shape) < 0.1] = np.nan
    left[:, :3] = -4.0  # whole disparities: differences of exactly the limit
    right[:, 13:16] = -5.0
    right[::2, 13:16] = -5.5
    left[:5, -1], right[:5, 0] = -6.9, -6.5  # its match would lie beyond the right border
    expected, means = np.zeros(left.shape, bool), np.full(left.shape, np.nan)
    for row, column in np.ndindex(left.shape):
        d = left[row, column]
        if np.isfinite(d):
            there = round(float(column - d + HIGH))
            if 0 <= there < right.shape[1]:
                expected[row, column] = abs(right[row, there] - d) <= 1.0
                means[row, column] = (d + right[row, there]) / 2 if expected[row, column] else np.nan
    np.testing.assert_allclose(sgm._agreed(left, right, HIGH, 1.0), means, atol=1e-6)
    assert expected[1, :3].all() and not expected[0, :3].any() and not expected[:5, -1].any()
    assert 0.05 < expected.mean() < 0.5


def by_flooding(disparity, pixels, step):
    """Disparities in 4-connected components of more than so many pixels, by flooding."""
    found, seen = np.full(disparity.shape, np.nan, np.float32), np.isnan(disparity)
    for start in np.ndindex(disparity.shape):
        if seen[start]:
            continue
        seen[start], component, queue = True, [], deque([start])
        while queue:
            row, column = queue.popleft()
            component.append((row, column))
            for near in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
                inside = 0 <= near[0] < disparity.shape[0] and 0 <= near[1] < disparity.shape[1]
                if inside and not seen[near] and abs(disparity[near] - disparity[row, column]) <= step:
                    seen[near] = True
                    queue.append(near)
        if len(component) > pixels:
            for place in component:
                found[place] = disparity[place]
    return found


@pytest.mark.parametrize("step", (1.0, 0.5))
def test_components_end_where_neighbours_differ_by_more_than_a_step(step):
    numbers = np.random.default_rng(6)
    disparity = (LOW + numbers.integers(0, 16 * (HIGH - LOW), (10, 10)) / 16).repeat(4, 0).repeat(4, 1)
    disparity[:, 20:] = np.round(2 * ndimage.gaussian_filter(disparity, 2)[:, 20:] * 8) / 16
    disparity[numbers.uniform(size=disparity.shape) < 0.1] = np.nan
    disparity[0, 0] = LOW
    disparity = disparity.astype(np.float32)
    for pixels in (0, 3, 12, 40):
        expected = by_flooding(disparity, pixels, step)
        found = disparity_checks._components(disparity, LOW, pixels, replace(SGM, speckle_step_px=step))
        np.testing.assert_array_equal(found, expected)
    assert 0.05 < np.isfinite(expected).mean() < 0.9


def patch(rows, columns, top, left, match):
    """How many pixels of a patch the speckle filter leaves; its images match everywhere, in a part, or nowhere."""
    first, second = pair(np.full(120, 4))
    if match is not True:
        other = texture(first.shape, 9)
        if match:
            other[match] = first[match]
        first = other
    disparity = np.full(first.shape, np.nan, np.float32)
    disparity[top : top + rows, left : left + columns] = 4.0
    kept = disparity_checks.speckle_filter(
        disparity, LOW, lambda found: match_score(first, second, found, HIGH, SGM.score_window_px), SGM
    )
    np.testing.assert_array_equal(kept[np.isfinite(kept)], 4.0)
    return int(np.isfinite(kept).sum())


def test_speckles_go_unless_they_match_well():
    assert patch(9, 9, 20, 40, match=False) == 81 and patch(8, 10, 20, 40, match=False) == 0
    assert patch(3, 5, 20, 40, match=True) == 15 and patch(3, 4, 20, 40, match=True) == 0
    assert patch(3, 5, 20, 40, match=False) == 0
    assert patch(8, 9, 20, 40, match=np.s_[20:24, 40:44]) == 0  # too few of its pixels match
    assert 12 < patch(8, 9, 20, 40, match=np.s_[20:28, 40:45]) < 60


def test_scores_are_correlations_of_matched_windows():
    first, second = pair(np.full(120, 4))
    second[30:, 60:] = texture(second.shape, 12)[30:, 60:]
    disparity = np.full(first.shape, 4.0, np.float32)
    disparity[:, 50] = np.nan
    first[12, 30] = np.nan
    score = match_score(first, second, disparity, HIGH, SGM.score_window_px)
    assert np.isnan(score[:, 50]).all() and np.isnan(score[12, 30])
    for row, column in ((20, 30), (40, 90), (50, 100), (22, 70)):
        a, b = first[row - 3 : row + 4, column - 3 : column + 4], second[row - 3 : row + 4, column + 2 : column + 9]
        assert score[row, column] == pytest.approx(np.corrcoef(a.ravel(), b.ravel())[0, 1], abs=1e-3)


@pytest.mark.parametrize("seed", (1, 2))
def test_images_that_are_mirrored_give_the_same_disparities(seed):
    """They moved by 0.01 px, 0.05 m in a narrow pair: OpenCV rounds towards zero."""
    numbers = np.random.default_rng(seed)
    first = cv2.GaussianBlur(numbers.normal(size=(220, 420)), (0, 0), 1.5)
    first = ((first - first.min()) / np.ptp(first)).astype(np.float32)
    rows, columns = (part.astype(np.float32) for part in np.indices((220, 420 + HIGH - LOW)))
    shift = 1.5 * np.sin(columns / 37) + rows / 150  # all fractions of a pixel
    second = cv2.remap(first, columns - HIGH + shift, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    noisy = [(image + numbers.normal(0, 0.06, image.shape)).astype(np.float32) for image in (first, second)]
    found = sgm.match(*noisy, (LOW, HIGH), 1.0)
    mirrored = sgm.match(*(np.ascontiguousarray(image[:, ::-1]) for image in noisy), (-HIGH, -LOW), -1.0)
    apart = (found.disparity + mirrored.disparity[:, ::-1])[20:-20, 20:-20]
    assert np.isfinite(apart).mean() > 0.9 and abs(np.nanmedian(apart)) < 0.003  # 0.027 before


@pytest.mark.parametrize("seed", (1, 2))
def test_images_that_are_upside_down_show_the_same_relief(seed):
    """It moved by 0.5 rows in all: three paths hand costs down from the top alone."""
    numbers = np.random.default_rng(seed)
    first = texture((260, 360), seed)
    rows, columns = (part.astype(np.float32) for part in np.indices((260, 360 + HIGH - LOW)))
    relief = 2.0 * np.sin(rows / 20)
    second = cv2.remap(first, columns - HIGH + relief, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    noisy = [(image + numbers.normal(0, 0.02, image.shape)).astype(np.float32) for image in (first, second)]
    found = sgm.match(*noisy, (LOW, HIGH), 1.0).disparity
    turned = sgm.match(*(np.ascontiguousarray(image[::-1]) for image in noisy), (LOW, HIGH), 1.0).disparity[::-1]
    apart, slope = (turned - found)[20:-20, 20:-20], np.cos(rows / 20)[20:-20, 20 : 360 - 20] / 10
    known = np.isfinite(apart)
    assert known.mean() > 0.95
    assert abs((apart * slope)[known].sum() / (slope[known] ** 2).sum()) < 0.03


def test_a_map_is_consistent_in_itself():
    """Scores belong to matches only, fills to neither; nothing lies outside the range or where there is no image."""
    disparity = np.where(np.arange(120) < 60, -3, 5)
    first, second = pair(disparity)
    first[:10, :15] = np.nan
    found = sgm.match(first, second, (LOW, HIGH), 1.0)
    matched = np.isfinite(found.disparity) & ~found.filled
    np.testing.assert_array_equal(np.isfinite(found.score), matched)
    assert found.filled.any() and np.isfinite(found.disparity[found.filled]).all()
    assert np.nanmin(found.score) >= 0 and np.nanmax(found.score) <= 1
    assert np.nanmin(found.disparity) > LOW - 1 and np.nanmax(found.disparity) < HIGH + 1
    assert np.isnan(found.disparity[:10, :15]).all() and np.isfinite(found.disparity[20:30, 2:20]).all()
    # Greater disparities are higher: what they hide is filled from the ground, -3, to the left of the step.
    hidden = np.s_[5:55, 53:58]
    assert found.filled[hidden].all() and np.abs(found.disparity[hidden] + 3).max() < 0.5


def test_a_gap_of_the_image_is_not_filled():
    """Beside a step it looks like an occlusion."""
    first, second = pair(np.where(np.arange(120) < 60, -3, 5))
    first[20:40, 54:57] = np.nan
    found = sgm.match(first, second, (LOW, HIGH), 1.0)
    missing = np.s_[18:42, 52:59]  # with the rim of 2 px
    assert found.filled[:15, 53:58].all() and np.isnan(found.disparity[missing]).all()


def test_small_components_go():
    first, second = pair(np.full(120, 4))
    least = replace(MATCHING, sgm=replace(SGM, speckle_px=first.size, tower_px=first.size))
    assert np.isfinite(sgm.match(first, second, (LOW, HIGH), 1.0).disparity).mean() > 0.9
    assert np.isnan(sgm.match(first, second, (LOW, HIGH), 1.0, parameters=least).disparity).all()


def test_fills_are_smoothed_and_matches_are_not(monkeypatch):
    """A fill that differs from all around it, as rows filled one by one do; and what the filling is told."""
    first, second = pair(np.full(120, 4))
    first[20:30, 60:70] = texture(first.shape, 9)[20:30, 60:70]
    told = []

    def fill(disparity, height_sign, relief_displacement, left, parameters):
        told.append((height_sign, relief_displacement, left.shape, parameters))
        dense = np.where(np.isfinite(disparity), disparity, np.float32(4))
        dense[25, 65] = 9.0
        return dense

    monkeypatch.setattr(disparity_checks, "fill_occlusions", fill)
    found = sgm.match(first, second, (LOW, HIGH), -1.0, 0.7)
    assert told == [(-1.0, 0.7, first.shape, MATCHING.occlusions)]
    assert found.filled[25, 65] and abs(found.disparity[25, 65] - 4) < 0.5
