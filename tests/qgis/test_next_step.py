"""The path from the first DSM to one in the right place, in the desktop itself (Xvfb): each step leads to the next."""

from __future__ import annotations

import os
import shutil

import pytest

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.mark.slow
def test_run_compare_register_run_and_compare_again(desktop_start, town, tmp_path):
    from repm_qgis.evaluation.scoring import score_files
    from repm_qgis.scene import Scene

    folder = tmp_path / "old town"
    plan = {
        "pipeline": {"IMAGES": town["images"], "WORKSPACE": str(folder), "RESOLUTION": 1.0},
        "reference": town["truth"],
        "compare": "Compare with a reference…",
        "register": "Register to this reference…",
        "before": "Before",
        "after": "After",
        "again": "Make the DSM again…",
        "edit": "Edit the DSM…",
    }
    found = desktop_start("drive_next_step.py", plan, seconds=300)
    first, compared, registered, fused = found["messages"]
    assert first[1] == first[2] == [plan["compare"], "Register to a reference…"] and found["closed"]
    assert compared[1] == compared[2] == [plan["register"]]
    assert registered[1] == ["Before", "After", plan["again"]] and registered[2] == [plan["again"]]
    assert (
        "was moved by" in registered[0]
        and "registered scene" in fused[0]
        and fused[1] == [plan["compare"], plan["edit"]]
    )
    filled = found["filled"]
    assert filled["register"]["SCENE"] == str(folder / "reconstructed.json")
    assert filled["register"]["REFERENCE"] == [town["truth"]]
    assert filled["register"]["OUTPUT_SCENE"] == str(folder / "registered.json")
    assert filled["dsmfuse"]["SCENE"] == str(folder / "registered.json") and filled["dsmfuse"]["RESOLUTION"] == 1.0
    assert filled["dsmfuse"]["OUTPUT"] == str(folder / "dsm_registered.tif")
    assert (filled["comparedsm"]["DSM"], filled["comparedsm"]["REFERENCE"]) == (
        str(folder / "dsm_registered.tif"),
        town["truth"],
    )
    assert [band for _, band in found["views"]] == [1, 2] and found["views"][0][0] == "Before the registration"
    assert (
        found["shown"]
        and found["last"] == [plan["edit"]]
        and found["edited"] == found["filled"]["comparedsm"]["DSM"]
        and found["after the plugin"] == 0
    )
    assert not [name for name in found["visible"] if name.startswith("Height error")]  # it would hide the differences
    assert Scene.load(str(folder / "registered.json")).registration is not None
    before, after = (
        score_files(str(folder / name), town["truth"], "none") for name in ("dsm.tif", "dsm_registered.tif")
    )
    assert abs(after.metrics.bias) < abs(before.metrics.bias)
    assert os.path.exists(folder / "dsm_registered.qml")


@pytest.mark.skipif(
    not os.environ.get("REPM_KEEP_PICTURES"), reason="records a minute of pictures: set REPM_KEEP_PICTURES=FOLDER"
)
def test_from_images_to_a_registered_compared_and_edited_dsm_in_fifteen_clicks(desktop_start, tmp_path):
    """With the sample images of the first steps; the recording in docs/pictures comes from here."""
    plan = {
        "truth": "True DSM",
        "compare": "Compare with a reference…",
        "register": "Register to this reference…",
        "again": "Make the DSM again…",
        "edit": "Edit the DSM…",
    }
    found = desktop_start("drive_whole_way.py", plan, seconds=400)
    assert found["clicks"] == [
        *("Make the DSM…", "Run", plan["compare"], "the list Reference", "True DSM", "Run"),
        *(plan["register"], "Run", plan["again"], "Run", plan["compare"], "Run"),
        *(plan["edit"], "Brush", "a stroke on the map"),
    ]
    assert "was moved by" in found["moved"] and os.path.basename(found["dsm"]) == "dsm_registered.tif"
    assert found["edits"] == 1 and "dsm_registered_edited.tif: 1" in found["said"]
