"""Holes of a DSM filled from what surrounds them: ``FILL = all``."""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np

from ..contracts.arrays import FloatImage, Floats, IntArray, Mask
from .parameters import FUSION, HoleParameters

_HALF_TURN = ((0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2))
_DIRECTIONS = _HALF_TURN + tuple((-row, -column) for row, column in _HALF_TURN)


def fill_holes(
    height: Floats, base: Optional[Floats] = None, parameters: HoleParameters = FUSION.holes
) -> Tuple[FloatImage, Mask]:
    """Fill cells that heights surround, by inverse squared distance of the nearest heights in 16 directions.

    Parameters
    ----------
    height : (H, W) m, NaN = none.
    base : (H, W) m, a terrain model whose relief the holes take: the difference from it is then interpolated. Cells
        where it is NaN are filled as if there were none.

    Returns
    -------
    The filled heights, float32, and which cells were filled. Cells beyond the heights' outer border stay NaN.
    """
    filled = height.astype(np.float32)
    cells = np.flatnonzero(np.isnan(filled))
    marked = np.zeros(filled.shape, dtype=bool)
    if not cells.size or cells.size == filled.size:
        return filled, marked
    values, within = _interpolated(filled, cells, parameters)
    if base is not None:
        difference, _ = _interpolated(filled - base.astype(np.float32), cells, parameters)
        shaped = difference + base.ravel()[cells].astype(np.float32)
        values = np.where(np.isfinite(shaped), shaped, values)
    filled.ravel()[cells[within]] = values[within]
    marked.ravel()[cells[within]] = True
    return filled, marked


def _interpolated(surface: FloatImage, cells: IntArray, parameters: HoleParameters) -> Tuple[FloatImage, Mask]:
    """(N,) inverse-distance values of cells, and whether heights surround them."""
    rim = 2
    width = surface.shape[1] + 2 * rim
    padded = np.pad(surface, rim, constant_values=np.nan).ravel()
    outside = np.pad(np.zeros(surface.shape, dtype=bool), rim, constant_values=True).ravel()
    row, column = np.divmod(cells, surface.shape[1])
    start = (row + rim) * width + column + rim
    total, weights = np.zeros(len(cells)), np.zeros(len(cells))
    seen = np.zeros((len(_DIRECTIONS), len(cells)), dtype=bool)
    for known, (dr, dc) in zip(seen, _DIRECTIONS):
        todo, step = np.arange(len(cells)), math.hypot(dr, dc)
        for count in range(1, int(parameters.reach_cells / step) + 1):
            place = start[todo] + count * (dr * width + dc)
            value = padded[place]
            found = np.isfinite(value)
            weight = (count * step) ** -2
            total[todo[found]] += weight * value[found]
            weights[todo[found]] += weight
            known[todo[found]] = True
            todo = todo[~found & ~outside[place]]
            if not todo.size:
                break
    with np.errstate(invalid="ignore", divide="ignore"):
        values = (total / weights).astype(np.float32)
    return values, _longest_gap(seen) <= parameters.widest_gap


def _longest_gap(seen: Mask) -> IntArray:
    """(N,) the longest run, around the circle, of directions in which no height was found."""
    longest: IntArray = np.zeros(seen.shape[1], np.int64)
    run = longest.copy()
    for known in np.concatenate([seen, seen]):
        run = np.where(known, 0, run + 1)
        np.maximum(longest, run, out=longest)
    return longest
