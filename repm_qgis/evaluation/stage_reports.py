"""What each stage's HTML report says; the page itself is made by :mod:`repm_qgis.evaluation.report`."""

from __future__ import annotations

import os
import platform
from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np
from osgeo import ogr

from .. import __version__
from ..environment import PACKAGES, version_of
from ..geometry.footprints import footprint
from ..geometry.frames import projected_from_geodetic
from ..imagery.raster import opened
from ..progress import counted
from ..scene import Scene, View
from ..sfm.pair_selection import sun_over
from . import charts, pictures
from .error_study import add_error_study
from .geometry_section import add_geometry
from .report import Report, fixed

_PRODUCTS = (
    ("output", "DSM"),
    ("confidence", "Confidence"),
    ("ortho", "Orthophoto"),
    ("cloud", "Point cloud"),
    ("ept", "Point cloud for display (EPT)"),
    ("mesh", "Mesh"),
    ("tiles", "Tiles with their errors"),
    ("tie_points", "Tie points"),
    ("scene", "Scene, for the next stage"),
)
_TILES_LAYER = "The TILES layer has them all."
_WHERE_IT_RUNS = frozenset(
    (
        "workspace",
        "scene",
        "output_scene",
        "output",
        "report",
        "tiles",
        "tie_points",
        "heights",
        "confidence",
        "ortho",
        "cloud",
        "ept",
        "mesh",
    )
)


def fit_report(scene: Scene) -> Report:
    """Equivalent errors of the fitted cameras, measured and predicted."""
    report = Report("Equivalent pinhole cameras", f"{len(scene.views)} images, {counted(len(scene.tiles), 'tile')}")
    _warnings(report, scene)
    _inputs(report, scene)
    report.section("Equivalent error")
    report.paragraph(
        "How far the pinhole camera's pixel of a ground point lies from the RPC's, over a grid of 13 x 13 "
        "pixels and 7 altitudes of each tile, before any refinement. 'Predicted' is the paper's bound "
        "|x (Z - Zmean) / Zmean| at the tile's corner."
    )
    rows, errors = [], []
    for tile in scene.tiles:
        for name, view in tile.views.items():
            e = view.error
            rows.append([tile.id, name, *fixed(e.samp_rmse, e.line_rmse, e.rmse, e.max, e.predicted)])
            errors.append(e.rmse)
    headers = "tile | view | Samp RMSE, px | Line RMSE, px | RMSE, px | Max, px | predicted, px"
    report.table(headers, rows, where=_TILES_LAYER)
    if len(rows) > 20:
        report.svg(charts.histogram(errors, "px", "RMSE of tiles and views"), "Distribution over tiles and views.")
    add_error_study(report, scene)
    _history(report, scene)
    return report


def refine_report(scene: Scene) -> Report:
    """Equivalent errors before and after refinement."""
    report = Report("Refined images", f"model: {scene.refinement}")
    _warnings(report, scene)
    _errors(report, scene)
    add_error_study(report, scene)
    _history(report, scene)
    return report


def reconstruct_report(scene: Scene) -> Report:
    """Tie points, relative pointing and height maps."""
    report = Report("Reconstruction", f"{len(scene.views)} images, {counted(len(scene.tiles), 'tile')}")
    _warnings(report, scene)
    _reconstruction(report, scene)
    _history(report, scene)
    return report


def errormap_report(scene: Scene, view: View, path: str, facts: Mapping[str, float]) -> Report:
    """An error map's picture and figures."""
    report = Report("Equivalent error on the ground", f"{view.name} at {facts['altitude']:.0f} m above the ellipsoid")
    report.facts(
        [
            ("Refinement", scene.refinement or "none yet: the images as they are"),
            ("RMSE", f"{facts['rmse']:.3g} px"),
            ("Max", f"{facts['max_error']:.3g} px"),
        ]
    )
    values, _ = pictures.preview(path, 900)
    high = max(facts["max_error"], 1e-6)
    report.png(
        pictures.png_bytes(pictures.colour_map(values, 0.0, high, "viridis")),
        f"Magnitude of the equivalent error of {view.name}, north up.",
    )
    report.svg(charts.colour_bar(pictures.RAMPS["viridis"], 0.0, high, "px"))
    report.svg(
        charts.histogram(values[np.isfinite(values)], "px", "Magnitude of the equivalent error"), "Distribution."
    )
    return report


def pipeline_report(
    scene: Scene, products: Mapping[str, Any], seconds: Mapping[str, float], command: Optional[str]
) -> Report:
    """The whole run on one page: surface, inputs, geometry, ties, and the command that repeats it."""
    report = Report("Surface model from satellite images", os.path.basename(str(products["output"])))
    _surface(report, products)
    _warnings(report, scene, _thin(products))
    _inputs(report, scene)
    _errors(report, scene)
    _reconstruction(report, scene)
    _confidence(report, products)
    report.section("Files")
    report.table(
        "product | file",
        [[title, str(products[name])] for name, title in _PRODUCTS if products.get(name)],
        "To measure the DSM, compare it with a reference: 'Compare a DSM with a reference' (repm:comparedsm).",
    )
    if command:
        report.section("Repeat this run")
        report.command(command)
    _history(report, scene, seconds)
    return report


def _surface(report: Report, products: Mapping[str, Any]) -> None:
    values, cell = pictures.preview(products["output"], 800)
    low, high = pictures.spread(values)
    report.png(
        pictures.png_bytes(pictures.shaded_relief(values, cell)),
        "The DSM, shaded from the north-west, north up. White: no height was matched there.",
    )
    report.svg(charts.colour_bar(pictures.RAMPS["elevation"], low, high, f"m above the {products['vertical_datum']}"))
    known = values[np.isfinite(values)]
    report.facts(
        [
            ("Cell size", f"{products['resolution']:g} m"),
            ("Cells with a height", f"{products['valid']} of {products['cells']} ({products['valid_percent']:.1f} %)"),
            ("Heights", f"{known.min():.1f} to {known.max():.1f} m above the {products['vertical_datum']}"),
            ("CRS", products["crs"]),
        ]
    )


def _thin(products: Mapping[str, Any]) -> List[str]:
    if products["valid_percent"] >= 20:
        return []
    return [
        f"Only {products['valid_percent']:.0f} % of the cells have a height. Water, shadow and clouds leave gaps, "
        "and so do images from too different directions or dates: see 'Height maps' below for the pairs that "
        "matched badly."
    ]


def _warnings(report: Report, scene: Scene, more: Tuple[str, ...] | List[str] = ()) -> None:
    """Everything the stages warned of, first thing on the page."""
    said = [text for entry in scene.history for text in entry.warnings]
    for text in dict.fromkeys([*more, *said]):
        report.warning(text)


def _inputs(report: Report, scene: Scene) -> None:
    """Images, area and a map of the footprints."""
    report.section("Images")
    report.table(
        "view | file | size, px | GSD, m | RPC heights, m | taken (UTC) | sun's azimuth, elevation",
        [
            [
                v.name,
                v.image,
                f"{v.width} x {v.height}",
                f"{v.gsd_m:.3f}",
                "{:.0f} to {:.0f}".format(*v.rpc.height_range),
                *_taken(scene, v),
            ]
            for v in scene.views
        ],
        "The time is that of the product's files or name; the sun is computed from it for the scene's middle.",
    )
    middle = sum(scene.altitudes) / 2
    outlines = {v.name: projected_from_geodetic(scene.crs, footprint(v.localise, v.size, middle)) for v in scene.views}
    report.svg(
        charts.footprints(outlines, _outline(scene.area)),
        f"Footprints at {middle:.0f} m above the ellipsoid, north up, and the area that is worked on.",
    )
    report.facts(
        [
            ("Coordinate reference system", scene.crs),
            ("Altitudes", f"{scene.altitudes[0]:.0f} to {scene.altitudes[1]:.0f} m above the WGS 84 ellipsoid"),
            ("Tiles", len(scene.tiles)),
        ]
    )


def _taken(scene: Scene, view: View) -> List[str]:
    """When a view was taken, and where the sun stood."""
    sun = sun_over(scene, view)
    if sun is None:
        return ["unknown", "unknown"]
    return [f"{view.time:%Y-%m-%d %H:%M:%S}", "{:.1f}°, {:.1f}°".format(*sun)]


def _outline(wkt: str) -> np.ndarray:
    """(N, 2) vertices of a polygon's outer ring; of several polygons the largest's."""
    geometry = ogr.CreateGeometryFromWkt(wkt)
    parts = (
        [geometry]
        if geometry.GetGeometryName() == "POLYGON"
        else [geometry.GetGeometryRef(i) for i in range(geometry.GetGeometryCount())]
    )
    largest = max(parts, key=lambda part: part.GetArea())
    return np.array(largest.GetGeometryRef(0).GetPoints())[:, :2]


def _errors(report: Report, scene: Scene) -> None:
    """The equivalent error before and after refinement, tile by tile."""
    report.section("Equivalent error")
    report.paragraph(
        "What the pinhole cameras cost, as the distance between their pixel and the RPC's of the same "
        f"ground point: fitted, and after refinement ({scene.refinement}). Heights are computed with the "
        "RPCs, so none of it reaches the DSM; below about 0.3 px it does not disturb matching either."
    )
    rows = []
    for tile in scene.tiles:
        for name, view in tile.views.items():
            if view.refined:
                a, b = view.error, view.refined.error
                rows.append([tile.id, name, *fixed(a.rmse, a.max, b.samp_rmse, b.line_rmse, b.rmse, b.max)])
    headers = "tile | view | RMSE before, px | Max before, px | Samp RMSE, px | Line RMSE, px | RMSE, px | Max, px"
    report.table(headers, rows, where=_TILES_LAYER)


def _reconstruction(report: Report, scene: Scene) -> None:
    """Pairs, ties, pointing, and what was matched."""
    add_geometry(report, scene)
    _height_maps(report, scene)


def _height_maps(report: Report, scene: Scene) -> None:
    report.section("Height maps")
    rows = []
    for tile in scene.tiles:
        for record in tile.heights:
            size, matched = "{} x {}".format(*record.size), f"{100.0 * record.valid / record.pixels:.0f}"
            figures = f"{record.metres_per_px:.2f}", f"{record.vertical_parallax_px:.3f}"
            rows.append([tile.id, *record.pair, size, matched, *figures])
    headers = "tile | first | second | size, px | matched, % | m of height per px | vertical parallax, px"
    report.table(headers, rows, where=_TILES_LAYER)


def _confidence(report: Report, products: Mapping[str, Any]) -> None:
    """Where the heights rest on what."""
    path = products.get("confidence")
    if not path:
        return
    with opened(path) as dataset:
        titles = [dataset.GetRasterBand(band + 1).GetDescription() for band in range(dataset.RasterCount)]
    report.section("Confidence")
    for band, title in enumerate(titles, start=1):
        values, _ = pictures.preview(path, 500, band)
        known = values[np.isfinite(values)]
        if not known.size or float(known.max() - known.min()) < 1e-6:
            continue  # the same everywhere: with two images there is one height map
        low, high = pictures.spread(values)
        report.png(pictures.png_bytes(pictures.colour_map(values, low, high)), title[:1].upper() + title[1:] + ".")
        report.svg(charts.colour_bar(pictures.RAMPS["viridis"], low, high))


def _history(report: Report, scene: Scene, seconds: Optional[Mapping[str, float]] = None) -> None:
    """Time, options and versions of everything that led here."""
    report.section("What was done")
    computed = {entry.stage: entry for entry in scene.history}
    names = list(seconds) if seconds else list(computed)
    rows = []
    for name in names:
        entry = computed.get(name)
        now = [f"{seconds[name]:.1f}"] if seconds else []
        rows.append([name, *now, f"{entry.seconds:.1f}" if entry else "–", entry.fingerprint if entry else "–"])
    report.table(
        ["stage", *(["this run, s"] if seconds else []), "when computed, s", "fingerprint"],
        rows,
        "A stage that was reused takes no time in this run. Equal fingerprint, equal result.",
    )
    _options(report, scene)
    report.table("software | version", _versions())


def _options(report: Report, scene: Scene) -> None:
    """One table of all stages' options; a value that several stages share is told once."""
    told: Dict[Tuple[str, str], List[str]] = {}
    for entry in scene.history:
        for name, value in entry.options.items():
            if value not in (None, "", []) and name not in _WHERE_IT_RUNS:
                text = ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
                told.setdefault((name, text), []).append(entry.stage)
    report.table(
        "option | value | stage",
        [[name, text, ", ".join(stages)] for (name, text), stages in told.items()],
        "What is not listed was left to the defaults.",
    )


def _versions() -> List[List[str]]:
    wanted = ("numpy", "GDAL", "pyproj", "scipy", "opencv-python-headless", "pycolmap")
    found = [
        [package.distribution, version_of(package) or "not installed"]
        for package in PACKAGES
        if package.distribution in wanted
    ]
    return [["REPM", __version__], ["Python", platform.python_version()], *found]
