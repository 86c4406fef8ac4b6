"""Find, for every tile and view, the map M that makes the pinhole camera (almost) exact (paper, Algorithm 2)."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any, Dict

import numpy as np

from ..evaluation.stage_reports import refine_report
from ..geometry.equivalent_error import refine_pinhole, virtual_grid
from ..options import RefineOptions
from ..progress import Progress, Recorder
from ..scene import Scene, reusable
from ..workspace import fingerprint


def run(options: RefineOptions, progress: Progress) -> Dict[str, Any]:
    """Refine all tiles; gives the refined scene and the report."""
    start = time.monotonic()
    scene = Scene.load(options.scene)
    key = fingerprint("refine", scene.fingerprint, options.model, options.write_images)
    report_path = options.report or str(Path(options.output_scene).with_name("refinement.html"))
    done = reusable(options.output_scene, "refine", key)
    if done is not None:
        progress.info(f"Reused the refinement ({done.refinement}) in '{options.output_scene}'.")
        scene = done
    else:
        notes = Recorder(progress)
        scene.path = Path(options.output_scene)
        _refine(scene, options, notes)
        scene.record("refine", key, options.to_json(), time.monotonic() - start, warnings=notes.warnings)
        scene.save(options.output_scene)
    refine_report(scene).write(report_path)
    errors = [view.refined.error for tile in scene.tiles for view in tile.views.values()]
    rmse = float(np.sqrt(np.mean([e.rmse ** 2 for e in errors])))
    progress.info(f"Equivalent error after {scene.refinement} refinement: RMSE {rmse:.3f} px, max "
                  f"{max(e.max for e in errors):.3f} px.")
    progress.step(1.0, "images refined")
    return {"output_scene": options.output_scene, "report": report_path, "rmse": rmse,
            "max_error": max(e.max for e in errors)}


def _refine(scene: Scene, options: RefineOptions, progress: Progress) -> None:
    scene.refinement = options.model
    for index, tile in enumerate(scene.tiles):
        progress.step(index / len(scene.tiles), f"tile {index + 1} of {len(scene.tiles)}")
        for name, tile_view in tile.views.items():
            progress.check_cancelled()
            grid = virtual_grid(scene.view(name).localise, tile_view.window, tile.altitudes, scene.frame)
            tile_view.refined = refine_pinhole(options.model, tile_view.camera, grid, tile_view.window)
            if options.write_images:
                tile_view.image = _write_image(scene, tile.id, name, tile_view)


def _write_image(scene: Scene, tile: str, name: str, tile_view: Any) -> str:
    """The refined image of a tile, in the original's data type; 0 is nodata."""
    from ..imagery.raster import created, opened
    from ..imagery.warping import warp

    view = scene.view(name)
    path = str(scene.folder("refined") / f"{tile}_{name}.tif")
    with opened(view.image) as dataset:
        pixels = warp(dataset, view.band, tile_view.refined.to_original.original_from_refined, tile_view.refined.size)
    values = np.where(np.isfinite(pixels), np.clip(np.rint(pixels), 1, 65535), 0).astype(np.uint16)
    with created(path, values.shape, values.dtype, 1, None, "", nodata=0,
                 metadata={"REPM_VIEW": name, "REPM_TILE": tile}) as target:
        target.write(values)
    return os.path.relpath(path, scene.path.parent)


