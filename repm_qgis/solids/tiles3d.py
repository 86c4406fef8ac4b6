"""A DSM as 3-D Tiles 1.1, for CesiumJS, QGIS (3.34 and later) and other viewers on the globe.

A quadtree over the DSM's own cells, made from its leaves upwards. A leaf has 256 x 256 squares between cells; a tile
above four others has every second of their cells, so its vertices are vertices of theirs. Of each tile's cells those
are left out that its triangles do not need. Of each level four tiles are in memory at a time.

Vertices are metres in a local east, north, up frame at the DSM's middle (solids/tileset.py).
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import List, Optional, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import ByteImage, FloatArray, FloatImage, IntArray, Window
from ..contracts.documents import JsonObject
from ..contracts.errors import EmptyResultError
from ..evaluation.grids import Grid, cell_sides, require_place
from ..gate.companions import picture_findings, shown_under
from ..geometry.frames import on_earth
from ..geometry.vertical import TAG
from ..imagery.heights import read_heights
from ..imagery.raster import opened
from ..reports.pictures import hillshade, jpeg_bytes
from ..runtime.progress import Progress, Silent, warn_all
from ..runtime.workspace import whole_folder
from .gltf import small_glb
from .painting import Paint, opened_paint
from .parameters import SOLIDS, SolidsParameters
from .tile_triangles import Kept, kept_of_tile, surface_of_tile
from .tileset import Globe, box, require_tiles3d_place, write_tileset

_LEVEL = 0.7071  # the light on level ground


@dataclass(frozen=True)
class Tiles3dFacts:
    """A written tileset: its tiles with their vertices and triangles, and the error of the root, m."""

    tiles: int
    vertices: int
    triangles: int
    error_m: float


@dataclass
class _Tile:
    """A finished tile: its cells' heights, its picture, its error (m, RMS) against the DSM, its box, and its JSON."""

    heights: FloatImage
    picture: ByteImage
    error: float
    low: FloatArray
    high: FloatArray
    entry: JsonObject


def write_tiles3d(
    dsm: str,
    folder: str,
    ortho: Optional[str] = None,
    *,
    progress: Optional[Progress] = None,
    parameters: SolidsParameters = SOLIDS,
) -> Tiles3dFacts:
    """Write a DSM's surface as 3-D Tiles: a folder with ``tileset.json`` and GLB files, completely or not at all.

    Vertices are centres of cells with their heights above the WGS 84 ellipsoid; holes stay open. Pictures are those of
    the orthophoto ``ortho``, or else a hillshade. Heights of a DSM that does not state its datum are taken to be above
    the ellipsoid, with a warning.

    Raises ImageError for a raster that cannot be read or lies nowhere, EmptyResultError for a DSM without three heights
    beside each other, OverlapError for an orthophoto of another place, MissingPackageError where PROJ lacks the grid of
    its geoid, WorkspaceError where the folder has other files or cannot be written.
    """
    progress = progress or Silent()
    require_tiles3d_place(folder)
    with ExitStack() as stack:
        dataset = stack.enter_context(opened(dsm))
        paint = stack.enter_context(opened_paint(ortho, parameters.painting)) if ortho else None
        if ortho and paint is not None:
            share, values = shown_under(paint.dataset, dataset)
            warn_all(progress, picture_findings(dsm, ortho, share, [values]))
        whole = stack.enter_context(whole_folder(folder))
        (whole / "tiles").mkdir()
        tree = _Tree(dataset, whole, paint, progress, parameters)
        root = tree.tile(tree.depth, 0, 0)
        if root is None:
            raise EmptyResultError(
                f"The DSM '{dsm}' has no three heights beside each other, as a triangle needs: there is nothing to "
                f"write into '{folder}'."
            )
        write_tileset(whole, tree.globe.frame, root.entry, "REPLACE", float(np.linalg.norm(root.high - root.low)))
        return Tiles3dFacts(tree.tiles, tree.vertices, tree.triangles, root.error)


@dataclass
class _Tree:
    """The quadtree while it is written; level 0 are the leaves."""

    dataset: gdal.Dataset
    folder: Path
    paint: Optional[Paint]
    progress: Progress
    parameters: SolidsParameters
    tiles: int = 0
    vertices: int = 0
    triangles: int = 0
    done: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.grid, self.n = Grid.of(self.dataset), self.parameters.tiles3d.cells
        require_place(self.grid)
        width, height = self.grid.size
        middle, tag = self.grid.to_ground(width / 2, height / 2), self.dataset.GetMetadataItem(TAG) or ""
        self.globe = Globe.at(middle, self.grid.path, on_earth(self.grid.crs, self.grid.path), tag, self.progress)
        self.cell_m = max(cell_sides(self.grid))
        self.depth = 0
        while self.n << self.depth < max(width, height) - 1:
            self.depth += 1
        self.leaves = -(-width // self.n) * -(-height // self.n)
        self.texels = 1
        if self.paint is not None:
            ratio = self.cell_m / max(cell_sides(Grid.of(self.paint.dataset)))
            self.texels = int(np.clip(round(ratio), 1, self.parameters.tiles3d.most_texels))

    def tile(self, level: int, row: int, column: int) -> Optional[_Tile]:
        """Write a tile and all below it, whose first cell is that of a row and column; None where no triangle is."""
        width, height = self.grid.size
        if row >= max(height - 1, 1) or column >= max(width - 1, 1):
            return None
        if level == 0:
            self.progress.check_cancelled()
            self.done += 1
            self.progress.step(self.done / (self.leaves + 1))
            heights = self._heights(row, column)
            return self._finished(heights, self._picture(row, column), [], (level, row, column))
        half = self.n << (level - 1)
        parts = [self.tile(level - 1, row + down * half, column + right * half) for down in (0, 1) for right in (0, 1)]
        if not any(parts):
            return None
        fine = np.full((2 * self.n + 1, 2 * self.n + 1), np.nan, np.float32)
        px = self.n * self.texels
        joined = np.zeros((2 * px, 2 * px, 3), np.uint16)
        for index, part in enumerate(parts):
            if part is not None:
                down, right = index // 2 * self.n, index % 2 * self.n
                near = fine[down : down + self.n + 1, right : right + self.n + 1]
                near[:] = np.where(np.isfinite(part.heights), part.heights, near)
                joined[index // 2 * px :, index % 2 * px :][:px, :px] = part.picture
        smaller = (joined[::2, ::2] + joined[1::2, ::2] + joined[::2, 1::2] + joined[1::2, 1::2]) // 4
        below = [part for part in parts if part is not None]
        return self._finished(fine, smaller.astype(np.uint8), below, (level, row, column))

    def _finished(
        self, fine: FloatImage, picture: Optional[ByteImage], below: List[_Tile], place: Tuple[int, int, int]
    ) -> Optional[_Tile]:
        """Choose the vertices of a tile, and write it; ``fine`` are the cells of the tiles below it, or its own."""
        heights = np.ascontiguousarray(fine[::2, ::2]) if below else fine
        p = self.parameters.tiles3d
        cell = self.cell_m * (1 << place[0])
        kept = kept_of_tile(heights, cell, (p.tolerance * cell) ** 2, lost=p.lost, progress=self.progress)
        if not below and not len(kept.triangles):
            return None
        used = np.zeros(fine.shape, bool)
        used[:: 2 if below else 1, :: 2 if below else 1] = kept.cells
        error = _rms(fine - surface_of_tile(fine, used)) + max((part.error for part in below), default=0.0)
        if picture is None or self.paint is None:
            picture = _shaded(heights, cell)
        ends = [end for part in below for end in (part.low, part.high)]
        entry: JsonObject = {}
        if len(kept.triangles):  # else only islands of a few cells are below it
            xyz = self._written(place, heights, kept, picture)
            ends += [xyz.min(axis=0), xyz.max(axis=0)]
            entry["content"] = {"uri": self._name(*place)}
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        entry.update(boundingVolume=box(low, high), geometricError=error)
        if below:
            entry["geometricError"] = max(error, cell, *(part.entry["geometricError"] for part in below))
            entry["children"] = [part.entry for part in below]
        return _Tile(heights, picture, error, low, high, entry)

    def _written(self, place: Tuple[int, int, int], heights: FloatImage, kept: Kept, picture: ByteImage) -> FloatArray:
        """(N, 3) the vertices of a tile, after its file was written."""
        level, row, column = place
        step = 1 << level
        r, c = np.nonzero(kept.cells)
        xyz = self._enu(row + r * step, column + c * step, heights[r, c])
        corners, jpeg = kept.triangles.astype(np.int64), jpeg_bytes(picture, self.parameters.tiles3d.jpeg_quality)
        data = small_glb(xyz, np.column_stack([c, r]) / self.n, corners, image=jpeg)
        (self.folder / self._name(*place)).write_bytes(data)
        self.tiles, self.vertices = self.tiles + 1, self.vertices + len(xyz)
        self.triangles += len(corners)
        return xyz

    def _name(self, level: int, row: int, column: int) -> str:
        side = self.n << level
        return f"tiles/{self.depth - level}_{row // side}_{column // side}.glb"

    def _heights(self, row: int, column: int) -> FloatImage:
        heights = np.full((self.n + 1, self.n + 1), np.nan, np.float32)
        window = Window(column, row, self.n + 1, self.n + 1).common(Window(0, 0, *self.grid.size))
        if window is not None:
            heights[: window.height, : window.width] = read_heights(self.dataset, window)
        return heights

    def _picture(self, row: int, column: int) -> Optional[ByteImage]:
        """The orthophoto from the middle of a tile's first cell to that of its last; None without one."""
        if self.paint is None:
            return None
        x, y = self.grid.to_ground(column + 0.5, row + 0.5)
        _, b, c, _, e, f = (term / self.texels for term in self.grid.transform)
        side = self.n * self.texels
        cells = Grid(self.grid.path, (side, side), (x, b, c, y, e, f), self.grid.wkt)
        return (self.paint.onto(cells) >> 8).astype(np.uint8)

    def _enu(self, row: IntArray, column: IntArray, heights: FloatImage) -> FloatArray:
        return self.globe.enu(np.column_stack(self.grid.to_ground(column + 0.5, row + 0.5)), heights)


def _rms(differences: FloatImage) -> float:
    known = differences[np.isfinite(differences)]
    return float(np.sqrt(np.mean(known.astype(np.float64) ** 2))) if known.size else 0.0


def _shaded(heights: FloatImage, cell_m: float) -> ByteImage:
    """(rows, columns, 3) the surface in greys, of the squares between cells."""
    down = (heights[1:, :-1] - heights[:-1, :-1]) / cell_m
    right = (heights[:-1, 1:] - heights[:-1, :-1]) / cell_m
    grey = np.nan_to_num(hillshade(right, -down), nan=_LEVEL)
    return np.repeat(np.rint(40 + 215 * grey).astype(np.uint8)[..., None], 3, axis=2)
