"""The part of a report on the quality of the images' geometry: pairs, tie points, pointing, ground control."""

from __future__ import annotations

import os
from functools import lru_cache
from typing import List, Sequence

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.records import GcpFigures, PointingFigures, ViewPair
from ..evaluation.gcp_accuracy import ErrorSummary
from ..files.vector import read_points
from ..geometry.footprints import footprint, geometry_of
from ..geometry.frames import projected_from_geodetic
from ..imagery.acquisition import duration_text
from ..planning.advice import absolute_height
from ..planning.pair_selection import shared_part
from ..planning.parameters import PLANNING
from ..runtime.progress import counted
from ..scene import Scene
from . import charts
from .report import Report, fixed

_MOST_TIES = 200000
_MOST_TILES = 60
_WAVE_POINTS = 400  # of a drawing


def add_geometry(report: Report, scene: Scene) -> None:
    """Pairs, tie points before and after, pointing, and how well the absolute position is known."""
    _pairs(report, scene)
    if scene.pointing is not None:
        _ties(report, scene, scene.pointing)
        _pointing(report, scene.pointing)
        add_jitter(report, scene)
        _absolute(report, scene, scene.pointing)


def _pairs(report: Report, scene: Scene) -> None:
    rows = []
    for pair in scene.pairs:
        metres = _metres_per_px(scene, pair)
        overlap = overlap_percent(scene, pair.first, pair.second)
        accuracy = fixed(metres, PLANNING.advice.matching_px * metres, decimals=2)
        figures = f"{pair.base_to_height:.2f}", f"{overlap:.0f}", *accuracy
        times = duration_text(pair.days), "unknown" if pair.sun_deg is None else f"{pair.sun_deg:.1f}°"
        rows.append([pair.first, pair.second, f"{pair.angle_deg:.1f}°", *figures, *times])
    report.section("Pairs").table(
        "first | second | convergence | B/H | overlap, % | m of height per px | expected accuracy, m | time between | "
        "angle between suns",
        rows,
        "The overlap is a share of the smaller footprint, at the middle altitude. The expected accuracy is that of "
        f"single heights where matching is accurate to {PLANNING.advice.matching_px:g} px. A narrow pair (B/H below "
        "0.1) measures heights poorly, and a wide one (above 0.9) is hard to match. Images that were taken at very "
        "different times or under another sun have changed, and their matches have gaps.",
    )


def overlap_percent(scene: Scene, first: str, second: str) -> float:
    """The overlap of two views' footprints at the middle altitude, in % of the smaller one."""
    middle = sum(scene.altitudes) / 2
    places = [footprint(view.localise, view.size, middle) for view in (scene.view(first), scene.view(second))]
    one, two = (geometry_of(projected_from_geodetic(scene.crs, place)) for place in places)
    return 100.0 * shared_part(one, two)


def _metres_per_px(scene: Scene, pair: ViewPair) -> float:
    """Metres of height per px of parallax: as matched, or else from the convergence angle."""
    records = [record for tile in scene.tiles for record in tile.heights]
    known = [record.metres_per_px for record in records if record.pair == pair.names]
    return float(np.median(known)) if known else scene.gsd_m / pair.base_to_height


def _ties(report: Report, scene: Scene, ties: PointingFigures) -> None:
    residual = f"{ties.before_px:.2f} px before, {ties.after_px:.2f} px after the correction"
    facts = [("Tie points", ties.count), ("Median residual", residual)]
    report.section("Tie points").facts([*facts, ("Matcher", scene.backend)])
    rows = []
    for pair in ties.pairs:
        figures = f"{pair.before_px:+.2f}", *fixed(pair.after_px, pair.spread_px)
        rows.append([*pair.pair, pair.candidates, pair.count, *figures])
    report.table(
        "first | second | candidates | ties | before, px | after, px | spread, px",
        rows,
        "The vertical parallax of each pair, which is the distance between its pixels across the direction of the "
        "parallax: before the correction, with the vendors' RPCs (median), and after it (median of the absolute "
        "values, and their spread as NMAD).",
    )
    tiles = [list(entry) for entry in ties.ties_by_tile.items()]
    if len(tiles) > 1:
        caption = "Ties are counted within the tile, or within a fifth of the scene where that is more."
        report.table("tile | tie points around it", tiles, caption, most=_MOST_TILES)
    if ties.ties_by_part:
        counts = list(ties.ties_by_part.values())
        report.table(list(ties.ties_by_part), [counts], "Tie points in each ninth of the area.")
    _curves(report, scene)


def _curves(report: Report, scene: Scene) -> None:
    """How large the ties' residuals are, and where vertical parallax remains; nothing without the ties' layer."""
    found = _read_ties(scene.tie_points)
    if not len(found):
        return
    share = np.linspace(0, 100, len(found))
    limit = float(np.percentile(found[:, 2:4], 98))
    series = {"vendors' RPCs": (np.sort(found[:, 2]), share), "corrected": (np.sort(found[:, 3]), share)}
    drawing = charts.curves(
        series,
        "residual of a tie point (px)",
        "tie points with less (%)",
        xlim=(0.0, max(limit, 0.1)),
        ylim=(0.0, 100.0),
    )
    report.svg(drawing, "Tie points' residuals: the root mean square distance between measured and projected pixels.")
    row, azimuth = found[:, 4], np.radians(found[:, 5])
    vectors = np.column_stack([row * np.sin(azimuth), -row * np.cos(azimuth)])
    report.svg(
        charts.arrows(found[:, :2] * (1, -1), vectors, "Vertical parallax after the correction", "px"),
        "The vertical parallax that remains, at the tie points on the ground, north up (the layer of tie points has it "
        "in its field 'row'). Arrows in all directions are noise. Arrows that agree over a part of the scene are a "
        "trend, which POINTING=affine may remove.",
    )


def _read_ties(path: str) -> FloatArray:
    """(N, 6) of the ties' layer: x, y, residual before and after, vertical parallax, its azimuth; empty without it."""
    try:
        return _ties_of(path, os.stat(path).st_mtime_ns)
    except OSError:
        return np.empty((0, 6))


@lru_cache(maxsize=1)  # two pages of one run show them
def _ties_of(path: str, changed_ns: int) -> FloatArray:
    return read_points(path, ("before", "residual", "row", "direction"), _MOST_TIES)


def _pointing(report: Report, ties: PointingFigures) -> None:
    models = {"shift": "one shift per image", "affine": "an affine correction per image"}
    report.section("Pointing").facts([("Correction", models.get(ties.model, ties.model)), ("Why", ties.reason)])
    report.table(
        "view | column shift, px | row shift, px",
        [[name, *fixed(*shift, decimals=2, sign="+")] for name, shift in ties.shifts_px.items()],
        "Corrections of the vendors' RPCs at the images' centres.",
    )


def add_jitter(report: Report, scene: Scene) -> None:
    """The waves of each view that has jitter: their size and shape."""
    shaken = [(view, view.jitter) for view in scene.views if view.jitter is not None]
    if not shaken:
        return
    rows, drawings = [], []
    for view, jitter in shaken:
        lines = np.linspace(jitter.first, jitter.last, _WAVE_POINTS)
        waves = jitter.at(lines)
        sizes = *np.sqrt(np.mean(waves**2, axis=0)), *np.abs(waves).max(axis=0)
        rows.append([view.name, *fixed(*sizes, decimals=2)])
        series = {"in columns": (lines, waves[:, 0]), "in rows": (lines, waves[:, 1])}
        drawings.append(charts.curves(series, "line of the image", "displacement from the RPC (px)", view.name))
    report.section("Jitter").table(
        "view | columns, RMS, px | rows, RMS, px | columns, most, px | rows, most, px",
        rows,
        "The satellite shook while it took the images: the content of an image line is displaced by this much from "
        "where the corrected RPC puts it. The heights and all products of this scene are corrected for these waves.",
    )
    for drawing in drawings:
        report.svg(drawing, "The waves of an image over its lines.")


def _absolute(report: Report, scene: Scene, ties: PointingFigures) -> None:
    """Ground control, or how uncertain the heights are without it."""
    report.section("Absolute position")
    if ties.height_uncertainty_m is not None:
        report.paragraph(
            "Without control points the corrections sum to zero, so the position and height of the whole scene stay "
            "as the vendors' RPCs give them. Ground control points (GCPS), or a registration to a reference, remove "
            "their error."
        )
    for text in absolute_height(scene.views, ties):
        report.paragraph(text)
    points, rejected = ties.gcps, ties.rejected_gcps
    if rejected:
        points_text = f"{counted(len(rejected), 'control point')} contradicted all others and could not be used in"
        remedy = "Check their coordinates, the datum of their heights, and the measured pixels."
        report.paragraph(f"{points_text} the adjustment: {', '.join(rejected)}. {remedy}")
    if not points:
        return
    if ties.control_noise_px is not None:
        report.paragraph(
            f"The residuals of the control points are {ties.control_noise_px:.2f} px in each direction (standard "
            "deviation), which sets their weight against the tie points."
        )
    report.table(
        "points | count | component | MedAE, m | RMSE, m | Max, m",
        _summary(points),
        "Errors are the place found by the corrected images minus the true place. Control points were used in the "
        "adjustment; only check points show how good the result is.",
    )
    rows = []
    for point in points:
        errors = fixed(point.east_m, point.north_m, point.up_m, sign="+")
        rows.append([point.id, "rejected" if point.rejected else point.role, *errors])
    report.table("point | role | east, m | north, m | height, m", rows)


def _summary(points: Sequence[GcpFigures]) -> List[List[object]]:
    rows: List[List[object]] = []
    for role in ("control", "check"):
        mine = [point for point in points if point.role == role and not point.rejected]
        for name, title in (("east_m", "east"), ("north_m", "north"), ("up_m", "height")):
            errors = ErrorSummary.of(np.array([getattr(point, name) for point in mine]))
            if errors.count:
                rows.append([role, errors.count, title, *fixed(errors.medae, errors.rmse, errors.max)])
    return rows
