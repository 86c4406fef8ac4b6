"""The scene's coarse surface, matched at an eighth of the resolution: what tiles expect, and terrain feedback.

It costs little (1/512 of a fine search over the same altitudes), and knows the ground everywhere, where tie points
lie on patches only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Optional, Sequence, Tuple

import numpy as np
import pyproj
from numpy.typing import NDArray
from osgeo import ogr

from ..arrays import Bounds, FloatArray
from ..errors import EmptyResultError
from ..geometry.cell_grid import CellGrid
from ..geometry.gridding import grid_points
from ..geometry.tiles import enclosing, lay_tiles
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked, read, write
from ..imagery.sampling import median_of_known, median_of_neighbours
from ..imagery.warping import sample_array, source_positions
from ..parallel import run_tasks
from ..progress import Progress
from ..scene import Scene, View
from ..stereo.pairing import grown, rectified_pair
from ..stereo.triangulation import pair_geometry
from .disparity_map import PairMatcher

FACTOR = 8
CELL_PX = 16  # a side of the surface's cells, fine px: two coarse ones
_BLOCK_PX = 6400  # a side of what is matched at once: 800 coarse px
_MORE = 0.15  # of the scene's altitude range searched beyond either end: its own margins may be short
_LEAST_SCORE = 0.6
_LEAST_SHARE = 0.25  # of a tile's cells must be known for its altitudes to be taken from there
_TAIL = 0.2  # percent of cells on either side that may be blunders
_ROOM_CELLS = 1.25  # m of height a m of cell: what narrow valleys and ridges may lose, a px of disparity or so


@dataclass(frozen=True)
class _Task:
    """What a worker needs: the scene without its tiles, a ground rectangle, a pair, the whole grid, and the matcher."""

    scene: Scene
    bounds: Bounds
    first: str
    second: str
    stretches: Tuple[Stretch, Stretch]
    grid: CellGrid
    match: PairMatcher


@dataclass(frozen=True)
class CoarseSurface:
    """Ground heights, (rows, columns) of ``grid`` in the scene's CRS, metres above the ellipsoid, NaN where unknown."""

    grid: CellGrid
    height: FloatArray

    def altitudes(self, bounds: Bounds) -> Optional[Tuple[float, float]]:
        """Between what heights the ground of a rectangle lies; None where too little of it is known."""
        col, row, width, height = self.grid.window(bounds, 1)
        cells = self.height[row : row + height, col : col + width]
        known = cells[np.isfinite(cells)]
        if known.size < max(4, _LEAST_SHARE * cells.size):
            return None
        low, high = np.percentile(known, (_TAIL, 100 - _TAIL))
        room = _ROOM_CELLS * self.grid.cell
        return float(low - room), float(high + room)

    def write(self, path: str, crs: str) -> str:
        """As a GeoTIFF."""
        return write(
            path,
            [self.height.astype(np.float32)],
            self.grid.geotransform,
            pyproj.CRS.from_user_input(crs).to_wkt(),
            unit="m",
        )


def coarse_surface(
    scene: Scene,
    pairs: Sequence[Tuple[str, str]],
    stretches: Dict[str, Stretch],
    match: PairMatcher,
    workers: int,
    progress: Progress,
) -> CoarseSurface:
    """Match all pairs over all of the scene at an eighth of the resolution, cell by cell the median of the pairs."""
    cell = CELL_PX * scene.gsd_m
    grid = CellGrid.covering(enclosing([tile.bounds for tile in scene.tiles]), cell)
    blocks = lay_tiles(ogr.CreateGeometryFromWkt(scene.area), _BLOCK_PX * scene.gsd_m)
    tasks = [
        _Task(scene.lean(), block.bounds, first, second, (stretches[first], stretches[second]), grid, match)
        for block in blocks
        for first, second in pairs
    ]
    parts = run_tasks(
        _match_block, tasks, workers, progress, lambda task: f"coarse surface, {task.first} and {task.second}"
    )
    height = np.full(grid.shape, np.nan)
    for begin in range(0, len(tasks), len(pairs)):
        found = [part for part in parts[begin : begin + len(pairs)] if part is not None]
        if found:
            col, row, width, rows = grid.window(tasks[begin].bounds)
            height[row : row + rows, col : col + width] = median_of_known(np.stack(found))
    return CoarseSurface(grid, height)


def _match_block(task: _Task) -> Optional[FloatArray]:
    """Heights of a block's cells from one pair; None where the pair does not see it."""
    scene, (first, second) = task.scene, (task.scene.view(name) for name in (task.first, task.second))
    room = _MORE * (scene.altitudes[1] - scene.altitudes[0])
    altitudes = scene.altitudes[0] - room, scene.altitudes[1] + room
    pair = rectified_pair(scene, first, second, grown(task.bounds, 2 * CELL_PX * scene.gsd_m), altitudes)
    if pair is None or min(pair.size) < 16 * FACTOR:
        return None
    pair = pair.scaled(FACTOR)
    try:
        geometry = pair_geometry(pair, first, second, altitudes, scene.crs)
    except EmptyResultError:
        return None
    low, high = math.floor(geometry.disparities[0]) - 2, math.ceil(geometry.disparities[1]) + 2
    width, height = pair.size
    positions = source_positions(lambda p: pair.second_original(p - (high, 0)), (width + high - low, height))
    a = _reduced(first, task.stretches[0], source_positions(pair.first_original, pair.size))
    b = _reduced(second, task.stretches[1], positions)
    found = task.match(a, b, (low, high), geometry.nearer)
    good = ~found.filled & (found.score >= _LEAST_SCORE)
    disparity = np.where(good, found.disparity, np.nan).astype(np.float64)
    columns, rows = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
    z = geometry.height.on_grid(columns, rows, disparity)
    x, y = (table.on_grid(columns, rows, z) for table in (geometry.x, geometry.y))
    cells, _, _ = grid_points(task.grid.part(task.grid.window(task.bounds)), x, y, z, found.score)
    # Medians drop blunders and cells that stand alone.
    return median_of_neighbours(cells, 5, 8)


def _reduced(view: View, stretch: Stretch, positions: FloatArray) -> NDArray[np.float32]:
    """Brightness at original positions, from the window that they span, read by means over ``FACTOR`` px."""
    known = positions[np.isfinite(positions).all(axis=-1)]
    low = np.maximum(np.floor(known.min(axis=0)).astype(int) // FACTOR * FACTOR - FACTOR, 0)
    high = np.minimum(np.ceil(known.max(axis=0)).astype(int) + FACTOR, view.size)
    size = (high - low) // FACTOR
    if (size < 2).any():
        return np.full(positions.shape[:2], np.nan, dtype=np.float32)
    with opened_masked(view.image, view.mask) as dataset:
        window = (int(low[0]), int(low[1]), int(size[0]) * FACTOR, int(size[1]) * FACTOR)
        pixels = read(dataset, window, view.band, (int(size[0]), int(size[1])))
    return sample_array(stretch.apply(pixels), (positions - low + 0.5) / FACTOR - 0.5, "bilinear")
