"""The path from the first DSM to one in the right place, in the desktop itself (Xvfb): each step leads to the next."""

from __future__ import annotations

import os
import shutil
from types import SimpleNamespace

import pytest
from qgis.PyQt.QtWidgets import QApplication

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.mark.parametrize("language", ("en", "de"))
def test_messages_are_read_whole_in_a_dialog_of_qgis_own_width(language, provider, request, monkeypatch):
    """Beside their buttons, in 688 px: QGIS gives a text one line, and a scroll bar for the second."""
    from qgis.gui import QgsMessageBar
    from qgis.PyQt.QtWidgets import QTextBrowser, QVBoxLayout, QWidget
    from repm.desktop import next_step

    if language == "de":
        request.getfixturevalue("german")
    window = QWidget()
    bar = QgsMessageBar()
    column = QVBoxLayout(window)
    column.addWidget(bar)
    column.addStretch()
    window.resize(688, 523)
    window.show()
    monkeypatch.setattr(next_step.last_scene, "of_surface", lambda path: path)
    made = {"SCENE": "scene.json", "OUTPUT": "dsm.tif", "OUTPUT_SCENE": "registered.json", "EAST": 123.4}
    cases = [("inspect", {"PAIR": ["a"], "TRIPLET": ["a"]}, False), ("register", made, False)]
    cases += [
        (name, made, registered) for name in ("pipeline", "dsmfuse", "comparedsm") for registered in (False, True)
    ]
    texts = {}
    for algorithm, results, registered in cases:
        steps = next_step.NextSteps()
        steps.edit_dsm = lambda: None
        monkeypatch.setattr(next_step, "is_registered", lambda scene, registered=registered: registered)
        monkeypatch.setattr(next_step, "layer_of", lambda path: SimpleNamespace(id=lambda: "a layer"))
        monkeypatch.setattr(next_step, "bring_out", lambda layer_id: None)
        given = {"SCENE": "scene.json", "DSM": "dsm.tif"}
        text, buttons = steps.after(SimpleNamespace(messageBar=lambda: bar), algorithm, given, results)
        for _ in range(9):  # Qt lays out the message, then the bar, then the window
            QApplication.processEvents()
        browser = bar.currentItem().findChild(QTextBrowser)
        assert browser.toPlainText() == f"REPM: {text}" and buttons
        place, needed = browser.viewport().height(), browser.document().size().height()
        assert place >= needed and not browser.verticalScrollBar().isVisible(), (text, place, needed)
        texts[algorithm, registered] = text
    assert len(set(texts.values())) == 6
    # A reference of the first run registers the scene too.
    assert all(texts["pipeline", registered] == texts["dsmfuse", registered] for registered in (False, True))


@pytest.mark.slow
def test_run_compare_register_run_and_compare_again(desktop_start, town, tmp_path):
    from repm_qgis.evaluation.scoring import score_files
    from repm_qgis.scene import Scene

    folder = tmp_path / "old town"
    plan = {
        "pipeline": {
            "IMAGES": town.images,
            "WORKSPACE": str(folder),
            "RESOLUTION": 1.0,
            "ORTHO": str(folder / "colours.tif"),
        },
        "reference": town.truth,
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
        and fused[0] == "Is the DSM in the right place now?"
        and fused[1] == [plan["compare"], plan["edit"]]
    )
    filled = found["filled"]
    assert filled["register"]["SCENE"] == str(folder / "reconstructed.json")
    assert filled["register"]["REFERENCE"] == [town.truth]
    assert filled["register"]["OUTPUT_SCENE"] == str(folder / "registered.json")
    assert filled["dsmfuse"]["SCENE"] == str(folder / "registered.json") and filled["dsmfuse"]["RESOLUTION"] == 1.0
    assert filled["dsmfuse"]["OUTPUT"] == str(folder / "dsm_registered.tif")
    assert found["crs"][0] == found["crs"][1] == "EPSG:32631"  # of the first run's map
    # All products of the first run are made again, the report too, and the map shows them.
    assert found["in sight"] and found["groups"]["registered, old town"] == [True, True]
    assert found["groups"]["old town"] == [False, False]  # the labels of what is hidden would lie on the new DSM
    ticks = found["ticks"]
    assert ticks["Orthophoto registered, old town"] is False and ticks["Confidence registered, old town"] is False
    assert ticks["DSM registered, old town (WGS 84 ellipsoid)"] is True
    for name in ("dsm_registered.tif", "colours_registered.tif", "confidence_registered.tif"):
        assert os.path.exists(folder / name), os.listdir(folder)
    assert "after the registration" in (folder / "dsm_report_registered.html").read_text(encoding="utf-8")
    assert (filled["comparedsm"]["DSM"], filled["comparedsm"]["REFERENCE"]) == (
        str(folder / "dsm_registered.tif"),
        town.truth,
    )
    assert [band for _, band in found["views"]] == [1, 2] and found["views"][0][0] == "Before the registration"
    assert (
        found["shown"]
        and found["last"] == [plan["edit"]]
        and found["edited"] == found["filled"]["comparedsm"]["DSM"]
        and found["after the plugin"] == 0
    )
    # The second DSM, and what measures it, are told from the first.
    named = dict(found["names"])
    assert named["DSM old town (WGS 84 ellipsoid)"] == "old town"
    for name in ("DSM registered, old town (WGS 84 ellipsoid)", "Height error registered, old town"):
        assert named[name] == "registered, old town", named
    assert not [name for name in found["visible"] if name.startswith("Height error")]  # it would hide the differences
    assert Scene.load(str(folder / "registered.json")).registration is not None
    before, after = (score_files(str(folder / name), town.truth, "none") for name in ("dsm.tif", "dsm_registered.tif"))
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
