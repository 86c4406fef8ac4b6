"""Feathering: a linear transition between the heights of neighbouring tiles along their seams."""

from __future__ import annotations

from typing import Optional, Sequence

import numpy as np

from ..contracts.arrays import Floats, Size, Window
from .parameters import FUSION
from .tile_fusion import StoredTile


def feathered(
    height: Floats,
    index: int,
    windows: Sequence[Window],
    *,
    stored: Sequence[StoredTile],
    size: Size,
    tolerance: float,
    margin: int = FUSION.feather_cells,
) -> Floats:
    """A tile's heights, blended with its neighbours' within ``margin`` cells of its borders.

    Tiles are matched separately, in frames of their own, and differ by a fraction of the noise along their border,
    which a hillshade shows as a line. Weights fall linearly from the margin inside a border to the margin outside, and
    their sum is one. Heights farther apart than ``tolerance`` belong to different surfaces: there the tile's own stays,
    and cells without a height stay without one.

    Parameters
    ----------
    height : (H, W) m, of ``windows[index]`` in the whole grid of ``size``.
    """
    own = windows[index]
    total: Optional[Floats] = None
    for number, window in enumerate(windows):
        wide = window.grown(margin, size)
        overlap = own.common(wide)
        if number == index or overlap is None:
            continue
        if total is None:
            share = _weights(own, own, margin)
            total, weights = share * height, share
        other = stored[number].wide()[overlap.inside(wide)]
        here = overlap.inside(own)
        with np.errstate(invalid="ignore"):
            near = np.abs(other - height[here]) <= tolerance
        share = np.where(near, _weights(window, overlap, margin), np.float32(0))
        total[here] += np.where(share > 0, share * other, np.float32(0))
        weights[here] += share
    return height if total is None else total / weights


def _weights(window: Window, cells: Window, margin: int) -> Floats:
    """A tile's weight in cells: 1/2 along its borders."""
    ramps = []
    for first, size, start, count in (
        (window.row, window.height, cells.row, cells.height),
        (window.col, window.width, cells.col, cells.width),
    ):
        middle = np.arange(start, start + count) + 0.5
        inside = np.minimum(middle - first, first + size - middle)
        ramps.append(np.clip(0.5 + inside / (2 * margin), 1e-3, 1.0).astype(np.float32))
    product: Floats = ramps[0][:, None] * ramps[1][None, :]
    return product
