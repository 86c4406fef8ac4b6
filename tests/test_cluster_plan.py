"""The model of benchmarks/cluster_plan.py in cases whose answer is known."""

from __future__ import annotations

import importlib.util
import math

import pytest

plan = pytest.importorskip("benchmarks.cluster_plan") if importlib.util.find_spec("resource") else None
pytestmark = pytest.mark.skipif(plan is None, reason="benchmarks need a POSIX system")


def outcome(scenes, phases, at_once=1, **platform):
    return plan.simulate(scenes, phases, plan.Platform(**platform), at_once)


def test_one_worker_takes_the_sum_of_everything():
    phases = [plan.Phase(3.0, 4, (1.0, 2.0)), plan.Phase(0.5, 2, (5.0,)), plan.Phase(1.0)]
    assert outcome(1, phases, workers=1).wall_s == pytest.approx(3 + 6 + 0.5 + 10 + 1)
    assert outcome(3, phases, workers=1).wall_s == pytest.approx(3 * 20.5)


@pytest.mark.parametrize("workers", [1, 3, 8, 64, 1000])
def test_without_overheads_it_scales_until_there_is_a_worker_for_each_task(workers):
    found = outcome(1, [plan.Phase(0.0, 240, (2.0,))], workers=workers)
    assert found.wall_s == pytest.approx(2.0 * math.ceil(240 / workers))
    assert found.busy == pytest.approx(480.0 / (found.wall_s * workers))


def test_the_work_of_a_coordinator_bounds_what_workers_gain():
    found = outcome(1, [plan.Phase(30.0, 100, (1.0,)), plan.Phase(10.0)], workers=100)
    assert found.wall_s == pytest.approx(41.0)
    assert outcome(2, [plan.Phase(30.0, 100, (1.0,))], 2, workers=200).wall_s == pytest.approx(31.0)


def test_the_slowest_of_scheduler_coordinator_and_storage_sets_the_pace():
    phases = [plan.Phase(0.0, 1000, (1.0,), 50.0)]
    scheduler = outcome(1, phases, workers=1000, scheduler_s=0.01)
    assert scheduler.wall_s == pytest.approx(11.0) and scheduler.scheduler == pytest.approx(10 / 11)
    assert outcome(1, phases, workers=1000, client_s=0.02).wall_s == pytest.approx(21.0)
    assert outcome(1, phases, workers=1000, storage=5000.0).wall_s == pytest.approx(11.0)  # all move, then all compute
    assert outcome(1, phases, workers=10, link=100.0, worker_s=0.25).wall_s == pytest.approx(100 * 1.75)


def test_transfers_share_the_storage_equally():
    storage = plan._Storage(100.0, 80.0)
    storage.begin(0.0, 80.0, 1)
    storage.begin(0.5, 80.0, 2)  # 1 has 40 left, and each gets 50 a second
    assert (storage.next_end(), storage.pop(1.3)) == (pytest.approx(1.3), 1)
    assert storage.next_end() == pytest.approx(1.3 + 40 / 80)


def test_many_scenes_follow_from_the_rate_of_the_first():
    phases = [plan.Phase(1.0, 20, (0.5, 1.0)), plan.Phase(2.0)]
    few, many = (outcome(count, phases, 3, workers=4).wall_s for count in (12, 1000))
    assert many == pytest.approx(few * 1000 / 12, rel=0.1)
    assert many >= 1000 * 15.0 / 4


def test_the_same_seed_gives_the_same_plan():
    phases = [plan.Phase(0.1, 30, (0.5, 1.0, 3.0), 10.0)]
    first, second = (outcome(9, phases, 2, workers=7, storage=100.0, scheduler_s=0.01) for _ in range(2))
    assert first == second
