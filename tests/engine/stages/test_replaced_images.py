"""An image that takes the name of another one: no stage works with pixels that the scene was not made from."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError, SceneError
from repm_qgis.imagery.raster import content_of
from repm_qgis.ortho import grey_ortho
from repm_qgis.scene import Scene
from repm_qgis.stages import dsmfuse, exportcameras, fusing, reconstruct, run_stage

WORDS = "was made from other pixels than '.*img_02.tif' has now: restore the image, or run 'Fit"


@pytest.fixture(scope="module")
def project(hamlet, tmp_path_factory, told):
    """A folder with a pair of images, their scene, and the scene with heights; it was moved, so that copies of it have
    images of their own."""
    folder = tmp_path_factory.mktemp("made") / "project"
    folder.mkdir()
    images = [shutil.copy(path, folder) for path in hamlet.images[:2]]
    made = run_stage("epmfit", {"images": images, "workspace": str(folder / "w")}, told())
    done = {"scene": made.scene, "output_scene": str(folder / "w" / "done.json"), "workers": 1}
    run_stage("reconstruct", done, told())
    return shutil.move(folder, tmp_path_factory.mktemp("moved")), [Path(image).name for image in images]


@pytest.fixture
def fitted(project, tmp_path):
    """A copy of the pair and its scene, as options of the stages that follow."""
    folder, names = project
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    scene, after = (str(tmp_path / "w" / name) for name in ("scene.json", "reconstructed.json"))
    return [str(tmp_path / name) for name in names], {"scene": scene, "output_scene": after, "workers": 1}


@pytest.fixture
def fusion(fitted, tmp_path):
    """The images and a fusion of their heights."""
    scene = str(tmp_path / "w" / "done.json")
    return fitted[0], {"scene": scene, "output": str(tmp_path / "dsm.tif"), "workers": 1}


def replace_image(path):
    """Other pixels in a file of the same name, size and time."""
    before = os.stat(path)
    dataset = gdal.Open(path, gdal.GA_Update)
    dataset.GetRasterBand(1).WriteArray(dataset.ReadAsArray()[::-1])
    dataset = None
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_between_two_stages(fitted, told):
    images, options = fitted
    replace_image(images[1])
    with pytest.raises(SceneError, match=WORDS):
        run_stage("reconstruct", options, told())
    assert not Path(options["output_scene"]).exists()


def test_amid_a_stage(fitted, told, monkeypatch):
    """The last step of the stage finds other pixels than the first one: nothing is kept as its result."""
    images, options = fitted
    last = reconstruct.with_agreeing_maps
    monkeypatch.setattr(reconstruct, "with_agreeing_maps", lambda *given: replace_image(images[1]) or last(*given))
    with pytest.raises(SceneError, match=WORDS):
        run_stage("reconstruct", options, told())
    assert not Path(options["output_scene"]).exists()


def test_amid_the_fusion(fusion, tmp_path, told, monkeypatch):
    """A DSM whose brightness is of other pixels does not take its name."""
    images, options = fusion
    last = fusing._chosen
    monkeypatch.setattr(fusing, "_chosen", lambda *given: (last(*given), replace_image(images[1]))[0])
    with pytest.raises(SceneError, match=WORDS):
        run_stage("dsmfuse", options, told())
    assert not (tmp_path / "dsm.tif").exists()


def test_the_orthophoto_is_of_the_same_pixels(fusion, tmp_path, told):
    images, options = fusion
    replace_image(images[1])
    with pytest.raises(SceneError, match=WORDS):
        run_stage("dsmfuse", {**options, "ortho": str(tmp_path / "ortho.tif")}, told())
    assert not (tmp_path / "ortho.tif").exists()


@pytest.mark.long
def test_amid_the_orthophoto(fusion, tmp_path, told, monkeypatch):
    """One of other pixels than the DSM's does not take its name, and the products appear together."""
    images, options = fusion
    last = grey_ortho.run_tasks
    monkeypatch.setattr(grey_ortho, "run_tasks", lambda *given: (last(*given), replace_image(images[1]))[0])
    with pytest.raises(SceneError, match=WORDS):
        run_stage("dsmfuse", {**options, "ortho": str(tmp_path / "ortho.tif")}, told())
    assert not (tmp_path / "dsm.tif").exists() and not (tmp_path / "ortho.tif").exists()


def test_amid_the_export(fitted, tmp_path, told, monkeypatch):
    images, options = fitted
    refined = run_stage("refine", {**options, "output_scene": str(tmp_path / "w" / "refined.json")}, told())
    last, done = exportcameras.write_image, []

    def written(*given):
        last(*given)
        if not done:
            done.append(replace_image(images[1]))

    monkeypatch.setattr(exportcameras, "write_image", written)
    wanted = {"scene": refined.output_scene, "folder": str(tmp_path / "cameras"), "format": "mvsnet"}
    with pytest.raises(SceneError, match=WORDS):
        run_stage("exportcameras", wanted, told())
    assert not list((tmp_path / "cameras").rglob("*.tif"))


def test_an_image_that_is_read_for_its_colours(fitted, hamlet):
    """It is none of the scene's, which knows nothing of it: it is compared with what it was at the beginning."""
    images, options = fitted
    scene = Scene.load(options["scene"])
    require = dsmfuse._same_images(scene, [*images, colours := f"{images[0]}.colours.tif"])
    with pytest.raises(ImageError, match="colours.tif' was replaced while its colours were read"):
        shutil.copy(hamlet.images[2], colours)
        require()
    shutil.copy(hamlet.images[2], colours)
    require = dsmfuse._same_images(scene, [*images, colours])
    require()
    replace_image(colours)
    with pytest.raises(ImageError, match="colours.tif' was replaced"):
        require()


def test_what_other_programs_add_to_an_image_replaces_nothing(fitted, tmp_path):
    images, options = fitted
    dataset = gdal.Open(images[0])
    dataset.BuildOverviews("average", [2])  # external ones: it is open for reading
    dataset.GetRasterBand(1).ComputeStatistics(False)
    dataset = None
    assert Path(images[0] + ".ovr").exists() and Path(images[0] + ".aux.xml").exists()
    os.utime(images[0])
    Scene.load(options["scene"]).require_images()
    copied = shutil.copy(images[0], str(tmp_path / "elsewhere.tif"))
    assert content_of(copied) == content_of(images[0]) != content_of(images[1])


def test_a_vrt_has_the_content_of_its_sources(fitted, tmp_path):
    images, _ = fitted
    path = str(tmp_path / "view.vrt")
    gdal.GetDriverByName("VRT").CreateCopy(path, gdal.Open(images[1])).FlushCache()
    before = content_of(path)
    replace_image(images[1])
    assert content_of(path) != before


def test_an_rpc_that_was_changed_in_the_scene(fitted, told):
    _, options = fitted
    document = json.loads(Path(options["scene"]).read_text(encoding="utf-8"))
    document["views"][1]["rpc"]["row_off"] += 100.0
    Path(options["scene"]).write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(SceneError, match="has an RPC that is not the one which was read from '.*img_02.tif'"):
        run_stage("reconstruct", options, told())
    assert not Path(options["output_scene"]).exists()
