"""The page of a surface: it holds what the rasters hold, to the step that it states, and needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyproj
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import EmptyResultError, ImageError, OptionError, OverlapError
from repm_qgis.evaluation.grids import Grid
from repm_qgis.imagery.raster import opened, write
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.runtime.translation import written_in
from repm_qgis.stages import run_stage
from repm_qgis.viewer.parameters import ViewerParameters
from repm_qgis.viewer.surface import page_grid, without_holes
from tests.english import english_in

ROOT = Path(__file__).resolve().parents[3]
UTM = pyproj.CRS("EPSG:32631").to_wkt()
PLACE = (500000.0, 0.5, 0.0, 4800000.0, 0.0, -0.5)


def raster(path, values, place=PLACE, crs=UTM, **options):
    bands = values if isinstance(values, list) else [values]
    return write(str(path), [np.asarray(band) for band in bands], place, crs, **options)


def hilly(rows=90, columns=130):
    y, x = np.mgrid[0:rows, 0:columns]
    return (220 + 15 * np.sin(x / 17) * np.cos(y / 11) + 0.02 * x).astype(np.float32)


class Parts(HTMLParser):
    """The scripts by their ids, all text outside of them, and every address."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.scripts, self.text, self.addresses, self.tags, self._open = {}, [], [], [], None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.append(tag)
        self.addresses += [given[name] for name in ("src", "href", "data", "action") if name in given]
        self._open = given.get("id", "script") if tag in ("script", "style") else None
        if self._open:
            self.scripts[self._open] = ""

    def handle_endtag(self, tag):
        self._open = None

    def handle_data(self, data):
        if self._open:
            self.scripts[self._open] += data
        else:
            self.text.append(data)


def page_of(folder, dsm, **given):
    """The page's parts, its facts, and what the stage gave."""
    target = folder / "page.html"
    made = run_stage("viewer", {"dsm": str(dsm), "viewer": str(target), **given}, Silent())
    parts = Parts(target.read_text(encoding="utf-8"))
    return parts, json.loads(parts.scripts["facts"]), made


def inflated(text):
    return zlib.decompress(base64.b64decode(text))


def heights_in(facts):
    """The heights as the script computes them, NaN where the mask has none."""
    columns, rows = facts["size"]
    low, high = np.frombuffer(inflated(facts["heights"]), np.uint8).reshape(2, rows, columns).astype(np.int64)
    steps = low + 256 * high
    steps[:, 0] = np.cumsum(steps[:, 0])
    levels = np.cumsum(steps, axis=1) % 65536
    heights = facts["low"] + levels * facts["quantum"]
    if facts["mask"]:
        bits = np.unpackbits(np.frombuffer(inflated(facts["mask"]), np.uint8))[: rows * columns]
        heights[bits.reshape(rows, columns) == 0] = np.nan
    return heights


def test_heights_are_those_of_the_file_to_a_centimetre(tmp_path):
    values = hilly()
    values[20:40, 30:60] = values[3, 5] = np.nan
    parts, facts, made = page_of(
        tmp_path, raster(tmp_path / "d.tif", values, metadata={"VERTICAL_DATUM": "EGM96 height"})
    )
    assert (made.columns, made.rows) == (130, 90) == tuple(facts["size"])
    np.testing.assert_allclose(heights_in(facts), values, atol=0.0051)
    assert facts["quantum"] == 0.01 and facts["cell_m"] == pytest.approx([0.5 / 0.9996] * 2)  # on the ground
    assert (facts["corner"], facts["step"]) == ([500000.0, 4800000.0], [0.5, -0.5])
    assert (facts["crs"], facts["datum"]) == ("WGS 84 / UTM zone 31N (EPSG:32631)", "EGM96 height")
    assert "is larger than this page" not in "".join(parts.text)


def test_a_range_of_more_than_16_bits_of_centimetres_has_larger_steps(tmp_path):
    values = hilly() * 20
    facts = page_of(tmp_path, raster(tmp_path / "d.tif", values))[1]
    assert 0.009 < facts["quantum"] < 0.02
    np.testing.assert_allclose(heights_in(facts), values, atol=facts["quantum"] / 2 + 1e-3)


def test_a_large_dsm_becomes_means_and_the_page_says_so(tmp_path):
    values = hilly(400, 600)
    values[:, 300:310] = np.nan
    parts, facts, made = page_of(tmp_path, raster(tmp_path / "d.tif", values), cells=10_000)
    columns, rows = facts["size"]
    assert columns * rows <= 10_000 and columns / rows == pytest.approx(1.5, rel=0.02) and made.rows == rows
    ratio = 600 / columns
    assert facts["step"][0] == pytest.approx(0.5 * ratio) and facts["step"][1] == pytest.approx(-0.5 * 400 / rows)
    found = heights_in(facts)
    # A mean over some cells of a smooth surface is its height at the middle of them.
    column, row = ((np.arange(n) + 0.5) * m / n - 0.5 for n, m in ((columns, 600), (rows, 400)))
    middle = 220 + 15 * np.sin(column / 17) * np.cos(row[:, None] / 11) + 0.02 * column
    assert np.nanmax(np.abs(found - middle)) < 0.4 and 0 < np.isnan(found).sum() <= 2 * rows
    text = " ".join("".join(parts.text).split())
    assert "each height is a mean of its cells" in text and "600 x 400" in text and f"{columns} x {rows}" in text


def test_no_page_is_wider_than_what_devices_show(tmp_path):
    grid = Grid("d.tif", (200_000, 30), PLACE, UTM)
    cells = page_grid(grid, 16_000_000)
    assert cells.size[0] <= 4096 and cells.bounds == pytest.approx(grid.bounds)
    assert page_grid(Grid("d.tif", (40, 30), PLACE, UTM), 16_000_000).size == (40, 30)
    assert page_grid(grid, 16_000_000, ViewerParameters(most_side=500)).size[0] <= 500


def test_holes_are_filled_only_for_the_shape_of_their_edges():
    values = hilly(40, 50)
    values[10:20, 10:30] = np.nan
    filled = without_holes(values)
    good = np.isfinite(values)
    assert (filled[good] == values[good]).all() and np.isfinite(filled).all()
    assert filled[~good].min() >= np.nanmin(values) and filled[~good].max() <= np.nanmax(values)
    assert (without_holes(np.full((3, 5), np.nan, np.float32)) == 0).all()


def values_in(layer, shape):
    stored = np.frombuffer(inflated(layer["values"]), np.uint8).reshape(shape)
    values = layer["low"] + (stored - 1.0) / 254 * (layer["high"] - layer["low"])
    return np.where(stored > 0, values, np.nan)


def test_draped_rasters_lie_where_they_belong(tmp_path):
    values = hilly()
    error = (0.2 + 0.004 * np.arange(130) + np.zeros((90, 1))).astype(np.float32)
    error[50:60, 50:60] = np.nan
    confidence = [np.ones_like(error)] * 4 + [error]
    # The same ground in another CRS' cells: a difference that grows to the north, m.
    coarse = (499990.0, 2.0, 0.0, 4800010.0, 0.0, -2.0)
    north = 4800010.0 - 2.0 * (np.arange(40) + 0.5)
    difference = np.repeat(((north - 4799980.0) / 10)[:, None], 50, axis=1).astype(np.float32)
    photo = np.full((90, 130), 40, np.uint8)
    photo[:, 65:] = 200
    _, facts, _ = page_of(
        tmp_path,
        raster(tmp_path / "d.tif", values),
        confidence=raster(tmp_path / "c.tif", confidence),
        difference=raster(tmp_path / "e.tif", difference, coarse),
        ortho=raster(tmp_path / "o.tif", photo, nodata=None),
    )
    elevation, picture, expected, apart = facts["layers"]
    assert [layer["kind"] for layer in facts["layers"]] == ["dsm", "ortho", "confidence", "dsm_error"]
    assert elevation["low"] < elevation["high"] and len(elevation["ramp"]) == 9
    found = values_in(expected, (90, 130))
    assert expected["low"] == 0 and (np.isnan(found) == np.isnan(error)).all()
    inside = error <= expected["high"]
    np.testing.assert_allclose(found[inside], error[inside], atol=0.003)
    assert apart["low"] == -apart["high"]
    y = 4800000.0 - 0.5 * (np.arange(90) + 0.5)
    found = values_in(apart, (90, 130))[:, 60]
    within = np.abs((y - 4799980) / 10) < apart["high"]
    np.testing.assert_allclose(found[within], ((y - 4799980) / 10)[within], atol=apart["high"] / 200 + 0.01)
    gdal.FileFromMemBuffer("/vsimem/o.jpg", base64.b64decode(picture["picture"]))
    with opened("/vsimem/o.jpg") as shown:
        grey = shown.ReadAsArray()
    gdal.Unlink("/vsimem/o.jpg")
    assert grey.shape == (90, 130) and abs(int(grey[45, 20]) - 40) < 4 and abs(int(grey[45, 100]) - 200) < 4


def test_a_picture_in_colour_stays_in_colour(tmp_path):
    bands = [np.full((90, 130), value, np.uint8) for value in (200, 90, 30)]
    facts = page_of(
        tmp_path, raster(tmp_path / "d.tif", hilly()), ortho=raster(tmp_path / "o.tif", bands, nodata=None)
    )[1]
    gdal.FileFromMemBuffer("/vsimem/o.jpg", base64.b64decode(facts["layers"][1]["picture"]))
    with opened("/vsimem/o.jpg") as shown:
        colour = shown.ReadAsArray()[:, 40, 40]
    gdal.Unlink("/vsimem/o.jpg")
    assert np.abs(colour.astype(int) - [200, 90, 30]).max() < 6


def test_a_turned_grid_is_laid_north_up(tmp_path):
    turned = (500000.0, 0.4, 0.3, 4800000.0, 0.3, -0.4)
    rows, columns = np.mgrid[0:90, 0:130] + 0.5
    x, y = turned[0] + turned[1] * columns + turned[2] * rows, turned[3] + turned[4] * columns + turned[5] * rows
    plane = ((x - 500000) + 2 * (y - 4800000)).astype(np.float32)
    facts = page_of(tmp_path, raster(tmp_path / "d.tif", plane, turned))[1]
    found = heights_in(facts)
    east = facts["corner"][0] + (np.arange(facts["size"][0]) + 0.5) * facts["step"][0]
    north = facts["corner"][1] + (np.arange(facts["size"][1]) + 0.5) * facts["step"][1]
    wanted = (east - 500000) + 2 * (north[:, None] - 4800000)
    assert facts["step"][0] == pytest.approx(0.5, rel=0.02) and np.isfinite(found).mean() > 0.4
    assert np.nanmedian(np.abs(found - wanted)) < 0.02


def test_degrees_and_feet_become_metres(tmp_path):
    crs = pyproj.CRS("EPSG:4326+6360").to_wkt()
    place = (5.0, 1e-5, 0.0, 45.0, 0.0, -1e-5)
    feet = raster(tmp_path / "d.tif", hilly(), place, crs)
    facts = page_of(tmp_path, feet, difference=raster(tmp_path / "e.tif", hilly() - 220, place, crs))[1]
    assert facts["cell_m"] == pytest.approx([0.788, 1.111], rel=2e-3)
    assert (facts["decimals"], facts["datum"]) == (6, "NAVD88 height (ftUS)")
    assert np.abs(heights_in(facts) - hilly() * 1200 / 3937).max() < 0.011


def test_a_dsm_without_a_crs_is_shown_with_what_has_its_cells(tmp_path):
    dsm = raster(tmp_path / "d.tif", hilly(), crs="")
    parts, facts, _ = page_of(tmp_path, dsm, difference=raster(tmp_path / "e.tif", hilly() - 220, crs=""))
    assert facts["crs"] == facts["datum"] == "" and len(facts["layers"]) == 2
    assert "no coordinate reference system · vertical datum not stated" in " ".join("".join(parts.text).split())


def test_what_cannot_be_shown_is_refused_and_leaves_no_page(tmp_path):
    dsm = raster(tmp_path / "d.tif", hilly())
    empty = raster(tmp_path / "n.tif", np.full((9, 9), np.nan, np.float32))
    far = raster(tmp_path / "f.tif", hilly(), (700000.0, 0.5, 0.0, 4800000.0, 0.0, -0.5))
    target = str(tmp_path / "page.html")
    for given, error, words in (
        ({"dsm": empty}, EmptyResultError, "nothing to show"),
        ({"dsm": dsm, "ortho": far}, OverlapError, "f.tif' has no value where the DSM"),
        ({"dsm": dsm, "confidence": str(tmp_path / "gone.tif")}, ImageError, "does not exist"),
    ):
        with pytest.raises(error, match=words):
            run_stage("viewer", {**given, "viewer": target}, Silent())
    with pytest.raises(OptionError, match=r"must end with \.html"):
        run_stage("viewer", {"dsm": dsm, "viewer": str(tmp_path / "page.png")}, Silent())
    with pytest.raises(OptionError, match="VIEWER.*must end with"):
        run_stage("dsmfuse", {"scene": "s.json", "output": "d.tif", "viewer": "page.png"}, Silent())
    assert not list(tmp_path.glob("page*")) and not list(tmp_path.glob(".page*"))


WORST = "-a&b<c>\"d' {x}{{y}} {% z %} </script><script>alert(1)</script> ä"


def test_names_of_files_are_text_and_nothing_is_fetched(tmp_path):
    refused = '<>"' if os.name == "nt" else ""  # by Windows
    name = "".join(letter for letter in WORST.replace("/", "∕") if letter not in refused)
    dsm = raster(tmp_path / "d.tif", hilly())
    Path(dsm).rename(tmp_path / f"{name}.tif")
    parts, facts, _ = page_of(tmp_path, tmp_path / f"{name}.tif")
    assert "".join(parts.text).count(name) == 2  # the title and the heading
    assert parts.addresses == [] and sorted(parts.tags).count("script") == 4 and "alert" not in parts.tags
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    assert policy.startswith("default-src 'none'") and "http" not in policy and "connect-src" not in policy
    assert str(tmp_path) not in text


def test_what_a_crs_is_called_cannot_end_the_script(tmp_path):
    named = pyproj.CRS("+proj=tmerc +lat_0=1 +lon_0=3.1 +datum=WGS84").to_json_dict()
    named["name"] = "</script><b>x"
    wkt = pyproj.CRS.from_json_dict(named).to_wkt()
    dsm = raster(tmp_path / "d.tif", hilly(), crs=wkt, metadata={"VERTICAL_DATUM": "<i>&\"'"})
    parts, facts, _ = page_of(tmp_path, dsm)
    assert "<b>" in facts["crs"] and facts["datum"] == "<i>&\"'"
    assert "b" not in parts.tags and "i" not in parts.tags


def test_the_page_speaks_its_readers_language(tmp_path):
    dsm = raster(tmp_path / "d.tif", hilly(300, 300))
    with written_in("de"):
        parts, facts, _ = page_of(tmp_path, dsm, cells=10_000)
    words = list(json.loads(parts.scripts["words"]).values())
    said = [text.strip() for text in parts.text if text.strip()] + words
    assert not english_in(said) and "Höhe" in " ".join(said)
    assert '<html lang="de">' in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_the_library_is_the_one_that_the_documents_name():
    library = (ROOT / "resources" / "viewer" / "twgl.js").read_bytes()
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    script = (ROOT / "scripts" / "twgl.py").read_text(encoding="utf-8")
    version = re.search(r'VERSION, ESBUILD = "([\d.]+)", "([\d.]+)"', script)
    assert hashlib.sha256(library).hexdigest() in page
    assert f"TWGL {version.group(1)}" in page and f"esbuild {version.group(2)}" in page
    assert library.startswith(f"/*! TWGL {version.group(1)}".encode()) and b"Permission is hereby granted" in library
    assert len(library) < 100_000
    checked = json.loads((ROOT / "package.json").read_text(encoding="utf-8"))["devDependencies"]
    assert checked["twgl.js"] == version.group(1)


def test_a_run_with_a_page_drapes_its_own_products(urban_run):
    made = urban_run.result.viewer
    facts = json.loads(Parts(Path(made).read_text(encoding="utf-8")).scripts["facts"])
    assert [layer["kind"] for layer in facts["layers"]] == ["dsm", "ortho", "confidence"]
    with opened(urban_run.result.output) as dsm:
        values = dsm.ReadAsArray()
        values = np.where(values == dsm.GetRasterBand(1).GetNoDataValue(), np.nan, values)
    np.testing.assert_allclose(heights_in(facts), values, atol=0.0051)


@pytest.mark.long
def test_a_page_alone_drapes_what_nobody_keeps(urban_run, tmp_path, told):
    said = told()
    given = {"scene": urban_run.result.scene, "resolution": 1.0, "output": str(tmp_path / "d.tif")}
    made = run_stage("dsmfuse", {**given, "viewer": str(tmp_path / "v.html")}, said)
    facts = json.loads(Parts((tmp_path / "v.html").read_text(encoding="utf-8")).scripts["facts"])
    assert [layer["kind"] for layer in facts["layers"]] == ["dsm", "ortho", "confidence"]
    assert made.ortho is None and made.confidence is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.qml", "d.tif", "v.html"]
    assert not [path for path in urban_run.workspace.rglob("*draped*")]
    assert any(text.startswith("Page of ") for text in said.notes)


@pytest.mark.parametrize(
    ("kind", "values", "named"),
    (
        ("ortho", np.zeros((90, 130), np.uint8), "picture-blank"),
        ("ortho", np.indices((90, 130)).sum(0).astype(np.uint8), ""),
        ("difference", hilly(), "difference-heights"),
        ("difference", np.random.default_rng(1).normal(0, 1, (90, 130)).astype(np.float32), ""),
        ("confidence", np.where(np.indices((90, 130))[0] < 22, 0.5, np.nan).astype(np.float32), "raster-partial"),
        ("confidence", np.full((90, 130), 0.5, np.float32), ""),
    ),
)
def test_what_says_nothing_of_the_dsm_is_named(kind, values, named, tmp_path):
    run = Recorder(Silent())
    given = {kind: raster(tmp_path / "draped.tif", values, nodata=None if kind == "ortho" else np.nan)}
    dsm, target = raster(tmp_path / "dsm.tif", hilly()), str(tmp_path / "page.html")
    run_stage("viewer", {"dsm": dsm, "viewer": target, **given}, run)
    assert [each.id for each in run.findings] == ([named] if named else [])
