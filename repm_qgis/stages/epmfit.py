"""Fit an equivalent pinhole camera to each image's RPC, tile by tile (paper, Algorithm 1)."""

from __future__ import annotations

import math
import os
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import ogr

from ..contracts.arrays import Altitudes, Bounds, Window
from ..contracts.errors import OptionError, OverlapError
from ..contracts.findings import Finding
from ..contracts.options import EpmFitOptions, Extent
from ..contracts.results import EpmFitResult
from ..files.vector import write_layer
from ..geometry.equivalent_error import VirtualGrid, fit_pinhole, refine_pinhole, virtual_grid
from ..geometry.footprints import bounds_of, box
from ..geometry.frames import EnuFrame, geodetic_from_projected, projected_crs_at, utm_crs
from ..geometry.ground_metric import metric_at
from ..geometry.parameters import VIRTUAL_GRID
from ..geometry.tiles import GroundTile, largest_within, lay_tiles, pixel_window
from ..imagery.acquisition import time_sidecars
from ..imagery.deliveries import with_images
from ..imagery.parameters import SAMPLING
from ..imagery.raster import raster_identity, require_content
from ..names import scene_title
from ..planning.altitude_range import altitude_range
from ..planning.empty_ends import without_empty_ends
from ..planning.overlap import common_ground, views_of
from ..planning.plane_heights import with_planes
from ..reports.stage_reports import fit_report
from ..rpc.readers import rpc_sidecars
from ..runtime.memory import planned_mib
from ..runtime.parallel import task_mib
from ..runtime.progress import Part, Progress, Recorder, counted, warn_all
from ..runtime.workspace import ensure_folder, file_identity, fingerprint, with_copy
from ..scene import (
    Scene,
    Tile,
    TileView,
    View,
    common_gsd_m,
    common_heights,
    finest_gsd_m,
    folder_of,
    middle_of,
    reusable,
)
from ..stereo.parameters import STEREO
from .parameters import ENGINE, EngineParameters, TileParameters

_MOST_NAMED = 12  # images that the log names one by one


def run(options: EpmFitOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> EpmFitResult:
    """Read the RPCs, find area and altitudes, lay tiles, fit cameras; gives the scene, the TILES layer, the report."""
    start, notes = time.monotonic(), Recorder(progress)
    options = with_images(options, progress)
    folder = ensure_folder(options.workspace)
    scene_path = str(folder / "scene.json")
    tiles_paths = with_copy(str(folder / "tiles.gpkg"), options.tiles)
    report_paths = with_copy(str(folder / "equivalent_error.html"), options.report)
    key = _key(options, parameters)
    scene = reusable(scene_path, "epmfit", key)
    masks = [view.mask for view in scene.views if view.mask] if scene is not None else []  # the fit may have made some
    if scene is not None and all(os.path.exists(mask) or mask.startswith("/vsi") for mask in masks):
        tiles = counted(len(scene.tiles), "tile")
        progress.info(f"Reused the cameras of {tiles} in '{scene_path}': images and options are unchanged.")
    else:
        scene = _fit(options, folder_of(Path(scene_path), "masks"), parameters, notes)
        replace(scene, path=Path(scene_path)).require_same_images()
        seconds, changes = time.monotonic() - start, parameters.changes()
        scene = scene.recorded("epmfit", key, options.to_json(), seconds, notes.findings, changes)
        scene.save(scene_path)
    for path in tiles_paths:
        write_tiles(scene, path)
    report = fit_report(scene).of(scene_title(scene, scene_path))
    for path in report_paths:
        report.write(path, notes)
    errors = [view.error for tile in scene.tiles for view in tile.views.values()]
    rmse, largest = float(np.sqrt(np.mean([e.rmse**2 for e in errors]))), max(e.max for e in errors)
    progress.step(1.0, "cameras fitted")
    return EpmFitResult(
        workspace=options.workspace,
        tiles=tiles_paths[-1],
        report=report_paths[-1],
        scene=scene_path,
        rmse=rmse,
        max_error=largest,
    )


def _key(options: EpmFitOptions, parameters: EngineParameters = ENGINE) -> str:
    wanted = {k: v for k, v in options.to_json().items() if k not in ("workspace", "tiles", "report")}
    named = options.rpcs or ("",) * len(options.images)
    sidecars = [path for image, rpc in zip(options.images, named) for path in ([rpc] if rpc else rpc_sidecars(image))]
    sidecars += [path for image in options.images for path in time_sidecars(image) if path not in sidecars]
    rasters = map(raster_identity, [*options.images, *filter(None, [options.dem, *options.masks])])
    return fingerprint("epmfit", wanted, *rasters, *map(file_identity, sidecars), *parameters.in_fingerprint())


def _fit(options: EpmFitOptions, masks: Path, parameters: EngineParameters, progress: Progress) -> Scene:
    views = views_of(options, parameters.tiles.least_overlap_px, progress.warn)
    _log_views(views, progress)
    views = _coarser_first(views)
    crs = _crs(options, views)
    lon, lat = middle_of(views)
    warn_all(progress, metric_at(crs, lon, lat).finding(crs))
    search = common_heights(views)
    area = _area(views, crs, search, options, parameters.tiles)
    views, search = with_planes(
        views,
        crs,
        Bounds(*bounds_of(area)),
        search=search,
        dem=options.dem,
        progress=Part(progress, 0.0, 0.3),
        sweep=parameters.pointing.planning.sweep,
        parameters=parameters.pointing.planning.planes,
    )
    ends, part, sweep = (
        (options.altitude_min, options.altitude_max),
        Part(progress, 0.0, 0.6),
        parameters.pointing.planning.sweep,
    )
    if options.extent is not None:
        known = [*search, *(end for end in ends if end is not None)]
        views = _parted(views, crs, area, (min(known), max(known)))
        for view in views:
            require_content(view.image, view.part)
    found: List[View] = []
    for view in views:
        progress.step(0.0, f"black ends of {view.name}")
        found.append(without_empty_ends(view, masks / f"{view.name}.tif", progress))
    views = tuple(found)
    altitudes, source = altitude_range(
        views,
        crs,
        bounds_of(area),
        search=search,
        given=ends,
        dem=options.dem,
        progress=part,
        parameters=sweep,
        altitudes=parameters.altitudes,
    )
    progress.info(f"Altitudes {altitudes[0]:.0f} to {altitudes[1]:.0f} m above the ellipsoid (from: {source}).")
    area = _area(views, crs, altitudes, options, parameters.tiles)
    if options.extent is not None:
        views = _parted(views, crs, area, altitudes)
    xmin, ymin, xmax, ymax = bounds_of(area)
    lon, lat = geodetic_from_projected(crs, np.array([(xmin + xmax) / 2, (ymin + ymax) / 2]))
    frame = EnuFrame(float(lon), float(lat), 0.0)
    scene = Scene(views, frame, crs, area.ExportToWkt(), altitudes, (), dem=options.dem or "")
    size = options.tile_size or _automatic_size(scene, area, options.error_budget, parameters.tiles, progress)
    _require_count(scene, area, size, parameters.tiles)
    scene = replace(scene, tiles=_tiles(scene, lay_tiles(area, size * scene.gsd_m), progress))
    progress.info(f"{counted(len(scene.tiles), 'tile')} of up to {size} px a side.")
    return scene


def _coarser_first(views: Sequence[View]) -> Tuple[View, ...]:
    """The views of coarser sensors before those of finer ones, and alike ones in their order: a pair of two sensors has
    the same tie points, pointing and heights in whichever order IMAGES names it."""
    classes = common_gsd_m([view.gsd_m for view in views])
    return tuple(view for view, _ in sorted(zip(views, classes), key=lambda each: -each[1]))


def _log_views(views: Sequence[View], progress: Progress) -> None:
    """The images, and at which ground sampling distance those of different sensors are matched."""
    finest, coarsest = (choose(view.gsd_m for view in views) for choose in (min, max))
    if len(views) > _MOST_NAMED:
        pixels = sum(view.width * view.height for view in views) / 1e6
        progress.info(f"{len(views)} images with {pixels:.0f} million pixels of {finest:.2f} to {coarsest:.2f} m.")
    else:
        taken = [f", taken {v.time:%Y-%m-%d %H:%M:%S} UTC" if v.time else "" for v in views]
        satellites = [f", {v.sensor}" if v.sensor else "" for v in views]
        sizes = (f"{v.name}: {v.width} x {v.height} px of {v.gsd_m:.2f} m" for v in views)
        progress.info("; ".join(map("".join, zip(sizes, satellites, taken))))
    if coarsest > SAMPLING.alike * finest:
        progress.info(
            f"The images' ground sampling distances are {finest:.2f} to {coarsest:.2f} m: each pair is matched at that "
            "of its coarser image, to which the finer one is reduced; tiles and cells follow the finest pair "
            f"({finest_gsd_m(views):.2f} m)."
        )


def _parted(views: Sequence[View], crs: str, area: ogr.Geometry, altitudes: Altitudes) -> Tuple[View, ...]:
    """The views with the windows that show an area at these altitudes, and the margin that tiles are matched with."""
    around = Bounds(*bounds_of(area)).grown(STEREO.tile_margin_px * min(view.gsd_m for view in views))

    def part(view: View) -> Optional[Window]:
        window = pixel_window(
            view.project, partial(geodetic_from_projected, crs), around, altitudes=altitudes, size=view.size
        )
        return None if window == (0, 0, *view.size) else window

    return tuple(replace(view, part=part(view)) for view in views)


def _crs(options: EpmFitOptions, views: Sequence[View]) -> str:
    lon, lat = middle_of(views)
    if options.crs:
        projected_crs_at(options.crs, lon, lat)
        return options.crs
    return utm_crs(lon, lat)


def _area(
    views: Sequence[View], crs: str, altitudes: Altitudes, options: EpmFitOptions, parameters: TileParameters
) -> ogr.Geometry:
    """The ground that two views, or the only one, see at some altitude of the range, within the requested extent."""
    area = common_ground(views, crs, altitudes)
    least = (parameters.least_overlap_px * min(v.gsd_m for v in views)) ** 2
    if area.IsEmpty() or area.GetArea() < least:
        range_ = f"{altitudes[0]:.0f} to {altitudes[1]:.0f} m above the ellipsoid"
        remedy = "give the heights of this ground as ALTITUDE_MIN and ALTITUDE_MAX, or a DEM of it"
        if len(views) == 1:
            raise OverlapError(f"{views[0].name} sees no ground at altitudes of {range_}: {remedy}.")
        raise OverlapError(f"The images share no ground at altitudes of {range_}: {remedy}.")
    see = "what two images see" if len(views) > 1 else "what the image sees"
    if options.extent is None:
        return area
    common = area.Intersection(_extent(options, options.extent, crs, area))
    if common is None or common.IsEmpty() or common.GetArea() < least:
        if common is not None and not common.IsEmpty():
            shares = f"shares only {common.GetArea():.3g} m² with {see}"
            raise OptionError(
                "EXTENT", list(options.extent), f"{shares}: draw at least {math.sqrt(least):.0f} m a side"
            )
        back = pyproj.Transformer.from_crs(crs, options.extent_crs, always_xy=True)
        wanted, seen = (_range_text(ends) for ends in (options.extent, back.transform_bounds(*bounds_of(area))))
        place = f"EXTENT {wanted} ({options.extent_crs}) lies outside {see}: {seen}"
        raise OverlapError(f"{place}. Draw it there, or leave it empty.")
    return common


def _range_text(bounds: Sequence[float]) -> str:
    """Bounds xmin, ymin, xmax, ymax as text: degrees to a metre or so, metres whole."""
    digits = 5 if max(map(abs, bounds)) <= 360 else 0
    xmin, ymin, xmax, ymax = (f"{value:.{digits}f}" for value in bounds)
    return f"x {xmin} to {xmax}, y {ymin} to {ymax}"


def _extent(options: EpmFitOptions, extent: Extent, crs: str, area: ogr.Geometry) -> ogr.Geometry:
    """The requested extent, cut to the surroundings of an area, as its bounding box in the scene's CRS. Places far away
    have no coordinates in that CRS: an extent may be the whole Earth.
    """
    try:
        transformer = pyproj.Transformer.from_crs(options.extent_crs, crs, always_xy=True)
        around = bounds_of(area)
        reach = max(around[2] - around[0], around[3] - around[1])
        near = transformer.transform_bounds(*Bounds(*around).grown(reach), direction="INVERSE")
        xmin, ymin, xmax, ymax = (*map(max, extent[:2], near[:2]), *map(min, extent[2:], near[2:]))
        if xmin >= xmax or ymin >= ymax:
            return ogr.Geometry(ogr.wkbPolygon)
        return box(transformer.transform_bounds(xmin, ymin, xmax, ymax))
    except pyproj.exceptions.ProjError as error:
        raise OptionError("EXTENT", options.extent, f"cannot be brought into {crs} ({error})") from error


def _fitting(scene: Scene, parameters: TileParameters) -> Sequence[int]:
    """The automatic sizes, px, that a cluster's smallest worker can match; the smallest one where none is."""
    limit, sizes = task_mib(), parameters.sizes_px
    if limit is None:
        return sizes
    disparities = (scene.altitudes[1] - scene.altitudes[0]) / scene.gsd_m  # of views with a base as long as the height
    return [size for size in sizes if planned_mib(size, disparities) <= limit] or sizes[-1:]


def _automatic_size(
    scene: Scene, area: ogr.Geometry, budget: float, parameters: TileParameters, progress: Progress
) -> int:
    """The largest tile whose refined equivalent error keeps to the budget at the area's centre and ends."""
    xmin, ymin, xmax, ymax = bounds_of(area)
    places = [(xmin + f * (xmax - xmin), ymin + f * (ymax - ymin)) for f in (0.5, 0.1, 0.9)]

    def error_of(size: int) -> float:
        half = size * scene.gsd_m / 2
        fitted = (fit_tile(scene, GroundTile("", Bounds(x - half, y - half, x + half, y + half))) for x, y in places)
        errors = [
            refine_pinhole("polynomial", view.camera, grid, window=view.window).error.rmse
            for tile, grids in fitted
            for view, grid in zip(tile.views.values(), grids)
        ]
        return max(errors, default=0.0)

    size, error = largest_within(budget, _fitting(scene, parameters), error_of)
    if error > budget:
        left, range_m = f"{error:.2f} px of equivalent error", scene.altitudes[1] - scene.altitudes[0]
        progress.warn(
            Finding(
                "tiles-smallest",
                f"Tiles of {size} px, the smallest, still have {left} after refinement (budget {budget:g} px), "
                f"because the altitude range is {range_m:.0f} m; heights are computed with the RPCs and are not "
                "affected.",
            )
        )
    return size


def fit_tile(scene: Scene, ground: GroundTile) -> Tuple[Tile, List[VirtualGrid]]:
    """Cameras of all views that see a tile, with the virtual grids they were fitted to."""
    views, grids, to_geodetic = {}, [], partial(geodetic_from_projected, scene.crs)
    for view in scene.views:
        window = pixel_window(view.project, to_geodetic, ground.bounds, altitudes=scene.altitudes, size=view.size)
        if window is None:
            continue
        grid = virtual_grid(view.localise, window, scene.altitudes, scene.frame, VIRTUAL_GRID.tile)
        fitted = fit_pinhole(grid)
        views[view.name] = TileView(window, fitted.camera, fitted.error)
        grids.append(grid)
    return Tile(ground.id, ground.bounds, scene.altitudes, views), grids


def _require_count(scene: Scene, area: ogr.Geometry, size: int, parameters: TileParameters) -> None:
    """Raise OptionError where tiles of this size would be too many."""
    xmin, ymin, xmax, ymax = bounds_of(area)
    sides = (xmax - xmin) / scene.gsd_m, (ymax - ymin) / scene.gsd_m
    count = math.ceil(sides[0] / size) * math.ceil(sides[1] / size)
    if count > parameters.most_tiles:
        least = 100 * math.ceil(math.sqrt(sides[0] * sides[1] / parameters.most_tiles) / 100)
        most = f"makes {count} tiles of {sides[0]:.0f} x {sides[1]:.0f} px, and {parameters.most_tiles} are the most"
        raise OptionError("TILE_SIZE", size, f"{most}: choose {least} px or more, 0 for automatic, or a smaller EXTENT")


def _tiles(scene: Scene, grounds: Sequence[GroundTile], progress: Progress) -> Tuple[Tile, ...]:
    tiles, least = [], min(len(scene.views), 2)
    for index, ground in enumerate(grounds):
        progress.check_cancelled()
        progress.step(0.6 + 0.4 * index / len(grounds), f"cameras of tile {index + 1} of {len(grounds)}")
        tile, _ = fit_tile(scene, ground)
        if len(tile.views) >= least:
            tiles.append(tile)
    if not tiles:
        who = "two images" if least > 1 else "the image"
        raise OverlapError(f"No tile is seen by {who} (tiles: {len(grounds)}): choose a larger EXTENT or TILE_SIZE.")
    return tuple(tiles)


def write_tiles(scene: Scene, path: str) -> None:
    """The TILES layer: outlines with each view's equivalent error in px."""
    from ..reports.styles import write_style

    fields: Dict[str, type] = {"tile": str, "worst_rmse": float, "worst_max": float}
    for number in range(1, max(len(tile.views) for tile in scene.tiles) + 1):
        fields[f"view_{number}"] = str
        fields.update({f"{name}_{number}": float for name in ("samp", "line", "rmse", "max")})
    rows = []
    for tile in scene.tiles:
        errors = [view.error for view in tile.views.values()]
        values: List[object] = [tile.id, max(e.rmse for e in errors), max(e.max for e in errors)]
        for name, view in tile.views.items():
            values += [name, view.error.samp_rmse, view.error.line_rmse, view.error.rmse, view.error.max]
        rows.append((box(tile.bounds), values))
    write_layer(path, scene.crs, ogr.wkbPolygon, fields, rows)
    write_style("tiles", path)
