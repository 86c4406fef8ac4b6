"""Tasks over processes: order, exceptions, deaths and Cancel."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import Cancelled, OptionError, OutOfMemoryError, WorkerError
from repm_qgis.runtime import parallel
from repm_qgis.runtime.parallel import cores, kept_workers, run_tasks
from repm_qgis.runtime.progress import Silent
from repm_qgis.runtime.shortage import shortage_as_error
from repm_qgis.stages import run_stage

ROOT = Path(__file__).resolve().parents[3]
# In a module of its own: workers import the function by its name, and a test's module has none that they know.
WORK = """
import ctypes, os, signal, time
from repm_qgis.contracts.errors import OptionError

def square(x):
    return x * x

def picky(x):
    if x == 3:
        raise OptionError("x", x, "must not be three")
    return x

def deadly(x, number):
    if x == 3:
        os.kill(os.getpid(), number)
    return x

def crashing(x):
    if x == 3:
        ctypes.windll.kernel32.TerminateProcess(ctypes.c_void_p(-1), 0xC0000005)
    return x

def starving(x):
    if x == 3:
        ctypes.windll.kernel32.TerminateProcess(ctypes.c_void_p(-1), 0xC000012D)
    return x

def hungry(x):
    import numpy
    return numpy.empty(1 << 60, numpy.uint8)

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


BOUNDED = """
import resource, sys
from repm_qgis.contracts.errors import OutOfMemoryError
from repm_qgis.runtime.parallel import run_tasks
from repm_qgis.runtime.progress import Silent
from repm_qgis.runtime.shortage import shortage_as_error

if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]) << 20,) * 2)
    try:
        with shortage_as_error():
            print(run_tasks(abs, list(range(8)), 2, Silent(), str))
    except OutOfMemoryError as error:
        print("OutOfMemoryError", error)
"""
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not bound the address space")


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


@pytest.mark.skipif(os.name == "nt", reason="no signals end processes there: see the next test")
def test_a_worker_that_dies_is_said(work, told):
    for number, error, words in (
        (
            signal.SIGKILL,
            OutOfMemoryError,
            r"killed \(SIGKILL\) after \d of 8 tasks, most likely because memory ran out",
        ),
        (signal.SIGSEGV, WorkerError, r"without an answer \(SIGSEGV\) after \d of 8 tasks: run again"),
    ):
        with pytest.raises(error, match=words) as caught:
            run_tasks(partial(work.deadly, number=number), list(range(8)), 2, told(), str)
        assert "MEMORY" in str(caught.value) and "TILE_SIZE" in str(caught.value)


@pytest.mark.skipif(os.name != "nt", reason="exit codes that Windows gives to what it ends")
def test_a_worker_that_windows_ends_is_said(work, told):
    with pytest.raises(WorkerError, match=r"without an answer \(0xC0000005\) after \d of 8 tasks: run again"):
        run_tasks(work.crashing, list(range(8)), 2, told(), str)
    with pytest.raises(
        OutOfMemoryError, match=r"Windows ended a worker process after \d of 8 tasks because memory ran"
    ):
        run_tasks(work.starving, list(range(8)), 2, told(), str)


@pytest.mark.parametrize(
    "codes, done, error, words",
    (
        ((0xC0000017, -15), 2, OutOfMemoryError, "Windows ended a worker process after 2 of 8 tasks because memory"),
        ((0xC0000409, -15), 2, WorkerError, r"without an answer \(0xC0000409\) after 2 of 8 tasks"),
        ((1, -15), 2, WorkerError, "without an answer after 2 of 8 tasks"),  # somebody ended it in the Task Manager
        ((1, -15), 0, WorkerError, "could not begin"),
    ),
)
def test_exit_codes_of_windows_are_told_apart(codes, done, error, words):
    found = parallel._death(codes, False, done, 8)
    assert type(found) is error
    assert re.search(words, str(found)), found


@pytest.mark.skipif(os.name == "nt", reason="no server and no sockets in files there")
@pytest.mark.long
def test_what_a_killed_run_leaves_behind_the_next_one_removes(tmp_path):
    """SIGKILL of the whole group: nobody is left who could remove the socket of the server."""
    code = tmp_path / "begun.py"
    code.write_text(
        "import sys, time\nfrom repm_qgis.runtime.parallel import kept_workers, run_tasks\n"
        "from repm_qgis.runtime.progress import Silent\nif __name__ == '__main__':\n    with kept_workers():\n"
        "        run_tasks(abs, list(range(8)), 2, Silent(), str)\n"
        "        print('begun', flush=True)\n        time.sleep(60 if sys.argv[1:] else 0)\n",
        encoding="utf-8",
    )
    with tempfile.TemporaryDirectory(prefix="r") as folder:  # tmp_path is too long for a socket in a folder of ours
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": folder}
        command = [sys.executable, str(code), "long"]
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, start_new_session=True) as run:
            assert run.stdout.readline() == b"begun\n"
            os.killpg(run.pid, signal.SIGKILL)
        assert list(Path(folder).rglob("listener-*"))
        done = subprocess.run([sys.executable, str(code)], env=environment, capture_output=True, check=True)
        assert done.stderr == b"" and not os.listdir(folder)


def test_a_script_without_a_guard_is_told_so(tmp_path, monkeypatch):
    """Workers import the script that started them, which then starts workers itself."""
    code = tmp_path / "unguarded.py"
    code.write_text(
        "from repm_qgis.runtime.parallel import run_tasks\nfrom repm_qgis.runtime.progress import Silent\n"
        "run_tasks(abs, list(range(8)), 2, Silent(), str)\n",
        encoding="utf-8",
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(code)], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    last = done.stderr.splitlines()[-1]
    assert "A worker process could not begin" in last and "'if __name__ == \"__main__\":'" in last, done.stderr
    # A stage would first wait for the folders that the script's own run keeps for itself, and never end.
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(WorkerError, match="could not begin: if a script of your own"):
        run_stage("environment", {}, Silent())


def test_where_the_system_says_that_it_killed_for_memory_so_do_we(work, told, monkeypatch):
    counts = iter((3, 4))
    monkeypatch.setattr(parallel, "memory_kills", lambda: next(counts))
    with pytest.raises(OutOfMemoryError, match="The system killed a worker process after . of 8 tasks because memory"):
        run_tasks(partial(work.deadly, number=getattr(signal, "SIGKILL", 9)), list(range(8)), 2, told(), str)


@pytest.mark.parametrize("workers", (1, 2))
def test_want_of_memory_in_a_task_is_a_sentence(work, told, workers):
    with pytest.raises(OutOfMemoryError, match=r"Memory ran out \(.*allocate.*\): use fewer WORKERS"):
        with shortage_as_error():
            run_tasks(work.hungry, list(range(8)), workers, told(), str)


@linux
@pytest.mark.parametrize("limit", (100, 200, 300, 1000))
def test_workers_that_find_no_memory_to_begin_with_are_a_sentence(tmp_path, limit):
    """Imports fail then, and threads: whatever the limit, there is one sentence and no traceback, and nothing hangs."""
    code = tmp_path / "bounded.py"
    code.write_text(BOUNDED)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(code), str(limit)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    last = done.stdout.splitlines()[-1]  # OpenCV may say something before, without an end of line
    assert ("[0, 1, 2" if limit == 1000 else "OutOfMemoryError ") in last, done.stdout + done.stderr
    assert "Traceback" not in done.stderr, done.stderr


def test_workers_live_on_within_a_block_only(work, told):
    def who(workers=2):
        return set(run_tasks(work.who, list(range(8)), workers, told(), str))

    with kept_workers():
        first = who() | who()  # where workers begin slowly, one of them may do all of the first tasks
        assert len(first) <= 2
        with pytest.raises(OptionError):
            run_tasks(work.picky, list(range(8)), 2, told(), str)
        later = who()
        assert not later & first
        assert not who(3) & later
    assert not who() & later


def test_on_macos_no_worker_is_a_copy_of_a_process_with_native_threads(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    assert parallel._context().get_start_method() == "spawn"


def commands_of_children():
    """The command lines of this process's children that have not ended; bare Linux systems have no ps."""
    if not os.path.exists("/proc/self/stat"):
        words = ["ps", "-A", "-o", "ppid,stat,args"]
        lines = subprocess.run(words, text=True, stdout=subprocess.PIPE, check=True).stdout.splitlines()[1:]
        found = [line.split(None, 2) for line in lines]
        return [each[2] for each in found if each[0] == str(os.getpid()) and "Z" not in each[1]]
    commands = []
    for number in filter(str.isdigit, os.listdir("/proc")):
        with contextlib.suppress(OSError):  # it ends just now
            with open(f"/proc/{number}/stat", encoding="utf-8", errors="replace") as stream:
                state, parent = stream.read().rpartition(")")[2].split()[:2]
            if int(parent) == os.getpid() and state != "Z":
                with open(f"/proc/{number}/cmdline", encoding="utf-8", errors="replace") as stream:
                    commands.append(stream.read().replace("\0", " "))
    return commands


def test_cancel_is_quick_and_leaves_no_process(work, told):
    start = time.monotonic()
    with pytest.raises(Cancelled):
        run_tasks(work.slow, list(range(8)), 2, told(cancel_at=3), str)
    assert time.monotonic() - start < 5
    assert multiprocessing.active_children() == []
    if os.name == "nt":  # which has no ps, and no server whose children these would be
        return
    running = "".join(commands_of_children())
    assert "spawn_main" not in running and "forkserver" not in running


def test_cancel_is_quick_though_a_task_is_on_its_way(work, told):
    """It fills the pipe, and with the workers its readers are gone: its writer would wait for ever."""
    start = time.monotonic()
    with pytest.raises(Cancelled):
        run_tasks(work.slow, [bytes(1 << 20)] * 12, 2, told(cancel_at=3), len)
    assert time.monotonic() - start < 5


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signal")
def test_cancel_is_quick_where_termination_is_ignored(tmp_path):
    """A parent may have a program begin so, and workers inherit it; without an end this would wait for ever."""
    script = tmp_path / "run.py"
    script.write_text(
        "import signal, time\n"
        "from repm_qgis.contracts.errors import Cancelled\n"
        "from repm_qgis.runtime.parallel import run_tasks\n"
        "from repm_qgis.runtime.progress import Silent\n"
        "class Cancel(Silent):\n"
        "    asked = 0\n"
        "    def check_cancelled(self):\n"
        "        self.asked += 1\n"
        "        if self.asked > 3:\n"
        "            raise Cancelled\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "    try:\n"
        "        run_tasks(time.sleep, [100.0] * 8, 2, Cancel(), str)\n"
        "    except Cancelled:\n"
        "        print('cancelled')\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "cancelled\n")


@pytest.mark.skipif(os.name == "nt", reason="Windows does not count it")
def test_what_workers_use_is_counted_as_used_by_this_process(work, told):
    before = os.times()
    run_tasks(work.busy, [0.2] * 6, 2, told(), str)
    after = os.times()
    assert after.children_user + after.children_system - before.children_user - before.children_system > 1.2


def test_cores(monkeypatch):
    """Those that this process may use, or all of the machine where a system does not tell."""
    assert 1 <= cores() <= (os.cpu_count() or 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 3, 5} if process == 0 else {1}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 16)
    assert cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    assert cores() == 16
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert cores() == 1


def test_the_environment_of_this_process_stays(work, told, monkeypatch):
    """The server process gets one thread for sums; this one keeps what it has."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    before = dict(os.environ)
    run_tasks(work.square, list(range(5)), 2, told(), str)
    assert dict(os.environ) == before


_PINNING = """
import threading
import numpy as np
from repm_qgis.runtime.process_limits import _thread_settings, one_thread_for_loaded_sums

def threads():
    return [get() for get, _ in _thread_settings()]

before = threads()
if not before and not any(name in open("/proc/self/maps").read() for name in ("openblas", "libmkl")):
    print("one thread alone")  # the reference's, which a bare Debian has
    raise SystemExit
assert before, "no library is known"
entered, leave = threading.Event(), threading.Event()

def other():
    with one_thread_for_loaded_sums():
        entered.set()
        leave.wait(20)

with one_thread_for_loaded_sums():
    assert set(threads()) == {1}, threads()
    thread = threading.Thread(target=other)
    thread.start()
    assert entered.wait(20)
assert set(threads()) == {1}, "the other block goes on"
leave.set()
thread.join()
assert threads() == before, (threads(), before)
print("before", max(before))
"""


def test_each_stage_has_one_thread_for_linear_algebra(monkeypatch, told):
    """In QGIS's process and in scripts too, whose numpy has as many threads as there are cores."""
    from repm_qgis.runtime.process_limits import _thread_settings
    from repm_qgis.stages import environment, run_stage

    settings, seen = list(_thread_settings()), []  # the stage may load more of them
    before = [(put, get()) for get, put in settings]
    if not before:
        pytest.skip("no library of this numpy has threads that can be set")
    monkeypatch.setattr(environment, "run", lambda *_: seen.append({get() for get, _ in _thread_settings()}) or {})
    try:
        for put, _ in before:
            put(2)
        counts = [get() for get, _ in settings]  # a library that was built for one thread stays at that
        run_stage("environment", {}, told())
        assert seen == [{1}] and [get() for get, _ in settings] == counts and 2 in counts
    finally:
        for put, count in before:
            put(count)


@pytest.mark.skipif(sys.platform == "darwin", reason="Accelerate has no such setting")
def test_linear_algebra_that_others_have_loaded_gets_one_thread_for_a_while():
    """Light stages run in QGIS's process, whose numpy has as many threads as cores."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2", "MKL_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", _PINNING], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    if done.stdout.strip() == "one thread alone":
        pytest.skip("this numpy's linear algebra has one thread alone")
    if cores() > 1:
        assert done.stdout.strip() == "before 2"


def test_few_tasks_are_done_here(work, told):
    """Starting processes would take longer; and so with one worker."""
    assert set(run_tasks(work.who, list(range(4)), 2, told(), str)) == {os.getpid()}
    assert set(run_tasks(work.who, list(range(9)), 1, told(), str)) == {os.getpid()}
    with kept_workers():
        assert os.getpid() not in run_tasks(work.who, list(range(5)), 2, told(), str)
        assert os.getpid() not in run_tasks(work.who, list(range(4)), 2, told(), str), "these have begun"
        assert set(run_tasks(work.who, list(range(3)), 2, told(), str)) == {os.getpid()}


def test_what_is_said_of_tasks(work, told):
    said = told()
    steps = []
    said.step = lambda fraction, text="": steps.append((fraction, text))
    run_tasks(work.square, [5, 6], 1, said, "tile {}".format)
    assert steps == [(0.0, "tile 5"), (0.5, "tile 6")]
    steps.clear()
    run_tasks(work.square, [5, 6, 7, 8, 9], 2, said, "tile {}".format)
    assert steps[0] == (0.0, "5 tasks on 2 cores")
    assert [fraction for fraction, _ in steps[1:]] == [0.2, 0.4, 0.6, 0.8, 1.0]
    assert sorted(text.split(" (")[0] for _, text in steps[1:]) == ["tile 5", "tile 6", "tile 7", "tile 8", "tile 9"]
    assert steps[-1][1].endswith("(5 of 5)")


def test_an_executor_whose_thread_has_died_is_a_sentence_and_no_hang(work, told, monkeypatch):
    """Where there is no memory for the thread that feeds the workers, nobody would ever end the tasks."""
    import concurrent.futures.process as pool

    def die(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(pool._ExecutorManagerThread, "add_call_item_to_queue", die)
    monkeypatch.setattr("threading.excepthook", lambda arguments: None)
    start = time.monotonic()
    with pytest.raises(OutOfMemoryError, match="could not start a thread because memory ran out: use fewer WORKERS"):
        run_tasks(work.square, list(range(8)), 2, told(), str)
    assert time.monotonic() - start < 10
