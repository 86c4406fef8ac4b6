"""Snow: broad, weak shading under the noise of single pixels gets heights; water, which shares nothing, gets none."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy import ndimage

from repm_qgis.evaluation.scoring import score_files
from repm_qgis.matching.parameters import MATCHING
from repm_qgis.matching.reliability import mask_unreliable
from repm_qgis.matching.sgm import match
from repm_qgis.matching.wide_windows import even_contrast, wide_match
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage
from tests.engine.matching.pairs import reduced_pair

SHAPE = (360, 440)
LOW, HIGH = -20, 20
NOISE = 0.003
ROWS, COLUMNS = np.indices(SHAPE)
FIELD = (slice(60, 300), slice(80, 360))
SLOPE = 4.0 + 0.03 * (COLUMNS - 220)  # px of disparity at a pixel


def shown(texture, bank, seed=0):
    """A pair of a slope: strong texture around a field with a texture of its own; noise of each image's own."""
    rng = np.random.default_rng(seed)
    first = bank.copy()
    first[FIELD] = texture[FIELD]
    # A column c of the second image shows the rectified column c - HIGH, which shows first column c - HIGH + d.
    wide = np.arange(SHAPE[1] + HIGH - LOW, dtype=float)[None, :] - HIGH
    source = (wide + 4.0 - 0.03 * 220) / (1 - 0.03)
    places = np.broadcast_to(ROWS[:, :1], (SHAPE[0], source.shape[1])), np.broadcast_to(source, (SHAPE[0], source.size))
    second = ndimage.map_coordinates(first, places, order=3, mode="nearest")
    return [(image + NOISE * rng.standard_normal(image.shape)).astype(np.float32) for image in (first, second)]


def smooth(sigma, seed):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), sigma)
    return noise / noise.std()


@pytest.fixture(scope="module")
def bank():
    return 0.4 + 0.08 * smooth(1.0, 7)


def kept(pair, wide=True):
    found = match(*pair, (LOW, HIGH), 1.0)
    wider = partial(wide_match, reduced_pair(*pair, (LOW, HIGH)), 1.0, match, MATCHING) if wide else None
    return mask_unreliable(found, *pair, disparities=(LOW, HIGH), height_sign=1.0, metres_per_px=1.0, wider=wider)


def test_weak_shading_gets_heights_within_their_stated_error(bank):
    """Its deviation is half of the noise, a third of a step of eight bits."""
    pair = shown(0.85 + 0.0015 * smooth(6.0, 3), bank)
    inside = np.s_[84:276, 104:336]
    assert np.isfinite(kept(pair, wide=False).disparity[inside]).mean() < 0.4
    found = kept(pair)
    known = np.isfinite(found.disparity[inside])
    off = np.abs(found.disparity - SLOPE)[inside][known]
    stated = 0.15 + 0.85 * (1 - found.score[inside][known])  # px
    assert known.mean() > 0.75  # the windows of its rim reach beyond it
    assert (off < stated).mean() > 0.6 and (off < 2 * stated).mean() > 0.9
    assert not (found.filled & ~match(*pair, (LOW, HIGH), 1.0).filled)[inside].any()


def test_water_beside_a_strong_bank_stays_empty(bank):
    first, second = shown(np.full(SHAPE, 0.85), bank)
    left, before = kept((first, second)), kept((first, second), wide=False)
    assert np.isfinite(before.disparity[80:280, 100:340]).mean() < 0.02
    np.testing.assert_array_equal(left.disparity, before.disparity)


@pytest.mark.parametrize(
    "shade",
    [
        (COLUMNS - 220) / 140,
        (ROWS - 180) / 120,
        np.exp(-((ROWS - 150) ** 2 + (COLUMNS - 200) ** 2) / (2 * 60**2)),
    ],
    ids=["shallower to the right", "shallower below", "mud"],
)
def test_a_lake_that_both_images_show_shaded_stays_empty(bank, shade):
    """Even shading correlates at any disparity: a third of the heights that it gave were wrong by more than 1 px."""
    found = kept(shown(0.2 + 0.1 * shade, bank))
    assert np.isfinite(found.disparity[80:280, 100:340]).mean() < 0.02


@pytest.mark.long
def test_a_lake_in_images_of_two_metres_is_not_made_of_wide_windows(shared_data, tmp_path):
    """Three-line images of WHU-TLC: over its lake, heights were 20 m off, and the RMSE twice that of the land."""
    place = shared_data / "whu_tlc"
    images = [str(place / f"block0067_view{number}.tif") for number in range(3)]
    output = str(tmp_path / "dsm.tif")
    options = {"images": images, "workspace": str(tmp_path / "work"), "output": output, "resolution": 5.0, "workers": 1}
    run_stage("pipeline", options, Silent())
    found = score_files(output, str(place / "truth_0067.tif"), "3d").metrics
    assert found.mae < 0.65 and found.rmse < 1.2 and found.valid > 95


def test_contrast_is_even_and_what_is_unknown_stays_so():
    image = np.where(COLUMNS < 220, 0.2 + 0.001 * smooth(1.0, 1), 0.8 + 0.1 * smooth(1.0, 2)).astype(np.float32)
    image[:20] = np.nan
    even = even_contrast(image, MATCHING.wide)
    assert np.isnan(even[:20]).all() and np.isfinite(even[20:]).all()
    weak, strong = even[40:, 20:180].std(), even[40:, 260:420].std()
    assert weak == pytest.approx(strong, rel=0.1) and even[20:].min() >= 0 and even[20:].max() <= 1


def test_what_is_supported_is_not_matched_again(bank):
    pair = shown(bank, bank)
    found = match(*pair, (LOW, HIGH), 1.0)

    def wider(missing):
        raise AssertionError("nothing large is missing")

    numbers = {"disparities": (LOW, HIGH), "height_sign": 1.0, "metres_per_px": 1.0}
    assert mask_unreliable(found, *pair, **numbers, wider=wider) is found
