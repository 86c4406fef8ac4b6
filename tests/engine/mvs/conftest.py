"""Scenes around views, without images: what rectification and triangulation work on."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.geometry.frames import EnuFrame, projected_from_geodetic, utm_crs
from repm_qgis.rpc.readers import read_rpc_file
from repm_qgis.scene import Scene, View, load_views


class Case:
    """Two views, a ground rectangle they both see, and an altitude range."""

    def __init__(self, views, lon, lat, altitudes, half_m):
        self.views, self.altitudes, self.crs = views, altitudes, utm_crs(lon, lat)
        x, y = projected_from_geodetic(self.crs, np.array([lon, lat]))
        self.bounds = (x - half_m, y - half_m, x + half_m, y + half_m)
        self.scene = Scene(views, EnuFrame(lon, lat), self.crs, "", altitudes, [], "polynomial")

    def points(self, count=500, seed=0):
        """Random (N, 3) x, y, height within the rectangle and the altitudes."""
        x0, y0, x1, y1 = self.bounds
        return np.random.default_rng(seed).uniform((x0, y0, self.altitudes[0]), (x1, y1, self.altitudes[1]), (count, 3))


def _gdal_pixels(rpc, lon_lat_h):
    """Pixels by GDAL's RPC transformer, in our convention."""
    from repm_qgis.simulation.scene import rpc_tags

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


NAMES = ("simulated", "pleiades_pair", "pleiades_triplet", "calanques", "giza", "melbourne", "ossoue")


@pytest.fixture(scope="session", params=NAMES)
def case(request):
    """One of the cases: simulated, crops of real images, or tiles of 600 m of full scenes over 200 m of altitude."""
    if request.param == "simulated":
        scene = request.getfixturevalue("urban")
        return _images(scene.images[:2], (150.0, 260.0), 60.0)
    shared_data = request.getfixturevalue("shared_data")
    if request.param.startswith("pleiades"):
        images = sorted((shared_data / request.param).glob("img*.tif"))
        return _images(images[:2], {"pleiades_pair": (2200.0, 2450.0), "pleiades_triplet": (100.0,
                                                                                            250.0)}[request.param],
                       120.0)
    return _full_scene(shared_data, request.param, 300.0, 200.0)
