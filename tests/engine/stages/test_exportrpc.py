"""Export of corrected RPCs: the scene's files as other software opens them."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import Cancelled, OptionError, SceneError, WorkspaceError
from repm_qgis.contracts.records import GroundShift
from repm_qgis.geometry.frames import geodetic_from_projected, projected_from_geodetic
from repm_qgis.geometry.jitter import Jitter
from repm_qgis.imagery.raster import opened, read
from repm_qgis.registration.moved_scene import moved_scene
from repm_qgis.rpc.correction import JITTERED
from repm_qgis.scene import Scene, load_views
from repm_qgis.stages import run_stage
from tests.engine.pages import plain

AFFINE = np.array([[1.00008, -1e-4, 4.5], [0.7e-4, 0.9999, -12.25]])


def export(scene, folder, told, **more):
    said = more.pop("said", None) or told()
    return run_stage("exportrpc", {"scene": str(scene), "rpc_folder": str(folder), **more}, said)


@pytest.fixture(scope="module")
def pointed(urban_run):
    """The town's scene after matching, whose views have shifts."""
    return urban_run.workspace / "reconstructed.json"


@pytest.fixture
def turned(pointed, tmp_path):
    """The same with an affine pointing of every view."""
    scene = Scene.load(str(pointed))
    views = tuple(view.with_pointing(AFFINE) for view in scene.views)
    return replace(scene, views=views).save(str(tmp_path / "turned.json"))


def test_jitter_is_exported_as_far_as_an_rpc_holds_it(pointed, tmp_path, told):
    scene = Scene.load(str(pointed))
    waves = Jitter(0.0, scene.views[0].height - 1.0, np.random.default_rng(2).normal(0, 0.4, (30, 2)))
    first = scene.views[0].with_pointing(scene.views[0].pointing, waves)
    path = replace(scene, views=(first, *scene.views[1:])).save(str(tmp_path / "shaken.json"))
    said = told()
    result = export(path, tmp_path / "rpcs", told, said=said)
    record = json.loads((tmp_path / "rpcs" / "rpcs.json").read_text())["images"][0]
    assert record["method"] == JITTERED and 0.2 < record["max_px"] < 2.0 and result.max_error == record["max_px"]
    ground = ground_of(first, scene.altitudes)
    error = np.linalg.norm(by_gdal(result.images[0], ground) - first.project(ground), axis=1)
    assert 0.5 * record["max_px"] < error.max() < 1.3 * record["max_px"]
    assert any("cannot hold the jitter of img_01" in text for text in said.warnings)


def ground_of(view, altitudes, count=300):
    chance = np.random.default_rng(9)
    pixels = chance.uniform(-0.5, np.array(view.size) - 0.5, (count, 2))
    return view.localise(pixels, chance.uniform(*altitudes, count))


def by_gdal(path, ground):
    transformer = gdal.Transformer(gdal.Open(str(path)), None, ["METHOD=RPC"])
    found, _ = transformer.TransformPoints(1, ground.tolist())
    return np.array(found)[:, :2] - 0.5


def test_the_vrts_are_the_images_with_the_pointed_model(pointed, turned, tmp_path, told):
    for number, path in enumerate((pointed, turned)):
        scene = Scene.load(str(path))
        made = export(path, tmp_path / str(number), told)
        assert made.images == tuple(str(tmp_path / str(number) / f"{view.name}.vrt") for view in scene.views)
        assert made.max_error < 1e-4
        again = load_views(tuple(made.images))
        for view, vrt, loaded in zip(scene.views, made.images, again):
            ground = ground_of(view, scene.altitudes)
            assert np.abs(view.project(ground) - view.rpc.project(ground)).max() > 0.05  # there is a correction
            assert np.abs(by_gdal(vrt, ground) - view.project(ground)).max() < 1e-4
            assert np.abs(loaded.project(ground) - view.project(ground)).max() < 1e-4  # with the texts beside it
            assert (loaded.name, loaded.size, loaded.acquired) == (view.name, view.size, view.acquired)
            with opened(view.image) as image, opened(vrt) as shown:
                assert np.array_equal(read(image), read(shown), equal_nan=True)
                assert (shown.GetGCPCount(), shown.GetProjection(), shown.GetGeoTransform(can_return_null=True)) == (
                    0,
                    "",
                    None,
                )
            assert os.path.getsize(vrt) < 10_000


def test_bands_nodata_mask_and_time_of_an_image_are_kept_and_its_georeferencing_is_not(
    pointed, tmp_path, told, write_image
):
    scene = Scene.load(str(pointed))
    images = tmp_path / ("images & 'more'" if os.name == "nt" else "images & <more>")  # Windows allows no < in names
    images.mkdir()
    chance = np.random.default_rng(1)
    colour = chance.integers(0, 255, (3, 400, 400)).astype(np.uint8)
    first = write_image(images / "a.tif", colour, scene.views[0].rpc, nodata=7, crs="EPSG:32631")
    second = write_image(images / "b.tif", colour[0], scene.views[1].rpc)
    dataset = gdal.Open(second, gdal.GA_Update)
    dataset.SetGCPs([gdal.GCP(1.0 + i, 2.0 + i % 2, 0.0, 10.0 * i, 20.0 * (i % 2)) for i in range(4)], "")
    gdal.SetThreadLocalConfigOption("GDAL_TIFF_INTERNAL_MASK", "NO")  # GDAL before 3.9 made files by itself
    dataset.CreateMaskBand(gdal.GMF_PER_DATASET)
    gdal.SetThreadLocalConfigOption("GDAL_TIFF_INTERNAL_MASK", None)
    hidden = np.full((400, 400), 255, np.uint8)
    hidden[:100] = 0
    dataset.GetRasterBand(1).GetMaskBand().WriteArray(hidden)
    dataset = None
    assert os.path.exists(f"{second}.msk")
    views = tuple(
        replace(view, image=image, content="", width=400, height=400, acquired="2013-07-01T10:20:30.500Z")
        for view, image in zip(scene.views, (first, second))
    )
    path = replace(scene, views=views, tiles=(), pairs=(), pointing=None).save(str(tmp_path / "s.json"))
    made = export(path, tmp_path / "out", told)
    with opened(first) as image, opened(made.images[0]) as shown:
        assert np.array_equal(image.ReadAsArray(), shown.ReadAsArray()) and shown.RasterCount == 3
        assert np.array_equal(read(image, band=0), read(shown, band=0), equal_nan=True)
        assert shown.GetRasterBand(2).GetNoDataValue() == 7.0
        assert [shown.GetRasterBand(i).GetColorInterpretation() for i in (1, 2, 3)] == [
            image.GetRasterBand(i).GetColorInterpretation() for i in (1, 2, 3)
        ]
        assert shown.GetProjection() == "" and image.GetProjection() != ""
    with opened(second) as image, opened(made.images[1]) as shown:
        values = read(shown)
        assert np.isnan(values[:100]).all() and np.array_equal(values, read(image), equal_nan=True)
        assert image.GetGCPCount() == 4 and shown.GetGCPCount() == 0
    assert [view.acquired for view in load_views(tuple(made.images))] == ["2013-07-01T10:20:30.500Z"] * 2


def test_images_of_equal_names_have_files_of_their_own(pointed, tmp_path, told):
    scene = Scene.load(str(pointed))
    for index, view in enumerate(scene.views):
        (tmp_path / str(index)).mkdir()
        shutil.copy(view.image, tmp_path / str(index) / "scene.tif")
    images = tuple(str(tmp_path / str(index) / "scene.tif") for index in range(len(scene.views)))
    named = tuple(view.with_pointing(old.pointing) for view, old in zip(load_views(images), scene.views))
    path = replace(scene, views=named, tiles=(), pairs=(), pointing=None).save(str(tmp_path / "s.json"))
    made = export(path, tmp_path / "out", told)
    assert len(set(made.images)) == len(list((tmp_path / "out").glob("*.RPB"))) == len(images)
    for view, vrt in zip(named, made.images):
        ground = ground_of(view, scene.altitudes, 20)
        assert np.abs(by_gdal(vrt, ground) - view.project(ground)).max() < 1e-6


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_the_folder_and_its_images_can_be_moved_together_and_reached_by_a_link(urban, pointed, tmp_path, told):
    home = tmp_path / "deep" / "down" / "home"
    shutil.copytree(urban.folder, home / "images")
    scene = Scene.load(str(pointed))
    views = tuple(replace(view, image=str(home / "images" / Path(view.image).name)) for view in scene.views)
    path = replace(scene, views=views, tiles=(), pairs=(), pointing=None).save(str(tmp_path / "s.json"))
    (tmp_path / "link").symlink_to(home)
    made = export(path, tmp_path / "link" / "out", told)
    wanted = gdal.Open(views[0].image).ReadAsArray()
    assert np.array_equal(gdal.Open(made.images[0]).ReadAsArray(), wanted)
    assert np.array_equal(gdal.Open(str(home / "out" / Path(made.images[0]).name)).ReadAsArray(), wanted)
    os.rename(home, tmp_path / "elsewhere")
    assert np.array_equal(
        gdal.Open(str(tmp_path / "elsewhere" / "out" / Path(made.images[0]).name)).ReadAsArray(), wanted
    )


def test_the_list_and_the_report_say_how_and_how_well(turned, tmp_path, told):
    said = told()
    made = export(turned, tmp_path / "out", told, said=said, report=str(tmp_path / "r.html"))
    scene = Scene.load(str(turned))
    records = json.loads((tmp_path / "out" / "rpcs.json").read_text())["images"]
    for view, record in zip(scene.views, records):
        middle = (np.array(view.size) - 1) / 2
        assert record["shift_px"] == pytest.approx(AFFINE @ [*middle, 1.0] - middle)
        assert np.linalg.norm(record["moved_m"]) == pytest.approx(
            np.linalg.norm(record["shift_px"]) * view.gsd_m, rel=0.2
        )
        assert (record["view"], record["original"], record["method"]) == (
            view.name,
            view.image,
            "affine, numerators fitted",
        )
        assert record["max_px"] <= made.max_error
    page = plain((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "Every exported RPC is within 0.0001 px" in page
    assert "affine, numerators fitted" in page and "img_02.vrt" in page
    assert not said.warnings and "3 images" in said.notes[-1]


def test_the_ground_moves_to_the_east_where_the_report_says_so(pointed, tmp_path, told):
    """East and north by PROJ, which the stage does not use for them."""
    import pyproj

    export(pointed, tmp_path / "out", told)
    scene = Scene.load(str(pointed))
    geod = pyproj.Geod(ellps="WGS84")
    for view, record in zip(scene.views, json.loads((tmp_path / "out" / "rpcs.json").read_text())["images"]):
        middle, height = (np.array(view.size) - 1) / 2, sum(scene.altitudes) / 2
        before, after = view.rpc.localise(middle, height), view.localise(middle, height)
        azimuth, _, metres = geod.inv(before[0], before[1], after[0], after[1])
        east, north = metres * np.sin(np.radians(azimuth)), metres * np.cos(np.radians(azimuth))
        assert record["moved_m"] == pytest.approx([east, north], abs=1e-3)


def test_without_pointing_the_rpcs_are_as_delivered_and_it_says_so(urban_run, tmp_path, told):
    said = told()
    fitted = urban_run.workspace / "scene.json"
    made = export(fitted, tmp_path / "out", told, said=said, report=str(tmp_path / "r.html"))
    assert len(said.warnings) == 1 and "the RPCs as delivered: give control points" in said.warnings[0]
    assert made.max_error == 0.0
    for view, again in zip(Scene.load(str(fitted)).views, load_views(tuple(made.images))):
        assert again.rpc == view.rpc
    assert "the RPCs as delivered" in plain((tmp_path / "r.html").read_text(encoding="utf-8"))


def test_a_correction_that_no_rpc_can_hold_is_a_warning_with_the_number(pointed, tmp_path, told, synthetic_rpc):
    scene = Scene.load(str(pointed))
    wild = np.array([[0.9, 0.4, 0.0], [-0.4, 0.9, 0.0]])
    views = tuple(replace(view, rpc=_uneven(view.rpc)).with_pointing(wild) for view in scene.views)
    path = replace(scene, views=views, tiles=(), pairs=(), pointing=None).save(str(tmp_path / "s.json"))
    said = told()
    made = export(path, tmp_path / "out", told, said=said, report=str(tmp_path / "r.html"))
    assert made.max_error > 0.01 and len(said.warnings) == 3
    assert f"by up to {made.max_error:.3f} px (usual: at most 0.01 px)" in " ".join(said.warnings)
    page = plain((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "Every exported RPC" not in page and "the correction is too large" in page


def _uneven(rpc):
    """With denominators that no common one replaces."""
    bent = list(rpc.row_den)
    bent[1], bent[7] = bent[1] + 0.08, bent[7] - 0.05
    return replace(rpc, row_den=tuple(bent))


def test_an_earlier_export_is_replaced_and_nothing_else_is(pointed, turned, tmp_path, told):
    out = tmp_path / "out"
    export(pointed, out, told)
    (out / "img_01.vrt.aux.xml").write_text("<PAMDataset/>")  # QGIS's statistics
    before = (out / "img_01.RPB").read_bytes()
    export(turned, out, told)
    assert (out / "img_01.RPB").read_bytes() != before and not (out / "img_01.vrt.aux.xml").exists()
    (out / "notes.txt").write_text("mine")
    with pytest.raises(WorkspaceError, match="holds 'notes.txt', which does not belong .* for RPC_FOLDER"):
        export(pointed, out, told)
    assert (out / "notes.txt").read_text() == "mine"
    shutil.rmtree(out)
    out.mkdir()
    (out / "img_01.vrt").write_text("mine")  # the name alone is no proof
    with pytest.raises(WorkspaceError, match="holds 'img_01.vrt'"):
        export(pointed, out, told)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(WorkspaceError, match="holds 'file'"):
        export(pointed, tmp_path / "file", told)


def test_a_cancel_or_an_error_leaves_nothing_new(pointed, tmp_path, told, monkeypatch):
    out = tmp_path / "out"
    with pytest.raises(Cancelled):
        export(pointed, out, told, said=told(cancel_at=2))
    assert sorted(tmp_path.iterdir()) == []
    export(pointed, out, told)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    from repm_qgis.stages import exportrpc

    def full(rpc):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(exportrpc, "rpb_text", full)
    with pytest.raises(WorkspaceError, match="the disk is full"):
        export(pointed, out, told)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_what_is_wrong_is_said_before_anything_is_written(urban, pointed, tmp_path, told):
    with pytest.raises(OptionError, match="would be lost"):
        export(pointed, urban.folder, told)  # the images' own folder
    place = "a shorter" if os.name == "nt" else "another"  # it is said to be too long for Windows
    with pytest.raises(WorkspaceError, match=f"Cannot write 'xxx.*: choose {place} place"):
        export(pointed, "x" * 5000, told)
    scene = Scene.load(str(pointed))
    views = (replace(scene.views[0], image=str(tmp_path / "gone.tif")), *scene.views[1:])
    lost = replace(scene, views=views).save(str(tmp_path / "lost.json"))
    with pytest.raises(SceneError, match="gone.tif"):
        export(lost, tmp_path / "out", told)
    blind = (replace(scene.views[0], rpc=scene.views[0].rpc.shifted(5e7, 5e7)), *scene.views[1:])
    path = replace(scene, views=blind, tiles=()).save(str(tmp_path / "blind.json"))
    with pytest.raises(Exception, match="cannot be exported: it gives almost none") as error:
        export(path, tmp_path / "out", told)
    assert scene.views[0].image in str(error.value)
    assert not (tmp_path / "out").exists()


def test_a_scene_that_was_laid_onto_a_reference_takes_its_rpcs_along(pointed, tmp_path, told):
    scene = Scene.load(str(pointed))
    metres = np.array([12.0, -9.0, 6.0])
    centre = tuple(float(value) for value in np.mean(np.reshape(scene.tiles[0].bounds, (2, 2)), axis=0))
    moved, left_px = moved_scene(scene, GroundShift(moved=tuple(metres), tilt=(0.0, 0.0), centre=centre))
    made = export(moved.save(str(tmp_path / "moved.json")), tmp_path / "out", told)
    for view, vrt in zip(scene.views, made.images):
        ground = ground_of(view, scene.altitudes)
        xyz = np.column_stack([projected_from_geodetic(scene.crs, ground), ground[:, 2]]) + metres
        there = np.column_stack([geodetic_from_projected(scene.crs, xyz[:, :2]), xyz[:, 2]])
        error = np.abs(by_gdal(vrt, there) - view.project(ground)).max()
        assert error < 0.01 and error < left_px + 1e-3
