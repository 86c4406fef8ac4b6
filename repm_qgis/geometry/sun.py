"""The position of the sun, and the shadows that follow from it."""

from __future__ import annotations

import math
from datetime import datetime, timezone
from typing import Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray

_J2000 = datetime(2000, 1, 1, 12, tzinfo=timezone.utc)


def sun_position(moment: datetime, lon: float, lat: float) -> Tuple[float, float]:
    """Azimuth (clockwise from north) and elevation of the sun's centre, degrees; without refraction.

    ``moment`` has a time zone; ``lon`` and ``lat`` are degrees east and north.

    References
    ----------
    The Astronomical Almanac, "Low precision formulas for the Sun's coordinates" (page C5): 0.01 degrees from 1950 to
    2050. Sidereal time: Michalsky, Solar Energy 40 (1988).
    """
    days = (moment - _J2000).total_seconds() / 86400.0
    mean_longitude = 280.460 + 0.9856474 * days
    anomaly = math.radians(357.528 + 0.9856003 * days)
    longitude = math.radians(mean_longitude + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    obliquity = math.radians(23.439 - 4e-7 * days)
    ascension = math.atan2(math.cos(obliquity) * math.sin(longitude), math.cos(longitude))
    declination = math.asin(math.sin(obliquity) * math.sin(longitude))
    sidereal = math.radians((280.46062 + 360.98564737 * days + lon) % 360.0)
    hour_angle, phi = sidereal - ascension, math.radians(lat)
    east = -math.cos(declination) * math.sin(hour_angle)
    north = math.sin(declination) * math.cos(phi) - math.cos(declination) * math.sin(phi) * math.cos(hour_angle)
    up = math.sin(declination) * math.sin(phi) + math.cos(declination) * math.cos(phi) * math.cos(hour_angle)
    return math.degrees(math.atan2(east, north)) % 360.0, math.degrees(math.asin(max(-1.0, min(1.0, up))))


def mean_position(positions: Sequence[Tuple[float, float]]) -> Tuple[float, float]:
    """The mean of one or more positions of the sun (azimuth, elevation), degrees: the direction of their sum."""
    east, north, up = np.sum([_towards(position) for position in positions], axis=0)
    return math.degrees(math.atan2(east, north)) % 360.0, math.degrees(math.atan2(up, math.hypot(east, north)))


def sun_angle(first: Tuple[float, float], second: Tuple[float, float]) -> float:
    """The angle between two positions of the sun (azimuth, elevation), degrees."""
    return math.degrees(math.acos(max(-1.0, min(1.0, float(_towards(first) @ _towards(second))))))


def shadow_shift(first: Tuple[float, float], second: Tuple[float, float]) -> float:
    """The distance between the ends of an object's two shadows on level ground, m for each m of its height.

    Both positions of the sun must be above the horizon.
    """
    ends = [-sun[:2] / sun[2] for sun in (_towards(first), _towards(second))]
    return float(np.linalg.norm(ends[0] - ends[1]))


def _towards(position: Tuple[float, float]) -> FloatArray:
    """(3,) unit vector to the sun (azimuth, elevation): east, north, up."""
    a, e = map(math.radians, position)
    return np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])
