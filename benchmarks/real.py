"""Real Pleiades images to DSMs through qgis_process, against S2P's DSMs."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import List

from benchmarks.programs import repm
from benchmarks.runner import CORES, few
from benchmarks.scenes import absent, real_or_town
from benchmarks.scoring import scores
from benchmarks.tables import Section, table

NAMES = ("pleiades_pair", "pleiades_triplet")


def whole_commands() -> List[str]:
    rows = []
    for scene in few(real_or_town(*NAMES)):
        with tempfile.TemporaryDirectory() as work:
            dsm, cost, _ = repm(scene.images, scene.resolution, Path(work))
            found = scores(dsm, scene.reference, scene.align)
        errors = (found.nmad, found.bias, found.rmse, found.valid)
        rows.append([scene.name, len(scene.images), *errors, cost.wall_s, cost.cpu_s, cost.peak_gib])
    headers = (
        "images | views | NMAD, m | bias, m | RMSE, m | valid, % of the reference's cells | wall, s | CPU, s | "
        "peak memory, GiB"
    )
    return [
        "`repm:pipeline` with RESOLUTION=0.5 and nothing else set, through `scripts/qgis-headless`; no alignment "
        "before the comparison. The reference of real images is S2P's DSM, which is no truth: NMAD is how far two "
        "programs differ. Time and memory are those of the whole command, the start of QGIS included, on "
        f"{CORES} cores.",
        table(headers, rows),
        *absent(*NAMES),
        "Bars of the project: NMAD at most 0.45 m (pair) and 0.7 m (triplet), at least 88 % valid, the pair within "
        "25 s, memory under 1.5 GiB.",
    ]


SECTIONS = [Section("real", "Real Pleiades images against S2P", "make bench-real", {"real": whole_commands})]
