"""Buildings of surfaces with known houses, from files to files: footprints, heights, roofs and solids."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.buildings.regularisation import regular
from repm_qgis.contracts.errors import Cancelled, ImageError, OptionError, OverlapError
from repm_qgis.geometry.vertical import ELLIPSOID, TAG
from repm_qgis.imagery import raster
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage
from tests.engine.buildings.cityjson_checks import checked, volume

TOOL = Path(__file__).resolve().parents[3] / "dist" / "cityjson" / "tool"
CELL, SIDE = 0.5, 300
WEST, NORTH = 500000.0, 4800000.0
PLACE = (WEST, CELL, 0.0, NORTH, 0.0, -CELL)


@dataclass(frozen=True)
class House:
    """A house around a place (m east and south of the corner), turned by an angle, with half sides (m) along and across
    it: heights of the eaves above the floor, and of the roof as a function of the places along and across."""

    kind: str
    place: tuple
    turned_deg: float
    half: tuple
    eaves: float
    roof: object = staticmethod(lambda u, v, half: 0 * u)
    area: float = 0.0
    mean_roof: float = 0.0  # of the roof above the eaves, over the footprint
    planes: int = 1

    def axes(self):
        rows, columns = (np.indices((SIDE, SIDE)) + 0.5) * CELL
        x, y, turn = columns - self.place[0], self.place[1] - rows, math.radians(self.turned_deg)
        return x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)

    def inside(self):
        u, v = self.axes()
        return (abs(u) <= self.half[0]) & (abs(v) <= self.half[1])


def gable(u, v, half, pitch=0.7):
    return pitch * (half[1] - abs(v))


def hip(u, v, half, pitch=0.7):
    return pitch * np.minimum(half[1] - abs(v), half[0] - abs(u))


def shed(u, v, half, pitch=0.4):
    return pitch * (v + half[1])


HOUSES = (
    House("flat", (30, 30), 0, (10, 7), 8.0, area=280.0),
    House("gable", (75, 30), 25, (11, 6), 6.0, gable, 264.0, 0.7 * 6 / 2, 2),
    House("hip", (120, 30), -15, (12, 7), 6.0, hip, 336.0, 0.7 * (7 / 2 - 7 * 7 / 6 / 12), 4),
    House("shed", (30, 75), 40, (9, 6), 5.0, shed, 216.0, 0.4 * 6),
)
TOLERANCE_M2 = 0.06  # of areas: half a cell all around


def written(path, bands, place=PLACE, crs="EPSG:32631", **facts):
    facts = {"metadata": {TAG: ELLIPSOID}, "unit": "m", **facts}
    return raster.write(str(path), [np.asarray(band, np.float32) for band in bands], place, crs, **facts)


def ground(slope=0.0):
    return 100.0 + slope * np.broadcast_to(np.arange(SIDE) * CELL, (SIDE, SIDE))


def built(base, houses=HOUSES, noise=0.05):
    """A surface with houses whose floors are the highest ground below each of them."""
    surface = base.copy()
    for house in houses:
        inside = house.inside()
        u, v = house.axes()
        top = base[inside].max() + house.eaves + house.roof(u, v, house.half)
        surface = np.where(inside, top, surface)
    return surface + np.random.default_rng(3).normal(0, noise, surface.shape)


def made(folder, surface, base, **options):
    """The results of the stage, the fields of the buildings with their outlines, and the solids of the CityJSON."""
    os.makedirs(folder, exist_ok=True)
    given = {
        "dsm": written(folder / "dsm.tif", [surface]),
        "dtm": written(folder / "dtm.tif", [base]),
        "output": str(folder / "b.gpkg"),
        "cityjson": str(folder / "b.city.json"),
        "report": str(folder / "b.html"),
        **options,
    }
    result = run_stage("buildings", given, Silent())
    source = ogr.Open(str(folder / "b.gpkg"))
    found = [(feature.items(), feature.GetGeometryRef().Clone()) for feature in source.GetLayer(0)]
    return result, found, checked(given["cityjson"])


def at(found, place):
    """The building on a place (m east and south of the corner)."""
    point = ogr.Geometry(ogr.wkbPoint)
    point.AddPoint_2D(WEST + place[0], NORTH - place[1])
    return next((fields, shape) for fields, shape in found if shape.Contains(point))


@pytest.fixture(scope="module")
def village(tmp_path_factory):
    base = ground()
    return made(tmp_path_factory.mktemp("village"), built(base), base)


@pytest.mark.parametrize("house", HOUSES, ids=lambda house: house.kind)
def test_outline_height_and_volume_are_those_of_the_house(village, house):
    result, found, (_, solids) = village
    assert result.n_buildings == len(found) == len(HOUSES)
    fields, shape = at(found, house.place)
    assert shape.GetArea() == pytest.approx(house.area, rel=TOLERANCE_M2) and shape.IsValid()
    assert shape.GetGeometryRef(0).GetPointCount() == 5, "four straight walls"
    corners = np.array(shape.GetGeometryRef(0).GetPoints())[:, :2]
    along = np.diff(corners, axis=0)
    off = (np.degrees(np.arctan2(along[:, 1], along[:, 0])) - house.turned_deg + 45) % 90 - 45
    assert np.abs(off).max() < 2.0
    u, v = house.axes()
    roof = house.eaves + house.roof(u, v, house.half)[house.inside()]
    assert fields["height_m"] == pytest.approx(np.median(roof), abs=0.15)
    assert fields["ground_m"] == pytest.approx(100.0, abs=0.01)
    assert fields["eave_m"] - 100 == pytest.approx(np.percentile(roof, 5), abs=0.6)
    assert fields["ridge_m"] - 100 == pytest.approx(np.percentile(roof, 95), abs=0.3)
    assert 0.03 <= fields["error_m"] <= 0.2 and fields["measured"] == 1.0
    assert fields["roof"] == house.kind and fields["planes"] == house.planes
    solid = solids[f"building-{fields['id']}"]
    assert set(solid) == ({"1.2"} if house.kind == "flat" else {"1.2", "2.2"})
    finest = solid[max(solid)]
    wanted = house.area * (house.eaves + house.mean_roof)
    assert volume(finest) == pytest.approx(wanted, rel=0.07)
    assert fields["volume_m3"] == pytest.approx(volume(finest), rel=1e-3)
    assert volume(solid["1.2"]) == pytest.approx(shape.GetArea() * fields["height_m"], rel=1e-3)


def test_a_house_that_a_gap_cuts_is_named(tmp_path):
    """A gap over the western third of a house: the rest cannot tell where the house ends."""
    base, house = ground(), HOUSES[0]
    surface = built(base, [house])
    surface[:, : int((house.place[0] - house.half[0] / 3) / CELL)] = np.nan
    result, found, _ = made(tmp_path, surface, base)
    fields, _ = at(found, house.place)
    assert fields["area_m2"] < 0.75 * house.area and 0.15 < fields["gaps"] < 0.3  # its western wall
    assert "may be larger than stated" in (tmp_path / "b.html").read_text(encoding="utf-8")


def test_houses_without_gaps_are_not_named(village):
    _, found, _ = village
    assert all(fields["gaps"] == 0 for fields, _ in found)


def test_roofs_have_their_slopes(village):
    _, found, (city, _) = village
    fields, _ = at(found, HOUSES[1].place)
    solid = next(s for s in city["CityObjects"][f"building-{fields['id']}"]["geometry"] if s["lod"] == "2.2")
    roofs = [surface for surface in solid["semantics"]["surfaces"] if surface["type"] == "RoofSurface"]
    assert [roof["slope_deg"] for roof in roofs] == pytest.approx([math.degrees(math.atan(0.7))] * 2, abs=1.5)
    faces = sorted(roof["faces_deg"] % 360 for roof in roofs)
    assert faces == pytest.approx([155.0, 335.0], abs=3), "across the ridge, which runs 25 degrees north of east"


def test_the_file_says_its_reference_systems(village):
    _, _, (city, _) = village
    assert city["metadata"]["referenceSystem"] == "https://www.opengis.net/def/crs/EPSG/0/32631"
    assert {each["attributes"]["heights_above"] for each in city["CityObjects"].values()} == {ELLIPSOID}


def test_the_validator_of_cityjson_finds_nothing(village, tmp_path):
    program = shutil.which("cjval") or shutil.which("cjval", path=str(TOOL / "bin"))
    if program is None:
        pytest.skip("needs CityJSON's validator cjval: run 'make cityjson-tools', which needs Rust's cargo")
    city = village[2][0]
    assert any(solid["lod"] == "2.2" for each in city["CityObjects"].values() for solid in each["geometry"])
    report = validated(program, city, tmp_path)
    assert report["valid"] and not report["has_warnings"], report["checks"]
    city = json.loads(json.dumps(city))
    city["CityObjects"]["building-1"]["geometry"][0]["boundaries"][0][0][0][0] = len(city["vertices"])
    assert not validated(program, city, tmp_path)["valid"], "it finds a corner that is not there"


def validated(program, city, folder):
    """What cjval says about a city."""
    path = folder / "city.json"
    path.write_text(json.dumps(city), encoding="utf-8")
    done = subprocess.run([program, str(path), "--report"], capture_output=True, encoding="utf-8", check=True)
    return json.loads(done.stdout)


def test_a_compound_reference_system_has_its_own_code(tmp_path):
    base, place = ground(), (155000.0, CELL, 0.0, 463000.0, 0.0, -CELL)  # in the Netherlands
    dsm = written(tmp_path / "dsm.tif", [built(base, HOUSES[:1])], place, crs="EPSG:7415", metadata={})
    dtm = written(tmp_path / "dtm.tif", [base], place, crs="EPSG:7415", metadata={})
    city = str(tmp_path / "b.json")
    run_stage("buildings", {"dsm": dsm, "dtm": dtm, "output": str(tmp_path / "b.gpkg"), "cityjson": city}, Silent())
    assert checked(city)[0]["metadata"]["referenceSystem"].endswith("/EPSG/0/7415")


def test_an_l_shape_and_a_courtyard_keep_their_corners(tmp_path):
    base, surface = ground(), ground().copy()
    surface[60:120, 60:160] = 109.0
    surface[60:120, 110:160] = 100.0
    surface[60:84, 60:160] = 109.0  # an L of 50 x 12 and 25 x 18 m
    surface[160:240, 60:160], surface[180:220, 85:135] = 112.0, 100.0
    _, found, (_, solids) = made(tmp_path, surface, base)
    fields, shape = at(found, (35, 35))
    assert shape.GetGeometryRef(0).GetPointCount() == 7 and shape.GetArea() == pytest.approx(
        50 * 12 + 25 * 18, rel=0.02
    )
    assert volume(solids[f"building-{fields['id']}"]["1.2"]) == pytest.approx(9 * 1050, rel=0.02)
    fields, shape = at(found, (35, 85))
    assert shape.GetGeometryCount() == 2 and shape.GetArea() == pytest.approx(50 * 40 - 25 * 20, rel=0.02)
    assert volume(solids[f"building-{fields['id']}"]["1.2"]) == pytest.approx(12 * 1500, rel=0.02)
    assert len(found) == 2


def test_a_tower_on_a_hall_is_a_building_of_its_own_and_leaves_no_gap(tmp_path):
    base, surface = ground(), ground().copy()
    surface[80:180, 60:200] = 110.0
    surface[110:150, 60:100] = 130.0
    _, found, _ = made(tmp_path, surface, base)
    assert sorted(round(fields["height_m"]) for fields, _ in found) == [10, 30]
    (hall, tower) = sorted((shape for _, shape in found), key=lambda shape: -shape.GetArea())
    assert tower.GetArea() == pytest.approx(20 * 20, rel=0.03)
    assert hall.GetArea() + tower.GetArea() == pytest.approx(50 * 70, rel=0.02)
    assert hall.Intersection(tower).GetArea() < 0.01
    assert hall.Union(tower).GetArea() == pytest.approx(50 * 70, rel=0.02) and hall.Touches(tower)


def test_floors_reach_the_lowest_ground_of_a_slope(tmp_path):
    base = ground(0.15)
    house = HOUSES[0]
    _, found, (_, solids) = made(tmp_path, built(base, [house]), base)
    fields, _ = at(found, house.place)
    lowest, highest = base[house.inside()].min(), base[house.inside()].max()
    assert fields["ground_m"] == pytest.approx(lowest, abs=0.2)
    assert fields["height_m"] == pytest.approx(highest + house.eaves - lowest, abs=0.25)
    solid = solids[f"building-{fields['id']}"]["1.2"]
    assert min(ring[:, 2].min() for _, rings in solid for ring in rings) == pytest.approx(fields["ground_m"], abs=0.002)


def with_tree(surface, base, place=(57.0, 30.0), radius=5.0, tall=7.0):
    """A crown that touches the flat house: half an ellipsoid with a rough skin."""
    rows, columns = (np.indices(surface.shape) + 0.5) * CELL
    away = np.hypot(columns - place[0], rows - place[1]) / radius
    rough = np.random.default_rng(8).normal(0, 1.2, surface.shape)
    crown = base + 2 + tall * np.sqrt(np.maximum(1 - away**2, 0)) + rough
    return np.where(away < 1, np.maximum(crown, surface), surface), away < 1


def test_a_rough_crown_is_no_building(tmp_path):
    base = ground()
    surface, tree = with_tree(built(base, HOUSES[:1]), base)
    _, found, _ = made(tmp_path, surface, base)
    assert len(found) == 1 and found[0][1].GetArea() == pytest.approx(280, rel=TOLERANCE_M2)
    assert tree.any()


def test_near_infrared_tells_a_smooth_crown_beside_a_house(tmp_path):
    base = ground()
    house = built(base, HOUSES[:1])
    tree = with_tree(house, base, (44.5, 30.0))[1] & ~HOUSES[0].inside()
    surface = np.where(tree, base + 6.5, house)  # as flat as a roof
    without = made(tmp_path / "a", surface, base)[1]
    bands = [np.full(tree.shape, 90.0)] * 3 + [np.where(tree, 400.0, 100.0)]
    ortho = written(tmp_path / "ortho.tif", bands, descriptions=("red", "green", "blue", "near infrared"))
    with_it = made(tmp_path / "b", surface, base, ortho=ortho)[1]
    areas = [sum(shape.GetArea() for _, shape in found) for found in (without, with_it)]
    assert areas[0] > 280 + 45 and areas[1] == pytest.approx(280, rel=0.08)


def test_an_orthophoto_without_infrared_is_said_to_tell_nothing(tmp_path):
    class Heard(Silent):
        said: list[str] = []

        def info(self, text):
            self.said.append(text)

    base = ground()
    dsm, dtm = written(tmp_path / "dsm.tif", [built(base)]), written(tmp_path / "dtm.tif", [base])
    ortho = written(tmp_path / "ortho.tif", [base])
    given = {"dsm": dsm, "dtm": dtm, "ortho": ortho, "output": str(tmp_path / "b.gpkg")}
    run_stage("buildings", given, Heard())
    assert any("names no near infrared band" in text for text in Heard.said)


def test_the_stated_error_is_that_of_the_confidence_and_of_the_ground(tmp_path):
    base, house = ground(), HOUSES[0]
    surface = built(base, [house], noise=0.2)
    confidence = written(tmp_path / "confidence.tif", [np.full(base.shape, 0.6)])
    _, found, _ = made(tmp_path, surface, base, confidence=confidence)
    assert found[0][0]["error_m"] == pytest.approx(math.hypot(0.6, 0.2), rel=0.1)


@pytest.mark.parametrize("expected_m, lod", [(0.3, 2), (3.0, 1)])
def test_a_slope_within_the_expected_error_is_no_roof(tmp_path, expected_m, lod):
    base, house = ground(), HOUSES[3]
    error = np.where(house.inside(), expected_m, 0.1)  # the slope's heights are spread by 1.8 m
    confidence = written(tmp_path / "confidence.tif", [error])
    _, found, (_, solids) = made(tmp_path, built(base, [house]), base, confidence=confidence)
    assert [fields["lod"] for fields, _ in found] == [lod]
    assert set(solids["building-1"]) == ({"1.2", "2.2"} if lod == 2 else {"1.2"})


def test_the_terrain_is_made_where_none_is_given(tmp_path):
    base = ground(0.02)
    _, found, _ = made(tmp_path, built(base), base, dtm=None)
    assert len(found) == len(HOUSES)
    for house in HOUSES:
        fields, _ = at(found, house.place)
        assert fields["ground_m"] == pytest.approx(base[house.inside()].min(), abs=0.4)


@pytest.mark.parametrize("given", (False, True))
def test_hillsides_are_no_good_buildings(tmp_path, told, given):
    """A ramp of 100 % is a building of its own, or with a terrain that cuts it, and the report said "Good."."""
    base = ground(0.0) + np.indices((SIDE, SIDE))[1] * CELL * np.ones((SIDE, SIDE))
    terrain = written(tmp_path / "cut.tif", [np.minimum(base, base.min() + 40)]) if given else None
    said, report = told(), tmp_path / "page.html"
    options = {"dsm": written(tmp_path / "dsm.tif", [base]), "dtm": terrain, "report": str(report)}
    result = run_stage("buildings", {**options, "output": str(tmp_path / "b.gpkg")}, said)
    assert result.n_buildings
    (finding,) = (each for each in said.warnings if each.id == "buildings-hillsides")
    assert "surfaces steeper than 40 % that no walls bound" in finding and "Good." not in report.read_text("utf-8")


@pytest.mark.long
def test_blocks_change_no_byte(tmp_path):
    from dataclasses import replace

    from repm_qgis.stages.parameters import ENGINE

    base = ground()
    dsm, dtm = written(tmp_path / "dsm.tif", [built(base)]), written(tmp_path / "dtm.tif", [base])
    files = []
    for side in (1024, 64, 1024):
        small = replace(ENGINE, buildings=replace(ENGINE.buildings, block_cells=side))
        path = tmp_path / f"{len(files)}.json"
        given = {"dsm": dsm, "dtm": dtm, "output": str(tmp_path / "b.gpkg"), "cityjson": str(path)}
        run_stage("buildings", given, Silent(), small)
        files.append(path.read_bytes())
    assert files[0] == files[1] == files[2]


def test_nothing_found_is_said_and_gives_empty_files(tmp_path):
    class Heard(Silent):
        warned: list[str] = []

        def warn(self, text):
            self.warned.append(text)

    base = ground()
    given = {"dsm": written(tmp_path / "dsm.tif", [base]), "dtm": written(tmp_path / "dtm.tif", [base])}
    given.update(output=str(tmp_path / "b.gpkg"), cityjson=str(tmp_path / "b.json"), report=str(tmp_path / "b.html"))
    result = run_stage("buildings", given, Heard())
    assert result.n_buildings == 0 and any("No building of at least 2.5 m" in text for text in Heard.warned)
    assert ogr.Open(given["output"]).GetLayer(0).GetFeatureCount() == 0
    city, solids = checked(given["cityjson"])
    assert city["CityObjects"] == {} and city["vertices"] == [] and solids == {}
    assert "No building of at least 2.5 m" in (tmp_path / "b.html").read_text(encoding="utf-8")


def test_what_cannot_be_used_is_refused_in_a_sentence(tmp_path):
    base = ground()
    dsm = written(tmp_path / "dsm.tif", [built(base)])
    dtm = written(tmp_path / "dtm.tif", [base])
    far = written(tmp_path / "far.tif", [base], place=(600000.0, CELL, 0.0, 4900000.0, 0.0, -CELL))
    degrees = written(tmp_path / "degrees.tif", [base], (2.0, 1e-5, 0, 43.0, 0, -1e-5), "EPSG:4326")
    turned = written(tmp_path / "turned.tif", [base], (WEST, 0.4, 0.3, NORTH, 0.3, -0.4))
    small = written(tmp_path / "small.tif", [base[:50]])
    web = written(tmp_path / "web.tif", [base], (334000.0, CELL, 0.0, 5621500.0, 0.0, -CELL), "EPSG:3857")
    feet = written(tmp_path / "feet.tif", [base], (6e6, CELL, 0.0, 2e6, 0.0, -CELL), "EPSG:2225")
    for error, text, options in (
        (ImageError, "reproject it first", {"dsm": degrees, "dtm": dtm}),
        (ImageError, "do not run east and south", {"dsm": turned, "dtm": dtm}),
        (ImageError, "do not run east and south in metres", {"dsm": feet, "dtm": dtm}),
        (ImageError, "up to 1.4. m in the coordinate reference system of '.*web.tif': use .* EPSG:32631", {"dsm": web}),
        (ImageError, "does not have the cells of the DSM", {"dsm": dsm, "dtm": dtm, "confidence": small}),
        (OverlapError, "do not overlap", {"dsm": dsm, "dtm": far}),
        (OverlapError, "leave ORTHO empty", {"dsm": dsm, "dtm": dtm, "ortho": far}),
        (ImageError, "it does not exist", {"dsm": dsm, "dtm": str(tmp_path / "none.tif")}),
        (OptionError, "must end with .json", {"dsm": dsm, "cityjson": str(tmp_path / "b.xml")}),
        (OptionError, "MIN_HEIGHT", {"dsm": dsm, "min_height": 0}),
    ):
        with pytest.raises(error, match=text):
            run_stage("buildings", {"output": str(tmp_path / "b.gpkg"), **options}, Silent())
    assert not (tmp_path / "b.gpkg").exists()


def test_a_run_that_is_cancelled_leaves_nothing(tmp_path):
    class Impatient(Silent):
        def step(self, fraction, text=""):
            if "roofs" in text:
                raise Cancelled

    base = ground()
    given = {"dsm": written(tmp_path / "dsm.tif", [built(base)]), "dtm": written(tmp_path / "dtm.tif", [base])}
    with pytest.raises(Cancelled):
        run_stage("buildings", {**given, "output": str(tmp_path / "b.gpkg")}, Impatient())
    assert sorted(os.listdir(tmp_path)) == ["dsm.tif", "dtm.tif"]


def test_the_layer_has_its_style_and_the_report_its_table(village, tmp_path):
    base = ground()
    made(tmp_path, built(base), base)
    assert "graduatedSymbol" in (tmp_path / "b.qml").read_text(encoding="utf-8")
    page = (tmp_path / "b.html").read_text(encoding="utf-8")
    assert "<table" in page and "data:image/png" in page and "gable" in page
    assert json.loads((tmp_path / "b.city.json").read_text(encoding="utf-8"))["metadata"]["title"]
    assert gdal.OpenEx(str(tmp_path / "b.gpkg"), gdal.OF_VECTOR) is not None


def test_a_strip_that_simplification_leaves_two_corners_of_stays_as_it_is():
    """A roof part of one row of cells ended in an IndexError (block 0073 of whu_tlc)."""
    strip = ogr.CreateGeometryFromWkt("POLYGON ((0 0, 30 0, 30 0.5, 0 0.5, 0 0))")
    made = regular(strip, 5.0)
    assert made.IsValid() and made.GetArea() == pytest.approx(15.0)
