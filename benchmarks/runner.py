"""Runs a program as a whole, measures its process tree, and scores the DSM that it leaves."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from repm_qgis.evaluation.scoring import score_files  # noqa: E402

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
PEERS = ("s2p", "cars")


@dataclass(frozen=True)
class Cost:
    """Seconds by the clock and of all cores, and the largest memory of the whole process tree, GiB."""

    wall_s: float
    cpu_s: float
    peak_gib: float


class Failed(Exception):
    """A program that did not make its DSM, with what it said last."""


def measured(command: Sequence[str], folder: Optional[str] = None) -> tuple[str, Cost]:
    """A command's standard output and its cost; raises Failed where it ends with another code than 0."""
    before, start = os.times(), time.monotonic()
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder, start_new_session=True
    )
    said: List[str] = ["", ""]

    def listen(number: int, stream: Any) -> None:
        said[number] = stream.read()

    readers = [threading.Thread(target=listen, args=(i, s)) for i, s in enumerate((process.stdout, process.stderr))]
    for reader in readers:
        reader.start()
    peak = 0.0
    while process.poll() is None:
        peak = max(peak, tree_gib(process.pid))
        time.sleep(0.1)
    for reader in readers:
        reader.join()
    after = os.times()
    cost = Cost(
        time.monotonic() - start,
        after.children_user + after.children_system - before.children_user - before.children_system,
        peak,
    )
    if process.returncode:
        last = (said[1].strip() or said[0].strip() or "nothing said").splitlines()[-1]
        raise Failed(f"ended with code {process.returncode}: {last[:200]}")
    return said[0], cost


def tree_gib(root: int) -> float:
    """Memory of a process and all below it, GiB: what they share is divided among them (PSS) where the kernel says."""
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

    return (
        sum(_proportional_bytes(pid) or size * os.sysconf("SC_PAGE_SIZE") for pid, size in sizes.items() if below(pid))
        / 2**30
    )


def _proportional_bytes(pid: int) -> int:
    """Proportional set size; 0 where it is not told."""
    try:
        with open(f"/proc/{pid}/smaps_rollup", encoding="utf-8") as stream:
            return next((1024 * int(line.split()[1]) for line in stream if line.startswith("Pss:")), 0)
    except (OSError, ValueError, IndexError):
        return 0


# Programs --------------------------------------------------------------------------------------------------------


def repm(images: Sequence[str], resolution: float, folder: Path, **options: Any) -> tuple[str, Cost, Dict[str, Any]]:
    """Ours through ``scripts/qgis-headless``: the DSM, the cost, and the algorithm's other results."""
    folder.mkdir(parents=True, exist_ok=True)
    dsm = folder / "dsm.tif"
    text, cost = measured(
        [
            str(ROOT / "scripts" / "qgis-headless"),
            "--json",
            "run",
            "repm:pipeline",
            "--",
            *(f"IMAGES={image}" for image in images),
            f"RESOLUTION={resolution}",
            f"OUTPUT={dsm}",
            f"WORKSPACE={folder / 'w'}",
            *(f"{name}={value}" for name, value in options.items()),
        ]
    )
    return str(dsm), cost, json.loads(text).get("results", {})


def _s2p(images: Sequence[str], resolution: float, folder: Path) -> tuple[str, Cost]:
    config = {
        "out_dir": str(folder / "out"),
        "images": [{"img": image} for image in images],
        "full_img": True,
        "dsm_resolution": resolution,
        "max_processes": len(os.sched_getaffinity(0)),
    }
    return _configured("s2p", config, folder, ("out/dsm.tif",))


def _cars(images: Sequence[str], resolution: float, folder: Path) -> tuple[str, Cost]:
    sensors = {
        f"view{i}": {"image": image, "geomodel": {"path": image, "model_type": "RPC"}} for i, image in enumerate(images)
    }
    names = list(sensors)
    config = {
        "input": {"sensors": sensors, "pairing": [[names[0], other] for other in names[1:]]},
        "output": {"directory": str(folder / "out"), "resolution": resolution},
    }
    return _configured("cars", config, folder, ("out/dsm/dsm.tif", "out/dsm.tif"))


def _configured(program: str, config: Dict[str, Any], folder: Path, products: Sequence[str]) -> tuple[str, Cost]:
    """Run a program on a configuration file; raises Failed where it leaves none of its products."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "config.json"
    path.write_text(json.dumps(config))
    _, cost = measured([program, str(path)], str(folder))
    found = next((folder / product for product in products if (folder / product).exists()), None)
    if found is None:
        raise Failed(f"left no {products[0]}")
    return str(found), cost


_RUN: Dict[str, Callable[[Sequence[str], float, Path], tuple[str, Cost]]] = {"s2p": _s2p, "cars": _cars}


def peer(name: str, images: Sequence[str], resolution: float, folder: Path) -> tuple[str, Cost]:
    """Another program's DSM of the same images; raises Failed where it is not on PATH or does not make one."""
    if shutil.which(name) is None:
        raise Failed("not on PATH")
    return _RUN[name](images, resolution, folder)


# Scores ----------------------------------------------------------------------------------------------------------


def scores(dsm: str, truth: str, align: bool, thresholds: Sequence[float] = (1.0, 2.5, 5.0)) -> Dict[str, float]:
    """The paper's measures: valid and C are per cent of all cells of the truth, the others metres.

    ``align`` first removes the best whole-cell shift and the median height difference, which relative pointing leaves.
    """
    m = score_files(dsm, truth, "cells" if align else "none", thresholds).metrics
    shares = {f"C{threshold:g}": share for threshold, share in m.completeness}
    return {"valid": m.valid, "RMSE": m.rmse, "ME": m.me, "MAE": m.mae, "NMAD": m.nmad, **shares}


def say(text: str) -> None:
    """Progress of a long benchmark, beside the tables on standard output."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()
