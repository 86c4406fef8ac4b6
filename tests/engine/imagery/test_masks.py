"""Masks beside images, and masks and alpha bands in them: what they hide reads as NaN everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError, OptionError
from repm_qgis.contracts.options import EpmFitOptions
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.imagery.enhancement import view_stretch
from repm_qgis.imagery.raster import opened, opened_masked, read
from repm_qgis.imagery.warping import warp
from repm_qgis.scene import Scene, View, load_views
from repm_qgis.stages import run_stage


def raster(path, values, nodata=None, kind=gdal.GDT_Byte):
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), values.shape[1], values.shape[0], 1, kind)
    if nodata is not None:
        dataset.GetRasterBand(1).SetNoDataValue(nodata)
    dataset.GetRasterBand(1).WriteArray(values)
    dataset = None  # noqa: F841
    return str(path)


@pytest.fixture
def image(tmp_path):
    values = np.random.default_rng(3).integers(100, 900, (80, 100)).astype(np.uint16)
    return raster(tmp_path / "image.tif", values, kind=gdal.GDT_UInt16), values.astype(np.float32)


@pytest.fixture
def mask(tmp_path):
    values = np.zeros((80, 100), np.uint8)
    values[20:40, 30:60] = 1
    values[70:, 90:] = 255
    return raster(tmp_path / "mask.tif", values), values != 0


def test_what_is_not_zero_in_the_mask_reads_as_nan(image, mask):
    with opened_masked(image[0], mask[0]) as dataset:
        pixels = read(dataset)
        np.testing.assert_array_equal(np.isnan(pixels), mask[1])
        np.testing.assert_array_equal(pixels[~mask[1]], image[1][~mask[1]])
        np.testing.assert_array_equal(read(dataset, (25, 15, 40, 30)), pixels[15:45, 25:65])
        warped = warp(dataset, 1, lambda p: p, (100, 80), "cubic")
        small = read(dataset, None, 1, (50, 40))
    assert np.isnan(warped[mask[1]]).all() and np.isfinite(warped[50, 50])
    np.testing.assert_array_equal(np.isnan(small), mask[1].reshape(40, 2, 50, 2).any(axis=(1, 3)))


def test_nodata_of_the_mask_hides_nothing(image, tmp_path):
    """As gdal_rasterize leaves it around what it burns."""
    values = np.full((80, 100), 9, np.uint8)
    values[10:20] = 1
    with opened_masked(image[0], raster(tmp_path / "m.tif", values, nodata=9)) as dataset:
        np.testing.assert_array_equal(np.isnan(read(dataset)), values == 1)


def test_no_mask_hides_nothing(image):
    with opened_masked(image[0]) as dataset:
        np.testing.assert_array_equal(read(dataset), image[1])


@pytest.mark.parametrize("way", ("alpha", "internal"))
def test_the_files_own_mask_is_obeyed(tmp_path, way):
    path = str(tmp_path / f"{way}.tif")
    dataset = gdal.GetDriverByName("GTiff").Create(
        path, 64, 64, 2 if way == "alpha" else 1, options=["ALPHA=YES"] if way == "alpha" else []
    )
    shown = np.full((64, 64), 255, np.uint8)
    shown[:20, :30] = 0
    dataset.GetRasterBand(1).WriteArray(np.full((64, 64), 77, np.uint8))
    gdal.SetConfigOption("GDAL_TIFF_INTERNAL_MASK", "YES")
    if way == "internal":
        dataset.CreateMaskBand(gdal.GMF_PER_DATASET)
    gdal.SetConfigOption("GDAL_TIFF_INTERNAL_MASK", None)
    (dataset.GetRasterBand(2) if way == "alpha" else dataset.GetRasterBand(1).GetMaskBand()).WriteArray(shown)
    dataset = None
    with opened(path) as dataset:
        np.testing.assert_array_equal(np.isnan(read(dataset)), shown == 0)
        assert np.isnan(read(dataset, None, 1, (32, 32))[:10, :15]).all()


def test_a_mask_that_does_not_fit_is_named(urban, tmp_path):
    small = raster(tmp_path / "small.tif", np.zeros((10, 20), np.uint8))
    with pytest.raises(ImageError, match=r"small.tif' has 20 x 10 px, its image .*img_01.tif' 400 x 400 px"):
        load_views(urban.images[:2], (), (small, ""))
    with pytest.raises(ImageError, match="gone.tif': it does not exist"):
        load_views(urban.images[:2], (), ("", str(tmp_path / "gone.tif")))
    with pytest.raises(OptionError, match="MASKS is .*one for each of IMAGES"):
        EpmFitOptions(images=tuple(urban.images[:2]), workspace="w", masks=("a.tif",))
    every = raster(tmp_path / "every.tif", np.ones((400, 400), np.uint8))
    with pytest.raises(ImageError, match="only nodata in band 1: choose another image, band or mask"):
        view_stretch(urban.images[0], 1, every)


def test_a_scene_of_before_masks_is_read(urban):
    values = load_views(urban.images[:1])[0].to_mapping()
    assert values.pop("mask") == ""
    assert View.from_mapping(values).mask == ""


@pytest.mark.long
def test_masked_pixels_give_no_ties_and_no_heights(urban, tmp_path, told):
    """A quarter of the first image is masked: there is nothing there; elsewhere the scene is as whole as ever."""
    hidden = np.zeros((400, 400), np.uint8)
    hidden[100:250, 120:300] = 1
    made = run_stage(
        "pipeline",
        {
            "images": urban.images[:2],
            "masks": [raster(tmp_path / "mask.tif", hidden), ""],
            "workspace": str(tmp_path / "ws"),
            "output": str(tmp_path / "dsm.tif"),
            "resolution": 0.5,
            "workers": 1,
        },
        told(),
    )
    scene = Scene.load(made.scene)
    assert [bool(view.mask) for view in scene.views] == [True, False]
    dataset = gdal.Open(made.output)
    dsm, (west, cell, _, north, _, _) = dataset.ReadAsArray().astype(np.float64), dataset.GetGeoTransform()
    dataset = None
    rows, columns = np.indices(dsm.shape)
    known = dsm != -9999
    place = np.stack([west + (columns + 0.5) * cell, north - (rows + 0.5) * cell], axis=-1)
    height = np.where(known, dsm, dsm[known].mean())
    ground = np.concatenate([geodetic_from_projected(scene.crs, place), height[..., None]], axis=-1)
    pixels = np.rint(scene.views[0].project(ground)).astype(int)
    inside = ((pixels >= 4) & (pixels < 396)).all(axis=-1)
    masked = np.zeros(dsm.shape, dtype=bool)
    masked[inside] = hidden[pixels[inside][:, 1], pixels[inside][:, 0]] != 0
    # The masked image's own geometry, so a cell's height decides: only rims of a pixel or two may be hit.
    assert known[masked].mean() < 0.03
    assert known[inside & ~masked].mean() > 0.8
    again = told()
    run_stage("epmfit", {"images": urban.images[:2], "workspace": str(tmp_path / "ws")}, again)
    assert not any("Reused" in note for note in again.notes)


def test_what_is_read_reduced_leaves_out_each_pixel_that_a_mask_touches(image, tmp_path):
    """GDAL's mean of a mask is rounded: a pixel of which a tenth is excluded had a tenth of the fill in it."""
    values = image[1].copy()
    values[:, :31] = -9999.0
    hidden = np.zeros(values.shape, np.uint8)
    hidden[:, :31] = 1
    path = raster(tmp_path / "filled.tif", values, kind=gdal.GDT_Float32)
    with opened_masked(path, raster(tmp_path / "hidden.tif", hidden)) as masked:
        for size in ((10, 8), (97, 77), (33, 80)):
            reduced = read(masked, None, 1, size)
            assert np.nanmin(reduced) > 0
            assert np.isnan(reduced).all(axis=0).sum() == np.ceil(31 * size[0] / 100 - 1e-9)
