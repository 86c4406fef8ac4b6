"""``python -m repm_qgis STAGE JOB.json``: one stage in a process of its own.

JOB.json is an object with the stage's options. Standard output carries JSON lines only:
``{"type": "progress", "fraction": 0.25, "text": "..."}``, ``{"type": "info" | "warning", "text": "..."}`` and last
``{"type": "result", "result": {...}}`` or ``{"type": "error", "kind": "RpcMissingError", "text": "..."}``.
The exit code is 0 for a result, 1 for an expected failure, 2 for a bug (``"type": "bug"`` with the traceback).

A SIGTERM cancels: the stage's clean-up runs, and the exit code is 1. With REPM_ENGINE_WATCH_STDIN set, the process ends
itself and its group when its standard input closes, that is when the process that started it is gone.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
import traceback
from typing import Any

from .errors import Cancelled, MissingPackageError, OptionError, RepmError
from .parallel import keep_freed_memory, one_thread_for_sums
from .progress import JsonLines

_MAX_JOB_BYTES = 64 << 20
_GRACE_S = 1.2  # from SIGTERM to SIGKILL where nobody else does it


def _job(path: str) -> dict[str, Any]:
    try:
        if os.path.getsize(path) > _MAX_JOB_BYTES:
            raise OptionError("job", path, f"must be a file of less than {_MAX_JOB_BYTES >> 20} MiB")
        with open(path, encoding="utf-8") as stream:
            job = json.load(stream)
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, RepmError):
            raise
        raise OptionError("job", path, f"must be a readable JSON file ({error})") from error
    if not isinstance(job, dict):
        raise OptionError("job", path, "must hold a JSON object with the stage's options")
    return job


def _cancel_on_sigterm() -> None:
    engine = os.getpid()

    def cancel(number: int, frame: object) -> None:
        if os.getpid() != engine:  # a forked worker inherits this handler; its clean-up is the engine's business
            os._exit(1)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise Cancelled

    signal.signal(signal.SIGTERM, cancel)


def _end_with_parent() -> None:
    """Cancel, and soon after end the process group, once standard input closes."""

    def watch() -> None:
        try:
            while os.read(0, 4096):
                pass
        except OSError:
            pass
        if hasattr(os, "killpg") and os.getpgrp() == os.getpid():  # ours alone: the parent made it for us
            os.killpg(0, signal.SIGTERM)
            time.sleep(_GRACE_S)
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=watch, name="watch-parent", daemon=True).start()


def main(arguments: list[str]) -> int:
    # Native libraries print to standard output at will: keep it for our lines, and send theirs to standard error.
    lines = JsonLines(os.fdopen(os.dup(1), "w", encoding="utf-8"))
    os.dup2(2, 1)
    if os.environ.get("REPM_ENGINE_WATCH_STDIN"):
        _end_with_parent()
    try:
        one_thread_for_sums()
        keep_freed_memory()
        _cancel_on_sigterm()
        if len(arguments) != 2:
            raise OptionError("arguments", " ".join(arguments), "must be a STAGE and a JOB.json")
        from .imagery.raster import bound_cache
        from .stages import run_stage

        bound_cache()

        lines.send(type="result", result=run_stage(arguments[0], _job(arguments[1]), lines))
        return 0
    except RepmError as error:
        lines.send(type="error", kind=type(error).__name__, text=str(error))
        return 1
    except ImportError as error:
        if (error.name or "").startswith(__package__ or "repm_qgis"):  # a part of the engine itself, no package
            lines.send(type="bug", kind="bug", text=traceback.format_exc())
            return 2
        missing = MissingPackageError(
            f"The Python package '{error.name}' is not installed for {sys.executable} ({error}): "
            "run scripts/setup in the plugin's folder, or the Environment report for the command that installs it."
        )
        lines.send(type="error", kind=type(missing).__name__, text=str(missing))
        return 1
    except Exception:
        lines.send(type="bug", kind="bug", text=traceback.format_exc())
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
