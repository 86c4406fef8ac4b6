"""Runs inside a real QGIS desktop with an empty profile: the zip is installed, then the packages, sample images, a DSM.

Counts the clicks that a user makes after "Install Plugin", and takes a picture of each step.
"""

import os
import sys

from qgis.core import QgsProject
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QDockWidget, QMessageBox
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, dialog_of, finish, guarded, picture, window  # noqa: E402

FOUND["name"] = "first_hour"
FOUND["clicks"] = []


def click(button):
    FOUND["clicks"].append(button.text().replace("&", ""))
    button.click()


def when(ready, step, milliseconds=300):
    """Go on with a step once a condition holds; the plan's time ends what never comes."""
    if ready():
        QTimer.singleShot(500, step)
    else:
        QTimer.singleShot(milliseconds, lambda: when(ready, step, milliseconds))


def screen(name):
    QApplication.processEvents()
    shot = QApplication.primaryScreen().grabWindow(0)
    shot.save(os.path.join(PLAN["folder"], name))


def say_yes():
    """QGIS asks whether the author of a zip is trusted."""
    box = QApplication.activeModalWidget()
    if isinstance(box, QMessageBox):
        box.button(QMessageBox.StandardButton.Yes).click()


@guarded
def install_the_zip():
    import pyplugin_installer

    iface.mainWindow().move(0, 0)
    iface.mainWindow().resize(1280, 860)
    for wait in (300, 1000, 2000):
        QTimer.singleShot(wait, say_yes)
    pyplugin_installer.instance().installFromZipFile(PLAN["zip"])
    when(lambda: "repm" in plugins and window("FirstSteps"), look_at_the_panel)


@guarded
def look_at_the_panel():
    screen("1_panel.png")
    click(window("FirstSteps").install)
    when(lambda: window("InstallDialog"), install)


@guarded
def install():
    dialog = window("InstallDialog")
    screen("2_install.png")
    click(dialog.install)
    QTimer.singleShot(4000, lambda: screen("3_running.png"))
    when(lambda: dialog.doing.text().startswith("The packages are installed"), installed)


@guarded
def installed():
    dialog = window("InstallDialog")
    picture(dialog, "4_installed.png")
    click(dialog.close_button)
    click(window("FirstSteps").sample)
    when(lambda: any(hasattr(each, "runButton") for each in QApplication.topLevelWidgets()), make_images)


@guarded
def make_images():
    dialog = dialog_of("sampledata")
    dialog.algorithmFinished.connect(lambda *_: QTimer.singleShot(1500, lambda: make_dsm(dialog)))
    click(dialog.runButton())


@guarded
def make_dsm(dialog):
    dialog.close()
    click(window("FirstSteps").dsm)
    QTimer.singleShot(2000, run_dsm)


@guarded
def run_dsm():
    dialog = dialog_of("pipeline")
    screen("5_dsm.png")
    dialog.algorithmFinished.connect(lambda success, _: QTimer.singleShot(2500, lambda: look(dialog, success)))
    click(dialog.runButton())


@guarded
def look(dialog, success):
    FOUND["success"] = bool(success)
    FOUND["layers"] = sorted(layer.name() for layer in QgsProject.instance().mapLayers().values())
    dialog.close()
    window("FirstSteps").close()
    for dock in iface.mainWindow().findChildren(QDockWidget):
        if dock.windowTitle() in ("Browser", "Results Viewer", "Processing Toolbox"):
            dock.close()
    iface.mapCanvas().zoomToFullExtent()
    iface.mapCanvas().refresh()
    own_word = lambda: iface.messageBar().currentItem().title() == "REPM"  # noqa: E731 - QGIS's goes after seconds
    QTimer.singleShot(2500, lambda: when(own_word, show_map))


@guarded
def show_map():
    iface.mapCanvas().waitWhileRendering()
    screen("6_map.png")
    finish()


begin(install_the_zip)
