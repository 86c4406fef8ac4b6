"""One height for each cell, in whole runs: what is chosen, what it says of itself, and what is counted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from repm_qgis.evaluation.scoring import score_files
from repm_qgis.imagery.confidence import Provenance
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from tests.engine.rasters import bands


@pytest.fixture
def fused(urban_run, tmp_path, told):
    """A function that fuses the town's height maps: the DSM, the confidence, the facts and the log."""

    def made(name, parameters=ENGINE, scene=None, **options):
        files = {"output": str(tmp_path / f"{name}.tif"), "confidence": str(tmp_path / f"{name}_confidence.tif")}
        log = told()
        scene = scene or urban_run.result["scene"]
        facts = run_stage("dsmfuse", {"scene": scene, "resolution": 0.5, **files, **options}, log, parameters)
        return bands(files["output"])[0][0], bands(files["confidence"])[0], facts, log

    return made


def test_heights_are_chosen_and_each_says_where_it_comes_from(fused, as_they_are, urban, tmp_path):
    plain, before, without, _ = fused("plain", as_they_are)
    dsm, after, facts, _ = fused("chosen")
    changed = np.abs(dsm - plain) > 0
    assert 0.005 < changed.mean() < 0.3
    scores = [score_files(str(tmp_path / f"{name}.tif"), urban.truth, "cells").metrics for name in ("plain", "chosen")]
    assert scores[1].mae < scores[0].mae and scores[1].rmse < scores[0].rmse
    source = after[3]
    # No height keeps the facts of one that was thrown away.
    unmatched = np.isfinite(source) & (source != Provenance.MATCHED)
    assert (source == Provenance.NEIGHBOURS).sum() > 100 and np.isnan(after[:3, unmatched]).all()
    far = changed & (np.abs(dsm - plain) > 2.0) & (source == Provenance.MATCHED)
    assert not np.array_equal(after[2, far], before[2, far]) and (after[4, unmatched] >= 0.7).all()
    counts = {name: int((source == code).sum()) for name, code in (("matched", Provenance.MATCHED),)}
    assert facts["matched"] == counts["matched"] < without["matched"]
    assert facts["background"] == unmatched.sum() and facts["valid"] == np.isfinite(dsm).sum()


def test_without_filling_only_matched_heights_are_left(fused):
    dsm, confidence, facts, _ = fused("none", fill="none")
    assert set(np.unique(confidence[3][np.isfinite(confidence[3])])) == {Provenance.MATCHED}
    np.testing.assert_array_equal(np.isnan(confidence[3]), np.isnan(dsm))
    assert facts["background"] == 0 and facts["matched"] == np.isfinite(dsm).sum()


@pytest.mark.parametrize("kind", ("urban", "mountains"))
def test_heights_do_not_depend_on_the_blocks(request, tmp_path, told, kind):
    """Three sizes of blocks, in which tiles are gridded and heights are chosen, and the same bytes."""
    scene = request.getfixturevalue(f"{kind}_run").result["scene"]
    found = []
    for number, (side, part) in enumerate(((1024, 512), (300, 200), (160, 333))):
        parameters = replace(ENGINE, fusion=replace(ENGINE.fusion, hole_block_cells=side, block_cells=part))
        path = str(tmp_path / f"{number}.tif")
        run_stage("dsmfuse", {"scene": scene, "resolution": 0.5, "output": path}, told(), parameters)
        found.append(bands(path)[0][0])
    assert np.isfinite(found[0]).mean() > 0.5
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


def test_without_its_images_a_scene_is_fused_and_that_is_said(fused, urban_run, tmp_path):
    scene = Scene.load(urban_run.result["scene"])
    views = tuple(replace(view, image=str(tmp_path / f"gone_{view.name}.tif")) for view in scene.views)
    moved = replace(scene, views=views).save(str(Path(urban_run.result["scene"]).with_name("moved.json")))
    dsm, _, _, log = fused("moved", scene=moved)
    assert np.isfinite(dsm).mean() > 0.5
    assert any(f"{len(views)} images of the scene cannot be found" in line for line in log.notes)
