"""Heights that stray from the surface around them, replaced by its median.

Each cell's height comes from its own points alone, so single cells and the edges of roofs are as rough as matching is.
A cell belongs to the surface that the cells of its own brightness around it have: their weighted median (Ma, He, Wei,
Sun and Wu 2013, "Constant time weighted median filtering for stereo matching and beyond") keeps the edges that the
images show, where a plain median rounds them. Only heights that lie farther from it than those of almost all other
cells do are replaced (Hampel 1974), and only where there are many of these, because there are walls: in natural ground
they would be relief.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatImage, Floats
from ..imagery.sampling import NMAD_FACTOR
from .parameters import FUSION, StrayParameters


class SurfaceAround:
    """The surface around each cell of (H, W) heights, m, NaN = none.

    ``brightness`` (H, W) is as of :func:`.brightness.brightness`; ``cell`` in m.
    """

    def __init__(
        self, height: Floats, brightness: FloatImage, cell: float, parameters: StrayParameters = FUSION.strays
    ) -> None:
        self._height, self._parameters = height, parameters
        self._median = _weighted_median(height.astype(np.float32), brightness.astype(np.float32), cell, parameters)
        self._away = np.abs(self._median - height)
        self._known = self._away[np.isfinite(self._away)].astype(np.float64)
        self._usual = NMAD_FACTOR * float(np.median(self._known)) if self._known.size else 0.0

    @property
    def walls(self) -> bool:
        """Whether so many heights lie so far from it that there must be walls: in natural ground, few do."""
        p = self._parameters
        farthest = p.tail * max(self._usual, p.least_usual_m)
        return bool(self._known.size) and float(np.sqrt((self._known**2).mean())) > farthest

    def without_strays(self) -> Floats:
        """(H, W) the heights, with the median of the surface around them in cells that stray from it."""
        p = self._parameters
        with np.errstate(invalid="ignore"):
            return np.where(self._away > max(p.least_m, p.sigmas * self._usual), self._median, self._height)


def _weighted_median(height: FloatImage, brightness: FloatImage, cell: float, parameters: StrayParameters) -> Floats:
    """(H, W) the weighted median of the known heights around each cell; NaN where it has none itself."""
    p = parameters
    reach = p.reach(cell)
    offsets = [(down, right) for down in range(2 * reach + 1) for right in range(2 * reach + 1)]
    near = [((down - reach) ** 2 + (right - reach) ** 2) * (cell / p.sigma_m) ** 2 / 2 for down, right in offsets]
    rows, columns = height.shape
    heights, lights = (np.pad(values, reach, constant_values=np.nan) for values in (height, brightness))
    result = np.full(height.shape, np.nan, np.float32)
    step = max(1, p.at_once // max(columns, 1))
    for first in range(0, rows, step):
        count = min(step, rows - first)
        values = np.empty((count, columns, len(offsets)), np.float32)
        weights = np.empty_like(values)
        for number, (down, right) in enumerate(offsets):
            there = slice(first + down, first + down + count), slice(right, right + columns)
            unlike = np.abs(lights[there] - brightness[first : first + count]) / np.float32(p.contrast)
            unlike[np.isnan(unlike)] = p.unknown
            values[..., number] = heights[there]
            weights[..., number] = np.exp(-unlike - np.float32(near[number]))
        weights[np.isnan(values)] = 0.0
        order = np.argsort(values, axis=-1, kind="stable")
        total = np.cumsum(np.take_along_axis(weights, order, axis=-1), axis=-1)
        middle = (total >= total[..., -1:] / 2).argmax(axis=-1)[..., None]
        result[first : first + count] = np.take_along_axis(values, np.take_along_axis(order, middle, -1), -1)[..., 0]
    return np.where(np.isfinite(height), result, np.float32(np.nan))
