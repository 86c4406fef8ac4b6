"""How far a terrain lies from the open ground that its DSM shows by itself.

Open ground is what is left of a surface above the terrain by an opening wider than houses (Zhang et al. 2003, IEEE TGRS
41), and is smooth, as crowns are not. A plane through its heights above the terrain is zero where the two fit.
"""

from __future__ import annotations

from typing import List, Optional, Sequence, Tuple

import numpy as np
from scipy import ndimage

from ..contracts.arrays import FloatArray, FloatImage, Window
from ..evaluation.coregistration import block_means
from ..numerics.robust import nmad, tukey
from .parameters import GATE, GateParameters

_ROUNDS = 12  # of robust weights


def ground_offsets(
    above: Sequence[FloatImage],
    windows: Sequence[Window],
    cell: Tuple[float, float],
    parameters: GateParameters = GATE,
) -> Optional[FloatArray]:
    """(N,) how far the open ground lies above a terrain at N places, m, by a plane; None where too little is seen.

    ``above`` (rows, columns) are a DSM's heights above the terrain in windows of it, m, with cells of these metres.
    """
    parts: List[FloatArray] = []
    total = 0
    for heights, window in zip(above, windows):
        factor = max(1, round(parameters.open_cell_m / abs(cell[0])))
        coarse, side = block_means(heights, factor), factor * abs(cell[0])
        known = np.isfinite(coarse)
        total += int(known.sum())
        width = 2 * max(1, round(parameters.open_width_m / 2 / side)) + 1
        low = ndimage.grey_opening(np.where(known, coarse, np.float32(1e9)), size=(width, width))
        with np.errstate(invalid="ignore"):
            rough = np.hypot(*np.gradient(coarse, side)) if min(coarse.shape) > 1 else np.inf
            rows, columns = np.nonzero((coarse - low < parameters.open_near_m) & (rough < parameters.open_gradient))
        x, y = (window.col + columns * factor) * abs(cell[0]), (window.row + rows * factor) * abs(cell[1])
        parts.append(np.column_stack([x, y, coarse[rows, columns]]).astype(np.float64))
    x, y, height = np.concatenate([np.empty((0, 3)), *parts]).T
    if height.size < max(parameters.open_cells, parameters.open_share * total):
        return None
    design = np.column_stack([x - x.mean(), y - y.mean(), np.ones(x.size)])
    design[:, :2] /= max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    plane = np.array([0.0, 0.0, _densest(height)])
    for _ in range(_ROUNDS):
        away = height - design @ plane
        weight = tukey(away / (parameters.open_tukey * max(nmad(away), parameters.open_least_m)))
        weighted = design * weight[:, None]
        normal = weighted.T @ design + np.diag([1e-6, 1e-6, 1e-9]) * max(float(weight.sum()), 1.0)
        plane = np.linalg.solve(normal, weighted.T @ height)
    return np.asarray(design @ plane)


def _densest(height: FloatArray) -> float:
    """The middle of the metre that most heights lie in."""
    bins = np.arange(np.floor(height.min()), np.ceil(height.max()) + 1.5, 0.5)
    count = np.histogram(height, bins)[0]
    pairs = count[:-1] + count[1:] if count.size > 1 else count
    return float(bins[int(pairs.argmax())] + 0.5)
