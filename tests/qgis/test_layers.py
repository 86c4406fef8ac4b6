"""Results on the map: named after their scene, styled, georeferenced; as Processing's own dialog loads them."""

from __future__ import annotations

import shutil
import types

import laspy
import numpy as np
import pytest
from osgeo import gdal
from qgis.core import (
    QgsApplication,
    QgsCategorizedSymbolRenderer,
    QgsGraduatedSymbolRenderer,
    QgsMapLayerStore,
    QgsPointXY,
    QgsProcessingContext,
    QgsProject,
    QgsRuleBasedRenderer,
    QgsSingleBandPseudoColorRenderer,
    QgsSingleSymbolRenderer,
)


@pytest.mark.long
def test_tiles_come_with_name_style_and_crs(load, sample, tmp_path, feedback):
    workspace = tmp_path / "town"
    results, layers = load(
        "epmfit",
        {"IMAGES": sample.images, "WORKSPACE": str(workspace), "REPORT": ""},
        {"TILES": tmp_path / "t.gpkg"},
    )
    layer = layers["TILES"]
    assert layer.isValid() and layer.featureCount() >= 1
    assert layer.crs().isValid() and not layer.crs().isGeographic()
    assert not isinstance(layer.renderer(), QgsSingleSymbolRenderer)
    assert isinstance(
        layer.renderer(), (QgsGraduatedSymbolRenderer, QgsCategorizedSymbolRenderer, QgsRuleBasedRenderer)
    )
    assert layer.name() == "Tiles town"
    assert results["MAX_ERROR"] >= results["RMSE"] > 0
    assert max(feedback.heard["progress"]) == 100


def test_a_layers_name_tells_the_scene(plugin, tmp_path):
    from qgis.core import QgsProcessingUtils

    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline").create()
    images = ["/data/IMG_1.tif", "/data/IMG_2.tif"]
    assert algorithm._scene_name({"workspace": "/work/giza", "images": images}) == "giza"
    temporary = QgsProcessingUtils.tempFolder() + "/abc/WORKSPACE"
    assert algorithm._scene_name({"workspace": temporary, "images": images}) == "IMG_1"
    inspect = QgsApplication.processingRegistry().algorithmById("repm:inspect").create()
    several = ["/data/order 7/IMG_1/a.tif", "/data/order 7/IMG_2/b.tif"]
    hills = ["/data/hills/IMG_1.tif", "/data/hills/IMG_2.tif"]
    names = {"order 7": several, "hills": hills, "IMG_1": images[:1]}
    assert {name: inspect._scene_name({"images": given}) for name, given in names.items()} == dict(zip(names, names))
    fuse = QgsApplication.processingRegistry().algorithmById("repm:dsmfuse").create()
    assert fuse._scene_name({"scene": "/work/giza/scene.json"}) == "giza"
    assert fuse._scene_name({"scene": temporary + "/scene.json"}) == ""
    compare = QgsApplication.processingRegistry().algorithmById("repm:comparedsm").create()
    assert compare._scene_name({"dsm": "/work/giza/dsm.tif", "reference": "/data/lidar.tif"}) == "giza"
    placed = {"workspace": "/work/giza", "images": images, "reference": ["/data/lidar.tif"]}
    assert algorithm._scene_name(placed) == "registered, giza"
    mosaic = QgsApplication.processingRegistry().algorithmById("repm:mosaic").create()
    parts = {"dsms": ["/work/west/dsm.tif", "/work/east/dsm.tif"], "scenes": []}
    assert mosaic._scene_name({**parts, "output": temporary + "/OUTPUT.tif"}) == "west + east"
    assert mosaic._scene_name({**parts, "output": "/work/valley.vrt"}) == "valley"
    change = QgsApplication.processingRegistry().algorithmById("repm:change").create()
    for before, after, name in (
        ("/data/giza 2019.tif", "/data/giza 2024.tif", "giza 2019 – giza 2024"),
        ("/work/2019/dsm.tif", "/work/2024/dsm.tif", "2019 – 2024"),
        (temporary + "/dsm.tif", "/work/2024/dsm.tif", "2024"),
        (temporary + "1/dsm.tif", temporary + "2/dsm.tif", ""),
    ):
        assert change._scene_name({"before": before, "after": after}) == name


@pytest.mark.long
def test_layers_that_stay_are_not_named_after_their_files(load, sample, tmp_path, monkeypatch):
    """QGIS gives what lies outside the temporary folder its file's name: "dsm" in every workspace."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    folder = tmp_path / "old town" / "out"
    _, layers = load(
        "epmfit", {"IMAGES": sample.images, "WORKSPACE": str(folder), "REPORT": ""}, {"TILES": folder / "tiles.gpkg"}
    )
    assert layers["TILES"].name() == "Tiles old town"
    page = (folder / "equivalent_error.html").read_text(encoding="utf-8")
    assert "<title>Equivalent pinhole cameras: old town</title>" in page


def test_a_layers_name_tells_what_of_which_scene_and_of_when(plugin):
    from repm.processing_provider.styles import Run

    assert Run("hills", ["2019-04-02"]).name("DSM", "EGM96 height") == "DSM hills, 2019-04-02 (EGM96 height)"
    assert Run("hills", ["2019-04-02", "2019-05-01"]).name("Tiles") == "Tiles hills, 2019-04-02 – 2019-05-01"
    assert Run("hills", number=2).name("Tiles") == "Tiles hills (2)"
    assert Run("hills", ["2019-04-02"], number=2).label() == "hills (2), 2019-04-02"
    assert Run("").name("DSM", "EGM96 height") == "DSM (EGM96 height)"


@pytest.fixture(scope="module")
def rebuilt(town, tmp_path_factory):
    """A scene with heights in a workspace named "old town"."""
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    folder = tmp_path_factory.mktemp("rebuilt") / "old town"
    return run_stage(
        "pipeline",
        {"images": town.images, "workspace": str(folder), "resolution": 1.0, "output": str(folder / "dsm.tif")},
        Silent(),
    ).scene


def tree(node):
    """Names, and whether they are switched on, from top to bottom; groups as nested lists after their names."""
    found = []
    for child in node.children():
        found.append((child.name(), child.itemVisibilityChecked()))
        if child.nodeType() == child.NodeType.NodeGroup:
            found.append(tree(child))
    return found


@pytest.mark.slow
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
    assert [name for name, _ in tree(root)[1]][:2] == [
        "Equivalent error old town (img_01, 219 m, after refinement)",
        "Point cloud old town",
    ]


def test_each_run_has_its_group_and_stages_of_one_scene_share_theirs(plugin, feedback):
    from qgis.core import QgsRasterLayer, QgsVectorLayer
    from repm.processing_provider.styles import LayerStyler, Run

    project = QgsProject()
    context = QgsProcessingContext()
    context.setProject(project)
    root = project.layerTreeRoot()

    def arrive(scene, *kinds):
        run = Run(scene)
        run.kinds.update(kinds)
        for kind in kinds:
            styler = LayerStyler.make("", kind, run, kind)
            layer = QgsVectorLayer("Point", run.name(kind), "memory")
            project.addMapLayer(layer)
            styler.postProcessLayer(layer, context, feedback)

    arrive("field", "footprints", "overlaps")  # images are inspected, and a DSM is made of them
    assert tree(root) == [("field", True), [("footprints field", True), ("overlaps field", True)]]
    arrive("field", "dsm")
    assert tree(root)[1] == [("footprints field", True), ("overlaps field", False), ("dsm field", True)]
    arrive("field", "dsm_error")
    arrive("field", "dsm_error")  # compared again, with another alignment
    arrive("field", "tiles", "dsm")  # of none of these comparisons
    assert tree(root)[:4] == [
        ("field (3)", True),
        [("tiles field (3)", False), ("dsm field (3)", True)],
        ("field (2)", True),
        [("dsm_error field (2)", True)],
    ]
    root.clear()
    root.addGroup("town")  # somebody's own
    arrive("town", "error", "tiles")
    assert tree(root)[:2] == [("town", True), [("tiles town", True), ("error town", True)]]
    arrive("town", "ortho", "dsm", "tie_points")  # a later stage
    arrive("town", "dsm", "confidence", "tiles")  # another run
    arrive("village", "dsm")
    arrive("", "tiles")
    assert tree(root) == [
        ("tiles", True),
        ("village", True),
        [("dsm village", True)],
        ("town (2)", True),
        [("tiles town (2)", False), ("confidence town (2)", False), ("dsm town (2)", True)],
        ("town", True),
        [
            ("tie_points town", False),
            ("tiles town", False),
            ("error town", False),  # it would hide the DSM
            ("ortho town", False),
            ("dsm town", True),
        ],
        ("town", True),
        [],
    ]
    arrive("pit", "change")
    assert tree(root.findGroup("pit")) == [("change pit", True)]
    arrive("pit", "volumes", "significant")  # the change that counts is seen, the raw difference is off
    shown = [("volumes pit", True), ("significant pit", True), ("change pit", False)]
    assert tree(root.findGroup("pit")) == shown
    root.removeChildNode(root.findGroup("pit"))
    # QGIS may put a layer beside the one that is selected, into a group of ours: groups are not nested.
    layer = QgsRasterLayer("", "error", "gdal")
    project.addMapLayer(layer, False)
    root.findGroup("town (2)").insertLayer(0, layer)
    run = Run("town", kinds={"error"})
    LayerStyler.make("", "error", run).postProcessLayer(layer, context, feedback)
    assert ("error", False) in tree(root.findGroup("town (2)")) and len(root.findGroups()) == 4
    project.clear()


def test_newer_qgis_is_told_the_order(plugin, feedback, tmp_path):
    from repm.processing_provider import styles

    def blank():
        return types.SimpleNamespace(name="", groupName="", layerSortKey=0, setPostProcessor=lambda dresser: None)

    class Context:
        details = {"dsm": blank(), "ties": blank()}

        def willLoadLayerOnCompletion(self, name):
            return name in self.details

        def layerToLoadOnCompletionDetails(self, name):
            return self.details[name]

        def temporaryLayerStore(self):
            return QgsMapLayerStore()

    context = Context()
    for kept_as, kind in (("dsm", "dsm"), ("ties", "tie_points")):
        (tmp_path / f"{kept_as}.qml").touch()
        styles.style_layer(
            context, feedback, kept_as, str(tmp_path / f"{kept_as}.gpkg"), kind, styles.Run("town"), kept_as.upper()
        )
    dsm, ties = context.details["dsm"], context.details["ties"]
    assert (dsm.name, dsm.groupName, ties.name) == ("DSM town", "", "TIES town")
    assert ties.layerSortKey > dsm.layerSortKey  # greater is higher


def test_without_a_project_or_a_provider_nothing_is_loaded(plugin, feedback, monkeypatch, tmp_path):
    from repm.processing_provider import styles

    context = QgsProcessingContext()
    for kind in ("ept", "mesh"):
        styles.style_layer(context, feedback, "", str(tmp_path), kind, styles.Run("town"), "x")
    assert not context.layersToLoadOnCompletion()
    context.setProject(QgsProject.instance())

    class Registry:
        def instance(self):
            return self

        def providerList(self):
            return ["gdal", "mdal"]

    monkeypatch.setattr(styles, "QgsProviderRegistry", Registry())
    for kind in ("ept", "mesh"):
        styles.style_layer(context, feedback, "", str(tmp_path / "m.ply"), kind, styles.Run("town"), "x")
    assert list(context.layersToLoadOnCompletion()) == [str(tmp_path / "m.ply")]


@pytest.mark.long
def test_height_errors_are_styled_about_zero(load, sample, tmp_path):
    dsm = shutil.copy(sample.truth, tmp_path / "dsm.tif")
    dataset = gdal.Open(str(dsm), gdal.GA_Update)
    band = dataset.GetRasterBand(1)
    heights = band.ReadAsArray()
    band.WriteArray(np.where(heights == band.GetNoDataValue(), heights, heights + np.float32(0.25)))
    dataset = band = None  # noqa: F841
    results, layers = load(
        "comparedsm",
        {"DSM": str(dsm), "REFERENCE": sample.truth, "REPORT": ""},
        {"ERROR": tmp_path / "e.tif"},
    )
    layer = layers["ERROR"]
    assert results["RMSE"] == pytest.approx(0.25, abs=1e-4)
    assert results["COMPLETENESS"] == pytest.approx(100)
    assert isinstance(layer.renderer(), QgsSingleBandPseudoColorRenderer)
    assert layer.renderer().classificationMin() == -layer.renderer().classificationMax()
    assert (tmp_path / "e.qml").exists()


@pytest.mark.long
def test_corners_of_sample_images_are_transparent(plugin, context, feedback, tmp_path):
    """On the map an image is turned, and QGIS fills what lies beside it with zeros, which would be black."""
    project = QgsProject()
    context.setProject(project)
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:sampledata")
    _, fine = algorithm.run({"FOLDER": str(tmp_path / "hills"), "SIZE": 128}, context, feedback)
    from processing.gui.Postprocessing import handleAlgorithmResults
    from repm.processing_provider.styles import Run

    assert fine and handleAlgorithmResults(algorithm, context, feedback, parameters={})
    (group,) = project.layerTreeRoot().findGroups()
    assert group.name() == "hills"
    run = Run("hills", kinds={"dsm"})
    assert run.group(project.layerTreeRoot()) != group and run.label() == "hills"  # a run's group has no number for it
    (image,) = project.mapLayersByName("img_01")
    box, provider = image.extent(), image.dataProvider()
    corner, fine = provider.sample(QgsPointXY(box.xMinimum(), box.yMaximum()), 1)
    middle, inside = provider.sample(box.center(), 1)
    assert inside and middle > 0 and not (fine and corner == 0)
    assert image.renderer().contrastEnhancement().minimumValue() > 0
    project.clear()
