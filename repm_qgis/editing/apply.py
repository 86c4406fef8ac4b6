"""Edits applied to a DSM, one after the other, each to the result of those before it.

The DSM is copied in blocks to a raster, and each edit changes the blocks that it covers: memory does not grow with the
DSM, and neither the blocks nor their order change a byte.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Optional, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Mask, Window
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..evaluation.grids import Grid
from ..geometry.cell_grid import overlapping_blocks
from ..geometry.levels import doubled, halved
from ..imagery.confidence import ConfidenceBands, Provenance
from ..imagery.raster import RasterWriter
from ..runtime.progress import Progress
from . import membrane
from .edits import Edit
from .parameters import EDITING, EditingParameters
from .shapes import Shape

_CROSSED = 0.75  # cells: a cell whose centre is so near to a line is crossed by it, and has its height


@dataclass(frozen=True)
class Applied:
    """What an edit did: how many cells it covered, and the level of flattened water (m, None for others)."""

    cells: int
    level: Optional[float] = None


class Surface:
    """The rasters that are edited: heights in m, and their confidence (None: there is none) with its bands."""

    def __init__(
        self,
        grid: Grid,
        heights: RasterWriter,
        confidence: Optional[Tuple[RasterWriter, int, ConfidenceBands]],
        progress: Progress,
        parameters: EditingParameters = EDITING,
    ) -> None:
        self._grid, self._heights, self._confidence = grid, heights, confidence
        self._progress, self._parameters = progress, parameters

    def apply(self, edit: Edit, shape: Shape) -> Applied:
        """Apply one edit; raises EmptyResultError for one that finds no heights to use."""
        window = shape.window(self._grid)
        if window is None:
            return Applied(0)
        if edit.operation == "remove":
            return self._with_value(shape, window, math.nan)
        if edit.operation == "set":
            return self._with_value(shape, window, float(edit.value or 0.0))
        if edit.operation == "flatten":
            level = self._shore(edit, shape, window) if edit.value is None else edit.value
            return Applied(self._with_value(shape, window, level).cells, level)
        if edit.operation == "fill":
            return self._fill(edit, shape, window.grown(1, self._grid.size))
        return self._breakline(edit, shape, window)

    # --- operations ---

    def _with_value(self, shape: Shape, window: Window, value: float) -> Applied:
        count = 0
        for own, _ in self._blocks(window):
            covered = shape.covered(own)
            if covered.any():
                height = self._heights.read(own)
                height[covered] = value
                self._write(own, height, covered)
                count += int(covered.sum())
        return Applied(count)

    def _shore(self, edit: Edit, shape: Shape, window: Window) -> float:
        """A low percentile of the heights around water."""
        reach = self._parameters.shore_cells
        found = []
        for own, wide in self._blocks(window.grown(reach, self._grid.size), reach):
            covered = shape.covered(wide)
            shore = (_grown(covered, reach) & ~covered)[own.inside(wide)]
            if shore.any():
                heights = self._heights.read(own)[shore]
                found.append(heights[np.isfinite(heights)])
        heights = np.concatenate([np.empty(0, np.float32), *found]).astype(np.float64)
        if not heights.size:
            raise EmptyResultError(
                f"Edit {edit.number} flattens water that no heights surround: give its field 'value' in metres."
            )
        return float(np.float32(np.percentile(heights, self._parameters.shore_percentile)))

    def _breakline(self, edit: Edit, shape: Shape, window: Window) -> Applied:
        shape = Shape(None, tuple(self._with_heights(edit, line) for line in shape.lines), shape.half)
        fading = max(shape.half - _CROSSED, 1e-9)
        shape = Shape(None, shape.lines, max(shape.half, _CROSSED))
        count = 0
        for own, _ in self._blocks(window.grown(1, self._grid.size)):
            away, line = shape.along(own)
            covered = np.isfinite(away)
            if not covered.any():
                continue
            height = self._heights.read(own)
            share = np.where(covered, np.clip(1.0 - (away - _CROSSED) / fading, 0.0, 1.0), 0.0)
            known = np.where(np.isfinite(height), height.astype(np.float64), line)  # where there is none, the line's
            blended = share * line + (1.0 - share) * known
            height[covered] = blended[covered]
            self._write(own, height, covered)
            count += int(covered.sum())
        return Applied(count)

    def _with_heights(self, edit: Edit, line: FloatArray) -> FloatArray:
        """A line whose vertices have heights: their own, else the DSM's; those without one lie on the way between."""
        line = line.copy()
        size = Window(0, 0, *self._grid.size)
        for vertex in line:
            place = Window(math.floor(vertex[0]), math.floor(vertex[1]), 1, 1)
            if not np.isfinite(vertex[2]) and place.common(size):
                vertex[2] = self._heights.read(place)[0, 0]
        known = np.isfinite(line[:, 2])
        if not known.any():
            raise EmptyResultError(
                f"Edit {edit.number} is a breakline whose vertices have no heights: draw it where the DSM has "
                "heights, or give it 3-D vertices."
            )
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])
        line[:, 2] = np.interp(along, along[known], line[known, 2])
        return line

    def _fill(self, edit: Edit, shape: Shape, window: Window) -> Applied:
        steps = 0
        while (window.width >> steps) * (window.height >> steps) > self._parameters.most_solved:
            steps += 1
        count, reached = self._fill_whole(shape, window) if not steps else self._fill_coarsely(shape, window, steps)
        if count and not reached:
            raise EmptyResultError(
                f"Edit {edit.number} fills an area that no heights surround: draw it around some, or set "
                "a value instead."
            )
        if count > reached:
            self._progress.warn(
                Finding(
                    "edit-without-heights",
                    f"Edit {edit.number}: cells without heights around them, which stay empty: {count - reached}.",
                )
            )
        return Applied(count)

    def _fill_whole(self, shape: Shape, window: Window) -> Tuple[int, int]:
        covered, height = shape.covered(window), self._heights.read(window)
        found, reached = membrane.filled(height, covered, self._parameters)
        height[covered] = np.where(reached, found, np.nan)[covered]
        self._write(window, height, covered)
        return int(covered.sum()), int(reached.sum())

    def _fill_coarsely(self, shape: Shape, window: Window, steps: int) -> Tuple[int, int]:
        """Solve on cells of 2**steps, and smooth the result on the DSM's own."""
        coarse, hole = self._means(shape, window, steps)
        solved, reached = membrane.filled(coarse, hole, self._parameters)
        surface, sure = _continued(np.where(reached, solved, coarse)), reached | ~hole
        times = self._parameters.smoothings << steps
        margin = -(-(times + 2) // (1 << steps)) << steps
        counts = [0, 0]
        for own, wide in self._blocks(window, margin, 1 << steps):
            covered = shape.covered(wide)
            if not covered[own.inside(wide)].any():
                continue
            height = self._heights.read(wide)
            top, left = (wide.row - window.row) >> steps, (wide.col - window.col) >> steps
            rows, columns = (-(-count // (1 << steps)) for count in (wide.height, wide.width))
            part = surface[top : top + rows + 2, left : left + columns + 2]  # the surface has a cell more on each side
            for step in range(steps):
                part = doubled(part, (2 * (part.shape[0] - 2), 2 * (part.shape[1] - 2)))
                if step + 1 < steps:
                    part = np.pad(part, 1, mode="edge")
            start = part[: wide.height, : wide.width]
            made = membrane.relaxed(height, covered, start, times)
            top, left = (own.row - window.row) >> steps, (own.col - window.col) >> steps
            inside = sure[top : top + (own.height >> steps) + 1, left : left + (own.width >> steps) + 1]
            inside = inside.repeat(1 << steps, axis=0)[: own.height].repeat(1 << steps, axis=1)[:, : own.width]
            cut = own.inside(wide)
            covered, height = covered[cut], height[cut]
            height[covered] = np.where(inside, made[cut], np.nan)[covered]
            self._write(own, height, covered)
            counts[0] += int(covered.sum())
            counts[1] += int((covered & inside).sum())
        return counts[0], counts[1]

    def _means(self, shape: Shape, window: Window, steps: int) -> Tuple[FloatImage, Mask]:
        """The means of the heights in a window on coarser cells, and which of them the hole covers wholly."""
        side = 1 << steps
        size = -(-window.height // side), -(-window.width // side)
        total, known, hole = (np.zeros(size) for _ in range(3))
        for own, _ in self._blocks(window, 0, side):
            covered, height = shape.covered(own), self._heights.read(own)
            outside = np.isfinite(height) & ~covered
            parts = np.where(outside, height, 0.0).astype(np.float64), outside.astype(float), covered.astype(float)
            top, left = (own.row - window.row) >> steps, (own.col - window.col) >> steps
            for sums, values in zip((total, known, hole), parts):
                for _ in range(steps):
                    values = halved(values)
                sums[top : top + values.shape[0], left : left + values.shape[1]] = values
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.where(known > 0, total / known, np.nan).astype(np.float32)
        return means, (hole > 0) & (known == 0)

    # --- the rasters ---

    def _blocks(self, window: Window, margin: int = 0, whole: int = 1) -> Iterator[Tuple[Window, Window]]:
        """Blocks of a window with a margin, beginning at whole multiples of so many cells."""
        side = max(self._parameters.block_cells // whole, 1) * whole
        for own, wide in overlapping_blocks((window.width, window.height), side, margin):
            self._progress.check_cancelled()
            yield (
                Window(own.col + window.col, own.row + window.row, own.width, own.height),
                Window(wide.col + window.col, wide.row + window.row, wide.width, wide.height),
            )

    def _write(self, own: Window, height: FloatImage, covered: Mask) -> None:
        """Write heights, and the confidence of the cells that an edit covers."""
        self._heights.write(height.astype(np.float32), own.col, own.row)
        if self._confidence is None:
            return
        writer, bands, meaning = self._confidence
        for band in range(1, bands + 1):
            values = writer.read(own, band)
            edited = np.where(np.isfinite(height), float(Provenance.EDITED), np.nan)
            values[covered] = edited[covered] if band == meaning.source else np.nan
            writer.write(values, own.col, own.row, band)


def _grown(mask: Mask, reach: int) -> Mask:
    """A mask with so many cells more on each side."""
    found = mask.copy()
    for axis in (0, 1):
        before = found.copy()
        for step in range(1, reach + 1):
            low, high = [slice(None)] * 2, [slice(None)] * 2
            low[axis], high[axis] = slice(None, -step), slice(step, None)
            found[tuple(high)] |= before[tuple(low)]
            found[tuple(low)] |= before[tuple(high)]
    return found


def _continued(surface: FloatArray) -> FloatArray:
    """With a cell more on each side, and with the mean of their neighbours in cells without a height."""
    surface = np.pad(surface, 1, mode="edge").astype(np.float64)
    usual = float(np.nanmean(surface))
    for _ in range(2):
        padded = np.pad(surface, 1, constant_values=np.nan)
        rows, columns = surface.shape
        near = [padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
        count = sum(np.isfinite(each).astype(float) for each in near)
        mean = sum(np.nan_to_num(each) for each in near) / np.maximum(count, 1.0)
        surface = np.where(np.isfinite(surface) | (count == 0), surface, mean)
    return np.where(np.isfinite(surface), surface, usual)
