"""Where the cells of a DSM lie, and the datum of its heights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import Bounds, FloatArray, Mask, Window
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.interpolation import on_lattice
from ..geometry.tiles import enclosing
from ..geometry.vertical import HeightDatum
from ..scene import Scene, Tile


@dataclass(frozen=True)
class DsmLayout:
    """The DSM's cells, its projected CRS, the datum of its heights, and the window of each tile."""

    grid: CellGrid
    crs: str
    datum: HeightDatum
    windows: Tuple[Window, ...]

    @classmethod
    def of(cls, scene: Scene, tiles: Sequence[Tile], crs: str, datum: HeightDatum, cell: float) -> DsmLayout:
        """In the scene's CRS every cell belongs to one tile; in others tiles are turned and windows overlap."""
        transformer = None if crs == scene.crs else pyproj.Transformer.from_crs(scene.crs, crs, always_xy=True)
        boxes = [tile.bounds for tile in tiles]
        if transformer is not None:
            boxes = [Bounds(*transformer.transform_bounds(*box)) for box in boxes]
        grid = CellGrid.covering(enclosing(boxes), cell)
        return cls(grid, crs, datum, tuple(grid.window(box) for box in boxes))

    @property
    def file_crs(self) -> str:
        """The CRS as it is written into files, with the vertical part of the datum."""
        return self.datum.file_crs(self.crs)

    def undulation(self, grid: CellGrid) -> FloatArray:
        """(rows, columns) m to subtract from the ellipsoidal heights of a part of the grid; geoids are smooth."""
        if not self.datum.code or not all(grid.shape):
            return np.zeros(grid.shape)
        return on_lattice(*grid.centres(), lambda xy: self.datum.undulation(self.crs, xy))


_NEAR = 0.1  # cells: for centres so near to a tile's border, the side on which they lie is computed exactly


def own_cells(grid: CellGrid, crs: str, bounds: Bounds, scene_crs: str) -> Optional[Mask]:
    """Which cells of a grid lie in a tile, whose ``bounds`` are in the scene's CRS: in another one tiles are turned and
    their windows overlap, but each cell belongs to one of them. None in the scene's CRS, where they do not overlap."""
    if crs == scene_crs or not all(grid.shape):
        return None

    def to_scene(xy: FloatArray) -> FloatArray:
        return projected_from_geodetic(scene_crs, geodetic_from_projected(crs, xy))

    xs, ys = grid.centres()
    places = on_lattice(xs, ys, to_scene)
    x, y = places[..., 0], places[..., 1]
    # Between its nodes a tile's lattice is off by up to millimetres, and a neighbour's by others.
    beside = [np.abs(axis - end) for axis, ends in ((x, bounds[::2]), (y, bounds[1::2])) for end in ends]
    row, column = np.nonzero(np.min(beside, axis=0) < _NEAR * grid.cell)
    if row.size:
        places[row, column] = to_scene(np.column_stack([xs[column], ys[row]]))
    own: Mask = (x >= bounds.xmin) & (x < bounds.xmax) & (y >= bounds.ymin) & (y < bounds.ymax)
    return own
