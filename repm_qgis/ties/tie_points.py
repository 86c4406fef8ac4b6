"""Tie points: the same ground points found in several images, in original pixels.

SIFT (Lowe 2004) on a few patches spread over the scene, where its texture is best. The pinhole cameras limit the
vertical parallax and the disparity of a match: only few candidates compete, and repetitive roofs do little harm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import Bounds, ByteImage, FloatArray, FloatImage, Mask, Size
from ..contracts.errors import EmptyResultError
from ..geometry.equivalent_error import RefinedPinhole
from ..geometry.rectification import RectifiedPair
from ..geometry.refinement import apply_homography
from ..imagery.enhancement import Stretch
from ..imagery.parameters import SAMPLING
from ..imagery.raster import opened_masked
from ..imagery.warping import warp_coarsened
from ..numerics.robust import tukey
from ..planning.graph import components
from ..planning.overlap import foreign_rpc
from ..runtime.parallel import run_tasks
from ..runtime.progress import Part, Progress, counted
from ..runtime.spare_cores import spread
from ..scene import Scene, View, common_gsd_m
from ..stereo.pairing import ground_points, rectify_over, reductions, refined_view
from .keypoints import detect
from .parameters import TIES, KeypointParameters, PatchParameters, TieParameters, TiesParameters
from .tie_patches import BlockPatches, common_ground, covered_by_ties, is_block, ranked_patches, texture_of

_ROWS = 256  # of the matrix of distances that are made at once: they fit into the cache

Indices = NDArray[np.intp]
Pair = Tuple[str, str]


@dataclass(frozen=True)
class PairMatches:
    """Matches of two views: (N, 2) original pixels in each, and (N,) vertical parallax before any correction, px."""

    first: str
    second: str
    first_px: FloatArray
    second_px: FloatArray
    vertical_parallax_px: FloatArray


@dataclass(frozen=True)
class _Features:
    """A view over a patch: its refined camera, keypoints (N, 2) in refined pixels, their descriptors (N, 128)."""

    view: View
    camera: RefinedPinhole
    points: FloatArray
    descriptors: FloatImage


@dataclass(frozen=True)
class _PatchTask:
    """What a worker needs to match all pairs over one patch; ``scene`` is without its tiles.

    ``coarsest_m`` has for each pair the GSD at which its keypoints are found.
    """

    scene: Scene
    bounds: Bounds
    pairs: Tuple[Pair, ...]
    coarsest_m: Tuple[float, ...]
    stretches: Dict[str, Stretch]
    small_px: int
    features: int
    keypoints: KeypointParameters
    parameters: TieParameters


def find_ties(
    scene: Scene,
    pairs: Sequence[Pair],
    stretches: Dict[str, Stretch],
    *,
    progress: Progress,
    workers: int = 0,
    parameters: TiesParameters = TIES,
) -> List[PairMatches]:
    """Match pairs of views on patches spread over the scene; more patches where the first give too few.

    Pairs with too few ties are left out where the others connect all their views. ``workers`` 0 means one for each
    core. Raises EmptyResultError with the counts where a pair that is needed has too few ties.
    """
    patches, keypoints, ties = parameters.patches, parameters.keypoints, parameters.matches
    names = {name for pair in pairs for name in pair}
    used = {name: stretch for name, stretch in stretches.items() if name in names}
    search = _Search.of(scene, pairs, used, progress, patches)
    lean, small_px = scene.lean(), ties.small_px if search.count == 1 else ties.small_patch_px
    features = max(ties.least_patch_features, ties.most_features // search.count)
    parts: Dict[Pair, List[PairMatches]] = {pair: [] for pair in pairs}
    kept = {(first, second): consistent_matches(first, second, [], ties) for first, second in pairs}
    gsd_m = common_gsd_m([max(scene.view(name).gsd_m for name in pair) for pair in pairs])
    coarsest_m, lacking = dict(zip(pairs, gsd_m)), list(pairs)
    for number in range(patches.most_rounds):
        tasks = []
        for place in search.places(number, lacking):
            own = search.pairs(place)
            scales = tuple(coarsest_m[pair] for pair in own)
            tasks.append(_PatchTask(lean, place, own, scales, used, small_px, features, keypoints, ties))
        if not tasks:
            break
        part = Part(progress, 1 - 0.5**number, 1 - 0.5 ** (number + 1), "tie points")
        for found in run_tasks(_match_patch, tasks, workers, part, lambda _: "patch"):
            for pair, matches in found.items():
                parts[pair].append(matches)
        kept = {(a, b): consistent_matches(a, b, found, ties) for (a, b), found in parts.items()}
        lacking = [pair for pair, matches in kept.items() if len(matches.first_px) < search.enough]
        if not lacking:
            break
    enough = [pair for pair in pairs if len(kept[pair].first_px) >= ties.least_ties]
    groups = components(sorted(names), enough)
    needed = [pair for pair in pairs if not any(group.issuperset(pair) for group in map(set, groups))]
    for first, second in needed:
        raise _too_few(scene, (first, second), kept[first, second], parts[first, second], ties)
    return [kept[pair] for pair in enough]


@dataclass(frozen=True)
class _Search:
    """Where all pairs are searched: in each of the ``cells``, or in the patches of a ``block`` of frames."""

    every: Tuple[Pair, ...]
    cells: List[List[Bounds]]
    block: Optional[BlockPatches]
    enough: int

    @classmethod
    def of(
        cls,
        scene: Scene,
        pairs: Sequence[Pair],
        stretches: Dict[str, Stretch],
        progress: Progress,
        parameters: PatchParameters,
    ) -> "_Search":
        ground = common_ground(scene, pairs)
        if len(pairs) > 1 and not covered_by_ties(scene, parameters) and is_block(scene, ground, parameters):

            def texture(place: Bounds, pair: Pair) -> float:
                return texture_of(scene, {name: stretches[name] for name in pair}, place, parameters)

            block = BlockPatches(scene, ground, texture, parameters)
            return cls(tuple(pairs), [[place] for place in block.first(progress)], block, parameters.frame_ties)
        cells = ranked_patches(scene, lambda at: texture_of(scene, stretches, at, parameters), progress, parameters)
        return cls(tuple(pairs), cells, None, parameters.enough_ties)

    @property
    def count(self) -> int:
        """How many patches share the keypoints of a view."""
        return len(self.cells)

    def places(self, number: int, lacking: Sequence[Pair]) -> List[Bounds]:
        """The patches of a round; those of a block's further rounds lie on the ground of pairs that lack ties."""
        if self.block is not None and number > 0:
            return self.block.more(lacking)
        return [cell[number] for cell in self.cells if number < len(cell)]

    def pairs(self, place: Bounds) -> Tuple[Pair, ...]:
        """The pairs that may see a patch."""
        return self.every if self.block is None else tuple(self.block.seeing(place))


def _match_patch(task: _PatchTask) -> Dict[Pair, PairMatches]:
    """Matches of all pairs over one patch; pairs without any are left out."""
    needed = list(dict.fromkeys((name, gsd_m) for pair, gsd_m in zip(task.pairs, task.coarsest_m) for name in pair))
    features = dict(zip(needed, spread(lambda each: _features(task, task.scene.view(each[0]), each[1]), needed)))

    def of(number: int) -> Optional[PairMatches]:
        a, b = (features[name, task.coarsest_m[number]] for name in task.pairs[number])
        return _match(task, a, b) if a is not None and b is not None else None

    found = spread(of, range(len(task.pairs)))
    return {pair: matches for pair, matches in zip(task.pairs, found) if matches is not None}


def _features(task: _PatchTask, view: View, coarsest_m: float) -> Optional[_Features]:
    """Keypoints and descriptors of a view over a patch; None where it shows too little."""
    scene, parameters = task.scene, task.parameters
    camera = refined_view(scene, view, task.bounds.grown(parameters.margin_px * scene.gsd_m), scene.altitudes)
    if camera is None:
        return None
    # Both views have one sampling distance here: most keypoints have the smallest scale, and match at equal scales
    # only.
    finer = coarsest_m / view.gsd_m
    ratio = finer if finer > SAMPLING.alike else 1.0
    factor = (parameters.reduction if min(camera.size) >= ratio * task.small_px else 1.0) * finer
    size = (max(1, int(camera.size[0] / factor)), max(1, int(camera.size[1] / factor)))

    def to_original(points: FloatArray) -> FloatArray:
        return camera.to_original.original_from_refined((points + 0.5) * factor - 0.5)

    with opened_masked(view.image, view.mask) as dataset:
        seen = warp_coarsened(dataset, view.band, to_original, size, "bilinear", ratio)
    pixels = task.stretches[view.name].apply(seen)
    missing = ~np.isfinite(pixels)
    grey: ByteImage = (np.where(missing, 0, pixels) * 255).astype(np.uint8)
    kernel = np.ones((2 * parameters.border_px + 1,) * 2, np.uint8)
    mask = np.asarray(cv2.erode((~missing).astype(np.uint8), kernel, borderValue=(0,)))
    usual = parameters.features_per_mpx * camera.size[0] * camera.size[1] / ratio**2 / 1e6
    most = min(int(np.clip(usual, parameters.least_features, parameters.most_features)), task.features)

    def choose(points: FloatArray, strength: FloatArray) -> Indices:
        return evenly_spread(points, strength, size, most, parameters.buckets)

    found = detect(grey, mask, parameters.spare_features * most, choose=choose, parameters=task.keypoints)
    if len(found.points) < parameters.least_keypoints:
        return None
    return _Features(view, camera, (found.points + 0.5) * factor - 0.5, found.descriptors)


def evenly_spread(points: FloatArray, strength: FloatArray, size: Size, most: int, buckets: int) -> Indices:
    """Indices of at most so many points: the strongest of every bucket first, then the second of each, and so on."""
    if len(points) <= most:
        return np.arange(len(points))
    place = np.clip((points / size * buckets).astype(int), 0, buckets - 1)
    bucket = place[:, 1] * buckets + place[:, 0]
    order = np.lexsort((-strength, bucket))
    ordered = bucket[order]
    rank = np.arange(len(order)) - np.searchsorted(ordered, ordered, side="left")
    return np.sort(order[np.lexsort((-strength[order], rank))[:most]])


def _match(task: _PatchTask, first: _Features, second: _Features) -> Optional[PairMatches]:
    """Matches of two views over a patch, in original pixels; None where there are none.

    The first search allows for the errors of the RPCs. Where its matches agree on a vertical parallax, a second search
    near that value, and a third along its trend over the patch, have fewer candidates that compete.
    """
    scene, parameters = task.scene, task.parameters
    reduction = reductions(first.view, second.view)[0]
    pair = rectify_over(scene, (first.camera, second.camera), task.bounds, scene.altitudes, reduction)
    a = apply_homography(pair.h_first, first.points)
    b = apply_homography(pair.h_second, second.points)
    low, high = disparity_range(pair, first.view, second.view, ground_points(scene, task.bounds, scene.altitudes))
    tolerance = parameters.tolerance_px
    bounds = low - tolerance, high + tolerance
    search = partial(_guided_matches, (first.descriptors, second.descriptors), (a, b), bounds, parameters)
    index = search(np.zeros(len(a)), tolerance)
    parallax = a[index[:, 0], 1] - b[index[:, 1], 1]
    if len(parallax) >= parameters.least_ties:
        mode = _mode(parallax, parameters.patch_mode_px)
        near = (np.abs(parallax - mode) < parameters.patch_mode_px).sum()
        if near >= max(parameters.least_ties, parameters.patch_mode_share * len(parallax)):
            index = search(np.full(len(a), mode), parameters.near_px)
            parallax = a[index[:, 0], 1] - b[index[:, 1], 1]
            trend = parallax_trend(a[index[:, 0]], parallax, parameters, a)
            if (np.abs(parallax - trend[index[:, 0]]) < parameters.close_px).sum() >= parameters.least_ties:
                index = search(trend, parameters.close_px)
    index = index[supported(a[index[:, 0]], (a[index[:, 0]] - b[index[:, 1]])[:, 0], parameters)]
    if not len(index):
        return None
    i, j = index[:, 0], index[:, 1]
    first_px = first.camera.to_original.original_from_refined(first.points[i])
    second_px = second.camera.to_original.original_from_refined(second.points[j])
    return PairMatches(first.view.name, second.view.name, first_px, second_px, a[i, 1] - b[j, 1])


def supported(points: FloatArray, disparity: FloatArray, parameters: TieParameters) -> Mask:
    """(N,) whether enough of the nearest matches have nearly the same disparity, apart from slopes and houses.

    A roof that is matched with the next one has a disparity that its neighbours mostly do not have.
    """
    from scipy.spatial import cKDTree

    if len(points) <= parameters.neighbours:
        return np.ones(len(points), dtype=bool)
    places = points.astype(np.float32)
    away, nearest = cKDTree(places).query(places, parameters.neighbours + 1)
    step = np.abs(disparity[nearest] - disparity[:, None])
    close = step <= parameters.support_step_px + parameters.support_slope * away
    return np.asarray(close.sum(axis=1) - 1 >= parameters.supporters)


def disparity_range(pair: RectifiedPair, first: View, second: View, ground: FloatArray) -> Tuple[float, float]:
    """Least and greatest disparity of ground points (N, 3) longitude, latitude, height, in rectified px."""
    difference = pair.first_rectified(first.project(ground)) - pair.second_rectified(second.project(ground))
    return float(np.nanmin(difference[:, 0])), float(np.nanmax(difference[:, 0]))


def _guided_matches(
    descriptors: Tuple[FloatImage, FloatImage],
    points: Tuple[FloatArray, FloatArray],
    disparities: Tuple[float, float],
    parameters: TieParameters,
    parallax: FloatArray,
    around_px: float,
) -> Indices:
    """(N, 2) indices of mutual best matches that pass the ratio test among geometrically possible candidates.

    Those have a disparity within bounds and a vertical parallax (A,) to some px, for ``points`` (A, 2) and (B, 2) in
    rectified px with unit ``descriptors`` (A, D) and (B, D). Points in the order of their rows have candidates that
    follow each other, so only parts of the matrix of distances are made.
    """
    (a, b), rows = points, points[0][:, 1] - parallax
    order, columns = np.argsort(rows, kind="stable"), np.argsort(points[1][:, 1], kind="stable")
    nearest, second = np.full(len(a), np.inf, np.float32), np.full(len(a), np.inf, np.float32)
    best, mutual = np.zeros(len(a), np.intp), np.full(len(b), -1, np.intp)
    least = np.full(len(b), np.inf, np.float32)
    for start in range(0, len(a), _ROWS):
        part = order[start : start + _ROWS]
        ends = rows[part[0]] - around_px, rows[part[-1]] + around_px
        inside = columns[slice(*np.searchsorted(b[columns, 1], ends))]
        if not len(inside):
            continue
        likeness = descriptors[0][part] @ descriptors[1][inside].T
        distance = np.sqrt(np.maximum(2.0 - 2.0 * likeness, 0.0))
        along = a[part, 0][:, None] - b[inside, 0]
        outside = (along < disparities[0]) | (along > disparities[1])
        distance[outside | (np.abs(rows[part][:, None] - b[inside, 1]) > around_px)] = np.inf
        own, found = np.arange(len(part)), distance.argmin(axis=1)
        column, other = np.arange(len(inside)), distance.argmin(axis=0)
        nearest[part], best[part] = distance[own, found], inside[found]
        better = distance[other, column] < least[inside]
        least[inside[better]], mutual[inside[better]] = distance[other, column][better], part[other[better]]
        distance[own, found] = np.inf
        second[part] = distance.min(axis=1)
    good = (mutual[best] == np.arange(len(a))) & np.isfinite(nearest) & (nearest < parameters.most_distance)
    good &= nearest < parameters.ratio * second
    return np.column_stack([np.flatnonzero(good), best[good]])


def consistent_matches(first: str, second: str, parts: Sequence[PairMatches], parameters: TieParameters) -> PairMatches:
    """All patches' matches of a pair whose vertical parallax follows one trend: gross errors are removed.

    The trend is a plane over the first image, which is what shifts and affine errors of two views make. The median of a
    patch may differ from it a little.
    """
    if not parts:
        return PairMatches(first, second, np.empty((0, 2)), np.empty((0, 2)), np.empty(0))
    names = ("first_px", "second_px", "vertical_parallax_px")
    a, b, parallax = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
    patch = np.repeat(np.arange(len(parts)), [len(part.first_px) for part in parts])
    off = parallax - parallax_trend(a, parallax, parameters)
    kept = np.zeros(len(parallax), dtype=bool)
    for number in range(len(parts)):
        near = (patch == number) & (np.abs(off) < parameters.patch_reach_px)
        if near.sum() >= parameters.least_patch_matches:
            kept |= near & (np.abs(off - np.median(off[near])) < parameters.agree_px)
    return PairMatches(first, second, a[kept], b[kept], parallax[kept])


def parallax_trend(
    pixels: FloatArray, parallax: FloatArray, parameters: TieParameters, at: Optional[FloatArray] = None
) -> FloatArray:
    """(N,) the vertical parallax that most matches follow, a constant or a plane, at their pixels or at other ones."""
    at = pixels if at is None else at
    mode = _mode(parallax, parameters.mode_px)
    if (np.abs(parallax - mode) < parameters.likely_px).sum() < parameters.trend_matches:
        return np.full(len(at), mode)
    middle, extent = pixels.mean(axis=0), np.maximum(np.ptp(pixels, axis=0), 1.0)

    def design(points: FloatArray) -> FloatArray:
        return np.column_stack([np.ones(len(points)), (points - middle) / extent])

    own = design(pixels)
    plane = np.array([mode, 0.0, 0.0])
    for reach in parameters.trend_reach_px:
        # Tukey's weights, which become stricter: what lies beyond the reach does not count.
        weight = np.sqrt(tukey((parallax - own @ plane) / reach))
        plane, *_ = np.linalg.lstsq(own * weight[:, None], parallax * weight, rcond=1e-6)
    near = parameters.agree_px
    if (np.abs(parallax - own @ plane) < near).sum() < (np.abs(parallax - mode) < near).sum():
        plane = np.array([mode, 0.0, 0.0])
    return np.asarray(design(at) @ plane)


def _too_few(
    scene: Scene, pair: Pair, found: PairMatches, parts: Sequence[PairMatches], parameters: TieParameters
) -> EmptyResultError:
    """The error of a pair whose consistent matches are too few."""
    first, second = map(scene.view, pair)
    low, high = scene.altitudes
    candidates = sum(len(part.first_px) for part in parts)
    doubt = foreign_rpc([first, second]) or "Check that each RPC belongs to its image: a crop's often does not."
    return EmptyResultError(
        f"{first.name} and {second.name} have only {len(found.first_px)} consistent tie points, of {candidates} "
        f"candidates in {counted(len(parts), 'place')} (needed: {parameters.least_ties}). {doubt} Do they show the "
        "same place, in focus and without clouds? Choose another EXTENT with more texture, or another pair. They were "
        f"searched for ground from {low:.0f} to {high:.0f} m above the ellipsoid: where that is wrong, give "
        "ALTITUDE_MIN and ALTITUDE_MAX, or a DEM."
    )


def _mode(values: FloatArray, width: float) -> float:
    """The median of the fullest interval of a width: robust where more than half of the values are wrong."""
    ordered = np.sort(values)
    ends = np.searchsorted(ordered, ordered + width, side="right")
    start = int(np.argmax(ends - np.arange(len(ordered))))
    return float(np.median(ordered[start : ends[start]]))
