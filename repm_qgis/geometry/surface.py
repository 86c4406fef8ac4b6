"""A coarse surface of the ground, for the terrain-aware refinement: heights on a grid in longitude and latitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .interpolation import bilinear


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
