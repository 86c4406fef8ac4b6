"""repm:exportcameras from the command line, as a user of QGIS would run it."""

from __future__ import annotations

import json
import sys

import pytest

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def refined(sample, tmp_path_factory):
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    folder = tmp_path_factory.mktemp("refined")
    fitted = run_stage("epmfit", {"images": sample.images, "workspace": str(folder)}, Silent())
    path = str(folder / "refined.json")
    run_stage("refine", {"scene": fitted.scene, "output_scene": path}, Silent())
    return fitted.scene, path


def test_a_refined_scene_becomes_a_model_for_nerfstudio(headless, refined, tmp_path):
    done = headless(
        "--json",
        "run",
        "repm:exportcameras",
        "--",
        f"SCENE={refined[1]}",
        "FORMAT=nerfstudio",
        "CENTRE=false",
        f"FOLDER={tmp_path / 'out'}",
        REPM_ENGINE_PYTHON=sys.executable,
    )
    assert done.returncode == 0, done.stderr + done.stdout
    results = json.loads(done.stdout)["results"]
    assert results["IMAGES"] == 3 and results["FOLDER"] == str(tmp_path / "out")
    model = tmp_path / "out" / "r000c000"
    frames = json.loads((model / "transforms.json").read_text())["frames"]
    scene = json.loads(open(refined[1], encoding="utf-8").read())
    for frame in frames:
        name = frame["file_path"][len("images/") : -len(".png")]
        K = scene["tiles"][0]["views"][name]["refined"]["camera"]["K"]
        assert (frame["fl_x"], frame["fl_y"], frame["cx"], frame["cy"]) == pytest.approx(
            (K[0][0], K[1][1], K[0][2] + 0.5, K[1][2] + 0.5), rel=1e-14
        )
        assert (model / frame["file_path"]).is_file() and (model / frame["mask_path"]).is_file()


def test_a_scene_that_is_not_refined_is_refused_in_one_sentence(headless, refined, tmp_path):
    done = headless(
        "run",
        "repm:exportcameras",
        "--",
        f"SCENE={refined[0]}",
        f"FOLDER={tmp_path / 'out'}",
        REPM_ENGINE_PYTHON=sys.executable,
    )
    assert done.returncode == 1
    assert "run 'Refine the images' first" in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_a_killed_exports_half_model_is_removed(plugin, tmp_path):
    import time

    from repm.processing_provider.cleanup import remove_half_written

    start = time.time()
    half, whole = tmp_path / ".r000c000.part", tmp_path / "r000c001"
    for folder in (half, whole):
        (folder / "images").mkdir(parents=True)
        (folder / "images" / "a.png").touch()
    assert remove_half_written({"folder": str(tmp_path)}, start) == [str(half)]
    assert not half.exists() and (whole / "images" / "a.png").exists()
