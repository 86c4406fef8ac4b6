"""Reports of a batch run in Processing's results viewer, past an error of QGIS's own.

QGIS's batch dialog (3.22 to 3.44 at least) hands each HTML output to the viewer without a time, which the viewer
requires: when all is made, the run ends in a Python error. Here the time may be missing.
"""

from __future__ import annotations

import inspect
import time


def allow_missing_times() -> None:
    """Let the results viewer take pages without a time: they get that of their arrival."""
    from processing.core.ProcessingResults import resultsList

    add = resultsList.addResult
    if inspect.signature(add).parameters["timestamp"].default is not inspect.Parameter.empty:
        return  # by us, or by a QGIS that has fixed it

    def with_time(icon: object, name: str, timestamp: object = None, result: object = None) -> None:
        add(icon, name, timestamp or time.localtime(), result)

    resultsList.addResult = with_time


def require_times_again() -> None:
    """Leave the viewer as it was."""
    from processing.core.ProcessingResults import resultsList

    vars(resultsList).pop("addResult", None)
