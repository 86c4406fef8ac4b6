"""Where ties are searched: the places of a cell, and the part of an image that shows one of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.ties import tie_patches
from repm_qgis.ties.parameters import TIES
from repm_qgis.ties.tie_patches import _places, texture_of

PATCHES = TIES.patches


def test_places_lie_evenly_and_the_middle_one_comes_first():
    found = _places(np.array([1000.0, 2000.0]), np.array([900.0, 300.0]), 300.0, 6)
    assert found[0] == Bounds(1300.0, 2000.0, 1600.0, 2300.0) and len(found) == 3
    assert {place.xmin for place in found} == {1000.0, 1300.0, 1600.0}
    many = _places(np.array([0.0, 0.0]), np.array([900.0, 900.0]), 100.0, 4)
    assert len(many) == 16 and sorted({place.xmin for place in many}) == pytest.approx([0.0, 800 / 3, 1600 / 3, 800.0])
    middles = [np.hypot(place.xmin + 50 - 450, place.ymin + 50 - 450) for place in many]
    assert middles == sorted(middles)
    assert _places(np.array([0.0, 0.0]), np.array([80.0, 50.0]), 100.0, 4) == [Bounds(0.0, 0.0, 80.0, 50.0)]
    assert len(_places(np.array([0.0, 0.0]), np.array([101.0, 50.0]), 100.0, 4)) == 2


def test_of_a_cells_places_the_one_with_the_best_texture_comes_first(urban_run):
    scene = Scene.load(urban_run.result.scene)
    small = replace(PATCHES, whole_px=0, least_px=60, most_px=60)

    def texture(place):
        return place.xmin - 2.0 * place.ymin

    cells = tie_patches.ranked_patches(scene, texture, Silent(), small)
    assert any(len(places) > 2 for places in cells)
    for places in cells:
        values = [texture(place) for place in places]
        assert values == sorted(values, reverse=True)


def test_the_texture_is_that_of_the_middle_half(urban_run, monkeypatch):
    """Of half of the place's side, around its middle, in each view; read at half the resolution."""
    scene = Scene.load(urban_run.result.scene)
    x0, y0, x1, y1 = scene.tiles[0].bounds
    middle, side = np.array([(x0 + x1) / 2, (y0 + y1) / 2]), 60.0
    place = Bounds(*(middle - side / 2), *(middle + side / 2))
    ground = np.append(geodetic_from_projected(scene.crs, middle[None])[0], sum(scene.altitudes) / 2)
    asked, last = [], tie_patches.read

    def read(dataset, window, band, size):
        asked.append((window, size))
        return last(dataset, window, band, size)

    monkeypatch.setattr(tie_patches, "read", read)
    stretches = {view.name: view.stretch() for view in scene.views}
    whole = texture_of(scene, stretches, place, PATCHES)
    assert whole > 0 and len(asked) == len(scene.views)
    for view, (window, size) in zip(scene.views, asked):
        assert abs(window.width - 0.5 * side / view.gsd_m) <= 1 and window.width == window.height
        at = np.array([window.col, window.row]) + np.array([window.width, window.height]) / 2
        assert at == pytest.approx(view.project(ground), abs=1.0)
        assert size == (window.width // 2, window.height // 2)
    # A view that does not show the place halves the value; one view alone says nothing.
    away = replace(scene.views[2], rpc=scene.views[2].rpc.shifted(5000.0, 0.0))
    fewer = replace(scene, views=(*scene.views[:2], away))
    two = texture_of(scene, dict(list(stretches.items())[:2]), place, PATCHES)
    assert texture_of(fewer, stretches, place, PATCHES) == pytest.approx(PATCHES.missed_weight * two)
    assert texture_of(scene, dict(list(stretches.items())[:1]), place, PATCHES) == 0.0
