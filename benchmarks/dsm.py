"""DSMs of truth scenes and real images through qgis_process: ours and, where they are on PATH, S2P's and CARS's."""

from __future__ import annotations

import tempfile
from itertools import combinations
from pathlib import Path
from typing import List, Sequence

from benchmarks.programs import PEERS, peer, repm
from benchmarks.runner import CORES, Failed, few, say
from benchmarks.scenes import Scene, absent, default, real, simulated, zy3
from benchmarks.scoring import scores, shares
from benchmarks.tables import Section, table

HEADERS = (
    "scene | program | valid % | RMSE m | MedAE m | MAE m | NMAD m | C1 % | C2.5 % | C5 % | CPU s | wall s | peak GiB"
)


def row(scene: Scene, program: str, images: Sequence[str], label: str) -> List[object]:
    """A program's scores and cost on some of a scene's images, or why there are none."""
    say(f"{scene.name}: {label} ...")
    with tempfile.TemporaryDirectory() as work:
        make = repm if program == "ours" else lambda *where: peer(program, *where)
        try:
            dsm, cost = make(images, scene.resolution, Path(work))[:2]
            found = scores(dsm, scene.reference, scene.align)
        except Failed as error:
            if program == "ours":
                raise
            return [scene.name, label, str(error), *[""] * 10]
    values = (found.valid, found.rmse, found.medae, found.mae, found.nmad, *shares(found))
    cells = (round(cost.cpu_s, 1), round(cost.wall_s, 1), round(cost.peak_gib, 2))
    return [scene.name, label, *(round(value, 3) for value in values), *cells]


def rows(scene: Scene) -> List[List[object]]:
    """All programs on all views, and ours on each pair of a simulated tri-stereo."""
    made = [row(scene, "ours", scene.images, f"ours, {len(scene.images)} views")]
    if scene.spec is not None:
        for first, second in few(combinations(range(len(scene.images)), 2)):
            images = [scene.images[first], scene.images[second]]
            made.append(row(scene, "ours", images, f"ours, views {first + 1} and {second + 1}"))
    return made + [row(scene, name, scene.images, name) for name in PEERS]


def simulations() -> List[Scene]:
    mountains = default("mountains", 1200, 7, 1.0)
    return [default("urban", 800, 1), mountains, simulated("zy3_1000m", zy3(1600, 1000.0), 5.0)]


def programs() -> List[str]:
    scenes = few(real()) or []
    return [
        f"Whole commands with default options, the start of QGIS included, on {CORES} cores that others used too (wall "
        "times are upper bounds); memory is the resident memory of the whole process tree. Simulated scenes and "
        "truth_urban are compared with the true ground after the best whole-cell shift and the median height "
        "difference are taken out (relative pointing leaves them); the Pleiades images with S2P's DSM as it is, which "
        "is no truth. valid and C1, C2.5, C5 are percent of all cells of the reference; MedAE is the median of the "
        "absolute errors.",
        table(HEADERS, [line for scene in [*scenes, *few(simulations())] for line in rows(scene)]),
        *absent(),
    ]


SECTIONS = [Section("dsm", "DSMs, ours and others", "make bench", {"programs": programs})]
