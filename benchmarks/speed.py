"""CPU seconds, time by the clock and memory of the whole pipeline, in turn with those of an earlier revision.

Machines differ, and one machine from hour to hour: only what runs in turn on one machine can be compared.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Tuple

import numpy as np

from benchmarks import towns
from benchmarks.runner import CORES, ROOT, Cost, Failed, earlier, is_quick, made_by, say
from benchmarks.scenes import Scene, absent, default, real, simulated, whu_tlc, zy3
from benchmarks.tables import Details, Section, table

BEFORE = "913e92d"  # the revision in turn with which all is timed; a release's tag once there is one
TURNS = 5


@dataclass(frozen=True)
class Work:
    """Images, with what they are called, and how many workers make their DSM."""

    name: str
    scene: Scene
    workers: int = 1


def works() -> Iterator[Work]:
    """What is timed; simulated images are made when they are called for."""
    for scene in real("pleiades_pair", "pleiades_triplet"):
        yield Work(scene.name, scene)
        if is_quick():
            break
    yield Work("a small town of 3 views" if is_quick() else "town of 3 views, 1400 px", default("urban", 1400, 1))
    if is_quick():
        return
    yield Work("ZY-3, 3 x 2048 px", simulated("zy3_2048", zy3(2048, 1500.0), 5.0))
    if towns._FOLDER.exists():
        for count in (2, 19):
            images = towns.images_of(towns._names()[:count])
            yield Work(f"jax_068, {count} images", Scene("jax_068", images, towns._LIDAR.heights, 0.5, True))
    for scene in whu_tlc()[:1]:
        yield Work(scene.name, scene)
    large = simulated("zy3_1500m", zy3(5120, 1500.0), 5.0)
    yield Work(f"ZY-3, 3 x 5120 px, {CORES} workers", large, CORES)


def _turn(work: Work, tree: Path) -> Tuple[Cost, Dict[str, float]]:
    """The cost of one run of a checkout's pipeline, and the seconds of its stages."""
    with tempfile.TemporaryDirectory() as folder:
        options = {"resolution": work.scene.resolution, "workers": work.workers}
        _, cost = made_by(tree, work.scene.images, folder, **options)
        history = json.loads(Path(folder, "w", "reconstructed.json").read_text(encoding="utf-8"))["history"]
        seconds = {entry["stage"]: float(entry["seconds"]) for entry in history if "seconds" in entry}
    return cost, seconds


def _timed(work: Work, before: Path) -> Tuple[List[object], List[object]]:
    """Rows of the two tables: medians of the turns, and ratios turn by turn."""
    turns: List[Tuple[Cost, ...]] = []
    stages: List[Dict[str, float]] = []
    for turn in range(1 if is_quick() else TURNS):
        say(f"{work.name}, turn {turn + 1} ...")
        found = [_turn(work, tree) for tree in (ROOT, before)]
        turns.append(tuple(cost for cost, _ in found))
        stages.append(found[0][1])
    figures = np.array([[(c.cpu_s, c.wall_s, c.peak_gib) for c in turn] for turn in turns])
    middle = np.median(figures, axis=0)
    row: List[object] = [work.name]
    for number in range(3):
        row += [float(engine[number]) for engine in middle[::-1]]
        if number < 2:
            row.append(float(np.median(figures[:, 0, number] / figures[:, 1, number])))
    matching = float(np.median([part.get("reconstruct", 0.0) for part in stages]))
    fitting = float(np.median([part.get("epmfit", 0.0) + part.get("refine", 0.0) for part in stages]))
    rest = float(middle[0][1]) - matching - fitting
    return row, [work.name, fitting, matching, rest]


def cost() -> List[str]:
    rows, parts = [], []
    with tempfile.TemporaryDirectory() as place:
        before = earlier(BEFORE, Path(place))
        if before is None:
            raise Failed(f"there is nothing to compare with: the revision {BEFORE} is not here (a shallow clone?)")
        for work in works():
            row, part = _timed(work, before)
            rows.append(row)
            parts.append(part)
    heads = ("work", f"CPU, s: {BEFORE}", "now", "ratio", f"wall, s: {BEFORE}", "now", "ratio")
    return [
        f"`python -m repm_qgis pipeline` with default settings as a process, its start included, on {CORES} cores; one "
        f"worker where nothing else is said. The engine now and that of {BEFORE} run in turn; medians of "
        f"{1 if is_quick() else TURNS} turns, ratios turn by turn.",
        table([*heads, f"peak, GiB: {BEFORE}", "now"], rows),
        Details("Seconds by the clock of the stages now; *the rest* is fusion, reports, and the start."),
        Details(table("work | camera models | tie points and matching | the rest", parts)),
        *absent("pleiades_pair", "pleiades_triplet"),
    ]


SECTIONS = [Section("speed", "What a run costs", "make bench-speed", {"cost": cost})]
