"""The rasters of fusion: DSM and confidence."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Optional, Sequence, Tuple

import numpy as np
import pyproj
from numpy.typing import DTypeLike
from osgeo import ogr

from .. import __version__
from ..contracts.arrays import Bounds, FloatArray, FloatImage, Window
from ..contracts.errors import EmptyResultError
from ..contracts.options import DsmFuseOptions
from ..contracts.records import FusionFacts
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..geometry.footprints import footprint, seen_twice
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.interpolation import on_lattice
from ..geometry.surface import Surface
from ..geometry.vertical import DEVIATION_TAG, PLACED_TAG, TAG
from ..imagery.confidence import CONFIDENCE_BANDS, SOURCE_BAND, Provenance
from ..imagery.dem import load_surface, make_surface
from ..imagery.raster import RasterFrame, RasterWriter, created
from ..names import DAYS
from ..scene import Scene
from .coarse_means import CoarseMeans
from .holes import fill_holes
from .joining import JoinedTiles
from .layout import DsmLayout
from .parameters import FUSION, FusionParameters
from .provenance import SurfaceCells
from .surface import Block
from .water import Water, flattened

_NO_MASK = 255


@dataclass(frozen=True)
class _Products:
    """The open files of the products, None for those that are not written; rasters hold the ``crop`` of the layout.

    ``whole`` has the ellipsoidal heights where holes are filled: that needs heights of several blocks.
    """

    crop: Window
    dsm: RasterWriter
    confidence: Optional[RasterWriter]
    water: Optional[RasterWriter]
    whole: Optional[RasterWriter]

    @classmethod
    def opened(
        cls,
        stack: ExitStack,
        options: DsmFuseOptions,
        scene: Scene,
        layout: DsmLayout,
        crop: Window,
        folder: str,
        deviation_m: Optional[float],
        evidence: str = "",
    ) -> _Products:
        datum, cells, shape = layout.datum, layout.grid.part(crop), (crop.height, crop.width)
        wkt = pyproj.CRS.from_user_input(layout.crs).to_wkt()
        metadata = {"REPM_SCENE": scene.fingerprint, "REPM_ENGINE": __version__, "REPM_METHOD": options.method}
        metadata.update({"REPM_FILL": options.fill, TAG: datum.name})
        if deviation_m is not None:
            metadata[DEVIATION_TAG] = f"{deviation_m:.3f}"
        if scene.placed:
            metadata[PLACED_TAG] = scene.placed
        if evidence:
            metadata["REPM_WATER"] = evidence
        if days := scene.days():
            metadata[DAYS] = " ".join(days)

        def raster(
            path: str, names: Tuple[str, ...], kind: DTypeLike = np.float32, crs: str = wkt, **more: Any
        ) -> RasterWriter:
            frame = RasterFrame(shape, kind, len(names), cells.geotransform, crs)
            file = created(path, frame, descriptions=names, metadata=metadata, cog=True, **more)
            return stack.enter_context(file)

        dsm = raster(options.output, (f"height above the {datum.name} (m)",), crs=layout.file_crs, unit="m")
        confidence = raster(options.confidence, CONFIDENCE_BANDS, overviews="NEAREST") if options.confidence else None
        water = None
        if options.water_mask:
            names = ("water: 0 land, 1 water",)
            water = raster(options.water_mask, names, np.uint8, nodata=_NO_MASK, overviews="NEAREST")
        whole = None
        if options.fill == "all":
            heights = created(f"{folder}/heights.tif", RasterFrame(shape, np.float32), compress=False)
            whole = stack.enter_context(heights)
        return cls(crop, dsm, confidence, water, whole)

    def write_block(self, surface: SurfaceCells, own: Window, level: Optional[FloatImage]) -> None:
        """Write the facts of a block's own cells; ``level`` is that of water, NaN on land, infinite if unknown."""
        if self.water is not None and level is not None:
            land = np.where(np.isfinite(surface.height), 0, _NO_MASK)
            self.water.write(np.where(np.isnan(level), land, 1).astype(np.uint8), own.col, own.row)
        if self.confidence is not None:
            for band, values in enumerate(surface.facts(), start=1):
                self.confidence.write(values, own.col, own.row, band)


def write_products(
    options: DsmFuseOptions,
    scene: Scene,
    layout: DsmLayout,
    *,
    joined: JoinedTiles,
    blocks: Sequence[Block],
    folder: str,
    parameters: FusionParameters = FUSION,
    means: Optional[CoarseMeans] = None,
    deviation_m: Optional[float] = None,
    water: Optional[Water] = None,
) -> FusionFacts:
    """Write DSM, confidence and water from the surface's ``blocks``; gives what was counted, without a cloud's points.

    ``folder`` is for temporary files. ``means`` sum the heights above the ellipsoid, before holes are filled.
    ``deviation_m`` is the standard deviation of the absolute height, m, which the rasters state.
    Raises WorkspaceError where a file cannot be written, SceneError where an image was replaced amid the work.
    """
    crop, grid = joined.crop, layout.grid.part(joined.crop)
    valid, matched, levels = 0, 0, []
    with ExitStack() as stack:
        evidence = water.evidence if water else ""
        products = _Products.opened(stack, options, scene, layout, crop, folder, deviation_m, evidence)
        for block in blocks:
            surface, own = block.surface(), block.own
            level = water.within(own) if water else None
            if level is not None and options.water == "flatten":
                surface = flattened(surface, level)
            known = np.isfinite(surface.height)
            if known.any():
                levels.append(float(np.median(surface.height[known])))
            valid += int(known.sum())
            matched += int((surface.source == Provenance.MATCHED).sum())
            if means is not None:
                place = Window(own.col + crop.col, own.row + crop.row, own.width, own.height)
                means.add(surface.height.astype(np.float64), place)
            products.write_block(surface, own, level)
            height = surface.height
            if products.whole is None:
                height = height - layout.undulation(grid.part(own))
            target = products.whole or products.dsm
            target.write(height.astype(np.float32), own.col, own.row)
        interpolated = 0
        if products.whole is not None:
            interpolated = _write_filled(products, products.whole, scene, layout, folder, parameters)
        scene.require_same_images()  # before the products get their names: the intensities came from these pixels
    if not levels:
        raise EmptyResultError(f"No cell of the DSM has a matched height (cells: {grid.shape[0] * grid.shape[1]}).")
    filled, valid = valid - matched, valid + interpolated
    overlap = overlap_m2(scene, float(np.median(levels)))
    cells = max(round(overlap / layout.grid.cell**2), valid)  # holes are filled beyond it, too
    return FusionFacts(
        cells=cells,
        valid=valid,
        valid_percent=100.0 * valid / cells,
        matched=matched,
        background=filled,
        interpolated=interpolated,
        points=0,
        removed=joined.removed,
        resolution=layout.grid.cell,
        crs=layout.crs,
    )


def overlap_m2(scene: Scene, level: float) -> float:
    """The ground that two images see at a level, metres above the ellipsoid, within the area that is processed.

    The scene's own area is larger: it is what they see at any altitude of the range.
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
            kind = Provenance.INTERPOLATED if base is None else Provenance.INTERPOLATED_ON_DEM
            source = np.where(filled, np.float32(kind), np.nan)
            products.confidence.write(source.astype(np.float32), own.col, own.row, SOURCE_BAND, keep=True)
        count += int(filled.sum())
    return count


def _terrain_of(scene: Scene, grid: CellGrid, crs: str, folder: str) -> Optional[Surface]:
    """The DEM that the scene was made with, over the grid; None where there was none."""
    if not scene.dem:
        return None
    xs, ys = grid.centres()
    lon_lat = geodetic_from_projected(crs, np.array([(x, y) for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])]))
    bounds = Bounds.between(lon_lat.min(axis=0), lon_lat.max(axis=0))
    return load_surface(make_surface(scene.dem, bounds, grid.cell, f"{folder}/dem.tif"))


def _on_cells(surface: Surface, grid: CellGrid, crs: str) -> FloatArray:
    """Heights of a surface at the cells' centres."""
    lon_lat = on_lattice(*grid.centres(), lambda xy: geodetic_from_projected(crs, xy))
    return surface.height(lon_lat[..., 0], lon_lat[..., 1])
