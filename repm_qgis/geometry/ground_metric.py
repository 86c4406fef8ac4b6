"""True lengths, areas and directions on the ground from coordinates of a map: the local scale of a CRS.

A map's metres are not metres on the ground: UTM's are off by up to 0.1 %, Web Mercator's by a factor of two at 60
degrees of latitude, and degrees are none at all. All that is stated in metres is measured with this module, on the
ellipsoid (Snyder 1987, Map Projections: A Working Manual, USGS Professional Paper 1395, chapter 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Optional, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import FloatArray
from ..contracts.findings import Finding
from .frames import flat_crs, projected_from_geodetic, utm_crs

MOST_DISTORTION = 0.01
"""The share by which a CRS may stretch lengths before it is named: UTM stays below a tenth of it in its zone."""
_STEP_M = 10.0  # of the differences that give the scale: their error is below 1e-9


@dataclass(frozen=True)
class GroundMetric:
    """The scale of a CRS at one place: ``jacobian`` (2, 2) has the metres east and north on the ground of one unit of x
    (first column) and of y; ``unit_m`` is the unit's nominal length in metres, None for degrees; ``place`` (longitude,
    latitude)."""

    jacobian: FloatArray
    unit_m: Optional[float]
    place: Tuple[float, float]

    @classmethod
    def at(cls, crs: pyproj.CRS, x: float, y: float) -> GroundMetric:
        """The scale at x, y of a CRS, of which only the horizontal part counts."""
        return _at(flat_crs(crs), float(x), float(y))

    @property
    def per_unit(self) -> Tuple[float, float]:
        """How many metres on the ground one unit of x and one of y have."""
        x, y = np.linalg.norm(self.jacobian, axis=0)
        return float(x), float(y)

    @property
    def area_per_unit(self) -> float:
        """How many square metres on the ground a square of one unit has."""
        return float(abs(np.linalg.det(self.jacobian)))

    @property
    def distortion(self) -> float:
        """By which share the CRS stretches or shrinks lengths at most; 0 for degrees, which are no lengths."""
        if self.unit_m is None:
            return 0.0
        stretch = np.linalg.svd(self.jacobian, compute_uv=False) / self.unit_m
        return float(max(1.0 / stretch.min(), stretch.max()) - 1.0) if stretch.min() > 0 else math.inf

    def finding(self, what: str) -> Tuple[Finding, ...]:
        """A warning where what is in this CRS ("the CRS", "'a.tif'") is distorted by more than 1 %, with a better CRS;
        none elsewhere."""
        if self.distortion <= MOST_DISTORTION:
            return ()
        longest = 1.0 / float(np.linalg.svd(self.jacobian, compute_uv=False).min()) * (self.unit_m or 1.0)
        text = f"A metre on the ground is up to {longest:.3g} m in the coordinate reference system of {what}"
        return (
            Finding("crs-distorts", f"{text}: use one that is true to scale there, such as {utm_crs(*self.place)}."),
        )


def metric_at(crs: str, lon: float, lat: float) -> GroundMetric:
    """The scale of a projected CRS at a longitude and latitude, degrees."""
    x, y = projected_from_geodetic(crs, np.array([lon, lat]))
    return GroundMetric.at(pyproj.CRS.from_user_input(crs), x, y)


@lru_cache(maxsize=256)
def _at(crs: pyproj.CRS, x: float, y: float) -> GroundMetric:
    axis = crs.axis_info[0].unit_conversion_factor if crs.axis_info else 1.0
    ellipsoid = crs.ellipsoid
    if ellipsoid is None or not (crs.is_projected or crs.is_geographic):
        return GroundMetric(np.eye(2) * (axis or 1.0), axis or 1.0, (0.0, 0.0))
    a, b = ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre
    e2 = 1.0 - (b / a) ** 2
    step = (_STEP_M / a if crs.is_geographic else _STEP_M) / axis  # a factor is in radians or metres
    xs, ys = np.array([x + step, x - step, x, x, x]), np.array([y, y, y + step, y - step, y])
    lon, lat = _to_degrees(crs).transform(xs, ys)
    middle = math.radians(lat[4])
    w = math.sqrt(1.0 - e2 * math.sin(middle) ** 2)
    east, north = a * math.cos(middle) / w, a * (1.0 - e2) / w**3  # m per radian
    turned = (np.diff([lon[1], lon[0]])[0], np.diff([lon[3], lon[2]])[0])
    d_lon = np.radians([(each + 180.0) % 360.0 - 180.0 for each in turned])
    d_lat = np.radians([lat[0] - lat[1], lat[2] - lat[3]])
    jacobian = np.stack([d_lon * east, d_lat * north]) / (2.0 * step)
    unit = float(axis) if crs.is_projected else None
    if not np.isfinite(jacobian).all():  # beyond the projection's edge, where nothing is measured
        return GroundMetric(np.eye(2) * (axis or 1.0), unit, (0.0, 0.0))
    return GroundMetric(jacobian, unit, (float(lon[4]), float(lat[4])))


@lru_cache(maxsize=64)
def _to_degrees(crs: pyproj.CRS) -> pyproj.Transformer:
    return pyproj.Transformer.from_crs(crs, crs.geodetic_crs or "EPSG:4326", always_xy=True)
