"""Inspect images in a real desktop: what its message offers."""

from __future__ import annotations

import os
import shutil

import pytest

pytestmark = pytest.mark.skipif(
    not (shutil.which("xvfb-run") and shutil.which("qgis")), reason="needs QGIS's desktop and xvfb-run ('make setup')"
)


@pytest.mark.slow
@pytest.mark.long
def test_the_best_images_go_into_the_dialog_by_a_button(sample, desktop_start, tmp_path):
    files = {name: str(tmp_path / file) for name, file in (("FOOTPRINTS", "f.gpkg"), ("REPORT", "images.html"))}
    found = desktop_start("drive_inspect.py", {"parameters": {"IMAGES": sample.images, **files}}, seconds=150)
    assert found["buttons"] == ["DSM of the best pair…", "DSM of the best triplet…"]
    assert sorted(map(os.path.basename, found["images"])) == sorted(map(os.path.basename, sample.images))
    assert len(found["images"]) == 3 and found["footprints are outlines"]
