"""Runs inside a real QGIS desktop: whether REPM's docks fit small screens, beside the docked toolbox."""

import os
import sys

from qgis.core import QgsProject, QgsRasterLayer
from qgis.PyQt.QtCore import QPoint, QRect
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QAbstractButton, QComboBox, QLabel
from qgis.utils import iface, plugins
from repm.desktop.next_step import push_message

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND.update(name=PLAN["name"], sizes={}, outside={}, cut={})


def outside(dock, window):
    """The texts of visible widgets of a dock that lie beyond the window, or beyond their dock."""
    limits = [QRect(QPoint(0, 0), window.size()), QRect(dock.mapTo(window, QPoint(0, 0)), dock.size())]
    found = []
    for kind in (QAbstractButton, QLabel, QComboBox):
        for each in dock.findChildren(kind):
            place = QRect(each.mapTo(window, QPoint(0, 0)), each.size())
            if each.isVisible() and not all(limit.contains(place) for limit in limits):
                found.append(f"{type(each).__name__} {getattr(each, 'text', lambda: '')()}")
    return found


def cut(dock):
    """The buttons of a dock that are narrower than their text."""
    buttons = [each for each in dock.findChildren(QAbstractButton) if each.isVisible() and each.text()]
    return [each.text() for each in buttons if each.width() < each.fontMetrics().horizontalAdvance(each.text())]


@guarded
def look():
    window = iface.mainWindow()
    plugins["processing"].toolbox.setUserVisible(True)
    QgsProject.instance().addMapLayer(QgsRasterLayer(PLAN["dsm"], "DSM"))
    for width, height in PLAN["screens"]:
        window.showNormal()
        window.resize(width, height)
        for name, show in (("scenes", "scenes"), ("edit", "edit_dsm"), ("points", "measure_control_points")):
            dock = getattr(plugins["repm"].menu, show)()
            QTest.qWait(300)
            window.resize(width, height)
            QTest.qWait(300)
            key = f"{name}_{width}"
            FOUND["sizes"][key] = [window.width(), window.height()]
            FOUND["outside"][key] = outside(dock, window)
            FOUND["cut"][key] = cut(dock)
            FOUND.setdefault("in front", {})[key] = not dock.visibleRegion().isEmpty()
            picture(window, f"{key}.png")
            if name == "points":
                dock.setUserVisible(False)
    # The question after a run, with the longest words that we have, must not take the place of the panels.
    plugins["repm"].menu.scenes()
    text, *titles = PLAN["message"]
    push_message(iface.messageBar(), text, [(title, lambda: None) for title in titles])
    QTest.qWait(300)
    window.resize(*PLAN["screens"][-1])
    QTest.qWait(300)
    FOUND["with a message"] = [window.width(), window.height(), iface.layerTreeView().width()]
    picture(window, "message.png")
    finish()


begin(look)
