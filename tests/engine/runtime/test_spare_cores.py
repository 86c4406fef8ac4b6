"""Work on spare cores: at the same time as this thread's, bounded, and with the results and errors of one thread."""

import threading
import time
from contextvars import ContextVar

import pytest

from repm_qgis.runtime.parallel import run_tasks
from repm_qgis.runtime.progress import Silent
from repm_qgis.runtime.spare_cores import side_by_side, spare_cores, spread

PATIENCE_S = 20


class Counter:
    """How many threads were in a block at the same time, at most."""

    def __init__(self):
        self._lock, self._now, self.most = threading.Lock(), 0, 0

    def __call__(self, work, seconds=0.02):
        with self._lock:
            self._now += 1
            self.most = max(self.most, self._now)
        time.sleep(seconds)
        with self._lock:
            self._now -= 1
        return work * work


@pytest.mark.parametrize("count", (0, 1, 3))
def test_results_come_in_order_on_no_more_cores_than_are_spare(count):
    counter = Counter()
    with spare_cores(count):
        assert spread(counter, range(12)) == [work * work for work in range(12)]
    assert counter.most == count + 1
    assert spread(counter, []) == []


def test_without_spare_cores_all_is_done_by_this_thread():
    assert set(spread(lambda _: threading.get_ident(), range(5))) == {threading.get_ident()}


def test_few_tasks_are_done_at_the_same_time():
    """Each waits for the others, for ever where one is done after the other."""
    barrier = threading.Barrier(3)
    waited = run_tasks(lambda _: barrier.wait(PATIENCE_S), [0, 1, 2], 3, Silent(), str)
    assert sorted(waited) == [0, 1, 2]


def test_work_within_work_gets_the_core_that_is_left_over():
    """Of two works one ends at once: the parts of the other one, which wait for each other, then have both cores."""
    barrier = threading.Barrier(2)

    def work(number):
        if number == 0:
            return []
        time.sleep(0.2)
        return side_by_side(*[lambda: barrier.wait(PATIENCE_S)] * 2)

    with spare_cores(1):
        assert sorted(spread(work, (0, 1))[1]) == [0, 1]


def test_nested_work_takes_no_more_cores_than_are_spare():
    counter = Counter()
    with spare_cores(2):
        spread(lambda _: spread(counter, range(4)), range(4))
    assert counter.most <= 3


@pytest.mark.parametrize("count", (0, 1, 3))
def test_the_error_is_that_of_the_first_work_that_has_one(count):
    def picky(work):
        time.sleep(0.05 if work == 2 else 0)  # the later one fails first
        if work in (2, 3):
            raise ValueError(f"work {work}")
        return work

    done = threading.active_count()
    with spare_cores(count), pytest.raises(ValueError, match="work 2"):
        spread(picky, range(8))
    assert threading.active_count() == done, "a thread goes on after the error"


def test_what_begin_raises_drops_what_has_not_begun():
    seen, begun = [], []

    def begin(ended, work):
        begun.append(ended)
        if ended > 2:
            raise KeyboardInterrupt

    with spare_cores(1), pytest.raises(KeyboardInterrupt):
        spread(lambda work: (time.sleep(0.01), seen.append(work)), range(100), begin)
    assert len(seen) < 10 and begun == sorted(begun)
    count = len(seen)
    time.sleep(0.05)
    assert len(seen) == count, "work goes on after the error"


def test_other_threads_have_the_context_of_this_one():
    """The language of texts, and which links may be followed."""
    language: ContextVar = ContextVar("language", default="en")
    token, barrier = language.set("de"), threading.Barrier(2)
    try:
        with spare_cores(1):
            assert spread(lambda _: (barrier.wait(PATIENCE_S), language.get())[1], (0, 1)) == ["de", "de"]
    finally:
        language.reset(token)


def test_where_no_thread_can_begin_this_one_does_all(monkeypatch):
    def refuse(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    with spare_cores(3):
        assert set(spread(lambda _: threading.get_ident(), range(5))) == {threading.get_ident()}
