"""Results on the map: named after their scene, styled, georeferenced; as Processing's own dialog loads them."""

from __future__ import annotations

import gc
import pathlib

import pytest
from qgis.core import (
    QgsApplication,
    QgsCategorizedSymbolRenderer,
    QgsGraduatedSymbolRenderer,
    QgsProcessingContext,
    QgsProcessingOutputLayerDefinition,
    QgsProject,
    QgsRuleBasedRenderer,
    QgsSingleBandPseudoColorRenderer,
    QgsSingleSymbolRenderer,
)


@pytest.fixture
def load(plugin, feedback):
    """Runs an algorithm as the dialog does, and gives its results and the layers by output name."""
    from processing.gui.Postprocessing import handleAlgorithmResults

    project = QgsProject()

    def run(name, parameters, layers):
        context = QgsProcessingContext()
        context.setProject(project)
        given = {**parameters, **{key: QgsProcessingOutputLayerDefinition(str(path), project)
                                  for key, path in layers.items()}}
        algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}")
        results, fine = algorithm.run(given, context, feedback)
        assert fine, feedback.heard["error"]
        gc.collect()  # a post-processor that only QGIS knows would be gone now
        assert handleAlgorithmResults(algorithm, context, feedback, parameters=given)
        by_source = {pathlib.Path(layer.source().split("|")[0]).resolve(): layer
                     for layer in project.mapLayers().values()}
        return results, {key: by_source[pathlib.Path(path).resolve()] for key, path in layers.items()}

    yield run
    project.clear()


def test_tiles_come_with_name_style_and_crs(load, sample, tmp_path, feedback):
    workspace = tmp_path / "town"
    results, layers = load("epmfit", {"IMAGES": sample["images"], "WORKSPACE": str(workspace), "REPORT": ""},
                           {"TILES": tmp_path / "t.gpkg"})
    layer = layers["TILES"]
    assert layer.isValid() and layer.featureCount() >= 1
    assert layer.crs().isValid() and not layer.crs().isGeographic()
    assert not isinstance(layer.renderer(), QgsSingleSymbolRenderer)
    assert isinstance(layer.renderer(),
                      (QgsGraduatedSymbolRenderer, QgsCategorizedSymbolRenderer, QgsRuleBasedRenderer))
    assert layer.name() in ("Tiles town", "t")  # the second where Processing prefers file names
    assert results["MAX_ERROR"] >= results["RMSE"] > 0
    assert max(feedback.heard["progress"]) == 100


def test_a_layers_name_tells_the_scene(plugin, tmp_path):
    from qgis.core import QgsProcessingUtils

    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline").create()
    images = ["/data/IMG_1.tif", "/data/IMG_2.tif"]
    assert algorithm._layer_name("DSM", {"workspace": "/work/giza", "images": images}, {}) == "DSM giza"
    temporary = QgsProcessingUtils.tempFolder() + "/abc/WORKSPACE"
    assert algorithm._layer_name("DSM", {"workspace": temporary, "images": images}, {}) == "DSM IMG_1"
    fuse = QgsApplication.processingRegistry().algorithmById("repm:dsmfuse").create()
    above = {"vertical_datum": "EGM96 height"}
    assert fuse._layer_name("DSM", {"scene": "/work/giza/scene.json"}, above) == "DSM giza (EGM96 height)"
    assert fuse._layer_name("DSM", {"scene": temporary + "/scene.json"}, above) == "DSM (EGM96 height)"


def test_height_errors_are_styled_about_zero(load, sample, tmp_path):
    results, layers = load("comparedsm", {"DSM": sample["truth"], "REFERENCE": sample["truth"], "REPORT": ""},
                           {"ERROR": tmp_path / "e.tif"})
    layer = layers["ERROR"]
    assert results["RMSE"] == pytest.approx(0, abs=1e-6)
    assert results["COMPLETENESS"] == pytest.approx(100)
    assert isinstance(layer.renderer(), QgsSingleBandPseudoColorRenderer)
    assert layer.renderer().classificationMin() == -layer.renderer().classificationMax()
    assert (tmp_path / "e.qml").exists()
