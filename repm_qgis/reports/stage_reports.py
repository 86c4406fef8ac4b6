"""The content of each stage's HTML report; :mod:`repm_qgis.reports.report` makes the page."""

from __future__ import annotations

import os
import platform
from functools import partial
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr

from .. import __version__
from ..contracts.arrays import ByteImage, FloatArray, FloatImage
from ..contracts.errors import RepmError
from ..contracts.products import STYLES, forms, products_of
from ..contracts.records import FusionFacts
from ..contracts.results import DsmFuseResult, FusedSurface, PipelineResult
from ..geometry.footprints import footprint
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.interpolation import on_lattice
from ..imagery.confidence import CONFIDENCE_BANDS, SOURCE_BAND
from ..imagery.raster import opened
from ..planning.inspection import Place
from ..planning.pair_selection import sun_over
from ..runtime.environment import version_of
from ..runtime.packages import PACKAGES
from ..runtime.progress import counted
from ..scene import Scene, View
from . import charts, pictures, verdict
from .error_study import add_error_study
from .geometry_section import add_geometry
from .inspection_page import add_preview
from .registration_section import add_registration
from .report import Report, fixed

_BELOW_PX = 1200  # of an image that is shown below its error map, along the longer side
_TILES_LAYER = "The TILES layer has them all."
_PATH_OPTIONS = frozenset(forms())  # options that name files and folders to write


def fit_report(scene: Scene) -> Report:
    """Equivalent errors of the fitted cameras, measured and predicted."""
    report = Report("Equivalent pinhole cameras", f"{len(scene.views)} images, {counted(len(scene.tiles), 'tile')}")
    good = f"The cameras differ from the RPCs by at most {verdict.fitted_error_px(scene):.2g} px (RMSE of a tile)."
    report.verdict(good, [*verdict.of_history(scene), *verdict.of_fit(scene)])
    _inputs(report, scene)
    report.section("Equivalent error")
    report.paragraph(
        "The equivalent error is the distance between the pinhole camera's pixel of a ground point and the RPC's, over "
        "a grid of 13 x 13 pixels and 7 altitudes of each tile, before any refinement. 'Predicted' is the paper's "
        "bound |x (Z - Zmean) / Zmean| at the tile's corner."
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
    return _history(report, scene)


def refine_report(scene: Scene) -> Report:
    """Equivalent errors before and after refinement."""
    report = Report("Refined images", f"model: {scene.refinement}")
    worst = verdict.largest_error_px(scene) or 0.0
    good = f"The cameras differ from the RPCs by at most {worst:.2g} px (RMSE of a tile)."
    report.verdict(good, [*verdict.of_history(scene), *verdict.of_refinement(scene)])
    _errors(report, scene)
    add_error_study(report, scene)
    return _history(report, scene)


def reconstruct_report(scene: Scene) -> Report:
    """Tie points, relative pointing and height maps."""
    report = Report("Reconstruction", f"{len(scene.views)} images, {counted(len(scene.tiles), 'tile')}")
    _verdict(report, scene)
    _reconstruction(report, scene)
    return _history(report, scene)


def errormap_report(scene: Scene, view: View, path: str, rmse: float, max_error: float, altitude: float) -> Report:
    """An error map's picture and figures (px; the altitude in m above the ellipsoid)."""
    report = Report("Equivalent error on the ground", f"{view.name} at {altitude:.0f} m above the ellipsoid")
    good = f"The cameras of this view differ from the RPC by {rmse:.2g} px (RMSE), which does not disturb matching."
    report.verdict(good)
    refinement = scene.refinement or "none yet: the images as they are"
    report.facts([("Refinement", refinement), ("RMSE", f"{rmse:.3g} px"), ("Max", f"{max_error:.3g} px")])
    values, _ = pictures.preview(path, 900)
    caption = f"Magnitude of the equivalent error of {view.name}, north up, over the image."
    _map(report, values, (0.0, max(max_error, 1e-6)), caption, "px", _image_below(scene, view, path, values, altitude))
    return report.svg(charts.histogram(values, "px", "Magnitude of the equivalent error"), "Distribution.")


def _image_below(scene: Scene, view: View, path: str, values: FloatImage, altitude: float) -> Optional[ByteImage]:
    """What a view shows of the cells of an error map, on level ground; None where the image cannot be read."""
    with opened(path) as dataset:
        place, size = dataset.GetGeoTransform(), (dataset.RasterXSize, dataset.RasterYSize)
    rows, columns = values.shape
    x = place[0] + place[1] * size[0] * (np.arange(columns) + 0.5) / columns
    y = place[3] + place[5] * size[1] * (np.arange(rows) + 0.5) / rows

    def pixels(xy: FloatArray) -> FloatArray:
        lon_lat = geodetic_from_projected(scene.crs, xy)
        return view.rpc.project(np.concatenate([lon_lat, np.full((*lon_lat.shape[:-1], 1), altitude)], axis=-1))

    try:
        picture = pictures.photograph(view.image, _BELOW_PX)
    except RepmError:
        return None
    scale = np.array([picture.shape[1] / view.width, picture.shape[0] / view.height])
    at = np.floor((on_lattice(x, y, pixels) + 0.5) * scale).astype(int)
    inside = ((at >= 0) & (at < (picture.shape[1], picture.shape[0]))).all(axis=-1)
    column, row = np.where(inside[..., None], at, 0)[..., 0], np.where(inside[..., None], at, 0)[..., 1]
    return np.where(inside[..., None], picture[row, column], np.uint8(0))


def pipeline_report(
    scene: Scene, result: PipelineResult, command: Optional[str], previewed: Optional[Place] = None
) -> Report:
    """The whole run on one page: surface, inputs, geometry, ties, and the command that repeats it; of a preview also
    the place that it shows."""
    preview = partial(add_preview, place=previewed, scene=scene, result=result) if previewed is not None else None
    report = surface_report(scene, result, result.scene, preview)
    if command:
        report.section("Repeat this run").command(command)
    return _history(report, scene, result.seconds)


def fusion_report(scene: Scene, result: DsmFuseResult, path: str) -> Report:
    """A DSM of a scene that was reconstructed before, and how that was; ``path`` is the scene's file."""
    return _history(surface_report(scene, result, path), scene)


def surface_report(
    scene: Scene, result: FusedSurface, path: str, preview: Optional[Callable[[Report], None]] = None
) -> Report:
    """A DSM with all that it comes from, but for its history; ``preview`` adds what is to be known of a preview."""
    title = "Surface model from satellite images" if preview is None else "Preview of the surface"
    report = Report(title, os.path.basename(result.output))
    facts = FusionFacts.from_mapping(result.to_mapping())
    _verdict(report, scene, facts)
    _surface(report, result.output, result.vertical_datum, facts)
    if preview is not None:
        preview(report)
    if scene.registration is not None:
        report.paragraph("This page describes the DSM after the registration.")
    if result.ortho:
        picture = pictures.png_bytes(pictures.photograph(result.ortho, 800))
        report.png(picture, "The orthophoto, north up. White: no image shows the ground there, or it has no height.")
    _inputs(report, scene)
    _errors(report, scene)
    _reconstruction(report, scene)
    if scene.registration is not None:
        add_registration(report, scene.registration)
    _confidence(report, result.confidence, result.ortho or "", result.output)
    made = sorted(products_of("pipeline"), key=lambda product: product.stage != "dsmfuse")
    files = [(each.title, getattr(result, each.option, None)) for each in made if each.style or each.stage == "dsmfuse"]
    files.append(("Scene, for the next stage", path))
    report.section("Files").table(
        "product | file",
        [[title, str(path)] for title, path in files if path],
        "To measure the DSM's accuracy, compare it with a reference: 'Compare a DSM with a reference' "
        "(repm:comparedsm).",
    )
    return report


def _surface(report: Report, path: str, datum: str, facts: FusionFacts) -> None:
    values, cell = pictures.preview(path, 800)
    picture = pictures.png_bytes(pictures.shaded_relief(values, cell))
    report.png(picture, "The DSM, shaded from the north-west, north up. White: no height was matched there.")
    limits = pictures.percentile_range(values)
    report.svg(charts.colour_bar(pictures.RAMPS["elevation"], *limits, f"m above the {datum}"))
    known = f"{facts.valid} of {facts.cells} that two images see ({facts.valid_percent:.1f} %)"
    heights = f"{np.nanmin(values):.1f} to {np.nanmax(values):.1f} m above the {datum}"
    figures = [("Cell size", f"{facts.resolution:g} m"), ("Cells with a height", known)]
    removed = [("Spikes and pits that were removed", f"{facts.needles} cells")] if facts.needles else []
    found = f"{facts.water_m2:.0f} m2 ({facts.water_evidence})"
    water = [("Water", found)] if facts.water else []
    report.facts([*figures, *removed, ("Heights", heights), *water, ("CRS", facts.crs)])
    if facts.dem_offset is not None and not facts.dem_offset.unexpected:  # which stands at the top
        report.paragraph(facts.dem_offset.sentence())


def _classes(report: Report, values: FloatImage, entries: Mapping[int, Tuple[str, str]], caption: str) -> None:
    """A picture of classes, and the colour (``#rrggbb``) and name of each class."""
    colours = pictures.categories(values, {value: colour for value, (colour, _) in entries.items()})
    report.png(pictures.png_bytes(colours), caption)
    report.svg(charts.legend(list(entries.values())))


def _map(
    report: Report,
    values: FloatImage,
    limits: Tuple[float, float],
    caption: str,
    unit: str = "",
    base: Optional[ByteImage] = None,
) -> None:
    """A coloured picture, over the orthophoto or relief of the same ground where there is one, and its key."""
    coloured = pictures.colour_map(values, *limits)
    report.png(pictures.png_bytes(coloured if base is None else pictures.over(base, coloured)), caption)
    report.svg(charts.colour_bar(pictures.RAMPS["viridis"], *limits, unit))


def _verdict(report: Report, scene: Scene, facts: Optional[FusionFacts] = None) -> None:
    """The first thing to read: whether the figures of the page are as usual."""
    good = []
    if facts is not None:
        good.append(f"{facts.valid_percent:.0f} % of the ground that two images see has a height.")
    if scene.pointing is not None:
        good.append(f"The median residual of the tie points is {scene.pointing.after_px:.2f} px.")
    compared = facts is not None and facts.dem_offset is not None
    if facts is not None and not compared and (scene.pointing is None or not scene.pointing.gcps):
        good.append("Nothing here measures the absolute position: only ground control points or a reference can.")
    report.verdict(" ".join(good), [*verdict.of_run(scene, facts), *verdict.of_history(scene)])


def _inputs(report: Report, scene: Scene) -> None:
    """Images, area and a map of the footprints."""
    rows = []
    for v in scene.views:
        heights = "{:.0f} to {:.0f}".format(*v.rpc.height_range)
        size, satellite = f"{v.width} x {v.height}", v.sensor or "unknown"
        rows.append([v.name, v.image, size, f"{v.gsd_m:.3f}", heights, satellite, *_taken(scene, v)])
    report.section("Images").table(
        "view | file | size, px | GSD, m | RPC heights, m | satellite | taken (UTC) | sun's azimuth, elevation",
        rows,
        "Satellite and time are from the product's files or name; the sun's direction is computed for the "
        "scene's middle.",
    )
    middle = sum(scene.altitudes) / 2
    outlines = {v.name: projected_from_geodetic(scene.crs, footprint(v.localise, v.size, middle)) for v in scene.views}
    caption = f"Footprints at {middle:.0f} m above the ellipsoid, north up, and the area that is processed."
    report.svg(charts.footprints(outlines, _outline(scene.area)), caption)
    altitudes = "{:.0f} to {:.0f} m above the WGS 84 ellipsoid".format(*scene.altitudes)
    facts = [("Coordinate reference system", scene.crs), ("Altitudes", altitudes), ("Tiles", len(scene.tiles))]
    report.facts(facts)


def _taken(scene: Scene, view: View) -> List[str]:
    """When a view was taken, and where the sun stood."""
    sun = sun_over(scene, view)
    if sun is None:
        return ["unknown", "unknown"]
    return [f"{view.time:%Y-%m-%d %H:%M:%S}", "{:.1f}°, {:.1f}°".format(*sun)]


def _outline(wkt: str) -> FloatArray:
    """(N, 2) vertices of a polygon's outer ring, or of the largest of several polygons."""
    polygons = ogr.ForceToMultiPolygon(ogr.CreateGeometryFromWkt(wkt))
    parts = [polygons.GetGeometryRef(i) for i in range(polygons.GetGeometryCount())]
    largest = max(parts, key=lambda part: part.GetArea())
    return np.array(largest.GetGeometryRef(0).GetPoints(), dtype=np.float64)[:, :2]


def _errors(report: Report, scene: Scene) -> None:
    """The equivalent error before and after refinement, tile by tile."""
    report.section("Equivalent error").paragraph(
        "The equivalent error is the distance between a pinhole camera's pixel and the RPC's of the same ground point, "
        f"before and after refinement ({scene.refinement}). Heights are computed with the RPCs, so it does not reach "
        "the DSM, and below about 0.3 px it does not disturb matching either."
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
    rows = []
    for tile in scene.tiles:
        for record in tile.heights:
            size, matched = "{} x {}".format(*record.size), f"{100.0 * record.valid / record.pixels:.0f}"
            moved = f"{round(float(np.mean(record.offsets)), 2) + 0.0:+.2f}" if record.offsets else None
            figures = f"{record.metres_per_px:.2f}", f"{record.vertical_parallax_px:.3f}", moved
            rows.append([tile.id, *record.pair, size, matched, *figures])
    headers = "tile | first | second | size, px | matched, % | m of height per px | vertical parallax, px | moved, m"
    note = "'Moved' is the mean offset that was added to a map's heights, so that the maps of different pairs agree."
    report.section("Height maps").table(headers, rows, note, where=_TILES_LAYER)


def _confidence(report: Report, path: Optional[str], ortho: str, dsm: str) -> None:
    """How reliable the heights are, and where: over the orthophoto, or else over the shaded DSM."""
    if not path:
        return
    relief, cell = pictures.preview(dsm, 500)
    size = relief.shape[1], relief.shape[0]
    base = pictures.photograph(ortho, 500, size) if ortho else pictures.grey_relief(relief, cell)
    kinds = next(style.classes for style in STYLES if style.kind == "confidence_source")
    with opened(path) as dataset:
        titles = [dataset.GetRasterBand(band + 1).GetDescription() for band in range(dataset.RasterCount)]
    report.section("Confidence")
    for band, title in enumerate(titles, start=1):
        named = band == SOURCE_BAND or title == CONFIDENCE_BANDS[0]
        values, _ = pictures.preview(path, 500, band, nearest=named)
        known = values[np.isfinite(values)]
        if not known.size or float(known.max() - known.min()) < 1e-6:
            continue  # the same everywhere: with two images there is one height map
        found = [int(value) for value in np.unique(known)]
        if band == SOURCE_BAND:
            entries = {value: (pictures.CLASSES[value], kinds[value]) for value in found if value < len(kinds)}
            _classes(report, values, entries, "Where each height comes from.")
        elif named and len(found) <= len(pictures.CLASSES):
            table = pictures.ramp_table("viridis", len(found))
            entries = {v: ("#" + bytes(colour).hex(), f"{v:g}") for v, colour in zip(found, table)}
            _classes(report, values, entries, "How many height maps agree.")
        else:
            caption = title[:1].upper() + title[1:] + "."
            _map(report, values, pictures.percentile_range(values), caption, base=base)


def _history(report: Report, scene: Scene, seconds: Optional[Mapping[str, float]] = None) -> Report:
    """Time, options and versions of all stages so far."""
    computed = {entry.stage: entry for entry in scene.history}
    rows: List[Sequence[object]] = []
    for name in seconds or computed:
        entry = computed.get(name)
        now = [f"{seconds[name]:.1f}"] if seconds else []
        rows.append([name, *now, f"{entry.seconds:.1f}" if entry else None, entry.fingerprint if entry else None])
    report.section("What was done").table(
        f"stage{' | this run, s' if seconds else ''} | when computed, s | fingerprint",
        rows,
        "A stage that was reused takes no time in this run. Stages with equal fingerprints have equal results.",
    )
    _options(report, scene)
    return report.table("software | version", _versions())


def _options(report: Report, scene: Scene) -> None:
    """One table of all stages' options; a value that several stages share has one row."""
    found: Dict[Tuple[str, str], List[str]] = {}
    if scene.preset != "none":
        found["preset", scene.preset] = ["pipeline"]
    for entry in scene.history:
        for name, value in entry.options.items():
            if value not in (None, "", []) and name not in _PATH_OPTIONS:
                text = ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
                found.setdefault((name, text), []).append(entry.stage)
    report.table(
        "option | value | stage",
        [[name, text, ", ".join(stages)] for (name, text), stages in found.items()],
        "All other options had their default values.",
    )


def _versions() -> List[List[str]]:
    wanted = ("numpy", "GDAL", "pyproj", "scipy", "opencv-python-headless", "pycolmap")
    found = [[p.distribution, version_of(p) or "not installed"] for p in PACKAGES if p.distribution in wanted]
    return [["REPM", __version__], ["Python", platform.python_version()], *found]
