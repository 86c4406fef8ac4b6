"""Water and clouds: what share of them comes out as nodata, and what is lost on land (``make bench-masks``).

Each pair is matched once; rows show the DSM of what the matcher found, and of what ``matching/reliability.py``
leaves of it.
The DSMs have the truth's grid, moved by the best whole-cell shift.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any, List, Tuple

import cv2
import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.matching import SHARED, VARIANTS, Case  # noqa: E402
from benchmarks.tables import publish, table  # noqa: E402
from benchmarks.water_and_clouds import CLOUD, LAND, WATER, make_pair  # noqa: E402
from repm_qgis.evaluation.coregistration import align  # noqa: E402
from repm_qgis.matching.pair_backend import sample_pair  # noqa: E402
from repm_qgis.matching.reliability import mask_unreliable  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402

_BANK_M, _CLEAR_M = 2.0, 3.0


def within(mask: np.ndarray, cells: float) -> np.ndarray:
    """A mask without what lies nearer than so many cells to its edge."""
    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) > cells


def measured(case: Case) -> List[Tuple[str, np.ndarray, float]]:
    """For the matcher alone and with what is unsupported dropped: label, error of each cell (m), CPU s."""
    matched = case.matched(VARIANTS["reliability mask off"])
    seen, geometry = sample_pair(case.task, case.pair, case.geometry), case.geometry
    start = time.process_time()
    kept = mask_unreliable(
        matched, seen.first, seen.second, seen.disparities, geometry.height_sign, geometry.metres_per_px
    )
    seconds = time.process_time() - start
    dsms = [case.dsm_of(found) for found in (matched, kept)]
    alignment = align("cells" if case.align else "none", [(dsms[0], case.truth)], (1.0, 1.0))
    errors = [alignment.applied(dsm, (1.0, 1.0)) - case.truth for dsm in dsms]
    return [("matched", errors[0], 0.0), ("supported", errors[1], seconds)]


def percent(of: np.ndarray, among: np.ndarray) -> Any:
    return round(100.0 * float(of[among].mean()), 2) if among.any() else "-"


def disturbed_rows(case: Case, classes: np.ndarray) -> List[List[Any]]:
    """Nodata in water and clouds, heights on land, in per cent of each kind's cells."""
    cell = case.grid.cell
    land = classes == LAND
    clear = within(land, _CLEAR_M / cell)
    rows = []
    for label, error, _ in measured(case):
        known, good = np.isfinite(error), np.abs(np.nan_to_num(error, nan=np.inf)) < 1.0
        water = [
            share
            for number in WATER.values()
            for share in (
                percent(~known, classes == number),
                percent(~known, within(classes == number, _BANK_M / cell)),
            )
        ]
        rows.append(
            [
                case.name,
                label,
                *water,
                percent(~known, classes == CLOUD),
                percent(known, land),
                percent(known, clear),
                percent(good, clear),
            ]
        )
    return rows


def undisturbed_rows(case: Case) -> List[List[Any]]:
    rows = []
    for label, error, seconds in measured(case):
        among, known = np.isfinite(case.truth), error[np.isfinite(error)]
        good = np.abs(np.nan_to_num(error, nan=np.inf)) < 1.0
        rows.append(
            [
                case.name,
                label,
                percent(np.isfinite(error), among),
                percent(good, among),
                float(np.sqrt((known**2).mean())),
                round(seconds, 2),
            ]
        )
    return rows


def main() -> None:
    gdal.SetCacheMax(64 << 20)
    with tempfile.TemporaryDirectory() as folder:
        disturbed, undisturbed = [], []
        for kind in ("urban", "mountains"):
            for seed in (5, 6):
                made = make_pair(f"{folder}/{kind}{seed}", kind, seed=seed)
                case = Case(f"{kind}, seed {seed}", made.images, made.truth, True, folder)
                rows, columns = case.truth.shape
                disturbed += disturbed_rows(case, made.classes[:rows, :columns])
            plain = run_stage(
                "sampledata", {"folder": f"{folder}/plain_{kind}", "kind": kind, "size": 800, "seed": 1}, Silent()
            )
            undisturbed += undisturbed_rows(Case(f"simulated, {kind}", plain["images"], plain["truth"], True, folder))
        for name, reference, align in (
            ("truth_urban", "truth.tif", True),
            ("pleiades_pair", "s2p_dsm.tif", False),
            ("pleiades_triplet", "s2p_dsm.tif", True),
        ):
            data = SHARED / name
            if data.exists():
                undisturbed += undisturbed_rows(
                    Case(
                        name, [str(data / "img_01.tif"), str(data / "img_02.tif")], str(data / reference), align, folder
                    )
                )
        publish(
            "masks",
            "Water and clouds",
            "make bench-masks",
            [
                "Pairs of 1000 px with three lakes of 100 px radius (still water: noise and nothing else; ripples; sun "
                "glint, both other in each view) and two clouds (`benchmarks/water_and_clouds.py`). Per cent of each "
                f"kind's cells that are nodata, of all and of those more than {_BANK_M:g} m from the bank; of land the per "
                f"cent that have a height, of all and of what lies more than {_CLEAR_M:g} m from water and clouds, where "
                "the last column has errors below 1 m.",
                table(
                    [
                        "pair",
                        "heights",
                        "still",
                        "from the bank",
                        "ripples",
                        "from the bank",
                        "glint",
                        "from the bank",
                        "cloud",
                        "land valid",
                        "clear land valid",
                        "clear land C1",
                    ],
                    disturbed,
                ),
                "Land without water and clouds (the real pairs against S2P's DSMs):",
                table(["pair", "heights", "valid %", "C1 %", "RMSE, m", "CPU s of the test"], undisturbed),
            ],
        )


if __name__ == "__main__":
    main()
