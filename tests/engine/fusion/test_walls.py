"""Whether a scene has walls."""

from __future__ import annotations

from dataclasses import replace

import pytest

from repm_qgis.fusion.walls import has_walls
from repm_qgis.scene import Scene


@pytest.mark.parametrize("kind, expected", (("urban", True), ("mountains", False)))
def test_towns_have_walls_and_mountains_have_none(request, kind, expected):
    scene = Scene.load(request.getfixturevalue(f"{kind}_run").result["scene"])
    assert has_walls(scene) is expected


def test_a_scene_without_maps_has_none(urban_run):
    scene = Scene.load(urban_run.result["scene"])
    assert has_walls(scene.with_tiles(lambda tile: replace(tile, heights=()))) is False
