"""Small screens: beside the docked toolbox, nothing of REPM's docks lies below the edge or is cut."""

from __future__ import annotations

import shutil

import pytest

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.mark.parametrize("locale", ["en", "de"])
@pytest.mark.long
def test_docks_fit_small_screens_beside_the_toolbox(desktop_start, sample, locale):
    screens = [[1366, 768], [1280, 720]]
    plan = {"dsm": sample.truth, "screens": screens, "name": f"small_{locale}"}
    plan["message"] = {
        "en": ["Is the DSM in the right place?", "Compare with a reference…", "Register to a reference…"],
        "de": ["Stimmt die Lage des DOM?", "Mit einer Referenz vergleichen…", "Auf eine Referenz einpassen…"],
    }[locale]
    found = desktop_start("drive_small_screen.py", plan, seconds=80, locale=locale)
    # The window is no higher than the screen: a column of docks that need more would make it so.
    for width, height in screens:
        assert {tuple(size) for key, size in found["sizes"].items() if key.endswith(str(width))} == {(width, height)}
    assert all(found["in front"].values()), found["in front"]
    assert {key: texts for key, texts in found["outside"].items() if texts} == {}
    assert {key: texts for key, texts in found["cut"].items() if texts} == {}
    width, height, layers = found["with a message"]
    assert (width, height) == (1280, 720) and layers > 150
