"""Heights and places of matched pixels against the ground points they come from, projected by GDAL."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from repm_qgis.contracts.errors import EmptyResultError
from repm_qgis.geometry.frames import geodetic_from_projected
from repm_qgis.stereo.pairing import rectified_pair
from repm_qgis.stereo.triangulation import NodeTable, pair_geometry, verticals


def at(table, points):
    """(N,) values of a table at (N, 3) columns, rows and third variables."""
    return np.array([table.on_grid(np.array([c]), np.array([r]), np.array([[t]]))[0, 0] for c, r, t in points])


@pytest.fixture(scope="session")
def geometry(case):
    pair = rectified_pair(case.scene, *case.views, case.bounds, case.altitudes)
    return pair, pair_geometry(pair, *case.views, case.altitudes, case.crs)


@pytest.mark.long
def test_heights_and_places_are_those_of_the_ground(case, geometry, gdal_pixels):
    pair, table = geometry
    points = case.points(400, 3)
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    a = pair.first_rectified(gdal_pixels(case.views[0].rpc, ground))
    b = pair.second_rectified(gdal_pixels(case.views[1].rpc, ground))
    height = at(table.height, np.column_stack([a, a[:, 0] - b[:, 0]]))
    assert np.abs(height - points[:, 2]).max() < 0.01
    places = np.column_stack([a, points[:, 2]])
    assert np.abs(at(table.x, places) - points[:, 0]).max() < 0.01
    assert np.abs(at(table.y, places) - points[:, 1]).max() < 0.01
    assert table.error_m < 0.01 and table.vertical_parallax_px < 0.02


def test_measured_pixels_meet_where_least_squares_says(case, geometry, gdal_pixels):
    """Pixels with matching's errors: the height is that of the point which fits both images best."""
    pair, table = geometry
    points = case.points(12, 5)
    numbers = np.random.default_rng(2)
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    a = pair.first_rectified(gdal_pixels(case.views[0].rpc, ground))
    disparity = a[:, 0] - pair.second_rectified(gdal_pixels(case.views[1].rpc, ground))[:, 0]
    disparity += numbers.normal(0, 0.3, 12)
    height = at(table.height, np.column_stack([a, disparity]))
    first = pair.first_original(a)
    second = pair.second_original(np.column_stack([a[:, 0] - disparity, a[:, 1]]))
    scale = np.array([1e-5, 1e-5, 1.0])
    for k in range(12):

        def misfit(step, k=k):
            place = ground[k] + step * scale
            return np.concatenate(
                [case.views[0].rpc.project(place) - first[k], case.views[1].rpc.project(place) - second[k]]
            )

        best = ground[k] + least_squares(misfit, np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14).x * scale
        assert height[k] == pytest.approx(best[2], abs=0.02)


def test_ranges_and_scale(case, geometry):
    _, table = geometry
    span = table.disparities[1] - table.disparities[0]
    assert table.disparities[0] < 0 < table.disparities[1]
    assert table.metres_per_px == pytest.approx(np.ptp(case.altitudes) / span, rel=0.1)


def test_parabolas_are_single_precision_and_gaps_stay():
    columns, rows = np.linspace(0, 200, 8), np.linspace(0, 90, 4)
    third = np.broadcast_to(np.linspace(-20, 30, 5)[:, None, None], (5, 4, 8))

    def height(c, r, t):
        return 3 + 0.1 * c - 0.2 * r + 0.01 * c * r + (5 - 0.002 * r) * t - 0.01 * t**2

    c, r = np.meshgrid(columns, rows)
    table, left = NodeTable.fit(columns, rows, third, height(c, r, third))
    assert left < 1e-9
    x, y = np.arange(0, 200.0, 7), np.arange(3, 90.0, 5)
    t = np.random.default_rng(0).uniform(-20, 30, (len(y), len(x)))
    c, r = np.meshgrid(x, y)
    # Single precision of the differences from the middle, which are up to 400 here.
    np.testing.assert_allclose(table.on_grid(x, y, t), height(c, r, t), rtol=0, atol=400 * 2.0**-23)
    t[1, 2] = np.nan
    assert np.argwhere(np.isnan(table.on_grid(x, y, t))).tolist() == [[1, 2]]


def test_pointing_is_part_of_the_geometry(case, gdal_pixels):
    """A view that really looks 3 px beside its RPC: heights come out right all the same."""
    first, second = case.views
    moved = second.with_pointing(np.array([[1.0, 0, 3.0], [0, 1.0, -2.0]]))
    pair = rectified_pair(case.scene, first, moved, case.bounds, case.altitudes)
    table = pair_geometry(pair, first, moved, case.altitudes, case.crs)
    points = case.points(100, 4)
    ground = np.column_stack([geodetic_from_projected(case.crs, points[:, :2]), points[:, 2]])
    a = pair.first_rectified(gdal_pixels(first.rpc, ground))
    b = pair.second_rectified(gdal_pixels(second.rpc, ground) + [3.0, -2.0])
    height = at(table.height, np.column_stack([a, a[:, 0] - b[:, 0]]))
    assert np.abs(height - points[:, 2]).max() < 0.01


def test_verticals_lean_as_the_rpcs_say(case, gdal_pixels):
    """A mast of 40 m: where its foot and its top are in the rectified first image, and where its pixel's ray goes."""
    first, second = case.views
    pair = rectified_pair(case.scene, first, second, case.bounds, case.altitudes)
    geometry = pair_geometry(pair, first, second, case.altitudes, case.crs)
    ray, lean = verticals(geometry.x, geometry.y)
    foot = case.points(50, 6)
    top = foot + [0.0, 0.0, 40.0]
    place = [
        pair.first_rectified(
            gdal_pixels(first.rpc, np.column_stack([geodetic_from_projected(case.crs, p[:, :2]), p[:, 2]]))
        )
        for p in (foot, top)
    ]
    np.testing.assert_allclose((place[1] - place[0]) / 40.0, np.tile(lean, (50, 1)), atol=0.01)
    below = [at(table, np.column_stack([place[1], foot[:, 2]])) for table in (geometry.x, geometry.y)]
    np.testing.assert_allclose((top[:, :2] - np.column_stack(below)) / 40.0, np.tile(ray, (50, 1)), atol=0.005)
    seen = [
        pair.second_rectified(
            gdal_pixels(second.rpc, np.column_stack([geodetic_from_projected(case.crs, p[:, :2]), p[:, 2]]))
        )
        for p in (foot, top)
    ]
    parallax = (place[1] - place[0] - seen[1] + seen[0])[:, 0]
    np.testing.assert_allclose((place[1] - place[0])[:, 0] / parallax, geometry.relief_displacement, atol=0.02)


def test_no_common_ground_is_said(case):
    pair = rectified_pair(case.scene, *case.views, case.bounds, case.altitudes)
    nowhere = case.views[1].__class__(**{**vars(case.views[1]), "pointing": np.full((2, 3), np.nan)})
    with pytest.raises(EmptyResultError, match="share no ground within"):
        pair_geometry(pair, case.views[0], nowhere, case.altitudes, case.crs)
