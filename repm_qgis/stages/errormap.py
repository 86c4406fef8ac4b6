"""Map a view's equivalent error on the ground, in the scene's CRS."""

from __future__ import annotations

import time
from typing import Tuple

import numpy as np
import pyproj

from ..contracts.arrays import FloatArray
from ..contracts.checks import as_text
from ..contracts.errors import OptionError
from ..contracts.options import ErrorMapOptions
from ..contracts.results import ErrorMapResult
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..geometry.interpolation import on_lattice
from ..geometry.tiles import enclosing
from ..imagery.raster import RasterFrame, created, opened
from ..names import scene_title
from ..reports.stage_reports import errormap_report
from ..reports.styles import write_style
from ..reports.verdict import of_error_map
from ..runtime.progress import Progress, Recorder, warn_all
from ..scene import Scene, Tile, View

_BANDS = ("magnitude (px)", "column (px)", "row (px)", "worst over the altitudes (px)")
_CELLS = 1000  # cells along the longer side of the map
_NODE_STEP = 8  # cells between exact errors; the error is smooth
_LEVELS = 5
_FACTS = ("REPM_VIEW", "REPM_ALTITUDE_M", "REPM_REFINEMENT")
_UNREFINED = "uncorrected"


def run(options: ErrorMapOptions, progress: Progress) -> ErrorMapResult:
    """Write the error map (four bands), its style and the report; gives RMSE and maximum at the altitude, px."""
    start = time.monotonic()
    scene = Scene.load(options.scene)
    view = scene.view(options.view) if options.view else scene.views[0]
    altitude = sum(scene.altitudes) / 2 if options.altitude is None else options.altitude
    if not scene.altitudes[0] - 1.0 <= altitude <= scene.altitudes[1] + 1.0:
        limits = "{:.0f} to {:.0f} m above the ellipsoid".format(*scene.altitudes)
        raise OptionError("ALTITUDE", altitude, f"must lie in the scene's range, {limits}: cameras were fitted there")
    tiles = [tile for tile in scene.tiles if view.name in tile.views]
    if not tiles:
        raise OptionError("VIEW", view.name, "sees none of the scene's tiles: choose another view")
    whole = enclosing([tile.bounds for tile in tiles])
    cell = max(scene.gsd_m, float(f"{max(whole[2] - whole[0], whole[3] - whole[1]) / _CELLS:.1g}"))
    grid = CellGrid.covering(whole, cell)
    squares, count, worst = 0.0, 0, 0.0
    refinement = scene.refinement or _UNREFINED
    metadata = dict(zip(_FACTS, (view.name, altitude, refinement)))
    wkt = pyproj.CRS.from_user_input(scene.crs).to_wkt()
    frame = RasterFrame(grid.shape, np.float32, len(_BANDS), grid.geotransform, wkt)
    with created(options.output, frame, descriptions=_BANDS, unit="px", metadata=metadata, cog=True) as raster:
        for index, tile in enumerate(tiles):
            progress.check_cancelled()
            progress.step(index / len(tiles), f"error of tile {index + 1} of {len(tiles)}")
            window = grid.window(tile.bounds)
            if not window[2] or not window[3]:
                continue
            error = _tile_error(scene, view, tile, grid.part(window), altitude)
            for band, values in enumerate(error, start=1):
                raster.write(values.astype(np.float32), window[0], window[1], band)
            known = error[0][np.isfinite(error[0])]
            squares, count = squares + float((known**2).sum()), count + known.size
            worst = max(worst, float(known.max(initial=0.0)))
    if not count:
        raise OptionError("VIEW", view.name, "sees nothing of the tiles at this altitude: choose another altitude")
    rmse = float(np.sqrt(squares / count))
    write_style("error", options.output)
    run = Recorder(progress)
    warn_all(run, of_error_map(rmse, bool(scene.refinement)))
    if options.report:
        report = errormap_report(scene, view, options.output, rmse, worst, altitude)
        report.of(scene_title(scene, options.scene)).write(options.report, run)
    errors = f"equivalent error RMSE {rmse:.2g} px, max {worst:.2g} px ({refinement})"
    progress.info(f"{view.name} at {altitude:.0f} m: {errors}.")
    progress.step(1.0, "error mapped")
    return ErrorMapResult(
        output=options.output,
        report=options.report,
        rmse=rmse,
        max_error=worst,
        altitude=altitude,
        seconds=round(time.monotonic() - start, 3),
    )


def map_title(path: str) -> str:
    """What an error map shows: its view, altitude, and whether that is before or after the refinement."""
    with opened(path) as dataset:
        view, altitude, refinement = (as_text(dataset.GetMetadataItem(name) or "") for name in _FACTS)
    when = "before refinement" if refinement == _UNREFINED else "after refinement"
    return f"{view}, {float(altitude):.0f} m, {when}"


def _tile_error(
    scene: Scene, view: View, tile: Tile, grid: CellGrid, altitude: float
) -> Tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Magnitude, column and row at the altitude, and the worst magnitude over the tile's altitudes; NaN outside."""
    column, row = np.moveaxis(_on_cells(scene, view, tile, altitude, grid), -1, 0)
    magnitude = np.hypot(column, row)
    worst = magnitude
    for level in np.linspace(*tile.altitudes, _LEVELS):
        other = _on_cells(scene, view, tile, float(level), grid)
        worst = np.fmax(worst, np.hypot(other[..., 0], other[..., 1]))
    return magnitude, column, row, worst


def _on_cells(scene: Scene, view: View, tile: Tile, altitude: float, grid: CellGrid) -> FloatArray:
    """(rows, columns, 2) errors of all cells, interpolated from the nodes; NaN where the image does not see a cell."""

    def exact(xy: FloatArray) -> FloatArray:
        return np.concatenate(error_at(scene, view, tile, geodetic_from_projected(scene.crs, xy), altitude), axis=-1)

    columns, rows = (max(2, n // _NODE_STEP + 1) for n in grid.size)
    both = on_lattice(*grid.centres(), exact, (columns, rows))
    pixels = both[..., 2:]
    inside = ((pixels > -1) & (pixels < (view.width, view.height))).all(axis=-1, keepdims=True)
    return np.where(inside, both[..., :2], np.nan)


def error_at(
    scene: Scene, view: View, tile: Tile, lon_lat: FloatArray, altitude: float
) -> Tuple[FloatArray, FloatArray]:
    """(..., 2) pinhole minus RPC pixel at ground nodes, the refined camera's where there is one; and the RPC pixel."""
    ground = np.concatenate([lon_lat, np.full(lon_lat.shape[:-1] + (1,), altitude)], axis=-1)
    # The vendor's RPC: pointing corrections, found later, are no error of the camera.
    pixels = view.model.project(ground)
    fitted = tile.views[view.name]
    enu = scene.frame.from_geodetic(ground)
    if fitted.refined is None:
        seen = fitted.camera.project(enu)
    else:
        seen = fitted.refined.to_original.original_from_refined(fitted.refined.camera.project(enu))
    return seen - pixels, pixels
