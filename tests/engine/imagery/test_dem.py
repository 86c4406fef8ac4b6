"""The range of heights that a DEM gives, whatever its CRS and vertical datum."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from osgeo import gdal, osr

from repm_qgis.contracts.errors import ImageError, OverlapError
from repm_qgis.imagery.dem import dem_range

LON, LAT = 6.65, 44.38
CRS = "EPSG:32632"


def bounds():
    x, y = pyproj.Transformer.from_crs("EPSG:4326", CRS, always_xy=True).transform(LON, LAT)
    return x - 500, y - 400, x + 500, y + 400


def dem(path, crs, heights=None, west=LON - 0.05, north=LAT + 0.05, cell=0.0005, nodata=-32768.0):
    heights = np.full((200, 200), 1000, np.float32) if heights is None else heights
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), heights.shape[1], heights.shape[0], 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((west, cell, 0, north, 0, -cell))
    if crs:
        reference = osr.SpatialReference()
        reference.SetFromUserInput(crs)
        dataset.SetSpatialRef(reference)
    dataset.GetRasterBand(1).SetNoDataValue(nodata)
    dataset.GetRasterBand(1).WriteArray(heights)
    dataset = None  # noqa: F841
    return str(path)


def relief():
    """1100 to 1400 m in the middle, and what must not count: a peak outside the bounds, a gap inside."""
    heights = np.full((200, 200), 1200, np.float32)
    heights[95, 100], heights[104, 97] = 1100, 1400
    heights[5, 5], heights[195, 190] = 4000, -50
    heights[100:102, 100:102] = -32768
    return heights


def test_only_the_scene_counts_and_nodata_does_not(tmp_path):
    low, high, vertical = dem_range(dem(tmp_path / "a.tif", "EPSG:4326", relief()), CRS, bounds())
    assert (low, high, vertical) == (1100.0, 1400.0, False)


def test_projected_dems(tmp_path):
    x0, y0, x1, y1 = bounds()
    heights = np.full((300, 300), 700, np.float32)
    heights[150, 150], heights[2, 2] = 750, 3000
    path = dem(tmp_path / "a.tif", CRS, heights, x0 - 1000, y1 + 1000, 10.0)
    assert dem_range(path, CRS, bounds())[:2] == (700.0, 750.0)
    assert dem_range(dem(tmp_path / "b.tif", "EPSG:4979"), CRS, bounds()) == (1000.0, 1000.0, True)


def grid_is_there():
    return pyproj.transformer.TransformerGroup("EPSG:4326+5773", "EPSG:4979").best_available


@pytest.mark.skipif(not grid_is_there(), reason="PROJ's EGM96 grid is not installed")
@pytest.mark.parametrize("crs", ("EPSG:4326+5773", "EPSG:32632+5773"))
def test_heights_above_a_geoid_are_brought_to_the_ellipsoid(tmp_path, crs):
    if crs.startswith("EPSG:4326"):
        path = dem(tmp_path / "a.tif", crs, relief())
    else:
        x0, _, _, y1 = bounds()
        path = dem(tmp_path / "a.tif", crs, np.full((300, 300), 1100, np.float32), x0 - 1000, y1 + 1000, 10.0)
    undulation = pyproj.Transformer.from_crs("EPSG:4326+5773", "EPSG:4979", always_xy=True).transform(LON, LAT, 0.0)[2]
    assert 50 < undulation < 56  # in the Alps the geoid is that far above the ellipsoid
    low, high, vertical = dem_range(path, CRS, bounds())
    assert vertical and low == pytest.approx(1100 + undulation, abs=0.3)
    assert high - low in (pytest.approx(300.0, abs=0.01), pytest.approx(0.0, abs=0.01))


def test_a_missing_grid_is_said(tmp_path):
    path = dem(tmp_path / "a.tif", "EPSG:4326+5703")  # NAVD88: no grid of it covers the Alps
    with pytest.raises(ImageError) as caught:
        dem_range(path, CRS, bounds())
    assert path in str(caught.value)


def test_dems_that_do_not_help(tmp_path):
    away = dem(tmp_path / "away.tif", "EPSG:4326", west=10.0)
    gaps = dem(tmp_path / "gaps.tif", "EPSG:4326", np.full((200, 200), -32768, np.float32))
    bare = dem(tmp_path / "bare.tif", None)
    for path, kind, words in (
        (away, OverlapError, "does not cover the scene"),
        (gaps, OverlapError, "only nodata"),
        (bare, ImageError, "no coordinate reference system"),
        (str(tmp_path / "gone.tif"), ImageError, "does not exist"),
    ):
        with pytest.raises(kind) as caught:
            dem_range(path, CRS, bounds())
        assert path in str(caught.value) and words in str(caught.value)
