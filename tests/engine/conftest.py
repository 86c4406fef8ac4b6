"""What the engine's tests share: recorded progress, small images with RPCs, truth scenes and runs of the pipeline."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.errors import Cancelled
from repm_qgis.geometry.frames import EnuFrame, projected_from_geodetic, utm_crs
from repm_qgis.rpc import Rpc
from repm_qgis.rpc.readers import read_rpc_file
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import Scene, View, load_views
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE


class Told:
    """Keeps all that a stage says; raises Cancelled at the ``cancel_at``-th check."""

    def __init__(self, cancel_at=None):
        self.fractions, self.notes, self.warnings, self.checks, self.cancel_at = [], [], [], 0, cancel_at

    def step(self, fraction, text=""):
        self.fractions.append(fraction)

    def info(self, text):
        self.notes.append(text)

    def warn(self, text):
        self.warnings.append(text)

    def check_cancelled(self):
        self.checks += 1
        if self.cancel_at is not None and self.checks >= self.cancel_at:
            raise Cancelled


class TruthScene:
    """A simulated tri-stereo scene with its true surface and the true RPC of each view."""

    def __init__(self, kind, folder, size):
        self.folder = Path(folder)
        self.made = run_stage("sampledata", {"folder": str(folder), "kind": kind, "size": size, "seed": 3}, Told())
        self.images, self.truth = self.made.images, self.made.truth
        self.record = json.loads((self.folder / "truth.json").read_text())
        self.true_rpcs = [Rpc.from_mapping(view["true_rpc"]) for view in self.record["views"]]
        self.biases = np.array([[v["rpc_bias_px"]["col"], v["rpc_bias_px"]["row"]] for v in self.record["views"]])
        self.crs, self.height_range = self.record["crs"], tuple(self.record["height_range_m"])
        self.views = load_views(tuple(self.images))
        self.true_views = [
            view.__class__(**{**vars(view), "rpc": rpc}) for view, rpc in zip(self.views, self.true_rpcs)
        ]
        dataset = gdal.Open(self.truth)
        self.surface, self.transform = dataset.ReadAsArray().astype(np.float64), dataset.GetGeoTransform()
        dataset = None

    @property
    def bounds(self):
        """xmin, ymin, xmax, ymax of the true DSM."""
        x, cell, _, y, _, _ = self.transform
        rows, columns = self.surface.shape
        return Bounds(x, y - rows * cell, x + columns * cell, y)


class Pipeline:
    """One run of the whole pipeline on a truth scene, with what it said."""

    def __init__(self, scene, folder, **options):
        self.scene, self.workspace, self.said = scene, folder / "ws", Told()
        self.options = {
            "images": scene.images,
            "workspace": str(self.workspace),
            "output": str(folder / "dsm.tif"),
            "confidence": str(folder / "confidence.tif"),
            "ortho": str(folder / "ortho.tif"),
            "cloud": str(folder / "cloud.laz"),
            "ept": str(folder / "ept"),
            "mesh": str(folder / "mesh.ply"),
            "viewer": str(folder / "viewer.html"),
            **options,
        }
        self.result = run_stage("pipeline", self.options, self.said)


@pytest.fixture(scope="session")
def told():
    """The class of a progress that remembers: ``told()`` or ``told(cancel_at=5)``."""
    return Told


@pytest.fixture(scope="session")
def as_they_are():
    """Parameters with which nothing is chosen: cells have what their own maps say."""
    fusion = ENGINE.fusion
    return replace(ENGINE, fusion=replace(fusion, walls=replace(fusion.walls, least_tail=1e9)))


@pytest.fixture(scope="session")
def pipeline():
    """The class of a run: ``pipeline(scene, folder, **options)`` has workspace, options, result and said."""
    return Pipeline


@pytest.fixture(scope="session")
def urban(tmp_path_factory):
    return TruthScene("urban", tmp_path_factory.mktemp("urban"), 400)


@pytest.fixture(scope="session")
def hamlet(tmp_path_factory):
    """A part of a town, in two fifths of the pixels: for what does not depend on how good heights are."""
    return TruthScene("urban", tmp_path_factory.mktemp("hamlet"), 256)


@pytest.fixture(scope="session")
def mountains(tmp_path_factory):
    return TruthScene("mountains", tmp_path_factory.mktemp("mountains"), 400)


@pytest.fixture(scope="session")
def urban_run(urban, tmp_path_factory):
    """The town's DSM at 0.5 m, in four tiles, with every product."""
    return Pipeline(urban, tmp_path_factory.mktemp("urban_run"), resolution=0.5, tile_size=256, workers=1)


@pytest.fixture(scope="session")
def mountains_run(mountains, tmp_path_factory):
    return Pipeline(mountains, tmp_path_factory.mktemp("mountains_run"), resolution=1.0, workers=1)


def _synthetic_rpc(lon=1.44, lat=43.6, **changes):
    """A made-up RPC with all eighty coefficients at work: 0.5 m px, 20 km a side, looking 15 degrees off nadir."""
    numbers = np.random.default_rng(7)

    def polynomial(leading, size):
        values = numbers.normal(0.0, size, 20)
        for index, value in leading.items():
            values[index] = value
        return tuple(values)

    members = {
        "row_off": 18999.5,
        "row_scale": 19000.0,
        "col_off": 20749.5,
        "col_scale": 20750.0,
        "lat_off": lat,
        "lat_scale": 0.09,
        "lon_off": lon,
        "lon_scale": 0.13,
        "height_off": 500.0,
        "height_scale": 400.0,
        "row_num": polynomial({0: 0.002, 1: -0.21, 2: -1.02, 3: 0.012}, 2e-5),
        "row_den": polynomial({0: 1.0}, 2e-5),
        "col_num": polynomial({0: -0.001, 1: 1.01, 2: -0.2, 3: 0.009}, 2e-5),
        "col_den": polynomial({0: 1.0}, 2e-5),
    }
    return Rpc(**{**members, **changes})


@pytest.fixture(scope="session")
def synthetic_rpc():
    """synthetic_rpc(lon, lat, **members): an RPC that needs no data; ground points for it: see `points_of`."""
    return _synthetic_rpc


@pytest.fixture(scope="session")
def points_of():
    """points_of(rpc, count): random (N, 3) ground points in the RPC's own domain."""

    def points(rpc, count=200):
        unit = np.random.default_rng(1).uniform(-0.95, 0.95, (count, 3))
        return unit * [rpc.lon_scale, rpc.lat_scale, rpc.height_scale] + [rpc.lon_off, rpc.lat_off, rpc.height_off]

    return points


@pytest.fixture(scope="session")
def write_image():
    """write_image(path, pixels, rpc, tags, nodata, crs): a GeoTIFF with RPC tags, or without any."""

    def write(path, pixels=None, rpc=None, tags=None, nodata=None, crs=None):
        pixels = np.arange(100 * 80, dtype=np.uint16).reshape(100, 80) if pixels is None else np.asarray(pixels)
        kinds = {"uint8": gdal.GDT_Byte, "uint16": gdal.GDT_UInt16, "float32": gdal.GDT_Float32}
        bands = pixels[None] if pixels.ndim == 2 else pixels
        dataset = gdal.GetDriverByName("GTiff").Create(
            str(path), bands.shape[2], bands.shape[1], bands.shape[0], kinds[bands.dtype.name]
        )
        metadata = {**(rpc_tags(rpc) if rpc else {}), **(tags or {})}
        if metadata:
            dataset.SetMetadata(metadata, "RPC")
        if crs:
            dataset.SetProjection(crs)
            dataset.SetGeoTransform((500000.0, 1.0, 0.0, 4800000.0, 0.0, -1.0))
        for number, band in enumerate(bands, start=1):
            if nodata is not None:
                dataset.GetRasterBand(number).SetNoDataValue(nodata)
            dataset.GetRasterBand(number).WriteArray(band)
        dataset = None  # noqa: F841
        return str(path)

    return write


class Case:
    """Two views, a ground rectangle they both see, and an altitude range."""

    def __init__(self, views, lon, lat, altitudes, half_m):
        self.views, self.altitudes, self.crs = views, altitudes, utm_crs(lon, lat)
        x, y = projected_from_geodetic(self.crs, np.array([lon, lat]))
        self.bounds = Bounds(x - half_m, y - half_m, x + half_m, y + half_m)
        self.scene = Scene(views, EnuFrame(lon, lat), self.crs, "", altitudes, [], "polynomial")

    def points(self, count=500, seed=0):
        """Random (N, 3) x, y, height within the rectangle and the altitudes."""
        x0, y0, x1, y1 = self.bounds
        return np.random.default_rng(seed).uniform((x0, y0, self.altitudes[0]), (x1, y1, self.altitudes[1]), (count, 3))


def _gdal_pixels(rpc, lon_lat_h):
    """Pixels by GDAL's RPC transformer, in our convention."""
    dataset = gdal.GetDriverByName("MEM").Create("", 10, 10, 1)
    dataset.SetMetadata(rpc_tags(rpc), "RPC")
    transformer = gdal.Transformer(dataset, None, ["METHOD=RPC"])
    found, _ = transformer.TransformPoints(1, lon_lat_h.tolist())
    transformer = dataset = None
    return np.array(found)[:, :2] - 0.5


@pytest.fixture(scope="session")
def gdal_pixels():
    return _gdal_pixels


def _full_scene(shared_data, site, half_m, span_m):
    views = []
    for path in sorted((shared_data / "rpc" / "pleiades").glob(f"{site}__*.XML"))[:2]:
        rpc = read_rpc_file(str(path))
        views.append(View(path.stem, "", 1, int(2 * rpc.col_off), int(2 * rpc.row_off), rpc, 0.5))
    middle = views[0].rpc.height_off
    lon, lat, _ = views[0].localise(np.array([views[0].width / 2, views[0].height / 2]), middle)
    return Case(views, float(lon), float(lat), (middle - span_m / 2, middle + span_m / 2), half_m)


def _images(paths, altitudes, half_m):
    views = load_views(tuple(map(str, paths)))
    lon, lat, _ = views[0].localise(np.array([views[0].width / 2, views[0].height / 2]), sum(altitudes) / 2)
    return Case(views, float(lon), float(lat), altitudes, half_m)


CASES = ("simulated", "pleiades_pair", "pleiades_triplet", "calanques", "giza", "melbourne", "ossoue")


@pytest.fixture(scope="session", params=CASES)
def case(request):
    """One of the cases: simulated, crops of real images, or tiles of 600 m of full scenes over 200 m of altitude."""
    if request.param == "simulated":
        scene = request.getfixturevalue("urban")
        return _images(scene.images[:2], (150.0, 260.0), 60.0)
    shared_data = request.getfixturevalue("shared_data")
    if request.param.startswith("pleiades"):
        images = sorted((shared_data / request.param).glob("img*.tif"))
        return _images(
            images[:2], {"pleiades_pair": (2200.0, 2450.0), "pleiades_triplet": (100.0, 250.0)}[request.param], 120.0
        )
    return _full_scene(shared_data, request.param, 300.0, 200.0)
