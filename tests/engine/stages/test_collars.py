"""Images with black frames that no nodata value marks: the cameras' stage leaves them out, and all stages after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage


@pytest.fixture
def framed(mountains, tmp_path):
    """The mountains' images with black upper parts and a stripe, which their files do not mark."""
    paths = []
    for image in mountains.images:
        path = str(tmp_path / Path(image).name)
        source = gdal.Open(image)
        dataset = gdal.GetDriverByName("GTiff").CreateCopy(path, source)
        dataset.SetMetadata(source.GetMetadata("RPC"), "RPC")
        values = dataset.GetRasterBand(1).ReadAsArray()
        values[:60] = 0
        values[200:230] = 0
        dataset.GetRasterBand(1).WriteArray(values)
        source = dataset = None
        paths.append(path)
    return paths


def fit(images, folder, said):
    return Scene.load(run_stage("epmfit", {"images": images, "workspace": str(folder)}, said)["scene"])


def test_black_frames_are_masked_and_change_nothing_else(mountains, framed, tmp_path, told):
    said = told()
    scene, plain = fit(framed, tmp_path / "ws", said), fit(mountains.images, tmp_path / "plain", told())
    assert all(Path(view.mask).exists() for view in scene.views) and not any(view.mask for view in plain.views)
    assert sum("are black from its ends on" in text for text in said.notes) == 3
    assert np.abs(np.subtract(scene.altitudes, plain.altitudes)).max() < 60.0
    again = told()
    fit(framed, tmp_path / "ws", again)
    assert any(text.startswith("Reused the cameras") for text in again.notes)
    Path(scene.views[0].mask).unlink()
    assert Path(fit(framed, tmp_path / "ws", told()).views[0].mask).exists()
