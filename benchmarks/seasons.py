"""Images of different seasons: what the learned cost gives beside intensities, on a real town and simulated ones."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from itertools import combinations
from typing import Dict, List, Sequence

import numpy as np

from benchmarks.confidence import errors
from benchmarks.runner import ROOT, Failed, few, is_quick, made_by, say
from benchmarks.scenes import CACHE, SHARED, made_once, not_measured
from benchmarks.simulated.dates import WORLDVIEW3_JACKSONVILLE, DatedSpec, make_dated_scene
from benchmarks.simulated.parameters import DATED, REAL
from benchmarks.tables import Section, table
from benchmarks.towns import images_of, spread_of_draws, write_mid_air
from repm_qgis.contracts.options import INTENSITY
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.runtime.progress import Silent

_TOWN = SHARED / "jax_068"
_TRUTH = str(_TOWN / "truth_west.tif")
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
            rows.append(_row(label, images_of(names.split()), _TRUTH))
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
        return [not_measured("jax_068")]
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


def stated() -> List[str]:
    """How many errors are larger than what is stated of them."""
    if not _TOWN.exists():
        return [not_measured("jax_068")]
    rows: List[List[object]] = []
    for label, names in few(sorted(_SETS.items(), key=lambda item: len(item[1]))):
        for cost in (INTENSITY, "auto"):
            say(f"{label}, {cost}, stated errors ...")
            with tempfile.TemporaryDirectory() as folder:
                doubtful = write_mid_air(f"{folder}/mid_air.tif")
                options = {"resolution": 0.5, "matching_cost": cost}
                found = errors(images_of(names.split()), _TRUTH, folder, doubtful, **options)
            within = (found.error <= found.expected, found.error > 3 * found.expected, found.error <= found.le90)
            rows.append([label, cost, *(100.0 * float(part.mean()) for part in within)])
    return [
        "Heights within their expected error (two thirds wanted), wrong by more than three of them, and within their "
        "LE90 (nine of ten wanted); without the lidar's cells in mid-air.",
        table("images | cost | within, % | wrong, % | within LE90, %", rows),
    ]


def pairs() -> List[str]:
    """All pairs of the real town by both costs: the mean and the quartiles."""
    if not _TOWN.exists():
        return [not_measured("jax_068")]
    numbers = sorted(path.name.split("_")[2] for path in _TOWN.glob("JAX_068_*_RGB.tif"))
    shares: Dict[str, List[float]] = {INTENSITY: [], "auto": []}
    for pair in few(combinations(numbers, 2)):
        for cost, found in shares.items():
            say(f"{' + '.join(pair)}, {cost} ...")
            with tempfile.TemporaryDirectory() as folder:
                try:
                    dsm, _ = made_by(ROOT, images_of(pair), folder, resolution=0.5, matching_cost=cost)
                    found.append(dict(score_files(dsm, _TRUTH, "3d").metrics.completeness)[1.0])
                except Failed as error:
                    say(error)
                    found.append(0.0)
    values = {name: np.array(found) for name, found in shares.items()}
    values["auto less intensity"] = values["auto"] - values[INTENSITY]
    rows = [
        [name, len(found), float(np.mean(found)), *map(float, np.percentile(found, (0, 25, 50, 75, 100)))]
        for name, found in values.items()
    ]
    return [
        "Every two images of `jax_068`, the western half: the share of cells within 1 m, % (0: no DSM).",
        table("cost | pairs | mean | least | lower quartile | median | upper quartile | most", rows),
    ]


PARTS = {"seasons": seasons, "draws": draws, "stated": stated, "pairs": pairs}
SECTIONS = [Section("seasons", "Images of different seasons", "make bench-seasons", PARTS)]
