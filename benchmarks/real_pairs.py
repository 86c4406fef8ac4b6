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
import threading
import time

from tables import publish, table

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
SHARED = os.path.join(os.path.dirname(ROOT), "shared")
SETS = {"pleiades_pair": 2, "pleiades_triplet": 3}


def measured(command: list[str]) -> tuple[dict, float, float, float]:
    """A command's JSON answer, wall and CPU seconds, and the largest memory of its process tree (GiB)."""
    before = os.times()
    start = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                               start_new_session=True)
    peak, text = 0.0, []
    reader = threading.Thread(target=lambda: text.append(process.stdout.read()))
    reader.start()
    while process.poll() is None:
        peak = max(peak, _tree_gib(process.pid))
        time.sleep(0.05)
    reader.join()
    wall = time.monotonic() - start
    after = os.times()
    if process.returncode:
        raise SystemExit(f"real_pairs: {' '.join(command)} ended with code {process.returncode}.")
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return json.loads(text[0]), wall, cpu, peak


def _tree_gib(root: int) -> float:
    """Memory of a process and all below it, shared pages counted once a process (so rather too much)."""
    parents, sizes = {}, {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat", encoding="utf-8") as stream:
                    fields = stream.read().rsplit(")", 1)[1].split()
                parents[int(name)], sizes[int(name)] = int(fields[1]), int(fields[21])
            except (OSError, IndexError, ValueError):
                continue

    def below(pid: int) -> bool:
        while pid and pid != root:
            pid = parents.get(pid, 0)
        return pid == root

    return sum(size for pid, size in sizes.items() if below(pid)) * os.sysconf("SC_PAGE_SIZE") / 2**30


def scores(dsm: str, reference: str) -> dict:
    done = subprocess.run([sys.executable, os.path.join(SHARED, "tools", "score_dsm.py"), dsm, reference],
                          stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.split("raw:", 1)[1].strip().replace("'", '"').splitlines()[0])


def main() -> int:
    if not os.path.isdir(SHARED):
        sys.stderr.write(f"real_pairs: no data at {SHARED}.\n")
        return 1
    rows = []
    for name, count in SETS.items():
        folder = os.path.join(SHARED, "data", name)
        with tempfile.TemporaryDirectory() as work:
            images = [f"IMAGES={folder}/img_{i + 1:02d}.tif" for i in range(count)]
            _, wall, cpu, peak = measured([
                os.path.join(ROOT, "scripts", "qgis-headless"), "--json", "run", "repm:pipeline", "--", *images,
                "RESOLUTION=0.5", f"OUTPUT={work}/dsm.tif", f"WORKSPACE={work}/w"])
            score = scores(f"{work}/dsm.tif", f"{folder}/s2p_dsm.tif")
        rows.append([name, count, score["NMAD"], score["bias"], score["RMSE"], score["valid"], wall, cpu, peak])
    publish("real", "Real Pleiades images against S2P", "make bench-real", [
        "`repm:pipeline` with RESOLUTION=0.5 and nothing else set, through `scripts/qgis-headless`; no alignment "
        "before the comparison. S2P's DSM is no truth: NMAD is how far two programs differ. Time and memory are those "
        f"of the whole command, the start of QGIS included, on {len(os.sched_getaffinity(0))} cores.",
        table(["images", "views", "NMAD, m", "bias, m", "RMSE, m", "valid, % of S2P's cells", "wall, s", "CPU, s",
               "peak memory, GiB"], rows),
        "Bars of the project: NMAD at most 0.45 m (pair) and 0.7 m (triplet), at least 88 % valid, the pair within "
        "25 s, memory under 1.5 GiB."])
    return 0


if __name__ == "__main__":
    sys.exit(main())
