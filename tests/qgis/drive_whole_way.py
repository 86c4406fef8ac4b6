"""Runs inside a real QGIS desktop: from images on the map to a DSM that is registered, compared and edited.

Each click of a user is counted, named, and has a picture of the screen before it, with a mark where it is.
"""

import os
import sys

from qgis.core import QgsProject
from qgis.PyQt.QtCore import QEvent, QPoint, QPointF, Qt, QTimer
from qgis.PyQt.QtGui import QColor, QMouseEvent, QPainter, QPen
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QApplication, QComboBox, QDockWidget, QPushButton
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, dialog_of, finish, guarded, window  # noqa: E402

FOUND["name"] = "whole_way"
FOUND["clicks"], FOUND["moved"] = [], ""
LEFT, NONE = Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton


def screen(place=None):
    """A picture of the screen, with a ring around a place."""
    QApplication.processEvents()
    shot = QApplication.primaryScreen().grabWindow(0)
    if place is not None:
        painter = QPainter(shot)
        painter.setPen(QPen(QColor("#d01c1c"), 4))
        painter.drawEllipse(place, 24, 24)
        painter.end()
    shot.save(os.path.join(PLAN["folder"], f"{len(FOUND['clicks']):02d}.png"))


def click(widget, name=""):
    """A left click in the middle of what is seen of a widget; one that nobody could press fails."""
    assert widget.isVisible() and widget.isEnabled(), name
    widget.window().raise_()
    QApplication.processEvents()
    assert widget.visibleRegion().contains(widget.rect().center()), name or widget.text()
    FOUND["clicks"].append(name or widget.text().replace("&", ""))
    screen(widget.mapToGlobal(widget.rect().center()))
    QTest.mouseClick(widget, LEFT, Qt.KeyboardModifier.NoModifier, widget.rect().center())


def button(bar, title):
    """A button of a message."""
    return next(
        each for item in bar.items() for each in item.findChildren(QPushButton) if each.text().replace("&", "") == title
    )


def run(name, then):
    """Press Run of an algorithm's dialog, and go on when it is done."""
    dialog = dialog_of(name)
    dialog.move(150, 20)
    dialog.resize(980, 760)
    QApplication.processEvents()
    dialog.algorithmFinished.connect(
        lambda well, _: QTimer.singleShot(2500, lambda: then(dialog)) if well else finish(4)
    )
    click(dialog.runButton())


def soon(step):
    QTimer.singleShot(1500, step)


@guarded
def images():
    """Before the count: the sample images, as the panel of the first start makes them."""
    iface.mainWindow().move(0, 0)
    iface.mainWindow().resize(1380, 880)
    for dock in iface.mainWindow().findChildren(QDockWidget):
        if dock.windowTitle() in ("Browser", "Results Viewer", "Processing Toolbox"):
            dock.close()
    plugins["repm"].menu.first_steps()
    panel = window("FirstSteps")
    panel.sample.click()
    soon(make_images)


@guarded
def make_images():
    dialog = dialog_of("sampledata")
    dialog.algorithmFinished.connect(lambda *_: QTimer.singleShot(2500, lambda: first(dialog)))
    dialog.runButton().click()


@guarded
def first(dialog):
    dialog.close()
    iface.mapCanvas().zoomToFullExtent()
    iface.mapCanvas().waitWhileRendering()
    click(window("FirstSteps").dsm)
    soon(lambda: (window("FirstSteps").close(), run("pipeline", made)))


@guarded
def made(dialog):
    click(button(dialog.messageBar(), PLAN["compare"]))
    soon(reference)


@guarded
def reference():
    dialog = dialog_of("comparedsm")
    dialog.move(150, 20)
    widget = dialog.mainWidget().wrappers["REFERENCE"].wrappedWidget()
    box = next(each for each in widget.findChildren(QComboBox))
    click(box, "the list Reference")
    QApplication.processEvents()
    rows = [row for row in range(box.count()) if box.itemText(row).startswith(PLAN["truth"])]
    place = box.view().visualRect(box.model().index(rows[0], 0)).center()
    FOUND["clicks"].append(PLAN["truth"])
    screen(box.view().viewport().mapToGlobal(place))
    box.setCurrentIndex(rows[0])
    box.hidePopup()
    soon(lambda: run("comparedsm", compared))


@guarded
def compared(dialog):
    click(button(dialog.messageBar(), PLAN["register"]))
    soon(lambda: run("register", registered))


@guarded
def registered(dialog):
    FOUND["moved"] = next(item.text() for item in dialog.messageBar().items() if item.title() == "REPM")
    click(button(dialog.messageBar(), PLAN["again"]))
    soon(lambda: run("dsmfuse", again))


@guarded
def again(dialog):
    click(button(dialog.messageBar(), PLAN["compare"]))
    soon(lambda: run("comparedsm", compared_again))


@guarded
def compared_again(dialog):
    click(button(dialog.messageBar(), PLAN["edit"]))
    soon(edit)


@guarded
def edit():
    dock = plugins["repm"].menu.edit_dsm()
    FOUND["dsm"] = dock.records.dsm
    iface.mapCanvas().waitWhileRendering()
    click(dock.buttons["brush"])
    soon(lambda: stroke(dock))


def mouse(kind, pixel, pressed, buttons):
    event = QMouseEvent(kind, QPointF(pixel), QPointF(pixel), pressed, buttons, Qt.KeyboardModifier.NoModifier)
    QApplication.sendEvent(iface.mapCanvas().viewport(), event)


@guarded
def stroke(dock):
    middle = iface.mapCanvas().viewport().rect().center()
    places = [middle + QPoint(step, step // 2) for step in range(-40, 41, 8)]
    FOUND["clicks"].append("a stroke on the map")
    screen(iface.mapCanvas().viewport().mapToGlobal(middle))
    mouse(QEvent.Type.MouseButtonPress, places[0], LEFT, LEFT)
    for place in places[1:]:
        mouse(QEvent.Type.MouseMove, place, NONE, LEFT)
    mouse(QEvent.Type.MouseButtonRelease, places[-1], LEFT, NONE)
    wait(dock)


@guarded
def wait(dock, tries=300):
    if dock._task is not None and tries:
        QTimer.singleShot(200, lambda: wait(dock, tries - 1))
        return
    FOUND["said"], FOUND["edits"] = dock.said.text(), len(dock.records.edits)
    FOUND["layers"] = sorted(layer.name() for layer in QgsProject.instance().mapLayers().values())
    iface.mapCanvas().refresh()
    QTimer.singleShot(1500, end)


@guarded
def end():
    iface.mapCanvas().waitWhileRendering()
    FOUND["clicks"].append("")
    screen()
    FOUND["clicks"].pop()
    finish()


begin(images)
