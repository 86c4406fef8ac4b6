"""Heights of neighbouring tiles made one where the tiles meet."""

from __future__ import annotations

from typing import Optional, Sequence, Tuple

import numpy as np

from ..arrays import Floats
from .fusion import MARGIN_CELLS, StoredTile

Window = Tuple[int, int, int, int]


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
    col, row, width, rows = windows[index]
    total: Optional[Floats] = None
    for number, window in enumerate(windows):
        overlap = None if number == index else _common(window, windows[index], shape)
        if overlap is None:
            continue
        c0, r0, c1, r1 = overlap
        if total is None:
            share = _weights(windows[index], (col, row, col + width, row + rows))
            total, weights = share * height, share
        c_from, r_from = max(window[0] - MARGIN_CELLS, 0), max(window[1] - MARGIN_CELLS, 0)
        other = stored[number].wide()[r0 - r_from : r1 - r_from, c0 - c_from : c1 - c_from]
        here = np.s_[r0 - row : r1 - row, c0 - col : c1 - col]
        with np.errstate(invalid="ignore"):
            share = np.where(np.abs(other - height[here]) <= tolerance, _weights(window, overlap), np.float32(0))
        total[here] += np.where(share > 0, share * other, np.float32(0))
        weights[here] += share
    return height if total is None else total / weights


def _common(window: Window, own: Window, shape: Tuple[int, int]) -> Optional[Window]:
    """First and last (exclusive) column and row of a tile's own cells that another one's margin covers."""
    c0, r0 = max(window[0] - MARGIN_CELLS, own[0], 0), max(window[1] - MARGIN_CELLS, own[1], 0)
    c1 = min(window[0] + window[2] + MARGIN_CELLS, own[0] + own[2], shape[1])
    r1 = min(window[1] + window[3] + MARGIN_CELLS, own[1] + own[3], shape[0])
    return (c0, r0, c1, r1) if c0 < c1 and r0 < r1 else None


def _weights(window: Window, cells: Window) -> Floats:
    """A tile's weight in cells (first and last column and row): 1/2 along its borders."""
    ramps = []
    for first, size, start, end in (
        (window[1], window[3], cells[1], cells[3]),
        (window[0], window[2], cells[0], cells[2]),
    ):
        middle = np.arange(start, end) + 0.5
        inside = np.minimum(middle - first, first + size - middle)
        ramps.append(np.clip(0.5 + inside / (2 * MARGIN_CELLS), 1e-3, 1.0).astype(np.float32))
    return ramps[0][:, None] * ramps[1][None, :]
