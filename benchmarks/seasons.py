"""Images of different seasons: what the learned cost gives beside intensities, on a real town and simulated ones."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from typing import List, Sequence

from benchmarks.runner import ROOT, few, is_quick, made_by, say
from benchmarks.scenes import CACHE, SHARED, made_once
from benchmarks.simulated.dates import WORLDVIEW3_JACKSONVILLE, DatedSpec, make_dated_scene
from benchmarks.simulated.parameters import DATED, REAL
from benchmarks.tables import Section, table
from benchmarks.towns import spread_of_draws
from repm_qgis.contracts.options import INTENSITY
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.runtime.progress import Silent

_TOWN = SHARED / "jax_068"
_SETS = {
    "006 + 018, December and May": "006 018",
    "005 + 020, October and July": "005 020",
    "003 + 022, October and a year later": "003 022",
    "005 006 007, October to December": "005 006 007",
    "six of all seasons": "005 007 009 012 014 020",
    "001 + 002, one day": "001 002",
    "009 010 011, January": "009 010 011",
}
_LEARNED, _DRAWS = 5, 4  # sets that are matched by learned features, and their draws
_SIMULATED = {"December and May": (5, 15), "October and July": (4, 17), "December, May, January": (5, 15, 9)}


def _row(label: str, images: Sequence[str], truth: str) -> List[object]:
    figures: List[object] = []
    for cost in (INTENSITY, "auto"):
        say(f"{label}, {cost} ...")
        with tempfile.TemporaryDirectory() as folder:
            dsm, spent = made_by(ROOT, images, folder, resolution=0.5, matching_cost=cost)
            found = score_files(dsm, truth, "3d").metrics
            figures += [found.valid, dict(found.completeness)[1.0], found.rmse, spent.cpu_s]
    return [label, *figures]


def seasons() -> List[str]:
    rows: List[List[object]] = []
    if _TOWN.exists():
        for label, names in few(_SETS.items()):
            images = [str(_TOWN / f"JAX_068_{name}_RGB.tif") for name in names.split()]
            rows.append(_row(label, images, str(_TOWN / "truth_west.tif")))
    for seed, (label, chosen) in enumerate(() if is_quick() and rows else few(_SIMULATED.items()), start=11):
        spec = DatedSpec(seed=seed, acquisitions=tuple(WORLDVIEW3_JACKSONVILLE[number] for number in chosen))
        folder = CACHE / f"seasons_{seed}_{int(spec.side_m)}"
        effects = replace(DATED, effects=REAL)
        made_once(folder, lambda: make_dated_scene(spec, str(folder), Silent(), effects))  # noqa: B023
        images = [str(path) for path in sorted(folder.glob("img_*.tif"))]
        rows.append(_row(f"simulated, {label}", images, str(folder / "truth.tif")))
    headers = "images | valid, % | C1, % | RMSE, m | CPU s | auto: valid, % | C1, % | RMSE, m | CPU s"
    return [
        "The western half of `jax_068` against lidar, and three simulated towns (leaves, grass, suns, cars of their "
        "dates); cells of 0.5 m, aligned in 3-D. First MATCHING_COST = intensity, then auto. C1: within 1 m, of all "
        "cells. The rule of doubt was fitted on the simulated towns alone, whose images are more alike than real ones: "
        "correlations at true heights have the quartiles 0.34 / 0.80 / 0.99 and 0.33 / 0.92 / 0.99, real ones 0.18 / "
        "0.53 / 0.81 and 0.18 / 0.59 / 0.86 (`season_scenes.alike`).",
        table(headers, rows),
    ]


def draws() -> List[str]:
    if not _TOWN.exists():
        return [f"jax_068 was not measured: absent from '{SHARED}'."]
    rows: List[List[object]] = []
    sets = list(_SETS.items())[:_LEARNED]
    for label, names in few([*sets[2:], *sets[:2]]):  # the small area of a quick run has too few ties of the first two
        say(f"{label}, draws ...")
        rows.append([label, *spread_of_draws(names.split(), _DRAWS)])
    return [
        "MATCHING_COST = auto with other thresholds of the keypoints' contrast, and so other pointings by some "
        "thousandths of a px: mean, standard deviation and range.",
        table("images | runs | C1, % | MAE, m | RMSE, m", rows),
    ]


PARTS = {"seasons": seasons, "draws": draws}
SECTIONS = [Section("seasons", "Images of different seasons", "make bench-seasons", PARTS)]
