"""What our dialogs add to Processing's: lists, the last scene, presets, and COLMAP's options where they matter."""

from __future__ import annotations

import shutil

import pytest

from repm_qgis.options import PRESETS, PipelineOptions

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


def test_dialogs_offer_what_is_known_and_hide_what_does_not_matter(desktop_start, sample, tmp_path):
    from repm_qgis.progress import Silent
    from repm_qgis.stages import run_stage

    fitted = run_stage("epmfit", {"images": sample["images"], "workspace": str(tmp_path / "work")}, Silent())
    names = sorted({name for preset in PRESETS.values() for name in preset})
    plan = {"presets": [*PRESETS, "none"], "names": [name.upper() for name in names]}
    missing = [str(tmp_path / name) for name in ("a.rpb", "b.xml")]
    plan["lists"] = {"RPCS": missing, "SCENES": [fitted["scene"]], "FIXED": [fitted["scene"], sample["truth"]]}
    settings = f"[repm]\nfirst_steps_shown=true\nlast_scenes={fitted['scene']}\n"
    found = desktop_start("drive_dialog.py", plan, seconds=60, settings=settings)
    assert found["scene"] == fitted["scene"]
    colmap = ["GEOMETRIC", "COLMAP_FUSION", "WINDOW_RADIUS", "GPU_MEMORY"]
    assert (found["closed"], found["auto"], found["colmap"], found["sgm"]) == ([], [], colmap, [])
    assert found["given"] == 7
    assert found["line"] and found["datums"][:2] == ["WGS 84 ellipsoid", "EGM2008  (EGM2008 height)"]
    assert found["datum"] == "EGM2008"
    for preset, values in found["presets"].items():
        for name, value in zip(names, values.values()):
            assert value == PRESETS[preset].get(name, PipelineOptions.option(name).default), (preset, name)
    assert found["changed"] == ["polynomial", "none"]  # what the user changed is not taken back
    assert found["history"] == ["homography", "all"]  # what a run was given goes before its preset
    assert (found["views"], found["view"]) == (["img_01", "img_02", "img_03"], "img_02")
    assert found["no views"] == ["Choose a scene first"]
    # What QGIS cannot open as a layer stays in its list, as where a run is taken up from the history.
    assert found["lists"] == plan["lists"]
    assert found["surfaces"] == ["surface"]  # a DSM is named once, without its hillshade
    assert not found["not refined"]  # what this stage could not begin with is not taken up
    assert len(found["tiles"]) >= 1 and found["tiles"] != found["no views"]
