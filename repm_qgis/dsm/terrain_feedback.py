"""Terrain feedback: a coarse surface from the heights that a scene already has, for the terrain-aware refinement."""

from __future__ import annotations

import numpy as np
import pyproj

from ..arrays import Bounds
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..geometry.tiles import enclosing
from ..imagery.raster import created
from ..scene import Scene
from .fusion import FuseTask, fuse_tile
from .parameters import FUSION, FusionParameters


def lon_lat_bounds(scene: Scene, parameters: FusionParameters = FUSION) -> Bounds:
    """West, south, east, north of a scene's tiles with a margin, in degrees."""
    x0, y0, x1, y1 = enclosing([tile.bounds for tile in scene.tiles]).grown(parameters.terrain_margin_m)
    corners = geodetic_from_projected(scene.crs, np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]]))
    return Bounds(*map(float, (*corners.min(axis=0), *corners.max(axis=0))))


def surface_of_heights(scene: Scene, cell: float, path: str, parameters: FusionParameters = FUSION) -> str:
    """Fuse a scene's height maps into coarse cells of ``cell`` metres, as a GeoTIFF in the scene's CRS."""
    tiles = [tile for tile in scene.tiles if tile.heights]
    grid = CellGrid.covering(enclosing([tile.bounds for tile in tiles]), cell)
    wkt = pyproj.CRS.from_user_input(scene.crs).to_wkt()
    with created(path, grid.shape, np.dtype(np.float32), 1, grid.geotransform, wkt, unit="m") as raster:
        for tile in tiles:
            window = grid.window(tile.bounds)
            task = FuseTask(scene, tile.bounds, tuple(tile.heights), grid, window, scene.crs, parameters=parameters)
            raster.write(fuse_tile(task).fused.height.astype(np.float32), window.col, window.row)
    return path
