"""Runs inside a real QGIS desktop (3.26 or later): a DSM in the elevation profile tool, as its style file leaves it.

The plan has dsm, a raster with its .qml beside it.
"""

import os
import sys

from qgis.core import QgsLineString, QgsPoint, QgsProject, QgsRasterLayer
from qgis.gui import QgsElevationProfileCanvas
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication
from qgis.utils import iface

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND["name"] = "profile"


@guarded
def open_the_tool():
    iface.mainWindow().resize(1280, 860)
    layer = QgsRasterLayer(PLAN["dsm"], "DSM")  # QGIS reads the style beside it
    QgsProject.instance().addMapLayer(layer)
    FOUND["elevation"] = layer.elevationProperties().isEnabled()
    actions = [each for each in iface.viewMenu().actions() if each.objectName() == "mActionElevationProfile"]
    actions[0].trigger()
    QTimer.singleShot(1500, lambda: draw(layer))


@guarded
def draw(layer):
    (canvas,) = iface.mainWindow().findChildren(QgsElevationProfileCanvas)
    FOUND["offered"] = [each.name() for each in canvas.layers()]
    extent = layer.extent()
    ends = [QgsPoint(x, extent.center().y()) for x in (extent.xMinimum(), extent.xMaximum())]
    canvas.setProfileCurve(QgsLineString(ends))
    canvas.refresh()
    QTimer.singleShot(2500, lambda: fit(canvas))


@guarded
def fit(canvas):
    canvas.zoomFull()
    QApplication.processEvents()
    seen = canvas.visibleElevationRange()
    FOUND["heights"] = [seen.lower(), seen.upper()]
    QTimer.singleShot(1500, lambda: show(canvas))


@guarded
def show(canvas):
    picture(canvas, "tool.png")
    finish()


begin(open_the_tool)
