"""Coordinate frames against PROJ's own operations."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from repm_qgis.contracts.errors import OptionError
from repm_qgis.geometry.frames import (
    EnuFrame,
    ecef_from_geodetic,
    flat_crs,
    geodetic_from_ecef,
    geodetic_from_projected,
    projected_crs,
    projected_crs_at,
    projected_from_geodetic,
    utm_crs,
    vertical_operations,
    vertical_part,
)

PLACES = np.array(
    [
        [1.44, 43.6, 190.0],
        [-179.9, -17.0, 1200.0],
        [151.2, -33.9, -20.0],
        [6.9, 45.8, 4800.0],
        [18.5, -72.2, 500.0],
        [0.0, 0.0, 0.0],
        [-70.0, 89.9, 10.0],
    ]
)


def test_ecef_agrees_with_epsg_4978():
    transformer = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    expected = np.stack(transformer.transform(*PLACES.T), axis=-1)
    found = ecef_from_geodetic(PLACES)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(geodetic_from_ecef(found)[:, :2], PLACES[:, :2], rtol=0, atol=1e-11)
    np.testing.assert_allclose(geodetic_from_ecef(found)[:, 2], PLACES[:, 2], rtol=0, atol=1e-6)


@pytest.mark.parametrize("place", PLACES.tolist())
def test_enu_agrees_with_projs_topocentric(place):
    lon, lat, height = place
    pipeline = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0={height}"
    )
    points = place + np.random.default_rng(0).uniform(-1, 1, (50, 3)) * [0.05, 0.05, 2000]
    expected = np.stack(pipeline.transform(*points.T), axis=-1)
    frame = EnuFrame(lon, lat, height)
    found = frame.from_geodetic(points)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    again = frame.to_geodetic(found)
    again[:, 0] = points[:, 0] + (again[:, 0] - points[:, 0] + 180) % 360 - 180
    np.testing.assert_allclose(again[:, 2], points[:, 2], rtol=0, atol=1e-6)
    np.testing.assert_allclose(again[:, :2], points[:, :2], rtol=0, atol=1e-11 / np.cos(np.radians(min(lat, 89))))


def test_the_origin_is_zero_and_shapes_are_kept():
    frame = EnuFrame(1.44, 43.6, 190.0)
    np.testing.assert_allclose(frame.from_geodetic(np.array([1.44, 43.6, 190.0])), 0.0, atol=1e-8)
    assert frame.from_geodetic(np.zeros((2, 3, 3)) + PLACES[0]).shape == (2, 3, 3)
    assert EnuFrame.from_mapping(frame.to_mapping()) == frame


@pytest.mark.parametrize(
    "lon, lat, code",
    (
        (1.44, 43.6, 32631),
        (151.2, -33.9, 32756),
        (-180.0, 10.0, 32601),
        (180.0, 10.0, 32601),
        (179.99, 10.0, 32660),
        (-0.01, -0.01, 32730),
        (0.0, 0.0, 32631),  # the equator counts as northern
        (-58.4, -34.6, 32721),  # Buenos Aires
        (-58.4, 34.6, 32621),
        (5.999, 1.0, 32631),
        (6.0, 1.0, 32632),
    ),
)
def test_utm_zone_is_one_whose_domain_holds_the_point(lon, lat, code):
    assert utm_crs(lon, lat) == f"EPSG:{code}"
    area = pyproj.CRS(utm_crs(lon, lat)).area_of_use
    assert area.west <= (lon if lon < 180 else -180) <= area.east and area.south <= lat <= area.north


def test_projecting_agrees_with_pyproj():
    for crs, (lon, lat) in (("EPSG:32631", (1.44, 43.6)), ("EPSG:2154", (1.44, 43.6)), ("EPSG:2193", (175.0, -41.0))):
        expected = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
        found = projected_from_geodetic(crs, np.array([[lon, lat, 99.0]]))
        np.testing.assert_allclose(found[0], expected, rtol=0, atol=1e-6)
        np.testing.assert_allclose(geodetic_from_projected(crs, found)[0], [lon, lat], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "text, words",
    (
        ("EPSG:4326", "must be a projected CRS"),
        ("EPSG:4978", "must be a projected CRS"),
        ("no such thing", "is not a coordinate reference system that PROJ knows"),
        ("EPSG:999999", "is not a coordinate reference"),
        ("EPSG:2263", "metres"),
        ("EPSG:32631+5773", "without a vertical"),
    ),
)
def test_a_dsm_needs_a_projected_crs_in_metres(text, words):
    with pytest.raises(OptionError) as caught:
        projected_crs(text)
    assert words in str(caught.value) and repr(text) in str(caught.value)


def test_an_empty_crs_is_named_as_empty():
    with pytest.raises(OptionError, match="CRS is empty: it is not a coordinate reference system that PROJ knows"):
        projected_crs("")


@pytest.mark.parametrize(
    "text", ("EPSG:32631", "EPSG:2154", "EPSG:2193", "EPSG:3035", "+proj=laea +lat_0=43 +lon_0=1 +datum=WGS84 +units=m")
)
def test_usual_projections_are_taken(text):
    assert projected_crs(text).is_projected


@pytest.mark.parametrize(
    "text, fit",
    (
        ("EPSG:32631", True),
        ("EPSG:2154", True),
        ("EPSG:3857", True),
        ("EPSG:3035", True),
        ("EPSG:3031", False),
        ("+proj=ortho +lat_0=-43 +lon_0=-178 +datum=WGS84 +units=m", False),
        ("+proj=laea +lat_0=-43.6 +lon_0=-178.56 +datum=WGS84", False),
    ),
)
def test_a_crs_must_be_made_for_the_place(text, fit):
    if fit:
        assert projected_crs_at(text, 1.44, 43.6).is_projected
    else:
        with pytest.raises(OptionError) as caught:
            projected_crs_at(text, 1.44, 43.6)
        assert "longitude 1.44, latitude 43.60" in str(caught.value) and "such as EPSG:32631" in str(caught.value)


def test_a_frame_as_a_matrix():
    frame = EnuFrame(6.9, 45.8)
    assert frame.height == 0.0
    enu = np.random.default_rng(3).uniform(-5000, 5000, (20, 3))
    xyz = np.column_stack([enu, np.ones(20)]) @ frame.ecef_from_enu.T
    np.testing.assert_allclose(xyz[:, :3], ecef_from_geodetic(frame.to_geodetic(enu)), atol=1e-6)
    assert (xyz[:, 3] == 1.0).all()


@pytest.mark.parametrize("scale, fits", ((0.51, True), (0.49, False), (1.39, True)))
def test_metres_of_a_crs_are_metres_there_to_a_factor_of_two(scale, fits):
    """An equirectangular projection that is true at one latitude: x is too long by cos(that) / cos(45)."""
    true_at = np.degrees(np.arccos(np.cos(np.radians(45.0)) * scale))
    text = f"+proj=eqc +lat_ts={true_at} +datum=WGS84"
    if fits:
        assert projected_crs_at(text, 5.0, 45.0).is_projected
    else:
        with pytest.raises(OptionError, match="is not made for longitude 5.00, latitude 45.00"):
            projected_crs_at(text, 5.0, 45.0)


@pytest.mark.parametrize("lat, fits", ((59.5, True), (60.5, False)))
def test_mercator_doubles_lengths_at_sixty_degrees(lat, fits):
    if fits:
        assert projected_crs_at("EPSG:3395", 5.0, lat).is_projected
    else:
        with pytest.raises(OptionError, match="is not made for"):
            projected_crs_at("EPSG:3395", 5.0, lat)


def test_parts_of_a_crs():
    flat, compound, tall = (pyproj.CRS(code) for code in ("EPSG:32631", "EPSG:32631+5773", "EPSG:4979"))
    upright = pyproj.CRS("EPSG:32631").to_3d()
    assert flat_crs(flat) == flat and flat_crs(compound) == flat
    for crs, expected in ((tall, "EPSG:4326"), (upright, "EPSG:32631")):
        found = flat_crs(crs)
        assert len(found.axis_info) == 2 and found == pyproj.CRS(expected)
    assert vertical_part(flat) is None and vertical_part(compound) == "EGM96 height"
    assert vertical_part(tall) == vertical_part(upright) == "ellipsoidal height (WGS 84)"


def test_operations_without_bounds_and_those_of_a_place():
    """Without ballpark operations, and with the grids that are missing by name."""
    source, target = pyproj.CRS("EPSG:4979"), pyproj.CRS("EPSG:4326+5773")
    for bounds in ((5.0, 45.0, 6.0, 46.0), (0.0, 0.0, 0.0, 0.0)):
        group, missing = vertical_operations(source, target, bounds)
        assert group.transformers or missing
        assert all(name.endswith((".tif", ".gtx")) for name in missing)
        if group.transformers:
            assert abs(group.transformers[0].transform(5.5, 45.5, 0.0)[2]) > 40
