"""Tie points to a tenth of a pixel: each is aligned, at full resolution, with its neighbourhood in one other view.

SIFT on reduced images places a keypoint to some half pixel. Lucas and Kanade's registration (1981; OpenCV's
implementation) of rectified neighbourhoods, which look alike but for the parallax, brings the spread of row
differences from 0.5 px to 0.1 px on real and simulated Pleiades pairs. What does not find its way back, or looks
least alike, is dropped: windows across the edge of a roof hold two parallaxes, and err to one side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..geometry.frames import projected_from_geodetic
from ..geometry.refinement import translation
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked
from ..imagery.warping import PixelMap, warp
from ..parallel import run_tasks
from ..progress import Progress
from ..scene import Scene, View
from ..stereo.pairing import grown, rectified_pair
from ..stereo.rectification import RectifiedPair
from .adjustment import Track

Indices = NDArray[np.intp]

_WINDOW = 11
_MARGIN_PX = 24
_PATCH_PX = 1700  # images are aligned in patches of at most so many px a side
_GAP = 0.1  # of that side: nothing is aligned between ties that are farther apart
_FARTHEST_PX = 1.5  # SIFT is never so wrong: what moves farther has found something else
_RETURN_PX = 0.1  # from the first image to the second and back
_MOST_ALIKE = 0.7  # of a patch's ties, those whose neighbourhoods differ least
_ENOUGH = 30  # with fewer ties in a patch, none is dropped for looking less alike
_EVEN_PX = 5.0  # standard deviation of the neighbourhood in which brightness and contrast are made even
_EVEN_CONTRAST = 40.0  # standard deviation of grey values afterwards
_NOISE = 0.012  # contrast of the stretched image, 0..1, that is as likely noise and is not made even
_LEAST_TEXTURE = 1e-3  # smallest eigenvalue of the gradients' matrix, as OpenCV normalises it


@dataclass(frozen=True)
class _Task:
    """What a worker needs: for each pair of views the tracks' numbers and their (n, 2) pixels in both."""

    scene: Scene
    bounds: Tuple[float, float, float, float]
    pairs: Dict[Tuple[str, str], Tuple[Indices, FloatArray, FloatArray]]
    stretches: Dict[str, Stretch]


def sharpen(
    scene: Scene, tracks: Sequence[Track], stretches: Dict[str, Stretch], progress: Progress, workers: int = 0
) -> List[Track]:
    """Align each track's pixels with those of its first view (which stay); a pixel that finds no hold is dropped.

    Tracks that keep fewer than two views are dropped too.
    """
    if not tracks:
        return []
    order = [view.name for view in scene.views]
    seen = [[name for name in order if name in track.pixels] for track in tracks]
    xy = _places(scene, tracks, seen)
    lean = scene.lean()
    tasks = []
    for members in clusters(xy, np.arange(len(tracks)), _PATCH_PX * scene.gsd_m):
        pairs: Dict[Tuple[str, str], List[int]] = {}
        for number in members:
            for other in seen[number][1:]:
                pairs.setdefault((seen[number][0], other), []).append(number)
        low, high = xy[members].min(axis=0), xy[members].max(axis=0)
        tasks.append(
            _Task(
                lean,
                (*map(float, low), *map(float, high)),
                {
                    pair: (np.array(numbers), *(np.array([tracks[k].pixels[name] for k in numbers]) for name in pair))
                    for pair, numbers in sorted(pairs.items())
                },
                stretches,
            )
        )
    sharp: Dict[Tuple[int, str], FloatArray] = {}
    for found in run_tasks(_sharpen_patch, tasks, workers, progress, lambda _: "sharpening tie points"):
        sharp.update(found)
    result = []
    for number, (track, names) in enumerate(zip(tracks, seen)):
        pixels = {names[0]: track.pixels[names[0]]}
        pixels.update({name: sharp[number, name] for name in names[1:] if (number, name) in sharp})
        if len(pixels) >= 2:
            result.append(Track(pixels))
    return result


def _places(scene: Scene, tracks: Sequence[Track], seen: Sequence[List[str]]) -> FloatArray:
    """(N, 2) about where tracks are, in the scene's CRS: their first pixel at the middle altitude."""
    xy = np.empty((len(tracks), 2))
    for view in scene.views:
        own = [number for number, names in enumerate(seen) if names[0] == view.name]
        if own:
            pixels = np.array([tracks[number].pixels[view.name] for number in own])
            xy[own] = projected_from_geodetic(scene.crs, view.localise(pixels, sum(scene.altitudes) / 2))
    return xy


def clusters(xy: FloatArray, members: Indices, side: float) -> List[Indices]:
    """Split points at gaps wider than a tenth of a side, where nothing need be aligned, and down to a side's extent."""
    orders = [members[np.argsort(xy[members, axis], kind="stable")] for axis in (0, 1)]
    gaps = [np.diff(xy[order, axis]) for axis, order in enumerate(orders)]
    axis = int(np.argmax([gap.max(initial=0.0) for gap in gaps]))
    if gaps[axis].max(initial=0.0) > _GAP * side:
        at = int(gaps[axis].argmax()) + 1
    else:
        extent = np.ptp(xy[members], axis=0)
        axis = int(extent.argmax())
        if extent[axis] <= side:
            return [members]
        values = xy[orders[axis], axis]
        at = int(np.clip(np.searchsorted(values, (values[0] + values[-1]) / 2), 1, len(values) - 1))
    return clusters(xy, orders[axis][:at], side) + clusters(xy, orders[axis][at:], side)


def _sharpen_patch(task: _Task) -> Dict[Tuple[int, str], FloatArray]:
    """The new pixels of those tracks that hold, by track and second view."""
    result: Dict[Tuple[int, str], FloatArray] = {}
    bounds = grown(task.bounds, _MARGIN_PX * task.scene.gsd_m)
    for names, (numbers, first_px, second_px) in task.pairs.items():
        views = tuple(task.scene.view(name) for name in names)
        pair = rectified_pair(task.scene, *views, bounds, task.scene.altitudes)
        if pair is None:
            continue
        a, b = pair.first_rectified(first_px), pair.second_rectified(second_px)
        inside = np.flatnonzero(((a >= 0) & (a < pair.size)).all(axis=1) & np.isfinite(b).all(axis=1))
        if not len(inside):
            continue
        moved, good = _registered(pair, views, tuple(task.stretches[name] for name in names), a[inside], b[inside])
        pixels = pair.second_original(moved)
        result.update({(int(numbers[k]), names[1]): pixel for k, pixel in zip(inside[good], pixels[good])})
    return result


def _registered(
    pair: RectifiedPair, views: Tuple[View, View], stretches: Tuple[Stretch, Stretch], a: FloatArray, b: FloatArray
) -> Tuple[FloatArray, NDArray[np.bool_]]:
    """(N, 2) positions in the second image that look like ``a`` in the first, and which of them hold."""
    # Each image in a frame that just holds its points, wherever the RPCs' errors put them.
    corners = [np.floor(points.min(axis=0)) - _MARGIN_PX for points in (a, b)]
    size = np.max([np.ceil(points.max(axis=0) - corner) for points, corner in zip((a, b), corners)], axis=0)
    size = (int(size[0]) + _MARGIN_PX, int(size[1]) + _MARGIN_PX)
    frames = RectifiedPair(
        pair.first,
        pair.second,
        translation(*-corners[0]) @ pair.h_first,
        translation(*-corners[1]) @ pair.h_second,
        size,
    )
    images = [
        _grey(view, stretch, to_original, size)
        for view, stretch, to_original in zip(views, stretches, (frames.first_original, frames.second_original))
    ]
    here, there = (points.astype(np.float32)[:, None] for points in (a - corners[0], b - corners[1]))
    found, status, error = _aligned(images[0], images[1], here, there)
    back, returned, _ = _aligned(images[1], images[0], found, here)
    good = (
        (status > 0) & (returned > 0) & (_distance(found, there) < _FARTHEST_PX) & (_distance(back, here) < _RETURN_PX)
    )
    if good.sum() >= _ENOUGH:
        good &= error <= np.quantile(error[good], _MOST_ALIKE)
    return found[:, 0].astype(np.float64) + corners[1], good


def _aligned(
    source: NDArray[np.uint8], target: NDArray[np.uint8], points: NDArray[np.float32], start: NDArray[np.float32]
) -> Tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
    """(N, 1, 2) positions in the target, (N,) whether found, (N,) mean difference of the neighbourhoods."""
    found, status, error = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points,
        start.copy(),
        winSize=(_WINDOW, _WINDOW),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.005),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=_LEAST_TEXTURE,
    )
    return found, status[:, 0], error[:, 0]


def _distance(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.hypot(*(a - b)[:, 0].T)


def _grey(view: View, stretch: Stretch, to_original: PixelMap, size: Tuple[int, int]) -> NDArray[np.uint8]:
    """The view as (rows, columns), its brightness and contrast made locally even.

    Registration takes a ground point for equally bright in both views. Under another sun or in another season it is
    not, and ties were dropped or pulled aside.
    """
    with opened_masked(view.image, view.mask) as dataset:
        pixels = np.nan_to_num(stretch.apply(warp(dataset, view.band, to_original, size, "cubic")), nan=0.0)
    away = pixels - cv2.GaussianBlur(pixels, (0, 0), _EVEN_PX)
    contrast = np.sqrt(cv2.GaussianBlur(away * away, (0, 0), _EVEN_PX))
    return np.clip(128.0 + _EVEN_CONTRAST * away / (contrast + _NOISE), 0, 255).astype(np.uint8)
