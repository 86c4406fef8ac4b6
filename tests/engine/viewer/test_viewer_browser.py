"""The page in a real browser, Chromium without a graphics card: what it shows and says is what the DSM has."""

from __future__ import annotations

import re

import numpy as np
import pyproj
import pytest
from osgeo import gdal
from scipy import ndimage

from repm_qgis.imagery.raster import write
from repm_qgis.runtime.progress import Silent
from repm_qgis.runtime.translation import written_in
from repm_qgis.stages import run_stage
from tests.browser import PROGRAM, Browser

pytestmark = [pytest.mark.long, pytest.mark.skipif(PROGRAM is None, reason="needs Chromium, which draws the page")]

UTM = pyproj.CRS("EPSG:32631").to_wkt()
WEST, NORTH, CELL = 500000.0, 4800000.0, 0.5
READY = "document.documentElement && document.documentElement.dataset.ready"
MESSAGE = "document.querySelector('#message:not([hidden])')?.textContent || ''"


def put(path, values, **options):
    return write(str(path), [values], (WEST, CELL, 0.0, NORTH, 0.0, -CELL), UTM, **options)


def surface(side):
    """Hills, with a tower, and a hole beside it."""
    y, x = np.mgrid[0:side, 0:side]
    heights = 200 + side / 60 * np.sin(6 * x / side) * np.cos(7 * y / side)
    heights[side // 2 : side // 2 + side // 10, side // 2 : side // 2 + side // 10] += side / 20
    heights[side // 5 : side // 3, side // 5 : side // 3] = np.nan
    return heights.astype(np.float32)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A page of 300 x 300 cells with all kinds of drapes; its path and its heights."""
    folder, heights = tmp_path_factory.mktemp("made"), surface(300)
    photo = np.full(heights.shape, 250, np.uint8)
    photo[:, :150] = 20
    error = np.where(np.arange(300) < 150, 0.1, 0.9).astype(np.float32) + np.zeros((300, 1), np.float32)
    given = {
        "dsm": put(folder / "town.tif", heights, metadata={"VERTICAL_DATUM": "EGM96 height"}),
        "ortho": put(folder / "o.tif", photo, nodata=None),
        "confidence": put(folder / "c.tif", error),
        "difference": put(folder / "e.tif", error - 0.5),
    }
    run_stage("viewer", {**given, "viewer": str(folder / "page.html")}, Silent())
    with written_in("de"):
        run_stage("viewer", {"dsm": given["dsm"], "viewer": str(folder / "seite.html")}, Silent())
    return folder / "page.html", heights


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("browser"), (1000, 700)) as opened:
        yield opened


@pytest.fixture
def shown(browser, made):
    """The browser with the page, as it opens."""
    browser.open(made[0])
    browser.wait(f"!document.querySelector('header') ? 0 : {READY}")
    yield browser
    assert browser.errors == []


def text(browser, name):
    return browser.evaluate(f"document.querySelector('{name}').textContent")


def pixels(browser, folder):
    """(rows, columns, 3) what is on the screen."""
    browser.picture(folder / "shot.png")
    dataset = gdal.Open(str(folder / "shot.png"))
    return np.moveaxis(dataset.ReadAsArray()[:3], 0, 2).astype(int)


def place_in(status):
    """x, y and height of a sentence of the page, and the cells' column and row."""
    x, y, height = (float(re.search(rf"{name} (-?[\d.]+)", status).group(1)) for name in ("x", "y", "height"))
    return height, (x - WEST) / CELL - 0.5, (NORTH - y) / CELL - 0.5


def height_at(heights, column, row):
    c, r = int(column), int(row)
    u, v = column - c, row - r
    four = heights[r : r + 2, c : c + 2]
    return float(np.array([1 - v, v]) @ four @ np.array([1 - u, u]))


def pointed(browser, x, y):
    browser.mouse("Moved", (x, y))
    browser.frame()
    return text(browser, "#status")


def test_coordinates_and_heights_under_the_pointer_are_the_dsms(shown, made):
    found = 0
    for x, y in ((450, 420), (330, 520), (600, 500), (520, 300), (400, 450)):
        status = pointed(shown, x, y)
        if "height" not in status:
            continue
        height, column, row = place_in(status)
        assert "(above: EGM96 height)" in status
        expected = height_at(made[1], column, row)
        if np.isfinite(expected):  # else beside the hole
            assert height == pytest.approx(expected, abs=0.03)
            found += 1
    assert found >= 4
    assert "Point at the surface" in pointed(shown, 20, 400)


def test_nothing_is_fetched_and_names_are_shown(shown, made):
    assert text(shown, "h1") == "town" and "EPSG:32631" in text(shown, "header p")
    fetched = [url for url in shown.requests if not url.startswith(("data:", "blob:", "file:"))]
    assert shown.requests and not fetched


def test_seen_from_above_the_middle_is_the_middle_and_north_is_up(shown, made):
    shown.key("t")
    height, column, row = place_in(pointed(shown, 500, 350))
    assert (column, row) == (pytest.approx(149.5, abs=25), pytest.approx(149.5, abs=25))
    _, east, _ = place_in(pointed(shown, 560, 350))
    _, _, north = place_in(pointed(shown, 500, 290))
    assert east > column + 5 and north < row - 5
    for _ in range(3):
        shown.key("ArrowRight", shift=True)
    _, _, turned = place_in(pointed(shown, 560, 350))
    assert abs(turned - row) > 3
    shown.key("n")
    _, _, back = place_in(pointed(shown, 560, 350))
    assert back == pytest.approx(row, abs=2)


def hole_px(image):
    """How many pixels of the page's own colour the surface encloses."""
    image = image[5:-5, 5:-5]  # without the frame of what has the keyboard
    parts, count = ndimage.label(np.abs(image - image[640, 500]).max(axis=2) <= 2)
    edge = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    inside = parts[100:600, 250:700]  # without the panels, which have the page's colour too
    return max((sizes[part] for part in np.unique(inside) if part and part not in edge), default=0)


def test_a_hole_is_a_hole_without_a_wall_around_it(shown, tmp_path):
    """One looks through all of it, from above and slanting, where a wall would hide a part."""
    shown.key("t")
    (_, left, _), (_, right, _) = (place_in(pointed(shown, x, 400)) for x in (420, 580))
    cells = 100 - 60 + 1  # from centre to centre of those around it
    above = (cells * 160 / (right - left)) ** 2
    assert hole_px(pixels(shown, tmp_path)) == pytest.approx(above, rel=0.08)
    for _ in range(8):
        shown.key("ArrowUp", shift=True)
    assert hole_px(pixels(shown, tmp_path)) > 0.9 * above * np.cos(np.radians(40)) * 0.8  # farther off, so smaller


def test_every_drape_has_its_colours_legend_and_value(shown, made, tmp_path):
    shown.key("t")
    colours, legends = [], []
    for key in "1234":
        shown.key(key)
        image = pixels(shown, tmp_path)
        colours.append((tuple(image[480, 380]), tuple(image[480, 620])))
        legends.append(shown.evaluate("document.getElementById('legend').hidden") or text(shown, "#limits"))
    assert len(set(colours)) == 4
    (dark, bright), (low, high) = colours[1], colours[2]
    assert max(dark) < 40 and min(bright) > 230 and legends[1] is True
    assert sum(low) < sum(high) and legends[2].startswith("0.00 m")
    assert re.match(r"-0\.4\d? m", legends[3]) or legends[3].startswith("-0.40 m")
    assert "Height difference -0.4" in pointed(shown, 380, 480).replace("≤ ", "")
    shown.key("3")
    assert "Expected error 0.1" in pointed(shown, 380, 480) and "0.9" in pointed(shown, 620, 480).split("error")[1]
    assert shown.evaluate("document.querySelectorAll('#layers input')[2].checked")


def test_two_clicks_make_a_profile_of_the_dsm(shown, made):
    shown.evaluate("document.getElementById('profile').click()")
    assert "first end" in text(shown, "#under")
    shown.click(380, 420)
    assert "other end" in text(shown, "#under")
    shown.click(640, 430)
    path = shown.evaluate("document.querySelector('#chart path').getAttribute('d')")
    assert path.startswith("M") and path.count("L") > 50
    assert shown.evaluate("document.querySelectorAll('#marks path').length") == 2
    box = shown.evaluate(
        "(r => [r.left, r.top, r.width, r.height])(document.querySelector('#chart svg').getBoundingClientRect())"
    )
    far = -1.0
    for share in (0.2, 0.5, 0.8):
        shown.mouse("Moved", (box[0] + share * box[2], box[1] + box[3] / 2))
        shown.frame()
        said = text(shown, "#under")
        height, column, row = place_in(said)
        assert height == pytest.approx(height_at(made[1], column, row), abs=0.6)  # the place is said to 0.01 m: walls
        distance = float(re.search(r"distance ([\d.]+) m", said).group(1))
        assert distance > far
        far = distance
    shown.key("t")
    shown.click(300, 220)  # across the hole, where neither line nor chart has anything
    shown.click(440, 225)
    for name in ("#marks", "#chart"):
        drawn = shown.evaluate(f"document.querySelector('{name} path').getAttribute('d')")
        assert drawn.count("M") == 2, name
    shown.key("Escape")
    assert shown.evaluate("document.getElementById('chart').hidden")


@pytest.mark.slow
def test_exaggeration_sun_mouse_and_touch_change_the_view(shown, tmp_path):
    def scale():
        return float(shown.evaluate("parseFloat(document.querySelector('#scale div').style.width)"))

    views = [pixels(shown, tmp_path)]
    for name, value in (("exaggeration", 3), ("azimuth", 90), ("altitude", 15)):
        shown.evaluate(
            f"(e => {{ e.value = {value}; e.dispatchEvent(new Event('input')); }})(document.getElementById('{name}'))"
        )
        views.append(pixels(shown, tmp_path))
        assert (np.abs(views[-1] - views[-2]).max(axis=2) > 10).mean() > 0.02, name
    status = pointed(shown, 450, 420)
    shown.drag((450, 420), (520, 440))
    assert place_in(pointed(shown, 520, 440)) == pytest.approx(place_in(status), abs=1.5)  # what was held is held
    text_before, before = text(shown, "#scale span"), scale()
    points = [[{"x": 400, "y": 400}, {"x": 500, "y": 400}], [{"x": 300, "y": 400}, {"x": 600, "y": 400}], []]
    for kind, fingers in zip(("touchStart", "touchMove", "touchEnd"), points):
        shown.ask("Input.dispatchTouchEvent", type=kind, touchPoints=fingers)
    shown.frame()
    assert (text(shown, "#scale span"), scale()) != (text_before, before)
    turned = pixels(shown, tmp_path)
    shown.drag((450, 420), (520, 440), 2)
    assert (np.abs(pixels(shown, tmp_path) - turned).max(axis=2) > 10).mean() > 0.05
    shown.evaluate("document.getElementById('reset').click()")
    shown.frame()
    assert text(shown, "#scale span") == text_before


def test_dark_and_german(browser, made, tmp_path):
    browser.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    try:
        browser.open(made[0].with_name("seite.html"))
        browser.wait(f"document.title !== 'town' || document.documentElement.lang !== 'de' ? 0 : {READY}")
        assert pixels(browser, tmp_path)[650, 500].max() < 60
        assert "Höhe" in pointed(browser, 450, 420) and "Profil" in text(browser, "#profile")
    finally:
        browser.ask("Emulation.setEmulatedMedia", features=[])


def test_a_damaged_page_says_so(browser, made, tmp_path):
    whole = made[0].read_text(encoding="utf-8")
    place = whole.index('"heights": "') + 400
    (tmp_path / "cut.html").write_text(whole[:place] + whole[place + 400 :], encoding="utf-8")
    browser.open(tmp_path / "cut.html")
    assert "damaged or cut short" in browser.wait(
        f"location.href.includes('cut') && /damaged/.test({MESSAGE}) && ({MESSAGE})"
    )


def test_a_browser_without_webgl_is_said_what_to_do(made, tmp_path):
    with Browser(tmp_path / "plain", (800, 600), ["--disable-3d-apis"]) as browser:
        browser.open(made[0])
        said = browser.wait(f"/WebGL/.test({MESSAGE}) && ({MESSAGE})")
    assert "hardware acceleration" in said


def test_four_million_cells_open_in_seconds(browser, tmp_path):
    """Without a graphics card; the benchmark has the figures of a machine that does little else: 3 s."""
    dsm = put(
        tmp_path / "large.tif", surface(2000) + np.random.default_rng(0).normal(0, 0.1, (2000, 2000)).astype("f4")
    )
    made = run_stage("viewer", {"dsm": dsm, "viewer": str(tmp_path / "large.html")}, Silent())
    assert made.columns == made.rows == 2000
    browser.open(tmp_path / "large.html")
    ready = int(browser.wait(f"document.title === 'large' && {READY}"))
    assert ready < 10_000
    assert "height" in pointed(browser, 450, 420)
