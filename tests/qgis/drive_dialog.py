"""Runs inside a real QGIS desktop: what our dialogs add to Processing's, looked at widget by widget."""

import gc
import os
import sys
import weakref

import processing
from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import QgsApplication, QgsProcessingContext, QgsProcessingFeedback, QgsProcessingParameterDefinition
from qgis.PyQt.QtCore import QEvent
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import (
    QAbstractSpinBox,
    QApplication,
    QGroupBox,
    QLabel,
    QLineEdit,
    QMenu,
    QScrollArea,
    QTextEdit,
)
from qgis.utils import iface

sys.path.insert(0, os.environ["REPM_DESKTOP_DRIVERS"])
from desktop_steps import FOUND, PLAN, begin, finish, guarded, picture  # noqa: E402

FOUND["name"] = "dialogs"
COLMAP = ("GEOMETRIC", "COLMAP_FUSION", "WINDOW_RADIUS", "GPU_MEMORY")


def opened(name):
    algorithm = QgsApplication.processingRegistry().algorithmById(f"repm:{name}").create()
    dialog = algorithm.createCustomParametersWidget(iface.mainWindow())
    dialog.show()
    QApplication.processEvents()
    return dialog


def offered(panel, name):
    """The texts of a parameter's list; the second one is chosen."""
    line = panel.wrappers[name].wrappedWidget()
    next(action for action in line.actions() if action.objectName() == "list").trigger()
    menu = line.findChildren(QMenu)[-1]
    texts = [action.text() for action in menu.actions()]
    if len(texts) > 1:
        menu.actions()[1].trigger()
    menu.close()
    return texts, panel.wrappers[name].parameterValue()


def listed(panel, name):
    """The files of a list in its widget, once it was given those of the plan."""
    panel.setParameters({name: PLAN["lists"][name]})
    return list(panel.wrappers[name].parameterValue() or [])


def shown(panel):
    QApplication.processEvents()
    return [name for name in COLMAP if panel.wrappers[name].wrappedWidget().isVisible()]


def kept_while_shown():
    """Whether Python still has a dialog that only Qt refers to: while it is shown, and after that."""
    dialog = processing.createAlgorithmDialog("repm:inspect")
    dialog.show()
    QApplication.processEvents()
    there = weakref.ref(dialog)
    states = []
    for close in (False, True):
        if close:
            dialog.close()
            QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        dialog = None
        gc.collect()
        states.append(there() is not None)
        dialog = there()
    return states


def line_of(panel, name):
    return panel.wrappers[name].wrappedWidget().findChild(QLineEdit)


def places():
    """Where products go that have no name, and those with a name but no folder."""
    dialog = opened("pipeline")
    panel = dialog.mainWidget()
    panel.setParameters({"IMAGES": PLAN["images"][:2]})
    workspaces = [panel.wrappers["WORKSPACE"].parameterValue()]
    panel.setParameters({"IMAGES": PLAN["images"]})
    workspaces.append(panel.wrappers["WORKSPACE"].parameterValue())
    QTest.keyClicks(line_of(panel, "CONFIDENCE"), "trust.tif")
    given = panel.createProcessingParameters()["CONFIDENCE"]
    found = {"typed": given.sink.staticValue(), "loaded": given.destinationProject is not None}
    found["hint"] = line_of(panel, "OUTPUT").placeholderText()
    picture(dialog, "workspace.png")
    panel.setParameters({"WORKSPACE": PLAN["own"]})
    panel.setParameters({"IMAGES": PLAN["images"][:2]})
    workspaces.append(panel.wrappers["WORKSPACE"].parameterValue())
    dialog.close()
    dialog = opened("dtm")
    panel = dialog.mainWidget()
    panel.setParameters({"DSM": PLAN["dsm"]})
    QTest.keyClicks(line_of(panel, "REPORT"), "trees")
    given = panel.createProcessingParameters()
    found["beside"] = [given["OUTPUT"].sink.staticValue(), given["HEIGHTS"].sink.staticValue(), given["REPORT"]]
    found["terrain"] = line_of(panel, "OUTPUT").placeholderText()
    dialog.close()
    dialog = opened("batch")
    panel = dialog.mainWidget()
    panel.setParameters({"FOLDER": os.path.dirname(PLAN["images"][0])})
    given = panel.createProcessingParameters()
    found["many"] = [given["WORKSPACE"], given["OUTPUT"].sink.staticValue(), given["REPORT"], given["PRODUCTS"]]
    picture(dialog, "batch.png")
    dialog.close()
    return {**found, "workspaces": workspaces}


@guarded
def look():
    FOUND["places"] = places()
    dialog = opened("reconstruct")
    panel = dialog.mainWidget()
    FOUND["scene"] = panel.wrappers["SCENE"].parameterValue()
    (group,) = panel.findChildren(QGroupBox)
    group.setProperty("collapsed", False)
    FOUND["usual"] = shown(panel)
    panel.setParameters({"BACKEND": "colmap", "WINDOW_RADIUS": 7})
    group.setProperty("collapsed", True)
    group.setProperty("collapsed", False)
    FOUND["differs"] = shown(panel)
    FOUND["given"] = dialog.mainWidget().createProcessingParameters()["WINDOW_RADIUS"]
    dialog.close()
    ProcessingConfig.setSettingValue("REPM_COLMAP_WINDOW_RADIUS", 9)
    panel = opened("reconstruct").mainWidget()
    FOUND["set"] = [panel.createProcessingParameters()["WINDOW_RADIUS"], shown(panel)]
    ProcessingConfig.setSettingValue("REPM_COLMAP_WINDOW_RADIUS", 5)

    FOUND["narrow"] = {}
    for name in PLAN["dialogs"]:
        dialog = opened(name)
        for box in dialog.mainWidget().findChildren(QGroupBox):
            box.setProperty("collapsed", False)
        dialog.resize(688, 523)  # as QGIS 3.22 opens it
        QApplication.processEvents()
        QApplication.processEvents()
        areas = [area for area in dialog.mainWidget().findChildren(QScrollArea) if area.widget() is not None]
        FOUND["narrow"][name] = [area.horizontalScrollBar().maximum() for area in areas]
        dialog.close()

    dialog = opened("pipeline")
    panel = dialog.mainWidget()
    advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
    definitions = dialog.algorithm().parameterDefinitions()
    FOUND["basic"] = [each.name() for each in definitions if not (each.flags() & advanced or each.isDestination())]
    FOUND["headings"] = [label.text() for label in panel.findChildren(QLabel, "heading")]
    box = panel.wrappers["FILL"].wrappedWidget()
    FOUND["words"] = {box.itemData(index): box.itemText(index) for index in range(box.count())}
    FOUND["zero"] = panel.wrappers["RESOLUTION"].wrappedWidget().findChildren(QAbstractSpinBox)
    FOUND["zero"] = [each.text() for each in FOUND["zero"] or [panel.wrappers["RESOLUTION"].wrappedWidget()]]
    lowest = panel.wrappers["ALTITUDE_MIN"].wrappedWidget()
    FOUND["empty"] = [each.text() for each in lowest.findChildren(QAbstractSpinBox) or [lowest]]
    boxes = {name: panel.wrappers[name].wrappedWidget() for name in ("PRESET", "QUALITY")}
    FOUND["fast"] = {name: box.itemText(box.findData("fast")) for name, box in boxes.items()}
    FOUND["references"], FOUND["reference datum"] = offered(panel, "REFERENCE_DATUM")
    FOUND["datums"], FOUND["datum"] = offered(panel, "VERTICAL_DATUM")
    FOUND["line"] = isinstance(panel.wrappers["VERTICAL_DATUM"].wrappedWidget(), QLineEdit)
    values = {}
    for preset in PLAN["presets"]:
        panel.setParameters({"PRESET": preset})
        values[preset] = {name: panel.wrappers[name].parameterValue() for name in PLAN["names"]}
    FOUND["presets"] = values
    panel.setParameters({"PRESET": "mountains"})
    panel.setParameters({"FILL": "none"})
    panel.setParameters({"PRESET": "none"})
    FOUND["changed"] = [panel.wrappers[name].parameterValue() for name in ("MODEL", "FILL")]
    panel.setParameters({"PRESET": "mountains", "MODEL": "homography"})  # from the history
    FOUND["history"] = [panel.wrappers[name].parameterValue() for name in ("MODEL", "FILL")]
    picture(dialog, "preset.png")
    FOUND["lists"] = {"RPCS": listed(panel, "RPCS")}
    log = next(each for each in dialog.findChildren(QTextEdit) if each.objectName() == "txtLog")
    dialog.setInfo("still shown")
    dialog.iterateParam = None  # as of a run
    dialog.finish(False, {}, QgsProcessingContext(), QgsProcessingFeedback())
    FOUND["log of a failure"] = log.toPlainText()
    dialog.close()

    dialog = opened("mosaic")
    FOUND["lists"].update({name: listed(dialog.mainWidget(), name) for name in ("SCENES", "FIXED")})
    dialog.close()

    panel = opened("errormap").mainWidget()
    FOUND["views"], FOUND["view"] = offered(panel, "VIEW")
    panel.setParameters({"SCENE": "gone.json"})
    FOUND["no views"], _ = offered(panel, "VIEW")
    panel = opened("exportcameras").mainWidget()
    taken = panel.wrappers["SCENE"].parameterValue()
    FOUND["not refined"] = taken if isinstance(taken, str) else ""  # QGIS has a NULL of its own
    panel.setParameters({"SCENE": FOUND["scene"]})
    FOUND["tiles"], _ = offered(panel, "TILE")
    FOUND["kept"] = kept_while_shown()
    finish()


begin(look)
