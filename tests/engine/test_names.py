"""What a scene is called: by what says most of it, and by its days."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from repm_qgis import names
from repm_qgis.imagery.raster import RasterFrame, created
from repm_qgis.runtime.translation import written_in
from repm_qgis.scene import SCHEMA, is_registered


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("/data/hills", "hills"),
        ("/data/hills/out", "hills"),  # "out" says nothing
        ("/data/hills/Results 2", "hills"),
        ("/data/2019", "2019"),
        ("/data/out_3", ""),
        ("/tmp/processing_WpllIw/d164a2fde3f6424bbb18b66c2307a9d7/WORKSPACE", ""),
        (str(Path.home() / "hills"), "hills"),
        (str(Path.home() / "work"), ""),  # and not the user's name
        ("", ""),
    ],
)
def test_a_folder_that_says_nothing_is_named_after_the_one_around_it(folder, name):
    assert names.folder_name(folder) == name


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("/work/hills/dsm.tif", "hills"),
        ("/work/hills/dsm_2.tif", "hills"),
        ("/work/hills/dsm_2m.tif", "hills"),
        ("/work/results/giza 2019.tif", "giza 2019"),
        ("/work/results/hills_dsm.tif", "hills"),
        ("/work/results/DSM_hills-west.tif", "hills-west"),
        ("/tmp/processing_WpllIw/d164a2fde3f6424bbb18b66c2307a9d7/OUTPUT.tif", ""),
    ],
)
def test_a_surface_is_named_after_its_file_or_its_folder(path, name):
    assert names.surface_name(path) == name


def test_images_are_named_after_what_holds_all_of_them():
    assert names.images_name(["/data/order 7/IMG_1/a.tif", "/data/order 7/IMG_2/b.tif"]) == "order 7"
    assert names.images_name(["/data/a.tif", "/data/b.tif"]) == "a"
    assert names.images_name(["/data/hills/a.tif"]) == "a"
    assert names.images_name([]) == ""


def test_a_run_is_named_after_its_workspace_its_dsm_or_its_images():
    images = ["/data/order 7/a.tif", "/data/order 7/b.tif"]
    assert names.run_name("/data/hills", "/data/giza.tif", images) == "hills"
    assert names.run_name("/data/out", "/data/giza.tif", images) == "giza"
    assert names.run_name("/data/out", "/data/dsm.tif", images) == "order 7"


def test_titles_have_the_days():
    assert names.titled("hills", ["2019-04-02"]) == "hills, 2019-04-02"
    assert names.titled("hills", ["2019-04-02", "2019-04-09", "2019-05-01"]) == "hills, 2019-04-02 – 2019-05-01"
    assert names.titled("", ["2019-04-02"]) == "2019-04-02"
    assert names.titled("hills", []) == "hills"


def test_mosaics_and_changes_are_named_after_their_parts():
    assert names.mosaic_name("/work/mosaic.vrt", ["/work/west/dsm.tif", "/work/east/dsm.tif"]) == "west + east"
    many = [f"/work/part_of_{number}/dsm.tif" for number in "abcd"]
    assert names.mosaic_name("/work/valley.vrt", many) == "valley"
    assert names.mosaic_name("/work/mosaic.vrt", many) == ""
    assert names.dates_name("/work/2019/dsm.tif", "/work/2024/dsm.tif") == "2019 – 2024"
    assert names.dates_name("/work/giza/dsm_1.tif", "/work/giza/dsm_2.tif") == "giza"


def test_a_dsm_says_when_its_images_were_taken(tmp_path):
    path = str(tmp_path / "dsm.tif")
    heights = np.zeros((2, 2), np.float32)
    frame = RasterFrame(heights.shape, heights.dtype, 1, (0, 1, 0, 0, 0, -1))
    with created(path, frame, metadata={names.DAYS: "2019-05-01 2019-04-02"}) as writer:
        writer.write(heights, 0, 0)
    assert names.surface_days(path) == ["2019-04-02", "2019-05-01"]
    assert names.surface_days(str(tmp_path / "none.tif")) == []
    assert names.surface_title(path) == f"{os.path.basename(tmp_path)}, 2019-04-02 – 2019-05-01"


@pytest.mark.parametrize("placed, mark", (("registered to a reference", "registered, "), ("ground control points", "")))
def test_a_dsm_of_a_registered_scene_is_told_from_the_one_before(placed, mark, tmp_path):
    path = str(tmp_path / "dsm.tif")
    tags = {"REPM_PLACED": placed, names.DAYS: "2019-05-01"}
    frame = RasterFrame((2, 2), np.float32, 1, (0, 1, 0, 0, 0, -1))
    with created(path, frame, metadata=tags) as writer:
        writer.write(np.zeros((2, 2), np.float32), 0, 0)
    assert names.is_of_registered(path) == bool(mark)
    assert names.surface_title(path) == f"{mark}{os.path.basename(tmp_path)}, 2019-05-01"
    assert not names.is_of_registered(str(tmp_path / "none.tif"))
    assert names.marked("", True) == ""
    with written_in("de"):
        assert names.marked("hills", True) == "eingepasst, hills"


@pytest.mark.parametrize("text, registered", (('{"shift": 1}', True), ("null", False)))
def test_a_scene_says_whether_it_is_registered(text, registered, tmp_path):
    path = tmp_path / "scene.json"
    path.write_text(f'{{"format": "repm-scene", "schema": {SCHEMA}, "registration": {text}}}')
    assert is_registered(str(path)) == registered
    path.write_text("no scene")
    assert not is_registered(str(path))
    assert not is_registered(str(tmp_path / "none.json"))
