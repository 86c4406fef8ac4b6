"""A DSM's mesh with fewer vertices, by collapsing the edges whose removal moves the surface least.

The package pyfqmr collapses edges by quadric error metrics. The rims of holes and of the DSM keep all their vertices,
so no triangle covers a cell without a height. Rows are simplified in strips, which bounds the memory: neighbouring
strips share a row of cells, whose vertices stay where they are. All strips together are then simplified once more,
because flat ones need fewer vertices than others.

References
----------
Garland and Heckbert, Surface simplification using quadric error metrics, SIGGRAPH 1997.
Forstmann, Fast quadric mesh simplification, 2014 (MIT licence): thresholds in place of a queue; what pyfqmr wraps.
"""

from __future__ import annotations

import importlib.util
import math
from dataclasses import dataclass, replace
from typing import Iterator, List, Optional, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatArray, FloatImage, IntArray
from ..contracts.errors import INSTALL_REMEDY
from ..contracts.findings import Finding
from ..runtime.progress import Progress
from .lattice import TRIANGLES, Lattice, Surface, square_triangles, thinned
from .painting import Colours, Paint
from .parameters import SimplificationParameters, SolidsParameters


@dataclass(frozen=True)
class Simplified:
    """A mesh whose vertices lie between the cells of a DSM.

    ``xyz`` (N, 3) in the DSM's CRS, from the north to the south; ``corners`` (M, 3) their numbers in the triangles.
    """

    dataset: gdal.Dataset
    xyz: FloatArray
    corners: IntArray
    at_once: int
    progress: Progress
    paint: Optional[Paint] = None

    def parts(self) -> Iterator[FloatArray]:
        """(n, 3) places of the vertices, part by part."""
        for first in range(0, len(self.xyz), self.at_once):
            self.progress.check_cancelled()
            yield self.xyz[first : first + self.at_once]

    def painted(self) -> Iterator[Tuple[FloatArray, Optional[Colours]]]:
        """The same with their (n, 3) colours; None without an orthophoto in colour."""
        for part in self.parts():
            # Few vertices lie on many cells of the orthophoto, which are read at once.
            cells = 0 if self.paint is None else self.paint.dataset.RasterXSize * self.paint.dataset.RasterYSize
            for piece in np.array_split(part, max(1, cells * len(part) // (len(self.xyz) * self.at_once))):
                yield piece, None if self.paint is None else self.paint.points(piece[:, 0], piece[:, 1])

    def triangles(self) -> Iterator[IntArray]:
        """(n, 3) numbers of the vertices of all triangles, part by part."""
        for first in range(0, len(self.corners), self.at_once):
            self.progress.check_cancelled()
            yield self.corners[first : first + self.at_once]

    def counts(self) -> Tuple[int, int]:
        """How many vertices and triangles there are."""
        return len(self.xyz), len(self.corners)


def reduced(
    dataset: gdal.Dataset,
    max_vertices: int,
    parameters: SolidsParameters,
    *,
    progress: Progress,
    paint: Optional[Paint] = None,
) -> Tuple[Surface, int]:
    """The painted surface of a DSM with at most ``max_vertices`` (0: no limit), and how many cells have a height.

    Where a DSM has more cells than memory is planned for, the mesh is made of every second, third, ... row and column;
    of still fewer where the rims of holes alone have more vertices than are wanted. Where the package pyfqmr is
    missing, as many rows and columns as the limit allows are the mesh, which a warning says.
    """
    lattice, cells = thinned(Lattice(dataset, 1, parameters.mesh_block_cells, progress, paint))
    if not max_vertices or cells <= max_vertices:
        return lattice, cells
    if importlib.util.find_spec("pyfqmr") is None:
        progress.warn(
            Finding(
                "mesh-thinned",
                "The mesh has every second, third, ... row and column, because the package 'pyfqmr', which chooses "
                f"better vertices, is missing. To have them, {INSTALL_REMEDY}.",
            )
        )
        return thinned(lattice, max_vertices)[0], cells
    simple, every = parameters.simplification, dataset.RasterXSize * dataset.RasterYSize
    step = math.ceil(math.sqrt(every / min(max(simple.cells, max_vertices), every)))
    while True:
        coarse = replace(lattice, step=step)
        heights = np.concatenate([block for _, block in coarse.rows()])
        if np.isfinite(heights).sum() <= max_vertices:
            return coarse, cells
        cell_m = abs(dataset.GetGeoTransform()[1]) * step
        xyz, corners = _joined(heights, cell_m, max_vertices, parameters=simple, progress=progress)
        if len(xyz) > max_vertices:
            xyz, corners = _collapsed(xyz, corners, max_vertices)
        if len(corners) and len(xyz) <= max_vertices:
            xyz, corners = _southward(_placed(dataset, xyz), corners)
            return Simplified(dataset, xyz, corners, parameters.mesh_block_cells, progress, paint), cells
        step += math.ceil(step / 2)


def _joined(
    heights: FloatImage, cell_m: float, limit: int, *, parameters: SimplificationParameters, progress: Progress
) -> Tuple[FloatArray, IntArray]:
    """The simplified strips of rows as one mesh: (N, 3) column, row (in metres) and height, (M, 3) corners.

    It has more vertices than the limit where all of it can be simplified once more within the planned memory.
    """
    share = (parameters.spare if limit <= parameters.joined else parameters.tight) * limit / np.isfinite(heights).sum()
    lines = max(parameters.strip_cells // heights.shape[1], 2)
    starts = range(0, max(len(heights) - 1, 1), lines)
    done: List[Tuple[FloatArray, IntArray]] = []
    for start in starts:
        progress.check_cancelled()
        xyz, corners = _strip(heights, start, lines, cell_m)
        done.append(_collapsed(xyz, corners, math.ceil(share * len(xyz))))
    xyz = np.concatenate([part for part, _ in done])
    offsets = np.cumsum([0, *(len(part) for part, _ in done[:-1])])
    corners = np.concatenate([part + offset for (_, part), offset in zip(done, offsets)])
    return _welded(xyz, corners, np.array([start * cell_m for start in starts[1:]]))


def _strip(heights: FloatImage, start: int, lines: int, cell_m: float) -> Tuple[FloatArray, IntArray]:
    """All vertices and triangles between so many rows and the next one; cells without a neighbour are left out."""
    part = heights[start : start + lines + 1]
    row, column, kind = square_triangles(part[:-1, :-1], part[:-1, 1:], part[1:, :-1], part[1:, 1:])
    corners = TRIANGLES[kind]
    places = (row[:, None] + corners[..., 0]) * part.shape[1] + column[:, None] + corners[..., 1]
    used, numbers = np.unique(places, return_inverse=True)
    row, column = np.divmod(used, part.shape[1])
    xyz = np.column_stack([column * cell_m, (row + start) * cell_m, part[row, column]])
    return xyz, numbers.reshape(corners.shape[:2])


def _collapsed(xyz: FloatArray, corners: IntArray, limit: int) -> Tuple[FloatArray, IntArray]:
    """At most about ``limit`` of the vertices, with those of all rims.

    A collapsed edge within the mesh takes one vertex and two triangles, which tells how many triangles to leave.
    """
    import pyfqmr

    triangles = len(corners) - 2 * (len(xyz) - limit)
    if triangles >= len(corners) or not len(corners):
        return xyz, corners
    mesh = pyfqmr.Simplify()
    mesh.setMesh(xyz, corners.astype(np.int32))
    mesh.simplify_mesh(target_count=max(triangles, 1), preserve_border=True, verbose=False)
    found, faces, _ = mesh.getMesh()
    used, numbers = np.unique(faces, return_inverse=True)
    return found[used], numbers.reshape(faces.shape)


def _welded(xyz: FloatArray, corners: IntArray, seams: FloatArray) -> Tuple[FloatArray, IntArray]:
    """The mesh whose vertices on the rows between strips, which both strips have, are one."""
    on_seam = np.isin(xyz[:, 1], seams)
    places, numbers = np.unique(xyz[on_seam], axis=0, return_inverse=True)
    renumbered = np.empty(len(xyz), np.int64)
    inner = int((~on_seam).sum())
    renumbered[~on_seam] = np.arange(inner)
    renumbered[on_seam] = inner + numbers.ravel()
    return np.concatenate([xyz[~on_seam], places]), renumbered[corners]


def _placed(dataset: gdal.Dataset, xyz: FloatArray) -> FloatArray:
    """(N, 3) metres right of and below the middle of the first cell, and heights, in the DSM's CRS."""
    x0, cell_x, _, y0, _, cell_y = dataset.GetGeoTransform()
    return np.column_stack([x0 + cell_x / 2 + xyz[:, 0], y0 + cell_y / 2 - xyz[:, 1], xyz[:, 2]])


def _southward(xyz: FloatArray, corners: IntArray) -> Tuple[FloatArray, IntArray]:
    """The same mesh with vertices from the north to the south: colours are then read row by row."""
    order = np.lexsort((xyz[:, 0], -xyz[:, 1]))
    numbers = np.empty(len(order), np.int64)
    numbers[order] = np.arange(len(order))
    return xyz[order], numbers[corners]
