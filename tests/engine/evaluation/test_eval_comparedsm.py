from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest
from osgeo import gdal
from pyproj import Transformer
from pyproj.transformer import TransformerGroup

from repm_qgis.contracts.errors import Cancelled, EmptyResultError, ImageError, OptionError, OverlapError
from repm_qgis.evaluation.comparison import compare as compare_rasters
from repm_qgis.evaluation.grids import Grid, metres_per_unit
from repm_qgis.evaluation.parameters import EVALUATION
from repm_qgis.evaluation.profiles import read_lines
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage

ORIGIN = (500000.0, 5000000.0)


class Watch(Silent):
    def __init__(self):
        self.fractions, self.warnings = [], []

    def step(self, fraction, text=""):
        self.fractions.append(fraction)

    def warn(self, text):
        self.warnings.append(text)


def compare(dsm, reference, progress=None, **options):
    return run_stage("comparedsm", {"dsm": dsm, "reference": reference, **options}, progress or Silent())


def score(shared_data, dsm, reference):
    tool = shared_data.parent / "tools" / "score_dsm.py"
    if not tool.exists():
        pytest.skip(f"{tool} is absent")
    done = subprocess.run(
        [sys.executable, str(tool), dsm, reference, "--json"], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)["raw"]


@pytest.mark.parametrize(
    ("moved", "height", "distance"),
    [((0.0, 0.0, 1.25), 1.25, 1.0), ((1.0, 0.0, 0.0), -0.75, -0.6), ((-0.6, 0.0, 0.8), 1.25, 1.0)],
    ids=["up", "down the slope", "along the normal"],
)
def test_distances_along_the_normal_of_a_tilted_plane(make_raster, tmp_path, moved, height, distance):
    """A plane that rises by 3 m on 4 m: its normal is (-0.6, 0, 0.8)."""
    east = np.tile(0.5 / 0.9996 * (np.arange(60) + 0.5), (50, 1))  # cells of 0.5 m on UTM's central meridian
    reference, dsm = 0.75 * east, 0.75 * (east - moved[0]) + moved[2]
    reference[20:24, 30:36] = np.nan  # its border has no slope
    page = tmp_path / "r.html"
    got = compare(make_raster("dsm.tif", dsm), make_raster("ref.tif", reference), report=str(page))
    assert got.bias == pytest.approx(height, abs=1e-4) and got.cells == 60 * 50 - 24
    normal = got.along_normals
    assert normal.bias == pytest.approx(distance, abs=0.003) and normal.rmse == pytest.approx(abs(distance), abs=1e-4)
    assert normal.cells == 58 * 48 - 24 - 2 * (4 + 6)  # neither the raster's rim, nor the hole's four sides
    assert "along the normal" in page.read_text(encoding="utf-8")


def test_numbers_raster_and_report(make_raster, tmp_path, terrain):
    rng = np.random.default_rng(1)
    reference = terrain(300, 340)
    error = rng.normal(0.4, 0.3, reference.shape).astype(np.float32)
    dsm = reference + error
    dsm[40:80, 100:200] = np.nan
    reference[:, :30] = np.nan
    a, b = make_raster("dsm.tif", dsm), make_raster("ref.tif", reference)
    watch = Watch()
    got = compare(a, b, watch, error=str(tmp_path / "e.tif"), report=str(tmp_path / "r.html"), thresholds=[0.5, 1])
    e = (gdal.Open(a).ReadAsArray() - gdal.Open(b).ReadAsArray())[np.isfinite(dsm) & np.isfinite(reference)].astype(
        float
    )
    n = np.isfinite(reference).sum()
    assert got.cells == e.size
    assert got.rmse == pytest.approx(np.sqrt((e**2).mean()), abs=1e-6)
    assert got.medae == pytest.approx(np.median(abs(e)), abs=1e-6)
    assert got.mae == pytest.approx(abs(e).mean(), abs=1e-6)
    assert got.bias == pytest.approx(np.median(e), abs=1e-6)
    assert got.nmad == pytest.approx(1.4826 * np.median(abs(e - np.median(e))), abs=1e-6)
    assert got.valid == pytest.approx(100 * e.size / n, abs=1e-6)
    assert got.completeness == pytest.approx(100 * (abs(e) < 0.5).sum() / n, abs=1e-6)
    assert set(got.completeness_by_threshold) == {"0.5", "1"}
    json.dumps(got.to_mapping(), allow_nan=False)
    raster = gdal.Open(str(tmp_path / "e.tif"))
    values, band = raster.ReadAsArray(), raster.GetRasterBand(1)
    assert raster.GetGeoTransform() == gdal.Open(b).GetGeoTransform() and band.DataType == gdal.GDT_Float32
    assert band.GetBlockSize() == [256, 256]
    good = values != band.GetNoDataValue()
    assert np.array_equal(good, np.isfinite(dsm) & np.isfinite(reference))
    assert np.abs(values[good] - e).max() < 1e-4
    assert (tmp_path / "e.qml").exists() and not list(tmp_path.glob(".*"))
    assert "NMAD" in (tmp_path / "r.html").read_text(encoding="utf-8")
    assert watch.fractions == sorted(watch.fractions) and watch.fractions[-1] == 1.0


@pytest.mark.parametrize("align", ["none", "vertical", "3d"])
def test_alignment_removes_what_was_put_in(make_raster, align, terrain, told):
    a = make_raster("dsm.tif", terrain(300, 340), origin=(ORIGIN[0] + 1.8, ORIGIN[1] - 0.9))
    b = make_raster("ref.tif", terrain(300, 340) - 2.0)
    said = told()
    got = compare(a, b, said, align=align)
    moved = [note for note in said.notes if f"'{a}' was moved by {got.dx:+.3f} m to the east" in note]
    assert len(moved) == (align != "none")
    if align == "3d":
        assert (got.dx, got.dy, got.dz) == pytest.approx((-1.8, 0.9, -2.0), abs=0.025)
        assert got.rmse < 0.02
    elif align == "vertical":
        assert abs(got.bias) < 1e-5 and (got.dx, got.dy) == (0, 0) and got.rmse > 1
    else:
        assert (got.dx, got.dy, got.dz) == (0, 0, 0) and got.bias == pytest.approx(2.0, abs=0.5)


def test_other_grid_and_crs(make_raster, terrain, surface):
    """The same surface in two UTM zones and cell sizes; what is left is bilinear interpolation."""
    reference = make_raster(
        "ref.tif", terrain(200, 220, cell=1.0), cell=1.0, crs="EPSG:32631", origin=(499890.0, 5000000.0)
    )
    to_zone_31 = Transformer.from_crs("EPSG:32632", "EPSG:32631", always_xy=True)
    x0, y0 = Transformer.from_crs("EPSG:32631", "EPSG:32632", always_xy=True).transform(499900.0, 4999980.0)
    row, column = np.mgrid[:300, :320].astype(float)
    x, y = to_zone_31.transform(x0 + (column + 0.5) * 0.5, y0 - (row + 0.5) * 0.5)
    dsm = make_raster(
        "dsm.tif", surface(x - 499890.0, y - 5000000.0) + 0.5, cell=0.5, crs="EPSG:32632", origin=(x0, y0)
    )
    got = compare(dsm, reference)
    assert got.cells > 15000
    assert got.bias == pytest.approx(0.5, abs=0.01) and got.nmad < 0.05
    moved = compare(dsm, reference, align="3d")
    assert np.hypot(moved.dx, moved.dy) < 0.05 and moved.dz == pytest.approx(-0.5, abs=0.01)


def test_reference_in_degrees(make_raster, surface):
    """Shifts come in metres although the reference's unit is the degree."""
    cell = 1e-5
    grid = Grid("", (300, 260), (5.4, cell, 0, 43.3, 0, -cell), "EPSG:4326")
    mx, my = metres_per_unit(grid)
    row, column = np.mgrid[:260, :300].astype(float)

    def at(dx, dy):
        return surface((column + 0.5) * cell * mx - dx, -(row + 0.5) * cell * my - dy)

    b = make_raster("ref.tif", at(0, 0), cell=cell, crs="EPSG:4326", origin=(5.4, 43.3))
    a = make_raster("dsm.tif", at(2.2, -1.4) + 1, cell=cell, crs="EPSG:4326", origin=(5.4, 43.3))
    got = compare(a, b, align="3d")
    assert (got.dx, got.dy, got.dz) == pytest.approx((-2.2, 1.4, -1.0), abs=0.04)


def test_metres_per_degree_against_geodesics():
    from pyproj import Geod

    grid = Grid("", (2, 2), (5.0, 0.01, 0, 45.01, 0, -0.01), "EPSG:4326")
    geod = Geod(ellps="WGS84")
    _, _, east = geod.inv(5.0, 45.0, 5.001, 45.0)
    _, _, north = geod.inv(5.0, 44.9995, 5.0, 45.0005)
    assert metres_per_unit(grid) == pytest.approx((east * 1000, north * 1000), rel=1e-6)


def test_holes_do_not_bleed(make_raster):
    dsm = np.full((60, 60), 10.0)
    dsm[:, 30:] = np.nan
    dsm[10, 10] = np.nan
    a = make_raster("dsm.tif", dsm, origin=(ORIGIN[0] + 0.2, ORIGIN[1]), nodata=-32768.0)
    b = make_raster("ref.tif", np.full((60, 60), 10.0))
    got = compare(a, b)
    assert got.rmse < 1e-6
    # the edge and the single hole keep their places (the nearest cells of the DSM's are those of the same number)
    assert got.cells == 60 * 30 - 1


@pytest.mark.parametrize("missing", [np.nan, -9999.0])
def test_undeclared_nodata(make_raster, missing):
    dsm = np.full((50, 50), 7.0)
    dsm[5:10] = missing
    got = compare(make_raster("dsm.tif", dsm, nodata=None), make_raster("ref.tif", np.full((50, 50), 6.0)))
    assert got.cells == 2250 and got.rmse == pytest.approx(1.0)


@pytest.mark.parametrize("site", ["pleiades_pair", "pleiades_triplet", "truth_urban"])
@pytest.mark.long
def test_agrees_with_the_scoring_tool_on_real_dsms(shared_data, make_raster, site):
    path = shared_data / site / ("truth.tif" if site == "truth_urban" else "s2p_dsm.tif")
    dataset = gdal.Open(str(path))
    z = dataset.ReadAsArray().astype(np.float32)
    z[z < -9000] = np.nan
    gt = dataset.GetGeoTransform()
    rng = np.random.default_rng(4)
    noisy = z + rng.normal(0.2, 0.4, z.shape)
    dsm = make_raster("dsm.tif", noisy, origin=(gt[0] + 0.13, gt[3] - 0.21), cell=gt[1], wkt=dataset.GetProjection())
    got, want = compare(dsm, str(path), thresholds=[1, 2.5, 5]), score(shared_data, dsm, str(path))
    assert got.nmad == pytest.approx(want["NMAD"], abs=0.01)
    assert got.bias == pytest.approx(want["bias"], abs=0.01)
    assert got.medae == pytest.approx(want["ME"], abs=0.01)
    # only holes differ: the tool's resampling closes small ones, ours keeps their size
    assert np.isfinite(z).sum() == pytest.approx(got.cells / got.valid * 100)
    assert 98 < got.valid <= want["valid"] + 0.01
    assert want["C1"] - 3 < got.completeness <= want["C1"] + 0.01
    same = make_raster("same.tif", z + 0.25, origin=(gt[0], gt[3]), cell=gt[1], wkt=dataset.GetProjection())
    above = compare(same, str(path))
    assert above.rmse == pytest.approx(0.25, abs=1e-4) and above.valid == pytest.approx(100)


@pytest.mark.long
def test_identical_grids_agree_exactly_with_the_tool(shared_data, make_raster):
    path = shared_data / "truth_urban" / "truth.tif"
    dataset = gdal.Open(str(path))
    z = dataset.ReadAsArray().astype(np.float32)
    gt = dataset.GetGeoTransform()
    rng = np.random.default_rng(4)
    noisy = np.where((z > -9000) & (rng.random(z.shape) > 0.1), z + rng.normal(0.2, 0.4, z.shape), np.nan)
    dsm = make_raster("dsm.tif", noisy, origin=(gt[0], gt[3]), cell=gt[1], wkt=dataset.GetProjection())
    got, want = compare(dsm, str(path)), score(shared_data, dsm, str(path))
    for ours, theirs in (
        ("rmse", "RMSE"),
        ("medae", "ME"),
        ("mae", "MAE"),
        ("nmad", "NMAD"),
        ("bias", "bias"),
        ("valid", "valid"),
        ("completeness", "C1"),
    ):
        assert getattr(got, ours) == pytest.approx(want[theirs], abs=0.00051), ours


def test_vertical_datums_that_differ(make_raster, terrain):
    """Ellipsoidal heights against EGM96, checked with pyproj's own answer."""
    group = TransformerGroup("EPSG:4979", "EPSG:4326+5773", always_xy=True, allow_ballpark=False)
    if not group.transformers:
        pytest.skip("PROJ's EGM96 grid is not installed")
    lon, lat = Transformer.from_crs("EPSG:32631", 4326, always_xy=True).transform(500025.0, 4999975.0)
    geoid = -group.transformers[0].transform(lon, lat, 0.0)[2]
    z = terrain(100, 100)
    a = make_raster("dsm.tif", z + geoid, wkt=ellipsoidal_utm31())
    b = make_raster("ref.tif", z, crs="EPSG:32631+5773")
    got = compare(a, b)
    assert abs(geoid) > 40
    assert abs(got.bias) < 0.01 and got.nmad < 0.01


def ellipsoidal_utm31():
    from pyproj import CRS

    return CRS("EPSG:32631").to_3d().to_wkt("WKT2_2019")


def test_our_own_dsms_say_that_they_are_ellipsoidal(make_raster, terrain):
    """Without a vertical CRS, which GeoTIFF keys cannot hold, but in the metadata."""
    group = TransformerGroup("EPSG:4979", "EPSG:4326+5773", always_xy=True, allow_ballpark=False)
    if not group.transformers:
        pytest.skip("PROJ's EGM96 grid is not installed")
    lon, lat = Transformer.from_crs("EPSG:32631", 4326, always_xy=True).transform(500025.0, 4999975.0)
    a = make_raster("dsm.tif", terrain(100, 100) - group.transformers[0].transform(lon, lat, 0.0)[2])
    dataset = gdal.Open(a, gdal.GA_Update)
    dataset.SetMetadataItem("VERTICAL_DATUM", "WGS 84 ellipsoid")
    dataset = None  # noqa: F841
    watch = Watch()
    got = compare(a, make_raster("ref.tif", terrain(100, 100), crs="EPSG:32631+5773"), watch)
    assert abs(got.bias) < 0.01 and got.nmad < 0.01 and not watch.warnings


def test_missing_vertical_grid_is_named(make_raster, terrain):
    group = TransformerGroup("EPSG:4979", "EPSG:4326+3855", always_xy=True, allow_ballpark=False)
    if group.transformers:
        pytest.skip("PROJ's EGM2008 grid is installed here")
    a = make_raster("dsm.tif", terrain(50, 50), wkt=ellipsoidal_utm31())
    b = make_raster("ref.tif", terrain(50, 50), crs="EPSG:32631+3855")
    with pytest.raises(ImageError, match=r"EGM2008.*us_nga_egm08.* not installed: .* put https"):
        compare(a, b)


def test_one_silent_datum_is_a_warning(make_raster, terrain):
    watch = Watch()
    compare(
        make_raster("dsm.tif", terrain(50, 50)), make_raster("ref.tif", terrain(50, 50), crs="EPSG:32631+5773"), watch
    )
    assert len(watch.warnings) == 1 and "dsm.tif" in watch.warnings[0] and "EGM96" in watch.warnings[0]


def test_apart_says_both_extents(make_raster, terrain):
    a, b = (
        make_raster("dsm.tif", terrain(50, 50)),
        make_raster("ref.tif", terrain(50, 50), origin=(510000.0, 5000000.0)),
    )
    with pytest.raises(OverlapError, match=r"500000\.\.500025.*510000\.\.510025"):
        compare(a, b)


def test_nothing_in_common_but_frames(make_raster, tmp_path, terrain):
    left, right = terrain(60, 60), terrain(60, 60)
    left[:, 30:] = np.nan
    right[:, :30] = np.nan
    a, b = make_raster("dsm.tif", left), make_raster("ref.tif", right)
    with pytest.raises(EmptyResultError, match="1800 cells"):
        compare(a, b, error=str(tmp_path / "e.tif"))
    assert not (tmp_path / "e.tif").exists() and not list(tmp_path.glob(".*"))
    with pytest.raises(EmptyResultError, match="Cells with a height in both the DSM and the reference: 0;"):
        compare(a, b, align="vertical")


def test_bad_files(make_raster, tmp_path, terrain):
    good = make_raster("good.tif", terrain(50, 50))
    with pytest.raises(ImageError, match="absent.tif.*does not exist"):
        compare(str(tmp_path / "absent.tif"), good)
    (tmp_path / "text.tif").write_text("no raster")
    with pytest.raises(ImageError, match="text.tif"):
        compare(good, str(tmp_path / "text.tif"))
    with pytest.raises(ImageError, match="bare.tif.*no coordinate reference system"):
        compare(make_raster("bare.tif", terrain(50, 50), crs=None), good)
    whole = Path(make_raster("cut.tif", np.random.default_rng(0).normal(size=(400, 400)))).read_bytes()
    (tmp_path / "cut.tif").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ImageError, match="cut.tif"):
        compare(str(tmp_path / "cut.tif"), make_raster("large.tif", terrain(400, 400)))


@pytest.mark.parametrize("turn, is_turned", ((1e-4, True), (1e-12, False)))
def test_a_turned_reference_is_refused_and_rounding_turns_nothing(make_raster, terrain, turn, is_turned):
    dsm, reference = make_raster("dsm.tif", terrain(50, 50)), make_raster("turned.tif", terrain(50, 50))
    dataset = gdal.Open(reference, gdal.GA_Update)
    dataset.SetGeoTransform((500000.0, 0.5, turn, 5000000.0, turn, -0.5))
    grid = Grid.of(dataset)
    dataset = None
    assert grid.is_turned == is_turned and grid.is_north_up != is_turned
    mirrored = replace(grid, transform=(500000.0, 0.5, 0.0, 5000000.0, 0.0, 0.5))
    assert not mirrored.is_turned and not mirrored.is_north_up
    if is_turned:
        with pytest.raises(ImageError, match="turned.tif' has a rotated grid: bring it north up first"):
            compare(dsm, reference)
    else:
        assert compare(dsm, reference).rmse < 1e-3


def test_cancel_leaves_nothing(make_raster, tmp_path, terrain):
    class Stop(Silent):
        def check_cancelled(self):
            raise Cancelled

    a, b = make_raster("dsm.tif", terrain(50, 50) + 0.1), make_raster("reference.tif", terrain(50, 50))
    with pytest.raises(Cancelled):
        compare(a, b, Stop(), error=str(tmp_path / "e.tif"), report=str(tmp_path / "r.html"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["dsm.tif", "reference.tif"]


def test_a_surface_is_not_compared_with_itself(make_raster, tmp_path, terrain):
    """QGIS proposes the first layer for each input; the report would find no errors."""
    a, b = make_raster("dsm.tif", terrain(50, 50)), make_raster("other.tif", terrain(50, 50))
    (tmp_path / "below").mkdir()
    for reference, others, words in (
        (str(tmp_path / "below" / ".." / "dsm.tif"), [], "is the same file as DSM"),
        (b, [b], "is the same file as OTHERS"),
    ):
        with pytest.raises(OptionError, match=words):
            compare(a, reference, others=others, report=str(tmp_path / "r.html"))
    assert not (tmp_path / "r.html").exists()


def test_blocks_do_not_show(make_raster, terrain):
    a = make_raster("dsm.tif", terrain(150, 170, 0.3, 0.4), origin=(ORIGIN[0] - 3.2, ORIGIN[1] + 2.7))
    b = make_raster("ref.tif", terrain(150, 170))
    small = replace(EVALUATION, comparison=replace(EVALUATION.comparison, block_cells=64))
    whole, parts = (
        compare_rasters(gdal.Open(a), gdal.Open(b), "none", thresholds=(1.0,), progress=Silent(), parameters=parameters)
        for parameters in (EVALUATION, small)
    )
    one, many = whole.thumbnails["error"], parts.thumbnails["error"]
    assert one.shape == (150, 170)
    assert np.array_equal(np.isnan(one), np.isnan(many)) and np.nanmax(np.abs(one - many)) < 1e-3
    assert parts.metrics.rmse == pytest.approx(whole.metrics.rmse, abs=1e-5)


def test_errors_by_class_equal_an_independent_count(make_raster, terrain):
    """A class raster on a grid and in a CRS of its own: each reference cell has the class at its centre."""
    rng = np.random.default_rng(3)
    reference, cell = terrain(200, 240), 0.5
    error = rng.normal(0, 0.3, reference.shape).astype(np.float32)
    row, column = np.mgrid[:200, :240]
    east = column * cell >= 60  # the class raster's cells are 4 m wide and begin 20 m to the west and north
    error[east] += 1.0
    classes = np.ones((40, 40))
    classes[:, 20:] = 7  # from 20 * 4 - 20 = 60 m on
    classes[:, 34:] = np.nan
    names = make_raster("classes.tif", classes, origin=(ORIGIN[0] - 20, ORIGIN[1] + 20), cell=4.0)
    got = compare(make_raster("dsm.tif", reference + error), make_raster("ref.tif", reference), classes=names)
    assert set(got.by_class) == {"1", "7"}
    where = {"1": ~east, "7": east & (column * cell < 34 * 4 - 20)}
    for name, inside in where.items():
        e = error[inside].astype(float)
        assert got.by_class[name].cells == inside.sum()
        assert got.by_class[name].rmse == pytest.approx(np.sqrt((e**2).mean()), abs=1e-5)
        assert got.by_class[name].bias == pytest.approx(np.median(e), abs=0.005)
        assert got.by_class[name].completeness == pytest.approx(100 * (abs(e) < 1).mean(), abs=0.01)


def test_classes_have_their_names_and_are_few(make_raster, terrain, tmp_path):
    classes = np.ones((100, 100))
    classes[:50] = 2
    path = make_raster("cover.tif", classes)
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.GetRasterBand(1).SetCategoryNames(["", "roofs", "ground"])
    dataset = None  # noqa: F841
    a, b = make_raster("dsm.tif", terrain(100, 100) + 0.1), make_raster("reference.tif", terrain(100, 100))
    got = compare(a, b, classes=path, report=str(tmp_path / "r.html"))
    assert list(got.by_class) == ["roofs", "ground"] and got.by_class["roofs"].cells == 5000
    assert "roofs" in (tmp_path / "r.html").read_text(encoding="utf-8")
    with pytest.raises(ImageError, match=r"noclass.tif.*whole numbers"):
        compare(a, b, classes=make_raster("noclass.tif", terrain(100, 100)))


def test_several_dsms_in_one_table(make_raster, terrain, tmp_path):
    reference = terrain(100, 100)
    first = make_raster("first.tif", reference + 0.25)
    (tmp_path / "peer").mkdir()
    second = make_raster("peer/first.tif", reference - 0.5)
    got = compare(
        first,
        make_raster("ref.tif", reference),
        others=[second],
        error=str(tmp_path / "e.tif"),
        report=str(tmp_path / "r.html"),
    )
    assert got.bias == pytest.approx(0.25, abs=1e-5)
    assert [(one.dsm, round(one.bias, 4)) for one in got.others] == [(second, -0.5)]
    error = gdal.Open(str(tmp_path / "e.tif")).ReadAsArray()
    assert np.median(error) == pytest.approx(0.25, abs=1e-4)  # the first one's errors
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Side by side" in page and ">peer/first<" in page


def line_layer(path, crs, **lines):
    from osgeo import ogr

    from repm_qgis.files.vector import write_layer

    def shape(points):
        line = ogr.Geometry(ogr.wkbLineString)
        for x, y in points:
            line.AddPoint_2D(x, y)
        return line

    return write_layer(path, crs, ogr.wkbLineString, {"name": str}, [(shape(p), [n]) for n, p in lines.items()])


def test_profiles_follow_lines_of_another_crs(make_raster, terrain, surface, tmp_path):
    """A bent line in longitude and latitude: heights are the surface's own there, at distances from the start."""
    corners = [(10.0, -20.0), (70.0, -60.0), (90.0, -15.0)]  # m from the origin
    to_degrees = Transformer.from_crs("EPSG:32631", 4326, always_xy=True)
    path = line_layer(
        str(tmp_path / "cuts.gpkg"),
        "EPSG:4326",
        ridge=[to_degrees.transform(ORIGIN[0] + x, ORIGIN[1] + y) for x, y in corners],
    )
    a = gdal.Open(make_raster("dsm.tif", terrain(200, 240) + 2))
    b = gdal.Open(make_raster("ref.tif", terrain(200, 240)))
    lines = read_lines(path, Grid.of(b))
    assert [line.name for line in lines] == ["ridge"]
    (profile,) = compare_rasters(a, b, "none", thresholds=(1.0,), progress=Silent(), lines=lines).profiles
    lengths = np.hypot(*np.diff(corners, axis=0).T)
    assert profile.distance[0] < 0.5 and profile.distance[-1] == pytest.approx(lengths.sum(), abs=0.5)
    part = profile.distance < lengths[0]
    share = profile.distance[part] / lengths[0]
    x, y = (corners[0][i] + share * (corners[1][i] - corners[0][i]) for i in (0, 1))
    assert np.abs(profile.reference[part] - surface(x, y)).max() < 0.1
    assert np.nanmedian(profile.dsm - profile.reference) == pytest.approx(2.0, abs=1e-3)


def test_what_is_no_line_layer_is_named(make_raster, terrain, tmp_path):
    from repm_qgis.contracts.errors import InputTableError

    a, b = make_raster("dsm.tif", terrain(60, 60) + 0.1), make_raster("reference.tif", terrain(60, 60))
    with pytest.raises(InputTableError, match="none.gpkg"):
        compare(a, b, profiles=str(tmp_path / "none.gpkg"))
    (tmp_path / "empty.geojson").write_text('{"type":"FeatureCollection","features":[]}')
    with pytest.raises(InputTableError, match="empty.geojson.*no line"):
        compare(a, b, profiles=str(tmp_path / "empty.geojson"))


def test_a_reference_of_90_m_covers_a_dsm_with_many_holes_and_that_is_said(make_raster):
    """A DSM of 450 m at 2 m with heights in 40 % of its rows: no cell of 90 m is half full. With 60 % they are."""
    row = np.arange(225)[:, None] % 5
    reference = make_raster("ref.tif", np.full((20, 20), 200.0), cell=90.0)
    for known, fits in ((3, True), (2, False)):
        heights = np.where((row < known) & np.ones(225, bool), 201.0, np.nan).astype(np.float32)
        dsm = make_raster(f"dsm{known}.tif", heights, cell=2.0)
        if fits:
            got = compare(dsm, reference)
            assert got.cells >= 25 and got.bias == pytest.approx(1.0, abs=1e-3)
            with pytest.raises(EmptyResultError, match="or has smaller cells, or set ALIGN to none"):
                compare(dsm, reference, align="3d")
            continue
        for method in ("none", "3d"):
            with pytest.raises(EmptyResultError) as caught:
                compare(dsm, reference, align=method)
            for words in ("covers the DSM", "90 x 90 m", "less than 50 % of each", "RESOLUTION"):
                assert words in str(caught.value)
    holes = np.full((20, 20), 200.0, np.float32)
    holes[:12, :12] = np.nan
    with pytest.raises(EmptyResultError, match="choose a reference that covers the DSM"):
        compare(dsm, make_raster("holes.tif", holes, cell=90.0))


@pytest.mark.parametrize("wrong", ["scaled", "displaced", "upside down"])
def test_a_dsm_that_shows_another_surface_is_not_called_good(make_raster, tmp_path, terrain, wrong):
    """Nothing in the figures of the mean tells: the alignment removes that. The spread does."""
    truth = 10.0 * terrain(300, 340)
    bad = {"scaled": 3.28 * truth, "displaced": np.roll(truth, 90, axis=1), "upside down": -truth}[wrong]
    reference, sound = make_raster("ref.tif", truth), make_raster("sound.tif", truth + 0.3)
    tops = {}
    for name, dsm, others in (
        ("sound", sound, []),
        ("bad", make_raster("bad.tif", bad), []),
        ("both", sound, [make_raster("bad.tif", bad)]),
    ):
        report = tmp_path / f"{name}.html"
        got = compare(dsm, reference, align="vertical", others=others, report=str(report))
        tops[name] = report.read_text(encoding="utf-8").split("<h2")[0]
        assert (got.nmad > 10) == (name == "bad")
    assert "Good." in tops["sound"]
    assert "Good." not in tops["bad"] and "do not show the same surface" in tops["bad"]
    assert "Good." not in tops["both"] and "&#39;bad&#39;: The heights spread" in tops["both"]


@pytest.mark.parametrize("crs", ("EPSG:32631", "EPSG:3857", "EPSG:3035", "EPSG:2154"))
def test_heights_change_their_datum_in_any_projection(make_raster, crs):
    """From Web Mercator with ellipsoidal heights PROJ applied no geoid, and said nothing: 50 m."""
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(5.0, 45.0)
    dsm = make_raster("dsm.tif", np.full((40, 40), 300.0), (x, y), 4.0, crs)
    dataset = gdal.Open(dsm, gdal.GA_Update)
    dataset.SetMetadataItem("VERTICAL_DATUM", "WGS 84 ellipsoid")
    dataset = None  # noqa: F841
    place = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32631", always_xy=True).transform(5.0, 45.0)
    reference = make_raster("ref.tif", np.full((60, 60), 240.0), (place[0] - 40, place[1] + 40), 4.0, "EPSG:32631+5773")
    got = compare(dsm, reference)
    above = -pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4326+5773", always_xy=True).transform(5.0, 45.0, 0.0)[2]
    assert got.bias == pytest.approx(60.0 - above, abs=0.05)
