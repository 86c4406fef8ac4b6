"""A DSM as vertices and triangles, in blocks of rows: what the writers of meshes have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Iterator, Optional, Tuple

import numpy as np
from numpy.typing import NDArray
from osgeo import gdal

from ..contracts.arrays import FloatArray, FloatImage, IntArray, Mask, Window
from ..imagery.raster import read
from ..runtime.progress import Progress
from .painting import Colours, Paint

# Corners of the square between four cells, as (row, column): triangles counter-clockwise, seen from above.
_A, _B, _C, _D = (0, 0), (0, 1), (1, 0), (1, 1)
TRIANGLES = np.array([[_A, _C, _D], [_A, _D, _B], [_A, _C, _B], [_B, _C, _D]])


@dataclass(frozen=True)
class Kept:
    """A simplified lattice: which of its cells are vertices, and (N, 3) their numbers in the triangles."""

    cells: Mask
    triangles: NDArray[np.int32]


@dataclass(frozen=True)
class Lattice:
    """Every ``step``-th cell of a DSM, of which ``block_cells`` are read at once; of these the ``kept`` ones."""

    dataset: gdal.Dataset
    step: int
    block_cells: int
    progress: Progress
    paint: Optional[Paint] = None
    kept: Optional[Kept] = None

    def rows(self) -> Iterator[Tuple[int, FloatImage]]:
        """Blocks of rows with the number of their first, NaN where no vertex is; memory does not grow with the DSM."""
        width, height = self.dataset.RasterXSize, self.dataset.RasterYSize
        lines = max(self.block_cells // width // self.step, 1) * self.step
        for row in range(0, height, lines):
            self.progress.check_cancelled()
            block = read(self.dataset, Window(0, row, width, min(lines, height - row)))
            first, block = row // self.step, block[:: self.step, :: self.step]
            if self.kept is not None:
                block = np.where(self.kept.cells[first : first + len(block)], block, np.float32(np.nan))
            yield first, block

    def squares(self) -> Iterator[Tuple[FloatImage, IntArray]]:
        """Heights and numbers of vertices, each block with the last row of the one before."""
        above: Optional[Tuple[FloatImage, IntArray]] = None
        count = 0
        for _, block in self.rows():
            known = np.isfinite(block)
            numbers = count + np.cumsum(known.ravel()).reshape(known.shape) - 1
            count += int(known.sum())
            pair = (block, numbers) if above is None else (np.vstack([above[0], block]), np.vstack([above[1], numbers]))
            above = block[-1:], numbers[-1:]
            yield pair

    def places(self, first: int, block: FloatImage) -> FloatArray:
        """(N, 3) x, y, height at the centres of the cells that have one."""
        row, column = np.nonzero(np.isfinite(block))
        x0, cell_x, _, y0, _, cell_y = self.dataset.GetGeoTransform()
        x, y = x0 + (column * self.step + 0.5) * cell_x, y0 + ((row + first) * self.step + 0.5) * cell_y
        return np.column_stack([x, y, block[row, column]])

    def colours(self, first: int, block: FloatImage) -> Optional[Colours]:
        """(N, 3) colours of these cells; None without an orthophoto in colour."""
        if self.paint is None:
            return None
        width = self.dataset.RasterXSize
        rows = min((len(block) - 1) * self.step + 1, self.dataset.RasterYSize - first * self.step)
        cells = self.paint.on(self.dataset, Window(0, first * self.step, width, rows))
        painted: Colours = cells[:: self.step, :: self.step][np.isfinite(block)]
        return painted

    def triangles(self) -> Iterator[IntArray]:
        """(N, 3) numbers of the vertices of all triangles, block by block."""
        if self.kept is not None:
            for start in range(0, len(self.kept.triangles), self.block_cells):
                self.progress.check_cancelled()
                yield self.kept.triangles[start : start + self.block_cells].astype(np.int64)
            return
        for heights, numbers in self.squares():
            row, column, kind = _cells(heights)
            corners = TRIANGLES[kind]
            yield numbers[row[:, None] + corners[..., 0], column[:, None] + corners[..., 1]]

    def faces(self) -> int:
        """How many triangles there are."""
        if self.kept is not None:
            return len(self.kept.triangles)
        return sum(len(_cells(heights)[0]) for heights, _ in self.squares())

    def vertices(self) -> int:
        """How many vertices there are."""
        return sum(int(np.isfinite(block).sum()) for _, block in self.rows())


def thinned(dataset: gdal.Dataset, max_vertices: int, block_cells: int, progress: Progress) -> Tuple[Lattice, int]:
    """The finest lattice that stays within the limit, and its vertices."""
    limit = min(max_vertices or np.inf, np.iinfo(np.int32).max)  # indices in files
    lattice = Lattice(dataset, 1, block_cells, progress)
    vertices = lattice.vertices()
    while vertices > limit:
        step = max(math.isqrt(int(vertices // limit)) * lattice.step, lattice.step + 1)
        lattice = replace(lattice, step=step)
        vertices = lattice.vertices()
    return lattice, vertices


def square_triangles(a: FloatImage, b: FloatImage, c: FloatImage, d: FloatImage) -> Tuple[IntArray, ...]:
    """Where there are triangles (a number for each axis of the arrays) and their kind, of ``TRIANGLES``.

    The heights are those of the upper left, upper right, lower left and lower right corners of squares, NaN for none.
    """
    has = [np.isfinite(corner) for corner in (a, b, c, d)]
    whole = has[0] & has[1] & has[2] & has[3]
    down = np.zeros(whole.shape, dtype=bool)
    down[whole] = np.abs(a[whole] - d[whole]) <= np.abs(b[whole] - c[whole])
    three = [np.logical_and.reduce([has[i] for i in range(4) if i != gone]) & ~has[gone] for gone in range(4)]
    falling, rising = whole & down, whole & ~down
    return np.nonzero(np.stack([falling | three[1], falling | three[2], rising | three[3], rising | three[0]], axis=-1))


def _cells(heights: FloatImage) -> Tuple[IntArray, ...]:
    """Row, column and kind of all triangles between the rows of a block."""
    return square_triangles(heights[:-1, :-1], heights[:-1, 1:], heights[1:, :-1], heights[1:, 1:])
