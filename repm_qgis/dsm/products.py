"""What fusion leaves on disk: DSM, confidence and orthophoto as rasters, and the points of the cloud."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import pyproj

from .. import __version__
from ..errors import EmptyResultError
from ..geometry.frames import geodetic_from_projected
from ..geometry.surface import Surface
from ..geometry.tiles import enclosing
from ..geometry.vertical import TAG, HeightDatum
from ..imagery.dem import load_surface, make_surface
from ..imagery.raster import created
from ..imagery.sampling import upsample_grid
from ..options import DsmFuseOptions
from ..scene import Scene, Tile
from .expected_error import expected_error
from .fusion import StoredTile
from .grid import CellGrid
from .holes import REACH_CELLS, fill_holes
from .point_cloud import created_cloud
from .seams import blended

_LATTICE = 17  # nodes a side of what is smooth: the undulation, the map to longitude and latitude
CONFIDENCE_BANDS = (
    "height maps that agree",
    "spread between them (m)",
    "mean matching score",
    "source: 0 matched, 1 background of an occlusion, 2 interpolated, 3 interpolated on the DEM",
    "expected error (m): two thirds are within",
)
_SOURCE_BAND = 4
_INTERPOLATED, _SHAPED = 2, 3
_WINDOW = 1024  # cells a side that are filled at once


@dataclass(frozen=True)
class Layout:
    """The DSM's cells, its projected CRS, and the window of each tile (column, row, width, height)."""

    grid: CellGrid
    crs: str
    windows: List[Tuple[int, int, int, int]]

    @classmethod
    def of(cls, scene: Scene, tiles: List[Tile], crs: str, cell: float) -> Layout:
        """In the scene's CRS every cell belongs to one tile; in others tiles are turned and windows overlap."""
        transformer = None if crs == scene.crs else pyproj.Transformer.from_crs(scene.crs, crs, always_xy=True)
        boxes = [tile.bounds if transformer is None else transformer.transform_bounds(*tile.bounds) for tile in tiles]
        grid = CellGrid.covering(enclosing(boxes), cell)
        return cls(grid, crs, [grid.window(box) for box in boxes])


def cloud_of(options: DsmFuseOptions, folder: str) -> Optional[str]:
    """Where the cloud is written: an EPT is made of one that nobody asked to keep, too."""
    return options.cloud or (f"{folder}/cloud.laz" if options.ept else None)


def write_products(
    options: DsmFuseOptions, scene: Scene, layout: Layout, datum: HeightDatum, stored: List[StoredTile], folder: str
) -> Dict[str, Any]:
    """Write DSM, confidence, orthophoto and cloud from the fused tiles; gives what was counted on the way.

    ``folder`` is for what lives only meanwhile. Raises EmptyResultError where no cell has a height, WorkspaceError
    where a file cannot be written.
    """
    grid, crs, windows = layout.grid, layout.crs, layout.windows
    wkt = pyproj.CRS.from_user_input(crs).to_wkt()
    metadata = {
        "REPM_SCENE": scene.fingerprint,
        "REPM_ENGINE": __version__,
        "REPM_METHOD": options.method,
        "REPM_FILL": options.fill,
        TAG: datum.name,
    }
    crop = _valid_part(grid, windows, stored)
    valid, cells = sum(tile.valid for tile in stored), sum(tile.cells for tile in stored)
    if not valid:
        raise EmptyResultError(f"None of {cells} cells of the DSM has a height: check the reconstruction's report.")
    with ExitStack() as stack:

        def raster(path: Optional[str], bands: Tuple[str, ...], unit: str, file_crs: str = wkt) -> Any:
            if not path:
                return None
            return stack.enter_context(
                created(
                    path,
                    (crop[3], crop[2]),
                    np.dtype(np.float32),
                    len(bands),
                    grid.part(crop).geotransform,
                    file_crs,
                    descriptions=bands,
                    metadata=metadata,
                    unit=unit,
                    cog=True,
                )
            )

        dsm = raster(options.output, (f"height above the {datum.name} (m)",), "m", datum.file_crs(crs))
        confidence = raster(options.confidence, CONFIDENCE_BANDS, "")
        ortho = raster(options.ortho, ("brightness",), "")
        # What is interpolated needs the heights of neighbouring tiles: they meet in a raster of their own first.
        whole = (
            stack.enter_context(
                created(f"{folder}/heights.tif", (crop[3], crop[2]), np.dtype(np.float32), 1, None, "", compress=False)
            )
            if options.fill == "all"
            else None
        )
        cloud_path = cloud_of(options, folder)
        cloud = (
            stack.enter_context(created_cloud(cloud_path, datum.file_crs(crs), (grid.west, grid.north, 0.0)))
            if cloud_path
            else None
        )
        tolerance = float(np.median([record.metres_per_px for tile in scene.tiles for record in tile.heights]))
        for index, (window, tile) in enumerate(zip(windows, stored)):
            place, cut = _placed(window, crop)
            if place is None:
                continue
            result = tile.load()
            fused = result.fused
            keep = result.own is not None
            # Turned tiles overlap in their windows: there each keeps to its own cells.
            height = fused.height if keep else blended(fused.height, index, windows, stored, grid.shape, tolerance)
            if whole is None:
                height = height - _undulation(datum, crs, grid.part(window))
            _put(dsm if whole is None else whole, [height], place, cut, keep)
            count = np.where(fused.count > 0, fused.count, np.nan)
            source = np.where(np.isfinite(fused.height), fused.filled, np.nan)
            error = expected_error(fused, tile.metres_per_px)
            _put(confidence, [count, fused.spread, fused.score, source, error], place, cut, keep)
            _put(ortho, [result.ortho], place, cut, keep)
            if cloud is not None:
                x, y, height, score = result.points.T
                cloud.write(x, y, height - datum.undulation(crs, np.column_stack([x, y])), score)
        points = cloud.count if cloud is not None else 0
        interpolated = 0 if whole is None else _fill(whole, dsm, confidence, scene, grid.part(crop), crs, datum, folder)
    return {
        "cells": cells,
        "valid": valid + interpolated,
        "valid_percent": 100.0 * (valid + interpolated) / cells,
        "matched": valid - sum(tile.filled for tile in stored),
        "background": sum(tile.filled for tile in stored),
        "interpolated": interpolated,
        "points": points,
        "removed": sum(tile.removed for tile in stored),
        "resolution": grid.cell,
        "crs": crs,
    }


def _fill(
    whole: Any, dsm: Any, confidence: Any, scene: Scene, grid: CellGrid, crs: str, datum: HeightDatum, folder: str
) -> int:
    """Write the DSM from the raster of all tiles' heights, holes filled window by window; gives how many cells were."""
    surface = _terrain_of(scene, grid, crs, folder)
    count = 0
    for row in range(0, grid.shape[0], _WINDOW):
        for col in range(0, grid.shape[1], _WINDOW):
            c0, r0 = max(col - REACH_CELLS, 0), max(row - REACH_CELLS, 0)
            c1, r1 = (min(start + _WINDOW + REACH_CELLS, size) for start, size in zip((col, row), grid.shape[::-1]))
            height = whole.read((c0, r0, c1 - c0, r1 - r0))
            holes = bool(np.isnan(height).any())
            base = _on_cells(surface, grid.part((c0, r0, c1 - c0, r1 - r0)), crs) if surface and holes else None
            height, filled = fill_holes(height, base)
            own = np.s_[row - r0 : row - r0 + _WINDOW, col - c0 : col - c0 + _WINDOW]
            cells = grid.part((col, row, *height[own].shape[::-1]))
            dsm.write((height[own] - _undulation(datum, crs, cells)).astype(np.float32), col, row)
            if confidence is not None and filled[own].any():
                source = np.where(filled[own], np.float32(_INTERPOLATED if base is None else _SHAPED), np.nan)
                confidence.write(source.astype(np.float32), col, row, _SOURCE_BAND, keep=True)
            count += int(filled[own].sum())
    return count


def _terrain_of(scene: Scene, grid: CellGrid, crs: str, folder: str) -> Optional[Surface]:
    """The DEM that the scene was made with, over the grid; None where there was none."""
    dem = scene.facts("epmfit").get("options", {}).get("dem")
    if not dem:
        return None
    xs, ys = grid.centres()
    lon_lat = geodetic_from_projected(crs, np.array([(x, y) for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])]))
    bounds = (*lon_lat.min(axis=0), *lon_lat.max(axis=0))
    return load_surface(make_surface(str(dem), tuple(map(float, bounds)), grid.cell, f"{folder}/dem.tif"))


def _on_cells(surface: Surface, grid: CellGrid, crs: str) -> np.ndarray:
    """Heights of a surface at the cells' centres; the map to longitude and latitude is smooth, a lattice will do."""
    xs, ys = grid.centres()
    lattice = np.stack(np.meshgrid(np.linspace(xs[0], xs[-1], _LATTICE), np.linspace(ys[0], ys[-1], _LATTICE)), axis=-1)
    lon_lat = upsample_grid(geodetic_from_projected(crs, lattice), grid.shape)
    return surface.height(lon_lat[..., 0], lon_lat[..., 1])


def _undulation(datum: HeightDatum, crs: str, grid: CellGrid) -> np.ndarray:
    """(rows, columns) to take off ellipsoidal heights; geoids are smooth, and evaluated on a lattice."""
    xs, ys = grid.centres()
    if not datum.code or not len(xs) or not len(ys):
        return np.zeros(grid.shape)
    nodes = np.meshgrid(np.linspace(xs[0], xs[-1], _LATTICE), np.linspace(ys[0], ys[-1], _LATTICE))
    return upsample_grid(datum.undulation(crs, np.stack(nodes, axis=-1)), grid.shape)


def _valid_part(
    grid: CellGrid, windows: List[Tuple[int, int, int, int]], stored: List[StoredTile]
) -> Tuple[int, int, int, int]:
    """The window of the grid that holds all heights: tiles reach beyond what the images see."""
    ends = [
        (col + tile.columns[0], row + tile.rows[0], col + tile.columns[1], row + tile.rows[1])
        for (col, row, _, _), tile in zip(windows, stored)
        if tile.columns and tile.rows
    ]
    if not ends:
        return 0, 0, grid.shape[1], grid.shape[0]
    c0, r0 = min(end[0] for end in ends), min(end[1] for end in ends)
    return c0, r0, max(end[2] for end in ends) - c0 + 1, max(end[3] for end in ends) - r0 + 1


def _placed(window: Tuple[int, int, int, int], crop: Tuple[int, int, int, int]) -> Tuple[Any, Any]:
    """Where a tile's cells go in the cropped raster, and which of them."""
    c0, r0 = max(window[0], crop[0]), max(window[1], crop[1])
    c1, r1 = min(window[0] + window[2], crop[0] + crop[2]), min(window[1] + window[3], crop[1] + crop[3])
    if c0 >= c1 or r0 >= r1:
        return None, None
    cut = (slice(r0 - window[1], r1 - window[1]), slice(c0 - window[0], c1 - window[0]))
    return (c0 - crop[0], r0 - crop[1]), cut


def _put(raster: Any, bands: List[Any], place: Tuple[int, int], cut: Any, keep: bool) -> None:
    if raster is not None:
        for index, values in enumerate(bands, start=1):
            raster.write(values[cut].astype(np.float32), *place, index, keep)
