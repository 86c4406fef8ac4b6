"""One height a cell from several height maps, and cells that stand alone removed (paper, "DSMs aggregation")."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_MAD_FACTOR = 3.0
_SIGMA_PX = 0.25    # what matching leaves, px of disparity: the floor of the outlier test


@dataclass(frozen=True)
class Aggregate:
    """Fused cells, all of one shape: ``height`` (m, NaN = none), ``count`` of height maps that agree, ``spread`` (m)
    between them (NaN for one alone), and mean matching ``score``."""

    height: FloatArray
    count: NDArray[np.uint8]
    spread: FloatArray
    score: FloatArray


def aggregate(heights: Sequence[FloatArray], scores: Sequence[FloatArray], metres_per_px: Sequence[float],
              method: str) -> Aggregate:
    """Fuse height maps cell by cell: median absolute deviation test, then the median or mean of what is left.

    Parameters
    ----------
    heights, scores : one (H, W) array a map.
    metres_per_px : height that one px of disparity means in each map: narrow pairs are noisier, and weigh less.
    method : ``median`` or ``mean``, weighted by 1 / metres_per_px either way (the square would let the widest pair of
        three decide alone).
    """
    stack = np.stack(heights)
    known = np.isfinite(stack)
    weight = np.array([1.0 / m for m in metres_per_px])[:, None, None] * known
    centre = _weighted_median(stack, weight)
    deviation = np.abs(stack - centre)
    mad = _median(deviation)
    floor = _SIGMA_PX * np.array(metres_per_px)[:, None, None]
    with np.errstate(invalid="ignore"):
        good = known & (deviation <= _MAD_FACTOR * np.maximum(1.4826 * mad, floor))
    weight = weight * good
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(good, stack * weight, 0.0).sum(axis=0) / total
        variance = np.where(good, weight * (stack - mean) ** 2, 0.0).sum(axis=0) / total
        score = np.where(good, np.nan_to_num(np.stack(scores)) * weight, 0.0).sum(axis=0) / total
    count = good.sum(axis=0).astype(np.uint8)
    height = mean if method == "mean" else _weighted_median(stack, weight)
    return Aggregate(np.where(count > 0, height, np.nan), count, np.where(count > 1, np.sqrt(variance), np.nan),
                     np.where(count > 0, score, np.nan))


def _median(stack: FloatArray) -> FloatArray:
    """Median along the first axis of what is finite; NaN where nothing is."""
    ordered = np.sort(stack, axis=0)  # NaN last
    count = np.isfinite(stack).sum(axis=0)
    low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[None], axis=0)[0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, len(stack) - 1)[None], axis=0)[0]
    return np.where(count > 0, (low + high) / 2, np.nan)


def _weighted_median(stack: FloatArray, weight: FloatArray) -> FloatArray:
    """Weighted median along the first axis: where the weights below and above balance, linear between.

    With two values that is their weighted mean, with equal weights the ordinary median.
    """
    if len(stack) == 1:
        return np.where(weight[0] > 0, stack[0], np.nan)
    order = np.argsort(np.where(weight > 0, stack, np.inf), axis=0)
    values = np.take_along_axis(stack, order, axis=0)
    weights = np.take_along_axis(weight, order, axis=0)
    total = weights.sum(axis=0)
    # Each value sits in the middle of its own weight on the cumulative axis.
    middle = weights.cumsum(axis=0) - weights / 2
    half = total / 2
    result = np.where(total > 0, values[0], np.nan)
    for k in range(1, len(stack)):
        span = middle[k] - middle[k - 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip((half - middle[k - 1]) / span, 0.0, 1.0)
        within = (weights[k] > 0) & (half > middle[k - 1])
        result = np.where(within, values[k - 1] + share * (values[k] - values[k - 1]), result)
    return result


def automatic_radius(cell: float) -> float:
    """The radius of the outlier filter in metres where none is given: three cells, at least 1.5 m.

    The paper has no standard parameter. Gridded points are one a cell, so the density is known, and a disc of three
    cells holds 28 neighbours.
    """
    return max(3.0 * cell, 1.5)


def lonely(height: FloatArray, cell: float, radius: float, share: float = 0.2) -> Tuple[NDArray[np.bool_], int]:
    """Cells with too few neighbours within a ball of ``radius`` metres: the radius outlier filter, on the grid.

    Horizontal and vertical distances count alike, as in a point cloud; a neighbour on a steep slope is allowed the
    slope that cell and radius imply. Returns the cells to remove, and the number of neighbours that was asked for.
    """
    reach = max(1, int(radius / cell))
    offsets = [(dr, dc) for dr in range(-reach, reach + 1) for dc in range(-reach, reach + 1)
               if (dr or dc) and math.hypot(dr, dc) * cell <= radius + 1e-9]
    needed = max(2, int(round(share * len(offsets))))
    neighbours = np.zeros(height.shape, dtype=np.uint16)
    padded = np.pad(height, reach, constant_values=np.nan)
    rows, columns = height.shape
    for dr, dc in offsets:
        other = padded[reach + dr:reach + dr + rows, reach + dc:reach + dc + columns]
        with np.errstate(invalid="ignore"):
            neighbours += np.abs(other - height) <= radius
    return np.isfinite(height) & (neighbours < needed), needed
