"""Compare DSMs with a reference: numbers, an error raster and a report."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import ContextManager, Optional, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.file_kinds import is_cloud
from ..contracts.options import CompareDsmOptions
from ..contracts.results import AlignedAccuracy, CompareDsmResult, HeightAccuracy, OtherDsm
from ..evaluation.clouds import raster_of_cloud
from ..evaluation.comparison import Comparison, compare
from ..evaluation.grids import Grid
from ..evaluation.metrics import HeightMetrics
from ..evaluation.profiles import read_lines
from ..gate.classes import class_findings
from ..gate.surfaces import Entry, surface_findings
from ..imagery import raster
from ..names import surface_title
from ..reports.comparison_page import comparison_findings, comparison_page
from ..reports.styles import write_style
from ..runtime.parallel import run_whole
from ..runtime.progress import Part, Progress, Recorder, warn_all


def run(options: CompareDsmOptions, progress: Progress) -> CompareDsmResult:
    """Compare; see :mod:`repm_qgis.evaluation.metrics` for what the numbers mean, and
    :mod:`repm_qgis.evaluation.coregistration` for the sign of dx, dy, dz (metres to add to the DSM).

    Raises ImageError, InputTableError, OverlapError, EmptyResultError, WorkspaceError.
    """
    result: CompareDsmResult = run_whole(_all_compared, options, progress, "comparing with the reference")
    return result


def _all_compared(options: CompareDsmOptions, progress: Progress) -> CompareDsmResult:
    paths, run = [options.dsm, *options.others], Recorder(progress)
    entries = [Entry("DSM", options.dsm), *(Entry("OTHERS", path) for path in options.others)]
    warn_all(
        run, surface_findings([Entry("REFERENCE", options.reference), *entries], "it would be compared with itself")
    )
    ends = [0.9 * i / len(paths) for i in range(len(paths) + 1)]
    found = [_compared(options, path, Part(run, low, high)) for path, low, high in zip(paths, ends, ends[1:])]
    warn_all(run, [*(finding for one in found for finding in one.warnings), *comparison_findings(found)])
    if options.error:
        write_style("dsm_error", options.error)
    if options.report:
        progress.step(0.92, "Report")
        comparison_page(found[0], options.error or "", found[1:]).of(surface_title(options.dsm)).write(
            options.report, run
        )
    for path, one in zip(paths, found):
        moved = one.alignment
        if moved.method != "none":
            progress.info(
                f"'{path}' was moved by {moved.dx:+.3f} m to the east, {moved.dy:+.3f} m to the north and "
                f"{moved.dz:+.3f} m up before it was compared: NMAD {moved.nmad_before:.3f} m before, "
                f"{moved.nmad_after:.3f} m after."
            )
        progress.info(
            "{}RMSE {rmse:.3f} m, MedAE {medae:.3f} m, MAE {mae:.3f} m, NMAD {nmad:.3f} m, "
            "LE90 {le90:.3f} m, bias {bias:+.3f} m; {valid:.1f} % of the reference's cells have a height.".format(
                f"'{path}': " if options.others else "", **_aligned(one).fields_of(AlignedAccuracy)
            )
        )
    progress.step(1.0, "Done")
    return CompareDsmResult(
        **_aligned(found[0]).fields_of(AlignedAccuracy),
        error=options.error,
        report=options.report,
        along_normals=_accuracy(found[0].along_normals),
        by_class={name: _accuracy(metrics) for name, metrics in found[0].by_class},
        others=tuple(
            OtherDsm(dsm=path, **_aligned(one).fields_of(AlignedAccuracy)) for path, one in zip(paths[1:], found[1:])
        ),
    )


def _compared(options: CompareDsmOptions, path: str, progress: Progress) -> Comparison:
    """One DSM against the reference; the first one's errors go into the error raster."""
    with ExitStack() as stack:
        dsm, reference = _rasters(stack, path, options.reference, progress)
        classes = stack.enter_context(raster.opened(options.classes)) if options.classes else None
        if classes is not None and path == options.dsm:
            warn_all(progress, class_findings(reference, classes))
        lines = read_lines(options.profiles, Grid.of(reference)) if options.profiles else ()
        target = options.error if path == options.dsm else None
        error = stack.enter_context(_error_raster(target, reference)) if target else None
        clouds = path if is_cloud(path) else "", options.reference if is_cloud(options.reference) else ""
        found = compare(
            dsm,
            reference,
            options.align,
            thresholds=options.thresholds,
            progress=progress,
            error=error,
            classes=classes,
            lines=lines,
            clouds=clouds,
        )
        if error is not None:
            error.flush()
        return found


def _rasters(stack: ExitStack, dsm: str, reference: str, progress: Progress) -> Tuple[gdal.Dataset, gdal.Dataset]:
    """Both as rasters: a cloud takes the cells of the raster beside it."""
    opened = {path: stack.enter_context(raster.opened(path)) for path in (dsm, reference) if not is_cloud(path)}
    for path, option, other in ((reference, "REFERENCE", dsm), (dsm, "DSM", reference)):
        if path not in opened:
            beside = Grid.of(opened[other]) if other in opened else None  # of two clouds the DSM takes the reference's
            opened[path] = raster_of_cloud(path, option, beside, progress.check_cancelled)
    return opened[dsm], opened[reference]


def _error_raster(path: str, reference: gdal.Dataset) -> ContextManager[raster.RasterWriter]:
    grid = Grid.of(reference)
    frame = raster.RasterFrame(grid.size[::-1], np.float32, 1, grid.transform, reference.GetProjection())
    return raster.created(path, frame, descriptions=["DSM - reference"], unit="m", cog=True)


def _accuracy(metrics: HeightMetrics) -> HeightAccuracy:
    return HeightAccuracy(
        rmse=_known(metrics.rmse),
        medae=_known(metrics.medae),
        mae=_known(metrics.mae),
        nmad=_known(metrics.nmad),
        le90=_known(metrics.le90),
        bias=_known(metrics.bias),
        valid=metrics.valid,
        completeness=metrics.completeness[0][1],
        completeness_by_threshold={f"{threshold:g}": share for threshold, share in metrics.completeness},
        cells=metrics.cells,
    )


def _known(value: float) -> Optional[float]:
    return value if math.isfinite(value) else None


def _aligned(one: Comparison) -> AlignedAccuracy:
    moved, of_heights = one.alignment, _accuracy(one.metrics).fields_of(HeightAccuracy)
    return AlignedAccuracy(**of_heights, dx=moved.dx, dy=moved.dy, dz=moved.dz)
