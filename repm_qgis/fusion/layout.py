"""Where the cells of a DSM lie, and what its heights are above."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence, Tuple

import numpy as np
import pyproj

from ..arrays import Bounds, FloatArray, Window
from ..geometry.cell_grid import CellGrid
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
        """(rows, columns) to take off the ellipsoidal heights of a part of the grid; geoids are smooth."""
        if not self.datum.code or not all(grid.shape):
            return np.zeros(grid.shape)
        return on_lattice(*grid.centres(), lambda xy: self.datum.undulation(self.crs, xy))
