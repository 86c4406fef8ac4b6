"""The DSM as a triangle mesh in a PLY file, which QGIS shows as a mesh layer and every 3-D program opens."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Iterator, Optional, Tuple

import numpy as np
from numpy.typing import NDArray
from osgeo import gdal

from ..arrays import FloatArray, FloatImage, IntArray, Window
from ..errors import EmptyResultError, OptionError
from ..geometry.vertical import ELLIPSOID, TAG
from ..imagery.raster import opened, read
from ..progress import Progress, Silent
from ..workspace import whole_file
from .derived import FinishedDsm
from .painting import Colours, Paint, opened_paint
from .parameters import FUSION, FusionParameters

_COLOURED = np.dtype([("place", "<f8", 3), ("colour", "u1", 3)])
_FACE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3)])
# Corners of the square between four cells, as (row, column): triangles counter-clockwise, seen from above.
_A, _B, _C, _D = (0, 0), (0, 1), (1, 0), (1, 1)
_TRIANGLES = np.array([[_A, _C, _D], [_A, _D, _B], [_A, _C, _B], [_B, _C, _D]])


@dataclass(frozen=True)
class MeshFacts:
    """A written mesh; it has every ``step``-th row and column of the DSM."""

    vertices: int
    faces: int
    step: int


@dataclass(frozen=True)
class _Lattice:
    """Every ``step``-th cell of a DSM, of which ``block_cells`` are read at once."""

    dataset: gdal.Dataset
    step: int
    block_cells: int
    progress: Progress
    paint: Optional[Paint] = None

    def rows(self) -> Iterator[Tuple[int, FloatImage]]:
        """Blocks of rows with the number of their first; memory does not grow with the DSM."""
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
        cells = self.paint.cells(Window(0, first * self.step, width, rows))
        painted: Colours = cells[:: self.step, :: self.step][np.isfinite(block)]
        return painted

    def vertices(self) -> int:
        return sum(int(np.isfinite(block).sum()) for _, block in self.rows())


def make(finished: FinishedDsm, path: str, progress: Progress) -> Optional[str]:
    """The surface of a finished DSM as a PLY; gives its path."""
    options = finished.options
    mesh = write_mesh(options.output, path, options.mesh_vertices, progress, finished.parameters, finished.ortho)
    thinned = f", one of {mesh.step} rows and columns (MESH_VERTICES)" if mesh.step > 1 else ""
    progress.info(f"Mesh of {mesh.vertices} vertices and {mesh.faces} triangles{thinned}.")
    return path


def write_mesh(
    dsm: str,
    path: str,
    max_vertices: int = 0,
    progress: Optional[Progress] = None,
    parameters: FusionParameters = FUSION,
    ortho: Optional[str] = None,
) -> MeshFacts:
    """Write a DSM's surface as a binary PLY, completely or not at all.

    Vertices are cells that have a height, in the DSM's CRS and heights, double precision; where these are more than
    ``max_vertices`` (0: no limit), only every second, third, ... row and column is used. Triangles join three
    neighbours that have a height, so holes stay open; of a square's two diagonals the flatter one is taken, which keeps
    edges of roofs straight. Vertices have the colours of ``ortho``, an orthophoto in colour on the DSM's cells.

    Raises OptionError for another extension, EmptyResultError for a DSM without heights, WorkspaceError where the file
    cannot be written.
    """
    if Path(path).suffix.lower() != ".ply":
        raise OptionError("MESH", path, "must end with .ply")
    progress = progress or Silent()
    with ExitStack() as stack:
        dataset = stack.enter_context(opened(dsm))
        lattice, vertices = _thinned(dataset, max_vertices, parameters.mesh_block_cells, progress)
        if not vertices:
            raise EmptyResultError(f"The DSM '{dsm}' has no heights: there is nothing to write into '{path}'.")
        faces = sum(len(_cells(heights)[0]) for heights, _ in lattice.squares())
        if ortho:
            lattice = replace(lattice, paint=stack.enter_context(opened_paint(ortho, parameters.colour)))
        with whole_file(path) as temporary:
            _write(temporary, lattice, vertices, faces)
    return MeshFacts(vertices, faces, lattice.step)


def _thinned(dataset: gdal.Dataset, max_vertices: int, block_cells: int, progress: Progress) -> Tuple[_Lattice, int]:
    """The finest lattice that stays within the limit, and its vertices."""
    limit = min(max_vertices or np.inf, np.iinfo(np.int32).max)  # PLY's indices
    lattice = _Lattice(dataset, 1, block_cells, progress)
    vertices = lattice.vertices()
    while vertices > limit:
        step = max(math.isqrt(int(vertices // limit)) * lattice.step, lattice.step + 1)
        lattice = replace(lattice, step=step)
        vertices = lattice.vertices()
    return lattice, vertices


def _write(path: str, lattice: _Lattice, vertices: int, faces: int) -> None:
    with open(path, "wb") as stream:
        stream.write(_header(lattice.dataset, vertices, faces, lattice.paint is not None))
        for first, block in lattice.rows():
            stream.write(_vertices(lattice.places(first, block), lattice.colours(first, block)))
        for heights, numbers in lattice.squares():
            stream.write(_faces(heights, numbers).tobytes())


def _vertices(places: FloatArray, colours: Optional[Colours]) -> bytes:
    if colours is None:
        return places.astype("<f8").tobytes()
    records = np.empty(len(places), _COLOURED)
    records["place"], records["colour"] = places, colours >> 8
    return records.tobytes()


def _header(dataset: gdal.Dataset, vertices: int, faces: int, coloured: bool) -> bytes:
    """MDAL, which reads meshes for QGIS, takes the CRS from a comment "crs: WKT"."""
    heights = dataset.GetMetadataItem(TAG) or ELLIPSOID
    lines = ["ply", "format binary_little_endian 1.0", f"comment crs: {dataset.GetProjection()}"]
    lines += [f"comment heights: metres above the {heights}", f"element vertex {vertices}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"property uchar {colour}" for colour in ("red", "green", "blue") if coloured]
    lines.append(f"element face {faces}")
    return "\n".join([*lines, "property list uchar int vertex_indices", "end_header", ""]).encode("utf-8")


def _cells(heights: FloatImage) -> Tuple[IntArray, ...]:
    """Row, column and kind (of ``_TRIANGLES``) of all triangles between the rows of a block."""
    a, b, c, d = heights[:-1, :-1], heights[:-1, 1:], heights[1:, :-1], heights[1:, 1:]
    has = [np.isfinite(corner) for corner in (a, b, c, d)]
    whole = has[0] & has[1] & has[2] & has[3]
    down = np.zeros(whole.shape, dtype=bool)
    down[whole] = np.abs(a[whole] - d[whole]) <= np.abs(b[whole] - c[whole])
    three = [np.logical_and.reduce([has[i] for i in range(4) if i != gone]) & ~has[gone] for gone in range(4)]
    falling, rising = whole & down, whole & ~down
    return np.nonzero(np.stack([falling | three[1], falling | three[2], rising | three[3], rising | three[0]], axis=-1))


def _faces(heights: FloatImage, numbers: IntArray) -> NDArray[Any]:
    row, column, kind = _cells(heights)
    corners = _TRIANGLES[kind]
    faces = np.empty(len(kind), _FACE)
    faces["corners"] = 3
    faces["vertices"] = numbers[row[:, None] + corners[..., 0], column[:, None] + corners[..., 1]]
    return faces
