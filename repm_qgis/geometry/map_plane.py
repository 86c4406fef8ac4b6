"""The plane that an ortho-ready image was projected to: pixels of a map, all at one height.

Vendors project such images with the sensor's model and one height for the whole image, so that a pixel is a place on
the map, and the place a point in space. Pixels are column, row with the first pixel's centre at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import FloatArray
from ..contracts.checks import Number
from ..contracts.record import Record
from .frames import geodetic_from_projected, projected_from_geodetic

_LEAST_PIXEL = 1e-18  # area of a pixel in units of the map squared: 1e-9 degrees are a tenth of a millimetre

_Unit = Annotated[float, Number(-1e9, 1e9)]


@dataclass(frozen=True)
class MapCrs:
    """The CRS of a map on the Earth."""

    def problem(self, value: str) -> str:
        try:
            crs = pyproj.CRS.from_user_input(value)
        except pyproj.exceptions.CRSError:
            return "must be a coordinate reference system that PROJ knows"
        return "" if crs.is_projected or crs.is_geographic else "must be the coordinate reference system of a map"


@dataclass(frozen=True)
class MapPlane(Record):
    """A map's lattice at one height.

    ``geotransform`` is GDAL's, of the pixels' corners; ``crs`` is any text that PROJ knows, without a vertical part.
    ``height`` is in metres above the WGS 84 ellipsoid, and ``source`` says where it comes from, "" where it is assumed.
    """

    crs: Annotated[str, MapCrs()]
    geotransform: Tuple[_Unit, _Unit, _Unit, _Unit, _Unit, _Unit]
    height: Annotated[float, Number(-12_000, 10_000, "m")]
    source: str

    def contradiction(self) -> str:
        return "" if abs(np.linalg.det(self._steps)) > _LEAST_PIXEL else "has a geotransform without an inverse"

    @property
    def _steps(self) -> FloatArray:
        """(2, 2) map units a pixel: columns of the matrix are those of a step right and a step down."""
        _, right, row_right, _, col_down, down = self.geotransform
        return np.array([[right, row_right], [col_down, down]])

    @property
    def _first(self) -> FloatArray:
        """(2,) x, y of the first pixel's centre."""
        corner = np.array([self.geotransform[0], self.geotransform[3]])
        first: FloatArray = corner + self._steps @ [0.5, 0.5]
        return first

    def ground(self, col_row: FloatArray) -> FloatArray:
        """(..., 2) column, row to (..., 3) longitude, latitude (degrees) and height, the plane's own (m)."""
        pixels = np.asarray(col_row, dtype=np.float64)
        lon_lat = _known(geodetic_from_projected(self.crs, pixels @ self._steps.T + self._first))
        return np.concatenate([lon_lat, np.full((*pixels.shape[:-1], 1), self.height)], axis=-1)

    def pixels(self, lon_lat: FloatArray) -> FloatArray:
        """(..., 2 or more) longitude, latitude (degrees; heights are ignored) to (..., 2) column, row."""
        xy = _known(projected_from_geodetic(self.crs, lon_lat))
        found: FloatArray = (xy - self._first) @ np.linalg.inv(self._steps).T
        return found


def _known(places: FloatArray) -> FloatArray:
    """Places with NaN where PROJ gives infinity, for what it cannot place."""
    places[~np.isfinite(places)] = np.nan
    return places
