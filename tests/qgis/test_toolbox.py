"""What the toolbox does beyond running an algorithm: sample images come to the map, the model becomes one's own."""

from __future__ import annotations

import gc
import os
import pathlib
import subprocess
import sys

import pytest
from qgis.core import (
    QgsApplication,
    QgsLayerTreeGroup,
    QgsProcessingContext,
    QgsProject,
    QgsSettings,
    QgsVectorLayer,
)


@pytest.mark.long
def test_sample_images_come_as_a_group(plugin, feedback, tmp_path):
    from processing.gui.Postprocessing import handleAlgorithmResults

    project, context = QgsProject(), QgsProcessingContext()
    context.setProject(project)
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:sampledata")
    given = {"SIZE": 256, "FOLDER": str(tmp_path / "first try")}
    results, fine = algorithm.run(given, context, feedback)
    assert fine, feedback.heard["error"]
    gc.collect()
    assert handleAlgorithmResults(algorithm, context, feedback, parameters=given)
    (group,) = project.layerTreeRoot().children()
    assert isinstance(group, QgsLayerTreeGroup) and group.name() == "first try"
    layers = [node.layer() for node in group.findLayers()]
    first, *images, last = (layer.name() for layer in layers)
    assert (first, last) == ("Ground control points first try", "True DSM first try")
    assert sorted(images) == ["img_01", "img_02", "img_03"]
    assert all(layer.isValid() for layer in layers)
    points = layers[0]
    assert isinstance(points, QgsVectorLayer) and points.crs().authid() == "EPSG:4326"
    truth = layers[-1]
    middle = truth.extent().center()
    assert points.extent().xMinimum() > -180 and points.featureCount() > 10
    # The images lie where the truth is: QGIS places them by their RPCs.
    from qgis.core import QgsCoordinateTransform

    to_image = QgsCoordinateTransform(truth.crs(), layers[1].crs(), project)
    assert layers[1].extent().contains(to_image.transform(middle))
    assert not list(pathlib.Path(results["FOLDER"]).glob("img_*.aux.xml")), "the images' fingerprints must not change"
    project.clear()


def test_our_model_becomes_one_of_the_users(plugin, tmp_path, monkeypatch):
    pytest.importorskip("processing.modeler.ModelerDialog", reason="needs QGIS's Python modules for the desktop")
    from processing.modeler.ModelerUtils import ModelerUtils
    from repm.desktop import model_copy

    monkeypatch.setattr(ModelerUtils, "modelsFolders", staticmethod(lambda: [str(tmp_path / "models")]))
    registry = QgsApplication.processingRegistry()
    model = registry.algorithmById("repm:dsm_by_stages")
    action = model_copy.CopyModel()
    action.setData(registry.algorithmById("repm:pipeline"), None)
    assert not action.isEnabled()
    action.setData(model, None)
    assert action.isEnabled()
    first, second = model_copy.copied(model), model_copy.copied(model)
    assert sorted(path.name for path in (tmp_path / "models").iterdir()) == [
        "dsm_by_stages.model3", "dsm_by_stages_2.model3",
    ]  # fmt: skip
    assert (first.name(), second.name()) == ("dsm_by_stages", "dsm_by_stages_2")
    assert first.validate()[0], first.validate()[1]
    assert first.provider().id() == second.provider().id() == "model"  # without one, QGIS crashed when it ran the copy
    assert set(first.childAlgorithms()) == set(model.childAlgorithms())
    # Its dialog is QGIS's own, and shows 0 as 0.
    assert first.parameterDefinition("RESOLUTION").description() == "DSM resolution (m), 0: automatic"
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(ModelerUtils, "modelsFolders", staticmethod(lambda: [str(tmp_path / "file")]))
    with pytest.raises(OSError):
        model_copy.copied(model)


def test_a_preset_goes_before_defaults_that_nobody_gave(plugin, context, feedback, sample):
    from repm_qgis.contracts.options import PipelineOptions

    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline").create()
    given = {"IMAGES": sample.images, "PRESET": "fast", "FILL": "all", "WORKSPACE": "w", "OUTPUT": "dsm.tif"}
    assert algorithm.checkParameterValues(given, context) == (True, "")
    assert algorithm.prepareAlgorithm(given, context, feedback)
    made = PipelineOptions.from_json({**algorithm._inputs, "workspace": "w", "output": "dsm.tif"})
    assert (made.fuse.fill, made.reconstruct.quality) == ("all", "fast")


@pytest.fixture
def no_scenes(plugin):
    """A profile that remembers no scene: those of other tests are there still."""
    QgsSettings().remove("repm/last_scenes")


def test_the_scene_that_was_written_last_is_remembered(no_scenes, context, feedback, sample, tmp_path):
    from repm.processing_provider.last_scene import last_scene

    algorithm = QgsApplication.processingRegistry().algorithmById("repm:epmfit")
    results, fine = algorithm.run({"IMAGES": sample.images, "WORKSPACE": str(tmp_path / "w")}, context, feedback)
    assert fine, feedback.heard["error"]
    fitted = results["SCENE"]
    assert last_scene("refine") == fitted == str(tmp_path / "w" / "scene.json")
    assert last_scene("dsmfuse") == last_scene("exportcameras") == ""  # they could not begin with it


@pytest.mark.long
def test_outputs_that_a_command_does_not_need_are_left_out(no_scenes, context, feedback, sample, tmp_path):
    def run(name, **given):
        algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
        fine, problem = algorithm.checkParameterValues(given, context)
        assert fine, problem
        results, fine = algorithm.run(given, context, feedback)
        assert fine, feedback.heard["error"]
        return results

    seen = run("inspect", IMAGES=sample.images)
    assert seen["N_IMAGES"] == 3 and not {"FOOTPRINTS", "OVERLAPS", "REPORT"} & set(seen)
    fitted = run("epmfit", IMAGES=sample.images, WORKSPACE=str(tmp_path / "w"))["SCENE"]
    assert run("refine", SCENE=fitted)["OUTPUT_SCENE"] == str(tmp_path / "w" / "refined.json")
    # The dialog's proposal is no place that QGIS empties, and takes no earlier scene away.
    again = run("refine", SCENE=fitted, OUTPUT_SCENE="TEMPORARY_OUTPUT", MODEL="homography")["OUTPUT_SCENE"]
    assert again == str(tmp_path / "w" / "refined_2.json") and os.path.exists(tmp_path / "w" / "refined.json")


@pytest.mark.long
def test_a_dialog_takes_up_the_newest_scene_that_its_stage_can_begin_with(no_scenes, town, tmp_path):
    from repm.processing_provider.last_scene import last_scene, remember

    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    fitted = run_stage("epmfit", {"images": town.images, "workspace": str(tmp_path)}, Silent()).scene
    refined, reconstructed = (str(tmp_path / f"{name}.json") for name in ("refined", "reconstructed"))
    run_stage("refine", {"scene": fitted, "output_scene": refined}, Silent())
    run_stage("reconstruct", {"scene": refined, "output_scene": reconstructed}, Silent())
    for path in (reconstructed, refined, fitted):  # the first stage ran once more after all others
        remember(path)
    wanted = {"errormap": fitted, "refine": fitted, "exportcameras": refined, "reconstruct": fitted}
    assert {stage: last_scene(stage) for stage in wanted} == wanted
    assert last_scene("dsmfuse") == reconstructed
    for path in (fitted, refined, reconstructed):  # each after the one before it
        remember(path)
    wanted = {"errormap": reconstructed, "refine": reconstructed, "exportcameras": reconstructed}
    assert {stage: last_scene(stage) for stage in wanted} == wanted
    assert (last_scene("reconstruct"), last_scene("dsmfuse")) == (refined, reconstructed)
    pathlib.Path(reconstructed).write_text("{", encoding="utf-8")
    assert (last_scene("errormap"), last_scene("dsmfuse")) == (refined, "")


RUN_THE_COPY = """
import importlib, os, sys
from qgis.core import QgsApplication
from qgis.PyQt.QtCore import QTimer
application = QgsApplication([], True)
application.initQgis()
sys.path[:0] = [os.path.join(QgsApplication.pkgDataPath(), "python", "plugins"), sys.argv[1]]
from processing.core.Processing import Processing
Processing.initialize()
plugin = importlib.import_module("repm").classFactory(None)
plugin.initProcessing()
from processing.modeler.ModelerDialog import ModelerDialog
from processing.modeler.ModelerUtils import ModelerUtils
from repm.desktop import model_copy
ModelerUtils.modelsFolders = staticmethod(lambda: [sys.argv[2]])
copy = model_copy.copied(QgsApplication.processingRegistry().algorithmById("repm:dsm_by_stages"))
designer = ModelerDialog.create(copy)
QTimer.singleShot(1000, lambda: [window.close() for window in application.topLevelWidgets()])
if hasattr(designer, "runModel"):
    designer.runModel()
else:  # QGIS 3.40
    from qgis.PyQt.QtWidgets import QAction
    designer.findChild(QAction, "mActionRun").trigger()
print("ran", flush=True)
from processing.core.ProcessingConfig import ProcessingConfig
ProcessingConfig.settings.clear()  # as where QGIS ends, and has unloaded Processing before
plugin.unload()
print("ended", flush=True)
os._exit(0)
"""


@pytest.mark.long
def test_the_copy_runs_in_the_designer_and_qgis_ends(plugin, tmp_path):
    """QGIS crashed (SIGSEGV) at the designer's Run, and said KeyError 'REPM_ENGINE_PYTHON' where it ended."""
    pytest.importorskip("processing.modeler.ModelerDialog", reason="needs QGIS's Python modules for the desktop")
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "repm").symlink_to(pathlib.Path(__file__).resolve().parents[2])
    variables = {**os.environ, "QGIS_CUSTOM_CONFIG_PATH": str(tmp_path), "QT_QPA_PLATFORM": "offscreen"}
    command = [sys.executable, "-c", RUN_THE_COPY, str(tmp_path / "plugins"), str(tmp_path / "models")]
    done = subprocess.run(command, env=variables, text=True, capture_output=True, timeout=120, check=False)
    assert done.returncode == 0 and done.stdout.split()[-2:] == ["ran", "ended"], done.stdout + done.stderr
    assert "Traceback" not in done.stderr, done.stderr
