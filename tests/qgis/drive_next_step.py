"""Runs inside a real QGIS desktop: from images to a DSM in the right place, by the buttons of the messages alone."""

import os
import sys

from qgis.core import QgsApplication, QgsProject, QgsRectangle
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QPushButton
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, dialog_of, finish, guarded, picture  # noqa: E402

FOUND["name"] = "next_step"
FOUND["messages"], FOUND["filled"] = [], {}
OPEN = []  # without a reference Python forgets what a dialog is


def buttons(bar):
    """The titles of the buttons in our message, and their presses; QGIS has messages with buttons of its own."""
    ours = [item for item in bar.items() if item.title() == "REPM"]
    return {each.text(): each for item in ours for each in item.findChildren(QPushButton) if each.text()}


def messages(dialog):
    """What the map and the dialog offer."""
    texts = [item.text() for item in iface.messageBar().items() if item.title() == "REPM"]
    FOUND["messages"].append([*texts, list(buttons(iface.messageBar())), list(buttons(dialog.messageBar()))])


def run(name, values, then):
    """Run the open dialog of an algorithm with some values changed; what was filled in is kept."""
    dialog = dialog_of(name)
    if name == "pipeline":  # nothing is filled in
        dialog.setParameters(values)
    for key, value in values.items() if name != "pipeline" else ():
        dialog.mainWidget().wrappers[key].setParameterValue(value, dialog.mainWidget().processing_context)
    filled = dialog.mainWidget().createProcessingParameters()
    FOUND["filled"][name] = {key: value for key, value in filled.items() if isinstance(value, (str, list, float))}
    if hasattr(filled.get("OUTPUT"), "sink"):
        FOUND["filled"][name]["OUTPUT"] = filled["OUTPUT"].sink.staticValue()
    for key in ("DSM", "SCENE"):
        layer = QgsProject.instance().mapLayer(str(filled.get(key)))
        if layer is not None:
            FOUND["filled"][name][key] = layer.source()
    dialog.resize(1000, 700)
    dialog.algorithmFinished.connect(
        lambda well, _: QTimer.singleShot(1500, lambda: then(dialog)) if well else finish(4)
    )
    dialog.runButton().click()


@guarded
def start():
    iface.mainWindow().resize(1280, 860)
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline").create()
    dialog = algorithm.createCustomParametersWidget(iface.mainWindow())
    dialog.show()
    OPEN.append(dialog)
    QTimer.singleShot(500, lambda: run("pipeline", PLAN["pipeline"], compare))


@guarded
def compare(dialog):
    messages(dialog)
    surface = next(each for each in QgsProject.instance().mapLayers().values() if each.name().startswith("DSM"))
    FOUND["crs"] = [QgsProject.instance().crs().authid(), surface.crs().authid()]
    buttons(dialog.messageBar())[PLAN["compare"]].click()
    FOUND["closed"] = not dialog.isVisible()
    QTimer.singleShot(800, lambda: run("comparedsm", {"REFERENCE": PLAN["reference"]}, register))


@guarded
def register(dialog):
    messages(dialog)
    buttons(dialog.messageBar())[PLAN["register"]].click()
    QTimer.singleShot(800, lambda: run("register", {"REFERENCE_DATUM": "ellipsoid"}, look))


@guarded
def look(dialog):
    messages(dialog)
    picture(dialog, "dialog.png")
    dialog.close()
    show()


@guarded
def show(tries=60):
    if iface.messageBar().currentItem().title() != "REPM" and tries:  # QGIS's own word that a task is done
        QTimer.singleShot(250, lambda: show(tries - 1))
        return
    layer = next(each for each in QgsProject.instance().mapLayers().values() if "differences" in each.source().lower())
    views = []
    for title in (PLAN["before"], PLAN["after"]):
        buttons(iface.messageBar())[title].click()
        views.append([layer.styleManager().currentStyle(), layer.renderer().band()])
        iface.mapCanvas().zoomToFullExtent()
        QApplication.processEvents()
        iface.mapCanvas().waitWhileRendering()
        picture(iface.mainWindow(), f"{title.lower()}.png")
    FOUND["views"] = views
    root = QgsProject.instance().layerTreeRoot()
    FOUND["visible"] = [node.name() for node in root.findLayers() if node.isVisible()]
    FOUND["shown"] = QgsProject.instance().layerTreeRoot().findLayer(layer.id()).isVisible()
    iface.mapCanvas().setExtent(QgsRectangle(0, 0, 10, 10))  # another place
    root.findGroup("old town").setExpanded(False)
    buttons(iface.messageBar())[PLAN["again"]].click()
    QTimer.singleShot(800, lambda: run("dsmfuse", {}, compare_again))


@guarded
def compare_again(dialog):
    messages(dialog)
    QApplication.processEvents()
    surface = next(each for each in QgsProject.instance().mapLayers().values() if each.name().startswith("DSM reg"))
    root, map_settings = QgsProject.instance().layerTreeRoot(), iface.mapCanvas().mapSettings()
    place = map_settings.layerExtentToOutputExtent(surface, surface.extent())
    FOUND["in sight"] = iface.mapCanvas().extent().contains(place)
    FOUND["groups"] = {each.name(): [each.itemVisibilityChecked(), each.isExpanded()] for each in root.findGroups()}
    FOUND["ticks"] = {node.name(): node.isVisible() for node in root.findLayers()}
    picture(iface.mainWindow(), "fused_again.png")
    buttons(dialog.messageBar())[PLAN["compare"]].click()
    QTimer.singleShot(800, lambda: run("comparedsm", {}, end))


@guarded
def end(dialog):
    dialog.close()
    FOUND["names"] = [
        [node.name(), node.parent().name()] for node in QgsProject.instance().layerTreeRoot().findLayers()
    ]
    FOUND["last"] = list(buttons(iface.messageBar()))
    buttons(iface.messageBar())[PLAN["edit"]].click()
    FOUND["edited"] = plugins["repm"].menu.edit_dsm().records.dsm
    plugins["repm"].unload()
    FOUND["after the plugin"] = sum(item.title() == "REPM" for item in iface.messageBar().items())
    finish()


begin(start)
