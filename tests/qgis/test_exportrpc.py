"""repm:exportrpc in QGIS: from the command line, and in QGIS's own process with its report in German."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal

from tests.engine.pages import plain

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def scenes(sample, tmp_path_factory):
    """A scene of the sample images as fitted, and one whose views have an affine pointing."""
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.scene import Scene
    from repm_qgis.stages import run_stage

    folder = tmp_path_factory.mktemp("scenes")
    fitted = run_stage("epmfit", {"images": sample.images, "workspace": str(folder)}, Silent()).scene
    scene = Scene.load(fitted)
    pointing = np.array([[1.0001, -0.00005, 3.5], [0.00008, 0.9999, -2.25]])
    views = tuple(view.with_pointing(pointing) for view in scene.views)
    return fitted, replace(scene, views=views).save(str(folder / "pointed.json"))


def test_gdal_sees_the_pointed_model_in_what_the_command_line_wrote(headless, scenes, tmp_path):
    from repm_qgis.scene import Scene

    options = [f"SCENE={scenes[1]}", f"RPC_FOLDER={tmp_path / 'rpcs'}", f"REPORT={tmp_path / 'r.html'}"]
    done = headless("--json", "run", "repm:exportrpc", "--", *options)
    assert done.returncode == 0, done.stderr + done.stdout
    results = json.loads(done.stdout)["results"]
    assert results["MAX_ERROR"] < 0.001 and results["RPC_FOLDER"] == str(tmp_path / "rpcs")
    scene = Scene.load(scenes[1])
    images = sorted((tmp_path / "rpcs").glob("*.vrt"))
    assert len(images) == len(scene.views) == 3 and (tmp_path / "r.html").is_file()
    for view, image in zip(scene.views, images):
        chance = np.random.default_rng(3)
        pixels = chance.uniform(0, np.array(view.size) - 1, (100, 2))
        ground = view.localise(pixels, chance.uniform(*scene.altitudes, 100))
        transformer = gdal.Transformer(gdal.Open(str(image)), None, ["METHOD=RPC"])
        found, _ = transformer.TransformPoints(1, ground.tolist())
        assert np.abs(np.array(found)[:, :2] - 0.5 - pixels).max() < 0.001


def test_it_runs_in_qgis_itself_and_its_images_go_on_to_other_algorithms(german, feedback, scenes, tmp_path):
    from qgis.core import QgsApplication, QgsProcessingContext

    algorithm = QgsApplication.processingRegistry().algorithmById("repm:exportrpc").create()
    given = {"SCENE": scenes[1], "RPC_FOLDER": str(tmp_path / "rpcs"), "REPORT": str(tmp_path / "r.html")}
    results, fine = algorithm.run(given, QgsProcessingContext(), feedback)
    assert fine, feedback.heard["error"]
    assert any(line.startswith("3 Bilder: RPC in ") for line in feedback.heard["info"])
    page = plain((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "Jedes exportierte RPC ist höchstens" in page and "affin, Zähler angepasst" in page
    again = QgsApplication.processingRegistry().algorithmById("repm:inspect").create()
    given = {"IMAGES": results["IMAGES"], "FOOTPRINTS": str(tmp_path / "f.gpkg"), "REPORT": str(tmp_path / "i.html")}
    seen, fine = again.run(given, QgsProcessingContext(), feedback)
    assert fine, feedback.heard["error"]
    assert seen["N_IMAGES"] == 3


def test_a_scene_without_pointing_is_a_warning_and_a_used_folder_a_refusal(headless, scenes, tmp_path):
    done = headless("run", "repm:exportrpc", "--", f"SCENE={scenes[0]}", f"RPC_FOLDER={tmp_path / 'rpcs'}")
    assert done.returncode == 0 and "these are the RPCs as delivered" in done.stdout + done.stderr
    (tmp_path / "rpcs" / "mine.txt").write_text("mine")
    done = headless("run", "repm:exportrpc", "--", f"SCENE={scenes[1]}", f"RPC_FOLDER={tmp_path / 'rpcs'}")
    assert done.returncode == 1 and "holds 'mine.txt'" in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
