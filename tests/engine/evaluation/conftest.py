from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal, osr


def _surface(x, y):
    """A smooth terrain, metres, of places in metres."""
    return 300 + 40 * np.sin(x / 31) * np.cos(y / 37) + 10 * np.sin(x / 9 + y / 12) + 0.05 * x


@pytest.fixture
def make_raster(tmp_path):
    """make(name, heights, origin, cell, crs, nodata) writes a GeoTIFF; NaN becomes nodata where one is given."""

    def make(name, heights, origin=(500000.0, 5000000.0), cell=0.5, crs="EPSG:32631", nodata=-9999.0, wkt=None):
        path = str(tmp_path / name)
        values = np.asarray(heights, np.float32)
        if nodata is not None:
            values = np.where(np.isfinite(values), values, np.float32(nodata))
        dataset = gdal.GetDriverByName("GTiff").Create(path, values.shape[1], values.shape[0], 1, gdal.GDT_Float32)
        dataset.SetGeoTransform((origin[0], cell, 0, origin[1], 0, -cell))
        if crs or wkt:
            reference = osr.SpatialReference()
            reference.SetFromUserInput(wkt or crs)
            dataset.SetSpatialRef(reference)
        if nodata is not None:
            dataset.GetRasterBand(1).SetNoDataValue(nodata)
        dataset.GetRasterBand(1).WriteArray(values)
        dataset = None  # noqa: F841
        return path

    return make


def _terrain(rows, columns, dx=0.0, dy=0.0, cell=0.5):
    """:func:`_surface` on a grid, moved dx m to the east and dy m to the north."""
    y, x = np.mgrid[:rows, :columns].astype(float)
    return _surface((x + 0.5) * cell - dx, -(y + 0.5) * cell - dy)


@pytest.fixture
def surface():
    """surface(x, y): smooth heights of places, all in metres."""
    return _surface


@pytest.fixture
def terrain():
    """terrain(rows, columns, dx, dy, cell): the surface on a grid, moved."""
    return _terrain
