"""A case of bad input: how a stage of a checkout ends on it, and the scenes and images that the cases are made of."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal

from benchmarks.scenes import CACHE, SHARED, Scene, default
from repm_qgis.contracts.errors import RepmError
from repm_qgis.evaluation.grids import Grid
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.imagery.raster import opened
from repm_qgis.rpc.model import Rpc
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import View, load_views

Job = Tuple[str, Dict[str, object]]


@dataclass
class Ended:
    """How a stage ended: its result, or its error; what it said, its folder, and the CPU seconds it took."""

    folder: Path
    result: Dict[str, Any] = field(default_factory=dict)
    error: str = ""
    said: List[str] = field(default_factory=list)
    warned: List[str] = field(default_factory=list)
    cpu_s: float = 0.0


@dataclass(frozen=True)
class Trial:
    """A case of bad input: ``jobs`` writes its files into a folder and gives the stages to run there, one after the
    other, and may do more between them; ``judge`` says in a few words what became of the last one that ended."""

    point: str
    what: str
    jobs: Callable[[Path], Iterable[Job]]
    judge: Callable[[Ended], str]
    limit_s: float = 900.0

    def run(self, tree: Path) -> str:
        with tempfile.TemporaryDirectory() as place:
            ended = Ended(Path(place))
            for stage, options in self.jobs(Path(place)):
                ended = run_in(tree, stage, options, Path(place), self.limit_s)
                if ended.error:
                    return f"stops: “{ended.error}”"
            return self.judge(ended)


def run_in(tree: Path, stage: str, options: Dict[str, object], folder: Path, limit_s: float = 900.0) -> Ended:
    """A stage of the engine in a checkout, which is ended after a time limit."""
    job, ended = folder / "job.json", Ended(folder)
    job.write_text(json.dumps(options))
    command = [sys.executable, "-m", "repm_qgis", stage, str(job)]
    started = os.times()
    try:
        done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False, timeout=limit_s)
    except subprocess.TimeoutExpired:
        ended.error = f"it hangs: ended after {limit_s:.0f} s"
        return ended
    over = os.times()
    ended.cpu_s = sum(over[2:4]) - sum(started[2:4])  # of children, with those that they have waited for
    for line in done.stdout.splitlines():
        message = json.loads(line)
        kind, text = message["type"], message.get("text", "").replace(f"{folder}/", "").replace(f"{CACHE}/", "")
        if kind == "result":
            ended.result = message["result"]
        elif kind in ("error", "bug"):
            ended.error = text.strip().splitlines()[-1]
        elif kind in ("info", "warning"):
            (ended.said if kind == "info" else ended.warned).append(text)
    if done.returncode and not ended.error:
        ended.error = f"exit code {done.returncode} without a sentence"
    return ended


def pipeline(folder: Path, images: Sequence[str], name: str = "run", **options: object) -> Job:
    """The pipeline; its DSM is ``NAME.tif`` in the folder."""
    made = {"images": list(images), "workspace": str(folder / name), "output": str(folder / f"{name}.tif")}
    return "pipeline", {**made, "resolution": 1.0, **options}


def off(ended: Ended, truth: str) -> str:
    """How far the DSM of a run lies from the true surface, whose middle is that of all trials' ground."""
    dsm = ended.result["output"]
    with opened(dsm) as ours, opened(truth) as theirs:
        boxes = [np.reshape(Grid.of(each).bounds, (2, 2)) for each in (ours, theirs)]
    away = float(np.hypot(*(boxes[0].mean(axis=0) - boxes[1].mean(axis=0))))
    try:
        found = score_files(dsm, truth).metrics
        wrong = f"{found.medae:.2f} m wrong in the median"
    except RepmError:
        wrong = "nowhere on the true surface"
    side = float(np.sqrt(np.prod(boxes[0][1] - boxes[0][0])))
    return f"exit 0: the DSM is {side:.0f} m wide, its middle {away:.0f} m from the ground's, {wrong}"


def say_of(ended: Ended, words: Sequence[str]) -> str:
    """The sentences that hold any of these words, from what a stage said and warned of."""
    found = [text for text in (*ended.warned, *ended.said) if any(word in text for word in words)]
    # Tables name the shared data as people find them, whatever the machine.
    return " ".join(f"“{text}”" for text in found).replace(str(SHARED), "../shared/data") or "nothing is said"


def town() -> Scene:
    return default("urban", 1000, 5)


def true_views(count: int) -> List[View]:
    """The first views of the town, with RPCs that are true: pointing errors of their own would hide others."""
    record = json.loads((town().folder / "truth.json").read_text())["views"]
    views = load_views(town().images[:count])
    return [replace(view, rpc=Rpc.from_mapping(known["true_rpc"])) for view, known in zip(views, record)]


def pixels_of(path: str) -> np.ndarray:
    dataset = gdal.Open(path)
    return dataset.ReadAsArray()


def write_plain(
    path: Path,
    pixels: np.ndarray,
    rpc: Optional[Rpc] = None,
    place: Optional[Sequence[float]] = None,
    tags: Optional[Dict[str, str]] = None,
) -> str:
    """An image with RPC tags, a geotransform and metadata, each where it is given."""
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), *pixels.shape[::-1], 1, gdal.GDT_UInt16)
    if rpc is not None:
        dataset.SetMetadata(rpc_tags(rpc), "RPC")
    if place is not None:
        dataset.SetGeoTransform(list(place))
    if tags:
        dataset.SetMetadata(tags)
    dataset.GetRasterBand(1).WriteArray(pixels)
    dataset = None
    return str(path)
