"""The values of rasters that stages write."""

from __future__ import annotations

import numpy as np
from osgeo import gdal


def bands(path):
    """(bands, rows, columns) with NaN for nodata, and the geotransform."""
    dataset = gdal.Open(path)
    values = dataset.ReadAsArray().astype(np.float64).reshape(dataset.RasterCount, dataset.RasterYSize, -1)
    nodata, transform = dataset.GetRasterBand(1).GetNoDataValue(), dataset.GetGeoTransform()
    dataset = None
    values[values == nodata] = np.nan
    return values, transform
