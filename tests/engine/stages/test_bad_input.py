"""Bad input gets one clear sentence that names file, value and remedy, and leaves nothing half-written."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal, ogr

from repm_qgis.contracts.errors import (
    EmptyResultError,
    ImageError,
    OptionError,
    OverlapError,
    RepmError,
    RpcInvalidError,
    RpcMissingError,
    SceneError,
    SceneVersionError,
    WorkspaceError,
)
from repm_qgis.geometry.frames import projected_from_geodetic
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage

ROOT = Path(__file__).resolve().parents[3]


class Bench:
    """A workspace and a pipeline that is expected to fail in it."""

    def __init__(self, folder, urban, write_image, told):
        self.folder, self.urban, self._write, self._told = folder, urban, write_image, told
        self.workspace, self.output = str(folder / "ws"), str(folder / "dsm.tif")

    def image(self, name, index=1, change=None, rpc=None, tags=None, nodata=None):
        """A changed copy of one of the town's images."""
        dataset = gdal.Open(self.urban.images[index])
        pixels = dataset.ReadAsArray()
        dataset = None
        pixels = pixels if change is None else change(pixels)
        return self._write(self.folder / name, pixels, rpc or self.urban.views[index].rpc, tags, nodata)

    def fails(self, kind, stage="pipeline", **options):
        """The sentence of the one error that the stage raises."""
        defaults = {"images": self.urban.images[:2], "workspace": self.workspace, "output": self.output}
        wanted = {**defaults, **options} if stage == "pipeline" else options
        said = self._told()
        with pytest.raises(RepmError) as caught:
            run_stage(stage, wanted, said)
        assert type(caught.value) is kind, caught.value
        text = str(caught.value)
        assert "\n" not in text and text.endswith(".") and 30 < len(text) < 900
        assert not os.path.exists(self.output)
        assert not [path for path in self.folder.rglob("*") if ".part" in path.name]
        return text


@pytest.fixture
def bench(tmp_path, urban, write_image, told):
    return Bench(tmp_path, urban, write_image, told)


def test_an_image_without_rpc(bench, tmp_path, write_image):
    path = write_image(tmp_path / "plain.tif", np.ones((200, 200), np.uint16))
    text = bench.fails(RpcMissingError, images=[bench.urban.images[0], path])
    for words in (path, "Looked in", ".RPB", "_RPC.TXT", "Put the vendor's RPC file into the image's folder"):
        assert words in text
    assert not os.path.exists(os.path.join(bench.workspace, "scene.json"))


def test_a_projected_product(bench, tmp_path, write_image):
    path = write_image(tmp_path / "ortho.tif", np.ones((200, 200), np.uint16), crs="EPSG:32631")
    text = bench.fails(RpcMissingError, images=[bench.urban.images[0], path])
    assert path in text and "already projected" in text and "order the Basic, Sensor or Primary level" in text


def test_one_image_only(bench):
    text = bench.fails(OptionError, images=bench.urban.images[:1])
    assert "IMAGES" in text and "img_01.tif" in text and "at least two images: one image has no heights" in text
    assert "must not name the same image twice" in bench.fails(OptionError, images=[bench.urban.images[0]] * 2)
    assert not os.path.exists(bench.workspace)


def test_one_image_twice_under_two_names(bench):
    other = bench.image("copy.tif", 0)
    text = bench.fails(OverlapError, images=[bench.urban.images[0], other])
    assert "All images are copies of" in text and "choose another image" in text


def test_images_that_do_not_overlap(bench):
    rpc = bench.urban.views[1].rpc
    away = rpc.__class__(**{**rpc.to_mapping(), "lon_off": rpc.lon_off + 0.5})
    text = bench.fails(OverlapError, images=[bench.urban.images[0], bench.image("away.tif", rpc=away)])
    for words in ("do not overlap", "img_01", "away", f"{away.lon_off:.4f}", "Choose images of one place"):
        assert words in text


def test_an_extent_outside(bench):
    text = bench.fails(OverlapError, extent=[10.0, 50.0, 10.1, 50.1])
    assert "EXTENT" in text and "lies outside" in text and "Draw it there, or leave it empty" in text
    assert "EPSG:4326" in text and "x 1.43" in text and "y 43.59" in text  # where it should lie, in its own CRS


@pytest.mark.parametrize("extent", ([-180.0, -90.0, 180.0, 90.0], [-60.0, 0.0, 60.0, 80.0]))
def test_an_extent_of_the_whole_earth_is_no_limit(bench, tmp_path, extent):
    """It "lay outside", because the scene's CRS has no place for what is so far away."""
    images = list(bench.urban.images[:2])
    found = []
    for name, more in (("without", {}), ("with", {"extent": extent})):
        made = run_stage("epmfit", {"images": images, "workspace": str(tmp_path / name), **more}, Silent())
        found.append(ogr.CreateGeometryFromWkt(Scene.load(made.scene).area))
    assert found[0].SymDifference(found[1]).GetArea() < 1e-3 * found[0].GetArea()


@pytest.mark.parametrize(
    "extent, words",
    (
        ([1.0, 43.0, 1.0, 44.0], "xmin < xmax"),
        ([1.0, 43.0, 1.1], "must have 4 entries"),
        ([float("nan"), 43.0, 1.1, 44.0], "entry 0 of it must be finite"),
    ),
)
def test_extents_that_are_none(bench, extent, words):
    assert words in bench.fails(OptionError, extent=extent)


def test_an_extent_in_an_absurd_crs(bench):
    text = bench.fails(OptionError, extent=[1.0, 43.0, 1.1, 44.0], extent_crs="EPSG:nonsense")
    assert "EXTENT" in text


def test_a_truncated_image(bench):
    path = bench.image("cut.tif")
    whole = Path(path).read_bytes()
    Path(path).write_bytes(whole[: len(whole) // 2])
    text = bench.fails(ImageError, images=[bench.urban.images[0], path])
    assert path in text and ("cut short" in text or "Cannot open" in text) and "again" in text


def test_a_nodata_only_image(bench):
    path = bench.image("empty.tif", change=lambda p: p * 0, nodata=0)
    text = bench.fails(ImageError, images=[bench.urban.images[0], path])
    assert path in text and "only nodata" in text and "choose another image" in text


def test_a_constant_image(bench):
    path = bench.image("flat.tif", change=lambda p: p * 0 + 321)
    text = bench.fails(ImageError, images=[bench.urban.images[0], path])
    assert path in text and "321" in text and "nothing to match" in text


def test_images_of_different_places_under_one_rpc(bench):
    """RPCs that say overlap, and images that share nothing: counts of tie points, no DSM of noise."""
    numbers = np.random.default_rng(0)
    path = bench.image("noise.tif", change=lambda p: numbers.integers(100, 900, p.shape).astype(np.uint16))
    text = bench.fails(EmptyResultError, images=[bench.urban.images[0], path])
    assert "tie points" in text and re.search(r"only \d+ consistent tie points", text) and "noise" in text


@pytest.mark.parametrize(
    "key, value, words",
    (
        ("LINE_SCALE", "0", "scale"),
        ("LAT_OFF", "nan", "nan"),
        ("SAMP_NUM_COEFF", " ".join(["nan"] * 20), "finite"),
        ("HEIGHT_SCALE", "0", "scale"),
    ),
)
def test_rpcs_that_cannot_be(bench, key, value, words):
    tags = {**rpc_tags(bench.urban.views[1].rpc), key: value}
    path = bench.image("bad.tif", tags=tags)
    text = bench.fails(RpcInvalidError, images=[bench.urban.images[0], path])
    assert path in text and words in text and "Get the file again" in text


def test_an_unwritable_workspace(bench, tmp_path):
    (tmp_path / "file").write_text("")
    for workspace in (str(tmp_path / "file" / "ws"), "Q:\\nowhere\\ws" if os.name == "nt" else "/proc/nowhere/ws"):
        text = bench.fails(WorkspaceError, workspace=workspace)
        assert workspace in text and "choose another" in text


def test_an_unwritable_output(bench, tmp_path):
    (tmp_path / "file").write_text("")
    output = str(tmp_path / "file" / "dsm.tif")
    text = bench.fails(WorkspaceError, output=output)
    assert str(tmp_path / "file") in text


def test_a_scene_of_a_newer_schema(bench, tmp_path):
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({"format": "repm-scene", "schema": 99}))
    other = str(tmp_path / "other.json")
    for stage, options in (
        ("refine", {"output_scene": other}),
        ("reconstruct", {"output_scene": other}),
        ("dsmfuse", {"output": bench.output}),
        ("errormap", {"output": bench.output}),
    ):
        text = bench.fails(SceneVersionError, stage, scene=str(path), **options)
        assert str(path) in text and "schema 99" in text and "update the plugin" in text
    assert sorted(os.listdir(tmp_path)) == ["scene.json"]


def test_a_workspace_with_a_scene_of_a_newer_schema_is_not_overwritten(bench):
    os.makedirs(bench.workspace)
    path = Path(bench.workspace) / "scene.json"
    path.write_text(json.dumps({"format": "repm-scene", "schema": 99}))
    assert "schema 99" in bench.fails(SceneVersionError)
    assert json.loads(path.read_text())["schema"] == 99


def test_stages_in_the_wrong_order(bench, urban, told):
    fitted = run_stage(
        "epmfit",
        {"images": urban.images[:2], "workspace": bench.workspace, "altitude_min": 150.0, "altitude_max": 260.0},
        told(),
    ).scene
    text = bench.fails(SceneError, "dsmfuse", scene=fitted, output=bench.output)
    assert fitted in text and "no height maps" in text
    text = bench.fails(SceneError, "errormap", scene=fitted, output=bench.output, view="nadir")
    assert "nadir" in text and "img_01, img_02" in text
    text = bench.fails(OptionError, "errormap", scene=fitted, output=bench.output, altitude=5000.0)
    assert "ALTITUDE is 5000.0" in text and "150 to 260 m" in text


@pytest.mark.parametrize("cloud", ("points.e57", "points", "points.laz.gz"))
def test_a_cloud_of_another_format_is_refused_before_the_work(bench, tmp_path, cloud):
    text = bench.fails(OptionError, cloud=str(tmp_path / cloud))
    assert "CLOUD" in text and cloud in text and ".laz, .las or .ply" in text
    assert not os.path.exists(os.path.join(bench.workspace, "reconstructed.json"))


def test_a_mesh_of_another_format_and_a_folder_in_use_are_refused_before_the_work(bench, tmp_path):
    text = bench.fails(OptionError, mesh=str(tmp_path / "mesh.stl"))
    assert "MESH" in text and "mesh.stl" in text and "must end with .ply" in text
    assert "MESH_VERTICES is -1" in bench.fails(OptionError, mesh_vertices=-1)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").touch()
    text = bench.fails(WorkspaceError, ept=str(tmp_path / "photos"))
    assert "photos" in text and "cat.jpg" in text
    assert not os.path.exists(os.path.join(bench.workspace, "reconstructed.json"))


@pytest.mark.parametrize(
    "crs, words",
    (
        ("EPSG:nonsense", "not a coordinate reference system that PROJ knows"),
        ("EPSG:4326", "projected"),
        ("EPSG:2263", "metres"),
        ("EPSG:32631+5773", "vertical"),
        ("EPSG:3031", "such as EPSG:32631"),
        ("+proj=ortho +lat_0=-43 +lon_0=-178 +datum=WGS84 +units=m", "such as EPSG:32631"),
        ("+proj=laea +lat_0=-43.6 +lon_0=-178.56 +datum=WGS84", "such as EPSG:32631"),
    ),
)
def test_absurd_crss(bench, crs, words):
    """Unknown, geographic, in feet, with a vertical part, or of another part of the world."""
    text = bench.fails(OptionError, crs=crs)
    assert "CRS" in text and words in text
    assert not os.path.exists(os.path.join(bench.workspace, "reconstructed.json"))


@pytest.mark.parametrize(
    "options, words",
    (
        ({"altitude_min": 300.0, "altitude_max": 200.0}, "must be below ALTITUDE_MAX"),
        ({"resolution": -1.0}, "RESOLUTION"),
        ({"tile_size": 10}, "TILE_SIZE"),
        ({"model": "spline"}, "MODEL"),
        ({"backend": "magic"}, "BACKEND"),
        ({"method": "mode"}, "METHOD"),
        ({"outlier_radius": float("nan")}, "OUTLIER_RADIUS"),
        ({"workers": -1}, "WORKERS"),
        ({"paint": "red"}, "not an option of this stage"),
        ({"workspace": ""}, "WORKSPACE"),
        ({"output": ""}, "OUTPUT"),
        ({"error_budget": 0}, "ERROR_BUDGET"),
        ({"window_radius": 0}, "WINDOW_RADIUS"),
        ({"window_radius": 2.5}, "WINDOW_RADIUS"),
        ({"gpu_memory": -1}, "GPU_MEMORY"),
    ),
)
def test_options_out_of_bounds(bench, options, words):
    assert words in bench.fails(OptionError, **options)
    assert not os.path.exists(bench.workspace)


def test_altitudes_where_nothing_is(bench):
    """Far above the town: matching finds nothing, and says so with numbers."""
    with pytest.raises(RepmError) as caught:
        run_stage(
            "pipeline",
            {
                "images": bench.urban.images[:2],
                "workspace": bench.workspace,
                "output": bench.output,
                "altitude_min": 1500.0,
                "altitude_max": 1600.0,
            },
            bench._told(),
        )
    assert isinstance(caught.value, (EmptyResultError, OverlapError)) and re.search(r"\d", str(caught.value))
    assert not os.path.exists(bench.output)


def test_a_dem_that_does_not_cover(bench, mountains):
    text = bench.fails(OverlapError, dem=mountains.truth)
    assert mountains.truth in text and "leave DEM empty" in text


@pytest.mark.parametrize("package, stage", (("cv2", "reconstruct"), ("pyproj", "epmfit")))
def test_a_missing_wheel(tmp_path, urban, told, package, stage):
    """The engine's command line with an import that is blocked: code 1, the package, and what installs it."""
    options = {"images": urban.images[:2], "workspace": str(tmp_path / "ws")}
    if stage == "reconstruct":
        fitted = run_stage("epmfit", {**options, "altitude_min": 150.0, "altitude_max": 260.0}, told()).scene
        options = {"scene": fitted, "output_scene": str(tmp_path / "out.json")}
    (tmp_path / "job.json").write_text(json.dumps(options))
    code = (
        f"import sys; sys.modules[{package!r}] = None; "
        "from repm_qgis.engine_process import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, stage, str(tmp_path / "job.json")],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        check=False,
    )
    assert done.returncode == 1 and "Traceback" not in done.stdout + done.stderr
    last = json.loads(done.stdout.splitlines()[-1])
    assert (last["type"], last["kind"]) == ("error", "MissingPackageError")
    assert package in last["text"] and "(repm:environment) with INSTALL=true" in last["text"]
    assert not (tmp_path / "out.json").exists()


def test_an_image_of_another_place_changes_nothing_but_a_warning(bench, tmp_path, told):
    """The scene of a pair with it has the same views, CRS, area, altitudes and tiles as that of the pair alone."""
    rpc = bench.urban.views[2].rpc
    abroad = rpc.__class__(**{**rpc.to_mapping(), "lon_off": -47.0, "lat_off": -23.0, "height_off": 3200.0})
    pair, foreign = bench.urban.images[:2], bench.image("abroad.tif", rpc=abroad)
    scenes = []
    for number, images in enumerate((pair, [*pair, foreign], [foreign, *pair])):
        said = told()
        workspace = str(tmp_path / f"w{number}")
        made = run_stage("epmfit", {"images": images, "workspace": workspace, "tile_size": 300}, said)
        document = json.loads(Path(made.scene).read_text())
        scenes.append({key: value for key, value in document.items() if key not in ("folder", "history")})
        assert [text for text in said.warnings if "left out: abroad" in text] == said.warnings[:number] * bool(number)
    assert scenes[0] == scenes[1] == scenes[2] and len(scenes[0]["views"]) == 2


def test_an_extent_chooses_the_place(bench, tmp_path, told):
    """Pairs of two places, an EXTENT over the second in its own CRS: its images are used."""
    move = {"lon_off": -47.0, "lat_off": -23.0}
    rpcs = [view.rpc.__class__(**{**view.rpc.to_mapping(), **move}) for view in bench.urban.views[:2]]
    there = [bench.image(f"there{k}.tif", k, rpc=rpc) for k, rpc in enumerate(rpcs)]
    options = {"images": [*bench.urban.images[:2], *there], "workspace": bench.workspace}
    x, y = projected_from_geodetic("EPSG:32723", np.array([-47.0, -23.0]))
    extent = {"extent": [x - 50, y - 50, x + 50, y + 50], "extent_crs": "EPSG:32723"}
    for chosen, names in (({}, ["img_01", "img_02"]), (extent, ["there0", "there1"])):
        made = run_stage("epmfit", {**options, **chosen}, told())
        assert [view["name"] for view in json.loads(Path(made.scene).read_text())["views"]] == names


def test_altitudes_of_another_place(bench):
    text = bench.fails(OverlapError, altitude_min=7000.0, altitude_max=7200.0)
    assert "share no ground at altitudes of 7000 to 7200 m" in text and "ALTITUDE_MIN" in text


@pytest.mark.long
def test_control_points_of_images_that_are_not_in_the_run(bench, tmp_path, told):
    """A table of three images, a run of two: their measurements count, and the third image's are told."""
    said = told()
    fitted = run_stage("epmfit", {"images": bench.urban.images[:2], "workspace": bench.workspace}, said)
    options = {"scene": fitted.scene, "gcps": bench.urban.made.gcps}
    made = run_stage("reconstruct", {**options, "output_scene": str(tmp_path / "reconstructed.json")}, said)
    pointing = json.loads(Path(made.output_scene).read_text())["pointing"]
    assert pointing["control_noise_px"] is not None and len(pointing["gcps"]) >= 8
    assert [text for text in said.warnings if "(img_03)" in text and "those in img_01, img_02 are used" in text]
    checked = told()
    run_stage("checkgcps", options, checked)
    assert [text for text in checked.warnings if "(img_03)" in text]


def test_a_crop_with_the_rpc_of_its_whole_image(bench, tmp_path):
    """It says where to look first: no cloud made these tie points disagree."""
    whole = [view.rpc for view in bench.urban.views]
    images = [
        bench.image("crop0.tif", 0, lambda pixels: pixels[:240, :240], whole[0]),
        bench.image("crop1.tif", 1, lambda pixels: pixels[160:, 160:], whole[1]),
    ]
    text = bench.fails(EmptyResultError, images=images)
    assert "consistent tie points" in text and "may be that of a larger image" in text
    assert re.search(r"crop1 has 240 x 240 px, its RPC was made for 4\d\d x 4\d\d", text)
