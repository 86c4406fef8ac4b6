"""Heights of a reference as its file has them, before they are brought to the ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import Bounds, FloatArray, Mask
from ..contracts.errors import InputTableError, OverlapError
from ..geometry.vertical import HeightDatum, metres_per_unit
from ..imagery.heights import HIGHEST_M, LOWEST_M
from .parameters import REGISTRATION


@dataclass(frozen=True)
class FoundHeights:
    """(N, 2) ``xy`` in the scene's projected CRS and (N,) ``height`` in metres above the file's own datum.

    ``datum`` is the datum that the file states, None where it states none. ``name``, ``width_m``, ``disc``
    and ``slopes`` are those of :class:`~repm_qgis.registration.surfaces.Reference`. Where the file does not state the
    unit of its heights, heights and slopes are the file's numbers, and ``places_in`` names the unit of its places.
    ``about`` is a sentence for the report: the kind of heights, and which of them were taken.
    """

    name: str
    xy: FloatArray
    height: FloatArray
    width_m: Tuple[float, float]
    disc: bool = False
    slopes: Optional[FloatArray] = None
    datum: Optional[HeightDatum] = None
    places_in: Optional[str] = None
    about: str = ""


def places_unit(system: pyproj.CRS) -> Optional[str]:
    """The unit of a file's places, where its CRS does not say that of its heights: what ``places_in`` is."""
    if metres_per_unit(system):
        return None
    axis = system.axis_info[0]
    return "metre" if system.is_projected and axis.unit_conversion_factor == 1.0 else str(axis.unit_name)


class Within:
    """Which places of a file lie within bounds of the scene's projected CRS, and where there."""

    def __init__(self, source: pyproj.CRS, crs: str, bounds: Bounds) -> None:
        """``source`` is the horizontal CRS of the file's places."""
        self.bounds, self._degrees = bounds, source.is_geographic
        self._forth = pyproj.Transformer.from_crs(source, crs, always_xy=True)
        u, v = np.meshgrid(np.linspace(bounds.xmin, bounds.xmax, 9), np.linspace(bounds.ymin, bounds.ymax, 9))
        x, y = (np.asarray(found) for found in self._forth.transform(u, v, direction="INVERSE"))
        more = 0.02 * float(np.ptp(x)), 0.02 * float(np.ptp(y))
        low, high = (x.min() - more[0], y.min() - more[1]), (x.max() + more[0], y.max() + more[1])
        self.source_bounds = Bounds.between(low, high)
        """In the file's CRS, and a little wider."""

    def near(self, x: FloatArray, y: FloatArray) -> Mask:
        """(...) whether places of the file may lie within the bounds: quick, before the rest of them is read."""
        box, x = self.source_bounds, self._turned(x)
        return np.asarray((x >= box.xmin) & (x <= box.xmax) & (y >= box.ymin) & (y <= box.ymax))

    def places(self, x: FloatArray, y: FloatArray) -> Tuple[FloatArray, Mask]:
        """(N, 2) places of the file in the scene's CRS, and which of them lie within the bounds."""
        xy = np.column_stack(self._forth.transform(self._turned(x), y))
        return xy, ((xy >= self.bounds[:2]) & (xy <= self.bounds[2:])).all(axis=1)

    def _turned(self, x: FloatArray) -> FloatArray:
        """Longitudes from -180 to 180 degrees: some count from 0 to 360."""
        return np.asarray((x + 180.0) % 360.0 - 180.0) if self._degrees else x


def no_heights(path: str) -> OverlapError:
    """The error of a file without heights over the scene."""
    return OverlapError(f"The reference '{path}' has no heights over the scene: choose one that has.")


class FoundPoints:
    """Collects heights within bounds, part by part."""

    def __init__(self, path: str, within: Within) -> None:
        self._path, self.within, self._count = path, within, 0
        self._parts: List[FloatArray] = []

    def add(self, x: FloatArray, y: FloatArray, height: FloatArray) -> None:
        """(N,) places of the file, and heights, m; raises InputTableError for more than fit into memory."""
        near = self.within.near(x, y) & (height >= LOWEST_M) & (height <= HIGHEST_M)
        xy, inside = self.within.places(x[near], y[near])
        self._count += int(inside.sum())
        if self._count > REGISTRATION.most_heights:
            raise InputTableError(
                f"The reference '{self._path}' has more than {REGISTRATION.most_heights} heights over the scene: give "
                "fewer of them, or a raster."
            )
        self._parts.append(np.column_stack([xy, height[near]])[inside])

    def found(
        self,
        width_m: Tuple[float, float] = (0.0, 0.0),
        disc: bool = False,
        datum: Optional[HeightDatum] = None,
        places_in: Optional[str] = None,
        about: str = "",
    ) -> FoundHeights:
        """All of them; raises OverlapError where there are none."""
        if not self._count:
            raise no_heights(self._path)
        xyz = np.concatenate(self._parts)
        return FoundHeights(self._path, xyz[:, :2], xyz[:, 2], width_m, disc, None, datum, places_in, about)
