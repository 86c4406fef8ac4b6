"""Runs one engine stage: light ones in QGIS's process, heavy ones in a process tree of their own.

The engine process speaks JSON lines (see repm_qgis/__main__.py). It is started in its own session, so that Cancel ends
it with everything it started, and with a pipe on its standard input that closes when QGIS dies, so that it ends too.
"""

from __future__ import annotations

import collections
import json
import os
import queue
import shlex
import signal
import subprocess  # nosec B404 # see its one use
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Callable, Iterator, Optional, TypeVar, cast

from qgis.core import QgsApplication, QgsProcessingException, QgsProcessingFeedback, QgsProjUtils
from qgis.PyQt.QtCore import QCoreApplication, QProcess, QProcessEnvironment

from ..repm_qgis.contracts.documents import JsonMapping, JsonObject
from ..repm_qgis.contracts.stages import R, Stage
from ..repm_qgis.installer.environments import usable, user_home
from ..repm_qgis.installer.interpreter import candidates, is_program, program_in, variables
from ..repm_qgis.installer.pip import without_password
from ..repm_qgis.runtime.packages import PACKAGES
from . import settings
from .cleanup import remove_half_written
from .json_errors import BUG, failure, write_error
from .language import labels, language, said

PLUGIN_FOLDER = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
WATCH_VARIABLE = "REPM_ENGINE_WATCH_STDIN"
_POLL_S = 0.1
_ASK_S = 30
_GRACE_S = 1.2  # for the engine to remove half-written files; the whole of Cancel must take less than 2 s
_WINDOWS = os.name == "nt"
_NORMAL_EXIT = QProcess.ExitStatus.NormalExit
_Result = TypeVar("_Result")


class FeedbackProgress:
    """The engine's Progress, shown by QGIS; ``translate`` brings texts into QGIS's language where they are not yet."""

    def __init__(self, feedback: QgsProcessingFeedback, translate: Callable[[str], str] = str) -> None:
        self._feedback, self._translate, self._text, self._percent = feedback, translate, "", 0.0

    def step(self, fraction: float, text: str = "") -> None:
        self._percent = max(self._percent, 100.0 * min(max(float(fraction), 0.0), 1.0))
        self._feedback.setProgress(self._percent)
        if text and text != self._text:
            self._text = text
            self._feedback.setProgressText(self._translate(text))

    def info(self, text: str) -> None:
        self._feedback.pushInfo(self._translate(text))

    def warn(self, finding: str) -> None:
        self._feedback.pushWarning(self._translate(finding))

    def check_cancelled(self) -> None:
        if is_cancelled(self._feedback):
            from ..repm_qgis.contracts.errors import Cancelled

            raise Cancelled


def is_cancelled(feedback: QgsProcessingFeedback) -> bool:
    """Whether the user has cancelled; qgis_process notices Ctrl-C in its event loop, which only we can run now."""
    if _in_qgis_process():
        QCoreApplication.processEvents()
    return feedback.isCanceled()


@contextmanager
def sigterm_cancels(feedback: QgsProcessingFeedback) -> Iterator[None]:
    """Within the block, SIGTERM to qgis_process does what Ctrl-C does; QGIS's desktop is left as it is."""
    if not _in_qgis_process() or threading.current_thread() is not threading.main_thread():
        yield
        return
    former = signal.signal(signal.SIGTERM, lambda number, frame: feedback.cancel())
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, former if former is not None else signal.SIG_DFL)


def end_at_ctrl_c() -> None:
    """See that Ctrl-C ends qgis_process while it still prepares the run.

    QGIS listens only from the start of the algorithm on. Before, Python's KeyboardInterrupt would crash QGIS's native
    code, or be lost there.
    """
    if _in_qgis_process() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end_at_once)


def _end_at_once(number: int, frame: object) -> None:
    os.write(2, b"Cancelled by the user.\n")
    write_error("Cancelled by the user.", "Cancelled")
    os._exit(1)


def _in_qgis_process() -> bool:
    return QgsApplication.platform() == "qgis_process"


def _failure(text: str, kind: str = "EngineError") -> QgsProcessingException:
    return failure(said(text), kind)


def in_python_thread(call: Callable[[], _Result]) -> _Result:
    """Call something of the engine in a thread that Python has made, unless this is the main thread; waits for it.

    QGIS runs algorithms in threads of Qt, which it keeps for the next run, while Python forgets its part of them. With
    pyproj 3.7 and newer the second run in such a thread ends QGIS: it takes up the context of PROJ that the first one
    has freed (https://github.com/pyproj4/pyproj/issues/1509). A thread of Python's has a context of its own.
    """
    if threading.current_thread() is threading.main_thread():
        return call()
    made: list[_Result] = []
    failed: list[BaseException] = []

    def run() -> None:
        try:
            made.append(call())
        except BaseException as error:  # any exception is passed to the caller
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return made[0]


def run_here(
    stage: Stage[R], options: JsonMapping, feedback: QgsProcessingFeedback, words: Callable[[str], str] = str
) -> R:
    """Run a light stage in QGIS's process. Expected failures become QgsProcessingException with one sentence. ``words``
    puts messages into those of the dialog."""
    from ..repm_qgis.contracts.errors import RepmError
    from ..repm_qgis.runtime.imports import import_failure, is_import_failure
    from ..repm_qgis.runtime.translation import written_in
    from ..repm_qgis.stages import run_stage

    try:
        with written_in(language(), labels(stage.name)):
            return run_stage(stage, options, FeedbackProgress(feedback, lambda text: words(said(text))))
    except RepmError as error:
        raise _failure(str(error), type(error).__name__) from None
    except Exception as error:
        if not is_import_failure(error):
            raise
        if not isinstance(error, ModuleNotFoundError):
            raise _failure(str(import_failure(error)), "MissingPackageError") from None
        debian = next((each.debian for each in PACKAGES if each.module == error.name and each.debian), "")
        apt = f" (on Debian and Ubuntu with 'sudo apt install {debian}')" if debian else ""
        raise _failure(
            f"The Python package '{error.name}' is not installed for QGIS's own Python ({error}): install QGIS again "
            f"with its Python modules{apt}.",
            "MissingPackageError",
        ) from None


def run_apart(
    stage: Stage[R],
    options: JsonMapping,
    feedback: QgsProcessingFeedback,
    words: Callable[[str], str] = str,
    python: Optional[str] = None,
) -> R:
    """Run a heavy stage in a process of its own and give its result; raises QgsProcessingException. ``words`` puts
    messages into those of the dialog."""
    python = python or find_python()
    start = time.time()
    given = {**options, "language": language()}
    job = json.dumps({**given, "labels": labels(stage.name)})
    # Without the labels, which are the same in each run and would fill the log, and without a proxy's password.
    shown = {**given, "proxy": without_password(given["proxy"])} if given.get("proxy") else given
    feedback.pushDebugInfo(f"{python} -m repm_qgis {stage.name} - <<< {shlex.quote(json.dumps(shown))}")
    try:
        return stage.result.from_mapping(_EngineProcess(stage.name, python, job).result(feedback, words))
    except QgsProcessingException:
        _give_back(stage, options)
        remove_half_written(options, start)
        raise


def _give_back(stage: Stage[Any], options: JsonMapping) -> None:
    """Undo what an engine process that was killed has replaced: the products of a run appear together or not at all."""
    from ..repm_qgis.runtime.together import recover
    from ..repm_qgis.stages import provisional

    with suppress(ValueError, OSError):  # options that the engine has refused, places that it cannot write
        products, folders = provisional(stage.name, stage.options.from_json(options))
        recover(products, folders)


def find_python() -> str:
    """The interpreter for the engine: the setting, REPM_ENGINE_PYTHON, the engine's environment, else QGIS's Python.

    Never ``sys.executable``: inside QGIS that is whatever ``python3`` comes first on PATH.
    """
    chosen = settings.engine_python()
    if chosen:
        if not is_program(chosen):
            raise _failure(
                f"The engine interpreter '{chosen}' is not a program: correct or clear it in Settings > Options > "
                "Processing > Providers > REPM (or the variable REPM_ENGINE_PYTHON)."
            )
        return chosen
    own = own_programs()
    folder = usable(homes(), own, plugin_folder())
    if folder:
        return program_in(folder)
    if own:
        return own[0]
    raise _failure(
        f"No Python was found to run the engine (looked for {', '.join(candidates(program_folders()))}): choose QGIS's "
        "Python in Settings > Options > Processing > Providers > REPM."
    )


def backend_remedy(name: str) -> str:
    """What to do to make a backend run; "" where it can, or where the engine does not start (it will report this
    itself)."""
    from ..repm_qgis.matching.backends import NEED_A_DEVICE

    if name not in NEED_A_DEVICE:
        return ""
    code = f"from repm_qgis.matching.backends import remedy; print(remedy({name!r}))"
    try:
        python = find_python()
    except QgsProcessingException:
        return ""
    process = _quiet_process()
    variables = QProcessEnvironment()
    for variable, value in environment(python).items():
        variables.insert(variable, value)
    process.setProcessEnvironment(variables)
    process.setWorkingDirectory(PLUGIN_FOLDER)
    process.start(python, ["-c", code])
    if not process.waitForFinished(_ASK_S * 1000):
        process.kill()
        process.waitForFinished()
        return ""
    answer = bytes(process.readAllStandardOutput()).decode("utf-8", "replace")
    return answer.strip() if process.exitCode() == 0 and process.exitStatus() == _NORMAL_EXIT else ""


def _quiet_process() -> QProcess:
    """A process with nothing on its standard input, whose standard error goes nowhere."""
    process = QProcess()
    process.setStandardInputFile(QProcess.nullDevice())
    process.setStandardErrorFile(QProcess.nullDevice())
    return process


def plugin_folder() -> Path:
    return Path(PLUGIN_FOLDER)


def homes() -> list[str]:
    """Where the engine's environments lie: in this profile, which updates of the plugin keep; else the user's."""
    return [os.path.join(os.path.abspath(QgsApplication.qgisSettingsDirPath()), "repm"), user_home()]


def program_folders() -> list[str]:
    """Where QGIS's own programs lie."""
    return [QgsApplication.prefixPath(), QCoreApplication.applicationDirPath()]


def own_programs() -> list[str]:
    """The Pythons that may be QGIS's own, the likeliest first."""
    return [path for path in candidates(program_folders()) if is_program(path)]


def environment(python: str) -> dict[str, str]:
    """The engine's environment: this plugin's folder on PYTHONPATH, no variables that are meant for another Python."""
    values = variables(python)
    values.update(PYTHONPATH=PLUGIN_FOLDER, PYTHONUNBUFFERED="1", PYTHONIOENCODING="utf-8", **{WATCH_VARIABLE: "1"})
    # Distributions' pyproj looks for its data below the interpreter's prefix, which in a venv is the venv.
    in_venv = os.path.exists(os.path.join(os.path.dirname(os.path.dirname(python)), "pyvenv.cfg"))
    if in_venv and not ({"PROJ_DATA", "PROJ_LIB"} & set(values)):
        found = [path for path in QgsProjUtils.searchPaths() if os.path.exists(os.path.join(path, "proj.db"))]
        if found:
            values["PROJ_DATA"] = values["PROJ_LIB"] = found[0]
    return values


class _EngineProcess:
    """One engine process, from its start to its result; ``job`` is a line of JSON."""

    def __init__(self, stage: str, python: str, job: str) -> None:
        from ..repm_qgis.runtime.containers import memory_kills

        self._stage, self._python, self._memory_kills = stage, python, memory_kills()
        self._lines: queue.Queue[Optional[str]] = queue.Queue()
        self._last_words: collections.deque[str] = collections.deque(maxlen=50)
        # "-m" looks for modules in the working folder first: that must be ours, and no folder that others write to.
        apart: JsonObject = {"creationflags": 0x00000200 | 0x08000000} if _WINDOWS else {"start_new_session": True}
        try:
            # Before Qt 6, QProcess makes no session.
            self._process = subprocess.Popen(  # nosec B603 # no shell, and an argument list of our own
                [python, "-m", "repm_qgis", stage, "-"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                cwd=PLUGIN_FOLDER,
                env=environment(python),
                **apart,
            )
        except OSError as error:
            raise _failure(
                f"The engine interpreter '{python}' cannot be started ({error}): choose another in Settings > Options "
                "> Processing > Providers > REPM."
            ) from None
        self._tell(job)
        self._readers = [
            self._read(cast(IO[bytes], self._process.stdout), self._lines.put, at_end=True),
            self._read(cast(IO[bytes], self._process.stderr), self._last_words.append),
        ]

    def _tell(self, line: str) -> None:
        """Give the process its job, or a later line, and leave the pipe open: its closing means that QGIS is gone."""

        pipe = cast(IO[bytes], self._process.stdin)

        def write() -> None:
            with suppress(OSError, ValueError):  # it has ended, and its output gives the reason
                pipe.write(f"{line}\n".encode())
                pipe.flush()

        threading.Thread(target=write, daemon=True).start()  # a pipe holds 64 KiB

    def _read(self, stream: IO[bytes], keep: Callable[[Any], None], at_end: bool = False) -> threading.Thread:
        def read() -> None:
            with stream:
                for line in stream:
                    keep(line.decode("utf-8", "replace").rstrip())
            if at_end:
                keep(None)

        thread = threading.Thread(target=read, daemon=True)
        thread.start()
        return thread

    def result(self, feedback: QgsProcessingFeedback, words: Callable[[str], str]) -> JsonObject:
        """Pass progress on until the process ends; its result, or QgsProcessingException."""
        progress = FeedbackProgress(feedback, words)
        last: JsonObject = {}
        try:
            while True:
                if is_cancelled(feedback):
                    raise _failure("Cancelled by the user.", "Cancelled")
                try:
                    line = self._lines.get(timeout=_POLL_S)
                except queue.Empty:
                    if self._process.poll() is None:
                        continue
                    line = None  # it has ended; workers that outlived it still hold its output open
                if line is None:
                    break
                last = self._hear(line, progress, feedback) or last
            code = self._wait(feedback)
        finally:
            self.end()
        for text in self._last_words:
            feedback.pushDebugInfo(text)
        return self._outcome(last, code)

    def _hear(self, line: str, progress: FeedbackProgress, feedback: QgsProcessingFeedback) -> Optional[JsonObject]:
        """Act on one line; the closing messages are given back."""
        try:
            message = json.loads(line)
            kind, text = message["type"], str(message.get("text", ""))
        except (ValueError, KeyError, TypeError, AttributeError):
            feedback.pushDebugInfo(line)
            return None
        if kind == "progress":
            progress.step(float(message.get("fraction", 0.0)), text)
        elif kind == "info":
            progress.info(text)
        elif kind == "warning":
            progress.warn(text)
        else:
            return message
        return None

    def _wait(self, feedback: QgsProcessingFeedback) -> int:
        """The exit code; the process has closed its output and is about to end."""
        while True:
            try:
                return self._process.wait(_POLL_S)
            except subprocess.TimeoutExpired:
                if is_cancelled(feedback):
                    raise _failure("Cancelled by the user.", "Cancelled") from None

    def _outcome(self, last: JsonObject, code: int) -> JsonObject:
        kind = last.get("type")
        if kind == "result" and code == 0 and isinstance(last.get("result"), dict):
            return last["result"]
        if kind == "error":
            raise failure(str(last.get("text", "")), str(last.get("kind")))
        if kind == "bug":
            sentence = said(
                f"The stage '{self._stage}' ended with an unexpected error: please report it with the text below."
            )
            raise failure(f"{sentence}\n{last.get('text', '')}", BUG)
        raise _failure(self._crash(code))

    def _crash(self, code: int) -> str:
        from ..repm_qgis.runtime.containers import memory_kills
        from ..repm_qgis.runtime.shortage import MEMORY_REMEDY, speaks_of_memory

        words = next((text for text in reversed(self._last_words) if text.strip()), "")
        said = f" (its last words: {words.strip()[:300]})" if words else ""
        if code < 0:
            try:
                name = signal.Signals(-code).name
            except ValueError:
                name = f"signal {-code}"
            cause = f"was ended by {name}"
            remedy = "QGIS and finished files are unharmed: run again, or choose another BACKEND"
        else:
            cause, remedy = (
                f"ended with code {code} and no result",
                f"check with 'Report the environment' (repm:environment) that '{self._python}' has what it needs",
            )
        if self._memory_kills is not None and (memory_kills() or 0) > self._memory_kills:
            remedy = f"the system says that memory ran out: {MEMORY_REMEDY}"
        elif cause.endswith("SIGKILL") or any(map(speaks_of_memory, self._last_words)):
            remedy = f"most likely memory ran out: {MEMORY_REMEDY}"
        return f"The engine process of the stage '{self._stage}' {cause}{said}; {remedy}."

    def end(self) -> None:
        """End the process and everything it started, at once if it has ended by itself."""
        running = self._process.poll() is None
        if _WINDOWS:
            self._end_on_windows(running)
        else:
            self._end_group(running)
        for thread in self._readers:
            thread.join(0.5)
        if self._process.stdin is not None:
            with suppress(OSError):  # the part of the job that was not read
                self._process.stdin.close()

    def _end_group(self, running: bool) -> None:
        if running and self._signal(signal.SIGTERM):
            end = time.monotonic() + _GRACE_S
            while time.monotonic() < end and self._process.poll() is None:
                time.sleep(0.02)
        self._signal(signal.SIGKILL)  # the rest of the group, workers of a crashed parent too
        self._process.wait()

    def _signal(self, number: int) -> bool:
        try:
            os.killpg(self._process.pid, number)
        except (ProcessLookupError, PermissionError):
            return False
        return True

    def _end_on_windows(self, running: bool) -> None:
        if running and not self._cancelled_in_time():
            taskkill = os.path.join(os.environ.get("SYSTEMROOT", r"C:\Windows"), "System32", "taskkill.exe")
            ending = _quiet_process()
            ending.setStandardOutputFile(QProcess.nullDevice())
            ending.start(taskkill, ["/F", "/T", "/PID", str(self._process.pid)])
            ending.waitForFinished()
        self._process.wait()

    def _cancelled_in_time(self) -> bool:
        """Ask the engine to end, so that it cleans up: signals would end it at once. Gives whether it has ended."""
        self._tell("cancel")
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_GRACE_S + 0.5)
            return True
        return False
