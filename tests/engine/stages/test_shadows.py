"""The fusion fills shadows where the images' times are known, and says so in the confidence raster and its counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from repm_qgis.imagery.confidence import Provenance
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE
from tests.engine.rasters import bands

AFTERNOON = "2023-06-21T16:40:00Z"  # over Toulouse, where the simulated town stands: the sun is at 33 degrees


def fused(run, folder, said, acquired, parameters, **options):
    """The run's height maps fused in a scene whose images have a time; the DSM, the confidence and the facts."""
    scene = Scene.load(run.result.scene)
    views = tuple(replace(view, acquired=acquired) for view in scene.views)
    path = replace(scene, views=views).save(str(Path(run.result.scene).with_name(f"{folder.name}.json")))
    folder.mkdir()
    files = {"output": str(folder / "dsm.tif"), "confidence": str(folder / "confidence.tif")}
    facts = run_stage("dsmfuse", {"scene": path, **files, **options}, said, parameters)
    return bands(files["output"])[0][0], bands(files["confidence"])[0], facts


@pytest.fixture(scope="module")
def begun():
    """Parameters with which heights are those that the choice begins with: the ground in shadows, else the maps' own.
    Without walls no shadows are looked for, so that ``as_they_are`` has none. Needles, which are removed from what the
    choice leaves, stay."""
    choice, needles = replace(ENGINE.fusion.choice, sweeps=0), replace(ENGINE.fusion.needles, slender=np.inf)
    return replace(ENGINE, fusion=replace(ENGINE.fusion, choice=choice, needles=needles))


@pytest.mark.parametrize("fill", ["occlusions", "all"])
@pytest.mark.slow
def test_what_takes_the_ground_of_a_shadow_is_marked_and_counted(urban_run, tmp_path, told, begun, fill):
    plain, before, without = fused(urban_run, tmp_path / "plain", told(), "", begun, fill=fill)
    dsm, confidence, facts = fused(urban_run, tmp_path / "timed", told(), AFTERNOON, begun, fill=fill)
    assert dsm.shape == plain.shape and not (before[3] == Provenance.SHADOW).any()
    count, spread, score, source, error, _ = confidence
    changed = ~np.isclose(dsm, plain, rtol=0, atol=0, equal_nan=True)
    taken = source == Provenance.SHADOW
    assert 20 < taken.sum() < 0.05 * dsm.size
    assert (np.isfinite(dsm) >= np.isfinite(plain)).all()
    assert changed[taken].all()
    if fill == "occlusions":
        # What lies within the noise of a background or of a map, its first height or its second one, is that one's.
        assert np.isin(source[changed], (Provenance.SHADOW, Provenance.BACKGROUND, Provenance.MATCHED)).all()
        near = changed & (source == Provenance.MATCHED) & (confidence[:3] == before[:3])[[0, 2]].all(axis=0)
        # Three standard deviations, of a map at its worst score; of a single cell, those that it states itself.
        widest = max(r.metres_per_px for tile in Scene.load(urban_run.result.scene).tiles for r in tile.heights)
        moved, own = np.abs(dsm - plain)[near], error[near]
        assert near.sum() > 20 and np.mean(moved < 3 * 0.65 * widest) > 0.99
        assert (moved < 3 * np.maximum(own, 0.65 * widest)).all()
    assert np.isnan(confidence[:3, taken]).all() and np.isfinite(error[taken]).all()
    assert facts.background == np.isin(source, (Provenance.BACKGROUND, Provenance.SHADOW)).sum()
    assert facts.background > without.background == (before[3] == Provenance.BACKGROUND).sum()
    assert facts.matched == (source == Provenance.MATCHED).sum()
    assert facts.interpolated == np.isin(source, (Provenance.INTERPOLATED, Provenance.INTERPOLATED_ON_DEM)).sum()
    assert facts.matched + facts.background + facts.interpolated == np.isfinite(dsm).sum()


@pytest.mark.long
def test_a_scene_without_walls_has_no_shadows(urban_run, tmp_path, told, as_they_are):
    plain, _, _ = fused(urban_run, tmp_path / "plain", told(), "", as_they_are)
    timed, confidence, _ = fused(urban_run, tmp_path / "timed", told(), AFTERNOON, as_they_are)
    np.testing.assert_array_equal(timed, plain)
    assert not (confidence[3] == Provenance.SHADOW).any()


@pytest.mark.long
def test_nothing_is_filled_where_nothing_is_wanted(urban_run, tmp_path, told, begun):
    plain, _, _ = fused(urban_run, tmp_path / "none", told(), "", begun, fill="none")
    timed, _, _ = fused(urban_run, tmp_path / "timed_none", told(), AFTERNOON, begun, fill="none")
    np.testing.assert_array_equal(timed, plain)
