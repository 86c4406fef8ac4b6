"""Water and clouds: what share of them comes out as nodata, and what is lost on land.

Each pair is matched by intensities once; rows show the DSM of what the matcher found, and of what
``matching/reliability.py`` leaves of it. A third row is of learned features, with the same check. The DSMs have the
truth's grid, moved by the best whole-cell shift.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from functools import partial
from typing import Any, List, Tuple

import cv2
import numpy as np

from benchmarks.matching import NO_MASK, Case
from benchmarks.runner import few, is_quick
from benchmarks.scenes import Scene, absent, default, quick_size, real
from benchmarks.tables import Section, table
from benchmarks.water_and_clouds import CLOUD, LAND, WATER, make_pair
from repm_qgis.contracts.options import LEARNED
from repm_qgis.evaluation.coregistration import align
from repm_qgis.evaluation.metrics import height_metrics
from repm_qgis.matching import sgm
from repm_qgis.matching.pair_backend import sample_pair
from repm_qgis.matching.parameters import MATCHING
from repm_qgis.matching.reliability import mask_unreliable
from repm_qgis.matching.wide_windows import wide_match

_BANK_M, _CLEAR_M = 2.0, 3.0


def within(mask: np.ndarray, cells: float) -> np.ndarray:
    """A mask without the cells that are nearer than this to its edge."""
    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) > cells


def measured(case: Case) -> List[Tuple[str, np.ndarray, float]]:
    """For the matcher alone and after the reliability mask: label, error of each cell (m), CPU s."""
    matched = case.matched(NO_MASK)
    seen, geometry = sample_pair(case.task, case.frame, case.geometry), case.geometry
    start = time.process_time()
    sign = geometry.height_sign
    residual = sgm.match(seen.first, seen.second, seen.disparities, sign, geometry.relief_displacement, MATCHING)
    wider = partial(wide_match, seen.reduced(), sign, sgm.match, MATCHING)
    kept = mask_unreliable(
        residual,
        seen.first,
        seen.second,
        disparities=seen.disparities,
        height_sign=sign,
        metres_per_px=geometry.metres_per_px,
        wider=wider,
        full_disparity=seen.full_disparity,
    )
    kept = kept.in_frame(seen.window, case.frame.size)
    seconds = time.process_time() - start
    other = case.matched(cost=LEARNED)
    dsms = [case.dsm_of(found) for found in (matched, kept, other)]
    alignment = align("cells" if case.align else "none", [(dsms[0], case.truth)], (1.0, 1.0))
    errors = [alignment.applied(dsm, (1.0, 1.0)) - case.truth for dsm in dsms]
    return [("matched", errors[0], 0.0), ("supported", errors[1], seconds), ("learned features", errors[2], 0.0)]


def percent(of: np.ndarray, among: np.ndarray) -> Any:
    return round(100.0 * float(of[among].mean()), 2) if among.any() else "-"


def good(error: np.ndarray) -> np.ndarray:
    return np.abs(np.nan_to_num(error, nan=np.inf)) < 1.0


def disturbed_rows(case: Case, classes: np.ndarray) -> List[List[object]]:
    """Nodata in water and clouds, heights on land, in per cent of each kind's cells."""
    cell, land = case.grid.cell, classes == LAND
    clear = within(land, _CLEAR_M / cell)
    rows = []
    for label, error, _ in measured(case):
        known = np.isfinite(error)
        waters = [classes == number for number in WATER.values()]
        water = [percent(~known, part) for of in waters for part in (of, within(of, _BANK_M / cell))]
        on_land = (percent(known, land), percent(known, clear), percent(good(error), clear))
        rows.append([case.name, label, *water, percent(~known, classes == CLOUD), *on_land])
    return rows


def undisturbed_rows(case: Case) -> List[List[object]]:
    among = np.isfinite(case.truth)
    rows = []
    for label, error, seconds in measured(case):
        cells = (percent(np.isfinite(error), among), percent(good(error), among))
        rmse = height_metrics(error, int(among.sum())).rmse
        rows.append([case.name, label, *cells, rmse, round(seconds, 2)])
    return rows


def disturbed() -> List[str]:
    rows: List[List[object]] = []
    for kind, seed in few([(kind, seed) for kind in ("urban", "mountains") for seed in (5, 6)]):
        with tempfile.TemporaryDirectory() as folder:
            made = make_pair(folder, kind, quick_size(1000), seed=seed)
            case = Case(Scene(f"{kind}, seed {seed}", made.images, made.truth, 0.5, True))
            height, width = case.truth.shape
            rows += disturbed_rows(case, made.classes[:height, :width])
    headers = (
        "pair | heights | still | from the bank | ripples | from the bank | glint | from the bank | cloud | "
        "land valid | clear land valid | clear land C1"
    )
    return [
        "Pairs of 1000 px with three lakes of 100 px radius (still water: noise and nothing else; ripples; sun "
        "glint, both different in each view) and two clouds (`benchmarks/water_and_clouds.py`). Per cent of each "
        f"kind's cells that are nodata, of all and of those more than {_BANK_M:g} m from the bank; of land the per "
        f"cent that have a height, of all and of what is more than {_CLEAR_M:g} m from water and clouds, where "
        "the last column has errors below 1 m.",
        table(headers, rows),
    ]


def undisturbed() -> List[str]:
    scenes = [replace(default(kind, 800, 1), name=f"simulated, {kind}") for kind in few(("urban", "mountains"))]
    # The triplet's first two views differ from S2P's DSM of all three by a shift.
    scenes += [replace(scene, align=scene.name != "pleiades_pair") for scene in real() if not is_quick()]
    return [
        "Land without water and clouds (the real pairs against S2P's DSMs):",
        table(
            "pair | heights | valid % | C1 % | RMSE, m | CPU s of the test",
            [row for scene in scenes for row in undisturbed_rows(Case(scene))],
        ),
        *absent(),
    ]


PARTS = {"disturbed": disturbed, "undisturbed": undisturbed}
SECTIONS = [Section("masks", "Water and clouds", "make bench-masks", PARTS)]
