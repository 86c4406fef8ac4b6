"""Black ends of images without a nodata value are found, and dark ground is not."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.arrays import Window
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

    def find(values, nodata=None, mask=None, part=None):
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
        share = write_collar_mask(paths[0], 1, paths[1] if mask is not None else "", target=str(target), part=part)
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


@pytest.mark.parametrize(
    "part",
    (
        Window(0, 0, 200, 200),
        Window(350, 0, 150, 700),
        Window(200, 250, 200, 120),  # the stripes alone, which reach the ends outside
        Window(10, 100, 480, 590),  # near to the ends, but not at them
        Window(220, 600, 280, 100),
    ),
)
def test_a_part_has_the_black_ends_that_the_whole_image_has_there(ground, found, part):
    ground[frame()] = 0
    clouds = np.zeros((HEIGHT, WIDTH), dtype=np.uint16)
    clouds[5:90, 210:480] = 1  # the user's own, inside the parts and outside
    _, whole = found(ground, mask=clouds)
    share, mask = found(ground, mask=clouds, part=part)
    seen = part.inside(Window(0, 0, WIDTH, HEIGHT))
    assert share > 0 and (mask[seen] != whole[seen]).mean() < 0.002  # runs that the part cuts short
    outside = np.ones((HEIGHT, WIDTH), dtype=bool)
    outside[part.grown(COLLARS.least_px, (WIDTH, HEIGHT)).inside(Window(0, 0, WIDTH, HEIGHT))] = False
    np.testing.assert_array_equal(mask[outside], clouds[outside] != 0)


def test_dark_ground_at_the_ends_of_a_part_stays(ground, found):
    ground[200:400, 100:300] = 0  # a lake, across the part's left end and its top
    assert found(ground, part=Window(200, 300, 250, 300)) == (0.0, None)


def test_beside_a_part_no_more_is_read_than_is_needed(ground, found, monkeypatch):
    read_from = []
    plain = read

    def counting(dataset, window=None, band=1, size=None):
        read_from.append(window)
        return plain(dataset, window, band, size)

    monkeypatch.setattr("repm_qgis.imagery.collars.read", counting)
    ground[:, :120] = 0
    part = Window(100, 300, 200, 100)
    assert found(ground, part=part)[0] == pytest.approx(0.1)
    near = Window(0, 300, 300, 100)
    assert all(near.common(window) == window or window.row < 300 and window.width == 200 for window in read_from)
    assert max(window.width * window.height for window in read_from) <= 200 * 300


@pytest.mark.parametrize("kind, fill", ((np.uint16, 65535), (np.uint8, 255), (np.float32, 1e6), (np.float32, -3.4e38)))
def test_ends_of_any_other_value_are_found_to_the_pixel(ground, found, kind, fill):
    margin = frame()
    values = (ground // 9 + 4).astype(kind)
    values[margin] = fill
    share, mask = found(values)
    assert share == pytest.approx(mask.mean(), abs=1e-6) and not mask[~margin].any()
    assert (margin & ~mask).mean() < 0.004


def test_even_ground_at_the_ends_stays_where_brighter_and_darker_is_around(ground, found):
    ground[100:300, :80] = 700  # a field, a roof
    assert found(ground) == (0.0, None)


def test_saturated_ground_at_the_ends_and_inside_stays(ground, found):
    values = np.minimum(ground // 9 + 4, 255).astype(np.uint8)
    values[100:130, :40] = values[300:340, 200:260] = values[600:, 480:] = 255  # roofs, cars, a cloud
    assert found(values) == (0.0, None)
    values[:, 460:] = 255  # a margin beside such roofs
    share, mask = found(values)
    assert mask[:, 460:].all() and not mask[300:340, 200:260].any()
