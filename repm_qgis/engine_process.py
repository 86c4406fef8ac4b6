"""One stage in a process of its own: the messages on its standard streams, how it is cancelled, and its exit codes.

``python -m repm_qgis STAGE JOB.json``: JOB.json is an object with the stage's options; in its place ``-`` has it read
from the first line of standard input, so that no file is left behind whatever happens. Standard output carries JSON
lines only: ``{"type": "progress", "fraction": 0.25, "text": "..."}``, ``{"type": "info" | "warning", "text": "..."}``
and last ``{"type": "result", "result": {...}}`` or ``{"type": "error", "kind": "RpcMissingError", "text": "..."}``.
Beside the options, the job may name the ``language`` of texts, reports and legends (``"de"``); without it they are
English. The exit code is 0 for a result, 1 for an expected failure, 2 for a bug (``"type": "bug"`` with the traceback).

SIGTERM and Ctrl-C cancel: the stage's clean-up runs, and within 2 s the process ends with exit code 1 and the sentence.
With REPM_ENGINE_WATCH_STDIN set, so does a line ``cancel`` on standard input, which serves Windows, where signals end a
process at once; and the process ends itself and its group when its standard input closes, that is when the process that
started it is gone. On Windows all that it has started ends with it, however it ends.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
import traceback
from typing import Callable, TextIO, Tuple

from .contracts.documents import JsonObject
from .contracts.errors import Cancelled, OptionError, RepmError
from .contracts.results import Result
from .runtime.imports import import_failure, is_import_failure
from .runtime.parallel import end_workers
from .runtime.process_limits import bound_cache, keep_freed_memory, one_thread_for_sums, silence_gdal
from .runtime.progress import JsonLines
from .runtime.shortage import reserve_buffers, shortage_as_error
from .runtime.standard_input import MAX_JOB_BYTES, VARIABLE, Beginning, first_line, watched
from .runtime.together import undo_all
from .runtime.translation import reader, written_in
from .runtime.windows import end_children_with_us
from .runtime.workspace import name_nothing_more, remove_own_temporaries

_GRACE_S = 1.2  # from SIGTERM to SIGKILL where nobody else does it
_CANCELLING = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGBREAK") if hasattr(signal, name)]
Asked = Callable[[], Tuple[str, JsonObject]]
"""A function that gives the stage's name and its job; raises OptionError."""


def read_job(path: str, line: bytes = b"") -> JsonObject:
    """The options in a file, or in a line where ``path`` is "-"; raises OptionError."""
    try:
        if (len(line) if path == "-" else os.path.getsize(path)) > MAX_JOB_BYTES:
            raise OptionError("job", path, f"must have less than {MAX_JOB_BYTES >> 20} MiB")
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


class Cancelling:
    """SIGTERM and Ctrl-C: the stage is interrupted so that it cleans up; if it does not end in time, the process is
    ended.

    An exception that a signal raises can get lost, in a destructor or in a callback of native code, and it can leave a
    lock taken that the clean-up waits for. So a separate thread ends the process in time, with the sentence and the
    exit code.
    """

    def __init__(self, lines: JsonLines) -> None:
        """Made in the main thread, which is the one that signals interrupt."""
        self._lines, self._engine, self._asked, self._listening = lines, os.getpid(), False, False
        self._main = threading.get_ident()

    def listen(self) -> None:
        self._listening = True
        sys.unraisablehook = self._print_lost
        for number in _CANCELLING:
            signal.signal(number, self._on_signal)

    @staticmethod
    def _print_lost(lost: "sys.UnraisableHookArgs") -> None:
        """Print an exception that was lost, for example in a destructor; a cancel is not printed, because the thread
        handles it."""
        if not isinstance(lost.exc_value, Cancelled):
            sys.__unraisablehook__(lost)

    def stop_listening(self) -> None:
        """The work has ended, with or without success: later signals must not change the exit code. Python removes its
        own handlers when it ends, and the system's handlers would kill it then.
        """
        for number in _CANCELLING:
            signal.signal(number, signal.SIG_IGN)
        self._listening = False

    def asked(self) -> bool:
        return self._asked

    def ask(self) -> None:
        """Cancel as the signals do, from any thread; it also works while the main thread runs native code."""
        if os.name == "nt":
            signal.raise_signal(signal.SIGINT)
        else:
            # To the main thread itself: os.kill() may choose another one, and the main thread would sleep on.
            signal.pthread_kill(self._main, signal.SIGINT)
        threading.Thread(target=self._end_if_not_asked, name="end-if-not-asked", daemon=True).start()

    def _end_if_not_asked(self) -> None:
        time.sleep(_GRACE_S)
        if self._listening and not self._asked:
            name_nothing_more()
            self._end_now()

    def _on_signal(self, number: int, frame: object) -> None:
        if os.getpid() != self._engine:  # a forked worker inherits this handler; its clean-up is the engine's business
            os._exit(1)
        if self._asked:  # second request: the clean-up already runs, and the thread ends it in time
            return
        self._asked = True
        name_nothing_more()
        threading.Thread(target=self._end_in_time, name="end-in-time", daemon=True).start()
        raise Cancelled

    def _end_in_time(self) -> None:
        time.sleep(_GRACE_S)
        self._end_now()

    def _end_now(self) -> None:
        end_workers()
        undo_all()
        remove_own_temporaries()
        self._lines.last_words(type="error", kind="Cancelled", text=self._lines.translate(str(Cancelled())))
        os._exit(1)


class _Parent(Beginning):
    """Cancel on the line ``cancel`` of standard input; cancel, and soon after end the process group, once it closes."""

    def __init__(self, cancelling: Cancelling) -> None:
        self._cancelling = cancelling

    def cancelled(self) -> None:
        self._cancelling.ask()

    def closed(self) -> None:
        if hasattr(os, "killpg") and os.getpgrp() == os.getpid():  # ours alone: the parent made it for us
            os.killpg(0, signal.SIGTERM)
            time.sleep(_GRACE_S)
            os.killpg(0, signal.SIGKILL)
        elif os.name == "nt":
            self.cancelled()
            time.sleep(_GRACE_S + 0.3)  # usually the cancel has ended it before
        os._exit(1)


def _asked_for(arguments: list[str], line: bytes) -> Tuple[str, JsonObject]:
    if len(arguments) != 2:
        raise OptionError("arguments", " ".join(arguments), "must be a STAGE and a JOB.json")
    return arguments[0], read_job(arguments[1], line)


def _run(asked: Asked, lines: JsonLines) -> Result:
    one_thread_for_sums()
    keep_freed_memory()
    from .stages import run_stage

    bound_cache()
    silence_gdal()
    reserve_buffers()
    stage, job = asked()
    with written_in(job.pop("language", None), job.pop("labels", None)):
        lines.translate = reader().translate
        return run_stage(stage, job, lines)


def main(arguments: list[str]) -> int:
    def begin(cancelling: Cancelling) -> Asked:
        job_first, line = arguments[1:] == ["-"], b""
        if os.environ.get(VARIABLE):
            parent = watched(job_first)
            parent.told = _Parent(cancelling)
            line = parent.line() if job_first else b""
        elif job_first:
            line, _ = first_line()
        return lambda: _asked_for(arguments, line)

    return serve(JsonLines(own_output()), begin)


def own_output() -> TextIO:
    """A standard output for our lines only: native libraries print to the original one, see :func:`serve`."""
    return os.fdopen(os.dup(1), "w", encoding="utf-8")


def serve(lines: JsonLines, begin: Callable[[Cancelling], Asked]) -> int:
    """Run a stage and send its lines; gives the exit code.

    ``begin`` is called when signals are handled, and gives the function that reads the stage's name and job. From here
    on, prints to standard output go to standard error.
    """
    cancelling = Cancelling(lines)
    lines.cancelled_by(cancelling.asked)
    try:
        cancelling.listen()
        end_children_with_us()
        os.dup2(2, 1)
        return _ended(begin(cancelling), lines, cancelling)
    except Cancelled as cancelled:  # a signal came before the stage began, or while the last line was being prepared
        cancelling.stop_listening()
        return _send_failure(cancelled, lines)


def _ended(asked: Asked, lines: JsonLines, cancelling: Cancelling) -> int:
    """Run the stage and send the last line; gives the exit code."""
    try:
        with shortage_as_error():
            result = _run(asked, lines)
        cancelling.stop_listening()
    except Exception as error:
        cancelling.stop_listening()
        # Native code that was interrupted in a callback turns the exception into one of its own.
        return _send_failure(Cancelled() if cancelling.asked() else error, lines)
    lines.send(type="result", result=result.to_mapping())
    return 0


def _send_failure(error: Exception, lines: JsonLines) -> int:
    """Send the last line of a run that failed; gives its exit code."""
    if isinstance(error, RepmError):
        lines.send(type="error", kind=type(error).__name__, text=lines.translate(str(error)))
        return 1
    if is_import_failure(error):
        missing = import_failure(error)
        lines.send(type="error", kind=type(missing).__name__, text=lines.translate(str(missing)))
        return 1
    text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    lines.send(type="bug", kind="bug", text=text)
    return 2
