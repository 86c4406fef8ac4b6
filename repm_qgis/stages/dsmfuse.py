"""Fuse height maps into a DSM with confidence, orthophoto and point cloud."""

from __future__ import annotations

import math
import shutil
import time
from contextlib import ExitStack
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import pyproj

from .. import __version__
from ..dsm.aggregation import automatic_radius
from ..dsm.ept import require_ept_place, write_ept
from ..dsm.fusion import FuseTask, StoredTile, fuse_to_disk
from ..dsm.grid import CellGrid
from ..dsm.holes import REACH_CELLS, fill_holes
from ..dsm.mesh import write_mesh
from ..dsm.ortho import nadir_first
from ..dsm.point_cloud import created_cloud
from ..dsm.seams import blended
from ..errors import EmptyResultError, SceneError
from ..evaluation.styles import height_limits, write_style
from ..geometry.frames import geodetic_from_projected, projected_crs_at
from ..geometry.surface import Surface
from ..geometry.tiles import enclosing
from ..geometry.vertical import TAG, HeightDatum
from ..imagery.dem import load_surface, make_surface
from ..imagery.raster import created
from ..imagery.sampling import upsample_grid
from ..memory import fusing_mib, workers_within
from ..options import DsmFuseOptions
from ..parallel import run_tasks
from ..progress import Progress
from ..scene import Scene, Tile
from ..workspace import ensure_folder, temporary_name

_LATTICE = 17   # nodes a side of what is smooth: the undulation, the map to longitude and latitude
_CONFIDENCE_BANDS = ("height maps that agree", "spread between them (m)", "mean matching score",
                     "source: 0 matched, 1 background of an occlusion, 2 interpolated, 3 interpolated on the DEM")
_INTERPOLATED, _SHAPED = 2, 3
_WINDOW = 1024  # cells a side that are filled at once


def run(options: DsmFuseOptions, progress: Progress) -> Dict[str, Any]:
    """Grid, aggregate, filter and write; gives the products' paths and the share of valid cells."""
    start = time.monotonic()
    scene = Scene.load(options.scene)
    tiles = [tile for tile in scene.tiles if tile.heights]
    if not tiles:
        raise SceneError(f"The scene '{options.scene}' has no height maps: run 'Reconstruct heights' first.")
    crs = options.crs or scene.crs
    projected_crs_at(crs, scene.frame.lon, scene.frame.lat)
    datum = HeightDatum.of(options.vertical_datum)
    datum.require(scene.frame.lon, scene.frame.lat)
    if options.ept:
        require_ept_place(options.ept)
    grid, windows = _layout(scene, tiles, crs, options.resolution or _round_cell(2.0 * scene.gsd_m))
    radius = automatic_radius(grid.cell, scene.gsd_m) if options.outlier_radius is None else options.outlier_radius
    progress.info(f"DSM of {grid.shape[1]} x {grid.shape[0]} cells of {grid.cell:g} m in {crs}, heights above the "
                  f"{datum.name}; outlier radius {radius:g} m.")
    views = tuple(nadir_first(scene)) if options.ortho else ()
    tasks = [FuseTask(scene.lean(), tile.bounds, tuple(tile.heights), grid, window, crs, options.method, options.fill,
                      radius, views, bool(options.cloud or options.ept)) for tile, window in zip(tiles, windows)]
    workers = _workers(options, scene, tiles, windows, progress)
    folder = temporary_name(str(scene.path.with_name("fusion")))
    try:
        ensure_folder(folder)
        stored = run_tasks(fuse_to_disk, [(task, f"{folder}/{i}.npz") for i, task in enumerate(tasks)], workers,
                           progress, lambda work: f"fusing {work[0].records[0]['tile']}")
        facts = _write(options, scene, grid, crs, datum, windows, stored, folder)
        cloud = _cloud_path(options, folder) if facts["points"] else None
        shown = _write_for_display(options, cloud, datum.file_crs(crs), progress)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    _tell(facts, radius, [tile.needed for tile in stored], options, progress)
    progress.step(1.0, "DSM fused")
    return {"output": options.output, "confidence": options.confidence, "ortho": options.ortho,
            "cloud": options.cloud, **shown, "vertical_datum": datum.name,
            "seconds": round(time.monotonic() - start, 3), **facts}


def _workers(options: DsmFuseOptions, scene: Scene, tiles: List[Tile], windows: List[Tuple[int, int, int, int]],
             progress: Progress) -> int:
    """How many workers the memory allows, by the tile that takes most."""
    each, tile = max(((fusing_mib([r["size"][0] * r["size"][1] for r in tile.heights], window[2] * window[3]), tile)
                      for tile, window in zip(tiles, windows)), key=lambda pair: pair[0])
    side = max(tile.bounds[2] - tile.bounds[0], tile.bounds[3] - tile.bounds[1]) / scene.gsd_m
    return workers_within(options.workers, each, options.memory, math.ceil(side), progress)


def _round_cell(cell: float) -> float:
    """Two significant digits: a cell of 1.0 m, not of 1.0122 m."""
    return float(f"{cell:.2g}")


def _layout(scene: Scene, tiles: List[Tile], crs: str,
            cell: float) -> Tuple[CellGrid, List[Tuple[int, int, int, int]]]:
    """The DSM's grid, and the window of each tile: in the scene's CRS every cell belongs to one of them."""
    transformer = None if crs == scene.crs else pyproj.Transformer.from_crs(scene.crs, crs, always_xy=True)
    boxes = [tile.bounds if transformer is None else transformer.transform_bounds(*tile.bounds) for tile in tiles]
    grid = CellGrid.covering(enclosing(boxes), cell)
    return grid, [grid.window(box) for box in boxes]


def _write(options: DsmFuseOptions, scene: Scene, grid: CellGrid, crs: str, datum: HeightDatum,
           windows: List[Tuple[int, int, int, int]], stored: List[StoredTile],
           folder: str) -> Dict[str, Any]:
    wkt = pyproj.CRS.from_user_input(crs).to_wkt()
    metadata = {"REPM_SCENE": scene.fingerprint, "REPM_ENGINE": __version__, "REPM_METHOD": options.method,
                "REPM_FILL": options.fill, TAG: datum.name}
    crop = _valid_part(grid, windows, stored)
    valid, cells = sum(tile.valid for tile in stored), sum(tile.cells for tile in stored)
    if not valid:
        raise EmptyResultError(f"None of {cells} cells of the DSM has a height: check the reconstruction's report.")
    with ExitStack() as stack:
        def raster(path: Optional[str], bands: Tuple[str, ...], unit: str, file_crs: str = wkt) -> Any:
            if not path:
                return None
            return stack.enter_context(created(
                path, (crop[3], crop[2]), np.dtype(np.float32), len(bands), grid.part(crop).geotransform, file_crs,
                descriptions=bands, metadata=metadata, unit=unit, cog=True))

        dsm = raster(options.output, (f"height above the {datum.name} (m)",), "m", datum.file_crs(crs))
        confidence = raster(options.confidence, _CONFIDENCE_BANDS, "")
        ortho = raster(options.ortho, ("brightness",), "")
        # What is interpolated needs the heights of neighbouring tiles: they meet in a raster of their own first.
        whole = stack.enter_context(created(
            f"{folder}/heights.tif", (crop[3], crop[2]), np.dtype(np.float32), 1, None, "", compress=False)) \
            if options.fill == "all" else None
        cloud_path = _cloud_path(options, folder)
        cloud = stack.enter_context(created_cloud(cloud_path, datum.file_crs(crs), (grid.west, grid.north, 0.0))) \
            if cloud_path else None
        tolerance = float(np.median([record["metres_per_px"] for tile in scene.tiles for record in tile.heights]))
        for index, (window, tile) in enumerate(zip(windows, stored)):
            place, cut = _placed(window, crop)
            if place is None:
                continue
            result = tile.load()
            fused = result.fused
            keep = result.own is not None
            # Turned tiles overlap in their windows: there each keeps to its own cells.
            height = fused.height if keep else blended(fused.height, index, windows, stored, grid.shape, tolerance)
            if whole is None:
                height = height - _undulation(datum, crs, grid.part(window))
            _put(dsm if whole is None else whole, [height], place, cut, keep)
            count = np.where(fused.count > 0, fused.count, np.nan)
            source = np.where(np.isfinite(fused.height), fused.filled, np.nan)
            _put(confidence, [count, fused.spread, fused.score, source], place, cut, keep)
            _put(ortho, [result.ortho], place, cut, keep)
            if cloud is not None:
                x, y, height, score = result.points.T
                cloud.write(x, y, height - datum.undulation(crs, np.column_stack([x, y])), score)
        points = cloud.count if cloud is not None else 0
        interpolated = 0 if whole is None else _fill(whole, dsm, confidence, scene, grid.part(crop), crs, datum, folder)
    for kind, path in (("dsm", options.output), ("confidence", options.confidence), ("ortho", options.ortho)):
        if path:
            write_style(kind, path)
    return {"cells": cells, "valid": valid + interpolated, "valid_percent": 100.0 * (valid + interpolated) / cells,
            "matched": valid - sum(tile.filled for tile in stored), "background": sum(tile.filled for tile in stored),
            "interpolated": interpolated, "points": points, "removed": sum(tile.removed for tile in stored),
            "resolution": grid.cell, "crs": crs}


def _fill(whole: Any, dsm: Any, confidence: Any, scene: Scene, grid: CellGrid, crs: str, datum: HeightDatum,
          folder: str) -> int:
    """Write the DSM from the raster of all tiles' heights, holes filled window by window; gives how many cells were."""
    surface = _terrain_of(scene, grid, crs, folder)
    count = 0
    for row in range(0, grid.shape[0], _WINDOW):
        for col in range(0, grid.shape[1], _WINDOW):
            c0, r0 = max(col - REACH_CELLS, 0), max(row - REACH_CELLS, 0)
            c1, r1 = (min(start + _WINDOW + REACH_CELLS, size) for start, size in zip((col, row), grid.shape[::-1]))
            height = whole.read((c0, r0, c1 - c0, r1 - r0))
            holes = bool(np.isnan(height).any())
            base = _on_cells(surface, grid.part((c0, r0, c1 - c0, r1 - r0)), crs) if surface and holes else None
            height, filled = fill_holes(height, base)
            own = np.s_[row - r0:row - r0 + _WINDOW, col - c0:col - c0 + _WINDOW]
            cells = grid.part((col, row, *height[own].shape[::-1]))
            dsm.write((height[own] - _undulation(datum, crs, cells)).astype(np.float32), col, row)
            if confidence is not None and filled[own].any():
                source = np.where(filled[own], np.float32(_INTERPOLATED if base is None else _SHAPED), np.nan)
                confidence.write(source.astype(np.float32), col, row, len(_CONFIDENCE_BANDS), keep=True)
            count += int(filled[own].sum())
    return count


def _terrain_of(scene: Scene, grid: CellGrid, crs: str, folder: str) -> Optional[Surface]:
    """The DEM that the scene was made with, over the grid; None where there was none."""
    dem = scene.facts("epmfit").get("options", {}).get("dem")
    if not dem:
        return None
    xs, ys = grid.centres()
    lon_lat = geodetic_from_projected(crs, np.array([(x, y) for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])]))
    bounds = (*lon_lat.min(axis=0), *lon_lat.max(axis=0))
    return load_surface(make_surface(str(dem), tuple(map(float, bounds)), grid.cell, f"{folder}/dem.tif"))


def _on_cells(surface: Surface, grid: CellGrid, crs: str) -> np.ndarray:
    """Heights of a surface at the cells' centres; the map to longitude and latitude is smooth, a lattice will do."""
    xs, ys = grid.centres()
    lattice = np.stack(np.meshgrid(np.linspace(xs[0], xs[-1], _LATTICE), np.linspace(ys[0], ys[-1], _LATTICE)), axis=-1)
    lon_lat = upsample_grid(geodetic_from_projected(crs, lattice), grid.shape)
    return surface.height(lon_lat[..., 0], lon_lat[..., 1])


def _cloud_path(options: DsmFuseOptions, folder: str) -> Optional[str]:
    """Where the cloud is written: an EPT is made of one that nobody asked to keep, too."""
    return options.cloud or (f"{folder}/cloud.laz" if options.ept else None)


def _write_for_display(options: DsmFuseOptions, cloud: Optional[str], crs: str, progress: Progress) -> Dict[str, Any]:
    """What is made of the finished cloud and DSM, in the DSM's colours."""
    made: Dict[str, Any] = {"ept": None, "mesh": None}
    if options.ept and cloud:
        facts = write_ept(cloud, options.ept, crs, progress)
        write_style("ept", f"{options.ept}/ept.json", height_limits(options.output))
        progress.info(f"EPT of {facts['points']} points in {facts['nodes']} nodes.")
        made["ept"] = options.ept
    elif options.ept:
        progress.warn("No matched point lies on the DSM: the EPT is not written.")
    if options.mesh:
        facts = write_mesh(options.output, options.mesh, options.mesh_vertices, progress)
        write_style("mesh", options.mesh, height_limits(options.output))
        thinned = f", one of {facts['step']} rows and columns (MESH_VERTICES)" if facts["step"] > 1 else ""
        progress.info(f"Mesh of {facts['vertices']} vertices and {facts['faces']} triangles{thinned}.")
        made["mesh"] = options.mesh
    return made


def _undulation(datum: HeightDatum, crs: str, grid: CellGrid) -> np.ndarray:
    """(rows, columns) to take off ellipsoidal heights; geoids are smooth, and evaluated on a lattice."""
    xs, ys = grid.centres()
    if not datum.code or not len(xs) or not len(ys):
        return np.zeros(grid.shape)
    nodes = np.meshgrid(np.linspace(xs[0], xs[-1], _LATTICE), np.linspace(ys[0], ys[-1], _LATTICE))
    return upsample_grid(datum.undulation(crs, np.stack(nodes, axis=-1)), grid.shape)


def _valid_part(grid: CellGrid, windows: List[Tuple[int, int, int, int]],
                stored: List[StoredTile]) -> Tuple[int, int, int, int]:
    """The window of the grid that holds all heights: tiles reach beyond what the images see."""
    ends = [(col + tile.columns[0], row + tile.rows[0], col + tile.columns[1], row + tile.rows[1])
            for (col, row, _, _), tile in zip(windows, stored) if tile.columns and tile.rows]
    if not ends:
        return 0, 0, grid.shape[1], grid.shape[0]
    c0, r0 = min(end[0] for end in ends), min(end[1] for end in ends)
    return c0, r0, max(end[2] for end in ends) - c0 + 1, max(end[3] for end in ends) - r0 + 1


def _placed(window: Tuple[int, int, int, int], crop: Tuple[int, int, int, int]) -> Tuple[Any, Any]:
    """Where a tile's cells go in the cropped raster, and which of them."""
    c0, r0 = max(window[0], crop[0]), max(window[1], crop[1])
    c1, r1 = min(window[0] + window[2], crop[0] + crop[2]), min(window[1] + window[3], crop[1] + crop[3])
    if c0 >= c1 or r0 >= r1:
        return None, None
    cut = (slice(r0 - window[1], r1 - window[1]), slice(c0 - window[0], c1 - window[0]))
    return (c0 - crop[0], r0 - crop[1]), cut


def _put(raster: Any, bands: List[Any], place: Tuple[int, int], cut: Any, keep: bool) -> None:
    if raster is not None:
        for index, values in enumerate(bands, start=1):
            raster.write(values[cut].astype(np.float32), *place, index, keep)


def _tell(facts: Dict[str, Any], radius: float, needed: List[int], options: DsmFuseOptions,
          progress: Progress) -> None:
    """What was filtered and filled, in the log."""
    if radius > 0:
        asked = f"{min(needed)}" if min(needed) == max(needed) else f"{min(needed)} to {max(needed)}, by tile"
        progress.info(f"{facts['removed']} cells removed that have fewer neighbours within {radius:g} m than a "
                      f"fifth of what is usual ({asked}).")
    shares = {name: 100.0 * facts[name] / facts["cells"] for name in ("matched", "background", "interpolated")}
    progress.info(f"Heights in {facts['valid_percent']:.1f} % of {facts['cells']} cells that the tiles cover: "
                  f"{shares['matched']:.1f} % matched, {shares['background']:.1f} % from the background of occlusions, "
                  f"{shares['interpolated']:.1f} % interpolated.")
    if facts["interpolated"] and not options.confidence:
        progress.warn(f"{facts['interpolated']} cells of '{options.output}' are interpolated, not measured: ask for "
                      "CONFIDENCE to see which (band 4).")
    if facts["valid_percent"] < 20:
        progress.warn(f"Only {facts['valid_percent']:.0f} % of the cells have a height: look at the confidence and at "
                      "the reconstruction's report before you use this DSM.")
