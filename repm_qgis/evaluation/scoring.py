"""Scores of DSMs that fit into memory, for studies and benchmarks; stage comparedsm takes rasters of any size."""

from __future__ import annotations

from typing import NamedTuple, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatImage, Floats
from ..imagery.heights import read_heights
from ..imagery.raster import opened
from .coregistration import Alignment, align
from .grids import Grid, HeightWarper, metres_per_unit
from .metrics import THRESHOLDS_M, HeightMetrics, height_metrics
from .parameters import COREGISTRATION, CoregistrationParameters


class Score(NamedTuple):
    """Metrics, the errors (DSM - reference, m) on the reference's cells, NaN = none, and how the DSM was aligned."""

    metrics: HeightMetrics
    error: FloatImage
    alignment: Alignment


def score(
    dsm: Floats,
    reference: Floats,
    method: str = "none",
    cell: Tuple[float, float] = (1.0, 1.0),
    thresholds: Sequence[float] = THRESHOLDS_M,
    parameters: CoregistrationParameters = COREGISTRATION,
) -> Score:
    """Compare a DSM with a reference on the same cells, (rows, columns), NaN = no height.

    ``method`` is that of :func:`~repm_qgis.evaluation.coregistration.align`, ``cell`` the width and height of a cell
    in metres. Raises EmptyResultError where the surfaces cannot be aligned.
    """
    alignment = align(method, [(dsm, reference)], cell, parameters=parameters)
    return score_aligned(alignment, dsm, reference, cell, thresholds)


def score_aligned(
    alignment: Alignment,
    dsm: Floats,
    reference: Floats,
    cell: Tuple[float, float] = (1.0, 1.0),
    thresholds: Sequence[float] = THRESHOLDS_M,
) -> Score:
    """The same with an alignment that is known. Cells that the shift uncovers at the border are left out."""
    error = alignment.applied(dsm, cell) - reference
    counted = np.isfinite(reference) & np.isfinite(alignment.applied(np.zeros_like(dsm), cell))
    return Score(height_metrics(error, int(counted.sum()), thresholds), error, alignment)


def score_files(dsm: str, reference: str, method: str = "none", thresholds: Sequence[float] = THRESHOLDS_M) -> Score:
    """Compare two rasters on the reference's grid, whatever the DSM's; raises ImageError and EmptyResultError.

    A 3-D shift is part of the one resampling, as in stage comparedsm: to resample twice would widen each hole.
    """
    with opened(dsm) as source, opened(reference) as target:
        grid = Grid.of(target)
        per_unit = metres_per_unit(grid)
        cell = grid.transform[1] * per_unit[0], -grid.transform[5] * per_unit[1]
        warper, heights = HeightWarper(source, grid), read_heights(target)
        resampled = warper.read(grid)
        alignment = align(method, [(resampled, heights)], cell)
        if method != "3d":
            return score_aligned(alignment, resampled, heights, cell, thresholds)
        error = warper.read(grid, alignment) - heights
        return Score(height_metrics(error, int(np.isfinite(heights).sum()), thresholds), error, alignment)
