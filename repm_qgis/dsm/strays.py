"""Heights that stray from the surface around them, replaced by its median.

Each cell's height comes from its own points alone, so single cells and the edges of roofs are as rough as matching is.
A cell belongs to the surface that the cells of its own brightness around it have: their weighted median (Ma, He, Wei,
Sun and Wu 2013, "Constant time weighted median filtering for stereo matching and beyond") keeps the edges that the
images show, where a plain median rounds them. Only heights that lie farther from it than those of almost all other
cells do are replaced (Hampel 1974): relief that is rough everywhere stays as it is.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatImage, Floats
from ..imagery.sampling import NMAD_FACTOR
from .parameters import FUSION, StrayParameters


def without_strays(
    height: Floats, brightness: FloatImage, cell: float, parameters: StrayParameters = FUSION.strays
) -> Floats:
    """(H, W) heights, m, with the median of the surface around them in cells that stray from it; NaN stays NaN.

    ``brightness`` (H, W) is as of :func:`.brightness.brightness`; ``cell`` in m.
    """
    p = parameters
    median = _weighted_median(height.astype(np.float32), brightness.astype(np.float32), cell, p)
    with np.errstate(invalid="ignore"):
        away = np.abs(median - height)
        known = away[np.isfinite(away)]
        if not known.size:
            return height
        limit = max(p.least_m, p.sigmas * NMAD_FACTOR * float(np.median(known)))
        return np.where(away > limit, median, height)


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
