"""Exported cameras, read back by the software they are for or by a few independent lines: the same pixels."""

from __future__ import annotations

import json
import os
import sys
import weakref
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import Cancelled, MissingPackageError, OptionError, SceneError, WorkspaceError
from repm_qgis.exports import images
from repm_qgis.exports.model import tile_model
from repm_qgis.geometry.frames import EnuFrame, projected_from_geodetic
from repm_qgis.geometry.jitter import Jitter
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from tests.engine.versions import needs_pycolmap_4

TILE = "r000c000"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("exports")


@pytest.fixture(scope="module")
def scenes(urban, urban_run, folder, told):
    """Paths of the fitted, the refined and the reconstructed scene of the town: four tiles, three views."""
    fitted = run_stage("epmfit", {"images": urban.images, "workspace": str(folder / "w"), "tile_size": 256}, told())
    refined = run_stage("refine", {"scene": fitted.scene, "output_scene": str(folder / "w" / "refined.json")}, told())
    return {"fitted": fitted.scene, "refined": refined.output_scene, "rebuilt": urban_run.result.scene}


@pytest.fixture(scope="module")
def exported(scenes, folder, told):
    """exported(format, scene, **options): folder of the first tile's model, and the stage's result."""
    known = {}

    def export(layout, scene="refined", **options):
        key = (layout, scene, *sorted(options.items()))
        if key not in known:
            given = {
                "scene": scenes[scene],
                "folder": str(folder / f"{len(known)}_{layout}"),
                "format": layout,
                "tile": TILE,
                **options,
            }
            known[key] = run_stage("exportcameras", given, told())
        return Path(known[key].models[0]), known[key]

    return export


@pytest.fixture(scope="module")
def ground(scenes):
    """(200, 3) random points of the tile between its altitudes: longitude, latitude, height; and the same in ENU."""
    scene = Scene.load(scenes["refined"])
    tile = next(tile for tile in scene.tiles if tile.id == TILE)
    numbers = np.random.default_rng(5)
    xy = numbers.uniform(tile.bounds[:2], tile.bounds[2:], (200, 2))
    from repm_qgis.geometry.frames import geodetic_from_projected

    points = np.column_stack([geodetic_from_projected(scene.crs, xy), numbers.uniform(*tile.altitudes, 200)])
    return points, scene.frame.from_geodetic(points)


def colmap_pixels(model, enu, form="sparse/0"):
    """{view: (N, 2)} pixels by pycolmap's own model and cameras; the first pixel's centre is (0.5, 0.5)."""
    pycolmap = pytest.importorskip("pycolmap")
    made = pycolmap.Reconstruction(str(model / form))
    assert made.num_images() == made.num_reg_images() == 3
    pixels = {}
    for image in made.images.values():
        in_camera = image.cam_from_world() * enu
        pixels[Path(image.name).stem] = made.cameras[image.camera_id].img_from_cam(in_camera)
        assert (model / "images" / image.name).is_file()
    return pixels


def mvsnet_pixels(path, enu):
    words = path.read_text().split()
    assert words[0] == "extrinsic" and words[17] == "intrinsic"
    E, K = np.array(words[1:17], float).reshape(4, 4), np.array(words[18:27], float).reshape(3, 3)
    h = np.column_stack([enu, np.ones(len(enu))]) @ (K @ E[:3]).T
    return h[:, :2] / h[:, 2:], h[:, 2], [float(word) for word in words[27:]]


def nerf_pixels(frame, enu):
    """By nerfstudio's rules: -z forward, y up, rays through pixel + 0.5."""
    c2w = np.array(frame["transform_matrix"])
    x, y, z = np.linalg.solve(c2w, np.column_stack([enu, np.ones(len(enu))]).T)[:3]
    assert (z < 0).all()
    return np.column_stack([frame["fl_x"] * x / -z + frame["cx"], -frame["fl_y"] * y / -z + frame["cy"]])


def size_of(path):
    dataset = gdal.Open(str(path))
    found = dataset.RasterXSize, dataset.RasterYSize, dataset.RasterCount, dataset.GetRasterBand(1).DataType
    dataset = None  # noqa: F841
    return found


def pixels_of(path):
    dataset = gdal.Open(str(path))
    values = dataset.ReadAsArray()
    dataset = None  # noqa: F841
    return values


@needs_pycolmap_4
@pytest.mark.parametrize("form", ["sparse/0", "sparse_text"])
@pytest.mark.long
def test_pycolmap_sees_what_the_refined_cameras_see(exported, scenes, ground, form):
    model, result = exported("colmap", centre=False)
    assert result.images == 3 and result.models == (str(model),)
    tile = next(tile for tile in Scene.load(scenes["refined"]).tiles if tile.id == TILE)
    pixels = colmap_pixels(model, ground[1], form)
    assert set(pixels) == set(tile.views)
    for name, seen in pixels.items():
        expected = tile.views[name].refined.camera.project(ground[1]) + 0.5
        np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-6)


@needs_pycolmap_4
@pytest.mark.parametrize("centre", [False, True])
@pytest.mark.parametrize("scene", ["refined", "rebuilt"])
def test_what_colmap_sees_lies_where_the_sensor_sees_it(exported, scenes, ground, centre, scene):
    """M of the pixel that COLMAP gives a ground point is the view's own pixel of it, relative pointing included."""
    model, _ = exported("colmap", scene, centre=centre)
    loaded = Scene.load(scenes[scene])
    tile = next(tile for tile in loaded.tiles if tile.id == TILE)
    views = [view.centred() if centre else view for view in tile_model(loaded, tile).views]
    pixels = colmap_pixels(model, ground[1])
    for view in views:
        original = view.to_original(pixels[view.name] - 0.5)
        expected = loaded.view(view.name).project(ground[0])
        # A shift of a few px in the original is one in the refined image to a few thousandths.
        limit = view.error.max + (1e-3 if scene == "refined" else 5e-3)
        assert np.abs(original - expected).max() < limit
        assert (np.abs(view.shift_px).max() > 0.1) == (scene == "rebuilt")


@needs_pycolmap_4
def test_centred_cameras_look_at_their_images_middle(exported):
    model, _ = exported("colmap")
    for line in (model / "sparse_text" / "cameras.txt").read_text().splitlines():
        if not line.startswith("#"):
            _, kind, width, height, fx, fy, cx, cy = line.split()
            assert kind == "PINHOLE" and fx == fy
            assert abs(float(cx) - int(width) / 2) <= 1 and abs(float(cy) - int(height) / 2) <= 1
            assert size_of(model / "images" / "img_01.png")[2:] == (1, gdal.GDT_Byte)


@needs_pycolmap_4
def test_stock_colmap_triangulates_the_town(exported, scenes, urban, tmp_path):
    """SIFT, matching and triangulation by pycolmap alone, from the exported folder alone."""
    pycolmap = pytest.importorskip("pycolmap")
    model, _ = exported("colmap", "rebuilt")
    database = tmp_path / "database.db"
    database.write_bytes((model / "database.db").read_bytes())
    reader = pycolmap.ImageReaderOptions()
    reader.mask_path = str(model / "masks")
    pycolmap.extract_features(str(database), str(model / "images"), reader_options=reader)
    pycolmap.match_exhaustive(str(database))
    options = pycolmap.IncrementalPipelineOptions()
    options.max_focal_length_ratio = 1e9
    (tmp_path / "out").mkdir()
    made = pycolmap.triangulate_points(
        pycolmap.Reconstruction(str(model / "sparse" / "0")),
        str(database),
        str(model / "images"),
        str(tmp_path / "out"),
        options=options,
    )
    points = np.array([point.xyz for point in made.points3D.values()])
    assert len(points) > 100
    assert np.median([point.error for point in made.points3D.values()]) < 0.3
    origin = json.loads((model / "frame.json").read_text())["world"]["origin"]
    found = EnuFrame(origin["lon"], origin["lat"], origin["height"]).to_geodetic(points)
    x, y = projected_from_geodetic(urban.crs, found).T
    column, row = (
        ((x - urban.transform[0]) / urban.transform[1]).astype(int),
        ((y - urban.transform[3]) / urban.transform[5]).astype(int),
    )
    difference = found[:, 2] - urban.surface[row, column]
    # Pointing is relative: the whole scene may hang a few metres off, but not its shape. Corners are found at walls.
    assert np.median(np.abs(difference - np.median(difference))) < 1.0


@needs_pycolmap_4
def test_tie_points_come_along(exported, scenes):
    pycolmap = pytest.importorskip("pycolmap")
    model, _ = exported("colmap", "rebuilt")
    points = list(pycolmap.Reconstruction(str(model / "sparse" / "0")).points3D.values())
    frame = json.loads((model / "frame.json").read_text())
    assert len(points) == frame["points"] > 50
    tile = next(tile for tile in Scene.load(scenes["rebuilt"]).tiles if tile.id == TILE)
    ground = EnuFrame(**frame["world"]["origin"]).to_geodetic(np.array([point.xyz for point in points]))
    assert (ground[:, 2] > tile.altitudes[0] - 20).all() and (ground[:, 2] < tile.altitudes[1] + 20).all()
    ecef = np.array(frame["world"]["ecef_from_world"]) @ np.append(points[0].xyz, 1.0)
    from repm_qgis.geometry.frames import geodetic_from_ecef

    np.testing.assert_allclose(geodetic_from_ecef(ecef[:3]), ground[0], atol=1e-8)
    assert json.loads((exported("colmap")[0] / "frame.json").read_text())["points"] == 0


@needs_pycolmap_4
@pytest.mark.parametrize("centre", [False, True])
def test_all_formats_tell_the_same_pixels(exported, ground, centre):
    colmap = colmap_pixels(exported("colmap", centre=centre)[0], ground[1])
    mvsnet, _ = exported("mvsnet", centre=centre)
    nerf, _ = exported("nerfstudio", centre=centre)
    frames = json.loads((nerf / "transforms.json").read_text())["frames"]
    for index, (name, frame) in enumerate(zip(sorted(colmap), frames)):
        assert frame["file_path"] == f"images/{name}.png" and (nerf / frame["mask_path"]).is_file()
        assert size_of(nerf / frame["file_path"])[:2] == (frame["w"], frame["h"])
        np.testing.assert_allclose(nerf_pixels(frame, ground[1]), colmap[name], rtol=0, atol=1e-6)
        pixels, depth, (low, step, count, high) = mvsnet_pixels(mvsnet / "cams" / f"{index:08d}_cam.txt", ground[1])
        np.testing.assert_allclose(pixels, colmap[name], rtol=0, atol=1e-6)
        shown = ((pixels > 0) & (pixels < (frame["w"], frame["h"]))).all(axis=1)
        assert low <= depth[shown].min() and depth[shown].max() <= high and shown.sum() > 100
        assert high == pytest.approx(low + step * (count - 1)) and count > 50
        assert size_of(mvsnet / "images" / f"{index:08d}.jpg")[:2] == (frame["w"], frame["h"])
    assert len(frames) == 3


def test_pairs_name_all_others_best_first(exported):
    lines = (exported("mvsnet")[0] / "pair.txt").read_text().splitlines()
    assert lines[0] == "3" and lines[1::2] == ["0", "1", "2"]
    for index, line in enumerate(lines[2::2]):
        words = line.split()
        scores = [float(word) for word in words[2::2]]
        assert words[0] == "2" and {*map(int, words[1::2]), index} == {0, 1, 2}
        assert scores == sorted(scores, reverse=True) and 0 < scores[-1] < scores[0] < 1


@pytest.mark.parametrize("centre", [False, True])
def test_whutlc_has_square_pixels_and_one_size(exported, scenes, ground, centre):
    """As SatMVS's reader takes it: 4 lines of E, f x0 y0, depths, and an image that shows what these say."""
    model, _ = exported("whutlc", centre=centre)
    sizes = set()
    scene = Scene.load(scenes["refined"])
    tile = next(tile for tile in scene.tiles if tile.id == TILE)
    for index, name in enumerate(tile.views):
        lines = (model / "camera" / str(index) / f"{TILE}.txt").read_text().split("\n")
        E = np.array([[float(word) for word in line.split(" ")] for line in lines[:4]])
        f, x0, y0 = (float(word) for word in lines[5].split(" "))
        low, high, step = (float(word) for word in lines[7].split(" "))
        image = pixels_of(model / "image" / str(index) / f"{TILE}.png")
        sizes.add(image.shape)
        assert lines[8].split(" ") == [str(index), "0", "0", "0", "0", str(image.shape[1]), str(image.shape[0])]
        x, y, z = E[:3, :3] @ ground[1].T + E[:3, 3:]
        assert 0 < step < high - low
        # What lies at a ground point's pixel (from the first centre) is what the original image has there.
        column, row = f * x / z + x0, f * y / z + y0
        inside = (column > 1) & (column < image.shape[1] - 2) & (row > 1) & (row < image.shape[0] - 2)
        shown = image[row[inside].round().astype(int), column[inside].round().astype(int)].astype(float)
        source = scene.view(name).project(ground[0][inside]).round().astype(int)
        truth = pixels_of(scene.view(name).image)[source[:, 1], source[:, 0]].astype(float)
        assert inside.sum() > 100 and np.corrcoef(np.sqrt(truth), shown)[0, 1] > 0.9
    assert len(sizes) == 1 and all(side % 64 == 0 for side in sizes.pop())


@needs_pycolmap_4
def test_eight_bits_are_the_stretched_refined_image(exported, scenes):
    from repm_qgis.imagery.enhancement import view_stretch

    model, _ = exported("colmap", centre=False)
    tile = next(tile for tile in Scene.load(scenes["refined"]).tiles if tile.id == TILE)
    view = Scene.load(scenes["refined"]).view("img_02")
    refined = pixels_of(tile.views["img_02"].image).astype(np.float32)
    shown = pixels_of(model / "images" / "img_02.png")
    known = refined > 0
    np.testing.assert_array_equal(shown > 0, known)
    np.testing.assert_array_equal(pixels_of(model / "masks" / "img_02.png.png"), np.where(known, 255, 0))
    expected = 1 + 254 * view_stretch(view.image, view.band).apply(refined)
    assert np.abs(shown[known] - expected[known]).max() <= 0.51
    assert np.ptp(shown[known]) > 150
    assert sorted(path.name for path in (model / "images").iterdir()) == ["img_01.png", "img_02.png", "img_03.png"]


def test_sixteen_bits_are_the_refined_image_itself_or_made_anew(exported, scenes):
    tile = next(tile for tile in Scene.load(scenes["refined"]).tiles if tile.id == TILE)
    refined = pixels_of(tile.views["img_01"].image)
    copied, _ = exported("nerfstudio", centre=False, bits="16")
    np.testing.assert_array_equal(pixels_of(copied / "images" / "img_01.tif"), refined)
    sharper, _ = exported("nerfstudio", centre=False, bits="16", kernel="cubic")  # which refine did not write
    anew = pixels_of(sharper / "images" / "img_01.tif")
    inner = (anew > 0) & (refined > 0)
    difference = np.abs(anew[inner].astype(float) - refined[inner])
    assert difference.any() and np.median(difference) < 0.1 * np.ptp(refined[inner])


def test_every_tile_is_a_model_of_its_own(scenes, tmp_path, told):
    said = told()
    result = run_stage(
        "exportcameras", {"scene": scenes["refined"], "folder": str(tmp_path / "all"), "format": "mvsnet"}, said
    )
    tiles = [tile.id for tile in Scene.load(scenes["refined"]).tiles]
    assert len(tiles) == 4 and result.models == tuple(str(tmp_path / "all" / tile) for tile in tiles)
    assert result.images == 12 and result.folder == str(tmp_path / "all")
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == sorted(tiles)
    assert said.fractions == sorted(said.fractions) and said.fractions[-1] == 1
    again = run_stage(
        "exportcameras", {"scene": scenes["refined"], "folder": str(tmp_path / "all"), "format": "mvsnet"}, told()
    )
    assert again == result


def test_cancel_leaves_all_models_or_none(scenes, tmp_path, told):
    options = {"scene": scenes["refined"], "folder": str(tmp_path), "format": "nerfstudio"}
    counting = told()
    run_stage("exportcameras", {**options, "folder": str(tmp_path / "count")}, counting)
    with pytest.raises(Cancelled):
        run_stage("exportcameras", {**options, "folder": str(tmp_path / "c")}, told(cancel_at=counting.checks // 2))
    assert list((tmp_path / "c").iterdir()) == []  # some were whole already
    assert not any(path.name.startswith(".c") for path in tmp_path.iterdir())


def test_a_failure_leaves_the_earlier_export_as_it_was(scenes, tmp_path, told, monkeypatch):
    from repm_qgis.stages import exportcameras

    options = {"scene": scenes["refined"], "folder": str(tmp_path), "format": "mvsnet", "tile": TILE}
    run_stage("exportcameras", options, told())
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def full(*arguments):
        raise WorkspaceError("Cannot write: no space left on device. Is the disk full?")

    monkeypatch.setattr(exportcameras, "write_text", full)
    with pytest.raises(WorkspaceError, match="no space"):
        run_stage("exportcameras", options, told())
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_nothing_of_others_is_replaced(scenes, tmp_path, told):
    options = {"scene": scenes["refined"], "folder": str(tmp_path), "format": "nerfstudio", "tile": TILE}
    (tmp_path / TILE).mkdir()
    (tmp_path / TILE / "thesis.txt").write_text("mine")
    with pytest.raises(WorkspaceError, match="choose another FOLDER"):
        run_stage("exportcameras", options, told())
    assert (tmp_path / TILE / "thesis.txt").read_text() == "mine"
    run_stage("exportcameras", {**options, "folder": str(tmp_path / "x")}, told())
    with pytest.raises(WorkspaceError, match="no export for mvsnet"):
        run_stage("exportcameras", {**options, "folder": str(tmp_path / "x"), "format": "mvsnet"}, told())


@needs_pycolmap_4
def test_what_cannot_be_exported_is_said(scenes, tmp_path, told, monkeypatch):
    options = {"scene": scenes["refined"], "folder": str(tmp_path / "never")}
    with pytest.raises(SceneError, match="run 'Refine the images' first"):
        run_stage("exportcameras", {**options, "scene": scenes["fitted"]}, told())
    with pytest.raises(OptionError, match="must be one of r000c000, "):
        run_stage("exportcameras", {**options, "tile": "Z9"}, told())
    with pytest.raises(OptionError, match="FORMAT"):
        run_stage("exportcameras", {**options, "format": "bundler"}, told())
    with pytest.raises(OptionError, match="must be 8 for whutlc"):
        run_stage("exportcameras", {**options, "format": "whutlc", "bits": "16"}, told())
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingPackageError, match="pycolmap"):
        run_stage("exportcameras", options, told())
    assert not (tmp_path / "never").exists()


def test_jitter_is_in_the_cameras_by_its_mean_alone(scenes, tmp_path, told):
    scene = Scene.load(scenes["rebuilt"])
    view, tile = scene.views[0], next(tile for tile in scene.tiles if tile.id == TILE)
    level = np.tile([0.7, -0.4], (8, 1))  # waves that are the same in all lines move the camera by so much
    moved = view.with_pointing(view.pointing, Jitter(0.0, view.height - 1.0, level))
    shaken = replace(scene, views=(moved, *scene.views[1:]))
    steady, found = (tile_model(each, tile, False).views[0].shift_px for each in (scene, shaken))
    assert np.abs(found - steady - level[0]).max() < 0.02
    said = told()
    path = shaken.save(str(tmp_path / "shaken.json"))
    run_stage("exportcameras", {"scene": path, "folder": str(tmp_path / "x"), "tile": TILE, "format": "mvsnet"}, said)
    assert [text for text in said.warnings if "cannot hold the jitter of img_01, waves of up to 0.81 px" in text]


def test_mirrored_cameras_are_turned_round(scenes, ground):
    """A negative focal length (an image that is mirrored against a right-handed camera) becomes a positive one."""
    from dataclasses import replace

    scene = Scene.load(scenes["refined"])
    tile = next(tile for tile in scene.tiles if tile.id == TILE)
    tile_view = tile.views["img_01"]
    mirror = np.diag([1.0, -1.0, 1.0])
    camera = tile_view.refined.camera
    mirrored = type(camera)(camera.K @ mirror, mirror @ camera.R, mirror @ camera.t)
    tile_view = replace(tile_view, refined=replace(tile_view.refined, camera=mirrored))
    tile = replace(tile, views={**tile.views, "img_01": tile_view})
    np.testing.assert_allclose(tile_view.refined.camera.project(ground[1]), camera.project(ground[1]), atol=1e-6)
    for view in (tile_model(scene, tile).views[0], tile_model(scene, tile).views[0].centred()):
        assert view.camera.K[0, 0] > 0 and view.camera.K[1, 1] > 0 and view.source == ""
        original = view.to_original(view.camera.project(ground[1]))
        assert np.abs(original - scene.view("img_01").project(ground[0])).max() < view.error.max + 1e-3


def test_a_raster_is_closed_before_it_is_removed(tmp_path, write_image, monkeypatch):
    """Windows removes no open file."""
    plain, alive, closed = tmp_path / "a.png.tif", [], []
    write_image(plain, np.full((8, 8), 9, np.uint8))
    last, unlink = images.opened, os.unlink

    @contextmanager
    def noted(path):
        with last(path) as dataset:
            alive.append(weakref.ref(dataset))
            yield dataset

    monkeypatch.setattr(images, "opened", noted)

    def removed(path, **named):
        if path == str(plain):
            closed.append(alive[0]() is None)
        unlink(path, **named)

    monkeypatch.setattr(images.os, "unlink", removed)
    images.encode(str(plain), tmp_path / "a.png")
    assert closed == [True] and not plain.exists() and (tmp_path / "a.png").exists()
