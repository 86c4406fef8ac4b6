"""Point clouds in comparisons: as rasters, on which errors are measured, and as points, which ICP lays onto each other.

A raster of a cloud has the mean of the first returns in each cell: what a DSM shows of roofs and trees.
"""

from __future__ import annotations

import math
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from ..contracts.arrays import Bounds, FloatArray, Window
from ..contracts.errors import ImageError
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import flat_crs
from ..geometry.vertical import TAG, stated_datum
from ..registration.clouds import CellSums, OpenedCloud, opened_cloud
from .grids import Grid, HeightWarper, metres_per_unit

_POINTS_A_CELL = 4  # of a cloud without a raster beside it


def raster_of_cloud(path: str, option: str, beside: Optional[Grid], check: Callable[[], None]) -> gdal.Dataset:
    """A cloud's first returns as means over cells, in memory; its description is the cloud's path.

    The cells are those of the raster ``beside`` it where that is in a projected CRS, else of four points each in the
    cloud's own CRS. Sixteen bytes a cell are taken meanwhile. ``option`` names the cloud. Raises ImageError for a
    cloud that cannot be read, or is in degrees itself, OverlapError where it does not cover the raster.
    """
    with opened_cloud(path, option) as cloud:
        grid, crs = _cells(cloud, beside)
        sums = CellSums(grid)
        for part in cloud.parts(crs, grid.bounds, check):
            sums.add(part.xyz[part.first])
        datum = stated_datum(cloud.system)
    dataset = gdal.GetDriverByName("MEM").Create("", *grid.size, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform(grid.geotransform)
    dataset.SetProjection(datum.file_crs(crs) if datum is not None else pyproj.CRS(crs).to_wkt("WKT2_2019"))
    if datum is not None:
        dataset.SetMetadataItem(TAG, datum.name)
    dataset.GetRasterBand(1).WriteArray(sums.means().astype(np.float32))
    dataset.SetDescription(path)
    return dataset


def _cells(cloud: OpenedCloud, beside: Optional[Grid]) -> Tuple[CellGrid, str]:
    """The cells of a cloud's raster, and their CRS."""
    if beside is not None and _is_plain(beside):
        crs = flat_crs(beside.crs).to_wkt("WKT2_2019")
        west, cell, _, north = beside.transform[:4]
        whole = CellGrid(west, north, cell, beside.size[::-1])
        return whole.part(whole.window(cloud.common(crs, beside.bounds), 1)), crs
    system = flat_crs(cloud.system)
    if system.is_geographic:
        raise ImageError(f"The point cloud '{cloud.path}' is in degrees: reproject it to a CRS in metres first (PDAL).")
    header = cloud.reader.header
    bounds = Bounds.between(header.mins[:2], header.maxs[:2])
    area = max((bounds.xmax - bounds.xmin) * (bounds.ymax - bounds.ymin), 1e-6)
    cell = math.sqrt(_POINTS_A_CELL * area / max(header.point_count, 1))
    return CellGrid.covering(bounds, float(f"{cell:.2g}")), system.to_wkt("WKT2_2019")


def _is_plain(grid: Grid) -> bool:
    """Whether a raster has square cells, north up, in a projected CRS."""
    return grid.is_north_up and grid.transform[1] == -grid.transform[5] and flat_crs(grid.crs).is_projected


class Surface:
    """One side of an alignment by points: a raster's cells, or the points of the cloud that it was made from."""

    def __init__(self, warper: HeightWarper, target: Grid, cloud: str = "") -> None:
        """``target`` is the grid of the reference, in whose CRS and datum the points are; ``cloud`` "" for a raster."""
        self._warper, self._target, self._cloud = warper, target, cloud

    def points(self, windows: Sequence[Window], margin: int, check: Callable[[], None]) -> FloatArray:
        """(N, 3) points within windows of the target grid and a margin of its cells, in metres from its middle."""
        grids = [self._target.window(window.grown(margin, self._target.size)) for window in windows]
        found = self._of_cloud(grids, check) if self._cloud else [self._of_cells(grid) for grid in grids]
        xyz: FloatArray = np.concatenate([*found, np.empty((0, 3))])
        west, south, east, north = self._target.bounds
        xyz[:, :2] -= (west + east) / 2, (south + north) / 2
        xyz[:, :2] *= metres_per_unit(self._target)
        return xyz

    def _of_cells(self, grid: Grid) -> FloatArray:
        cells = self._warper.own_cells(grid)
        heights = self._warper.read(cells)
        row, column = np.nonzero(np.isfinite(heights))
        return np.column_stack([*cells.to_ground(column + 0.5, row + 0.5), heights[row, column]])

    def _of_cloud(self, grids: Sequence[Grid], check: Callable[[], None]) -> List[FloatArray]:
        boxes = np.array([grid.bounds for grid in grids])
        around = Bounds.between(boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0))
        crs = flat_crs(self._target.crs).to_wkt("WKT2_2019")
        found = []
        with opened_cloud(self._cloud) as cloud:
            for part in cloud.parts(crs, around, check):
                x, y = part.xyz[:, :1], part.xyz[:, 1:2]
                inside = (x >= boxes[:, 0]) & (y >= boxes[:, 1]) & (x <= boxes[:, 2]) & (y <= boxes[:, 3])
                xyz = part.xyz[part.first & inside.any(axis=1)]
                found.append(np.column_stack([xyz[:, :2], self._warper.heights_of(xyz)]))
        return found
