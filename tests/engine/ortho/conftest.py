"""A town with multispectral images, for all that is made in colour."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.colour_scene import make_colour_scene
from repm_qgis.simulation.scene import SceneSpec
from repm_qgis.stages import run_stage


@pytest.fixture(scope="session")
def town(tmp_path_factory, told):
    """A reconstructed town with multispectral images in another folder: images, XS, true colours, scene."""
    folder = tmp_path_factory.mktemp("colours")
    images, xs, truth = make_colour_scene(SceneSpec.default("urban", 420, 8), str(folder / "s"))
    apart = folder / "multispectral"
    apart.mkdir()
    moved = [str(Path(path).rename(apart / Path(path).name)) for path in xs]
    options = {"images": images, "workspace": str(folder / "w"), "output": str(folder / "dsm.tif"), "resolution": 0.5}
    run_stage("pipeline", {**options, "ortho": str(folder / "grey.tif")}, told())
    return {"images": images, "xs": moved, "truth": truth, "scene": str(folder / "w" / "reconstructed.json")}
