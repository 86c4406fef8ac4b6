"""The sun's place against published values, and shadows against trigonometry."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from repm_qgis.geometry.sun import shadow_shift, sun_angle, sun_position


def utc(*parts):
    return datetime(*parts, tzinfo=timezone.utc)


def test_nrels_example():
    """Reda and Andreas, NREL/TP-560-34302, Table A5.1: azimuth 194.34024, elevation without refraction 39.872046."""
    local = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    azimuth, elevation = sun_position(local, -105.1786, 39.742476)
    assert azimuth == pytest.approx(194.34024, abs=0.02) and elevation == pytest.approx(39.872046, abs=0.02)


def test_meeus_examples():
    """Astronomical Algorithms, 25.a and 28.a: 1992 October 13, 0 h TD (59 s after UT): declination -7.78507 degrees,
    equation of time 13 min 42.6 s. At the pole the elevation is the declination; at longitude 180 and 0 h the
    hour angle is the equation of time."""
    azimuth, elevation = sun_position(utc(1992, 10, 12, 23, 59, 1), 180.0, 90.0)
    assert elevation == pytest.approx(-7.78507, abs=0.02)
    hour_angle = (azimuth - 180.0) - 360.0 * (-59.0 / 86400)
    assert hour_angle == pytest.approx((13 + 42.6 / 60) / 4, abs=0.02)


@pytest.mark.parametrize(
    ("moment", "declination"),
    [
        (utc(2000, 3, 20, 7, 35), 0.0),
        (utc(2012, 6, 20, 23, 9), 23.44),
        (utc(2012, 12, 21, 11, 12), -23.44),
        (utc(2021, 9, 22, 19, 21), 0.0),
    ],
)
def test_equinoxes_and_solstices(moment, declination):
    """Times published by the US Naval Observatory, to the minute."""
    assert sun_position(moment, 0.0, 90.0)[1] == pytest.approx(declination, abs=0.02)


def test_directions_and_hemispheres():
    noon = utc(2012, 6, 21, 12, 0)
    north_azimuth, north = sun_position(noon, 0.0, 50.0)
    south_azimuth, south = sun_position(noon, 0.0, -30.0)
    assert north_azimuth == pytest.approx(180, abs=1.5) and north == pytest.approx(90 - 50 + 23.44, abs=0.1)
    assert min(south_azimuth, 360 - south_azimuth) < 1.5 and south == pytest.approx(90 - 30 - 23.44, abs=0.1)
    assert 60 < sun_position(utc(2012, 6, 21, 6, 0), 0.0, 50.0)[0] < 90  # morning: east
    assert sun_position(utc(2012, 6, 21, 0, 0), 0.0, 40.0)[1] < 0
    for lon in (-180.0, 180.0, 540.0):
        np.testing.assert_allclose(sun_position(noon, lon, 10.0), sun_position(noon, 180.0, 10.0), atol=1e-9)


def test_vendors_own_azimuth(shared_data):
    """The mean azimuth in Maxar's file of a WorldView-2 product, 162.1 degrees."""
    from repm_qgis.rpc.readers import read_rpc_file

    path = shared_data / "rpc" / "other" / "rpc_WV2.xml"
    assert "<MEANSUNAZ>1.621000000000000e+02<" in path.read_text()
    rpc = read_rpc_file(str(path))
    azimuth, _ = sun_position(utc(2015, 9, 30, 10, 56, 57), rpc.lon_off, rpc.lat_off)
    assert azimuth == pytest.approx(162.1, abs=0.1)


def test_angles_and_shadows():
    assert sun_angle((120.0, 40.0), (120.0, 70.0)) == pytest.approx(30.0)
    assert sun_angle((0.0, 90.0), (200.0, 60.0)) == pytest.approx(30.0)
    assert sun_angle((10.0, 30.0), (10.0, 30.0)) == pytest.approx(0.0, abs=1e-5)
    assert sun_angle((90.0, 10.0), (270.0, 20.0)) == pytest.approx(150.0)
    assert sun_angle((90.0, 0.0), (270.0, 0.0)) == pytest.approx(180.0)
    # 45 degrees high: a shadow as long as the thing is high; from the east and from the south they end sqrt(2) apart.
    assert shadow_shift((90.0, 45.0), (180.0, 45.0)) == pytest.approx(np.sqrt(2))
    assert shadow_shift((150.0, 30.0), (150.0, 60.0)) == pytest.approx(np.sqrt(3) - 1 / np.sqrt(3))
