"""Terrain feedback: the coarse level's surface against the true one, and a whole run that refines on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.imagery.sampling import sample
from repm_qgis.matching import sgm
from repm_qgis.matching.coarse_surface import coarse_surface
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from repm_qgis.ties.tie_patches import covered_by_ties


def true_heights(scene, x, y):
    """True heights at places of the scene's CRS; NaN outside the true DSM."""
    west, cell, _, north, _, _ = scene.transform
    return sample(scene.surface, (x - west) / cell - 0.5, (north - y) / cell - 0.5)


def true_range(scene, bounds):
    x, y = np.meshgrid(np.linspace(bounds[0], bounds[2], 60), np.linspace(bounds[1], bounds[3], 60))
    heights = true_heights(scene, x, y)
    return np.nanmin(heights), np.nanmax(heights)


@pytest.fixture(scope="module")
def terrain_run(mountains, pipeline, tmp_path_factory):
    return pipeline(
        mountains, tmp_path_factory.mktemp("terrain"), resolution=1.0, tile_size=256, model="terrain", workers=2
    )


def test_the_coarse_surface_is_the_ground(mountains, mountains_run, told):
    scene = Scene.load(mountains_run.result.scene)
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    pairs = [("img_01", "img_02"), ("img_02", "img_03"), ("img_01", "img_03")]
    found = coarse_surface(scene, pairs, stretches, match=sgm.match, workers=1, progress=told())
    x, y = np.meshgrid(*found.grid.centres())
    error = found.height - true_heights(mountains, x, y)
    assert np.isfinite(error).sum() > 0.9 * np.isfinite(true_heights(mountains, x, y)).sum()
    error -= np.nanmedian(error)
    # Cells of 16 m on slopes of 30 degrees, where a px of disparity means 17 m and more.
    assert np.nanmedian(np.abs(error)) < 5 and np.nanpercentile(np.abs(error), 98) < 20
    west, south, east, north = mountains.bounds
    low, high = true_range(mountains, mountains.bounds)
    said = found.altitudes((west, south, east, north))
    # Pointing without control moves the whole by some metres.
    assert low - 60 < said[0] < low + 5 and high - 5 < said[1] < high + 60
    assert found.altitudes((west - 5000, south, west - 4000, north)) is None


@pytest.mark.long
def test_tiles_that_ties_do_not_cover_get_their_altitudes_from_the_surface(mountains, told, tmp_path):
    """Parameters that search the small scene in patches, as a large one: its ties do not cover the tiles."""
    patches = replace(ENGINE.pointing.ties.patches, whole_px=150, least_px=130, most_px=130)
    ties = replace(ENGINE.pointing.ties, patches=patches)
    parameters = replace(ENGINE, pointing=replace(ENGINE.pointing, ties=ties))
    fitted = run_stage("epmfit", {"images": mountains.images, "workspace": str(tmp_path), "tile_size": 256}, told())
    made = run_stage(
        "reconstruct",
        {"scene": fitted.scene, "output_scene": str(tmp_path / "r.json"), "workers": 1},
        told(),
        parameters,
    )
    scene = Scene.load(made.output_scene)
    assert not covered_by_ties(scene, patches) and scene.refinement == "polynomial" and len(scene.tiles) >= 4
    spans = []
    for tile in scene.tiles:
        low, high = true_range(mountains, tile.bounds)
        assert tile.altitudes[0] < low and tile.altitudes[1] > high
        spans.append(tile.altitudes[1] - tile.altitudes[0])
    assert min(spans) < scene.altitudes[1] - scene.altitudes[0]


@pytest.mark.slow
def test_a_run_refines_on_its_own_surface(mountains, terrain_run, told):
    scene = Scene.load(terrain_run.result.scene)
    assert scene.refinement == "terrain" and Path(scene.surface).exists()
    assert all(
        view.refined.to_original.to_mapping() == {"kind": "terrain"}
        for tile in scene.tiles
        for view in tile.views.values()
    )
    assert any("Refined on a surface" in note for note in terrain_run.said.notes)
    found = run_stage(
        "comparedsm", {"dsm": terrain_run.result.output, "reference": mountains.truth, "align": "3d"}, told()
    )
    assert found.nmad < 0.65 and found.valid > 99 and found.completeness_by_threshold["5"] > 99


@pytest.mark.slow
def test_the_same_bytes_with_one_worker(mountains, terrain_run, pipeline, tmp_path):
    alone = pipeline(
        mountains,
        tmp_path,
        **{**terrain_run.options, "workspace": str(tmp_path / "ws"), "output": str(tmp_path / "dsm.tif"), "workers": 1},
    )
    arrays = [gdal.Open(run.result.output).ReadAsArray() for run in (terrain_run, alone)]
    assert arrays[0].tobytes() == arrays[1].tobytes()
    files = [sorted(Path(run.result.heights).glob("*.tif")) for run in (terrain_run, alone)]
    assert [path.name for path in files[0]] == [path.name for path in files[1]] and len(files[0]) > 3
    for one, two in zip(*files):
        assert gdal.Open(str(one)).ReadAsArray().tobytes() == gdal.Open(str(two)).ReadAsArray().tobytes()


@pytest.mark.slow
def test_a_second_run_takes_up_what_is_there(terrain_run, told):
    again = told()
    before = Path(terrain_run.result.output).read_bytes()
    run_stage("pipeline", terrain_run.options, again)
    assert any("Reused" in note and "height maps" in note for note in again.notes)
    assert Path(terrain_run.result.output).read_bytes() == before
