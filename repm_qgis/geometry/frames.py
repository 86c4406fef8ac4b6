"""Geodetic, geocentric (ECEF), local (ENU) and projected coordinates on WGS 84.

Longitude and latitude are in degrees, heights in metres above the WGS 84 ellipsoid, everything else in metres.
"""

from __future__ import annotations

import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, List, Optional, Sequence, Tuple, Type

import numpy as np
import pyproj
from osgeo import osr
from pyproj.aoi import AreaOfInterest
from pyproj.transformer import TransformerGroup

from ..contracts.arrays import FloatArray
from ..contracts.checks import Number
from ..contracts.errors import ImageError, OptionError, RepmError
from ..contracts.record import Record

_TO_ECEF = "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84"


@lru_cache(maxsize=1)
def _ecef_transformer() -> pyproj.Transformer:
    return pyproj.Transformer.from_pipeline(_TO_ECEF)


def ecef_from_geodetic(lon_lat_h: FloatArray) -> FloatArray:
    """(..., 3) longitude, latitude, height to (..., 3) geocentric X, Y, Z in metres."""
    points = np.asarray(lon_lat_h, dtype=np.float64)
    return np.stack(_ecef_transformer().transform(points[..., 0], points[..., 1], points[..., 2]), axis=-1)


def geodetic_from_ecef(xyz_ecef_m: FloatArray) -> FloatArray:
    """(..., 3) geocentric X, Y, Z to (..., 3) longitude, latitude, height."""
    x, y, z = np.moveaxis(np.asarray(xyz_ecef_m, dtype=np.float64), -1, 0)
    inverse = pyproj.enums.TransformDirection.INVERSE
    return np.stack(_ecef_transformer().transform(x, y, z, direction=inverse), axis=-1)


@dataclass(frozen=True)
class EnuFrame(Record):
    """East, north, up at one point of the ellipsoid, in metres."""

    lon: Annotated[float, Number(-360, 360, "degrees")]
    lat: Annotated[float, Number(-90, 90, "degrees")]
    height: Annotated[float, Number(-22_000, 20_000, "m")] = 0.0

    @property
    def _rotation(self) -> FloatArray:
        """(3, 3) rows are east, north and up in ECEF."""
        (sin_lon, sin_lat), (cos_lon, cos_lat) = (f(np.radians([self.lon, self.lat])) for f in (np.sin, np.cos))
        north = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]
        return np.array([[-sin_lon, cos_lon, 0.0], north, [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat]])

    @property
    def _origin(self) -> FloatArray:
        return ecef_from_geodetic(np.array([self.lon, self.lat, self.height]))

    @property
    def ecef_from_enu(self) -> FloatArray:
        """(4, 4) matrix that takes homogeneous east, north, up to geocentric X, Y, Z, metres."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self._rotation.T, self._origin
        return matrix

    def from_geodetic(self, lon_lat_h: FloatArray) -> FloatArray:
        """(..., 3) longitude, latitude, height to (..., 3) east, north, up."""
        return (ecef_from_geodetic(lon_lat_h) - self._origin) @ self._rotation.T

    def to_geodetic(self, enu_m: FloatArray) -> FloatArray:
        """(..., 3) east, north, up to (..., 3) longitude, latitude, height."""
        return geodetic_from_ecef(np.asarray(enu_m, dtype=np.float64) @ self._rotation + self._origin)


def mean_place(places: FloatArray) -> FloatArray:
    """(D,) the mean of (N, D) longitudes, latitudes and what follows: across the line of 180 degrees, 179.9 and -179.9
    have the mean 180, and not 0 on the other side of the Earth."""
    middle: FloatArray = np.mean(places, axis=0)
    lon = places[:, 0]
    if np.ptp(lon) > 180.0:
        middle[0] = lon[0] + np.mean((lon - lon[0] + 180.0) % 360.0 - 180.0)
    return middle


def utm_crs(lon: float, lat: float) -> str:
    """The PROJ name of the UTM zone a point lies in, southern hemisphere included: ``EPSG:32631``."""
    zone = int(np.floor((lon + 180.0) / 6.0)) % 60 + 1
    return f"EPSG:{(32600 if lat >= 0 else 32700) + zone}"


def projected_crs(text: str) -> pyproj.CRS:
    """Parse a CRS and check that it is projected, in metres, and horizontal only; raises OptionError otherwise."""
    try:
        crs = pyproj.CRS.from_user_input(text)
    except pyproj.exceptions.CRSError as error:
        raise OptionError("CRS", text, f"is not a coordinate reference system that PROJ knows ({error})") from error
    if not crs.is_projected:
        raise OptionError("CRS", text, "must be a projected CRS, such as UTM: a DSM's cells are in metres")
    if len(crs.axis_info) != 2:
        raise OptionError("CRS", text, "must be one without a vertical part: heights are above the WGS 84 ellipsoid")
    if any(abs(axis.unit_conversion_factor - 1.0) > 1e-9 for axis in crs.axis_info):
        raise OptionError("CRS", text, f"is in {crs.axis_info[0].unit_name}: choose one in metres")
    return crs


def projected_crs_at(text: str, lon: float, lat: float) -> pyproj.CRS:
    """:func:`projected_crs` that also suits a place: its metres are, within a factor of two, metres there.

    Web Mercator does up to 60 degrees of latitude; a polar projection at the equator, or a zone on the other side of
    the Earth, does not.
    """
    crs = projected_crs(text)
    ends = EnuFrame(lon, lat).to_geodetic(np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0]]))
    xy = projected_from_geodetic(text, ends)
    with np.errstate(invalid="ignore"):
        units = (xy[1:] - xy[0]) / 100.0
    scales = np.linalg.svd(units, compute_uv=False) if np.isfinite(units).all() else np.zeros(2)
    if scales.min() < 0.5 or scales.max() > 2.0:
        remedy = f"choose one of that place, such as {utm_crs(lon, lat)}"
        raise OptionError("CRS", text, f"is not made for longitude {lon:.2f}, latitude {lat:.2f}: {remedy}")
    return crs


def on_earth(crs: pyproj.CRS, path: str, error: Type[RepmError] = ImageError) -> pyproj.CRS:
    """A file's CRS, which PROJ can bring to others: local CRSs of drawings and sites lie nowhere on the Earth.

    Raises the error with the file's name for one of those.
    """
    if "Engineering" in crs.type_name or any("Engineering" in part.type_name for part in crs.sub_crs_list):
        raise error(
            f"'{path}' has a local coordinate reference system ({crs.name}), which lies nowhere on the Earth: assign "
            "the right one (Raster > Projections > Assign projection) and try again."
        )
    return crs


def flat_crs(crs: pyproj.CRS) -> pyproj.CRS:
    """The horizontal part of a CRS."""
    if crs.is_compound:
        return crs.sub_crs_list[0]
    if len(crs.axis_info) < 3:
        return crs
    reference = osr.SpatialReference()
    reference.ImportFromWkt(crs.to_wkt("WKT2_2019"))
    reference.DemoteTo2D("")
    return pyproj.CRS.from_wkt(reference.ExportToWkt(["FORMAT=WKT2_2018"]))


def vertical_part(crs: pyproj.CRS) -> Optional[str]:
    """The name of a CRS's vertical part: a vertical CRS's, "ellipsoidal height", or None where it has none."""
    if crs.is_compound:
        return crs.sub_crs_list[1].name
    ellipsoid = crs.ellipsoid.name if crs.ellipsoid is not None else "unknown"
    name = "WGS 84" if is_world_ellipsoid(crs) else ellipsoid
    return f"ellipsoidal height ({name})" if len(crs.axis_info) == 3 else None


def is_world_ellipsoid(crs: pyproj.CRS) -> bool:
    """Whether a CRS has the ellipsoid of WGS 84, or that of GRS 1980, which is the same to 0.1 mm."""
    return crs.ellipsoid is not None and crs.ellipsoid.name in ("WGS 84", "GRS 1980")


def vertical_operations(
    source: pyproj.CRS, target: pyproj.CRS, bounds: Tuple[float, float, float, float]
) -> Tuple[TransformerGroup, List[str]]:
    """PROJ's operations from one CRS with heights to another, best first, and the grids that others lack.

    ``bounds`` are west, south, east, north in degrees. "Ballpark" operations, which do not change heights, are not
    included.
    """
    found = _operations(source, target, bounds)
    folder = pyproj.datadir.get_user_data_dir()  # type: ignore[attr-defined,unused-ignore]
    if any(os.path.exists(os.path.join(folder, grid)) for grid in found[1]):
        # Grids may have been installed since the last request, but a context (PROJ 9.5) remembers which were missing.
        # Each thread has its own context.
        with ThreadPoolExecutor(1) as thread:
            found = thread.submit(_operations, source, target, bounds).result()
    return found


def _operations(
    source: pyproj.CRS, target: pyproj.CRS, bounds: Tuple[float, float, float, float]
) -> Tuple[TransformerGroup, List[str]]:
    west, south, east, north = bounds
    area: Any = AreaOfInterest(west, south, east, north) if east > west and north > south else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of missing grids: the caller reports them
        group = TransformerGroup(source, target, always_xy=True, area_of_interest=area, allow_ballpark=False)
    grids = [grid for operation in group.unavailable_operations for grid in operation.grids]
    return group, sorted({grid.short_name for grid in grids if not grid.available})


def install_grid(missing: Sequence[str]) -> str:
    """How to give PROJ one of the grids that it lacks: "fetch it in QGIS (...), or put ... into the folder ...".

    PROJ looks into that folder of the user's on every system, needs no administrator for it and no restart. Debian's
    package proj-data has few grids: EGM2008 is not among them.
    """
    name = next((name for name in missing if name.endswith(".tif")), missing[0])
    folder = pyproj.datadir.get_user_data_dir()  # type: ignore[attr-defined,unused-ignore]
    by_hand = f"put https://cdn.proj.org/{name} into the folder '{folder}'"
    return f"fetch it in QGIS (Plugins > REPM > Geoid grids...), or {by_hand}"


@lru_cache(maxsize=32)
def _to_wgs84(crs: str) -> pyproj.Transformer:
    return pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)


def projected_from_geodetic(crs: str, lon_lat: FloatArray) -> FloatArray:
    """(..., 2 or more) longitude, latitude (further members ignored) to (..., 2) x, y in ``crs``."""
    points = np.asarray(lon_lat, dtype=np.float64)
    result = _to_wgs84(crs).transform(points[..., 0], points[..., 1], direction=pyproj.enums.TransformDirection.INVERSE)
    return np.stack(result, axis=-1)


def geodetic_from_projected(crs: str, xy: FloatArray) -> FloatArray:
    """(..., 2) x, y in ``crs`` to (..., 2) longitude, latitude."""
    points = np.asarray(xy, dtype=np.float64)
    return np.stack(_to_wgs84(crs).transform(points[..., 0], points[..., 1]), axis=-1)
