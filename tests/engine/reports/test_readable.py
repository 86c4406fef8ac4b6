from __future__ import annotations

import re

import numpy as np
import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.reports import charts, pictures
from repm_qgis.reports.report import Report
from repm_qgis.runtime.translation import written_in

LABELS = {"GCPS": "Ground control points", "ALIGN": "Alignment", "DEM": "Terrain model", "EXTENT": "Area <m>"}


def body(page: Report) -> str:
    return page.html().split("<main>")[1]


def test_a_word_is_explained_where_it_stands_once_a_section():
    page = Report("NMAD").section("One").paragraph("The NMAD, again the NMAD; two tie points.")
    text = body(page.section("Two").facts([("NMAD of all", "0.4 m")]).command("NMAD"))
    assert text.count('<abbr class="term"') == 3
    assert re.search(
        r'<abbr class="term" tabindex="0" title="1\.4826 times the median [^"]*">NMAD</abbr>, again the', text
    )
    assert 'whose position is not known before.">tie points</abbr>' in text
    assert "<h1>NMAD</h1>" in text and "<pre>NMAD</pre>" in text


def test_everyday_words_and_parts_of_names_are_not_explained():
    text = body(Report("x").paragraph("The source of a tile in a scene: NMAD_before, rmse.tif, my-RMSE."))
    assert "<abbr" not in text


def test_advice_is_in_the_dialogs_own_words():
    said = "Give points (GCPS) or a DEM (DEM), with ALIGN=3d or EXTENT. 'EXTENT.tif' GCPS_2"
    with written_in("en", LABELS):
        text = re.sub(r"</?abbr[^>]*>", "", body(Report("x").paragraph(said)))
    assert (
        "Give points (‘Ground control points’) or a DEM (‘Terrain model’), with ‘Alignment’ = 3d or ‘Area &lt;m&gt;’."
        in text
    )
    assert "EXTENT.tif" in text and "GCPS_2" in text
    with written_in("en", LABELS):
        text = body(Report("x").paragraph("Give ground control points (GCPS) or a reference."))
    assert "‘<abbr" in text and "(‘" not in text
    assert "(GCPS)" in body(Report("x").paragraph(said))  # a command line has no dialog
    with pytest.raises(OptionError, match="labels is"), written_in("en", ["GCPS"]):
        pass


def test_decimals_are_those_of_the_language():
    page = (
        Report("x")
        .table("a | b", [["RMSE", "0.25 m"], ["Punkt", "-1.5"]])
        .paragraph("QGIS 3.22.1, 'a_1.5.tif', 12.75 %")
    )
    page.svg(charts.histogram(np.linspace(0, 1.5, 50), "m")).command("--x=1.5")
    with written_in("de"):
        text = body(page)
    for words in ("0,25 m", "-1,5<", "12,75 %", "3.22.1", "a_1.5.tif", "--x=1.5", ">0,5</text>"):
        assert words in text, words
    assert ' width="640"' in text and "0.25 m" in body(page)


def test_words_are_explained_in_the_readers_language():
    with written_in("de"):
        text = body(Report("x").facts([("NMAD", "0.4 m")]).paragraph("Die Verknüpfungspunkte und die Höhenkarten."))
    assert re.search(r'title="1,4826-mal der Median [^"]*">NMAD</abbr>', text)
    assert ">Verknüpfungspunkte</abbr>" in text and ">Höhenkarten</abbr>" in text


def test_small_pictures_are_shown_in_whole_pixels_of_a_readable_size():
    def width(size):
        made = pictures.png_bytes(np.zeros((*size, 3), np.uint8))
        return int(re.search(r'<img width="(\d+)"', body(Report("x").png(made)))[1])

    assert (width((100, 123)), width((414, 400)), width((800, 800))) == (123 * 7, 800, 800)


def test_classes_have_their_own_colours_and_names():
    values = np.array([[0.0, 5.0], [np.nan, 9.0]])
    drawn = pictures.categories(values, {0: "#0072b2", 5: "#d55e00"})
    assert drawn.tolist() == [[[0, 114, 178, 255], [213, 94, 0, 255]], [[0, 0, 0, 0], [0, 0, 0, 0]]]
    key = charts.legend([("#0072b2", "Matched"), ("#d55e00", "A < B")])
    assert 'fill="#0072b2"' in key and ">Matched</text>" in key and "A &lt; B" in key


def test_colours_lie_over_what_is_there():
    base = np.full((2, 4, 4), 255, np.uint8)
    base[:, 2:] = 0
    colours = np.zeros((1, 3, 4), np.uint8)
    colours[0, :2] = (200, 0, 0, 255)
    laid = pictures.over(base, colours, 0.5)
    assert laid[0, 0].tolist() == [228, 128, 128, 255]  # both
    assert laid[0, 1].tolist() == [228, 128, 128, 255] and laid[0, 2, 3] == 0
    alone = pictures.over(np.zeros((1, 1, 4), np.uint8), colours)
    assert alone[0, 0].tolist() == [200, 0, 0, 255]
    relief = pictures.grey_relief(np.array([[0.0, np.nan], [1.0, 2.0]]), 1.0)
    assert relief[0, 1, 3] == 0 and (relief[..., 0] == relief[..., 2]).all() and relief[1, 1, 3] == 255
