"""One stage in a process of its own: what goes over its standard streams, how it is cancelled, and its exit codes.

``python -m repm_qgis STAGE JOB.json``: JOB.json is an object with the stage's options; in its place ``-`` has it read
from the first line of standard input, so that no file is left behind whatever happens. Standard output carries JSON
lines only: ``{"type": "progress", "fraction": 0.25, "text": "..."}``, ``{"type": "info" | "warning", "text": "..."}``
and last ``{"type": "result", "result": {...}}`` or ``{"type": "error", "kind": "RpcMissingError", "text": "..."}``.
Beside the options, the job may name the ``language`` of texts, reports and legends (``"de"``); without it they are
English. The exit code is 0 for a result, 1 for an expected failure, 2 for a bug (``"type": "bug"`` with the traceback).

SIGTERM and Ctrl-C cancel: the stage's clean-up runs, and within 2 s the process ends with exit code 1 and the sentence.
With REPM_ENGINE_WATCH_STDIN set, the process ends itself and its group when its standard input closes, that is when
the process that started it is gone.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
import traceback
from typing import Any, Dict

from .errors import INSTALL_REMEDY, Cancelled, MissingPackageError, OptionError, RepmError
from .parallel import end_workers, keep_freed_memory, one_thread_for_sums
from .progress import JsonLines
from .shortage import reserve_buffers, said_in_a_sentence
from .translation import reader, written_in
from .workspace import name_nothing_more, remove_own_temporaries

_MAX_JOB_BYTES = 64 << 20
_GRACE_S = 1.2  # from SIGTERM to SIGKILL where nobody else does it


def _first_line() -> bytes:
    """The first line of standard input, which is not read any further: its end says that the parent is gone."""
    line = bytearray()
    while not line.endswith(b"\n") and len(line) <= _MAX_JOB_BYTES:
        piece = os.read(0, 65536)
        if not piece:
            break
        line += piece
    return bytes(line)


def _job(path: str, line: bytes) -> Dict[str, Any]:
    """The options in a file, or in a line where ``path`` is "-"."""
    try:
        if (len(line) if path == "-" else os.path.getsize(path)) > _MAX_JOB_BYTES:
            raise OptionError("job", path, f"must have less than {_MAX_JOB_BYTES >> 20} MiB")
        if path == "-":
            job = json.loads(line)
        else:
            with open(path, encoding="utf-8") as stream:
                job = json.load(stream)
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, RepmError):
            raise
        raise OptionError("job", path, f"must be a readable JSON file ({error})") from error
    if not isinstance(job, dict):
        raise OptionError("job", path, "must hold a JSON object with the stage's options")
    return job


class _Cancelling:
    """SIGTERM and Ctrl-C: the stage is interrupted so that it cleans up; what does not end in time is ended.

    An exception that a signal raises can get lost, in a destructor or in a callback of native code, and it can leave a
    lock taken that the clean-up waits for. So a thread of its own sees to the end, with the sentence and the exit code.
    """

    def __init__(self, lines: JsonLines) -> None:
        self._lines, self._engine, self._asked = lines, os.getpid(), False

    def listen(self) -> None:
        sys.unraisablehook = self._unheard
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._hear)

    @staticmethod
    def _unheard(lost: Any) -> None:
        """An exception that got lost in a destructor, say, is printed; a cancel is not, as the thread sees to it."""
        if not isinstance(lost.exc_value, Cancelled):
            sys.__unraisablehook__(lost)

    def stop_listening(self) -> None:
        """The work has ended, one way or the other: what comes now must not change the exit code.

        Python gives up its own handlers when it ends, and the system's would kill it then.
        """
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)

    def asked(self) -> bool:
        return self._asked

    def _hear(self, number: int, frame: object) -> None:
        if os.getpid() != self._engine:  # a forked worker inherits this handler; its clean-up is the engine's business
            os._exit(1)
        if self._asked:  # asked twice: the clean-up already runs, and the thread sees to its end
            return
        self._asked = True
        name_nothing_more()
        threading.Thread(target=self._end_in_time, name="end-in-time", daemon=True).start()
        raise Cancelled

    def _end_in_time(self) -> None:
        time.sleep(_GRACE_S)
        end_workers()
        remove_own_temporaries()
        self._lines.last_words(type="error", kind="Cancelled", text=self._lines.translate(str(Cancelled())))
        os._exit(1)


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


def _run(arguments: list[str], lines: JsonLines, line: bytes) -> Dict[str, Any]:
    one_thread_for_sums()
    keep_freed_memory()
    if len(arguments) != 2:
        raise OptionError("arguments", " ".join(arguments), "must be a STAGE and a JOB.json")
    from .imagery.raster import bound_cache
    from .stages import run_stage

    bound_cache()
    reserve_buffers()
    job = _job(arguments[1], line)
    with written_in(job.pop("language", None)):
        lines.translate = reader().translate
        return run_stage(arguments[0], job, lines)


def main(arguments: list[str]) -> int:
    # Native libraries print to standard output at will: keep it for our lines, and send theirs to standard error.
    lines = JsonLines(os.fdopen(os.dup(1), "w", encoding="utf-8"))
    cancelling = _Cancelling(lines)
    lines.cancelled_by(cancelling.asked)
    try:
        cancelling.listen()
        os.dup2(2, 1)
        line = _first_line() if arguments[1:] == ["-"] else b""
        if os.environ.get("REPM_ENGINE_WATCH_STDIN"):
            _end_with_parent()
        return _ended(arguments, lines, cancelling, line)
    except Cancelled as cancelled:  # heard before the stage began, or while the last line was being prepared
        cancelling.stop_listening()
        return _said(cancelled, lines)


def _ended(arguments: list[str], lines: JsonLines, cancelling: _Cancelling, line: bytes) -> int:
    """Run the stage and send the last line; gives the exit code."""
    try:
        with said_in_a_sentence():
            result = _run(arguments, lines, line)
        cancelling.stop_listening()
    except Exception as error:
        cancelling.stop_listening()
        # Native code that was interrupted amid a callback turns the exception into one of its own.
        return _said(Cancelled() if cancelling.asked() else error, lines)
    lines.send(type="result", result=result)
    return 0


def _said(error: Exception, lines: JsonLines) -> int:
    """Send the last line of a run that failed; gives its exit code."""
    if isinstance(error, RepmError):
        lines.send(type="error", kind=type(error).__name__, text=lines.translate(str(error)))
        return 1
    # A part of the engine itself that is missing is no package.
    if isinstance(error, ImportError) and not (error.name or "").startswith(__package__ or "repm_qgis"):
        reason = " ".join(str(error).split())[:300]  # numpy's has paragraphs
        missing = MissingPackageError(
            f"The Python package '{error.name}' is not installed for {sys.executable} ({reason}): {INSTALL_REMEDY}."
        )
        lines.send(type="error", kind=type(missing).__name__, text=lines.translate(str(missing)))
        return 1
    text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    lines.send(type="bug", kind="bug", text=text)
    return 2
