"""Runs inside a real QGIS desktop (``qgis --code``): opens an algorithm from the toolbox, runs it, tells what came.

The plan has title and parameters. Writes found.json, toolbox.png,
dialog.png, log.png and map.png into the folder, and ends QGIS. See desktop_steps.py.
"""

import os
import sys

from qgis.core import QgsProject
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QDockWidget, QLabel
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402


@guarded
def open_from_toolbox():
    iface.mainWindow().resize(1280, 860)
    toolbox = plugins["processing"].toolbox
    toolbox.setUserVisible(True)
    tree = toolbox.algorithmTree
    toolbox.searchBox.setText("satellite")
    tree.setFilterString("satellite")
    tree.expandAll()
    toolbox.resize(380, 560)
    QApplication.processEvents()
    picture(toolbox, "toolbox.png")
    toolbox.searchBox.setText(PLAN["title"])
    tree.setFilterString(PLAN["title"])
    tree.expandAll()
    index = tree.model().index(0, 0)
    while index.isValid() and tree.algorithmForIndex(index) is None:
        index = tree.model().index(0, 0, index)
    tree.setCurrentIndex(index)
    chosen = tree.selectedAlgorithm()
    FOUND["chosen"] = chosen.id() if chosen else None
    FOUND["name"] = chosen.name()
    QTimer.singleShot(1500, fill_in)
    toolbox.executeAlgorithm()


@guarded
def fill_in():
    dialogs = [
        widget
        for widget in QApplication.topLevelWidgets()
        if hasattr(widget, "algorithm") and hasattr(widget, "runButton") and widget.isVisible()
    ]
    dialog = dialogs[0]
    dialog.setParameters(PLAN["parameters"])
    dialog.resize(980, 760)
    FOUND["title"] = dialog.windowTitle()
    FOUND["help"] = len(dialog.algorithm().shortHelpString())
    QApplication.processEvents()
    picture(dialog, "dialog.png")
    dialog.algorithmFinished.connect(lambda success, results: QTimer.singleShot(1500, lambda: look(dialog, success)))
    dialog.runButton().click()


@guarded
def look(dialog, success):
    FOUND["success"] = bool(success)
    picture(dialog, "log.png")
    dialog.close()
    for node in QgsProject.instance().layerTreeRoot().findLayers():  # from top to bottom
        layer = node.layer()
        renderer = layer.renderer() if hasattr(layer, "renderer") else None
        FOUND["layers"].append(
            {
                "name": layer.name(),
                "valid": layer.isValid(),
                "crs": layer.crs().authid(),
                "source": layer.source(),
                "renderer": type(renderer).__name__,
                "in_3d": layer.renderer3D().type() if layer.renderer3D() is not None else "",
                "group": node.parent().name(),
                "shown": node.isVisible(),
            }
        )
    if QgsProject.instance().mapLayers():
        iface.mapCanvas().zoomToFullExtent()
    plugins["processing"].toolbox.setUserVisible(False)
    for dock in iface.mainWindow().findChildren(QDockWidget):
        if dock.windowTitle() in ("Browser", "Results Viewer"):
            dock.close()
    iface.mapCanvas().refresh()
    QTimer.singleShot(2500, show_map)


@guarded
def show_map():
    iface.mapCanvas().waitWhileRendering()
    picture(iface.mainWindow(), "map.png")
    follow_link()
    finish()


def follow_link():
    """Click the link in the legend of a DSM twice, and look whether the confidence is shown."""
    links = [each for each in iface.layerTreeView().findChildren(QLabel) if "href" in each.text() and each.isVisible()]
    FOUND["links"] = [each.text() for each in links]
    FOUND["linked"] = []
    for link in links * 2:
        link.linkActivated.emit("confidence")
        QApplication.processEvents()
        active = iface.activeLayer()
        node = QgsProject.instance().layerTreeRoot().findLayer(active.id())
        FOUND["linked"].append([active.name(), node.isVisible()])
    iface.mapCanvas().waitWhileRendering()
    picture(iface.mainWindow(), "linked.png")


begin(open_from_toolbox)
