"""What fusion leaves on disk: DSM, confidence and orthophoto as rasters, and the points of the cloud."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, List, Optional, Tuple

import numpy as np
import pyproj

from .. import __version__
from ..arrays import Window
from ..errors import EmptyResultError
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..geometry.frames import geodetic_from_projected
from ..geometry.interpolation import on_lattice
from ..geometry.surface import Surface
from ..geometry.tiles import enclosing
from ..geometry.vertical import TAG, HeightDatum
from ..imagery.dem import load_surface, make_surface
from ..imagery.raster import created
from ..options import DsmFuseOptions
from ..records import FusionFacts
from ..scene import Scene, Tile
from .expected_error import expected_error
from .fusion import StoredTile
from .holes import REACH_CELLS, fill_holes
from .point_cloud import created_cloud
from .seams import blended

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
    windows: List[Window]

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
) -> FusionFacts:
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
            common = window.common(crop)
            if common is None:
                continue
            place, cut = (common.col - crop.col, common.row - crop.row), common.inside(window)
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
    return FusionFacts(
        cells=cells,
        valid=valid + interpolated,
        valid_percent=100.0 * (valid + interpolated) / cells,
        matched=valid - sum(tile.filled for tile in stored),
        background=sum(tile.filled for tile in stored),
        interpolated=interpolated,
        points=points,
        removed=sum(tile.removed for tile in stored),
        resolution=grid.cell,
        crs=crs,
    )


def _fill(
    whole: Any, dsm: Any, confidence: Any, scene: Scene, grid: CellGrid, crs: str, datum: HeightDatum, folder: str
) -> int:
    """Write the DSM from the raster of all tiles' heights, holes filled window by window; gives how many cells were."""
    surface = _terrain_of(scene, grid, crs, folder)
    count = 0
    for own, wide in overlapping_blocks(grid.size, _WINDOW, REACH_CELLS):
        height = whole.read(wide)
        holes = bool(np.isnan(height).any())
        base = _on_cells(surface, grid.part(wide), crs) if surface and holes else None
        height, filled = (values[own.inside(wide)] for values in fill_holes(height, base))
        dsm.write((height - _undulation(datum, crs, grid.part(own))).astype(np.float32), own.col, own.row)
        if confidence is not None and filled.any():
            source = np.where(filled, np.float32(_INTERPOLATED if base is None else _SHAPED), np.nan)
            confidence.write(source.astype(np.float32), own.col, own.row, _SOURCE_BAND, keep=True)
        count += int(filled.sum())
    return count


def _terrain_of(scene: Scene, grid: CellGrid, crs: str, folder: str) -> Optional[Surface]:
    """The DEM that the scene was made with, over the grid; None where there was none."""
    if not scene.dem:
        return None
    xs, ys = grid.centres()
    lon_lat = geodetic_from_projected(crs, np.array([(x, y) for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])]))
    bounds = (*lon_lat.min(axis=0), *lon_lat.max(axis=0))
    return load_surface(make_surface(scene.dem, tuple(map(float, bounds)), grid.cell, f"{folder}/dem.tif"))


def _on_cells(surface: Surface, grid: CellGrid, crs: str) -> np.ndarray:
    """Heights of a surface at the cells' centres; the map to longitude and latitude is smooth, a lattice will do."""
    lon_lat = on_lattice(*grid.centres(), lambda xy: geodetic_from_projected(crs, xy))
    return surface.height(lon_lat[..., 0], lon_lat[..., 1])


def _undulation(datum: HeightDatum, crs: str, grid: CellGrid) -> np.ndarray:
    """(rows, columns) to take off ellipsoidal heights; geoids are smooth, and evaluated on a lattice."""
    if not datum.code or not all(grid.shape):
        return np.zeros(grid.shape)
    return on_lattice(*grid.centres(), lambda xy: datum.undulation(crs, xy))


def _valid_part(grid: CellGrid, windows: List[Window], stored: List[StoredTile]) -> Window:
    """The window of the grid that holds all heights: tiles reach beyond what the images see."""
    ends = [
        (col + tile.columns[0], row + tile.rows[0], col + tile.columns[1], row + tile.rows[1])
        for (col, row, _, _), tile in zip(windows, stored)
        if tile.columns and tile.rows
    ]
    if not ends:
        return Window(0, 0, *grid.size)
    c0, r0, c1, r1 = (choose(end) for choose, end in zip((min, min, max, max), zip(*ends)))
    return Window.spanning(c0, r0, c1 + 1, r1 + 1)


def _put(raster: Any, bands: List[Any], place: Tuple[int, int], cut: Any, keep: bool) -> None:
    if raster is not None:
        for index, values in enumerate(bands, start=1):
            raster.write(values[cut].astype(np.float32), *place, index, keep)
