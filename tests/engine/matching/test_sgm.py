"""Semi-global matching of made-up pairs whose disparities are known."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.contracts.options import BACKENDS
from repm_qgis.matching.backends import backend_of, pair_matcher, resolve
from repm_qgis.matching.sgm import BACKEND
from repm_qgis.matching.sgm import match as match_with_background
from repm_qgis.runtime.spare_cores import spare_cores

HEIGHT, WIDTH = 180, 240
LOW, HIGH = -12, 20


def match(first, second, disparities):
    """Disparities that were matched, without what the background fills; and their scores."""
    found = match_with_background(first, second, disparities, 1.0)
    return np.where(found.filled, np.nan, found.disparity), found.score


def texture(seed=0):
    """A smooth random image, wider than what is cut from it, as spline coefficients."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH + 200)), 1.2)
    noise = (noise - noise.min()) / np.ptp(noise)
    return ndimage.spline_filter(noise, order=3)


def pair_of(disparity, seed=0):
    """First image, and the second whose column c shows rectified column c - HIGH, for disparities of the second."""
    coefficients = texture(seed)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    first = ndimage.map_coordinates(coefficients, [rows, columns + 100], order=3, prefilter=False)
    rows, columns = np.mgrid[:HEIGHT, : WIDTH + HIGH - LOW].astype(float)
    columns -= HIGH
    second = ndimage.map_coordinates(
        coefficients, [rows, columns + disparity(columns, rows) + 100], order=3, prefilter=False
    )
    return first.astype(np.float32), second.astype(np.float32)


@pytest.mark.parametrize("shift", (0.0, 3.0, 7.25, -4.4, -9.5, 16.7))
def test_a_shift_is_found_to_a_fraction_of_a_pixel(shift):
    """OpenCV's matcher draws towards whole pixels, by up to 0.28 px; sharpened, a tenth of that is left."""
    first, second = pair_of(lambda c, r: shift)
    disparity, score = match(first, second, (LOW, HIGH))
    known = np.isfinite(disparity)
    assert known.mean() > 0.97
    error = disparity[known] - shift
    whole = shift == round(shift)
    assert abs(np.median(error)) < (0.01 if whole else 0.06)
    assert np.percentile(np.abs(error), 95) < (0.05 if whole else 0.2)
    assert np.median(score[known]) > 0.9


def test_a_slope_is_found():
    def sloped(columns, rows):
        return 2.0 + 0.04 * columns - 0.02 * rows

    first, second = pair_of(sloped)
    disparity, _ = match(first, second, (LOW, HIGH))
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    # The slope is given at the second image's columns xb; the first's are xa = xb + d(xb).
    truth = 2.0 + 0.04 * ((columns - 2.0 + 0.02 * rows) / 1.04) - 0.02 * rows
    error = disparity - truth
    assert np.isfinite(error).mean() > 0.95
    # Over a slope the draw towards whole pixels averages out.
    assert abs(np.nanmedian(error)) < 0.08 and np.nanpercentile(np.abs(error), 95) < 0.4


def test_borders_are_matched_too():
    """Nothing but what the second image does not show may be missing, left and right."""
    first, second = pair_of(lambda c, r: 5.0)
    disparity, _ = match(first, second, (LOW, HIGH))
    known = np.isfinite(disparity)
    assert known[:, :8].mean() > 0.7 and known[:, -8:].mean() > 0.7 and known[:8].mean() > 0.7


def test_nan_is_not_matched_and_does_not_spread():
    first, second = pair_of(lambda c, r: 4.0)
    first[40:80, 60:120] = np.nan
    second[120:150, 100:160] = np.nan
    disparity, score = match(first, second, (LOW, HIGH))
    assert np.isnan(disparity[40:80, 60:120]).all() and np.isnan(score[40:80, 60:120]).all()
    # What lies at c in the second image is rectified column c - HIGH, and matches the first's column c - HIGH + 4.
    hidden = disparity[120:150, 100 - HIGH + 4 : 160 - HIGH + 4]
    right = np.abs(hidden - 4.0) < 0.5
    assert np.isnan(hidden).mean() > 0.9 and not right.any()
    far = np.ones(disparity.shape, dtype=bool)
    far[30:90, 50:130] = far[110:160, 75:155] = False
    known = np.isfinite(disparity) & far
    assert known[far].mean() > 0.96 and np.percentile(np.abs(disparity[known] - 4.0), 99) < 0.4


def test_empty_images_give_nothing_and_flat_ones_nothing_trustworthy():
    first, second = pair_of(lambda c, r: 4.0)
    for a, b in ((np.full_like(first, np.nan), second), (first, np.full_like(second, np.nan))):
        disparity, score = match(a, b, (LOW, HIGH))
        assert np.isnan(disparity).all() and np.isnan(score).all()
    disparity, score = match(np.full_like(first, 0.5), np.full_like(second, 0.5), (LOW, HIGH))
    assert not (np.isfinite(disparity) & (score > 0.1)).any()


def test_noise_is_hardly_matched():
    numbers = np.random.default_rng(5)
    a = numbers.uniform(size=(HEIGHT, WIDTH)).astype(np.float32)
    b = numbers.uniform(size=(HEIGHT, WIDTH + HIGH - LOW)).astype(np.float32)
    disparity, _ = match(a, b, (LOW, HIGH))
    assert np.isfinite(disparity).mean() < 0.25


def test_threads_do_not_change_a_bit():
    first, second = pair_of(lambda c, r: 3.0 + 0.03 * c + np.sin(r / 9))
    before, found = cv2.getNumThreads(), []
    try:
        for threads in (1, 2, 4):
            cv2.setNumThreads(threads)
            with spare_cores(threads - 1):
                found.append(match(first, second, (LOW, HIGH)))
    finally:
        cv2.setNumThreads(before)
    for disparity, score in found[1:]:
        np.testing.assert_array_equal(disparity, found[0][0])
        np.testing.assert_array_equal(score, found[0][1])


def test_auto_chooses_the_backend_with_the_better_figures(monkeypatch):
    """As where a CUDA device answers; the page has both backends' figures of each scene."""
    colmap = backend_of("colmap")
    monkeypatch.setattr(type(colmap), "usable", lambda self: True)
    monkeypatch.setattr(type(colmap), "remedy", lambda self: "")
    page = (Path(__file__).resolve().parents[3] / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    table = page.partition("## COLMAP's PatchMatch on CUDA")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (.+?) \| (sgm|colmap) " + 4 * r"\| (\S+) ", table, re.M)
    within = {(row[0], row[1]): float(row[5]) for row in rows}
    scenes = {scene for scene, _ in within}
    worse = [scene for scene in scenes if within[scene, "colmap"] < within[scene, "sgm"]]
    assert len(scenes) >= 5 and (resolve("auto")[0] is BACKEND) == (2 * len(worse) > len(scenes))
    assert resolve("colmap") == [colmap]


def test_backends_by_name():
    assert resolve("auto") == [BACKEND] == resolve("sgm") and BACKEND.pair_matcher is match_with_background
    assert [backend_of(name).name for name in BACKENDS[1:]] == list(BACKENDS[1:])
    assert all(pair_matcher(backend_of(name)) is match_with_background for name in BACKENDS[1:])
