"""The virtual grid: pixels and heights that a sensor model is sampled at (Tao and Hu 2001)."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray, Size


def virtual_grid(
    size: Size, heights: Altitudes, nodes: Tuple[int, int, int], inset: float = 0.0
) -> Tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) and heights (N,) of a regular grid of columns, rows, heights over image and height range.

    ``inset`` moves the grid's ends inwards by that share of a grid step, so that grids do not share nodes; a negative
    one moves them outwards.
    """

    def axis(low: float, high: float, count: int) -> FloatArray:
        step = inset * (high - low) / max(count - 1, 1)
        return np.linspace(low + step, high - step, count)

    ends = ((-0.5, size[0] - 0.5), (-0.5, size[1] - 0.5), heights)
    axes = (axis(low, high, count) for (low, high), count in zip(ends, nodes))
    col, row, height = np.meshgrid(*axes, indexing="ij")
    return np.stack([col.ravel(), row.ravel()], axis=1), height.ravel()
