"""COLMAP's PatchMatch on CUDA beside ``sgm``: DSM scores, seconds, GPU memory for each Mpx.

Needs an NVIDIA GPU and ``pycolmap-cuda12``; where they are not there, the page keeps what the last GPU gave,
and a quick run measures ``sgm`` alone.
"""

from __future__ import annotations

import tempfile
import threading
import time
from typing import Dict, List, Sequence, Tuple

from benchmarks import towns
from benchmarks.runner import Failed, few, is_quick, pipeline, say, stage
from benchmarks.scenes import Scene, default, quick_size, real, simulated, whu_tlc, zy3
from benchmarks.tables import Section, table
from repm_qgis.contracts.stages import COMPAREDSM
from repm_qgis.runtime.environment import cuda, gpus
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.scene import Scene as SceneFile

Way = Tuple[str, Dict[str, object]]
WAYS: Sequence[Way] = (
    ("sgm", {"backend": "sgm"}),
    ("colmap", {"backend": "colmap"}),
    ("colmap, its fusion decides", {"backend": "colmap", "colmap_fusion": True}),
    ("colmap, no geometric pass", {"backend": "colmap", "geometric": False}),
    ("colmap, window of 7 x 7 px", {"backend": "colmap", "window_radius": 3}),
)
BIG = 5120
HEADERS = (
    "scene | matched by | NMAD, m | bias, m | RMSE, m | within 1 m, % of all cells | with a height, % | matching, s | "
    "GPU memory, GiB | GiB a Mpx"
)


class MemoryWatch:
    """The most memory that the GPUs use while the block runs, above what they used before."""

    def __enter__(self) -> MemoryWatch:
        self._before, self._most, self._end = self._used(), 0, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    @staticmethod
    def _used() -> int:
        return max((gpu.total_bytes - gpu.free_bytes for gpu in gpus()), default=0)

    def _watch(self) -> None:
        while not self._end.wait(0.2):
            self._most = max(self._most, self._used())

    @property
    def gib(self) -> float:
        return max(self._most - self._before, 0) / 2**30


def row(name: str, scene: Scene, way: Way) -> List[object]:
    """Scores and cost of a scene's DSM by one way of matching; raises Failed where a tile was not matched."""
    heard = Recorder(Silent())
    with tempfile.TemporaryDirectory() as work:
        with MemoryWatch() as memory:
            made = pipeline(scene.images, work, heard, resolution=scene.resolution, **way[1])
        failed = [text for text in heard.findings if text.startswith("Tile ")]
        if failed:
            raise Failed(failed[0])
        align = "3d" if scene.align else "none"
        score = stage(COMPAREDSM, dsm=made.output, reference=scene.reference, align=align, thresholds=(1.0,))
        records = [record for tile in SceneFile.load(made.scene).tiles for record in tile.heights]
    mpx = max(record.size[0] * record.size[1] for record in records) / 1e6
    used = (memory.gib, memory.gib / mpx) if way[1]["backend"] == "colmap" else ("", "")
    errors = (score.nmad, score.bias, score.rmse, score.completeness)
    return [name, way[0], *errors, made.valid_percent, made.seconds["reconstruct"], *used]


def scenes() -> List[Tuple[Scene, Sequence[Way]]]:
    """The real scenes and ``truth_urban`` with all ways; with two, the town of lidar and a block of WHU-TLC."""
    two = WAYS[:2]
    if not real():
        return [(default("urban", 800, 1), WAYS)]
    found = [(scene, WAYS) for scene in real()] + [(scene, two) for scene in whu_tlc()[:1]]
    if towns._FOLDER.exists():
        sets = [(2, towns._names()[:2]), (3, list(towns._JANUARY))]
        names = [(f"jax_068, {count} images", towns.images_of(numbers)) for count, numbers in sets]
        found += [(Scene(name, images, towns._LIDAR.heights, 0.5, True), two) for name, images in names]
    return found


def rows(missing: str) -> List[List[object]]:
    """A row for each scene and way; each is said as soon as it is there, because a GPU is often lent for minutes."""
    found = []
    for scene, ways in few(scenes()):
        for way in ways[: 1 if missing else None]:
            found.append(row(scene.name, scene, way))
            say(found[-1])
        found += [[scene.name, way[0], missing, *[""] * 7] for way in ways[1:] if missing]
    return found


def big(missing: str) -> List[List[object]]:
    """The paper's case for time: three images of 5120 x 5120 px."""
    side = quick_size(BIG, "ZY3")
    scene = simulated("zy3_800m", zy3(side, 800.0), 5.0)
    rows = []
    name = f"3 x {side} x {side} (ZY-3 simulated)"
    for way in WAYS[: 1 if missing else 2]:
        start = time.monotonic()
        rows.append(row(name, scene, way))
        rows[-1].append(time.monotonic() - start)
    return rows + ([[name, WAYS[1][0], missing, *[""] * 8]] if missing else [])


def beside_sgm() -> List[str]:
    found, devices = cuda(), gpus()
    missing = "" if found["usable"] and devices else f"not measured: {found['remedy'].split(',')[0]}"
    if missing and not is_quick():
        say(f"Nothing is written, COLMAP is {missing}.")
        return []
    return [
        f"On {devices[0] if devices else 'no GPU'}. Matching is the stage `reconstruct`, ties included; memory is the "
        "most in use on the GPU.",
        table(HEADERS, rows(missing)),
        "Three images of 5120 x 5120 px, against the paper's 7.3 min on an A100 (goal: under 60 s):",
        table(HEADERS + " | whole pipeline and comparison, s", big(missing)),
    ]


SECTIONS = [Section("cuda", "COLMAP's PatchMatch on CUDA", "make bench-cuda", {"cuda": beside_sgm})]
