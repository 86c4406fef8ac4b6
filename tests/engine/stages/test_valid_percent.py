"""The share of cells with a height: of the ground that two images see, whatever the altitudes and the cells were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from osgeo import gdal

from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage


@pytest.mark.slow
def test_cells_finer_than_the_images_are_filled_and_that_is_said(urban, urban_run, tmp_path, told):
    """At half the ground sampling distance half of the cells were empty, without a word."""
    said, output = told(), str(tmp_path / "fine.tif")
    made = run_stage("dsmfuse", {"scene": urban_run.result.scene, "output": output, "resolution": 0.25}, said)
    assert made.valid_percent > urban_run.result.valid_percent - 2.0 > 88.0
    assert any("0.25 m are finer than the images' ground sampling distance of 0.5 m" in note for note in said.notes)
    assert not any("ground sampling distance" in note for note in urban_run.said.notes)  # cells of 0.5 m
    found = run_stage("comparedsm", {"dsm": output, "reference": urban_run.result.output}, told())
    assert abs(found.bias) < 0.02 and found.nmad < 0.1, found


@pytest.mark.long
def test_pixels_that_are_long_and_narrow_leave_no_holes(urban, tmp_path, told):
    """RPCs that are moved to 85 degrees of latitude have pixels of 0.06 x 0.5 m: a seventh of the heights was lost."""
    images = []
    for image in urban.images[:2]:
        images.append(str(tmp_path / Path(image).name))
        gdal.Translate(images[-1], image)
        dataset = gdal.Open(images[-1], gdal.GA_Update)
        tags = dataset.GetMetadata("RPC")
        dataset.SetMetadata({**tags, "LAT_OFF": repr(float(tags["LAT_OFF"].split()[0]) + 41.5)}, "RPC")
        dataset = None
    options = {"images": images, "workspace": str(tmp_path / "w"), "output": str(tmp_path / "dsm.tif"), "workers": 1}
    made = run_stage("pipeline", {**options, "fill": "none"}, told())
    views = Scene.load(made.scene).views
    assert all(5 < view.elongation < 12 for view in views) and all(view.elongation < 1.3 for view in urban.views)
    assert made.valid_percent > 74  # 69 before; 81 of these images where they belong


@pytest.mark.long
def test_altitudes_that_ties_did_not_narrow_change_nothing(urban_run, tmp_path, told):
    """Those of an RPC have their middle far from the ground, where the two images see other ground together."""
    scene = Scene.load(urban_run.result.scene)
    wide = scene.with_tiles(lambda tile: replace(tile, altitudes=(tile.altitudes[0] - 900.0, tile.altitudes[1])))
    path = wide.save(str(Path(urban_run.result.scene).with_name("wide.json")))
    made = run_stage("dsmfuse", {"scene": path, "output": str(tmp_path / "dsm.tif"), "resolution": 0.5}, told())
    assert made.valid == urban_run.result.valid
    assert made.valid_percent == pytest.approx(urban_run.result.valid_percent, abs=0.01)
