"""Fusing cells against numpy's medians and known surfaces, and the radius filter against a k-d tree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from repm_qgis.fusion.aggregation import HeightLayer, aggregate, disagreement, rim_cells
from repm_qgis.fusion.outliers import needed_neighbours, radius_outliers, remove_isolated_points
from repm_qgis.fusion.parameters import FUSION

NUMBERS = np.random.default_rng(8)
SHAPE = (60, 80)
RIM = 2  # cells by which matching may widen what stands above a step


def layers(stack, scores=0.9, background=np.nan, metres=1.0):
    metres = np.broadcast_to(metres, len(stack))
    return [
        HeightLayer(height, np.broadcast_to(scores, SHAPE), np.broadcast_to(background, SHAPE), float(m), 1.0)
        for height, m in zip(stack, metres)
    ]


def maps(count, spread=0.1, gaps=0.2):
    truth = 200 + 30 * NUMBERS.uniform(size=SHAPE)
    stack = truth + NUMBERS.normal(0, spread, (count,) + SHAPE)
    stack[NUMBERS.uniform(size=stack.shape) < gaps] = np.nan
    return truth, stack


@pytest.mark.parametrize("method, function", (("median", np.nanmedian), ("mean", np.nanmean)))
@pytest.mark.parametrize("count", (1, 2, 3, 4, 5, 7))
def test_equal_maps_give_numpys(count, method, function):
    _, stack = maps(count)
    # Pairs so narrow that all heights agree.
    found = aggregate(layers(stack, 0.7, metres=10.0), method, RIM)
    known = np.isfinite(stack).any(axis=0)
    expected = np.full(SHAPE, np.nan)
    expected[known] = function(stack[:, known], axis=0)
    np.testing.assert_allclose(found.height, expected, atol=1e-4)
    assert (found.first.count == np.isfinite(stack).sum(axis=0)).all() and not found.first.filled.any()
    np.testing.assert_allclose(found.first.score[known], 0.7, atol=1e-6)
    several = found.first.count > 1
    if method == "mean":  # the spread is that about the mean
        np.testing.assert_allclose(found.first.spread[several], np.nanstd(stack[:, several], axis=0), atol=1e-4)
    assert np.isnan(found.first.spread[~several]).all()


def test_narrow_pairs_weigh_less():
    """Two maps: their mean, weighted by the inverse of their variances, which grow with the metres for each px."""
    a, b = np.full(SHAPE, 100.0), np.full(SHAPE, 100.4)
    found = aggregate(layers([a, b], metres=(2.0, 8.0)), "mean", RIM)
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(found.height[inner], (100 / 2 + 100.4 / 8) / (1 / 2 + 1 / 8), rtol=1e-6)


def test_a_worse_score_weighs_less():
    """0.16 units at a correlation of 1, 3.2 more for each 1 less: 0.48 and 1.76 at 0.9 and 0.5."""
    a, b = np.full(SHAPE, 100.0), np.full(SHAPE, 100.2)
    stack = [HeightLayer(h, np.full(SHAPE, s), np.full(SHAPE, np.nan), 1.0, 1.0) for h, s in ((a, 0.9), (b, 0.5))]
    found = aggregate(stack, "mean", RIM)
    np.testing.assert_allclose(found.height, (100 / 0.48**2 + 100.2 / 1.76**2) / (1 / 0.48**2 + 1 / 1.76**2), rtol=1e-6)
    np.testing.assert_allclose(found.first.evidence, 2.0)
    np.testing.assert_allclose(found.first.sigma, 1.12, rtol=1e-5)


@pytest.mark.parametrize("method", ("median", "mean"))
def test_outliers_are_thrown_out(method):
    truth = hills()
    stack = truth + NUMBERS.normal(0, 0.1, (6,) + SHAPE)
    wrong = NUMBERS.uniform(size=truth.shape) < 0.5
    stack[2][wrong] += 25.0
    stack[5][wrong] -= 60.0
    found = aggregate(layers(stack), method, RIM)
    assert np.abs(found.height - truth).max() < 0.3
    assert (found.first.count[wrong] == 4).all() and found.first.spread[wrong].max() < 0.5
    assert (found.first.count[~wrong] == 6).all()


def hills(shape=SHAPE):
    rows, cols = np.indices(shape)
    return 200 + 6 * np.sin(cols / 11.0) + 4 * np.cos(rows / 7.0)


@pytest.mark.parametrize("count", (2, 3, 4, 6))
def test_one_in_ten_grossly_wrong_changes_little(count):
    """Ten per cent of every map's heights are wrong by 5 to 50 m: after fusion and filter the RMSE has grown by less
    than a tenth of the clean one."""
    truth = hills((200, 220))
    clean = truth + NUMBERS.normal(0, 0.2, (count,) + truth.shape)
    dirty = clean.copy()
    wrong = NUMBERS.uniform(size=dirty.shape) < 0.1
    dirty[wrong] += NUMBERS.uniform(5, 50, wrong.sum()) * NUMBERS.choice((-1, 1), wrong.sum())
    errors = []
    for stack in (clean, dirty):
        score = np.full(truth.shape, 0.9)
        stack = [remove_isolated_points(h, 1.0) for h in stack]
        found = aggregate([HeightLayer(h, score, np.full(truth.shape, np.nan), 1.0, 1.0) for h in stack], "mean", RIM)
        height = np.where(radius_outliers(found.height, 1.0, 3.0), np.nan, found.height)
        assert np.isfinite(height).mean() > 0.97
        errors.append(float(np.sqrt(np.nanmean((height - truth) ** 2))))
    # What is gone from a cell's mean leaves more noise there: with two maps, a fifth of the cells have one only.
    assert errors[1] < 1.1 * errors[0] + (0.02 if count == 2 else 0.0), errors


def edge():
    """A roof 20 m above the ground; three maps, of which the first two let it stick out by three and two columns."""
    truth = np.where(np.arange(SHAPE[1]) < 40, 120.0, 100.0) * np.ones(SHAPE)
    stack = np.stack([truth, truth, truth])
    stack[0][:, 40:43] = stack[1][:, 40:42] = 120.0
    return truth, stack + NUMBERS.normal(0, 0.05, stack.shape)


def test_what_speaks_against_the_widened_roof_is_the_second_candidate():
    """Matching widens what stands out: two maps are the first candidate, and the one that saw the ground the second."""
    truth, stack = edge()
    found = aggregate(layers(stack), "mean", RIM)
    widened = np.s_[:, 40:41]
    np.testing.assert_allclose(found.first.height[widened], 120.0, atol=0.3)
    np.testing.assert_allclose(found.second.height[widened], 100.0, atol=0.3)
    assert (found.first.count[widened] == 2).all() and (found.second.count[widened] == 1).all()
    # The step of the first map is three cells away, that of the second one two: it has half of the evidence.
    np.testing.assert_allclose(found.first.evidence[widened], 1.5)
    np.testing.assert_allclose(found.second.evidence[widened], 1.0)
    away = np.s_[:, 50:]
    assert np.isnan(found.second.height[away]).all() and np.abs(found.height - truth)[away].max() < 0.3


def test_one_map_beside_its_own_step_has_less_evidence_than_one_away_from_any():
    roof, ground = np.full(SHAPE, 100.0), np.full(SHAPE, 100.0)
    roof[:, :40] = 120.0
    ground[:, :20] = 120.0
    found = aggregate(layers([roof, ground]), "mean", RIM)
    np.testing.assert_allclose(found.height[:, 38:40], 100.0, atol=1e-4)  # within the rim of the first map's step
    np.testing.assert_allclose(found.second.height[:, 38:40], 120.0, atol=1e-4)


def test_backgrounds_fill_and_are_said():
    truth, stack = edge()
    stack[:, :, 45:48] = np.nan
    background = np.full(SHAPE, np.nan)
    background[:, 45:48] = 99.5
    found = aggregate(layers(stack, background=background), "mean", RIM)
    assert found.first.filled[:, 45:48].all() and found.first.filled.sum() == 3 * SHAPE[0]
    np.testing.assert_allclose(found.height[:, 45:48], 99.5, atol=1e-4)
    assert (found.first.count[:, 45:48] == 0).all() and np.isnan(found.first.score[:, 45:48]).all()
    plain = found.without_backgrounds()
    assert np.isnan(plain.height[:, 45:48]).all() and np.isfinite(plain.height).sum() == 77 * SHAPE[0]


def test_more_maps_are_better():
    """Noise and gaps: every further map lowers the error and fills holes."""
    errors, known = [], []
    truth = hills()
    stack = truth + NUMBERS.normal(0, 0.3, (6,) + SHAPE)
    stack[NUMBERS.uniform(size=stack.shape) < 0.1] = np.nan
    for count in range(1, 7):
        height = aggregate(layers(stack[:count], metres=2.0), "mean", RIM).height
        errors.append(float(np.sqrt(np.nanmean((height - truth) ** 2))))
        known.append(np.isfinite(height).sum())
    assert (np.diff(errors) < 0).all() and (np.diff(known) >= 0).all()


def test_nothing_stays_nothing():
    found = aggregate(layers(np.full((3,) + SHAPE, np.nan)), "median", RIM)
    assert np.isnan(found.height).all() and (found.first.count == 0).all() and np.isnan(found.first.score).all()


@pytest.mark.parametrize("cell, radius", ((0.5, 1.5), (1.0, 3.0), (0.3, 2.0), (2.0, 2.0)))
def test_lonely_cells_are_those_a_tree_finds(cell, radius):
    """Neighbours count within a radius on the ground and the same radius in height."""
    height = NUMBERS.uniform(0, 8, (60, 70))
    height[NUMBERS.uniform(size=height.shape) < 0.3] = np.nan
    found, needed = radius_outliers(height, cell, radius), needed_neighbours(cell, radius)
    rows, cols = np.nonzero(np.isfinite(height))
    places, z = np.column_stack([rows, cols]) * cell, height[rows, cols]
    counts = np.array(
        [
            (np.abs(z[near] - z[k]) <= radius).sum() - 1
            for k, near in enumerate(cKDTree(places).query_ball_point(places, radius + 1e-6))
        ]
    )
    steps = np.arange(-20, 21) * cell
    disc = (np.hypot(*np.meshgrid(steps, steps)) <= radius + 1e-6).sum() - 1
    assert needed == max(2, round(0.2 * disc))
    expected = np.zeros(height.shape, bool)
    expected[rows, cols] = counts < needed
    assert (found == expected).all() and found.sum() < len(rows)


def test_islands_go_and_surfaces_stay():
    height = np.full((50, 50), np.nan)
    height[5:45, 5:25] = 100 + np.arange(20) * 0.8  # a steep slope
    height[20, 40], height[30:32, 35:37] = 120.0, 90.0
    height[10, 10] = 160.0
    found, needed = radius_outliers(height, 1.0, 3.0), needed_neighbours(1.0, 3.0)
    # A disc of three cells holds 28; of a slope of 0.8, heights within 3 m are all of them.
    assert needed == 6
    assert found[20, 40] and found[30:32, 35:37].all() and found[10, 10]
    assert found[5:45, 5:25].sum() == 1


def test_what_a_cell_needs_does_not_depend_on_what_else_is_there():
    """The part of a surface that is asked for alone loses the same cells as in the whole, but at its own border."""
    height = np.where(NUMBERS.uniform(size=(80, 90)) < 0.33, 100.0, np.nan)
    whole = radius_outliers(height, 1.0, 3.0)
    part = radius_outliers(height[20:60, 30:70], 1.0, 3.0)
    np.testing.assert_array_equal(part[3:-3, 3:-3], whole[23:57, 33:67])
    assert not radius_outliers(np.full((80, 80), 100.0), 1.0, 3.0).any()


def test_a_map_that_brushes_a_cell_does_not_count_where_another_covers_it():
    """A roof's last pixels reach into cells of the street: 120 m over a fifth of the cell against 100 m over all."""
    roof, street = np.full(SHAPE, 120.0), np.full(SHAPE, 100.0)
    brushed, whole, nothing = np.ones(SHAPE, dtype=bool), np.zeros(SHAPE, dtype=bool), np.full(SHAPE, np.nan)
    high = HeightLayer(roof, np.full(SHAPE, 0.9), nothing, 1.0, 1.0, brushed)
    found = aggregate([high, HeightLayer(street, np.full(SHAPE, 0.9), nothing, 1.0, 1.0, whole)], "mean", RIM)
    np.testing.assert_allclose(found.height, 100.0)
    np.testing.assert_allclose(found.second.height, 120.0)
    # The background of an occlusion has less evidence than a match, but is not forgotten.
    found = aggregate([high, HeightLayer(nothing, nothing, street, 1.0, 1.0, whole, whole)], "mean", RIM)
    np.testing.assert_allclose(found.height, 120.0)
    np.testing.assert_allclose(found.second.height, 100.0)
    assert found.second.filled.all() and not found.first.filled.any()
    # Alone it is all there is.
    np.testing.assert_allclose(aggregate([high], "mean", RIM).height, 120.0)


def test_what_a_witness_objects_to():
    """Nothing against its own height, all of its evidence beyond 2.5 standard deviations, a quarter at half of that."""
    own, evidence, sigma = (np.full(4, value, np.float32) for value in (10.0, 0.5, 0.2))
    height = np.array([10.0, 10.25, 10.6, np.nan], np.float32)
    found = disagreement(height, own, evidence, sigma, FUSION.evidence)
    np.testing.assert_allclose(found, [0.0, 0.125, 0.5, 0.0], atol=1e-5)
    np.testing.assert_allclose(disagreement(own + 5, own * np.nan, evidence, sigma, FUSION.evidence), 0.0)


def test_the_rim_is_counted_in_pixels():
    assert rim_cells(0.5, 0.5) == 2 and rim_cells(2.0, 0.5) == 10 and rim_cells(0.3, 1.0) == 1


def test_the_order_of_maps_does_not_matter():
    _, stack = edge()
    forward, backward = (aggregate(layers(part), "mean", RIM) for part in (stack, stack[::-1]))
    np.testing.assert_allclose(forward.height, backward.height, atol=0.2)
    np.testing.assert_array_equal(forward.first.count, backward.first.count)


def test_a_pair_whose_images_are_less_alike_counts_less():
    def layer(height, alike):
        known = np.full((1, 3), height, np.float32)
        return HeightLayer(known, np.ones_like(known), np.full_like(known, np.nan), 1.0, 1.0, alike=alike)

    for heights in ((10.0, 20.0), (20.0, 10.0)):
        found = aggregate([layer(heights[0], 1.0), layer(heights[1], 0.5)], "mean", RIM, FUSION.evidence)
        np.testing.assert_allclose(found.first.height, heights[0])
        np.testing.assert_allclose(found.second.evidence / found.first.evidence, 0.25, rtol=1e-6)
