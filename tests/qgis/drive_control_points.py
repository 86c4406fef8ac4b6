"""Runs inside a real QGIS desktop: measures control points as a user does, by mouse and keys, and looks at the file."""

import os
import sys

import numpy as np
from qgis.core import QgsProject, QgsRasterLayer
from qgis.PyQt.QtCore import QEvent, QPoint, QPointF, Qt, QTimer
from qgis.PyQt.QtGui import QMouseEvent
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QApplication, QMessageBox
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND["name"] = "control_points"
MADE = PLAN["made"]


def marks():
    """How many marks and bands are on the map; QGIS has some of its own."""
    return sum(
        "Vertex" in type(item).__name__ or "Band" in type(item).__name__ for item in iface.mapCanvas().scene().items()
    )


def near(dock, view):
    panel = next(panel for panel in dock.panels if panel.name == view)
    panel.image.setFocus()
    QApplication.processEvents()
    return panel.image


def click(image, pixel):
    place = image.place_of(np.array(pixel))
    QTest.mouseClick(
        image, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, QPoint(round(place.x()), round(place.y()))
    )


def look_at_one_image(dock):
    """Measures two points in the only image, and saves them."""
    assert dock.open_images(MADE["images"][:1]), dock.said.text()
    assert dock.open_points(PLAN["points"]), dock.said.text()
    FOUND["one image"] = [dock.said.text()]
    for gcp in dock.measuring.points[:2]:
        dock.choose(gcp.id)
        dock.measure("img_01", np.array(PLAN["pixels"][gcp.id]["img_01"]))
    FOUND["one image"] += [dock.said.text(), dock.panels[0].said.text()]
    picture(iface.mainWindow(), "one_image.png")
    dock.save(PLAN["one"])
    dock._path = ""


@guarded
def open_dock():
    FOUND["before"] = marks()
    iface.mainWindow().resize(1380, 880)
    truth = QgsRasterLayer(MADE["truth"], "truth")
    QgsProject.instance().addMapLayer(truth)
    QgsProject.instance().setCrs(truth.crs())
    iface.mapCanvas().setDestinationCrs(truth.crs())
    iface.mapCanvas().setExtent(truth.extent())
    dock = plugins["repm"].menu.measure_control_points()
    FOUND["first words"] = dock.said.text()
    look_at_one_image(dock)
    assert dock.open_images(MADE["images"]), dock.said.text()
    FOUND["views"] = [panel.name for panel in dock.panels]
    assert dock.open_points(PLAN["elsewhere"]), dock.said.text()
    FOUND["elsewhere"] = dock.said.text()
    assert dock.open_points(PLAN["points"]), dock.said.text()
    FOUND["points"] = len(dock.measuring.points)
    QTimer.singleShot(1500, lambda: measure(dock))


@guarded
def measure(dock):
    name = dock.measuring.points[0].id
    for view, pixel in PLAN["pixels"][name].items():
        click(near(dock, view), pixel)
    gcp = dock.measuring.point(name)
    FOUND["clicked"] = {view: list(pixel) for view, pixel in gcp.pixels.items()}
    image = near(dock, "img_02")
    before = gcp.pixels["img_02"].copy()
    QTest.keyClick(image, Qt.Key.Key_Right)
    QTest.keyClick(image, Qt.Key.Key_Up, Qt.KeyboardModifier.ShiftModifier)
    FOUND["nudged"] = list(dock.measuring.point(name).pixels["img_02"] - before)
    dock.undo()
    dock.undo()
    FOUND["undone"] = list(dock.measuring.point(name).pixels["img_02"] - before)
    QTest.keyClick(image, Qt.Key.Key_Delete)
    FOUND["deleted"] = "img_02" in dock.measuring.point(name).pixels
    QTest.keyClick(image, Qt.Key.Key_S)
    FOUND["skipped"] = next(panel for panel in dock.panels if panel.name == "img_02").said.text()
    dock.undo()
    dock.undo()
    FOUND["summary"] = dock.said.text()
    FOUND["offset"] = list(dock.table.check(0).offset)
    scale = image.scale
    image.zoom(1)
    FOUND["zoom"] = image.scale / scale
    kept = image.pixel_at(QPointF(10, 10))
    image.zoom(-1, QPointF(10, 10))
    FOUND["zoom keeps"] = list(image.pixel_at(QPointF(10, 10)) - kept)
    QApplication.setActiveWindow(iface.mainWindow())  # no window manager does it here
    QTest.keyClick(image, Qt.Key.Key_PageDown)
    FOUND["next"] = dock._current
    for name in [*list(PLAN["pixels"])[2:], dock._current]:
        dock.choose(name)
        for view, pixel in PLAN["pixels"][name].items():
            click(near(dock, view), pixel)
    QTimer.singleShot(800, lambda: show(dock))


@guarded
def show(dock):
    QApplication.processEvents()
    iface.mapCanvas().waitWhileRendering()
    picture(iface.mainWindow(), "window.png")
    picture(dock, "dock.png")
    map_click(dock)


@guarded
def map_click(dock):
    dock.heights.setLayer(QgsProject.instance().mapLayersByName("truth")[0])
    dock.new_button.click()
    FOUND["tool"] = iface.mapCanvas().mapTool() is dock._tool
    canvas = iface.mapCanvas()
    where = canvas.getCoordinateTransform().transform(canvas.extent().center())
    place = QPointF(where.x(), where.y())
    for kind in (QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonRelease):
        button = Qt.MouseButton.LeftButton
        event = QMouseEvent(kind, place, place, button, button, Qt.KeyboardModifier.NoModifier)
        QApplication.sendEvent(canvas.viewport(), event)
    new = dock.measuring.point(dock._current)
    FOUND["new"] = [new.id, new.lon, new.lat, new.height]
    FOUND["title"] = dock.windowTitle()
    dock.table.setData(dock.table.index(dock.measuring.points.index(new), 0), "roof")
    FOUND["renamed"] = dock._current
    FOUND["refused"] = dock.table.setData(dock.table.index(0, 7), "north")
    FOUND["why"] = dock.said.text()
    path = os.path.join(PLAN["folder"], "measured.csv")
    FOUND["saved"] = dock.save(path)
    FOUND["title saved"] = dock.windowTitle()
    dock.remove()
    with open(path, encoding="utf-8") as stream:
        FOUND["file"] = stream.read()
    assert dock.open_points(path), dock.said.text()
    FOUND["again"] = {gcp.id: sorted(gcp.pixels) for gcp in dock.measuring.points}
    QMessageBox.question = lambda *_: finish(5)  # nothing is unsaved now
    dock.close()
    plugins["repm"].unload()
    QApplication.processEvents()
    QTimer.singleShot(300, after)


@guarded
def after():
    FOUND["left"] = marks() - FOUND["before"]
    finish()


begin(open_dock)
