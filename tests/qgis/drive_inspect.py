"""Runs inside a real QGIS desktop: inspects images, and opens the DSM's dialog with the button of the message."""

import os
import sys

from qgis.core import QgsProject
from qgis.PyQt.QtCore import Qt, QTimer
from qgis.PyQt.QtWidgets import QApplication, QPushButton
from qgis.utils import iface

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, dialog_of, finish, guarded, picture  # noqa: E402

FOUND["name"] = "inspect"


@guarded
def inspect():
    import processing

    iface.mainWindow().resize(1280, 860)
    dialog = processing.createAlgorithmDialog("repm:inspect", PLAN["parameters"])
    dialog.show()
    dialog.algorithmFinished.connect(lambda *_: QTimer.singleShot(2000, lambda: look(dialog)))
    dialog.runButton().click()


@guarded
def look(dialog, tries=20):
    buttons = [b for b in iface.messageBar().findChildren(QPushButton) if b.isVisible()]
    if not buttons and tries:  # the layers are still being loaded
        QTimer.singleShot(1000, lambda: look(dialog, tries - 1))
        return
    dialog.close()
    iface.zoomFull()
    QApplication.processEvents()
    layer = next(each for each in QgsProject.instance().mapLayers().values() if "ootprint" in each.name())
    fill = layer.renderer().symbol().symbolLayer(0)
    FOUND["footprints are outlines"] = fill.brushStyle() == Qt.BrushStyle.NoBrush
    FOUND["buttons"] = [button.text() for button in buttons]
    QTimer.singleShot(2500, lambda: press(buttons))


@guarded
def press(buttons):
    picture(iface.mainWindow(), "map.png")
    buttons[-1].click()
    QApplication.processEvents()
    opened = dialog_of("pipeline")
    FOUND["images"] = opened.mainWidget().createProcessingParameters()["IMAGES"]
    QTimer.singleShot(800, lambda: end(opened))


@guarded
def end(opened):
    picture(opened, "dialog.png")
    finish()


begin(inspect)
