"""Runs inside a real QGIS desktop: edits a DSM on the map as a user does, by the mouse, and looks at the files."""

import os
import sys

from qgis.core import QgsPointXY, QgsProject, QgsRasterLayer
from qgis.PyQt.QtCore import QEvent, QPoint, QPointF, Qt, QTimer
from qgis.PyQt.QtGui import QMouseEvent
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QApplication
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND["name"] = "surface_editing"
LEFT, RIGHT, NONE = Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton, Qt.MouseButton.NoButton


def bands():
    return sum("Band" in type(item).__name__ for item in iface.mapCanvas().scene().items())


def mouse(kind, place, button, buttons):
    pixel = iface.mapCanvas().getCoordinateTransform().transform(QgsPointXY(*place))
    point = QPointF(round(pixel.x()), round(pixel.y()))
    event = QMouseEvent(kind, point, point, button, buttons, Qt.KeyboardModifier.NoModifier)
    QApplication.sendEvent(iface.mapCanvas().viewport(), event)


def click(place, button=LEFT):
    mouse(QEvent.Type.MouseButtonPress, place, button, button)
    mouse(QEvent.Type.MouseButtonRelease, place, button, NONE)


def shape(places):
    for place in places:
        click(place)
        mouse(QEvent.Type.MouseMove, (place[0] + 1, place[1]), NONE, NONE)
    click(places[-1], RIGHT)


def choose(dock, operation):
    dock.operation.setCurrentIndex(dock.operation.findData(operation))


def done(dock, then, tries=100):
    """Go on when the edited DSM is made."""
    if dock._task is None:
        QTimer.singleShot(200, then)
    elif tries:
        QTimer.singleShot(100, lambda: done(dock, then, tries - 1))
    else:
        FOUND["error"] = "the edited DSM is not made"
        finish(1)


def layers():
    root = QgsProject.instance().layerTreeRoot()
    return [[node.name(), node.isVisible(), node.layer().source()] for node in root.findLayers()]


@guarded
def open_dock():
    iface.mainWindow().resize(1380, 880)
    FOUND["before"] = bands()
    for name, path in (("DSM town", PLAN["dsm"]), ("Confidence town", PLAN["confidence"])):
        layer = QgsRasterLayer(path, name)
        if name.startswith("DSM"):
            layer.loadNamedStyle(PLAN["dsm"].replace(".tif", ".qml"))
            top = layer
        QgsProject.instance().addMapLayer(layer)
    from repm.processing_provider.styles import shade

    shade(QgsProject.instance().layerTreeRoot().findLayer(top.id()))
    QgsProject.instance().layerTreeRoot().findLayers()[0].setItemVisibilityChecked(False)
    QgsProject.instance().setCrs(top.crs())
    iface.mapCanvas().setDestinationCrs(top.crs())
    iface.mapCanvas().setExtent(top.extent())
    iface.setActiveLayer(top)
    dock = plugins["repm"].menu.edit_dsm()
    QApplication.processEvents()
    FOUND["chosen"] = [dock.layers.currentLayer().name(), dock.confidence.currentLayer().name()]
    FOUND["first words"] = dock.said.text()
    QTimer.singleShot(1500, lambda: polygon(dock))


@guarded
def polygon(dock):
    choose(dock, "fill")
    FOUND["offered"] = [dock.value.isEnabled(), [kind for kind, each in dock.buttons.items() if each.isVisible()]]
    dock.buttons["polygon"].click()
    FOUND["tool"] = [iface.mapCanvas().mapTool() is dock._tool, dock.buttons["polygon"].isChecked()]
    click(PLAN["house"][0])
    QTest.keyClick(iface.mapCanvas(), Qt.Key.Key_Escape)  # not this one
    shape([*PLAN["house"][:1], (PLAN["house"][0][0] + 3, PLAN["house"][0][1])])  # two corners are no polygon
    FOUND["none yet"] = len(dock.records.edits)
    shape(PLAN["house"])
    done(dock, lambda: brush(dock))


@guarded
def brush(dock):
    FOUND["after the polygon"] = [dock.said.text(), layers()]
    iface.mapCanvas().waitWhileRendering()
    picture(iface.mainWindow(), "filled.png")
    choose(dock, "set")
    dock.value.setValue(77.5)
    dock.width_m.setValue(6.0)
    dock.buttons["brush"].click()
    start, *rest = PLAN["stroke"]
    mouse(QEvent.Type.MouseButtonPress, start, LEFT, LEFT)
    for place in rest:
        mouse(QEvent.Type.MouseMove, place, NONE, LEFT)
    iface.mapCanvas().waitWhileRendering()
    QApplication.processEvents()
    picture(iface.mainWindow(), "brush.png")
    mouse(QEvent.Type.MouseButtonRelease, rest[-1], LEFT, NONE)
    done(dock, lambda: water(dock))


@guarded
def water(dock):
    choose(dock, "flatten")
    FOUND["automatic"] = dock.value.text()
    dock.buttons["polygon"].click()
    shape(PLAN["water"])
    choose(dock, "breakline")  # while the DSM is being made
    FOUND["line"] = [kind for kind, each in dock.buttons.items() if each.isVisible()]
    dock.buttons["line"].click()
    shape(PLAN["line"])
    done(dock, lambda: wrong(dock))


@guarded
def wrong(dock):
    FOUND["list"] = [dock.list.item(i).text() for i in range(dock.list.count())]
    FOUND["four"] = dock.said.text()
    choose(dock, "fill")
    dock.buttons["polygon"].click()
    shape(PLAN["void"])
    done(dock, lambda: untick(dock))


@guarded
def untick(dock):
    FOUND["taken back"] = [dock.said.text(), len(dock.records.edits)]
    picture(dock, "dock.png")
    dock.list.item(1).setCheckState(Qt.CheckState.Unchecked)
    done(dock, lambda: undo(dock))


@guarded
def undo(dock):
    iface.mapCanvas().waitWhileRendering()
    picture(iface.mainWindow(), "edited.png")
    with open(dock.records.edited, "rb") as stream:
        FOUND["size"] = len(stream.read())
    FOUND["enabled"] = [edit.enabled for edit in dock.records.edits]
    os.rename(dock.records.edited, dock.records.edited + ".three")
    dock.undo_button.click()
    done(dock, lambda: after_undo(dock))


@guarded
def after_undo(dock):
    FOUND["left edits"] = [edit.operation for edit in dock.records.edits]
    FOUND["layers"] = layers()
    FOUND["renderers"] = {
        layer.name(): layer.renderer().type()
        for layer in QgsProject.instance().mapLayers().values()
        if "edited" in layer.source()
    }
    edited = next(layer for layer in QgsProject.instance().mapLayers().values() if layer.name() == "Edited: DSM town")
    iface.setActiveLayer(edited)
    FOUND["of the edited layer"] = [dock.records.dsm == PLAN["dsm"], dock.list.count()]
    FOUND["kept"] = QPoint(0, 0).isNull() and sorted(os.listdir(os.path.dirname(PLAN["dsm"])))
    dock.close()
    plugins["repm"].unload()
    QApplication.processEvents()
    QTimer.singleShot(300, after)


@guarded
def after():
    FOUND["left"] = bands() - FOUND["before"]
    finish()


begin(open_dock)
