"""The backend that runs a matcher of rectified pairs over all tiles and pairs: from images to height maps on disk."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from itertools import product
from typing import Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, Bounds, FloatImage, Mask, Size, Window
from ..contracts.errors import EmptyResultError
from ..contracts.options import INTENSITY, LEARNED, ReconstructOptions
from ..contracts.records import HeightMapRecord, ViewPair
from ..geometry.rectification import RectifiedPair
from ..geometry.refinement import translation
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked
from ..imagery.warping import PixelMap, SourcePixels, coarsened, source_pixels
from ..runtime.memory import matching_mib, tile_work, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import KEPT, Part, Progress, Silent, Uneven, slow_down
from ..runtime.spare_cores import side_by_side, spread
from ..runtime.workspace import drop_temporaries, fingerprint
from ..scene import Scene, Tile
from ..stereo.height_maps import HeightSource, finished_record, foreign_height_map, has_key, write_height_map
from ..stereo.pairing import rectified_pair, reductions
from ..stereo.parameters import STEREO, StereoParameters
from ..stereo.triangulation import PairGeometry, pair_geometry
from ..stereo.wave_change import WaveGeometry, wave_geometry
from . import learned
from .backends import MatchingJob, MatchingResult
from .disparity_map import DisparityMap, PairMatcher
from .disparity_prior import (
    DisparityPrior,
    ReducedPair,
    coarse_level,
    find_prior,
    needs_coarse_level,
    sampled_on,
)
from .parameters import MATCHING, LearnedParameters, MatchingParameters, PriorParameters
from .reliability import mask_unreliable, shown_twice
from .wide_windows import wide_match

_LEARNED, _MEASURED = 5.0, 0.1
"""Of the time of matching by intensities: by features, and a pair's agreement."""


@dataclass(frozen=True)
class PairBackend:
    """A matcher of pairs as a backend (:class:`repm_qgis.matching.backends.Backend`). It runs on every machine."""

    name: str
    pair_matcher: PairMatcher

    def usable(self) -> bool:
        return True

    def remedy(self) -> str:
        return ""

    def settings(self, options: ReconstructOptions) -> List[object]:
        return []

    def match(self, job: MatchingJob, progress: Progress) -> MatchingResult:
        """Match every pair over every tile that both of its views see, in as many workers as fit into memory."""
        tasks = self._tasks(job)
        measured = unsure_tasks(job, tasks)
        times = [KEPT if has_key(task.path, task.key) else 1.0 for task in tasks]
        choice = _MEASURED * len(measured) / (_MEASURED * len(measured) + sum(times) or 1.0)
        costs = choose_costs(job, measured, Part(progress, 0.0, choice))
        tasks = [task.matched_by(costs[task.pair]) for task in tasks]
        before, times = sum(times), [t * (_LEARNED if task.cost == LEARNED else 1.0) for t, task in zip(times, tasks)]
        expected = expected_factor(job.pairs, job.options.matching_cost, job.parameters.learned)
        slow_down(progress, sum(times) / (expected * before or 1.0))
        workers = _workers(tasks, job, progress)
        try:
            records = run_tasks(match_to_disk, tasks, workers, Uneven(progress, choice, 1.0, times), _describe)
        except BaseException:
            drop_temporaries(job.folder)  # a worker that is ended while it writes cannot clean up
            raise
        return MatchingResult(records, {})

    def share_left(self, job: MatchingJob) -> float:
        places = list(_places(job))
        return sum(not has_key(path, key) for _, _, path, key in places) / max(len(places), 1)

    def _tasks(self, job: MatchingJob) -> List[PairTask]:
        """Every pair over every tile that both of its views see, matched by intensities."""
        scene, parameters = job.scene.lean(), job.parameters.of_pairs(len(job.pairs))
        return [
            PairTask(
                backend=self,
                scene=scene,
                tile=tile.id,
                bounds=tile.bounds,
                altitudes=tile.altitudes,
                pair=pair.names,
                stretches=(job.stretches[pair.first], job.stretches[pair.second]),
                path=path,
                key=key,
                parameters=parameters,
            )
            for tile, pair, path, key in _places(job)
        ]

    def height_source(
        self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters
    ) -> HeightSource:
        pair = rectified_over_tile(scene, record.pair, bounds, record.altitudes, parameters.stereo)
        if pair is None or pair.size != record.size:
            raise foreign_height_map(record, scene)
        first, second = (scene.view(name) for name in record.pair)
        geometry = pair_geometry(pair, first, second, record.altitudes, crs, parameters.stereo)
        return HeightSource(record.file, geometry.x, geometry.y, record.size, record.altitudes)

    def wave_geometry(
        self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters
    ) -> Optional[WaveGeometry]:
        pair = rectified_over_tile(scene, record.pair, bounds, record.altitudes, parameters.stereo)
        if pair is None or pair.size != record.size:
            raise foreign_height_map(record, scene)
        first, second = (scene.view(name) for name in record.pair)
        geometry = pair_geometry(pair, first, second, record.altitudes, crs, parameters.stereo)
        return wave_geometry(pair, geometry, first, second, record.altitudes, parameters.stereo)


def _places(job: MatchingJob) -> Iterator[Tuple[Tile, ViewPair, str, str]]:
    """Every tile with every pair of views that see it, the path of the height map, and its fingerprint."""
    for tile, pair in product(job.tiles, job.pairs):
        if pair.first in tile.views and pair.second in tile.views:
            path = os.path.join(job.folder, f"{tile.id}_{pair.first}_{pair.second}.tif")
            yield tile, pair, path, fingerprint(job.key, tile.id, pair.first, pair.second)


class PairCost(NamedTuple):
    """What a pair is matched by: its ``cost``, and the share of the ground, 0..1, on which the intensities of its
    images agree, where these are ``unlike`` each other."""

    cost: str
    alike: float = 1.0

    @property
    def unlike(self) -> bool:
        """Whether penalties are those of intensities that say little."""
        return self.cost == INTENSITY and self.alike < 1.0


@dataclass(frozen=True)
class PairTask:
    """All a worker needs: the scene without its tiles, the pair, the tile's ground and altitudes, where to write."""

    backend: PairBackend
    scene: Scene
    tile: str
    bounds: Bounds
    altitudes: Altitudes
    pair: Tuple[str, str]
    stretches: Tuple[Stretch, Stretch]
    path: str
    key: str
    parameters: MatchingParameters = MATCHING
    cost: str = INTENSITY
    alike: float = 1.0

    def matched_by(self, choice: PairCost) -> PairTask:
        """The same task with the cost and the penalties of its pair."""
        sgm = self.parameters.sgm.of_unlike_images() if choice.unlike else self.parameters.sgm
        return replace(self, cost=choice.cost, alike=choice.alike, parameters=replace(self.parameters, sgm=sgm))

    @property
    def pair_matcher(self) -> PairMatcher:
        return learned.match if self.cost == LEARNED else self.backend.pair_matcher


def _describe(task: PairTask) -> str:
    return f"matching tile {task.tile}, {task.pair[0]} and {task.pair[1]}"


def _workers(tasks: Sequence[PairTask], job: MatchingJob, progress: Progress) -> int:
    """How many workers the memory allows; tiles are alike, so the one with the widest altitudes stands for all."""
    if not tasks:
        return job.options.workers
    task = max(tasks, key=lambda t: (t.altitudes[1] - t.altitudes[0]) / t.scene.matched_gsd_m(t.pair))
    slope = max(pair.base_to_height for pair in job.pairs)
    disparities = (task.altitudes[1] - task.altitudes[0]) * slope / task.scene.matched_gsd_m(task.pair)
    side = max(task.bounds[2] - task.bounds[0], task.bounds[3] - task.bounds[1]) / task.scene.gsd_m
    width, height = frame_size(task)
    paths = max(8 if each.cost == LEARNED else each.parameters.sgm.paths for each in tasks)
    each = matching_mib(width, height, disparities, paths)
    return workers_within(job.options.workers, tile_work(math.ceil(side), each), job.options.memory, progress)


def expected_factor(pairs: Sequence[ViewPair], cost: str, parameters: LearnedParameters) -> float:
    """How many times as long as by intensities matching may take: half of the pairs of several days are taken to be
    unlike, and a fifth of those without dates."""
    unsure = [is_unsure(pair, parameters) * (0.2 if pair.days is None else 0.5) for pair in pairs]
    share = {INTENSITY: 0.0, LEARNED: 1.0}.get(cost, float(np.mean(unsure)))
    return 1.0 + (_LEARNED - 1.0) * share


def is_unsure(pair: ViewPair, parameters: LearnedParameters) -> bool:
    """Whether a pair's images are not of one day, as far as is known: their intensities may not agree."""
    return pair.days is None or pair.days >= parameters.least_days


def unsure_tasks(job: MatchingJob, tasks: Sequence[PairTask]) -> List[PairTask]:
    """A few tasks of each pair whose intensities may not agree, to be measured."""
    p, measured = job.parameters.learned, []
    if job.options.matching_cost == LEARNED:
        return []
    unsure = {pair.names for pair in job.pairs if is_unsure(pair, p)}
    for names in sorted(unsure):
        own = [task for task in tasks if task.pair == names]
        measured += own[:: max(-(-len(own) // p.measured_tiles), 1)]
    return measured


def choose_costs(job: MatchingJob, measured: Sequence[PairTask], progress: Progress) -> Dict[Tuple[str, str], PairCost]:
    """What each pair is matched by, by the names of its views; ``measured`` are :func:`unsure_tasks`.

    Images of one day are alike, and others where their intensities agree: where the coarse level of a few tiles has
    enough disparities that both directions of matching confirm. With ``auto``, unlike ones are matched by features.
    """
    chosen, p = job.options.matching_cost, job.parameters.learned
    if chosen == LEARNED:
        return {pair.names: PairCost(LEARNED) for pair in job.pairs}
    counts: Dict[Tuple[str, str], List[Tuple[int, int]]] = {}
    workers = _workers(measured, job, Silent())
    for task, count in zip(measured, run_tasks(agreement, measured, workers, progress, _describe)):
        counts.setdefault(task.pair, []).append(count)
    shares = {}
    for pair in job.pairs:
        agreed, shown = (sum(part) for part in zip(*counts.get(pair.names, [(0, 0)])))
        if shown and agreed / shown < (p.most_undated if pair.days is None else p.most_agreement):
            shares[pair.names] = agreed / shown
    if shares:
        least, most = (100 * end(shares.values()) for end in (min, max))
        how = "with higher penalties" if chosen == INTENSITY else "by learned features"
        progress.info(
            f"{len(shares)} of {len(job.pairs)} pairs are matched {how}: the intensities of their images "
            f"agree on {least:.0f} to {most:.0f} % of the ground (MATCHING_COST)."
        )
    cost = INTENSITY if chosen == INTENSITY else LEARNED
    alike = {pair.names: shares.get(pair.names, 1.0) for pair in job.pairs}
    return {names: PairCost(cost if share < 1.0 else INTENSITY, share) for names, share in alike.items()}


def agreement(task: PairTask) -> Tuple[int, int]:
    """Of the reduced first image of a pair over a tile, the pixels that intensities match in both directions, and those
    that both images can show."""
    posed = _posed(task)
    if posed is None:
        return 0, 0
    pair, geometry = posed
    small = _Frame(task, pair, geometry).reduced()
    match = task.backend.pair_matcher
    found = match(small.first, small.second, small.disparities, geometry.height_sign, parameters=task.parameters)
    shown = shown_twice(small.first, small.second, small.disparities)
    return int((shown & np.isfinite(found.disparity) & ~found.filled).sum()), int(shown.sum())


def match_to_disk(task: PairTask) -> Optional[HeightMapRecord]:
    """Match a tile and keep its height map in a file; gives the record, None without common ground.

    A file that an earlier, stopped run has finished is taken as it is (``reused`` in the record).
    """
    done = finished_record(task.path, task.key)
    if done is not None:
        return done
    tile = match_tile(task)
    if tile is None:
        return None
    return write_height_map(task.path, task.key, tile.record, tile.heights, tile.score, tile.filled)


class MatchedTile(NamedTuple):
    """A pair's ``heights`` over a tile in metres, NaN where there are none, and the ``score`` of each.

    ``filled`` tells which of them a neighbour gave. All are (H, W), in the rectified frame of the record.
    """

    record: HeightMapRecord
    heights: FloatImage
    score: FloatImage
    filled: Mask


def _posed(task: PairTask) -> Optional[Tuple[RectifiedPair, PairGeometry]]:
    """A task's rectified pair and its geometry; None without common ground."""
    pair = rectified_over_tile(task.scene, task.pair, task.bounds, task.altitudes, task.parameters.stereo)
    if pair is None or min(pair.size) < task.parameters.stereo.smallest_px:
        return None
    first, second = (task.scene.view(name) for name in task.pair)
    try:
        return pair, pair_geometry(pair, first, second, task.altitudes, task.scene.crs, task.parameters.stereo)
    except EmptyResultError:
        return None


def match_tile(task: PairTask) -> Optional[MatchedTile]:
    """Rectify, match, and turn disparities into heights; None without common ground."""
    posed = _posed(task)
    if posed is None:
        return None
    pair, geometry = posed
    matched = match_pair(task, pair, geometry)
    columns, rows = np.arange(pair.size[0], dtype=np.float64), np.arange(pair.size[1], dtype=np.float64)
    heights = geometry.height.on_grid(columns, rows, matched.disparity.astype(np.float64)).astype(np.float32)
    record = HeightMapRecord(
        tile=task.tile,
        backend=task.backend.name,
        pair=task.pair,
        metres_per_px=geometry.metres_per_px,
        vertical_parallax_px=geometry.vertical_parallax_px,
        table_error_m=geometry.error_m,
        altitudes=task.altitudes,
        cost=task.cost,
        alike=task.alike,
    )
    return MatchedTile(record, heights, matched.score, matched.filled)


def frame_size(task: PairTask) -> Size:
    """Width and height of the rectified frame in which a tile is matched; 0 where the views do not share it."""
    pair = rectified_over_tile(task.scene, task.pair, task.bounds, task.altitudes, task.parameters.stereo)
    return pair.size if pair is not None else (0, 0)


class SampledPair(NamedTuple):
    """A rectified pair as a matcher gets it: ``first``, ``second`` and the ``disparities`` to search.

    ``window`` is the part of the rectified frame that shows the tile. With a ``prior``, the second image is resampled
    on it and the disparities are residual ones. ``reduced`` gives the pair as the coarse level has it.
    """

    first: FloatImage
    second: FloatImage
    disparities: Tuple[int, int]
    window: Window
    prior: Optional[DisparityPrior]
    reduced: Callable[[], ReducedPair]

    def full_disparity(self, disparity: FloatImage) -> FloatImage:
        """Disparities (H, W) of the rectified images from those of the matcher."""
        return disparity if self.prior is None else self.prior.full_disparity(disparity)


class _Frame:
    """What the frame of a task's pair is sampled from, over the disparities of all altitudes with their margin."""

    def __init__(self, task: PairTask, pair: RectifiedPair, geometry: PairGeometry) -> None:
        self.search = low, high = _whole_range(geometry, task.parameters.prior)
        (width, height), self._factor = pair.size, task.parameters.prior.factor
        self.moved = replace(pair, h_second=translation(high, 0) @ pair.h_second)
        self._sizes = (pair.size, (width + high - low, height))
        self._maps = (self.moved.first_original, self.moved.second_original)
        self.first, self.second = spread(lambda k: _source(task, k, self._maps[k], self._sizes[k]), (0, 1))
        self._reduced: Optional[ReducedPair] = None

    def reduced(self) -> ReducedPair:
        """The pair as the coarse level has it."""
        if self._reduced is None:
            sources, factor = (self.first, self.second), self._factor
            a, b = spread(lambda k: _reduced(sources[k], self._maps[k], self._sizes[k], factor), (0, 1))
            self._reduced = ReducedPair(a, b, (self.search[0] // self._factor, self.search[1] // self._factor))
        return self._reduced


def sample_pair(task: PairTask, pair: RectifiedPair, geometry: PairGeometry) -> SampledPair:
    """The images of a task's pair where they show the tile, on the disparity prior where that narrows the search."""
    p, (width, height), frame = task.parameters.prior, pair.size, _Frame(task, pair, geometry)
    (low, high), moved = frame.search, frame.moved
    window, prior = Window(0, 0, width, height), None
    if needs_coarse_level(frame.search, (height, width), p):
        match, sign = task.pair_matcher, geometry.height_sign
        coarse = coarse_level(frame.reduced(), (height, width), sign, match, task.parameters)
        bounds = task.bounds.grown(task.parameters.stereo.tile_margin_px * task.scene.matched_gsd_m(task.pair))
        window = coarse.window(bounds, geometry, p)
        prior = find_prior(coarse, window, geometry, p)
    left, top, width, height = window
    if prior is None:
        original = lambda at: moved.second_original(at + (left, top))  # noqa: E731
    else:
        low, high = prior.low, prior.high
        original = sampled_on(prior.second_original(pair, geometry, p.remove_parallax))
    a, b = side_by_side(
        lambda: frame.first.sampled(lambda at: pair.first_original(at + (left, top)), (width, height), "cubic"),
        lambda: frame.second.sampled(original, (width + high - low, height), "cubic"),
    )
    return SampledPair(a, b, (low, high), window, prior, lambda: frame.reduced().part(window, p.factor))


def match_pair(task: PairTask, pair: RectifiedPair, geometry: PairGeometry) -> DisparityMap:
    """Disparities of a task's rectified pair, coarse to fine, without water and clouds; NaN beside the tile."""
    seen, sign = sample_pair(task, pair, geometry), geometry.height_sign
    gsd_m, p = task.scene.matched_gsd_m(task.pair), task.parameters
    subpixel = p.subpixel.of_pair(gsd_m / geometry.metres_per_px)
    parameters, match = replace(p, subpixel=subpixel), task.pair_matcher
    matched = match(seen.first, seen.second, seen.disparities, sign, geometry.relief_displacement, parameters)

    def wider(missing: Mask) -> DisparityMap:
        return wide_match(seen.reduced(), sign, task.backend.pair_matcher, parameters, missing)

    # Clouds are detected in full disparities: a prior that lies on a cloud would hide the height of the cloud.
    kept = mask_unreliable(
        matched,
        seen.first,
        seen.second,
        disparities=seen.disparities,
        height_sign=sign,
        metres_per_px=geometry.metres_per_px,
        parameters=parameters.learned_reliability if task.cost == LEARNED else parameters.reliability,
        wider=wider if p.wide.smooth_px * p.prior.factor * gsd_m <= p.wide.most_smooth_m else None,
        full_disparity=seen.full_disparity,
    )
    return kept.in_frame(seen.window, pair.size)


def _whole_range(geometry: PairGeometry, parameters: PriorParameters) -> Tuple[int, int]:
    """Disparities of all altitudes with their margin, in whole coarse pixels."""
    factor, margin = parameters.factor, parameters.range_margin_px
    low = math.floor((geometry.disparities[0] - margin) / factor) * factor
    high = math.ceil((geometry.disparities[1] + margin) / factor) * factor
    return low, high


def _source(task: PairTask, number: int, to_original: PixelMap, size: Size) -> SourcePixels:
    """The intensities of a view that a frame of ``size`` is sampled from, as coarse as the frame is."""
    view = task.scene.view(task.pair[number])
    one, two = map(task.scene.view, task.pair)
    ratio, stretch = reductions(one, two)[number], task.stretches[number]
    with opened_masked(view.image, view.mask) as dataset:
        return source_pixels(dataset, view.band, to_original, size, lambda seen: coarsened(stretch.apply(seen), ratio))


def _reduced(source: SourcePixels, to_source: PixelMap, size: Size, factor: int) -> FloatImage:
    """A frame of ``size`` in pixels that stand for ``factor`` x ``factor`` px each."""
    small = (size[0] // factor, size[1] // factor)
    return source.reduced(factor).sampled(lambda at: to_source(factor * at + (factor - 1) / 2), small, "bilinear")


def rectified_over_tile(
    scene: Scene, pair: Tuple[str, str], bounds: Bounds, altitudes: Altitudes, parameters: StereoParameters = STEREO
) -> Optional[RectifiedPair]:
    """The rectified pair in which a tile is matched: its ground with the matching margin; None where unseen."""
    first, second = (scene.view(name) for name in pair)
    wide = bounds.grown(parameters.tile_margin_px * scene.matched_gsd_m(pair))
    return rectified_pair(scene, first, second, wide, altitudes, parameters)
