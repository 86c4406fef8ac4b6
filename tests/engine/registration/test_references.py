"""A reference is read by what its file is, whatever its name in QGIS."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import ImageError, InputTableError
from repm_qgis.files.vector import write_layer
from repm_qgis.registration import references
from repm_qgis.registration.found import Within
from repm_qgis.registration.references import read_reference

UTM = "EPSG:32631"
BOUNDS = Bounds(500_000.0, 4_000_000.0, 501_000.0, 4_001_000.0)


def raster(path, driver="GTiff"):
    dataset = gdal.GetDriverByName("MEM").Create("", 40, 40, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((499_900.0, 30.0, 0, 4_001_100.0, 0, -30.0))
    dataset.SetProjection(pyproj.CRS(UTM).to_wkt())
    dataset.GetRasterBand(1).Fill(7.0)
    gdal.GetDriverByName(driver).CreateCopy(str(path), dataset)
    return str(path)


def points(path):
    point = ogr.CreateGeometryFromWkt("POINT Z (500500 4000500 7)")
    return write_layer(str(path), UTM, ogr.wkbPoint25D, {}, [(point, ())])


@pytest.mark.parametrize("name, driver", (("dem.tif", "GTiff"), ("dem.gpkg", "GPKG"), ("dem.img", "HFA")))
def test_rasters(tmp_path, name, driver):
    found = read_reference(raster(tmp_path / name, driver), UTM, BOUNDS, 0.0)
    assert len(found.height) > 1000 and (found.height == 7).all() and found.slopes is not None


@pytest.mark.parametrize("name", ("points.gpkg", "points.shp", "points.fgb", "points.gpkg|layername=points"))
def test_layers(tmp_path, name):
    path = points(tmp_path / name.split("|")[0])
    found = read_reference(path + name[len(name.split("|")[0]) :], UTM, BOUNDS, 0.0)
    assert found.xy.tolist() == [[500_500.0, 4_000_500.0]] and found.height.tolist() == [7.0]


@pytest.mark.parametrize("name", ("points.csv", "POINTS.CSV", "points.txt", "points.tsv"))
def test_tables(tmp_path, name):
    (tmp_path / name).write_text("x\ty\tz\n500500\t4000500\t7\n")
    assert read_reference(str(tmp_path / name), UTM, BOUNDS, 0.0).height.tolist() == [7.0]


@pytest.mark.parametrize(
    "name, reader", (("a.LAZ", "read_cloud"), ("a.copc.laz", "read_cloud"), ("a.h5", "read_lasers"))
)
def test_clouds_and_lasers_go_to_their_readers(monkeypatch, name, reader):
    monkeypatch.setattr(references, reader, lambda path, *_: path)
    assert read_reference(name, UTM, BOUNDS, 0.0) == name


def test_what_is_no_reference(tmp_path):
    with pytest.raises(ImageError, match=r"Cannot open the raster '.*missing\.tif': it does not exist"):
        read_reference(str(tmp_path / "missing.tif"), UTM, BOUNDS, 0.0)
    (tmp_path / "text.tif").write_text("no raster")
    with pytest.raises(ImageError, match=r"Cannot open the raster '.*text\.tif'"):
        read_reference(str(tmp_path / "text.tif"), UTM, BOUNDS, 0.0)
    with pytest.raises(InputTableError, match="has no layer 'other': choose an existing one"):
        read_reference(points(tmp_path / "points.gpkg") + "|layername=other", UTM, BOUNDS, 0.0)


def test_all_is_said_to_go_on_between_parts(tmp_path):
    path, checks = raster(tmp_path / "dem.tif"), []
    assert np.isfinite(read_reference(path, UTM, BOUNDS, 0.0, lambda: checks.append(1)).height).all() and checks


def test_what_is_read_reaches_two_percent_beyond_the_bounds_on_each_side():
    """In the file's own coordinates, east and north each by its own length; also with longitudes from 0 to 360."""
    bounds = Bounds(500_000.0, 4_000_000.0, 510_000.0, 4_001_000.0)
    within = Within(pyproj.CRS("EPSG:32631"), "EPSG:32631", bounds)
    wanted = (499_800.0, 3_999_980.0, 510_200.0, 4_001_020.0)
    assert tuple(within.source_bounds) == pytest.approx(wanted)
    x, y = np.array([499_790.0, 499_810.0, 500_000.0, 500_000.0]), np.array([4e6, 4e6, 4_001_030.0, 3_999_990.0])
    assert within.near(x, y).tolist() == [False, True, False, True]
    (west, east), _ = pyproj.Transformer.from_crs(4326, 32601, always_xy=True).transform([-177.0, -176.9], [10.0, 10.1])
    turned = Within(pyproj.CRS("EPSG:4326"), "EPSG:32601", Bounds(west, 1_105_000.0, east, 1_117_000.0))
    places, inside = turned.places(np.array([183.05, -176.95, 176.95]), np.array([10.05, 10.05, 10.05]))
    assert inside.tolist() == [True, True, False] and places[0] == pytest.approx(places[1])
    assert turned.near(np.array([183.05, 3.05]), np.array([10.05, 10.05])).tolist() == [True, False]
