"""The preview of a DSM in QGIS: by its button in the desktop (Xvfb), and what is taken over from it."""

from __future__ import annotations

import json
import os
import pathlib
import shutil

import pytest
from qgis.core import QgsApplication

from repm_qgis.contracts.options import PRESETS, PREVIEW


def test_the_next_run_has_the_altitudes_and_images_of_the_preview_and_no_preset(provider):
    from repm.desktop.preview import of_preview, taken_over

    given = {"IMAGES": ["a.tif", "b.tif", "c.tif"], "EXTENT": "0,1,0,1", "CLOUD": "c.laz", "WORKSPACE": "w"}
    results = {"MATCHED_IMAGES": ["a.tif", "b.tif"], "LOWEST": 12.34, "HIGHEST": 99.0}
    shown = of_preview(given)
    assert shown["PRESET"] == PREVIEW and shown["IMAGES"] == given["IMAGES"] and shown["WORKSPACE"] == "w"
    assert "EXTENT" not in shown and "CLOUD" not in shown  # all the ground, and the surface alone
    kept = taken_over(given, results)
    assert kept["IMAGES"] == ["a.tif", "b.tif"] and (kept["ALTITUDE_MIN"], kept["ALTITUDE_MAX"]) == (12.3, 99.0)
    assert kept["CLOUD"] == "c.laz" and kept["EXTENT"] == given["EXTENT"]
    # RPC files are in the order of the images; a range that the preview does not show is not made up.
    assert taken_over({**given, "RPCS": ["a", "b", "c"]}, results)["IMAGES"] == given["IMAGES"]
    assert "ALTITUDE_MIN" not in taken_over(given, {"MATCHED_IMAGES": ["a.tif"]})
    # The preset that was chosen in the list has filled its values in.
    listed = {**given, "PRESET": PREVIEW, **{name.upper(): value for name, value in PRESETS[PREVIEW].items()}}
    assert set(taken_over(listed, results)) == {*given, "ALTITUDE_MIN", "ALTITUDE_MAX"}


@pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)
@pytest.mark.long
def test_a_preview_leads_to_the_area_and_the_dsm(desktop_start, town, tmp_path):
    from repm_qgis.imagery.raster import opened, read

    folder = tmp_path / "old town"
    plan = {"pipeline": {"IMAGES": town.images, "WORKSPACE": str(folder)}, "draw": "Draw the area on it…"}
    found = desktop_start("drive_preview.py", plan, seconds=120)
    assert found["button"] == ["Preview", True] and not found["running"]
    enabled, own = found["after"]
    assert enabled and own["PRESET"] == "none" and own["ALTITUDE_MIN"] is None  # the dialog itself stays as it was
    assert found["messages"] == [[plan["draw"], "Make the DSM…"]] * 2 and found["closed"] and found["hidden"]
    names = [name for name, _, _ in found["layers"]]
    assert [name.split(" preview, old town")[0] for name in names] == [
        *("Footprints", "Overlaps of pairs", "Hillshade of DSM", "DSM"),
    ]
    files = [pathlib.Path(source.split("|")[0]) for _, source, _ in found["layers"]]
    assert {file.parent for file in files} == {folder / "preview"}
    back, drawn = found["drawn"]
    assert back and drawn["IMAGES"] == town.images and drawn["WORKSPACE"] == str(folder)
    assert (drawn["PRESET"], drawn["QUALITY"]) == ("none", "default")
    with opened(town.truth) as truth:
        heights = read(truth)
    assert drawn["ALTITUDE_MIN"] < heights.min() and drawn["ALTITUDE_MAX"] > heights.max()
    area, crs = drawn["EXTENT"].split(" ")
    assert [float(end) for end in area.split(",")] == pytest.approx(found["area"], abs=1e-3)
    assert crs.startswith("[EPSG:")
    assert not os.path.exists(folder / "scene.json")  # the DSM's run begins in a workspace of its own


@pytest.mark.long
def test_a_preview_without_the_desktop_keeps_what_it_makes_in_its_own_folder(headless, town, tmp_path):
    images = [f"IMAGES={image}" for image in town.images[:2]]
    wanted = [f"WORKSPACE={tmp_path / 'w'}", "PRESET=preview", "OUTPUT=TEMPORARY_OUTPUT"]
    done = headless("--json", "run", "repm:pipeline", "--", *images, *wanted)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)["results"]
    assert pathlib.Path(found["OUTPUT"]) == tmp_path / "w" / "preview" / "dsm.tif"
    assert found["LOWEST"] < found["HIGHEST"] and len(found["MATCHED_IMAGES"]) == 2
    assert os.listdir(tmp_path / "w") == ["preview"] and os.path.exists(found["OVERLAPS"])


@pytest.mark.long
def test_the_scene_of_a_preview_is_not_taken_up_by_the_next_stage(provider, context, feedback, town, tmp_path):
    from repm.processing_provider.last_scene import last_scene

    before = last_scene("dsmfuse")
    algorithm = QgsApplication.processingRegistry().algorithmById("repm:pipeline")
    given = {"IMAGES": town.images[:2], "WORKSPACE": str(tmp_path / "w"), "PRESET": PREVIEW}
    results, fine = algorithm.run({**given, "OUTPUT": str(tmp_path / "dsm.tif")}, context, feedback)
    assert fine, feedback.heard["error"]
    assert last_scene("dsmfuse") == before != results["SCENE"]
