"""Runs inside a real QGIS desktop: the panel of scenes with a workspace, one that is written, and one that moved."""

import os
import shutil
import subprocess
import sys

from qgis.core import QgsLayoutExporter, QgsProject, QgsSettings
from qgis.PyQt import sip
from qgis.PyQt.QtCore import Qt, QTimer
from qgis.PyQt.QtWidgets import QApplication, QFileDialog, QMenu, QMessageBox
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, dialog_of, finish, guarded, picture  # noqa: E402

FOUND["name"] = "scenes"
DOCK = []


def when_read(step):
    if DOCK[0].is_reading():
        QTimer.singleShot(100, lambda: when_read(step))
    else:
        QTimer.singleShot(100, step)


def tree():
    """The items of the tree as rows: depth, text, about it, tick."""
    rows = []

    def walk(item, depth):
        tick = item.checkState(0) if item.flags() & Qt.ItemFlag.ItemIsUserCheckable else None
        ticked = (
            None if tick is None else tick == Qt.CheckState.Checked and item.data(0, Qt.ItemDataRole.CheckStateRole)
        )
        rows.append([depth, item.text(0), item.text(1), None if item.data(0, 10) is None else bool(ticked)])
        for row in range(item.childCount()):
            walk(item.child(row), depth + 1)

    for row in range(DOCK[0].tree.topLevelItemCount()):
        walk(DOCK[0].tree.topLevelItem(row), 0)
    return rows


def item(text, folder=None):
    """The first item with a beginning, of a folder's workspace."""
    return next(
        each
        for each in DOCK[0]._items()
        if each.text(0).startswith(text) and folder in (None, each.data(0, Qt.ItemDataRole.UserRole)[1])
    )


def action(text, of):
    menu = QMenu()
    DOCK[0]._fill(menu, of)
    found = next(each for each in menu.actions() if each.text().startswith(text))
    if found.isEnabled():
        found.trigger()
    return found.isEnabled()


@guarded
def start():
    iface.mainWindow().resize(1280, 860)
    QgsSettings().setValue("repm/workspaces", "\n".join([PLAN["folder of the scene"], PLAN["moved from"]]))
    DOCK.append(plugins["repm"].menu.scenes())
    when_read(look)


@guarded
def look():
    FOUND["first"] = tree()
    item("Images").setExpanded(True)
    when_read(show)


@guarded
def show():
    FOUND["pictures"] = [not item("img_01").icon(0).isNull(), not item("img_02").icon(0).isNull()]
    for title in ("DSM", "Orthophoto"):
        item(title).setCheckState(0, Qt.CheckState.Checked)
    FOUND["renderer"] = type(next(iter(QgsProject.instance().mapLayersByName("DSM old town"))).renderer()).__name__
    FOUND["layers"] = sorted([layer.name(), layer.isValid()] for layer in QgsProject.instance().mapLayers().values())
    action("Zoom to it", item("DSM"))
    iface.mapCanvas().waitWhileRendering()
    FOUND["on the map"] = (
        iface.mapCanvas()
        .extent()
        .contains(next(iter(QgsProject.instance().mapLayersByName(FOUND["layers"][0][0]))).extent())
    )
    item("Orthophoto").setCheckState(0, Qt.CheckState.Unchecked)
    FOUND["ticked"] = tree()
    root = QgsProject.instance().layerTreeRoot()
    FOUND["visible"] = [node.name() for node in root.findLayers() if node.isVisible()]
    for node in root.findLayers():  # as a user does in the tree of layers
        if node.name().startswith("DSM"):
            node.setItemVisibilityChecked(False)
    FOUND["hidden"] = item("DSM").checkState(0) == Qt.CheckState.Unchecked
    item("DSM").setCheckState(0, Qt.CheckState.Checked)
    QTimer.singleShot(1500, photograph)


@guarded
def photograph():
    iface.mapCanvas().waitWhileRendering()
    picture(iface.mainWindow(), "panel.png")
    menu = QMenu()
    DOCK[0]._fill(menu, item("DSM"))
    FOUND["menu"] = [each.text() for each in menu.actions() if each.text()]
    menu.popup(DOCK[0].mapToGlobal(DOCK[0].rect().topLeft()))
    QApplication.processEvents()
    picture(menu, "menu.png")
    menu.close()
    picture(DOCK[0], "dock.png")
    make_page()
    FOUND["copied"] = action("Copy the command", item("Runs").child(0)) and QApplication.clipboard().text()
    action("Run again", item("Runs").child(0))
    QTimer.singleShot(1500, look_at_dialog)


def make_page():
    """The page for the client: its PDF, its texts, and what its maps show."""
    action("Page for the client", item("DSM"))
    (layout,) = QgsProject.instance().layoutManager().printLayouts()
    items = {each.id(): each for each in layout.items() if hasattr(each, "id") and each.id()}
    FOUND["page"] = {name: each.text() for name, each in items.items() if hasattr(each, "text")}
    FOUND["maps"] = {name: [layer.name() for layer in items[name].layers()] for name in ("map", "inset")}
    FOUND["layout"] = layout.name()
    QgsLayoutExporter(layout).exportToImage(
        os.path.join(PLAN["folder"], "page.png"), QgsLayoutExporter.ImageExportSettings()
    )


@guarded
def look_at_dialog():
    dialog = dialog_of("pipeline")
    values = dialog.mainWidget().createProcessingParameters()
    FOUND["again"] = {
        "IMAGES": [getattr(each, "source", lambda each=each: each)() for each in values["IMAGES"]],
        **{name: values[name] for name in ("WORKSPACE", "RESOLUTION", "FILL")},
        "OUTPUT": values["OUTPUT"].sink.staticValue() if hasattr(values["OUTPUT"], "sink") else values["OUTPUT"],
    }
    dialog.close()
    action("Terrain", item("DSM"))
    QTimer.singleShot(1000, look_at_terrain)


@guarded
def look_at_terrain():
    dialog = dialog_of("dtm")
    FOUND["terrain"] = dialog.mainWidget().createProcessingParameters()["DSM"]
    layer = QgsProject.instance().mapLayer(str(FOUND["terrain"]))
    FOUND["terrain"] = layer.source() if layer is not None else FOUND["terrain"]
    dialog.close()
    relink()


def relink():
    QFileDialog.getExistingDirectory = staticmethod(lambda *_: PLAN["moved to"])
    FOUND["relinked"] = action("Where is it now", DOCK[0].item_of(PLAN["moved from"]))
    when_read(remove)


@guarded
def remove():
    FOUND["second"] = tree()
    FOUND["kept"] = QgsSettings().value("repm/workspaces").splitlines()
    asked = []
    answer = QMessageBox.StandardButton.Yes

    def question(*given):
        asked.append(given[2])
        return answer

    QMessageBox.question = staticmethod(question)
    action("Remove", item("Orthophoto"))
    FOUND["asked"] = asked
    when_read(write)


@guarded
def write():
    FOUND["files"] = sorted(os.listdir(PLAN["folder of the scene"]))
    FOUND["layers after"] = sorted(layer.name() for layer in QgsProject.instance().mapLayers().values())
    FOUND["third"] = tree()
    holder = subprocess.Popen(
        [os.environ["REPM_ENGINE_PYTHON"], "-c", PLAN["holder"]],
        stdout=subprocess.PIPE,
        stdin=subprocess.PIPE,
        text=True,
    )
    DOCK.append(holder)
    holder.stdout.readline()
    DOCK[0].refresh()
    when_read(look_at_writer)


@guarded
def look_at_writer():
    FOUND["writer"] = DOCK[0].item_of(PLAN["folder of the scene"]).text(1)
    menu = QMenu()
    DOCK[0]._fill(menu, item("DSM"))
    FOUND["removable meanwhile"] = [each.isEnabled() for each in menu.actions() if each.text().startswith("Remove")]
    DOCK[1].communicate()
    shutil.rmtree(PLAN["moved to"])
    DOCK[0].refresh()
    when_read(end)


@guarded
def end():
    FOUND["gone"] = DOCK[0].item_of(PLAN["moved to"]).toolTip(1)
    picture(DOCK[0], "gone.png")
    plugins["repm"].unload()
    QTimer.singleShot(300, after_the_plugin)


@guarded
def after_the_plugin():
    FOUND["left"] = not sip.isdeleted(DOCK[0])
    finish()


begin(start)
