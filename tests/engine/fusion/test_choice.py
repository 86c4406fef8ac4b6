"""One height for each cell: surfaces whose truth is known, seen by one map that is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.fusion.aggregation import Candidate, FusedCells
from repm_qgis.fusion.choice import Problem, chosen, reach_cells
from repm_qgis.fusion.parameters import FUSION

CELL, GROUND, ROOF = 0.5, 20.0, 30.0
SHAPE = (70, 80)
HOUSE, STRIP, SHADOW = np.s_[20:45, 20:50], np.s_[14:20, 20:50], np.s_[4:20, 14:56]
NUMBERS = np.random.default_rng(3)
BRIGHT, LIT, DARK = 0.9, 0.5, 0.1


def one_map(height, evidence=1.0):
    """What a single map says; NaN: nothing."""
    height = np.asarray(height, np.float32)
    known = np.isfinite(height)
    parts = (np.where(known, evidence, 0), np.where(known, 0.2, np.nan), known, np.full(SHAPE, np.nan), known * 0.9)
    first = Candidate(height, *(np.broadcast_to(part, height.shape).astype(np.float32) for part in parts))
    return FusedCells(first, Candidate.none(height.shape), first.evidence)


def decided(height, brightness, ground=None, **changes):
    ground = np.full(np.shape(height), np.nan, np.float32) if ground is None else ground
    parameters = replace(FUSION.choice, **changes)
    brightness = np.asarray(brightness, np.float32)
    return chosen(Problem(one_map(height), ground, brightness, CELL, FUSION.evidence, parameters))


def town():
    height = np.full(SHAPE, GROUND, np.float32)
    height[HOUSE] = ROOF
    return height


def images(roof=BRIGHT):
    """A roof, with a shadow to its north, in images with some noise."""
    light = np.full(SHAPE, LIT, np.float32)
    light[SHADOW] = DARK
    light[HOUSE] = roof
    return light + NUMBERS.normal(0, 0.01, SHAPE).astype(np.float32)


def test_a_roof_that_matching_continued_into_its_shadow_ends_where_the_images_show_its_edge():
    wrong = town()
    wrong[STRIP] = ROOF  # three metres
    found = decided(wrong, images())
    assert (np.abs(found - town()) < 0.1).mean() > 0.995
    assert (found[STRIP] == GROUND).mean() > 0.9 and (found[HOUSE] == ROOF).mean() > 0.99


def test_without_what_cells_look_like_the_roof_stays_too_wide():
    wrong = town()
    wrong[STRIP] = ROOF
    assert (decided(wrong, images(), appearance=0.0)[STRIP] == ROOF).mean() > 0.5


def test_a_roof_as_dark_as_the_ground_keeps_its_edges_and_loses_no_more_than_the_tips_of_its_corners():
    """Images that do not show an edge do not move it; a corner of 90 degrees loses three square metres."""
    found = decided(town(), np.full(SHAPE, DARK))
    lost = found != town()
    assert lost.sum() <= 4 * 12
    assert not lost[:, 26:44].any() and not lost[26:39].any()


def test_a_stray_takes_the_height_of_the_cells_around_it():
    wrong = town()
    wrong[30, 30], wrong[60, 60], wrong[61, 60] = 45.0, 12.0, 12.0
    np.testing.assert_array_equal(decided(wrong, images()), town())


def test_what_several_maps_agree_on_stays_where_one_would_not():
    small = town()
    small[60:62, 60:62] = GROUND + 4.0  # a kiosk of a square metre, as bright as the ground
    fused = one_map(small)
    many = replace(fused.first, evidence=fused.first.evidence * 400, count=fused.first.count * 400)
    nothing, light = np.full(SHAPE, np.nan, np.float32), images()
    found = [
        chosen(Problem(each, nothing, light, CELL)) for each in (fused, FusedCells(many, fused.second, many.evidence))
    ]
    assert (found[0][60:62, 60:62] == GROUND).all() and (found[1][60:62, 60:62] == GROUND + 4.0).all()


def hills(steepness):
    rows, columns = np.indices(SHAPE)
    return (100 + steepness * (4 * np.sin(columns / 9.0) + 3 * np.cos(rows / 7.0))).astype(np.float32)


def test_gentle_relief_stays_to_the_byte():
    np.testing.assert_array_equal(decided(hills(0.2), images()), hills(0.2))


def test_steep_relief_beside_edges_of_brightness_hardly_moves():
    """Slopes up to 0.9 m a metre, where what is alike lies on one side of a cell: few cells follow it, none of them
    farther than what counts as another surface."""
    away = np.abs(decided(hills(0.5), images()) - hills(0.5))
    assert away.max() < 1.0 and (away > 0.5).mean() < 0.005 and np.sqrt((away**2).mean()) < 0.1


def test_the_ground_of_shadows_is_taken_where_there_is_nothing_else():
    holed = town()
    holed[SHADOW] = np.nan
    ground = np.full(SHAPE, np.nan, np.float32)
    ground[SHADOW] = GROUND
    np.testing.assert_array_equal(decided(holed, images(), ground), town())
    assert np.isnan(decided(holed, images())[SHADOW]).all()


def test_a_doubted_part_of_a_roof_in_a_shadow_stays_on_the_roof():
    """The ground of the shadow is no more than a candidate there."""
    ground = np.full(SHAPE, np.nan, np.float32)
    ground[30:32, 30:36] = GROUND
    np.testing.assert_array_equal(decided(town(), images(), ground), town())


def test_nothing_stays_nothing():
    assert np.isnan(decided(np.full(SHAPE, np.nan), images())).all()


@pytest.mark.long
def test_a_part_is_decided_as_in_the_whole():
    """Rough heights, rough images: inside the reach of all sweeps the same bytes."""
    shape, halo = (260, 270), reach_cells(CELL)
    height = np.where(NUMBERS.uniform(size=shape) < 0.4, ROOF, GROUND) + NUMBERS.normal(0, 0.3, shape)
    light = NUMBERS.uniform(0, 1, shape).astype(np.float32)
    evidence = NUMBERS.uniform(0.1, 1, shape)
    height[NUMBERS.uniform(size=shape) < 0.1] = np.nan

    def solved(cells):
        first = one_map_of(height[cells], evidence[cells])
        nothing = np.full(first.height.shape, np.nan, np.float32)
        return chosen(Problem(first, nothing, light[cells], CELL))

    whole = solved(np.s_[:, :])
    for window in (np.s_[100:160, 90:170], np.s_[97:150, 101:143]):
        wide = tuple(slice(part.start - halo, part.stop + halo) for part in window)
        assert all(part.start >= 0 and part.stop <= side for part, side in zip(wide, shape))
        inner = tuple(slice(halo, halo + side.stop - side.start) for side in window)
        assert (whole != height.astype(np.float32))[window].mean() > 0.1
        np.testing.assert_array_equal(solved(wide)[inner], whole[window])


def one_map_of(height, evidence):
    height = height.astype(np.float32)
    known = np.isfinite(height)
    parts = (np.where(known, evidence, 0), np.where(known, 0.2, np.nan), known, height * np.nan, known * 0.9)
    first = Candidate(height, *(part.astype(np.float32) for part in parts))
    return FusedCells(first, Candidate.none(height.shape), first.evidence)
