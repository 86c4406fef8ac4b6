"""Fusing the height maps of one tile into its cells of the DSM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..imagery.sampling import upsample_grid
from ..mvs.dense import HeightMap, load_heights
from ..scene import Scene, View
from .aggregation import Aggregate, aggregate, lonely
from .grid import CellGrid, grid_points
from .ortho import orthophoto

FloatArray = NDArray[np.float64]

_LATTICE = 17       # nodes a side of the map between two CRSs
_MARGIN_CELLS = 8   # fused beyond the tile's cells, so that neighbours count in the outlier filter


@dataclass(frozen=True)
class FuseTask:
    """All a worker needs to fuse one tile.

    ``scene`` without its tiles, ``bounds`` the tile's, ``window`` the tile's own cells of the whole ``grid``.
    """

    scene: Scene
    bounds: Tuple[float, float, float, float]
    records: Tuple[Dict[str, Any], ...]
    grid: CellGrid
    window: Tuple[int, int, int, int]
    crs: str
    method: str
    fill: str
    radius: float
    ortho_views: Tuple[View, ...]
    cloud: bool


@dataclass(frozen=True)
class FusedTile:
    """A tile's own cells, and the points that agree with them (x, y, height, score) where a cloud is wanted.

    ``filled`` cells have the background's height: one image hides them. ``own`` tells which of the
    window's cells belong to the tile; None stands for all.
    """

    fused: Aggregate
    filled: NDArray[np.bool_]
    ortho: Optional[NDArray[np.float32]]
    points: Optional[FloatArray]
    removed: int
    own: Optional[NDArray[np.bool_]] = None


@dataclass(frozen=True)
class StoredTile:
    """A fused tile on disk, and what must be known of it before the DSM can be laid out.

    ``valid`` counts the cells with a height, ``cells`` the tile's own; ``columns`` and ``rows`` are the first and last
    of the window that have a height, None where none has.
    """

    path: str
    valid: int
    cells: int
    removed: int
    columns: Optional[Tuple[int, int]]
    rows: Optional[Tuple[int, int]]

    def load(self) -> FusedTile:
        """The tile's cells again, in the precision that products have."""
        with np.load(self.path, allow_pickle=False) as kept:
            part = {name: kept[name] for name in kept.files}
        return FusedTile(Aggregate(part["height"], part["count"], part["spread"], part["score"]), part["filled"],
                         part.get("ortho"), part.get("points"), self.removed, part.get("own"))


def fuse_to_disk(work: Tuple[FuseTask, str]) -> StoredTile:
    """Fuse a tile and keep it in a file, so that memory does not grow with the number of tiles."""
    task, path = work
    tile = fuse_tile(task)
    fused, known = tile.fused, np.isfinite(tile.fused.height)
    parts = {"height": fused.height.astype(np.float32), "count": fused.count, "filled": tile.filled,
             "spread": fused.spread.astype(np.float32), "score": fused.score.astype(np.float32)}
    parts.update({name: getattr(tile, name) for name in ("ortho", "points", "own") if getattr(tile, name) is not None})
    np.savez(path, **parts)
    columns, rows = (np.flatnonzero(known.any(axis=axis)) for axis in (0, 1))
    return StoredTile(path, int(known.sum()), known.size if tile.own is None else int(tile.own.sum()), tile.removed,
                      *((int(n[0]), int(n[-1])) if n.size else None for n in (columns, rows)))


def fuse_tile(task: FuseTask) -> FusedTile:
    """Grid each height map, aggregate, remove lonely cells, cut to the tile's own cells."""
    col, row, width, height = task.window
    wide = (max(col - _MARGIN_CELLS, 0), max(row - _MARGIN_CELLS, 0))
    ends = (min(col + width + _MARGIN_CELLS, task.grid.shape[1]), min(row + height + _MARGIN_CELLS, task.grid.shape[0]))
    grid = task.grid.part((wide[0], wide[1], ends[0] - wide[0], ends[1] - wide[1]))
    maps = [load_heights(task.scene, task.bounds, record, task.crs) for record in task.records]
    metres = [record["metres_per_px"] for record in task.records]
    matched = [grid_points(grid, m.x, m.y, np.where(m.filled, np.nan, m.height), m.score) for m in maps]
    fused = aggregate([g[0] for g in matched], [g[1] for g in matched], metres, task.method)
    filled = np.zeros(grid.shape, dtype=bool)
    if task.fill == "occlusions":
        fused, filled = _with_background(fused, grid, maps, metres, task.method)
    removed = 0
    if task.radius > 0:
        alone, _ = lonely(fused.height, grid.cell, task.radius)
        removed = int(alone.sum())
        fused, filled = _without(fused, alone), filled & ~alone
    ortho = orthophoto(task.ortho_views, grid, fused.height, task.crs) if task.ortho_views else None
    own = (slice(row - wide[1], row - wide[1] + height), slice(col - wide[0], col - wide[0] + width))
    cut = Aggregate(*(getattr(fused, name)[own] for name in ("height", "count", "spread", "score")))
    ortho, filled = None if ortho is None else ortho[own], filled[own]
    belonging = _belonging(task)
    if belonging is not None:
        cut, filled = _without(cut, ~belonging), filled & belonging
        ortho = None if ortho is None else np.where(belonging, ortho, np.float32(np.nan))
    points = _agreeing(task.grid.part(task.window), cut.height, maps, task.records) if task.cloud else None
    return FusedTile(cut, filled, ortho, points, removed, belonging)


def _belonging(task: FuseTask) -> Optional[NDArray[np.bool_]]:
    """Which cells of the window lie in the tile: in another CRS than the scene's, tiles are turned and windows overlap.

    None in the scene's CRS, where they do not. The map between two CRSs is smooth: it is evaluated on a lattice.
    """
    grid = task.grid.part(task.window)
    if task.crs == task.scene.crs or not all(grid.shape):
        return None
    xs, ys = grid.centres()
    lattice = np.stack(np.meshgrid(np.linspace(xs[0], xs[-1], _LATTICE), np.linspace(ys[0], ys[-1], _LATTICE)), axis=-1)
    xy = upsample_grid(projected_from_geodetic(task.scene.crs, geodetic_from_projected(task.crs, lattice)), grid.shape)
    # A millimetre more, so that no cell falls between two tiles.
    x0, y0, x1, y1 = np.array(task.bounds) + [-1e-3, -1e-3, 1e-3, 1e-3]
    return (xy[..., 0] >= x0) & (xy[..., 0] <= x1) & (xy[..., 1] >= y0) & (xy[..., 1] <= y1)


def _with_background(fused: Aggregate, grid: CellGrid, maps: Sequence[HeightMap], metres: Sequence[float],
                     method: str) -> Tuple[Aggregate, NDArray[np.bool_]]:
    """Cells that nothing was matched in take the background's height from the maps that say what hides them."""
    hidden = [grid_points(grid, m.x, m.y, np.where(m.filled, m.height, np.nan), np.zeros_like(m.score)) for m in maps]
    background = aggregate([h[0] for h in hidden], [h[1] for h in hidden], metres, method)
    filled = np.isnan(fused.height) & np.isfinite(background.height)
    return Aggregate(np.where(filled, background.height, fused.height), fused.count, fused.spread, fused.score), filled


def _without(fused: Aggregate, cells: NDArray[np.bool_]) -> Aggregate:
    return Aggregate(np.where(cells, np.nan, fused.height), np.where(cells, 0, fused.count).astype(np.uint8),
                     np.where(cells, np.nan, fused.spread), np.where(cells, np.nan, fused.score))


def _agreeing(grid: CellGrid, height: FloatArray, maps: Sequence[HeightMap],
              records: Sequence[Dict[str, Any]]) -> FloatArray:
    """(N, 4) points of all maps that lie on the fused surface: within a px of disparity of their cell's height."""
    parts: List[FloatArray] = []
    for heights, record in zip(maps, records):
        known = np.isfinite(heights.height) & ~heights.filled
        x, y, z, s = heights.x[known], heights.y[known], heights.height[known], heights.score[known]
        column = np.floor((x - grid.west) / grid.cell).astype(np.int64)
        row = np.floor((grid.north - y) / grid.cell).astype(np.int64)
        inside = (column >= 0) & (column < grid.shape[1]) & (row >= 0) & (row < grid.shape[0])
        x, y, z, s, column, row = x[inside], y[inside], z[inside], s[inside], column[inside], row[inside]
        with np.errstate(invalid="ignore"):
            agree = np.abs(z - height[row, column]) <= record["metres_per_px"]
        parts.append(np.column_stack([x, y, z, s])[agree])
    return np.concatenate(parts) if parts else np.empty((0, 4))
