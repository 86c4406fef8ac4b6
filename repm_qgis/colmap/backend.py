"""Backend ``colmap``: a tile's views matched by COLMAP's patch match on CUDA, a height map for each.

Every view that is matched with others is a reference once. Its height map has the bands of those of ``sgm``, in the
geometry of the image that COLMAP was given. COLMAP leaves occlusions empty, and nothing is filled in.
"""

from __future__ import annotations

import os
import shutil
import threading
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import Bounds, FloatArray, FloatImage
from ..environment import Gpu, cuda, cuda_usable, gpus
from ..errors import DeviceError, EmptyResultError, ImageError, SceneError
from ..imagery.enhancement import Stretch
from ..imagery.warping import sample_array
from ..matching.backends import MatchingJob, MatchingResult
from ..options import ReconstructOptions
from ..progress import Progress
from ..records import HeightMapRecord, ViewPair
from ..scene import Scene, Tile
from ..stereo.height_maps import MARGIN_PX, HeightSource, finished_record, map_size, write_height_map
from ..workspace import ensure_folder, fingerprint, temporary_name
from .depth_heights import DepthGeometry, depth_geometry
from .maps import read_map
from .projective_frame import FrameView, TileFrame, tile_frame
from .runner import (
    FUSION,
    PatchMatch,
    Runner,
    bytes_allowed,
    bytes_needed,
    colmap_options,
    on_gpus,
    run_patch_match,
)
from .workspace import brightness, map_path, write_workspace

_RANGE_MARGIN_PX = 6  # heights kept beyond the altitude range, in px of parallax
_SCORE_WINDOW = 7
_FUSED_SHARE = 0.01  # of the depth: COLMAP's max_depth_error
_MOST_PARTS = 64  # along a side of a tile


@dataclass(frozen=True)
class GpuTask:
    """A tile to match: ``sources`` names, for each reference view, those that it is matched with.

    ``scene`` without its tiles; height maps are written into ``folder``; ``key`` is what they are made from.
    """

    scene: Scene
    tile: str
    bounds: Bounds
    altitudes: Tuple[float, float]
    sources: Mapping[str, Tuple[str, ...]]
    stretches: Mapping[str, Stretch]
    settings: PatchMatch
    folder: str
    key: str

    def path(self, reference: str, part: int) -> str:
        """The height map's file of a reference view over a part of the tile."""
        return os.path.join(self.folder, f"{self.tile}_{reference}_colmap{part or ''}.tif")


@dataclass(frozen=True)
class ColmapBackend:
    """COLMAP's patch match as a backend (:class:`repm_qgis.matching.backends.Backend`).

    ``run`` is what runs it in a tile's workspace, ``devices`` finds the GPUs.
    """

    run: Runner = run_patch_match
    devices: Callable[[], Sequence[Gpu]] = gpus
    name: str = "colmap"
    pair_matcher: None = None

    def usable(self) -> bool:
        return cuda_usable()

    def remedy(self) -> str:
        missing = cuda()["remedy"]
        return f"needs CUDA, and {missing}" if missing else ""

    def settings(self, options: ReconstructOptions) -> List[Any]:
        return [options.geometric, options.colmap_fusion, options.window_radius]

    def match(self, job: MatchingJob, progress: Progress) -> MatchingResult:
        """Match all tiles, one worker a GPU."""
        chosen = job.options
        settings = PatchMatch(chosen.geometric, chosen.window_radius, chosen.gpu_memory, chosen.colmap_fusion)
        tasks = [
            GpuTask(
                job.scene.lean(),
                tile.id,
                tile.bounds,
                tile.altitudes,
                sources,
                {name: job.stretches[name] for name in sorted(sources)},
                settings,
                job.folder,
                fingerprint(job.key, tile.id, sources),
            )
            for tile, sources in ((tile, _partners(tile, job.pairs)) for tile in job.tiles)
            if sources
        ]
        devices = self.devices()
        if not devices:
            lost = "no CUDA device answers any more: look at it with nvidia-smi and run again, or choose BACKEND sgm."
            return MatchingResult([], {task.tile: DeviceError(lost) for task in tasks})

        def work(task: GpuTask, gpu: Gpu, stop: threading.Event) -> List[HeightMapRecord]:
            return match_tile(task, gpu, stop, self.run)

        results = on_gpus(work, tasks, devices, progress, lambda task: f"matched tile {task.tile}")
        failed = {task.tile: result for task, result in zip(tasks, results) if isinstance(result, DeviceError)}
        done = (result for result in results if not isinstance(result, DeviceError))
        return MatchingResult([record for records in done for record in records], failed)

    def height_source(self, scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str) -> HeightSource:
        """Where the tile was matched in parts, heights beyond the part are left out: its neighbour has them."""
        size, own = map_size(record.file), record.bounds or bounds
        frame = tile_frame(scene, record.views, own, record.altitudes, MARGIN_PX)
        names = (record.pair[0], *record.sources)
        views = [view for view in map(frame.view, names) if view is not None] if frame else []
        if frame is None or len(views) < len(names) or views[0].size != size:
            raise SceneError(
                f"The height map '{record.file}' does not belong to the scene '{scene.path}': run "
                "'Reconstruct heights' again."
            )
        tables = depth_geometry(scene, frame, views[0], views[1:], crs)
        part = (bounds, own) if record.part else None
        return HeightSource(record.file, tables.x, tables.y, size, record.altitudes, part)


BACKEND = ColmapBackend()


def _partners(tile: Tile, pairs: Sequence[ViewPair]) -> Dict[str, Tuple[str, ...]]:
    """For each view of a tile, the views it is matched with: both ways of every pair that the tile has."""
    found: Dict[str, List[str]] = {}
    for pair in pairs:
        if pair.first in tile.views and pair.second in tile.views:
            found.setdefault(pair.first, []).append(pair.second)
            found.setdefault(pair.second, []).append(pair.first)
    return {name: tuple(others) for name, others in found.items()}


def match_tile(task: GpuTask, gpu: Gpu, stop: threading.Event, run: Runner) -> List[HeightMapRecord]:
    """Match a tile on a GPU, in as many parts as its memory asks for; gives the height maps' records.

    Height maps that an earlier, stopped run has finished are taken as they are (``reused`` in the record). Raises
    DeviceError where the GPU fails, Cancelled once ``stop`` is set.
    """
    records: List[HeightMapRecord] = []
    for part, frame in enumerate(_parts(task, bytes_allowed(gpu, task.settings))):
        sources = _sources(task, frame)
        keys = {name: fingerprint(task.key, name, others, frame.bounds) for name, others in sources.items()}
        done = [finished_record(task.path(name, part), key) for name, key in keys.items()]
        if not all(done):
            done = _match_part(task, part, frame, sources, keys, gpu, stop, run)
        records += [record for record in done if record]
    return records


def _parts(task: GpuTask, allowed: int) -> List[TileFrame]:
    """The tile's frames: one for the whole, or for equal parts that fit into a GPU's memory."""
    for count in range(1, _MOST_PARTS + 1):
        frames = [
            frame
            for frame in (
                tile_frame(task.scene, tuple(task.stretches), bounds, task.altitudes, MARGIN_PX)
                for bounds in _divided(task.bounds, count)
            )
            if frame is not None
        ]
        needed = max(
            (
                bytes_needed(max(view.size[0] * view.size[1] for view in frame.views), len(frame.views) - 1)
                for frame in frames
            ),
            default=0,
        )
        if needed <= allowed:
            return frames
        if count > 1 and min(min(view.size) for frame in frames for view in frame.views) <= 4 * MARGIN_PX:
            break
    raise DeviceError(
        f"A GPU may use {allowed / 2**30:.2f} GiB, and even a small part of a tile takes "
        f"{needed / 2**30:.2f} GiB: free its memory, or choose BACKEND sgm."
    )


def _divided(bounds: Bounds, count: int) -> List[Bounds]:
    """A rectangle in count x count equal ones."""
    x, y = np.linspace(bounds[0], bounds[2], count + 1), np.linspace(bounds[1], bounds[3], count + 1)
    return [
        Bounds(float(x[i]), float(y[j]), float(x[i + 1]), float(y[j + 1])) for j in range(count) for i in range(count)
    ]


def _sources(task: GpuTask, frame: TileFrame) -> Dict[str, Tuple[str, ...]]:
    """For each reference that sees the frame, its sources that do."""
    seen = {view.view.name for view in frame.views}
    found = {
        name: tuple(other for other in others if other in seen) for name, others in task.sources.items() if name in seen
    }
    return {name: others for name, others in found.items() if others}


def _match_part(
    task: GpuTask,
    part: int,
    frame: TileFrame,
    sources: Dict[str, Tuple[str, ...]],
    keys: Dict[str, str],
    gpu: Gpu,
    stop: threading.Event,
    run: Runner,
) -> List[Optional[HeightMapRecord]]:
    """Write the workspace, run, and turn depths into heights; the workspace is removed in any case."""
    if not sources:
        return []
    folder = temporary_name(os.path.join(task.folder, f"{task.tile}_colmap{part or ''}"))
    shutil.rmtree(folder, ignore_errors=True)
    try:
        ensure_folder(folder)
        images = [brightness(view, task.stretches[view.view.name]) for view in frame.views]
        write_workspace(folder, task.scene, frame, images, sources)
        most = max(len(others) for others in sources.values())
        run(
            folder,
            colmap_options(task.settings, frame.depths(task.scene), most, gpu.index),
            FUSION if task.settings.fusion else None,
            stop,
        )
        return [
            _height_map(task, part, frame, images, name, others, folder, keys[name]) for name, others in sources.items()
        ]
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _height_map(
    task: GpuTask,
    part: int,
    frame: TileFrame,
    images: Sequence[FloatImage],
    name: str,
    others: Sequence[str],
    folder: str,
    key: str,
) -> Optional[HeightMapRecord]:
    """Read a reference's depths, and store its heights; None where its RPC sees no ground of the tile."""
    numbers = {view.view.name: index for index, view in enumerate(frame.views)}
    reference, sources = frame.views[numbers[name]], [frame.views[numbers[other]] for other in others]
    try:
        geometry = depth_geometry(task.scene, frame, reference, sources, task.scene.crs)
    except EmptyResultError:
        return None
    image = images[numbers[name]]
    depth = read_map(map_path(folder, "depth", numbers[name], task.settings.geometric), reference.size)
    if task.settings.fusion:
        depth = _fused_only(depth, reference, _fused(folder))
    depth = np.where(_surrounded(image, task.settings.window_radius) & (depth > 0), depth, np.float32(np.nan))
    score = _score(image, [images[numbers[other]] for other in others], reference, sources, depth)
    heights = _heights(geometry, depth, frame.altitudes)
    heights[~np.isfinite(score)] = np.nan
    score[~np.isfinite(heights)] = np.nan
    path = task.path(name, part)
    record = HeightMapRecord(
        tile=task.tile,
        backend="colmap",
        pair=(name, others[geometry.best]),
        file=path,
        size=reference.size,
        valid=int(np.isfinite(heights).sum()),
        filled=0,
        metres_per_px=geometry.metres_per_px,
        vertical_parallax_px=geometry.row_px,
        table_error_m=geometry.error_m,
        altitudes=frame.altitudes,
        sources=tuple(others),
        views=tuple(task.stretches),
        bounds=frame.bounds,
        part=frame.bounds != task.bounds,
    )
    write_height_map(path, key, record, heights.astype(np.float32), score, np.zeros(heights.shape, dtype=bool))
    return record


def _fused(folder: str) -> FloatArray:
    """(N, 3) points that COLMAP's fusion has made; raises ImageError where they cannot be read."""
    path = os.path.join(folder, "fused.npy")
    try:
        points = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise ImageError(f"Cannot read COLMAP's fused points '{path}' ({error}): reconstruct again.") from error
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype != np.float64:
        raise ImageError(f"COLMAP's fused points '{path}' are {points.shape} {points.dtype}: reconstruct again.")
    return points


def _fused_only(depth: FloatImage, reference: FrameView, points: FloatArray) -> FloatImage:
    """Depths of the pixels that a fused point lies in, within fusion's own tolerance of it; elsewhere 0."""
    pixels = np.rint(reference.camera.project(points)).astype(np.int64)
    inside = ((pixels >= 0) & (pixels < reference.size)).all(axis=1)
    column, row = pixels[inside].T
    near = np.abs(reference.camera.depth(points[inside]) - depth[row, column]) <= _FUSED_SHARE * depth[row, column]
    kept = np.zeros(depth.shape, dtype=bool)
    kept[row[near], column[near]] = True
    return np.where(kept, depth, np.float32(0))


def _heights(geometry: DepthGeometry, depth: FloatImage, altitudes: Tuple[float, float]) -> FloatArray:
    """(H, W) heights; NaN where they leave the altitudes by more than the search's margin."""
    rows, columns = (np.arange(n, dtype=np.float64) for n in depth.shape)
    heights = geometry.height.on_grid(columns, rows, 1.0 / depth.astype(np.float64))
    margin = _RANGE_MARGIN_PX * geometry.metres_per_px
    with np.errstate(invalid="ignore"):
        heights[(heights < altitudes[0] - margin) | (heights > altitudes[1] + margin)] = np.nan
    return heights


def _surrounded(image: FloatImage, radius: int) -> NDArray[np.bool_]:
    """Where the window around a pixel has brightness throughout."""
    missing = (~np.isfinite(image)).astype(np.uint8)
    return cv2.dilate(missing, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)) == 0


def _score(
    image: FloatImage,
    others: Sequence[FloatImage],
    reference: FrameView,
    sources: Sequence[FrameView],
    depth: FloatImage,
) -> FloatImage:
    """Correlation in 0..1 of each pixel's neighbourhood with the source that agrees best; NaN where none shows it."""
    best = np.full(depth.shape, np.nan, dtype=np.float32)
    rows, columns = np.indices(depth.shape)
    for other, source in zip(others, sources):
        warped = sample_array(other, transferred(reference, source, columns, rows, depth), "bilinear")
        best = np.fmax(best, _correlation(image, warped))
    return np.clip(best, 0, 1)


def transferred(
    reference: FrameView, source: FrameView, columns: NDArray[Any], rows: NDArray[Any], depth: FloatImage
) -> FloatArray:
    """(..., 2) where a source's camera sees pixels of a reference that have these depths."""
    rays = np.stack([columns, rows, np.ones(columns.shape)], axis=-1) @ np.linalg.inv(reference.camera.K).T
    world = (rays * depth[..., None] - reference.camera.t) @ reference.camera.R
    return source.camera.project(world)


def _correlation(a: FloatImage, b: FloatImage) -> FloatImage:
    """Correlation of neighbourhoods, over the pixels that both images have; NaN at pixels that one has not."""
    both = np.isfinite(a) & np.isfinite(b)
    weight = _mean(both.astype(np.float32))
    first, second = np.where(both, a, np.float32(0)), np.where(both, b, np.float32(0))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_a, mean_b = _mean(first) / weight, _mean(second) / weight
        spread_a = _mean(first * first) / weight - mean_a**2
        spread_b = _mean(second * second) / weight - mean_b**2
        common = _mean(first * second) / weight - mean_a * mean_b
        found = common / np.sqrt(np.maximum(spread_a * spread_b, 1e-12))
    return np.where(both, found, np.float32(np.nan))


def _mean(values: FloatImage) -> FloatImage:
    return cv2.blur(values, (_SCORE_WINDOW, _SCORE_WINDOW), borderType=cv2.BORDER_REPLICATE)
