"""What the panel of scenes reads of a workspace, against what was put there; and what it must not do with others'."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import WorkspaceError
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import SceneFacts, facts_of
from repm_qgis.stages import run_stage
from repm_qgis.workspaces import reading
from repm_qgis.workspaces.options import options_of_command, safe_inputs
from repm_qgis.workspaces.products import remove_products
from repm_qgis.workspaces.reading import read_workspace


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A workspace of two small images, with a report of a run as the pipeline writes it."""
    folder = tmp_path_factory.mktemp("panel") / "old town"
    job = {"folder": str(folder.parent / "images"), "kind": "urban", "size": 240, "seed": 3}
    images = run_stage("sampledata", job, Silent()).images[:2]
    run_stage("epmfit", {"images": images, "workspace": str(folder)}, Silent())
    for name in ("dsm.tif", "dsm_dtm_2.tif", "my hills.tif"):
        gdal.GetDriverByName("GTiff").Create(str(folder / name), 8, 8, 1, gdal.GDT_Float32)
    (folder / "dsm.qml").write_text("<qgis/>")
    words = [*(f"IMAGES={path}" for path in images), f"WORKSPACE={folder}", f"OUTPUT={folder}/dsm.tif"]
    words += [f"ORTHO={folder}/gone.tif", f"CLOUD={folder.parent}/outside.laz", "RESOLUTION=2.5", "FILL=all"]
    report(folder, words)
    (folder.parent / "outside.laz").write_bytes(b"LASF")
    return folder, images


def report(
    folder, words, verdict='<div class="warning good" role="note"><strong>Good.</strong>\nFine &amp; well.\n</div>'
):
    command = " ".join(f"'{word}'" if " " in word else word for word in words)
    page = f"<h1>Surface model: old town</h1>{verdict}<pre>qgis_process run repm:pipeline -- {command}</pre>"
    (folder / "report.html").write_text(f"{page}<footer>REPM · now</footer>", encoding="utf-8")


def copy_of(fitted, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(fitted[0], folder)
    return folder


def test_images_runs_and_products_of_a_workspace(fitted):
    folder, images = fitted
    found = read_workspace(str(folder))
    assert (found.title, found.problem, found.writer) == ("old town", "", "")
    assert [(each.path, each.there) for each in found.images] == [(path, True) for path in images]
    (run,) = found.runs
    assert (run.verdict, run.good, run.text) == ("Good.", True, "Fine & well.")
    assert run.differing == ("RESOLUTION 2.5", "FILL all")
    assert run.options["images"] == tuple(images) and run.options["output"] == str(folder / "dsm.tif")
    made = {os.path.basename(each.path): each for each in found.products}
    assert {name: (each.product.title, each.there, each.removable) for name, each in made.items()} == {
        "dsm.tif": ("DSM", True, True),
        "dsm_dtm_2.tif": ("Terrain (DTM)", True, True),
        "gone.tif": ("Orthophoto", False, True),
        "tiles.gpkg": ("Tiles", True, False),
    }
    sizes = [os.path.getsize(folder / name) for name in ("dsm.tif", "dsm.qml")]
    assert made["dsm.tif"].size == sum(sizes) and found.product("dtm").path == str(folder / "dsm_dtm_2.tif")
    facts = facts_of(str(folder / "scene.json"))
    assert isinstance(facts, SceneFacts) and facts.crs == found.crs and found.bounds[0] < found.bounds[2]


def test_date_and_sun_of_an_image(fitted, tmp_path):
    folder = copy_of(fitted, tmp_path)
    scene = json.loads((folder / "scene.json").read_text())
    scene["views"][0]["acquired"] = "2021-06-21T12:00:00Z"
    (folder / "scene.json").write_text(json.dumps(scene))
    first, second = read_workspace(str(folder)).images
    rpc = facts_of(str(folder / "scene.json")).views[0].rpc
    # At noon UTC of the longest day the sun stands above 23.44 degrees north, near the meridian of Greenwich.
    east = np.radians(rpc.lon_off)
    north, tilt = np.radians(rpc.lat_off), np.radians(23.44)
    height = np.degrees(np.arcsin(np.sin(north) * np.sin(tilt) + np.cos(north) * np.cos(tilt) * np.cos(east)))
    assert first.acquired.startswith("2021-06-21") and abs(first.sun[1] - height) < 1.0
    assert second.sun is None


def test_a_workspace_that_was_moved_runs_again_where_it_is_now(fitted, tmp_path):
    folder = copy_of(fitted, tmp_path)
    (run,) = read_workspace(str(folder)).runs
    assert run.options["workspace"] == str(folder) and run.options["output"] == str(folder / "dsm.tif")
    gone = read_workspace(str(tmp_path / "nowhere"))
    assert "moved or removed" in gone.problem and not gone.products


@pytest.mark.parametrize("wrong", ["", "{}", "[" * 100_000, '{"format": "repm-scene", "schema": 2}', '{"views": 5}'])
def test_a_scene_that_cannot_be_read_is_told_and_the_rest_is_shown(fitted, tmp_path, wrong):
    folder = copy_of(fitted, tmp_path)
    (folder / "scene.json").write_text(wrong)
    found = read_workspace(str(folder))
    assert str(folder / "scene.json") in found.problem and not found.images
    assert [each.product.title for each in found.products if each.there][0] == "DSM"


def test_a_stranger_s_records_lead_nowhere(fitted, tmp_path):
    """Neither to the network, nor to files outside that would be overwritten, nor to somebody's workers."""
    folder = copy_of(fitted, tmp_path)
    victim = tmp_path / "victim.tif"
    victim.write_bytes(b"mine")
    (folder / "dsm_buildings.gpkg").symlink_to(victim)
    words = ["IMAGES=/vsicurl/http://example.org/a.tif", f"IMAGES={fitted[1][0]}", f"WORKSPACE={folder}"]
    words += [f"OUTPUT={victim}", "CLUSTER=tcp://example.org:8786", "DEM=//server/share/dem.tif", "EVIL=1", "ORDER=3"]
    report(folder, [*words, "VERTICAL_DATUM=https://example.org/grid.tif"], "")
    scene = json.loads((folder / "scene.json").read_text())
    scene["views"][0]["image"] = "/vsicurl/http://example.org/a.tif"
    (folder / "scene.json").write_text(json.dumps(scene))
    found = read_workspace(str(folder))
    (run,) = found.runs
    assert found.images[0].remote and not found.images[1].remote
    assert not {"output", "cluster", "dem", "vertical_datum", "evil"} & set(run.options)
    assert run.options["order"] == "3" and run.options["workspace"] == str(folder)
    assert "dsm_buildings.gpkg" not in [os.path.basename(each.path) for each in found.products]
    shown = [each for each in read_workspace(str(fitted[0])).products if each.path == str(fitted[0] / "dsm.tif")]
    with pytest.raises(WorkspaceError, match="not a product in the workspace"):
        remove_products(str(folder), shown)
    assert victim.read_bytes() == b"mine" and shown[0].there


def test_files_that_must_not_be_opened_are_left_out_of_a_dialog(fitted, tmp_path):
    vrt = tmp_path / "a.vrt"
    part = "<SimpleSource><SourceFilename>/vsicurl/http://example.org/a.tif</SourceFilename></SimpleSource>"
    band = f'<VRTRasterBand dataType="Byte" band="1">{part}</VRTRasterBand>'
    vrt.write_text(f'<VRTDataset rasterXSize="8" rasterYSize="8">{band}</VRTDataset>')
    images = (str(vrt), fitted[1][0], "relative.tif", "//server/a.tif")
    kept = safe_inputs({"images": images, "dem": str(vrt), "gcps": "/vsicurl/x.csv", "order": 3})
    assert kept == {"images": (fitted[1][0],), "order": 3}


@pytest.mark.parametrize(
    ("command", "options"),
    [
        (
            "qgis_process run repm:pipeline -- 'IMAGES=/a b.tif' IMAGES=/c.tif ORDER=3",
            {"images": ("/a b.tif", "/c.tif"), "order": "3"},
        ),
        (
            'qgis_process run repm:pipeline -- "WORKSPACE=C:\\my data" ORDER=3',
            {"workspace": "C:\\my data", "order": "3"},
        ),
        ("qgis_process run repm:dtm -- ORDER=3", {}),
        ("rm -rf / ; qgis_process run repm:pipeline -- ORDER=3", {}),
        ("qgis_process run repm:pipeline -- 'ORDER=3", {}),
    ],
)
def test_commands_of_linux_and_windows(command, options):
    assert options_of_command(command, "pipeline") == options


def test_products_are_removed_with_what_belongs_to_them(fitted, tmp_path):
    folder = copy_of(fitted, tmp_path)
    before = set(os.listdir(folder))
    removed = remove_products(str(folder), [read_workspace(str(folder)).product("dsmfuse")])
    assert before - set(os.listdir(folder)) == {"dsm.tif", "dsm.qml"} == {os.path.basename(path) for path in removed}
    with pytest.raises(WorkspaceError, match="not a product"):  # which the scene needs
        remove_products(str(folder), [read_workspace(str(folder)).product("epmfit", "tiles")])


def test_who_writes_in_a_workspace_is_told_and_nothing_is_removed_meanwhile(fitted, tmp_path):
    folder = copy_of(fitted, tmp_path)
    code = (
        "import sys; from repm_qgis.runtime.locks import exclusive; from repm_qgis.runtime.progress import Silent\n"
        f"with exclusive('dsmfuse', Silent(), [{str(folder)!r}]): print('held', flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout.readline().strip() == "held"
        found = read_workspace(str(folder))
        assert f"process {other.pid}" in found.writer and "dsmfuse" in found.writer
        with pytest.raises(WorkspaceError, match="in use"):
            remove_products(str(folder), [found.product("dsmfuse")])
    finally:
        other.communicate()
    assert os.path.exists(folder / "dsm.tif") and read_workspace(str(folder)).writer == ""
    assert reading.is_workspace(str(folder)) and not reading.is_workspace(str(tmp_path))
