"""The part of a report that says what the images' geometry is worth: pairs, ties, pointing, ground control."""

from __future__ import annotations

import os
from functools import lru_cache
from typing import Any, List, Optional, Sequence

import numpy as np
from osgeo import ogr

from ..geometry.footprints import footprint, geometry_of
from ..geometry.frames import projected_from_geodetic
from ..imagery.acquisition import apart_text
from ..imagery.raster import quiet
from ..progress import counted
from ..records import GcpFigures, PointingFigures, ViewPair
from ..scene import Scene
from ..sfm.advice import MATCHING_PX
from . import charts
from .gcp_accuracy import Errors
from .report import Report, fixed

_MOST_TIES = 200000
_MOST_TILES = 60


def add_geometry(report: Report, scene: Scene) -> None:
    """Pairs, tie points before and after, pointing, and what the absolute position rests on."""
    _pairs(report, scene)
    if scene.pointing is not None:
        _ties(report, scene, scene.pointing)
        _pointing(report, scene.pointing)
        _absolute(report, scene.pointing)


def _pairs(report: Report, scene: Scene) -> None:
    report.section("Pairs")
    rows = []
    for pair in scene.pairs:
        metres = _metres_per_px(scene, pair)
        overlap = overlap_percent(scene, pair.first, pair.second)
        figures = f"{pair.base_to_height:.2f}", f"{overlap:.0f}", *fixed(metres, MATCHING_PX * metres, decimals=2)
        times = apart_text(pair.days), _sun_text(pair.sun_deg)
        rows.append([pair.first, pair.second, f"{pair.angle_deg:.1f}°", *figures, *times])
    report.table(
        "first | second | convergence | B/H | overlap, % | m of height per px | expected accuracy, m | taken apart | "
        "angle between suns",
        rows,
        "Overlap is of the smaller footprint at the middle altitude. The expected accuracy of single "
        f"heights is that of matching good to {MATCHING_PX:g} px; a narrow pair (B/H below 0.1) tells heights "
        "poorly, a wide one (above 0.9) matches poorly; images far apart in time or under another sun have "
        "changed, and match with gaps.",
    )


def _sun_text(degrees: Optional[float]) -> str:
    return "unknown" if degrees is None else f"{degrees:.1f}°"


def overlap_percent(scene: Scene, first: str, second: str) -> float:
    """What two views' footprints have in common at the middle altitude, in % of the smaller one."""
    middle = sum(scene.altitudes) / 2
    shapes = [
        geometry_of(projected_from_geodetic(scene.crs, footprint(view.localise, view.size, middle)))
        for view in (scene.view(first), scene.view(second))
    ]
    common = shapes[0].Intersection(shapes[1])
    smaller = min(shape.GetArea() for shape in shapes)
    return 100.0 * common.GetArea() / smaller if common is not None and smaller > 0 else 0.0


def _metres_per_px(scene: Scene, pair: ViewPair) -> float:
    """Metres of height a px of parallax: as matched, else from the angle."""
    known = [
        record.metres_per_px
        for tile in scene.tiles
        for record in tile.heights
        if record.pair == (pair.first, pair.second)
    ]
    return float(np.median(known)) if known else scene.gsd_m / pair.base_to_height


def _ties(report: Report, scene: Scene, ties: PointingFigures) -> None:
    report.section("Tie points")
    report.facts(
        [
            ("Tie points", ties.count),
            ("Median residual", f"{ties.before_px:.2f} px before, {ties.after_px:.2f} px after the correction"),
            ("Keypoints", ties.detector),
            ("Matcher", scene.backend),
        ]
    )
    rows = []
    for pair in ties.pairs:
        figures = f"{pair.before_px:+.2f}", *fixed(pair.after_px, pair.spread_px)
        rows.append([*pair.pair, pair.candidates, pair.count, *figures])
    report.table(
        "first | second | candidates | ties | before, px | after, px | spread, px",
        rows,
        "'Rows' are by how much a pair's pixels miss each other across the parallax: with the vendors' RPCs "
        "(median), and corrected (median of the absolute values; their spread as NMAD).",
    )
    tiles = [list(entry) for entry in ties.ties_by_tile.items()]
    if len(tiles) > 1:
        report.table(
            "tile | tie points around it",
            tiles,
            "Within the tile, or within a fifth of the scene where that is more.",
            most=_MOST_TILES,
        )
    if ties.ties_by_part:
        report.table(
            list(ties.ties_by_part),
            [list(ties.ties_by_part.values())],
            "Tie points by ninths of the area, north up.",
        )
    _curves(report, scene)


def _curves(report: Report, scene: Scene) -> None:
    """How many ties are how good, and where rows still differ; nothing where the ties' layer is gone."""
    found = _read_ties(scene.tie_points)
    if not len(found):
        return
    share = np.linspace(0, 100, len(found))
    limit = float(np.percentile(found[:, :2], 98))
    report.svg(
        charts.curves(
            {"vendors' RPCs": (np.sort(found[:, 0]), share), "corrected": (np.sort(found[:, 1]), share)},
            "residual of a tie point (px)",
            "tie points with less (%)",
            xlim=(0.0, max(limit, 0.1)),
            ylim=(0.0, 100.0),
        ),
        "Tie points' residuals: root mean square distance between measured and projected pixels.",
    )
    row, azimuth = found[:, 2], np.radians(found[:, 3])
    vectors = np.column_stack([row * np.sin(azimuth), -row * np.cos(azimuth)])
    report.svg(
        charts.arrows(found[:, 4:] * (1, -1), vectors, "Rows left", "px"),
        "What is left of the rows' differences, at the tie points on the ground, north up (the layer of tie "
        "points has them too, in its field 'row'). Arrows in all directions are noise; arrows that agree over "
        "a part of the scene are a trend that POINTING=affine may take out.",
    )


def _read_ties(path: str) -> np.ndarray:
    """(N, 6) residuals before and after, row, its azimuth, x, y of the ties' layer; empty where it cannot be read."""
    try:
        return _ties_of(path, os.stat(path).st_mtime_ns)
    except OSError:
        return np.empty((0, 6))


@lru_cache(maxsize=1)  # of one run, two pages show them
def _ties_of(path: str, changed_ns: int) -> np.ndarray:
    with quiet():
        try:
            source = ogr.Open(path)
        except RuntimeError:
            source = None
        if source is None:
            return np.empty((0, 6))
        layer = source.GetLayer(0)
        definition = layer.GetLayerDefn()
        indices = [definition.GetFieldIndex(name) for name in ("before", "residual", "row", "direction")]
        values = []
        for feature, _ in zip(layer if min(indices) >= 0 else (), range(_MOST_TIES)):
            if all(feature.IsFieldSetAndNotNull(index) for index in indices):
                point = feature.GetGeometryRef()
                values.append((*map(feature.GetFieldAsDouble, indices), point.GetX(), point.GetY()))
        layer = source = None
    return np.array(values, dtype=float).reshape(-1, 6)


def _pointing(report: Report, ties: PointingFigures) -> None:
    report.section("Pointing")
    said = {"shift": "one shift an image", "affine": "an affine correction an image"}
    report.facts([("Correction", said.get(ties.model, ties.model)), ("Why", ties.reason)])
    report.table(
        "view | column shift, px | row shift, px",
        [[name, *fixed(*shift, decimals=2, sign="+")] for name, shift in ties.shifts_px.items()],
        "Corrections of the vendors' RPCs at the images' centres.",
    )


def _absolute(report: Report, ties: PointingFigures) -> None:
    """Ground control, or how uncertain things are without it."""
    report.section("Absolute position")
    if ties.height_uncertainty_m is not None:
        report.paragraph(
            "Without control points the corrections sum to zero: the position and height of the whole "
            "stay where the vendors put them. By how much their RPCs disagree across the parallax, the "
            f"absolute height is uncertain by {ties.height_uncertainty_m:.1f} m (two "
            "standard deviations; relative heights are not affected). Ground control points (GCPS), or "
            "an alignment with a reference, take that out."
        )
    points, rejected = ties.gcps, ties.rejected_gcps
    if rejected:
        report.warning(
            f"{counted(len(rejected), 'control point')} contradicted all others and took no part: "
            f"{', '.join(rejected)}.",
            "check coordinates, the heights' datum, and the measured pixels.",
        )
    if not points:
        return
    if ties.control_noise_px is not None:
        report.paragraph(
            f"The control points fit to {ties.control_noise_px:.2f} px in each direction (standard "
            "deviation, estimated from their own residuals), and have the weight of that."
        )
    report.table(
        "points | count | component | ME, m | RMSE, m | Max, m",
        _summary(points),
        "From the true place to where the corrected images put it. Control points were fitted; only check "
        "points tell how good the result is.",
    )
    rows = []
    for point in points:
        errors = fixed(point.east_m, point.north_m, point.up_m, sign="+")
        rows.append([point.id, "rejected" if point.rejected else point.role, *errors])
    report.table("point | role | east, m | north, m | height, m", rows)


def _summary(points: Sequence[GcpFigures]) -> List[List[Any]]:
    rows = []
    for role in ("control", "check"):
        mine = [point for point in points if point.role == role and not point.rejected]
        for name, title in (("east_m", "east"), ("north_m", "north"), ("up_m", "height")):
            errors = Errors.of(np.array([getattr(point, name) for point in mine]))
            if errors.count:
                rows.append([role, errors.count, title, *fixed(errors.me, errors.rmse, errors.max)])
    return rows
