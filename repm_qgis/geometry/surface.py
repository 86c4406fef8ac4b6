"""A coarse surface of the ground, for the terrain-aware refinement: heights on a grid in longitude and latitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

import numpy as np

from ..contracts.arrays import FloatArray
from .interpolation import bilinear

_STEPS = 20  # of an intersection at most: they bound the time where lines never meet the surface
_TOLERANCE_M = 1e-3  # 1e-5 px at the steepest parallax
_ROOM_M = 50.0  # of the levels at which lines are sampled, beyond the surface's heights


@dataclass(frozen=True)
class Surface:
    """Heights in metres above the WGS 84 ellipsoid; cell (0, 0)'s centre is at (lon, lat), rows run south.

    ``heights`` (m, n) has no NaN; beyond its border the surface continues level. ``step_lon`` and ``step_lat`` are
    positive, in degrees.
    """

    lon: float
    lat: float
    step_lon: float
    step_lat: float
    heights: FloatArray

    def met_by(self, line: Callable[[FloatArray], FloatArray], lines: FloatArray, above: FloatArray) -> FloatArray:
        """(..., 3) longitudes, latitudes (degrees) and heights (m) at which lines meet the surface.

        Parameters
        ----------
        line : takes levels that broadcast with ``lines`` to points (..., 3) of the lines. A level is a height, or
            differs from it by little more than a constant.
        lines : an array of zeros with the lines' shape.
        above : metres above the surface to meet instead, which broadcasts with ``lines``.

        Lines of sight bend so little in longitude, latitude and height that a parabola through three points has them
        to decimetres over the relief of a mountain range: the parabola is followed to the surface, the line itself is
        evaluated there, and the parabola is shifted by the difference. NaN where the line has no point.
        """
        levels = np.linspace(self.heights.min() - _ROOM_M, self.heights.max() + _ROOM_M, 3)
        origin, *others = (line(lines + level) for level in levels)
        middle, end = (_from(origin, node) for node in others)
        slope, square = 4.0 * middle - end, 2.0 * (end - 2.0 * middle)

        def parabola(level: FloatArray) -> FloatArray:
            share = ((level - levels[0]) / (levels[2] - levels[0]))[..., None]
            points: FloatArray = origin + share * (slope + share * square)
            return points

        level, missed = lines + above + levels[1], np.zeros(3)
        for _ in range(_STEPS):
            for _ in range(_STEPS):
                rise = self._rise(parabola(level) + missed, above)
                level = level + rise
                if not (np.abs(rise) > _TOLERANCE_M / 2).any():
                    break
            ground = line(level)
            if not (np.abs(self._rise(ground, above)) > _TOLERANCE_M).any():
                break
            missed = _from(parabola(level), ground)
        return ground

    def _rise(self, ground: FloatArray, above: FloatArray) -> FloatArray:
        return self.height(ground[..., 0], ground[..., 1]) + above - ground[..., 2]

    def height(self, lon: FloatArray, lat: FloatArray) -> FloatArray:
        """Bilinear height at positions in degrees; NaN in gives NaN out."""
        m, n = self.heights.shape
        away = (np.asarray(lon) - self.lon + 180.0) % 360.0 - 180.0
        with np.errstate(invalid="ignore"):
            u = np.clip(away / self.step_lon, 0.0, n - 1.0)
            v = np.clip((self.lat - np.asarray(lat)) / self.step_lat, 0.0, m - 1.0)
        known = np.isfinite(u) & np.isfinite(v)
        u, v = np.where(known, u, 0.0), np.where(known, v, 0.0)
        return np.where(known, bilinear(self.heights, u, v), np.nan)


def _from(origin: FloatArray, ground: FloatArray) -> FloatArray:
    """Differences of longitude, latitude and height, across the date line too."""
    away = ground - origin
    away[..., 0] = (away[..., 0] + 180.0) % 360.0 - 180.0
    return away
