"""The coarse surface of the whole DSM, from what its blocks found."""

from __future__ import annotations

import math
from typing import Sequence

import numpy as np
from scipy import ndimage

from ..contracts.arrays import FloatArray, Mask
from ..contracts.errors import EmptyResultError
from . import ground
from .blocks import Coarse, Part, Search


def coarse_of(search: Search, parts: Sequence[Part], stiffness: float, voids: str) -> Coarse:
    """Put the blocks' sums together and solve; raises EmptyResultError where nothing is ground.

    ``voids`` is an option of :class:`~repm_qgis.contracts.options.DtmOptions`.
    """
    weighted, weights, known = (np.zeros(search.coarse_shape) for _ in range(3))
    for part in parts:
        top, left = part.own.row >> search.level, part.own.col >> search.level
        rows, columns = part.known.shape
        cut = slice(top, top + rows), slice(left, left + columns)
        weighted[cut], weights[cut], known[cut] = *part.sums, part.known
    if not weights.any():
        raise EmptyResultError(
            f"No cell of '{search.surface.path}' is ground: check that the DSM has heights, or make its terrain by "
            "repm:dtm with a smaller LARGEST or a larger SLOPE."
        )
    parameters = search.parameters.ground
    cell = search.surface.cell * (1 << search.level)
    sums, seen = (weighted, weights), weights >= parameters.seen_share * 4**search.level
    height = ground.whole_surface(sums, np.zeros_like(weights), stiffness, parameters)
    laplacian = ground.laplacian_of(height, seen, cell, parameters)
    height = ground.whole_surface(sums, laplacian, stiffness, parameters)
    across, down = (
        np.minimum(1 << search.level, count - (np.arange(coarse) << search.level))
        for count, coarse in zip(search.surface.size, known.shape[::-1])
    )
    full = known == down[:, None] * across  # others may lie on the border, beyond which there is no terrain
    inside = _inside(full, search.largest / 2 / cell) if voids == "inside" else np.zeros(known.shape, bool)
    return Coarse(height, _slope(height, cell), laplacian, inside)


def _slope(height: FloatArray, cell: float) -> FloatArray:
    """The surface's slope, m per m, of means over 3 x 3 cells."""
    padded = np.pad(height, 2, mode="reflect", reflect_type="odd")
    rows = (padded[:-2] + padded[1:-1] + padded[2:]) / 3
    smooth = (rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 3
    east, south = smooth[1:-1, 2:] - smooth[1:-1, :-2], smooth[2:, 1:-1] - smooth[:-2, 1:-1]
    return np.asarray(np.hypot(east, south) / (2 * cell))


def _inside(known: Mask, half: float) -> Mask:
    """All cells that heights surround: those a disc of this radius cannot reach from outside without touching one."""
    margin = math.ceil(half) + 1
    away = ndimage.distance_transform_edt(~np.pad(known, margin)) if known.any() else None
    if away is None:
        return known
    outside = away > half
    if not outside.any():
        return np.ones_like(known)
    closed = ndimage.distance_transform_edt(~outside) > half
    return np.asarray(closed[margin:-margin, margin:-margin])
