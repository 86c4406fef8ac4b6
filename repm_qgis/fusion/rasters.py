"""The rasters of fusion: DSM and confidence."""

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
from ..geometry.vertical import TAG
from ..imagery.confidence import CONFIDENCE_BANDS, SOURCE_BAND
from ..imagery.dem import load_surface, make_surface
from ..imagery.raster import RasterWriter, created, opened, read
from ..options import DsmFuseOptions
from ..records import FusionFacts
from ..scene import Scene
from .coarse_means import CoarseMeans
from .expected_error import background_error, expected_error
from .feathering import feathered
from .fitting import FittedBlock
from .holes import fill_holes
from .layout import DsmLayout
from .parameters import FUSION, FusionParameters
from .shaded import NOTHING, WEAK, Sun, shaded_ground, support
from .tile_fusion import FusedTile, StoredTile

BACKGROUND, INTERPOLATED, _INTERPOLATED_ON_DEM = 1, 2, 3
_SUPPORT, _FILLED = 2, 3  # bands of the raster of joined tiles, after the heights


@dataclass(frozen=True)
class _Products:
    """The open files of the products, None for those that are not written; rasters hold the ``crop`` of the layout.

    ``whole`` has the ellipsoidal heights where holes are filled: that needs heights of several blocks.
    """

    crop: Window
    dsm: RasterWriter
    confidence: Optional[RasterWriter]
    whole: Optional[RasterWriter]

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
        whole = None
        if options.fill == "all":
            heights = created(f"{folder}/heights.tif", shape, kind, 1, None, "", compress=False)
            whole = stack.enter_context(heights)
        return cls(crop, dsm, confidence, whole)

    def write_tile(self, tile: FusedTile, error: Floats, window: Window) -> None:
        """Write the facts of a tile's cells, as far as they lie in the crop."""
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

        put(self.confidence, count, fused.spread, fused.score, source, error)

    def mark(self, window: Window, cells: Mask, error: Optional[float]) -> None:
        """Note that cells of a window of the crop took the background's height, with that expected error (m; None: they
        lost their own)."""
        if self.confidence is None or not cells.any():
            return
        facts = (np.nan, np.nan) if error is None else (BACKGROUND, error)
        for band, value in enumerate((np.nan, np.nan, np.nan, *facts), start=1):  # as CONFIDENCE_BANDS
            values = np.where(cells, np.float32(value), self.confidence.read(window, band))
            self.confidence.write(values, window.col, window.row, band)


@dataclass(frozen=True)
class JoinedTiles:
    """The heights of all tiles on the ``crop`` of the layout, feathered into each other: temporary rasters, that of the
    ground in shadows only where the sun is known."""

    crop: Window
    path: str
    shaded: str = ""

    def heights(self, window: Window) -> FloatImage:
        """(H, W) heights of a window of the crop, m above the ellipsoid, with the ground in shadows; NaN = none."""
        ground = self.ground(window)
        return np.where(np.isfinite(ground), ground, self._read(self.path, window, 1))

    def matched(self, window: Window) -> Mask:
        """(H, W) the cells of a window that have a height of their own, not the background's."""
        return self._kept(window, _FILLED, 0)

    def weak(self, window: Window) -> Mask:
        """(H, W) the cells of a window whose height is a single map's, which the images hardly support."""
        return self._kept(window, _SUPPORT, WEAK)

    def ground(self, window: Window) -> FloatImage:
        """(H, W) the ground in shadows, for the cells of a window that take it; NaN for others."""
        if not self.shaded:
            return np.full((window.height, window.width), np.nan, np.float32)
        return self._read(self.shaded, window, 1)

    def _kept(self, window: Window, band: int, value: int) -> Mask:
        """(H, W) the cells whose band has that value, and whose height no ground in shadows has replaced."""
        kept: Mask = (self._read(self.path, window, band) == value) & np.isnan(self.ground(window))
        return kept

    @staticmethod
    def _read(path: str, window: Window, band: int) -> FloatImage:
        with opened(path) as dataset:
            return read(dataset, window, band)


def join_tiles(
    options: DsmFuseOptions,
    scene: Scene,
    layout: DsmLayout,
    stored: Sequence[StoredTile],
    folder: str,
    parameters: FusionParameters = FUSION,
) -> JoinedTiles:
    """Write the heights of all tiles into one raster, and the ground of shadows, in ``folder``.

    Raises EmptyResultError where no cell has a height, WorkspaceError where a file cannot be written.
    """
    if not any(tile.valid for tile in stored):
        cells = sum(tile.cells for tile in stored)
        raise EmptyResultError(f"None of {cells} cells of the DSM has a height: check the reconstruction's report.")
    crop, path, shaded = _known_part(layout, stored), f"{folder}/joined.tif", f"{folder}/shaded.tif"
    frame = (crop.height, crop.width), np.dtype(np.float32)
    with created(path, *frame, 3, None, "", compress=False) as raster:
        for _, window, result, height in _Tiles(scene, layout, stored, parameters):
            common = window.common(crop)
            if common is None:
                continue
            behind = support(result.fused, parameters.shaded).astype(np.float32)
            filled = np.where(np.isfinite(result.fused.height), result.fused.filled, np.float32(np.nan))
            if result.own is not None:
                behind[~result.own] = np.nan
            place = common.within(crop)
            for band, values in ((1, height), (_SUPPORT, behind), (_FILLED, filled)):
                part = values[common.inside(window)].astype(np.float32)
                raster.write(part, place.col, place.row, band, result.own is not None)
    joined = JoinedTiles(crop, path)
    sun = Sun.over(scene, layout.crs, parameters.shaded) if options.fill != "none" else None
    if sun is None:
        return joined
    with created(shaded, *frame, 1, None, "", compress=False) as raster, opened(path) as dataset:
        cell, numbers = layout.grid.cell, parameters.shaded
        for own, wide in overlapping_blocks((crop.width, crop.height), parameters.hole_block_cells, numbers.halo(cell)):
            known = np.nan_to_num(read(dataset, wide, _SUPPORT), nan=NOTHING).astype(np.uint8)  # beyond all tiles
            found = shaded_ground(read(dataset, wide, 1), known, cell, sun, numbers)
            raster.write(found[own.inside(wide)], own.col, own.row)
    return replace(joined, shaded=shaded)


def write_products(
    options: DsmFuseOptions,
    scene: Scene,
    layout: DsmLayout,
    stored: Sequence[StoredTile],
    joined: JoinedTiles,
    blocks: Sequence[FittedBlock],
    folder: str,
    parameters: FusionParameters = FUSION,
    means: Optional[CoarseMeans] = None,
) -> FusionFacts:
    """Write DSM and confidence; gives what was counted, without a cloud's points.

    ``blocks`` have the DSM's heights, ``joined`` and the fused tiles the facts about them. ``folder`` is for temporary
    files. ``means`` take up the heights above the ellipsoid, before holes are filled. Raises WorkspaceError where a
    file cannot be written.
    """
    valid, filled = (sum(getattr(tile, name) for tile in stored) for name in ("valid", "filled"))
    levels: List[float] = []
    crop, grid = joined.crop, layout.grid.part(joined.crop)
    metres = [each for tile in stored for each in tile.metres_per_px]
    unsure = None if options.fill == "none" else background_error(metres, parameters.error)
    with ExitStack() as stack:
        products = _Products.opened(stack, options, scene, layout, crop, folder)
        for tile, window, result, height in _Tiles(scene, layout, stored, parameters):
            if tile.known is not None:
                levels.append(float(np.nanmedian(height)))
            if means is not None:
                means.add(height, window)
            if joined.shaded:
                ground = _own_part(joined, window, result.own)
                taken = np.isfinite(ground)
                valid += int((taken & np.isnan(result.fused.height)).sum())
                filled += int((taken & ~result.fused.filled).sum())
                result = replace(result, fused=result.fused.with_background(ground))
            error = expected_error(result.fused, tile.metres_per_px, parameters.error)
            products.write_tile(result, error, window)
        for block in blocks:
            height, ground = block.load()
            cut_back = np.isfinite(ground) & joined.matched(block.own)
            products.mark(block.own, cut_back, unsure)
            filled += 0 if unsure is None else int(cut_back.sum())
            valid -= int(np.isfinite(ground).sum()) if unsure is None else 0
            height = np.where(np.isfinite(ground) & (unsure is None), np.nan, height)
            if products.whole is None:
                height = height - layout.undulation(grid.part(block.own))
            target = products.whole or products.dsm
            target.write(height.astype(np.float32), block.own.col, block.own.row)
        interpolated = 0
        if products.whole is not None:
            interpolated = _write_filled(products, products.whole, scene, layout, folder, parameters)
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


def _own_part(joined: JoinedTiles, window: Window, own: Optional[Mask]) -> FloatImage:
    """The ground in shadows in a tile's window, in the tile's own cells; NaN elsewhere."""
    values = np.full((window.height, window.width), np.nan, np.float32)
    common = window.common(joined.crop)
    if common is not None:
        values[common.inside(window)] = joined.ground(common.within(joined.crop))
    return values if own is None else np.where(own, values, np.float32(np.nan))


def overlap_m2(scene: Scene, level: float) -> float:
    """The ground that two images see at a level, metres above the ellipsoid, within the area that is processed.

    The scene's own area is larger: it is what they see at any altitude that was thought possible.
    """
    outlines = [projected_from_geodetic(scene.crs, footprint(v.localise, v.size, level)) for v in scene.views]
    seen: ogr.Geometry = seen_twice([outlines]).Intersection(ogr.CreateGeometryFromWkt(scene.area))
    return float(seen.GetArea())


def _write_filled(
    products: _Products, whole: RasterWriter, scene: Scene, layout: DsmLayout, folder: str, parameters: FusionParameters
) -> int:
    """Write the DSM from the raster of all heights, with its holes filled; gives how many cells were filled."""
    grid = layout.grid.part(products.crop)
    surface = _terrain_of(scene, grid, layout.crs, folder)
    count = 0
    for own, wide in overlapping_blocks(grid.size, parameters.hole_block_cells, parameters.holes.reach_cells):
        heights = whole.read(wide)
        base = None
        if surface is not None and np.isnan(heights).any():
            base = _on_cells(surface, grid.part(wide), layout.crs)
        height, filled = (values[own.inside(wide)] for values in fill_holes(heights, base, parameters.holes))
        products.dsm.write((height - layout.undulation(grid.part(own))).astype(np.float32), own.col, own.row)
        if products.confidence is not None and filled.any():
            source = np.where(filled, np.float32(INTERPOLATED if base is None else _INTERPOLATED_ON_DEM), np.nan)
            products.confidence.write(source.astype(np.float32), own.col, own.row, SOURCE_BAND, keep=True)
        count += int(filled.sum())
    return count


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
