from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError, OptionError, WorkspaceError
from repm_qgis.contracts.findings import Finding
from repm_qgis.imagery import raster
from repm_qgis.reports import charts, pictures, styles
from repm_qgis.reports.report import Report, number
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.stages import run_stage
from tests.engine.pages import checked


def full_page():
    rng = np.random.default_rng(0)
    outline = np.array([[5.0, 43.0], [5.1, 43.0], [5.1, 43.1], [5.0, 43.1]])
    page = Report("A <b>title</b> & more", "sub")
    page.section("One").paragraph("<i>x</i>").facts([("a<", 1.5), ("b", None)])
    page.section("Two").table(["name", "value"], [["<x>", 1.25], ["y", None]], "a caption").verdict(
        "fine", [Finding("odd", "odd")]
    )
    page.section("Three").command("run --x <y>").png(pictures.png_bytes(np.zeros((3, 4, 3), np.uint8)), 'a "quote"')
    page.svg(charts.histogram(rng.normal(size=500), "m", "<t>"))
    page.svg(charts.curves({"<c>": (np.arange(9), np.arange(9) ** 2), "d": ([0, 1], [np.nan, 2])}, "x", "y"))
    page.svg(charts.footprints({"<img>": outline}, outline * 1.0)).svg(
        charts.arrows(rng.uniform(0, 9, (5, 2)), np.ones((5, 2)))
    )
    return page.svg(charts.colour_bar(pictures.RAMPS["diverging"], -1, 1, "m"))


def test_page_is_whole_escaped_and_offline():
    page = checked(full_page().html())
    text = "".join(page.text)
    for piece in ("A <b>title</b> & more", "<i>x</i>", "<x>", "run --x <y>", "<img>", "<c>", "odd"):
        assert piece in text
    assert "i" not in page.tags and "x" not in page.tags and page.tags.count("svg") == 5
    assert page.tags.count("nav") == 1


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.skipif(BROWSER is None, reason="needs Chromium, which measures how wide tables are")
@pytest.mark.long
def test_no_table_is_cut_at_the_right(tmp_path, urban_run):
    """At 900 px, the width of half a screen, no table is wider than the page."""
    page = (Path(urban_run.result.report)).read_text(encoding="utf-8")
    measure = "[...document.querySelectorAll('.scroll')].map(x => x.scrollWidth - x.clientWidth)"
    script = f"<script>document.title = 'cut ' + Math.max(...{measure})</script>"
    (tmp_path / "r.html").write_text(page.replace("</body>", f"{script}</body>"), encoding="utf-8")
    options = "--headless --no-sandbox --disable-gpu --disable-background-networking --no-first-run --dump-dom".split()
    place = [f"--user-data-dir={tmp_path / 'browser'}", "--window-size=900,800", f"file://{tmp_path / 'r.html'}"]
    shown = subprocess.run([BROWSER, *options, *place], stdout=subprocess.PIPE, text=True, timeout=120, check=True)
    cut = re.search(r"<title>cut (-?\d+)</title>", shown.stdout)
    assert cut is not None and int(cut.group(1)) <= 0


def test_comparison_report_is_whole_and_offline(make_raster, tmp_path, terrain):
    a, b = make_raster("dsm.tif", terrain(120, 120, 0.4) + 3), make_raster("ref.tif", terrain(120, 120))
    run_stage("comparedsm", {"dsm": a, "reference": b, "align": "3d", "report": str(tmp_path / "r.html")}, Silent())
    page = checked((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert page.tags.count("img") == 3 and page.tags.count("svg") == 5 and page.tags.count("table") >= 5
    assert "-0.400 m" in "".join(page.text)


def test_report_refuses_what_it_cannot_show(tmp_path):
    page = Report("x")
    with pytest.raises(ValueError, match="1 cells under 2"):
        page.table(["a", "b"], [[1]])
    for bad in ("<svg><script>1</script></svg>", "<p>", '<svg onload="x()"></svg>', "<svg></svg>"):
        with pytest.raises(ValueError, match="Only the drawings"):
            page.svg(bad)
    with pytest.raises(ValueError):
        page.png(b"GIF89a")
    (tmp_path / "file").write_text("")
    with pytest.raises(WorkspaceError):
        page.write(tmp_path / "file" / "r.html", Recorder(Silent()))


@pytest.mark.parametrize(
    "value, text",
    [
        (0.0123456, "0.01235"),
        (12345.678, "12345.7"),
        (None, "–"),
        (float("nan"), "–"),
        (np.int64(12345), "12345"),
        (np.float32(2.5), "2.5"),
        (True, "yes"),
        (-0.0, "0"),
        ("a", "a"),
        (3e-7, "3.00e-07"),
    ],
)
def test_numbers_read_well(value, text):
    assert number(value) == text


def test_numbers_are_right_aligned_by_column():
    text = Report("x").table(["a", "b", "c"], [["x1 y", "0.4 m", 3], ["z", "–", None]]).html()
    head = text[text.index("<thead>") : text.index("</thead>")]
    assert head == '<thead><tr><th>a</th><th class="n">b</th><th class="n">c</th></tr>'


@pytest.mark.parametrize(
    "draw",
    [
        lambda: charts.histogram(np.full(9, np.nan)),
        lambda: charts.histogram([]),
        lambda: charts.histogram(np.full(9, 2.0)),
        lambda: charts.curves({}),
        lambda: charts.curves({"a": ([1], [1])}),
        lambda: charts.footprints({}),
        lambda: charts.footprints({"a": [[1, 1]]}),
        lambda: charts.arrows([], []),
        lambda: charts.arrows([[5, 5]], [[0, 0]]),
        lambda: charts.counted_histogram(np.array([0, 0]), np.array([0, 1, 2])),
    ],
)
def test_charts_of_next_to_nothing(draw):
    text = draw()
    assert "nan" not in text.replace("Noto Sans", "") and "inf" not in text
    checked(text)


def test_a_key_says_by_what_long_names_differ_and_names_no_block_of_frames():
    def outlines(count):
        names = [f"20200101_10101{n % 10}_ssc{n // 10}d1_basic_l1a_panchromatic_dn" for n in range(count)]
        return {name: [[n, 0], [n + 9, 0], [n + 9, 5]] for n, name in enumerate(names)}

    few = charts.footprints(outlines(3))
    assert all(f">…{number}…</text>" in few for number in range(3))
    many = charts.footprints(outlines(42))
    assert ">42 images</text>" in many and "…" not in many and len(re.findall("<title>2020", many)) == 42
    assert len(set(re.findall('fill="(#[0-9a-f]{6})"', many))) == 1, "colours that come again would tell nothing"


def test_labelled_vectors_are_named_in_place_and_stay_inside():
    import re

    places = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 80.0], [50.0, 50.0]])
    vectors = np.array([[-1.0, -1.0], [1.0, 0.5], [np.nan, 0.0], [0.0, 1.0]])
    text = charts.arrows(places, vectors, "t", "m", labels=["A", "<B>", "C", "D"])
    checked(text)
    assert ">A<" in text and "&lt;B&gt;" in text and ">D<" in text
    assert ">C<" not in text  # it has no vector
    ends = np.array([[float(v) for v in match] for match in re.findall(r"L([-\d.]+) ([-\d.]+)", text)])
    box = re.search(r'<rect x="20" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"', text)
    top, width, height = map(float, box.groups())
    assert len(ends) == 3
    assert (ends >= [20, top]).all() and (ends <= [20 + width, top + height]).all()


def test_histogram_bars_add_up():
    import re

    text = charts.counted_histogram(np.array([1.0, 3.0]), np.array([0.0, 1.0, 2.0]))
    heights = [float(h) for h in re.findall(r'<rect [^>]*height="([\d.]+)" fill="#2b83ba"', text)]
    assert len(heights) == 2 and heights[1] == pytest.approx(3 * heights[0], rel=1e-3)


@pytest.mark.parametrize("low, high", [(0, 1), (-3.2, 7.9), (2270.4, 2376.1), (0, 1e-5), (-1e6, 1e6)])
def test_ticks_are_round_and_inside(low, high):
    found = charts.ticks(low, high)
    assert 2 <= len(found) <= 8 and low - 1e-9 <= found[0] and found[-1] <= high * (1 + 1e-9) + 1e-9
    step = found[1] - found[0]
    assert round(step / 10 ** np.floor(np.log10(step) + 1e-9)) in (1, 2, 5, 10)


def test_png_keeps_every_pixel():
    rng = np.random.default_rng(0)
    for shape in ((17, 23), (17, 23, 3), (17, 23, 4)):
        picture = rng.integers(0, 256, shape).astype(np.uint8)
        gdal.FileFromMemBuffer("/vsimem/test_eval.png", pictures.png_bytes(picture))
        dataset = gdal.Open("/vsimem/test_eval.png")
        back = dataset.ReadAsArray()
        dataset = None
        gdal.Unlink("/vsimem/test_eval.png")
        assert np.array_equal(back if picture.ndim == 2 else np.moveaxis(back, 0, 2), picture)
    assert not [name for name in (gdal.ReadDir("/vsimem/") or []) if name.startswith("repm_")]
    with pytest.raises(ValueError):
        pictures.png_bytes(np.zeros((3, 3)))


def test_hillshade_is_gdals(terrain):
    z = terrain(80, 90).astype(np.float32)
    memory = gdal.GetDriverByName("MEM").Create("", 90, 80, 1, gdal.GDT_Float32)
    memory.SetGeoTransform((0, 0.5, 0, 0, 0, -0.5))
    memory.GetRasterBand(1).WriteArray(z)
    want = (
        gdal.DEMProcessing("", memory, "hillshade", format="MEM", azimuth=300, altitude=40).ReadAsArray().astype(float)
    )
    got = 1 + 254 * pictures.hillshade(*pictures.gradients(z, 0.5), 300, 40)
    assert np.abs(got - want)[1:-1, 1:-1].max() < 1.0


def test_colours_and_relief(terrain):
    got = pictures.colour_map(np.array([[0.0, 5.0, 10.0, np.nan, 99.0]]), 0, 10, "diverging")
    assert [tuple(c) for c in got[0]][0] == pictures.rgb(pictures.RAMPS["diverging"][0]) + (255,)
    assert got[0, 1, :3].min() >= 253 and got[0, 3, 3] == 0 and np.array_equal(got[0, 4], got[0, 2])
    relief = pictures.shaded_relief(np.where(np.eye(40) > 0, np.nan, terrain(40, 40)), 0.5)
    assert relief.shape == (40, 40, 4) and np.array_equal(relief[..., 3] == 0, np.eye(40) > 0)
    assert pictures.shaded_relief(np.full((5, 5), np.nan), 1.0)[..., 3].max() == 0
    for ramp in ("viridis", "elevation", "grey"):
        light = pictures.ramp_table(ramp) @ np.array([0.299, 0.587, 0.114])
        assert (np.diff(light) > -0.6).all() and light[-1] - light[0] > 120, ramp


def test_preview_of_a_file(make_raster, tmp_path, terrain):
    values, cell = pictures.preview(make_raster("dsm.tif", terrain(300, 600)), 200)
    assert values.shape == (100, 200) and cell == pytest.approx(1.5 / 0.9996)  # on the ground
    with pytest.raises(ImageError):
        pictures.preview(tmp_path / "none.tif", 200)


@pytest.mark.parametrize("kind", ["dsm", "slope", "dsm_error", "ortho", "hillshade"])
def test_raster_styles_carry_the_rasters_range(make_raster, tmp_path, kind):
    import xml.dom.minidom as minidom

    values = np.linspace(-2, 8, 10000).reshape(100, 100)
    sidecar = styles.write_style(kind, make_raster("layer.tif", values))
    assert sidecar == str(tmp_path / "layer.qml")
    text = open(sidecar, encoding="utf-8").read()
    assert "@" not in text
    document = minidom.parseString(text.split("\n", 1)[1])  # noqa: S318 - our own file
    if kind == "hillshade":
        return
    if kind == "ortho":
        found = [float(document.getElementsByTagName(t)[0].firstChild.data) for t in ("minValue", "maxValue")]
    else:
        items = [float(i.getAttribute("value")) for i in document.getElementsByTagName("item")]
        assert items == sorted(items) and len(items) >= 9
        found = [items[0], items[-1]]
    want = {"slope": [0.0, 7.8], "dsm_error": [-7.8, 7.8]}.get(kind, [-1.8, 7.8])
    assert found == pytest.approx(want, abs=0.01)


@pytest.mark.parametrize("heights", [np.full((30, 30), 5.0), np.full((30, 30), np.nan)])
def test_styles_of_flat_and_empty_rasters(make_raster, heights):
    text = open(styles.write_style("dsm", make_raster("layer.tif", heights)), encoding="utf-8").read()
    assert "nan" not in text and "@" not in text


def test_vector_styles_and_unknown_kinds(tmp_path):
    for kind, field in (("tiles", 'attr="worst_rmse"'), ("tie_points", 'filter="&quot;residual&quot; &lt; 0.1"')):
        text = open(styles.write_style(kind, tmp_path / f"{kind}.gpkg"), encoding="utf-8").read()
        assert field in text
    with pytest.raises(OptionError, match="kind is 'x'"):
        styles.write_style("x", tmp_path / "a.tif")


def confidence(tmp_path, bands):
    rows = np.ones((20, 20), np.float32)
    values = [rows * 3, rows, rows * 0.5, rows, np.linspace(0.2, 0.9, 400, dtype=np.float32).reshape(20, 20)]
    path = str(tmp_path / "confidence.tif")
    return raster.write(path, values[:bands], (0, 1, 0, 20, 0, -1), "", cog=True)


def test_a_confidence_shows_the_expected_error(tmp_path):
    text = open(styles.write_style("confidence", confidence(tmp_path, 5)), encoding="utf-8").read()
    assert 'type="singlebandpseudocolor" band="5"' in text and 'suffix=" m"' in text
    ends = [float(re.search(rf'classification{end}="([^"]*)"', text).group(1)) for end in ("Min", "Max")]
    assert ends == pytest.approx([0.0, 0.886], abs=0.001)


def test_counts_and_sources_have_discrete_legends(tmp_path):
    def entries(kind, path):
        return re.findall(
            r'<paletteEntry value="(\d+)" color="(#\w+)" alpha="255" label="([^"]*)"', text_of(kind, path)
        )

    def text_of(kind, path):
        text = styles.style_text(kind, path)
        assert 'type="paletted"' in text and "@" not in text
        return text

    path = confidence(tmp_path, 5)
    assert [entry[::2] for entry in entries("confidence_count", path)] == [("1", "1"), ("2", "2"), ("3", "3")]
    assert 'band="4"' in text_of("confidence_source", path)
    assert [entry[::2] for entry in entries("confidence_source", path)][:2] == [
        ("0", "Matched"),
        ("1", "Background of an occlusion"),
    ]
    dsms = str(tmp_path / "sources.tif")
    numbers = np.arange(12, dtype=np.float32).reshape(3, 4) + 1
    names = {f"DSM_{number}": f"/data/{number}<.tif" for number in (1, 2)}
    raster.write(dsms, [numbers], (0, 1, 0, 3, 0, -1), "", metadata=names)
    found = entries("sources", dsms)
    assert [label for _, _, label in found[:3]] == ["1: 1&lt;", "2: 2&lt;", "3"] and len(found) == 12
    assert len({colour for _, colour, _ in found[:8]}) == 8


def test_an_orthophoto_has_the_time_of_its_images(make_raster):
    path = make_raster("layer.tif", np.arange(100.0).reshape(10, 10))
    taken = "2019-04-02T10:15:00.000Z", "2019-04-02T10:16:00.000Z"
    text = styles.style_text("ortho", path, taken=taken)
    assert "<start>2019-04-02T10:15:00.000Z</start>" in text and "<end>2019-04-02T10:16:00.000Z</end>" in text
    assert "<temporal" not in styles.style_text("ortho", path)


def test_only_heights_are_an_elevation(make_raster):
    path = make_raster("layer.tif", np.arange(100.0).reshape(10, 10))
    found = {kind: re.search(r'<elevation enabled="(\d)"', styles.style_text(kind, path)) for kind in ("dsm", "error")}
    assert {kind: match.group(1) for kind, match in found.items()} == {"dsm": "1", "error": "0"}


def test_no_two_classes_look_alike_to_anybody():
    """Residuals get lighter from class to class, so that they are told apart without colour, and none is green."""
    for kind in ("tie_points", "tiles"):
        text = styles.style_text(kind, "a.gpkg")
        pattern = r'name="(?:color|outline_color)" value="(\d+),(\d+),(\d+),255"'
        colours = [tuple(map(int, each)) for each in re.findall(pattern, text)]
        classes = [each for each in dict.fromkeys(colours) if each not in ((255, 255, 255), (29, 39, 51))]
        light = [colour @ np.array([0.299, 0.587, 0.114]) for colour in np.array(classes)]
        assert len(classes) == 6 and (np.diff(light) > 15).all(), kind
        assert not any(green > 1.2 * red and green > 1.2 * blue for red, green, blue in classes)
