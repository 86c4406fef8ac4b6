"""True lengths and areas: a CRS's local scale against PROJ's geodesics on the ellipsoid."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from repm_qgis.geometry.ground_metric import GroundMetric, metric_at

_GEOD = pyproj.Geod(ellps="WGS84")


@pytest.mark.parametrize(
    "crs, lon, lat",
    [
        ("EPSG:32631", 3.0, 43.0),
        ("EPSG:32631", 5.9, 60.0),
        ("EPSG:3857", 10.0, 60.0),
        ("EPSG:3857", -70.0, -45.0),
        ("EPSG:4326", 10.0, 60.0),
        ("EPSG:4087", 10.0, 60.0),
        ("EPSG:3035", 20.0, 65.0),
        ("EPSG:2229", -118.0, 34.0),
        ("EPSG:3413", 179.9999, 80.0),
    ],
)
def test_lengths_and_areas_are_those_of_the_ellipsoid(crs, lon, lat):
    system = pyproj.CRS(crs)
    to_degrees = pyproj.Transformer.from_crs(system, "EPSG:4326", always_xy=True)
    x, y = to_degrees.transform(lon, lat, direction="INVERSE")
    metric, unit = GroundMetric.at(system, x, y), 1e-3 if system.is_geographic else 100.0
    xs, ys = np.array([x - unit, x + unit, x, x]), np.array([y, y, y - unit, y + unit])
    lons, lats = to_degrees.transform(xs, ys)
    east, north = (_GEOD.inv(lons[k], lats[k], lons[k + 1], lats[k + 1])[2] / (2 * unit) for k in (0, 2))
    assert metric.per_unit == pytest.approx((east, north), rel=1e-6)
    corners = to_degrees.transform([x - unit, x + unit, x + unit, x - unit], [y - unit, y - unit, y + unit, y + unit])
    area = abs(_GEOD.polygon_area_perimeter(*corners)[0]) / (2 * unit) ** 2
    assert metric.area_per_unit == pytest.approx(area, rel=1e-5)


def test_a_crs_that_distorts_is_named_with_a_better_one():
    (finding,) = metric_at("EPSG:3857", 10.0, 60.0).finding("EPSG:3857")
    assert finding.id == "crs-distorts" and "up to 2 m" in finding and "EPSG:32632" in finding
    assert not metric_at("EPSG:3857", 10.0, 1.0).finding("x")  # true to scale at the equator
    for crs in ("EPSG:32632", "EPSG:25832"):
        assert metric_at(crs, 11.9, 60.0).finding(crs) == ()
