"""A tile's views matched by COLMAP's patch match on CUDA, with a height map for each view.

Every view that is matched with others is a reference once. Its height map is in the geometry of the image that COLMAP
was given. COLMAP leaves occlusions empty, and nothing is filled in.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple, Union

import cv2
import numpy as np

from ..contracts.arrays import Altitudes, AnyArray, Bounds, FloatArray, FloatImage, Mask
from ..contracts.errors import DeviceError, EmptyResultError, ImageError
from ..contracts.records import HeightMapRecord
from ..imagery.correlation import window_statistics
from ..imagery.enhancement import Stretch
from ..imagery.warping import box_filter, sample_array
from ..runtime.environment import Gpu
from ..runtime.progress import Progress
from ..runtime.workspace import fingerprint, temporary_folder
from ..scene import Scene
from ..stereo.height_maps import HeightSource, finished_record, foreign_height_map, write_height_map
from ..stereo.parameters import STEREO, StereoParameters
from .depth_heights import DepthGeometry, depth_geometry
from .maps import read_map
from .parameters import COLMAP, ColmapParameters
from .projective_frame import FrameView, TileFrame, tile_frame
from .runner import PatchMatchOptions, Runner, bytes_allowed, bytes_needed, colmap_options, fusion_options, on_gpus
from .workspace import map_path, view_intensity, write_workspace


@dataclass(frozen=True)
class GpuTask:
    """A tile to match: ``sources`` names, for each reference view, those that it is matched with.

    ``scene`` is without its tiles; height maps are written into ``folder``; ``key`` is the fingerprint of what they
    are made from.
    """

    scene: Scene
    tile: str
    bounds: Bounds
    altitudes: Altitudes
    sources: Mapping[str, Tuple[str, ...]]
    stretches: Mapping[str, Stretch]
    options: PatchMatchOptions
    folder: str
    key: str
    parameters: ColmapParameters = COLMAP
    stereo: StereoParameters = STEREO

    def path(self, reference: str, part: int) -> str:
        """The height map's file of a reference view over a part of the tile."""
        return os.path.join(self.folder, f"{self.tile}_{reference}_colmap{part or ''}.tif")

    def frame(self, bounds: Bounds) -> Optional[TileFrame]:
        """The frame of a part of the tile; None where fewer than two views see it."""
        return tile_frame(self.scene, tuple(self.stretches), bounds, self.altitudes, self.parameters.frame, self.stereo)


def match_tiles(
    tasks: Sequence[GpuTask], devices: Sequence[Gpu], run: Runner, progress: Progress
) -> Tuple[List[Optional[HeightMapRecord]], Dict[str, DeviceError]]:
    """Match tiles, one worker for each GPU; gives the records, and the errors of tiles on which a GPU failed."""
    if not devices:
        lost = "no CUDA device responds any more: check it with nvidia-smi and run again, or choose BACKEND sgm."
        return [], {task.tile: DeviceError(lost) for task in tasks}

    def work(task: GpuTask, gpu: Gpu, stop: threading.Event) -> List[HeightMapRecord]:
        return match_tile(task, gpu, stop, run)

    records: List[Optional[HeightMapRecord]] = []
    failed: Dict[str, DeviceError] = {}
    results: Sequence[Union[List[HeightMapRecord], DeviceError]] = on_gpus(
        work, tasks, devices, progress, lambda task: f"matched tile {task.tile}"
    )
    for task, result in zip(tasks, results):
        if isinstance(result, DeviceError):
            failed[task.tile] = result
        else:
            records += result
    return records, failed


def match_tile(task: GpuTask, gpu: Gpu, stop: threading.Event, run: Runner) -> List[HeightMapRecord]:
    """Match a tile on a GPU, in as many parts as its memory requires; gives the height maps' records.

    Height maps that an earlier, stopped run has finished are taken as they are (``reused`` in the record). Raises
    DeviceError where the GPU fails, Cancelled once ``stop`` is set.
    """
    records: List[HeightMapRecord] = []
    for part, frame in enumerate(_parts(task, bytes_allowed(gpu, task.options, task.parameters.patch_match))):
        sources = _sources(task, frame)
        keys = {name: fingerprint(task.key, name, others, frame.bounds) for name, others in sources.items()}
        done = [finished_record(task.path(name, part), key) for name, key in keys.items()]
        if not all(done):
            done = _match_part(task, part, frame, sources=sources, keys=keys, gpu=gpu, stop=stop, run=run)
        records += [record for record in done if record]
    return records


def _parts(task: GpuTask, allowed: int) -> List[TileFrame]:
    """The tile's frames: one for the whole, or for equal parts that fit into a GPU's memory."""
    smallest_px = 8 * task.stereo.tile_margin_px
    for count in range(1, task.parameters.patch_match.most_parts + 1):
        frames = [frame for frame in map(task.frame, _divided(task.bounds, count)) if frame is not None]
        needed = max((bytes_needed(frame.largest_px, len(frame.views) - 1) for frame in frames), default=0)
        if needed <= allowed:
            return frames
        if count > 1 and min(min(view.size) for frame in frames for view in frame.views) <= smallest_px:
            break
    limit = f"A GPU may use {allowed / 2**30:.2f} GiB, and even a small part of a tile takes {needed / 2**30:.2f} GiB"
    raise DeviceError(f"{limit}: free its memory, or choose BACKEND sgm.")


def _divided(bounds: Bounds, count: int) -> List[Bounds]:
    """A rectangle in count x count equal ones."""
    x, y = np.linspace(bounds[0], bounds[2], count + 1), np.linspace(bounds[1], bounds[3], count + 1)
    x, y = x.tolist(), y.tolist()
    return [Bounds(x[i], y[j], x[i + 1], y[j + 1]) for j in range(count) for i in range(count)]


def _sources(task: GpuTask, frame: TileFrame) -> Dict[str, Tuple[str, ...]]:
    """For each reference that sees the frame, its sources that do."""
    seen, given = {view.view.name for view in frame.views}, task.sources.items()
    found = {name: tuple(other for other in others if other in seen) for name, others in given if name in seen}
    return {name: others for name, others in found.items() if others}


def _match_part(
    task: GpuTask,
    part: int,
    frame: TileFrame,
    *,
    sources: Dict[str, Tuple[str, ...]],
    keys: Dict[str, str],
    gpu: Gpu,
    stop: threading.Event,
    run: Runner,
) -> List[Optional[HeightMapRecord]]:
    """Write the workspace, run, and turn depths into heights; the workspace is removed in any case."""
    if not sources:
        return []
    with temporary_folder(os.path.join(task.folder, f"{task.tile}_colmap{part or ''}")) as folder:
        images = [view_intensity(view, task.stretches[view.view.name]) for view in frame.views]
        write_workspace(folder, task.scene, frame, images, sources, task.parameters.tracks)
        most, parameters = max(len(others) for others in sources.values()), task.parameters.patch_match
        options = colmap_options(task.options, frame.depths(task.scene), most, gpu.index, parameters)
        run(folder, options, fusion_options(parameters) if task.options.fusion else None, stop)
        return [
            _height_map(task, part, frame, images=images, name=name, others=others, folder=folder, key=keys[name])
            for name, others in sources.items()
        ]


def _height_map(
    task: GpuTask,
    part: int,
    frame: TileFrame,
    *,
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
        geometry = depth_geometry(
            task.scene,
            frame,
            reference,
            sources=sources,
            crs=task.scene.crs,
            parameters=task.parameters,
            stereo=task.stereo,
        )
    except EmptyResultError:
        return None
    image = images[numbers[name]]
    depth = read_map(map_path(folder, numbers[name], task.options.geometric), reference.size)
    if task.options.fusion:
        depth = _fused_only(depth, reference, _fused(folder), task.parameters.patch_match.fused_depth_share)
    depth = np.where(_surrounded(image, task.options.window_radius) & (depth > 0), depth, np.float32(np.nan))
    seen = [(source, images[numbers[other]]) for source, other in zip(sources, others)]
    score = _score(image, reference, seen, depth, task.parameters.score_window_px)
    heights = _heights(geometry, depth, frame.altitudes, task.parameters.range_margin_px)
    heights[~np.isfinite(score)] = np.nan
    score[~np.isfinite(heights)] = np.nan
    record = HeightMapRecord(
        tile=task.tile,
        backend="colmap",
        pair=(name, others[geometry.best]),
        metres_per_px=geometry.metres_per_px,
        vertical_parallax_px=geometry.vertical_parallax_px,
        table_error_m=geometry.error_m,
        altitudes=frame.altitudes,
        sources=tuple(others),
        views=tuple(task.stretches),
        bounds=frame.bounds,
        part=frame.bounds != task.bounds,
    )
    filled = np.zeros(heights.shape, dtype=bool)
    return write_height_map(task.path(name, part), key, record, heights.astype(np.float32), score, filled)


def _fused(folder: str) -> FloatArray:
    """(N, 3) points that COLMAP's fusion has made; raises ImageError where they cannot be read."""
    path = os.path.join(folder, "fused.npy")
    try:
        points: FloatArray = np.load(path, allow_pickle=False)
    except (OSError, EOFError, ValueError) as error:  # EOFError: an empty file
        raise ImageError(f"Cannot read COLMAP's fused points '{path}' ({error}): reconstruct again.") from error
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype != np.float64:
        raise ImageError(f"COLMAP's fused points '{path}' are {points.shape} {points.dtype}: reconstruct again.")
    return points


def _fused_only(depth: FloatImage, reference: FrameView, points: FloatArray, tolerance: float) -> FloatImage:
    """Depths of pixels that contain a fused point and agree with it to a share of the depth; elsewhere 0."""
    pixels = np.rint(reference.camera.project(points)).astype(np.int64)
    inside = ((pixels >= 0) & (pixels < reference.size)).all(axis=1)
    column, row = pixels[inside].T
    near = np.abs(reference.camera.depth(points[inside]) - depth[row, column]) <= tolerance * depth[row, column]
    kept = np.zeros(depth.shape, dtype=bool)
    kept[row[near], column[near]] = True
    return np.where(kept, depth, np.float32(0))


def _heights(geometry: DepthGeometry, depth: FloatImage, altitudes: Altitudes, margin_px: float) -> FloatArray:
    """(H, W) heights; NaN where they leave the altitudes by more than the margin."""
    rows, columns = (np.arange(n, dtype=np.float64) for n in depth.shape)
    heights = geometry.height.on_grid(columns, rows, 1.0 / depth.astype(np.float64))
    margin = margin_px * geometry.metres_per_px
    with np.errstate(invalid="ignore"):
        heights[(heights < altitudes[0] - margin) | (heights > altitudes[1] + margin)] = np.nan
    return heights


def _surrounded(image: FloatImage, radius: int) -> Mask:
    """Where the image has data in the whole window around a pixel."""
    missing = (~np.isfinite(image)).astype(np.uint8)
    complete: Mask = cv2.dilate(missing, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)) == 0
    return complete


def _score(
    image: FloatImage, reference: FrameView, seen: Sequence[Tuple[FrameView, FloatImage]], depth: FloatImage, side: int
) -> FloatImage:
    """Correlation in 0..1 of each pixel's window with the source that agrees best; NaN where no source shows it."""
    best = np.full(depth.shape, np.nan, dtype=np.float32)
    rows, columns = np.indices(depth.shape)
    for source, other in seen:
        warped = sample_array(other, transferred(reference, source, columns, rows, depth), "bilinear")
        best = np.fmax(best, _correlation(image, warped, side))
    return np.clip(best, 0, 1)


def transferred(
    reference: FrameView, source: FrameView, columns: AnyArray, rows: AnyArray, depth: FloatImage
) -> FloatArray:
    """(..., 2) pixels of a source that show what a reference shows at these pixels and depths."""
    rays = np.stack([columns, rows, np.ones(columns.shape)], axis=-1) @ np.linalg.inv(reference.camera.K).T
    world = (rays * depth[..., None] - reference.camera.t) @ reference.camera.R
    return source.camera.project(world)


def _correlation(a: FloatImage, b: FloatImage, side: int) -> FloatImage:
    """Correlation of windows, over the pixels that both images have; NaN at pixels that one has not."""
    known, mean = np.isfinite(a) & np.isfinite(b), box_filter(side, cv2.BORDER_REPLICATE)
    return np.where(known, window_statistics(a, b, known, mean).correlation(), np.float32(np.nan))


def tile_height_source(
    scene: Scene, bounds: Bounds, record: HeightMapRecord, crs: str, colmap: ColmapParameters, stereo: StereoParameters
) -> HeightSource:
    """A height map of a tile with these bounds, to be placed on the ground in any projected ``crs``.

    Where the tile was matched in parts, heights beyond the part are left out, because its neighbour has them. Raises
    SceneError where the height map is of another scene.
    """
    own = record.bounds or bounds
    frame = tile_frame(scene, record.views, own, record.altitudes, colmap.frame, stereo)
    names = (record.pair[0], *record.sources)
    views = [view for view in map(frame.view, names) if view is not None] if frame else []
    if frame is None or len(views) < len(names) or views[0].size != record.size:
        raise foreign_height_map(record, scene)
    tables = depth_geometry(scene, frame, views[0], sources=views[1:], crs=crs, parameters=colmap, stereo=stereo)
    part = (bounds, own) if record.part else None
    return HeightSource(record.file, tables.x, tables.y, record.size, record.altitudes, part)
