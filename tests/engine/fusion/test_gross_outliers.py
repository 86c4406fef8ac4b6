"""One height in ten grossly wrong: the fused surface stays within a tenth of the clean one's RMSE."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stereo.height_maps import write_height_map


def spoilt(scene_path, folder):
    """A copy of a scene whose height maps have a tenth of their matched heights 10 to 40 m too high or too low.

    Fills are made of the heights around them, and cannot be wrong alone.
    """
    scene, rng = Scene.load(scene_path), np.random.default_rng(1)
    tiles = []
    for tile in scene.tiles:
        records = []
        for record in tile.heights:
            path = os.path.join(folder, os.path.basename(record.file))
            height, score, filled = gdal.Open(record.file).ReadAsArray()
            wrong = (rng.random(height.shape) < 0.1) & (height > -9000) & (filled == 0)
            height[wrong] += (rng.uniform(10, 40, height.shape) * rng.choice([-1, 1], height.shape))[wrong]
            height, score = (np.where(values == -9999, np.float32(np.nan), values) for values in (height, score))
            records.append(write_height_map(path, "spoilt", record, height, score, filled > 0))
        tiles.append(replace(tile, heights=tuple(records)))
    return replace(scene, tiles=tuple(tiles)).save(os.path.join(folder, "spoilt.json"))


@pytest.mark.parametrize("pairs", ("all", "one"))
@pytest.mark.parametrize("kind", ("urban", "mountains"))
@pytest.mark.long
def test_the_surface_stays(request, tmp_path, told, capsys, kind, pairs):
    run = request.getfixturevalue(f"{kind}_run")
    scene = Scene.load(run.result.scene)
    if pairs == "one":
        scene = scene.with_tiles(lambda tile: replace(tile, heights=tile.heights[:1]))
    clean = scene.save(str(tmp_path / "clean.json"))
    found = []
    for path, name in ((clean, "clean"), (spoilt(clean, str(tmp_path)), "spoilt")):
        made = run_stage("dsmfuse", {"scene": path, "output": str(tmp_path / f"{name}.tif"), "resolution": 1.0}, told())
        found.append(run_stage("comparedsm", {"dsm": made.output, "reference": run.scene.truth, "align": "3d"}, told()))
    with capsys.disabled():
        print(
            f"\n{kind}, {pairs}: RMSE {found[0].rmse:.3f} m clean, {found[1].rmse:.3f} m spoilt; valid "
            f"{found[0].valid:.2f}, {found[1].valid:.2f} %"
        )
    assert found[1].rmse < 1.1 * found[0].rmse and found[1].valid > found[0].valid - 3
