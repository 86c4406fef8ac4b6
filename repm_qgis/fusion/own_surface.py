"""The surface that a scene already has, in coarse cells: for the terrain-aware refinement, and for registration."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from ..contracts.arrays import Bounds, FloatImage
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..geometry.tiles import enclosing
from ..runtime.memory import fusing_mib, tile_work, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..scene import Scene
from .parameters import FUSION, FusionParameters
from .tile_fusion import FuseTask, fuse_tile


def lon_lat_bounds(scene: Scene, parameters: FusionParameters = FUSION) -> Bounds:
    """West, south, east, north of a scene's tiles with a margin, in degrees."""
    x0, y0, x1, y1 = enclosing([tile.bounds for tile in scene.tiles]).grown(parameters.terrain_margin_m)
    corners = geodetic_from_projected(scene.crs, np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]]))
    return Bounds.between(corners.min(axis=0), corners.max(axis=0))


def own_surface(
    scene: Scene,
    cell: float,
    workers: int,
    *,
    memory: int,
    progress: Progress,
    coarse: bool = False,
    parameters: FusionParameters = FUSION,
) -> Tuple[CellGrid, FloatImage]:
    """A scene's height maps fused into cells of ``cell`` metres in the scene's CRS: the cells, and (rows, columns)
    heights in metres above the ellipsoid, NaN where there are none. ``workers`` and ``memory`` are options.

    ``coarse``: only the height map with the most heights of each tile, and of it every second pixel, which takes a
    fifth of the time and is enough for references whose noise is larger than that of the surface.
    """
    tiles = [tile for tile in scene.tiles if tile.heights]
    grid, lean = CellGrid.covering(enclosing([tile.bounds for tile in tiles]), cell), scene.lean()
    best = [(max(tile.heights, key=lambda record: record.valid),) if coarse else tile.heights for tile in tiles]
    step = 2 if coarse else 1
    tasks = [
        FuseTask(lean, tile.bounds, maps, grid, grid.window(tile.bounds), scene.crs, step=step, parameters=parameters)
        for tile, maps in zip(tiles, best)
    ]
    most = max(
        fusing_mib([record.pixels for record in task.records], task.window.width * task.window.height) for task in tasks
    )
    side = math.ceil(max(max(b.xmax - b.xmin, b.ymax - b.ymin) for b in (task.bounds for task in tasks)) / scene.gsd_m)
    count = workers_within(workers, tile_work(side, most), memory, progress)
    height = np.full(grid.shape, np.nan, dtype=np.float32)
    parts = run_tasks(_heights, tasks, count, progress, lambda task: f"own surface, {task.records[0].tile}")
    for task, part in zip(tasks, parts):
        col, row, columns, rows = task.window
        known = np.isfinite(part)
        height[row : row + rows, col : col + columns][known] = part[known]
    return grid, height


def _heights(task: FuseTask) -> FloatImage:
    return fuse_tile(task).fused.height.astype(np.float32)
