"""A coarse surface from the heights that a scene already has: terrain feedback."""

from __future__ import annotations

from typing import Tuple

import numpy as np
import pyproj

from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..geometry.tiles import enclosing
from ..imagery.raster import created
from ..scene import Scene
from ..stereo.pairing import grown
from .fusion import FuseTask, fuse_tile


def lon_lat_bounds(scene: Scene, margin_m: float = 300.0) -> Tuple[float, float, float, float]:
    """West, south, east, north of a scene's tiles with a margin, in degrees."""
    xmin, ymin, xmax, ymax = grown(enclosing([tile.bounds for tile in scene.tiles]), margin_m)
    corners = geodetic_from_projected(scene.crs, np.array([[xmin, ymin], [xmin, ymax], [xmax, ymin], [xmax, ymax]]))
    return (
        float(corners[:, 0].min()),
        float(corners[:, 1].min()),
        float(corners[:, 0].max()),
        float(corners[:, 1].max()),
    )


def own_surface(scene: Scene, cell: float, path: str) -> str:
    """Fuse a scene's height maps into coarse cells of ``cell`` metres, as a GeoTIFF in the scene's CRS."""
    tiles = [tile for tile in scene.tiles if tile.heights]
    grid = CellGrid.covering(enclosing([tile.bounds for tile in tiles]), cell)
    with created(
        path,
        grid.shape,
        np.dtype(np.float32),
        1,
        grid.geotransform,
        pyproj.CRS.from_user_input(scene.crs).to_wkt(),
        unit="m",
    ) as raster:
        for tile in tiles:
            window = grid.window(tile.bounds)
            fused = fuse_tile(
                FuseTask(
                    scene,
                    tile.bounds,
                    tile.heights,
                    grid,
                    window,
                    scene.crs,
                    "median",
                    "occlusions",
                    0.0,
                    (),
                    False,
                )
            ).fused
            raster.write(fused.height.astype(np.float32), window[0], window[1])
    return path
