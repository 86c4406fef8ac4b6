"""A shift of the ground in another projected CRS, and of areas."""

from __future__ import annotations

from typing import Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import FloatArray
from ..contracts.records import GroundShift
from .frames import geodetic_from_projected, projected_from_geodetic

_STEP_M = 100.0  # over which two CRSs are compared


def shift_in(shift: GroundShift, crs: str, other: str, place: Tuple[float, float]) -> GroundShift:
    """A shift in ``crs`` as it is in another projected CRS around a place there: grid norths differ by degrees."""
    if crs == other:
        return shift

    def there(xy: FloatArray) -> FloatArray:
        return projected_from_geodetic(crs, geodetic_from_projected(other, xy))

    def back(xy: FloatArray) -> FloatArray:
        return projected_from_geodetic(other, geodetic_from_projected(crs, xy))

    here = np.array([place])
    moved = back(there(here) + np.array(shift.moved[:2])) - here
    steps = there(here + _STEP_M * np.eye(2)) - there(here)  # rows: a step to the east, and one to the north
    tilt = steps @ np.array(shift.tilt) / _STEP_M
    centre = back(np.array([shift.centre])) if any(shift.tilt) else here
    east, north = map(float, moved[0])
    return GroundShift((east, north, shift.moved[2]), (float(tilt[0]), float(tilt[1])), (centre[0, 0], centre[0, 1]))


def moved_area(wkt: str, shift: GroundShift) -> str:
    """An area, as WKT in the shift's CRS, moved east and north."""
    geometry = ogr.CreateGeometryFromWkt(wkt)
    _move(geometry, shift.moved[0], shift.moved[1])
    return str(geometry.ExportToWkt())


def _move(geometry: ogr.Geometry, east: float, north: float) -> None:
    for index in range(geometry.GetGeometryCount()):
        _move(geometry.GetGeometryRef(index), east, north)
    for index in range(geometry.GetPointCount() if not geometry.GetGeometryCount() else 0):
        x, y = geometry.GetPoint_2D(index)
        geometry.SetPoint_2D(index, x + east, y + north)
