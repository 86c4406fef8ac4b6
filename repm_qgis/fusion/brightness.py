"""How bright the cells of a DSM are: the median of several views, so that a shadow that moved counts for little."""

from __future__ import annotations

from functools import partial
from typing import List, Sequence

import numpy as np

from ..arrays import FloatImage, Floats
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..geometry.tiles import pixel_window
from ..imagery.sampling import median_of_known
from ..scene import View
from .parameters import FUSION, FusionParameters
from .visible import orthophoto


def brightness(
    views: Sequence[View], grid: CellGrid, height: Floats, crs: str, parameters: FusionParameters = FUSION
) -> FloatImage:
    """(H, W) brightness of cells with their heights (m), where 0 to 1 is the range of nearly all; NaN = unknown.

    ``height`` is above the ellipsoid. The first views that show the grid are taken, as many as the parameters say; each
    counts where it sees a cell past all that stands higher.
    """
    nothing = np.full(grid.shape, np.nan, np.float32)
    if not np.isfinite(height).any():
        return nothing
    p, levels = parameters.brightness, (float(np.nanmin(height)), float(np.nanmax(height)))
    to_geodetic = partial(geodetic_from_projected, crs)
    seen: List[FloatImage] = []
    for view in views:
        if len(seen) == p.views:
            break
        if pixel_window(view.project, to_geodetic, grid.bounds, levels, view.size, smallest=1) is None:
            continue
        values = orthophoto([view], grid, height, crs, parameters.visibility)
        known = values[np.isfinite(values)]
        if known.size:
            dark, bright = np.percentile(known, p.percents)
            seen.append((values - np.float32(dark)) / np.float32(max(bright - dark, p.least_range)))
    return median_of_known(np.stack(seen)) if seen else nothing
