"""repm:inspect: two layers and a page, and bad images that stop nobody."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import ImageError, OptionError
from repm_qgis.stages import run_stage
from tests.engine.pages import plain


def rows(path):
    source = ogr.Open(str(path))
    layer = source.GetLayer(0)
    found = [dict(feature.items(), shape=feature.GetGeometryRef().Clone()) for feature in layer]
    place = layer.GetSpatialRef().GetAuthorityCode(None)
    layer = source = None  # noqa: F841
    return found, place


@pytest.fixture
def job(tmp_path):
    def make(images, **options):
        names = {"footprints": "footprints.gpkg", "overlaps": "overlaps.gpkg", "report": "page.html"}
        return {"images": images, **{key: str(tmp_path / name) for key, name in names.items()}, **options}

    return make


def test_layers_and_page(urban, job, told, tmp_path):
    said, start = told(), time.monotonic()
    result = run_stage("inspect", job(urban.images), said)
    assert time.monotonic() - start < 5 and not said.warnings
    assert (result.n_images, result.n_pairs) == (3, 3)
    footprints, place = rows(result.footprints)
    assert f"EPSG:{place}" == urban.crs
    assert [row["view"] for row in footprints] == [view.name for view in urban.views]
    for row, view in zip(footprints, urban.views):
        area = view.width * view.height * view.gsd_m**2
        assert row["shape"].GetArea() == pytest.approx(area, rel=0.1) and row["gsd"] == view.gsd_m
    overlaps, place = rows(result.overlaps)
    assert f"EPSG:{place}" == urban.crs and len(overlaps) == 3
    by_name = {row["view"]: row["shape"] for row in footprints}
    for row in overlaps:
        common = by_name[row["first"]].Intersection(by_name[row["second"]])
        assert row["area_km2"] * 1e6 == pytest.approx(common.GetArea(), rel=1e-6)
        assert row["worth"] == "yes" and row["matched"] == 1
    for name in ("footprints", "overlaps"):
        assert (tmp_path / f"{name}.qml").read_text(encoding="utf-8").startswith("<!DOCTYPE qgis")
    page = plain((tmp_path / "page.html").read_text(encoding="utf-8"))
    verdict = "Good: 3 pairs of 3 are worth matching; begin with"
    assert any(verdict in note for note in said.notes)
    assert sorted(result.triplet) == sorted(urban.images) and set(result.pair) < set(urban.images)
    assert page.count('<figure><img src="data:image/png') == 3  # small pictures
    for words in ("the best pair</td>", "the best triplet</td>", "the message above the map"):
        assert words in page, words
    for words in (verdict, "Footprints at", "A small area to start with", f"[{urban.crs}]", "accuracy, m"):
        assert words in page, words


def test_the_proposed_area_is_one_that_the_first_stage_takes(urban, job, told, tmp_path):
    import re

    run_stage("inspect", job(urban.images), told())
    page = plain((tmp_path / "page.html").read_text(encoding="utf-8"))
    found = re.search(r"<pre>(-?\d+),(-?\d+),(-?\d+),(-?\d+) \[(EPSG:\d+)\]</pre>", page)
    xmin, xmax, ymin, ymax = map(float, found.groups()[:4])
    fitted = {"images": urban.images, "workspace": str(tmp_path / "w"), "extent": (xmin, ymin, xmax, ymax)}
    result = run_stage("epmfit", {**fitted, "extent_crs": found[5]}, told())
    bounds = [row["shape"].GetEnvelope() for row in rows(result.tiles)[0]]
    assert max(box[1] for box in bounds) - min(box[0] for box in bounds) <= xmax - xmin + 2


def test_bad_images_are_named_and_stop_nobody(urban, job, told, tmp_path, write_image):
    (tmp_path / "text.tif").write_text("no image")
    bare = write_image(tmp_path / "no_rpc.tif")
    bad = [str(tmp_path / "text.tif"), bare, str(tmp_path / "gone.tif")]
    said = told()
    result = run_stage("inspect", job([bad[0], *urban.images[:2], *bad[1:]]), said)
    assert (result.n_images, result.n_pairs) == (2, 1)
    assert len(said.warnings) == 3
    page = plain((tmp_path / "page.html").read_text(encoding="utf-8"))
    for name, why in (("text.tif", "Cannot open"), ("no_rpc.tif", "No RPC found"), ("gone.tif", "")):
        assert any(f"'{name}' cannot be used: " in text and why in text for text in said.warnings)
        assert name in page
    assert "3 images cannot be used." in page
    with pytest.raises(ImageError, match="No image can be used .images: 3.; 'text.tif': Cannot open"):
        run_stage("inspect", job(bad), told())


@pytest.mark.parametrize(
    ("change", "words"), (({}, "is a copy of img_01: only img_01 is used"), ({"pixels": 1}, "have the same RPC"))
)
def test_an_image_and_its_copy_are_named(urban, job, told, tmp_path, change, words):
    """ZeroDivisionError: both look from the same direction."""
    copy = str(tmp_path / "again.tif")
    gdal.Translate(copy, urban.images[0])
    if change:
        dataset = gdal.Open(copy, gdal.GA_Update)
        band = dataset.GetRasterBand(1)
        band.WriteArray(band.ReadAsArray()[::-1])
        dataset = band = None
    said = told()
    result = run_stage("inspect", job([urban.images[0], copy]), said)
    assert result.n_images == 1 and any(words in text for text in said.warnings)
    page = plain((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert words in page and "One image alone gives no heights" in page


def test_outlines_lie_at_the_altitude_of_the_ground(shared_data, job, told, tmp_path):
    """The RPCs' middle height is 1295 m, the ground lies at 2331 m: 47 % of overlap where it is nearly all."""
    result = run_stage(
        "inspect", job([str(path) for path in sorted((shared_data / "pleiades_pair").glob("img*.tif"))]), told()
    )
    (overlap,), _ = rows(result.overlaps)
    assert overlap["percent"] > 95
    assert all(2200 < row["altitude"] < 2450 for row in rows(result.footprints)[0])
    assert "(where the images show the ground)" in plain((tmp_path / "page.html").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("count", "words"),
    ((1, "One image alone gives no heights: add another image of the same ground."), (2, "Good: 1 pair of 1 is worth")),
)
def test_the_verdict(urban, job, told, count, words):
    said = told()
    run_stage("inspect", job(urban.images[:count]), said)
    assert any(words in note for note in said.notes)


def test_images_of_two_places_go_into_one_layer(urban, shared_data, job, told):
    images = [*urban.images[:2], *map(str, sorted((shared_data / "pleiades_pair").glob("img*.tif")))]
    said = told()
    result = run_stage("inspect", job(images), said)
    footprints, place = rows(result.footprints)
    assert place == "4326" and len({round(row["shape"].Centroid().GetX()) for row in footprints}) == 2
    assert len(rows(result.overlaps)[0]) == 2 and any("The images show 2 places" in note for note in said.notes)
    assert [row["satellite"] for row in footprints].count("Pleiades 1B") == 2
    assert ">Pleiades 1B</td>" in Path(result.report).read_text(encoding="utf-8")


def test_images_that_show_different_ground(urban, shared_data, job, told):
    said = told()
    result = run_stage("inspect", job([urban.images[0], str(shared_data / "pleiades_pair" / "img_01.tif")]), said)
    assert result.n_pairs == 0 and rows(result.overlaps)[0] == []
    assert any("No two of these 2 images show the same ground" in note for note in said.notes)


@pytest.mark.parametrize(
    ("options", "words"),
    (
        ({"images": []}, "IMAGES is .* must name an image"),
        ({"images": ["a.tif", "a.tif"]}, "must not name the same image twice"),
        ({"images": ["a.tif"], "rpcs": ["b", "c"]}, "must be empty, or name 1 files"),
    ),
)
def test_options_that_make_no_sense(options, words, told):
    with pytest.raises(OptionError, match=words):
        run_stage("inspect", options, told())


@pytest.mark.long
def test_rows_are_sorted_and_each_choice_has_a_time(shared_data, job, told, tmp_path):
    """The best pair of the real town's January first, then a third image that fits both; times as runs took."""
    images = [str(shared_data / "jax_068" / f"JAX_068_{name}_RGB.tif") for name in ("013", "012", "009", "011", "001")]
    result = run_stage("inspect", job(images), told())
    assert [Path(path).name[8:11] for path in result.triplet] == ["009", "011", "012"]
    footprints, _ = rows(result.footprints)
    assert [row["taken"] for row in footprints] == sorted(row["taken"] for row in footprints)
    page = plain((tmp_path / "page.html").read_text(encoding="utf-8"))
    told_s = [int(each) for each in re.findall(r'<td class="n">(\d+) s</td>', page.split("all images")[0])]
    # A core takes 5.3 s and 10.9 s for the pair and the triplet where other work goes on; two workers share it.
    assert len(told_s) == 2 and told_s[0] <= told_s[1]
    for seconds, core_s in zip(told_s, (5.3, 10.9)):
        assert core_s / 2 / 2 <= seconds <= 2 * core_s
