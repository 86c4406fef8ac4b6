"""A file in a local CRS, of a drawing or a building site, lies nowhere on the Earth: each reader says so."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from osgeo import gdal, ogr, osr

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import RepmError
from repm_qgis.geometry.frames import on_earth
from repm_qgis.imagery.dem import dem_range, make_surface
from repm_qgis.registration.references import read_reference
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage

LOCAL = 'LOCAL_CS["site of works",UNIT["metre",1]]'
UTM = "EPSG:32631"
BOUNDS = Bounds(500_000.0, 4_000_000.0, 500_040.0, 4_000_040.0)
SAID = r"' has a local coordinate reference system \(site of works\), which lies nowhere on the Earth: assign"


def raster(path, wkt=LOCAL, shape=(40, 40)):
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), shape[1], shape[0], 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((BOUNDS.xmin, 1.0, 0.0, BOUNDS.ymax, 0.0, -1.0))
    dataset.SetProjection(wkt)
    row, col = np.indices(shape)
    dataset.GetRasterBand(1).WriteArray((100.0 + 3.0 * np.sin(row / 3.0) * np.cos(col / 4.0)).astype(np.float32))
    dataset = None  # noqa: F841
    return str(path)


def layer(path):
    reference = osr.SpatialReference()
    reference.ImportFromWkt(LOCAL)
    source = ogr.GetDriverByName("GPKG").CreateDataSource(str(path))
    points = source.CreateLayer("points", reference, ogr.wkbPoint25D)
    feature = ogr.Feature(points.GetLayerDefn())
    feature.SetGeometry(ogr.CreateGeometryFromWkt("POINT Z (500010 4000010 100)"))
    points.CreateFeature(feature)
    feature = points = source = None  # noqa: F841
    return str(path)


def cloud(path):
    laspy = pytest.importorskip("laspy", reason="the package laspy is not installed")
    header = laspy.LasHeader(point_format=6, version="1.4")
    wkt = pyproj.CRS.from_wkt(LOCAL).to_wkt("WKT1_GDAL").encode()
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt.decode()))
    header.global_encoding.wkt = True
    made = laspy.LasData(header)
    made.x, made.y, made.z = np.full((3, 9), 5.0)
    made.write(str(path))
    return str(path)


def test_a_dem_is_refused(tmp_path):
    path = raster(tmp_path / "site.tif")
    with pytest.raises(RepmError, match="site.tif" + SAID):
        dem_range(path, UTM, BOUNDS)
    with pytest.raises(RepmError, match="site.tif" + SAID):
        make_surface(path, Bounds(3.0, 36.0, 3.01, 36.01), 10.0, str(tmp_path / "surface.tif"))


@pytest.mark.parametrize("name, make", (("site.tif", raster), ("site.gpkg", layer), ("site.las", cloud)))
def test_a_reference_is_refused(tmp_path, name, make):
    with pytest.raises(RepmError, match=name + SAID):
        read_reference(make(tmp_path / name), UTM, BOUNDS, 1.0)


@pytest.mark.parametrize("systems", ((LOCAL, UTM), (UTM, LOCAL), (LOCAL, LOCAL)))
def test_a_dsm_is_not_compared(tmp_path, systems):
    dsm, reference = (
        raster(tmp_path / f"{name}.tif", pyproj.CRS(wkt).to_wkt("WKT1_GDAL")) for name, wkt in zip("ab", systems)
    )
    with pytest.raises(RepmError, match=SAID):
        run_stage("comparedsm", {"dsm": dsm, "reference": reference}, Silent())


def test_a_terrain_needs_no_place_on_the_earth(tmp_path):
    made = run_stage("dtm", {"dsm": raster(tmp_path / "a.tif"), "output": str(tmp_path / "t.tif")}, Silent())
    assert gdal.Open(made.output).GetSpatialRef().GetName() == "site of works"


def test_a_mosaic_refuses_one(tmp_path):
    dsms = [raster(tmp_path / f"{name}.tif") for name in "ab"]
    with pytest.raises(RepmError, match="a.tif" + SAID):
        run_stage("mosaic", {"dsms": dsms, "output": str(tmp_path / "m.tif")}, Silent())


@pytest.mark.parametrize("name", ("EPSG:32631", "EPSG:4326", "EPSG:4979", "EPSG:32631+3855", "EPSG:3857", "EPSG:4978"))
def test_systems_of_the_earth_are_as_they_were(name):
    crs = pyproj.CRS(name)
    assert on_earth(crs, "a.tif") is crs
