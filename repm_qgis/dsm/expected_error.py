"""How wrong a fused height is likely to be: what the confidence raster tells in metres.

Two things are known of a cell: what matching leaves at its correlation and base-to-height ratio, and how far the maps
that agree there differ. Both were held against true surfaces (docs/method.md#confidence): the 68 % quantile of errors
in px of disparity falls linearly with the correlation, and the spread adds to it as another error does.
"""

from __future__ import annotations

from typing import Sequence

import numpy as np

from ..arrays import Floats
from .aggregation import Aggregate

_AT_BEST_PX, _PER_SCORE_PX = 0.15, 0.85  # px of disparity at a correlation of 1, and more for each 1 less
_BACKGROUND_PX = 1.5  # of heights taken from the background of an occlusion


def expected_error(fused: Aggregate, metres_per_px: Sequence[float]) -> Floats:
    """(H, W) metres within which about two thirds of such heights are right; NaN where there is no height.

    ``metres_per_px`` of all the tile's height maps. Pointing errors that all cells share are not in it: the report
    tells them.
    """
    metres = np.asarray(metres_per_px, dtype=np.float64)
    together = len(metres) ** 0.5 / np.sqrt((metres**-2.0).sum())  # of one map, where they count by their variances
    count = np.maximum(fused.count, 1)
    score = np.clip(np.nan_to_num(fused.score), 0.0, 1.0)
    # Pairs share images, and with them errors: three maps are worth two.
    matching = (_AT_BEST_PX + _PER_SCORE_PX * (1.0 - score)) * together / np.sqrt((1.0 + count) / 2.0)
    error = np.hypot(matching, np.nan_to_num(fused.spread))
    error = np.where(fused.filled, _BACKGROUND_PX * together, error)
    return np.where(np.isfinite(fused.height), error, np.nan).astype(np.float32)
