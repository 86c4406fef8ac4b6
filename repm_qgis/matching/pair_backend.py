"""The backend that runs a matcher of rectified pairs over all tiles and pairs: from images to height maps on disk."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import Any, List, Optional, Tuple

import numpy as np

from ..arrays import Altitudes, Bounds, FloatImage, Size
from ..errors import EmptyResultError, SceneError
from ..geometry.refinement import translation
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked
from ..imagery.warping import warp
from ..memory import matching_mib, workers_within
from ..options import ReconstructOptions
from ..parallel import run_tasks
from ..progress import Progress
from ..records import HeightMapRecord
from ..scene import Scene, View
from ..stereo.height_maps import MARGIN_PX, HeightSource, finished_record, map_size, write_height_map
from ..stereo.pairing import grown, rectified_pair
from ..stereo.rectification import RectifiedPair
from ..stereo.triangulation import PairGeometry, pair_geometry
from ..workspace import drop_temporary, fingerprint
from .backends import MatchingJob, MatchingResult
from .coarse import FACTOR, guide_of, sampled_on
from .disparity_map import DisparityMap, PairMatcher
from .reliability import without_unsupported

_RANGE_MARGIN_PX = 6  # disparities searched beyond the altitude range
_SMALLEST_PX = 48


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
        tasks = [
            PairTask(
                self,
                scene,
                tile.id,
                tile.bounds,
                tile.altitudes,
                (pair.first, pair.second),
                (job.stretches[pair.first], job.stretches[pair.second]),
                os.path.join(job.folder, f"{tile.id}_{pair.first}_{pair.second}.tif"),
                fingerprint(job.key, tile.id, pair.first, pair.second),
            )
            for tile in job.tiles
            for pair in job.pairs
            if pair.first in tile.views and pair.second in tile.views
        ]
        try:
            records = run_tasks(match_pair_over_tile, tasks, _workers(tasks, job, progress), progress, _describe)
        except BaseException:
            for task in tasks:  # a worker that is ended while it writes cannot clean up
                drop_temporary(task.path)
            raise
        return MatchingResult(records, {})

    def height_source(self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str) -> HeightSource:
        first, second = (scene.view(name) for name in record.pair)
        pair = rectified_over_tile(scene, first, second, bounds, record.altitudes)
        size = map_size(record.file)
        if pair is None or pair.size != size:
            raise SceneError(
                f"The height map '{record.file}' does not belong to the scene '{scene.path}': run "
                "'Reconstruct heights' again."
            )
        geometry = pair_geometry(pair, first, second, record.altitudes, crs)
        return HeightSource(record.file, geometry.x, geometry.y, size, record.altitudes)


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
    each = matching_mib(*frame_size(task), disparities)
    return workers_within(job.options.workers, each, job.options.memory, math.ceil(side), progress)


def match_pair_over_tile(task: PairTask) -> Optional[HeightMapRecord]:
    """Rectify, match, and turn disparities into heights; gives the height map's record, None without common ground.

    The file has three bands in the geometry of the rectified first image: height in metres above the ellipsoid, the
    matching score, and 1 where the height was not matched but taken from the background of an occlusion. A file
    that an earlier, stopped run has finished is taken as it is (``reused`` in the record).
    """
    done = finished_record(task.path, task.key)
    if done is not None:
        return done
    first, second = (task.scene.view(name) for name in task.pair)
    pair = rectified_over_tile(task.scene, first, second, task.bounds, task.altitudes)
    if pair is None or min(pair.size) < _SMALLEST_PX:
        return None
    try:
        geometry = pair_geometry(pair, first, second, task.altitudes, task.scene.crs)
    except EmptyResultError:
        return None
    matched = _match(task, pair, geometry, first, second)
    columns, rows = np.arange(pair.size[0], dtype=np.float64), np.arange(pair.size[1], dtype=np.float64)
    heights = geometry.height.on_grid(columns, rows, matched.disparity.astype(np.float64)).astype(np.float32)
    record = HeightMapRecord(
        tile=task.tile,
        backend=task.backend.name,
        pair=task.pair,
        file=task.path,
        size=pair.size,
        valid=int((np.isfinite(heights) & ~matched.filled).sum()),
        filled=int(matched.filled.sum()),
        metres_per_px=geometry.metres_per_px,
        vertical_parallax_px=geometry.row_px,
        table_error_m=geometry.error_m,
        altitudes=task.altitudes,
    )
    write_height_map(task.path, task.key, record, heights, matched.score, matched.filled)
    return record


def frame_size(task: PairTask) -> Size:
    """Width and height of the rectified frame that a tile is matched in; nothing where the views do not share it."""
    first, second = (task.scene.view(name) for name in task.pair)
    pair = rectified_over_tile(task.scene, first, second, task.bounds, task.altitudes)
    return pair.size if pair is not None else (0, 0)


def _match(task: PairTask, pair: RectifiedPair, geometry: PairGeometry, first: View, second: View) -> DisparityMap:
    """Disparities of the pair, coarse to fine where that narrows the search."""
    low, high = _whole_range(geometry)
    width, height = pair.size
    shifted = RectifiedPair(pair.first, pair.second, pair.h_first, translation(high, 0) @ pair.h_second, pair.size)
    a = _brightness(first, task.stretches[0], pair.first_original, (width, height))
    b = _brightness(second, task.stretches[1], shifted.second_original, (width + high - low, height))
    match = task.backend.pair_matcher
    guide = guide_of(a, b, (low, high), geometry, match)
    if guide is None:
        matched = match(a, b, (low, high), geometry.nearer, geometry.lean)
    else:
        guided = _brightness(
            second,
            task.stretches[1],
            sampled_on(guide.second_original(pair, geometry)),
            (width + guide.high - guide.low, height),
        )
        matched = match(a, guided, (guide.low, guide.high), geometry.nearer, geometry.lean)
        matched = replace(matched, disparity=guide.whole(matched.disparity))
    # On whole disparities: a guide that lies on a cloud would hide how high it stands.
    return without_unsupported(matched, a, b, (low, high), geometry.nearer, geometry.metres_per_px)


def _whole_range(geometry: PairGeometry) -> Tuple[int, int]:
    """Disparities of all altitudes with their margin, in whole coarse pixels."""
    low = math.floor((geometry.disparities[0] - _RANGE_MARGIN_PX) / FACTOR) * FACTOR
    high = math.ceil((geometry.disparities[1] + _RANGE_MARGIN_PX) / FACTOR) * FACTOR
    return low, high


def _brightness(view: View, stretch: Stretch, to_original: Any, size: Size) -> FloatImage:
    with opened_masked(view.image, view.mask) as dataset:
        return stretch.apply(warp(dataset, view.band, to_original, size, "cubic"))


def rectified_over_tile(
    scene: Scene, first: View, second: View, bounds: Bounds, altitudes: Altitudes
) -> Optional[RectifiedPair]:
    """The rectified pair that a tile is matched in: its ground with the matching margin."""
    return rectified_pair(scene, first, second, grown(bounds, MARGIN_PX * scene.gsd_m), altitudes)
