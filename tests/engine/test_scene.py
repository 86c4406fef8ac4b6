"""The scene on disk: there and back, and no to everything that is none."""

from __future__ import annotations

import json
import os
from dataclasses import FrozenInstanceError, replace
from datetime import datetime, timezone

import numpy as np
import pytest

from repm_qgis.contracts.errors import ImageError, RpcInvalidError, SceneError, SceneVersionError, WorkspaceError
from repm_qgis.geometry.jitter import Jitter
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import SCHEMA, Scene, ground_of, load_views, reusable
from repm_qgis.stages import run_stage


@pytest.fixture(scope="module")
def fitted(urban, tmp_path_factory, told):
    """The path of a scene with cameras and refinements."""
    folder = tmp_path_factory.mktemp("fitted")
    result = run_stage(
        "epmfit",
        {"images": urban.images, "workspace": str(folder), "altitude_min": 150.0, "altitude_max": 260.0},
        told(),
    )
    return run_stage(
        "refine",
        {"scene": result.scene, "output_scene": str(folder / "refined.json"), "write_images": False},
        told(),
    ).output_scene


def test_there_and_back_is_the_same_to_the_last_bit(fitted, tmp_path):
    scene = Scene.load(fitted)
    again = Scene.load(scene.save(str(tmp_path / "b.json")))
    assert os.listdir(tmp_path) == ["b.json"]
    first, second = (json.loads(open(path, encoding="utf-8").read()) for path in (fitted, str(tmp_path / "b.json")))
    assert {**first, "folder": ""} == {**second, "folder": ""}
    points = np.random.default_rng(0).uniform(-100, 100, (20, 3))
    for old, new in zip(scene.tiles[0].views.values(), again.tiles[0].views.values()):
        np.testing.assert_array_equal(old.camera.project(points), new.camera.project(points))
        np.testing.assert_array_equal(
            old.refined.to_original.original_from_refined(points[:, :2]),
            new.refined.to_original.original_from_refined(points[:, :2]),
        )
    assert again.views[0].rpc == scene.views[0].rpc and again.fingerprint == scene.fingerprint


def test_what_a_scene_knows(fitted, urban):
    scene = Scene.load(fitted)
    assert [view.name for view in scene.views] == ["img_01", "img_02", "img_03"]
    assert scene.view("img_02").size == (400, 400) and scene.altitudes == (150.0, 260.0)
    assert scene.gsd_m == pytest.approx(0.5, rel=0.15) and scene.crs == urban.crs
    assert [entry.stage for entry in scene.history] == ["epmfit", "refine"]
    assert scene.record_of("epmfit").options["altitude_min"] == 150.0 and scene.record_of("dsmfuse") is None
    with pytest.raises(SceneError) as caught:
        scene.view("img_09")
    assert "img_09" in str(caught.value) and "img_01, img_02, img_03" in str(caught.value)
    again = scene.recorded("refine", "other", {}, 1.0)
    assert [entry.fingerprint for entry in again.history][1:] == ["other"] and again.history[0] == scene.history[0]
    assert again.fingerprint == "other" != scene.fingerprint


def test_times_are_kept_where_there_are_any(fitted, tmp_path):
    scene = Scene.load(fitted)
    assert [view.time for view in scene.views] == [None] * 3
    first = replace(scene.views[0], acquired="2012-02-25T00:24:15.300Z")
    scene = replace(scene, views=(first, *scene.views[1:]))
    path = scene.save(str(tmp_path / "timed.json"))
    again = Scene.load(path)
    assert again.views[0].time == datetime(2012, 2, 25, 0, 24, 15, 300000, tzinfo=timezone.utc)
    assert again.views[0].with_pointing(np.eye(2, 3)).acquired == "2012-02-25T00:24:15.300Z"
    document = json.loads(open(path, encoding="utf-8").read())
    for view, stored in zip(document["views"], ("nonsense", "", "7")):
        view["acquired"] = stored
    (tmp_path / "odd.json").write_text(json.dumps(document))
    assert [view.time for view in Scene.load(str(tmp_path / "odd.json")).views] == [None] * 3
    for view in document["views"]:
        del view["acquired"]
    (tmp_path / "none.json").write_text(json.dumps(document))
    assert [view.acquired for view in Scene.load(str(tmp_path / "none.json")).views] == [""] * 3


def test_times_and_satellites_come_with_the_images(tmp_path, write_image, synthetic_rpc):
    path = write_image(tmp_path / "PHR1B_P_201709281038045_SEN.tif", rpc=synthetic_rpc())
    view = load_views([path])[0]
    assert view.acquired == "2017-09-28T10:38:04.500Z" and view.sensor == "Pleiades 1B"


def test_pointing_moves_pixels_and_localise_undoes_it(fitted):
    view = Scene.load(fitted).views[0]
    moved = view.with_pointing(np.array([[1.0, 1e-4, 2.5], [-2e-4, 1.0, -1.5]]))
    ground = view.rpc.localise(np.array([[10.0, 20.0], [300.0, 200.0]]), 200.0)
    pixels = view.rpc.project(ground)
    expected = pixels @ np.array([[1.0, -2e-4], [1e-4, 1.0]]) + [2.5, -1.5]
    np.testing.assert_allclose(moved.project(ground), expected, atol=1e-9)
    np.testing.assert_allclose(moved.localise(moved.project(ground), 200.0), ground, atol=1e-11)


def test_jitter_comes_on_top_of_the_pointing_and_stays_with_the_scene(fitted, tmp_path):
    scene = Scene.load(fitted)
    view = scene.views[0]
    waves = Jitter(0.0, view.height - 1.0, np.random.default_rng(0).normal(0, 0.3, (8, 2)))
    shaken = view.with_pointing(np.array([[1.0, 1e-4, 2.5], [-2e-4, 1.0, -1.5]]), waves)
    ground = view.rpc.localise(np.array([[10.0, 20.0], [300.0, 200.0]]), 200.0)
    pixels = shaken.project(ground)
    np.testing.assert_allclose(pixels - waves.at(pixels[:, 1]), shaken.steady.project(ground), atol=1e-9)
    np.testing.assert_allclose(shaken.localise(pixels, 200.0), ground, atol=1e-11)
    path = replace(scene, views=(shaken, *scene.views[1:])).save(str(tmp_path / "shaken.json"))
    np.testing.assert_array_equal(Scene.load(path).views[0].project(ground), pixels)
    assert shaken.with_pointing(view.pointing).jitter is None and scene.views[1].jitter is None


@pytest.mark.parametrize(
    "change, words",
    (
        (lambda d: d.pop("views"), "damaged"),
        (lambda d: d.pop("tiles"), "damaged"),
        (lambda d: d["views"][0].pop("rpc"), "damaged"),
        (lambda d: d.update(tiles=5), "damaged"),
        (lambda d: d["views"][0]["rpc"].update(row_scale=0), "row scale is 0"),
        (lambda d: d["views"][0].update(width="wide"), "damaged"),
        (lambda d: d["views"][0].update(band=float("inf")), "damaged"),
        (lambda d: d["tiles"][0].update(views=[1]), "damaged"),
        (lambda d: d["views"][0].update(acquired=None), "damaged"),
        (lambda d: d.update(altitudes=None), "damaged"),
        (lambda d: d["history"][0].pop("fingerprint"), "damaged"),
        (lambda d: next(iter(d["tiles"][0]["views"].values())).update(window=[float("inf")] * 4), "damaged"),
        (
            lambda d: next(iter(d["tiles"][0]["views"].values()))["refined"]["to_original"].update(kind="spline"),
            "spline",
        ),
        (lambda d: d.update(frame=[]), "damaged"),
        (lambda d: d.update(format="other"), "is not a REPM scene"),
    ),
)
def test_damaged_scenes(fitted, tmp_path, change, words):
    document = json.loads(open(fitted, encoding="utf-8").read())
    change(document)
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(document))
    with pytest.raises(SceneError) as caught:
        Scene.load(str(path))
    assert str(path) in str(caught.value) and words in str(caught.value)
    assert "Fit " in str(caught.value)  # the algorithm that makes a new one


@pytest.mark.parametrize(
    "text",
    ("", "{", "[1, 2]", "null", "3", '{"format": "repm-scene", "schema": ', "[" * 100000),
    ids=range(7),  # Windows cannot have the last one as a name
)
def test_files_that_are_no_scene(tmp_path, text):
    path = tmp_path / "scene.json"
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        Scene.load(str(path))
    assert str(path) in str(caught.value)
    assert reusable(str(path), "epmfit", "key") is None


def test_other_files(tmp_path, urban):
    for path in (str(tmp_path / "gone.json"), str(tmp_path), urban.images[0]):
        with pytest.raises(SceneError) as caught:
            Scene.load(path)
        assert path in str(caught.value)
    binary = tmp_path / "b.json"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(SceneError):
        Scene.load(str(binary))


def test_a_newer_schema_has_its_own_error_and_is_not_overwritten(fitted, tmp_path):
    document = json.loads(open(fitted, encoding="utf-8").read())
    path = tmp_path / "scene.json"
    for schema in (SCHEMA + 1, 99):
        document["schema"] = schema
        path.write_text(json.dumps(document))
        with pytest.raises(SceneVersionError) as caught:
            Scene.load(str(path))
        for words in (str(path), f"schema {schema}", f"up to {SCHEMA}", "update the plugin"):
            assert words in str(caught.value)
        with pytest.raises(SceneVersionError):
            reusable(str(path), "refine", document["history"][-1]["fingerprint"])


def test_a_scene_of_an_older_schema_is_made_again(fitted, tmp_path):
    document = json.loads(open(fitted, encoding="utf-8").read())
    document["schema"] = SCHEMA - 1
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(document))
    with pytest.raises(SceneError, match=f"schema {SCHEMA - 1} of an earlier version.*make the scene again"):
        Scene.load(str(path))
    assert reusable(str(path), "refine", document["history"][-1]["fingerprint"]) is None


def test_nothing_changes_a_scene_in_place(fitted):
    scene = Scene.load(fitted)
    tile = scene.tiles[0]
    for part, name in (
        (scene, "views"),
        (scene.views[0], "pointing"),
        (tile, "heights"),
        (tile.views["img_01"], "image"),
    ):
        with pytest.raises(FrozenInstanceError):
            setattr(part, name, ())


def test_reuse_asks_for_the_last_stage_and_its_fingerprint(fitted):
    scene = Scene.load(fitted)
    assert reusable(fitted, "refine", scene.fingerprint) is not None
    assert reusable(fitted, "refine", "x") is None and reusable(fitted, "epmfit", scene.fingerprint) is None
    assert reusable(fitted + "gone", "refine", scene.fingerprint) is None


def test_saving_where_it_cannot_be(fitted, tmp_path):
    (tmp_path / "a file").write_text("")
    with pytest.raises(WorkspaceError, match="a file"):
        Scene.load(fitted).save(str(tmp_path / "a file" / "scene.json"))


def test_views_of_the_same_name_are_told_apart(tmp_path, urban, write_image):
    paths = []
    for number, view in enumerate(urban.views):
        (tmp_path / str(number)).mkdir()
        paths.append(write_image(tmp_path / str(number) / "img.tif", rpc=view.rpc))
    names = [view.name for view in load_views(tuple(paths))]
    assert names[0] == "img" and len(set(names)) == 3


def test_images_that_are_too_small_or_not_where_their_rpc_is(tmp_path, urban, write_image):
    rpc = urban.views[0].rpc
    with pytest.raises(ImageError) as caught:
        load_views((write_image(tmp_path / "small.tif", np.ones((60, 200), np.uint16), rpc),))
    assert "small.tif" in str(caught.value) and "200 x 60 px" in str(caught.value)
    far = rpc.shifted(1e8, 1e8)
    with pytest.raises(RpcInvalidError) as caught:
        load_views((write_image(tmp_path / "far.tif", rpc=far),))
    assert "far.tif" in str(caught.value)
    microscope = rpc.__class__(
        **{**rpc.to_mapping(), "lat_scale": rpc.lat_scale / 1e4, "lon_scale": rpc.lon_scale / 1e4}
    )
    with pytest.raises(RpcInvalidError, match="micro.tif.*(no satellite image|cannot be used)"):
        load_views((write_image(tmp_path / "micro.tif", rpc=microscope),))


# --- what an edited scene may not do --------------------------------------------------------------------------------

HOSTILE_NAMES = (
    "../../x", "..", ".", "", "a/b", "/etc/x", "..\\x", "a\\b", "C:x", "C:\\x", "\0", "a\0b", "a\nb", "CON", "nul.txt",
    "x" * 300, "é" * 200, "end.", "end ", "a?b", "\ud800",
)  # fmt: skip


def renamed(document, old, new):
    """The document with a view's name changed wherever it stands, as a careful attacker would."""
    return json.loads(json.dumps(document).replace(json.dumps(old), json.dumps(new)))


def refused(tmp_path, document):
    path = tmp_path / "edited.json"
    path.write_text(json.dumps(document))
    with pytest.raises(SceneError) as caught:
        Scene.load(str(path))
    assert str(caught.value).startswith(f"The scene '{path}' is damaged (") and "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_names_that_would_lead_elsewhere_are_refused(fitted, tmp_path, name):
    document = json.loads(open(fitted, encoding="utf-8").read())
    said = refused(tmp_path, renamed(document, "img_01", name))
    assert "views.0.name is " in said and "must be a" in said and len(said) < 400
    document["tiles"][0]["id"] = name
    assert "tiles.0.id is " in refused(tmp_path, document)


@pytest.mark.parametrize(
    "name", ("a b", "Bär", "x=1", "it's", "a&b", "-v", ".hidden", "100%", "x" * 240, "日本", "CONE")
)
def test_names_of_real_images_are_kept(fitted, tmp_path, write_image, urban, name):
    document = json.loads(open(fitted, encoding="utf-8").read())
    (tmp_path / "s.json").write_text(json.dumps(renamed(document, "img_01", name)))
    assert Scene.load(str(tmp_path / "s.json")).views[0].name == name
    image = write_image(tmp_path / f"{name}.tif", rpc=urban.views[0].rpc)
    assert [view.name for view in load_views([image])] == [name]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such files")
@pytest.mark.parametrize("stem, name", (("a:b", "a_b"), ("a\\b", "a_b"), ("con", "con_"), ("a\nb", "a_b"), ("..", "_")))
def test_images_get_names_that_every_system_takes(fitted, tmp_path, write_image, urban, stem, name):
    image = write_image(tmp_path / f"{stem}.tif", rpc=urban.views[0].rpc)
    assert [view.name for view in load_views([image])] == [name]
    document = json.loads(open(fitted, encoding="utf-8").read())
    (tmp_path / "s.json").write_text(json.dumps(renamed(document, "img_01", name)))
    assert Scene.load(str(tmp_path / "s.json")).views[0].name == name


def first_view(document):
    return next(iter(document["tiles"][0]["views"].values()))


@pytest.mark.parametrize(
    "change, words",
    (
        (
            lambda d: d["views"][0].update(width=0),
            "views.0.width is 0: it must be a whole number between 1 and 1000000",
        ),
        (lambda d: d["views"][0].update(band=-1), "views.0.band is -1"),
        (lambda d: d["views"][0].update(pointing=[[1, 0], [0, 1]]), "views.0.pointing"),
        (lambda d: d["views"][0].update(pointing=[[0, 0, 0], [0, 0, 0]]), "too large for a correction"),
        (lambda d: d["views"][0]["rpc"].update(row_num=[1.0] * 19), "row_num has 19 coefficients"),
        (lambda d: d["views"][1].update(name="img_01"), "distinct names"),
        (lambda d: d.update(altitudes=[300, 200]), "two numbers, the smaller one first, between -22000 and 20000 m"),
        (lambda d: d.update(altitudes=[0, 1e6]), "two numbers, the smaller one first"),
        (lambda d: d["frame"].update(lat=91), "frame.lat is 91"),
        (lambda d: d.update(crs="EPSG:4326"), "projected CRS"),
        (lambda d: d.update(crs="nonsense"), "coordinate reference system"),
        (lambda d: d.update(area="POLYGON EMPTY"), "area is 'POLYGON EMPTY'"),
        (lambda d: d.update(order=9), "order is 9"),
        (lambda d: d.update(refinement="bent"), "refinement is 'bent'"),
        (lambda d: d.update(refinement="terrain"), "no surface"),
        (lambda d: d.update(tie_points="/vsicurl/http://127.0.0.1/t.gpkg"), "a file on this machine"),
        (lambda d: d.update(surface="<VRTDataset/>"), "a file on this machine"),
        (lambda d: d["tiles"][0].update(bounds=[2, 0, 1, 1]), "xmin < xmax"),
        (lambda d: d["tiles"][0].update(bounds=[0, 0, 1e6, 1e6]), "larger than its images"),
        (lambda d: first_view(d).update(window=[0, 0, 100, 401]), "outside the view 'img_01' of 400 x 400 px"),
        (lambda d: first_view(d)["camera"].update(K=[[1, 0, 0]]), "camera.K"),
        (lambda d: first_view(d)["camera"].update(R=[[1, 0, 0], [0, 1, 0], [0, 0, 2]]), "not a rotation"),
        (lambda d: first_view(d)["refined"]["to_original"].update(order=3), "order 3 has 10"),
        (lambda d: first_view(d)["refined"]["to_original"].update(order=20), "order is 20"),
        (
            lambda d: first_view(d)["refined"]["error"].update(rmse="0"),
            "refined.error.rmse is '0': it must be a number",
        ),
        (
            lambda d: d["tiles"][0]["views"].update(img_09=first_view(d)),
            "a view 'img_09', which the scene does not have",
        ),
        (lambda d: d["tiles"].append(d["tiles"][0]), "two tiles of the same name"),
        (lambda d: d.update(pairs=[PAIR]), "a pair img_01, img_09"),
        (lambda d: d["tiles"][0].update(heights=[HEIGHTS]), "a height map of the tile"),
        (lambda d: d.update(pairs=[{**PAIR, "second": "img_02", "base_to_height": 0}]), "a number between 1e-06"),
        (lambda d: d["tiles"][0].update(heights=[UNKNOWN]), "height maps of the backend 'other', which this version"),
        (lambda d: d["history"][0]["options"].update(deep=json.loads("[" * 80 + "]" * 80)), "nested"),
    ),
)
def test_values_that_no_scene_of_ours_has(fitted, tmp_path, change, words):
    document = json.loads(open(fitted, encoding="utf-8").read())
    change(document)
    assert words in refused(tmp_path, document)


PAIR = {"first": "img_01", "second": "img_09", "angle_deg": 20.0, "base_to_height": 0.3, "tiles": 1}
HEIGHTS = {
    "tile": "r000c000", "backend": "sgm", "pair": ["img_01", "img_09"], "metres_per_px": 1.0, "altitudes": [0, 100],
    "vertical_parallax_px": 0.1, "table_error_m": 0.0,
}  # fmt: skip
UNKNOWN = {**HEIGHTS, "backend": "other", "pair": ["img_01", "img_02"]}


def test_a_scene_without_views_shows_no_ground(fitted, tmp_path):
    document = json.loads(open(fitted, encoding="utf-8").read())
    document["views"] = []
    (tmp_path / "scene.json").write_text(json.dumps(document))
    assert ground_of(str(tmp_path / "scene.json")) is None
    with pytest.raises(SceneError, match="has no views, or views without distinct names"):
        run_stage("dsmfuse", {"scene": str(tmp_path / "scene.json"), "output": str(tmp_path / "dsm.tif")}, Silent())
