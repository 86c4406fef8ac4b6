"""The scene on disk: what a user gets from repm:sampledata, against GDAL and against itself."""

import csv
import hashlib
import json
import os

import numpy as np
import pytest
from osgeo import gdal, osr
from scipy import ndimage

from repm_qgis.contracts.errors import Cancelled, WorkspaceError
from repm_qgis.contracts.options import SampleDataOptions
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.rpc.formats import rpc_from_texts
from repm_qgis.rpc.model import Rpc
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.render import RayCaster
from repm_qgis.simulation.scene import SceneSpec, make_surface, make_views, pointing_errors, surface_bounds
from repm_qgis.stages.sampledata import run

SIZE = 320
KINDS = ("urban", "mountains")


class Scene:
    """A scene that was made through the stage, read back with GDAL only."""

    def __init__(self, kind, folder):
        self.spec = SceneSpec.default(kind, SIZE, 3)
        self.result = run(SampleDataOptions(folder=str(folder), kind=kind, size=SIZE, seed=3), Silent())
        self.images, self.files_rpcs = [], []
        for path in self.result.images:
            dataset = gdal.Open(path)
            self.images.append(dataset.ReadAsArray())
            self.files_rpcs.append(rpc_from_texts(dataset.GetMetadata("RPC")))
            dataset = None
        with open(os.path.join(folder, "truth.json"), encoding="utf-8") as stream:
            self.record = json.load(stream)
        self.true_rpcs = [Rpc.from_mapping(view["true_rpc"]) for view in self.record["views"]]
        dataset = gdal.Open(self.result.truth)
        self.truth, self.transform = dataset.ReadAsArray(), dataset.GetGeoTransform()
        dataset = None
        with open(self.result.gcps, newline="", encoding="utf-8") as stream:
            self.gcps = list(csv.DictReader(stream))

    def ground(self, rows, cols, lift=0.0):
        """(N, 3) ground positions of cells of the true DSM."""
        t = self.transform
        place = np.stack([t[0] + (cols + 0.5) * t[1], t[3] + (rows + 0.5) * t[5]], axis=-1)
        height = self.truth[rows, cols] + lift
        return np.concatenate([geodetic_from_projected(self.record["crs"], place), height[..., None]], axis=-1)


@pytest.fixture(scope="module", params=KINDS)
def scene(request, tmp_path_factory):
    return Scene(request.param, tmp_path_factory.mktemp(request.param))


@pytest.mark.long
def test_result_and_files(scene):
    assert json.dumps(scene.result.to_mapping())
    assert [os.path.basename(path) for path in scene.result.images] == ["img_01.tif", "img_02.tif", "img_03.tif"]
    assert sorted(os.listdir(scene.result.folder)) == [
        "gcps.csv",
        "img_01.tif",
        "img_02.tif",
        "img_03.tif",
        "truth.json",
        "truth.tif",
    ]
    assert scene.result.rpc_fit_max_px < 0.01


def test_images_are_12_bit_tiled_and_only_rpc_referenced(scene):
    for path, image in zip(scene.result.images, scene.images):
        dataset = gdal.Open(path)
        assert (dataset.RasterXSize, dataset.RasterYSize, dataset.RasterCount) == (SIZE, SIZE, 1)
        assert dataset.GetRasterBand(1).DataType == gdal.GDT_UInt16
        assert dataset.GetRasterBand(1).GetBlockSize() == [256, 256]
        assert dataset.GetGeoTransform(can_return_null=True) is None
        assert dataset.GetProjection() == ""
        dataset = None
        assert image.min() >= 1 and image.max() <= 4095
        assert (image >= 4000).mean() < 0.01
        low, middle, high = np.percentile(image, [1, 50, 99])
        assert 120 < low < 450 and 350 < middle < 1300 and 900 < high < 3000
        assert high - middle > middle - low  # a long bright tail


def test_gdal_projects_as_our_rpc_does(scene):
    rng = np.random.default_rng(0)
    for path, rpc in zip(scene.result.images, scene.files_rpcs):
        low, high = rpc.height_range
        points = np.stack(
            [
                rng.uniform(rpc.lon_off - rpc.lon_scale, rpc.lon_off + rpc.lon_scale, 200),
                rng.uniform(rpc.lat_off - rpc.lat_scale, rpc.lat_off + rpc.lat_scale, 200),
                rng.uniform(low, high, 200),
            ],
            axis=1,
        )
        dataset = gdal.Open(path)
        transformer = gdal.Transformer(dataset, None, ["METHOD=RPC"])
        pixels, ok = transformer.TransformPoints(1, points.tolist())
        transformer = dataset = None
        assert all(ok)
        # GDAL counts from the corner of the first pixel, we from its centre.
        np.testing.assert_allclose(np.array(pixels)[:, :2] - 0.5, rpc.project(points), atol=1e-6)


def test_files_rpcs_are_the_true_ones_plus_the_recorded_bias(scene):
    views = make_views(scene.spec)
    rng = np.random.default_rng(1)
    for number, view in enumerate(views):
        low, high = scene.true_rpcs[number].height_range
        ground = view.localise(rng.uniform(0, SIZE - 1, (300, 2)), rng.uniform(low, high, 300))
        true = view.project(ground)
        assert np.abs(scene.true_rpcs[number].project(ground) - true).max() < 0.02
        bias = scene.record["views"][number]["rpc_bias_px"]
        wrong = scene.files_rpcs[number].project(ground) - true
        np.testing.assert_allclose(wrong, np.broadcast_to([bias["col"], bias["row"]], wrong.shape), atol=0.02)
        assert np.abs(wrong).max() < 3.1


def test_truth_is_georeferenced_ellipsoidal_and_seen_by_all_views(scene):
    dataset = gdal.Open(scene.result.truth)
    band = dataset.GetRasterBand(1)
    assert band.DataType == gdal.GDT_Float32 and band.GetNoDataValue() == -9999.0
    assert "ellipsoid" in band.GetDescription() and band.GetUnitType() == "m"
    assert dataset.GetMetadataItem("VERTICAL_DATUM") == "WGS 84 ellipsoid"
    reference = osr.SpatialReference(dataset.GetProjection())
    assert f"EPSG:{reference.GetAuthorityCode(None)}" == scene.record["crs"]
    band = dataset = None
    assert scene.transform[1] == -scene.transform[5] == scene.spec.cell_m
    assert scene.truth.shape[0] > 0.5 * SIZE and np.isfinite(scene.truth).all() and (scene.truth > -9999).all()
    rows, cols = (part.ravel() for part in np.mgrid[: scene.truth.shape[0] : 7, : scene.truth.shape[1] : 7])
    for rpc in scene.true_rpcs:
        pixels = rpc.project(scene.ground(rows, cols))
        assert pixels.min() > 0 and pixels.max() < SIZE - 1


def _visible(scene, number, surface, view, rows, cols):
    """Whether a view sees cells of the true DSM: cast every pixel, and compare heights where the cells project."""
    grid = np.arange(float(SIZE))
    _, heights = RayCaster(surface, view).cast(grid, grid)
    pixels = scene.true_rpcs[number].project(scene.ground(rows, cols))
    at = np.rint(pixels).astype(int)
    # Pixels are rounded, and ground slopes.
    return np.abs(heights[at[..., 1], at[..., 0]] - scene.truth[rows, cols]) < 1.5 * scene.spec.cell_m


def _patches(scene, number, rows, cols, lift=0.0):
    """Image values of view ``number`` at cells of the true DSM, lifted by some metres."""
    pixels = scene.true_rpcs[number].project(scene.ground(rows, cols, lift))
    return ndimage.map_coordinates(scene.images[number].astype(float), [pixels[..., 1], pixels[..., 0]], order=1)


def _correlation(one, other):
    one, other = one - one.mean(axis=1, keepdims=True), other - other.mean(axis=1, keepdims=True)
    return (one * other).sum(axis=1) / np.sqrt((one**2).sum(axis=1) * (other**2).sum(axis=1))


def test_views_agree_at_true_heights_and_not_5_m_above(scene):
    views = make_views(scene.spec)
    surface = make_surface(scene.spec, surface_bounds(scene.spec, views), Silent())
    count = scene.truth.shape[0]
    middle_r, middle_c = (part.ravel() for part in np.mgrid[8 : count - 8 : 9, 8 : count - 8 : 9])
    side = np.arange(-5, 6)
    rows = middle_r[:, None] + np.repeat(side, 11)
    cols = middle_c[:, None] + np.tile(side, 11)
    seen = np.all([_visible(scene, n, surface, views[n], rows, cols).mean(axis=1) > 0.97 for n in (0, 2)], axis=0)
    one, other, lifted_one, lifted = (
        _patches(scene, n, rows[seen], cols[seen], lift) for n, lift in ((0, 0), (2, 0), (0, 5), (2, 5))
    )
    # Above the noise in both views; the rest is what a matcher has to bridge.
    textured = np.minimum(one.std(axis=1), other.std(axis=1)) > 25
    assert textured.sum() > 50
    true = _correlation(one, other)[textured]
    wrong = _correlation(lifted_one, lifted)[textured]
    assert np.median(true) > 0.9 and np.mean(true > 0.8) > 0.85
    assert np.median(wrong) < 0.6 and np.mean(wrong > 0.8) < 0.25
    assert np.mean(wrong < true) > 0.9


def test_gcps_fit_the_true_rpcs_to_their_noise(scene):
    residuals, seen = [], {}
    for gcp in scene.gcps:
        number = int(gcp["view"][-2:]) - 1
        ground = np.array([[float(gcp["lon"]), float(gcp["lat"]), float(gcp["height"])]])
        measured = np.array([float(gcp["col"]), float(gcp["row"])])
        residuals.append(scene.true_rpcs[number].project(ground)[0] - measured)
        seen.setdefault(gcp["id"], set()).add((gcp["role"], tuple(ground[0])))
    residuals = np.array(residuals)
    assert list(scene.gcps[0]) == ["id", "lon", "lat", "height", "view", "col", "row", "role"]
    assert len(seen) >= 10 and len(scene.gcps) >= 25
    assert all(len(places) == 1 for places in seen.values())
    roles = [next(iter(places))[0] for places in seen.values()]
    assert {"control", "check"} == set(roles) and abs(roles.count("control") - roles.count("check")) <= 2
    assert 0.2 < np.sqrt(np.mean(residuals**2)) < 0.4
    assert np.abs(residuals).max() < 1.5
    pixels = np.array([[float(g["col"]), float(g["row"])] for g in scene.gcps])
    assert (np.ptp(pixels, axis=0) > 0.45 * SIZE).all()


def test_gcps_heights_are_the_true_surfaces(scene):
    t = scene.transform
    to_map = osr.SpatialReference()
    to_map.SetFromUserInput(scene.record["crs"])
    wgs = osr.SpatialReference()
    wgs.ImportFromEPSG(4326)
    wgs.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    transform = osr.CoordinateTransformation(wgs, to_map)
    for gcp in scene.gcps:
        east, north, _ = transform.TransformPoint(float(gcp["lon"]), float(gcp["lat"]))
        col, row = int((east - t[0]) / t[1]), int((north - t[3]) / t[5])
        around = scene.truth[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
        assert around.min() - 0.1 < float(gcp["height"]) < around.max() + 0.1


def _hashes(folder):
    return {
        name: hashlib.sha256(open(os.path.join(folder, name), "rb").read()).hexdigest()
        for name in sorted(os.listdir(folder))
    }


@pytest.mark.long
def test_same_seed_same_bytes_other_seed_other_scene(tmp_path):
    runs = {}
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        run(SampleDataOptions(folder=str(tmp_path / name), size=128, seed=seed), Silent())
        runs[name] = _hashes(tmp_path / name)
    assert len(runs["a"]) == 6 and runs["a"] == runs["b"]
    assert all(runs["a"][name] != runs["c"][name] for name in runs["a"])


def test_pointing_errors_differ_between_views_and_have_a_mean():
    many = np.array([pointing_errors(3, seed) for seed in range(200)])
    assert np.abs(many).max() <= 3.0 and np.abs(many).max() > 2.5
    assert np.abs(many.mean(axis=1)).mean() > 0.5
    assert 0.3 < many.std(axis=1).mean() < 0.8


def test_cancel_leaves_no_half_file(tmp_path):
    class Stop(Silent):
        def step(self, fraction, text=""):
            self.late = fraction > 0.55

        def check_cancelled(self):
            if getattr(self, "late", False):
                raise Cancelled

    with pytest.raises(Cancelled):
        run(SampleDataOptions(folder=str(tmp_path), size=300), Stop())
    left = sorted(os.listdir(tmp_path))
    assert "truth.json" not in left and not any("part" in name for name in left)
    assert [name for name in left if name.startswith("img")] == ["img_01.tif"]


def test_progress_never_falls_and_names_the_views(tmp_path):
    class Watch(Silent):
        steps = []

        def step(self, fraction, text=""):
            self.steps.append((fraction, text))

    progress = Watch()
    run(SampleDataOptions(folder=str(tmp_path), kind="mountains", size=128), progress)
    fractions = [fraction for fraction, _ in progress.steps]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    assert any("img_02" in text for _, text in progress.steps)


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    path = tmp_path / "occupied"
    path.write_text("")
    with pytest.raises(WorkspaceError, match="occupied"):
        run(SampleDataOptions(folder=str(path), size=128), Silent())


@pytest.mark.long
def test_smallest_scene_works(tmp_path):
    for kind in KINDS:
        result = run(SampleDataOptions(folder=str(tmp_path / kind), kind=kind, size=128, seed=11), Silent())
        assert result.rpc_fit_max_px < 0.01
