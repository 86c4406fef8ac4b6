"""Edits of a DSM: what each operation does to the heights, and that records and DSM alone decide every byte."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from osgeo import ogr, osr

from repm_qgis.contracts.errors import EmptyResultError, ImageError, InputTableError, OptionError
from repm_qgis.editing.edits import Edit, read_edits, write_edits
from repm_qgis.editing.membrane import filled
from repm_qgis.editing.parameters import EDITING
from repm_qgis.geometry.vertical import ELLIPSOID, TAG
from repm_qgis.imagery import raster
from repm_qgis.imagery.confidence import CONFIDENCE_BANDS, Provenance
from repm_qgis.runtime.progress import Recorder, Silent
from repm_qgis.stages import editdsm, run_stage

UTM31 = "EPSG:32631"
CELL = 0.5
SHAPE = (180, 240)
WEST, NORTH = 500000.0, 4800000.0
ROWS, COLUMNS = np.indices(SHAPE)
GROUND = (100 + 0.02 * COLUMNS - 0.01 * ROWS).astype(np.float32)  # a plane: every membrane on it is itself


def place(column, row):
    """Where a corner of cells lies on the ground."""
    return WEST + CELL * column, NORTH - CELL * row


def box(left, top, right, bottom):
    corners = [place(*corner) for corner in ((left, top), (right, top), (right, bottom), (left, bottom), (left, top))]
    return f"POLYGON(({', '.join(f'{x} {y}' for x, y in corners)}))"


def line(*points):
    """A line through columns, rows, and heights where all have one."""
    words = [" ".join(map(str, [*place(*point[:2]), *point[2:]])) for point in points]
    return f"LINESTRING {'Z' if len(points[0]) > 2 else ''}({', '.join(words)})"


def edit(number, operation, wkt, **more):
    return Edit(number, operation, bytes(ogr.CreateGeometryFromWkt(wkt).ExportToIsoWkb()), **more)


def written(folder, heights=GROUND, name="dsm", **facts):
    facts = {"metadata": {TAG: ELLIPSOID}, "unit": "m", **facts}
    bands = [np.asarray(band, np.float32) for band in (heights if isinstance(heights, list) else [heights])]
    return raster.write(str(folder / f"{name}.tif"), bands, (WEST, CELL, 0.0, NORTH, 0.0, -CELL), UTM31, **facts)


def read(path, band=1):
    with raster.opened(str(path)) as dataset:
        return raster.read(dataset, band=band)


def edited(folder, dsm, *edits, crs=UTM31, name="edited", progress=Silent(), **options):
    path = write_edits(str(folder / f"{name}.gpkg"), edits, crs)
    result = run_stage(
        "editdsm", {"dsm": dsm, "edits": path, "output": str(folder / f"{name}.tif"), **options}, progress
    )
    return read(folder / f"{name}.tif"), result


def test_what_a_polygon_covers_is_removed_filled_or_set(tmp_path):
    house = GROUND + 6 * ((ROWS // 30 % 2 == 1) & (COLUMNS // 40 % 2 == 1))
    dsm = written(tmp_path, house)
    heights, result = edited(
        tmp_path,
        dsm,
        edit(1, "remove", box(5, 5, 15, 25)),
        edit(2, "fill", box(36, 26, 84, 64)),
        edit(3, "set", box(100, 100, 110, 110), value=42.5),
    )
    assert np.isnan(heights[5:25, 5:15]).all() and np.isnan(heights).sum() == 200
    assert abs(heights - GROUND)[26:64, 36:84].max() < 1e-3  # no house is left, and the slope goes on below it
    assert (heights[100:110, 100:110] == 42.5).all()
    untouched = np.ones(SHAPE, bool)
    for top, bottom, left, right in ((5, 25, 5, 15), (26, 64, 36, 84), (100, 110, 100, 110)):
        untouched[top:bottom, left:right] = False
    assert (heights[untouched] == house[untouched]).all()
    assert (result.edits, result.edited_cells) == (3, 200 + 38 * 48 + 100)


def test_a_fill_is_the_membrane_of_its_rim(tmp_path):
    """A harmonic surface within an irregular hole: Laplace's equation has it as its only solution."""
    x, y = (COLUMNS - 120) / 100, (ROWS - 90) / 100
    surface = (50 + 8 * (x**2 - y**2) + 3 * x * y).astype(np.float32)
    hole = (np.hypot(x, y) < 0.7 + 0.1 * np.cos(7 * np.arctan2(y, x))) & ~((abs(x) < 0.05) & (abs(y) < 0.3))
    heights, reached = filled(np.where(hole, 1e4, surface).astype(np.float32), hole)
    assert reached.sum() == hole.sum() > 10_000
    assert abs(heights - surface)[hole].max() < 2e-4
    alone = hole.copy()
    alone[:5, :5] = True  # a corner whose neighbours have no heights
    beside = np.where((ROWS < 8) & (COLUMNS < 8), np.nan, surface)
    heights, reached = filled(beside, alone)
    assert not reached[:5, :5].any() and reached.sum() == hole.sum()


def test_water_is_flattened_to_its_shore_or_to_a_value(tmp_path):
    rng = np.random.default_rng(3)
    away = np.hypot(COLUMNS + 0.5 - 120, ROWS + 0.5 - 90)
    lake = away < 50
    bank = 71.0 + np.maximum(away - 52, 0)
    surface = np.where(lake, 71 + rng.normal(0, 4, SHAPE), bank)
    surface[60:65, :] += 15 * (COLUMNS[60:65] < 90)  # trees at the shore
    x, y = place(120, 90)
    circle = ogr.CreateGeometryFromWkt(f"POINT({x} {y})").Buffer(CELL * 50.5, 60).ExportToWkt()
    heights, _ = edited(tmp_path, written(tmp_path, surface), edit(1, "flatten", circle))
    level = np.unique(heights[lake])
    assert len(level) == 1 and abs(level[0] - 71) < 0.3
    heights, _ = edited(tmp_path, str(tmp_path / "dsm.tif"), edit(1, "flatten", circle, value=70.25))
    assert set(np.unique(heights[lake])) == {70.25}


def test_a_breakline_keeps_its_heights_and_fades_within_its_width(tmp_path):
    dsm = written(tmp_path)
    heights, _ = edited(
        tmp_path,
        dsm,
        edit(1, "breakline", line((20, 50.5, 110), (220, 50.5, 130)), width=8.0),
        edit(2, "breakline", line((60.5, 100.5), (160.5, 100.5)), width=4.0),
    )
    middle = (COLUMNS[50] + 0.5 - 20) / 200
    along = slice(30, 210)
    assert abs(heights[50] - (110 + 20 * middle))[along].max() < 1e-3  # the 3-D line's own heights
    half = 8.0 / CELL / 2
    for away in (2, 4, 6):
        share = 1 - (away - 0.75) / (half - 0.75)
        expected = share * (110 + 20 * middle) + (1 - share) * GROUND[50 + away]
        assert abs(heights[50 + away] - expected)[along].max() < 1e-3
    assert (heights[50 + 9] == GROUND[50 + 9]).all() and (heights[50 - 9] == GROUND[50 - 9]).all()
    # A plain line has the DSM's heights at its vertices: on a plane nothing changes.
    assert abs(heights[100] - GROUND[100])[60:160].max() < 1e-3


def test_a_plain_breakline_cuts_what_stands_between_its_vertices(tmp_path):
    surface = GROUND.copy()
    surface[100, 90:130] += 9  # noise of the matching on an edge
    surface[100, 100:105] = np.nan
    heights, _ = edited(
        tmp_path, written(tmp_path, surface), edit(1, "breakline", line((60.5, 100.5), (160.5, 100.5)), width=0.5)
    )
    assert abs(heights[100] - GROUND[100])[61:160].max() < 1e-3


def test_a_brush_covers_its_width(tmp_path):
    heights, _ = edited(tmp_path, written(tmp_path), edit(1, "remove", line((50, 60), (90, 60)), width=6 * CELL))
    gone = np.isnan(heights)
    assert gone[57:63, 50:90].all() and not gone[:57].any() and not gone[63:].any()
    assert not gone[:, :46].any() and not gone[:, 94:].any()
    assert gone[60, 47]  # its ends are round


def test_edits_are_applied_in_the_order_of_their_numbers(tmp_path):
    dsm = written(tmp_path)
    first, second = box(50, 50, 80, 80), box(70, 70, 100, 100)
    later, _ = edited(tmp_path, dsm, edit(7, "set", second, value=9.0), edit(2, "set", first, value=5.0))
    earlier, _ = edited(tmp_path, dsm, edit(1, "set", second, value=9.0), edit(2, "set", first, value=5.0))
    assert later[75, 75] == 9 and earlier[75, 75] == 5 and (later[60, 60], later[90, 90]) == (5, 9)


def test_the_same_records_give_the_same_bytes_and_undone_ones_the_earlier_ones(tmp_path):
    dsm = written(tmp_path, GROUND + np.random.default_rng(1).normal(0, 0.3, SHAPE))
    records = [
        edit(1, "fill", box(20, 20, 60, 50)),
        edit(2, "flatten", box(100, 90, 160, 150)),
        edit(3, "remove", box(0, 0, 9, 9)),
    ]
    before = open(dsm, "rb").read()

    def made(name, *edits):
        edited(tmp_path, dsm, *edits, name=name)
        return (tmp_path / f"{name}.tif").read_bytes()

    three, two, none = made("a", *records), made("b", *records[:2]), made("c")
    assert made("d", *records) == three != two
    assert made("e", *records[:2]) == two  # the third is deleted
    assert made("f", *records[:2], replace(records[2], enabled=False)) == two  # or disabled
    assert made("g", *(replace(each, enabled=False) for each in records)) == none
    assert (read(tmp_path / "g.tif") == read(dsm)).all()  # and all heights are the original's to the bit
    assert open(dsm, "rb").read() == before


def test_blocks_change_no_byte(tmp_path):
    dsm = written(tmp_path, GROUND + np.random.default_rng(1).normal(0, 0.3, SHAPE))
    edits = write_edits(
        str(tmp_path / "edits.gpkg"),
        [
            edit(1, "fill", box(11, 13, 217, 171)),
            edit(2, "flatten", box(100, 90, 160, 150)),
            edit(3, "breakline", line((5, 5, 90), (230, 160, 120)), width=20.0),
            edit(4, "remove", line((5, 150), (200, 20)), width=5.0),
        ],
        UTM31,
    )
    found = []
    for number, block in enumerate((1024, 64, 40)):
        options = {"dsm": dsm, "edits": edits, "output": str(tmp_path / f"{number}.tif")}
        checked = editdsm.EditDsmOptions.from_json(options)
        editdsm.run(checked, Silent(), replace(EDITING, block_cells=block, most_solved=3000))
        found.append((tmp_path / f"{number}.tif").read_bytes())
    assert found[0] == found[1] == found[2]


def test_a_large_fill_is_solved_on_coarser_cells_and_joins_its_rim(tmp_path):
    x, y = (COLUMNS - 120) / 100, (ROWS - 90) / 100
    surface = (50 + 8 * (x**2 - y**2) + 3 * x * y).astype(np.float32)
    hole = box(20, 15, 220, 165)
    dsm = written(tmp_path, np.where((ROWS >= 15) & (ROWS < 165) & (COLUMNS >= 20) & (COLUMNS < 220), 999, surface))
    options = {"dsm": dsm, "edits": write_edits(str(tmp_path / "e.gpkg"), [edit(1, "fill", hole)], UTM31)}
    checked = editdsm.EditDsmOptions.from_json({**options, "output": str(tmp_path / "out.tif")})
    editdsm.run(checked, Silent(), replace(EDITING, most_solved=5000))
    heights = read(tmp_path / "out.tif")
    error = abs(heights - surface)
    assert error.max() < 0.25 and np.sqrt(np.mean(error**2)) < 0.1  # of a relief of 20 m


def test_the_confidence_says_what_was_edited(tmp_path):
    dsm = written(tmp_path)
    bands = [np.full(SHAPE, value) for value in (3, 0.2, 0.8, 0, 0.4)]
    bands[3][:, 200:] = Provenance.BACKGROUND
    confidence = written(tmp_path, bands, "confidence", descriptions=CONFIDENCE_BANDS)
    out = str(tmp_path / "out_confidence.tif")
    records = edit(1, "set", box(10, 10, 20, 20), value=90.0), edit(2, "remove", box(30, 10, 40, 20))
    _, result = edited(tmp_path, dsm, *records, confidence=confidence, edited_confidence=out)
    source = read(out, 4)
    assert (source[10:20, 10:20] == Provenance.EDITED).all() and np.isnan(source[10:20, 30:40]).all()
    assert np.isnan(read(out, 5)[10:20, 10:20]).all() and np.isnan(read(out, 1)[10:20, 10:20]).all()
    assert (source[30:, :200] == 0).all() and (source[30:, 200:] == 1).all()
    assert (read(out, 5)[30:] == np.float32(0.4)).all() and result.edited_confidence == out
    with raster.opened(out) as dataset:
        assert "6 edited by hand" in dataset.GetRasterBand(4).GetDescription()
    assert (tmp_path / "out_confidence.qml").exists() and (tmp_path / "edited.qml").exists()


def test_the_metadata_hold_the_records_and_what_identifies_the_dsm(tmp_path):
    dsm = written(tmp_path, metadata={TAG: ELLIPSOID, "REPM_DAYS": "2019-04-02", "OTHERS": "x"})
    edited(tmp_path, dsm, edit(4, "set", box(1, 1, 3, 3), value=1.5), edit(5, "remove", box(1, 1, 3, 3), enabled=False))
    with raster.opened(str(tmp_path / "edited.tif")) as dataset:
        tags = dataset.GetMetadata()
        assert dataset.GetMetadataItem("LAYOUT", "IMAGE_STRUCTURE") == "COG"
    assert (tags["EDITED_FROM"], tags["EDITS"], tags[TAG]) == ("dsm.tif", "1", ELLIPSOID)
    assert tags["REPM_DAYS"] == "2019-04-02" and "OTHERS" not in tags
    assert tags["EDITED_FROM_CONTENT"] == raster.content_of(dsm)
    assert str(tmp_path) not in json.dumps(tags)
    record = json.loads(tags["EDIT_1"])
    assert (record["number"], record["operation"], record["value"], record["cells"]) == (4, "set", 1.5, 4)
    again = edit(4, "set", record["geometry"], value=1.5)
    assert ogr.CreateGeometryFromWkb(again.geometry).Equals(ogr.CreateGeometryFromWkt(box(1, 1, 3, 3)))


def test_edits_in_another_crs_lie_at_the_same_place(tmp_path):
    from pyproj import Transformer

    corners = [place(*corner) for corner in ((20, 20), (40, 20), (40, 50), (20, 50), (20, 20))]
    degrees = [Transformer.from_crs(UTM31, "EPSG:4326", always_xy=True).transform(*corner) for corner in corners]
    wkt = f"POLYGON(({', '.join(f'{x:.12f} {y:.12f}' for x, y in degrees)}))"
    heights, _ = edited(tmp_path, written(tmp_path), edit(1, "remove", wkt), crs="EPSG:4326")
    gone = np.isnan(heights)
    assert gone[21:49, 21:39].all() and gone.sum() == pytest.approx(600, abs=60)


def test_records_are_written_and_read_as_they_are(tmp_path):
    records = [
        edit(2, "set", box(0, 0, 4, 4), value=7.25, made="2026-01-02T03:04:05Z"),
        edit(1, "breakline", line((0, 0, 10.5), (4, 4, 11.5)), width=2.5, enabled=False),
    ]
    path = write_edits(str(tmp_path / "edits.gpkg"), records, UTM31)
    found = read_edits(path)
    assert found.edits == (records[1], records[0]) and found.crs == UTM31
    assert read_edits(write_edits(path, [], UTM31)).edits == ()


@pytest.mark.parametrize(
    "record, said",
    [
        (edit(1, "paint", box(0, 0, 4, 4)), "operation 'paint': it must be one of remove"),
        (edit(1, "set", box(0, 0, 4, 4)), "sets a value and has none"),
        (edit(1, "set", box(0, 0, 4, 4), value=1e6), "value 1e+06: heights are"),
        (edit(1, "breakline", box(0, 0, 4, 4), width=2.0), "is a breakline and a polygon"),
        (edit(1, "remove", line((0, 0), (4, 4))), "a line with the width 0"),
        (edit(1, "remove", "POINT(500000 4800000)"), "neither a line nor a polygon"),
        (edit(1, "remove", "POLYGON EMPTY"), "has no shape"),
    ],
)
def test_a_record_that_is_none_is_refused_by_its_number(tmp_path, record, said):
    with pytest.raises(InputTableError, match="^Edit 1 of .*") as refused:
        edited(tmp_path, written(tmp_path), record)
    assert said in str(refused.value)
    assert not (tmp_path / "edited.tif").exists()


def test_what_cannot_be_done_is_said_and_leaves_nothing(tmp_path):
    dsm = written(tmp_path, np.where(COLUMNS < 200, GROUND, np.nan))
    void = box(215, 50, 235, 90)
    for operation, said in (("fill", "that no heights surround"), ("flatten", "give its field 'value'")):
        with pytest.raises(EmptyResultError, match=said):
            edited(tmp_path, dsm, edit(1, operation, void))
    with pytest.raises(EmptyResultError, match="whose vertices have no heights"):
        edited(tmp_path, dsm, edit(1, "breakline", line((210, 10), (230, 40)), width=2.0))
    with pytest.raises(OptionError, match="also a file of the input DSM"):
        edited(tmp_path, dsm, output=dsm)
    with pytest.raises(OptionError, match="CONFIDENCE"):
        edited(tmp_path, dsm, edited_confidence=str(tmp_path / "c.tif"))
    with pytest.raises(ImageError, match="does not have the cells"):
        other = raster.write(str(tmp_path / "o.tif"), [GROUND[:90]], (WEST, CELL, 0, NORTH, 0, -CELL), UTM31)
        edited(tmp_path, dsm, confidence=other, edited_confidence=str(tmp_path / "c.tif"))
    progress = Recorder(Silent())
    heights, result = edited(tmp_path, dsm, edit(9, "remove", box(900, 900, 950, 950)), progress=progress)
    assert result.edited_cells == 0 and "Edit 9 covers no cell of the DSM" in progress.findings[0]
    assert not [path.name for path in tmp_path.iterdir() if ".part" in path.name]


class Heard(Recorder):
    """Keeps what is said, too."""

    def __init__(self):
        super().__init__(Silent())
        self.said = []

    def info(self, text):
        self.said.append(str(text))


@pytest.mark.parametrize(
    ("record", "applied", "named", "said"),
    (
        ({"wkt": box(30.6, 30.6, 30.9, 30.9)}, 1, "Edit 1 covers no cell of the DSM", "1 edit applied to 0 cells."),
        ({"wkt": box(30, 30, 31, 31)}, 1, "", "1 edit applied to 1 cell."),
        ({"wkt": box(30, 30, 40, 40), "enabled": False}, 0, "is enabled, so the DSM stays", "0 edits applied to 0"),
    ),
    ids=("between centres", "one cell", "none enabled"),
)
def test_edits_that_change_nothing_are_named(tmp_path, record, applied, named, said):
    heard = Heard()
    _, result = edited(tmp_path, written(tmp_path), edit(1, "remove", **record), progress=heard)
    assert result.edits == applied and any(said in line for line in heard.said)
    assert [named in finding for finding in heard.findings] == ([True] if named else [])


@pytest.mark.parametrize(
    "crs", (None, 'LOCAL_CS["Undefined Cartesian SRS",UNIT["Meter",1]]'), ids=("none", "undefined")
)
def test_edits_without_a_crs_are_refused_with_a_remedy(tmp_path, crs):
    """GDAL writes "Undefined ... SRS" into a GeoPackage where a layer has none."""
    path, reference = str(tmp_path / "e.gpkg"), osr.SpatialReference(crs) if crs else None
    source = ogr.GetDriverByName("GPKG").CreateDataSource(path)
    layer = source.CreateLayer("edits", reference, ogr.wkbPolygon)
    layer.CreateField(ogr.FieldDefn("operation", ogr.OFTString))
    feature = ogr.Feature(layer.GetLayerDefn())
    feature["operation"] = "remove"
    feature.SetGeometry(ogr.CreateGeometryFromWkt(box(30, 30, 40, 40)))
    layer.CreateFeature(feature)
    del feature, layer, source
    with pytest.raises(InputTableError, match=r"e.gpkg' has no coordinate reference system: assign it one first"):
        run_stage("editdsm", {"dsm": written(tmp_path), "edits": path, "output": str(tmp_path / "o.tif")}, Silent())


def test_a_layer_without_operations_is_refused(tmp_path):
    from repm_qgis.files.vector import write_layer

    path = write_layer(str(tmp_path / "areas.gpkg"), UTM31, ogr.wkbPolygon, {"name": str}, [])
    with pytest.raises(InputTableError, match="has no field 'operation'"):
        run_stage("editdsm", {"dsm": written(tmp_path), "edits": path, "output": str(tmp_path / "o.tif")}, Silent())
    with pytest.raises(InputTableError, match="Cannot read the edits"):
        read_edits(str(tmp_path / "dsm.tif"))


def test_the_edits_of_a_dsm_lie_beside_it(tmp_path):
    from repm_qgis.editing.session import DsmEdits, original_of

    dsm = written(tmp_path)
    records = DsmEdits(dsm)
    assert (records.path, records.edited) == (str(tmp_path / "dsm_edits.gpkg"), str(tmp_path / "dsm_edited.tif"))
    assert records.undo() is None and not (tmp_path / "dsm_edits.gpkg").exists()
    for number in (1, 2):
        assert records.add("set", box(0, 0, 4, 4), 1.5, None, "2026-01-02T03:04:05Z").number == number
    with pytest.raises(InputTableError, match="a line with the width 0"):
        records.add("remove", line((0, 0), (4, 4)), None, None)
    assert [edit.number for edit in DsmEdits(dsm).edits] == [1, 2]  # the wrong one is not kept
    records.enable(1, False)
    other = DsmEdits(dsm)
    assert [edit.enabled for edit in other.edits] == [False, True] and other.edits[1].made == "2026-01-02T03:04:05Z"
    assert other.undo() == records.edits[1]
    assert records.add("remove", box(0, 0, 2, 2), None, None).number == 2  # after what others did to the file
    run_stage("editdsm", {"dsm": dsm, "edits": records.path, "output": records.edited}, Silent())
    assert original_of(records.edited) == dsm and original_of(dsm) == dsm
    moved = str(tmp_path / "moved.tif")
    (tmp_path / "dsm_edited.tif").rename(moved)
    assert original_of(moved) == moved


@pytest.mark.parametrize("value, words", ((-9999.0, "which means no height"), (9500.0, "heights are -12000 to 9000 m")))
def test_what_is_no_height_is_not_set(tmp_path, value, words):
    record = edit(3, "set", box(10, 10, 50, 50), value=value)
    with pytest.raises(InputTableError, match=f"Edit 3 of .* has the value {value:g}.*{words}"):
        edited(tmp_path, written(tmp_path), record)


@pytest.mark.parametrize(
    ("operation", "wkt", "value", "named"),
    (
        ("breakline", line((20, 50, 0.0), (220, 50, 0.0)), None, "has the height 0 m, 100 m"),
        ("breakline", line((20, 50, 101.0), (220, 50, 700.0)), None, "has the height 700 m, 59"),
        ("breakline", line((20, 50, 110.0), (220, 50, 112.0)), None, ""),
        ("breakline", line((20, 50, 121.0), (220, 50, 125.0)), None, "has the height 125 m, 21"),
        ("breakline", line((20, 50), (220, 50)), None, ""),
        ("set", box(100, 100, 110, 110), 0.0, "has the height 0 m, 101 m"),
        ("set", box(100, 100, 110, 110), 420.0, "has the height 420 m, 31"),
        ("set", box(100, 100, 110, 110), 120.0, ""),  # a house
        ("flatten", box(100, 100, 110, 110), -300.0, "has the height -300 m, 40"),
        ("flatten", box(100, 100, 110, 110), None, ""),
    ),
)
def test_heights_far_from_the_ground_are_named(tmp_path, operation, wkt, value, named):
    heard = Heard()
    edited(tmp_path, written(tmp_path), edit(1, operation, wkt, value=value, width=4.0), progress=heard)
    assert [each.id for each in heard.findings] == (["edit-far"] if named else [])
    assert all(named in each and "beyond all heights of" in each for each in heard.findings)


@pytest.mark.parametrize(("right", "ids"), ((240, ["edit-large"]), (60, [])))
def test_an_edit_that_removes_most_of_a_dsm_is_named(tmp_path, right, ids):
    heard = Heard()
    edited(tmp_path, written(tmp_path), edit(1, "remove", box(0, 0, right, 180)), progress=heard)
    assert [each.id for each in heard.findings] == ids


def test_a_line_drawn_without_heights_is_named_near_the_sea_too(tmp_path):
    """QGIS gives new vertices a Z of 0; along a shore that is right."""
    for level, named in ((5.0, True), (0.0, False)):
        heard, record = Heard(), edit(1, "breakline", line((20, 50, 0.0), (220, 50, 0.0)), width=4.0)
        edited(tmp_path, written(tmp_path, GROUND - 100 + level), record, progress=heard)
        assert bool(heard.findings) == named


def test_a_polygon_of_an_edit_that_crosses_itself_is_named(tmp_path):
    heard = Heard()
    x0, y0, x1, y1 = *place(100, 100), *place(140, 140)
    bow = f"POLYGON(({x0} {y0}, {x1} {y1}, {x1} {y0}, {x0} {y1}, {x0} {y0}))"
    edited(tmp_path, written(tmp_path), edit(4, "set", bow, value=101.0), progress=heard)
    (found,) = heard.findings
    assert found.id == "polygons-crossed" and "edited.gpkg' cross themselves (4)" in found
