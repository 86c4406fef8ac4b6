"""Tables as spreadsheets write them, and texts that spreadsheets must not run."""

from __future__ import annotations

import csv

import pytest

from repm_qgis.contracts.errors import InputTableError
from repm_qgis.files.tables import CsvTable, csv_text
from repm_qgis.pointing.ground_control import Gcp, read_gcps, write_gcps

HEAD, ROWS = "id;lon;lat;height", ("a;5,4418;43,2605;152,5", "b;5,4438;43,262;-3")


def points(path, text):
    path.write_text(text, encoding="utf-8")
    return read_gcps(str(path), None)


@pytest.mark.parametrize("first", ("", "sep=;\n", "SEP=;\r\n"))
@pytest.mark.parametrize("degrees", ("", " °", "°", " deg"))
def test_what_spreadsheets_write_in_europe_is_read(tmp_path, first, degrees):
    rows = [row.split(";") for row in ROWS]
    lines = [";".join([name, lon + degrees, lat + degrees, height]) for name, lon, lat, height in rows]
    one, two = points(tmp_path / "p.csv", "\n".join([first + HEAD, *lines]) + "\n")
    assert (one.lon, one.lat, one.height) == (5.4418, 43.2605, 152.5)
    assert (two.lon, two.lat, two.height) == (5.4438, 43.262, -3.0)


def test_a_stated_separator_holds_whatever_the_line_has(tmp_path):
    (point,) = points(tmp_path / "p.csv", "sep=|\nid|lon|lat|height|a,b,c\nx|5|43|1|2,3\n")
    assert point.id == "x" and point.height == 1.0


def test_commas_and_points_together_are_refused(tmp_path):
    with pytest.raises(InputTableError, match="with a decimal comma .row 2. and with a point .row 3."):
        points(tmp_path / "p.csv", f"{HEAD}\n{ROWS[0]}\nb;5.4438;43.262;1\n")


def test_rows_are_counted_from_the_files_first_line(tmp_path):
    with pytest.raises(InputTableError, match="row 4: the field 'height' is 'much'"):
        points(tmp_path / "p.csv", f"sep=;\n{HEAD}\n{ROWS[0]}\nb;5;43;much\n")


def test_a_comma_in_a_table_of_commas_stays_an_error(tmp_path):
    with pytest.raises(InputTableError, match="write decimals with a point"):
        points(tmp_path / "p.csv", 'id,lon,lat,height\na,"5,4",43,1\n')


def test_formulas_become_texts_and_numbers_stay(tmp_path):
    texts = ["=1+2", "+cmd", "@SUM(A1)", "-x", "\tx", "-3.50", "+1e5", "house", -2.5]
    (cells,) = csv.reader([csv_text([texts]).rstrip("\n")])
    assert cells == ["'=1+2", "'+cmd", "'@SUM(A1)", "'-x", "'\tx", "-3.50", "+1e5", "house", "-2.5"]
    path = tmp_path / "again.csv"
    path.write_text(csv_text([["name"], *([text] for text in texts[:4])]), encoding="utf-8")
    assert [row["name"] for _, row in CsvTable(str(path)).rows()] == texts[:4]


def test_control_points_come_back_as_they_were(tmp_path):
    gcps = [Gcp(name, 5.0, 43.0, 10.0, "control", {}) for name in ("=HYPERLINK(1)", "-7", "plain")]
    path = write_gcps(str(tmp_path / "p.csv"), gcps)
    assert "'=HYPERLINK(1)" in open(path, encoding="utf-8").read()
    assert [gcp.id for gcp in read_gcps(path, None)] == [gcp.id for gcp in gcps]


def test_names_that_look_like_numbers_stay(tmp_path):
    one, two = points(tmp_path / "p.csv", f"{HEAD}\n1,5;5,5;43,5;7\n1.5;5,6;43,6;8\n")
    assert (one.id, two.id, one.lon, two.lat) == ("1,5", "1.5", 5.5, 43.6)
