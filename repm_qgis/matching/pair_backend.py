"""The backend that runs a matcher of rectified pairs over all tiles and pairs: from images to height maps on disk."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, List, NamedTuple, Optional, Tuple

import numpy as np

from ..arrays import Altitudes, Bounds, FloatImage, Size
from ..errors import EmptyResultError
from ..geometry.refinement import translation
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked
from ..imagery.warping import PixelMap, warp
from ..memory import matching_mib, tile_work, workers_within
from ..options import ReconstructOptions
from ..parallel import run_tasks
from ..progress import Progress
from ..records import HeightMapRecord
from ..scene import Scene
from ..stereo.height_maps import HeightSource, finished_record, foreign_height_map, write_height_map
from ..stereo.pairing import rectified_pair
from ..stereo.parameters import STEREO, StereoParameters
from ..stereo.rectification import RectifiedPair
from ..stereo.triangulation import PairGeometry, pair_geometry
from ..workspace import drop_temporaries, fingerprint
from .backends import MatchingJob, MatchingResult
from .disparity_map import DisparityMap, PairMatcher
from .disparity_prior import DisparityPrior, find_prior, sampled_on
from .parameters import MATCHING, MatchingParameters, PriorParameters
from .reliability import mask_unreliable
from .wide_windows import wide_match


@dataclass(frozen=True)
class PairBackend:
    """A matcher of pairs as a backend (:class:`repm_qgis.matching.backends.Backend`). It runs on every machine."""

    name: str
    pair_matcher: PairMatcher

    def usable(self) -> bool:
        return True

    def remedy(self) -> str:
        return ""

    def settings(self, options: ReconstructOptions) -> List[Any]:
        return []

    def match(self, job: MatchingJob, progress: Progress) -> MatchingResult:
        """Match every pair over every tile that both of its views see, in as many workers as fit into memory."""
        scene = job.scene.lean()
        tasks = []
        for tile, pair in product(job.tiles, job.pairs):
            names, ground = pair.names, (tile.id, tile.bounds, tile.altitudes)
            if pair.first in tile.views and pair.second in tile.views:
                stretches = (job.stretches[pair.first], job.stretches[pair.second])
                path = os.path.join(job.folder, f"{tile.id}_{pair.first}_{pair.second}.tif")
                key = fingerprint(job.key, tile.id, *names)
                tasks.append(PairTask(self, scene, *ground, names, stretches, path, key, job.parameters))
        try:
            records = run_tasks(match_pair_over_tile, tasks, _workers(tasks, job, progress), progress, _describe)
        except BaseException:
            drop_temporaries(job.folder)  # a worker that is ended while it writes cannot clean up
            raise
        return MatchingResult(records, {})

    def height_source(
        self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, parameters: MatchingParameters
    ) -> HeightSource:
        pair = rectified_over_tile(scene, record.pair, bounds, record.altitudes, parameters.stereo)
        if pair is None or pair.size != record.size:
            raise foreign_height_map(record, scene)
        first, second = (scene.view(name) for name in record.pair)
        geometry = pair_geometry(pair, first, second, record.altitudes, crs, parameters.stereo)
        return HeightSource(record.file, geometry.x, geometry.y, record.size, record.altitudes)


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


def _describe(task: PairTask) -> str:
    return f"matching tile {task.tile}, {task.pair[0]} and {task.pair[1]}"


def _workers(tasks: List[PairTask], job: MatchingJob, progress: Progress) -> int:
    """How many workers the memory allows; tiles are alike, so the one with the widest altitudes stands for all."""
    if not tasks:
        return job.options.workers
    task = max(tasks, key=lambda t: t.altitudes[1] - t.altitudes[0])
    slope = max(pair.base_to_height for pair in job.pairs)
    disparities = (task.altitudes[1] - task.altitudes[0]) * slope / task.scene.gsd_m
    side = max(task.bounds[2] - task.bounds[0], task.bounds[3] - task.bounds[1]) / task.scene.gsd_m
    each = matching_mib(*frame_size(task), disparities, task.parameters.sgm.paths)
    return workers_within(job.options.workers, tile_work(math.ceil(side), each), job.options.memory, progress)


def match_pair_over_tile(task: PairTask) -> Optional[HeightMapRecord]:
    """Rectify, match, and turn disparities into heights; gives the height map's record, None without common ground.

    A file that an earlier, stopped run has finished is taken as it is (``reused`` in the record).
    """
    done = finished_record(task.path, task.key)
    if done is not None:
        return done
    pair = rectified_over_tile(task.scene, task.pair, task.bounds, task.altitudes, task.parameters.stereo)
    if pair is None or min(pair.size) < task.parameters.stereo.smallest_px:
        return None
    first, second = (task.scene.view(name) for name in task.pair)
    try:
        geometry = pair_geometry(pair, first, second, task.altitudes, task.scene.crs, task.parameters.stereo)
    except EmptyResultError:
        return None
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
    )
    return write_height_map(task.path, task.key, record, heights, matched.score, matched.filled)


def frame_size(task: PairTask) -> Size:
    """Width and height of the rectified frame in which a tile is matched; 0 where the views do not share it."""
    pair = rectified_over_tile(task.scene, task.pair, task.bounds, task.altitudes, task.parameters.stereo)
    return pair.size if pair is not None else (0, 0)


class SampledPair(NamedTuple):
    """A rectified pair as a matcher gets it: ``first``, ``second`` and the whole range of ``disparities``.

    ``resampled`` is the second image for the ``residuals``; without a prior they are the second image and all of the
    range.
    """

    first: FloatImage
    second: FloatImage
    disparities: Tuple[int, int]
    resampled: FloatImage
    residuals: Tuple[int, int]
    prior: Optional[DisparityPrior]


def sample_pair(task: PairTask, pair: RectifiedPair, geometry: PairGeometry) -> SampledPair:
    """The images of a task's pair, on the disparity prior where that narrows the search."""
    low, high = search = _whole_range(geometry, task.parameters.prior)
    width, height = pair.size
    shifted = RectifiedPair(pair.first, pair.second, pair.h_first, translation(high, 0) @ pair.h_second, pair.size)
    first = _intensity(task, 0, pair.first_original, pair.size)
    second = _intensity(task, 1, shifted.second_original, (width + high - low, height))
    prior = find_prior(first, second, search, geometry, task.backend.pair_matcher, task.parameters)
    if prior is None:
        return SampledPair(first, second, search, second, search, None)
    original = sampled_on(prior.second_original(pair, geometry, task.parameters.prior.remove_parallax))
    resampled = _intensity(task, 1, original, (width + prior.high - prior.low, height))
    return SampledPair(first, second, search, resampled, (prior.low, prior.high), prior)


def match_pair(task: PairTask, pair: RectifiedPair, geometry: PairGeometry) -> DisparityMap:
    """Disparities of a task's rectified pair, coarse to fine, without water and clouds."""
    seen, sign = sample_pair(task, pair, geometry), geometry.height_sign
    subpixel = task.parameters.subpixel.of_pair(task.scene.gsd_m / geometry.metres_per_px)
    parameters = replace(task.parameters, subpixel=subpixel)
    images, displacement = (seen.first, seen.resampled), geometry.relief_displacement
    matched = task.backend.pair_matcher(*images, seen.residuals, sign, displacement, parameters)
    if seen.prior is not None:
        matched = replace(matched, disparity=seen.prior.full_disparity(matched.disparity))
    # On full disparities: a prior that lies on a cloud would hide how high the cloud is.
    whole = seen.first, seen.second, seen.disparities, sign
    wider = partial(wide_match, *whole, task.backend.pair_matcher, parameters)
    return mask_unreliable(matched, *whole, geometry.metres_per_px, parameters.reliability, wider)


def _whole_range(geometry: PairGeometry, parameters: PriorParameters) -> Tuple[int, int]:
    """Disparities of all altitudes with their margin, in whole coarse pixels."""
    factor, margin = parameters.factor, parameters.range_margin_px
    low = math.floor((geometry.disparities[0] - margin) / factor) * factor
    high = math.ceil((geometry.disparities[1] + margin) / factor) * factor
    return low, high


def _intensity(task: PairTask, number: int, to_original: PixelMap, size: Size) -> FloatImage:
    view = task.scene.view(task.pair[number])
    with opened_masked(view.image, view.mask) as dataset:
        return task.stretches[number].apply(warp(dataset, view.band, to_original, size, "cubic"))


def rectified_over_tile(
    scene: Scene, pair: Tuple[str, str], bounds: Bounds, altitudes: Altitudes, parameters: StereoParameters = STEREO
) -> Optional[RectifiedPair]:
    """The rectified pair in which a tile is matched: its ground with the matching margin; None where unseen."""
    first, second = (scene.view(name) for name in pair)
    wide = Bounds(*bounds).grown(parameters.tile_margin_px * scene.gsd_m)
    return rectified_pair(scene, first, second, wide, altitudes, parameters)
