"""Polygons on cells, and cells as polygons."""

from __future__ import annotations

from typing import Iterator, List, Sequence, Tuple

import numpy as np
from osgeo import gdal, ogr

from ..contracts.arrays import FloatArray, Mask
from .raster import quiet


def burned(
    shapes: Sequence[ogr.Geometry], values: Sequence[float], size: Tuple[int, ...], transform: Sequence[float]
) -> FloatArray:
    """(rows, columns) the value of the polygon in which each cell's middle lies, NaN for none; ``size`` are rows and
    columns, ``transform`` is GDAL's geotransform. Of polygons that overlap the later one counts."""
    store = ogr.GetDriverByName("Memory").CreateDataSource("shapes")
    target = gdal.GetDriverByName("MEM").Create("", size[1], size[0], 1, gdal.GDT_Float64)
    target.SetGeoTransform(list(transform))
    target.GetRasterBand(1).Fill(float("nan"))
    with quiet():
        layer = store.CreateLayer("shapes", None, ogr.wkbPolygon)
        layer.CreateField(ogr.FieldDefn("value", ogr.OFTReal))
        for shape, value in zip(shapes, values):
            feature = ogr.Feature(layer.GetLayerDefn())
            feature.SetField("value", float(value))
            feature.SetGeometry(shape)
            layer.CreateFeature(feature)
        gdal.RasterizeLayer(target, [1], layer, options=["ATTRIBUTE=value"])
    feature = layer = store = None  # noqa: F841 - in this order, or OGR's objects outlive their file
    return np.asarray(target.ReadAsArray(), np.float64)


def inside(shape: ogr.Geometry, size: Tuple[int, ...], transform: Sequence[float]) -> Mask:
    """(rows, columns) which cells have their middle in a polygon."""
    return np.isfinite(burned([shape], [1.0], size, transform))


def outlined(mask: Mask, transform: Sequence[float]) -> List[ogr.Geometry]:
    """The borders of connected cells, as polygons with holes."""
    memory = gdal.GetDriverByName("MEM").Create("", mask.shape[1], mask.shape[0], 1, gdal.GDT_Byte)
    memory.SetGeoTransform(list(transform))
    memory.GetRasterBand(1).WriteArray(mask.astype(np.uint8))
    return list(polygons_of(memory))


def polygons_of(dataset: gdal.Dataset) -> Iterator[ogr.Geometry]:
    """The borders of connected cells of a raster's first band that are not 0, in the order of their first cells."""
    band = dataset.GetRasterBand(1)
    store = ogr.GetDriverByName("Memory").CreateDataSource("cells")
    with quiet():
        layer = store.CreateLayer("cells", None, ogr.wkbPolygon)
        gdal.Polygonize(band, band, layer, -1, [])
    for feature in layer:
        yield feature.GetGeometryRef().Clone()
    feature = layer = store = None  # noqa: F841 - in this order, or OGR's objects outlive their file
