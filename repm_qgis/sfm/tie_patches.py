"""Where tie points are searched: patches spread over a scene, at the places with the best texture."""

from __future__ import annotations

import math
from typing import Callable, Dict, List

import cv2
import numpy as np
from osgeo import ogr

from ..arrays import Bounds, FloatArray, Window
from ..geometry.footprints import box
from ..geometry.frames import geodetic_from_projected
from ..geometry.tiles import enclosing
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked, read
from ..progress import Progress
from ..scene import Scene
from .parameters import POINTING, PatchParameters

Texture = Callable[[Bounds], float]
"""How suitable a patch is: more is better."""


def covered_by_ties(scene: Scene, parameters: PatchParameters = POINTING.patches) -> bool:
    """Whether a scene is so small that all of it is searched for tie points."""
    return _side(scene) <= parameters.whole_px * scene.gsd_m


def _side(scene: Scene) -> float:
    """The scene's longer side, m."""
    xmin, ymin, xmax, ymax = enclosing([Bounds(*tile.bounds) for tile in scene.tiles])
    return max(xmax - xmin, ymax - ymin)


def ranked_patches(
    scene: Scene, texture: Texture, progress: Progress, parameters: PatchParameters
) -> List[List[Bounds]]:
    """For each cell of the scene, the patches to search, those with the best texture first."""
    bounds = np.array([tile.bounds for tile in scene.tiles])
    low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    if covered_by_ties(scene, parameters):
        return [[Bounds(*map(float, (*low, *high)))]]
    area = ogr.CreateGeometryFromWkt(scene.area)
    least, most = (px * scene.gsd_m for px in (parameters.least_px, parameters.most_px))
    side = float(np.clip(_side(scene) / parameters.scene_patches, least, most))
    cells = np.ceil((high - low) / (parameters.cell_patches * side))
    cells = np.clip(cells, parameters.least_cells, parameters.most_cells)
    cells = np.maximum(np.minimum(cells, np.ceil((high - low) / side)), 1).astype(int)
    step = (high - low) / cells
    result = []
    for i, j in np.ndindex(*cells):
        progress.check_cancelled()
        places = _places(low + step * (i, j), step, side, parameters.places)
        places = [place for place in places if _share_within(place, area) > parameters.least_inside]
        if len(places) > 1:
            places.sort(key=lambda place: -texture(place))
        if places:
            result.append(places)
    return result


def _places(corner: FloatArray, step: FloatArray, side: float, most: int) -> List[Bounds]:
    """Squares of a side (or less) evenly over a cell, its middle first; at most so many along a side."""

    def starts(low: float, length: float) -> List[float]:
        if length <= side:
            return [low]
        return list(np.linspace(low, low + length - side, min(math.ceil(length / side), most)))

    width, height = min(side, step[0]), min(side, step[1])
    corners = [(x, y) for x in starts(corner[0], step[0]) for y in starts(corner[1], step[1])]
    places = [Bounds(float(x), float(y), float(x + width), float(y + height)) for x, y in corners]
    middle = corner + step / 2
    return sorted(places, key=lambda p: math.hypot((p[0] + p[2]) / 2 - middle[0], (p[1] + p[3]) / 2 - middle[1]))


def _share_within(place: Bounds, area: ogr.Geometry) -> float:
    shape = box(place)
    shared = shape.Intersection(area)
    return 0.0 if shared is None else float(shared.GetArea() / shape.GetArea())


def texture_of(scene: Scene, stretches: Dict[str, Stretch], place: Bounds, parameters: PatchParameters) -> float:
    """Texture around a patch's middle in the view that shows the least of it, so that clouds and water are avoided.

    Each view that does not show the patch halves the value.
    """
    middle = np.array([[(place[0] + place[2]) / 2, (place[1] + place[3]) / 2]])
    ground = np.append(geodetic_from_projected(scene.crs, middle)[0], sum(scene.altitudes) / 2)
    values, missed = [], 0
    for name, stretch in stretches.items():
        view = scene.view(name)
        side = int(0.5 * (place[2] - place[0]) / view.gsd_m)
        corner = np.round(view.project(ground) - side / 2)
        low = np.maximum(corner, 0)
        size = np.minimum(corner + side, view.size) - low
        if not np.isfinite(corner).all() or (size < side / 2).any():
            missed += 1
            continue
        window = Window(*(int(v) for v in (*low, *size)))
        with opened_masked(view.image, view.mask, overviews=False) as dataset:
            pixels = read(dataset, window, view.band, (window.width // 2, window.height // 2))
        intensity = np.nan_to_num(stretch.apply(pixels), nan=0.0)
        gradients = np.sqrt(np.maximum(cv2.cornerMinEigenVal(intensity, parameters.texture_px), 0))
        values.append(float(np.quantile(gradients, parameters.texture_quantile)))
    return 0.0 if len(values) < 2 else min(values) * parameters.missed_weight**missed
