"""Which DSM a cell has its height from, and how neighbouring ones change into each other."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Window
from repm_qgis.mosaic.parameters import MOSAIC
from repm_qgis.mosaic.seams import mosaicked, reach

SIZE = (120, 200)
SEAMS = MOSAIC.seams
LEFT, RIGHT = np.s_[:, :140], np.s_[:, 60:]  # what each DSM covers: the seam is at column 100


def two(first, second, error=0.1):
    """A mosaic of two stacked DSMs, the first on the left."""
    heights = np.full((2, *SIZE), np.nan, np.float32)
    heights[0][LEFT], heights[1][RIGHT] = first[LEFT], second[RIGHT]
    errors = np.full(heights.shape, error, np.float32)
    columns = np.broadcast_to(np.arange(SIZE[1], dtype=np.float32), SIZE)
    interior = np.stack([np.maximum(138 - columns, 0), np.maximum(columns - 61, 0)])
    return mosaicked(heights, errors, interior, Window(0, 0, SIZE[1], SIZE[0]), SEAMS)


def flat(height=0.0):
    return np.full(SIZE, height, np.float32)


def test_the_seam_lies_in_the_middle_and_a_difference_is_spread_over_it():
    made = two(flat(0.0), flat(0.1))
    assert set(made.source[:, 98].tolist()) == {0} and set(made.source[:, 101].tolist()) == {1}
    assert np.abs(np.diff(made.height, axis=1)).max() < 0.012  # not 0.1 at once
    assert made.height[:, :85] == pytest.approx(0.0) and made.height[:, 115:] == pytest.approx(0.1)
    assert np.median(made.steps) == pytest.approx(0.1)
    assert made.count[0, 0] == 1 and made.count[0, 100] == 2
    assert np.isnan(made.spread[0, 0]) and made.spread[0, 100] == pytest.approx(0.05)


def test_what_both_show_differently_is_not_averaged():
    """Beyond the tolerance (2.5 expected errors) each cell has the height of one DSM."""
    made = two(flat(0.0), flat(1.0))
    assert set(np.unique(made.height).tolist()) == {0.0, 1.0}


@pytest.mark.parametrize("columns", (slice(88, 108), slice(92, 112)))
def test_seams_go_around_an_object(columns):
    """A tree that the DSMs show at different heights comes from one of them as a whole, the one that has more of it."""
    first, second = flat(), flat()
    first[40:60, columns], second[40:60, columns] = 5.0, 7.0
    made = two(first, second)
    assert set(made.height[40:60, columns].ravel().tolist()) == {5.0 if columns.start == 88 else 7.0}
    assert set(made.source[20].tolist()) == {0, 1} and made.source[20, 99] == 0  # elsewhere the seam is where it was


def test_the_better_dsm_has_more_cells():
    heights, interior = np.zeros((2, *SIZE), np.float32), np.full((2, *SIZE), 50.0, np.float32)
    errors = np.stack([np.full(SIZE, 0.4, np.float32), np.full(SIZE, 0.1, np.float32)])
    made = mosaicked(heights, errors, interior, Window(0, 0, SIZE[1], SIZE[0]), SEAMS)
    assert (made.source == 1).all()


def test_holes_are_filled_by_the_other_dsm_and_stay_where_none_has_a_height():
    first, second = flat(0.0), flat(0.05)
    first[50:70, 70:90] = np.nan  # the second one has heights there
    first[10:15, 10:15] = np.nan
    made = two(first, second)
    assert np.isfinite(made.height[50:70, 70:90]).all() and (made.source[55:65, 75:85] == 1).all()
    assert np.abs(np.diff(made.height[60, 60:100])).max() < 0.02
    assert np.isnan(made.height[10:15, 10:15]).all() and (made.source[10:15, 10:15] == -1).all()
    assert np.isfinite(made.height).sum() == made.height.size - 25


def test_a_cell_depends_on_nothing_beyond_the_reach():
    rng = np.random.default_rng(3)
    size = (2 * reach() + 60, 2 * reach() + 60)
    stack = rng.normal(0, 0.3, (3, *size)).astype(np.float32)
    stack[rng.random(stack.shape) < 0.03] = np.nan
    stack[0, :, 120:], stack[1, :, :80], stack[2, :90] = np.nan, np.nan, np.nan
    errors = rng.uniform(0.05, 0.2, stack.shape).astype(np.float32)
    interior = np.zeros(stack.shape, np.float32)
    own = Window(reach(), reach(), 60, 60)
    before = mosaicked(stack, errors, interior, own, SEAMS)
    wide = [np.pad(a, ((0, 0), (40, 40), (40, 40)), mode="reflect") for a in (stack, errors, interior)]
    after = mosaicked(*wide, Window(own.col + 40, own.row + 40, 60, 60), SEAMS)
    assert (before.source == after.source).all()
    assert before.height == pytest.approx(after.height, abs=1e-6, nan_ok=True)
