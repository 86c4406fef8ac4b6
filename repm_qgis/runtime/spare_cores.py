"""Work on cores that have nothing else to do: threads of this process, for what is too little for processes.

numpy, OpenCV and GDAL let other threads run while they compute. A thread costs nothing to start, on Windows too, and
shares the memory of libraries. Work may be spread within work that is spread: whoever has nothing left to do leaves
its core to the others. Results and errors do not depend on the number of threads.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import Callable, Dict, Generic, Iterator, List, Optional, Sequence, Tuple, TypeVar

T = TypeVar("T")
"""What a piece of work is."""
R = TypeVar("R")
"""What comes of it."""

_spare: ContextVar[Optional[threading.Semaphore]] = ContextVar("spare", default=None)


@contextmanager
def spare_cores(count: int) -> Iterator[None]:
    """Within the block, work of this thread may be spread over so many cores beside its own."""
    token = _spare.set(threading.Semaphore(max(count, 0)))
    try:
        yield
    finally:
        _spare.reset(token)


def spread(
    function: Callable[[T], R], works: Sequence[T], begin: Callable[[int, T], None] = lambda *_: None
) -> List[R]:
    """``[function(work) for work in works]``, on this core and on spare ones.

    ``begin`` is called in this thread with the number of works that have ended and the next of its own; what it raises
    drops what has not begun. Of several errors the one of the first work is raised, as without spare cores.
    """
    return _Spread(function, works).run(begin)


def side_by_side(*works: Callable[[], R]) -> List[R]:
    """The results of functions, as of :func:`spread`."""
    return spread(lambda work: work(), works)


class _Spread(Generic[T, R]):
    """Works that are taken in their order by this thread and others."""

    def __init__(self, function: Callable[[T], R], works: Sequence[T]) -> None:
        self._function, self._works = function, works
        self._begun, self._lock = 0, threading.Lock()
        self._results: Dict[int, R] = {}
        self._errors: Dict[int, BaseException] = {}
        self._threads: List[threading.Thread] = []

    def run(self, begin: Callable[[int, T], None]) -> List[R]:
        try:
            self._work(begin)
            self._join()
        except BaseException:
            self._drop()
            self._join()
            raise
        for index in sorted(self._errors):
            raise self._errors[index]
        return [self._results[index] for index in range(len(self._works))]

    def _work(self, begin: Callable[[int, T], None] = lambda *_: None) -> None:
        while True:
            self._recruit()
            taken = self._take()
            if taken is None:
                return
            index, work = taken
            begin(len(self._results), work)
            try:
                self._results[index] = self._function(work)
            except BaseException as error:
                self._errors[index] = error
                self._drop()

    def _take(self) -> Optional[Tuple[int, T]]:
        with self._lock:
            if self._begun >= len(self._works):
                return None
            self._begun += 1
            return self._begun - 1, self._works[self._begun - 1]

    def _drop(self) -> None:
        """Let nothing more begin."""
        with self._lock:
            self._begun = len(self._works)

    def _recruit(self) -> None:
        """Begin threads on all spare cores, as far as there is work for them beside what this one takes next."""
        spare = _spare.get()
        while spare is not None and self._begun + 1 < len(self._works) and spare.acquire(blocking=False):
            context = copy_context()
            thread = threading.Thread(target=context.run, args=(self._help, spare), name="spread", daemon=True)
            try:
                thread.start()
            except RuntimeError:  # no memory for it
                spare.release()
                return
            self._threads.append(thread)

    def _help(self, spare: threading.Semaphore) -> None:
        try:
            self._work()
        finally:
            spare.release()

    def _join(self) -> None:
        """Wait for the threads; meanwhile the core of this one is spare."""
        spare = _spare.get()
        if spare is None or not self._threads:
            return
        spare.release()
        for thread in self._threads:  # which may add others until it ends
            thread.join()
        spare.acquire()
