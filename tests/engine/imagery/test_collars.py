"""Black ends of images without a nodata value are found, and dark ground is not."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.imagery.collars import write_collar_mask
from repm_qgis.imagery.parameters import COLLARS
from repm_qgis.imagery.raster import opened, read

HEIGHT, WIDTH = 700, 500


@pytest.fixture
def ground():
    return np.random.default_rng(1).integers(20, 2000, (HEIGHT, WIDTH)).astype(np.uint16)


@pytest.fixture
def found(tmp_path):
    """The share and the mask of an image; None where none is written."""

    def find(values, nodata=None, mask=None):
        paths = [str(tmp_path / name) for name in ("image.tif", "mask.tif")]
        for path, data in zip(paths, (values, mask)):
            if data is not None:
                kind = gdal.GDT_Float32 if data.dtype.kind == "f" else gdal.GDT_UInt16
                dataset = gdal.GetDriverByName("GTiff").Create(path, WIDTH, HEIGHT, 1, kind)
                dataset.GetRasterBand(1).WriteArray(data)
                if nodata is not None and path == paths[0]:
                    dataset.GetRasterBand(1).SetNoDataValue(nodata)
                dataset = None
        target = tmp_path / "found.tif"
        share = write_collar_mask(paths[0], 1, paths[1] if mask is not None else "", str(target))
        if not target.exists():
            return share, None
        with opened(str(target)) as dataset:
            return share, read(dataset) != 0

    return find


def frame():
    """A turned image in its rectangle, a stripe of rows and one of columns."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    black = (columns < 0.1 * (HEIGHT - rows)) | (columns > WIDTH - 0.1 * rows) | (rows < 20)
    black[300:330] = True
    black[:, 250:255] = True
    return black


@pytest.mark.parametrize("kind", ("zeros", "lossy", "float"))
def test_black_ends_are_found_to_the_pixel(ground, found, kind):
    black = frame()
    values = ground.astype(np.float32) / 7.3 if kind == "float" else ground.copy()
    values[black] = np.random.default_rng(2).integers(0, 4, black.sum()) if kind == "lossy" else 0
    share, mask = found(values)
    assert share == pytest.approx(mask.mean(), abs=1e-6) and not mask[~black].any()
    assert (black & ~mask).mean() < 0.004  # runs that are shorter than what counts, where the turned frame ends


def test_dark_ground_stays(ground, found):
    ground[200:400, 100:300] = 0  # a lake that no border touches
    ground[500:510, :10] = 0  # a shadow at the border, shorter than what counts
    assert found(ground) == (0.0, None)


def test_what_nodata_marks_already_needs_no_mask_and_near_black_beside_it_does(ground, found):
    black = frame()
    ground[black] = 0
    assert found(ground, nodata=0.0)[1] is None
    ground[:40] = np.where(black[:40], 0, 2)  # a ring of what compression made
    share, mask = found(ground, nodata=0.0)
    assert share > 0.01 and mask[25, 100] and mask[5].all()


def test_the_users_mask_is_kept_in_the_new_one(ground, found):
    black, clouds = frame(), np.zeros((HEIGHT, WIDTH), dtype=np.uint16)
    ground[black], clouds[600:650, 300:400] = 0, 1
    _, mask = found(ground, mask=clouds)
    assert mask[610:640, 310:390].all() and not mask[560:590, 310:390].any()


def test_a_plain_image_is_not_read_as_a_whole(ground, found, monkeypatch):
    pixels = []
    plain = read

    def counting(dataset, window=None, band=1, size=None):
        pixels.append(window.width * window.height)
        return plain(dataset, window, band, size)

    monkeypatch.setattr("repm_qgis.imagery.collars.read", counting)
    assert found(ground) == (0.0, None)
    assert sum(pixels) == WIDTH + 2 * COLLARS.looked_at * COLLARS.end_px
