"""Parameters that a study varies: they reach every stage, and its fingerprint and scene tell them."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import pytest

from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.contracts.options import EpmFitOptions
from repm_qgis.runtime.parallel import use_workers
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stages.epmfit import _key
from repm_qgis.stages.parameters import ENGINE, EngineParameters, TileParameters


def test_the_defaults_leave_no_trace(urban):
    options = EpmFitOptions(images=tuple(urban.images), workspace="w")
    assert ENGINE.changes() == {} and _key(options) == _key(options, EngineParameters())
    other = replace(ENGINE, fusion=replace(ENGINE.fusion, covered=0.4))
    assert other.changes() == {"fusion": {"covered": 0.4}} and _key(options, other) != _key(options)
    assert json.loads(json.dumps(other.changes())) == other.changes()


def test_fitting_takes_them_and_records_them(urban, told, tmp_path):
    options = {
        "images": urban.images,
        "workspace": str(tmp_path),
        "altitude_min": 150.0,
        "altitude_max": 260.0,
    }
    small = replace(ENGINE, tiles=TileParameters(sizes_px=(150,)))
    one, many = told(), told()
    plain = Scene.load(run_stage("epmfit", options, one).scene)
    scene = Scene.load(run_stage("epmfit", options, many, small).scene)
    assert len(scene.tiles) > len(plain.tiles) and not any("Reused" in note for note in many.notes)
    assert scene.record_of("epmfit").parameters == {"tiles": {"sizes_px": [150]}}
    assert plain.record_of("epmfit").parameters == {} and scene.fingerprint != plain.fingerprint
    again = told()
    run_stage("epmfit", options, again, small)
    assert any("Reused" in note for note in again.notes)


def test_the_pipeline_hands_them_to_its_stages(urban, told, tmp_path):
    strict = replace(ENGINE, pointing=replace(ENGINE.pointing, least_tracks=10**6))
    options = {"images": urban.images, "workspace": str(tmp_path), "output": str(tmp_path / "dsm.tif")}
    with pytest.raises(EmptyResultError, match="1000000"):
        run_stage("pipeline", {**options, "altitude_min": 150.0, "altitude_max": 260.0}, told(), strict)
    assert Scene.load(str(tmp_path / "refined.json")).record_of("refine").parameters == strict.changes()


@pytest.mark.long
def test_matching_and_fusion_take_them(urban_run, told, tmp_path):
    said, path = told(), str(tmp_path / "dsm.tif")
    wide = replace(ENGINE, tiles=replace(ENGINE.tiles, cell_gsd=8.0))
    made = run_stage("dsmfuse", {"scene": urban_run.result.scene, "output": path}, said, wide)
    assert made.resolution > 3
    nothing = replace(ENGINE, tiles=replace(ENGINE.tiles, least_matched=10**9))
    options = {"scene": str(urban_run.workspace / "refined.json"), "output_scene": str(tmp_path / "done.json")}
    with pytest.raises(EmptyResultError, match="Matching found heights for only"):
        run_stage("reconstruct", options, told(), nothing)


def test_stages_that_have_none_are_light():
    import subprocess

    code = "import sys, repm_qgis.stages; print('repm_qgis.stages.parameters' in sys.modules, 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


class _Few:
    """Workers of a cluster that have so many MiB each."""

    def __init__(self, mib):
        self.task_mib = mib

    def run(self, function, work, workers, progress, describe):
        return [function(each) for each in work]

    def kill(self):
        pass


@pytest.mark.long
def test_automatic_tiles_are_small_enough_for_the_smallest_worker_of_a_cluster(urban, told, tmp_path):
    options = {"images": urban.images, "error_budget": 5.0, "altitude_min": 150.0, "altitude_max": 260.0}
    for mib, size in ((None, 1300), (2000, 1300), (300, 1000), (10, 800)):
        said = told()
        with use_workers(_Few(mib)):
            run_stage("epmfit", {**options, "workspace": str(tmp_path / str(mib))}, said)
        assert any(f"of up to {size} px a side" in note for note in said.notes), (mib, said.notes)
