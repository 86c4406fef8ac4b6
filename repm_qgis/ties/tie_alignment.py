"""Subpixel tie points: each one is aligned, at full resolution, with its neighbourhood in one other view.

SIFT on reduced images places a keypoint to about half a pixel. Lucas and Kanade's registration (1981; OpenCV's
implementation) works on rectified neighbourhoods, which differ by the parallax only. Two kinds of positions are
dropped: those from which the alignment back to the first image does not return to the start, and those whose
neighbourhoods differ most: a window across the edge of a roof holds two parallaxes, and its error always has the same
direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import Bounds, ByteImage, FloatArray, FloatImage, Mask, Size
from ..geometry.frames import projected_from_geodetic
from ..geometry.rectification import RectifiedPair
from ..geometry.refinement import translation
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked
from ..imagery.sampling import known_or_zero
from ..imagery.warping import PixelMap, gaussian_mean, warp_coarsened
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..runtime.spare_cores import spread
from ..scene import Scene, View
from ..stereo.pairing import rectified_pair, reductions
from .parameters import TIES, AlignmentParameters
from .tracks import Track, track_pixels

Indices = NDArray[np.intp]
Pair = Tuple[str, str]


Step = Tuple[int, str, str]  # how many steps from a track's first view, and the views of one alignment


@dataclass(frozen=True)
class _AlignTask:
    """What a worker needs: the tracks' pixels by their numbers, and for each step the numbers of its tracks."""

    scene: Scene
    bounds: Bounds
    steps: Dict[Step, List[int]]
    pixels: Dict[int, Dict[str, FloatArray]]
    stretches: Dict[str, Stretch]
    parameters: AlignmentParameters


def align_ties(
    scene: Scene,
    tracks: Sequence[Track],
    pairs: Sequence[Pair],
    *,
    stretches: Dict[str, Stretch],
    progress: Progress,
    workers: int = 0,
    parameters: AlignmentParameters = TIES.alignment,
) -> List[Track]:
    """Align each track's pixels, from those of its first view on, along the ``pairs`` that its ties were found in.

    These are pairs of similar sun and season, and views of many dates need few of them. Where a pixel cannot be
    aligned, the views beyond it are a track of their own; tracks that keep fewer than two views are dropped.
    """
    if not tracks:
        return []
    order = [view.name for view in scene.views]
    seen = [[name for name in order if name in track.pixels] for track in tracks]
    xy = _places(scene, tracks, seen)
    lean = scene.lean()
    tasks = []
    for members in clusters(xy, np.arange(len(tracks)), parameters.patch_px * scene.gsd_m, parameters.gap):
        steps: Dict[Step, List[int]] = {}
        for number in map(int, members):
            for step in _steps(seen[number], pairs):
                steps.setdefault(step, []).append(number)
        steps = {step: steps[step] for step in sorted(steps, key=lambda step: (step[0], *map(order.index, step[1:])))}
        bounds = Bounds.between(xy[members].min(axis=0), xy[members].max(axis=0))
        pixels = {int(number): tracks[number].pixels for number in members}
        tasks.append(_AlignTask(lean, bounds, steps, pixels, stretches, parameters))
    aligned: Dict[int, List[Track]] = {}
    for found in run_tasks(_align_patch, tasks, workers, progress, lambda _: "aligning tie points"):
        aligned.update(found)
    return [track for number in sorted(aligned) for track in aligned[number]]


def _steps(names: Sequence[str], pairs: Sequence[Pair]) -> List[Step]:
    """From the first of some views to all that pairs lead to, each by as few pairs as possible."""
    found: List[Step] = []
    queue, known = [(0, names[0])], {names[0]}
    for depth, name in queue:
        for pair in pairs:
            if name in pair:
                other = pair[1] if pair[0] == name else pair[0]
                if other in names and other not in known:
                    known.add(other)
                    queue.append((depth + 1, other))
                    found.append((depth, name, other))
    return found


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


@dataclass(frozen=True)
class _Frames:
    """Two rectified views where they have ties: ``images`` of one size, and which rectified pixels are their first."""

    pair: RectifiedPair
    names: Pair
    images: Tuple[ByteImage, ByteImage]
    corners: Tuple[FloatArray, FloatArray]

    def places(self, name: str, pixels: FloatArray) -> FloatArray:
        """(N, 2) column and row, in the image of a view, of pixels of that view."""
        first = name == self.names[0]
        rectified = self.pair.first_rectified(pixels) if first else self.pair.second_rectified(pixels)
        return rectified - self.corners[0 if first else 1]

    def pixels(self, name: str, places: FloatArray) -> FloatArray:
        """The inverse of :meth:`places`."""
        if name == self.names[0]:
            return self.pair.first_original(places + self.corners[0])
        return self.pair.second_original(places + self.corners[1])

    def holds(self, places: FloatArray) -> Mask:
        """(N,) which places lie in the images."""
        inside: Mask = ((places >= 0) & (places < self.images[0].shape[::-1])).all(axis=1)
        return inside


def _align_patch(task: _AlignTask) -> Dict[int, List[Track]]:
    """The aligned tracks, by the numbers of those that they are made of."""
    places = {number: dict(pixels) for number, pixels in task.pixels.items()}
    roots = {number: {name: name for name in pixels} for number, pixels in task.pixels.items()}
    order = [view.name for view in task.scene.views]
    kept: Dict[Pair, _Frames] = {}
    room = task.parameters.kept_px
    for (_, source, target), numbers in task.steps.items():
        names = (source, target) if order.index(source) < order.index(target) else (target, source)
        frames = kept.get(names) or _frames(task, names)
        if frames is None:
            continue
        if names not in kept and frames.images[0].size <= room:  # pairs come again, for tracks that begin elsewhere
            kept[names], room = frames, room - frames.images[0].size
        here, there = (frames.places(name, np.array([places[k][name] for k in numbers])) for name in (source, target))
        first, second = (frames.images[names.index(name)] for name in (source, target))
        inside = np.flatnonzero(frames.holds(here) & frames.holds(there))
        if not len(inside):
            continue
        moved, good = _registered(first, second, here[inside], there[inside], task.parameters)
        for k, pixel in zip(inside[good], frames.pixels(target, moved[good])):
            places[numbers[k]][target] = pixel
            roots[numbers[k]][target] = roots[numbers[k]][source]
    return {number: _tracks(places[number], roots[number]) for number in task.pixels}


def _frames(task: _AlignTask, names: Pair) -> Optional[_Frames]:
    """Of all tracks that both views see; None where the frame of the ground holds none of them."""
    scene, margin = task.scene, task.parameters.margin_px
    first, second = (scene.view(name) for name in names)
    pair = rectified_pair(scene, first, second, task.bounds.grown(margin * scene.gsd_m), scene.altitudes)
    if pair is None:
        return None
    both = [pixels for pixels in task.pixels.values() if names[0] in pixels and names[1] in pixels]
    first_px, second_px = (np.array([pixels[name] for pixels in both]) for name in names)
    a, b = pair.first_rectified(first_px), pair.second_rectified(second_px)
    inside = ((a >= 0) & (a < pair.size)).all(axis=1) & np.isfinite(b).all(axis=1)
    if not inside.any():
        return None
    # Each image has a frame that just holds its points, wherever the errors of the RPCs put them.
    points = a[inside], b[inside]
    corners = [np.floor(own.min(axis=0)) - margin for own in points]
    extent = np.max([np.ceil(own.max(axis=0) - corner) for own, corner in zip(points, corners)], axis=0)
    size = (int(extent[0]) + margin, int(extent[1]) + margin)
    h_first, h_second = (translation(*-corner) @ h for corner, h in zip(corners, (pair.h_first, pair.h_second)))
    cut = RectifiedPair(pair.first, pair.second, h_first, h_second, size)
    images = zip((first, second), (cut.first_original, cut.second_original), reductions(first, second))
    evened = spread(
        lambda image: _evened(image[0], task.stretches[image[0].name], image[1], size, image[2], task.parameters),
        list(images),
    )
    return _Frames(pair, names, (evened[0], evened[1]), (corners[0], corners[1]))


def _tracks(pixels: Dict[str, FloatArray], roots: Dict[str, str]) -> List[Track]:
    """One track for all pixels that were aligned with that of the same view."""
    groups: Dict[str, Dict[str, FloatArray]] = {}
    for name, root in roots.items():
        groups.setdefault(root, {})[name] = pixels[name]
    return [Track(group) for group in groups.values() if len(group) > 1]


def _registered(
    source: ByteImage, target: ByteImage, here: FloatArray, there: FloatArray, parameters: AlignmentParameters
) -> Tuple[FloatArray, Mask]:
    """(N, 2) places in the target, near ``there``, that look like those ``here`` in the source; which are good."""
    points, start = (part.astype(np.float32)[:, None] for part in (here, there))

    def tried(window: int, most_off: float) -> Tuple[FloatImage, Mask, FloatImage]:
        found, status, error = _aligned(source, target, points, start, window, parameters)
        back, returned, _ = _aligned(target, source, found, points, window, parameters)
        near = (_distance(found, start) < parameters.farthest_px) & (_distance(back, points) < most_off)
        return found, (status > 0) & (returned > 0) & near, error

    found, good, error = tried(parameters.window_px, parameters.return_px)
    if good.mean() < parameters.least_alike:
        found, good, error = tried(parameters.wide_px, parameters.wide_return_px)
    if good.sum() >= parameters.enough:
        good &= error <= np.quantile(error[good], parameters.most_alike)
    return found[:, 0].astype(np.float64), good


def _aligned(
    source: ByteImage,
    target: ByteImage,
    points: FloatImage,
    start: FloatImage,
    side: int,
    parameters: AlignmentParameters,
) -> Tuple[FloatImage, ByteImage, FloatImage]:
    """(N, 1, 2) positions in the target, (N,) whether found, (N,) mean difference of the neighbourhoods."""
    window, flags = (side, side), cv2.OPTFLOW_USE_INITIAL_FLOW
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, parameters.iterations, parameters.stop_px)
    guess, least = start.copy(), parameters.least_texture
    found = cv2.calcOpticalFlowPyrLK(source, target, points, guess, None, None, window, 0, stop, flags, least)
    places, status, error = (np.asarray(part) for part in found)
    return places, status[:, 0], error[:, 0]


def _distance(a: FloatImage, b: FloatImage) -> FloatImage:
    return np.asarray(np.hypot(*(a - b)[:, 0].T))


def _evened(
    view: View, stretch: Stretch, to_original: PixelMap, size: Size, ratio: float, parameters: AlignmentParameters
) -> ByteImage:
    """The view as (rows, columns), ``ratio`` times as coarse, with locally even intensity and contrast.

    Registration assumes that a ground point has the same intensity in both views. Under another sun or in another
    season this is not true, and ties would be dropped or displaced.
    """
    with opened_masked(view.image, view.mask) as dataset:
        pixels = known_or_zero(stretch.apply(warp_coarsened(dataset, view.band, to_original, size, "cubic", ratio)))
    mean = gaussian_mean(np.ones(pixels.shape, bool), parameters.even_px)
    away = pixels - mean(pixels)
    contrast = np.sqrt(mean(away * away))
    evened = 128.0 + parameters.even_contrast * away / (contrast + parameters.noise)
    return np.asarray(np.clip(evened, 0, 255).astype(np.uint8))
