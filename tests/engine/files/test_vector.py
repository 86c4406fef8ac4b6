"""Vector layers, read again with OGR."""

from __future__ import annotations

import os

import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import WorkspaceError
from repm_qgis.files.vector import crosses_itself, open_vector, read_points, write_layer

FIELDS = {"name": str, "count": int, "height": float}


def features(count=3):
    for number in range(count):
        point = ogr.Geometry(ogr.wkbPoint)
        point.AddPoint_2D(500000.0 + number, 4800000.25)
        yield point, (f"pörtø {number}", number, 0.5 * number if number != 1 else None)


@pytest.mark.parametrize(
    "name, driver",
    (
        ("a.gpkg", "GPKG"),
        ("a.geojson", "GeoJSON"),
        ("a.shp", "ESRI Shapefile"),
        ("a.fgb", "FlatGeobuf"),
        ("a.GPKG", "GPKG"),
        ("-a.gpkg", "GPKG"),  # words and signs that GeoPackage refuses at the beginning
        ("gpkg_a.gpkg", "GPKG"),
        ("sqlite_a.gpkg", "GPKG"),
        ("rtree_a.gpkg", "GPKG"),
    ),
)
def test_layers_come_back(tmp_path, name, driver):
    path = str(tmp_path / "new" / name)
    for count in (5, 3):  # written over, it has only the new features
        assert write_layer(path, "EPSG:32631", ogr.wkbPoint, FIELDS, features(count)) == path
    source = gdal.OpenEx(path, gdal.OF_VECTOR)
    assert source.GetDriver().ShortName == driver
    layer = source.GetLayer(0)
    assert layer.GetFeatureCount() == 3
    found = sorted((f["name"], f["count"], f["height"], f.geometry().GetX(), f.geometry().GetY()) for f in layer)
    assert layer.GetSpatialRef().GetAuthorityCode(None) == "32631" or "UTM zone 31N" in layer.GetSpatialRef().GetName()
    layer = source = None
    assert [row[:3] for row in found] == [("pörtø 0", 0, 0.0), ("pörtø 1", 1, None), ("pörtø 2", 2, 1.0)]
    assert found[2][3:] == (500002.0, 4800000.25)
    assert not [entry for entry in os.listdir(tmp_path / "new") if ".part" in entry]


def test_what_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.gpkg").mkdir()
    for path in (
        str(tmp_path / "file" / "a.gpkg"),
        *(["/proc/nowhere/a.gpkg"] if os.name != "nt" else []),
        str(tmp_path / "file" / "a.shp"),
        str(tmp_path / "folder.gpkg"),
    ):
        with pytest.raises(WorkspaceError) as caught:
            write_layer(path, "EPSG:32631", ogr.wkbPoint, FIELDS, features())
        assert os.path.dirname(path) in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.gpkg"]


def test_an_exception_leaves_nothing_new_and_what_was_there(tmp_path):
    path = str(tmp_path / "a.gpkg")
    write_layer(path, "EPSG:32631", ogr.wkbPoint, FIELDS, features())
    before = open(path, "rb").read()

    def broken():
        yield from features(1)
        raise KeyError

    with pytest.raises(KeyError):
        write_layer(path, "EPSG:32631", ogr.wkbPoint, FIELDS, broken())
    assert os.listdir(tmp_path) == ["a.gpkg"] and open(path, "rb").read() == before


def test_points_with_all_their_numbers_are_read(tmp_path):
    path = write_layer(str(tmp_path / "a.gpkg"), "EPSG:32631", ogr.wkbPoint, FIELDS, features())
    wanted = [[500000.0, 4800000.25, 0.0, 0.0], [500002.0, 4800000.25, 2.0, 1.0]]  # the second point has no height
    assert read_points(path, ("count", "height")).tolist() == wanted
    assert read_points(path, ("count",), most=2).shape == (2, 3)
    assert read_points(path, ("absent",)).shape == read_points(str(tmp_path / "none.gpkg"), ("count",)).shape == (0, 3)
    assert open_vector(str(tmp_path / "none.gpkg")) is None


@pytest.mark.parametrize(
    ("wkt", "crossed"),
    (
        ("POLYGON((0 0, 4 0, 4 4, 0 4, 0 0))", False),
        ("POLYGON((0 0, 4 4, 4 0, 0 4, 0 0))", True),  # half of the square
        ("POLYGON((0 0, 9 9, 9 0, 1 3, 0 0))", True),
        ("POLYGON((0 3, 5 3, 1 0, 2.5 5, 4 0, 0 3))", True),  # a star, with its middle twice
        ("MULTIPOLYGON(((0 0, 4 0, 4 4, 0 4, 0 0)),((2 2, 6 2, 6 6, 2 6, 2 2)))", True),  # overlapping parts
        ("MULTIPOLYGON(((0 0, 4 0, 4 4, 0 4, 0 0)),((4 4, 6 4, 6 6, 4 6, 4 4)))", False),
        ("POLYGON((0 0, 4 0, 4 4, 2 4, 3 2, 2 4, 0 4, 0 0))", False),  # a spike
        ("POLYGON((0 0, 4 0, 4 4, 2 4, 3 2, 1 2, 2 4, 0 4, 0 0))", False),  # a hole that touches its outline
        ("POLYGON((0 0, 4 0, 4 0, 4 4, 0 4, 0 0),(1 1, 1 2, 2 2, 2 1, 1 1))", False),
    ),
)
def test_polygons_that_cross_themselves_are_told_from_those_that_touch(wkt, crossed):
    assert crosses_itself(ogr.CreateGeometryFromWkt(wkt)) == crossed
