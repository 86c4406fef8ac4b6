"""Outlines on the ground, and where they meet."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.geometry.footprints import bounds_of, box, footprint, geometry_of, ray_slope, ring, seen_twice
from repm_qgis.geometry.frames import EnuFrame, projected_from_geodetic


def square(x, y, side=10.0):
    return np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]], dtype=float)


def test_footprint_agrees_with_gdals_rpc_transformer(urban):
    view = urban.views[0]
    dataset = gdal.Open(view.image)
    transformer = gdal.Transformer(dataset, None, ["METHOD=RPC", "RPC_HEIGHT=200", "RPC_PIXEL_ERROR_THRESHOLD=0.0001"])
    outline = footprint(view.localise, view.size, 200.0)
    assert outline.shape == (20, 2)
    corners = [(0, 0), (view.width, 0), (view.width, view.height), (0, view.height)]
    for corner, ours in zip(corners, outline[::5]):
        _, (lon, lat, _) = transformer.TransformPoint(0, *map(float, corner))
        metres = projected_from_geodetic(urban.crs, np.array([[lon, lat], ours]))
        assert np.linalg.norm(metres[0] - metres[1]) < 0.01
    transformer = dataset = None


def test_what_two_see():
    assert seen_twice([[square(0, 0), square(5, 0), square(100, 0)]]).GetArea() == pytest.approx(50.0)
    assert seen_twice([[square(0, 0), square(5, 0), square(0, 5)]]).GetArea() == pytest.approx(75.0)
    assert seen_twice([[square(0, 0), square(5, 0)], [square(0, 0), square(7, 0)]]).GetArea() == pytest.approx(50.0)
    assert seen_twice([[square(0, 0), square(20, 0)]]).IsEmpty()
    assert seen_twice([[square(0, 0), square(0, 0)[:2]]]).IsEmpty()
    assert seen_twice([[square(0, 0), square(0, 0)[:3]]]).GetArea() == pytest.approx(50.0)


def test_box_and_bounds():
    assert bounds_of(box((1.0, 2.0, 3.0, 5.0))) == (1.0, 2.0, 3.0, 5.0)
    assert box((1.0, 2.0, 3.0, 5.0)).GetArea() == 6.0


def test_a_ring_goes_around_once_clockwise_from_the_upper_left():
    u, v = np.array([0.0, 1.0, 2.0]), np.array([5.0, 7.0, 9.0])
    expected = [(0, 5), (1, 5), (2, 5), (2, 7), (2, 9), (1, 9), (0, 9), (0, 7)]
    assert ring(u, v).tolist() == [list(map(float, place)) for place in expected]


def test_a_footprint_is_the_border_of_the_pixels_at_an_altitude():
    """A sensor of 0.01 degrees a pixel that cannot place its first columns."""

    def localise(pixels, altitude):
        ground = np.column_stack([10 + 0.01 * pixels[:, 0], 50 - 0.01 * pixels[:, 1], np.full(len(pixels), altitude)])
        ground[pixels[:, 0] < 0] = np.nan
        return ground

    outline = footprint(localise, (100, 60), 300.0, points=3)
    assert outline.shape == (5, 2)  # of eight vertices, three are in the first columns
    np.testing.assert_allclose(outline[:, 0], 10 + 0.01 * np.array([49.5, 99.5, 99.5, 99.5, 49.5]))
    np.testing.assert_allclose(outline[:, 1], 50 - 0.01 * np.array([-0.5, -0.5, 29.5, 59.5, 59.5]))


@pytest.mark.parametrize("east, north", ((0.3, -0.2), (0.0, 0.5), (-0.4, -0.1)))
def test_the_slope_of_a_ray(east, north):
    """A view whose lines of sight go so far east and north for each metre that they rise."""
    frame = EnuFrame(7.0, 46.0, 0.0)

    class View:
        def project(self, lon_lat_h):
            x, y, up = frame.from_geodetic(lon_lat_h)
            return np.array([x - east * up, -(y - north * up)])

        def localise(self, pixels, height):
            x, y = pixels[:, 0] + east * height, -pixels[:, 1] + north * height
            return frame.to_geodetic(np.column_stack([x, y, height]))

    found = ray_slope(View(), np.array([7.0005, 45.9995]), 400.0)
    np.testing.assert_allclose(found, [east, north], atol=2e-4)


def test_polygons_are_made_valid():
    bow = geometry_of(np.array([[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]]))
    assert bow.IsValid() and bow.GetArea() in (pytest.approx(25.0), pytest.approx(50.0))
    assert geometry_of(square(3, 4)).GetArea() == pytest.approx(100.0)


def test_what_touches_only_is_not_seen_twice():
    assert seen_twice([[square(0, 0, 1.0), square(0.5, 0, 1.0)]]).GetArea() == pytest.approx(0.5)
    seen = seen_twice([[square(0, 0), square(10, 0), square(2, 2, 4.0)]])
    assert seen.GetArea() == pytest.approx(16.0) and bounds_of(seen) == (2.0, 2.0, 6.0, 6.0)
