"""The HTML page of a comparison."""

from __future__ import annotations

from pathlib import PurePath
from typing import List, Mapping, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.findings import Finding
from ..evaluation.comparison import Comparison
from ..evaluation.grids import Grid, cell_sides
from ..evaluation.metrics import HeightMetrics
from ..gate.places import displaced_by
from ..gate.reliefs import block_findings, relief_findings, stray_findings
from ..geometry.frames import flat_crs, vertical_part
from ..numerics.accuracy import EXPLAINED
from . import charts, pictures, verdict
from .parameters import VERDICT, VerdictParameters
from .report import Report, fixed

_ERRORS = "Compared cells | RMSE (m) | MedAE (m) | MAE (m) | NMAD (m) | LE90 (m) | bias (m)"
_METHODS = {
    "none": "none: the rasters are compared as they are",
    "vertical": "vertical: median height difference",
    "3d": "3d: Nuth and Kääb, by the cells' slopes",
    "icp": "icp: the nearest points of both, point to plane (Chen and Medioni)",
}


def comparison_page(found: Comparison, error_path: str = "", others: Sequence[Comparison] = ()) -> Report:
    """What a comparison found, for the analyst; ``others`` are further DSMs against the same reference."""
    page = Report("DSM against reference", f"{found.dsm.path} against {found.reference.path}")
    everyone = dict(zip(_names([found, *others]), [found, *others]))
    _summary(page, found, everyone)
    if others:
        _side_by_side(page, everyone)
    page.section("Inputs").table(["", "DSM", "Reference"], _input_rows(found))
    if error_path:
        page.facts([("Error raster (DSM − reference)", error_path)])
    _alignment(page, found)
    _metrics(page, found)
    _distribution(page, found, everyone)
    _profiles(page, everyone)
    _pictures(page, found)
    return page


def _names(found: Sequence[Comparison]) -> List[str]:
    """A short name for each DSM: its file's, with as many of its folders as make the names different."""
    parts = [PurePath(one.dsm.path).with_suffix("").parts for one in found]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-count:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{i}: {part[-1]}" for i, part in enumerate(parts, start=1)]


def _side_by_side(page: Report, everyone: Mapping[str, Comparison]) -> None:
    """All DSMs in one table: the reason to compare several at once."""
    first = next(iter(everyone.values()))
    moved = first.alignment.method != "none"
    rows = []
    for name, one in everyone.items():
        m, a = one.metrics, one.alignment
        shares = [f"{share:.1f}" for _, share in m.completeness]
        shift = [f"{a.dx:+.2f}, {a.dy:+.2f}, {a.dz:+.2f}"] if moved else []
        rows.append(
            [name, f"{m.valid:.1f}", *fixed(m.rmse, m.medae, m.mae, m.nmad, m.le90), f"{m.bias:+.3f}", *shares, *shift]
        )
    headers = ["DSM", "valid (%)", "RMSE (m)", "MedAE (m)", "MAE (m)", "NMAD (m)", "LE90 (m)", "bias (m)"]
    headers += [f"< {level:g} m (%)" for level, _ in first.metrics.completeness]
    page.section("Side by side").table(
        headers + ["dx, dy, dz added (m)"] * moved,
        rows,
        "All are compared with the same reference, and each is aligned for itself. RMSE and MAE count only the cells "
        "that a DSM has. Read them together with the valid share and the completeness, which count all cells of the "
        "reference.",
    )


def _profiles(page: Report, everyone: Mapping[str, Comparison]) -> None:
    """Every surface along the same lines."""
    first = next(iter(everyone.values()))
    page.section("Profiles")
    for index, profile in enumerate(first.profiles):
        series = {"reference": (profile.distance, profile.reference)}
        for name, one in everyone.items():
            cut = one.profiles[index]
            series[name if len(everyone) > 1 else "DSM"] = (cut.distance, cut.dsm)
        page.svg(charts.curves(series, "distance (m)", "height (m)", profile.name), "Heights after the alignment.")


def comparison_findings(compared: Sequence[Comparison]) -> List[Finding]:
    """The findings of all DSMs; where there are several, each finding names its DSM."""
    findings = []
    for name, one in zip(_names(compared), compared):
        own = verdict.of_comparison(one.metrics, max(*cell_sides(one.dsm), *cell_sides(one.reference)))
        own += _place_findings(one)
        several = f"Of the DSM '{name}': " if len(compared) > 1 else ""
        findings += [Finding(each.id, f"{several}{each}", each.level) for each in own]
    return findings


def _place_findings(one: Comparison, bounds: VerdictParameters = VERDICT) -> List[Finding]:
    """Whether the heights compared are those of one place, by their means over blocks of cells."""
    if one.metrics.cells < bounds.least_compared_cells:
        text = f"Too few cells to judge the DSM by were compared ({one.metrics.cells})"
        return [Finding("compared-cells", f"{text}; choose a reference that covers more of it.", "doubt")]
    ours, theirs = (one.thumbnails[name] for name in ("dsm", "reference"))
    side = (one.cell_m[0] * one.thumbnail_factor, one.cell_m[1] * one.thumbnail_factor)
    beside = displaced_by([(ours, theirs)], side) if one.alignment.method in ("none", "vertical") else 0.0
    found = relief_findings(ours, theirs, side, one.reference.path, beside)
    found += block_findings(ours, theirs, one.reference.path) if not found else []
    found += stray_findings(ours, theirs, one.reference.path) if not found else []
    relief = any(each.id == "relief-other" for each in found)
    moved, cell = one.alignment, max(map(abs, one.cell_m))
    along = float(np.hypot(moved.dx, moved.dy))
    if along > max(bounds.most_moved_m, bounds.most_moved_cells * cell) or abs(moved.dz) > bounds.most_raised_m:
        text = f"The DSM was moved by {along:.1f} m along the ground and {moved.dz:+.1f} m up before it was compared"
        found.append(Finding("moved-far", f"{text}: check the CRS, the units and the vertical datums of both."))
    if beside and not relief:
        text = f"The DSM fits to '{one.reference.path}' better {beside:.1f} m beside its place"
        found.append(Finding("place-off", f"{text}: check the CRS and the place of both, or set ALIGN to 3d."))
    return found


def _summary(page: Report, found: Comparison, everyone: Mapping[str, Comparison]) -> None:
    m = found.metrics
    good = (
        f"The median difference is {m.bias:+.3f} m, and half of the heights are within {m.medae:.3f} m of the "
        "reference."
    )
    page.verdict(good)
    page.paragraph(
        f"{m.cells} of {m.reference_cells} reference cells have a DSM height ({m.valid:.1f} %). "
        f"Half of them are within {m.medae:.3f} m of the reference; NMAD {m.nmad:.3f} m, RMSE {m.rmse:.3f} m, "
        f"LE90 {m.le90:.3f} m, bias {m.bias:+.3f} m."
    )


def _input_rows(found: Comparison) -> List[List[str]]:
    def column(grid: Grid) -> Tuple[str, ...]:
        x0, y0, x1, y1 = grid.bounds
        digits = 6 if flat_crs(grid.crs).is_geographic else 1
        size, cell = "{} × {} cells".format(*grid.size), f"{abs(grid.transform[1]):g} × {abs(grid.transform[5]):g}"
        extent = f"x {x0:.{digits}f}..{x1:.{digits}f}, y {y0:.{digits}f}..{y1:.{digits}f}"
        return grid.path, flat_crs(grid.crs).name, vertical_part(grid.crs) or "not stated", size, cell, extent

    names = ("File", "CRS", "Vertical datum", "Size", "Cell", "Extent")
    return [[name, a, b] for name, a, b in zip(names, column(found.dsm), column(found.reference))]


def _alignment(page: Report, found: Comparison) -> None:
    a = found.alignment
    page.section("Alignment").facts([("Method", _METHODS[a.method])])
    if a.method == "none":
        return
    page.paragraph("This was added to the DSM before comparing. Add the same to move the DSM onto the reference.")
    shifts = zip(("dx, to the east", "dy, to the north", "dz, up"), (a.dx, a.dy, a.dz))
    rows = [[name, f"{shift:+.3f} m"] for name, shift in shifts]
    rows += [["NMAD before", f"{a.nmad_before:.3f} m"], ["NMAD after", f"{a.nmad_after:.3f} m"]]
    page.table("Shift | Value", rows, f"Estimated from {a.cells} cells.")


def _metrics(page: Report, found: Comparison) -> None:
    page.section("Accuracy and completeness")
    _accuracy_tables(page, found, "Reference slope", found.by_slope)
    if found.by_class:
        _accuracy_tables(page, found, "Class", found.by_class)
    page.table(
        f"Measured | {_ERRORS}",
        [_errors("along the normal", found.along_normals)],
        "On a steep slope or at a wall, a small shift to the side is a large difference in height. This distance is "
        "measured at right angles to the reference's surface: the height difference times the cosine of the slope. "
        "It is positive where the DSM is above. Cells beside holes have no slope and are not counted.",
    )
    page.paragraph(
        "The DSM is resampled onto the reference's grid bilinearly, from cells that have heights only. Where less "
        "than half of a cell's weight has a height there is no error, so holes neither grow nor shrink. gdalwarp "
        "itself closes holes of one cell, and would count some more cells."
    )


def _errors(name: str, m: HeightMetrics) -> List[object]:
    """A row of a table with the columns ``_ERRORS``."""
    return [name, m.cells, *fixed(m.rmse, m.medae, m.mae, m.nmad, m.le90, m.bias)]


def _accuracy_tables(page: Report, found: Comparison, by: str, parts: Sequence[Tuple[str, HeightMetrics]]) -> None:
    rows = [("all", found.metrics)] + [(name, m) for name, m in parts if m.reference_cells]
    page.table(
        f"{by} | {_ERRORS}",
        [_errors(name, m) for name, m in rows],
        "e is DSM − reference, over the cells that have both heights. MedAE is the median of |e| (ME in the method's "
        "paper), bias is the median of e. "
        + EXPLAINED
        + " RMSE is called RMSE_V by ASPRS (2023). "
        + ("" if found.exact else "Medians are good to 0.5 mm. ")
        + "Medians of parts are good to 5 mm.",
    )
    page.table(
        [by, "Reference cells", "valid (%)"] + [f"< {t:g} m (%)" for t, _ in found.metrics.completeness],
        [[name, m.reference_cells, *fixed(m.valid, *(s for _, s in m.completeness), decimals=1)] for name, m in rows],
        "Completeness is the share of all reference cells whose |e| is below each threshold, so a hole counts as a "
        "miss.",
    )


def _distribution(page: Report, found: Comparison, everyone: Mapping[str, Comparison]) -> None:
    edges, counts = found.histogram_edges(), found.histogram
    total = np.cumsum(counts)
    low, high = (int(np.searchsorted(total, q * total[-1])) for q in (0.005, 0.995))
    group = max(1, -(-(high - low + 1) // 80))
    count = -(-(high - low + 1) // group)
    inside = counts[low : low + count * group]
    padded = np.zeros(count * group)
    padded[: inside.size] = inside
    grouped_edges = edges[low] + np.arange(count + 1) * group * (edges[1] - edges[0])
    page.section("Distribution of errors").svg(
        charts.counted_histogram(padded.reshape(count, group).sum(1), grouped_edges, "DSM − reference (m)", "Errors"),
        "The middle 99 % of the errors.",
    )
    series = {name if len(everyone) > 1 else "cells": _cumulative(one) for name, one in everyone.items()}
    ends = ", ".join(f"{one.metrics.valid:.1f} %" for one in everyone.values())
    page.svg(
        charts.curves(
            series,
            "|DSM − reference| (m)",
            "share of all reference cells (%)",
            "Cumulative error",
            ylim=(0.0, 100.0),
        ),
        f"A curve ends at the share of reference cells that have a DSM height: {ends}.",
    )


def _cumulative(found: Comparison) -> Tuple[FloatArray, FloatArray]:
    """Sizes of errors in metres, and the share of the reference's cells in per cent that are better."""
    edges, counts = found.histogram_edges(), found.histogram
    half = counts.size // 2
    size = counts[half:] + counts[:half][::-1]
    share = 100.0 * np.cumsum(size) / max(found.metrics.reference_cells, 1)
    end = int(min(np.searchsorted(share, 0.99 * share[-1]) * 1.2 + 50, size.size))
    pick = np.unique(np.linspace(0, end - 1, 300).astype(int))
    return (pick + 1) * (edges[1] - edges[0]), share[pick]


def _pictures(page: Report, found: Comparison) -> None:
    error = found.thumbnails["error"]
    cell = abs(found.cell_m[0]) * found.thumbnail_factor
    relief = pictures.grey_relief(found.thumbnails["reference"], cell)
    limit = max(abs(v) for v in pictures.percentile_range(error))
    page.section("Pictures").png(
        pictures.png_bytes(pictures.over(relief, pictures.colour_map(error, -limit, limit, "diverging"))),
        "DSM − reference, over the shaded reference. Red: the DSM is higher. Blue: it is lower. Grey: equal, or "
        "no error is known.",
    )
    page.svg(charts.colour_bar(pictures.RAMPS["diverging"], -limit, limit, "m"))
    low, high = pictures.percentile_range(found.thumbnails["reference"])
    for name, text in (("dsm", "The DSM, aligned, on the reference's grid"), ("reference", "The reference")):
        picture = pictures.png_bytes(pictures.shaded_relief(found.thumbnails[name], cell, low, high))
        page.png(picture, f"{text}. Heights {low:.1f} to {high:.1f} m, with the same colours in both pictures.")
