"""The process runner against a small engine that does, on demand, what engines do at their worst.

The engine here is the real repm_qgis/__main__.py with stages of the test's own.
"""

from __future__ import annotations

import importlib
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from typing import Any, Dict, Optional

import pytest
from qgis.core import QgsProcessingException

from repm_qgis.contracts.options import Options
from repm_qgis.contracts.results import Result
from repm_qgis.contracts.stages import EPMFIT, Stage

ROOT = pathlib.Path(__file__).resolve().parents[2]
VENV_PYTHON = sys.executable

STAGES = """
import multiprocessing, os, signal, subprocess, sys, time
from ..contracts.errors import RpcMissingError
from ..contracts.findings import Finding

class Answer(dict):
    def to_mapping(self):
        return dict(self)

def nap(pids):
    with open(pids, "a") as stream:
        stream.write(f"{os.getpid()}\\n")
    time.sleep(60)

def run_stage(name, options, progress):
    if name == "fine":
        print("native libraries print to standard output")
        os.write(1, b"also so\\n")
        progress.step(0.5, "half")
        progress.step(0.2, "never back")
        progress.info("a note")
        progress.warn(Finding("id", "a warning"))
        return Answer(got=options, here=os.getcwd(), path=os.environ.get("PYTHONPATH"),
                      home=os.environ.get("PYTHONHOME"), prefix=sys.prefix)
    if name == "sentence":
        raise RpcMissingError("No RPC found for 'a.tif'.")
    if name == "bug":
        return {"x": 1 / 0}
    if name == "package":
        import surely_no_such_package
    if name == "segfault":
        sys.stderr.write("the last words\\n")
        sys.stderr.flush()
        os.kill(os.getpid(), signal.SIGSEGV)
    if name == "memory":
        os.kill(os.getpid(), signal.SIGKILL)
    if name == "allocation":
        sys.stderr.write("terminate called after throwing an instance of 'std::bad_alloc'\\n")
        sys.stderr.flush()
        os.abort()
    if name == "mute":
        os._exit(7)
    workers = [multiprocessing.get_context("spawn" if name == "spawned" else "fork").Process(
        target=nap, args=(options["pids"],)) for _ in range(2)]
    for worker in workers:
        worker.start()
    half = os.path.join(os.path.dirname(options["pids"]), ".dsm.part.tif")
    try:
        open(half, "w").close()
        if name == "stubborn":
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        nap(options["pids"])
    finally:
        os.unlink(half)
"""


@dataclass(frozen=True)
class Answer(Result):
    """What the stage 'fine' returns."""

    got: Dict[str, Any]
    here: str
    path: Optional[str]
    home: Optional[str]
    prefix: str


def stage_of(name):
    return Stage(name, Options, Answer)


@pytest.fixture
def engine(plugin, tmp_path, monkeypatch):
    """processing_provider.engine, with the test's stages behind it; no file of a run stays in the temporary folder."""
    from repm.processing_provider import engine

    package = tmp_path / "plugin folder" / "repm_qgis"
    shutil.copytree(ROOT / "repm_qgis", package, ignore=shutil.ignore_patterns("__pycache__", "stages"))
    (package / "stages").mkdir()
    (package / "stages" / "__init__.py").write_text(STAGES)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(engine, "PLUGIN_FOLDER", str(package.parent))
    yield engine
    assert list(temporary.iterdir()) == [], "a run left a file behind"


def alive(pid):
    try:
        state = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def started(pids, count=3, seconds=10):
    """The process ids in the file once there are so many."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = [int(line) for line in pids.read_text().split()] if pids.exists() else []
        if len(found) >= count:
            return found
        time.sleep(0.05)
    raise AssertionError("the engine did not start")


def all_gone(pids, seconds=0.5):
    end = time.monotonic() + seconds
    while any(map(alive, pids)) and time.monotonic() < end:
        time.sleep(0.02)
    return not any(map(alive, pids))


def test_progress_notes_and_result_come_through(engine, feedback, monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/nonsense")
    monkeypatch.setenv("PYTHONPATH", "/nonsense")
    result = engine.run_apart(
        stage_of("fine"), {"images": ["ä b.tif"], "x": 1.5, "y": None}, feedback, python=VENV_PYTHON
    )
    assert result.got == {"images": ["ä b.tif"], "x": 1.5, "y": None}
    assert result.path == engine.PLUGIN_FOLDER
    assert result.home is None
    assert result.prefix == sys.prefix
    assert feedback.heard["progress"] == [50.0]
    assert feedback.heard["text"] == ["half", "never back"]
    assert feedback.heard["info"] == ["a note"]
    assert feedback.heard["warning"] == ["a warning"]


@pytest.mark.parametrize("proxy", ("http://anna:secret@10.0.0.1:3128", "anna:secret@10.0.0.1:3128"))
def test_the_log_has_no_password_of_a_proxy(engine, feedback, proxy):
    """Logs are sent to others; the engine itself gets the proxy as it is."""
    result = engine.run_apart(stage_of("fine"), {"proxy": proxy}, feedback, python=VENV_PYTHON)
    assert result.got == {"proxy": proxy}
    assert "10.0.0.1:3128" in feedback.textLog() and "secret" not in feedback.textLog()


@pytest.mark.parametrize(
    ("stage", "words"),
    [
        ("sentence", ["No RPC found for 'a.tif'."]),
        ("package", ["'surely_no_such_package' is not installed", VENV_PYTHON]),
        ("segfault", ["'segfault'", "SIGSEGV", "the last words"]),
        ("memory", ["'memory'", "SIGKILL", "most likely memory ran out", "EXTENT", "MEMORY"]),
        ("allocation", ["'allocation'", "SIGABRT", "bad_alloc", "most likely memory ran out", "TILE_SIZE"]),
        ("mute", ["'mute'", "code 7", "Report the environment"]),
    ],
)
@pytest.mark.long
def test_every_end_but_a_bug_is_one_sentence(engine, feedback, stage, words):
    with pytest.raises(QgsProcessingException) as caught:
        engine.run_apart(stage_of(stage), {}, feedback, python=VENV_PYTHON)
    text = str(caught.value)
    assert all(word in text for word in words), text
    assert "\n" not in text and "Traceback" not in text


def test_what_the_system_says_of_memory_is_passed_on(engine, feedback, monkeypatch):
    containers = importlib.import_module(f"{engine.__name__.split('.')[0]}.repm_qgis.runtime.containers")
    counts = iter((3, 4))
    monkeypatch.setattr(containers, "memory_kills", lambda: next(counts))
    with pytest.raises(QgsProcessingException, match="SIGKILL; the system says that memory ran out: use fewer WORKERS"):
        engine.run_apart(stage_of("memory"), {}, feedback, python=VENV_PYTHON)


def test_a_bug_keeps_its_traceback(engine, feedback):
    with pytest.raises(QgsProcessingException, match="(?s)please report.*Traceback.*ZeroDivisionError"):
        engine.run_apart(stage_of("bug"), {}, feedback, python=VENV_PYTHON)


@pytest.mark.parametrize("stage", ["forked", "spawned", "stubborn"])
@pytest.mark.long
def test_cancel_ends_the_whole_tree_within_two_seconds(engine, feedback, tmp_path, stage):
    pids = tmp_path / "pids"
    cancelled = []

    def cancel():
        started(pids)
        cancelled.append(time.monotonic())
        feedback.cancel()

    thread = threading.Thread(target=cancel)
    thread.start()
    with pytest.raises(QgsProcessingException, match="Cancelled by the user"):
        engine.run_apart(
            stage_of(stage), {"pids": str(pids), "output": str(tmp_path / "dsm.tif")}, feedback, python=VENV_PYTHON
        )
    seconds = time.monotonic() - cancelled[0]
    thread.join()
    assert seconds < 2
    assert all_gone(started(pids))
    # The stubborn one ignores SIGTERM and so never cleans up: then the runner does.
    assert not (tmp_path / ".dsm.part.tif").exists()


@pytest.mark.long
def test_on_windows_the_engine_is_asked_to_cancel(engine, feedback, tmp_path, monkeypatch):
    """Signals would end it at once there: so it is told over its standard input, and cleans up."""
    pids = tmp_path / "pids"
    monkeypatch.setattr(engine._EngineProcess, "_end_group", engine._EngineProcess._end_on_windows)
    monkeypatch.setattr(engine, "remove_half_written", lambda *arguments: None)

    def cancel():
        started(pids)
        feedback.cancel()

    thread = threading.Thread(target=cancel)
    thread.start()
    with pytest.raises(QgsProcessingException, match="Cancelled by the user"):
        engine.run_apart(
            stage_of("spawned"), {"pids": str(pids), "output": str(tmp_path / "dsm.tif")}, feedback, python=VENV_PYTHON
        )
    thread.join()
    assert not (tmp_path / ".dsm.part.tif").exists()
    for pid in started(pids):
        if alive(pid):  # workers of the test's own
            os.kill(pid, signal.SIGKILL)


def test_the_engine_ends_when_the_process_that_started_it_is_killed(engine, tmp_path):
    """As when QGIS dies: only the pipe on the engine's standard input tells."""
    pids, job = tmp_path / "pids", tmp_path / "job.json"
    job.write_text(f'{{"pids": "{pids}"}}')
    parent = subprocess.Popen(
        [
            VENV_PYTHON,
            "-c",
            (
                "import subprocess, sys, time\n"
                "subprocess.Popen(sys.argv[1:], stdin=subprocess.PIPE, start_new_session=True)\n"
                "time.sleep(60)"
            ),
            VENV_PYTHON,
            "-m",
            "repm_qgis",
            "forked",
            str(job),
        ],
        cwd=engine.PLUGIN_FOLDER,
        env=engine.environment(VENV_PYTHON),
    )
    try:
        found = started(pids)
    finally:
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    assert all_gone(found, seconds=2)
    assert not (tmp_path / ".dsm.part.tif").exists()


def test_workers_of_a_crashed_engine_are_ended(engine, feedback, tmp_path, monkeypatch):
    pids = tmp_path / "pids"

    def crash():
        os.kill(started(pids)[-1], signal.SIGKILL)
        main = [
            pid
            for pid in started(pids)
            if os.path.exists(f"/proc/{pid}")
            and b"repm_qgis" in pathlib.Path(f"/proc/{pid}/cmdline").read_bytes()
            and os.getpgid(pid) == pid
        ]
        for pid in main:
            os.kill(pid, signal.SIGKILL)

    thread = threading.Thread(target=crash)
    thread.start()
    with pytest.raises(QgsProcessingException, match="SIGKILL"):
        engine.run_apart(stage_of("forked"), {"pids": str(pids)}, feedback, python=VENV_PYTHON)
    thread.join()
    assert all_gone(started(pids))


def test_an_interpreter_that_cannot_be_started_is_named(engine, feedback, tmp_path):
    script = tmp_path / "python"
    script.write_text("not a program")
    script.chmod(0o755)
    with pytest.raises(QgsProcessingException, match="cannot be started.*choose another"):
        engine.run_apart(stage_of("fine"), {}, feedback, python=str(script))


def test_the_interpreter_is_the_setting_then_the_variable_then_the_venv_then_qgis_own(engine, tmp_path, monkeypatch):
    from processing.core.ProcessingConfig import ProcessingConfig

    setting = ProcessingConfig.settings["REPM_ENGINE_PYTHON"]
    monkeypatch.delenv("REPM_ENGINE_PYTHON", raising=False)
    own = engine.find_python()
    assert os.path.realpath(own) == os.path.realpath(f"{sys.base_exec_prefix}/bin/python3")
    assert own != sys.executable
    venv = pathlib.Path(engine.PLUGIN_FOLDER) / ".venv" / "bin" / "python"
    venv.parent.mkdir(parents=True)
    venv.symlink_to(own)
    assert engine.find_python() == str(venv)
    monkeypatch.setenv("REPM_ENGINE_PYTHON", "/usr/bin/env")
    assert engine.find_python() == "/usr/bin/env"
    chosen = tmp_path / "nothing"
    chosen.touch(mode=0o755)
    setting.setValue(str(chosen))
    try:
        assert engine.find_python() == str(chosen)
        chosen.unlink()
        with pytest.raises(QgsProcessingException, match="nothing' is not a program.*Settings"):
            engine.find_python()
    finally:
        setting.setValue("")


def test_no_interpreter_at_all_says_where_it_was_looked_for(engine, monkeypatch):
    monkeypatch.delenv("REPM_ENGINE_PYTHON", raising=False)
    monkeypatch.setattr(engine, "is_program", lambda path: False)
    with pytest.raises(QgsProcessingException, match="looked for .*python3.*choose QGIS's Python in Settings"):
        engine.find_python()


def raised(error):
    raise error


def test_light_stages_turn_errors_into_sentences(plugin, feedback, monkeypatch):
    from repm.processing_provider import engine

    with pytest.raises(QgsProcessingException, match="TILE_SIZE is 3: it must be a whole number between"):
        engine.run_here(EPMFIT, {"images": ["a", "b"], "workspace": "w", "tile_size": 3}, feedback)
    with pytest.raises(QgsProcessingException, match="IMAGES is 5: it must be a list"):
        engine.run_here(EPMFIT, {"images": 5, "workspace": "w"}, feedback)
    with monkeypatch.context() as bug, pytest.raises(ZeroDivisionError):  # a bug keeps its traceback
        bug.setattr("repm.repm_qgis.stages.run_stage", lambda *arguments: 1 / 0)
        engine.run_here(EPMFIT, {"images": ["a", "b"], "workspace": "w"}, feedback)
    for error, words in (
        (ImportError("libX.so: cannot open"), r"The Python package '\w+(\.\w+)?' cannot be imported .*libX.so"),
        (ImportError("numpy.core.multiarray failed to import"), r'was built for .* type .* -m pip install .*"numpy<2"'),
        (
            ModuleNotFoundError("No module named 'scipy'", name="scipy"),
            "'scipy' is not installed for QGIS's own Python",
        ),
    ):
        with monkeypatch.context() as broken, pytest.raises(QgsProcessingException, match=words) as caught:
            broken.setattr("repm.repm_qgis.stages.run_stage", lambda *arguments, error=error: raised(error))
            engine.run_here(EPMFIT, {"images": ["a", "b"], "workspace": "w"}, feedback)
        assert "None" not in str(caught.value) and "\n" not in str(caught.value)
    feedback.cancel()
    from repm.repm_qgis.contracts.errors import Cancelled

    with pytest.raises(Cancelled):
        engine.FeedbackProgress(feedback).check_cancelled()


@pytest.mark.long
def test_cancel_ends_a_real_stage(plugin, feedback, tmp_path):
    """A truth scene that would take minutes, stopped while it is made."""
    from qgis.core import QgsApplication, QgsProcessingContext

    folder = tmp_path / "big"
    cancelled = []
    timer = threading.Timer(2.0, lambda: (cancelled.append(time.monotonic()), feedback.cancel()))
    timer.start()
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:sampledata").create()
    with pytest.raises(QgsProcessingException, match="Cancelled"):
        algorithm.run(
            {"KIND": "urban", "SIZE": 6000, "SEED": 1, "FOLDER": str(folder)},
            QgsProcessingContext(),
            feedback,
            catchExceptions=False,
        )
    assert time.monotonic() - cancelled[0] < 2
    left = [path.name for path in folder.rglob("*") if path.is_file()] if folder.exists() else []
    assert not [name for name in left if "part" in name or "tmp" in name], left


def test_light_stages_run_in_threads_of_pythons(plugin, sample, tmp_path, ears, monkeypatch):
    """With pyproj 3.7 and newer the second run in the same thread of Qt ended QGIS (3.40: edit twice)."""
    from qgis.core import QgsApplication, QgsProcessingAlgRunnerTask, QgsProcessingContext
    from qgis.PyQt.QtCore import QCoreApplication
    from repm.processing_provider import engine
    from repm.repm_qgis import stages

    kinds, run_stage = [], stages.run_stage

    def spied(*given):
        kinds.append(type(threading.current_thread()))
        return run_stage(*given)

    monkeypatch.setattr(stages, "run_stage", spied)
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:viewer")
    dsm = shutil.copy(sample.truth, tmp_path / "dsm.tif")
    for number in range(3):
        given = {"DSM": str(dsm), "VIEWER": str(tmp_path / f"{number}.html")}
        context, feedback, ended = QgsProcessingContext(), ears(), []
        task = QgsProcessingAlgRunnerTask(algorithm, given, context, feedback)
        task.executed.connect(lambda well, _, ended=ended: ended.append(well))
        QgsApplication.taskManager().addTask(task)
        while not ended:
            QCoreApplication.processEvents()
        assert ended == [True] and (tmp_path / f"{number}.html").exists(), feedback.heard
    assert kinds == [threading.Thread] * 3
    raised = []

    def fails():
        with pytest.raises(ZeroDivisionError) as caught:
            engine.in_python_thread(lambda: 1 / 0)
        raised.append(caught.type)

    other = threading.Thread(target=fails)
    other.start()
    other.join()
    assert raised == [ZeroDivisionError]
