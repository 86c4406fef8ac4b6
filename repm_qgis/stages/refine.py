"""Find, for every tile and view, the map M that makes the pinhole camera (almost) exact (paper, Algorithm 2)."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import List, Optional, Tuple

import numpy as np
import pyproj

from ..contracts.errors import OptionError
from ..contracts.options import RefineOptions
from ..contracts.results import RefineResult
from ..fusion.own_surface import lon_lat_bounds, own_surface
from ..geometry.equivalent_error import RefinedPinhole, refine_pinhole, virtual_grid
from ..geometry.parameters import VIRTUAL_GRID
from ..imagery.dem import load_surface, make_surface
from ..imagery.raster import raster_identity, write
from ..names import scene_title
from ..planning.disk_space import images_need, require_space
from ..reports.stage_reports import refine_report
from ..runtime.memory import refining_mib, tile_work, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress, Recorder
from ..runtime.together import join
from ..runtime.workspace import ensure_folder, fingerprint
from ..scene import Scene, Tile, folder_of, reusable
from .parameters import ENGINE, EngineParameters

_BATCH = 32  # tiles of a task that writes no images: starting processes costs as much as the maps of some hundred tiles


def run(options: RefineOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> RefineResult:
    """Refine all tiles; gives the refined scene and the report."""
    start, notes = time.monotonic(), Recorder(progress)
    scene = Scene.load(options.scene)
    if options.write_images:
        scene.require_images()
    dem = raster_identity(options.dem) if options.dem else None
    chosen = options.model, options.order, options.kernel, dem, options.write_images
    key = fingerprint("refine", scene.fingerprint, *chosen, *parameters.in_fingerprint())
    report_path = options.report or str(Path(options.output_scene).with_name("refinement.html"))
    done = reusable(options.output_scene, "refine", key)
    if done is not None and all(os.path.exists(v.image) for t in done.tiles for v in t.views.values() if v.image):
        progress.info(f"Reused the refinement ({done.refinement}) in '{options.output_scene}'.")
        scene = done
    else:
        if options.write_images:
            require_space("refinement", [images_need(scene, options.output_scene)], progress)
            images = ensure_folder(str(folder_of(Path(options.output_scene), "refined")))
            join(str(images), [f"{tile.id}_{name}.tif" for tile in scene.tiles for name in tile.views])
        scene = _refine(replace(scene, path=Path(options.output_scene)), options, parameters, notes)
        if options.write_images:
            scene.require_same_images()
        seconds, changes = time.monotonic() - start, parameters.changes()
        scene = scene.recorded("refine", key, options.to_json(), seconds, notes.findings, changes)
        scene.save(options.output_scene)
    refine_report(scene).of(scene_title(scene, options.output_scene)).write(report_path, notes)
    errors = [view.refined.error for tile in scene.tiles for view in tile.views.values() if view.refined]
    rmse, largest = float(np.sqrt(np.mean([e.rmse**2 for e in errors]))), max(e.max for e in errors)
    progress.info(f"Equivalent error after {scene.refinement} refinement: RMSE {rmse:.3f} px, max {largest:.3f} px.")
    progress.step(1.0, "images refined")
    return RefineResult(output_scene=options.output_scene, report=report_path, rmse=rmse, max_error=largest)


def _refine(scene: Scene, options: RefineOptions, parameters: EngineParameters, progress: Progress) -> Scene:
    scene = replace(scene, refinement=options.model, order=options.order)
    if options.model == "terrain":
        scene = with_surface(scene, _source(scene, options, parameters, progress), parameters, progress)
    return refined_tiles(
        scene, options.workers, options.memory, progress, options.kernel if options.write_images else None
    )


def with_surface(scene: Scene, source: str, parameters: EngineParameters, progress: Progress) -> Scene:
    """The scene with the terrain model, whose surface is made from the heights in a raster."""
    cell, path = parameters.tiles.surface_px * scene.gsd_m, str(scene.folder("surface") / "surface.tif")
    surface = make_surface(source, lon_lat_bounds(scene, parameters.fusion), cell, path)
    heights = load_surface(surface).heights
    cells, range_ = f"{heights.shape[1]} x {heights.shape[0]} cells", f"{heights.min():.0f} to {heights.max():.0f} m"
    progress.info(f"Refined on a surface of {cells}, {range_}, from '{source}'.")
    return replace(scene, refinement="terrain", surface=surface)


def refined_tiles(scene: Scene, workers: int, memory: int, progress: Progress, kernel: Optional[str] = None) -> Scene:
    """Find M for every tile and view by the scene's model; with a ``kernel``, write the refined images too."""
    size, lean = 1 if kernel else _BATCH, scene.lean()
    tasks = [RefineTask(lean, scene.tiles[at : at + size], kernel) for at in range(0, len(scene.tiles), size)]
    widest = max(view.window.width for tile in scene.tiles for view in tile.views.values())
    work = tile_work(widest, refining_mib(widest if kernel else 0))
    done = run_tasks(_refined, tasks, workers_within(workers, work, memory, progress), progress, _describe)
    return replace(scene, tiles=tuple(tile for tiles in done for tile in tiles))


@dataclass(frozen=True)
class RefineTask:
    """All a worker needs: the scene without its tiles, some of these, and the kernel of their images (None: none)."""

    scene: Scene
    tiles: Tuple[Tile, ...]
    kernel: Optional[str]


def _describe(task: RefineTask) -> str:
    return f"refining tile {task.tiles[-1].id}"


def _refined(task: RefineTask) -> List[Tile]:
    scene, tiles = task.scene, []
    for tile in task.tiles:
        views = {}
        for name, seen in tile.views.items():
            model = scene.view(name).model
            grid = virtual_grid(model.localise, seen.window, tile.altitudes, scene.frame, VIRTUAL_GRID.tile)
            terrain, order = scene.terrain(model), scene.order
            refined = refine_pinhole(
                scene.refinement, seen.camera, grid, window=seen.window, order=order, terrain=terrain
            )
            image = _write_image(scene, tile.id, name, refined, task.kernel) if task.kernel else seen.image
            views[name] = replace(seen, refined=refined, image=image)
        tiles.append(replace(tile, views=views))
    return tiles


def _source(scene: Scene, options: RefineOptions, parameters: EngineParameters, progress: Progress) -> str:
    """The raster that the coarse surface comes from: the DEM that is given, else the scene's own heights."""
    if options.dem:
        return options.dem
    if any(tile.heights for tile in scene.tiles):
        cell, path = parameters.tiles.surface_px * scene.gsd_m, str(scene.folder("surface") / "own_heights.tif")
        grid, heights = own_surface(scene, cell, 1, memory=0, progress=progress, parameters=parameters.fusion)
        wkt = pyproj.CRS.from_user_input(scene.crs).to_wkt()
        return write(path, [heights], grid.geotransform, wkt, unit="m")
    remedy = "a scene that has heights already ('Reconstruct heights' with another MODEL first)"
    reason = f"needs a surface: give a DEM, or {remedy}; 'Make a DSM' finds the surface by itself"
    raise OptionError("MODEL", options.model, reason)


def _write_image(scene: Scene, tile: str, name: str, refined: RefinedPinhole, kernel: str) -> str:
    """The refined image of a tile, in 16 bits; 0 is nodata."""
    from ..imagery.raster import RasterFrame, created, opened
    from ..imagery.warping import warp_strips

    view = scene.view(name)
    path = str(scene.folder("refined") / f"{tile}_{name}.tif")
    metadata, kind = {"REPM_VIEW": name, "REPM_TILE": tile}, np.dtype(np.uint16)
    file = created(path, RasterFrame(refined.size[::-1], kind), nodata=0, metadata=metadata)
    with opened(view.image) as dataset, file as target:
        to_original = refined.to_original.original_from_refined
        for row, pixels in warp_strips(dataset, view.band, to_original, refined.size, kernel):
            known = np.isfinite(pixels)
            whole = np.clip(np.rint(np.where(known, pixels, 0)), 1, 65535)
            target.write(np.where(known, whole, 0).astype(kind), 0, row)
    return path
