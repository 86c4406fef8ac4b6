"""The parts of a mosaic's work, each of which a worker does from files and to files: its memory does not grow."""

from __future__ import annotations

import math
import os
import zipfile
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, IntArray, Window
from ..contracts.documents import JsonObject
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..evaluation.coregistration import align, block_means
from ..evaluation.grids import Grid, HeightWarper, cell_metres, metres_per_unit
from ..gate.surfaces import overlap_findings
from ..geometry.cell_grid import overlapping_blocks
from ..imagery import raster
from ..imagery.heights import read_heights
from ..numerics.robust import nmad
from ..registration.parameters import REGISTRATION
from ..registration.solve import other_relief
from ..runtime.workspace import writing
from .inputs import Dsm, Layout
from .offsets import Overlap
from .parameters import MOSAIC, MosaicParameters, OffsetParameters
from .seams import mosaicked, reach, to_unknown, without_small_holes

STEP_M = 0.01
"""Width of a bin of the steps' histogram; the last of :data:`STEP_BINS` bins holds all that is larger."""
STEP_BINS = 500
_LEAST_SIDE = 64
_STORED = ("height", "source", "count", "spread", "steps")


# Differences of two DSMs ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PairTask:
    """Two DSMs by their numbers, and the window of the mosaic that may show both."""

    numbers: Tuple[int, int]
    dsms: Tuple[Dsm, Dsm]
    window: Window
    target: Grid
    parameters: OffsetParameters = MOSAIC.offsets


def pair_tasks(layout: Layout, parameters: OffsetParameters) -> List[PairTask]:
    """All pairs whose extents meet."""
    found = []
    for (i, first), (j, second) in combinations(enumerate(layout.dsms), 2):
        common = first.window.common(second.window)
        if common is not None:
            found.append(PairTask((i, j), (first, second), common, layout.target, parameters))
    return found


def measure_pair(task: PairTask) -> Optional[Overlap]:
    """The median difference of two DSMs, from parts that lie evenly over their overlap; None without enough cells."""
    windows = _patches(task.window, task.parameters.patch_cells, task.parameters.patches)
    parts: List[FloatArray] = []
    with raster.opened(task.dsms[0].path) as first, raster.opened(task.dsms[1].path) as second:
        warpers = [HeightWarper(dataset, task.target) for dataset in (first, second)]
        for window in windows:
            cells = task.target.window(window)
            here = warpers[0].read(cells)
            if np.isfinite(here).any():
                there = warpers[1].read(cells)
                both = np.isfinite(here) & np.isfinite(there)
                parts.append(np.stack([here[both], there[both]]).astype(np.float64))
    heights = np.concatenate([np.empty((2, 0)), *parts], axis=1)
    found, plan = heights[0] - heights[1], task.parameters
    cell = max(cell_metres(task.target)) / min(1.0, *(dsm.ratio for dsm in task.dsms))  # of the coarser DSM
    left = max(plan.most_left_m, plan.most_left_cells * cell)
    relief = replace(
        REGISTRATION, most_left_m=left, unexplained=plan.unexplained, most_alike_scaled=plan.most_alike_scaled
    )
    if found.size < task.parameters.least_cells:
        return None
    seen = sum(window.width * window.height for window in windows)
    cells_of_all = round(found.size * task.window.width * task.window.height / seen)
    first_number, second_number = task.numbers
    unlike = other_relief(heights[1], heights[0], relief)
    displaced, findings = _compared(task)
    return Overlap(
        first=first_number,
        second=second_number,
        cells=cells_of_all,
        median=float(np.median(found)),
        nmad=nmad(found),
        displaced=displaced,
        other_relief=unlike,
        findings=() if unlike else findings,
    )


def _compared(task: PairTask) -> Tuple[Optional[Tuple[float, float]], Tuple[Finding, ...]]:
    """How far the second DSM lies to the east and north of the first, m, None where the relief is too weak to find it;
    and whether it is tilted, or shows the ground alone."""
    choices, cell = task.parameters, min(cell_metres(task.target))
    factor = max(1, math.ceil(choices.displaced_cell_m / cell))
    windows = _patches(task.window, choices.displaced_patch_cells * factor, choices.displaced_patches)
    largest = max(min(window.width, window.height) for window in windows)
    patches, coarse = [], []
    with raster.opened(task.dsms[0].path) as first, raster.opened(task.dsms[1].path) as second:
        warpers = [HeightWarper(dataset, task.target) for dataset in (second, first)]
        for window in windows:
            if min(window.width, window.height) * 2 > largest:  # the smallest one bounds the search
                coarse.append(Window(window.col // factor, window.row // factor, 0, 0))
                cells = task.target.window(window)
                dsm, reference = (block_means(warper.read(cells), factor) for warper in warpers)
                patches.append((dsm, reference))
    cells_m = (cell * factor, cell * factor)
    names = f"DSM {task.numbers[0] + 1}", f"DSM {task.numbers[1] + 1}"
    wide, high = (max(getattr(dsm.window, side) for dsm in task.dsms) * cell for side in ("width", "height"))
    findings = tuple(overlap_findings([patch[::-1] for patch in patches], coarse, cells_m, names, (wide, high)))
    try:
        found = align("3d", patches, cells_m)
    except EmptyResultError:
        return None, findings
    before = _mean_deviation([dsm - reference for dsm, reference in patches])
    after = _mean_deviation([found.applied(dsm, cells_m) - reference for dsm, reference in patches])
    return ((-found.dx, -found.dy) if after <= choices.displaced_gain * before else (0.0, 0.0)), findings


def _mean_deviation(differences: Sequence[FloatImage]) -> float:
    """The mean distance from the median, m: the NMAD does not notice houses in a flat town."""
    known = np.concatenate([each[np.isfinite(each)] for each in differences])
    return float(np.abs(known - np.median(known)).mean())


def _patches(window: Window, side: int, most: int) -> List[Window]:
    """The blocks of a window with this side, or so many of them, evenly spread."""
    blocks = [
        Window(window.col + own.col, window.row + own.row, own.width, own.height)
        for own, _ in overlapping_blocks((window.width, window.height), side)
    ]
    chosen = np.unique(np.linspace(0, len(blocks) - 1, min(len(blocks), most)).round().astype(int))
    return [blocks[index] for index in chosen]


# How far inside a DSM a place lies --------------------------------------------------------------------------------


@dataclass(frozen=True)
class InteriorTask:
    """A DSM, and the file for the map of how far inside it its places lie."""

    dsm: Dsm
    path: str
    parameters: MosaicParameters = MOSAIC


def write_interior(task: InteriorTask) -> str:
    """Write the distance to the DSM's border, m, as a raster on the DSM's ground with few cells; gives its path.

    It is 0 within a cell of the border: near it, blocks measure the distance themselves. A map that an earlier, stopped
    run has written there is taken as it is.
    """
    if os.path.exists(task.path):
        return task.path
    seams = task.parameters.seams
    with raster.opened(task.dsm.path) as dataset:
        grid = Grid.of(dataset)
        factor = max(1, math.ceil(max(grid.size) / seams.interior_px))
        size = (math.ceil(grid.size[0] / factor), math.ceil(grid.size[1] / factor))
        known = np.isfinite(read_heights(dataset, size=size if factor > 1 else None))
        crs = dataset.GetProjection()
    cells = to_unknown(np.pad(without_small_holes(known, seams), 1))[1:-1, 1:-1]
    x, b, c, y, e, f = grid.transform
    across, down = grid.size[0] / size[0], grid.size[1] / size[1]
    place = (x, b * across, c * down, y, e * across, f * down)
    side = across * math.hypot(b, e) * metres_per_unit(grid)[0]
    distance = (np.maximum(cells - 1, 0) * side).astype(np.float32)
    return raster.write(task.path, [distance], place, crs, nodata=None, own=True)


# One block of the mosaic ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Source:
    """A DSM with all that blocks need of it: ``added`` to its heights (m), the map ``interior``, and the error (m) of
    the heights for which no raster states one."""

    number: int
    dsm: Dsm
    interior: str
    added: float
    error: float


@dataclass(frozen=True)
class BlockTask:
    """A block's own cells, these with their margin, and the DSMs that may show them."""

    own: Window
    wide: Window
    target: Grid
    sources: Tuple[Source, ...]
    path: str
    parameters: MosaicParameters = MOSAIC


@dataclass(frozen=True)
class Block:
    """A finished block: its file, None where no DSM has a height; how many cells each DSM gives, by its number, and
    how often two DSMs are how far apart along the seams (see :data:`STEP_M`), up to the largest step that there is.

    ``reused``: an earlier, stopped run had made the block.
    """

    own: Window
    path: Optional[str]
    cells: Dict[int, int]
    steps: IntArray
    reused: bool = False


def block_tasks(
    layout: Layout, sources: Sequence[Source], folder: str, parameters: MosaicParameters
) -> List[BlockTask]:
    """The blocks that some DSM may show, row by row; where many DSMs lie over each other, blocks are smaller."""
    halo, side = reach(parameters.seams), parameters.block_cells
    while True:
        blocks = [
            (own, wide, tuple(each for each in sources if each.dsm.window.common(wide)))
            for own, wide in overlapping_blocks(layout.grid.size, side, halo)
        ]
        if side <= _LEAST_SIDE or max(_stack_cells(wide, here) for _, wide, here in blocks) <= parameters.stack_cells:
            break
        side //= 2
    return [
        BlockTask(own, wide, layout.target, here, f"{folder}/{number}.npz", parameters)
        for number, (own, wide, here) in enumerate(blocks)
        if any(each.dsm.window.common(own) for each in here)
    ]


def _stack_cells(wide: Window, sources: Sequence[Source]) -> float:
    """The cells that a block reads and holds of all its DSMs."""
    return wide.width * wide.height * sum(max(1.0, each.dsm.ratio) ** 2 for each in sources)


def block_mib(task: BlockTask) -> float:
    """Peak memory of a worker that makes a block, MiB; measured (`make bench-mosaic`)."""
    return 130.0 + 60.0 * _stack_cells(task.wide, task.sources) / 2**20


def make_block(task: BlockTask) -> Block:
    """Make a block and keep it in a file: height, source (number from 0), count and spread of its own cells.

    A block that an earlier, stopped run has stored there is taken as it is.
    """
    made = _finished(task.path)
    reused = made is not None
    if made is None:
        made = _made(task)
        if made is None:
            return Block(task.own, None, {}, np.empty(0, np.int64))
        with writing(task.path):
            np.savez(task.path, **made)
    places, counts = np.unique(made["source"][made["source"] >= 0], return_counts=True)
    return Block(task.own, task.path, dict(zip(places.tolist(), counts.tolist())), made["steps"], reused)


def _finished(path: str) -> Optional[JsonObject]:
    """A stored block, whose checksums reading compares; None where it is not there as a whole."""
    try:
        with np.load(path, allow_pickle=False) as kept:
            return {name: kept[name] for name in _STORED}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _made(task: BlockTask) -> Optional[JsonObject]:
    """What is stored of a block; None where no DSM has a height."""
    seams, cells = task.parameters.seams, task.target.window(task.wide)
    heights, errors, interiors, numbers = [], [], [], []
    for each in task.sources:
        height = _read(each.dsm.path, task, cells)
        if not np.isfinite(height).any():
            continue
        error = np.full(height.shape, each.error, np.float32)
        if each.dsm.confidence:
            stated = _read(each.dsm.confidence, task, cells, each.dsm.band)
            error = np.where(np.isfinite(stated), stated, error)
        interior = np.nan_to_num(_read(each.interior, task, cells), nan=0.0) / np.float32(_cell_m(task.target))
        heights.append(height + np.float32(each.added))
        errors.append(np.maximum(error, np.float32(seams.least_error_m)))
        interiors.append(interior)
        numbers.append(each.number)
    if not heights:
        return None
    own = Window(task.own.col - task.wide.col, task.own.row - task.wide.row, task.own.width, task.own.height)
    made = mosaicked(np.stack(heights), np.stack(errors), np.stack(interiors), own, seams)
    source = np.where(made.source >= 0, np.array(numbers)[made.source], -1).astype(np.int32)
    steps = np.bincount(np.minimum(made.steps / STEP_M, STEP_BINS - 1).astype(np.int64))
    return dict(zip(_STORED, (made.height, source, made.count.astype(np.int32), made.spread, steps)))


def _read(path: str, task: BlockTask, cells: Grid, band: int = 1) -> FloatImage:
    with raster.opened(path) as dataset:
        return HeightWarper(dataset, task.target, band=band).read(cells)


def _cell_m(target: Grid) -> float:
    return abs(target.transform[1])
