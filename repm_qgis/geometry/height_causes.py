"""What heights that are wrong as a whole may be: feet instead of metres, or above a geoid instead of the ellipsoid."""

from __future__ import annotations

from typing import List, Tuple

import numpy as np

from ..contracts.errors import MissingPackageError
from .frames import projected_from_geodetic, utm_crs
from .vertical import HeightDatum

FOOT_M = 0.3048
_GEOIDS = ("EGM2008", "EGM96")
_LESS = 3.0  # times smaller than the offset must what a cause leaves of it be


def likely_cause(offset_m: float, height_m: float, lon: float, lat: float, within_m: float) -> str:
    """What explains that ``offset_m`` must be added to given heights, of ``height_m`` in the middle, at a place
    (degrees), for the end of a sentence; "" where nothing leaves less than ``within_m``, and a third, of it.
    """
    causes: List[Tuple[float, str]] = [
        ((FOOT_M - 1.0) * height_m, "if they are in feet and were read as metres"),
        ((1.0 / FOOT_M - 1.0) * height_m, "if they are in metres and were read as feet"),
    ]
    for name in _GEOIDS:
        above = geoid_height(name, lon, lat)
        if np.isfinite(above):
            words = f"{abs(above):.1f} m {'above' if above > 0 else 'below'} the ellipsoid here"
            causes += [
                (above, f"if they are above the geoid ({name}, {words}) and were read as above the ellipsoid"),
                (-above, f"if they are above the ellipsoid and were read as above the geoid ({name}, {words})"),
            ]
            break
    expected, cause = min(causes, key=lambda each: abs(offset_m - each[0]))
    left = abs(offset_m - expected)
    return f"{expected:+.1f} metres {cause}" if left <= min(within_m, abs(offset_m) / _LESS) else ""


def geoid_height(name: str, lon: float, lat: float) -> float:
    """How far a geoid lies above the ellipsoid at a place, m; NaN where PROJ lacks its grid."""
    crs = utm_crs(lon, lat)
    try:
        return float(HeightDatum.of(name).undulation(crs, projected_from_geodetic(crs, np.array([[lon, lat, 0.0]])))[0])
    except MissingPackageError:
        return float("nan")
