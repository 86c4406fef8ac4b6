"""Where tie points are searched: patches spread over a scene, at the places with the best texture."""

from __future__ import annotations

import math
from typing import Callable, Dict, List, Sequence, Tuple

import cv2
import numpy as np
from osgeo import ogr

from ..contracts.arrays import Bounds, FloatArray, Window
from ..geometry.footprints import bounds_of, box, footprint, geometry_of
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.tiles import enclosing
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked, read
from ..runtime.progress import Progress
from ..scene import Scene
from .parameters import TIES, PatchParameters

Pair = Tuple[str, str]
Texture = Callable[[Bounds], float]
"""How suitable a patch is: more is better."""


def covered_by_ties(scene: Scene, parameters: PatchParameters = TIES.patches) -> bool:
    """Whether a scene is so small that all of it is searched for tie points."""
    return _side(scene) <= parameters.whole_px * scene.gsd_m


def _side(scene: Scene) -> float:
    """The scene's longer side, m."""
    xmin, ymin, xmax, ymax = enclosing([tile.bounds for tile in scene.tiles])
    return max(xmax - xmin, ymax - ymin)


def ranked_patches(
    scene: Scene, texture: Texture, progress: Progress, parameters: PatchParameters
) -> List[List[Bounds]]:
    """For each cell of the scene, the patches to search, those with the best texture first."""
    bounds = np.array([tile.bounds for tile in scene.tiles])
    low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    if covered_by_ties(scene, parameters):
        return [[Bounds.between(low, high)]]
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


def common_ground(scene: Scene, pairs: Sequence[Pair]) -> Dict[Pair, ogr.Geometry]:
    """For each pair of views, the part of the scene's area that both see at its middle altitude, in the scene's CRS."""
    area, altitude = ogr.CreateGeometryFromWkt(scene.area), sum(scene.altitudes) / 2
    shapes = {}
    for name in {name for pair in pairs for name in pair}:
        view = scene.view(name)
        outline = footprint(view.localise, view.size, altitude)
        shapes[name] = geometry_of(projected_from_geodetic(scene.crs, outline))
    return {pair: shapes[pair[0]].Intersection(shapes[pair[1]]).Intersection(area) for pair in pairs}


def is_block(scene: Scene, ground: Dict[Pair, ogr.Geometry], parameters: PatchParameters) -> bool:
    """Whether a scene is a block of frames: most pairs see a small part of its area only."""
    whole = ogr.CreateGeometryFromWkt(scene.area).GetArea()
    return bool(np.median([shared.GetArea() for shared in ground.values()]) < parameters.block_share * whole)


class BlockPatches:
    """Where the ties of a block of frames are searched: some patches on the ground of each pair.

    Patches that an earlier pair has got count for all pairs that see them. ``texture`` is given a patch and the pair.
    """

    def __init__(
        self,
        scene: Scene,
        ground: Dict[Pair, ogr.Geometry],
        texture: Callable[[Bounds, Pair], float],
        parameters: PatchParameters,
    ) -> None:
        self._ground, self._texture, self._parameters = ground, texture, parameters
        self._side = parameters.most_px * scene.gsd_m
        self._chosen: List[Bounds] = []

    def first(self, progress: Progress) -> List[Bounds]:
        """Patches for all pairs."""
        for pair in self._ground:
            progress.check_cancelled()
            self._add(pair, self._parameters.frame_patches)
        return list(self._chosen)

    def more(self, pairs: Sequence[Pair]) -> List[Bounds]:
        """As many patches again for pairs with too few ties, as far as there is room."""
        before = len(self._chosen)
        for pair in pairs:
            self._add(pair, len(self._on(pair)) + self._parameters.frame_patches)
        return self._chosen[before:]

    def seeing(self, place: Bounds) -> List[Pair]:
        """The pairs that see enough of a patch."""
        least = self._parameters.frame_seen
        return [pair for pair, shared in self._ground.items() if _share_within(place, shared) >= least]

    def _on(self, pair: Pair) -> List[Bounds]:
        least = self._parameters.frame_inside
        return [place for place in self._chosen if _share_within(place, self._ground[pair]) >= least]

    def _add(self, pair: Pair, wanted: int) -> None:
        """Patches on a pair's ground, those with the best texture first, until it has so many."""
        missing, shared = wanted - len(self._on(pair)), self._ground[pair]
        if missing <= 0 or not shared.GetArea() > 0:
            return
        bounds = bounds_of(shared)
        extent = np.array([bounds.xmax - bounds.xmin, bounds.ymax - bounds.ymin])
        side = min(self._side, float(extent.max()) / 2)
        places = _places(np.array(bounds[:2]), extent, side, self._parameters.frame_places)
        inside = {place: _share_within(place, shared) for place in places}
        most = min(self._parameters.frame_inside, max(inside.values()))
        free = [place for place in places if inside[place] >= most and self._is_apart(place)]
        for place in sorted(free, key=lambda place: -self._texture(place, pair)):
            if missing > 0 and self._is_apart(place):
                self._chosen.append(place)
                missing -= 1

    def _is_apart(self, place: Bounds) -> bool:
        return all(_share_within(place, box(other)) <= self._parameters.frame_apart for other in self._chosen)


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
