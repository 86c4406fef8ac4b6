"""How alike two images are, against images that are equal, moved, or nothing but noise; and what a view sees."""

import math

import numpy as np
import pytest
from osgeo import gdal, osr
from scipy import ndimage

from benchmarks.season_scenes import _visible, alike
from repm_qgis.evaluation.coregistration import Alignment
from repm_qgis.geometry.frames import geodetic_from_projected, projected_from_geodetic

CRS, WEST, NORTH, SIDE, CELL = "EPSG:32631", 374000.0, 4828600.0, 120, 0.5


class Leaning:
    """A view of parallel rays that lean by ``lean`` metres to the east for each metre up; a pixel is a cell."""

    def __init__(self, image="", lean=0.0):
        self.image, self.lean, self.size = image, lean, (SIDE, SIDE)

    def project(self, lon_lat_h):
        east, north = projected_from_geodetic(CRS, lon_lat_h).T[:2]
        return np.stack([(east - self.lean * lon_lat_h[:, 2] - WEST) / CELL - 0.5, (NORTH - north) / CELL - 0.5], 1)

    def localise(self, pixels, height):
        x = WEST + (pixels[:, 0] + 0.5) * CELL + self.lean * height
        lon_lat = geodetic_from_projected(CRS, np.stack([x, NORTH - (pixels[:, 1] + 0.5) * CELL], 1))
        return np.column_stack([lon_lat[:, :2], np.full(len(x), height)])


def _written(path, values):
    reference = osr.SpatialReference()
    reference.SetFromUserInput(CRS)
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), SIDE, SIDE, 1, gdal.GDT_Float32)
    dataset.SetGeoTransform((WEST, CELL, 0, NORTH, 0, -CELL))
    dataset.SetProjection(reference.ExportToWkt())
    dataset.GetRasterBand(1).WriteArray(values)
    dataset = None
    return str(path)


def test_equal_images_are_alike_also_moved_and_noise_is_not(tmp_path):
    rng = np.random.default_rng(1)
    pattern, other = (ndimage.gaussian_filter(rng.normal(1000, 300, (SIDE, SIDE)), 1.0) for _ in range(2))
    truth = _written(tmp_path / "truth.tif", np.full((SIDE, SIDE), 3.0))
    images = {"same": pattern, "moved": np.roll(pattern, 2, 1), "inverted": -pattern, "noise": other}
    first, found = Leaning(_written(tmp_path / "first.tif", pattern)), {}
    for name, values in images.items():
        views = [first, Leaning(_written(tmp_path / f"{name}.tif", values))]
        found[name] = [float(part) for part in alike(views, truth, Alignment("none")).split("/")]
    assert found["same"] == found["moved"] == [1.0, 1.0, 1.0]
    assert found["noise"][1] == pytest.approx(0.0, abs=0.15)
    assert found["inverted"][1] < 0.4  # no shift makes it alike


def test_a_block_hides_the_ground_behind_it():
    height = np.zeros((SIDE, SIDE), np.float32)
    height[50:70, 50:70] = 20.0
    x, y = np.meshgrid(WEST + (np.arange(SIDE) + 0.5) * CELL, NORTH - (np.arange(SIDE) + 0.5) * CELL)
    lon_lat = geodetic_from_projected(CRS, np.stack([x.ravel(), y.ravel()], 1))[:, :2]
    ground = np.column_stack([lon_lat, height.ravel()])
    lean = math.tan(math.radians(25.0))
    seen = _visible(Leaning(lean=lean), ground, height, CELL)
    hidden = ~seen[60]
    assert hidden.sum() * CELL == pytest.approx(20.0 * lean, abs=1.0) and hidden[49] and not hidden[50:].any()
    assert seen[:48].all() and seen[72:].all() and seen[50:70, 50:70].all()
