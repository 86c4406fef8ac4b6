"""Ground control: what is read, what is refused and in which words, and where images put a point."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from osgeo import ogr, osr
from pyproj.transformer import TransformerGroup

from repm_qgis.contracts.errors import InputTableError, OptionError
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.geometry.vertical import vertical_crs
from repm_qgis.pointing.ground_control import Gcp, intersect, read_gcps

HEADER = "id,lon,lat,height,view,col,row,role"


@pytest.fixture
def table(tmp_path):
    """table(*rows, header, encoding, name): the path of a CSV file."""

    def write(*rows, header=HEADER, encoding="utf-8", name="gcps.csv"):
        path = tmp_path / name
        path.write_text("\n".join([header, *rows]) + "\n", encoding=encoding)
        return str(path)

    return write


def refused(path, views, *words, kind=InputTableError, datum=None):
    with pytest.raises(kind) as caught:
        read_gcps(path, views, datum)
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".")
    for word in words:
        assert word in text, text


def test_the_truth_scenes_points_are_read_whole(urban):
    gcps = read_gcps(urban.made.gcps, urban.views)
    lines = [line.split(",") for line in open(urban.made.gcps, encoding="utf-8").read().split()[1:]]
    assert {(gcp.id, f"{name}") for gcp in gcps for name in gcp.pixels} == {(line[0], line[4]) for line in lines}
    assert len(gcps) == urban.record["gcp_points"] >= 8
    assert {gcp.role for gcp in gcps} == {"control", "check"}
    for gcp in gcps:
        assert len(gcp.pixels) >= 2
        for view, true in zip(urban.views, urban.true_views):
            if view.name in gcp.pixels:  # 0.3 px of noise
                assert np.abs(true.project(gcp.lon_lat_h) - gcp.pixels[view.name]).max() < 1.5


def test_a_table_with_bom_capitals_and_no_role(urban, table):
    path = table(
        "A,1.44,43.6,190.5,img_01.tif,10.25,20.5",
        " B ,1.45,43.61,191,,,",
        header="ID,Lon,LAT,height,view,col,row",
        encoding="utf-8-sig",
    )
    first, second = read_gcps(path, urban.views)
    assert (first.id, first.lon, first.lat, first.height, first.role) == ("A", 1.44, 43.6, 190.5, "control")
    np.testing.assert_array_equal(first.pixels["img_01"], [10.25, 20.5])
    assert second.id == "B" and second.pixels == {}


@pytest.mark.parametrize("alias", ("img_02", "img_02.tif"))
def test_a_view_goes_by_its_file_with_or_without_extension(urban, table, alias):
    (gcp,) = read_gcps(table(f"A,1.44,43.6,190,{alias},1,2,check"), urban.views)
    assert list(gcp.pixels) == ["img_02"] and gcp.role == "check"


@pytest.mark.parametrize(
    ("rows", "words"),
    (
        (["A,1.44,43.6,high,img_01,1,2,control"], ("row 2", "'height' is 'high'", "not a number")),
        (["A,1.44,43.6,190,img_01,1,,control"], ("row 2", "'row' is ''")),
        (["A,1.44,43.6,190,img_01,1,nan,control"], ("row 2", "'row' is 'nan'")),
        (
            ["A,1.44,43.6,190,img_09.tif,1,2,control"],
            ("img_09.tif", "none of the images (img_01, img_02, img_03)"),
        ),
        (
            ["A,1.44,43.6,190,,,,control", "A,1.4401,43.6,190,img_01,1,2,control"],
            ("row 3", "'A'", "another place or role"),
        ),
        (["A,1.44,43.6,190,,,,control", "A,1.44,43.6,190,img_01,1,2,check"], ("row 3", "another place or role")),
        (
            ["A,1.44,43.6,190,img_01,1,2,", "A,1.44,43.6,190,img_01.tif,1,3,"],
            ("row 3", "another pixel in 'img_01.tif'"),
        ),
        ([",1.44,43.6,190,img_01,1,2,control"], ("row 2", "'id' is empty")),
        (["A,43.6,144,190,img_01,1,2,control"], ("row 2", "latitude 144", "degrees")),
        (["A,1.44,43.6,190,img_01,1,2,tie"], ("role of point 'A' is 'tie'", "control or check")),
        ([], ("holds no point",)),
    ),
)
def test_what_is_wrong_is_said_with_its_row(urban, table, rows, words):
    refused(table(*rows), urban.views, "gcps.csv", *words)


def test_measurements_in_other_images_are_left_out_and_told(urban, table):
    said = []
    path = table(
        "A,1.44,43.6,190,img_01,1,2,control",
        "A,1.44,43.6,190,other,3,4,control",
        "A,1.44,43.6,190,another.tif,5,,control",
        "B,1.45,43.6,190,other,7,8,check",
    )
    first, second = read_gcps(path, urban.views, None, said.append)
    assert list(first.pixels) == ["img_01"] and second.pixels == {}
    (text,) = said
    for words in ("gcps.csv", "3 measurements", "(other, another.tif)", "those in img_01, img_02, img_03 are used"):
        assert words in text
    read_gcps(table("A,1.44,43.6,190,img_01,1,2,"), urban.views, None, said.append)
    assert len(said) == 1


def test_missing_fields_and_files(urban, table, tmp_path):
    refused(table("A,1", header="id,lon"), urban.views, "lacks the fields lat, height", "id, lon, lat")
    refused(str(tmp_path / "gone.csv"), urban.views, "gone.csv", "No such file")
    refused(str(tmp_path / "gone.gpkg"), urban.views, "gone.gpkg", "give a CSV file or a point layer")
    (tmp_path / "latin.csv").write_bytes(b"id,lon,lat,height\n\xe9,1,2,3\n")
    refused(str(tmp_path / "latin.csv"), urban.views, "latin.csv", "UTF-8")


def layer(path, crs, points, fields=("id", "height", "view", "col", "row"), name="points", append=False):
    """A point layer; ``points`` are x, y and the fields' values."""
    driver = ogr.GetDriverByName("GPKG")
    source = ogr.Open(str(path), 1) if append else driver.CreateDataSource(str(path))
    reference = osr.SpatialReference()
    reference.SetFromUserInput(crs)
    made = source.CreateLayer(name, reference, ogr.wkbPoint)
    for field in fields:
        made.CreateField(ogr.FieldDefn(field, ogr.OFTString if field in ("id", "view", "role") else ogr.OFTReal))
    for x, y, *values in points:
        feature = ogr.Feature(made.GetLayerDefn())
        for field, value in zip(fields, values):
            feature[field] = value
        point = ogr.Geometry(ogr.wkbPoint)
        point.AddPoint_2D(x, y)
        feature.SetGeometry(point)
        made.CreateFeature(feature)
        feature = None
    made = source = None  # noqa: F841
    return str(path)


def test_a_layers_place_is_its_geometry_in_whatever_crs(urban, tmp_path):
    x, y = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32631", always_xy=True).transform(1.44, 43.6)
    path = layer(
        tmp_path / "utm.gpkg",
        "EPSG:32631",
        [(x, y, "A", 190.0, "img_01.tif", 3.0, 4.0), (x, y, "A", 190.0, "img_02.tif", 5.0, 6.0)],
    )
    (gcp,) = read_gcps(path, urban.views)
    assert (gcp.lon, gcp.lat) == pytest.approx((1.44, 43.6), abs=1e-9)
    np.testing.assert_array_equal(gcp.pixels["img_02"], [5.0, 6.0])


def test_a_layer_with_half_a_place_in_its_fields_has_that_of_its_geometry(urban, tmp_path):
    path = layer(tmp_path / "half.gpkg", "EPSG:4326", [(1.44, 43.6, "A", 190.0, 99.0)], fields=("id", "height", "lon"))
    (gcp,) = read_gcps(path, urban.views)
    assert (gcp.lon, gcp.lat) == pytest.approx((1.44, 43.6), abs=1e-9)


def test_one_layer_of_several_goes_by_its_name_as_qgis_writes_it(urban, tmp_path):
    path = layer(tmp_path / "two.gpkg", "EPSG:4326", [(1.0, 43.0, "other", 1.0, "", 0.0, 0.0)])
    layer(path, "EPSG:4326", [(1.44, 43.6, "A", 190.0, "", 0.0, 0.0)], name="gcps", append=True)
    assert [gcp.id for gcp in read_gcps(path, urban.views)] == ["other"]
    assert [gcp.id for gcp in read_gcps(f"{path}|layername=gcps", urban.views)] == ["A"]
    refused(f"{path}|layername=none", urban.views, "has no layer 'none'")


def test_a_layer_without_heights_is_refused(urban, tmp_path):
    path = layer(tmp_path / "flat.gpkg", "EPSG:4326", [(1.44, 43.6, "A")], fields=("id",))
    refused(path, urban.views, "lacks the field height")


def test_without_views_only_places_are_read(table):
    (gcp,) = read_gcps(table("A,1.44,43.6,190,of another scene,x,y,check"), None)
    assert gcp.pixels == {} and gcp.height == 190


@pytest.mark.parametrize("name", ("EGM96", "egm96", "EPSG:5773", "EGM96 height", "EPSG:4326+5773"))
def test_heights_above_the_geoid_become_ellipsoidal_as_pyproj_has_it(table, name):
    path = table("A,1.44,43.6,100,,,,check", "B,144.97,-37.81,20,,,,check")
    shift = pyproj.Transformer.from_crs("EPSG:4326+5773", "EPSG:4979", always_xy=True)
    if not TransformerGroup("EPSG:4326+5773", "EPSG:4979", allow_ballpark=False).transformers:
        pytest.skip("PROJ's EGM96 grid is not installed")
    gcps = read_gcps(path, None, name)
    for gcp, (lon, lat, height) in zip(gcps, ((1.44, 43.6, 100.0), (144.97, -37.81, 20.0))):
        assert gcp.height == pytest.approx(shift.transform(lon, lat, height)[2], abs=1e-6)
        assert (gcp.lon, gcp.lat) == (lon, lat)
    assert gcps[0].height == pytest.approx(149.19, abs=0.01) and gcps[1].height < 30


@pytest.mark.parametrize("name", (None, "", "ellipsoid", " Ellipsoid "))
def test_ellipsoidal_heights_stay(table, name):
    assert read_gcps(table("A,1.44,43.6,100,,,,check"), None, name)[0].height == 100.0


@pytest.mark.filterwarnings("ignore:Best transformation")
def test_a_missing_grid_is_named(table):
    path = table("A,1.44,43.6,100,,,,check")
    group = pyproj.transformer.TransformerGroup(
        pyproj.CRS("EPSG:4326+3855"), pyproj.CRS("EPSG:4979"), always_xy=True, allow_ballpark=False
    )
    if group.transformers:
        assert read_gcps(path, None, "EGM2008")[0].height == pytest.approx(149.1, abs=0.5)
    else:
        refused(
            path,
            None,
            "gcps.csv",
            "EGM2008 height",
            "put https://cdn.proj.org/us_nga_egm08_25.tif into the folder",
            datum="EGM2008",
        )
    # A geoid of Slovakia, whose grid no distribution's base package has, and that does not reach Toulouse anyway.
    refused(path, None, "gcps.csv", "EVRF2007", datum="EPSG:5621")


@pytest.mark.parametrize("name", ("geoid", "EPSG:4326", "EPSG:32631", "EPSG:9999999"))
def test_what_is_no_vertical_datum(name):
    with pytest.raises(OptionError, match=f"GCP_DATUM is '{name}': it is not a vertical CRS .* EGM96, EGM2008"):
        vertical_crs(name, "GCP_DATUM")


@pytest.fixture(params=("urban", "mountains"))
def scene(request):
    return request.getfixturevalue(request.param)


def truth_gcps(scene, count=12, noise=0.0, seed=5, role="control"):
    """Points on the true surface, as the true sensors see them."""
    from repm_qgis.geometry.frames import geodetic_from_projected

    numbers = np.random.default_rng(seed)
    rows, cols = (numbers.integers(10, n - 10, count) for n in scene.surface.shape)
    x, cell, _, y, _, _ = scene.transform
    lon_lat = geodetic_from_projected(scene.crs, np.column_stack([x + (cols + 0.5) * cell, y - (rows + 0.5) * cell]))
    return [
        Gcp(
            f"P{k}",
            *map(float, place),
            float(scene.surface[row, col]),
            role,
            {
                view.name: view.project(np.append(place, scene.surface[row, col])) + numbers.normal(0, noise, 2)
                for view in scene.true_views
            },
        )
        for k, (place, row, col) in enumerate(zip(lon_lat, rows, cols))
    ]


def test_intersecting_true_sensors_gives_the_true_place(scene):
    for gcp in truth_gcps(scene):
        assert np.abs(intersect(gcp, scene.true_views)).max() < 1e-3
        assert np.abs(intersect(gcp, scene.true_views[:2])).max() < 1e-3


def test_intersection_is_the_place_where_the_rays_meet(scene):
    """A place moved by a known vector, seen by the sensors: that vector comes back."""
    move = np.array([3.0, -2.0, 7.0])
    for gcp in truth_gcps(scene):
        frame = EnuFrame(gcp.lon, gcp.lat, gcp.height)
        seen = frame.to_geodetic(move)
        moved = Gcp(
            gcp.id, gcp.lon, gcp.lat, gcp.height, gcp.role, {view.name: view.project(seen) for view in scene.views}
        )
        np.testing.assert_allclose(intersect(moved, scene.views), move, atol=1e-3)


def test_one_image_places_nothing(urban):
    gcp = truth_gcps(urban)[0]
    assert intersect(gcp, urban.views[:1]) is None
    assert intersect(Gcp("A", 1.44, 43.6, 190.0, "check", {}), urban.views) is None
