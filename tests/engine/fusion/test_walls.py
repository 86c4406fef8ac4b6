"""Whether a scene has walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from repm_qgis.fusion import walls
from repm_qgis.fusion.walls import has_walls
from repm_qgis.scene import Scene
from repm_qgis.stereo.height_maps import write_height_map


@pytest.mark.parametrize("kind, expected", (("urban", True), ("mountains", False)))
def test_towns_have_walls_and_mountains_have_none(request, kind, expected):
    scene = Scene.load(request.getfixturevalue(f"{kind}_run").result.scene)
    assert has_walls(scene) is expected


def test_pixels_wider_than_a_neighbourhood_show_no_walls(urban_run):
    """A height is chosen among neighbours within 1.5 m, of which such a pixel has none; ridges of a mountain of which
    three-line images have pixels of 2.1 m were taken for walls, and lost 1.5 m of RMSE (tiles of 1000 px)."""
    scene = Scene.load(urban_run.result.scene)
    scenes = [replace(scene, views=tuple(replace(view, gsd_m=gsd) for view in scene.views)) for gsd in (1.4, 1.6, 2.1)]
    assert [has_walls(each) for each in scenes] == [True, False, False]


def test_a_scene_without_maps_has_none(urban_run):
    scene = Scene.load(urban_run.result.scene)
    assert has_walls(scene.with_tiles(lambda tile: replace(tile, heights=()))) is False


@pytest.mark.parametrize("kind, expected", (("urban", True), ("mountains", False)))
def test_each_map_alone_says_the_same(request, kind, expected):
    scene = Scene.load(request.getfixturevalue(f"{kind}_run").result.scene)
    alone = [
        has_walls(replace(scene, tiles=(replace(tile, heights=(record,)),)))
        for tile in scene.tiles
        for record in tile.heights
    ]
    assert len(alone) >= 3 and alone == [expected] * len(alone)


@pytest.mark.parametrize("kind, expected", (("noise", False), ("blocks", True), ("spoilt", False), ("empty", False)))
def test_walls_are_what_planes_end_at_and_neither_noise_nor_gross_errors(urban_run, tmp_path, kind, expected):
    scene, rng, shape = Scene.load(urban_run.result.scene), np.random.default_rng(3), (300, 300)
    height = np.full(shape, np.nan) if kind == "empty" else 150 + rng.normal(0, 0.2, shape)
    if kind == "blocks":
        height[60:140, 60:140] += 20.0
        height[180:240, 100:220] += 15.0
    if kind == "spoilt":
        wrong = rng.uniform(size=shape) < 0.1
        height[wrong] += rng.uniform(10, 40, wrong.sum()) * rng.choice((-1, 1), wrong.sum())
    parts = height.astype(np.float32), np.ones(shape, np.float32), np.zeros(shape, bool)
    record = write_height_map(str(tmp_path / "map.tif"), kind, scene.tiles[0].heights[0], *parts)
    assert has_walls(replace(scene, tiles=(replace(scene.tiles[0], heights=(record,)),))) is expected


def test_no_more_than_nine_maps_are_asked(urban_run, monkeypatch):
    """The time does not grow with the scene; which they are is spread over it."""
    asked, tail = [], walls._tail
    monkeypatch.setattr(walls, "_tail", lambda record, *rest: asked.append(record.file) or tail(record, *rest))
    scene = Scene.load(urban_run.result.scene)
    assert sum(len(tile.heights) for tile in scene.tiles) == 12
    has_walls(scene)
    files = [record.file for tile in scene.tiles for record in tile.heights]
    assert asked == files[::2]
