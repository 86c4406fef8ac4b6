"""Subpixel tie points: each one is aligned, at full resolution, with its neighbourhood in one other view.

SIFT on reduced images places a keypoint to about half a pixel. Lucas and Kanade's registration (1981; OpenCV's
implementation) works on rectified neighbourhoods, which differ by the parallax only. Dropped are positions from which
the way back does not return, and those whose neighbourhoods differ most: a window across the edge of a roof holds two
parallaxes, and its error always has the same direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import Bounds, ByteImage, FloatArray, FloatImage, Mask, Size
from ..geometry.frames import projected_from_geodetic
from ..geometry.refinement import translation
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked
from ..imagery.warping import PixelMap, warp
from ..parallel import run_tasks
from ..progress import Progress
from ..scene import Scene, View
from ..stereo.pairing import rectified_pair
from ..stereo.rectification import RectifiedPair
from .adjustment import Track, track_pixels
from .parameters import POINTING, AlignmentParameters

Indices = NDArray[np.intp]
Pair = Tuple[str, str]


@dataclass(frozen=True)
class _AlignTask:
    """What a worker needs: for each pair of views the numbers of its tracks."""

    scene: Scene
    bounds: Bounds
    pairs: Dict[Pair, List[int]]
    pixels: Dict[Pair, Tuple[FloatArray, FloatArray]]
    stretches: Dict[str, Stretch]
    parameters: AlignmentParameters


def align_ties(
    scene: Scene,
    tracks: Sequence[Track],
    stretches: Dict[str, Stretch],
    progress: Progress,
    workers: int = 0,
    parameters: AlignmentParameters = POINTING.alignment,
) -> List[Track]:
    """Align each track's pixels with those of its first view, which stay; pixels that cannot be aligned are dropped.

    Tracks that keep fewer than two views are dropped too.
    """
    if not tracks:
        return []
    order = [view.name for view in scene.views]
    seen = [[name for name in order if name in track.pixels] for track in tracks]
    xy = _places(scene, tracks, seen)
    lean = scene.lean()
    tasks = []
    for members in clusters(xy, np.arange(len(tracks)), parameters.patch_px * scene.gsd_m, parameters.gap):
        pairs: Dict[Pair, List[int]] = {}
        for number in members:
            for other in seen[number][1:]:
                pairs.setdefault((seen[number][0], other), []).append(int(number))
        bounds = Bounds(*map(float, (*xy[members].min(axis=0), *xy[members].max(axis=0))))
        pixels = {(a, b): (track_pixels(tracks, a, own), track_pixels(tracks, b, own)) for (a, b), own in pairs.items()}
        tasks.append(_AlignTask(lean, bounds, dict(sorted(pairs.items())), pixels, stretches, parameters))
    aligned: Dict[Tuple[int, str], FloatArray] = {}
    for found in run_tasks(_align_patch, tasks, workers, progress, lambda _: "aligning tie points"):
        aligned.update(found)
    result = []
    for number, (track, names) in enumerate(zip(tracks, seen)):
        kept = {name: aligned[number, name] for name in names[1:] if (number, name) in aligned}
        if kept:
            result.append(Track({names[0]: track.pixels[names[0]], **kept}))
    return result


def _places(scene: Scene, tracks: Sequence[Track], seen: Sequence[List[str]]) -> FloatArray:
    """(N, 2) approximate places of tracks in the scene's CRS: their first pixel at the middle altitude."""
    xy = np.empty((len(tracks), 2))
    for view in scene.views:
        own = [number for number, names in enumerate(seen) if names[0] == view.name]
        if own:
            pixels = track_pixels(tracks, view.name, own)
            xy[own] = projected_from_geodetic(scene.crs, view.localise(pixels, sum(scene.altitudes) / 2))
    return xy


def clusters(xy: FloatArray, members: Indices, side: float, gap: float) -> List[Indices]:
    """Split points (N, 2) at gaps wider than a share ``gap`` of a side, and until no part is larger than a side."""
    orders = [members[np.argsort(xy[members, axis], kind="stable")] for axis in (0, 1)]
    steps = [np.diff(xy[order, axis]) for axis, order in enumerate(orders)]
    axis = int(np.argmax([step.max(initial=0.0) for step in steps]))
    if steps[axis].max(initial=0.0) > gap * side:
        at = int(steps[axis].argmax()) + 1
    else:
        extent = np.ptp(xy[members], axis=0)
        axis = int(extent.argmax())
        if extent[axis] <= side:
            return [members]
        values = xy[orders[axis], axis]
        at = int(np.clip(np.searchsorted(values, (values[0] + values[-1]) / 2), 1, len(values) - 1))
    return clusters(xy, orders[axis][:at], side, gap) + clusters(xy, orders[axis][at:], side, gap)


def _align_patch(task: _AlignTask) -> Dict[Tuple[int, str], FloatArray]:
    """The aligned pixels, by track and second view."""
    result: Dict[Tuple[int, str], FloatArray] = {}
    bounds = task.bounds.grown(task.parameters.margin_px * task.scene.gsd_m)
    for names, numbers in task.pairs.items():
        first, second = (task.scene.view(name) for name in names)
        pair = rectified_pair(task.scene, first, second, bounds, task.scene.altitudes)
        if pair is None:
            continue
        first_px, second_px = task.pixels[names]
        a, b = pair.first_rectified(first_px), pair.second_rectified(second_px)
        inside = np.flatnonzero(((a >= 0) & (a < pair.size)).all(axis=1) & np.isfinite(b).all(axis=1))
        if not len(inside):
            continue
        stretches = task.stretches[names[0]], task.stretches[names[1]]
        moved, good = _registered(pair, (first, second), stretches, a[inside], b[inside], task.parameters)
        pixels = pair.second_original(moved)
        result.update({(numbers[k], names[1]): pixel for k, pixel in zip(inside[good], pixels[good])})
    return result


def _registered(
    pair: RectifiedPair,
    views: Tuple[View, View],
    stretches: Tuple[Stretch, Stretch],
    a: FloatArray,
    b: FloatArray,
    parameters: AlignmentParameters,
) -> Tuple[FloatArray, Mask]:
    """(N, 2) positions in the second image that look like ``a`` in the first, and which of them are good."""
    # Each image has a frame that just holds its points, wherever the errors of the RPCs put them.
    margin = parameters.margin_px
    corners = [np.floor(points.min(axis=0)) - margin for points in (a, b)]
    extent = np.max([np.ceil(points.max(axis=0) - corner) for points, corner in zip((a, b), corners)], axis=0)
    size = (int(extent[0]) + margin, int(extent[1]) + margin)
    h_first, h_second = (translation(*-corner) @ h for corner, h in zip(corners, (pair.h_first, pair.h_second)))
    frames = RectifiedPair(pair.first, pair.second, h_first, h_second, size)
    images = zip(views, stretches, (frames.first_original, frames.second_original))
    first, second = (_evened(*image, size, parameters) for image in images)
    here, there = (points.astype(np.float32)[:, None] for points in (a - corners[0], b - corners[1]))
    found, status, error = _aligned(first, second, here, there, parameters)
    back, returned, _ = _aligned(second, first, found, here, parameters)
    near = (_distance(found, there) < parameters.farthest_px) & (_distance(back, here) < parameters.return_px)
    good = (status > 0) & (returned > 0) & near
    if good.sum() >= parameters.enough:
        good &= error <= np.quantile(error[good], parameters.most_alike)
    return found[:, 0].astype(np.float64) + corners[1], good


def _aligned(
    source: ByteImage, target: ByteImage, points: FloatImage, start: FloatImage, parameters: AlignmentParameters
) -> Tuple[FloatImage, ByteImage, FloatImage]:
    """(N, 1, 2) positions in the target, (N,) whether found, (N,) mean difference of the neighbourhoods."""
    window, flags = (parameters.window_px,) * 2, cv2.OPTFLOW_USE_INITIAL_FLOW
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, parameters.iterations, parameters.stop_px)
    guess, least = start.copy(), parameters.least_texture
    found = cv2.calcOpticalFlowPyrLK(source, target, points, guess, None, None, window, 0, stop, flags, least)
    places, status, error = (np.asarray(part) for part in found)
    return places, status[:, 0], error[:, 0]


def _distance(a: FloatImage, b: FloatImage) -> FloatImage:
    return np.asarray(np.hypot(*(a - b)[:, 0].T))


def _evened(
    view: View, stretch: Stretch, to_original: PixelMap, size: Size, parameters: AlignmentParameters
) -> ByteImage:
    """The view as (rows, columns), with locally even intensity and contrast.

    Registration assumes that a ground point has the same intensity in both views. Under another sun or in another
    season it has not, and ties would be dropped or displaced.
    """
    with opened_masked(view.image, view.mask) as dataset:
        pixels = np.nan_to_num(stretch.apply(warp(dataset, view.band, to_original, size, "cubic")), nan=0.0)
    away = pixels - cv2.GaussianBlur(pixels, (0, 0), parameters.even_px)
    contrast = np.sqrt(cv2.GaussianBlur(away * away, (0, 0), parameters.even_px))
    evened = 128.0 + parameters.even_contrast * away / (contrast + parameters.noise)
    return np.asarray(np.clip(evened, 0, 255).astype(np.uint8))
