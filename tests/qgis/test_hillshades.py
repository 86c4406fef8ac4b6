"""A DSM with its hillshade is one layer: in lists, for Identify, and in a project that is opened again."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from qgis.core import (
    QgsLayerTreeModel,
    QgsLayoutItemMap,
    QgsMapThemeCollection,
    QgsPrintLayout,
    QgsProject,
    QgsRasterLayer,
)
from qgis.PyQt import sip

DSM = "DSM town"
SHADE = f"Hillshade of {DSM}"


@pytest.fixture
def dsm(tmp_path):
    """A house on a slope."""
    from repm_qgis.imagery import raster
    from repm_qgis.reports.styles import write_style

    heights = np.add.outer(np.linspace(100, 110, 120), np.zeros(160)).astype(np.float32)
    heights[40:70, 50:110] += 9
    path = raster.write(
        str(tmp_path / "dsm.tif"), [heights], (500000.0, 0.5, 0.0, 4800000.0, 0.0, -0.5), "EPSG:32631", unit="m"
    )
    write_style("dsm", path)
    return path


@pytest.fixture
def other_dsm(dsm, tmp_path):
    return shutil.copyfile(dsm, str(tmp_path / "other.tif"))


def names(project):
    return [node.name() for node in project.layerTreeRoot().findLayers()]


@pytest.fixture
def shaded(plugin, dsm):
    """A project with a DSM that has a hillshade, and what makes it."""
    from repm.desktop.hillshades import Hillshades
    from repm.processing_provider.styles import shade

    project = QgsProject()
    layer = QgsRasterLayer(dsm, DSM)
    project.addMapLayer(layer)
    hillshades = Hillshades(project)
    shade(project.layerTreeRoot().findLayer(layer.id()))
    hillshades.arrange()
    yield project, layer, hillshades
    hillshades.stop()
    project.clear()


def test_a_hillshade_is_shown_hidden_and_removed_with_its_dsm(shaded):
    project, layer, hillshades = shaded
    assert names(project) == [SHADE, DSM] and list(project.mapLayers()) == [layer.id()]
    node, dsm = project.layerTreeRoot().findLayers()
    for shown in (False, True):
        dsm.setItemVisibilityChecked(shown)
        assert node.itemVisibilityChecked() == shown
    node.setItemVisibilityChecked(False)  # as a theme does that does not know it
    assert node.itemVisibilityChecked()
    project.removeMapLayer(layer.id())
    hillshades.arrange()
    assert names(project) == []


def test_a_hillshade_lies_right_above_its_dsm(shaded, other_dsm):
    project, layer, hillshades = shaded
    root = project.layerTreeRoot()
    other = QgsRasterLayer(other_dsm, "other")
    project.addMapLayer(other, False)
    root.insertLayer(1, other)
    hillshades.arrange()
    assert names(project) == ["other", SHADE, DSM]
    group = root.addGroup("group")
    node = root.findLayer(layer.id())
    group.addChildNode(node.clone())
    root.removeChildNode(node)
    hillshades.arrange()
    assert names(project) == ["other", SHADE, DSM] and len(group.children()) == 2
    root.setHasCustomLayerOrder(True)
    node = root.findLayer(layer.id())
    node.setCustomProperty("repm/hillshade", 0)
    hillshades.arrange()
    assert names(project) == ["other", DSM]
    node.setCustomProperty("repm/hillshade", 1)
    hillshades.arrange()
    order = [each.name() for each in root.customLayerOrder()]
    assert order.index(SHADE) == order.index(DSM) - 1


def test_a_hillshade_follows_opacity_scale_and_file(shaded, other_dsm):
    project, layer, _ = shaded
    node = project.layerTreeRoot().findLayers()[0]
    usual = node.layer().opacity()
    layer.setOpacity(0.5)
    layer.setMinimumScale(5000)
    layer.setScaleBasedVisibility(True)
    layer.emitStyleChanged()
    assert node.layer().opacity() == pytest.approx(usual / 2) and node.layer().minimumScale() == 5000
    assert node.layer().hasScaleBasedVisibility()
    layer.setDataSource(other_dsm, layer.name(), "gdal", False)
    assert node.layer().source() == other_dsm and node.layer().renderer().type() == "hillshade"
    assert node.layer().opacity() == pytest.approx(usual / 2)


def test_a_stored_project_has_the_dsm_alone_and_its_hillshade_again_when_it_is_opened(shaded, tmp_path):
    from repm.desktop.hillshades import Hillshades

    project, layer, _ = shaded
    root = project.layerTreeRoot()
    root.setHasCustomLayerOrder(True)
    path = str(tmp_path / "p.qgs")
    project.setDirty(False)
    assert project.write(path) and names(project) == [SHADE, DSM]
    text = (tmp_path / "p.qgs").read_text(encoding="utf-8")
    tree = text[text.index("<layer-tree-group>") : text.index("</layer-tree-group>")]
    assert "Hillshade" not in tree and tree.count("<item>") == 1 and text.count("<maplayer ") == 1
    plain = QgsProject()  # without the plugin
    assert plain.read(path) and names(plain) == [DSM]
    assert all(node.layer() is not None for node in plain.layerTreeRoot().findLayers())
    plain.clear()
    again = QgsProject()
    hillshades = Hillshades(again)
    assert again.read(path) and names(again) == [SHADE, DSM] and not again.isDirty()
    assert again.layerTreeRoot().findLayers()[0].layer().isValid()
    hillshades.stop()
    assert names(again) == [DSM]
    again.clear()


def test_themes_and_locked_layouts_have_the_hillshade_again(shaded, tmp_path):
    """Both name layers of the project, of which the hillshade is none."""
    from repm.desktop.hillshades import Hillshades

    project, layer, _ = shaded
    root, themes = project.layerTreeRoot(), project.mapThemeCollection()
    themes.insert("relief", QgsMapThemeCollection.createThemeFromCurrentState(root, QgsLayerTreeModel(root)))
    layout = QgsPrintLayout(project)
    layout.initializeDefaults()
    layout.setName("sheet")
    item = QgsLayoutItemMap(layout)
    layout.addLayoutItem(item)
    item.setKeepLayerSet(True)
    item.setLayers(root.layerOrder())
    assert [each.name() for each in item.layers()] == [SHADE, DSM]
    project.layoutManager().addLayout(layout)
    path = str(tmp_path / "p.qgz")
    assert project.write(path)
    again = QgsProject()
    sip.transferto(again, None)  # see conftest
    hillshades = Hillshades(again)
    assert again.read(path) and names(again) == [SHADE, DSM] and not again.isDirty()
    shown = again.mapThemeCollection().mapThemeVisibleLayers("relief")
    (sheet,) = again.layoutManager().printLayouts()
    (locked,) = (each for each in sheet.items() if isinstance(each, QgsLayoutItemMap))
    for layers in (shown, locked.layers()):
        assert [each.name() for each in layers] == [SHADE, DSM]
        assert all(each.isValid() for each in layers)
    del shown, layers  # which keep the hillshade
    hillshades.stop()
    assert [each.name() for each in again.mapThemeCollection().mapThemeVisibleLayers("relief")] == [DSM]
    assert [each.name() for each in locked.layers()] == [DSM]


def test_hillshades_of_older_projects_are_taken_out_of_them(plugin, dsm):
    from repm.desktop.hillshades import Hillshades

    project = QgsProject()
    layer, older = QgsRasterLayer(dsm, DSM), QgsRasterLayer(dsm, "Hillshade town")
    project.addMapLayers([layer, older])
    project.layerTreeRoot().findLayer(older.id()).setCustomProperty("repm/shaded", layer.id())
    hillshades = Hillshades(project)
    assert names(project) == [SHADE, DSM] and [each.name() for each in project.mapLayers().values()] == [DSM]
    hillshades.stop()
    project.clear()


@pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)
@pytest.mark.slow
@pytest.mark.long
def test_one_layer_in_the_desktop(desktop_start, dsm, tmp_path):
    found = desktop_start("drive_hillshades.py", {"dsm": dsm, "project": str(tmp_path / "p.qgz")}, seconds=300)
    for name, groups in (("first", []), ("reopened", ["outer", "elsewhere"])):
        seen = found[name]
        assert seen["project"] == seen["combo"] == seen["processing"] == [DSM], name
        assert all(row == [DSM] for row in seen["dialog"]) and seen["dialog"], name
        assert seen["tree"] == [*groups, DSM] and seen["identified"] == [DSM], name
        assert seen["map"] == [SHADE, DSM] and seen["place"] == [SHADE, DSM], name
        assert seen["drawn"] != found["plain"], name
    assert found["first"]["drawn"] == found["reopened"]["drawn"]
    assert found["hidden"] == []
    assert found["action"] == [True, False] and found["without"] == found["plain"]
    assert [seen["place"] for seen in found["dragged"]] == [[SHADE, DSM]] * 2
    assert all(seen["drawn"] == found["first"]["drawn"] for seen in found["dragged"])
    entries, wider, inside = found["zoomed"]
    assert entries == 1 and 1.04 < wider < 3.0 and inside
    assert found["stored"] and found["after writing"] == [SHADE, DSM] and found["new"] == [True, 0]
    assert not found["dirty"]
    assert found["unloaded"] == [[DSM], found["plain"]] and found["left"] == 0
