"""Ortho-ready images through the stages: a truth scene whose images GDAL has projected to a map at one height."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.rpc.writers import rpb_text
from repm_qgis.scene import Scene, load_views
from repm_qgis.stages import run_stage

HEIGHT = 1000.0  # of the plane: the ground lies around 950 m


def project(view, path, crs, height, cell):
    """An image as its vendor would project it: at one height, with the sensor's RPC beside it."""
    options = {"dstSRS": crs, "rpc": True, "transformerOptions": [f"RPC_HEIGHT={height}"], "xRes": cell, "yRes": cell}
    gdal.Warp(str(path), view.image, **options, resampleAlg="cubic", errorThreshold=0, dstNodata=0)
    Path(path).with_suffix(".RPB").write_text(rpb_text(view.rpc))
    return str(path)


@pytest.fixture(scope="module")
def projected(mountains, tmp_path_factory):
    """The mountains' images as an ortho-ready product without metadata."""
    folder = tmp_path_factory.mktemp("projected")
    return [project(view, folder / f"{view.name}.tif", mountains.crs, HEIGHT, 1.0) for view in mountains.views]


@pytest.fixture(scope="module")
def delivered(projected, tmp_path_factory):
    """The same with the vendor's metadata."""
    folder = tmp_path_factory.mktemp("delivered")
    for path in projected:
        for end in (".tif", ".RPB"):
            shutil.copy(Path(path).with_suffix(end), folder)
        text = f'\timageDescriptor = "ORStandard2A";\n\tterrainHAE = {HEIGHT:.2f};\n'
        (folder / f"{Path(path).stem}.IMD").write_text(text)
    return [str(folder / Path(path).name) for path in projected]


def differences(path, scene):
    """What a DSM is above the truth where both are known."""
    dataset = gdal.Open(str(path))
    heights, (x, cell, _, y, _, _) = dataset.ReadAsArray().astype(float), dataset.GetGeoTransform()
    dataset = None  # noqa: F841
    west, south, east, north = scene.bounds
    rows, columns = scene.surface.shape
    at_x = west + (np.arange(columns) + 0.5) * (east - west) / columns
    at_y = north - (np.arange(rows) + 0.5) * (north - south) / rows
    col, row = np.floor((at_x - x) / cell).astype(int), np.floor((y - at_y) / cell).astype(int)
    found = heights[np.ix_(row, col)] - scene.surface
    return found[np.abs(found) < 1000]


def nmad(values):
    return 1.4826 * np.median(np.abs(values - np.median(values)))


@pytest.mark.slow
def test_the_dsm_is_that_of_the_sensors_images(mountains, mountains_run, delivered, tmp_path, told):
    said = told()
    # Fails without the model of ortho-ready images: their RPCs see other pixels.
    options = {"images": delivered, "workspace": str(tmp_path / "ws"), "output": str(tmp_path / "dsm.tif")}
    run_stage("pipeline", {**options, "resolution": 1.0, "workers": 1}, said)
    assert sum("1000.00 m above the ellipsoid ('img_0" in note for note in said.notes) == 3
    sensor, ortho = (differences(path, mountains) for path in (mountains_run.options["output"], options["output"]))
    assert abs(nmad(ortho) - nmad(sensor)) < 0.05, "m: it was 0.597 and 0.604"
    assert abs(np.median(ortho) - np.median(sensor)) < 0.1
    assert len(ortho) > 0.98 * len(sensor)


def test_a_wrong_height_moves_all_heights_by_as_much_and_nothing_else(projected):
    right, wrong = (load_views(projected, height=height) for height in (HEIGHT, HEIGHT + 50.0))
    pixels = np.random.default_rng(4).uniform(100, 350, (50, 2))
    ground = right[0].localise(pixels, 950.0)
    seen = [view.project(ground) for view in right]
    lifted = ground + [0.0, 0.0, 50.0]
    for view, pixel in zip(wrong, seen):
        assert np.abs(view.project(lifted) - pixel).max() < 0.02, "px: the same place, 50 m higher"


@pytest.mark.long
def test_a_dem_tells_the_height(mountains, projected, tmp_path, told):
    said = told()
    options = {"images": projected, "workspace": str(tmp_path), "dem": mountains.truth}
    run_stage("epmfit", options, said)
    planes = [view.plane for view in Scene.load(str(tmp_path / "scene.json")).views]
    # The RPCs are wrong by some pixels, as vendors' are, which is metres of height.
    assert all(abs(plane.height - HEIGHT) < 5.0 and plane.source == "DEM" for plane in planes)
    assert any("above the ellipsoid was found" in note and "agrees with the DEM" in note for note in said.notes)
    assert not any("ORTHO_READY_HEIGHT" in text for text in said.warnings)


def test_without_any_source_the_height_is_assumed_and_the_user_is_told(mountains, projected, tmp_path, told):
    said = told()
    run_stage("epmfit", {"images": projected, "workspace": str(tmp_path)}, said)
    scene = Scene.load(str(tmp_path / "scene.json"))
    middle = np.mean([view.rpc.height_off for view in scene.views])
    assert {view.plane.height for view in scene.views} == {middle}
    text = next(text for text in said.warnings if "is assumed" in text)
    assert "is an error of all heights of the DSM" in text and "ORTHO_READY_HEIGHT, or REFERENCE" in text
    assert any("is assumed" in warning for warning in scene.record_of("epmfit").warnings)
    # The ground is searched where it would be seen, not only at the RPC's own heights.
    low, high = mountains.height_range
    assert scene.altitudes[0] < low + middle - HEIGHT and high + middle - HEIGHT < scene.altitudes[1]


def test_one_image_without_a_height_takes_that_of_the_others(projected, delivered, tmp_path, told):
    said = told()
    run_stage("epmfit", {"images": [*delivered[:2], projected[2]], "workspace": str(tmp_path)}, said)
    views = Scene.load(str(tmp_path / "scene.json")).views
    assert [view.plane.height for view in views] == [HEIGHT] * 3
    assert any("the mean of the other images' heights" in text for text in said.warnings)


def test_the_exported_rpc_is_that_of_the_projected_pixels(delivered, tmp_path, told):
    said = told()
    run_stage("epmfit", {"images": delivered, "workspace": str(tmp_path)}, said)
    scene = Scene.load(str(tmp_path / "scene.json"))
    pointing = np.array([[1.0, 2e-5, 4.25], [1e-5, 1.0, -3.0]])
    pointed = [view.with_pointing(pointing) for view in scene.views]
    scene.__class__(**{**vars(scene), "views": tuple(pointed)}).save(str(tmp_path / "pointed.json"))
    made = run_stage("exportrpc", {"scene": str(tmp_path / "pointed.json"), "rpc_folder": str(tmp_path / "rpcs")}, said)
    assert made.max_error < 0.01
    for view, again in zip(pointed, load_views(made.images)):
        assert again.plane is None, "the VRT lies on no map: the RPC alone places it"
        ground = view.localise(np.array([[50.0, 60.0], [300.0, 350.0]]), 960.0)
        assert np.abs(again.project(ground) - view.project(ground)).max() < 0.01
    record = json.loads((tmp_path / "rpcs" / "rpcs.json").read_text())
    assert {image["method"] for image in record["images"]} == {"fitted to the map's pixels"}


def test_the_real_pair_has_the_same_heights_on_a_map(shared_data, tmp_path):
    views = load_views(sorted(map(str, (shared_data / "pleiades_pair").glob("img_*.tif"))))
    images = [project(view, tmp_path / f"{view.name}.tif", "EPSG:32740", 2200.0, 0.5) for view in views]
    ready = load_views(images, height=2200.0)
    pixels = np.random.default_rng(5).uniform(100, 900, (200, 2))
    heights = np.random.default_rng(6).uniform(2250, 2400, 200)
    for view, other in zip(views, ready):
        ground = view.localise(pixels, heights)
        # GDAL's own transformers: from the map to the image at the plane's height.
        on_map = other.plane.ground(other.project(ground))
        assert np.abs(view.rpc.project(on_map) - pixels).max() < 1e-6
        with_gdal = gdal.Transformer(gdal.Open(view.image), None, ["METHOD=RPC", "RPC_HEIGHT=2200"])
        seen, _ = with_gdal.TransformPoints(1, [(lon, lat, 0.0) for lon, lat, _ in on_map])
        assert np.abs(np.array(seen)[:, :2] - 0.5 - pixels).max() < 1e-3
