"""What the confidence raster's expected error is worth, against true surfaces (``make bench-confidence``).

A height's error is the DSM less the truth averaged over its cell, after the best 3-D shift: errors that all cells share
are not what the raster tells. Two thirds of heights should lie within their expected error, whatever its size.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
SOURCES = {0.0: "matched", 1.0: "background of an occlusion"}
FIFTHS = 5


def errors(images: List[str], truth: str, folder: str) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error, expected error (m) and source of the cells of a default DSM that have a height and a truth."""
    made = run_stage(
        "pipeline",
        {
            "images": images,
            "workspace": folder,
            "output": f"{folder}/dsm.tif",
            "confidence": f"{folder}/confidence.tif",
        },
        Silent(),
    )
    shift = run_stage("comparedsm", {"dsm": made["output"], "reference": truth, "align": "3d"}, Silent())
    dataset = gdal.Open(made["output"])
    west, cell, _, north, _, _ = dataset.GetGeoTransform()
    height = dataset.ReadAsArray().astype(np.float64) + shift["dz"]
    rows, columns = height.shape
    x, y = west + shift["dx"], north + shift["dy"]
    warped = gdal.Warp(
        "",
        truth,
        format="MEM",
        outputBounds=(x, y - rows * cell, x + columns * cell, y),
        width=columns,
        height=rows,
        resampleAlg="average",
        dstNodata=-9999,
    )
    surface = warped.ReadAsArray().astype(np.float64)
    confidence = gdal.Open(made["confidence"]).ReadAsArray().astype(np.float64)
    known = (height > -9000) & (surface != -9999) & (confidence[4] != -9999)
    return (height - surface)[known], confidence[4][known], confidence[3][known]


def rows_of(name: str, error: np.ndarray, expected: np.ndarray, source: np.ndarray) -> List[List[Any]]:
    """A row for each fifth of the matched cells by expected error, and one for each other source."""
    result = []
    error = np.abs(error - np.median(error))
    matched = source == 0
    ends = np.quantile(expected[matched], np.linspace(0, 1, FIFTHS + 1))
    for index, (low, high) in enumerate(zip(ends, ends[1:]), start=1):
        inside = matched & (expected >= low) & (expected <= high)
        result.append([name, f"matched, fifth {index}", *_figures(error[inside], expected[inside])])
    result.append([name, "matched, all", *_figures(error[matched], expected[matched])])
    if (source == 1).sum() >= 100:
        inside = source == 1
        result.append([name, SOURCES[1.0], *_figures(error[inside], expected[inside])])
    return result


def _figures(error: np.ndarray, expected: np.ndarray) -> Tuple[int, float, float, float]:
    return (
        error.size,
        float(np.median(expected)),
        float(np.quantile(error, 2 / 3)),
        100.0 * float((error <= expected).mean()),
    )


def scenes(folder: str) -> Dict[str, Tuple[List[str], str]]:
    found = {}
    shared = SHARED / "truth_urban"
    if shared.exists():
        found["truth_urban, 2 views"] = [str(shared / f"img_0{i}.tif") for i in (1, 2)], str(shared / "truth.tif")
    for kind, title in (("urban", "simulated town, 3 views"), ("mountains", "simulated mountains, 3 views")):
        made = run_stage("sampledata", {"folder": f"{folder}/{kind}", "kind": kind, "size": 800, "seed": 5}, Silent())
        found[title] = made["images"], made["truth"]
    return found


def main() -> None:
    gdal.SetCacheMax(64 << 20)
    rows: List[List[Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for index, (name, (images, truth)) in enumerate(scenes(folder).items()):
            work = f"{folder}/work{index}"
            os.makedirs(work)
            rows += rows_of(name, *errors(images, truth, work))
    publish(
        "confidence",
        "What the expected error is worth",
        "make bench-confidence",
        [
            "Default options. Cells by their expected error in fifths, and those filled from the background. Aim: 67 % of "
            "the errors within the expected one, in every row; steps of height that fall into a cell are in the errors.",
            table(
                ["scene", "cells", "number", "expected, median, m", "two thirds of errors below, m", "within, %"], rows
            ),
        ],
    )


if __name__ == "__main__":
    main()
