"""Stable ground: where a surface may be compared with a reference, as polygons or as a raster."""

from __future__ import annotations

from typing import Callable

import numpy as np
import pyproj
from osgeo import gdal, ogr, osr

from ..contracts.arrays import Mask
from ..contracts.errors import ImageError
from ..contracts.findings import Finding
from ..files.vector import file_and_layer, open_layer, polygons_of
from ..geometry.cell_grid import CellGrid
from ..imagery.raster import opened


def stable_cells(path: str, grid: CellGrid, crs: str, warn: Callable[[Finding], None] = lambda finding: None) -> Mask:
    """The (rows, columns) cells of a grid in a projected CRS whose middle is stable: in a polygon of a layer, or in a
    cell of a raster that is neither zero nor nodata.

    ``warn`` hears of polygons that cross themselves. Raises InputTableError for a layer, and ImageError for a raster,
    that cannot be used.
    """
    file, name = file_and_layer(path)
    source, layer = open_layer(file, name)
    if layer is None:
        return _in_raster(file, grid, crs)
    cells = _in_polygons(path, layer, grid, crs, warn)
    del layer, source  # in this order, or OGR's objects outlive their file
    return cells


def _in_polygons(path: str, layer: ogr.Layer, grid: CellGrid, crs: str, warn: Callable[[Finding], None]) -> Mask:
    target = osr.SpatialReference()
    target.SetFromUserInput(crs)
    target.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    memory = ogr.GetDriverByName("Memory").CreateDataSource("stable")
    copy = memory.CreateLayer("stable", target, ogr.wkbUnknown)
    for _, geometry in polygons_of(layer, path, "STABLE", target, warn):
        moved = ogr.Feature(copy.GetLayerDefn())
        moved.SetGeometry(geometry)
        copy.CreateFeature(moved)
    mask = _memory_raster(grid, crs)
    gdal.RasterizeLayer(mask, [1], copy, burn_values=[1])
    return np.asarray(mask.ReadAsArray() > 0)


def _in_raster(path: str, grid: CellGrid, crs: str) -> Mask:
    with opened(path) as dataset:
        if not dataset.GetProjection():
            raise ImageError(f"The raster '{path}' has no coordinate reference system: assign it one first.")
        west, south, east, north = grid.bounds
        rows, columns = grid.shape
        warped = gdal.Warp(
            "",
            dataset,
            format="MEM",
            dstSRS=pyproj.CRS.from_user_input(crs).to_wkt(),
            outputBounds=(west, south, east, north),
            width=columns,
            height=rows,
            resampleAlg="near",
            dstNodata=float("nan"),  # not 0: newer GDAL moves the raster's own zeros away from it
            outputType=gdal.GDT_Float32,
        )
        values = warped.GetRasterBand(1).ReadAsArray()
    return np.asarray(np.isfinite(values) & (values != 0))


def _memory_raster(grid: CellGrid, crs: str) -> gdal.Dataset:
    rows, columns = grid.shape
    dataset = gdal.GetDriverByName("MEM").Create("", columns, rows, 1, gdal.GDT_Byte)
    dataset.SetGeoTransform(grid.geotransform)
    dataset.SetProjection(pyproj.CRS.from_user_input(crs).to_wkt())
    return dataset
