"""A run that would write over what it reads, or two products to one place, is refused before it begins."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import OptionError, WorkspaceError
from repm_qgis.runtime.locks import exclusive
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage


@pytest.fixture
def project(urban, tmp_path):
    """Copies of two images with RPC files beside them, a mask and control points."""
    images = [shutil.copy(path, tmp_path) for path in urban.images[:2]]
    shutil.copy(images[0], tmp_path / "mask.tif")
    (tmp_path / "img_01_RPC.TXT").write_text("LINE_OFF: 1\n")
    (tmp_path / "gcps.csv").write_text("id,lon,lat,height\n")
    (os.link if os.name == "nt" else os.symlink)(images[0], tmp_path / "link.tif")  # symbolic ones need rights there
    os.link(images[0], tmp_path / "second_name.tif")
    return tmp_path


def state(folder):
    return {path.name: path.read_bytes() for path in Path(folder).iterdir() if path.is_file()}


def job(place, **options):
    images = [str(place / "img_01.tif"), str(place / "img_02.tif")]
    return {"images": images, "workspace": str(place / "w"), "output": str(place / "dsm.tif"), **options}


@pytest.mark.parametrize(
    "options, words",
    (
        ({"output": "img_01.tif"}, "OUTPUT is '.*img_01.tif': it is also a file of the input IMAGES"),
        ({"output": "link.tif"}, "OUTPUT is '.*link.tif': it is also a file of the input IMAGES"),
        ({"output": "second_name.tif"}, "OUTPUT is '.*second_name.tif': it is also a file of the input IMAGES"),
        ({"output": "img_01_RPC.TXT"}, "it is also a file of the input IMAGES"),
        ({"ortho": "mask.tif", "masks": ["mask.tif", ""]}, "ORTHO is .* also a file of the input MASKS"),
        ({"tie_points": "gcps.csv", "gcps": "gcps.csv"}, "TIE_POINTS is .* also a file of the input GCPS"),
        ({"report": "dem.tif", "dem": "dem.tif"}, "REPORT is .* also a file of the input DEM"),
        ({"confidence": "dsm.tif"}, "CONFIDENCE is '.*dsm.tif': it is also OUTPUT: choose two names"),
        ({"output": "w/scene.json"}, "OUTPUT is .* also a file of the input SCENE"),
        ({"output": "w/reconstructed.json"}, "OUTPUT is .* it is also OUTPUT_SCENE"),
        ({"ept": "ept", "output": "ept/dsm.tif"}, "OUTPUT is .* lies in EPT, a folder that is replaced as a whole"),
    ),
)
def test_the_pipeline_refuses_and_touches_nothing(project, told, options, words):
    before = state(project)

    def whole(value):
        return [whole(each) for each in value] if isinstance(value, list) else value and str(project / value)

    with pytest.raises(OptionError, match=words):
        run_stage("pipeline", job(project, **{name: whole(value) for name, value in options.items()}), told())
    assert state(project) == before and not (project / "w").exists()


def test_names_that_differ_in_case_alone_are_one_where_the_disk_says_so(project, told, monkeypatch):
    """As on Windows and macOS: a link gives the folder its name in the other case."""
    options = {"ortho": str(project / "DSM.tif")}
    monkeypatch.setattr("repm_qgis.stages.pipeline.run", lambda options, progress: {})
    if os.name != "nt":
        run_stage("pipeline", job(project, **options), told())
        os.symlink(project, project.parent / project.name.swapcase())
    with pytest.raises(OptionError, match="ORTHO is '.*DSM.tif': it is also OUTPUT: choose two names"):
        run_stage("pipeline", job(project, **options), told())


def test_a_product_that_another_program_has_open_is_refused_before_the_work(project, told, monkeypatch):
    """As on Windows, where QGIS has the last run's DSM open."""
    (project / "dsm.tif").write_bytes(b"the last one")
    in_use = PermissionError(13, "Access is denied")
    in_use.winerror = 5

    def refused(source, target):
        raise in_use

    monkeypatch.setattr("repm_qgis.runtime.workspace.os.replace", refused)
    monkeypatch.setattr("repm_qgis.runtime.workspace._PATIENCE_S", 0)
    with pytest.raises(WorkspaceError, match="dsm.tif': another program has it open, QGIS perhaps as a layer: remove"):
        run_stage("pipeline", job(project), told())
    assert (project / "dsm.tif").read_bytes() == b"the last one" and not (project / "w").exists()


def test_what_a_scene_names_is_an_input_too(urban_run, told, tmp_path):
    scene = Scene.load(urban_run.result.scene)
    for file in (scene.views[1].image, scene.tiles[0].heights[0].file, scene.tie_points, str(scene.path)):
        before = Path(file).read_bytes()
        with pytest.raises(OptionError, match="OUTPUT is .* is also a file of the input SCENE"):
            run_stage("dsmfuse", {"scene": str(scene.path), "output": file}, told())
        assert Path(file).read_bytes() == before


def test_comparisons_and_checks(project, told):
    shutil.copy(project / "mask.tif", project / "truth.tif")
    before = state(project)
    compare = {"dsm": str(project / "mask.tif"), "reference": str(project / "truth.tif")}
    with pytest.raises(OptionError, match="ERROR is .* also a file of the input REFERENCE"):
        run_stage("comparedsm", {**compare, "error": str(project / "truth.tif")}, told())
    check = {"gcps": str(project / "gcps.csv"), "dsm": str(project / "mask.tif")}
    with pytest.raises(OptionError, match="OUTPUT is .* also a file of the input GCPS"):
        run_stage("checkgcps", {**check, "output": str(project / "gcps.csv")}, told())
    assert state(project) == before


def test_the_pipeline_locks_its_workspace_and_its_output(project, told, monkeypatch):
    held = []

    def noted(stage, progress, folders=(), files=()):
        held.extend([*folders, *files])
        return exclusive(stage, progress, folders, files)

    monkeypatch.setattr("repm_qgis.stages.exclusive", noted)
    monkeypatch.setattr("repm_qgis.stages.pipeline.run", lambda options, progress: {})
    run_stage("pipeline", job(project), told())
    assert set(held) == {str(project / "w"), str(project / "dsm.tif")}
