"""Runs inside a real QGIS desktop: a DSM and its hillshade are one layer, in lists, for Identify, when stored."""

import os
import sys

from qgis.core import QgsApplication, QgsProcessingUtils, QgsProject, QgsRasterLayer
from qgis.gui import QgsMapLayerComboBox, QgsMapToolIdentify
from qgis.PyQt.QtCore import Qt, QTimer
from qgis.PyQt.QtGui import QContextMenuEvent
from qgis.PyQt.QtWidgets import QApplication, QComboBox
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402
from repm.processing_provider.styles import shade  # noqa: E402

FOUND["name"] = "hillshades"
PROJECT, ROOT = QgsProject.instance(), QgsProject.instance().layerTreeRoot()


def tree(index=None):
    """What the panel Layers shows, with the state of each tick."""
    view = iface.layerTreeView()
    model = view.model()
    found = []
    for row in range(model.rowCount(*([index] if index is not None else []))):
        child = model.index(row, 0, *([index] if index is not None else []))
        node = view.index2node(child) if hasattr(view, "index2node") else None
        if node is not None:
            found.append(node.name())
            found += tree(child) if node.nodeType() == 0 else []
    return found


def boxes_of(widget):
    found = [box for box in widget.findChildren(QComboBox) if box.metaObject().className() == "QgsMapLayerComboBox"]
    return [[box.itemText(i).split(" [")[0] for i in range(box.count())] for box in found]


def drawn():
    """The map's pixels, as a sum: another map has another one."""
    iface.mapCanvas().refresh()
    QApplication.processEvents()
    iface.mapCanvas().waitWhileRendering()
    QApplication.processEvents()
    image = iface.mapCanvas().grab().toImage()
    return hash(bytes(image.constBits().asarray(image.sizeInBytes())))


def all_there_is():
    node = next(each for each in ROOT.findLayers() if each.name() == "DSM town")
    identify = QgsMapToolIdentify(iface.mapCanvas())
    middle = iface.mapCanvas().viewport().rect().center()
    hits = identify.identify(middle.x(), middle.y(), QgsMapToolIdentify.IdentifyMode.TopDownAll)
    box = QgsMapLayerComboBox()
    algorithm = QgsApplication.processingRegistry().algorithmById("native:slope").create()
    import processing

    dialog = processing.createAlgorithmDialog(algorithm.id())
    lists = [row for row in boxes_of(dialog) if row]
    dialog.deleteLater()
    return {
        "project": sorted(layer.name() for layer in PROJECT.mapLayers().values()),
        "tree": tree(),
        "combo": [box.itemText(i) for i in range(box.count())],
        "dialog": lists,
        "processing": [layer.name() for layer in QgsProcessingUtils.compatibleRasterLayers(PROJECT)],
        "identified": [hit.mLayer.name() for hit in hits],
        "map": [layer.name() for layer in iface.mapCanvas().layers()],
        "drawn": drawn(),
        "place": [each.name() for each in node.parent().children()],
    }


@guarded
def start():
    iface.mainWindow().resize(1280, 860)
    dsm = QgsRasterLayer(PLAN["dsm"], "DSM town")
    dsm.loadNamedStyle(PLAN["dsm"].replace(".tif", ".qml"))
    PROJECT.addMapLayer(dsm)
    PROJECT.setCrs(dsm.crs())
    iface.mapCanvas().setExtent(dsm.extent())
    FOUND["plain"] = drawn()
    shade(ROOT.findLayer(dsm.id()))
    iface.setActiveLayer(dsm)
    QTimer.singleShot(800, first)


@guarded
def first():
    FOUND["first"] = all_there_is()
    picture(iface.mainWindow(), "one_layer.png")
    node = next(each for each in ROOT.findLayers() if each.name() == "DSM town")
    node.setItemVisibilityChecked(False)
    FOUND["hidden"] = [layer.name() for layer in ROOT.layerOrder() if ROOT.findLayer(layer.id()).isVisible()]
    node.setItemVisibilityChecked(True)
    action = plugins["repm"].menu._hillshades._action
    FOUND["action"] = [action.isChecked()]
    action.trigger()
    QTimer.singleShot(500, lambda: without(action))


@guarded
def without(action):
    FOUND["without"] = drawn()
    FOUND["action"].append(action.isChecked())
    action.trigger()
    ROOT.insertGroup(0, "elsewhere")
    QTimer.singleShot(500, drag)


@guarded
def drag():
    """As the mouse drags it: by a text in which layers are named, and the old node is removed afterwards."""
    model = iface.layerTreeView().layerTreeModel()
    node = next(each for each in ROOT.findLayers() if each.name() == "DSM town")
    index = model.node2index(node)
    data = model.mimeData([index])
    group = model.node2index(ROOT.findGroup("elsewhere"))
    model.dropMimeData(data, Qt.DropAction.MoveAction, 0, 0, group)
    node.parent().removeChildNode(node)
    QTimer.singleShot(500, dragged)


def zoom_to_group():
    """By the entry of the menu that a right click shows; QGIS's own would crash here."""
    view, canvas = iface.layerTreeView(), iface.mapCanvas()
    group = ROOT.findGroup("elsewhere")
    index = view.node2index(group)
    view.scrollTo(index)
    view.setCurrentIndex(index)
    before = canvas.extent()
    canvas.setExtent(before.scaled(9.0))
    place = view.visualRect(index).center()
    chosen = []

    def choose():
        menu = QApplication.activePopupWidget()
        if menu is None:
            QTimer.singleShot(100, choose)
            return
        chosen.extend(each for each in menu.actions() if each.text().replace("&", "") == "Zoom to Group")
        for each in chosen:
            each.trigger()
        menu.close()

    QTimer.singleShot(100, choose)
    event = QContextMenuEvent(
        QContextMenuEvent.Reason.Mouse, place, view.viewport().mapToGlobal(place), Qt.KeyboardModifier.NoModifier
    )
    QApplication.sendEvent(view.viewport(), event)
    (layer,) = (node.layer() for node in group.findLayers() if node.name() == "DSM town")
    FOUND["zoomed"] = [len(chosen), canvas.extent().width() / layer.extent().width()]
    FOUND["zoomed"].append(canvas.extent().contains(layer.extent()))
    canvas.setExtent(before)


@guarded
def dragged():
    FOUND["dragged"] = [all_there_is()]
    zoom_to_group()
    model = iface.layerTreeView().layerTreeModel()
    PROJECT.layerTreeRoot().insertGroup(0, "outer")
    group = ROOT.findGroup("elsewhere")
    data = model.mimeData([model.node2index(group)])
    model.dropMimeData(data, Qt.DropAction.MoveAction, 0, 0, model.node2index(ROOT.findGroup("outer")))
    group.parent().removeChildNode(group)
    QTimer.singleShot(500, group_dragged)


@guarded
def group_dragged():
    FOUND["dragged"].append(all_there_is())
    FOUND["stored"] = PROJECT.write(PLAN["project"])
    FOUND["after writing"] = [layer.name() for layer in iface.mapCanvas().layers()]
    iface.newProject(False)
    QTimer.singleShot(500, reopen)


@guarded
def reopen():
    FOUND["new"] = [ROOT.findLayers() == [], len(plugins["repm"].menu._hillshades._shades)]
    iface.addProject(PLAN["project"])
    QTimer.singleShot(1500, reopened)


@guarded
def reopened():
    FOUND["dirty"] = PROJECT.isDirty()
    FOUND["reopened"] = all_there_is()
    picture(iface.mainWindow(), "reopened.png")
    plugins["repm"].unload()
    QApplication.processEvents()
    FOUND["unloaded"] = [[each.name() for each in ROOT.findLayers()], drawn()]
    PROJECT.removeAllMapLayers()
    FOUND["left"] = len(iface.mapCanvas().layers())
    finish()


begin(start)
