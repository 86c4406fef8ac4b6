"""Heights of neighbouring tiles made one where the tiles meet."""

from __future__ import annotations

from typing import Optional, Sequence, Tuple

import numpy as np

from ..arrays import Floats, Window
from .fusion import MARGIN_CELLS, StoredTile


def blended(
    height: Floats,
    index: int,
    windows: Sequence[Window],
    stored: Sequence[StoredTile],
    shape: Tuple[int, int],
    tolerance: float,
) -> Floats:
    """A tile's own heights, passing over into its neighbours' within the margin of its borders.

    Tiles are matched by themselves, in frames of their own, and differ by a fraction of the noise along their border,
    which a hillshade shows as a line. Weights fall linearly from the margin inside a border to the margin outside, and
    sum to one. Heights farther apart than ``tolerance`` are of different surfaces: the tile's own stays, and cells
    without a height stay so.

    Parameters
    ----------
    height : (H, W) m, of ``windows[index]`` (column, row, width, height of the whole grid of ``shape``).
    """
    own = windows[index]
    total: Optional[Floats] = None
    for number, window in enumerate(windows):
        wide = window.grown(MARGIN_CELLS, (shape[1], shape[0]))
        overlap = own.common(wide)
        if number == index or overlap is None:
            continue
        if total is None:
            share = _weights(own, own)
            total, weights = share * height, share
        other = stored[number].wide()[overlap.inside(wide)]
        here = overlap.inside(own)
        with np.errstate(invalid="ignore"):
            share = np.where(np.abs(other - height[here]) <= tolerance, _weights(window, overlap), np.float32(0))
        total[here] += np.where(share > 0, share * other, np.float32(0))
        weights[here] += share
    return height if total is None else total / weights


def _weights(window: Window, cells: Window) -> Floats:
    """A tile's weight in cells: 1/2 along its borders."""
    ramps = []
    for first, size, start, count in (
        (window.row, window.height, cells.row, cells.height),
        (window.col, window.width, cells.col, cells.width),
    ):
        middle = np.arange(start, start + count) + 0.5
        inside = np.minimum(middle - first, first + size - middle)
        ramps.append(np.clip(0.5 + inside / (2 * MARGIN_CELLS), 1e-3, 1.0).astype(np.float32))
    return ramps[0][:, None] * ramps[1][None, :]
