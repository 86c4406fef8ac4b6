#!/usr/bin/env python3
"""Real Pleiades images to DSMs through qgis_process, against S2P's DSMs ('make bench-real').

Time and memory are those of the whole command, the start of QGIS included. The data lies beside the project
(../shared); without it there is nothing to measure.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

from benchmarks.runner import repm  # noqa: E402
from benchmarks.tables import publish, table  # noqa: E402

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
SHARED = os.path.join(os.path.dirname(ROOT), "shared")
SETS = {"pleiades_pair": 2, "pleiades_triplet": 3}


def scores(dsm: str, reference: str) -> dict:
    done = subprocess.run(
        [sys.executable, os.path.join(SHARED, "tools", "score_dsm.py"), dsm, reference],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.split("raw:", 1)[1].strip().replace("'", '"').splitlines()[0])


def main() -> int:
    if not os.path.isdir(SHARED):
        sys.stderr.write(f"real_pairs: no data at {SHARED}.\n")
        return 1
    rows = []
    for name, count in SETS.items():
        folder = os.path.join(SHARED, "data", name)
        with tempfile.TemporaryDirectory() as work:
            images = [f"{folder}/img_{i + 1:02d}.tif" for i in range(count)]
            dsm, cost, _ = repm(images, 0.5, Path(work))
            score = scores(dsm, f"{folder}/s2p_dsm.tif")
        rows.append(
            [
                name,
                count,
                score["NMAD"],
                score["bias"],
                score["RMSE"],
                score["valid"],
                cost.wall_s,
                cost.cpu_s,
                cost.peak_gib,
            ]
        )
    publish(
        "real",
        "Real Pleiades images against S2P",
        "make bench-real",
        [
            "`repm:pipeline` with RESOLUTION=0.5 and nothing else set, through `scripts/qgis-headless`; no alignment "
            "before the comparison. S2P's DSM is no truth: NMAD is how far two programs differ. Time and memory are those "
            f"of the whole command, the start of QGIS included, on {len(os.sched_getaffinity(0))} cores.",
            table(
                [
                    "images",
                    "views",
                    "NMAD, m",
                    "bias, m",
                    "RMSE, m",
                    "valid, % of S2P's cells",
                    "wall, s",
                    "CPU, s",
                    "peak memory, GiB",
                ],
                rows,
            ),
            "Bars of the project: NMAD at most 0.45 m (pair) and 0.7 m (triplet), at least 88 % valid, the pair within "
            "25 s, memory under 1.5 GiB.",
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
