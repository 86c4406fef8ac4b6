"""A second run takes up what the first has made, and only that; a stopped run leaves nothing half-made."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import Cancelled, EmptyResultError, SceneError
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]

LEAVE_HALF = """
import os, sys
from repm_qgis.runtime.workspace import temporary_name
open(temporary_name(sys.argv[1]), "w").write("half a file")
os.kill(os.getpid(), 9)
"""
STAGES = ("Reused the cameras", "Reused the refinement", "Reused 4 height maps and the relative pointing")


def heights(path):
    dataset = gdal.Open(path)
    values = dataset.ReadAsArray()
    dataset = None
    return values


def parts(folder):
    return [str(path) for path in Path(folder).rglob("*") if ".part" in path.name]


def maps(workspace):
    """Time of change of each height map."""
    return {
        path.name: path.stat().st_mtime_ns for path in sorted(Path(workspace, "reconstructed_heights").glob("*.tif"))
    }


def reused(said):
    return [any(words in note for note in said.notes) for words in STAGES]


@pytest.fixture(scope="module")
def whole(hamlet, tmp_path_factory, pipeline):
    """A pair's DSM in four tiles, from an undisturbed run."""
    return pipeline(
        hamlet,
        tmp_path_factory.mktemp("whole"),
        images=hamlet.images[:2],
        resolution=0.5,
        tile_size=256,
        confidence=None,
        ortho=None,
        cloud=None,
        ept=None,
        mesh=None,
        workers=1,
    )


@pytest.fixture
def again(whole, tmp_path, told):
    """again(**changes): the first run once more on a copy of its workspace; the result and what was said."""
    workspace = tmp_path / "ws"
    shutil.copytree(whole.workspace, workspace)

    def run(cancel_at=None, **changes):
        said = told(cancel_at)
        options = {**whole.options, "workspace": str(workspace), "output": str(tmp_path / "dsm.tif"), **changes}
        return run_stage("pipeline", options, said), said

    run.workspace, run.output = workspace, str(tmp_path / "dsm.tif")
    return run


@pytest.mark.slow
def test_a_second_run_reuses_everything_and_says_so(again, whole):
    before = maps(again.workspace)
    result, said = again()
    assert reused(said) == [True, True, True]
    assert maps(again.workspace) == before
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))
    for name in ("rmse", "max_error", "n_tie_points", "valid", "cells", "removed"):
        assert getattr(result, name) == getattr(whole.result, name)


def points_of(path):
    source = ogr.Open(path)
    layer = source.GetLayer(0)
    found = [(row.GetGeometryRef().ExportToWkt(), *map(row.GetField, range(row.GetFieldCount()))) for row in layer]
    place = layer.GetSpatialRef().GetAuthorityCode(None), [field.GetName() for field in layer.schema]
    layer = source = None  # noqa: F841
    return place, found


@pytest.mark.slow
def test_where_products_are_copied_to_does_not_matter(again, hamlet, tmp_path):
    """QGIS names other temporary files at every run; those of the first are gone at the second."""
    runs = []
    for number in range(2):
        folder = tmp_path / f"temporary_{number}"
        folder.mkdir()
        gcps = shutil.copy(hamlet.made.gcps, str(folder / "layer.csv"))
        places = {name: str(folder / f"{name}.gpkg") for name in ("tiles", "tie_points")}
        changes = {**places, "report": str(folder / "report.html"), "output": str(folder / "dsm.tif")}
        result, said = again(images=hamlet.images, gcps=gcps, **changes)
        assert {name: getattr(result, name) for name in changes} == changes
        layers = {name: points_of(path) for name, path in places.items()}
        assert all(Path(path).with_suffix(".qml").exists() for path in places.values())
        runs.append((reused(said), layers))
        shutil.rmtree(folder)
    assert runs[0][0] == [False, False, False] and runs[1][0][:2] == [True, True]
    assert any("the relative pointing" in note and note.startswith("Reused") for note in said.notes)
    assert runs[1][1] == runs[0][1] and len(runs[0][1]["tie_points"][1]) == result.n_tie_points > 100
    kept = {"tiles": again.workspace / "tiles.gpkg", "tie_points": again.workspace / "reconstructed_tie_points.gpkg"}
    assert {name: points_of(str(path)) for name, path in kept.items()} == runs[1][1]
    assert (again.workspace / "report.html").exists()
    gcps = tmp_path / "gcps.csv"  # control points that say something else are found again
    gcps.write_text(Path(hamlet.made.gcps).read_text().replace(",control", ",check", 3))  # the rows of one point
    assert reused(again(images=hamlet.images, gcps=str(gcps))[1])[2] is False


@pytest.mark.parametrize(
    "change, kept",
    (
        ({"resolution": 1.0}, [True, True, True]),
        ({"outlier_radius": 3.0}, [True, True, True]),
        ({"model": "homography"}, [True, False, False]),
        ({"altitude_max": 275.0}, [False, False, False]),
    ),
)
@pytest.mark.slow
def test_a_changed_option_makes_anew_what_depends_on_it(again, whole, change, kept):
    before = maps(again.workspace)
    result, said = again(**change)
    assert reused(said) == kept
    after = maps(again.workspace)
    if kept[2]:
        assert after == before
    else:
        assert not {name for name in before if after.get(name) == before[name]}
    assert not np.array_equal(heights(result.output), heights(whole.result.output))


def test_a_changed_image_makes_everything_anew(again, hamlet, tmp_path):
    images = []
    for path in hamlet.images[:2]:
        images.append(shutil.copy(path, tmp_path))
    _, said = again(images=images)
    assert reused(said) == [False, False, False]


def test_a_lost_height_map_alone_is_made_again(again, whole):
    before = maps(again.workspace)
    lost = sorted(before)[1]
    os.unlink(again.workspace / "reconstructed_heights" / lost)
    result, said = again()
    after = maps(again.workspace)
    assert set(after) == set(before)
    assert [name for name in after if after[name] != before[name]] == [lost]
    assert any("Reused 3 of 4 height maps" in note for note in said.notes)
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))


def damage(path, how):
    """Do to a height map what a full disk, a broken copy, another program or a bad disk does."""
    content, dataset = path.read_bytes(), None
    if how in ("cut", "text", "empty"):
        path.write_bytes({"cut": content[: len(content) // 2], "text": b"no raster", "empty": b""}[how])
    elif how == "smaller":
        dataset = gdal.Translate(f"{path}.new.tif", str(path), srcWin=[0, 0, 100, 100])
        dataset = None
        os.replace(f"{path}.new.tif", path)
    else:
        dataset = gdal.Open(str(path), gdal.GA_Update)
        values = dataset.GetRasterBand(1).ReadAsArray()
        row, column = np.argwhere(values != -9999)[0]
        bits = values[row : row + 1, column : column + 1].view(np.int32) ^ 1  # the last bit of one height
        dataset.GetRasterBand(1).WriteArray(bits.view(np.float32), int(column), int(row))
    dataset = None


@pytest.mark.parametrize("damages, stopped", ((("cut", "one bit"), True), (("text", "empty", "smaller"), False)))
@pytest.mark.slow
def test_damaged_height_maps_are_made_again_and_named(again, whole, damages, stopped):
    paths = sorted((again.workspace / "reconstructed_heights").glob("*.tif"))
    good = {path: heights(str(path)) for path in paths}
    for path, how in zip(paths, damages):
        damage(path, how)
    if stopped:
        os.unlink(again.workspace / "reconstructed.json")
    result, said = again()
    for path in paths:
        np.testing.assert_array_equal(heights(str(path)), good[path])
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))
    assert any(f"Reused {4 - len(damages)} of 4 height maps" in note for note in said.notes)
    named = {path for path in paths if any("damaged" in text and str(path) in text for text in said.warnings)}
    assert named == set(paths[: len(damages)])


def test_fusion_alone_refuses_a_damaged_height_map(again, told):
    path = sorted((again.workspace / "reconstructed_heights").glob("*.tif"))[0]
    damage(path, "one bit")
    options = {"scene": str(again.workspace / "reconstructed.json"), "output": again.output, "workers": 1}
    with pytest.raises(SceneError, match=f"{path.name}' is missing or damaged: run 'Reconstruct heights'"):
        run_stage("dsmfuse", options, told())
    assert not os.path.exists(again.output)


def test_a_project_that_was_moved_works(hamlet, whole, tmp_path, told):
    """Workspace and images in one folder, which is moved: height maps and images are found from the scene."""
    before, now = tmp_path / "before", tmp_path / "now"
    before.mkdir()
    images = [shutil.copy(path, before) for path in hamlet.images[:2]]
    options = {**whole.options, "images": images, "workspace": str(before / "w"), "output": str(before / "dsm.tif")}
    run_stage("pipeline", options, told())
    shutil.move(before, now)
    scene = Scene.load(str(now / "w" / "reconstructed.json"))
    assert [view.image for view in scene.views] == [str(now / Path(path).name) for path in images]
    assert all(record.file.startswith(str(now)) for tile in scene.tiles for record in tile.heights)
    fuse = {"scene": str(scene.path), "output": str(now / "again.tif"), "resolution": 0.5, "ortho": str(now / "o.tif")}
    result = run_stage("dsmfuse", {**fuse, "workers": 1}, told())
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))
    os.rename(images[0].replace("before", "now"), now / "other.tif")
    with pytest.raises(SceneError, match=f"reconstructed.json' needs '.*{Path(images[0]).name}', which is not there"):
        run_stage("dsmfuse", {**fuse, "workers": 1}, told())


def test_a_damaged_scene_is_made_again(again, whole):
    (again.workspace / "refined.json").write_text("{")
    result, said = again()
    assert reused(said)[:2] == [True, False]
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))


def test_what_a_killed_run_left_is_no_hindrance(again, whole):
    folder = again.workspace / "reconstructed_heights"
    name = sorted(path.name for path in folder.glob("*.tif"))[0]
    os.unlink(folder / name)
    killed = subprocess.run(  # a process that ends with a file half-written
        [sys.executable, "-c", LEAVE_HALF, str(folder / name)], cwd=ROOT, check=False
    )
    assert abs(killed.returncode) == 9 and len(parts(folder)) == 1
    result, _ = again()
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))
    assert parts(folder) == []


@pytest.mark.parametrize("workers, share", ((1, 0.02), (1, 0.3), (1, 0.6), (1, 0.9), (2, 0.3), (2, 0.7)))
@pytest.mark.slow
def test_cancel_leaves_no_half_made_file_and_the_next_run_succeeds(hamlet, whole, tmp_path, told, workers, share):
    options = {
        **whole.options,
        "workspace": str(tmp_path / "ws"),
        "output": str(tmp_path / "dsm.tif"),
        "workers": workers,
    }
    said = told(cancel_at=max(1, int(share * whole.said.checks)))
    with pytest.raises(Cancelled):
        run_stage("pipeline", options, said)
    assert parts(tmp_path) == [] and not os.path.exists(options["output"])
    if workers == 1 and share == 0.6:
        result = run_stage("pipeline", {**options, "workers": 1}, told())
        np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_tiles_it_has_finished(again, whole, told, tmp_path):
    """The whole process group killed in the middle of matching, as by the kernel where memory runs out."""
    folder = again.workspace / "reconstructed_heights"
    shutil.rmtree(folder)
    for name in ("reconstructed.json", "report.html"):
        os.unlink(again.workspace / name)
    job = tmp_path / "job.json"
    options = {**whole.options, "workspace": str(again.workspace), "output": again.output, "workers": 1}
    job.write_text(json.dumps(options))

    def whole_maps():
        return {name: time for name, time in maps(again.workspace).items() if not name.startswith(".")}

    engine = subprocess.Popen(
        [sys.executable, "-m", "repm_qgis", "pipeline", str(job)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=os.name != "nt",
        cwd=ROOT,
    )
    end = time.monotonic() + 60
    while len(whole_maps()) < 2 and engine.poll() is None and time.monotonic() < end:
        time.sleep(0.005)
    if os.name == "nt":
        engine.kill()
    else:
        os.killpg(engine.pid, signal.SIGKILL)
    engine.wait()
    done = whole_maps()
    assert done and not os.path.exists(again.output)
    result = run_stage("pipeline", options, said := told())
    assert any(f"Reused {len(done)} of 4 height maps" in note or "Reused 4 height maps" in note for note in said.notes)
    assert {name: maps(again.workspace)[name] for name in done} == done
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))
    assert parts(tmp_path) == []


def test_heights_go_where_they_are_wanted(again, tmp_path, told):
    """A folder for the height maps that differs from the first run's gets them all the same."""
    options = {
        "scene": str(again.workspace / "refined.json"),
        "output_scene": str(again.workspace / "reconstructed.json"),
        "heights": str(tmp_path / "elsewhere"),
        "workers": 1,
    }
    result = run_stage("reconstruct", options, told())
    assert result.heights == str(tmp_path / "elsewhere")
    files = {Path(record.file).name for tile in Scene.load(result.output_scene).tiles for record in tile.heights}
    assert len(files) == 4 and files <= set(os.listdir(tmp_path / "elsewhere"))


def test_a_scene_in_place(again, told):
    """The same file as input and output of a stage."""
    scene = str(again.workspace / "refined.json")
    run_stage("reconstruct", {"scene": scene, "output_scene": scene, "workers": 1}, told())
    assert [entry.stage for entry in Scene.load(scene).history] == ["epmfit", "refine", "reconstruct"]


STOP_AFTER_TWO = """
import json, os, sys
from repm_qgis.fusion import tile_fusion
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage
fuse, done = tile_fusion.fuse_tile, []
def fuse_tile(task):
    if len(done) == 2:
        os.kill(os.getpid(), 9)
    done.append(task)
    return fuse(task)
tile_fusion.fuse_tile = fuse_tile
run_stage("dsmfuse", json.loads(sys.argv[1]), Silent())
"""


@pytest.fixture(scope="module")
def after_the_kill(whole, tmp_path_factory):
    """The workspace of a fusion that was killed at the third of four tiles, and a copy of it."""
    folder = tmp_path_factory.mktemp("killed")
    workspace = shutil.copytree(whole.workspace, folder / "ws")
    options = {"scene": str(workspace / "reconstructed.json"), "output": str(folder / "dsm.tif"), "resolution": 0.5}
    options.update(workers=1, cloud=str(folder / "cloud.laz"))
    killed = subprocess.run([sys.executable, "-c", STOP_AFTER_TWO, json.dumps(options)], cwd=ROOT, check=False)
    assert abs(killed.returncode) == 9 and not os.path.exists(options["output"])
    assert len(list((workspace / "reconstructed_fusion").glob("*/*.npz"))) == 2
    return workspace, shutil.copytree(workspace, folder / "copy")


@pytest.fixture
def killed_fusion(after_the_kill, tmp_path):
    """The options of that fusion, to be run on at its place, and the folder of its fused tiles."""
    workspace, copy = after_the_kill
    shutil.rmtree(workspace)
    shutil.copytree(copy, workspace)
    options = {"scene": str(workspace / "reconstructed.json"), "output": str(tmp_path / "dsm.tif"), "resolution": 0.5}
    options.update(workers=1, cloud=str(tmp_path / "cloud.laz"))
    return options, workspace / "reconstructed_fusion"


def test_fusion_goes_on_with_the_tiles_it_has_finished(killed_fusion, whole, told):
    options, folder = killed_fusion
    result = run_stage("dsmfuse", options, said := told())
    assert any("Reused 2 of 4 fused tiles" in note for note in said.notes)
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))
    assert not folder.exists() and parts(folder.parent) == []


@pytest.mark.parametrize("change", ({"cloud": None}, {"cloud_normals": True}))
def test_fusion_takes_its_tiles_whatever_is_made_of_the_finished_dsm(killed_fusion, told, change):
    options, _ = killed_fusion
    run_stage("dsmfuse", {**options, **change}, said := told())
    assert any("Reused 2 of 4 fused tiles" in note for note in said.notes)


@pytest.mark.parametrize("change", ({"method": "median"}, {"resolution": 1.0}, {"fill": "none"}))
@pytest.mark.slow
def test_fusion_takes_no_tile_of_other_options(killed_fusion, told, tmp_path, change):
    options, folder = killed_fusion
    result = run_stage("dsmfuse", {**options, **change}, said := told())
    assert not any("Reused" in note for note in said.notes) and not folder.exists()
    undisturbed = run_stage("dsmfuse", {**options, **change, "output": str(tmp_path / "other.tif")}, told())
    np.testing.assert_array_equal(heights(result.output), heights(undisturbed.output))


def test_a_damaged_fused_tile_is_made_again(killed_fusion, whole, told):
    options, folder = killed_fusion
    tile = sorted(folder.glob("*/*.npz"))[0]
    content = bytearray(tile.read_bytes())
    content[len(content) // 2] ^= 1
    tile.write_bytes(bytes(content))
    result = run_stage("dsmfuse", options, said := told())
    assert any("Reused 1 of 4 fused tiles" in note for note in said.notes)
    np.testing.assert_array_equal(heights(result.output), heights(whole.result.output))


@pytest.mark.parametrize("how", ("zeros", "another height", "gone", "empty"))
@pytest.mark.slow
def test_damaged_heights_with_the_margin_are_not_reused(killed_fusion, whole, told, how):
    """A power cut leaves zeros in a file that the disk had not got yet: seams were 24 m off."""
    options, folder = killed_fusion
    wide = sorted(folder.glob("*/*.npz.wide.npy"))[0]
    values = np.load(wide)
    if how == "gone":
        wide.unlink()
    elif how == "empty":  # numpy has an error of its own for these, from 1.25 on
        wide.write_bytes(b"")
    else:
        content = bytearray(wide.read_bytes())
        begin = len(content) - values.nbytes
        content[begin:] = bytes(values.nbytes) if how == "zeros" else (values + 24).tobytes()
        wide.write_bytes(bytes(content))
    said = told()
    again = run_stage("dsmfuse", options, said)
    assert any("Reused 1 of 4 fused tiles" in note for note in said.notes)
    np.testing.assert_array_equal(heights(again.output), heights(whole.result.output))


def test_a_cancelled_fusion_keeps_its_tiles_and_a_failed_one_leaves_nothing(again, whole, told, monkeypatch):
    options = {"scene": str(again.workspace / "reconstructed.json"), "output": again.output, "resolution": 0.5}
    with pytest.raises(Cancelled):
        run_stage("dsmfuse", {**options, "workers": 1}, told(cancel_at=3))
    folder = again.workspace / "reconstructed_fusion"
    assert list(folder.glob("*/*.npz")) and parts(folder) == [] and not os.path.exists(again.output)

    def fail(*arguments, **more):
        raise EmptyResultError("No cell of the DSM has a height (cells: 1): check the reconstruction's report.")

    monkeypatch.setattr("repm_qgis.stages.fusing.write_products", fail)
    with pytest.raises(EmptyResultError):
        run_stage("dsmfuse", {**options, "workers": 1}, told())
    assert not list(folder.glob("*/*"))
