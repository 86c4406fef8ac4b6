"""Tasks over processes: order, exceptions, deaths and Cancel."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from repm_qgis.errors import Cancelled, EmptyResultError, OptionError
from repm_qgis.parallel import cores, kept_workers, run_tasks

ROOT = Path(__file__).resolve().parents[2]
# In a module of its own: workers import the function by its name, and a test's module has none that they know.
WORK = """
import os, signal, time
from repm_qgis.errors import OptionError

def square(x):
    return x * x

def picky(x):
    if x == 3:
        raise OptionError("x", x, "must not be three")
    return x

def deadly(x):
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x

def slow(x):
    time.sleep(30)

def busy(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

def who(x):
    time.sleep(0.05)
    return os.getpid()
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """The module with the functions, on the path of this process and of its workers."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "repm_test_work.py").write_text(WORK)
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), str(ROOT)])
    sys.path.insert(0, str(folder))
    import repm_test_work

    yield repm_test_work
    sys.path.remove(str(folder))
    os.environ.pop("PYTHONPATH") if before is None else os.environ.update(PYTHONPATH=before)


@pytest.mark.parametrize("workers", (1, 2))
def test_results_come_in_order(work, told, workers):
    said = told()
    assert run_tasks(work.square, list(range(12)), workers, said, str) == [x * x for x in range(12)]
    assert said.fractions == sorted(said.fractions) and said.checks > 0
    assert run_tasks(work.square, [], workers, told(), str) == []


@pytest.mark.parametrize("workers", (1, 2))
def test_exceptions_of_tasks_are_raised_here(work, told, workers):
    with pytest.raises(OptionError, match="x is 3: it must not be three"):
        run_tasks(work.picky, list(range(8)), workers, told(), str)


def test_a_worker_that_dies_is_said(work, told):
    with pytest.raises(EmptyResultError, match="of 8 tasks: most likely memory ran out"):
        run_tasks(work.deadly, list(range(8)), 2, told(), str)


def test_workers_live_on_within_a_block_only(work, told):
    def who(workers=2):
        return set(run_tasks(work.who, list(range(8)), workers, told(), str))

    with kept_workers():
        first = who()
        assert who() == first and len(first) <= 2
        with pytest.raises(OptionError):
            run_tasks(work.picky, list(range(8)), 2, told(), str)
        later = who()
        assert not later & first
        assert not who(3) & later
    assert not who() & later


def test_cancel_is_quick_and_leaves_no_process(work, told):
    start = time.monotonic()
    with pytest.raises(Cancelled):
        run_tasks(work.slow, list(range(8)), 2, told(cancel_at=3), str)
    assert time.monotonic() - start < 5
    listed = subprocess.run(
        ["ps", "-o", "pid,stat,args", "--ppid", str(os.getpid())], text=True, stdout=subprocess.PIPE, check=False
    ).stdout
    running = "".join(line for line in listed.splitlines(True) if " Z" not in line)
    assert "spawn_main" not in running and "forkserver" not in running


def test_what_workers_use_is_counted_as_used_by_this_process(work, told):
    before = os.times()
    run_tasks(work.busy, [0.2] * 6, 2, told(), str)
    after = os.times()
    assert after.children_user + after.children_system - before.children_user - before.children_system > 1.2


def test_cores():
    assert 1 <= cores() <= (os.cpu_count() or 1)
    assert signal.SIGTERM  # the handlers of this process are left alone
