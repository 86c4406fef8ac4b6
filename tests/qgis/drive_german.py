"""Runs inside a real QGIS desktop in German: what our windows show, text by text."""

import os
import sys

from qgis.core import QgsApplication
from qgis.PyQt.QtWidgets import QAbstractButton, QApplication, QComboBox, QLabel
from qgis.utils import iface, plugins

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, begin, finish, guarded, picture  # noqa: E402

FOUND["name"] = "german"


def texts(window):
    """What its labels, buttons and lists say, and its title."""
    found = [window.windowTitle()]
    for widget in window.findChildren(QLabel) + window.findChildren(QAbstractButton):
        found += [widget.text(), widget.toolTip()]
    for widget in window.findChildren(QComboBox):
        found += [widget.itemText(index) for index in range(widget.count())]
    return found


def of_our_panel(dialog):
    """The parameters alone: the rest of the dialog is QGIS's."""
    return texts(dialog.mainWidget())


@guarded
def look():
    FOUND["windows"] = {}
    for algorithm in QgsApplication.processingRegistry().providerById("repm").algorithms():
        dialog = algorithm.create().createCustomParametersWidget(iface.mainWindow())
        if dialog is not None:
            dialog.resize(1000, 820)
            dialog.show()
            QApplication.processEvents()
            FOUND["windows"][algorithm.name()] = of_our_panel(dialog)
            if algorithm.name() in ("pipeline", "inspect"):
                picture(dialog, f"{algorithm.name()}.png")
            dialog.close()
    menu = plugins["repm"].menu
    entries = {action.text(): action.menu() for action in iface.pluginMenu().actions() if action.menu()}
    FOUND["windows"]["menu"] = [action.text() for action in entries["REPM"].actions()]
    menu.first_steps()
    QApplication.processEvents()
    ours = [widget for widget in QApplication.topLevelWidgets() if type(widget).__module__.startswith("repm.")]
    for widget in ours:
        FOUND["windows"][type(widget).__name__] = texts(widget)
    FOUND["windows"]["control points"] = texts(menu.measure_control_points())
    finish()


begin(look)
