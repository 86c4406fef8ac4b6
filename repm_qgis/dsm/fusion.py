"""Fusing the height maps of one tile into its cells of the DSM."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bounds, FloatArray, Window
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.gridding import grid_points, surface_step
from ..geometry.interpolation import on_lattice
from ..matching.backends import height_source
from ..matching.occlusions import STEP_PX
from ..records import HeightMapRecord
from ..scene import Scene, View
from ..stereo.height_maps import HeightMap, HeightSource
from .aggregation import REACH_CELLS, Aggregate, Layer, aggregate, lonely
from .hidden import hidden_ground
from .ortho import orthophoto
from .outliers import without_lone_points

_COVERED = 0.5  # of a cell
_PART_CELLS = 512  # a side that are fused at once
MARGIN_CELLS = 8
"""Fused beyond the tile's cells: neighbours count in the outlier filter, and tiles are blended over that width."""


@dataclass(frozen=True)
class FuseTask:
    """All a worker needs to fuse one tile.

    ``scene`` without its tiles, ``bounds`` the tile's, ``window`` the tile's own cells of the whole ``grid``.
    """

    scene: Scene
    bounds: Bounds
    records: Tuple[HeightMapRecord, ...]
    grid: CellGrid
    window: Window
    crs: str
    method: str
    fill: str
    radius: float
    ortho_views: Tuple[View, ...]
    cloud: bool


@dataclass(frozen=True)
class FusedTile:
    """A tile's own cells, and the points that agree with them (x, y, height, score) where a cloud is wanted.

    ``removed`` cells had fewer than ``needed`` neighbours. ``wide`` are the heights with the margin, as far as the
    whole grid reaches. ``own`` tells which of the window's cells belong to the
    tile; None stands for all.
    """

    fused: Aggregate
    ortho: Optional[NDArray[np.float32]]
    points: Optional[FloatArray]
    removed: int
    needed: int
    wide: FloatArray
    own: Optional[NDArray[np.bool_]] = None


@dataclass(frozen=True)
class StoredTile:
    """A fused tile on disk, and what must be known of it before the DSM can be laid out.

    ``metres_per_px`` of its height maps. ``valid`` counts the cells with a height, ``filled`` those of them that have
    the background's, ``cells`` the tile's own; ``columns`` and ``rows`` are the first and last
    of the window that have a height, None where none has.
    """

    path: str
    valid: int
    filled: int
    cells: int
    removed: int
    needed: int
    columns: Optional[Tuple[int, int]]
    rows: Optional[Tuple[int, int]]
    metres_per_px: Tuple[float, ...]

    def load(self) -> FusedTile:
        """The tile's cells again, in the precision that products have."""
        with np.load(self.path, allow_pickle=False) as kept:
            part = {name: kept[name] for name in kept.files}
        return FusedTile(
            Aggregate(*(part[field.name] for field in fields(Aggregate))),
            part.get("ortho"),
            part.get("points"),
            self.removed,
            self.needed,
            self.wide(),
            part.get("own"),
        )

    def wide(self) -> FloatArray:
        """The heights with the margin; read from the file as they are looked at."""
        return np.load(wide_file(self.path), mmap_mode="r", allow_pickle=False)


def wide_file(path: str) -> str:
    """The file beside a stored tile's that holds its heights with the margin."""
    return path + ".wide.npy"


def fuse_to_disk(work: Tuple[FuseTask, str]) -> StoredTile:
    """Fuse a tile and keep it in a file, so that memory does not grow with the number of tiles."""
    task, path = work
    tile = fuse_tile(task)
    fused, known = tile.fused, np.isfinite(tile.fused.height)
    parts = {
        "height": fused.height.astype(np.float32),
        "count": fused.count,
        "filled": fused.filled,
        "spread": fused.spread.astype(np.float32),
        "score": fused.score.astype(np.float32),
    }
    parts.update({name: getattr(tile, name) for name in ("ortho", "points", "own") if getattr(tile, name) is not None})
    np.savez(path, **parts)
    np.save(wide_file(path), tile.wide.astype(np.float32))
    columns, rows = (np.flatnonzero(known.any(axis=axis)) for axis in (0, 1))
    cells = known.size if tile.own is None else int(tile.own.sum())
    return StoredTile(
        path,
        int(known.sum()),
        int(fused.filled.sum()),
        cells,
        tile.removed,
        tile.needed,
        *((int(n[0]), int(n[-1])) if n.size else None for n in (columns, rows)),
        tuple(record.metres_per_px for record in task.records),
    )


def fuse_tile(task: FuseTask) -> FusedTile:
    """Grid each height map, aggregate, remove lonely cells, cut to the tile's own cells."""
    wide = task.window.grown(MARGIN_CELLS, task.grid.size)
    grid = task.grid.part(wide)
    sources = [height_source(task.scene, task.bounds, record, task.crs) for record in task.records]
    fused = _aggregated(task, grid, sources)
    if task.fill == "none":
        fused = _without(fused, fused.filled)
    removed, needed = 0, 0
    if task.radius > 0:
        alone, needed = lonely(fused.height, grid.cell, task.radius)
        removed = int(alone.sum())
        fused = _without(fused, alone)
    ortho = orthophoto(task.ortho_views, grid, fused.height, task.crs) if task.ortho_views else None
    own = task.window.inside(wide)
    cut = Aggregate(*(getattr(fused, field.name)[own] for field in fields(fused)))
    ortho = None if ortho is None else ortho[own]
    belonging = _belonging(task)
    if belonging is not None:
        cut = _without(cut, ~belonging)
        ortho = None if ortho is None else np.where(belonging, ortho, np.float32(np.nan))
    points = _agreeing(task.grid.part(task.window), cut.height, sources, task.records) if task.cloud else None
    return FusedTile(cut, ortho, points, removed, needed, fused.height, belonging)


def _aggregated(task: FuseTask, grid: CellGrid, sources: Sequence[HeightSource]) -> Aggregate:
    """The fused cells of a grid, in parts of bounded memory that overlap by what neighbours are asked for."""
    whole: Dict[str, NDArray[Any]] = {}
    everything = Window(0, 0, *grid.size)
    for own, wide in overlapping_blocks(grid.size, _PART_CELLS, REACH_CELLS):
        part = grid.part(wide)
        bounds = part.bounds.grown(part.cell)
        layers = [
            _layer(part, source.within(bounds), record, task.scene.gsd_m)
            for source, record in zip(sources, task.records)
        ]
        fused = aggregate(layers, task.method)
        for field in fields(fused):
            values = getattr(fused, field.name)
            target = whole.setdefault(field.name, np.empty(grid.shape, values.dtype))
            target[own.inside(everything)] = values[own.inside(wide)]
    return Aggregate(**whole)


def _layer(grid: CellGrid, heights: HeightMap, record: HeightMapRecord, spacing: float) -> Layer:
    """A height map on the cells: what was matched, and the background where an occlusion hides it, each by itself.

    Cells that the background covers by more than what was matched, and lies below, have the background alone.
    """
    filled = np.flatnonzero(heights.filled)
    matched = without_lone_points(np.where(heights.filled, np.nan, heights.height), record.metres_per_px)
    height, score, covered = grid_points(grid, heights.x, heights.y, matched, heights.score, spacing)
    known = np.where(heights.filled, heights.height, matched)
    hidden = hidden_ground(replace(heights, height=known), STEP_PX * record.metres_per_px)
    x, y, z = (
        np.concatenate([part.ravel()[filled], more])
        for part, more in zip((heights.x, heights.y, heights.height), hidden)
    )
    half = _COVERED * (grid.cell / spacing) ** 2
    if not z.size:
        return Layer(height, score, np.full(grid.shape, np.nan), record.metres_per_px, covered < half)
    background, _, behind = grid_points(grid, x, y, z, np.zeros(len(z)), spacing)
    # A roof's last pixels reach into cells that are mostly hidden ground.
    with np.errstate(invalid="ignore"):
        brushed = (behind > covered) & (height - background > surface_step(grid.cell))
    height[brushed] = np.nan
    score[brushed] = np.nan
    return Layer(height, score, background, record.metres_per_px, covered < half, behind < half)


def _belonging(task: FuseTask) -> Optional[NDArray[np.bool_]]:
    """Which cells of the window lie in the tile: in another CRS than the scene's, tiles are turned and windows overlap.

    None in the scene's CRS, where they do not. The map between two CRSs is smooth: it is evaluated on a lattice.
    """
    grid = task.grid.part(task.window)
    if task.crs == task.scene.crs or not all(grid.shape):
        return None

    def to_scene(xy: FloatArray) -> FloatArray:
        return projected_from_geodetic(task.scene.crs, geodetic_from_projected(task.crs, xy))

    xy = on_lattice(*grid.centres(), to_scene)
    # A millimetre more, so that no cell falls between two tiles.
    x0, y0, x1, y1 = np.array(task.bounds) + [-1e-3, -1e-3, 1e-3, 1e-3]
    return (xy[..., 0] >= x0) & (xy[..., 0] <= x1) & (xy[..., 1] >= y0) & (xy[..., 1] <= y1)


def _without(fused: Aggregate, cells: NDArray[np.bool_]) -> Aggregate:
    return Aggregate(
        np.where(cells, np.nan, fused.height),
        np.where(cells, 0, fused.count).astype(np.uint8),
        np.where(cells, np.nan, fused.spread),
        np.where(cells, np.nan, fused.score),
        fused.filled & ~cells,
    )


def _agreeing(
    grid: CellGrid, height: FloatArray, sources: Sequence[HeightSource], records: Sequence[HeightMapRecord]
) -> FloatArray:
    """(N, 4) points of all maps that lie on the fused surface: within a px of disparity of their cell's height."""
    parts: List[FloatArray] = []
    for source, record in zip(sources, records):
        heights = source.within()
        known = np.isfinite(heights.height) & ~heights.filled
        x, y, z, s = heights.x[known], heights.y[known], heights.height[known], heights.score[known]
        column = np.floor((x - grid.west) / grid.cell).astype(np.int64)
        row = np.floor((grid.north - y) / grid.cell).astype(np.int64)
        inside = (column >= 0) & (column < grid.shape[1]) & (row >= 0) & (row < grid.shape[0])
        x, y, z, s, column, row = x[inside], y[inside], z[inside], s[inside], column[inside], row[inside]
        with np.errstate(invalid="ignore"):
            agree = np.abs(z - height[row, column]) <= record.metres_per_px
        parts.append(np.column_stack([x, y, z, s])[agree])
    return np.concatenate(parts) if parts else np.empty((0, 4))
