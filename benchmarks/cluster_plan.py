"""Plan of large runs on a cluster: a discrete-event simulation with task times, bytes and overheads measured here.

The model: each scene has a coordinator, which alternates between work of its own and a number of tasks. A task waits
for the scheduler, which takes them one after the other, then for a worker; it moves its bytes over storage that all
share, computes, and its coordinator takes the result. docs/cluster.md shows the tables.
"""

from __future__ import annotations

import heapq
import os
import pickle
import random
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Callable, Dict, Iterator, List, Sequence, Tuple
from unittest import mock

from benchmarks.runner import ROOT, few, is_quick, pipeline, say, there
from benchmarks.scenes import default
from benchmarks.tables import Section, table
from repm_qgis.runtime.progress import Silent

WORKERS, SCENES = (1, 8, 64, 512), (1, 100, 10_000)
SIDE_PX, VIEWS = 40_000, 3
PRICE = 0.05  # US dollars for an hour of one core with 4 GiB, about what clouds ask on demand; a parameter, not a quote
WORKERS_A_SCENE = 16  # one scene runs at a time, and one more for so many workers
TILE_PX = 1300  # side of the engine's largest automatic tiles
MEASURED_TILE_PX = 650  # small, so that two workers have enough of them
MB = 1e6
LINK = 85 * MB
"""Of one worker: what AWS plans for one request to S3 ("85-90 MB/s", S3 User Guide, Performance design patterns)."""
NFS = 1.17e9  # a file server with 10 Gbit/s Ethernet: its payload is 1.17 GB/s at most
S3 = 1e11  # far above what 512 workers ask: S3 names no limit of a bucket

# The model ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Phase:
    """The coordinator's own seconds, then tasks: their number, their CPU seconds (taken in turn), bytes of each."""

    own_s: float
    tasks: int = 0
    seconds: Tuple[float, ...] = ()
    moved: float = 0.0


@dataclass(frozen=True)
class Platform:
    """Workers, overheads of a task in seconds, and storage in bytes a second: of all together, and of one worker."""

    workers: int
    scheduler_s: float = 0.0
    client_s: float = 0.0
    worker_s: float = 0.0
    storage: float = float("inf")
    link: float = float("inf")


@dataclass(frozen=True)
class Outcome:
    """When the last scene ended, s; the share of the workers' time that tasks used; and of the scheduler's."""

    wall_s: float
    busy: float
    scheduler: float


class _Storage:
    """Transfers that share a bandwidth equally; ``served`` is what each that was there from the start has moved."""

    def __init__(self, total: float, link: float) -> None:
        self._total, self._link = total, link
        self._served, self._now = 0.0, 0.0
        self._ends: List[Tuple[float, int]] = []

    def _advance(self, now: float) -> None:
        if self._ends:
            self._served += (now - self._now) * self._rate()
        self._now = now

    def _rate(self) -> float:
        return min(self._link, self._total / len(self._ends))

    def begin(self, now: float, size: float, number: int) -> None:
        self._advance(now)
        heapq.heappush(self._ends, (self._served + size, number))

    def next_end(self) -> float:
        return self._now + max(0.0, self._ends[0][0] - self._served) / self._rate() if self._ends else float("inf")

    def pop(self, now: float) -> int:
        self._advance(now)
        self._served, number = heapq.heappop(self._ends)
        return number


def simulate(scenes: int, phases: Sequence[Phase], platform: Platform, at_once: int = 1, seed: int = 1) -> Outcome:
    """Run so many scenes, ``at_once`` at a time. Each starts at a random place of the lists of its tasks' seconds.

    More than four rounds of scenes are not simulated: the wall time of the rest follows from the rate of the middle.
    """
    rounds = 4 * at_once
    if scenes > rounds:
        ends, busy, served = _events(rounds, phases, platform, at_once, seed)
        rate = (2 * at_once) / (ends[3 * at_once - 1] - ends[at_once - 1])
        wall = ends[-1] + (scenes - rounds) / rate
        busy, served = busy * scenes / rounds, served * scenes / rounds
    else:
        ends, busy, served = _events(scenes, phases, platform, at_once, seed)
        wall = ends[-1]
    return Outcome(wall, busy / (wall * platform.workers), served / wall)


def _events(
    scenes: int, phases: Sequence[Phase], platform: Platform, at_once: int, seed: int
) -> Tuple[List[float], float, float]:
    """When scenes ended, in order; the seconds of all workers in tasks; the seconds of the scheduler."""
    chance = random.Random(seed)  # noqa: S311 - no secret
    storage = _Storage(platform.storage, platform.link)
    heap: List[Tuple[float, int, str, int, float]] = []  # time, order, what, scene, a task's seconds
    phase, left, client_free = [-1] * scenes, [0] * scenes, [0.0] * scenes
    moving: Dict[int, Tuple[int, float]] = {}
    waiting: List[Tuple[int, float]] = []
    head, idle, order, begun = 0, platform.workers, 0, 0
    scheduler_free, busy, served = 0.0, 0.0, 0.0
    ends: List[float] = []

    def later(when: float, what: str, scene: int, seconds: float = 0.0) -> None:
        nonlocal order
        order += 1
        heapq.heappush(heap, (when, order, what, scene, seconds))

    def go_on(now: float, scene: int) -> None:
        """The scene's next phase, or its end and the next scene."""
        nonlocal begun
        phase[scene] += 1
        if phase[scene] < len(phases):
            later(now + phases[phase[scene]].own_s, "submit", scene)
            return
        ends.append(now)
        if begun < scenes:
            begun += 1
            go_on(now, begun - 1)

    while begun < min(at_once, scenes):
        begun += 1
        go_on(0.0, begun - 1)
    while heap or moving:
        end = storage.next_end()
        if moving and (not heap or end <= heap[0][0]):
            now, number = end, storage.pop(end)
            scene, seconds = moving.pop(number)
            later(now + seconds, "done", scene)
            continue
        now, _, what, scene, seconds = heapq.heappop(heap)
        if what == "submit":
            current = phases[phase[scene]]
            left[scene], client_free[scene] = current.tasks, now
            first = chance.randrange(len(current.seconds)) if current.seconds else 0
            for number in range(current.tasks):
                scheduler_free = max(now, scheduler_free) + platform.scheduler_s
                served += platform.scheduler_s
                later(scheduler_free, "ready", scene, current.seconds[(first + number) % len(current.seconds)])
            if not current.tasks:
                go_on(now, scene)
        elif what == "ready":
            waiting.append((scene, seconds))
        elif what == "done":
            idle += 1
            busy += now
            client_free[scene] = max(now, client_free[scene]) + platform.client_s
            left[scene] -= 1
            if not left[scene]:
                later(client_free[scene], "taken", scene)
        else:
            go_on(now, scene)
        while idle and head < len(waiting):
            scene, seconds = waiting[head]
            head, idle, order, busy = head + 1, idle - 1, order + 1, busy - now
            moved = phases[phase[scene]].moved
            if moved:
                moving[order] = (scene, seconds + platform.worker_s)
                storage.begin(now, moved, order)
            else:
                later(now + seconds + platform.worker_s, "done", scene)
    return sorted(ends), busy, served


# What is measured ---------------------------------------------------------------------------------------------------


@contextmanager
def local_cluster(workers: int) -> Iterator[Tuple[str, int]]:
    """The scheduler file and the process id of ``scripts/repm-cluster local``."""
    command = [sys.executable, str(ROOT / "scripts" / "repm-cluster"), "local", str(workers), "--memory", "4000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield [there(process.stdout).readline().strip() for _ in range(3)][1].partition("=")[2], process.pid
        finally:
            process.terminate()


class Timed:
    """A function that also gives its start, its seconds by the clock and of the CPU, and the bytes it moved."""

    def __init__(self, function: Callable[[Any], object]) -> None:
        self._function = function

    def __call__(self, task: Any) -> Tuple[Any, float, float, int]:
        moved, start, cpu = _moved(), time.perf_counter(), time.process_time()
        result = self._function(task)
        return result, time.perf_counter() - start, time.process_time() - cpu, _moved() - moved


def _moved() -> int:
    """Bytes that this process has read and written."""
    with open("/proc/self/io", encoding="ascii") as stream:
        return sum(int(line.split()[1]) for line in stream if line.startswith(("rchar", "wchar")))


@dataclass(frozen=True)
class Batch:
    """A batch of tasks: its name, its begin and end, and of each task wall and CPU seconds, bytes, message's bytes.

    ``own_cpu_s`` is what the coordinator computed between the batch before and this one.
    """

    name: str
    begin: float
    end: float
    own_cpu_s: float
    tasks: Tuple[Tuple[float, float, int, int], ...]


@dataclass(frozen=True)
class Run:
    """A pipeline that ran: wall seconds, its batches (times since its begin), and the load of the machine."""

    wall_s: float
    batches: Tuple[Batch, ...]
    last_cpu_s: float
    load: float

    def own_cpu(self) -> List[float]:
        """The coordinator's CPU seconds before, between and after the batches."""
        return [*(batch.own_cpu_s for batch in self.batches), self.last_cpu_s]

    def own_wall(self) -> List[float]:
        """The same by the clock."""
        begins, ends = [each.begin for each in self.batches], [each.end for each in self.batches]
        return [begin - end for begin, end in zip([*begins, self.wall_s], [0.0, *ends])]

    def replayed(self) -> List[Phase]:
        """What the model makes of it: the same gaps, the same tasks; their bytes are in their seconds."""
        return self._phases(self.own_wall(), 0, 1.0)

    def slowed_as(self, other: "Run") -> List[Phase]:
        """The CPU seconds of this run, slowed by what others used of the machine during the other one."""
        wall, cpu = (sum(task[column] for each in other.batches for task in each.tasks) for column in (0, 1))
        own = sum(other.own_wall()) / sum(other.own_cpu())
        return self._phases([own * each for each in self.own_cpu()], 1, wall / cpu)

    def _phases(self, own: Sequence[float], column: int, factor: float) -> List[Phase]:
        seconds = [tuple(factor * task[column] for task in each.tasks) for each in self.batches]
        return [*(Phase(gap, len(each), each) for gap, each in zip(own, seconds)), Phase(own[-1])]


def recorded(images: Sequence[str], address: str, **options: object) -> Run:
    """The pipeline on a cluster, with what its tasks took."""
    from repm_qgis.runtime import cluster

    batches: List[Batch] = []
    original = cluster._ClusterWorkers.run

    def run(self: Any, function: Any, tasks: Sequence[object], *others: Any) -> List[object]:
        begin, own_cpu = time.perf_counter() - start, time.process_time() - last_cpu[0]
        found = original(self, Timed(function), tasks, *others)
        end = time.perf_counter() - start
        sizes = [len(pickle.dumps((function, task))) + len(pickle.dumps(one[0])) for task, one in zip(tasks, found)]
        figures = tuple((*one[1:], size) for one, size in zip(found, sizes))
        batches.append(Batch(getattr(function, "__name__", "tasks"), begin, end, own_cpu, figures))
        last_cpu[0] = time.process_time()
        return [one[0] for one in found]

    with tempfile.TemporaryDirectory() as folder:
        start, last_cpu = time.perf_counter(), [time.process_time()]
        with mock.patch.object(cluster._ClusterWorkers, "run", run):
            pipeline(images, folder, cluster=address, **options)
        wall, own_cpu = time.perf_counter() - start, time.process_time() - last_cpu[0]
        return Run(wall, tuple(batches), own_cpu, round(os.getloadavg()[0], 1))


def nothing(task: int) -> int:
    return task


def overheads(address: str, process: int, tasks: int) -> Tuple[float, float, float, float]:
    """Seconds a task that does nothing: CPU of the client, the scheduler and the workers; and by the clock."""
    import psutil

    from repm_qgis.runtime.cluster import cluster_workers
    from repm_qgis.runtime.parallel import run_tasks

    scheduler = psutil.Process(process)
    workers = [child for child in scheduler.children(recursive=True) if child.is_running()]

    def used() -> List[float]:
        own = time.process_time()
        return [own, sum(scheduler.cpu_times()[:2]), sum(sum(each.cpu_times()[:2]) for each in workers)]

    with cluster_workers(address, [], [tempfile.gettempdir()], Silent()):
        run_tasks(nothing, range(200), 0, Silent(), str)
        before, start = used(), time.perf_counter()
        run_tasks(nothing, range(tasks), 0, Silent(), str)
        wall, after = time.perf_counter() - start, used()
    client, server, all_workers = ((b - a) / tasks for a, b in zip(before, after))
    return client, server, all_workers, wall / tasks


# The tables ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Measured:
    """Seconds a task of client, scheduler and workers, and pipelines on small and large images, by 1 and 2 workers."""

    client_s: float
    scheduler_s: float
    worker_s: float
    wall_s: float
    small: Run
    one: Run
    two: Run
    sides: Tuple[int, int]


@lru_cache(None)
def measured() -> Measured:
    sides = (400, 400) if is_quick() else (1600, 3200)
    scenes = [default("urban", side, 4) for side in sides]
    options = {"tile_size": 300 if is_quick() else MEASURED_TILE_PX}
    with local_cluster(1) as (address, _):
        say("one worker ...")
        if not is_quick():  # imports and caches
            recorded(scenes[0].images, address, **options)
        one = recorded(scenes[1].images, address, **options)
    with local_cluster(2) as (address, process):
        say("two workers ...")
        two = recorded(scenes[1].images, address, **options)
        small = two if is_quick() else recorded(scenes[0].images, address, **options)
        say("tasks that do nothing ...")
        overhead = overheads(address, process, 300 if is_quick() else 5000)
    return Measured(*overhead, small, one, two, sides)


# How often a batch's tasks are repeated where the area grows; a number of tasks that stays takes longer.
_TILES = (MEASURED_TILE_PX / TILE_PX) ** 2
_BLOCKS = 0.06  # of the coarse surface: 6400 px, of which the images measured fill a part
GROWING = {"match_to_disk": _TILES, "fuse_to_disk": _TILES, "match_block": _BLOCKS, "stretch": 0.0, "noted": 0.0}


def scene_of(found: Measured) -> List[Phase]:
    """The large scene's phases, in CPU seconds.

    Ties come from so many patches; the coordinator's own work grows with the tiles, all else with the pixels.
    """
    area = (SIDE_PX / found.sides[1]) ** 2
    own, before = found.two.own_cpu(), found.small.own_cpu()
    tiles, few = (_tiles_of(run) for run in (found.two, found.small))
    each_tile = max(0.0, sum(own) - sum(before)) / max(tiles - few, 1)
    own_factor = 1.0 + each_tile * (area * _TILES - 1.0) * tiles / sum(own)
    phases = []
    for gap, batch in zip(own, found.two.batches):
        count, grows = len(batch.tasks), batch.name.strip("_") in GROWING
        repeated = round(count * area * GROWING[batch.name.strip("_")]) if grows else 0
        tasks = max(count, repeated)
        each = (area if grows else 1.0) * count / tasks
        moved = sum(moved for _, _, moved, _ in batch.tasks) / count * each
        phases.append(Phase(own_factor * gap, tasks, tuple(cpu * each for _, cpu, _, _ in batch.tasks), moved))
    return [*phases, Phase(own_factor * own[-1])]


def _tiles_of(run: Run) -> int:
    return sum(len(batch.tasks) for batch in run.batches if batch.name == "fuse_to_disk")


def platform_of(found: Measured, workers: int, storage: float = S3) -> Platform:
    return Platform(workers, found.scheduler_s, found.client_s, found.worker_s, storage, LINK)


def at_once(workers: int, scenes: int) -> int:
    return min(scenes, 1 + workers // WORKERS_A_SCENE)


def duration(seconds: float) -> str:
    for size, unit in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:,.{1 if seconds < 20 * size else 0}f} {unit}"
    return f"{seconds:.3g} s"


def check() -> List[str]:
    """What was measured, and the model against the clock."""
    found = measured()
    rows = []
    slowed = "2, from the CPU seconds of the run with 1, slowed as this run was"
    for label, run, phases, workers in (
        ("1", found.one, found.one.replayed(), 1),
        ("2", found.two, found.two.replayed(), 2),
        (slowed, found.two, found.one.slowed_as(found.two), 2),
    ):
        predicted = simulate(1, phases, Platform(workers, found.scheduler_s, found.client_s, found.worker_s)).wall_s
        off = 100 * (predicted / run.wall_s - 1)
        rows.append([label, round(run.wall_s, 2), round(predicted, 2), f"{off:+.1f}", run.load])
    kinds: Dict[str, List[Tuple[float, float, int, int]]] = {}
    for batch in found.two.batches:
        kinds.setdefault(batch.name.strip("_"), []).extend(batch.tasks)
    each = [
        [name, len(tasks), *(round(sum(column) / len(tasks) / unit, 3) for column, unit in zip(zip(*tasks), UNITS))]
        for name, tasks in kinds.items()
    ]
    milliseconds = (1000 * value for value in (found.client_s, found.scheduler_s, found.worker_s, found.wall_s))
    return [
        f"**Measured** on {os.cpu_count()} cores that others used too, with `scripts/repm-cluster local`: the "
        f"pipeline on {VIEWS} simulated images of {found.sides[1]} px with tiles of {MEASURED_TILE_PX} px. A task that "
        "does nothing takes {:.2f} ms of CPU of the coordinator, {:.2f} ms of the scheduler, {:.2f} ms of a worker, "
        "and {:.2f} ms by the clock.".format(*milliseconds),
        table("tasks | number | wall s each | CPU s each | MB read and written each | KiB of messages each", each),
        "**The model against the clock**, the same pipeline. Load: of the machine as the run ended; above the "
        "number of workers, others took part of the time.",
        table("workers | measured, s | predicted, s | difference, % | load", rows),
    ]


UNITS = (1.0, 1.0, MB, 1024.0)


def plan() -> List[str]:
    """Wall time and cost by workers and scenes, and what limits them."""
    found = measured()
    phases = scene_of(found)
    tasks = sum(phase.tasks for phase in phases)
    cpu = sum(phase.tasks * sum(phase.seconds) / len(phase.seconds) for phase in phases if phase.tasks)
    moved = sum(phase.tasks * phase.moved for phase in phases)
    own = sum(phase.own_s for phase in phases)
    mean = cpu / tasks
    rows = []
    for scenes in few(SCENES):
        for workers in few(WORKERS):
            say(f"{scenes} scenes, {workers} workers ...")
            count = at_once(workers, scenes)
            walls = [simulate(scenes, phases, platform_of(found, workers, store), count) for store in (S3, NFS)]
            cost = (workers + count) * walls[0].wall_s / 3600 * PRICE
            shares = [f"{100 * share:.0f}" for share in (walls[0].busy, walls[0].scheduler)]
            rows.append([scenes, workers, count, *(duration(each.wall_s) for each in walls), *shares, f"{cost:,.2f}"])
    transfer = moved / tasks / LINK
    limits = [
        ["one scene: work of its coordinator alone", f"{cpu / own:.0f} workers are half idle", f"{own:.0f} s a scene"],
        [
            "the scheduler",
            f"{(mean + transfer) / found.scheduler_s:.0f} workers",
            f"{1 / found.scheduler_s:.0f} tasks/s of {mean:.2f} s",
        ],
        [
            "a coordinator",
            f"{(mean + transfer) / found.client_s:.0f} workers on its scene",
            f"{1 / found.client_s:.0f} tasks/s",
        ],
        [
            "a file server with 10 Gbit/s",
            f"{NFS * mean / (moved / tasks):.0f} workers",
            f"{moved / tasks / mean / MB:.1f} MB/s for each worker",
        ],
    ]
    return [
        f"**A scene** is {VIEWS} images of {SIDE_PX:,} px ({VIEWS * SIDE_PX**2 / 1e6:,.0f} Mpx): {tasks:,} tasks, "
        f"{cpu / 3600:.2f} CPU hours ({cpu / (VIEWS * SIDE_PX**2 / 1e6):.2f} s a Mpx of all images), "
        f"{moved / 1e9:.0f} GB read and written (calls are counted: caches make it less), and {own:.0f} s of the "
        f"coordinator's own work, all extrapolated from {found.sides[0]} and {found.sides[1]} px: read the figures as "
        f"right within a factor of two. One core costs {PRICE} US dollars an hour (a parameter: put in "
        "your own price; storage and transfers come on top). *S3*: 85 MB/s for each worker and no limit for all "
        "together (AWS, S3 User Guide, *Performance design patterns*); *file server*: 1.17 GB/s for all together (10 "
        "Gbit/s Ethernet). Above four rounds of scenes the rest follows from the rate.",
        table(
            "scenes | workers | scenes at a time | wall, S3 | wall, file server | workers busy % | scheduler busy % | "
            "US dollars, S3",
            rows,
        ),
        "**Where it stops scaling**: the number of workers above which each part would keep the others waiting.",
        table("part | limit | reason", limits),
    ]


SECTIONS = [
    Section(
        "cluster_plan",
        "Time and cost, planned",
        "make bench-cluster_plan",
        {"check": check, "plan": plan},
        "cluster.md",
    )
]
