"""Rasters as references: cells where they are, means of fine ones, slopes, datums and what cannot be used."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Bounds, Window
from repm_qgis.contracts.errors import ImageError, OverlapError
from repm_qgis.registration import rasters
from repm_qgis.registration.rasters import read_raster

UTM = "EPSG:32631"
BOUNDS = Bounds(500_000.0, 4_000_000.0, 501_000.0, 4_001_000.0)


def plane(x, y):
    """Heights that rise by 0.05 to the east and fall by 0.02 to the north."""
    return 100.0 + 0.05 * (np.asarray(x) - 500_000.0) - 0.02 * (np.asarray(y) - 4_000_000.0)


@pytest.fixture
def raster(tmp_path):
    def make(crs, transform, size, nodata=None, holes=None):
        path = str(tmp_path / "reference.tif")
        dataset = gdal.GetDriverByName("GTiff").Create(path, *size, 1, gdal.GDT_Float32)
        dataset.SetGeoTransform(transform)
        if crs:
            dataset.SetProjection(pyproj.CRS(crs).to_wkt())
        col, row = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
        x, y = transform[0] + col * transform[1], transform[3] + row * transform[5]
        if crs and pyproj.CRS(crs).is_geographic:
            x, y = pyproj.Transformer.from_crs("EPSG:4326", UTM, always_xy=True).transform(x, y)
        heights = plane(x, y)
        if holes:
            heights[holes] = nodata
        dataset.GetRasterBand(1).WriteArray(heights)
        if nodata is not None:
            dataset.GetRasterBand(1).SetNoDataValue(nodata)
        dataset = None
        return path

    return make


def test_cells_in_degrees_lie_where_they_are(raster):
    """A DEM of one second of arc: places in the scene's CRS, widths in metres, slopes to the true east and north."""
    second = 1 / 3600
    path = raster("EPSG:4326", (2.98, second, 0, 36.16, 0, -second), (140, 100))
    found = read_raster(path, UTM, BOUNDS, 0.0)
    (x, y), z = found.xy.T, found.height
    np.testing.assert_allclose(z, plane(x, y), atol=1e-3)
    assert found.width_m[0] == pytest.approx(25.0, abs=0.3) and found.width_m[1] == pytest.approx(30.8, abs=0.3)
    assert x.min() < BOUNDS.xmin and x.max() > BOUNDS.xmax and x.max() < BOUNDS.xmax + 200
    known = np.isfinite(found.slopes).all(axis=1)
    assert known.mean() > 0.8
    np.testing.assert_allclose(found.slopes[known], [[0.05, -0.02]] * known.sum(), atol=2e-3)


def test_fine_cells_are_averaged_and_gaps_left_out(raster):
    holes = (slice(0, 400), slice(500, 700))
    path = raster(UTM, (499_900.0, 0.5, 0, 4_001_100.0, 0, -0.5), (2400, 2400), -9999.0, holes)
    found = read_raster(path, UTM, BOUNDS, 3.0)
    (x, y), z = found.xy.T, found.height
    assert found.width_m == pytest.approx((3.0, 3.0)) and len(z) < (1010 / 3) ** 2
    np.testing.assert_allclose(z, plane(x, y), atol=0.1)  # beside gaps a mean is that of the cells that are there
    inside = (x < 500_140.0) & (y < 4_000_890.0)
    np.testing.assert_allclose(z[inside], plane(x, y)[inside], atol=1e-3)
    assert not ((x > 500_152.0) & (x < 500_248.0) & (y > 4_000_902.0)).any()


@pytest.mark.parametrize(
    "crs, tag, datum",
    (
        (UTM, "", None),
        (UTM, "WGS 84 ellipsoid", ("", "WGS 84 ellipsoid")),
        (UTM, "EGM2008 height", ("EPSG:3855", "EGM2008 height")),
        (UTM, "nonsense", None),
        (UTM + "+5773", "", ("EPSG:5773", "EGM96 height")),
        (UTM + "+5773", "WGS 84 ellipsoid", ("EPSG:5773", "EGM96 height")),
        ("EPSG:4979", "", ("", "WGS 84 ellipsoid")),
    ),
)
def test_the_file_says_what_its_heights_refer_to(raster, crs, tag, datum):
    second = 1 / 3600
    path = raster(crs, (2.98, second, 0, 36.16, 0, -second), (140, 100)) if crs == "EPSG:4979" else None
    path = path or raster(crs, (499_900.0, 30.0, 0, 4_001_100.0, 0, -30.0), (40, 40))
    dataset = gdal.Open(path, gdal.GA_Update)
    if tag:
        dataset.SetMetadataItem("VERTICAL_DATUM", tag)
    dataset = None
    found = read_raster(path, UTM, BOUNDS, 0.0).datum
    assert (found and (found.code, found.name)) == datum


@pytest.mark.parametrize("unit, metres", (("m", 1.0), ("ft", 0.3048), ("US survey foot", 1200 / 3937)))
def test_feet_become_metres(raster, unit, metres):
    path = raster(UTM, (499_900.0, 30.0, 0, 4_001_100.0, 0, -30.0), (40, 40))
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.GetRasterBand(1).SetUnitType(unit)
    dataset = None
    found = read_raster(path, UTM, BOUNDS, 0.0)
    np.testing.assert_allclose(found.height, plane(*found.xy.T) * metres, atol=1e-3)
    known = np.isfinite(found.slopes).all(axis=1)
    np.testing.assert_allclose(found.slopes[known], np.tile([0.05, -0.02], (known.sum(), 1)) * metres, atol=1e-5)


@pytest.mark.parametrize(
    "crs, unit, places_in",
    (
        (UTM, "", "metre"),
        (UTM, "m", None),
        ("EPSG:4326", "", "degree"),
        ("EPSG:4979", "", None),
        (UTM + "+5773", "", None),
        ("EPSG:2260", "", "US survey foot"),
        ("EPSG:2260", "ft", None),
        ("EPSG:2260+6360", "", None),
    ),
)
def test_whether_the_unit_of_heights_is_known(tmp_path, crs, unit, places_in):
    """Where it is not, what the places are in says how doubtful it is."""
    system = pyproj.CRS(crs)
    flat = system.sub_crs_list[0] if system.is_compound else system
    zone = "EPSG:32618" if "2260" in crs else UTM
    lon, lat = (-74.5, 42.0) if "2260" in crs else (3.005, 36.14)
    x, y = pyproj.Transformer.from_crs("EPSG:4326", flat, always_xy=True).transform(lon, lat)
    step = 1e-4 if flat.is_geographic else 30.0
    path = str(tmp_path / "reference.tif")
    dataset = gdal.GetDriverByName("GTiff").Create(path, 100, 100, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((x - 50 * step, step, 0, y + 50 * step, 0, -step))
    dataset.SetProjection(system.to_wkt())
    dataset.GetRasterBand(1).SetUnitType(unit)
    dataset = None
    middle = np.array(pyproj.Transformer.from_crs("EPSG:4326", zone, always_xy=True).transform(lon, lat))
    found = read_raster(path, zone, Bounds(*(middle - 100), *(middle + 100)), 0.0)
    assert found.places_in == places_in


def test_another_unit_is_a_sentence(raster):
    path = raster(UTM, (499_900.0, 30.0, 0, 4_001_100.0, 0, -30.0), (40, 40))
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.GetRasterBand(1).SetUnitType("fathom")
    dataset = None
    with pytest.raises(ImageError, match="has heights in 'fathom': convert them to metres first"):
        read_raster(path, UTM, BOUNDS, 0.0)


@pytest.mark.parametrize(
    "crs, west, holes, kind, words",
    (
        (None, 499_900.0, None, ImageError, "has no coordinate reference system: assign it one first"),
        (UTM, 600_000.0, None, OverlapError, "does not cover the scene: choose one that does"),
        (UTM, 499_900.0, (slice(None), slice(None)), OverlapError, "has no heights over the scene"),
    ),
)
def test_what_cannot_be_used_is_a_sentence(raster, crs, west, holes, kind, words):
    path = raster(crs, (west, 30.0, 0, 4_001_100.0, 0, -30.0), (40, 40), -9999.0, holes)
    with pytest.raises(kind, match=words) as caught:
        read_raster(path, UTM, BOUNDS, 0.0)
    assert path in str(caught.value)


def test_cells_are_as_wide_as_in_the_middle_of_what_is_read():
    """Degrees of longitude are narrower to the north: a window of 20 degrees has the width of its middle."""
    back = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3395", always_xy=True)  # Mercator stretches by 1 / cos
    place = (2.0, 0.01, 0.0, 70.0, 0.0, -0.01)
    for window in (Window(100, 0, 50, 2000), Window(100, 500, 50, 1000)):
        found = rasters._jacobian(place, back, window)
        latitude = 70.0 - 0.01 * (window.row + window.height / 2)
        x, y = back.transform([3.25, 3.26, 3.25], [latitude, latitude, latitude - 0.01])
        assert found == pytest.approx(np.array([[x[1] - x[0], x[2] - x[0]], [y[1] - y[0], y[2] - y[0]]]))
    turned = rasters._jacobian((0.0, 3.0, 4.0, 0.0, 4.0, -3.0), Same(), Window(0, 0, 10, 10))
    assert turned == pytest.approx(np.array([[3.0, 4.0], [4.0, -3.0]]))


class Same:
    """A transformation that changes nothing."""

    @staticmethod
    def transform(x, y):
        return x, y


def test_two_cells_more_than_the_bounds_are_read():
    dataset = gdal.GetDriverByName("MEM").Create("", 100, 80, 1)
    place = (1000.0, 10.0, 0.0, 5000.0, 0.0, -10.0)

    def window(*bounds):
        return rasters._window(dataset, place, Same(), Bounds(*bounds))

    assert window(1200.0, 4500.0, 1300.0, 4700.0) == Window(18, 28, 14, 24)
    assert window(1205.0, 4495.0, 1305.0, 4705.0) == Window(18, 27, 15, 26)
    assert window(900.0, 4000.0, 3000.0, 6000.0) == Window(0, 0, 100, 80)
    assert window(990.0, 4990.0, 1010.0, 5010.0) == Window(0, 0, 3, 3)
    assert window(3000.0, 4500.0, 3100.0, 4700.0) is None and window(1200.0, 5100.0, 1300.0, 5200.0) is None
    turned = (1000.0, 0.0, 10.0, 5000.0, 10.0, 0.0)  # rows run to the east, columns to the north
    assert rasters._window(dataset, turned, Same(), Bounds(1200.0, 5100.0, 1300.0, 5300.0)) == Window(8, 18, 24, 14)


@pytest.mark.parametrize("strip", (7, 10_000))
def test_means_are_those_of_the_blocks(monkeypatch, strip):
    """However many rows are read at once; blocks at the end that are not whole are left out."""
    monkeypatch.setattr(rasters, "_STRIP_CELLS", strip * 30)
    rng = np.random.default_rng(0)
    values = rng.normal(100, 5, (40, 34)).astype(np.float32)
    values[10, 10] = np.nan
    values[20:22, 5:7] = np.nan  # four of a block's nine cells
    values[23:25, 5:7], values[25, 5] = np.nan, np.nan  # and five
    dataset = gdal.GetDriverByName("MEM").Create("", 34, 40, 1, gdal.GDT_Float32)
    dataset.GetRasterBand(1).WriteArray(values)
    found, right, below = rasters._read_blocks(dataset, Window(2, 5, 31, 33), 3, lambda: None).means(0.5)
    part = values[5 : 5 + 33, 2 : 2 + 30].reshape(11, 3, 10, 3)
    wanted = np.nanmean(part, axis=(1, 3))
    wanted[6, 1] = np.nan
    assert found.shape == (11, 10) and np.isnan(found[6, 1]) and np.isnan(found).sum() == 1
    assert found == pytest.approx(wanted, rel=1e-5, nan_ok=True)
