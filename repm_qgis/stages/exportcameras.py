"""Write refined images with their pinhole cameras, one model a tile, for COLMAP, MVSNet, SatMVS or nerfstudio."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import numpy as np

from .. import __version__
from ..contracts.errors import OptionError, SceneError, WorkspaceError
from ..contracts.findings import Finding
from ..contracts.options import ExportCamerasOptions
from ..contracts.results import ExportCamerasResult
from ..exports import FORMATS
from ..exports.formats import ExportFormat
from ..exports.images import write_image
from ..exports.model import TileModel, tile_model
from ..exports.ties import tie_points
from ..imagery.enhancement import Stretch
from ..runtime.progress import Progress
from ..runtime.together import join
from ..runtime.workspace import ensure_folder, whole_folder, write_text
from ..scene import Scene, Tile

_MARK = "repm-cameras"
_FRAME_FILE = "frame.json"


def run(options: ExportCamerasOptions, progress: Progress) -> ExportCamerasResult:
    """Export the tiles; gives the folder, the models' folders in it, and how many images they hold."""
    written_as = FORMATS[options.format]
    written_as.require()
    scene = Scene.load(options.scene)
    scene.require_images()
    tiles = _tiles(scene, options.tile)
    # Everything is checked before anything is written.
    refined = scene.record_of("refine")
    reuse = refined is not None and refined.options.get("kernel") == options.kernel
    models = [written_as.prepare(_model(scene, tile, reuse, options.centre)) for tile in tiles]
    folder = ensure_folder(options.folder)
    places = [folder / tile.id for tile in tiles]
    for place in places:
        _check_place(place, options.format)
    join(str(folder), [tile.id for tile in tiles])
    names = sorted({view.name for model in models for view in model.views} if options.bits == "8" else ())
    stretches = {name: scene.view(name).stretch() for name in names}
    count, done = sum(len(model.views) for model in models), 0
    for model, place in zip(models, places):
        points, residuals = tie_points(scene, model.tile)
        whole = replace(model, points=points, residuals_px=residuals)
        _write_model(
            scene,
            whole,
            written_as,
            place=place,
            options=options,
            stretches=stretches,
            progress=progress,
            done=(done, count),
        )
        done += len(model.views)
    error = max(view.error.max for model in models for view in model.views)
    rmse = float(np.sqrt(np.mean([view.error.rmse**2 for model in models for view in model.views])))
    errors = f"the cameras hold to RMSE {rmse:.3f} px, max {error:.3f} px"
    progress.info(f"{count} images with cameras in '{folder}', for {options.format}; {errors}.")
    for view in scene.views:
        if view.jitter is not None:
            progress.warn(
                Finding(
                    "camera-without-jitter",
                    f"A camera cannot hold the jitter of {view.name}, waves of up to {view.jitter.most_px:.2f} px "
                    "over its lines: the camera only contains their mean, and products of software that uses the "
                    "cameras contain the rest.",
                )
            )
    progress.step(1.0, "cameras exported")
    return ExportCamerasResult(folder=str(folder), models=tuple(map(str, places)), images=count)


def _tiles(scene: Scene, name: str) -> List[Tile]:
    if not scene.refinement:
        remedy = "run 'Refine the images' first, and export the scene that it writes"
        raise SceneError(f"The scene '{scene.path}' is not refined: {remedy}.")
    tiles = [tile for tile in scene.tiles if name in ("", tile.id)]
    if not tiles:
        raise OptionError("TILE", name, f"must be one of {', '.join(tile.id for tile in scene.tiles)}, or empty")
    return tiles


def _model(scene: Scene, tile: Tile, reuse_images: bool, centre: bool) -> TileModel:
    model = tile_model(scene, tile, reuse_images)
    return replace(model, views=tuple(view.centred() for view in model.views)) if centre else model


def _check_place(place: Path, layout: str) -> None:
    """Raise WorkspaceError where the export would replace anything but an earlier export of this format."""
    if not place.exists() or (place.is_dir() and not any(place.iterdir())):
        return
    try:
        with open(place / _FRAME_FILE, encoding="utf-8") as stream:
            found = json.load(stream)
        ours = found["format"] == _MARK and found["layout"] == layout
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        ours = False
    if not ours:
        remedy = "choose another FOLDER, or remove it"
        raise WorkspaceError(f"'{place}' is there already and is no export for {layout}: {remedy}.")


def _write_model(
    scene: Scene,
    model: TileModel,
    written_as: ExportFormat,
    *,
    place: Path,
    options: ExportCamerasOptions,
    stretches: Dict[str, Stretch],
    progress: Progress,
    done: Tuple[int, int],
) -> None:
    """One tile's folder, whole or not at all."""
    images = written_as.images(model, options.bits)
    with whole_folder(str(place)) as folder:
        for index, (view, image) in enumerate(zip(model.views, images)):
            progress.check_cancelled()
            progress.step((done[0] + index) / done[1], f"tile {model.tile.id}, {view.name}")
            mask: Optional[str] = written_as.mask(image)
            mask_path, stretch = folder / mask if mask else None, stretches.get(view.name)
            write_image(view, folder / image, mask_path, stretch, options.kernel, progress)
        scene.require_same_images()  # before the folder gets its name
        written_as.write(model, images, folder)
        write_text(str(folder / _FRAME_FILE), json.dumps(_frame(model, images, options), indent=1, allow_nan=False))


def _frame(model: TileModel, images: Tuple[str, ...], options: ExportCamerasOptions) -> Dict[str, object]:
    """Where the cameras' world lies on the Earth, and the file of each image."""
    origin, ecef = model.frame.to_mapping(), model.frame.ecef_from_enu.tolist()
    return {
        "format": _MARK,
        "layout": options.format,
        "engine": __version__,
        "tile": model.tile.id,
        "world": {"axes": "east, north, up in metres on WGS 84", "origin": origin, "ecef_from_world": ecef},
        "crs": model.crs,
        "bounds": list(model.tile.bounds),
        "altitudes_m": list(model.tile.altitudes),
        "points": len(model.points),
        "images": [
            {
                "file": image,
                "view": view.name,
                "original": view.view.image,
                "depths_m": list(view.depths),
                "equivalent_error_px": view.error.to_mapping(),
                "pointing_px": view.shift_px.tolist(),
            }
            for view, image in zip(model.views, images)
        ],
    }
