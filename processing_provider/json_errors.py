"""Why a run failed, as JSON: qgis_process with --json writes a result to its standard output, but nothing of a failure.

The lines are those of the engine (repm_qgis/engine_process.py): ``{"type": "error", "kind": "RpcMissingError", "text":
"..."}``, or ``"type": "bug"`` with the traceback.
"""

from __future__ import annotations

import json
import os
import traceback
from contextlib import contextmanager
from typing import Iterator

from qgis.core import QgsApplication, QgsProcessingException
from qgis.PyQt.QtCore import QCoreApplication

BUG = "bug"
_written: list[str] = []  # one document in a process: models hand a failure of one of their parts on


def wanted() -> bool:
    """Whether this is qgis_process and its caller reads JSON; ``-`` has it read JSON too, and answer in it."""
    arguments = QCoreApplication.arguments()
    return QgsApplication.platform() == "qgis_process" and ("--json" in arguments or arguments[-1:] == ["-"])


def write_error(text: str, kind: str) -> None:
    """Write why this run failed where a program is to read it; a process writes one such document only."""
    if wanted() and not _written:
        _written.append(json.dumps({"type": BUG if kind == BUG else "error", "kind": kind, "text": text}))
        os.write(1, f"{_written[0]}\n".encode())


def failure(text: str, kind: str) -> QgsProcessingException:
    """An expected failure, which keeps the name of the engine's exception."""
    error = QgsProcessingException(text)
    error.kind = kind
    return error


@contextmanager
def errors_as_json() -> Iterator[None]:
    """Write whatever ends the block by an exception, and pass it on."""
    try:
        yield
    except QgsProcessingException as error:
        write_error(str(error), getattr(error, "kind", "Error"))
        raise
    except Exception as error:
        write_error("".join(traceback.format_exception(type(error), error, error.__traceback__)), BUG)
        raise
