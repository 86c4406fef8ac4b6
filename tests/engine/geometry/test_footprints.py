"""Outlines on the ground, and where they meet."""

from __future__ import annotations

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.geometry.footprints import bounds_of, box, footprint, seen_twice
from repm_qgis.geometry.frames import projected_from_geodetic


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


def test_box_and_bounds():
    assert bounds_of(box((1.0, 2.0, 3.0, 5.0))) == (1.0, 2.0, 3.0, 5.0)
    assert box((1.0, 2.0, 3.0, 5.0)).GetArea() == 6.0
