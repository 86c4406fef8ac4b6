"""Tasks over the cores of this machine: same results whatever the number of workers."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Callable, Dict, List, Sequence

from .errors import EmptyResultError
from .progress import Progress

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_FEW = 3
"""Up to so many tasks a pool costs more than it gives: the task's own threads use the cores instead."""


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_tasks(function: Callable[[Any], Any], tasks: Sequence[Any], workers: int, progress: Progress,
              describe: Callable[[Any], str]) -> List[Any]:
    """``[function(task) for task in tasks]``, in worker processes where that pays.

    ``function`` and tasks must be picklable, ``workers`` 0 means one a core. Progress moves with every finished
    task; Cancel drops what has not begun and ends the workers. Exceptions of a task are raised here; a worker that
    dies (out of memory, a crash in native code) raises EmptyResultError.
    """
    workers = min(workers or cores(), len(tasks))
    if workers <= 1 or len(tasks) <= _FEW:
        results = []
        for index, task in enumerate(tasks):
            progress.check_cancelled()
            progress.step(index / len(tasks), describe(task))
            results.append(function(task))
        return results
    return _in_pool(function, tasks, workers, progress, describe)


def _in_pool(function: Callable[[Any], Any], tasks: Sequence[Any], workers: int, progress: Progress,
             describe: Callable[[Any], str]) -> List[Any]:
    results: Dict[int, Any] = {}
    # Spawned, not forked: native libraries' threads do not survive a fork.
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_bound_threads)
    try:
        pending: Dict[Future, int] = {pool.submit(function, task): i for i, task in enumerate(tasks)}
        progress.step(0.0, f"{len(tasks)} tasks on {workers} cores")
        while pending:
            done, _ = wait(pending, timeout=0.3, return_when=FIRST_COMPLETED)
            progress.check_cancelled()
            for future in done:
                index = pending.pop(future)
                results[index] = future.result()
                progress.step(len(results) / len(tasks), f"{describe(tasks[index])} ({len(results)} of {len(tasks)})")
    except BrokenProcessPool as error:
        raise EmptyResultError(f"A worker process ended without an answer after {len(results)} of {len(tasks)} tasks: "
                               "most likely memory ran out. Use fewer workers or a smaller TILE_SIZE.") from error
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return [results[i] for i in range(len(tasks))]


def one_thread_for_sums() -> None:
    """Let linear algebra use one thread, from its import on: call it before numpy is imported.

    Sums in another order differ in their last bits with the number of threads, and rounding makes whole pixels of
    them: results must not depend on it. In a worker, N threads for each of N workers would be too many, besides.
    """
    for name in _THREAD_VARIABLES:
        os.environ[name] = "1"


def _bound_threads() -> None:
    """One thread a worker: N workers use N cores, not N times N."""
    one_thread_for_sums()
    import cv2

    from .imagery.raster import bound_cache

    cv2.setNumThreads(1)
    bound_cache(64)
