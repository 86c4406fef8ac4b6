"""A DSM as vertices and triangles, in blocks of rows: what the writers of meshes have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Iterator, Optional, Protocol, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatArray, FloatImage, IntArray, Window
from ..imagery.raster import read
from ..runtime.progress import Progress
from .painting import Colours, Paint

# Corners of the square between four cells, as (row, column): triangles counter-clockwise, seen from above.
_A, _B, _C, _D = (0, 0), (0, 1), (1, 0), (1, 1)
TRIANGLES = np.array([[_A, _C, _D], [_A, _D, _B], [_A, _C, _B], [_B, _C, _D]])


class Surface(Protocol):
    """Vertices and triangles as the writers of meshes take them, part by part; ``dataset`` is the DSM."""

    @property
    def dataset(self) -> gdal.Dataset: ...

    @property
    def paint(self) -> Optional[Paint]: ...

    def parts(self) -> Iterator[FloatArray]:
        """(n, 3) places of the vertices."""

    def painted(self) -> Iterator[Tuple[FloatArray, Optional[Colours]]]:
        """The same with their (n, 3) colours; None without an orthophoto in colour."""

    def triangles(self) -> Iterator[IntArray]:
        """(n, 3) numbers of the vertices of all triangles."""

    def counts(self) -> Tuple[int, int]:
        """How many vertices and triangles there are."""


@dataclass(frozen=True)
class Lattice:
    """Every ``step``-th row and column of a DSM, of which ``block_cells`` cells are read at once."""

    dataset: gdal.Dataset
    step: int
    block_cells: int
    progress: Progress
    paint: Optional[Paint] = None

    def rows(self) -> Iterator[Tuple[int, FloatImage]]:
        """Blocks of rows with the number of their first, NaN where no vertex is; memory does not grow with the DSM."""
        width, height = self.dataset.RasterXSize, self.dataset.RasterYSize
        lines = max(self.block_cells // width // self.step, 1) * self.step
        for row in range(0, height, lines):
            self.progress.check_cancelled()
            block = read(self.dataset, Window(0, row, width, min(lines, height - row)))
            yield row // self.step, block[:: self.step, :: self.step]

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

    def parts(self) -> Iterator[FloatArray]:
        """(n, 3) x, y, height at the centres of the cells that have one."""
        for first, block in self.rows():
            yield self._places(first, block)

    def painted(self) -> Iterator[Tuple[FloatArray, Optional[Colours]]]:
        """The same with their (n, 3) colours; None without an orthophoto in colour."""
        for first, block in self.rows():
            yield self._places(first, block), self._colours(first, block)

    def _places(self, first: int, block: FloatImage) -> FloatArray:
        row, column = np.nonzero(np.isfinite(block))
        x0, cell_x, _, y0, _, cell_y = self.dataset.GetGeoTransform()
        x, y = x0 + (column * self.step + 0.5) * cell_x, y0 + ((row + first) * self.step + 0.5) * cell_y
        return np.column_stack([x, y, block[row, column]])

    def _colours(self, first: int, block: FloatImage) -> Optional[Colours]:
        if self.paint is None:
            return None
        width = self.dataset.RasterXSize
        rows = min((len(block) - 1) * self.step + 1, self.dataset.RasterYSize - first * self.step)
        cells = self.paint.on(self.dataset, Window(0, first * self.step, width, rows))
        painted: Colours = cells[:: self.step, :: self.step][np.isfinite(block)]
        return painted

    def triangles(self) -> Iterator[IntArray]:
        """(n, 3) numbers of the vertices of all triangles."""
        for heights, numbers in self.squares():
            row, column, kind = _cells(heights)
            corners = TRIANGLES[kind]
            yield numbers[row[:, None] + corners[..., 0], column[:, None] + corners[..., 1]]

    def counts(self) -> Tuple[int, int]:
        """How many vertices and triangles there are."""
        return self.vertices(), sum(len(_cells(heights)[0]) for heights, _ in self.squares())

    def vertices(self) -> int:
        """How many vertices there are."""
        return sum(int(np.isfinite(block).sum()) for _, block in self.rows())


def thinned(lattice: Lattice, max_vertices: int = 0) -> Tuple[Lattice, int]:
    """The finest lattice that stays within the limit, and its vertices."""
    limit = min(max_vertices or np.inf, np.iinfo(np.int32).max)  # indices in files
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
