"""Rows agree, and the middle altitude has no disparity: for real RPCs and simulated ones."""

from __future__ import annotations

import numpy as np
import pytest

from repm_qgis.contracts.errors import RpcInvalidError
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.stereo.pairing import ground_points, rectified_pair
from repm_qgis.stereo.parameters import StereoParameters


def rectified(case, points, gdal_pixels):
    """(N, 2) rectified pixels of ground points in both images, projected by GDAL."""
    pair = rectified_pair(case.scene, *case.views, case.bounds, case.altitudes)
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    first, second = (gdal_pixels(view.rpc, ground) for view in case.views)
    return pair, pair.first_rectified(first), pair.second_rectified(second)


def test_rows_of_random_points_agree(case, gdal_pixels):
    _, a, b = rectified(case, case.points(), gdal_pixels)
    assert np.abs(a[:, 1] - b[:, 1]).max() < 0.01


def test_disparity_is_zero_on_the_middle_and_grows_with_height(case, gdal_pixels):
    points = case.points()
    points[:, 2] = sum(case.altitudes) / 2
    _, a, b = rectified(case, points, gdal_pixels)
    assert np.abs(a[:, 0] - b[:, 0]).max() < 0.05
    disparities = []
    for height in np.linspace(*case.altitudes, 4):
        points[:, 2] = height
        _, a, b = rectified(case, points, gdal_pixels)
        disparities.append(a[:, 0] - b[:, 0])
        assert np.ptp(disparities[-1]) < 1.0
    steps = np.diff(np.mean(disparities, axis=1))
    assert (np.abs(steps) > 1).all() and (np.sign(steps) == np.sign(steps[0])).all()


def test_the_frame_holds_the_tile_and_the_scale_stays(case, gdal_pixels):
    points = np.random.default_rng(1).permutation(case.points(300))
    pair, a, _ = rectified(case, points, gdal_pixels)
    inside = (a >= -0.6) & (a <= np.array(pair.size) - 0.4)
    assert inside.all(axis=1).mean() > 0.99
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    original = gdal_pixels(case.views[0].rpc, ground)
    # Distances of neighbours in the rectified and in the original image.
    scale = np.linalg.norm(np.diff(a, axis=0), axis=1) / np.linalg.norm(np.diff(original, axis=0), axis=1)
    assert 0.9 < np.median(scale) < 1.1 and np.percentile(scale, 1) > 0.75 and np.percentile(scale, 99) < 1.35


def test_there_and_back(case, gdal_pixels):
    pair, a, b = rectified(case, case.points(), gdal_pixels)
    np.testing.assert_allclose(pair.first_rectified(pair.first_original(a)), a, atol=1e-4)
    np.testing.assert_allclose(pair.second_rectified(pair.second_original(b)), b, atol=1e-4)


def test_scaled_keeps_pixel_areas_on_pixel_areas(case, gdal_pixels):
    pair, a, b = rectified(case, case.points(), gdal_pixels)
    half = pair.scaled(2.0)
    ground = np.column_stack([geodetic_from_projected(case.crs, case.points()[:, :2]), case.points()[:, 2]])
    for view, full, reduced in zip(case.views, (a, b), (half.first_rectified, half.second_rectified)):
        np.testing.assert_allclose(reduced(gdal_pixels(view.rpc, ground)), (full + 0.5) / 2 - 0.5, atol=1e-6)
    assert half.size == tuple(-(-n // 2) for n in pair.size)


def mirrored(view):
    """The view as if its image had been delivered with its columns in reverse."""
    rpc = view.rpc.to_mapping()
    rpc.update(col_scale=-rpc["col_scale"], col_off=view.width - 1 - rpc["col_off"])
    return view.__class__(**{**vars(view), "rpc": view.rpc.from_mapping(rpc)})


@pytest.mark.parametrize("flip", ((), (0,), (1,), (0, 1)))
@pytest.mark.parametrize("order", ((0, 1), (1, 0)))
@pytest.mark.long
def test_any_order_and_sense_of_columns(case, gdal_pixels, flip, order):
    """Stereo along the track has its baseline along the rows, to which no sense of left and right belongs."""
    views = [mirrored(view) if k in flip else view for k, view in enumerate(case.views)]
    views = [views[k] for k in order]
    points = case.points(200)
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    x0, y0, x1, y1 = case.bounds
    for corner in ((0, 0), (0.4, -0.3), (-0.4, 0.3)):  # parts of the tile have other residual turns
        step = np.array(corner) * (x1 - x0) / 2
        bounds = (x0 + step[0], y0 + step[1], x1 + step[0], y1 + step[1])
        pair = rectified_pair(case.scene, *views, bounds, case.altitudes)
        a = pair.first_rectified(gdal_pixels(views[0].rpc, ground))
        b = pair.second_rectified(gdal_pixels(views[1].rpc, ground))
        assert np.abs(a[:, 1] - b[:, 1]).max() < 0.02
        assert np.abs(np.polyfit(a[:, 0], b[:, 0], 1)[0] - 1) < 0.5


def test_no_baseline_no_pair(case):
    with pytest.raises(RpcInvalidError, match="taken from the same place"):
        rectified_pair(case.scene, case.views[0], case.views[0], case.bounds, case.altitudes)


def test_a_tile_that_one_view_does_not_see_has_no_pair(case):
    away = tuple(value + 1e5 for value in case.bounds)
    assert rectified_pair(case.scene, *case.views, away, case.altitudes) is None


def test_ground_points_are_a_grid_of_the_rectangle(case):
    points = ground_points(case.scene, case.bounds, case.altitudes, 3)
    assert points.shape == (18, 3) and set(points[:, 2]) == set(case.altitudes)


def test_a_shear_leaves_less_beside_the_tile_and_all_disparities(case, gdal_pixels):
    points = case.points()
    _, a, b = rectified(case, points, gdal_pixels)
    upright = rectified_pair(case.scene, *case.views, case.bounds, case.altitudes, StereoParameters(most_shear=0.0))
    sheared = rectified_pair(case.scene, *case.views, case.bounds, case.altitudes)
    assert np.prod(sheared.size) <= np.prod(upright.size)
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    first, second = (gdal_pixels(view.rpc, ground) for view in case.views)
    disparity = upright.first_rectified(first)[:, 0] - upright.second_rectified(second)[:, 0]
    np.testing.assert_allclose(a[:, 0] - b[:, 0], disparity, atol=0.01)
