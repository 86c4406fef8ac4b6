"""Follow one surface over three dates or more: a stack, trends, dates of change, volumes over time and a report."""

from __future__ import annotations

import math

from ..contracts.options import SeriesOptions
from ..contracts.products import paths_of
from ..contracts.results import SeriesResult
from ..gate.surfaces import entries_of, surface_findings
from ..gate.times import time_findings
from ..names import dates_title
from ..reports.styles import write_style
from ..runtime.parallel import run_whole
from ..runtime.progress import Part, Progress, Recorder, counted, warn_all
from ..series.finding import FoundSeries, find_series
from ..series.layers import write_layers
from ..series.page import series_page


def run(options: SeriesOptions, progress: Progress) -> SeriesResult:
    """Follow the surface; see docs/algorithms/series.md for what is significant.

    Raises ImageError, OverlapError, OptionError, InputTableError, EmptyResultError, WorkspaceError.
    """
    result: SeriesResult = run_whole(_followed, options, progress, "following a surface over time")
    return result


def _followed(options: SeriesOptions, progress: Progress) -> SeriesResult:
    run = Recorder(progress)
    entries = entries_of(options.dsms, options.confidences)
    warn_all(run, surface_findings(entries, "it would count as a date of its own"))
    found = find_series(options, Part(run, 0.0, 0.92))
    warn_all(
        run,
        [*found.warnings, *(time_findings({each.path: each.taken for each in found.series}) if options.dates else [])],
    )
    for product, path in paths_of("series", options):
        if product.style:
            write_style(product.style, path, (-found.shown_m_a, found.shown_m_a) if product.style == "trend" else None)
    made = write_layers(options.layers, options.output, found.series) if options.layers else []
    if options.report:
        progress.step(0.95, "Report")
        paths = [each.path for each in found.series]
        series_page(options, found).of(dates_title(*paths)).write(options.report, run)
    _log(found, progress)
    progress.step(1.0, "Done")
    first = next((each for each in found.areas if math.isfinite(each.volume[each.last])), None)
    return SeriesResult(
        output=options.output,
        trend=options.trend,
        changed=options.changed,
        volumes=options.volumes,
        table=options.table,
        layers=options.layers,
        report=options.report,
        dates=tuple(each.label for each in found.series),
        maps=tuple(made),
        n_dates=len(found.series),
        areas=len(found.areas),
        rising_m2=found.rising,
        falling_m2=found.falling,
        volume_m3=float(first.volume[first.last]) if first else 0.0,
        volume_deviation_m3=float(first.deviation[first.last]) if first else 0.0,
        offsets_m=tuple(map(float, found.offsets)),
        errors_m=tuple(map(float, found.errors.usual_m)),
    )


def _log(found: FoundSeries, progress: Progress) -> None:
    for date, offset, error in zip(found.series, found.offsets, found.errors.usual_m):
        progress.info(
            f"{date.label}: heights are uncertain by {error:.2f} m on level ground, and lie {offset:+.3f} m from those "
            f"of the first date where nothing changed."
        )
    progress.info(
        f"The surface rises significantly on {found.rising:.0f} m2 and falls on {found.falling:.0f} m2; dates of "
        f"change are known on {found.changed:.0f} m2, in {counted(len(found.areas), 'area')}."
    )
