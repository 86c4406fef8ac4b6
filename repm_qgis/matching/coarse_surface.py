"""The coarse surface of a scene: expected altitudes of tiles, and terrain feedback.

Matching at an eighth of the resolution costs little (1/512 of a fine search over the same altitudes), and it finds the
ground everywhere, where tie points lie in patches only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import ogr

from ..contracts.arrays import Altitudes, Bounds, FloatArray, FloatImage, Window
from ..contracts.errors import EmptyResultError
from ..geometry.cell_grid import CellGrid
from ..geometry.gridding import grid_points
from ..geometry.tiles import enclosing, lay_tiles
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened_masked, read, write
from ..imagery.sampling import median_of_known, median_of_neighbours
from ..imagery.warping import sample_array, source_positions
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..scene import Scene, View
from ..stereo.pairing import rectified_pair, reductions
from ..stereo.triangulation import pair_geometry
from .disparity_map import PairMatcher
from .parameters import MATCHING, CoarseSurfaceParameters, MatchingParameters


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
    parameters: MatchingParameters


@dataclass(frozen=True)
class CoarseSurface:
    """Ground heights, (rows, columns) of ``grid`` in the scene's CRS, metres above the ellipsoid, NaN where unknown."""

    grid: CellGrid
    height: FloatArray
    parameters: CoarseSurfaceParameters

    def altitudes(self, bounds: Bounds) -> Optional[Altitudes]:
        """The range of the ground's heights in a rectangle; None where too little of it is known."""
        col, row, width, height = self.grid.window(bounds, 1)
        cells = self.height[row : row + height, col : col + width]
        known = cells[np.isfinite(cells)]
        if known.size < max(self.parameters.least_cells, self.parameters.least_share * cells.size):
            return None
        low, high = np.percentile(known, (self.parameters.tail_percent, 100 - self.parameters.tail_percent))
        room = self.parameters.room_cells * self.grid.cell
        return float(low - room), float(high + room)

    def write(self, path: str, crs: str) -> str:
        """Write the heights as a GeoTIFF."""
        wkt = pyproj.CRS.from_user_input(crs).to_wkt()
        return write(path, [self.height.astype(np.float32)], self.grid.geotransform, wkt, unit="m")


def coarse_surface(
    scene: Scene,
    pairs: Sequence[Tuple[str, str]],
    stretches: Dict[str, Stretch],
    *,
    match: PairMatcher,
    workers: int,
    progress: Progress,
    parameters: MatchingParameters = MATCHING,
) -> CoarseSurface:
    """Match all pairs over the whole scene at a reduced resolution; each cell takes the median of the pairs."""
    p, lean = parameters.coarse_surface, scene.lean()
    grid = CellGrid.covering(enclosing([tile.bounds for tile in scene.tiles]), p.cell_px * scene.gsd_m)
    blocks = lay_tiles(ogr.CreateGeometryFromWkt(scene.area), p.block_px * scene.gsd_m)
    tasks = [
        _Task(lean, block.bounds, first, second, (stretches[first], stretches[second]), grid, match, parameters)
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
    return CoarseSurface(grid, height, p)


def _match_block(task: _Task) -> Optional[FloatArray]:
    """Heights of a block's cells from one pair; None where the pair does not see it."""
    p, stereo = task.parameters.coarse_surface, task.parameters.stereo
    scene, (first, second) = task.scene, (task.scene.view(name) for name in (task.first, task.second))
    room = p.range_share * (scene.altitudes[1] - scene.altitudes[0])
    altitudes = scene.altitudes[0] - room, scene.altitudes[1] + room
    pair = rectified_pair(scene, first, second, task.bounds.grown(2 * p.cell_px * scene.gsd_m), altitudes, stereo)
    if pair is None or min(pair.size) < p.smallest_px * p.factor:
        return None
    pair = pair.scaled(p.factor)
    try:
        geometry = pair_geometry(pair, first, second, altitudes, scene.crs, stereo)
    except EmptyResultError:
        return None
    low = math.floor(geometry.disparities[0]) - p.range_margin_px
    high = math.ceil(geometry.disparities[1]) + p.range_margin_px
    width, height = pair.size
    positions = source_positions(lambda at: pair.second_original(at - (high, 0)), (width + high - low, height))
    factors = [p.factor * max(1, round(ratio)) for ratio in reductions(first, second)]
    a = _reduced(first, task.stretches[0], source_positions(pair.first_original, pair.size), factors[0])
    b = _reduced(second, task.stretches[1], positions, factors[1])
    found = task.match(a, b, (low, high), geometry.height_sign, parameters=task.parameters)
    good = ~found.filled & (found.score >= p.least_score)
    disparity = np.where(good, found.disparity, np.nan).astype(np.float64)
    columns, rows = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
    z = geometry.height.on_grid(columns, rows, disparity)
    x, y = (table.on_grid(columns, rows, z) for table in (geometry.x, geometry.y))
    spacing, part = p.factor * scene.matched_gsd_m((task.first, task.second)), task.grid.window(task.bounds)
    spacing = spacing if spacing > task.grid.cell else math.inf  # then a point is as wide as a cell
    cells, _, _ = grid_points(task.grid.part(part), x, y, height=z, score=found.score, spacing=spacing)
    # The median removes wrong cells and cells without neighbours.
    return median_of_neighbours(cells, p.median_cells, p.least_neighbours)


def _reduced(view: View, stretch: Stretch, positions: FloatArray, factor: int) -> FloatImage:
    """Intensities at original positions, from the window that they span, read by means over ``factor`` px."""
    known = positions[np.isfinite(positions).all(axis=-1)]
    low = np.maximum(np.floor(known.min(axis=0)).astype(int) // factor * factor - factor, 0)
    high = np.minimum(np.ceil(known.max(axis=0)).astype(int) + factor, view.size)
    width, height = (int(n) for n in (high - low) // factor)
    if min(width, height) < 2:
        return np.full(positions.shape[:2], np.nan, dtype=np.float32)
    with opened_masked(view.image, view.mask) as dataset:
        window = Window(int(low[0]), int(low[1]), width * factor, height * factor)
        pixels = read(dataset, window, view.band, (width, height))
    return sample_array(stretch.apply(pixels), (positions - low + 0.5) / factor - 0.5, "bilinear")
