"""The HTML page of a check against ground control points."""

from __future__ import annotations

from typing import Any, List

import numpy as np

from ..geometry.frames import EnuFrame
from ..options import CheckGcpsOptions
from ..progress import counted
from . import charts
from .gcp_accuracy import COLUMNS, COMPONENTS, GcpAccuracy
from .report import Report

_MOST_ROWS = 300
_MOST_LABELS = 60
_SHORT = {"rpc": "RPC", "compensated": "compensated", "scene": "scene", "dsm": "DSM"}


def gcp_page(found: GcpAccuracy, options: CheckGcpsOptions) -> Report:
    """What the points say of the images' geometry and of the DSM, for the analyst."""
    page = Report("Accuracy at ground control points", _counts(found))
    for text in found.warnings:
        page.warning(text)
    _heights(page, found)
    _components(page, found)
    _arrows(page, found)
    _points(page, found)
    _residuals(page, found)
    page.section("Inputs").facts(
        [
            (name, value)
            for name, value in (
                ("Points", options.gcps),
                ("Their heights", options.gcp_datum or "above the WGS 84 ellipsoid"),
                ("Scene", options.scene),
                ("DSM", options.dsm),
            )
            if value
        ]
    )
    return page


def _counts(found: GcpAccuracy) -> str:
    """How many points of each role; where no image was measured roles mean nothing."""
    if not any(gcp.pixels for gcp in found.gcps):
        return counted(len(found.gcps), "point")
    counts = ((sum(gcp.role == role for gcp in found.gcps), role) for role in ("control", "check"))
    return f"{counted(len(found.gcps), 'point')}: {' and '.join(f'{n} {role}' for n, role in counts if n)}"


def _roles(found: GcpAccuracy) -> List[str]:
    """All points, and each role where both occur."""
    roles = sorted({gcp.role for gcp in found.gcps}, reverse=True)
    return ["", *roles] if len(roles) > 1 else [""]


def _heights(page: Report, found: GcpAccuracy) -> None:
    """The paper's table."""
    page.section("Heights")
    rows = []
    for column in found.errors:
        for role in _roles(found):
            e = found.summary(column, "height", role)
            rows.append([COLUMNS[column], role or "all", e.count, *_metres(e.me, e.rmse, e.max)])
    page.table(
        ["heights by", "points", "count", "ME, m", "RMSE, m", "Max, m"],
        rows,
        "ME is the median of the absolute errors, Max the largest of them." + _notes(found),
    )


def _notes(found: GcpAccuracy) -> str:
    """How to read the columns that are there."""
    said = ""
    if "compensated" in found.errors:
        said += (
            " With compensation, each control point is located with the shifts of the other control points, so "
            "that no point vouches for itself."
        )
    if any(gcp.pixels and gcp.role == "control" for gcp in found.gcps):
        said += (
            " Where the scene's pointing or the DSM were made with the control points, only check points judge them."
        )
    if "rpc" in found.errors and "dsm" in found.errors:
        said += (
            " What the images say of a point's height carries the noise of its own few measured pixels; the DSM's "
            "height does not."
        )
    return said


def _components(page: Report, found: GcpAccuracy) -> None:
    page.section("East, north and height")
    rows = []
    for column, errors in found.errors.items():
        for component in COMPONENTS:
            e = found.summary(column, component)
            if e.count:
                values = errors[found.rows(), COMPONENTS.index(component)]
                bias = float(np.nanmedian(values))
                rows.append([COLUMNS[column], component, e.count, f"{bias:+.3f}", *_metres(e.me, e.rmse, e.max)])
    page.table(
        ["by", "component", "count", "median, m", "ME, m", "RMSE, m", "Max, m"],
        rows,
        "Found less true. A median far from zero is a shift of the whole, which control points take out.",
    )


def _arrows(page: Report, found: GcpAccuracy) -> None:
    places = np.array([gcp.lon_lat_h for gcp in found.gcps])
    flat = EnuFrame(*map(float, places.mean(axis=0))).from_geodetic(places)[:, :2] * (1, -1)
    for column in [name for name in ("rpc", "compensated", "scene") if name in found.errors]:
        vectors = found.errors[column][:, :2] * (1, -1)
        if np.isfinite(vectors).all(axis=1).sum() >= 2:
            names = [gcp.id for gcp in found.gcps] if len(found.gcps) <= _MOST_LABELS else []
            page.svg(
                charts.arrows(flat, vectors, COLUMNS[column], "m", labels=names),
                "Planimetric errors of the points, north up; from the true place to the one found.",
            )


def _points(page: Report, found: GcpAccuracy) -> None:
    page.section("Points")
    columns = list(found.errors)
    heads = [
        f"{_SHORT[column]} {part}" for column in columns for part in (("H",) if column == "dsm" else ("E", "N", "H"))
    ]
    rows: List[List[Any]] = []
    for row, gcp in enumerate(found.gcps[:_MOST_ROWS]):
        values = [value for column in columns for value in found.errors[column][row][2 if column == "dsm" else 0 :]]
        rows.append(
            [
                gcp.id,
                "wrong" if gcp.id in found.wrong else gcp.role,
                f"{gcp.height:.3f}",
                *(f"{value:+.3f}" if np.isfinite(value) else "–" for value in values),
            ]
        )
    left = len(found.gcps) - _MOST_ROWS
    page.table(
        ["point", "role", "height", *heads],
        rows,
        f"{left} more points are left out here; the layer has them all."
        if left > 0
        else "In metres: the true height above the ellipsoid, and errors (found less true). Points called wrong "
        "contradict the other control points and are in no figure above.",
    )


def _residuals(page: Report, found: GcpAccuracy) -> None:
    """Image residuals, and what the compensation is."""
    if not found.residuals:
        return
    page.section("In the images")
    page.table(
        ["view", "column shift, px", "row shift, px"],
        [[name, *(f"{value:+.3f}" for value in shift)] for name, shift in found.shifts.items()],
        "Image-space compensation: the control points' mean of measured less projected pixels.",
    )
    kinds = list(found.residuals)
    rows = []
    for row, gcp in enumerate(found.gcps[:_MOST_ROWS]):
        for view in sorted(gcp.pixels):
            pairs = [found.residuals[kind][row].get(view) for kind in kinds]
            rows.append(
                [
                    gcp.id,
                    view,
                    *(
                        text
                        for pair in pairs
                        for text in ((f"{pair[0]:+.2f}", f"{pair[1]:+.2f}") if pair is not None else ("–", "–"))
                    ),
                ]
            )
    page.table(
        ["point", "view", *(f"{_SHORT[kind]} {axis}" for kind in kinds for axis in ("column", "row"))],
        rows[:_MOST_ROWS],
        "Measured less projected, px.",
    )


def _metres(*values: float) -> List[str]:
    return [f"{value:.3f}" if np.isfinite(value) else "–" for value in values]
