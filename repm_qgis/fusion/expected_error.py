"""The likely error of a fused height: what the confidence raster states in metres.

Two facts of a cell are known: the error that matching leaves at its correlation and base-to-height ratio, and the
spread of the maps that agree there. Both were compared with true surfaces (docs/method.md#confidence): the 68 %
quantile of errors in px of disparity falls linearly with the correlation, and the spread adds as an independent error.
"""

from __future__ import annotations

from typing import Sequence

import numpy as np

from ..arrays import FloatImage
from .aggregation import FusedCells
from .parameters import FUSION, ExpectedErrorParameters


def expected_error(
    fused: FusedCells, metres_per_px: Sequence[float], parameters: ExpectedErrorParameters = FUSION.error
) -> FloatImage:
    """(H, W) metres within which about two thirds of such heights are right; NaN where there is no height.

    ``metres_per_px`` of all the tile's height maps. Pointing errors, which all cells share, are not included: the
    report states them.
    """
    typical = _of_one_map(metres_per_px)
    count = np.maximum(fused.count, 1)
    loss = parameters.per_score_px * (1.0 - np.clip(np.nan_to_num(fused.score), 0.0, 1.0))
    # Pairs share images and so share errors: three maps count as two.
    matching = (parameters.at_best_px + loss) * typical / np.sqrt((1.0 + count) / 2.0)
    error = np.hypot(matching, np.nan_to_num(fused.spread))
    error = np.where(fused.filled, background_error(metres_per_px, parameters), error)
    return np.where(np.isfinite(fused.height), error, np.nan).astype(np.float32)


def background_error(metres_per_px: Sequence[float], parameters: ExpectedErrorParameters = FUSION.error) -> float:
    """The same, of heights that cells took from the background beside them."""
    return parameters.background_px * _of_one_map(metres_per_px)


def _of_one_map(metres_per_px: Sequence[float]) -> float:
    """The height of one px of disparity of one map among several, where they count by their variances."""
    metres = np.asarray(metres_per_px, dtype=np.float64)
    return float(len(metres) ** 0.5 / np.sqrt((metres**-2.0).sum()))
