"""Offsets that make the height maps of different pairs agree.

Tie points leave the parallax of a pair wrong by about a tenth of a pixel, and in real images the error changes by as
much within a scene. Across the rows of a rectified pair it is vertical parallax, which can be measured; along them it
only moves heights, smoothly over the ground. Two maps of one place have thousands of heights, so that the difference of
their errors is known to a few hundredths of a pixel in each part of a scene. The error that all maps share stays
unknown, and is left as it is.

Maps are adjusted by their overlaps as strips of a mosaic are (Howat et al. 2019, The Cryosphere 13, 665-674), with
errors that are smooth on the ground in place of constants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds, FloatArray, Floats
from ..contracts.records import HeightMapRecord
from ..geometry.cell_grid import CellGrid
from ..geometry.gridding import grid_points
from ..geometry.tiles import enclosing
from ..matching.backends import height_source
from ..matching.parameters import MATCHING, MatchingParameters
from ..runtime.memory import fusing_mib, tile_work, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..runtime.spare_cores import spread
from ..scene import Scene, Tile
from ..stereo.triangulation import nodes
from .parameters import FUSION, FusionParameters, MapOffsetParameters

Key = Tuple[str, str, str]  # of maps that share their errors: the backend and the pair


class Differences(NamedTuple):
    """How far the heights of one map lie above those of another in parts of a tile.

    ``x``, ``y`` (N,) are the middles of the parts, ``median`` (N,) the differences, m, of so many ``cells`` (N,);
    ``metres_per_px`` those of the two maps.
    """

    first: Key
    second: Key
    metres_per_px: Tuple[float, float]
    x: FloatArray
    y: FloatArray
    median: FloatArray
    cells: FloatArray


@dataclass(frozen=True)
class Lattice:
    """Evenly spaced nodes over ``bounds``, (rows, columns) of them, between which functions are bilinear."""

    bounds: Bounds
    shape: Tuple[int, int]

    @classmethod
    def over(cls, bounds: Bounds, step: float, most: int) -> Lattice:
        """Nodes at most ``step`` metres apart, or ``most`` steps along a side."""
        sides = bounds.ymax - bounds.ymin, bounds.xmax - bounds.xmin
        rows, columns = (1 + min(max(1, math.ceil(side / step)), most) for side in sides)
        return cls(bounds, (rows, columns))

    def weights(self, x: FloatArray, y: FloatArray) -> Any:
        """The sparse (N, nodes) matrix that takes values on the nodes, row by row, to N places within the bounds."""
        from scipy import sparse

        rows, columns = self.shape
        left, below, right, above = self.bounds
        across = np.clip((x - left) / (right - left), 0.0, 1.0) * (columns - 1)
        down = np.clip((above - y) / (above - below), 0.0, 1.0) * (rows - 1)
        column, row = np.minimum(across.astype(int), columns - 2), np.minimum(down.astype(int), rows - 2)
        across, down = across - column, down - row
        first = row * columns + column
        values = np.stack([(1 - down) * (1 - across), (1 - down) * across, down * (1 - across), down * across], axis=1)
        places = first[:, None] + np.array([0, 1, columns, columns + 1])
        each = np.repeat(np.arange(len(x)), 4)
        return sparse.csr_matrix((values.ravel(), (each, places.ravel())), (len(x), rows * columns))

    def stiffness(self, parameters: MapOffsetParameters) -> Any:
        """The sparse (nodes, nodes) inverse covariance of an error of parallax, px, that is small and smooth: of its
        mean, and of its differences between neighbours."""
        from scipy import sparse

        number = np.arange(self.shape[0] * self.shape[1]).reshape(self.shape)
        pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
        first, second = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
        edge, ones = np.arange(len(first)), np.ones(len(first))
        steps = sparse.csr_matrix((ones, (edge, first)), (len(first), number.size))
        steps -= sparse.csr_matrix((ones, (edge, second)), (len(first), number.size))
        size = sparse.identity(number.size) / (parameters.usual_px**2 * number.size)
        return size + steps.T @ steps / parameters.smooth_px**2


@dataclass(frozen=True)
class _TileTask:
    scene: Scene
    bounds: Bounds
    records: Tuple[HeightMapRecord, ...]
    fusion: FusionParameters
    matching: MatchingParameters


@dataclass(frozen=True)
class _Compared:
    """The differences between the maps of a tile, and x and y (rows, columns) at the nodes of each map's own
    lattice."""

    differences: List[Differences]
    ground: List[Tuple[FloatArray, FloatArray]]


def with_agreeing_maps(
    scene: Scene,
    workers: int,
    memory: int,
    progress: Progress,
    fusion: FusionParameters = FUSION,
    matching: MatchingParameters = MATCHING,
) -> Scene:
    """The scene with offsets of its height maps, in place of those that it has; ``workers``, ``memory`` are options."""
    scene, parameters = scene.with_tiles(lambda tile: _with_offsets(tile, {})), fusion.offsets
    lean = scene.lean()
    tiles = [tile for tile in scene.tiles if len(set(map(_key, tile.heights))) > 1]
    tasks = [_TileTask(lean, tile.bounds, tile.heights, fusion, matching) for tile in tiles]
    if not tasks:
        return scene
    count = _workers(tasks, workers, memory, progress)
    found = run_tasks(_compared, tasks, count, progress, lambda task: f"comparing maps of {task.records[0].tile}")
    bounds, step = enclosing([tile.bounds for tile in tiles]), parameters.lattice_px * scene.gsd_m
    lattice = Lattice.over(bounds, step, parameters.most_steps)
    errors = solve_parallax([each for part in found for each in part.differences], lattice, parameters)
    offsets: Dict[str, FloatArray] = {}
    for tile, part in zip(tiles, found):
        for record, (x, y) in zip(tile.heights, part.ground):
            if _key(record) in errors:
                px = lattice.weights(x.ravel(), y.ravel()) @ errors[_key(record)]
                offsets[record.file] = np.round(-record.metres_per_px * px.reshape(x.shape), 5)
    if offsets:
        most = max(float(np.abs(each).max()) for each in offsets.values())
        progress.info(f"The height maps have been moved by up to {most:.2f} m, so that those of different pairs agree.")
    return scene.with_tiles(lambda tile: _with_offsets(tile, offsets))


def _key(record: HeightMapRecord) -> Key:
    return (record.backend, *record.pair)


def _with_offsets(tile: Tile, offsets: Mapping[str, FloatArray]) -> Tile:
    none: FloatArray = np.empty((0, 0))
    rows = (offsets.get(record.file, none).tolist() for record in tile.heights)
    return replace(
        tile, heights=tuple(replace(r, offsets=tuple(map(tuple, own))) for r, own in zip(tile.heights, rows))
    )


def _workers(tasks: Sequence[_TileTask], workers: int, memory: int, progress: Progress) -> int:
    task = max(tasks, key=lambda each: sum(record.pixels for record in each.records))
    pixels = [record.pixels for record in task.records]
    side = max(task.bounds.xmax - task.bounds.xmin, task.bounds.ymax - task.bounds.ymin) / task.scene.gsd_m
    need = fusing_mib(pixels, math.ceil(side / task.fusion.offsets.every_px) ** 2)
    return workers_within(workers, tile_work(math.ceil(side), need), memory, progress)


def _compared(task: _TileTask) -> _Compared:
    parameters, crs = task.fusion.offsets, task.scene.crs
    spacing = parameters.every_px * task.scene.gsd_m
    grid = CellGrid.covering(task.bounds, spacing)

    def layer(record: HeightMapRecord) -> Tuple[FloatArray, Tuple[FloatArray, FloatArray]]:
        source = height_source(task.scene, task.bounds, record, crs, task.matching)
        points = source.read(None, parameters.every_px)
        own = np.where(points.filled, np.nan, points.height)
        apart = parameters.every_px * task.scene.matched_gsd_m(record.pair)
        cells, _, _ = grid_points(
            grid, points.x, points.y, height=own, score=points.score, spacing=apart, parameters=task.fusion.gridding
        )
        columns, rows = (nodes(size, parameters.lattice_px) for size in record.size)
        known = points.height[np.isfinite(points.height)]
        middle = float(np.median(known)) if known.size else sum(record.altitudes) / 2
        level = np.full((len(rows), len(columns)), middle)
        return cells, (source.x.on_grid(columns, rows, level), source.y.on_grid(columns, rows, level))

    layers, ground = (list(each) for each in zip(*spread(layer, task.records)))
    parts = Parts(grid, max(1, round(parameters.part_px / parameters.every_px)))
    differences = []
    best = sorted(range(len(layers)), key=lambda number: task.records[number].metres_per_px)[: parameters.compared]
    for i, first in enumerate(task.records):
        for j, second in enumerate(task.records[:i]):
            if i not in best and j not in best:
                continue
            metres = first.metres_per_px, second.metres_per_px
            x, y, median, cells = parts.medians(layers[i] - layers[j], math.hypot(*metres), parameters)
            differences.append(Differences(_key(first), _key(second), metres, x=x, y=y, median=median, cells=cells))
    return _Compared(differences, ground)


class Parts:
    """Squares of ``side`` x ``side`` cells of a grid; the last ones of a row or column may be cut."""

    def __init__(self, grid: CellGrid, side: int) -> None:
        self._side, self._count = side, tuple(math.ceil(cells / side) for cells in grid.shape)
        middles = [np.minimum((np.arange(n) + 0.5) * side, cells) for n, cells in zip(self._count, grid.shape)]
        y, x = np.meshgrid(grid.north - middles[0] * grid.cell, grid.west + middles[1] * grid.cell, indexing="ij")
        self._x, self._y = x.ravel(), y.ravel()

    def medians(
        self, difference: Floats, metres_per_px: float, parameters: MapOffsetParameters
    ) -> Tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """x, y, the median (m) and the number of cells of each part in which enough cells show one surface in both."""
        usual = np.abs(difference) <= parameters.widest_px * metres_per_px
        if np.count_nonzero(usual) < parameters.least_cells:
            return (np.empty(0),) * 4
        middle = float(np.median(difference[usual]))
        same = np.abs(difference - middle) <= parameters.same_px * metres_per_px
        (rows, columns), side = self._count, self._side
        whole = np.full((rows * side, columns * side), np.nan)
        whole[: difference.shape[0], : difference.shape[1]] = np.where(same, difference, np.nan)
        part = whole.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows * columns, side * side)
        count = np.isfinite(part).sum(axis=1)
        enough = np.flatnonzero(count >= parameters.least_cells)
        ordered, count = np.sort(part[enough], axis=1), count[enough]  # NaN come last
        at = np.arange(len(enough))
        median = 0.5 * (ordered[at, (count - 1) // 2] + ordered[at, count // 2])
        return self._x[enough], self._y[enough], median, count.astype(np.float64)


def solve_parallax(
    differences: Sequence[Differences], lattice: Lattice, parameters: MapOffsetParameters = FUSION.offsets
) -> Dict[Key, FloatArray]:
    """The error of the parallax (px) of each map that was compared with another, on the lattice's nodes, row by row.

    Least squares with Huber's weights, and a prior of small and smooth errors: the prior keeps the mean of all maps,
    each weighted by its geometry, because differences do not determine it.
    """
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    differences = [each for each in differences if len(each.median)]
    keys = list(dict.fromkeys(key for each in differences for key in (each.first, each.second)))
    if not keys:
        return {}
    rows, medians, sigmas = [], [], []
    for each in differences:
        maps = np.zeros((1, len(keys)))
        maps[0, [keys.index(each.first), keys.index(each.second)]] = each.metres_per_px[0], -each.metres_per_px[1]
        rows.append(sparse.kron(maps, lattice.weights(each.x, each.y)))
        medians.append(each.median)
        noise = np.hypot(parameters.known_px, parameters.spread_px / np.sqrt(each.cells))
        sigmas.append(math.hypot(*each.metres_per_px) * noise)
    sigma = np.concatenate(sigmas)
    wanted, scaled = np.concatenate(medians) / sigma, sparse.diags(1.0 / sigma) @ sparse.vstack(rows)
    prior = sparse.kron(sparse.identity(len(keys)), lattice.stiffness(parameters))
    weight, solution = np.ones(len(wanted)), np.zeros(prior.shape[0])
    for _ in range(parameters.iterations):
        weighted = scaled.T @ sparse.diags(weight)
        solution = spsolve((weighted @ scaled + prior).tocsc(), weighted @ wanted)
        weight = 1.0 / np.maximum(np.abs(wanted - scaled @ solution) / parameters.huber, 1.0)
    return dict(zip(keys, solution.reshape(len(keys), -1)))
