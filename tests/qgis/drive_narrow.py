"""Runs inside a real QGIS desktop: whether dialogs fit QGIS's own size, and choices are in words."""

import os
import sys

from qgis.core import QgsApplication
from qgis.PyQt.QtWidgets import QApplication, QGroupBox, QScrollArea
from qgis.utils import iface

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND["name"] = "narrow"


@guarded
def look():
    FOUND["narrow"] = {}
    for name in PLAN["dialogs"]:
        algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}").create()
        dialog = algorithm.createCustomParametersWidget(iface.mainWindow())
        dialog.show()
        for box in dialog.mainWidget().findChildren(QGroupBox):
            box.setProperty("collapsed", False)
        dialog.resize(688, 523)
        QApplication.processEvents()
        QApplication.processEvents()
        picture(dialog, f"{name}.png")
        areas = [area for area in dialog.mainWidget().findChildren(QScrollArea) if area.widget() is not None]
        FOUND["narrow"][name] = [area.horizontalScrollBar().maximum() for area in areas]
        if name == "pipeline":
            box = dialog.mainWidget().wrappers["QUALITY"].wrappedWidget()
            FOUND["words"] = {box.itemData(index): box.itemText(index) for index in range(box.count())}
            FOUND["values"] = []
            for index in range(box.count()):
                box.setCurrentIndex(index)
                FOUND["values"].append(dialog.mainWidget().wrappers["QUALITY"].parameterValue())
        dialog.close()
    model = QgsApplication.processingRegistry().algorithmById("repm:dsm_by_stages")
    FOUND["model"] = [each.name() for each in model.parameterDefinitions()]
    finish()


begin(look)
