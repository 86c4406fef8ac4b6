"""Tie points: the same ground points found in several images, in original-image pixels.

SIFT (Lowe 2004) on a few patches spread over the scene, where its texture is best: the pinhole cameras say which rows
and columns a match may have, so only few candidates compete and repetitive roofs do little harm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray
from osgeo import ogr

from ..arrays import FloatArray
from ..errors import EmptyResultError
from ..geometry.equivalent_error import RefinedPinhole
from ..geometry.footprints import box
from ..geometry.frames import geodetic_from_projected
from ..geometry.refinement import apply_homography
from ..geometry.tiles import enclosing
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked, read
from ..imagery.warping import warp
from ..parallel import run_tasks
from ..progress import Part, Progress, counted
from ..scene import Scene, View
from ..stereo.pairing import ground_points, grown, rectify_over, refined_view
from ..stereo.rectification import RectifiedPair
from .keypoints import CPU_DETECTOR, Detector

Bounds = Tuple[float, float, float, float]
Pair = Tuple[str, str]

_REDUCTION = 2.0  # SIFT on half-size images: a sixth of the time, ties enough
_SMALL_PX, _SMALL_PATCH_PX = 500, 300  # images of a scene, of a patch below this side need all their pixels for ties
_FEATURES_PER_MPX = 2500
_FEATURES = (600, 4000)  # of a scene that is one patch, at least and at most
_LEAST_FEATURES = 300  # of each of several patches, which share those of a scene
_SPARE_FEATURES = 3  # times as many to choose an even spread from
_BUCKETS = 12  # a side of a patch, for an even spread of features
_WHOLE_PX = 1600  # a scene up to this side is one patch
_CELLS = 5  # a side of a larger scene, at most; each cell gives one patch at a time
_LEAST_CELLS = 3
_CELL_PATCHES = 3  # patches a side of a cell, at least: ties of a ninth of a scene are enough
_PATCH_PX = (300, 500)  # a side of a patch: a sixth of the scene, within these
_PLACES = 6  # a side of a cell, at most, that are looked at for the best patch
_MARGIN_PX = 24
_TOLERANCE_PX = 64.0  # vendor RPCs are off by up to tens of px, each view in its own way
_NEAR_PX = 8.0  # of a patch's row difference, once that is known
_CLOSE_PX = 2.5  # of a patch's trend of row differences, at last
_LIKELY_PX = 6.0  # of the scene's row difference: trends over the images are smaller
_NEIGHBOURS, _SUPPORT = 10, 3
_KD_TREE, _ALL = 4, -1  # FLANN's single tree, which finds the nearest ones exactly where it may look at all
_STEP_PX, _SLOPE = 6.0, 0.4  # of disparity between neighbours: a house, and a share of their distance
_RATIO = 0.85
_MIN_TIES = 12
_ENOUGH_TIES = 100  # with fewer, more patches are searched
_ROUNDS = 5


@dataclass(frozen=True)
class PairMatches:
    """Matches of two views: (N, 2) original pixels in each, and the (N,) row differences before any correction."""

    first: str
    second: str
    first_px: FloatArray
    second_px: FloatArray
    rows_px: FloatArray


@dataclass(frozen=True)
class _Features:
    """A view over a patch: its refined camera, SIFT keypoints (N, 2) in refined pixels, descriptors (N, 128)."""

    view: View
    camera: RefinedPinhole
    points: FloatArray
    descriptors: NDArray[np.float32]


@dataclass(frozen=True)
class _PatchTask:
    """What a worker needs to match all pairs over one patch; ``scene`` is without its tiles."""

    scene: Scene
    bounds: Bounds
    pairs: Tuple[Pair, ...]
    stretches: Dict[str, Stretch]
    detector: Detector
    small_px: int
    features: int


def find_ties(
    scene: Scene,
    pairs: Sequence[Pair],
    stretches: Dict[str, Stretch],
    progress: Progress,
    workers: int = 0,
    detector: Detector = CPU_DETECTOR,
) -> List[PairMatches]:
    """Match pairs of views on patches spread over the scene; more patches where the first give too few.

    ``workers`` 0 means one a core. Raises DetectorError where the detector's device fails, and EmptyResultError with
    the counts where a pair gives fewer than a dozen trustworthy ties.
    """
    wanted = tuple((first, second) for first, second in pairs)
    names = {name for pair in wanted for name in pair}
    used = {name: stretch for name, stretch in stretches.items() if name in names}
    cells = _ranked_patches(scene, used, progress)
    parts: Dict[Pair, List[PairMatches]] = {pair: [] for pair in wanted}
    lean, small_px = scene.lean(), _SMALL_PX if len(cells) == 1 else _SMALL_PATCH_PX
    for number in range(_ROUNDS):
        tasks = [
            _PatchTask(
                lean, cell[number], wanted, used, detector, small_px, max(_LEAST_FEATURES, _FEATURES[1] // len(cells))
            )
            for cell in cells
            if number < len(cell)
        ]
        if not tasks:
            break
        part = Part(progress, 1 - 0.5**number, 1 - 0.5 ** (number + 1), "tie points")
        for found in run_tasks(_match_patch, tasks, detector.workers(workers), part, lambda _: "patch"):
            for pair, matches in found.items():
                parts[pair].append(matches)
        if all(len(_agreeing(*pair, found)[0]) >= _ENOUGH_TIES for pair, found in parts.items()):
            break
    return [_consistent(first, second, found) for (first, second), found in parts.items()]


def covered_by_ties(scene: Scene) -> bool:
    """Whether a scene is so small that all of it is searched for ties."""
    return _side(scene) <= _WHOLE_PX * scene.gsd_m


def _side(scene: Scene) -> float:
    """The scene's longer side, m."""
    xmin, ymin, xmax, ymax = enclosing([tile.bounds for tile in scene.tiles])
    return max(xmax - xmin, ymax - ymin)


def _patch_side(scene: Scene) -> float:
    """A patch's side, m: nine patches search a quarter of a small scene, which gives ties enough."""
    return float(np.clip(_side(scene) / 6, *(px * scene.gsd_m for px in _PATCH_PX)))


def _ranked_patches(scene: Scene, stretches: Dict[str, Stretch], progress: Progress) -> List[List[Bounds]]:
    """For each cell of the scene, ground rectangles to search, the most promising first."""
    bounds = np.array([tile.bounds for tile in scene.tiles])
    low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    if covered_by_ties(scene):
        return [[(*map(float, low), *map(float, high))]]
    area = ogr.CreateGeometryFromWkt(scene.area)
    side = _patch_side(scene)
    cells = np.clip(np.ceil((high - low) / (_CELL_PATCHES * side)), _LEAST_CELLS, _CELLS)
    cells = np.maximum(np.minimum(cells, np.ceil((high - low) / side)), 1).astype(int)
    step = (high - low) / cells
    result = []
    for i, j in np.ndindex(*cells):
        progress.check_cancelled()
        corner = low + step * (i, j)
        places = [place for place in _places(corner, step, side) if _mostly_within(place, area)]
        if len(places) > 1:
            places.sort(key=lambda place: -_texture(scene, stretches, place))
        if places:
            result.append(places)
    return result


def _places(corner: FloatArray, step: FloatArray, side: float) -> List[Bounds]:
    """Squares of a side (or less) evenly over a cell, its middle first."""

    def starts(low: float, length: float) -> List[float]:
        if length <= side:
            return [low]
        count = min(math.ceil(length / side), _PLACES)
        return list(np.linspace(low, low + length - side, count))

    width, height = min(side, step[0]), min(side, step[1])
    places = [
        (float(x), float(y), float(x + width), float(y + height))
        for x in starts(corner[0], step[0])
        for y in starts(corner[1], step[1])
    ]
    middle = corner + step / 2
    return sorted(places, key=lambda p: math.hypot((p[0] + p[2]) / 2 - middle[0], (p[1] + p[3]) / 2 - middle[1]))


def _mostly_within(place: Bounds, area: ogr.Geometry) -> bool:
    shape = box(place)
    shared = shape.Intersection(area)
    return shared is not None and shared.GetArea() > 0.3 * shape.GetArea()


def _texture(scene: Scene, stretches: Dict[str, Stretch], place: Bounds) -> float:
    """How much there is to hold on to around a place's middle, in the view that shows the least: clouds and water.

    A view that does not show it counts as half as good as the others.
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
        window = tuple(int(v) for v in (*low, *size))
        with opened_masked(view.image, view.mask) as dataset:
            pixels = read(dataset, window, view.band, (window[2] // 2, window[3] // 2))
        grey = np.nan_to_num(stretch.apply(pixels), nan=0.0)
        values.append(float(np.quantile(np.sqrt(np.maximum(cv2.cornerMinEigenVal(grey, 5), 0)), 0.9)))
    return 0.0 if len(values) < 2 else min(values) * 0.5**missed


def _match_patch(task: _PatchTask) -> Dict[Pair, PairMatches]:
    """Matches of all pairs over one patch; pairs without any are left out."""
    coarsest = max(task.scene.view(name).gsd_m for name in task.stretches)
    features: Dict[str, _Features] = {}
    for name in task.stretches:
        found = _features(task, task.scene.view(name), coarsest)
        if found is not None:
            features[name] = found
    result = {}
    for first, second in task.pairs:
        if first in features and second in features:
            matches = _match(task.scene, features[first], features[second], task.bounds)
            if matches is not None:
                result[first, second] = matches
    return result


def _features(task: _PatchTask, view: View, coarsest_m: float) -> Optional[_Features]:
    """Keypoints and descriptors of a view over a patch; None where it shows too little."""
    scene = task.scene
    camera = refined_view(scene, view, grown(task.bounds, _MARGIN_PX * scene.gsd_m), scene.altitudes)
    if camera is None:
        return None
    # All views at one sampling distance: most keypoints are of the smallest size there is, and must meet their like.
    factor = (_REDUCTION if min(camera.size) >= task.small_px else 1.0) * coarsest_m / view.gsd_m
    size = (max(1, int(camera.size[0] / factor)), max(1, int(camera.size[1] / factor)))

    def to_original(points: FloatArray) -> FloatArray:
        return camera.to_original.original_from_refined((points + 0.5) * factor - 0.5)

    with opened_masked(view.image, view.mask) as dataset:
        pixels = task.stretches[view.name].apply(warp(dataset, view.band, to_original, size))
    missing = ~np.isfinite(pixels)
    grey = (np.where(missing, 0, pixels) * 255).astype(np.uint8)
    mask = cv2.erode((~missing).astype(np.uint8), np.ones((9, 9), np.uint8), borderValue=0)
    usual = int(np.clip(_FEATURES_PER_MPX * camera.size[0] * camera.size[1] / 1e6, *_FEATURES))
    most = min(usual, task.features)
    found = task.detector.detect(
        grey, mask, _SPARE_FEATURES * most, lambda points, strength: _even(points, strength, size, most)
    )
    if len(found.points) < 8:
        return None
    return _Features(view, camera, (found.points + 0.5) * factor - 0.5, found.descriptors)


def _even(points: FloatArray, strength: FloatArray, size: Tuple[int, int], most: int) -> NDArray[np.intp]:
    """Indices of at most so many points: the strongest of every bucket first, then the second of each, and so on."""
    if len(points) <= most:
        return np.arange(len(points))
    place = np.clip((points / size * _BUCKETS).astype(int), 0, _BUCKETS - 1)
    bucket = place[:, 1] * _BUCKETS + place[:, 0]
    order = np.lexsort((-strength, bucket))
    ordered = bucket[order]
    starts = np.searchsorted(ordered, ordered, side="left")
    rank = np.arange(len(order)) - starts
    return np.sort(order[np.lexsort((-strength[order], rank))[:most]])


def _match(scene: Scene, first: _Features, second: _Features, bounds: Bounds) -> Optional[PairMatches]:
    """Matches of two views over a patch, in original pixels; None where there are none.

    A first pass allows for the RPCs' errors; where its matches agree on a row difference, a second one searches near
    it, where fewer candidates compete.
    """
    pair = rectify_over(scene, first.camera, second.camera, bounds, scene.altitudes)
    a = apply_homography(pair.h_first, first.points)
    b = apply_homography(pair.h_second, second.points)
    low, high = disparity_range(pair, first.view, second.view, ground_points(scene, bounds, scene.altitudes))
    difference = (a[:, None] - b[None, :]).astype(np.float32)
    distance = np.sqrt(np.maximum(2.0 - 2.0 * (first.descriptors @ second.descriptors.T), 0.0))
    distance[(difference[..., 0] < low - _TOLERANCE_PX) | (difference[..., 0] > high + _TOLERANCE_PX)] = np.inf
    index = _guided_matches(distance, np.abs(difference[..., 1]) <= _TOLERANCE_PX)
    rows = a[index[:, 0], 1] - b[index[:, 1], 1]
    if len(rows) >= _MIN_TIES:
        middle = _mode(rows, 2.0)
        if (np.abs(rows - middle) < 2.0).sum() >= max(_MIN_TIES, 0.15 * len(rows)):
            index = _guided_matches(distance, np.abs(difference[..., 1] - np.float32(middle)) <= _NEAR_PX)
            index = _closer(distance, difference, a, index)
    index = index[_supported(a[index[:, 0]], (a[index[:, 0]] - b[index[:, 1]])[:, 0])]
    if not len(index):
        return None
    i, j = index[:, 0], index[:, 1]
    return PairMatches(
        first.view.name,
        second.view.name,
        first.camera.to_original.original_from_refined(first.points[i]),
        second.camera.to_original.original_from_refined(second.points[j]),
        a[i, 1] - b[j, 1],
    )


def _closer(
    distance: NDArray[np.float32], difference: NDArray[np.float32], a: FloatArray, index: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Matches searched once more, within a band as wide as what is left around the trend of the rows found."""
    rows = difference[index[:, 0], index[:, 1], 1].astype(np.float64)
    trend = _row_trend(a[index[:, 0]], rows, a)
    if (np.abs(rows - trend[index[:, 0]]) < _CLOSE_PX).sum() < _MIN_TIES:
        return index
    return _guided_matches(distance, np.abs(difference[..., 1] - trend[:, None].astype(np.float32)) <= _CLOSE_PX)


def _supported(points: FloatArray, disparity: FloatArray) -> NDArray[np.bool_]:
    """(N,) which matches lie at a height that neighbours share: a roof taken for the next one's mostly does not.

    Of the ten nearest matches, three must have the disparity, but for what a slope and a house may make between.
    """
    if len(points) <= _NEIGHBOURS:
        return np.ones(len(points), dtype=bool)
    places = points.astype(np.float32)
    nearest, squares = cv2.flann_Index(places, {"algorithm": _KD_TREE}).knnSearch(
        places, _NEIGHBOURS + 1, params={"checks": _ALL}
    )
    away = np.sqrt(squares)
    step = np.abs(disparity[nearest] - disparity[:, None])
    return (step <= _STEP_PX + _SLOPE * away).sum(axis=1) - 1 >= _SUPPORT


def disparity_range(pair: RectifiedPair, first: View, second: View, ground: FloatArray) -> Tuple[float, float]:
    """Least and greatest disparity of ground points (N, 3) longitude, latitude, height, in rectified px."""
    difference = pair.first_rectified(first.project(ground)) - pair.second_rectified(second.project(ground))
    return float(np.nanmin(difference[:, 0])), float(np.nanmax(difference[:, 0]))


def _guided_matches(distance: NDArray[np.float32], possible: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(N, 2) indices of mutual best matches that pass the ratio test among geometrically possible candidates.

    ``distance`` (A, B) of descriptors, infinite where a match is out of the question.
    """
    distance = np.where(possible, distance, np.float32(np.inf))
    best = distance.argmin(axis=1)
    first = np.arange(len(distance))
    nearest = distance[first, best]
    distance[first, best] = np.inf
    second = distance.min(axis=1)
    distance[first, best] = nearest
    mutual = distance.argmin(axis=0)[best] == first
    good = mutual & np.isfinite(nearest) & (nearest < _RATIO * second) & (nearest < 0.8)
    return np.column_stack([first[good], best[good]])


def _agreeing(first: str, second: str, parts: Sequence[PairMatches]) -> Tuple[FloatArray, FloatArray, FloatArray]:
    """First pixels, second pixels, row differences of all patches' matches that agree, to 1.5 px, on a trend.

    A trend is a plane over the first image: that is what shifts and affine errors of two views make. Each patch may
    differ from it a little.
    """
    if not parts:
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    a, b, rows = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("first_px", "second_px", "rows_px")
    )
    patch = np.repeat(np.arange(len(parts)), [len(part.rows_px) for part in parts])
    off = rows - _row_trend(a, rows)
    kept = np.zeros(len(rows), dtype=bool)
    for number in range(len(parts)):
        near = (patch == number) & (np.abs(off) < 2.5)
        if near.sum() >= 4:
            kept |= near & (np.abs(off - np.median(off[near])) < 1.5)
    return a[kept], b[kept], rows[kept]


def _row_trend(pixels: FloatArray, rows: FloatArray, at: Optional[FloatArray] = None) -> FloatArray:
    """(N,) the row difference that most matches agree on, a constant or a plane, at their pixels or at other ones."""
    at = pixels if at is None else at
    mode = _mode(rows)
    if (np.abs(rows - mode) < _LIKELY_PX).sum() < 40:
        return np.full(len(at), mode)
    middle, extent = pixels.mean(axis=0), np.maximum(np.ptp(pixels, axis=0), 1.0)

    def design(points: FloatArray) -> FloatArray:
        return np.column_stack([np.ones(len(points)), (points - middle) / extent])

    own = design(pixels)
    plane = np.array([mode, 0.0, 0.0])
    for reach in (_LIKELY_PX, 4.0, 3.0, 2.0, 2.0):
        # Tukey's weights, ever stricter: what lies beyond the reach counts for nothing.
        weight = np.maximum(1.0 - ((rows - own @ plane) / reach) ** 2, 0.0)
        plane, *_ = np.linalg.lstsq(own * weight[:, None], rows * weight, rcond=1e-6)
    if (np.abs(rows - own @ plane) < 1.5).sum() < (np.abs(rows - mode) < 1.5).sum():
        plane = np.array([mode, 0.0, 0.0])
    return design(at) @ plane


def _consistent(first: str, second: str, parts: Sequence[PairMatches]) -> PairMatches:
    """All patches' matches of a pair that agree: gross errors do not survive, slow trends do."""
    agreed = _agreeing(first, second, parts)
    if len(agreed[0]) < _MIN_TIES:
        raise EmptyResultError(
            f"{first} and {second} have only {len(agreed[0])} tie points that agree, of "
            f"{sum(len(part.rows_px) for part in parts)} candidates on {counted(len(parts), 'patch')} (needed: "
            f"{_MIN_TIES}). Do they show the same place, in focus and without clouds? Another EXTENT with more "
            "texture, or another pair, may do."
        )
    return PairMatches(first, second, *agreed)


def _mode(values: FloatArray, width: float = 1.0) -> float:
    """The centre of the fullest interval of a width: robust where more than half are wrong."""
    ordered = np.sort(values)
    ends = np.searchsorted(ordered, ordered + width, side="right")
    start = int(np.argmax(ends - np.arange(len(ordered))))
    return float(np.median(ordered[start : ends[start]]))
