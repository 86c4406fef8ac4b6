"""Which cells of a DSM belong to buildings, block by block, and the borders of connected ones.

Buildings are what stands above the terrain and has planar parts: roofs are planes over the width of a tree, and crowns
of trees are not (Rottensteiner and Briese 2002, ISPRS Archives 34/3A). The planar parts, opened so that neither rows of
trees nor garden walls are left, grow back to the walls around them, which end where the surface is at half the height
of the roof.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, List

import numpy as np
from osgeo import ogr
from scipy import ndimage

from ..contracts.arrays import FloatImage, Mask
from ..geometry.cell_grid import overlapping_blocks
from ..imagery import raster
from ..imagery.cell_polygons import polygons_of
from .cells import Cells, Rasters
from .local_planes import local_planes
from .parameters import BUILDINGS, BuildingParameters, FootprintParameters


@dataclass(frozen=True)
class Border:
    """The border of connected cells of a building, in the DSM's CRS, as WKB, and its ``area``, m2."""

    outline: bytes
    area: float


def in_cells(metres: float, cell: float) -> int:
    """How many cells a length is, at least one."""
    return max(1, round(metres / cell))


def disc(radius: int) -> Mask:
    """The cells within a radius of the middle one, (2 radius + 1, 2 radius + 1)."""
    across = np.arange(-radius, radius + 1)
    return np.asarray(across[:, None] ** 2 + across**2 <= (radius + 0.5) ** 2)


def margin(cell: float, parameters: FootprintParameters = BUILDINGS.footprints) -> int:
    """Cells around a block on which its own cells depend."""
    lengths = (parameters.plane_m / 2, parameters.wall_m, 2 * parameters.opening_m, parameters.rim_m)
    return sum(in_cells(length, cell) for length in lengths) + 2 * in_cells(parameters.closed_m, cell) + 4


def building_cells(
    cells: Cells,
    cell: float,
    least_m: float,
    usual_error: float,
    parameters: FootprintParameters = BUILDINGS.footprints,
) -> Mask:
    """(rows, columns) which cells belong to buildings of at least ``least_m`` above the terrain; ``cell`` in m,
    ``usual_error`` of the DSM in m, 0 where it is not known."""
    above = cells.above
    high = _above_half(above, least_m, in_cells(parameters.wall_m, cell))
    half = in_cells(parameters.plane_m / 2, cell)
    planes = local_planes(above, high, half, cell)
    limit = max(parameters.planar_m, parameters.planar_errors * usual_error)
    with np.errstate(invalid="ignore"):
        planar = high & (planes.rms < limit) & (planes.slope < parameters.steepest)
        if cells.plants is not None:
            planar &= ~(cells.plants > parameters.vegetation)
    core = ndimage.binary_opening(planar, disc(in_cells(parameters.opening_m, cell)))
    found = high & (ndimage.distance_transform_edt(~core) <= in_cells(parameters.rim_m, cell)) if core.any() else core
    closing = disc(in_cells(parameters.closed_m, cell))
    return without_tails(np.asarray(ndimage.binary_closing(found, closing)), in_cells(parameters.closed_m, cell))


def without_tails(cells: Mask, radius: int) -> Mask:
    """The cells without parts that are narrower than a disc; corners, which an opening alone would round, stay."""
    opened = ndimage.binary_opening(cells, disc(radius))
    return np.asarray(cells & ndimage.binary_dilation(opened, disc(radius + 1)))


def _above_half(above: FloatImage, least_m: float, reach: int) -> Mask:
    """What is higher than ``least_m`` and than half the height of the highest cell nearby."""
    known = np.where(np.isfinite(above), above, -np.inf)
    top = ndimage.maximum_filter(known, footprint=disc(reach), mode="nearest")
    with np.errstate(invalid="ignore"):
        return np.asarray((known > least_m) & (known > 0.5 * top))


def write_cells(
    rasters: Rasters,
    path: str,
    least_m: float,
    step: Callable[[float], None],
    parameters: BuildingParameters = BUILDINGS,
) -> None:
    """Write 1 where buildings stand, else 0, on the DSM's cells, block by block; ``step`` is called with the
    share that is done."""
    surface = rasters.surface
    columns, rows = surface.size
    around = margin(surface.cell, parameters.footprints)
    blocks = list(overlapping_blocks(surface.size, parameters.block_cells, around))
    frame = raster.RasterFrame((rows, columns), np.uint8, 1, surface.transform, surface.crs)
    with raster.created(path, frame, nodata=None, own=True) as target:
        for number, (own, wide) in enumerate(blocks):
            step(number / len(blocks))
            found = building_cells(
                rasters.read(wide), surface.cell, least_m, surface.usual_error, parameters.footprints
            )
            target.write(found[own.inside(wide)].astype(np.uint8), own.col, own.row)
            target.flush()


def borders(path: str, cell: float, least_m2: float, hole_m2: float, check: Callable[[], None]) -> List[Border]:
    """The borders of connected cells that are at least ``least_m2``, without courtyards smaller than ``hole_m2``, in
    the order of their first cells."""
    found = []
    with raster.opened(path) as dataset:
        for outline in polygons_of(dataset):
            check()
            shape = without_small_holes(outline, hole_m2)
            if shape.GetArea() >= max(least_m2, cell * cell):
                found.append(Border(bytes(shape.ExportToWkb()), float(shape.GetArea())))
    return found


def without_small_holes(shape: ogr.Geometry, least_m2: float) -> ogr.Geometry:
    """A polygon with its larger holes alone."""
    made = ogr.Geometry(ogr.wkbPolygon)
    for number in range(shape.GetGeometryCount()):
        ring = shape.GetGeometryRef(number)
        if number == 0 or ring.GetArea() >= least_m2:
            made.AddGeometry(ring)
    return made
