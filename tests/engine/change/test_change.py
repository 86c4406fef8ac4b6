from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from osgeo import gdal, ogr, osr

from repm_qgis.change.detection import _with_hidden, detect
from repm_qgis.change.errors import Correlation, ErrorModel, correlation_of, fitted_model
from repm_qgis.change.finding import find_changes
from repm_qgis.change.parameters import CHANGE
from repm_qgis.change.surfaces import Cells
from repm_qgis.contracts.errors import EmptyResultError, ImageError, OptionError, OverlapError
from repm_qgis.contracts.options import ChangeOptions
from repm_qgis.imagery.confidence import CONFIDENCE_BANDS
from repm_qgis.stages import run_stage

CELL = 0.5
PLACE = (500000.0, 5000000.0)
SIDE = 300  # cells
BUILT, DUG = (slice(60, 100), slice(50, 90)), (slice(180, 230), slice(200, 240))  # 400 and 500 m2


def ground(east=0.0, north=0.0, cell=CELL, side=SIDE):
    """Hills with a tall house and a low one, m, where the ground was moved by this much."""
    y, x = (np.mgrid[:side, :side] + 0.5) * cell
    x, y = x - east, y + north
    z = 100 + 4 * np.sin(x / 21) * np.cos(y / 17) + 2 * np.sin(x / 7 + y / 9)
    z[(abs(x - 100) < 9) & (abs(y - 30) < 7)] = 125
    z[(abs(x - 40) < 6) & (abs(y - 110) < 8)] = 112
    return z


def noise(seed, size=0.12, shape=(SIDE, SIDE)):
    """Errors that neighbours share, as those of matching."""
    fine = np.random.default_rng(seed).normal(0, 1, shape)
    for axis in (0, 1):
        fine = fine + np.roll(fine, 1, axis) + np.roll(fine, -1, axis)
    return size * fine / fine.std()


def write(path, bands, cell=CELL, crs="EPSG:32631", names=(), place=PLACE, unit=""):
    bands = [np.asarray(band, np.float32) for band in bands]
    made = gdal.GetDriverByName("GTiff").Create(str(path), *bands[0].shape[::-1], len(bands), gdal.GDT_Float32)
    made.SetGeoTransform((place[0], cell, 0, place[1], 0, -cell))
    reference = osr.SpatialReference()
    reference.SetFromUserInput(crs)
    made.SetSpatialRef(reference)
    for index, band in enumerate(bands, start=1):
        made.GetRasterBand(index).SetNoDataValue(-9999)
        made.GetRasterBand(index).WriteArray(np.where(np.isfinite(band), band, -9999))
        if unit:
            made.GetRasterBand(index).SetUnitType(unit)
    for index, name in enumerate(names, start=1):
        made.GetRasterBand(index).SetDescription(name)
    made = None  # noqa: F841
    return str(path)


def confidence(path, error=0.1, source=None, count=None):
    shape = (SIDE, SIDE)
    full = [np.full(shape, value, float) for value in (3, 0.1, 0.9, 0, error, 1.645 * error)]
    if source is not None:
        full[3] = source
    if count is not None:
        full[0] = count
    return write(path, full, names=CONFIDENCE_BANDS)


@pytest.fixture
def dates(tmp_path):
    """Two dates of the ground: a heap of 3 m and a pit of 2 m came between them, and the second lies elsewhere."""
    before, after = ground() + noise(1), ground(0.8, -0.55) + 1.7 + noise(2)
    after[BUILT] += 3.0
    after[DUG] -= 2.0
    return write(tmp_path / "before.tif", [before]), write(tmp_path / "after.tif", [after])


def test_shifts_areas_and_volumes_are_true_where_the_crs_doubles_lengths(tmp_path, told):
    """Web Mercator at 60 degrees north: volumes were four times too large, and the shift was doubled."""
    before, after = ground() + noise(1, 0.05), ground(0.8, -0.55) + 1.7 + noise(2, 0.05)
    after[BUILT] += 3.0
    after[DUG] -= 2.0
    place = {"place": (1e6, 8399738.0), "crs": "EPSG:3857", "cell": 2 * CELL}
    paths = [write(tmp_path / f"{name}.tif", [each], **place) for name, each in (("a", before), ("b", after))]
    found = change(*paths, tmp_path, told)
    assert (found.dx, found.dy, found.dz) == pytest.approx((-0.8, 0.55, -1.7), abs=0.06)
    assert found.gained_m3 == pytest.approx(1200, rel=0.08) and found.lost_m3 == pytest.approx(1000, rel=0.08)


@pytest.fixture
def witnessed(tmp_path):
    """Confidences of both dates: three height maps agree everywhere."""
    names = ("before_confidence", "after_confidence")
    return {name: confidence(tmp_path / f"{name}.tif") for name in names}


def change(before, after, folder, told, **options):
    made = {"output": str(folder / "d.tif"), "volumes": str(folder / "v.gpkg"), **options}
    return run_stage("change", {"before": before, "after": after, **made}, told())


def polygons(path):
    source = ogr.Open(str(path))
    return [{**feature.items(), "shape": feature.GetGeometryRef().Clone()} for feature in source.GetLayer(0)]


def test_a_heap_and_a_pit_are_found_with_their_volumes(dates, witnessed, tmp_path, told):
    made = {"significant": str(tmp_path / "s.tif"), "report": str(tmp_path / "r.html")}
    found = change(*dates, tmp_path, told, **made, **witnessed)
    assert (found.dx, found.dy, found.dz) == pytest.approx((-0.8, 0.55, -1.7), abs=0.06)
    heap, pit = sorted(polygons(tmp_path / "v.gpkg"), key=lambda each: -each["volume_m3"])
    for each, kind, area, volume in ((heap, "gain", 400, 1200), (pit, "loss", 500, -1000)):
        assert each["change"] == kind and each["area_m2"] == pytest.approx(area, rel=0.1)
        assert each["volume_m3"] == pytest.approx(volume, rel=0.07)
        assert abs(each["volume_m3"] - volume) < 2 * each["deviation_m3"] < 0.3 * abs(volume)
        assert each["shape"].IsValid() and each["shape"].GetArea() / 0.9996**2 == pytest.approx(
            each["area_m2"], rel=1e-6
        )
    assert found.gained_m3 == pytest.approx(heap["volume_m3"]) and found.changes == 2
    assert found.lost_m3 == pytest.approx(-pit["volume_m3"])
    significant = gdal.Open(str(tmp_path / "s.tif"))
    values, level = (significant.GetRasterBand(band).ReadAsArray() for band in (1, 2))
    shown = np.where(values == -9999, 0, values)
    assert shown.sum() * CELL**2 / 0.9996**2 == pytest.approx(heap["volume_m3"] + pit["volume_m3"], rel=1e-4)
    flat = level[120:150, 120:150]
    assert 0.3 < np.median(flat) < 0.7  # 1.96 times the noise of both
    assert level.max() > 5 * np.median(flat)  # beside walls
    assert (tmp_path / "v.qml").exists()
    for style in ("s.qml", "d.qml"):  # as in the report: the usual change has the darkest tone, noise is pale
        most = float(re.search(r'classificationMax="([^"]*)"', (tmp_path / style).read_text(encoding="utf-8"))[1])
        assert 2 < most < 3.2
    assert "A difference beyond the level of detection" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_nothing_changed_between_two_dsms_of_one_date(tmp_path, told):
    paths = [write(tmp_path / f"{seed}.tif", [ground() + noise(seed)]) for seed in (1, 2)]
    found = change(*paths, tmp_path, told, report=str(tmp_path / "r.html"))
    assert found.changes == 0 and found.gained_m3 == found.lost_m3 == 0
    assert polygons(tmp_path / "v.gpkg") == []
    assert "Nothing changed significantly" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_what_changed_has_no_part_in_what_the_alignment_gained(tmp_path, told):
    """A third of the ground was dug up, and nothing lies elsewhere: the NMAD of stable ground was as good before."""
    after = ground() + noise(2)
    after[:, 200:] += 4 * np.sin(np.mgrid[:SIDE, 200:SIDE][0] / 9)
    paths = [write(tmp_path / "a.tif", [ground() + noise(1)]), write(tmp_path / "b.tif", [after])]
    progress = told()
    run_stage("change", {"before": paths[0], "after": paths[1], "output": str(tmp_path / "d.tif")}, progress)
    said = next(text for text in progress.notes if "stable ground agrees" in text)
    before, now = map(float, re.findall(r"NMAD ([\d.]+) m before, ([\d.]+) m after", said)[0])
    assert now <= before < now + 0.02 < 0.25, said


@pytest.mark.long
def test_walls_that_matching_moved_are_no_change(tmp_path, told):
    """The tall house is a metre wider on one date, and the strip that it hides is bridged."""
    wide = ground()
    wide[44:76, 180:221] = 125
    wide[76:84, 182:218] = np.linspace(125, 103, 8)[:, None]
    paths = [write(tmp_path / name, [heights]) for name, heights in (("a.tif", ground()), ("b.tif", wide))]
    noisy = [write(tmp_path / f"n{i}.tif", [gdal.Open(p).ReadAsArray() + noise(i)]) for i, p in enumerate(paths)]
    for order in (noisy, noisy[::-1]):
        assert change(*order, tmp_path, told, min_area=10).changes == 0


@pytest.mark.long
def test_filled_cells_and_few_witnesses_are_no_change(dates, tmp_path, told):
    """Confidence rasters say that the heap was interpolated, or that fewer pairs than usual saw it."""
    plain = confidence(tmp_path / "before_c.tif")
    source, count = np.zeros((SIDE, SIDE)), np.full((SIDE, SIDE), 3.0)
    source[BUILT], count[BUILT] = 2, 2
    for name, more, expected in (("plain", {}, 2), ("source", {"source": source}, 1), ("count", {"count": count}, 1)):
        other = confidence(tmp_path / f"{name}.tif", **more)
        found = change(*dates, tmp_path, told, before_confidence=plain, after_confidence=other, align="3d")
        assert found.changes == expected, name
        assert (found.gained_m3 == 0) == (expected == 1)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.long
def test_heights_that_nothing_checks_need_larger_changes(stated, dates, tmp_path, told):
    """Heights of one map, and those of which no confidence raster tells: an error of matching leaves no trace there."""
    made = {}
    if stated:
        three, one = confidence(tmp_path / "c3.tif"), confidence(tmp_path / "c1.tif", count=np.ones((SIDE, SIDE)))
        made = {"before_confidence": three, "after_confidence": one}
    assert change(*dates, tmp_path, told, **made).changes == 0
    tall = gdal.Open(dates[1]).ReadAsArray()
    tall[BUILT] += 5.0
    found = change(dates[0], write(tmp_path / "tall.tif", [tall]), tmp_path, told, **made)
    assert found.changes == 1 and found.gained_m3 == pytest.approx(3200, rel=0.07)


def test_a_blurred_edge_lies_where_half_of_the_height_is_reached(witnessed, tmp_path, told):
    """Windows of matching blur a new house; its outline is still its own."""
    house = np.zeros((SIDE, SIDE))
    house[BUILT] = 8.0
    for axis in (0, 1):
        house = sum(np.roll(house, by, axis) for by in (-2, -1, 0, 1, 2)) / 5
    paths = [write(tmp_path / f"{seed}.tif", [ground() + noise(seed) + more]) for seed, more in ((1, 0.0), (2, house))]
    change(*paths, tmp_path, told, **witnessed)
    (found,) = polygons(tmp_path / "v.gpkg")
    assert found["area_m2"] == pytest.approx(400, rel=0.04)
    assert found["volume_m3"] == pytest.approx(3200, rel=0.07)  # what lies outside of it is left out


@pytest.mark.parametrize("cell", (0.5, 1.0))
@pytest.mark.parametrize("box", ((-2, -4, 18, 11), (0, -20, 20, -5), (2, -20, 12, 20), (-12, 4, 8, 19)))
def test_a_change_across_the_walls_of_a_house_has_its_volume(cell, box, tmp_path, told):
    """5 m more on a roof and on the ground beside it: cells at walls were left out, by up to ten deviations."""
    side = round(120 / cell)
    y, x = (np.mgrid[:side, :side] + 0.5) * cell - 60
    plain = 100 + 4 * np.sin(x / 21) * np.cos(y / 17) + 2 * np.sin(x / 7 + y / 9) + 8.0 * ((abs(x) < 8) & (abs(y) < 8))
    more = 5.0 * ((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3]))
    paths = [
        write(tmp_path / f"{seed}.tif", [plain + heap + noise(seed, 0.1, (side, side))], cell)
        for seed, heap in ((1, 0.0), (2, more))
    ]
    made, true = change(*paths, tmp_path, told), float(more.sum()) * cell**2
    assert abs(made.gained_m3 - true) < 3 * made.gained_deviation_m3 < 0.7 * true
    assert made.gained_m3 == pytest.approx(true, rel=0.25) and made.lost_m3 == 0


@pytest.mark.parametrize("align", ("none", "vertical"))
def test_a_date_beside_its_place_is_named_where_nothing_moves_it(align, tmp_path, told):
    before, said = write(tmp_path / "before.tif", [ground() + noise(1)]), told()
    for east, found in ((5.0, ["dates-displaced"]), (0.4, [])):
        after = write(tmp_path / "after.tif", [ground(east) + noise(2)])
        options = {"before": before, "after": after, "output": str(tmp_path / "d.tif"), "align": align}
        run_stage("change", options, said)
        assert [each.id for each in said.warnings] == found
        assert not found or "better 5.0 m beside its place" in said.warnings.pop()


def test_the_share_that_was_compared_is_in_the_verdict(dates, tmp_path, told):
    half, said = gdal.Open(dates[1]).ReadAsArray(), told()
    report = tmp_path / "r.html"
    for columns, share in ((SIDE, "100 %"), (SIDE // 2, "50.0 %")):
        after = write(tmp_path / "part.tif", [half[:, :columns]])
        options = {"before": dates[0], "after": after, "output": str(tmp_path / "d.tif"), "align": "vertical"}
        run_stage("change", {**options, "report": str(report)}, said)
        top = report.read_text(encoding="utf-8").split("<h2")[0]
        assert f"{share} of the larger" in top or f"Only {share} of the ground" in top
    # The pit of 2 m is less than eight levels of detection, in both runs.
    assert [each.id for each in said.warnings] == ["changes-unsure", "dates-partial", "changes-unsure"]


def test_a_volume_is_as_uncertain_as_its_outline(dates, witnessed, tmp_path, told):
    """An outline that is off by the horizontal error all around sweeps the whole height of the change."""
    options = ChangeOptions(before=dates[0], after=dates[1], output=str(tmp_path / "d.tif"), **witnessed)
    found = find_changes(options, told())
    for each, round_m in zip(found.changes, (80.0, 90.0)):
        edge = found.model.horizontal_m * round_m * abs(each.mean)
        assert 0.95 * edge < each.deviation < 1.5 * edge


def test_uncertain_heights_need_larger_changes(dates, tmp_path, told):
    error = np.full((SIDE, SIDE), 0.1)
    error[170:240, 190:250] = 3.0  # where the pit is
    paths = [confidence(tmp_path / f"{name}.tif", error) for name in ("b", "a")]
    found = change(*dates, tmp_path, told, before_confidence=paths[0], after_confidence=paths[1])
    assert found.changes == 1 and found.lost_m3 == 0


@pytest.mark.long
def test_other_cells_and_another_crs(dates, witnessed, tmp_path, told):
    """The second date has cells of 1 m in degrees' neighbour zone; volumes stay the same."""
    far = gdal.Warp(
        str(tmp_path / "far.tif"), dates[1], dstSRS="EPSG:32632", xRes=1, yRes=1, resampleAlg="average", dstNodata=-9999
    )
    far = gdal.Warp(
        str(tmp_path / "far_confidence.tif"), witnessed["after_confidence"], dstSRS="EPSG:32632", xRes=1, yRes=1
    )
    far = None  # noqa: F841
    dated = (
        (dates[0], witnessed["before_confidence"]),
        (str(tmp_path / "far.tif"), str(tmp_path / "far_confidence.tif")),
    )
    for (before, own), (after, others), sign in ((*dated, 1), (*dated[::-1], -1)):
        found = change(before, after, tmp_path, told, before_confidence=own, after_confidence=others)
        gained, lost = (found.gained_m3, found.lost_m3)[::sign]
        assert found.changes == 2 and (gained, lost) == pytest.approx((1200, 1000), rel=0.1)
        assert gdal.Open(str(tmp_path / "d.tif")).GetGeoTransform()[1] == 1


@pytest.mark.long
def test_blocks_change_nothing(dates, tmp_path, told):
    made = []
    for name, side in (("one", 1024), ("many", 64)):
        paths = {part: str(tmp_path / f"{name}_{part}") for part in ("output.tif", "significant.tif", "volumes.gpkg")}
        options = ChangeOptions(before=dates[0], after=dates[1], **{p.split(".")[0]: f for p, f in paths.items()})
        find_changes(options, told(), replace(CHANGE, detection=replace(CHANGE.detection, block_cells=side)))
        rasters = [gdal.Open(paths[part]).ReadAsArray() for part in ("output.tif", "significant.tif")]
        made.append(
            (rasters, [{**each, "shape": each["shape"].ExportToWkt()} for each in polygons(paths["volumes.gpkg"])])
        )
    for one, many in zip(made[0][0], made[1][0]):
        assert np.array_equal(one, many)
    for one, many in zip(made[0][1], made[1][1]):
        assert one.pop("shape") == many.pop("shape") and one.pop("change") == many.pop("change")
        assert one == pytest.approx(many, rel=1e-9)


@pytest.mark.long
def test_small_changes_are_left_out(dates, tmp_path, told):
    assert change(*dates, tmp_path, told, min_area=450).gained_m3 == 0
    for more in (700, 1e9):
        assert change(*dates, tmp_path, told, min_area=more).changes == 0


def test_what_cannot_be_compared_is_refused_in_a_sentence(dates, tmp_path, told):
    other = write(tmp_path / "feet.tif", [ground()], unit="furlong")
    away = write(tmp_path / "away.tif", [ground()], place=(600000.0, 5000000.0))
    bands = write(tmp_path / "bands.tif", [ground(), ground()], names=("red", "green"))
    empty = write(tmp_path / "empty.tif", [np.full((SIDE, SIDE), np.nan)])
    plain = confidence(tmp_path / "c.tif")
    both = {"before_confidence": plain}
    for after, options, kind, words in (
        (dates[0], {}, OptionError, "is the same file as BEFORE"),
        (other, {}, ImageError, "has heights in 'furlong'"),
        (away, {}, OverlapError, "do not overlap"),
        (empty, {}, EmptyResultError, "No cell of stable ground has a height in both DSMs"),
        (dates[1], both, OptionError, "AFTER_CONFIDENCE"),
        (dates[1], {**both, "after_confidence": bands}, ImageError, "of AFTER_CONFIDENCE has 2 bands"),
        (dates[1], {"min_area": -1}, OptionError, "MIN_AREA"),
    ):
        with pytest.raises(kind, match=words):
            change(dates[0], after, tmp_path, told, **options)
    assert not list(tmp_path.glob("*.part*")) and not (tmp_path / "d.tif").exists()


def test_the_model_finds_both_errors():
    """Heights that are wrong by 0.2 m, and places that are wrong by 0.4 m, on slopes of all steepness."""
    rng = np.random.default_rng(4)
    steep = rng.uniform(0, 4, (600, 600)).astype(np.float32)
    difference = rng.normal(0, 1, steep.shape) * np.hypot(0.2, 0.4 * steep)
    zero, one = np.zeros_like(steep), np.ones_like(steep)
    cells = Cells(zero, difference.astype(np.float32), one, one > 0, one > 0, steep)
    model = fitted_model([cells], CELL)
    assert (model.scale, model.horizontal_m) == pytest.approx((0.2, 0.4), rel=0.1)
    assert all(each.spread == pytest.approx(each.expected, rel=0.2) for each in model.classes)
    doubled = fitted_model([replace(cells, error=2 * one)], CELL)
    assert doubled.scale == pytest.approx(0.1, rel=0.1)


@pytest.mark.long
def test_the_mean_of_alike_errors_is_as_uncertain_as_it_is():
    """The deviation of means over squares, measured on many of them, against that from the variogram."""
    rng = np.random.default_rng(3)
    field = rng.normal(0, 1, (2000, 2000))
    frequency = np.hypot(np.fft.fftfreq(2000)[:, None], np.fft.rfftfreq(2000)[None])
    field = np.fft.irfft2(np.fft.rfft2(field) * np.exp(-2 * (np.pi * frequency * 4) ** 2), s=field.shape)
    field = (field / field.std()).astype(np.float32)
    alike = correlation_of([field], field[::5, ::5], 1.0, 5, CHANGE.errors)
    for side in (10, 40, 100):
        squares = field.reshape(2000 // side, side, 2000 // side, side).mean(axis=(1, 3))
        assert np.sqrt(alike.variance_share(side**2)) == pytest.approx(squares.std(), rel=0.25)
    alone = Correlation(np.array([1.0]), np.array([0.0]))
    assert alone.variance_share(1e6) < 1e-3


def test_a_wall_hides_a_strip_of_a_third_of_its_height():
    heights = np.zeros((41, 41), np.float32)
    heights[20, 20] = 12.0
    shown = _with_hidden(heights, 1.0, CHANGE.detection)
    assert shown[20, 20:26].tolist() == [12, 9, 6, 3, 0, 0]
    assert shown[22, 22] == pytest.approx(12 - 6 * 2**0.5)


def test_a_change_beside_the_edge_of_a_window_is_the_same(dates):
    """Cells farther than the halo from the edge do not see it."""
    before, after = (gdal.Open(path).ReadAsArray() for path in dates)
    one = np.ones_like(before)
    whole = Cells(before, after, one, one > 0, one > 0, one)
    model, halo = ErrorModel(0.2, 0.2), CHANGE.detection.halo_cells
    part = (slice(20, 260), slice(10, 250))
    inner = (slice(halo, -halo), slice(halo, -halo))
    of_all, of_part = (detect(each, model, CELL) for each in (whole, whole.inner(part)))
    for name in ("change", "core"):
        assert np.array_equal(getattr(of_all, name)[part][inner], getattr(of_part, name)[inner], equal_nan=True)
    assert of_part.core.any()


@pytest.mark.parametrize(
    ("changed", "area"), ((BUILT, 400), ((slice(0, 60), slice(None)), 4500)), ids=("a house", "a fifth of the ground")
)
def test_what_differs_and_is_not_counted_is_named(changed, area, tmp_path, told):
    """Without expected errors a change needs eight levels of detection, and 3.5 m are four of them here."""
    before, after = ground() + noise(1, 0.3), ground() + noise(2, 0.3)
    after[changed] += 3.5
    paths = [write(tmp_path / f"{name}.tif", [each]) for name, each in (("a", before), ("b", after))]
    said = told()
    found = run_stage("change", {"before": paths[0], "after": paths[1], "output": str(tmp_path / "d.tif")}, said)
    named = next(each for each in said.warnings if each.id == "changes-unsure")
    assert found.changes == 0 and float(named.split()[0]) == pytest.approx(area, rel=0.1)
    assert float(re.search(r"differs by ([\d.]+) m", named)[1]) == pytest.approx(8 * found.level_m, abs=0.06)


@pytest.mark.parametrize(("align", "ids"), (("none", ["dates-apart"]), ("vertical", [])))
def test_an_offset_that_nothing_removes_is_named(align, ids, tmp_path, told):
    paths = [write(tmp_path / f"{seed}.tif", [ground() + noise(seed) + up]) for seed, up in ((1, 0.0), (2, 0.6))]
    said, made = told(), {"output": str(tmp_path / "d.tif"), "align": align}
    run_stage("change", {"before": paths[0], "after": paths[1], **made}, said)
    assert [each.id for each in said.warnings] == ids
