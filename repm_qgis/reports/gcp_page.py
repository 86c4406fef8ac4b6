"""The HTML page of a check against ground control points."""

from __future__ import annotations

from typing import List

import numpy as np

from ..contracts.options import CheckGcpsOptions
from ..evaluation.gcp_accuracy import COLUMNS, COMPONENTS, GcpAccuracy
from ..geometry.frames import EnuFrame, mean_place
from ..numerics.accuracy import EXPLAINED, LEAST_POINTS
from ..runtime.progress import counted
from . import charts
from .report import Report, fixed

_MOST_LABELS = 60
_BEST = ("dsm", "scene", "compensated", "rpc")
"""The columns, that of the best product first."""
_SHORT = {"rpc": "RPC", "compensated": "compensated", "scene": "scene", "dsm": "DSM"}


def gcp_page(found: GcpAccuracy, options: CheckGcpsOptions) -> Report:
    """The accuracy of the images' geometry and of the DSM at the points, for the analyst."""
    page = Report("Accuracy at ground control points", _counts(found))
    page.verdict(_good(found))
    _heights(page, found)
    _components(page, found)
    _arrows(page, found)
    _points(page, found)
    _residuals(page, found)
    heights = options.gcp_datum or "above the WGS 84 ellipsoid"
    inputs = {"Points": options.gcps, "Their heights": heights, "Scene": options.scene, "DSM": options.dsm}
    page.section("Inputs").facts([(name, value) for name, value in inputs.items() if value])
    return page


def _good(found: GcpAccuracy) -> str:
    """The most important figure of the result: the DSM's, else that of the best geometry of the images."""
    for column in _BEST:
        figures = found.summary(column, "height") if column in found.errors else None
        if figures is not None and figures.count and column == "dsm":
            return f"Half of the DSM's heights are within {figures.medae:.3f} m of the points'."
        if figures is not None and figures.count:
            return f"Half of the heights that the images give are within {figures.medae:.3f} m of the points'."
    return ""  # every point is in one image alone, and has no height from it


def _counts(found: GcpAccuracy) -> str:
    """How many points of each role there are; roles mean nothing where no image was measured."""
    if not any(gcp.pixels for gcp in found.gcps):
        return counted(len(found.gcps), "point")
    control, check = (sum(gcp.role == role for gcp in found.gcps) for role in ("control", "check"))
    roles = [*([f"{control} for control"] if control else []), *([f"{check} for checking"] if check else [])]
    return f"{counted(len(found.gcps), 'point')}: {' and '.join(roles)}"


def _roles(found: GcpAccuracy) -> List[str]:
    """All points, and each role where both occur."""
    roles = sorted({gcp.role for gcp in found.gcps}, reverse=True)
    return ["", *roles] if len(roles) > 1 else [""]


def _heights(page: Report, found: GcpAccuracy) -> None:
    """The paper's table."""
    rows = []
    for column in found.errors:
        for role in _roles(found):
            e = found.summary(column, "height", role)
            rows.append([COLUMNS[column], role or "all", e.count, *fixed(e.medae, e.rmse, e.le90, e.max)])
    page.section("Heights").table(
        "heights by | points | count | MedAE, m | RMSE, m | LE90, m | Max, m",
        rows,
        "MedAE is the median of the absolute errors (ME in the method's paper), Max the largest of them. "
        + EXPLAINED
        + _notes(found),
    )
    _positions(page, found)


def _positions(page: Report, found: GcpAccuracy) -> None:
    """Horizontal accuracy, and both accuracies in the words of a contract."""
    rows: List[List[object]] = []
    for column in found.errors:
        for role in _roles(found):
            e = found.horizontal(column, role)
            if e.count:
                rows.append([COLUMNS[column], role or "all", e.count, *fixed(e.medae, e.rmse, e.le90, e.max)])
    if rows:
        page.section("Positions").table(
            "positions by | points | count | median, m | RMSE_H, m | CE90, m | Max, m",
            rows,
            "Horizontal distances of the place found from the true one. CE90: nine of ten points lie in a circle of "
            "this radius around their true places (NMAS). RMSE_H is the root mean square of the distances.",
        )
    role = "check" if any(gcp.role == "check" for gcp in found.gcps) else ""
    words = [text for column in _BEST if column in found.errors for text in [_in_words(found, column, role)] if text]
    if words:
        page.paragraph(words[0])


def _in_words(found: GcpAccuracy, column: str, role: str) -> str:
    """The accuracy of the best product in the words of ASPRS (2023) and NMAS; "" where no point has a height."""
    height, place = found.summary(column, "height", role), found.horizontal(column, role)
    if not height.count:
        return ""
    points = counted(height.count, "check point" if role else "point")
    horizontal = f", RMSE_H {place.rmse:.3f} m, CE90 {place.le90:.3f} m" if place.count else ""
    few = "" if height.count >= LEAST_POINTS else f" ASPRS asks for at least {LEAST_POINTS} check points."
    return (
        f"{COLUMNS[column]}, in the words of contracts: vertical accuracy RMSE_V {height.rmse:.3f} m (ASPRS 2023), "
        f"LE90 {height.le90:.3f} m (NMAS){horizontal}, of {points}.{few}"
    )


def _notes(found: GcpAccuracy) -> str:
    """How to read the columns that are there."""
    notes = ""
    if "compensated" in found.errors:
        notes += " With compensation, each control point is located with the shifts of the other control points only,"
        notes += " so that no point confirms itself."
    if any(gcp.pixels and gcp.role == "control" for gcp in found.gcps):
        notes += " Where the control points were used to make the scene's pointing or the DSM, only check points are"
        notes += " independent of them."
    if "rpc" in found.errors and "dsm" in found.errors:
        notes += " A height that is located from the images has the noise of the point's own few measured pixels;"
        notes += " the DSM's height does not."
    return notes


def _components(page: Report, found: GcpAccuracy) -> None:
    rows: List[List[object]] = []
    for column, errors in found.errors.items():
        for index, component in enumerate(COMPONENTS):
            e = found.summary(column, component)
            if e.count:
                bias = float(np.nanmedian(errors[found.rows(), index]))
                rows.append([COLUMNS[column], component, e.count, f"{bias:+.3f}", *fixed(e.medae, e.rmse, e.max)])
    page.section("East, north and height").table(
        "by | component | count | median, m | MedAE, m | RMSE, m | Max, m",
        rows,
        "Errors are the place found minus the true place. A median far from zero is a shift of the whole, which "
        "control points remove.",
    )


def _arrows(page: Report, found: GcpAccuracy) -> None:
    places = np.array([gcp.lon_lat_h for gcp in found.gcps])
    flat = EnuFrame(*map(float, mean_place(places))).from_geodetic(places)[:, :2] * (1, -1)
    for column in [name for name in ("rpc", "compensated", "scene") if name in found.errors]:
        vectors = found.errors[column][:, :2] * (1, -1)
        if np.isfinite(vectors).all(axis=1).sum() >= 2:
            names = [gcp.id for gcp in found.gcps] if len(found.gcps) <= _MOST_LABELS else []
            drawing = charts.arrows(flat, vectors, COLUMNS[column], "m", labels=names)
            page.svg(drawing, "Planimetric errors of the points, north up, from the true place to the place found.")


def _points(page: Report, found: GcpAccuracy) -> None:
    first = {column: 2 if column == "dsm" else 0 for column in found.errors}  # a DSM has errors of heights only
    heads = [f"{_SHORT[column]} {part}" for column, start in first.items() for part in "ENH"[start:]]
    rows = []
    for row, gcp in enumerate(found.gcps):
        values = [value for column, start in first.items() for value in found.errors[column][row][start:]]
        role = "wrong" if gcp.id in found.wrong else gcp.role
        rows.append([gcp.id, role, f"{gcp.height:.3f}", *fixed(*values, sign="+")])
    page.section("Points").table(
        ["point", "role", "height", *heads],
        rows,
        "In metres: the true height above the ellipsoid, and errors (found minus true). Points called wrong "
        "contradict the other control points and are in no figure above.",
        where="The layer has them all.",
    )


def _residuals(page: Report, found: GcpAccuracy) -> None:
    """Image residuals, and the compensation."""
    if not found.residuals:
        return
    page.section("In the images").table(
        "view | column shift, px | row shift, px",
        [[name, *fixed(*shift, sign="+")] for name, shift in found.shifts.items()],
        "Image-space compensation: the mean of the control points' measured minus projected pixels.",
    )
    rows, none = [], np.full(2, np.nan)
    for row, gcp in enumerate(found.gcps):
        for view in sorted(gcp.pixels):
            pairs = [residuals[row].get(view, none) for residuals in found.residuals.values()]
            rows.append([gcp.id, view, *fixed(*np.concatenate(pairs), decimals=2, sign="+")])
    heads = [f"{_SHORT[kind]} {axis}" for kind in found.residuals for axis in ("column", "row")]
    page.table(["point", "view", *heads], rows, "Measured minus projected pixels.", where="The layer has them all.")
