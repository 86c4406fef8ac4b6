"""The stages one by one, as the shipped model, and as repm:pipeline: the same DSM."""

from __future__ import annotations

import os
import pathlib
import re
import time

import numpy as np
import pytest
from osgeo import gdal
from qgis.core import (
    QgsApplication,
    QgsProcessingContext,
    QgsProcessingOutputLayerDefinition,
    QgsProject,
    QgsSingleBandPseudoColorRenderer,
)

pytestmark = pytest.mark.long

MAP = ("OUTPUT", "TILES", "TIE_POINTS")


def heights(path):
    dataset = gdal.OpenEx(str(path))
    band = dataset.GetRasterBand(1)
    values = band.ReadAsArray().astype(float)
    values[values == band.GetNoDataValue()] = np.nan
    placed = (dataset.GetGeoTransform(), dataset.GetProjection(), values.shape)
    del band, dataset
    return values, placed


@pytest.fixture(scope="module")
def run(plugin, ears):
    def run(name, **parameters):
        feedback = ears()
        algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
        results, fine = algorithm.run(parameters, QgsProcessingContext(), feedback)
        assert fine, feedback.heard["error"]
        assert feedback.heard["progress"] == sorted(feedback.heard["progress"])
        return results, feedback.heard

    return run


@pytest.fixture(scope="module")
def whole(run, town, tmp_path_factory):
    """repm:pipeline with everything it can make."""
    folder = tmp_path_factory.mktemp("whole")
    given = {
        "IMAGES": town.images,
        "WORKSPACE": str(folder / "w"),
        "OUTPUT": str(folder / "dsm.tif"),
        "CONFIDENCE": str(folder / "confidence.tif"),
        "ORTHO": str(folder / "ortho.tif"),
        "CLOUD": str(folder / "cloud.laz"),
        "EPT": str(folder / "ept"),
        "MESH": str(folder / "mesh.ply"),
        "TILES": str(folder / "tiles.gpkg"),
        "TIE_POINTS": str(folder / "ties.gpkg"),
        "REPORT": str(folder / "report.html"),
        "RESOLUTION": 1.0,
    }
    return given, *run("pipeline", **given)


@pytest.mark.slow
def test_a_workspace_keeps_what_has_no_name_and_makes_nothing_twice(plugin, ears, sample, tmp_path):
    """As in the dialog: a workspace is named, all else is temporary, and each run has temporary files of its own."""
    project, runs = QgsProject(), []
    for _ in range(2):
        context, feedback = QgsProcessingContext(), ears()
        context.setProject(project)
        given = {name: QgsProcessingOutputLayerDefinition("TEMPORARY_OUTPUT", project) for name in MAP}
        given.update(IMAGES=sample.images[:2], WORKSPACE=str(tmp_path / "town"), REPORT="TEMPORARY_OUTPUT")
        algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline")
        results, fine = algorithm.run(given, context, feedback)
        assert fine, feedback.heard["error"]
        details = context.layersToLoadOnCompletion()
        assert set(details) == {results[name] for name in MAP}
        assert details[results["OUTPUT"]].name.startswith("DSM town")
        runs.append((results, feedback.heard["info"]))
    first, second = (pathlib.Path(results["OUTPUT"]).relative_to(tmp_path).as_posix() for results, _ in runs)
    assert (first, second) == ("town/dsm.tif", "town/dsm_2.tif")
    for path in ("dsm.qml", "dsm_2.qml", "report.html", "tiles.gpkg", "reconstructed_tie_points.gpkg"):
        assert (tmp_path / "town" / path).exists(), path
    # Nothing lies in the temporary folder, which is gone when the project is opened again; nothing is replaced.
    loaded = [results[name] for results, _ in runs for name in (*MAP, "REPORT")]
    assert len(set(loaded)) == len(loaded)
    assert {pathlib.Path(path).parent for path in loaded} == {tmp_path / "town"}
    assert (tmp_path / "town" / "dsm_tie_points_2.qml").exists() and (tmp_path / "town" / "dsm_report.html").exists()
    errormap = QgsApplication.processingRegistry().algorithmById("repm:errormap")
    given = {"SCENE": runs[0][0]["SCENE"], "OUTPUT": "TEMPORARY_OUTPUT", "REPORT": "TEMPORARY_OUTPUT"}
    context, project = QgsProcessingContext(), QgsProject()
    context.setProject(project)
    given["OUTPUT"] = QgsProcessingOutputLayerDefinition("TEMPORARY_OUTPUT", project)
    results, fine = errormap.run(given, context, ears())  # a stage that takes the scene up
    (named,) = context.layersToLoadOnCompletion().values()
    assert re.fullmatch(r"Equivalent error town \(img_01, \d+ m, after refinement\)", named.name), named.name
    places = [pathlib.Path(results[name]).relative_to(tmp_path / "town").as_posix() for name in ("OUTPUT", "REPORT")]
    assert fine and places == ["error.tif", "equivalent_error_report.html"]
    for words in ("Reused the cameras", "Reused the refinement", "and the relative pointing"):
        assert not any(words in note for note in runs[0][1]) and any(words in note for note in runs[1][1]), words


def test_a_temporary_workspace_keeps_nothing(plugin, ears, sample):
    given = {"IMAGES": sample.images[:2], "OUTPUT": "TEMPORARY_OUTPUT", "WORKSPACE": "TEMPORARY_OUTPUT"}
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline")
    results, fine = algorithm.run(given, QgsProcessingContext(), ears())
    assert fine and os.path.dirname(results["OUTPUT"]) != results["WORKSPACE"]


def test_the_pipeline_makes_all_that_it_names(whole):
    given, results, heard = whole
    for name in ("OUTPUT", "CONFIDENCE", "ORTHO", "CLOUD", "EPT", "MESH", "TILES", "TIE_POINTS", "REPORT", "WORKSPACE"):
        assert results[name] == given[name]
        assert os.path.exists(results[name])
    assert os.path.exists(results["SCENE"])
    for name in ("OUTPUT", "CONFIDENCE", "ORTHO", "TILES", "TIE_POINTS"):
        assert os.path.exists(os.path.splitext(given[name])[0] + ".qml")
    assert results["N_TIE_POINTS"] > 100 and 50 < results["VALID_PERCENT"] <= 100
    assert heard["progress"][-1] == 100
    with open(results["REPORT"], encoding="utf-8") as stream:
        page = stream.read()
    for words in (
        "qgis_process run repm:pipeline -- IMAGES=",
        "Tie points&#39; residuals",
        "Mean matching score",
        given["CLOUD"],
        "opencv-python-headless",
        ">polynomial</td>",
    ):
        assert words in page, words
    assert page.count("<td>order</td>") == 1  # one table of options for all stages


def test_the_dsm_is_near_the_truth(whole, run, town):
    results, _ = run("comparedsm", DSM=whole[1]["OUTPUT"], REFERENCE=town.truth, ALIGN="3d", THRESHOLDS="2")
    assert results["NMAD"] < 0.6
    assert results["COMPLETENESS"] > 60


@pytest.mark.slow
def test_the_shipped_model_gives_the_pipelines_dsm_and_layers(whole, ears, town, tmp_path):
    from processing.gui.Postprocessing import handleAlgorithmResults

    project, context, feedback = QgsProject(), QgsProcessingContext(), ears()
    context.setProject(project)
    layers = {
        "dsmfuse:DSM": "dsm.tif",
        "epmfit:TILES": "t.gpkg",
        "errormap:ERROR_MAP": "e.tif",
        "reconstruct:TIE_POINTS": "p.gpkg",
    }
    given = {
        "IMAGES": town.images,
        "RESOLUTION": 1.0,
        "epmfit:WORKSPACE": str(tmp_path / "old town"),
        "epmfit:REPORT": str(tmp_path / "r.html"),
        **{key: QgsProcessingOutputLayerDefinition(str(tmp_path / name), project) for key, name in layers.items()},
    }
    model = QgsApplication.processingRegistry().algorithmById("repm:dsm_by_stages")
    results, fine = model.run(given, context, feedback)
    assert fine, feedback.heard["error"]
    got, want = heights(results["dsmfuse:DSM"]), heights(whole[1]["OUTPUT"])
    assert got[1] == want[1]
    np.testing.assert_array_equal(got[0], want[0])
    # On the map as the pipeline's are: one group, though the later stages know only temporary folders.
    assert handleAlgorithmResults(model, context, feedback, parameters=given)
    (group,) = project.layerTreeRoot().children()
    assert group.name() == "old town"
    sources = [pathlib.Path(node.layer().source().split("|")[0]).name for node in group.findLayers()]
    assert sources == ["p.gpkg", "t.gpkg", "e.tif", "dsm.tif"]
    shown = {node.name(): node.itemVisibilityChecked() for node in group.findLayers()}
    error = "Equivalent error old town (img_01, 219 m, before refinement)"
    hidden = ["Tie points old town", "Tiles old town", error]  # the DSM is to be seen
    assert [name for name, on in shown.items() if not on] == hidden
    assert isinstance(group.findLayers()[-1].layer().renderer(), QgsSingleBandPseudoColorRenderer)
    project.clear()


@pytest.mark.slow
def test_cancel_in_the_middle_leaves_a_workspace_that_goes_on(plugin, ears, run, whole, town, tmp_path):
    given = {
        "IMAGES": town.images,
        "WORKSPACE": str(tmp_path / "w"),
        "OUTPUT": str(tmp_path / "dsm.tif"),
        "RESOLUTION": 1.0,
        "TILES": str(tmp_path / "t.gpkg"),
        "TIE_POINTS": str(tmp_path / "p.gpkg"),
    }
    feedback, cancelled = ears(), []
    told = feedback.setProgressText

    def listen(text):
        told(text)
        if "matching" in text and not cancelled:
            cancelled.append(time.monotonic())
            feedback.cancel()

    feedback.setProgressText = listen
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline")
    _, fine = algorithm.run(given, QgsProcessingContext(), feedback)
    seconds = time.monotonic() - cancelled[0]
    assert not fine
    assert seconds < 2
    assert not os.path.exists(given["OUTPUT"])
    assert not [path for path in tmp_path.rglob("*") if ".part" in path.name]
    assert not [entry for entry in pathlib.Path("/proc").glob("[0-9]*/cmdline") if _is_our_engine(entry)]

    results, heard = run("pipeline", **given)
    assert [text for text in heard["info"] if "eused" in text]
    np.testing.assert_array_equal(heights(results["OUTPUT"])[0], heights(whole[1]["OUTPUT"])[0])


def _is_our_engine(entry):
    """A pipeline that this test process started and that is still there."""
    try:
        ours = f"PPid:\t{os.getpid()}\n" in (entry.parent / "status").read_text()
        return ours and b"repm_qgis\0pipeline" in entry.read_bytes()
    except OSError:
        return False
