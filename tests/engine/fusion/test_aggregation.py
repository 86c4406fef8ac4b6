"""Fusing cells against numpy's medians and known surfaces, and the radius filter against a k-d tree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from repm_qgis.fusion.aggregation import HeightLayer, aggregate
from repm_qgis.fusion.outliers import automatic_radius, radius_outliers

NUMBERS = np.random.default_rng(8)
SHAPE = (60, 80)


def layers(stack, scores=0.9, background=np.nan, metres=1.0):
    metres = np.broadcast_to(metres, len(stack))
    return [
        HeightLayer(height, np.broadcast_to(scores, SHAPE), np.broadcast_to(background, SHAPE), float(m))
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
    found = aggregate(layers(stack, 0.7, metres=10.0), method)
    known = np.isfinite(stack).any(axis=0)
    expected = np.full(SHAPE, np.nan)
    expected[known] = function(stack[:, known], axis=0)
    np.testing.assert_allclose(found.height, expected, atol=1e-4)
    assert (found.count == np.isfinite(stack).sum(axis=0)).all() and not found.filled.any()
    np.testing.assert_allclose(found.score[known], 0.7, atol=1e-6)
    several = found.count > 1
    np.testing.assert_allclose(found.spread[several], np.nanstd(stack[:, several], axis=0), atol=1e-4)
    assert np.isnan(found.spread[~several]).all()


def test_narrow_pairs_weigh_less():
    """Two maps: their mean, weighted by metres_per_px ** -0.5."""
    a, b = np.full(SHAPE, 100.0), np.full(SHAPE, 101.0)
    found = aggregate(layers([a, b], metres=(2.0, 8.0)), "mean")
    np.testing.assert_allclose(found.height, (100 / 2**0.5 + 101 / 8**0.5) / (2**-0.5 + 8**-0.5), rtol=1e-6)


@pytest.mark.parametrize("method", ("median", "mean"))
def test_outliers_are_thrown_out(method):
    truth = hills()
    stack = truth + NUMBERS.normal(0, 0.1, (6,) + SHAPE)
    wrong = NUMBERS.uniform(size=truth.shape) < 0.5
    stack[2][wrong] += 25.0
    stack[5][wrong] -= 60.0
    found = aggregate(layers(stack), method)
    assert np.abs(found.height - truth).max() < 0.3
    assert (found.count[wrong] == 4).all() and found.spread[wrong].max() < 0.5
    assert (found.count[~wrong] == 6).all()


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
        found = aggregate([HeightLayer(h, score, np.full(truth.shape, np.nan), 1.0) for h in stack], "mean")
        height = np.where(radius_outliers(found.height, 1.0, automatic_radius(1.0))[0], np.nan, found.height)
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


def test_at_a_step_the_lower_surface_wins():
    """Matching widens what stands out; the map that saw the ground beside the roof is right, though outvoted."""
    truth, stack = edge()
    found = aggregate(layers(stack), "mean")
    assert np.abs(found.height - truth).max() < 0.3 and (found.count[:, 40:42] == 1).all()


def test_a_low_height_of_a_bad_match_does_not_win():
    """The same heights, but the lower ones scored worse than nearly all that agree: a failed match."""
    truth, stack = edge()
    score = NUMBERS.uniform(0.8, 1.0, (3,) + SHAPE)
    score[2][:, 40:42] = 0.3
    found = aggregate([HeightLayer(h, s, np.full(SHAPE, np.nan), 1.0) for h, s in zip(stack, score)], "mean")
    assert (found.height[:, 40:42] > 119).all() and np.abs(found.height[:, 43:] - 100).max() < 0.3


def test_backgrounds_fill_and_are_said():
    truth, stack = edge()
    stack[:, :, 45:48] = np.nan
    background = np.full(SHAPE, np.nan)
    background[:, 45:48] = 99.5
    found = aggregate(layers(stack, background=background), "mean")
    assert found.filled[:, 45:48].all() and found.filled.sum() == 3 * SHAPE[0]
    np.testing.assert_allclose(found.height[:, 45:48], 99.5, atol=1e-4)
    assert (found.count[:, 45:48] == 0).all() and np.isnan(found.score[:, 45:48]).all()


@pytest.mark.parametrize("right, expected", ((True, 100.0), (False, 120.0)))
def test_backgrounds_count_where_others_confirm_them(right, expected):
    """A single match on high against two backgrounds: they win in a scene whose backgrounds are mostly confirmed."""
    truth, stack = edge()
    background = np.full((3,) + SHAPE, np.nan)
    stack[1:, 20:40, 50:53], background[1:, 20:40, 50:53] = np.nan, 100.0
    stack[0, 20:40, 50:53] = 120.0
    stack[2, :, :25], background[2, :, :25] = np.nan, 120.0 if right else 90.0
    found = aggregate([HeightLayer(h, np.full(SHAPE, 0.9), b, 1.0) for h, b in zip(stack, background)], "mean")
    np.testing.assert_allclose(found.height[20:40, 50:53], expected, atol=0.3)
    assert found.filled[20:40, 50:53].all() == right


def test_more_maps_are_better():
    """Noise and gaps: every further map lowers the error and fills holes."""
    errors, known = [], []
    truth = hills()
    stack = truth + NUMBERS.normal(0, 0.3, (6,) + SHAPE)
    stack[NUMBERS.uniform(size=stack.shape) < 0.1] = np.nan
    for count in range(1, 7):
        height = aggregate(layers(stack[:count], metres=2.0), "mean").height
        errors.append(float(np.sqrt(np.nanmean((height - truth) ** 2))))
        known.append(np.isfinite(height).sum())
    assert (np.diff(errors) < 0).all() and (np.diff(known) >= 0).all()


def test_nothing_stays_nothing():
    found = aggregate(layers(np.full((3,) + SHAPE, np.nan)), "median")
    assert np.isnan(found.height).all() and (found.count == 0).all() and np.isnan(found.score).all()


@pytest.mark.parametrize("cell, radius", ((0.5, 1.5), (1.0, 3.0), (0.3, 2.0), (2.0, 2.0)))
def test_lonely_cells_are_those_a_tree_finds(cell, radius):
    """Neighbours count within a radius on the ground and the same radius in height."""
    height = NUMBERS.uniform(0, 8, (60, 70))
    height[NUMBERS.uniform(size=height.shape) < 0.3] = np.nan
    found, needed = radius_outliers(height, cell, radius)
    rows, cols = np.nonzero(np.isfinite(height))
    places, z = np.column_stack([rows, cols]) * cell, height[rows, cols]
    counts = np.array(
        [
            (np.abs(z[near] - z[k]) <= radius).sum() - 1
            for k, near in enumerate(cKDTree(places).query_ball_point(places, radius + 1e-6))
        ]
    )
    assert needed == max(2, round(0.2 * np.median(counts)))
    expected = np.zeros(height.shape, bool)
    expected[rows, cols] = counts < needed
    assert (found == expected).all() and found.sum() < len(rows)


def test_islands_go_and_surfaces_stay():
    height = np.full((50, 50), np.nan)
    height[5:45, 5:25] = 100 + np.arange(20) * 0.8  # a steep slope
    height[20, 40], height[30:32, 35:37] = 120.0, 90.0
    height[10, 10] = 160.0
    found, needed = radius_outliers(height, 1.0, automatic_radius(1.0))
    # A disc of three cells holds 28; of a slope of 0.8, heights within 3 m are all of them.
    assert needed == 6
    assert found[20, 40] and found[30:32, 35:37].all() and found[10, 10]
    assert found[5:45, 5:25].sum() == 1


def test_sparse_points_are_asked_for_less():
    """Where a third of the cells has a height, a cell needs a third of the neighbours."""
    dense = np.full((80, 80), 100.0)
    sparse = np.where(NUMBERS.uniform(size=dense.shape) < 0.33, dense, np.nan)
    assert radius_outliers(dense, 1.0, 3.0)[1] == 6 and radius_outliers(sparse, 1.0, 3.0)[1] == 2
    assert not radius_outliers(dense, 1.0, 3.0)[0].any() and radius_outliers(sparse, 1.0, 3.0)[0].sum() < 10


def test_the_automatic_radius():
    assert automatic_radius(0.3) == 1.5 and automatic_radius(1.0) == 3.0
    assert automatic_radius(0.5, 2.0) == 6.0


def test_a_map_that_brushes_a_cell_does_not_count_where_another_covers_it():
    """A roof's last pixels reach into cells of the street: 120 m over a fifth of the cell against 100 m over all."""
    roof, street = np.full(SHAPE, 120.0), np.full(SHAPE, 100.0)
    brushed, whole, nothing = np.ones(SHAPE, dtype=bool), np.zeros(SHAPE, dtype=bool), np.full(SHAPE, np.nan)
    high = HeightLayer(roof, np.full(SHAPE, 0.9), nothing, 1.0, brushed)
    for low in (
        HeightLayer(street, np.full(SHAPE, 0.9), nothing, 1.0, whole),
        HeightLayer(nothing, nothing, street, 1.0, whole, whole),
    ):
        found = aggregate([high, low], "mean")
        np.testing.assert_allclose(found.height, 100.0)
        assert found.filled.all() == np.isnan(low.height).all()
    # Alone it is all there is.
    np.testing.assert_allclose(aggregate([high], "mean").height, 120.0)


def test_a_background_does_not_outvote_a_match_that_another_background_confirms():
    truth, stack = edge()
    place = np.s_[20:40, 50:53]
    background = np.full((3,) + SHAPE, np.nan)
    stack[2, :, :25], background[2, :, :25] = np.nan, 120.0  # confirmed by the other two
    stack[1:][(slice(None),) + place] = np.nan
    stack[0][place], background[1][place], background[2][place] = 120.0, 120.0, 100.0
    found = aggregate([HeightLayer(h, np.full(SHAPE, 0.9), b, 1.0) for h, b in zip(stack, background)], "mean")
    np.testing.assert_allclose(found.height[place], 120.0, atol=0.3)
    assert not found.filled[place].any()


@pytest.mark.parametrize("step, expected", ((6.0, 100.0), (20.0, 120.0)))
def test_the_finer_pair_decides_on_steps_that_others_cannot_see(step, expected):
    """A match and a background of pairs of 5 m a px against the background of one of 2 m a px: they see no step of 6 m,
    but one of 20 m."""
    truth, stack = edge()
    place = np.s_[20:40, 50:53]
    background = np.full((3,) + SHAPE, np.nan)
    stack[0, :, :25], background[0, :, :25] = np.nan, 120.0
    stack[0][place], background[0][place] = np.nan, 100.0
    stack[2][place] = np.nan
    stack[1][place] = background[2][place] = 100.0 + step
    metres = (2.0, 5.0, 5.0)
    found = aggregate([HeightLayer(h, np.full(SHAPE, 0.9), b, m) for h, b, m in zip(stack, background, metres)], "mean")
    np.testing.assert_allclose(found.height[place], expected, atol=0.3)
