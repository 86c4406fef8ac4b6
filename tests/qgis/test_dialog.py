"""What our dialogs add to Processing's: lists, the last scene, presets, and no more than matters."""

from __future__ import annotations

import os
import pathlib
import shutil

import pytest

from repm_qgis.contracts.options import PRESETS, PipelineOptions
from repm_qgis.names import images_name

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.mark.long
def test_dialogs_offer_what_is_known_and_hide_what_does_not_matter(desktop_start, sample, tmp_path):
    from repm_qgis.runtime.progress import Silent
    from repm_qgis.stages import run_stage

    fitted = run_stage("epmfit", {"images": sample.images, "workspace": str(tmp_path / "work")}, Silent())
    names = sorted({name for preset in PRESETS.values() for name in preset})
    plan = {"presets": [*PRESETS, "none"], "names": [name.upper() for name in names]}
    plan["dialogs"] = ["pipeline", "mosaic", "reconstruct", "dsmfuse", "epmfit", "register", "change", "comparedsm"]
    plan.update(images=sample.images, own=str(tmp_path / "own"), dsm=sample.truth)
    missing = [str(tmp_path / name) for name in ("a.rpb", "b.xml")]
    plan["lists"] = {"RPCS": missing, "SCENES": [fitted.scene], "FIXED": [fitted.scene, sample.truth]}
    settings = f"[repm]\nfirst_steps_shown=true\nlast_scenes={fitted.scene}\n"
    found = desktop_start("drive_dialog.py", plan, seconds=60, settings=settings)
    assert found["scene"] == fitted.scene
    # Nothing goes to a temporary folder: what has no name or no folder is kept in the workspace, or beside the DSM.
    places, folder = found["places"], pathlib.Path(sample.images[0]).parent
    workspace = str(folder / "repm" / images_name(sample.images))
    assert places["workspaces"] == [workspace, workspace, plan["own"]]
    assert (places["typed"], places["loaded"]) == (os.path.join(workspace, "trust.tif"), True)
    assert places["hint"] == f"[Save in {pathlib.Path(workspace).name}]"
    beside = [os.path.join(os.path.dirname(sample.truth), name) for name in ("truth_dtm.tif", "truth_dtm_heights.tif")]
    assert places["beside"][:2] == beside
    assert places["beside"][2].startswith(os.path.join(os.path.dirname(sample.truth), "trees"))
    many = folder.parent / "repm" / folder.name
    assert places["many"] == [str(many), f"{many}/scenes.gpkg", f"{many}/scenes_report.html", ["confidence"]]
    assert places["terrain"] == f"[Save in {pathlib.Path(sample.truth).parent.name}]"
    # COLMAP's options are on the options page, and come to the dialog where a run's value is another one.
    assert (found["usual"], found["differs"], found["given"]) == ([], ["WINDOW_RADIUS"], 7)
    assert found["set"] == [9, []]
    assert all(max(widths) == 0 for widths in found["narrow"].values()), found["narrow"]  # all buttons are in sight
    assert found["basic"] == [
        *("IMAGES", "EXTENT", "GCPS", "REFERENCE", "RESOLUTION", "VERTICAL_DATUM", "PRESET", "QUALITY"),
    ]
    assert [text[3:-4] for text in found["headings"]][:2] == ["Images", "Area and heights"]
    assert found["words"] == {"none": "None", "occlusions": "Occlusions", "all": "All holes (all)"}
    assert found["zero"] == found["empty"] == ["automatic"]
    assert found["fast"] == {"PRESET": "First look (fast)", "QUALITY": "Fewest pairs (fast)"}
    assert found["references"][:2] == ["Automatic: what each file says, or else what fits", "WGS 84 ellipsoid"]
    assert found["reference datum"] == "ellipsoid"
    assert found["line"] and found["datums"][:2] == ["WGS 84 ellipsoid", "EGM2008  (EGM2008 height)"]
    assert found["datum"] == "EGM2008"
    for preset, values in found["presets"].items():
        for name, value in zip(names, values.values()):
            assert value == PRESETS[preset].get(name, PipelineOptions.option(name).default), (preset, name)
    assert found["changed"] == ["polynomial", "none"]  # what the user changed is not taken back
    assert "still shown" in found["log of a failure"]
    assert not [word for word in ("HTML output", "finished") if word in found["log of a failure"]]
    assert found["history"] == ["homography", "all"]  # what a run was given goes before its preset
    assert (found["views"], found["view"]) == (["img_01", "img_02", "img_03"], "img_02")
    assert found["no views"] == ["Choose a scene first"]
    # What QGIS cannot open as a layer stays in its list, as where a run is taken up from the history.
    assert found["lists"] == plan["lists"]
    assert not found["not refined"]  # what this stage could not begin with is not taken up
    assert len(found["tiles"]) >= 1 and found["tiles"] != found["no views"]
    assert found["kept"] == [True, False]


@pytest.mark.slow
def test_german_dialogs_fit_too(desktop_start, tmp_path):
    """Labels are longer: at QGIS's own size every "..." button is in sight, with the advanced part open."""
    names = ["pipeline", "mosaic", "reconstruct", "dsmfuse", "epmfit", "register", "change", "comparedsm", "dtm"]
    names.append("buildings")
    found = desktop_start("drive_narrow.py", {"dialogs": names}, seconds=60, locale="de")
    assert all(max(widths) == 0 for widths in found["narrow"].values()), found["narrow"]
    assert found["words"]["fast"] == "Wenigste Paare (fast)" and found["values"] == ["fast", "default", "best"]
    assert found["model"][0] == "IMAGES"
