"""Offsets of many DSMs, solved together."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from repm_qgis.mosaic.offsets import Overlap, solve_offsets

TRUE = np.array([1.5, -2.0, 0.25, 2.75, -1.0, -1.5])  # what is to be added; their mean is zero


def overlap(first, second, wrong=0.0, cells=10_000, nmad=0.2):
    return Overlap(first, second, cells, TRUE[second] - TRUE[first] + wrong, nmad)


CHAIN = [overlap(i, i + 1) for i in range(5)]
ALL = [overlap(i, j) for i, j in combinations(range(6), 2)]


@pytest.mark.parametrize("overlaps", (CHAIN, ALL))
def test_offsets_are_found_up_to_their_mean(overlaps):
    found = solve_offsets(6, overlaps, ())
    assert found.added == pytest.approx(TRUE, abs=1e-9)
    assert all(abs(each.after(found.added)) < 1e-9 for each in overlaps)
    assert found.groups == ((0, 1, 2, 3, 4, 5),) and found.anchored == (False,)


def test_fixed_dsms_stay_and_the_others_come_to_them():
    found = solve_offsets(6, CHAIN, (2,))
    assert found.added == pytest.approx(TRUE - TRUE[2], abs=1e-9) and found.deviation[2] == 0
    two = solve_offsets(6, [overlap(0, 1), overlap(1, 2, wrong=0.4)], (0, 2))
    assert two.added[[0, 2]].tolist() == [0, 0] and two.anchored[0]
    assert two.added[1] == pytest.approx(((TRUE[1] - TRUE[0]) + (TRUE[1] - TRUE[2] - 0.4)) / 2)


def test_deviations_are_those_of_a_chain():
    """From a fixed DSM on, the variances of the overlaps add up."""
    found = solve_offsets(6, CHAIN, (0,))
    each = 1.2533 * 0.2 / np.sqrt(10_000 / 25)
    assert found.deviation == pytest.approx(each * np.sqrt(np.arange(6)))
    free = solve_offsets(2, [overlap(0, 1)], ())
    assert free.deviation == pytest.approx([each / 2, each / 2])  # half of the difference each


def test_large_and_quiet_overlaps_count_for_more():
    both = [overlap(0, 1), overlap(0, 1, wrong=1.0, cells=100, nmad=2.0)]
    assert solve_offsets(2, both, (0,)).added[1] == pytest.approx(TRUE[1] - TRUE[0], abs=0.01)


def test_an_overlap_that_contradicts_the_others_loses_its_weight():
    spoiled = [overlap(0, 1, wrong=8.0), *ALL[1:]]
    away = np.abs(solve_offsets(6, spoiled, ()).added - TRUE)
    assert away.max() < 0.05  # equal weights would leave 1.3 m
    assert solve_offsets(6, spoiled, ()).deviation.min() > solve_offsets(6, ALL, ()).deviation.max()


def test_groups_that_do_not_overlap_are_solved_for_themselves():
    found = solve_offsets(6, [overlap(0, 1), overlap(2, 4)], (4,))
    assert found.groups == ((0, 1), (2, 4), (3,), (5,)) and found.anchored == (False, True, False, False)
    half = (TRUE[0] - TRUE[1]) / 2
    assert found.added == pytest.approx([half, -half, TRUE[2] - TRUE[4], 0, 0, 0])
