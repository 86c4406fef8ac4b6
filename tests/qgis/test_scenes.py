"""The panel of scenes in the desktop itself (Xvfb), with a workspace that a run has made, and with others."""

from __future__ import annotations

import os
import shutil

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage

needs_desktop = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.fixture(scope="module")
def made(town, tmp_path_factory):
    """A workspace with a DSM and an orthophoto, as QGIS makes it."""
    folder = tmp_path_factory.mktemp("panel") / "old town"
    job = {"images": list(town.images), "workspace": str(folder), "resolution": 1.0, "fill": "all"}
    job.update({name: f"{folder}/{file}.tif" for name, file in (("output", "dsm"), ("ortho", "ortho"))})
    words = [f"IMAGES={path}" for path in town.images] + [f"WORKSPACE='{folder}'", "RESOLUTION=1.0", "FILL=all"]
    words += [f"OUTPUT='{folder}/dsm.tif'", f"ORTHO='{folder}/ortho.tif'"]
    run_stage("pipeline", {**job, "command": f"qgis_process run repm:pipeline -- {' '.join(words)}"}, Silent())
    return folder


@pytest.mark.parametrize(
    ("recorded", "filled"),
    [
        ({"order": "3", "resolution": "0.5", "fill": "all"}, {"ORDER": 3, "RESOLUTION": 0.5, "FILL": "all"}),
        ({"order": "many", "fill": "everything", "workers": "9", "evil": "x"}, {}),
        ({"images": "/a.tif", "crs": "EPSG:32631"}, {"IMAGES": ["/a.tif"], "CRS": "EPSG:32631"}),
    ],
)
def test_recorded_options_as_a_dialog_takes_them(provider, recorded, filled):
    from repm.desktop.scene_actions import parameters_of

    assert parameters_of(recorded) == filled


@pytest.mark.parametrize("overviews", [False, True])
def test_a_picture_of_a_large_image_shows_its_halves(provider, tmp_path, overviews):
    """Dark in the west, bright in the east; half as high as wide."""
    from repm.desktop.scene_reading import picture_of

    path = str(tmp_path / "image.tif")
    image = gdal.GetDriverByName("GTiff").Create(path, 4000, 2000, 1, gdal.GDT_UInt16)
    image.GetRasterBand(1).WriteArray(np.where(np.arange(4000) < 2000, 100, 900) * np.ones((2000, 1), np.uint16))
    if overviews:
        image.BuildOverviews("NEAREST", [8])
    del image
    found = picture_of(path)
    assert (found.width(), found.height()) == (64, 32)
    assert (found.pixelColor(10, 16).red(), found.pixelColor(54, 16).red()) == (0, 255)
    assert picture_of(str(tmp_path / "nowhere.tif")) is None


@needs_desktop
@pytest.mark.slow
def test_the_panel_shows_what_is_there_and_does_what_it_says(desktop_start, made, town, tmp_path):
    folder, moved = tmp_path / "old town", tmp_path / "elsewhere" / "river"
    shutil.copytree(made, folder)
    shutil.copytree(made, moved)
    (folder / "dsm.qml").write_text("<qgis><!-- a stranger's --></qgis>")
    holder = (
        "import sys; from repm_qgis.runtime.locks import exclusive; from repm_qgis.runtime.progress import Silent\n"
        f"with exclusive('dsmfuse', Silent(), [{str(folder)!r}]): print('held', flush=True); sys.stdin.read()"
    )
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    plan = {
        "folder of the scene": str(folder),
        "moved from": str(tmp_path / "river"),
        "moved to": str(moved),
        "holder": f"import sys; sys.path.insert(0, {root!r})\n{holder}",
    }
    found = desktop_start("drive_scenes.py", plan, seconds=120)
    first = [(depth, text) for depth, text, _, _ in found["first"]]
    count = len(town.images)
    assert first[:2] == [(0, "old town"), (1, f"Images ({count})")] and (1, "Runs (1)") in first
    assert [text for depth, text in first if depth == 2][-4:] == ["DSM", "Orthophoto", "Tiles", "Tie points"]
    assert found["first"][-1][:3] == [0, "river", "not there"]
    about = {text: said for _, text, said, _ in found["first"]}
    run = next(said for text, said in about.items() if text.startswith("20"))  # the time of the run
    assert "RESOLUTION 1.0" in run and "FILL all" in run and about["DSM"].startswith("dsm.tif, ")
    assert found["pictures"] == [True, True]
    assert found["renderer"] == "QgsSingleBandPseudoColorRenderer"  # ours, not the one beside the file
    assert [valid for _, valid in found["layers"]] == [True, True] and found["on the map"]
    ticks = {text: tick for _, text, _, tick in found["ticked"]}
    assert (ticks["DSM"], ticks["Orthophoto"], ticks[f"Images ({count})"]) == (True, False, None)
    assert found["visible"] == [name for name in found["visible"] if "Orthophoto" not in name] != []
    assert found["hidden"]
    again = found["again"]
    assert again["IMAGES"] == list(town.images) and again["WORKSPACE"] == str(folder)
    assert (again["RESOLUTION"], again["FILL"], again["OUTPUT"]) == (1.0, "all", str(folder / "dsm.tif"))
    assert "RESOLUTION=1.0" in found["copied"] and f"'WORKSPACE={folder}'" in found["copied"]
    assert found["terrain"] == str(folder / "dsm.tif")
    with open(folder / "dsm_page.pdf", "rb") as stream:
        assert stream.read(5) == b"%PDF-"
    page = found["page"]
    assert page["title"] == found["layout"] == "old town" and f"Images: {count}" in page["figures"]
    assert (
        "Cells: 1 m" in page["figures"] and "EPSG:32631" in page["figures"] and "as the images' RPCs" in page["figures"]
    )
    assert page["verdict"].split(".")[0] in run  # what the panel and the report say
    assert [name.split(" ")[0] for name in found["maps"]["map"]] == ["Hillshade", "DSM"]
    assert [name.split(" ")[0] for name in found["maps"]["inset"]] == ["Orthophoto"]
    assert found["relinked"] and found["kept"] == [str(folder), str(moved)]
    assert [text for depth, text, _, _ in found["second"] if depth == 0] == ["old town", "river"]
    assert "ortho.tif" in found["asked"][0] and "dsm.tif" not in found["asked"][0]
    assert "dsm.tif" in found["files"] and not {"ortho.tif", "ortho.qml"} & set(found["files"])
    assert not [name for name in found["layers after"] if "Orthophoto" in name]
    gone = next(said for _, text, said, _ in found["third"] if text == "Orthophoto")
    assert gone.endswith("not there")
    assert "dsmfuse" in found["writer"] and found["removable meanwhile"] == [False]
    assert "moved or removed" in found["gone"] and not found["left"]
