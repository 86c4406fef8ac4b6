"""Runs inside a real QGIS desktop: the preview of a DSM by its button, and what it leads to."""

import os
import sys

from qgis.core import QgsApplication, QgsProject, QgsRectangle
from qgis.PyQt.QtCore import QPoint, Qt, QTimer
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QApplication, QPushButton
from qgis.utils import iface

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND["name"] = "preview"
OPEN = []  # without a reference Python forgets what a dialog is


def buttons(bar):
    """The titles of the buttons in our message, and their presses."""
    ours = [item for item in bar.items() if item.title() == "REPM"]
    return {each.text(): each for item in ours for each in item.findChildren(QPushButton) if each.text()}


def filled(dialog):
    parameters = dialog.mainWidget().createProcessingParameters()
    names = ("IMAGES", "ALTITUDE_MIN", "ALTITUDE_MAX", "PRESET", "QUALITY", "WORKSPACE", "FILL", "EXTENT")
    return {name: parameters.get(name) for name in names}


@guarded
def start():
    iface.mainWindow().resize(1280, 720)
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline").create()
    dialog = algorithm.createCustomParametersWidget(iface.mainWindow())
    dialog.show()
    OPEN.append(dialog)
    dialog.setParameters(PLAN["pipeline"])
    button = dialog.findChild(QPushButton, "preview")
    FOUND["button"] = [button.text(), button.isVisible()]
    picture(dialog, "before.png")
    dialog.algorithmFinished.connect(
        lambda well, _: QTimer.singleShot(1500, lambda: previewed(dialog)) if well else finish(4)
    )
    button.click()
    FOUND["running"] = button.isEnabled()


@guarded
def previewed(dialog):
    FOUND["after"] = [dialog.findChild(QPushButton, "preview").isEnabled(), filled(dialog)]
    FOUND["messages"] = [list(buttons(bar)) for bar in (iface.messageBar(), dialog.messageBar())]
    FOUND["text"] = next(item.text() for item in iface.messageBar().items() if item.title() == "REPM")
    FOUND["layers"] = [
        [node.name(), node.layer().source(), node.isVisible()]
        for node in QgsProject.instance().layerTreeRoot().findLayers()
    ]
    picture(dialog, "dialog.png")
    buttons(dialog.messageBar())[PLAN["draw"]].click()
    FOUND["closed"] = not dialog.isVisible()
    canvas = iface.mapCanvas()
    canvas.setExtent(QgsProject.instance().mapLayersByName(FOUND["layers"][-1][0])[0].extent())
    canvas.refresh()
    canvas.waitWhileRendering()
    QTimer.singleShot(1000, draw)


@guarded
def draw():
    canvas = iface.mapCanvas()
    picture(iface.mainWindow(), "map.png")
    waiting = next(each for each in QApplication.topLevelWidgets() if hasattr(each, "runButton") and each not in OPEN)
    FOUND["hidden"] = waiting.isMinimized() or not waiting.isVisible()
    middle = QPoint(canvas.width() // 2, canvas.height() // 2)
    ends = [middle - QPoint(60, 60), middle + QPoint(60, 60)]
    QTest.mousePress(canvas.viewport(), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, ends[0])
    for step in range(1, 11):
        QTest.mouseMove(canvas.viewport(), ends[0] + (ends[1] - ends[0]) * step / 10)
    QTest.mouseRelease(canvas.viewport(), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, ends[1])
    QApplication.processEvents()
    FOUND["drawn"] = [waiting.isVisible(), filled(waiting)]
    to_map = canvas.getCoordinateTransform()
    asked = [to_map.toMapCoordinates(end.x(), end.y()) for end in ends]
    FOUND["area"] = box(QgsRectangle(asked[0], asked[1]))
    picture(waiting, "taken_over.png")
    finish()


def box(rectangle):
    return rectangle.xMinimum(), rectangle.xMaximum(), rectangle.yMinimum(), rectangle.yMaximum()


begin(start)
