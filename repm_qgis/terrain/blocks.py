"""The parts of the work, each of which a worker does from files and to files: its memory does not grow.

Blocks begin at whole cells of the coarse surface. All data that a cell depends on lie in the block with its margin, or
in the coarse surface, which is that of the whole DSM: neither the number of workers nor the size of blocks changes a
byte.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Mask, Window
from ..geometry.cell_grid import overlapping_blocks
from ..geometry.levels import halved
from ..imagery import raster
from ..imagery.confidence import Provenance
from ..imagery.heights import read_heights
from ..runtime.workspace import writing
from . import ground, objects
from .inputs import Surface
from .parameters import TERRAIN, TerrainParameters

GROUND, OBJECT, UNKNOWN = 0, 1, 255
"""The values of the mask of objects."""


@dataclass(frozen=True)
class Search:
    """What is searched: the DSM, the width of the largest object (m) and the steepest ground (m per m)."""

    surface: Surface
    largest: float
    slope: float
    parameters: TerrainParameters = TERRAIN

    @property
    def level(self) -> int:
        """How often cells are doubled to those of the coarse surface."""
        return max(0, math.ceil(math.log2(self.parameters.ground.coarse_m / self.surface.cell)))

    @property
    def averaged(self) -> int:
        """How many cells a side are averaged to one on which objects are looked for; a coarse cell has whole ones."""
        finer = self.parameters.objects.cell_m / self.surface.cell
        return int(min(2 ** max(0, math.floor(math.log2(finer) + 1e-9)), 1 << self.level))

    @property
    def coarse_shape(self) -> Tuple[int, int]:
        columns, rows = (coarser(count, self.level) for count in self.surface.size)
        return rows, columns


@dataclass(frozen=True)
class Coarse:
    """The coarse surface of some window: heights (m), slopes (m per m) and Laplacians (m, see
    :func:`~repm_qgis.terrain.ground.whole_surface`) of its cells, and which of them belong to the terrain. ``col`` and
    ``row`` are those of its first cell."""

    height: FloatArray
    slope: FloatArray
    laplacian: FloatArray
    inside: Mask
    col: int = 0
    row: int = 0

    def part(self, wide: Window, level: int) -> Coarse:
        """The cells around a window of the DSM."""
        rows, columns = self.height.shape
        top, left = max((wide.row >> level) - 1, 0), max((wide.col >> level) - 1, 0)
        bottom = min(((wide.row + wide.height) >> level) + 2, rows)
        right = min(((wide.col + wide.width) >> level) + 2, columns)
        cut = slice(top, bottom), slice(left, right)
        return Coarse(self.height[cut], self.slope[cut], self.laplacian[cut], self.inside[cut], left, top)


@dataclass(frozen=True)
class BlockTask:
    """A block's own cells, and these with their margin."""

    own: Window
    wide: Window
    search: Search


@dataclass(frozen=True)
class NearTask(BlockTask):
    """With the coarse surface that tells ground from objects."""

    coarse: Coarse


@dataclass(frozen=True)
class FinishTask(NearTask):
    """With the coarse surface that the finished one begins with, and the file for the block."""

    last: Coarse
    path: str


@dataclass(frozen=True)
class Part:
    """What a block gives to the coarse surface: sums of its cells (see :data:`~repm_qgis.terrain.ground.Sums`), and how
    many of the DSM's heights each has."""

    own: Window
    sums: ground.Sums
    known: FloatArray


@dataclass(frozen=True)
class Block:
    """A finished block: its file, and how many of its cells have a height, are objects, and have a terrain."""

    own: Window
    path: str
    known: int
    objects: int
    terrain: int


def windows(search: Search, margin: int) -> List[Tuple[Window, Window]]:
    """Each block's own cells and these with a margin, which is rounded up to whole coarse cells."""
    side = max(search.parameters.block_cells >> search.level, 1) << search.level
    return list(overlapping_blocks(search.surface.size, side, coarser(margin, search.level) << search.level))


def coarser(count: int, level: int) -> int:
    """How many cells of a level so many of the DSM's cells touch."""
    return -(-count // (1 << level))


def search_margin(search: Search) -> int:
    """Cells around a block on which its objects depend."""
    cell = search.surface.cell * search.averaged
    reach = objects.reach(cell, search.largest, search.parameters.objects)
    return search.averaged * (reach + search.parameters.ground.rim_cells) + search.averaged


def finishing_margin(search: Search) -> int:
    """Cells around a block on which its finished surface depends."""
    return ground.reach(search.level, search.parameters.ground) + search.parameters.ground.rim_cells


def block_mib(searched: Sequence[Window], finished: Sequence[Window]) -> float:
    """Peak memory of a worker, MiB, for the windows on which objects are searched and those that are finished.

    Measured on blocks of 1600 and 3200 cells a side with a confidence raster: 63 and 112 bytes a cell, and 121 MiB for
    a worker without a block.
    """
    most = (max(wide.width * wide.height for wide in windows) for windows in (searched, finished))
    return 130.0 + max(cells * each for cells, each in zip(most, (66.0, 116.0))) / 2**20


def first_ground(task: BlockTask) -> Part:
    """The ground of a block as openings find it: all cells that belong to no object."""
    search, surface = task.search, task.search.surface
    height, weight = _read(task)
    reduced = _means(height, search.averaged)
    cell = surface.cell * search.averaged
    found = objects.objects_on(reduced, cell, search.largest, search.slope, search.parameters.objects)
    found = np.repeat(
        np.repeat(objects.grown(found, search.parameters.ground.rim_cells), search.averaged, 0), search.averaged, 1
    )
    return _part(task, height, np.where(found[: height.shape[0], : height.shape[1]], 0.0, weight))


def better_ground(task: NearTask) -> Part:
    """The ground of a block by how far its cells are from the coarse surface."""
    height, weight = _read(task)
    return _part(task, height, _near(task, height, weight))


def make_block(task: FinishTask) -> Block:
    """Make a block and keep it in a file: terrain, height above it and mask of its own cells."""
    search, level = task.search, task.search.level
    height, weight = _read(task)
    weight = _near(task, height, weight)
    sums = (np.where(weight > 0, np.nan_to_num(height), 0.0) * weight, weight)
    start, laplacian = (
        _on_cells(task.last, values, task.wide, level, level) for values in (task.last.height, task.last.laplacian)
    )
    levels = ground.levels_of(sums, level)[:-1]
    choices = search.parameters.ground
    terrain = ground.finer_surface(start, laplacian, levels, choices.stiffness, choices).astype(np.float32)
    inside = _on_window(task.last, task.last.inside, task.wide, level) | np.isfinite(height)
    above = height - terrain
    slope = _on_cells(task.last, task.last.slope, task.wide, level, 0)
    tall = above > choices.object_m + slope
    mask = np.where(np.isfinite(height), np.where(tall, OBJECT, GROUND), UNKNOWN).astype(np.uint8)
    cut = task.own.inside(task.wide)
    made = {"output": np.where(inside, terrain, np.float32(np.nan))[cut], "heights": above[cut], "mask": mask[cut]}
    with writing(task.path):
        np.savez(task.path, **made)
    return Block(
        own=task.own,
        path=task.path,
        known=int(np.isfinite(made["heights"]).sum()),
        objects=int((made["mask"] == OBJECT).sum()),
        terrain=int(np.isfinite(made["output"]).sum()),
    )


def _read(task: BlockTask) -> Tuple[FloatImage, FloatArray]:
    """Heights of a block with its margin (m), and their weights: 1 at the usual error, less where more is expected, and
    zero where a height was interpolated."""
    surface = task.search.surface
    with raster.opened(surface.path) as dataset:
        height = read_heights(dataset, task.wide)
    weight = np.isfinite(height).astype(np.float64)
    if surface.confidence:
        with raster.opened(surface.confidence) as dataset:
            error = raster.read(dataset, task.wide, surface.error_band).astype(np.float64)
            error = np.where(np.isfinite(error), np.maximum(error, surface.usual_error), surface.usual_error)
            weight *= (surface.usual_error / error) ** 2
            if surface.source_band:
                source = raster.read(dataset, task.wide, surface.source_band)
                weight[np.isin(source, (Provenance.INTERPOLATED, Provenance.INTERPOLATED_ON_DEM))] = 0.0
    return height, weight


def _near(task: NearTask, height: FloatImage, weight: FloatArray) -> FloatArray:
    """The weights of the cells that are near the coarse surface and not beside an object; 0 elsewhere."""
    coarse, search = task.coarse, task.search
    choices = search.parameters.ground
    slope = _on_cells(coarse, coarse.slope, task.wide, search.level, 0)
    above = height - _on_cells(coarse, coarse.height, task.wide, search.level, 0)
    tolerance = max(choices.tolerance_m, search.surface.usual_error)
    with np.errstate(invalid="ignore"):
        near = np.abs(above) < tolerance + slope
        tall = above > choices.object_m + slope
    return np.where(near & ~objects.grown(tall, choices.rim_cells), weight, 0.0)


def _part(task: BlockTask, height: FloatImage, weight: FloatArray) -> Part:
    """A block's own cells on the coarse level."""
    cut = task.own.inside(task.wide)
    height, weight = height[cut], weight[cut]
    known = np.isfinite(height).astype(np.float64)
    sums = (np.where(weight > 0, np.nan_to_num(height), 0.0) * weight, weight)
    for _ in range(task.search.level):
        sums, known = (halved(sums[0]), halved(sums[1])), halved(known)
    return Part(task.own, sums, known)


def _means(height: FloatImage, count: int) -> FloatImage:
    """Means over count x count cells, of those with a height."""
    known = np.isfinite(height).astype(np.float64)
    total = np.nan_to_num(height).astype(np.float64)
    for _ in range(count.bit_length() - 1):
        total, known = halved(total), halved(known)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known > 0, total / known, np.nan).astype(np.float32)


def _on_cells(coarse: Coarse, values: FloatArray, wide: Window, level: int, to: int) -> FloatArray:
    """Values of the coarse surface on the cells of a window, bilinear; ``to`` is the level of these cells."""
    for _ in range(level - to):
        values = ground.finer(values, (2 * values.shape[0], 2 * values.shape[1]))
    scale = level - to
    top, left = (wide.row >> to) - (coarse.row << scale), (wide.col >> to) - (coarse.col << scale)
    return values[top : top + coarser(wide.height, to), left : left + coarser(wide.width, to)]


def _on_window(coarse: Coarse, values: Mask, wide: Window, level: int) -> Mask:
    """The values of the coarse cells, on the cells in them."""
    rows = ((wide.row + np.arange(wide.height)) >> level) - coarse.row
    columns = ((wide.col + np.arange(wide.width)) >> level) - coarse.col
    return np.asarray(values[np.ix_(rows, columns)])
