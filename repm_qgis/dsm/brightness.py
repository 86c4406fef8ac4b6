"""How bright the cells of a DSM are: the median of several views, so that a shadow that moved counts for little."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np

from ..arrays import FloatImage, Floats
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..imagery.sampling import median_of_known
from ..scene import View
from .ortho import orthophoto
from .parameters import FUSION, FusionParameters


def brightness(
    views: Sequence[View], grid: CellGrid, height: Floats, crs: str, parameters: FusionParameters = FUSION
) -> FloatImage:
    """(H, W) brightness of cells with their heights (m), where 0 to 1 is the range of nearly all; NaN = unknown.

    ``height`` is above the ellipsoid. The first views that show the grid are taken, as many as the parameters say; each
    counts where it sees a cell past all that stands higher.
    """
    p = parameters.brightness
    seen: List[FloatImage] = []
    for view in views:
        if len(seen) == p.views:
            break
        if not _shows(view, grid, height, crs):
            continue
        values = orthophoto([view], grid, height, crs, parameters.orthophoto)
        known = values[np.isfinite(values)]
        if known.size:
            dark, bright = np.percentile(known, p.percents)
            seen.append((values - np.float32(dark)) / np.float32(max(bright - dark, p.least_range)))
    return median_of_known(np.stack(seen)) if seen else np.full(grid.shape, np.nan, np.float32)


def _shows(view: View, grid: CellGrid, height: Floats, crs: str) -> bool:
    """Whether the rectangle around the cells' pixels meets the image."""
    if not np.isfinite(height).any():
        return False
    xs, ys = grid.centres()
    corners = geodetic_from_projected(crs, np.array([(x, y) for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])]))
    low, high = float(np.nanmin(height)), float(np.nanmax(height))
    pixels = np.concatenate([view.project(np.column_stack([corners, np.full(4, z)])) for z in (low, high)])
    return bool((pixels.max(axis=0) >= 0).all() and (pixels.min(axis=0) <= np.array(view.size) - 1).all())
