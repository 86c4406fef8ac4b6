"""What the confidence raster's expected error is worth, against true surfaces.

A height's error is the DSM less the truth averaged over its cell, after the best shift in three dimensions: the raster
does not tell of errors that all cells share. Two thirds of heights should lie within their expected error.
"""

from __future__ import annotations

import tempfile
from typing import List, Sequence, Tuple

import numpy as np
from osgeo import gdal

from benchmarks.runner import few, pipeline, stage
from benchmarks.scenes import absent, default, real
from benchmarks.scoring import heights_of, warped
from benchmarks.tables import Section, table
from repm_qgis.contracts.stages import COMPAREDSM
from repm_qgis.imagery.confidence import Provenance

FIFTHS = 5
_UNMATCHED = {
    Provenance.BACKGROUND: "background of an occlusion",
    Provenance.SHADOW: "ground in a shadow",
    Provenance.NEIGHBOURS: "from neighbouring cells",
}


def errors(images: Sequence[str], truth: str, folder: str) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error, expected error (m) and source of the cells of a default DSM that have a height and a truth."""
    made = pipeline(images, folder, confidence=f"{folder}/confidence.tif")
    shift = stage(COMPAREDSM, dsm=made.output, reference=truth, align="3d")
    dataset = gdal.Open(made.output)
    west, cell, _, north, _, _ = dataset.GetGeoTransform()
    height = heights_of(dataset) + shift.dz
    rows, columns = height.shape
    x, y = west + shift.dx, north + shift.dy
    bounds = (x, y - rows * cell, x + columns * cell, y)
    surface = warped(truth, outputBounds=bounds, width=columns, height=rows, resampleAlg="average")
    confidence = gdal.Open(made.confidence).ReadAsArray().astype(np.float64)
    known = np.isfinite(height) & np.isfinite(surface) & (confidence[4] != -9999)
    return (height - surface)[known], confidence[4][known], confidence[3][known]


def rows_of(name: str, error: np.ndarray, expected: np.ndarray, source: np.ndarray) -> List[List[object]]:
    """A row for each fifth of the matched cells by expected error, for all, and for each kind that no map has."""
    error = np.abs(error - np.median(error))
    matched = source == Provenance.MATCHED
    ends = np.quantile(expected[matched], np.linspace(0, 1, FIFTHS + 1))
    kinds = [
        (f"matched, fifth {index}", matched & (expected >= low) & (expected <= high))
        for index, (low, high) in enumerate(zip(ends, ends[1:]), start=1)
    ]
    others = [(label, source == kind) for kind, label in _UNMATCHED.items()]
    kinds += [("matched, all", matched), *((label, cells) for label, cells in others if cells.sum() >= 100)]
    return [[name, label, *_figures(error[cells], expected[cells])] for label, cells in kinds]


def _figures(error: np.ndarray, expected: np.ndarray) -> Tuple[int, float, float, float]:
    within = 100.0 * float((error <= expected).mean())
    return error.size, float(np.median(expected)), float(np.quantile(error, 2 / 3)), within


def expected_error() -> List[str]:
    scenes = [("truth_urban, 2 views", scene) for scene in real("truth_urban")]
    for kind, title in (("urban", "simulated town, 3 views"), ("mountains", "simulated mountains, 3 views")):
        scenes.append((title, default(kind, 800, 5)))
    rows: List[List[object]] = []
    for name, scene in few(scenes[::-1])[::-1]:
        with tempfile.TemporaryDirectory() as folder:
            rows += rows_of(name, *errors(scene.images, scene.reference, folder))
    return [
        "Default options. Cells by their expected error in fifths, and those whose height no map has. Aim: 67 % of "
        "the errors within the expected one, in every row; steps of height that fall into a cell are in the errors.",
        table("scene | cells | number | expected, median, m | two thirds of errors below, m | within, %", rows),
        *absent("truth_urban"),
    ]


SECTIONS = [
    Section("confidence", "What the expected error is worth", "make bench-confidence", {"confidence": expected_error})
]
