"""Find what changed between the DSMs of two dates: a difference raster, significant changes, volumes and a report."""

from __future__ import annotations

from ..change.finding import Found, find_changes
from ..change.page import change_page
from ..change.parameters import CHANGE
from ..contracts.options import ChangeOptions
from ..contracts.products import paths_of
from ..contracts.results import ChangeResult
from ..gate.surfaces import Entry, surface_findings
from ..gate.times import order_findings
from ..names import dates_title
from ..reports import verdict
from ..reports.styles import write_style
from ..runtime.parallel import run_whole
from ..runtime.progress import Part, Progress, Recorder, counted, warn_all


def run(options: ChangeOptions, progress: Progress) -> ChangeResult:
    """Compare the dates; see :mod:`repm_qgis.change.detection` for what is significant.

    Raises ImageError, OverlapError, OptionError, EmptyResultError, WorkspaceError.
    """
    result: ChangeResult = run_whole(_changed, options, progress, "comparing two dates")
    return result


def _changed(options: ChangeOptions, progress: Progress) -> ChangeResult:
    run = Recorder(progress)
    entries = [
        Entry("BEFORE", options.before, options.before_confidence or "", "BEFORE_CONFIDENCE"),
        Entry("AFTER", options.after, options.after_confidence or "", "AFTER_CONFIDENCE"),
    ]
    warn_all(run, surface_findings(entries, "nothing would have changed"))
    warn_all(run, order_findings(options.before, options.after))
    found = find_changes(options, Part(run, 0.0, 0.9))
    moved = found.alignment
    warn_all(
        run, [*found.warnings, *verdict.of_change(found.changed_share, (moved.dx, moved.dy, moved.dz), found.level_m)]
    )
    for product, path in paths_of("change", options):
        if product.style:  # both rasters have the same colours; changes that are not significant are pale
            write_style(product.style, path, (-found.shown_m, found.shown_m))
    if options.report:
        progress.step(0.92, "Report")
        change_page(options, found).of(dates_title(options.before, options.after)).write(options.report, run)
    _log(found, progress)
    progress.step(1.0, "Done")
    gains, losses = found.total(True), found.total(False)
    return ChangeResult(
        output=options.output,
        significant=options.significant,
        volumes=options.volumes,
        report=options.report,
        changes=len(found.changes),
        gained_m3=gains.volume,
        gained_deviation_m3=gains.deviation,
        lost_m3=abs(losses.volume),
        lost_deviation_m3=losses.deviation,
        level_m=found.level_m,
        dx=found.alignment.dx,
        dy=found.alignment.dy,
        dz=found.alignment.dz,
    )


def _log(found: Found, progress: Progress) -> None:
    moved = found.alignment
    if moved.method != "none":
        progress.info(
            f"AFTER was moved by {moved.dx:+.3f} m to the east, {moved.dy:+.3f} m to the north and {moved.dz:+.3f} m "
            f"up, so that stable ground agrees: NMAD {moved.nmad_before:.3f} m before, {moved.nmad_after:.3f} m after."
        )
    progress.info(
        f"The level of detection is {found.level_m:.2f} m (median of all cells); it is higher where the ground is "
        "steep and where heights are uncertain."
    )
    plan = CHANGE.detection
    progress.info(
        f"A change must exceed the level of flat ground {plan.support:g} times, or {plan.support_alone:g} times where "
        "a height comes from one height map only or no confidence rasters are given."
    )
    gains, losses = found.total(True), found.total(False)
    progress.info(
        f"Gained: {gains.volume:.0f} m3 (standard deviation {gains.deviation:.0f} m3) on {gains.area:.0f} m2, in "
        f"{counted(gains.count, 'change')}."
    )
    progress.info(
        f"Lost: {abs(losses.volume):.0f} m3 (standard deviation {losses.deviation:.0f} m3) on {losses.area:.0f} m2, in "
        f"{counted(losses.count, 'change')}."
    )
