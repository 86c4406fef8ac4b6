"""Results on the map: named after their scene, styled, georeferenced; as Processing's own dialog loads them."""

from __future__ import annotations

import types

import laspy
import numpy as np
import pytest
from qgis.core import (
    QgsApplication,
    QgsCategorizedSymbolRenderer,
    QgsGraduatedSymbolRenderer,
    QgsProcessingContext,
    QgsProject,
    QgsRuleBasedRenderer,
    QgsSingleBandPseudoColorRenderer,
    QgsSingleSymbolRenderer,
)


def test_tiles_come_with_name_style_and_crs(load, sample, tmp_path, feedback):
    workspace = tmp_path / "town"
    results, layers = load(
        "epmfit",
        {"IMAGES": sample["images"], "WORKSPACE": str(workspace), "REPORT": ""},
        {"TILES": tmp_path / "t.gpkg"},
    )
    layer = layers["TILES"]
    assert layer.isValid() and layer.featureCount() >= 1
    assert layer.crs().isValid() and not layer.crs().isGeographic()
    assert not isinstance(layer.renderer(), QgsSingleSymbolRenderer)
    assert isinstance(
        layer.renderer(), (QgsGraduatedSymbolRenderer, QgsCategorizedSymbolRenderer, QgsRuleBasedRenderer)
    )
    assert layer.name() in ("Tiles town", "t")  # the second where Processing prefers file names
    assert results["MAX_ERROR"] >= results["RMSE"] > 0
    assert max(feedback.heard["progress"]) == 100


def test_a_layers_name_tells_the_scene(plugin, tmp_path):
    from qgis.core import QgsProcessingUtils

    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline").create()
    images = ["/data/IMG_1.tif", "/data/IMG_2.tif"]
    assert algorithm._scene_name({"workspace": "/work/giza", "images": images}) == "giza"
    temporary = QgsProcessingUtils.tempFolder() + "/abc/WORKSPACE"
    assert algorithm._scene_name({"workspace": temporary, "images": images}) == "IMG_1"
    fuse = QgsApplication.processingRegistry().algorithmById("repm:dsmfuse").create()
    above = {"vertical_datum": "EGM96 height"}
    assert fuse._scene_name({"scene": "/work/giza/scene.json"}) == "giza"
    assert fuse._scene_name({"scene": temporary + "/scene.json"}) == ""
    assert fuse._layer_name("DSM", "giza", above) == "DSM giza (EGM96 height)"
    assert fuse._layer_name("DSM", "", above) == "DSM (EGM96 height)"


@pytest.fixture(scope="module")
def rebuilt(town, tmp_path_factory):
    """A scene with heights in a workspace named "old town"."""
    from repm_qgis.progress import Silent
    from repm_qgis.stages import run_stage

    folder = tmp_path_factory.mktemp("rebuilt") / "old town"
    return run_stage(
        "pipeline",
        {"images": town["images"], "workspace": str(folder), "resolution": 1.0, "output": str(folder / "dsm.tif")},
        Silent(),
    )["scene"]


def tree(node):
    """Names, and whether they are switched on, from top to bottom; groups as nested lists after their names."""
    found = []
    for child in node.children():
        found.append((child.name(), child.itemVisibilityChecked()))
        if child.nodeType() == child.NodeType.NodeGroup:
            found.append(tree(child))
    return found


def test_all_products_come_grouped_and_in_order(load, rebuilt, tmp_path, feedback):
    datum = "(WGS 84 ellipsoid)"
    folder = tmp_path / "cloud ü"
    results, layers = load(
        "dsmfuse",
        {
            "SCENE": rebuilt,
            "RESOLUTION": 1.0,
            "EPT": str(folder),
            "MESH": str(tmp_path / "m.ply"),
            "CLOUD": str(tmp_path / "c.laz"),
        },
        {"OUTPUT": tmp_path / "d.tif", "CONFIDENCE": tmp_path / "k.tif", "ORTHO": tmp_path / "o.tif"},
    )
    assert (results["EPT"], results["MESH"]) == (str(folder), str(tmp_path / "m.ply"))
    root = load.project.layerTreeRoot()
    assert tree(root) == [
        ("old town", True),
        [
            ("Point cloud old town", False),
            ("Orthophoto old town", False),
            ("Confidence old town", False),
            ("Mesh old town", False),
            ("Hillshade old town", True),
            (f"DSM old town {datum}", True),
        ],
    ]

    (cloud,) = load.project.mapLayersByName("Point cloud old town")
    with laspy.open(results["CLOUD"]) as reader:
        header = reader.header
    assert cloud.isValid() and cloud.pointCount() == header.point_count > 10000
    assert cloud.crs() == layers["OUTPUT"].crs()
    box = cloud.extent()
    np.testing.assert_allclose(
        [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()],
        [*header.mins[:2], *header.maxs[:2]],
        atol=1e-6,
    )
    assert cloud.renderer().type() == "ramp" and cloud.renderer().attribute() == "Z"
    dsm = layers["OUTPUT"].renderer()
    assert cloud.renderer().minimum() == pytest.approx(dsm.classificationMin(), abs=1e-6)

    (mesh,) = load.project.mapLayersByName("Mesh old town")
    assert mesh.isValid() and mesh.crs() == layers["OUTPUT"].crs()
    shown = mesh.rendererSettings().scalarSettings(0)
    assert shown.classificationMaximum() == pytest.approx(dsm.classificationMax(), abs=1e-6)

    # An earlier stage of the same scene joins its group, above.
    load("errormap", {"SCENE": rebuilt, "REPORT": ""}, {"OUTPUT": tmp_path / "e.tif"})
    assert [name for name, _ in tree(root)[1]][:2] == ["Equivalent error old town", "Point cloud old town"]


def test_groups_that_are_there_are_used_and_others_left(plugin, feedback):
    from qgis.core import QgsRasterLayer, QgsVectorLayer
    from repm.processing_provider.styles import LayerStyler

    project = QgsProject()
    context = QgsProcessingContext()
    context.setProject(project)
    root = project.layerTreeRoot()

    def arrive(name, kind, group):
        layer = QgsVectorLayer("Point", name, "memory")
        project.addMapLayer(layer)
        LayerStyler.make("", kind, group).postProcessLayer(layer, context, feedback)

    root.addGroup("mine")
    for name, kind in (
        ("dsm 1", "dsm"),
        ("ties", "tie_points"),
        ("tiles", "tiles"),
        ("ortho", "ortho"),
        ("dsm 2", "dsm"),
    ):
        arrive(name, kind, "town")
    arrive("other", "dsm", "village")
    arrive("alone", "tiles", "")
    assert tree(root) == [
        ("alone", True),
        ("village", True),
        [("other", True)],
        ("town", True),
        [("ties", True), ("tiles", True), ("ortho", False), ("dsm 2", True), ("dsm 1", True)],
        ("mine", True),
        [],
    ]
    # QGIS 3.32 and later put a layer into its group before they call: it is not nested again.
    layer = QgsRasterLayer("", "confidence", "gdal")
    project.addMapLayer(layer, False)
    root.findGroup("town").insertLayer(0, layer)
    LayerStyler.make("", "confidence", "town").postProcessLayer(layer, context, feedback)
    assert [name for name, _ in tree(root.findGroup("town"))] == [
        "ties",
        "tiles",
        "ortho",
        "confidence",
        "dsm 2",
        "dsm 1",
    ]
    project.clear()


def test_newer_qgis_is_told_group_and_order(plugin, feedback, tmp_path):
    from repm.processing_provider import styles

    def blank():
        return types.SimpleNamespace(name="", groupName="", layerSortKey=0, setPostProcessor=lambda dresser: None)

    class Context:
        details = {"dsm": blank(), "ties": blank()}

        def willLoadLayerOnCompletion(self, name):
            return name in self.details

        def layerToLoadOnCompletionDetails(self, name):
            return self.details[name]

    context = Context()
    for kept_as, kind in (("dsm", "dsm"), ("ties", "tie_points")):
        (tmp_path / f"{kept_as}.qml").touch()
        styles.style_layer(context, feedback, kept_as, str(tmp_path / f"{kept_as}.gpkg"), kept_as.upper(), kind, "town")
    dsm, ties = context.details["dsm"], context.details["ties"]
    assert (dsm.name, dsm.groupName, ties.groupName) == ("DSM", "town", "town")
    assert ties.layerSortKey > dsm.layerSortKey  # greater is higher


def test_without_a_project_or_a_provider_nothing_is_loaded(plugin, feedback, monkeypatch, tmp_path):
    from repm.processing_provider import styles

    context = QgsProcessingContext()
    for kind in ("ept", "mesh"):
        styles.style_layer(context, feedback, "", str(tmp_path), "x", kind, "town")
    assert not context.layersToLoadOnCompletion()
    context.setProject(QgsProject.instance())

    class Registry:
        def instance(self):
            return self

        def providerList(self):
            return ["gdal", "mdal"]

    monkeypatch.setattr(styles, "QgsProviderRegistry", Registry())
    for kind in ("ept", "mesh"):
        styles.style_layer(context, feedback, "", str(tmp_path / "m.ply"), "x", kind, "town")
    assert list(context.layersToLoadOnCompletion()) == [str(tmp_path / "m.ply")]


def test_height_errors_are_styled_about_zero(load, sample, tmp_path):
    results, layers = load(
        "comparedsm",
        {"DSM": sample["truth"], "REFERENCE": sample["truth"], "REPORT": ""},
        {"ERROR": tmp_path / "e.tif"},
    )
    layer = layers["ERROR"]
    assert results["RMSE"] == pytest.approx(0, abs=1e-6)
    assert results["COMPLETENESS"] == pytest.approx(100)
    assert isinstance(layer.renderer(), QgsSingleBandPseudoColorRenderer)
    assert layer.renderer().classificationMin() == -layer.renderer().classificationMax()
    assert (tmp_path / "e.qml").exists()
