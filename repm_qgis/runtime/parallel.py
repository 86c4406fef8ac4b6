"""Tasks on the cores of this machine: the results do not depend on the number of workers."""

from __future__ import annotations

import multiprocessing
import multiprocessing.context
import multiprocessing.process
import multiprocessing.util
import os
import pickle  # nosec B403 # see its one reading
import signal
import sys
import tempfile
import threading
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from typing import Any, Callable, Dict, Iterator, List, Optional, Protocol, Sequence, Tuple, TypeVar

from ..contracts.errors import OutOfMemoryError, RepmError, WorkerError
from ..contracts.findings import Finding
from .containers import memory_kills
from .process_limits import THREAD_VARIABLES, one_thread_for_sums, prepare_process
from .progress import Progress, Recorder, Silent, warn_all
from .shortage import MEMORY_REMEDY, shortage_as_error
from .spare_cores import spare_cores, spread
from .translation import reader, written_in
from .windows import cancel_transfers, exit_code
from .workspace import ensure_folder, remove_temporary, temporary_name

T = TypeVar("T")
"""What a task is."""
R = TypeVar("R")
"""What comes of it."""

_PRELOADED = ("numpy", "cv2", "osgeo.gdal_array")
_POLL_S = 0.3
_NO_MEMORY = 71  # the exit code of a worker that could not begin
_TERMINATED = 0x10000  # the exit code of what multiprocessing ends on Windows
_LEAST_STATUS = 0xC0000000  # from here on exit codes are errors of Windows (ntstatus.h)
_STATUS_NO_MEMORY = {0xC0000017, 0xC000012D}  # STATUS_NO_MEMORY, STATUS_COMMITMENT_LIMIT
_LONGEST_FOLDER = 70  # of characters; a socket's whole path may have 103 on macOS
_NO_THREAD = f"This process could not start a thread because memory ran out: {MEMORY_REMEDY}."
_FEW, _FEW_TO_BEGIN = 3, 4
"""With so few tasks, threads of this process gain more than processes, which share nothing and may end unevenly; and
with so few, processes that have not begun yet."""


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Workers(Protocol):
    """What runs tasks: this machine's processes, or those of a cluster (:mod:`repm_qgis.runtime.cluster`)."""

    @property
    def task_mib(self) -> Optional[float]:
        """The memory that a task may take, MiB; None where the tasks run on this machine."""

    def run(
        self,
        function: Callable[[T], R],
        tasks: Sequence[T],
        workers: int,
        progress: Progress,
        describe: Callable[[T], str],
    ) -> List[R]:
        """See :func:`run_tasks`."""

    def kill(self) -> None:
        """End the workers without waiting for anything that a lock might hold."""


def run_tasks(
    function: Callable[[T], R],
    tasks: Sequence[T],
    workers: int,
    progress: Progress,
    describe: Callable[[T], str],
) -> List[R]:
    """``[function(task) for task in tasks]``, in worker processes where that pays.

    ``function`` and tasks must be picklable, ``workers`` 0 means one a core; a cluster uses all that it has. Progress
    moves with every finished task; Cancel drops what has not begun and ends the workers. Exceptions of a task are
    raised here. A worker that is killed or finds no memory raises OutOfMemoryError, one that dies of something else
    WorkerError; a cluster's raises ClusterError.
    """
    if _workers is None:
        with kept_workers():
            return run_tasks(function, tasks, workers, progress, describe)
    return _workers.run(function, tasks, workers or cores(), progress, describe)


def run_whole(function: Callable[[T, Progress], R], task: T, progress: Progress, description: str) -> R:
    """``function(task, progress)``: here, or on a worker of a cluster, where there is one, so that no pixel comes here.

    The notes and findings of a cluster's worker are passed on when it is done.
    """
    if _workers is None or isinstance(_workers, _Pool):
        return function(task, progress)
    work = function, task, reader().language
    ((result, notes, findings),) = run_tasks(_noted, [work], 1, progress, lambda _: description)
    for text in notes:
        progress.info(text)
    warn_all(progress, findings)
    return result


def _noted(work: Tuple[Callable[[T, Progress], R], T, str]) -> Tuple[R, List[str], List[Finding]]:
    function, task, language = work
    recorder = Recorder(Silent())
    with written_in(language):
        return function(task, recorder), recorder.notes, recorder.findings


def task_mib() -> Optional[float]:
    """The memory that a task may take where a cluster's workers say so, MiB; else None."""
    return None if _workers is None else _workers.task_mib


class _Pool:
    """Worker processes of this machine that wait for tasks; each begins when there is a task for it."""

    task_mib: Optional[float] = None

    def __init__(self) -> None:
        self._executor: Optional[ProcessPoolExecutor] = None
        self._workers = 0

    def run(
        self,
        function: Callable[[T], R],
        tasks: Sequence[T],
        workers: int,
        progress: Progress,
        describe: Callable[[T], str],
    ) -> List[R]:
        results: Dict[int, R] = {}
        if workers <= 1 or len(tasks) <= (_FEW if self._executor else _FEW_TO_BEGIN):

            def begin(ended: int, task: T) -> None:
                progress.check_cancelled()
                progress.step(ended / len(tasks), describe(task))

            with spare_cores(workers - 1):
                return spread(function, tasks, begin)
        pending: Dict["Future[R]", int] = {}
        killed_before = memory_kills()
        try:
            executor = self._of(workers)
            for index, task in enumerate(tasks):
                pending[executor.submit(do_task, packed(function, task))] = index
            progress.step(0.0, f"{len(tasks)} tasks on {workers} cores")
            for index, future in as_they_end(pending, progress, lambda: _require_manager(executor)):
                results[index] = future.result()
                progress.step(len(results) / len(tasks), f"{describe(tasks[index])} ({len(results)} of {len(tasks)})")
        except (BrokenProcessPool, ConnectionError, EOFError) as error:  # the latter two: the workers' server is gone
            _require_thread(error, *(future.exception() for future in pending if future.done()))
            certain = killed_before is not None and (memory_kills() or 0) > killed_before
            raise _death(self._exit_codes(), certain, len(results), len(tasks)) from error
        except BaseException:
            self._end()
            raise
        return [results[i] for i in range(len(tasks))]

    def _of(self, workers: int) -> ProcessPoolExecutor:
        """The pool with so many workers: another number, by which memory is bounded, needs another pool."""
        if self._workers != workers:
            self.close()
        if self._executor is None:
            self._executor = ProcessPoolExecutor(workers, mp_context=_context(), initializer=begin_worker)
            self._workers = workers
            _begin_to_feed(self._executor)
        return self._executor

    def _exit_codes(self) -> List[Optional[int]]:
        """Close a broken pool; gives the exit codes of its workers, negative ones are signals."""
        processes = self._processes()
        self.close()
        if os.name != "nt":
            return [process.exitcode for process in processes]
        # The executor ends all of them: the system still knows which of them had ended before, and how.
        codes = [exit_code(process.sentinel) for process in processes]
        return [-signal.SIGTERM if code == _TERMINATED else code for code in codes]

    def _end(self) -> None:
        """End the workers while they work."""
        self.kill()
        self._let_go(ended=True)

    def kill(self) -> None:
        for process in self._processes():
            process.kill()  # who starts a program with SIGTERM ignored has its workers ignore it, too

    def _processes(self) -> List[multiprocessing.process.BaseProcess]:
        """The workers that have begun; no public name has them."""
        return list((getattr(self._executor, "_processes", None) or {}).values())

    def close(self) -> None:
        """Let the workers end."""
        if os.name == "nt":  # nothing counts their time there, and one that is still importing takes seconds to end
            self._end()
        else:
            self._let_go()

    def _let_go(self, ended: bool = False) -> None:
        executor, self._executor, self._workers = self._executor, None, 0
        if executor is None:
            return
        with _unblocked(executor) if ended else nullcontext():
            executor.shutdown(wait=True, cancel_futures=True)


def _begin_to_feed(executor: ProcessPoolExecutor) -> None:
    """Start the thread that takes tasks to the workers here, where a lack of memory for it can be raised.

    The executor would start it from a thread of its own with the first task, and Python prints the traceback of one
    that dies.
    """
    queue: Any = getattr(executor, "_call_queue", None)  # no public name has it
    if queue is not None and getattr(queue, "_thread", queue) is None:
        with queue._notempty:
            queue._start_thread()


@contextmanager
def _unblocked(executor: ProcessPoolExecutor) -> Iterator[None]:
    """Within the block, nobody waits for a task to reach workers that have ended.

    A task on its way fills the pipe. Its writer would wait for a reader for ever, and the executor for the writer, in
    Python before 3.12.1, and on Windows.
    """
    queue, over = getattr(executor, "_call_queue", None), threading.Event()  # no public name has it

    def unblock() -> None:
        while queue is not None and not over.wait(0.02):
            with suppress(OSError, EOFError, ValueError):  # it has been closed
                if os.name == "nt":
                    cancel_transfers(queue._writer.fileno())
                else:
                    while queue._reader.poll():
                        queue._reader.recv_bytes()

    thread = threading.Thread(target=unblock, name="unblock", daemon=True)
    with suppress(RuntimeError):  # no memory for it: then usually no task is on its way
        thread.start()
    try:
        yield
    finally:
        over.set()
        if thread.ident is not None:
            thread.join()


def _context() -> multiprocessing.context.BaseContext:
    """How workers begin: as copies of a server process that has imported what all need, or each by itself.

    Never as copies of this process: native libraries' threads do not survive that. The server has none; but on macOS
    the system's own libraries may have begun some when numpy and OpenCV were imported (docs.python.org,
    multiprocessing, "Contexts and start methods").
    """
    if sys.platform == "darwin" or "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver  # not on Windows

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_PRELOADED))
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    one_thread_for_sums()  # the server imports numpy, and for its copies it is then too late
    try:
        _own_place_for_sockets()
        forkserver.ensure_running()
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    return context


@cache
def _own_place_for_sockets() -> None:
    """Have the server's socket lie in a temporary folder of ours: the next run removes what a killed one left there."""
    folder = temporary_name(os.path.join(tempfile.gettempdir(), "repm"))
    if len(folder) > _LONGEST_FOLDER:
        return
    before, tempfile.tempdir = tempfile.tempdir, str(ensure_folder(folder))
    try:
        multiprocessing.util.get_temp_dir()  # which it removes with a priority of -100
        multiprocessing.util.Finalize(None, remove_temporary, args=(folder,), exitpriority=-200)
    finally:
        tempfile.tempdir = before


def _stop_server() -> None:
    """End the server and wait for it, so that the processor time of its copies is counted for this process."""
    stop = getattr(getattr(sys.modules.get("multiprocessing.forkserver"), "_forkserver", None), "_stop", None)
    if stop is not None:  # no public name has it; without it the server ends by itself, soon after this process
        stop()


_workers: Optional[Workers] = None


def end_workers() -> None:
    """End all workers at once, whatever they do; for a process that is about to end itself."""
    if _workers is not None:
        _workers.kill()


@contextmanager
def use_workers(workers: Workers) -> Iterator[None]:
    """Within the block tasks run on these."""
    global _workers
    outer, _workers = _workers, workers
    try:
        yield
    finally:
        _workers = outer


@contextmanager
def kept_workers() -> Iterator[None]:
    """Within the block workers live on from one :func:`run_tasks` to the next: to start them costs 0.4 s of imports.

    Where workers are in use already, these go on.
    """
    if _workers is not None:
        yield
        return
    pool = _Pool()
    try:
        with use_workers(pool):
            yield
    finally:
        pool.close()
        _stop_server()


def packed(function: Callable[[T], object], task: T) -> bytes:
    """A task as it travels to a worker."""
    return pickle.dumps((function, task))


def do_task(work: bytes) -> Any:
    """A :func:`packed` task, in a worker. It is unpacked here, so that a missing import is reported."""
    with shortage_as_error():
        function, task = pickle.loads(work)  # nosec B301 # noqa: S301 - made by the process that started this one
        return function(task)


def require_main() -> None:
    """Raise WorkerError in a worker that is still importing the script which started it: a run there would wait
    for the run of that script, which waits for the worker."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # no public name; multiprocessing's own check
        raise _unguarded()


def _unguarded() -> RepmError:
    return WorkerError(
        "A worker process could not begin: if a script of your own started this run, let it do so below "
        "'if __name__ == \"__main__\":', because workers import the script."
    )


def _death(codes: Sequence[Optional[int]], certain: bool, done: int, total: int) -> RepmError:
    """The error for a worker that ended without an answer, by the exit codes of all workers and the tasks done."""
    when = f"after {done} of {total} tasks"
    if certain:
        return OutOfMemoryError(f"The system killed a worker process {when} because memory ran out: {MEMORY_REMEDY}.")
    if _NO_MEMORY in codes:
        return OutOfMemoryError(f"A worker process could not start {when} because memory ran out: {MEMORY_REMEDY}.")
    if _STATUS_NO_MEMORY.intersection(codes):
        return OutOfMemoryError(f"Windows ended a worker process {when} because memory ran out: {MEMORY_REMEDY}.")
    signals = {-code for code in codes if code is not None and code < 0}
    if getattr(signal, "SIGKILL", None) in signals:
        text = f"A worker process was killed (SIGKILL) {when}, most likely because memory ran out: {MEMORY_REMEDY}."
        return OutOfMemoryError(text)
    if 1 in codes and not done:  # Python's own end, while it imported the script that started it
        return _unguarded()
    crash = signals - {signal.SIGTERM}  # which ended those that had not died
    names = [signal.Signals(number).name for number in crash]
    names += [f"0x{code:08X}" for code in codes if code is not None and code >= _LEAST_STATUS]
    name = f" ({', '.join(sorted(names))})" if names else ""
    return WorkerError(
        f"A worker process ended without an answer{name} {when}: run again; if memory ran out, {MEMORY_REMEDY}."
    )


def _require_manager(executor: ProcessPoolExecutor) -> None:
    """Raise OutOfMemoryError where the executor's own thread has died: it could not start another one, and none of the
    tasks would ever end."""
    manager = getattr(executor, "_executor_manager_thread", None)
    if manager is not None and not manager.is_alive():
        raise OutOfMemoryError(_NO_THREAD)


def _require_thread(*errors: Optional[BaseException]) -> None:
    """The same for Python from 3.12 on, whose executor says it before it ends."""
    for error in errors:
        if error is not None and "can't start new thread" in str(error.__cause__):
            raise OutOfMemoryError(_NO_THREAD) from error


def as_they_end(
    pending: Dict["Future[R]", int], progress: Progress, check: Callable[[], None] = lambda: None
) -> Iterator[Tuple[int, "Future[R]"]]:
    """Futures with their numbers as they end, removed from ``pending``; a cancel is obeyed while waiting.

    ``check`` is called where none has ended for a while.
    """
    while pending:
        done, _ = wait(pending, timeout=_POLL_S, return_when=FIRST_COMPLETED)
        progress.check_cancelled()
        if not done:
            check()
        for future in done:
            yield pending.pop(future), future


def _end_with_engine() -> None:
    """End this worker as soon as the engine is gone, for example killed: nobody would use its results."""
    engine = multiprocessing.parent_process()

    def watch() -> None:
        if engine is not None:
            engine.join()
            os._exit(1)

    threading.Thread(target=watch, name="watch-engine", daemon=True).start()


def begin_worker() -> None:
    """One thread a worker: N workers use N cores, not N times N. Ctrl-C is for the engine, which ends its workers."""
    try:
        with shortage_as_error():
            _prepare()
    except (OutOfMemoryError, ImportError) as error:
        if isinstance(error, ModuleNotFoundError):
            raise
        # An installed package that the server may have failed to load completely. The engine reports it.
        os._exit(_NO_MEMORY)


def _prepare() -> None:
    for name in ("SIGINT", "SIGBREAK"):  # the latter is Ctrl-Break, on Windows
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    _end_with_engine()
    prepare_process()
