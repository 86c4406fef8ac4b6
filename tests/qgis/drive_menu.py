"""Runs inside a real QGIS desktop: the first start's panel, step by step, and the documents of the menu."""

import os
import sys

from qgis.core import QgsProject, QgsSettings
from qgis.PyQt.QtCore import QObject, Qt, QTimer, QUrl, pyqtSlot
from qgis.PyQt.QtGui import QDesktopServices
from qgis.PyQt.QtWidgets import QApplication, QPushButton
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, dialog_of, finish, guarded, picture, window  # noqa: E402

FOUND["name"] = "menu"


class Browser(QObject):
    """Stands in for the system's browser."""

    @pyqtSlot(QUrl)
    def open(self, address):
        with open(address.toLocalFile(), encoding="utf-8") as stream:
            FOUND.setdefault("pages", []).append(stream.read()[:3000])


BROWSER = Browser()


@guarded
def look_at_the_panel():
    menus = {action.text(): action.menu() for action in iface.pluginMenu().actions() if action.menu()}
    FOUND["menu"] = [action.text() for action in menus["REPM"].actions()]
    for title in ("Inspect images…", "Make a DSM…"):  # each opens its dialog
        for action in menus["REPM"].actions():
            if action.text() == title:
                action.trigger()
    opened = [each for each in QApplication.topLevelWidgets() if hasattr(each, "runButton") and each.isVisible()]
    FOUND["opened"] = sorted(each.algorithm().name() for each in opened)
    for each in opened:
        each.close()
    panel = window("FirstSteps")
    FOUND["shown"] = panel is not None
    if panel is None:
        dock = plugins["repm"].menu.measure_control_points()
        dock.open_images(PLAN["images"])
        FOUND["dock"] = [dock.windowTitle(), dock.said.text(), dock.table.headerData(1, Qt.Orientation.Horizontal)]
        FOUND["dock"].append([button.text() for button in dock.panels[0].findChildren(QPushButton)])
        iface.mainWindow().resize(1380, 880)
        QApplication.processEvents()
        picture(dock, "dock.png")
        finish()
    FOUND["second step"] = panel.dsm.isEnabled()
    picture(panel, "first_steps.png")
    QDesktopServices.setUrlHandler("file", BROWSER, "open")
    panel.sample.click()
    QTimer.singleShot(1500, make_images)


@guarded
def make_images():
    dialog = dialog_of("sampledata")
    FOUND["folder"] = dialog.mainWidget().createProcessingParameters()["FOLDER"]
    dialog.setParameters({"FOLDER": os.path.join(PLAN["folder"], "sample images"), "SIZE": 300})
    dialog.algorithmFinished.connect(lambda *_: QTimer.singleShot(500, lambda: make_dsm(dialog)))
    dialog.runButton().click()


@guarded
def make_dsm(dialog):
    dialog.close()
    panel = window("FirstSteps")
    FOUND["second step after the first"] = panel.dsm.isEnabled()
    panel.dsm.click()
    QTimer.singleShot(1500, run_dsm)


@guarded
def run_dsm():
    dialog = dialog_of("pipeline")
    dialog.algorithmFinished.connect(lambda success, _: QTimer.singleShot(1500, lambda: read(dialog, success)))
    dialog.runButton().click()


@guarded
def read(dialog, success):
    FOUND["success"] = bool(success)
    FOUND["layers"] = sorted(layer.name() for layer in QgsProject.instance().mapLayers().values())
    dialog.close()
    window("FirstSteps").tutorial.click()
    menu = next(action.menu() for action in iface.pluginMenu().actions() if action.text() == "REPM")
    next(action for action in menu.actions() if action.text() == "Help").trigger()
    QTimer.singleShot(1000, after_reading)


@guarded
def after_reading():
    FOUND["kept"] = QgsSettings().value("repm/first_steps_shown", False, type=bool)
    plugins["repm"].unload()
    QApplication.processEvents()
    QTimer.singleShot(300, after_the_plugin)


@guarded
def after_the_plugin():
    FOUND["left"] = window("FirstSteps") is not None
    FOUND["menu after"] = [action.text() for action in iface.pluginMenu().actions() if action.text() == "REPM"]
    finish()


begin(look_at_the_panel)
