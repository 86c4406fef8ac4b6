"""How the equivalent error depends on the refinement, the image's size and the altitude: the paper's Section 4.2."""

from __future__ import annotations

from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray
from ..geometry.equivalent_error import EquivalentError, fit_pinhole, refine_pinhole, virtual_grid
from ..geometry.parameters import VIRTUAL_GRID
from ..geometry.refinement import Terrain
from ..scene import Scene, View
from . import charts
from .report import Report, fixed

_SIZES, _LEVELS = 7, 11
_TILES, _VIEWS = 9, 15
_MODELS = ("homography", "polynomial")

Curves = Dict[str, Tuple[FloatArray, FloatArray]]


def _errors_by_model(
    view: View,
    scene: Scene,
    window: Tuple[float, float, float, float],
    altitudes: Altitudes,
    models: Sequence[str],
    terrain: Optional[Terrain] = None,
) -> Dict[str, EquivalentError]:
    """The error over a window (col, row, width, height) without correction and after each refinement."""
    grid = virtual_grid(view.model.localise, window, altitudes, scene.frame, VIRTUAL_GRID.tile)
    fitted = fit_pinhole(grid)
    errors = {"uncorrected": fitted.error}
    for model in models:
        errors[model] = refine_pinhole(
            model, fitted.camera, grid, window=window, order=scene.order, terrain=terrain
        ).error
    return errors


def _errors_by_size(view: View, scene: Scene) -> Curves:
    """RMSE of windows of growing side around an image's middle: for each model the sides and errors, px."""
    largest = min(view.width, view.height)
    sides = np.unique(np.geomspace(min(512, largest / 2), largest, _SIZES).round())
    curves: Dict[str, List[float]] = {}
    for side in map(float, sides):
        window = ((view.width - side) / 2, (view.height - side) / 2, side, side)
        for model, error in _errors_by_model(view, scene, window, scene.altitudes, ("polynomial",)).items():
            curves.setdefault(model, []).append(error.rmse)
    return {model: (sides, np.array(values)) for model, values in curves.items()}


def _errors_by_altitude(view: View, scene: Scene) -> Curves:
    """RMSE over the whole image at each altitude of the scene's range: for each model the altitudes and errors."""
    window = (0.0, 0.0, float(view.width), float(view.height))
    grid = virtual_grid(view.model.localise, window, scene.altitudes, scene.frame, (13, 13, _LEVELS))
    fitted = fit_pinhole(grid)
    refined = refine_pinhole("polynomial", fitted.camera, grid, window=window)
    after = refined.to_original.original_from_refined(refined.camera.project(grid.enu))
    curves = {"uncorrected": fitted.camera.project(grid.enu) - grid.pixels, "polynomial": after - grid.pixels}
    levels = np.linspace(*scene.altitudes, _LEVELS)
    nearest = np.abs(grid.ground[:, 2:] - levels).argmin(axis=1)

    def rmse(error: FloatArray) -> FloatArray:
        return np.array([np.sqrt((error[nearest == k] ** 2).sum(axis=1).mean()) for k in range(_LEVELS)])

    return {model: (levels, rmse(error)) for model, error in curves.items()}


def add_error_study(report: Report, scene: Scene) -> None:
    """The table of the four models and the two curves, as a section of a report."""
    rows = []
    tiles = scene.tiles[:: max(1, len(scene.tiles) // _TILES)][:_TILES]
    views = scene.views[:: -(-len(scene.views) // _VIEWS)]
    for view in views:
        terrain = scene.terrain(view.model)  # the model is measured only where there is a surface
        models = _MODELS + (("terrain",) if terrain is not None else ())
        found = [
            _errors_by_model(view, scene, tile.views[view.name].window, tile.altitudes, models, terrain)
            for tile in tiles
            if view.name in tile.views
        ]
        for model in found[0] if found else ():
            errors = np.array([(e.samp_rmse, e.line_rmse, e.rmse) for e in (entry[model] for entry in found)])
            largest = max(entry[model].max for entry in found)
            rows.append([view.name, model, *fixed(*np.sqrt(np.mean(errors**2, axis=0)), largest, decimals=4)])
    report.section("What each refinement leaves").table(
        "view | model | Samp RMSE, px | Line RMSE, px | RMSE, px | Max, px",
        rows,
        f"Measured over {len(tiles)} of {len(scene.tiles)} tiles and in {len(views)} of {len(scene.views)} images. The "
        "terrain model, where there is a surface, is measured within 10 m of the surface.",
    )
    view = scene.views[0]
    by_size = charts.curves(_errors_by_size(view, scene), "side of the window, px", "RMSE, px")
    report.svg(by_size, f"Equivalent error against image size, middle of {view.name}.")
    by_altitude = charts.curves(_errors_by_altitude(view, scene), "altitude, m", "RMSE, px")
    report.svg(by_altitude, f"Equivalent error against altitude, all of {view.name}.")
