"""How bright the cells of a DSM are: the median of several views, so that a shadow that moved counts for little."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np

from ..arrays import FloatImage, Floats
from ..geometry.cell_grid import CellGrid
from ..imagery.sampling import median_of_known
from ..scene import View
from .ortho import orthophoto
from .parameters import FUSION, FusionParameters


def brightness(
    views: Sequence[View], grid: CellGrid, height: Floats, crs: str, parameters: FusionParameters = FUSION
) -> FloatImage:
    """(H, W) brightness of cells with their heights (m), where 0 to 1 is the range of nearly all; NaN = unknown.

    ``height`` is above the ellipsoid. A view counts where it sees a cell past all that stands higher.
    """
    seen: List[FloatImage] = []
    for view in views:
        values = orthophoto([view], grid, height, crs, parameters.orthophoto)
        known = values[np.isfinite(values)]
        if known.size:
            dark, bright = np.percentile(known, parameters.brightness.percents)
            seen.append((values - np.float32(dark)) / np.float32(max(bright - dark, 1e-6)))
    return median_of_known(np.stack(seen)) if seen else np.full(grid.shape, np.nan, np.float32)
