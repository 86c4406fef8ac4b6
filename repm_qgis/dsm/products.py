"""The products of fusion: DSM, confidence and grey orthophoto as rasters, and the points of the cloud."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Iterator, List, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import ogr

from .. import __version__
from ..arrays import Bounds, FloatArray, FloatImage, Floats, Mask, Window
from ..errors import EmptyResultError
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..geometry.footprints import footprint, seen_twice
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.interpolation import on_lattice
from ..geometry.surface import Surface
from ..geometry.tiles import enclosing
from ..geometry.vertical import TAG, HeightDatum
from ..imagery.confidence import CONFIDENCE_BANDS, SOURCE_BAND
from ..imagery.dem import load_surface, make_surface
from ..imagery.raster import RasterWriter, created
from ..las import is_cloud
from ..options import DsmFuseOptions
from ..records import FusionFacts
from ..scene import Scene, Tile, View
from .brightness import brightness
from .coarse_means import CoarseMeans
from .expected_error import background_error, expected_error
from .feathering import feathered
from .fusion import FusedTile, StoredTile
from .holes import fill_holes
from .painting import opened_paint
from .parameters import FUSION, FusionParameters
from .point_cloud import created_cloud
from .shaded import NOTHING, Sun, shaded_ground, support
from .strays import without_strays
from .widened_roofs import widened_over_shadow

BACKGROUND, INTERPOLATED, _INTERPOLATED_ON_DEM = 1, 2, 3


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


def clouds_of(options: DsmFuseOptions, folder: str) -> List[str]:
    """Where clouds are written; an EPT is made from the last one, which is temporary where the user keeps no LAZ."""
    wanted = [options.cloud] if options.cloud else []
    return wanted + ([f"{folder}/cloud.laz"] if options.ept and not any(map(is_cloud, wanted)) else [])


@dataclass(frozen=True)
class _Products:
    """The open files of the products, None for those that are not written; rasters hold the ``crop`` of the layout.

    ``whole`` has the ellipsoidal heights of all tiles, from which the DSM's are made (they depend on what is around
    them, in other tiles too), and which of them are the background's.
    """

    crop: Window
    dsm: RasterWriter
    confidence: Optional[RasterWriter]
    ortho: Optional[RasterWriter]
    whole: RasterWriter

    @classmethod
    def opened(
        cls, stack: ExitStack, options: DsmFuseOptions, scene: Scene, layout: DsmLayout, crop: Window, folder: str
    ) -> _Products:
        datum, cells, shape = layout.datum, layout.grid.part(crop), (crop.height, crop.width)
        wkt = pyproj.CRS.from_user_input(layout.crs).to_wkt()
        metadata = {"REPM_SCENE": scene.fingerprint, "REPM_ENGINE": __version__, "REPM_METHOD": options.method}
        metadata.update({"REPM_FILL": options.fill, TAG: datum.name})
        kind, place = np.dtype(np.float32), cells.geotransform

        def raster(path: str, names: Tuple[str, ...], unit: str = "", crs: str = wkt, **more: Any) -> RasterWriter:
            frame = shape, kind, len(names), place, crs
            file = created(path, *frame, descriptions=names, metadata=metadata, unit=unit, cog=True, **more)
            return stack.enter_context(file)

        dsm = raster(options.output, (f"height above the {datum.name} (m)",), "m", layout.file_crs)
        confidence = raster(options.confidence, CONFIDENCE_BANDS, overviews="NEAREST") if options.confidence else None
        ortho = raster(options.ortho, ("brightness",)) if options.ortho else None
        whole = stack.enter_context(created(f"{folder}/heights.tif", shape, kind, 2, None, "", compress=False))
        return cls(crop, dsm, confidence, ortho, whole)

    def write_tile(self, tile: FusedTile, error: Floats, height: Floats, window: Window) -> None:
        """Write a tile's cells, with ``height`` as the final one, as far as they lie in the crop."""
        common = window.common(self.crop)
        if common is None:
            return
        fused, (rows, columns) = tile.fused, common.inside(window)
        count = np.where(fused.count > 0, fused.count, np.nan)
        source = np.where(np.isfinite(fused.height), fused.filled, np.nan)

        def put(raster: Optional[RasterWriter], *bands: Optional[Floats]) -> None:
            place = common.within(self.crop)[:2]
            for index, values in enumerate(bands, start=1):
                if raster is not None and values is not None:
                    raster.write(values[rows, columns].astype(np.float32), *place, index, tile.own is not None)

        put(self.whole, height, source)
        put(self.confidence, count, fused.spread, fused.score, source, error)
        put(self.ortho, tile.ortho)

    def mark(self, window: Window, cells: Mask, error: Optional[float]) -> int:
        """Note that cells of a window of the crop took the background's height, with that expected error (m; None: they
        lost their own), and give how many had their own before."""
        matched = cells & (self.whole.read(window, 2) == 0)
        if self.confidence is not None and matched.any():
            facts = (np.nan, np.nan) if error is None else (BACKGROUND, error)
            for band, value in enumerate((np.nan, np.nan, np.nan, *facts), start=1):  # as CONFIDENCE_BANDS
                values = np.where(matched, np.float32(value), self.confidence.read(window, band))
                self.confidence.write(values, window.col, window.row, band)
        return int(matched.sum())


def write_products(
    options: DsmFuseOptions,
    scene: Scene,
    layout: DsmLayout,
    stored: Sequence[StoredTile],
    folder: str,
    views: Sequence[View] = (),
    parameters: FusionParameters = FUSION,
    means: Optional[CoarseMeans] = None,
) -> FusionFacts:
    """Write DSM, confidence and grey orthophoto from the fused tiles; gives what was counted, without a cloud's points.

    ``folder`` is for temporary files. ``views`` show how bright the cells are, the most vertical ones first; without
    them heights are compared with each other alone. ``means`` take up the heights above the ellipsoid, before holes are
    filled.
    Raises EmptyResultError where no cell has a height, WorkspaceError where a file cannot be written.
    """
    valid, cells, filled = (sum(getattr(tile, name) for tile in stored) for name in ("valid", "cells", "filled"))
    if not valid:
        raise EmptyResultError(f"None of {cells} cells of the DSM has a height: check the reconstruction's report.")
    levels: List[float] = []
    with ExitStack() as stack:
        crop = _known_part(layout, stored)
        products = _Products.opened(stack, options, scene, layout, crop, folder)
        shaded = None
        sun = Sun.over(scene, layout.crs, parameters.shaded) if options.fill != "none" else None
        if sun is not None:
            shaded = _shaded(stack, _Tiles(scene, layout, stored, parameters), crop, sun, folder, parameters)
        for tile, window, result, height in _Tiles(scene, layout, stored, parameters):
            if tile.known is not None:
                levels.append(float(np.nanmedian(height)))
            if means is not None:
                means.add(height, window)
            if shaded is not None:
                ground = _own_part(shaded, window, crop, result.own)
                taken = np.isfinite(ground)
                valid += int((taken & np.isnan(result.fused.height)).sum())
                filled += int((taken & ~result.fused.filled).sum())
                result = replace(result, fused=result.fused.with_background(ground))
                height = np.where(taken, ground, height)
            error = expected_error(result.fused, tile.metres_per_px, parameters.error)
            products.write_tile(result, error, height, window)
        metres = [each for tile in stored for each in tile.metres_per_px]
        unsure = None if options.fill == "none" else background_error(metres, parameters.error)
        making = _Heights(products, scene, layout, views, unsure, options.fill == "all", parameters)
        cut_back, interpolated = making.write(folder)
    if unsure is None:
        valid -= cut_back
    else:
        filled += cut_back
    valid, matched, removed = valid + interpolated, valid - filled, sum(tile.removed for tile in stored)
    overlap = overlap_m2(scene, float(np.median(levels)))
    cells = max(round(overlap / layout.grid.cell**2), valid)  # holes are filled beyond it, too
    counts = (cells, valid, 100.0 * valid / cells, matched, filled, interpolated, 0, removed)
    return FusionFacts(*counts, layout.grid.cell, layout.crs)


@dataclass(frozen=True)
class _Tiles:
    """The fused tiles with their heights, feathered into each other; each time they are gone through, they are read."""

    scene: Scene
    layout: DsmLayout
    stored: Sequence[StoredTile]
    parameters: FusionParameters

    def __iter__(self) -> Iterator[Tuple[StoredTile, Window, FusedTile, Floats]]:
        windows, size = self.layout.windows, self.layout.grid.size
        metres = [record.metres_per_px for tile in self.scene.tiles for record in tile.heights]
        numbers = float(np.median(metres)), self.parameters.feather_cells
        for index, (window, tile) in enumerate(zip(windows, self.stored)):
            result = tile.load()
            height = result.fused.height
            # Turned tiles overlap in their windows: there each tile has only its own cells.
            if result.own is None:
                height = feathered(height, index, windows, self.stored, size, *numbers)
            yield tile, window, result, height


def _shaded(
    stack: ExitStack, tiles: _Tiles, crop: Window, sun: Sun, folder: str, parameters: FusionParameters
) -> RasterWriter:
    """A temporary raster of the crop with the ground of cells in shadow that take it: shadows reach across tiles."""
    shape, kind, numbers = (crop.height, crop.width), np.dtype(np.float32), parameters.shaded
    raw, ground = (
        stack.enter_context(created(f"{folder}/{name}.tif", shape, kind, bands, None, "", compress=False))
        for name, bands in (("unshaded", 2), ("shaded", 1))
    )
    for _, window, result, height in tiles:
        common = window.common(crop)
        if common is None:
            continue
        behind = support(result.fused, numbers).astype(np.float32)
        if result.own is not None:
            behind[~result.own] = np.nan
        place = common.within(crop)
        for band, values in enumerate((height, behind), start=1):
            part = values[common.inside(window)].astype(np.float32)
            raw.write(part, place.col, place.row, band, result.own is not None)
    cell = tiles.layout.grid.cell
    for own, wide in overlapping_blocks((crop.width, crop.height), parameters.hole_block_cells, numbers.halo(cell)):
        known = np.nan_to_num(raw.read(wide, 2), nan=NOTHING).astype(np.uint8)  # beyond all tiles
        found = shaded_ground(raw.read(wide), known, cell, sun, numbers)
        ground.write(found[own.inside(wide)], own.col, own.row)
    return ground


def _own_part(raster: RasterWriter, window: Window, crop: Window, own: Optional[Mask]) -> FloatImage:
    """What a raster of the crop has in a tile's window, in the tile's own cells; NaN elsewhere."""
    values = np.full((window.height, window.width), np.nan, np.float32)
    common = window.common(crop)
    if common is not None:
        values[common.inside(window)] = raster.read(common.within(crop))
    return values if own is None else np.where(own, values, np.float32(np.nan))


def write_cloud(
    path: str, layout: DsmLayout, stored: Sequence[StoredTile], ortho: Optional[str] = None, normals: bool = False
) -> int:
    """Write the points of the fused tiles, with the colours of the orthophoto ``ortho`` if there is one, and with
    ``normals`` where the tiles have them; gives their number. Raises WorkspaceError where the file cannot be written.
    """
    origin, heights = (layout.grid.west, layout.grid.north, 0.0), layout.datum.name
    with ExitStack() as stack:
        paint = stack.enter_context(opened_paint(ortho)) if ortho else None
        cloud = stack.enter_context(created_cloud(path, layout.file_crs, origin, paint is not None, normals, heights))
        for tile in stored:
            points = tile.points()
            if points is not None and len(points):
                x, y, z, score = points[:, :4].T
                below = layout.datum.undulation(layout.crs, np.column_stack([x, y]))
                colours = paint.points(x, y) if paint else None
                cloud.write(x, y, z - below, score, colours, points[:, 4:] if normals else None)
        return cloud.count


def overlap_m2(scene: Scene, level: float) -> float:
    """The ground that two images see at a level, metres above the ellipsoid, within the area that is processed.

    The scene's own area is larger: it is what they see at any altitude that was thought possible.
    """
    outlines = [projected_from_geodetic(scene.crs, footprint(v.localise, v.size, level)) for v in scene.views]
    seen: ogr.Geometry = seen_twice([outlines]).Intersection(ogr.CreateGeometryFromWkt(scene.area))
    return float(seen.GetArea())


@dataclass(frozen=True)
class _Heights:
    """The DSM from the raster of all tiles' heights: without what does not fit the images, and with its holes filled
    where ``fill`` says so.

    ``views`` show how bright cells are, the most vertical ones first. What roofs are cut back to has the expected
    ``error`` (m); with None it becomes a hole.
    """

    products: _Products
    scene: Scene
    layout: DsmLayout
    views: Sequence[View]
    error: Optional[float]
    fill: bool
    parameters: FusionParameters

    def write(self, folder: str) -> Tuple[int, int]:
        """Write all blocks; gives how many cells roofs were cut back by, and how many were interpolated."""
        grid, p = self.layout.grid.part(self.products.crop), self.parameters
        surface = _terrain_of(self.scene, grid, self.layout.crs, folder) if self.fill else None
        halo = 2 * p.strays.reach(grid.cell) + p.widened.halo(grid.cell) + (p.holes.reach_cells if self.fill else 0)
        cut_back, interpolated = 0, 0
        for own, wide in overlapping_blocks(grid.size, p.hole_block_cells, halo):
            part, inner = grid.part(wide), own.inside(wide)
            height, ground = self._fitting(self.products.whole.read(wide), part)
            cut_back += self.products.mark(own, np.isfinite(ground[inner]), self.error)
            if self.fill:
                base = None
                if surface is not None and np.isnan(height).any():
                    base = _on_cells(surface, part, self.layout.crs)
                height, filled = fill_holes(height, base, p.holes)
                interpolated += self._mark_interpolated(own, filled[inner], base is not None)
            height = height[inner] - self.layout.undulation(grid.part(own))
            self.products.dsm.write(height.astype(np.float32), own.col, own.row)
        return cut_back, interpolated

    def _fitting(self, height: Floats, grid: CellGrid) -> Tuple[Floats, FloatImage]:
        """The heights of a part of the grid that fit the images, and the ground where roofs were cut back."""
        p, cell = self.parameters, grid.cell
        light = brightness(self.views, grid, height, self.layout.crs, p)
        height = without_strays(height, light, cell, p.strays)
        ground = widened_over_shadow(height, light, cell, p)
        taken = np.isfinite(ground)
        # What is left of a roof over the shadow strays now.
        height = without_strays(np.where(taken, ground, height), light, cell, p.strays)
        return (np.where(taken, np.nan, height) if self.error is None else height), ground

    def _mark_interpolated(self, window: Window, cells: Mask, on_dem: bool) -> int:
        if self.products.confidence is not None and cells.any():
            source = np.where(cells, np.float32(_INTERPOLATED_ON_DEM if on_dem else INTERPOLATED), np.float32(np.nan))
            self.products.confidence.write(source, window.col, window.row, SOURCE_BAND, keep=True)
        return int(cells.sum())


def _terrain_of(scene: Scene, grid: CellGrid, crs: str, folder: str) -> Optional[Surface]:
    """The DEM that the scene was made with, over the grid; None where there was none."""
    if not scene.dem:
        return None
    xs, ys = grid.centres()
    lon_lat = geodetic_from_projected(crs, np.array([(x, y) for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])]))
    bounds = Bounds(*map(float, (*lon_lat.min(axis=0), *lon_lat.max(axis=0))))
    return load_surface(make_surface(scene.dem, bounds, grid.cell, f"{folder}/dem.tif"))


def _on_cells(surface: Surface, grid: CellGrid, crs: str) -> FloatArray:
    """Heights of a surface at the cells' centres."""
    lon_lat = on_lattice(*grid.centres(), lambda xy: geodetic_from_projected(crs, xy))
    return surface.height(lon_lat[..., 0], lon_lat[..., 1])


def _known_part(layout: DsmLayout, stored: Sequence[StoredTile]) -> Window:
    """The window of the grid that holds all heights: tiles extend beyond the area that the images see."""
    ends: List[Tuple[int, int, int, int]] = []
    for window, tile in zip(layout.windows, stored):
        if tile.known is not None:
            col, row = window.col + tile.known.col, window.row + tile.known.row
            ends.append((col, row, col + tile.known.width, row + tile.known.height))
    first_cols, first_rows, end_cols, end_rows = zip(*ends)
    return Window.spanning(min(first_cols), min(first_rows), max(end_cols), max(end_rows))
