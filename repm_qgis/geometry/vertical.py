"""Vertical datums: the WGS 84 ellipsoid, a geoid, or any other vertical CRS that PROJ knows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Optional, Sequence, Tuple

import numpy as np
import pyproj
from pyproj.crs.crs import CompoundCRS

from ..contracts.arrays import FloatArray
from ..contracts.errors import MissingPackageError, OptionError
from .frames import geodetic_from_projected, install_grid, is_world_ellipsoid, vertical_operations

DATUMS = {"ellipsoid": "", "ellipsoidal": "", "egm96": "EPSG:5773", "egm2008": "EPSG:3855"}
"""Common names of vertical datums and their PROJ codes; "" is the WGS 84 ellipsoid."""

LISTED = ("EGM2008", "EGM96", "EPSG:5621", "EPSG:7837", "EPSG:5720", "EPSG:5701", "EPSG:5703", "EPSG:5711")
"""What dialogs offer: the world's geoids, then Europe, Germany, France, Great Britain, North America, Australia."""

ELLIPSOID = "WGS 84 ellipsoid"
TAG = "VERTICAL_DATUM"
"""The metadata item of a raster with the name of its heights' datum."""
PLACED_TAG = "REPM_PLACED"
"""The item of a DSM's metadata that says how its absolute position was determined: one of :data:`PLACED`."""

PLACED = ("registered to a reference", "ground control points")

DEVIATION_TAG = "REPM_HEIGHT_DEVIATION"
"""The metadata item with the standard deviation of a DSM's absolute height, m, where the scene states one."""

_ELLIPSOIDAL = "EPSG:4979"


def vertical_crs(text: Optional[str], option: str) -> Optional[pyproj.CRS]:
    """The vertical CRS that a text names; None for the WGS 84 ellipsoid ("" means that too).

    Raises OptionError, with the option's name, where PROJ knows no vertical CRS of that name.
    """
    name = DATUMS.get((text or "").strip().lower(), (text or "").strip())
    if not name:
        return None
    try:
        crs = pyproj.CRS.from_user_input(name)
        return next(part for part in (crs.sub_crs_list or [crs]) if part.is_vertical)
    except (pyproj.exceptions.ProjError, StopIteration) as error:
        remedy = "give ellipsoid, EGM96, EGM2008, or a code such as EPSG:5773"
        raise OptionError(option, text, f"is not a vertical CRS that PROJ knows: {remedy}") from error


def with_wgs84(vertical: pyproj.CRS) -> pyproj.CRS:
    """Longitude and latitude in WGS 84 with heights of a vertical CRS."""
    return CompoundCRS("points", ["EPSG:4326", vertical])


def geodetic_with_heights(crs: pyproj.CRS) -> pyproj.CRS:
    """Longitude and latitude with the heights of a CRS: between such ones PROJ converts heights, whatever the map is.

    From a projected CRS of three axes, as Web Mercator's, PROJ finds no geoid, and changes nothing without a word.
    """
    vertical = next((part for part in crs.sub_crs_list if part.is_vertical), None)
    if vertical is not None:
        return with_wgs84(vertical)
    return pyproj.CRS(_ELLIPSOIDAL) if is_world_ellipsoid(crs) else crs.geodetic_crs.to_3d()  # type: ignore[union-attr]


@dataclass(frozen=True)
class HeightDatum:
    """What a product's heights refer to; ``code`` is PROJ's name of a vertical CRS, "" the WGS 84 ellipsoid."""

    code: str
    name: str

    @property
    def unit_m(self) -> float:
        """The unit of heights in it, m."""
        return (metres_per_unit(pyproj.CRS(self.code)) or 1.0) if self.code else 1.0

    @classmethod
    def of(cls, text: Optional[str], option: str = "VERTICAL_DATUM") -> HeightDatum:
        """Raises OptionError where PROJ knows no vertical CRS of that name."""
        crs = vertical_crs(text, option)
        if crs is None:
            return cls("", ELLIPSOID)
        authority = crs.to_authority()
        return cls(":".join(authority) if authority else crs.to_wkt("WKT2_2019"), crs.name)

    def file_crs(self, horizontal: str) -> str:
        """WKT 2 of a horizontal CRS with this vertical part, as it is written into files.

        For ellipsoidal heights it stays horizontal: GDAL (3.6) stores a projected CRS of three axes only in a sidecar
        file, without which the raster has no CRS at all, and QGIS 3.22 finds no EPSG code for it. The file always
        states its datum in the metadata item ``VERTICAL_DATUM``.
        """
        flat = pyproj.CRS.from_user_input(horizontal)
        if not self.code:
            return flat.to_wkt("WKT2_2019")
        return CompoundCRS(f"{flat.name} + {self.name}", [flat, self.code]).to_wkt("WKT2_2019")

    def require(self, lon: float, lat: float, option: str = "VERTICAL_DATUM") -> None:
        """Check that heights can be converted at a place, before hours of work; raises MissingPackageError."""
        if self.code:
            self._operation(_bounds(np.array([[lon, lat]])), f"set {option} to ellipsoid")

    def undulation(self, crs: str, xy: FloatArray, remedy: str = "") -> FloatArray:
        """(...) metres to take off ellipsoidal heights at (..., 2) positions in a projected CRS; 0 for the ellipsoid.

        Raises MissingPackageError with the grid's name where PROJ lacks it: heights never stay unconverted. ``remedy``
        is what to do other than to install the grid; "" is to choose another VERTICAL_DATUM.
        """
        xy = np.asarray(xy, dtype=np.float64)
        if not self.code:
            return np.zeros(xy.shape[:-1])
        lon_lat = geodetic_from_projected(crs, xy)
        zero = np.zeros(lon_lat.shape[:-1])
        operation = self._operation(_bounds(lon_lat), remedy or "set VERTICAL_DATUM to ellipsoid")
        below = np.asarray(operation.transform(lon_lat[..., 0], lon_lat[..., 1], zero)[2])
        if not np.isfinite(below).all():
            remedy = remedy or "choose another VERTICAL_DATUM, such as ellipsoid"
            raise MissingPackageError(f"PROJ's grid for {self.name} does not cover the area: {remedy}.")
        return -below * self.unit_m

    def _operation(self, bounds: Tuple[int, int, int, int], remedy: str) -> pyproj.Transformer:
        """PROJ's best operation from ellipsoidal heights for a place."""
        try:
            return _best_operation(self.code, bounds)
        except _MissingGridsError as error:
            if not error.grids:
                raise MissingPackageError(
                    f"PROJ cannot convert heights to or from {self.name}: it knows no operation for that: {remedy}."
                ) from None
            put = install_grid(error.grids)
            raise MissingPackageError(
                f"PROJ cannot convert heights to or from {self.name}: {error}: {put}, or {remedy}."
            ) from None


def stated_datum(crs: Optional[pyproj.CRS], tag: str = "") -> Optional[HeightDatum]:
    """What a file says its heights refer to, by its CRS or its metadata item :data:`TAG`; None where it does not say.

    A vertical part without a name that PROJ knows is a datum too; heights in it cannot be converted.
    """
    vertical = next((part for part in crs.sub_crs_list if part.is_vertical), None) if crs is not None else None
    said = (vertical.name if vertical is not None else tag).lower()
    if "ellipsoid" in said or (crs is not None and vertical is None and len(crs.axis_info) == 3):
        return HeightDatum("", ELLIPSOID)
    try:
        return HeightDatum.of(vertical.to_wkt("WKT2_2019") if vertical is not None else tag) if said else None
    except OptionError:
        return None


def metres_per_unit(crs: pyproj.CRS) -> Optional[float]:
    """The unit of a CRS's heights, m; None where it has no heights."""
    parts = [part for part in crs.sub_crs_list or [crs] if part.is_vertical or len(part.axis_info) == 3]
    return float(parts[0].axis_info[-1].unit_conversion_factor) if parts else None


def named_datum(text: str, option: str) -> Optional[HeightDatum]:
    """The datum that a user names; None for ``auto``. Raises OptionError where PROJ knows no such vertical CRS."""
    return None if text.strip().lower() == "auto" else HeightDatum.of(text, option)


class _MissingGridsError(LookupError):
    """PROJ has no operation, or lacks the grids of those that it knows."""

    def __init__(self, grids: Sequence[str]) -> None:
        super().__init__(f"its grid {' or '.join(grids)} is not installed")
        self.grids = list(grids)


@lru_cache(maxsize=16)  # a missing grid may be installed the next time: only successes are cached
def _best_operation(code: str, bounds: Tuple[int, int, int, int]) -> pyproj.Transformer:
    """From ellipsoidal heights to a vertical CRS; raises _MissingGridsError. It takes 50 ms."""
    group, missing = vertical_operations(pyproj.CRS(_ELLIPSOIDAL), with_wgs84(pyproj.CRS(code)), bounds)
    if not group.transformers:
        raise _MissingGridsError(missing)
    return group.transformers[0]


def _bounds(lon_lat: FloatArray) -> Tuple[int, int, int, int]:
    """West, south, east, north in whole degrees around the points."""
    places = lon_lat.reshape(-1, 2)
    west, south = np.floor(places.min(axis=0)).astype(int)
    east, north = np.floor(places.max(axis=0)).astype(int) + 1
    return int(west), int(south), int(east), int(north)
