"""Tie points: the same ground points found in several images, in original-image pixels.

SIFT (Lowe 2004) on rectified pairs of a few tiles spread over the scene: the pinhole cameras say which rows and
columns a match may have, so only few candidates compete and repetitive roofs do little harm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import EmptyResultError
from ..geometry.equivalent_error import RefinedPinhole
from ..geometry.refinement import apply_homography
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened
from ..imagery.warping import warp
from ..mvs.pairing import ground_points, grown, rectify_over, refined_view
from ..mvs.rectification import RectifiedPair
from ..progress import Progress, counted
from ..scene import Scene, View

FloatArray = NDArray[np.float64]

_REDUCTION = 2.0            # SIFT on half-size images: a sixth of the time, ties enough
_MOST_FEATURES = 4000
_MOST_TILES = 9
_PATCH_PX = 1600            # largest side of a patch of a tile that is searched
_ROW_TOLERANCE_PX = 24.0    # vendor RPCs are off by up to tens of px
_RATIO = 0.85
_MIN_TIES = 12


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


def find_ties(scene: Scene, pairs: Sequence[Tuple[str, str]], stretches: Dict[str, Stretch],
              progress: Progress) -> List[PairMatches]:
    """Match pairs of views on tiles spread over the scene.

    Raises EmptyResultError with the counts where a pair gives fewer than a dozen trustworthy ties.
    """
    tiles = _spread(scene)
    parts: Dict[Tuple[str, str], List[PairMatches]] = {tuple(pair): [] for pair in pairs}
    names = [name for name in stretches if any(name in pair for pair in pairs)]
    for index, tile in enumerate(tiles):
        bounds = _bounds(scene, tile)
        features: Dict[str, _Features] = {}
        for number, name in enumerate(names):
            progress.check_cancelled()
            progress.step((index + 0.8 * number / len(names)) / len(tiles), f"tie points of tile {tile}, {name}")
            found = _features(scene, scene.view(name), stretches[name], bounds)
            if found is not None:
                features[name] = found
        for first, second in parts:
            progress.check_cancelled()
            if first in features and second in features:
                matches = _match(scene, features[first], features[second], bounds)
                if matches is not None:
                    parts[first, second].append(matches)
    return [_consistent(first, second, found) for (first, second), found in parts.items()]


def patches(scene: Scene) -> List[Tuple[float, float, float, float]]:
    """The ground rectangles that tie points are looked for in."""
    return [_bounds(scene, tile) for tile in _spread(scene)]


def _spread(scene: Scene) -> List[str]:
    """Up to nine tiles, evenly through the list, which runs over the scene row by row."""
    ids = [tile.id for tile in scene.tiles]
    if len(ids) <= _MOST_TILES:
        return ids
    return [ids[i] for i in np.unique(np.linspace(0, len(ids) - 1, _MOST_TILES).round().astype(int))]


def _bounds(scene: Scene, tile_id: str) -> Tuple[float, float, float, float]:
    """A tile's ground rectangle, cut to its middle where it is larger than a patch."""
    xmin, ymin, xmax, ymax = next(tile.bounds for tile in scene.tiles if tile.id == tile_id)
    half = _PATCH_PX * scene.gsd_m / 2
    x, y = (xmin + xmax) / 2, (ymin + ymax) / 2
    return max(xmin, x - half), max(ymin, y - half), min(xmax, x + half), min(ymax, y + half)


def _features(scene: Scene, view: View, stretch: Stretch,
              bounds: Tuple[float, float, float, float]) -> Optional[_Features]:
    """SIFT keypoints and RootSIFT descriptors of a view over a patch; None where it shows too little."""
    camera = refined_view(scene, view, grown(bounds, _ROW_TOLERANCE_PX * scene.gsd_m), scene.altitudes)
    if camera is None:
        return None
    factor = _REDUCTION if min(camera.size) >= 500 else 1.0
    size = (int(camera.size[0] / factor), int(camera.size[1] / factor))

    def to_original(points: FloatArray) -> FloatArray:
        return camera.to_original.original_from_refined((points + 0.5) * factor - 0.5)

    with opened(view.image) as dataset:
        pixels = stretch.apply(warp(dataset, view.band, to_original, size))
    missing = ~np.isfinite(pixels)
    grey = (np.where(missing, 0, pixels) * 255).astype(np.uint8)
    mask = cv2.erode((~missing).astype(np.uint8), np.ones((9, 9), np.uint8), borderValue=0)
    points, descriptors = cv2.SIFT_create(_MOST_FEATURES, contrastThreshold=0.02).detectAndCompute(grey, mask)
    if len(points) < 8:
        return None
    # Arandjelovic and Zisserman, Three things everyone should know to improve object retrieval, 2012.
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)).astype(np.float32)
    refined = (np.array([p.pt for p in points], dtype=np.float64) + 0.5) * factor - 0.5
    # SIFT gives a strong corner once for each of its orientations: one is enough as a tie.
    _, once = np.unique(refined, axis=0, return_index=True)
    return _Features(view, camera, refined[once], roots[once])


def _match(scene: Scene, first: _Features, second: _Features,
           bounds: Tuple[float, float, float, float]) -> Optional[PairMatches]:
    """Matches of two views over a patch, in original pixels; None where there are none."""
    pair = rectify_over(scene, first.camera, second.camera, bounds, scene.altitudes)
    a = apply_homography(pair.h_first, first.points)
    b = apply_homography(pair.h_second, second.points)
    low, high = disparity_range(pair, first.view, second.view, ground_points(scene, bounds, scene.altitudes))
    index = _guided_matches(((a, first.descriptors), (b, second.descriptors)),
                            (low - _ROW_TOLERANCE_PX, high + _ROW_TOLERANCE_PX), _ROW_TOLERANCE_PX)
    if not len(index):
        return None
    i, j = index[:, 0], index[:, 1]
    return PairMatches(first.view.name, second.view.name,
                       first.camera.to_original.original_from_refined(first.points[i]),
                       second.camera.to_original.original_from_refined(second.points[j]), a[i, 1] - b[j, 1])


def disparity_range(pair: RectifiedPair, first: View, second: View, ground: FloatArray) -> Tuple[float, float]:
    """Least and greatest disparity of ground points (N, 3) longitude, latitude, height, in rectified px."""
    difference = pair.first_rectified(first.project(ground)) - pair.second_rectified(second.project(ground))
    return float(np.nanmin(difference[:, 0])), float(np.nanmax(difference[:, 0]))


def _guided_matches(features: Sequence[Tuple[FloatArray, FloatArray]], columns: Tuple[float, float],
                    rows: float) -> NDArray[np.intp]:
    """(N, 2) indices of mutual best matches that pass the ratio test among geometrically possible candidates."""
    (a, da), (b, db) = features
    similarity = da @ db.T
    disparity = a[:, None, 0] - b[None, :, 0]
    possible = (np.abs(a[:, None, 1] - b[None, :, 1]) <= rows) & (disparity >= columns[0]) & (disparity <= columns[1])
    distance = np.where(possible, np.sqrt(np.maximum(2.0 - 2.0 * similarity, 0.0)), np.inf)
    best = distance.argmin(axis=1)
    first = np.arange(len(a))
    nearest = distance[first, best]
    distance[first, best] = np.inf
    second = distance.min(axis=1)
    distance[first, best] = nearest
    mutual = distance.argmin(axis=0)[best] == first
    good = mutual & np.isfinite(nearest) & (nearest < _RATIO * second) & (nearest < 0.8)
    return np.column_stack([first[good], best[good]])


def _consistent(first: str, second: str, parts: Sequence[PairMatches]) -> PairMatches:
    """All tiles' matches of a pair whose row differences agree: gross errors do not survive, slow trends do."""
    kept: List[PairMatches] = []
    found = sum(len(part.rows_px) for part in parts)
    if found:
        mode = _mode(np.concatenate([part.rows_px for part in parts]))
        for part in parts:
            near = np.abs(part.rows_px - mode) < 6.0
            if near.sum() >= 4:
                middle = float(np.median(part.rows_px[near]))
                near = np.abs(part.rows_px - middle) < 1.5
                kept.append(PairMatches(first, second, part.first_px[near], part.second_px[near], part.rows_px[near]))
    count = sum(len(part.rows_px) for part in kept)
    if count < _MIN_TIES:
        raise EmptyResultError(
            f"{first} and {second} have only {count} tie points that agree, of {found} candidates on "
            f"{counted(len(parts), 'tile')} (needed: {_MIN_TIES}). Do they show the same place, in focus "
            "and without clouds? Another EXTENT with more texture, or another pair, may do.")
    return PairMatches(first, second, *(np.concatenate([getattr(part, name) for part in kept])
                                        for name in ("first_px", "second_px", "rows_px")))


def _mode(values: FloatArray, width: float = 1.0) -> float:
    """The centre of the fullest interval of a width: robust where more than half are wrong."""
    ordered = np.sort(values)
    ends = np.searchsorted(ordered, ordered + width, side="right")
    start = int(np.argmax(ends - np.arange(len(ordered))))
    return float(np.median(ordered[start:ends[start]]))
