"""How the engine's process ends: at a word of whoever started it, killed, or left alone; on every system."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from repm_qgis.runtime.workspace import process_exists

ROOT = Path(__file__).resolve().parents[2]
# A stage with two workers, amid the writing of a file. The tasks fill the pipe through which they go.
CODE = """
import os, signal, sys, time
from pathlib import Path
from repm_qgis import engine_process
from repm_qgis.runtime.parallel import run_tasks
from repm_qgis.runtime.workspace import whole_file

def work(task):
    Path(task[0], f"{os.getpid()}.pid").touch()
    time.sleep(60)

def run(asked, lines):
    folder = sys.argv[1]
    Path(folder, f"{os.getpid()}.engine").touch()
    with whole_file(os.path.join(folder, "product.bin")) as temporary:
        Path(temporary).write_bytes(b"half")
        if sys.argv[2:] == ["busy"]:  # as in native code, which hears nothing
            for number in engine_process._CANCELLING:
                signal.signal(number, lambda number, frame: None)
            time.sleep(60)
        run_tasks(work, [(folder, bytes(1 << 20))] * 12, 2, lines, lambda task: "")
    return {}

engine_process._run = run
if __name__ == "__main__":
    sys.exit(engine_process.main(sys.argv[1:]))
"""


def alive(number):
    try:
        if Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":  # nobody has asked for it
            return False
    except OSError:
        pass
    return process_exists(number)


class Running:
    """The stage, begun: both workers have a task."""

    def __init__(self, folder, *words, workers=2):
        self.folder = folder
        (folder / "stage.py").write_text(CODE, encoding="utf-8")
        apart = {"creationflags": 0x200} if os.name == "nt" else {"start_new_session": True}
        self.process = subprocess.Popen(
            [sys.executable, str(folder / "stage.py"), str(folder), *words],
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "REPM_ENGINE_WATCH_STDIN": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=ROOT,
            **apart,
        )
        end = time.monotonic() + 200
        while len(self.workers()) < workers or not list(folder.glob("*.engine")):
            assert self.process.poll() is None and time.monotonic() < end, self.process.poll()
            time.sleep(0.05)

    def workers(self):
        return [int(path.stem) for path in self.folder.glob("*.pid")]

    def seconds_to_end(self):
        """Until the process and its workers are gone."""
        start = time.monotonic()
        self.process.wait(timeout=30)
        while any(map(alive, self.workers())):
            assert time.monotonic() < start + 30, "workers live on"
            time.sleep(0.02)
        return time.monotonic() - start

    def said(self):
        with self.process.stdout as stream:
            return json.loads(stream.read().splitlines()[-1])


CANCELLED = {"type": "error", "kind": "Cancelled", "text": "Cancelled by the user."}


@pytest.mark.parametrize("words, workers", (((), 2), (("busy",), 0)))
def test_a_line_cancels_within_two_seconds(tmp_path, words, workers):
    running = Running(tmp_path, *words, workers=workers)
    running.process.stdin.write(b"cancel\n")
    running.process.stdin.flush()
    assert running.seconds_to_end() < 2.5
    assert running.process.returncode == 1 and running.said() == CANCELLED
    assert not list(tmp_path.glob("*product*"))
    running.process.stdin.close()


def test_with_a_killed_engine_its_workers_end(tmp_path):
    running = Running(tmp_path)
    running.process.kill()
    assert running.seconds_to_end() < 2.5
    running.process.stdin.close()
    running.process.stdout.close()


def test_when_its_parent_is_gone_the_engine_cleans_up_and_ends(tmp_path):
    running = Running(tmp_path)
    running.process.stdin.close()
    assert running.seconds_to_end() < 2.5
    assert not list(tmp_path.glob("*product*"))
    running.process.stdout.close()


def test_a_cancel_before_the_job_is_read_counts(tmp_path):
    """Both come at once, where the engine has only just begun."""
    job = json.dumps({"folder": str(tmp_path / "scene"), "size": 2000})
    running = subprocess.Popen(
        [sys.executable, "-m", "repm_qgis", "sampledata", "-"],
        env={**os.environ, "REPM_ENGINE_WATCH_STDIN": "1"},
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    running.stdin.write(f"{job}\ncancel\n".encode())
    running.stdin.flush()
    with running.stdout as stream:
        said = stream.read()
    assert running.wait(timeout=60) == 1 and json.loads(said.splitlines()[-1]) == CANCELLED
    running.stdin.close()


@pytest.mark.parametrize("word", (b"cancel\n", b""))
def test_a_cancel_is_heard_while_the_engine_imports(tmp_path, word):
    """It imports for seconds on a busy Windows."""
    (tmp_path / "tempfile.py").write_text(
        "import pathlib, time; pathlib.Path(__file__).with_name('begun').touch(); time.sleep(60)"
    )
    running = subprocess.Popen(
        [sys.executable, "-m", "repm_qgis", "sampledata", "-"],
        env={**os.environ, "REPM_ENGINE_WATCH_STDIN": "1", "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    end = time.monotonic() + 60
    while not (tmp_path / "begun").exists():
        assert running.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    start = time.monotonic()
    running.stdin.write(b"{}\n" + word)
    running.stdin.flush()
    if not word:
        running.stdin.close()  # whoever started it is gone
    with running.stdout as stream:
        said = stream.read()
    assert running.wait(timeout=60) == 1 and time.monotonic() - start < 1.5
    assert json.loads(said.splitlines()[-1]) == CANCELLED
    running.stdin.close()
