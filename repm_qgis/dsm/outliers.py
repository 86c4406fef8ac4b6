"""Points of a height map that stand alone, dropped before they are gridded (paper, "DSMs aggregation")."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats

_TOLERANCE_PX = 2.0  # of disparity: steeper steps between neighbours are walls, and walls have pixels beside them
_NEEDED = 2  # of the eight neighbours


def without_lone_points(height: Floats, metres_per_px: float) -> Floats:
    """The (H, W) heights, NaN where fewer than two of the eight neighbours mean the same surface.

    Matching leaves none, as it drops small islands by disparity: this is for height maps of other origin or that
    something has damaged, and for what a cell of few points could not outvote.
    """
    known = np.isfinite(height)
    level = float(height[known].mean()) if known.any() else 0.0
    z = np.pad((height - level).astype(np.float32), 1, constant_values=np.nan)
    company = np.zeros(height.shape, np.uint8)
    rows, columns = height.shape
    tolerance = np.float32(_TOLERANCE_PX * metres_per_px)
    centre = z[1:-1, 1:-1]
    with np.errstate(invalid="ignore"):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):  # each pair of neighbours once
            near = np.abs(z[1 + down : 1 + down + rows, 1 + right : 1 + right + columns] - centre) <= tolerance
            company += near
            to = np.s_[down:, max(right, 0) : columns + min(right, 0)]
            source = near[: rows - down, max(-right, 0) : columns - max(right, 0)]
            company[to] += source
    return np.where(company >= _NEEDED, height, np.nan)
