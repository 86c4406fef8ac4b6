"""Scenes in a mosaic: each is fused first, as its user would do it by hand."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from repm_qgis.contracts.errors import Cancelled, ImageError, OptionError, SceneError
from repm_qgis.geometry.vertical import TAG
from repm_qgis.imagery import raster
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

CELL = 1.0


@pytest.fixture(scope="module")
def scenes(urban_run, tmp_path_factory):
    """A reconstructed scene, and the same as if it had ground control points."""
    free = str(urban_run.workspace / "reconstructed.json")
    scene = Scene.load(free)
    registered = str(tmp_path_factory.mktemp("registered") / "registered.json")
    replace(scene, pointing=replace(scene.pointing, height_uncertainty_m=None)).save(registered)
    return free, registered


@pytest.fixture(scope="module")
def fused(scenes, tmp_path_factory, told):
    """DSM and confidence of each scene, fused by hand; and the first DSM 2.5 m higher, as one of another program."""
    folder, found = tmp_path_factory.mktemp("fused"), []
    for number, scene in enumerate(scenes):
        files = {name: str(folder / f"{name}_{number}.tif") for name in ("output", "confidence")}
        run_stage("dsmfuse", {"scene": scene, "resolution": CELL, "workers": 1, **files}, told())
        found.append((files["output"], files["confidence"]))
    with raster.opened(found[0][0]) as dataset:
        heights, place, crs = raster.read(dataset), dataset.GetGeoTransform(), dataset.GetProjection()
        tags = {TAG: dataset.GetMetadataItem(TAG)}
    higher = raster.write(str(folder / "higher.tif"), [heights + 2.5], place, crs, metadata=tags, unit="m")
    return found, higher


def run(told, folder, said=None, **options):
    return run_stage("mosaic", {"output": str(folder / "m.tif"), "workers": 1, **options}, said or told())


@pytest.mark.long
def test_scenes_give_the_bytes_of_dsms_that_were_fused_by_hand(scenes, fused, tmp_path, told):
    (first, second), higher = fused
    said = told()
    made = run(told, tmp_path, said, dsms=[higher], scenes=scenes, report=str(tmp_path / "report.html"))
    data = Path(made.output).read_bytes()
    by_hand = {"dsms": [higher, first[0], second[0]], "confidences": ["", first[1], second[1]]}
    assert data == Path(run(told, tmp_path, **by_hand).output).read_bytes()
    # The second DSM says itself that ground control points have placed it, so it is fixed too.
    assert [each.dsm for each in made.offsets] == [higher, *scenes]
    assert [each.added for each in made.offsets] == pytest.approx([-2.5, 0, 0], abs=0.01)
    words = f"'{scenes[1]}': its heights are fixed (ground control points), 2 overlaps."
    assert words in said.notes and not any("mean of all offsets" in text for text in said.notes)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(scene in page for scene in scenes) and "ground control points" in page
    assert "Moved in height" in page and "&#39;higher.tif&#39; by -2.50 m" in page
    assert {path.name for path in tmp_path.iterdir()} == {"m.tif", "m.qml", "report.html"}
    assert not list(Path(scenes[1]).parent.glob("*fusion*"))


@pytest.mark.long
def test_scenes_alone_have_the_cells_of_the_first_and_may_be_fixed_by_name(scenes, tmp_path, told):
    said = told()
    made = run(told, tmp_path, said, scenes=scenes, resolution=2.0, fixed=[scenes[0]])
    with raster.opened(made.output) as dataset:
        assert dataset.GetGeoTransform()[1] == 2.0
        assert dataset.GetSpatialRef().GetAuthorityCode(None) == Scene.load(scenes[0]).crs.split(":")[1]
    assert any(f"'{scenes[0]}': its heights are fixed (named in FIXED)" in text for text in said.notes)
    assert any("fixed (ground control points)" in text for text in said.notes)


@pytest.mark.long
def test_a_stopped_run_keeps_the_scenes_that_are_fused(scenes, tmp_path, told):
    class Stop(told):
        def info(self, text):
            super().info(text)
            if text.startswith("Mosaic of"):
                raise Cancelled

    with pytest.raises(Cancelled):
        run(told, tmp_path, Stop(), scenes=scenes, resolution=2.0)
    said = told()
    data = Path(run(told, tmp_path, said, scenes=scenes, resolution=2.0).output).read_bytes()
    assert sum(text.startswith("Reused the DSM of") for text in said.notes) == 2
    assert data == Path(run(told, tmp_path, scenes=scenes, resolution=2.0).output).read_bytes()


def test_what_is_wrong_with_scenes_is_said_before_any_is_fused(scenes, fused, urban_run, tmp_path, told):
    higher = fused[1]
    with raster.opened(higher) as dataset:
        heights, place, crs = raster.read(dataset), dataset.GetGeoTransform(), dataset.GetProjection()
    geoid = raster.write(str(tmp_path / "geoid.tif"), [heights], place, crs, metadata={TAG: "EGM96 height"}, unit="m")
    out = tmp_path / "out"
    out.mkdir()
    for options, kind, words in (
        ({"scenes": scenes[:1]}, OptionError, "must name at least two DSMs, or as many together with SCENES"),
        ({"scenes": [scenes[0], scenes[0]]}, OptionError, f"SCENES is '{re.escape(scenes[0])}': it is named twice"),
        ({"scenes": [scenes[0], "gone.json"]}, SceneError, "gone.json"),
        ({"scenes": [scenes[0], str(urban_run.workspace / "scene.json")]}, SceneError, "has no height maps"),
        ({"dsms": [geoid], "scenes": scenes[:1]}, ImageError, "above 'EGM96 height', .*: convert all DSMs to one"),
        ({"scenes": scenes, "output": scenes[1]}, OptionError, "is also a file of the input SCENES"),
    ):
        said = told()
        with pytest.raises(kind, match=words):
            run(told, out, said, **options)
        assert not said.notes and not list(out.iterdir()), words
