"""Tables and layers of points: the fields, CRS and datum that are read, the rows that are good, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import Cancelled, InputTableError, OverlapError
from repm_qgis.files.vector import write_layer
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.registration import points
from repm_qgis.registration.points import read_points_of_layer, read_points_of_table

UTM = "EPSG:32631"
BOUNDS = Bounds(500_000.0, 4_000_000.0, 502_000.0, 4_002_000.0)
XY = np.array([[500_100.0, 4_000_200.0], [501_900.0, 4_001_000.0], [500_500.5, 4_001_999.0]])
FAR = [[499_990.0, 4_001_000.0]]
HEIGHTS = [10.5, 20.25, -3.0]
LON_LAT = geodetic_from_projected(UTM, XY)


def text_of(fields, rows, mark=","):
    return "\n".join([mark.join(fields), *(mark.join(str(value) for value in row) for row in rows)]) + "\n"


def degrees(height="height", more=(), mark=",", names=("longitude", "latitude")):
    rows = [[*place, h, *(value for _, value in more)] for place, h in zip(LON_LAT, HEIGHTS)]
    return text_of([*names, height, *(name for name, _ in more)], rows, mark)


@pytest.fixture
def table(tmp_path):
    def read(text, name="points.csv", bounds=BOUNDS, **options):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return read_points_of_table(str(tmp_path / name), UTM, bounds, **options)

    return read


@pytest.mark.parametrize(
    "names, mark",
    (
        (("longitude", "latitude"), ","),
        (("lon", "lat"), ";"),
        (("LON", "Lat"), "\t"),
        (("lng", "lat"), " "),
        (("x", "y"), ","),
    ),
)
def test_degrees_of_every_name_are_wgs84(table, names, mark):
    found = table(degrees(names=names, mark=mark), "points.txt")
    np.testing.assert_allclose(found.xy, XY, atol=1e-3)
    assert found.height.tolist() == HEIGHTS and found.width_m == (0.0, 0.0) and not found.disc
    assert found.datum is None and found.slopes is None and found.places_in == "degree"


def test_x_and_y_are_in_the_scenes_crs(table):
    found = table(text_of("xyz", [[*place, h] for place, h in zip([*XY.tolist(), *FAR], [*HEIGHTS, 1.0])]))
    np.testing.assert_allclose(found.xy, XY)
    assert found.height.tolist() == HEIGHTS


@pytest.mark.parametrize(
    "fields, width, disc, datum",
    (
        (("longitude", "latitude", "h_mean"), (12, 40), False, ""),  # SlideRule
        (("longitude", "latitude", "h_li"), (12, 40), False, ""),
        (("longitude", "latitude", "h_te_best_fit"), (12, 100), False, ""),
        (("lon_ph", "lat_ph", "h_ph"), (12, 12), True, ""),
        (("lon_lowestmode", "lat_lowestmode", "elev_lowestmode"), (25, 25), True, ""),
        (("lon", "lat", "ellipsoidal_height"), (0, 0), False, ""),
        (("lon", "lat", "elevation"), (0, 0), False, None),
        (("lon", "lat", "alt"), (0, 0), False, None),
    ),
)
def test_the_field_of_heights_says_what_they_are(table, fields, width, disc, datum):
    found = table(degrees(fields[2], names=fields[:2], more=(("dem_h", 1.0),)))
    assert found.height.tolist() == HEIGHTS and found.width_m == width and found.disc is disc
    assert (found.datum and found.datum.code) == datum and found.places_in == (None if width[0] else "degree")


@pytest.mark.parametrize(
    "height, flag, values",
    (
        ("elev_lowestmode", "quality_flag", (1, 0, 1)),
        ("elev_lowestmode", "degrade_flag", (0, 30, 0)),
        ("h_li", "atl06_quality_summary", (0, 1, 0)),
        ("h_ph", "signal_conf_ph", (3, 2, 4)),
        ("height", "atl03_cnf", (3, -1, 4)),  # SlideRule's photons
        ("h_ph", "signal_conf_ph", (3, "", 4)),
    ),
)
def test_rows_of_bad_quality_are_left_out(table, height, flag, values):
    rows = [[*place, h, value] for place, h, value in zip(LON_LAT, HEIGHTS, values)]
    found = table(text_of(["longitude", "latitude", height, flag], rows))
    assert found.height.tolist() == [HEIGHTS[0], HEIGHTS[2]] and found.datum.code == "" and found.width_m[0] > 0


def test_a_quality_flag_of_plain_points_means_nothing(table):
    assert len(table(degrees(more=(("quality_flag", 0),))).height) == 3


@pytest.mark.parametrize("field, form", (("geometry", "POINT ({} {})"), ("wkt", "POINT Z({} {} 7.0)")))
def test_places_as_geometries_of_geopandas(table, field, form):
    rows = [[f'"{form.format(*place)}"', h, 0.1] for place, h in zip(LON_LAT, HEIGHTS)]
    found = table(text_of([field, "h_mean", "h_sigma"], rows))
    np.testing.assert_allclose(found.xy, XY, atol=1e-3)
    assert found.height.tolist() == HEIGHTS and found.width_m == (12, 40)


def test_longitudes_may_count_to_360(table):
    west = Bounds(200_000.0, 4_000_000.0, 230_000.0, 4_030_000.0)  # west of Greenwich
    lon, lat = geodetic_from_projected(UTM, np.array([210_000.0, 4_010_000.0]))
    found = table(f"lon,lat,h\n{lon + 360},{lat},5\n", bounds=west)
    assert lon < 0 and np.abs(found.xy - [210_000.0, 4_010_000.0]).max() < 1e-3


def test_empty_values_and_fills_are_left_out(table):
    rows = [[*place, h] for place, h in zip([*LON_LAT, *LON_LAT], ["", "nan", "NULL", 3.4028235e38, -9999999, 8.5])]
    assert table(text_of(["lon", "lat", "h"], rows)).height.tolist() == [8.5]


def test_rows_are_added_in_parts_and_may_be_stopped(table, monkeypatch):
    monkeypatch.setattr(points, "_ROWS", 2)
    checks = []
    assert len(table(degrees(), check=lambda: checks.append(1)).height) == 3 and len(checks) == 2

    def stop():
        raise Cancelled

    with pytest.raises(Cancelled):
        table(degrees(), check=stop)


@pytest.mark.parametrize(
    "text, words",
    (
        ("", "has no fields that say where its points are: name them longitude, latitude and height"),
        ("a,b\n1,2\n", "has no fields that say where its points are"),
        ("lon,lat\n1,2\n", "has no fields that say where its points are"),
        ("lon,lat,h\n1,north,3\n", "row 2: the field 'lat' is 'north', which is not a number"),
        (
            "lon;lat;h\n3;36,15;1\n3;36.15;1\n",
            r"has numbers with a decimal comma \(row 2\) and with a point \(row 3\): write all decimals alike",
        ),
        ("lon,lat,h\n3,36.15,1_000\n", "row 2: the field 'h' is '1_000', which is not a number"),
        ("lon,lat,h\n3,36.15,1\n3,36.15,x\n", "row 3: the field 'h' is 'x', which is not a number"),
        ("geometry,h_mean\nPOLYGON(),3\n", r"row 2: its geometry is 'POLYGON\(\)', not a point"),
        ("geometry,h_mean\nPOINT (1-2 3),3\n", "row 2: its geometry is 'POINT .*, not a point"),
    ),
)
def test_wrong_tables_are_a_sentence(table, text, words):
    with pytest.raises(InputTableError, match=words) as caught:
        table(text)
    assert "points.csv'" in str(caught.value)


def test_too_much_and_nothing(table, tmp_path, monkeypatch):
    with pytest.raises(OverlapError, match="has no heights over the scene"):
        table("lon,lat,h\n10,20,3\n")
    with pytest.raises(OverlapError, match="has no heights over the scene"):
        table("lon,lat,h\n")
    monkeypatch.setattr(points, "_LIMITS", points.Limits(1 << 20, 2, "fewer"))
    with pytest.raises(InputTableError, match="has more than 2 rows: choose fewer, or a part of it"):
        table(degrees())
    monkeypatch.setattr(points, "_LIMITS", points.Limits(10, 2, "fewer"))
    with pytest.raises(InputTableError, match="at most 0 MiB: choose fewer"):
        table(degrees())
    with pytest.raises(InputTableError, match="Cannot read the table .*: give a CSV file in UTF-8"):
        read_points_of_table(str(tmp_path / "missing.csv"), UTM, BOUNDS)


# Layers -----------------------------------------------------------------------------------------------------------


def layer(path, crs=UTM, kind=ogr.wkbPoint25D, fields=None, places=XY, heights=HEIGHTS, values=((), (), ())):
    def features():
        for place, height, row in zip(places, heights, values):
            point = ogr.Geometry(kind)
            point.AddPoint(*map(float, place), float(height)) if height is not None else point.AddPoint_2D(
                *map(float, place)
            )
            yield point, row

    return write_layer(str(path), crs, kind, fields or {}, features())


@pytest.mark.parametrize("name", ("points.gpkg", "points.shp", "points.fgb"))
def test_points_with_heights_in_every_format(tmp_path, name):
    path = layer(tmp_path / name, places=[*XY.tolist(), *FAR], heights=[*HEIGHTS, 5.0], values=((),) * 4)
    found = read_points_of_layer(path, "", UTM, BOUNDS)
    order = np.argsort(found.height)  # FlatGeobuf has an order of its own
    np.testing.assert_allclose(found.xy[order], XY[np.argsort(HEIGHTS)], atol=1e-6)
    assert found.height[order].tolist() == sorted(HEIGHTS) and found.width_m == (0.0, 0.0) and found.datum is None


def test_the_layers_crs_says_places_unit_and_datum(tmp_path):
    path = layer(tmp_path / "points.gpkg", crs="EPSG:4979", places=LON_LAT)
    found = read_points_of_layer(path, "", UTM, BOUNDS)
    np.testing.assert_allclose(found.xy, XY, atol=1e-3)
    assert found.datum.code == "" and found.height.tolist() == HEIGHTS
    feet = layer(tmp_path / "feet.gpkg", crs="EPSG:32631+6360")
    found = read_points_of_layer(feet, "", UTM, BOUNDS)
    np.testing.assert_allclose(found.height, np.array(HEIGHTS) * 1200 / 3937)
    assert found.datum.code == "EPSG:6360" and found.places_in is None


def test_fields_of_lasers_count_more_than_points_heights(tmp_path):
    fields, values = {"h_mean": float, "height": float}, [(h + 100, 0.0) for h in HEIGHTS]
    path = layer(tmp_path / "sliderule.gpkg", "EPSG:4326", fields=fields, places=LON_LAT, values=values)
    found = read_points_of_layer(path, "", UTM, BOUNDS)
    assert found.height.tolist() == [h + 100 for h in HEIGHTS] and found.width_m == (12, 40) and found.datum.code == ""


def test_a_field_of_heights_where_points_have_none(tmp_path):
    values = [(h,) for h in HEIGHTS]
    path = layer(tmp_path / "flat.gpkg", kind=ogr.wkbPoint, fields={"Z": float}, heights=[None] * 3, values=values)
    found = read_points_of_layer(path, "", UTM, BOUNDS)
    assert found.height.tolist() == HEIGHTS and found.datum is None
    bare = layer(tmp_path / "bare.gpkg", kind=ogr.wkbPoint, heights=[None] * 3)
    with pytest.raises(InputTableError, match="have no heights: give points with Z, or a field 'height'"):
        read_points_of_layer(bare, "", UTM, BOUNDS)


def test_layers_that_cannot_be_used(tmp_path):
    def features():
        yield ogr.CreateGeometryFromWkt("LINESTRING Z (0 0 1, 1 1 2)"), ()

    lines = write_layer(str(tmp_path / "lines.gpkg"), UTM, ogr.wkbLineString25D, {}, features())
    with pytest.raises(InputTableError, match="does not hold points: choose a layer of points or a raster"):
        read_points_of_layer(lines, "", UTM, BOUNDS)
    shape = layer(tmp_path / "points.shp")
    (tmp_path / "points.prj").unlink()
    with pytest.raises(InputTableError, match="has no coordinate reference system: assign it one first"):
        read_points_of_layer(shape, "", UTM, BOUNDS)
    with pytest.raises(InputTableError, match="has no layer 'b': choose an existing one"):
        read_points_of_layer(lines, "b", UTM, BOUNDS)


@pytest.mark.parametrize("raises", (False, True))
def test_a_layer_that_is_cut_short_is_a_sentence_and_not_fewer_points(tmp_path, raises):
    """Whether GDAL raises or not, which any module of a process may choose for all."""
    before = gdal.GetUseExceptions()
    (gdal.UseExceptions if raises else gdal.DontUseExceptions)()
    try:
        require_whole_layer(tmp_path)
    finally:
        (gdal.UseExceptions if before else gdal.DontUseExceptions)()


def require_whole_layer(tmp_path):
    count = 2000
    many = np.column_stack([np.linspace(500_100, 501_900, count), np.linspace(4_000_100, 4_001_900, count)])
    path = layer(tmp_path / "points.fgb", places=many, heights=np.arange(count), values=((),) * count)
    assert len(read_points_of_layer(path, "", UTM, BOUNDS).height) == count
    with open(path, "r+b") as stream:
        stream.truncate(150_000)
    with pytest.raises(InputTableError, match=r"Cannot read the points of '.*points\.fgb' .*: get the file again"):
        read_points_of_layer(path, "", UTM, BOUNDS)
