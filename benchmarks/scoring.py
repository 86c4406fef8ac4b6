"""DSMs against surfaces and against each other; the scores are those of ``repm_qgis.evaluation``."""

from __future__ import annotations

from typing import Tuple

import numpy as np
from osgeo import gdal

from repm_qgis.evaluation.metrics import HeightMetrics
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.numerics import robust


def scores(dsm: str, truth: str, align: bool) -> HeightMetrics:
    """The paper's measures on the reference's cells.

    ``align`` first removes the best whole-cell shift and the median height difference, which pointing without ground
    control leaves.
    """
    return score_files(dsm, truth, "cells" if align else "none").metrics


def shares(found: HeightMetrics) -> Tuple[float, ...]:
    """Per cent of all cells of the reference with errors below each threshold."""
    return tuple(percent for _, percent in found.completeness)


def nmad(error: np.ndarray) -> float:
    return robust.nmad(error[np.isfinite(error)])


def heights_of(dataset: gdal.Dataset) -> np.ndarray:
    """The first band with NaN where it has no height."""
    heights = dataset.ReadAsArray().astype(np.float64)
    heights[(heights == dataset.GetRasterBand(1).GetNoDataValue()) | ~(heights > -9000)] = np.nan
    return heights


def bounds_of(dataset: gdal.Dataset) -> Tuple[float, float, float, float]:
    """xmin, ymin, xmax, ymax."""
    g = dataset.GetGeoTransform()
    return g[0], g[3] + g[5] * dataset.RasterYSize, g[0] + g[1] * dataset.RasterXSize, g[3]


def warped(dsm: str, **options: object) -> np.ndarray:
    """A DSM's heights on another grid, NaN where it has none."""
    settings = {"format": "MEM", "dstNodata": -99999, "outputType": gdal.GDT_Float32, **options}
    return heights_of(gdal.Warp("", gdal.Open(dsm), **settings))


def difference(a: str, b: str, cell: float = 0.5) -> np.ndarray:
    """One DSM less another over their common area, NaN where either has nothing."""
    boxes = [bounds_of(gdal.Open(path)) for path in (a, b)]
    common = (*(max(box[i] for box in boxes) for i in (0, 1)), *(min(box[i] for box in boxes) for i in (2, 3)))
    first, second = (warped(path, outputBounds=common, xRes=cell, yRes=cell, resampleAlg="near") for path in (a, b))
    return first - second
