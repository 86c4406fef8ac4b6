"""The learned cost: its network against onnxruntime's figures, its aggregation against plain loops, and pairs whose
intensities disagree."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from repm_qgis.contracts.options import INTENSITY, LEARNED
from repm_qgis.matching import learned, pair_backend, sgm
from repm_qgis.matching.cost_volume import winners
from repm_qgis.matching.learned_features import FEATURES, features_of_rows, normalised
from repm_qgis.matching.parameters import MATCHING, LearnedParameters
from repm_qgis.matching.reliability import mask_unreliable
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.runtime.spare_cores import spare_cores, spread

from .test_sgm import HIGH, LOW, pair_of

# Of onnxruntime 1.32 with the file of mccnn 1.4.1: the first eight features of three pixels.
_ONNXRUNTIME = {
    (0, 0): (-0.08639, 0.08297, -0.03702, -0.24331, -0.03895, 0.03889, 0.01929, 0.07253),
    (7, 11): (0.01969, 0.09283, 0.03549, -0.27256, -0.07153, -0.0484, 0.15711, 0.03904),
    (13, 19): (0.04364, 0.07242, 0.00427, -0.19845, 0.07805, -0.01615, 0.10784, 0.1545),
}


def test_features_are_those_of_onnxruntime():
    number = np.arange(24 * 30).reshape(24, 30)
    image = ((number * 7919) % 101 / 50.0 - 1).astype(np.float32)
    features = features_of_rows(image, slice(0, 14), slice(0, 20))
    assert features.shape == (FEATURES, 14, 20)
    for (row, column), expected in _ONNXRUNTIME.items():
        assert np.abs(features[:8, row, column] - expected).max() < 1e-4
    assert float(np.abs(features).sum()) == pytest.approx(1784.7437, abs=1e-2)


def test_features_do_not_depend_on_the_part_that_is_made_at_once():
    image = normalised(np.random.default_rng(1).random((40, 700)).astype(np.float32))
    columns = slice(0, 700)
    whole = features_of_rows(image, slice(0, 40), columns)
    parts = np.concatenate([features_of_rows(image, slice(top, top + 10), columns) for top in range(0, 40, 10)], axis=1)
    assert np.abs(whole - parts).max() < 1e-5
    assert np.abs(whole[:, :, 90:650] - features_of_rows(image, slice(0, 40), slice(90, 650))).max() < 1e-5


def test_threads_do_not_disturb_each_other():
    """Images of other sizes, and of the same one, at once: a network that they shared would mix them up."""
    random = np.random.default_rng(4)
    images = [normalised(random.random((60, 90 + 10 * (number % 3))).astype(np.float32)) for number in range(12)]

    def made(image):
        return features_of_rows(image, slice(0, 60), slice(0, image.shape[1] - 10))

    alone = [made(image) for image in images]
    with spare_cores(3):
        together = [spread(made, images) for _ in range(3)]
    for features in together:
        for one, other in zip(alone, features):
            np.testing.assert_array_equal(one, other)


def summed_by_loops(costs, one, two, image, contrast):
    """Hirschmueller's recursion, pixel by pixel: the sums over eight paths of costs (H, D, W)."""
    height, count, width = costs.shape
    total = np.zeros(costs.shape)
    for down, right in ((0, 1), (0, -1), (1, 0), (1, 1), (1, -1), (-1, 0), (-1, 1), (-1, -1)):
        paths = np.zeros(costs.shape)
        for row in range(height)[:: down or 1]:
            for column in range(width)[:: right or 1]:
                before = row - down, column - right
                own = costs[row, :, column].astype(float)
                if 0 <= before[0] < height and 0 <= before[1] < width:
                    past = paths[before[0], :, before[1]]
                    step = abs(float(image[row, column]) - float(image[before]))
                    jump = int(max(two / (1 + step / contrast), one + 1))
                    beside = np.concatenate([[np.inf], past, [np.inf]])
                    best = np.minimum(past, np.minimum(beside[:-2], beside[2:]) + one)
                    own += np.minimum(best, past.min() + jump) - past.min()
                paths[row, :, column] = own
        total += paths
    return total


@pytest.mark.parametrize("hidden", [0, 4], ids=["all shown", "paths begin where the image does"])
def test_sums_over_paths_are_those_of_plain_loops(hidden):
    rng, p = np.random.default_rng(3), LearnedParameters()
    shape, span = (14, 17), 6
    base = cv2.GaussianBlur(rng.random((shape[0], shape[1] + span + 4)).astype(np.float32), (0, 0), 1.0)
    first, second = base[:, 3 : 3 + shape[1]].copy(), base[:, : shape[1] + span].copy()
    first[:, :hidden] = np.nan
    found = winners(first, second, span, p)
    scale = int(255 / (1 + p.p1 + p.p2))
    rows = slice(0, shape[0])
    a, b = (features_of_rows(normalised(image), rows, slice(0, image.shape[1])) for image in (first, second))
    costs = np.stack([(1 - (a * b[:, :, e : e + shape[1]]).sum(axis=0)) / 2 for e in range(span + 1)], axis=1)
    costs = np.floor(scale * costs + 0.5)[:, :, hidden:]
    sums = summed_by_loops(costs, round(scale * p.p1), scale * p.p2, first[:, hidden:], p.contrast)
    shown = np.s_[:, hidden:]
    assert (np.abs(found.first[shown] - sums.argmin(axis=1)) <= 0.5).mean() > 0.99
    lead = (sums.mean(axis=1) - sums.min(axis=1)) / (8 * scale)
    assert np.abs(lead - found.lead[shown]).max() < 0.01
    assert np.median(found.first[:, hidden + 5 : -5]) == pytest.approx(3, abs=0.2)
    assert not found.first[:, :hidden].any()


def test_images_that_share_little_of_their_texture_are_matched():
    """As across seasons: leaves and crops of another day lie over what stays."""
    first, second = pair_of(lambda c, r: 5.25, seed=4)
    other = cv2.GaussianBlur(np.random.default_rng(9).random(second.shape).astype(np.float32), (0, 0), 1.2)
    other = (other - other.mean()) / other.std() * second.std()
    changed = np.clip(second + np.float32(4) * other, 0, 1).astype(np.float32)
    right = {}
    for name, match in ((INTENSITY, sgm.match), (LEARNED, learned.match)):
        found = match(first, changed, (LOW, HIGH), 1.0)
        with np.errstate(invalid="ignore"):
            right[name] = float((np.abs(found.disparity - 5.25) < 1).mean())
    assert right[LEARNED] > 0.9
    assert right[LEARNED] > right[INTENSITY] + 0.2


def test_noise_is_not_matched_with_noise():
    """Water looks different in each image: what is left of it is little, and no large surface."""
    rng = np.random.default_rng(6)
    first, second = (
        cv2.GaussianBlur(rng.random((200, width)).astype(np.float32), (0, 0), 0.8) for width in (260, 260 + HIGH - LOW)
    )
    found = learned.match(first, second, (LOW, HIGH), 1.0)
    assert np.isfinite(found.disparity).mean() < 0.1


def test_what_lies_beyond_the_second_image_is_not_matched_elsewhere():
    first, second = pair_of(lambda c, r: 3.0, seed=2)
    beyond = 80  # columns of the first image that the second one does not show
    second[:, : beyond + HIGH - 3] = np.nan
    found = learned.match(first, second, (LOW, HIGH), 1.0)
    assert not np.isfinite(found.disparity[:, : beyond - 5]).any()
    shown = found.disparity[:, beyond + 10 :]
    assert np.isfinite(shown).mean() > 0.8 and abs(np.nanmedian(shown) - 3.0) < 0.05


def test_what_smoothness_alone_matches_has_no_support():
    """A lake is noise in both images, over which the heights of its banks are extended."""
    first, second = pair_of(lambda c, r: 3.0, seed=5)
    rng, p = np.random.default_rng(8), MATCHING.learned_reliability
    lake = np.s_[30:170, 60:200]
    for image in (first, second):
        noise = 0.02 * rng.standard_normal(image.shape).astype(np.float32)
        image[lake] = (np.float32(0.3) + noise)[lake]
    found = learned.match(first, second, (LOW, HIGH), 1.0)
    kept = mask_unreliable(
        found, first, second, disparities=(LOW, HIGH), height_sign=1.0, metres_per_px=1.0, parameters=p
    )
    assert np.isfinite(kept.disparity[40:160, 70:190]).mean() < 0.02
    assert np.isfinite(kept.disparity[:, 220:-10]).mean() > 0.98


def test_pixels_without_data_have_no_disparity():
    first, second = pair_of(lambda c, r: 3.0, seed=2)
    first[40:90, 60:120] = np.nan
    found = learned.match(first, second, (LOW, HIGH), 1.0)
    assert not np.isfinite(found.disparity[40:90, 60:120]).any()
    known = np.isfinite(found.disparity) & ~found.filled
    assert known.mean() > 0.7
    assert np.abs(np.median(found.disparity[known]) - 3.0) < 0.05


def test_a_scene_of_several_pairs_keeps_only_what_is_less_doubtful():
    alone, several = MATCHING.of_pairs(1).learned, MATCHING.of_pairs(3).learned
    assert several.most_doubt == alone.most_shared_doubt < alone.most_doubt


@pytest.mark.parametrize(
    ("chosen", "days", "agreed", "cost", "unlike"),
    [
        ("auto", 0.4, 10, INTENSITY, False),  # images of one day are not even measured
        ("auto", 150.0, 60, LEARNED, False),
        ("auto", 150.0, 95, INTENSITY, False),
        ("auto", None, 80, INTENSITY, False),  # as images of one pass without times have it
        ("auto", None, 60, LEARNED, False),
        (LEARNED, 0.0, 95, LEARNED, False),
        (INTENSITY, 0.4, 10, INTENSITY, False),
        (INTENSITY, 150.0, 60, INTENSITY, True),
        (INTENSITY, 150.0, 95, INTENSITY, False),
    ],
)
def test_what_a_pair_is_matched_by(monkeypatch, chosen, days, agreed, cost, unlike):
    pair = SimpleNamespace(first="a", second="b", names=("a", "b"), days=days)
    job = SimpleNamespace(pairs=(pair,), options=SimpleNamespace(matching_cost=chosen), parameters=MATCHING)
    tasks = [SimpleNamespace(pair=("a", "b"), number=number) for number in range(7)]
    measured, told = [], Recorder(Silent())

    def counts(function, some, *_):
        measured.extend(some)
        return [(agreed, 100) for _ in some]

    monkeypatch.setattr(pair_backend, "run_tasks", counts)
    monkeypatch.setattr(pair_backend, "_workers", lambda *_: 1)
    found = pair_backend.choose_costs(job, pair_backend.unsure_tasks(job, tasks), told)["a", "b"]
    assert found.cost == cost and found.unlike == unlike
    assert found.alike == (agreed / 100 if measured and cost == LEARNED or unlike else 1.0)
    assert len(measured) == (0 if chosen == LEARNED or days == 0.4 else 3)


def test_a_pair_that_no_tile_shows_is_no_reason_for_features(monkeypatch):
    pair = SimpleNamespace(first="a", second="b", names=("a", "b"), days=90.0)
    job = SimpleNamespace(pairs=(pair,), options=SimpleNamespace(matching_cost="auto"), parameters=MATCHING)
    monkeypatch.setattr(pair_backend, "run_tasks", lambda *_: [])
    monkeypatch.setattr(pair_backend, "_workers", lambda *_: 1)
    assert pair_backend.choose_costs(job, [], Silent()) == {("a", "b"): (INTENSITY, 1.0)}
