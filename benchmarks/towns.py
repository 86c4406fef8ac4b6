"""Real towns of many dates against airborne lidar: nineteen WorldView-3 images of one of the DFC2019 sites."""

from __future__ import annotations

import csv
import json
import sys
import tempfile
from pathlib import Path
from typing import Any, List, Sequence, Tuple

import numpy as np
from scipy import ndimage

from benchmarks.runner import ROOT, few, measured, stage
from benchmarks.scenes import SHARED
from benchmarks.tables import Section, table
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.imagery.raster import opened, read

_FOLDER = SHARED / "jax_068"
_CLASSES = {"ground": 2, "trees": 5, "buildings": 6}
_JANUARY = ("009", "010", "011")
_COUNTS = (2, 3, 6, 12, 19)
_PUBLISHED = (
    "Published for this site, MAE / RMSE in m: S2P 1.6 to 2.1 / 4.6, EO-NeRF 1.2 to 1.6 / 2.2, EOGS 1.0 / 2.3, HLC-GS "
    "0.74 / 1.91; the paper's REPM RMSE 3.75, ME 0.26, C1 72.5 %. They are for the whole square, with other choices of "
    "images, other alignments and filled DSMs, and take minutes to hours of a GPU: the rows *FILL = all* are the ones "
    "to look at beside them, and none of the differences below 0.2 m means much."
)
_STEP_M, _WINDOW_M = 3.0, 2.5  # a wall: the truth's heights differ by so much within a window of this side


def _names() -> List[str]:
    """The images' numbers in the order of their dates."""
    with open(_FOLDER / "acquisitions.csv", encoding="utf-8", newline="") as stream:
        return [row["image"].split("_")[2] for row in csv.DictReader(stream)]


def _walls(dsm: np.ndarray, truth: np.ndarray, cell: float) -> Tuple[float, float]:
    """How far the DSM's walls are from the truth's (mean, m), and by how much objects are too wide on each side (m).

    A wall is the border between what lies above and below the middle of the truth's heights around it.
    """
    side = int(round(_WINDOW_M / cell)) | 1
    filled = np.where(np.isfinite(truth), truth, np.nanmedian(truth))
    top, bottom = ndimage.maximum_filter(filled, side), ndimage.minimum_filter(filled, side)
    near = (top - bottom > _STEP_M) & np.isfinite(truth) & np.isfinite(dsm)
    middle = (top + bottom) / 2
    high = [np.where(near, values > middle, False) for values in (truth, dsm)]
    borders = [(ndimage.maximum_filter(part, 3) != ndimage.minimum_filter(part, 3)) & near for part in high]
    # The outline of the walls' neighbourhood is no border of a surface.
    inside = ndimage.binary_erosion(near, iterations=2)
    borders = [border & inside for border in borders]
    distance = ndimage.distance_transform_edt(~borders[0]) * cell
    length = borders[0].sum() * cell / 2  # a border is two cells wide
    wider = (int(high[1].sum()) - int(high[0].sum())) * cell**2 / length
    return float(distance[borders[1]].mean()), float(wider)


def _rows(label: str, names: Sequence[str]) -> List[List[Any]]:
    """The DSM of some images with its holes, and with holes interpolated."""
    images = [str(_FOLDER / f"JAX_068_{name}_RGB.tif") for name in names]
    with tempfile.TemporaryDirectory() as folder:
        dsm = f"{folder}/dsm.tif"
        made = {"images": images, "workspace": f"{folder}/w", "output": dsm, "resolution": 0.5}
        job = Path(folder, "job.json")
        job.write_text(json.dumps(made), encoding="utf-8")
        cost = measured([sys.executable, "-m", "repm_qgis", "pipeline", str(job)], str(ROOT))[1]
        full = stage("dsmfuse", scene=f"{folder}/w/reconstructed.json", output=f"{folder}/full.tif", fill="all")[
            "output"
        ]
        return [[label, "", *_scores(dsm), cost.cpu_s], [label, "FILL = all", *_scores(full), ""]]


def _scores(dsm: str) -> List[float]:
    found = score_files(dsm, str(_FOLDER / "truth_west.tif"), "3d")
    with opened(str(_FOLDER / "truth_west.tif")) as dataset, opened(str(_FOLDER / "classes_west.tif")) as kinds:
        heights, kind, cell = read(dataset), read(kinds), dataset.GetGeoTransform()[1]
    within = np.abs(found.error) < 1.0
    m = found.metrics
    errors = [m.valid, dict(m.completeness)[1.0], m.mae, m.rmse, m.me, m.nmad]
    shares = [100.0 * float(within[kind == code].mean()) for code in _CLASSES.values()]
    return [*errors, *shares, *_walls(heights + found.error, heights, cell)]


def towns() -> List[str]:
    if not _FOLDER.exists():
        return [f"jax_068 was not measured: absent from '{SHARED}'."]
    names = _names()
    sets = [(str(count), names[:count]) for count in _COUNTS] + [("3, January", list(_JANUARY))]
    headers = (
        "images | holes | valid, % | C1, % | MAE, m | RMSE, m | ME, m | NMAD, m | ground, % | trees, % | "
        "buildings, % | walls off, m | wider, m | CPU s"
    )
    return [
        "WorldView-3, 0.3 m, 8 bit, pansharpened, October 2014 to November 2015, against the airborne lidar of the "
        "western half of `jax_068`, in cells of 0.5 m, default settings, aligned in 3-D (the images have no ground "
        "control). The first images by date; *3, January* are 009, 010 and 011 (sun at 36 degrees). C1: share of all "
        "cells of the lidar within 1 m, and the same for cells of three classes; ME is the median of absolute errors; "
        "*walls off*: mean distance of the DSM's walls of 3 m and more from the lidar's; *wider*: how much wider "
        "objects are, on each side.",
        table(headers, [row for label, chosen in few(sets) for row in _rows(label, chosen)]),
        _PUBLISHED,
    ]


SECTIONS = [Section("towns", "A real town of many dates against lidar", "make bench-towns", {"towns": towns})]
