"""Compare a DSM with a reference: numbers, an error raster and a report."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Dict

import numpy as np
from osgeo import gdal

from ..evaluation.comparison import Comparison, compare
from ..evaluation.comparison_page import comparison_page
from ..evaluation.grids import Grid
from ..evaluation.styles import write_style
from ..imagery import raster
from ..options import CompareDsmOptions
from ..progress import Part, Progress


def run(options: CompareDsmOptions, progress: Progress) -> Dict[str, Any]:
    """Compare; see :mod:`repm_qgis.evaluation.metrics` for what the numbers mean, and
    :mod:`repm_qgis.evaluation.coregistration` for the sign of dx, dy, dz (metres to add to the DSM).

    Raises ImageError, OverlapError, EmptyResultError, WorkspaceError.
    """
    found = _compared(options, Part(progress, 0.0, 0.9))
    for text in found.warnings:
        progress.warn(text)
    if options.error:
        write_style("dsm_error", options.error)
    if options.report:
        progress.step(0.92, "Report")
        comparison_page(found, options.error or "").write(options.report)
    result = _result(options, found)
    progress.info(
        "RMSE {rmse:.3f} m, ME {me:.3f} m, MAE {mae:.3f} m, NMAD {nmad:.3f} m, bias {bias:+.3f} m; {valid:.1f} % "
        "of the reference's cells have a height.".format(**result)
    )
    progress.step(1.0, "Done")
    return result


def _compared(options: CompareDsmOptions, progress: Progress) -> Comparison:
    with ExitStack() as stack:
        dsm = stack.enter_context(raster.opened(options.dsm))
        reference = stack.enter_context(raster.opened(options.reference))
        error = stack.enter_context(_error_raster(options.error, reference)) if options.error else None
        found = compare(dsm, reference, options.align, options.thresholds, progress, error)
        if error is not None:
            error.flush()
        return found


def _error_raster(path: str, reference: gdal.Dataset) -> Any:
    grid = Grid.of(reference)
    return raster.created(
        path,
        (grid.size[1], grid.size[0]),
        np.dtype(np.float32),
        1,
        grid.transform,
        reference.GetProjection(),
        descriptions=["DSM - reference"],
        unit="m",
        overviews=True,
    )


def _result(options: CompareDsmOptions, found: Comparison) -> Dict[str, Any]:
    m, a = found.metrics, found.alignment
    return {
        "error": options.error,
        "report": options.report,
        "rmse": m.rmse,
        "me": m.me,
        "mae": m.mae,
        "nmad": m.nmad,
        "bias": m.bias,
        "valid": m.valid,
        "completeness": m.completeness[0][1],
        "completeness_by_threshold": {f"{threshold:g}": share for threshold, share in m.completeness},
        "dx": a.dx,
        "dy": a.dy,
        "dz": a.dz,
        "cells": m.cells,
    }
