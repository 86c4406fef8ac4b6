"""Waves of the attitude that a reference shows along the parallax, put into the views of a registered scene.

Its height maps stay as they were matched; what is read from them follows the views (stereo/wave_change.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds, FloatArray
from ..contracts.records import HeightMapRecord, RegistrationFigures
from ..geometry.jitter import Jitter
from ..matching.backends import height_source, wave_geometry
from ..matching.parameters import MATCHING, MatchingParameters
from ..pointing.jitter import can_jitter
from ..registration.parameters import REGISTRATION, WaveParameters
from ..registration.surfaces import Reference
from ..registration.waves import FoundWaves, MapDifferences, find_waves
from ..runtime.memory import fusing_mib, tile_work, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..scene import Scene

Along = Dict[str, FloatArray]


@dataclass(frozen=True)
class _TileTask:
    scene: Scene
    bounds: Bounds
    records: Tuple[HeightMapRecord, ...]
    reference: Reference
    parameters: WaveParameters
    matching: MatchingParameters


def with_reference_waves(
    scene: Scene,
    references: Sequence[Reference],
    workers: int,
    *,
    memory: int,
    progress: Progress,
    parameters: WaveParameters = REGISTRATION.waves,
    matching: MatchingParameters = MATCHING,
) -> Scene:
    """The registered scene, with the waves that its references show in the views' jitter; the scene itself where they
    show none, and where its heights are not of pairs. ``workers`` and ``memory`` are options."""
    tiles = [tile for tile in scene.tiles if tile.heights]
    wide = [each for each in references if min(each.width_m) > 0]
    if scene.registration is None or not wide or not tiles or not can_jitter(scene.views):
        return scene
    known = _known(scene)
    if known is None and any(view.jitter for view in scene.views):
        return scene  # splines of different kinds cannot be added
    reference = max(wide, key=lambda each: len(each.xyz))
    lean = scene.lean()
    tasks = []
    for tile in tiles:
        near = _near(reference, tile.bounds, parameters.most_supports // len(tiles))
        tasks.append(_TileTask(lean, tile.bounds, tile.heights, near, parameters, matching))
    most = max(fusing_mib([record.pixels for record in task.records], 1) for task in tasks)
    side = math.ceil(max(max(b.xmax - b.xmin, b.ymax - b.ymin) for b in (t.bounds for t in tiles)) / scene.gsd_m)
    count = workers_within(workers, tile_work(side, most), memory, progress)
    parts: List[MapDifferences] = []
    along: Along = {}
    for found, directions in run_tasks(_differences, tasks, count, progress, lambda _: "waves along the parallax"):
        parts += found
        along = {**directions, **along}
    waves = find_waves(parts, max(reference.width_m), known, parameters)
    if waves is None:
        return scene
    progress.info(
        f"The reference '{reference.name}' shows jitter along the parallax, of up to {waves.largest_px:.2f} px. It is "
        f"removed: the NMAD of the differences falls from {waves.before_m:.2f} to {waves.after_m:.2f} m."
    )
    return _shaken(scene, scene.registration, waves, along)


def _near(reference: Reference, bounds: Bounds, most: int) -> Reference:
    """The supports in a tile, or an even selection of so many of them."""
    x, y, _ = reference.xyz.T
    inside = np.flatnonzero((x >= bounds[0]) & (x < bounds[2]) & (y >= bounds[1]) & (y < bounds[3]))
    inside = inside[:: max(1, math.ceil(len(inside) / max(most, 1)))]
    slopes = None if reference.slopes is None else reference.slopes[inside]
    return replace(reference, xyz=reference.xyz[inside], slopes=slopes)


def _known(scene: Scene) -> Optional[Tuple[Dict[str, Tuple[float, float]], int]]:
    """The ends and the number of the splines of waves that all views have already."""
    jitter = {view.name: view.jitter for view in scene.views if view.jitter is not None}
    counts = {len(each.coefficients) for each in jitter.values()}
    if len(jitter) < len(scene.views) or len(counts) > 1:
        return None
    return {name: (each.first, each.last) for name, each in jitter.items()}, counts.pop()


def _differences(task: _TileTask) -> Tuple[List[MapDifferences], Along]:
    """The differences between the maps of a tile and the reference, and the direction of the parallax in each view."""
    from scipy.spatial import cKDTree

    parameters, found = task.parameters, []
    along: Along = {}
    if not len(task.reference.xyz):
        return [], {}
    tree, width = cKDTree(task.reference.xyz[:, :2]), max(task.reference.width_m)
    steep = np.zeros(len(task.reference.xyz), dtype=bool)
    if task.reference.slopes is not None:
        steep = ~(np.hypot(*task.reference.slopes.T) < parameters.steepest)
    step = max(1, int(width / parameters.across / task.scene.gsd_m))
    for record in task.records:
        geometry = wave_geometry(task.scene, task.bounds, record, task.scene.crs, task.matching)
        if geometry is None:
            continue
        source = height_source(task.scene, task.bounds, record, task.scene.crs, task.matching)
        points = source.read(None, step)
        columns, rows = (np.arange(0, n, step, dtype=np.float64) for n in record.size)
        known = np.isfinite(points.height) & ~points.filled
        if not known.any():
            continue
        level = np.where(known, points.height - (source.shift.up(points.x, points.y) if source.shift else 0.0), 0.0)
        lines = [table.on_grid(columns, rows, level)[known] for table in geometry.lines]
        x, y, height = (each[known] for each in (points.x, points.y, points.height))
        away, nearest = tree.query(np.column_stack([x, y]), distance_upper_bound=0.71 * width)
        inside = np.isfinite(away)
        inside[inside] &= _in_support(task.reference, nearest[inside], x[inside], y[inside])
        which, size = nearest[inside], len(task.reference.xyz)
        count = np.bincount(which, minlength=size)
        usual = width**2 / (step * task.scene.gsd_m) ** 2
        used = np.flatnonzero((count >= max(parameters.covered * usual, 1.0)) & ~steep)
        if not len(used):
            continue
        means = [np.bincount(which, each[inside], size)[used] / count[used] for each in (height, *lines)]
        metres = [float(m @ e) for m, e in zip(geometry.height_m, geometry.along)]
        place = task.reference.xyz[used]
        value = place[:, 2] - means[0]
        pair = record.pair[0], record.pair[1]
        found.append(
            MapDifferences(pair, (metres[0], metres[1]), (means[1], means[2]), place[:, 0], place[:, 1], value)
        )
        along.update(zip(pair, geometry.along))
    return found, along


def _in_support(reference: Reference, which: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Whether places lie in the support that is nearest: a disc, or a square."""
    dx, dy = np.abs(x - reference.xyz[which, 0]), np.abs(y - reference.xyz[which, 1])
    across, down = reference.width_m
    inside = np.hypot(dx, dy) <= across / 2 if reference.disc else (dx <= across / 2) & (dy <= down / 2)
    return np.asarray(inside)


def _shaken(scene: Scene, registration: RegistrationFigures, waves: FoundWaves, along: Along) -> Scene:
    """The scene whose views have the waves too."""
    views = []
    for view in scene.views:
        own, jitter = waves.coefficients.get(view.name), view.jitter
        if own is not None:
            more = own[:, None] * along[view.name]
            more = more if jitter is None else more + jitter.coefficients
            first, last = waves.ends[view.name]
            jitter = Jitter(first, last, more)
        views.append(view.with_pointing(view.pointing, jitter))
    matched = registration.matched_waves
    if registration.waves_m is None:
        matched = {view.name: view.jitter.packed() for view in scene.views if view.jitter is not None}
    facts = replace(
        registration,
        matched_waves=matched,
        waves_m=(waves.before_m, waves.after_m),
        waves_px=waves.largest_px,
    )
    return replace(scene, views=tuple(views), registration=facts)
