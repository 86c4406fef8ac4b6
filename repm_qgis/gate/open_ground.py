"""How far a terrain lies from the open ground that its DSM shows by itself.

Open ground is what is left of a surface above the terrain by an opening wider than houses (Zhang et al. 2003, IEEE TGRS
41), and is smooth, as crowns are not. A plane through its heights above the terrain is zero where the two fit.
"""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Mask, Window
from ..evaluation.coregistration import block_means
from ..numerics.robust import nmad, tukey
from .parameters import GATE, GateParameters

_ROUNDS = 12  # of robust weights


class OpenGround(NamedTuple):
    """(N,) heights of a DSM on its open ground, m, and how high they lie above the terrain; (M,) how far the ground
    lies above the terrain at places of it, by a plane: None where too little is seen, or where much lies lower, as
    beside the wide roof of a hall; (2,) the plane's slope along rows and columns, m per m, and the NMAD about it, m."""

    heights: FloatArray
    above: FloatArray
    offsets: Optional[FloatArray]
    slope: FloatArray
    left: float


def open_ground(
    surfaces: Sequence[FloatImage],
    above: Sequence[FloatImage],
    windows: Sequence[Window],
    cell: Tuple[float, float],
    parameters: GateParameters = GATE,
) -> OpenGround:
    """What windows of a DSM show of the ground: ``surfaces`` are its (rows, columns) heights and ``above`` those above
    the terrain, m, with cells of these metres."""
    parts: List[FloatArray] = []
    for surface, heights, window in zip(surfaces, above, windows):
        coarse, smooth, factor = _smooth(heights, cell, parameters)
        own, by_itself, _ = _smooth(np.where(np.isfinite(heights), surface, np.float32(np.nan)), cell, parameters)
        known = np.isfinite(coarse)
        rows, columns = np.nonzero(known)
        x, y = (window.col + columns * factor) * abs(cell[0]), (window.row + rows * factor) * abs(cell[1])
        parts.append(np.column_stack([x, y, *(each[known] for each in (own, coarse, by_itself | smooth, smooth))]))
    x, y, own, whole, shown, smooth = np.concatenate([np.empty((0, 6)), *parts]).astype(np.float64).T
    offsets, slope, left = _plane(x, y, whole, smooth > 0, parameters)
    return OpenGround(own[shown > 0], whole[shown > 0], offsets, slope, left)


def _smooth(heights: FloatImage, cell: Tuple[float, float], parameters: GateParameters) -> Tuple[FloatImage, Mask, int]:
    """Means of heights over blocks of so many cells, and which of these are ground."""
    coarse, low, factor = opened_surface(heights, cell, parameters)
    with np.errstate(invalid="ignore"):
        steep = np.hypot(*np.gradient(coarse, factor * abs(cell[0]))) if min(coarse.shape) > 1 else np.inf
        ground: Mask = (coarse - low < parameters.open_near_m) & (steep < parameters.open_gradient)
    return coarse, ground, factor


def _plane(
    x: FloatArray, y: FloatArray, whole: FloatArray, ground: Mask, parameters: GateParameters
) -> Tuple[Optional[FloatArray], FloatArray, float]:
    """(M,) how far the ground lies above a terrain, of (N,) places with these heights above it, None as above; the
    slope, and what is left."""
    if ground.sum() < max(parameters.open_cells, parameters.open_share * whole.size):
        return None, np.zeros(2), 0.0
    side = max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    every = np.column_stack([(x - x.mean()) / side, (y - y.mean()) / side, np.ones(x.size)])
    design, height = every[ground], whole[ground]
    plane = robust_plane(design, height, _lowest(height, parameters.open_mode_share), parameters)
    below = np.mean(whole < every @ plane - parameters.open_near_m)
    offsets = np.asarray(design @ plane)
    good = 100.0 * below < parameters.ground_percent
    return offsets if good else None, plane[:2] / side, nmad(height - offsets)


def robust_plane(design: FloatArray, height: FloatArray, start: float, parameters: GateParameters = GATE) -> FloatArray:
    """(3,) the plane through heights (N,) at (N, 3) places with a 1, by Tukey's weights, from level ground on."""
    plane = np.array([0.0, 0.0, start])
    for _ in range(_ROUNDS):
        away = height - design @ plane
        weight = tukey(away / (parameters.open_tukey * max(nmad(away), parameters.open_least_m)))
        weighted = design * weight[:, None]
        normal = weighted.T @ design + np.diag([1e-6, 1e-6, 1e-9]) * max(float(weight.sum()), 1.0)
        plane = np.linalg.solve(normal, weighted.T @ height)
    return plane


def opened_surface(
    heights: FloatImage, cell: Tuple[float, float], parameters: GateParameters = GATE
) -> Tuple[FloatImage, FloatImage, int]:
    """Means of a surface (rows, columns) with cells of these metres over blocks of so many cells, and what an opening
    leaves of them."""
    from scipy import ndimage  # QGIS's own process may lack it

    factor = max(1, round(parameters.open_cell_m / abs(cell[0])))
    coarse = block_means(heights, factor)
    width = 2 * max(1, round(parameters.open_width_m / 2 / (factor * abs(cell[0])))) + 1
    low = ndimage.grey_opening(np.where(np.isfinite(coarse), coarse, np.float32(1e9)), size=(width, width))
    return coarse, low, factor


def _lowest(height: FloatArray, share: float) -> float:
    """The median of the lowest metre with so many heights as a ``share`` of those in the densest one: wide roofs are
    level, too."""
    bins = np.arange(np.floor(height.min()), np.ceil(height.max()) + 1.5, 0.5)
    count = np.histogram(height, bins)[0]
    pairs = count[:-1] + count[1:]
    first = int(np.argmax(pairs >= share * pairs.max()))
    peak = first + int(np.argmax(pairs[first : first + 3]))
    # Their median: heights without noise would all lie far from the middle of the bins, by the spread of zero.
    return float(np.median(height[(height >= bins[peak]) & (height <= bins[peak] + 1.0)]))
