"""What the drivers share that run inside a real QGIS desktop (``qgis --code``): the plan, steps, pictures, the end.

The plan (JSON) is the file that REPM_DESKTOP_PLAN names; ``folder`` gets found.json and the pictures.
"""

import json
import os
import sys
import traceback

from qgis.core import QgsProject
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication

with open(os.environ["REPM_DESKTOP_PLAN"], encoding="utf-8") as stream:
    PLAN = json.load(stream)
FOUND = {"steps": [], "layers": []}


def finish(code=0):
    with open(os.path.join(PLAN["folder"], "found.json"), "w", encoding="utf-8") as output:
        json.dump(FOUND, output, indent=1)
    QgsProject.instance().setDirty(False)
    sys.stdout.flush()
    os._exit(code)  # the questions that QGIS asks at its end have nobody to answer them here


def guarded(step):
    def run(*arguments):
        try:
            FOUND["steps"].append(step.__name__)
            step(*arguments)
        except Exception:
            FOUND["error"] = traceback.format_exc()
            finish(1)

    return run


def picture(widget, name):
    widget.grab().save(os.path.join(PLAN["folder"], name))


def window(kind):
    """The visible window of a class, by its name; None where there is none."""
    found = [
        widget for widget in QApplication.topLevelWidgets() if type(widget).__name__ == kind and widget.isVisible()
    ]
    return found[0] if found else None


def dialog_of(name):
    """The open dialog of an algorithm."""
    return next(
        widget
        for widget in QApplication.topLevelWidgets()
        if hasattr(widget, "runButton") and widget.isVisible() and widget.algorithm().name() == name
    )


def of_a_slot(kind, value, trace):
    """An exception in code that Qt calls: QGIS would show it in a window, and go on."""
    FOUND["error"] = "".join(traceback.format_exception(kind, value, trace))
    finish(1)


def begin(step):
    """Run a step when the desktop is there, and end it all when the plan's time is over."""
    sys.excepthook = of_a_slot
    QTimer.singleShot(1000 * PLAN["seconds"], lambda: finish(3))
    QTimer.singleShot(1000, step)
