"""The menu Plugins > REPM and the panel of the first start, in the desktop itself (Xvfb)."""

from __future__ import annotations

import shutil

import pytest

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.mark.slow
def test_three_steps_lead_a_new_user_to_a_dsm_and_the_tutorial(desktop_start):
    found = desktop_start("drive_menu.py", {}, settings="")
    assert {"First steps", "Inspect images…", "Make a DSM…", "Tutorial", "Help"} <= set(found["menu"])
    assert found["shown"] and found["kept"] and found["opened"] == ["inspect", "pipeline"]
    assert found["folder"].endswith("sample images")
    assert not found["second step"] and found["second step after the first"]
    assert found["success"]
    assert any(name.startswith("DSM sample town") for name in found["layers"])
    tutorial, guide = found["pages"]
    assert "<title>Tutorial" in tutorial and "<title>User guide" in guide
    assert not found["left"] and not found["menu after"]


@pytest.mark.long
def test_the_panel_comes_once_only_and_a_german_qgis_has_german_windows(desktop_start, sample):
    found = desktop_start("drive_menu.py", {"images": sample.images}, seconds=60, locale="de")
    assert not found["shown"] and {"Erste Schritte", "Passpunkte messen…"} <= set(found["menu"])
    assert found["dock"] == [
        "Passpunkte messen",
        "Punkte laden, oder „Neuer Punkt auf der Karte“ drücken und die Stelle auf einem Orthofoto anklicken.",
        "Bilder",
        ["Nicht sichtbar", "Löschen"],
    ]
