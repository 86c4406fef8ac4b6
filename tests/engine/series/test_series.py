"""The stage on simulated surfaces: a dome that grows, a pit that is dug, and nothing elsewhere."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal, ogr, osr
from scipy import ndimage

from repm_qgis.contracts.errors import (
    EmptyResultError,
    ImageError,
    InputTableError,
    OptionError,
    OverlapError,
)
from repm_qgis.contracts.options import SeriesOptions
from repm_qgis.imagery.confidence import CONFIDENCE_BANDS
from repm_qgis.series.finding import find_series
from repm_qgis.series.parameters import SERIES
from repm_qgis.series.times import dated, periods, read_time
from repm_qgis.stages import run_stage

CELL, SIDE, PLACE = 1.0, 240, (500000.0, 5000000.0)
DAYS = ("2018-05-01", "2019-06-15", "2020-05-10", "2021-08-01", "2022-05-20", "2024-05-05")
SIGMA = (0.12, 0.2, 0.1, 0.3, 0.15, 0.12)
DUG = slice(150, 200), slice(30, 80)  # 2500 m2, 3 m deep, before the fourth date
YEARS = np.array([(read_time(day) - read_time(DAYS[0])).total_seconds() / 86400 / 365.25 for day in DAYS])
RATE = 3.0  # m per year at the dome's top


def dome():
    """A dome of 45 m radius whose top is 1."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    return np.maximum(0.0, 1 - ((x - 150) ** 2 + (y - 80) ** 2) / 45**2)


def truth(date):
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    heights = 100 + 4 * np.sin(x / 42) * np.cos(y / 34) + 2 * np.sin(x / 14 + y / 18) + RATE * YEARS[date] * dome()
    if date >= 3:
        heights[DUG] -= 3.0
    return heights


def noise(seed, sigma):
    """Errors that neighbours share, as those of matching."""
    fine = np.random.default_rng(seed).normal(0, 1, (SIDE, SIDE))
    for axis in (0, 1):
        fine = fine + np.roll(fine, 1, axis) + np.roll(fine, -1, axis)
    return sigma * fine / fine.std()


def write(path, bands, place=PLACE, cell=CELL, crs="EPSG:32631", day="", names=(), unit=""):
    bands = [np.asarray(band, np.float32) for band in bands]
    made = gdal.GetDriverByName("GTiff").Create(str(path), *bands[0].shape[::-1], len(bands), gdal.GDT_Float32)
    made.SetGeoTransform((place[0], cell, 0, place[1], 0, -cell))
    reference = osr.SpatialReference()
    reference.SetFromUserInput(crs)
    made.SetSpatialRef(reference)
    if day:
        made.SetMetadataItem("REPM_DAYS", day)
    for index, band in enumerate(bands, start=1):
        made.GetRasterBand(index).SetNoDataValue(-9999)
        made.GetRasterBand(index).WriteArray(np.where(np.isfinite(band), band, -9999))
        made.GetRasterBand(index).SetDescription(names[index - 1] if names else "")
        if unit:
            made.GetRasterBand(index).SetUnitType(unit)
    made = None  # noqa: F841
    return str(path)


def polygons(path, shapes, crs="EPSG:32631"):
    features = [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]],
            },
        }
        for name, (x0, y0, x1, y1) in shapes.items()
    ]
    document = {"type": "FeatureCollection", "features": features}
    document["crs"] = {"type": "name", "properties": {"name": crs}}
    path.write_text(json.dumps(document), encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def dates(tmp_path_factory):
    """Six dates with their days in the metadata, given in no order; the third has a hole in the dome."""
    folder = tmp_path_factory.mktemp("dates")
    paths = []
    for date, (day, sigma) in enumerate(zip(DAYS, SIGMA)):
        heights = truth(date) + noise(date, sigma)
        if date == 2:
            heights[60:100, 130:160] = np.nan
        paths.append(write(folder / f"date_{date}.tif", [heights], day=day))
    return [paths[index] for index in (3, 0, 5, 1, 4, 2)]


def run(dsms, folder, told, said=None, **options):
    made = {"output": str(folder / "stack.tif"), "dsms": dsms, **options}
    return run_stage("series", made, said or told())


@pytest.fixture(scope="module")
def whole(dates, tmp_path_factory):
    from repm_qgis.runtime.progress import Silent

    folder = tmp_path_factory.mktemp("whole")
    names = {"trend": "t.tif", "changed": "c.tif", "volumes": "v.gpkg", "table": "v.csv", "report": "r.html"}
    made = {name: str(folder / file) for name, file in names.items()}
    result = run_stage(
        "series", {"dsms": dates, "output": str(folder / "s.tif"), "layers": str(folder / "l"), **made}, Silent()
    )
    return folder, result


def bands(path):
    values = gdal.Open(str(path)).ReadAsArray()
    return np.where(values == -9999, np.nan, values)


def test_the_stack_has_all_dates_in_their_order(whole):
    folder, result = whole
    assert result.dates == tuple(DAYS)
    stack = gdal.Open(str(folder / "s.tif"))
    assert [stack.GetRasterBand(band).GetDescription() for band in range(1, 7)] == list(DAYS)
    assert stack.GetMetadataItem("DATE_4") == DAYS[3] and stack.GetSpatialRef().GetAuthorityCode(None) == "32631"
    heights = bands(folder / "s.tif")
    for date in range(6):
        assert np.nanstd(heights[date] - truth(date)) == pytest.approx(SIGMA[date], rel=0.05)
    assert np.isnan(heights[2, 60:100, 130:160]).mean() > 0.9


def test_errors_of_dates_are_those_that_were_put_in(whole):
    _, result = whole
    assert result.errors_m == pytest.approx(SIGMA, rel=0.15)
    assert np.abs(result.offsets_m).max() < 0.02


def test_the_trend_is_recovered_and_its_errors_hold(whole):
    folder, _ = whole
    slope, error, count, low, high = bands(folder / "t.tif")
    inside, true = dome() > 0.05, RATE * dome()
    assert (count[60:100, 130:160] == 5).mean() > 0.85 and (count == 6).mean() > 0.95
    away = (slope - true)[inside]
    print(f"trend: off by {np.median(away):+.4f} m/a, {away.std():.4f} RMS, stated {np.median(error[inside]):.4f}")
    assert abs(np.median(away)) < 0.005 and 0.75 < (away / error[inside]).std() < 1.15
    still = (dome() == 0) & ~rim()
    covered = [((low <= true) & (high >= true))[where].mean() for where in (inside, still)]
    assert min(covered) > 0.95
    # With so different errors at the dates the exact interval is not that of equal ones, and wider than needed.
    assert np.nanmedian((high - low)[inside]) < 12 * np.median(error[inside])


def rim():
    """The pit and two cells around it."""
    pit = np.zeros((SIDE, SIDE), bool)
    pit[DUG[0].start - 2 : DUG[0].stop + 2, DUG[1].start - 2 : DUG[1].stop + 2] = True
    return pit


def test_dates_of_change_are_right(whole):
    folder, result = whole
    first, last = gdal.Open(str(folder / "c.tif")).ReadAsArray()
    inner = slice(DUG[0].start + 2, DUG[0].stop - 2), slice(DUG[1].start + 2, DUG[1].stop - 2)
    assert (first[inner] == 4).mean() > 0.98 and (last[inner] == 4).mean() > 0.98
    top = dome() > 0.8
    # The top rises by 2.7 m and more to the second date, twice the level, and goes on to the last.
    assert (first[top] == 2).mean() > 0.9 and (last[top] == 6).mean() > 0.95
    still = (dome() == 0) & ~rim()
    assert (first[still] != 0).mean() < 0.002
    assert result.falling_m2 == pytest.approx(2500, rel=0.06)
    style = (folder / "c.qml").read_text(encoding="utf-8")
    assert re.findall(r'label="([\d-]+)"', style) == list(DAYS)


@pytest.mark.long
def test_no_area_is_as_large_as_what_is_asked_for(dates, tmp_path, told):
    """Also where no part of the ground is: GDAL's sieve then has nothing to join small parts with."""
    for least in (1e5, 1e8, 1e9):
        assert run(dates[:3], tmp_path, told, min_area=least).areas == 0


@pytest.mark.long
def test_volumes_over_time_are_within_their_errors(dates, tmp_path, told):
    """Polygons of the user around both changes; the true volumes are sums of what was simulated."""
    x, y = PLACE
    boxes = {"dome": (x + 100, y - 130, x + 200, y - 30), "pit": (x + 25, y - 205, x + 85, y - 145)}
    areas = polygons(tmp_path / "areas.geojson", boxes)
    table, volumes = str(tmp_path / "t.csv"), str(tmp_path / "v.gpkg")
    result = run(dates, tmp_path, told, areas=areas, table=table, volumes=volumes)
    with open(table, newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["area"], row["date"]) for row in rows] == [(name, day) for name in boxes for day in DAYS]
    cells = {"dome": (slice(30, 130), slice(100, 200)), "pit": (slice(145, 205), slice(25, 85))}
    standard = []
    for row in rows:
        date = DAYS.index(row["date"])
        true = (truth(date) - truth(0))[cells[row["area"]]].sum() * CELL**2 / 0.9996**2
        assert float(row["area_m2"]) == pytest.approx((10000 if row["area"] == "dome" else 3600) / 0.9996**2)
        if date:
            away = float(row["volume_m3"]) - true
            standard.append(away / float(row["deviation_m3"]))
            assert abs(away) < 3 * float(row["deviation_m3"]), row
            if row["known_percent"] == "100.000":
                assert 3 * float(row["deviation_m3"]) < 0.1 * abs(true) + 400, row
    print(f"volumes over their deviations: {np.sqrt(np.mean(np.square(standard))):.2f} RMS")
    assert np.sqrt(np.mean(np.square(standard))) < 1.6
    known = {(row["area"], row["date"]): float(row["known_percent"]) for row in rows}
    assert known["dome", DAYS[2]] == pytest.approx(88, abs=1.5) and known["pit", DAYS[2]] == 100
    source = ogr.Open(volumes)
    found = [feature.items() for feature in source.GetLayer(0)]
    assert [each["area"] for each in found] == ["dome", "pit"] and [each["change"] for each in found] == [
        "gain",
        "loss",
    ]
    assert found[0]["m3_20240505"] == pytest.approx(found[0]["volume_m3"], abs=1e-6)
    per_year = RATE * dome()[cells["dome"]].sum()
    assert abs(found[0]["trend_m3_a"] - per_year) < 3 * found[0]["trend_error"] < 0.1 * per_year
    assert result.areas == 2 and result.volume_m3 == pytest.approx(found[0]["volume_m3"])


@pytest.mark.long
def test_an_area_that_crosses_itself_is_named(dates, tmp_path, told):
    """It has half of the square's volume."""
    areas = polygons(tmp_path / "areas.geojson", {"a": (PLACE[0] + 20, PLACE[1] - 80, PLACE[0] + 70, PLACE[1] - 30)})
    document = json.loads((tmp_path / "areas.geojson").read_text(encoding="utf-8"))
    ring = document["features"][0]["geometry"]["coordinates"][0]
    for crossed in (False, True):
        if crossed:
            ring[1], ring[2] = ring[2], ring[1]
            (tmp_path / "areas.geojson").write_text(json.dumps(document), encoding="utf-8")
        said = told()
        run_stage("series", {"output": str(tmp_path / "s.tif"), "dsms": dates[:3], "areas": areas}, said)
        assert [each.id for each in said.warnings if "areas.geojson" in each] == ["polygons-crossed"] * crossed


def volumes_of(dates, folder, told, boxes):
    """The rows of the table at the last date, by their areas, and the ids of the warnings."""
    table, said = str(folder / "t.csv"), told()
    areas = polygons(folder / "areas.geojson", boxes)
    made = {"output": str(folder / "stack.tif"), "dsms": dates, "areas": areas, "table": table}
    result = run_stage("series", made, said)
    with open(table, newline="", encoding="utf-8") as stream:
        rows = {row["area"]: row for row in csv.DictReader(stream) if row["date"] == DAYS[-1]}
    return rows, [each.id for each in said.warnings], result


@pytest.mark.long
def test_areas_that_overlap_have_their_whole_volumes(dates, tmp_path, told):
    """A slope within the pit's area, and one beside it: each has what it has alone, whatever the order."""
    x, y = PLACE
    boxes = {
        "pit": (x + 25, y - 205, x + 85, y - 145),
        "half": (x + 25, y - 205, x + 55, y - 145),
        "beside": (x + 85, y - 205, x + 100, y - 145),
        "twin": (x + 25, y - 205, x + 85, y - 145),
    }
    rows, said, result = volumes_of(dates, tmp_path, told, boxes)
    assert result.areas == 4 and not said
    assert float(rows["pit"]["area_m2"]) == pytest.approx(2 * float(rows["half"]["area_m2"]), rel=1e-3)
    assert rows["pit"]["volume_m3"] == rows["twin"]["volume_m3"]
    for name, true in (("pit", -2500 * 3), ("half", -25 * 50 * 3), ("beside", 0)):
        assert float(rows[name]["volume_m3"]) == pytest.approx(true, abs=3 * float(rows[name]["deviation_m3"]) + 10)


@pytest.mark.long
def test_areas_beyond_the_dsms_are_named_and_stay_in_the_table(dates, tmp_path, told):
    x, y = PLACE
    boxes = {
        "far": (x - 2000, y - 205, x - 1900, y - 145),
        "cut": (x + 220, y - 100, x + 320, y - 50),
        "pit": (x + 25, y - 205, x + 85, y - 145),
    }
    rows, said, result = volumes_of(dates, tmp_path, told, boxes)
    assert said == ["areas-outside"] and list(rows) == list(boxes)
    assert float(rows["far"]["known_percent"]) == 0 and not rows["far"]["volume_m3"]
    assert float(rows["cut"]["known_percent"]) == pytest.approx(20, abs=0.1)
    assert float(rows["pit"]["known_percent"]) == 100
    assert result.volume_m3 == pytest.approx(float(rows["cut"]["volume_m3"]), abs=0.01)


def test_without_areas_the_changes_are_outlined(whole):
    folder, result = whole
    source = ogr.Open(str(folder / "v.gpkg"))
    found = [{**each.items(), "shape": each.GetGeometryRef().Clone()} for each in source.GetLayer(0)]
    assert len(found) == result.areas == 2
    grown, dug = found
    assert grown["change"] == "gain" and dug["change"] == "loss" and dug["area_m2"] == pytest.approx(2500, rel=0.06)
    assert dug["volume_m3"] == pytest.approx(-7500, rel=0.03)
    assert 0.93 < grown["volume_m3"] / (RATE * YEARS[5] * dome().sum()) < 1.02  # its edge does not stand out
    assert all(each["shape"].IsValid() for each in found)
    page = (folder / "r.html").read_text(encoding="utf-8")
    assert "Volumes over time" in page and "Dates and their errors" in page and DAYS[3] in page
    assert "outlined areas" not in page


@pytest.mark.parametrize("count", (3, 4))
def test_outlines_that_errors_alone_may_draw_are_named_and_have_wide_deviations(count, tmp_path, told):
    """Nothing changes: areas of up to 1000 m2 had volumes of 3 to 6 of their deviations, without a word."""
    rng, dsms, said = np.random.default_rng(count), [], told()
    for date in range(count):
        fine = ndimage.gaussian_filter(rng.normal(size=(SIDE, SIDE)), 7.0, mode="wrap")
        ground = truth(0) + 0.3 * fine / fine.std() + rng.normal(0.0, 0.02, fine.shape)
        dsms.append(write(tmp_path / f"{date}.tif", [ground], day=DAYS[date]))
    made = run(dsms, tmp_path, told, said=said, volumes=str(tmp_path / "v.gpkg"), align="vertical")
    source = ogr.Open(str(tmp_path / "v.gpkg"))
    found = [each.items() for each in source.GetLayer(0)]
    assert made.areas > 3 and "areas-unsure" in [each.id for each in said.warnings]
    size = np.array([abs(each["volume_m3"]) / each["deviation_m3"] for each in found])
    assert np.median(size) < 3.0 and (size < 3.5).mean() > 0.9


def test_each_date_has_a_layer_with_its_period(whole):
    folder, result = whole
    assert [path[-14:-4] for path in result.maps] == list(reversed(DAYS))
    for date, day in enumerate(DAYS):
        np.testing.assert_array_equal(bands(folder / "l" / f"{day}.vrt"), bands(folder / "s.tif")[date])
        style = (folder / "l" / f"{day}.qml").read_text(encoding="utf-8")
        start, end = re.findall(r"<start>(.*?)</start><end>(.*?)</end>", style)[0]
        assert start == f"{day}T00:00:00Z" and (date == 5 or end < f"{DAYS[date + 1]}T00:00:00Z")
    text = (folder / "l" / f"{DAYS[0]}.vrt").read_text(encoding="utf-8")
    assert '<SourceFilename relativeToVRT="1">../s.tif</SourceFilename>' in text  # the folder may be moved


@pytest.mark.parametrize("align", ("none", "vertical"))
@pytest.mark.long
def test_an_offset_is_reported_and_removed_only_where_that_is_asked(align, tmp_path, told):
    paths = []
    for date, day in enumerate(DAYS):
        heights = truth(date) + noise(date, 0.1) + (0.8 if date == 4 else 0.0)
        paths.append(write(tmp_path / f"d{date}.tif", [heights], day=day))
    progress = told()
    made = {"dsms": paths, "output": str(tmp_path / "s.tif"), "changed": str(tmp_path / "c.tif"), "align": align}
    result = run_stage("series", made, progress)
    assert result.offsets_m == pytest.approx([0, 0, 0, 0, 0.8, 0], abs=0.02)
    left = np.nanmedian(bands(tmp_path / "s.tif")[4] - truth(4))
    assert left == pytest.approx(0.8 if align == "none" else 0.0, abs=0.02)
    warned = [text for text in progress.warnings if DAYS[4] in text and "set ALIGN to vertical" in text]
    assert len(warned) == (align == "none") and ("+0.80 m" in warned[0] if warned else True)
    first, _ = gdal.Open(str(tmp_path / "c.tif")).ReadAsArray()
    assert (first[(dome() == 0) & ~rim()] != 0).mean() < 0.002  # an offset of a date is no change


@pytest.mark.long
def test_a_date_beside_its_place_and_one_of_half_the_ground_are_named(tmp_path, told):
    plain = [truth(0) + noise(date, 0.1) for date in range(4)]
    for place, columns, found in ((PLACE, SIDE, []), ((PLACE[0] + 5.0, PLACE[1]), SIDE, ["dates-displaced"])):
        paths = [
            write(tmp_path / f"{date}.tif", [heights[:, :columns]], place if date == 2 else PLACE, day=DAYS[date])
            for date, heights in enumerate(plain)
        ]
        said = told()
        run_stage("series", {"dsms": paths, "output": str(tmp_path / "s.tif")}, said)
        assert [each.id for each in said.warnings] == found and (not found or "2.tif' fits to" in said.warnings[0])
    write(tmp_path / "2.tif", [plain[2][:, : SIDE // 2]], day=DAYS[2])
    said, report = told(), tmp_path / "r.html"
    run_stage("series", {"dsms": paths, "output": str(tmp_path / "s.tif"), "report": str(report)}, said)
    assert [each.id for each in said.warnings] == ["dates-partial"] and "Only 50.0 % of the ground" in said.warnings[0]
    assert "Only 50.0 % of the ground" in report.read_text(encoding="utf-8").split("<h2")[0]


@pytest.mark.long
def test_confidences_state_errors_and_what_was_filled(dates, tmp_path, told):
    ordered = sorted(dates)
    confidences = []
    for date in range(6):
        values = [np.full((SIDE, SIDE), value, float) for value in (3, 0.1, 0.9, 0, 0.1, 0.2)]
        if date == 3:
            values[3][DUG] = 2  # interpolated
        values[4][:, 120:] = 0.2  # half of the ground is said to be twice as uncertain
        confidences.append(write(tmp_path / f"c{date}.tif", values, names=CONFIDENCE_BANDS))
    made = {"trend": str(tmp_path / "t.tif"), "changed": str(tmp_path / "c.tif")}
    run(ordered, tmp_path, told, confidences=confidences, **made)
    _, error, count, _, _ = bands(tmp_path / "t.tif")
    inner = slice(155, 195), slice(35, 75)
    assert (count[inner] == 5).all()
    first, _ = gdal.Open(made["changed"]).ReadAsArray()
    assert (first[inner] == 5).mean() > 0.95  # the next date that was measured
    ratio = np.median(error[210:, 130:230]) / np.median(error[210:, 10:110])
    assert 1.5 < ratio < 2.1


@pytest.mark.long
def test_blocks_change_nothing(dates, tmp_path, told):
    made = []
    for name, side in (("one", 1024), ("many", 64)):
        paths = {each: str(tmp_path / f"{name}_{each}.tif") for each in ("output", "trend", "changed")}
        options = SeriesOptions(dsms=tuple(dates), table=str(tmp_path / f"{name}.csv"), **paths)
        plan = replace(SERIES, block_cells=side, least_block_cells=64, values_at_once=4_000_000 if side > 64 else 3000)
        find_series(options, told(), plan)
        made.append([bands(path) for path in paths.values()])
    for one, many in zip(*made):
        np.testing.assert_array_equal(one, many)
    texts = [(tmp_path / f"{name}.csv").read_text(encoding="utf-8") for name in ("one", "many")]
    assert texts[0] == texts[1]


@pytest.mark.long
def test_other_cells_another_crs_and_other_extents(tmp_path, told):
    """The coarsest cells are taken, and the ground that three dates cover."""
    paths = [write(tmp_path / f"d{date}.tif", [truth(date) + noise(date, 0.1)]) for date in range(4)]
    far = str(tmp_path / "far.tif")
    gdal.Warp(far, paths[1], dstSRS="EPSG:32632", xRes=2, yRes=2, resampleAlg="average", dstNodata=-9999)
    part = str(tmp_path / "part.tif")
    gdal.Translate(part, paths[2], srcWin=[0, 0, 200, SIDE])
    result = run([paths[0], far, part, paths[3]], tmp_path, told, dates=DAYS[:4], trend=str(tmp_path / "t.tif"))
    stack = gdal.Open(str(tmp_path / "stack.tif"))
    assert stack.GetGeoTransform()[1] == 2 and stack.GetSpatialRef().GetAuthorityCode(None) == "32632"
    assert result.n_dates == 4 and result.falling_m2 == pytest.approx(2500, rel=0.1)


def test_times_come_from_the_user_from_a_stac_item_or_from_days(tmp_path):
    flat = [np.zeros((10, 10))]
    days = write(tmp_path / "days.tif", flat, day="2020-03-01 2020-03-03")
    item = write(tmp_path / "item.tif", flat, day="2020-03-01")
    document = {
        "type": "Feature",
        "stac_version": "1.0.0",
        "properties": {"datetime": "2021-07-01T10:20:30Z"},
        "assets": {"output": {"href": "./item.tif", "type": "image/tiff; application=geotiff", "roles": ["data"]}},
    }
    (tmp_path / "item.json").write_text(json.dumps(document), encoding="utf-8")
    other = write(tmp_path / "other.tif", flat, day="2020-03-02")
    found = dated([item, days, write(tmp_path / "later.tif", flat, day="2022-01-05")], (), ())
    assert [each.label for each in found] == ["2020-03-02", "2021-07-01", "2022-01-05"]
    assert found[1].taken.hour == 10
    same_day = dated([days, item, other], (), ("2020-05-01T09:00:00Z", "2020-05-01 12:00:00+02:00", "2020-05-02"))
    assert [each.label for each in same_day][:2] == ["2020-05-01 09:00:00", "2020-05-01 10:00:00"]
    assert periods(same_day)[0] == ["2020-05-01T09:00:00Z", "2020-05-01T09:59:59Z"]
    with pytest.raises(OptionError, match="has the time of"):
        dated([days, other, item], (), ())


def test_what_cannot_be_followed_is_refused_in_a_sentence(dates, tmp_path, told):
    silent = write(tmp_path / "silent.tif", [truth(0)])
    away = write(tmp_path / "away.tif", [truth(0)], place=(600000.0, 5000000.0), day="2017-01-01")
    feet = write(tmp_path / "feet.tif", [truth(0)], day="2017-01-01", unit="furlong")
    empty = write(tmp_path / "empty.tif", [np.full((SIDE, SIDE), np.nan)], day="2017-01-01")
    x, y = PLACE
    outside = polygons(tmp_path / "o.geojson", {"far": (x + 5000, y, x + 5100, y + 100)})
    two = dates[:2]
    for dsms, options, kind, words in (
        (two, {}, OptionError, "must name 3 to 250 DSMs"),
        ([*two, two[0]], {}, OptionError, "is named twice"),
        ([*two, silent], {}, OptionError, "has no time, neither"),
        (dates[:3], {"dates": DAYS[:2]}, OptionError, "one for each of DSMS"),
        (dates[:3], {"dates": ("2020-01-01", "2020-13-01", "2021-01-01")}, OptionError, "must be a day such as"),
        (
            dates[:3],
            {"dates": ("2020-01-01", "2020-01-01", "2021-01-01")},
            OptionError,
            "DATES is '2020-01-01 00:00': it is",
        ),
        (dates[:3], {"confidences": ("a.tif",)}, OptionError, "CONFIDENCES"),
        (dates[:3], {"table": "t.xlsx"}, OptionError, "must end with .csv"),
        ([*two, away], {}, OverlapError, "no ground in common"),
        ([*dates[:3], away], {}, OverlapError, "do not overlap"),
        ([*two, feet], {}, ImageError, "has heights in 'furlong'"),
        ([*two, empty], {}, EmptyResultError, "No cell of stable ground has a height in both DSMs"),
        (dates[:3], {"areas": outside}, OverlapError, "No polygon of"),
        (dates[:3], {"areas": dates[0]}, InputTableError, "choose a layer of polygons"),
    ):
        with pytest.raises(kind, match=words):
            run(dsms, tmp_path, told, **options)
    assert not list(tmp_path.glob("*.part*"))


def test_another_vertical_datum_without_a_way_between_is_refused(dates, tmp_path, told):
    """A height system that no grid of this PROJ connects with the other."""
    low = write(tmp_path / "low.tif", [truth(0)], crs="EPSG:32631+5773", day="2016-01-01")
    odd = write(tmp_path / "odd.tif", [truth(0)], crs="EPSG:32631+5797", day="2017-01-01")
    with pytest.raises(ImageError, match="cannot be transformed into those of"):
        run([low, odd, dates[0]], tmp_path, told)


def test_a_run_can_be_stopped_and_leaves_nothing(dates, tmp_path):
    from repm_qgis.contracts.errors import Cancelled
    from repm_qgis.runtime.progress import Silent

    class Stopped(Silent):
        asked = 0

        def check_cancelled(self):
            Stopped.asked += 1
            if Stopped.asked > 12:
                raise Cancelled()

    with pytest.raises(Cancelled):
        run_stage("series", {"dsms": dates, "output": str(tmp_path / "s.tif")}, Stopped())
    assert not list(tmp_path.iterdir())
