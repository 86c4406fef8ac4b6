"""Ties where it is hard: equal roofs within the search range, shadows of other hours, fields of other seasons."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import hard_scenes
from benchmarks.pointing_case import Case, pointed, shift_of, write_image
from repm_qgis.simulation.scene import SceneSpec, make_views, surface_bounds

POINTINGS = [shift_of(9.0, -7.0), shift_of(-6.0, 8.0)]


@pytest.fixture(scope="module")
def spec():
    return SceneSpec.default("urban", 480, 4)


def case_of(spec, surfaces, folder):
    hard_scenes.write_scene(folder / "base", spec, surfaces, lambda path, pixels: write_image(path, pixels, {}))
    return Case((spec, folder / "base"), POINTINGS, folder / "case")


def left(case):
    found = pointed(case.scene(), model="shift")
    return len(found.tracks), float(case.observable_px(found.adjusted.pointing).max())


@pytest.mark.slow
def test_equal_roofs_on_a_grid_are_not_taken_for_each_other(spec, tmp_path):
    surface = hard_scenes.estate(surface_bounds(spec, make_views(spec)), spec, (18.0, 24.0), -11.0, 0.3, 0.016)
    case = case_of(spec, [surface] * 2, tmp_path)
    assert json.loads((tmp_path / "base" / "truth.json").read_text())["height_range_m"][1] < 220
    ties, error = left(case)
    assert ties >= 30 and error < 0.15


@pytest.mark.slow
def test_shadows_moved_by_hours(spec, tmp_path):
    surfaces = [hard_scenes.town_under(spec, sun) for sun in (spec.sun, hard_scenes.MORNING)]
    np.testing.assert_array_equal(surfaces[0].height, surfaces[1].height)
    moved = np.abs(surfaces[0].radiance - surfaces[1].radiance) > 100
    assert moved.mean() > 0.3
    ties, error = left(case_of(spec, surfaces, tmp_path))
    assert ties >= 25 and error < 0.15


@pytest.mark.long
def test_another_season(spec, tmp_path):
    plain = hard_scenes.town_under(spec, spec.sun)
    changed = hard_scenes.another_season(plain, 1)
    mean = [s.radiance - s.radiance.mean() for s in (plain, changed)]
    correlation = float((mean[0] * mean[1]).mean() / (mean[0].std() * mean[1].std()))
    assert correlation < 0.7
    ties, error = left(case_of(spec, [plain, changed], tmp_path))
    assert ties >= 25 and error < 0.15
