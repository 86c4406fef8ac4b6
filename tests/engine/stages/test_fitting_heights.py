"""Heights that do not fit the images' brightness, in whole runs: what is replaced, marked and counted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from repm_qgis.arrays import Window
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.fusion.rasters import JoinedTiles
from repm_qgis.fusion.shaded import NOTHING, SUPPORTED, WEAK
from repm_qgis.imagery.raster import created
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from tests.engine.rasters import bands

_FUSION = ENGINE.fusion
STRAYS_ONLY = replace(ENGINE, fusion=replace(_FUSION, widened=replace(_FUSION.widened, step_m=1e6)))


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


def test_strays_give_way_and_nothing_else_changes(fused, as_they_are, urban, tmp_path):
    plain, before, without, _ = fused("plain", as_they_are)
    dsm, after, facts, _ = fused("strays", STRAYS_ONLY)
    np.testing.assert_array_equal(np.isnan(dsm), np.isnan(plain))
    changed = np.abs(dsm - plain) > 0
    assert 0.005 < changed.mean() < 0.2
    assert np.median(np.abs(dsm - plain)[changed]) > _FUSION.strays.least_m
    plain_score, score = (
        score_files(str(tmp_path / f"{name}.tif"), urban.truth, "cells") for name in ("plain", "strays")
    )
    assert score.metrics.mae < plain_score.metrics.mae
    np.testing.assert_array_equal(after, before)
    assert {name: facts[name] for name in ("valid", "matched", "background")} == {
        name: without[name] for name in ("valid", "matched", "background")
    }


def test_what_roofs_are_cut_back_by_is_the_grounds_and_marked(fused, as_they_are):
    plain, before, without, _ = fused("wide", as_they_are)
    dsm, after, facts, _ = fused("cut")
    cut = (after[3] == 1) & (before[3] == 0)
    assert cut.sum() > 10
    assert ((plain - dsm)[cut] > 1.0).mean() > 0.9
    assert np.isnan(after[:3, cut]).all()
    assert np.unique(after[4, cut]).size == 1 and after[4, cut][0] > np.nanmedian(after[4])
    assert facts["background"] - without["background"] == without["matched"] - facts["matched"] == cut.sum()
    assert facts["matched"] == (after[3] == 0).sum() and facts["background"] == (after[3] == 1).sum()


def test_which_heights_are_weak_is_known_until_the_ground_replaces_them(tmp_path):
    shape, nothing = (40, 50), np.float32(np.nan)
    support, ground = np.full(shape, SUPPORTED, np.float32), np.full(shape, nothing)
    support[10:20, 10:30], support[30:, :], ground[15:20, 10:30] = WEAK, NOTHING, 12.0
    heights, filled = np.full(shape, 20.0, np.float32), np.zeros(shape, np.float32)
    for name, values in (("joined", (heights, support, filled)), ("shaded", (ground,))):
        with created(str(tmp_path / f"{name}.tif"), shape, np.dtype(np.float32), len(values), None, "") as raster:
            for band, part in enumerate(values, start=1):
                raster.write(part, 0, 0, band)
    path, whole, part = str(tmp_path / "joined.tif"), Window(0, 0, 50, 40), Window(20, 5, 20, 10)
    plain, shaded = (JoinedTiles(whole, path, shade) for shade in ("", str(tmp_path / "shaded.tif")))
    np.testing.assert_array_equal(plain.weak(whole), support == WEAK)
    np.testing.assert_array_equal(shaded.weak(whole), (support == WEAK) & np.isnan(ground))
    np.testing.assert_array_equal(shaded.weak(part), shaded.weak(whole)[5:15, 20:40])


def test_without_filling_they_become_holes(fused):
    plain, _, without, _ = fused("wide_none", STRAYS_ONLY, fill="none")
    dsm, confidence, facts, _ = fused("cut_none", fill="none")
    lost = np.isfinite(plain) & np.isnan(dsm)
    assert lost.sum() == without["valid"] - facts["valid"] > 10
    assert np.isnan(confidence[:, lost]).all()
    assert facts["background"] == 0 and facts["matched"] == np.isfinite(dsm).sum()


def test_without_its_images_a_scene_is_fused_and_that_is_said(fused, urban_run, tmp_path):
    scene = Scene.load(urban_run.result["scene"])
    views = tuple(replace(view, image=str(tmp_path / f"gone_{view.name}.tif")) for view in scene.views)
    moved = replace(scene, views=views).save(str(Path(urban_run.result["scene"]).with_name("moved.json")))
    dsm, _, _, log = fused("moved", scene=moved)
    assert np.isfinite(dsm).mean() > 0.5
    assert any(f"{len(views)} images of the scene cannot be found" in line for line in log.notes)
