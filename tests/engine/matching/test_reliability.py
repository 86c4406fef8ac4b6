"""Made-up matches whose truth is known: noise goes, plain roofs stay, what floats in the sky goes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from osgeo import gdal
from scipy import ndimage

from repm_qgis.imagery.confidence import Provenance
from repm_qgis.matching.disparity_map import DisparityMap
from repm_qgis.matching.reliability import mask_unreliable
from repm_qgis.matching.sgm import match
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages import run_stage

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from benchmarks.water_and_clouds import LAKES, LAND, WATER, make_pair  # noqa: E402

SHAPE = (300, 400)
LOW, HIGH = -20, 20
NOISE = 0.004


def pair(disparity, texture, second_texture=None, seed=1):
    """First and second image of a disparity (H, W) that is whole, and the brightness of each; noise of their own."""
    rng = np.random.default_rng(seed)
    second = texture if second_texture is None else second_texture
    wide = np.full((SHAPE[0], SHAPE[1] + HIGH - LOW), 0.5, np.float32)
    rows, columns = np.indices(SHAPE)
    order = np.argsort(disparity, axis=None)  # nearer surfaces hide the others
    target = (columns - disparity + HIGH).astype(int)
    wide[rows.ravel()[order], target.ravel()[order]] = second.ravel()[order]
    return (
        (texture + NOISE * rng.standard_normal(SHAPE)).astype(np.float32),
        (wide + NOISE * rng.standard_normal(wide.shape)).astype(np.float32),
    )


def land(seed=0):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), 1.0)
    return 0.5 + 0.1 * noise / noise.std()


def box(top, left, height, width):
    inside = np.zeros(SHAPE, dtype=bool)
    inside[top : top + height, left : left + width] = True
    return inside


def inner(mask, pixels):
    return ndimage.binary_erosion(mask, iterations=pixels)


def kept(first, second, metres=1.0):
    found = match(first, second, (LOW, HIGH), 1.0)
    return found, mask_unreliable(found, first, second, disparities=(LOW, HIGH), height_sign=1.0, metres_per_px=metres)


def test_still_water_goes_and_land_stays():
    lake = box(60, 100, 160, 200)
    texture = np.where(lake, 0.1, land())
    found, left = kept(*pair(np.zeros(SHAPE, int), texture))
    assert np.isfinite(found.disparity[inner(lake, 12)]).mean() > 0.9  # the matcher alone answers there
    assert np.isfinite(left.disparity[inner(lake, 6)]).mean() < 0.02
    assert np.isfinite(left.disparity[lake]).mean() < 0.03  # with what the texture of its bank extends
    clear = inner(~lake, 8)
    assert np.isfinite(left.disparity[clear]).sum() > 0.998 * np.isfinite(found.disparity[clear]).sum()
    assert not left.filled[inner(lake, 6)].any()
    same = np.isfinite(left.disparity)
    np.testing.assert_array_equal(left.disparity[same], found.disparity[same])


def test_waves_that_differ_between_the_views_go():
    lake = box(60, 100, 160, 200)
    _, left = kept(*pair(np.zeros(SHAPE, int), np.where(lake, land(5), land()), np.where(lake, land(6), land())))
    assert np.isfinite(left.disparity[inner(lake, 6)]).mean() < 0.02


@pytest.mark.parametrize(
    "size, wobble, stays", ((60, 0.2, 1), (110, 0.2, 1), (60, 2.0, 1), (110, 2.0, 0), (200, 0.2, 0))
)
def test_a_plain_roof_stays(size, wobble, stays):
    """Its texture is noise and nothing else, as the water's is, but its height is even; and roofs are not endless."""
    roof = box(50, 100, size, size)
    disparity = np.where(roof, 8.0, 0.0)
    first, second = pair(disparity.astype(int), np.where(roof, 0.75, land()))
    patches = ndimage.gaussian_filter(np.random.default_rng(4).normal(size=SHAPE), 5)
    disparity = np.where(roof, disparity + wobble * patches / patches.std(), 0.0).astype(np.float32)
    found = DisparityMap(disparity, np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool))
    left = mask_unreliable(found, first, second, disparities=(LOW, HIGH), height_sign=1.0, metres_per_px=1.0)
    assert np.isfinite(left.disparity[inner(roof, 6)]).mean() == stays
    assert np.isfinite(left.disparity[inner(~roof, 16)]).all()  # nearer, the roof hides land


def test_nothing_changes_where_all_is_supported():
    found, left = kept(*pair(np.zeros(SHAPE, int), land()))
    assert left is found


def _plateau(rise, bright, metres):
    """Share of a plateau's inside that stays, with a disparity of so many px above the ground."""
    top = box(100, 140, 90, 90)
    disparity = np.where(top, np.float32(rise), np.float32(0))
    texture = np.where(top, bright + 0.05 * (land(3) - 0.5), land()).astype(np.float32)
    first, second = pair(disparity.astype(int), texture)
    left = mask_unreliable(
        DisparityMap(disparity, np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool)),
        first,
        second,
        disparities=(LOW, HIGH),
        height_sign=1.0,
        metres_per_px=metres,
    )
    return np.isfinite(left.disparity[inner(top, 6)]).mean(), np.isfinite(left.disparity[:50]).mean()


def test_a_cloud_goes_and_what_stands_on_the_ground_stays():
    assert _plateau(16, 0.85, 10.0) == (0.0, 1.0)  # bright, 160 m above all around
    assert _plateau(16, 0.85, 3.0) == (1.0, 1.0)  # a white roof, 48 m
    assert _plateau(16, 0.45, 10.0) == (1.0, 1.0)  # a dark tower, 160 m


def test_a_bright_slope_stays():
    """Snow is bright and far above the valley, but the mountain leads up to it."""
    rows, columns = np.indices(SHAPE)
    disparity = np.rint(18 * np.exp(-((rows - 150) ** 2 + (columns - 200) ** 2) / 2 / 60**2)).astype(np.float32)
    texture = np.where(disparity > 9, 0.85 + 0.3 * (land(3) - 0.5), land()).astype(np.float32)
    first, second = pair(disparity.astype(int), texture)
    found = DisparityMap(disparity, np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool))
    left = mask_unreliable(found, first, second, disparities=(LOW, HIGH), height_sign=1.0, metres_per_px=20.0)
    assert np.isfinite(left.disparity[disparity > 10]).mean() > 0.99


def test_what_only_one_image_shows_speaks_against_nothing():
    first, second = pair(np.zeros(SHAPE, int), land())
    second[:, :180] = np.nan
    found, left = kept(first, second)
    np.testing.assert_array_equal(np.isfinite(left.disparity), np.isfinite(found.disparity))


@pytest.mark.slow
def test_lakes_of_a_simulated_scene_end_as_nodata(tmp_path, pipeline):
    """Through the whole pipeline: still water, ripples and glint; the land around them keeps its heights."""
    made = make_pair(str(tmp_path / "scene"), size=640, seed=5, clouds=False)
    mask, flat = str(tmp_path / "water.tif"), str(tmp_path / "flat.tif")
    run = pipeline(
        made,
        tmp_path,
        images=made.images,
        resolution=0.5,
        workers=1,
        confidence=None,
        ortho=None,
        cloud=None,
        water_mask=mask,
    )
    options = {"scene": run.result.scene, "output": flat, "confidence": str(tmp_path / "sources.tif")}
    flattened = run_stage("dsmfuse", {**options, "resolution": 0.5, "workers": 1, "water": "flatten"}, Silent())
    dataset = gdal.Open(run.result.output)
    dsm, place = dataset.ReadAsArray(), dataset.GetGeoTransform()
    water, level, sources = (gdal.Open(path).ReadAsArray() for path in (mask, flat, options["confidence"]))
    dataset = gdal.Open(made.truth)
    origin, shape = dataset.GetGeoTransform(), (dataset.RasterYSize, dataset.RasterXSize)
    dataset = None
    rows = np.floor((place[3] - (origin[3] - 0.5 * (np.arange(shape[0]) + 0.5))) / 0.5).astype(int)
    columns = np.floor((origin[0] + 0.5 * (np.arange(shape[1]) + 0.5) - place[0]) / 0.5).astype(int)
    known = dsm[np.ix_(rows, columns)] != -9999
    for number in map(WATER.get, LAKES):
        # 4 m: pointing is relative, and the whole may lie a few metres off.
        assert known[inner(made.classes == number, 8)].mean() < 0.02
    assert known[inner(made.classes == LAND, 8)].mean() > 0.95
    water, level, source = (values[np.ix_(rows, columns)] for values in (water, level, sources[3]))
    for number in (WATER["still"], WATER["ripples"]):  # glint is bright
        lake = inner(made.classes == number, 8)
        assert (water[lake] == 1).mean() > 0.95 and len(np.unique(level[lake & (water == 1)])) == 1
        assert (source[lake & (water == 1)] == Provenance.WATER).all()
    assert (water[made.classes == LAND] == 1).mean() < 0.01
    assert flattened.water == run.result.water == 2 and flattened.water_m2 > 5000
