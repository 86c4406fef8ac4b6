"""A Dask cluster on this machine against its own worker processes: bytes, CPU, deaths, and the cost of a task."""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import median
from typing import Callable, Dict, List, Sequence, Tuple

from benchmarks.runner import ROOT, Cost, few, is_quick, measured, pipeline, say
from benchmarks.scenes import default, real, simulated, zy3
from benchmarks.tables import Section, table
from repm_qgis.contracts.errors import RepmError
from repm_qgis.runtime.cluster import cluster_workers
from repm_qgis.runtime.parallel import run_tasks
from repm_qgis.runtime.progress import Silent
from tests.engine.cluster_tasks import square
from tests.engine.local_cluster import Cluster

_PRODUCTS = {"confidence": "confidence.tif", "cloud": "cloud.laz", "mesh": "mesh.ply"}
_TICKS = os.sysconf("SC_CLK_TCK")


def _cpu(*processes: subprocess.Popen) -> float:
    """CPU seconds of living processes."""
    total = 0.0
    for process in processes:
        fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        total += (int(fields[11]) + int(fields[12])) / _TICKS
    return total


def _bytes(folder: Path) -> Dict[str, str]:
    """The hash of each product."""
    files = [folder / name for name in ("dsm.tif", *_PRODUCTS.values())]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files if file.exists()}


def _run(images: Sequence[str], folder: Path, **options: object) -> Cost:
    """A whole engine process; its cost has that of its own workers."""
    job = {"images": images, "workspace": f"{folder}/w", "output": f"{folder}/dsm.tif", **_made(folder), **options}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "job.json"
    path.write_text(json.dumps(job))
    return measured([sys.executable, "-m", "repm_qgis", "pipeline", str(path)], str(ROOT))[1]


def same_bytes() -> List[str]:
    """Local pool, one and two workers of a cluster: the bytes, and CPU seconds."""
    cases: List[Tuple[str, int, Callable[[], Sequence[str]]]] = [
        ("demo, 3 x 800 px", 7, lambda: default("urban", 800, 1).images),
        ("Pléiades triplet", 3, lambda: real("pleiades_triplet")[0].images),
        ("ZY-3, 3 x 5120 px", 1, lambda: simulated("zy3_5120", zy3(5120, 1500.0), 5.0).images),
    ]
    rows: List[List[object]] = []
    for name, pairs, images_of in few(cases):
        images = images_of()
        for workers in (2,) if is_quick() else (1, 2):
            with tempfile.TemporaryDirectory() as place:
                rows.append([name, workers, *_compared(images, Path(place), workers, 1 if is_quick() else pairs)])
            say(rows[-1])
    columns = (
        "own workers, CPU s | cluster: engine | scheduler and workers | more in all, % | of single pairs | "
        "engine's memory, MiB"
    )
    return [
        "CPU seconds of whole runs, medians of pairs of runs in turn. The cluster's are those of the engine's process "
        "and, from the run's start to its end, of the scheduler and the workers, which had started before. The "
        "memory is the peak of the engine's process with a cluster.",
        table(f"scene | workers | pairs | same bytes | {columns}", rows),
    ]


def _compared(images: Sequence[str], folder: Path, workers: int, pairs: int) -> List[object]:
    """Pairs of runs of the local pool and a cluster: a row of :func:`same_bytes`."""
    cluster = Cluster(_new(folder / "cluster"), workers)
    seconds: List[Tuple[float, float, float]] = []
    peak_gib = 0.0
    same = True
    try:
        if not is_quick():  # the workers' imports
            _run(default("urban", 400, 1).images, folder / "warm", cluster=cluster.address)
        for pair in range(pairs):
            own = _run(images, folder / f"own{pair}", workers=workers).cpu_s
            before = _cpu(cluster.scheduler, *cluster.workers)
            client = _run(images, folder / f"dask{pair}", cluster=cluster.address)
            seconds.append((own, client.cpu_s, _cpu(cluster.scheduler, *cluster.workers) - before))
            peak_gib = max(peak_gib, client.peak_gib)
            same = same and _bytes(folder / f"own{pair}") == _bytes(folder / f"dask{pair}")
    finally:
        cluster.end()
    shares = sorted(100 * ((client + theirs) / own - 1) for own, client, theirs in seconds)
    middle = [median(column) for column in zip(*seconds)]
    spread = f"{shares[0]:+.1f} to {shares[-1]:+.1f}"
    return [pairs, "yes" if same else "NO", *middle, round(median(shares), 1), spread, round(1024 * peak_gib)]


def deaths() -> List[str]:
    """Workers and schedulers killed at random moments of a run, and a worker stopped for 20 s."""
    chance = random.Random(14)  # noqa: S311 - a reproducible campaign
    images = default("urban", 500, 3).images[:2]
    rows: List[List[object]] = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        options = {"tile_size": 256}
        _run(images, folder / "undisturbed", workers=2, **options)
        wanted = _bytes(folder / "undisturbed")
        kinds = [("worker killed", 20), ("scheduler killed", 5), ("worker stopped for 20 s", 2)]
        for kind, count in few(kinds):
            ended, resumed, seconds = 0, 0, 8.0
            for number in range(1 if is_quick() else count):
                trial = folder / f"{kind}{number}".replace(" ", "_")
                trial.mkdir()
                cluster = Cluster(trial, 2)
                timer = threading.Timer(chance.uniform(1.0, seconds), _harm, (kind, cluster, chance))
                timer.start()
                start = time.monotonic()
                try:
                    pipeline(images, trial, cluster=cluster.address, **options, **_made(trial))
                    ended += _bytes(trial) == wanted
                    seconds = min(seconds, time.monotonic() - start)
                except RepmError as error:
                    say(f"{kind}: {error}")
                    again = Cluster(_new(trial / "again"), 2)
                    pipeline(images, trial, cluster=again.address, **options, **_made(trial))
                    resumed += _bytes(trial) == wanted
                    again.end()
                finally:
                    timer.cancel()
                    cluster.end()
            rows.append([kind, number + 1, ended, resumed, number + 1 - ended - resumed])
            say(rows[-1])
    columns = "what | trials | ended with the same bytes | a sentence, and the same bytes when run again | neither"
    return [
        "A small town in several tiles on two workers; the moments are random, with one seed.",
        table(columns, rows),
    ]


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _made(folder: Path) -> Dict[str, str]:
    return {name: str(folder / file) for name, file in _PRODUCTS.items()}


def _harm(kind: str, cluster: Cluster, chance: random.Random) -> None:
    worker = chance.choice(cluster.workers)
    if kind == "scheduler killed":
        cluster.scheduler.kill()
    elif kind == "worker killed":
        worker.kill()
        cluster.grow(1, wait=False)  # the run may have ended before it is there
    else:
        os.kill(worker.pid, signal.SIGSTOP)
        time.sleep(20)
        os.kill(worker.pid, signal.SIGCONT)


def empty_tasks() -> List[str]:
    """What a task costs that does nothing."""
    count = 200 if is_quick() else 10_000

    def used() -> Tuple[float, float]:
        times = resource.getrusage(resource.RUSAGE_SELF)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return times.ru_utime + times.ru_stime, pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    with tempfile.TemporaryDirectory() as place:
        cluster = Cluster(Path(place), 2)
        try:
            with cluster_workers(cluster.address, (), (), Silent()):
                run_tasks(square, list(range(100)), 0, Silent(), str)
                before, (cpu, mib), start = _cpu(cluster.scheduler), used(), time.monotonic()
                run_tasks(square, list(range(count)), 0, Silent(), str)
                after, wall = used(), time.monotonic() - start
                scheduler = _cpu(cluster.scheduler) - before
        finally:
            cluster.end()
    each = [1000 * seconds / count for seconds in (after[0] - cpu, scheduler, wall)]
    return [
        table(
            "tasks | engine's CPU a task, ms | scheduler's, ms | by the clock, ms | engine's memory grew by, MiB",
            [[count, *each, after[1] - mib]],
        )
    ]


SECTIONS = [
    Section(
        "cluster",
        "A Dask cluster on this machine",
        "make bench-cluster",
        {"bytes": same_bytes, "deaths": deaths, "tasks": empty_tasks},
    )
]
