"""The fusion fills shadows where the images' times are known, and says so in the confidence raster and its counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.rasters import bands

AFTERNOON = "2023-06-21T16:40:00Z"  # over Toulouse, where the simulated town stands: the sun is at 33 degrees


def fused(run, folder, said, acquired, parameters, **options):
    """The run's height maps fused in a scene whose images have a time; the DSM, the confidence and the facts."""
    scene = Scene.load(run.result["scene"])
    views = tuple(replace(view, acquired=acquired) for view in scene.views)
    path = replace(scene, views=views).save(str(Path(run.result["scene"]).with_name(f"{folder.name}.json")))
    folder.mkdir()
    files = {"output": str(folder / "dsm.tif"), "confidence": str(folder / "confidence.tif")}
    facts = run_stage("dsmfuse", {"scene": path, **files, **options}, said, parameters)
    return bands(files["output"])[0][0], bands(files["confidence"])[0], facts


@pytest.mark.parametrize("fill", ["occlusions", "all"])
def test_what_takes_the_ground_of_a_shadow_is_marked_and_counted(urban_run, tmp_path, told, as_they_are, fill):
    plain, before, without = fused(urban_run, tmp_path / "plain", told(), "", as_they_are, fill=fill)
    dsm, confidence, facts = fused(urban_run, tmp_path / "timed", told(), AFTERNOON, as_they_are, fill=fill)
    assert dsm.shape == plain.shape
    count, spread, score, source, error = confidence
    changed = ~np.isclose(dsm, plain, rtol=0, atol=0, equal_nan=True)
    taken = (source == 1) & ~(before[3] == 1)
    assert 20 < taken.sum() < 0.05 * dsm.size
    assert (np.isfinite(dsm) >= np.isfinite(plain)).all()
    if fill == "occlusions":
        assert (taken | (before[3] == 1))[changed].all()
    assert np.isnan(count[taken]).all() and np.isnan(score[taken]).all() and np.isfinite(error[taken]).all()
    replaced = taken & (before[3] == 0)
    assert (dsm[replaced] < plain[replaced]).all()
    assert facts["background"] == (source == 1).sum() > without["background"]
    assert facts["matched"] == (source == 0).sum()
    assert facts["matched"] + facts["background"] + facts["interpolated"] == np.isfinite(dsm).sum()


def test_nothing_is_filled_where_nothing_is_wanted(urban_run, tmp_path, told, as_they_are):
    plain, _, _ = fused(urban_run, tmp_path / "none", told(), "", as_they_are, fill="none")
    timed, _, _ = fused(urban_run, tmp_path / "timed_none", told(), AFTERNOON, as_they_are, fill="none")
    np.testing.assert_array_equal(timed, plain)
