"""What ties are chosen by, against plain loops over all pairs of keypoints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.ties import tie_points
from repm_qgis.ties.parameters import TIES
from repm_qgis.ties.tie_points import (
    PairMatches,
    _guided_matches,
    _mode,
    consistent_matches,
    evenly_spread,
    supported,
)

MATCHES = TIES.matches


def by_loops(descriptors, points, disparities, parallax, around):
    """Mutual best matches with the ratio test, pair by pair."""
    (a, b), (da, db) = points, descriptors
    distance = np.full((len(a), len(b)), np.inf)
    for i in range(len(a)):
        for j in range(len(b)):
            along, across = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1] - parallax[i]
            if disparities[0] <= along <= disparities[1] and abs(across) <= around:
                distance[i, j] = np.linalg.norm(da[i] - db[j])
    found = []
    for i in range(len(a)):
        j = int(distance[i].argmin())
        nearest, second = distance[i, j], np.delete(distance[i], j).min()
        if np.isfinite(nearest) and distance[:, j].argmin() == i:
            if nearest < MATCHES.most_distance and nearest < MATCHES.ratio * second:
                found.append((i, j))
    return found


@pytest.mark.parametrize("rows", (16, 1000))
@pytest.mark.parametrize("seed", range(3))
def test_matches_are_those_of_all_pairs(monkeypatch, seed, rows):
    """However many rows of the matrix of distances are made at once."""
    monkeypatch.setattr(tie_points, "_ROWS", rows)
    rng, count = np.random.default_rng(seed), 90
    a = rng.uniform(0, 100, (count, 2))
    b = a[rng.permutation(count)[:70]] + rng.normal(0, 1.5, (70, 2)) + (7.0, -4.0)
    kinds = rng.normal(size=(12, 8))
    da, db = (kinds[rng.integers(0, 12, n)] + 0.3 * rng.normal(size=(n, 8)) for n in (count, 70))
    da, db = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (da, db))
    parallax = 4.0 + 0.02 * a[:, 0]
    for disparities, around in (((-12.0, -2.0), 3.0), ((-60.0, 60.0), 25.0), ((-9.0, -5.0), 1.0)):
        found = _guided_matches((da, db), (a, b), disparities, MATCHES, parallax, around)
        assert found.tolist() == [list(each) for each in by_loops((da, db), (a, b), disparities, parallax, around)]
    assert len(_guided_matches((da, db), (a, b + 500.0), (-9.0, -5.0), MATCHES, parallax, 1.0)) == 0


def test_the_mode_is_in_the_middle_of_the_fullest_interval():
    assert _mode(np.array([9.0, 1.0, 1.2, 1.9, 5.0, 5.4, 5.5, 5.9, 6.1]), 1.0) == pytest.approx(5.45)
    assert _mode(np.array([0.0, 2.0, 2.5, 3.0, 30.0]), 1.0) == pytest.approx(2.5)
    assert _mode(np.array([4.0]), 1.0) == 4.0


def matches(pixels, parallax, name="made"):
    return PairMatches("a", "b", pixels, pixels + (50.0, 0.0), parallax)


@pytest.mark.parametrize("wrong", (0.0, 0.4))
def test_matches_off_the_trend_go_and_those_of_a_patch_beside_it_stay(wrong):
    """A patch may be off the trend by its relief; within it, matches agree."""
    rng, parts, good = np.random.default_rng(1), [], []
    for number in range(9):
        pixels = rng.uniform(0, 300, (60, 2)) + (400.0 * (number % 3), 400.0 * (number // 3))
        parallax = 10.0 + 0.01 * pixels[:, 0] - 0.004 * pixels[:, 1] + (0.8 if number == 4 else 0.0)
        bad = rng.random(60) < wrong
        parallax = parallax + np.where(bad, rng.uniform(6, 40, 60) * rng.choice([-1, 1], 60), rng.normal(0, 0.2, 60))
        parts.append(matches(pixels, parallax))
        good.append(~bad)
    kept = consistent_matches("a", "b", parts, MATCHES)
    known = {tuple(pixel) for part, yes in zip(parts, good) for pixel in part.first_px[yes]}
    found = {tuple(pixel) for pixel in kept.first_px}
    assert not found - known and len(found) > 0.97 * len(known)
    assert kept.second_px == pytest.approx(kept.first_px + (50.0, 0.0))
    few = [*parts, matches(np.array([[2000.0, 2000.0]] * 3), np.full(3, 22.0))]
    assert len(consistent_matches("a", "b", few, MATCHES).first_px) == len(found)  # three are no patch
    assert len(consistent_matches("a", "b", [], MATCHES).first_px) == 0


def test_a_match_needs_neighbours_that_go_with_it():
    at = np.column_stack([np.arange(40.0) * 10.0, np.zeros(40)])
    level = np.zeros(40)
    assert supported(at, level, MATCHES).all()
    for step, kept in ((MATCHES.support_step_px + 0.4 * 10.0 - 0.1, True), (60.0, False)):
        one = level.copy()
        one[20] = step
        assert supported(at, one, MATCHES)[20] == kept and supported(at, one, MATCHES).sum() == 39 + kept
    # So many neighbours must agree: three in a row of a roof have only two.
    for row, kept in ((3, 0), (4, 4)):
        roof = level.copy()
        roof[18 : 18 + row] = 100.0
        assert supported(at, roof, MATCHES)[18 : 18 + row].sum() == kept
    assert supported(at[:10], 100.0 * np.arange(10.0), MATCHES).all()  # with so few, none has ten neighbours


def test_of_every_bucket_the_strongest_come_first():
    size, at = (100, 100), np.array([[5.0, 5.0], [6.0, 6.0], [7.0, 7.0], [95.0, 95.0], [94.0, 94.0], [50.0, 5.0]])
    strength = np.array([1.0, 3.0, 2.0, 9.0, 8.0, 0.1])
    assert evenly_spread(at, strength, size, 3, 10).tolist() == [1, 3, 5]
    assert evenly_spread(at, strength, size, 4, 10).tolist() == [1, 3, 4, 5]
    assert evenly_spread(at, strength, size, 5, 10).tolist() == [1, 2, 3, 4, 5]
    assert evenly_spread(at, strength, size, 6, 10).tolist() == [0, 1, 2, 3, 4, 5]
    edge = np.array([[100.0, 100.0], [99.0, 99.0]])
    assert evenly_spread(edge, np.array([1.0, 2.0]), size, 1, 10).tolist() == [1]
    wide = np.array([[150.0, 10.0], [160.0, 10.0], [10.0, 40.0]])
    assert evenly_spread(wide, np.array([1.0, 2.0, 0.5]), (200, 50), 2, 4).tolist() == [1, 2]


def test_a_trend_needs_many_matches_and_must_explain_more_than_a_constant():
    rng = np.random.default_rng(4)
    pixels = rng.uniform(0, 1000, (200, 2))
    sloped = 5.0 + 0.003 * pixels[:, 0] + 0.001 * pixels[:, 1]
    at = np.array([[0.0, 0.0], [1000.0, 0.0], [0.0, 1000.0]])
    found = tie_points.parallax_trend(pixels, sloped + rng.normal(0, 0.1, 200), MATCHES, at)
    assert found == pytest.approx([5.0, 8.0, 6.0], abs=0.15)
    few = replace(MATCHES, trend_matches=201)
    constant = tie_points.parallax_trend(pixels, sloped, few, at)
    assert constant == pytest.approx(np.full(3, _mode(sloped, MATCHES.mode_px)))
    assert tie_points.parallax_trend(pixels, np.full(200, 3.0), MATCHES, at) == pytest.approx([3.0, 3.0, 3.0], abs=1e-6)
