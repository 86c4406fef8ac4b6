"""Edits of a DSM: the algorithm from the command line, and the dock that draws them, in the desktop itself (Xvfb)."""

from __future__ import annotations

import json
import os
import shutil

import numpy as np
import pytest

CELL, WEST, NORTH = 0.5, 500000.0, 4800000.0
SHAPE = (160, 200)
ROWS, COLUMNS = np.indices(SHAPE)
GROUND = (100 + 0.02 * COLUMNS).astype(np.float32)


def place(column, row):
    return WEST + CELL * column, NORTH - CELL * row


def corners(left, top, right, bottom):
    return [place(*corner) for corner in ((left, top), (right, top), (right, bottom), (left, bottom))]


def read(path, band=1):
    from repm_qgis.imagery import raster

    with raster.opened(str(path)) as dataset:
        return raster.read(dataset, band=band)


@pytest.fixture
def town(tmp_path):
    """A slope with houses, water of which matching made noise, a void, and its confidence, in a folder of its own."""
    from repm_qgis.geometry.vertical import ELLIPSOID, TAG
    from repm_qgis.imagery import raster
    from repm_qgis.imagery.confidence import CONFIDENCE_BANDS
    from repm_qgis.reports.styles import write_style

    surface = GROUND + 8.0 * ((abs(ROWS - 40) < 12) & (abs(COLUMNS - 50) < 16))
    for column, height in ((40, 5), (75, 6), (120, 7), (160, 4)):
        surface += height * ((abs(ROWS - 80) < 8) & (abs(COLUMNS - column) < 12))
    water = np.hypot((COLUMNS - 130) / 26, (ROWS - 40) / 17) < 1
    surface = np.where(water, 101 + np.random.default_rng(1).normal(0, 1.5, SHAPE), surface)
    surface[110:150, 150:190] = np.nan
    frame = (WEST, CELL, 0.0, NORTH, 0.0, -CELL), "EPSG:32631"
    folder = tmp_path / "town"
    folder.mkdir()
    facts = {"metadata": {TAG: ELLIPSOID}, "unit": "m"}
    dsm = raster.write(str(folder / "dsm.tif"), [surface.astype(np.float32)], *frame, **facts)
    bands = [np.full(SHAPE, value, np.float32) for value in (3, 0.2, 0.8, 0, 0.4)]
    confidence = raster.write(str(folder / "confidence.tif"), bands, *frame, descriptions=CONFIDENCE_BANDS)
    write_style("dsm", dsm)
    return dsm, confidence, surface


@pytest.mark.long
def test_a_layer_of_polygons_from_the_command_line(headless, town, tmp_path):
    from osgeo import ogr

    from repm_qgis.files.vector import write_layer

    dsm, confidence, surface = town
    wkt = f"POLYGON(({', '.join(f'{x} {y}' for x, y in [*corners(30, 24, 70, 56), place(30, 24)])}))"
    rows = [(ogr.CreateGeometryFromWkt(wkt), ("fill",))]
    edits = write_layer(str(tmp_path / "areas.gpkg"), "EPSG:32631", ogr.wkbPolygon, {"OPERATION": str}, rows)
    out = {name: str(tmp_path / f"{name.lower()}.tif") for name in ("OUTPUT", "EDITED_CONFIDENCE")}
    given = [f"DSM={dsm}", f"EDITS={edits}|layername=areas", f"CONFIDENCE={confidence}"]
    given += [f"{name}={path}" for name, path in out.items()]
    done = headless("--json", "run", "repm:editdsm", "--", *given)  # in QGIS's own process, with what QGIS ships
    assert done.returncode == 0, done.stderr + done.stdout
    results = json.loads(done.stdout)["results"]
    assert (results["EDITS"], results["EDITED_CELLS"]) == (1, 32 * 40)
    heights, source = read(out["OUTPUT"]), read(out["EDITED_CONFIDENCE"], 4)
    assert abs(heights - GROUND)[24:56, 30:70].max() < 1e-3 and surface[40, 50] > 108
    assert (source[24:56, 30:70] == 6).all() and (source == 6).sum() == 32 * 40
    assert all(os.path.exists(f"{os.path.splitext(path)[0]}.qml") for path in out.values())
    wrong = headless("run", "repm:editdsm", "--", f"DSM={dsm}", f"EDITS={edits}", f"OUTPUT={dsm}")
    assert wrong.returncode and "would be lost" in wrong.stderr + wrong.stdout


@pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)
@pytest.mark.long
def test_edits_drawn_on_the_map(desktop_start, town, tmp_path):
    dsm, confidence, surface = town
    plan = {
        "dsm": dsm,
        "confidence": confidence,
        "house": corners(28, 22, 72, 58),
        "stroke": [place(column, 100) for column in range(20, 61, 8)],
        "water": corners(100, 20, 160, 60),
        "line": [place(20.5, 140.5), place(120.5, 140.5)],
        "void": corners(155, 115, 180, 140),
    }
    found = desktop_start("drive_surface_editing.py", plan, seconds=200)
    assert found["chosen"] == ["DSM town", "Confidence town"] and found["first words"].startswith("Choose an edit")
    assert found["offered"] == [False, ["polygon", "brush"]] and found["line"] == ["line"]
    assert found["tool"] == [True, True] and found["none yet"] == 0 and found["automatic"] == "from the shore"
    assert found["after the polygon"][0] == "Edits in dsm_edited.tif: 1."
    names = {name: shown for name, shown, _ in found["layers"]}
    assert names["Edited: DSM town"] and not names["DSM town"] and not names["Edited: Confidence town"]
    assert found["list"] == [
        "1: Fill from the rim",
        "2: Set to a height, 77.5 m",
        "3: Flatten water",
        "4: Keep a breakline",
    ]
    assert "no heights surround" in found["taken back"][0] and found["taken back"][1] == 4
    assert found["enabled"] == [True, False, True, True] and found["left edits"] == ["fill", "set", "flatten"]
    renderers = found["renderers"]
    assert renderers["Edited: DSM town"] == "singlebandpseudocolor"
    assert names["Hillshade of Edited: DSM town"] and not names["Hillshade of DSM town"]
    assert "Hillshade of Edited: DSM town" not in renderers  # no layer of the project
    assert found["of the edited layer"] == [True, 3]
    assert found["left"] == 0
    assert sorted(name for name in os.listdir(os.path.dirname(dsm)) if not name.endswith(".qml")) == [
        "confidence.tif",
        "dsm.tif",
        "dsm_edited.tif",
        "dsm_edited.tif.three",
        "dsm_edited_confidence.tif",
        "dsm_edits.gpkg",
    ]
    heights, source = read(dsm.replace(".tif", "_edited.tif")), read(dsm.replace(".tif", "_edited_confidence.tif"), 4)
    assert abs(heights - GROUND)[26:54, 32:68].max() < 0.01  # the house is gone
    assert len(np.unique(heights[24:56, 104:156])) == 1  # the water is level, at its shore
    assert 101.8 < heights[40, 130] < 102.5
    assert (heights[100] == surface[100].astype(np.float32))[20:60].all()  # what was painted is not ticked
    assert (source[26:54, 32:68] == 6).all() and (source[95:105] == 0).all()
    assert (read(dsm) == surface.astype(np.float32))[:110].all()
    # The same records give the same bytes without the desktop.
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    again = str(tmp_path / "again.tif")
    run_stage("editdsm", {"dsm": dsm, "edits": dsm.replace(".tif", "_edits.gpkg"), "output": again}, Silent())
    assert open(again, "rb").read() == open(dsm.replace(".tif", "_edited.tif"), "rb").read()
