"""Removes spikes ("needles"): a few cells far above or far below all others around them, which a single map has.

Matching removes small connected components of disparities, but lets those pass that match well: towers and chimneys are
so small. Where a texture repeats itself, gross errors match as well. Other maps outvote most cells of such a patch, and
the rest of it in the surface is even smaller. So a component of the size that matching removes is kept only with the
support of a second map, if it is above everything around it, or below it, by much more than it is wide. Two lines of
sight do not even reach the bottom of a pit that narrow.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, IntArray, Mask
from .parameters import FUSION, NeedleParameters
from .surroundings import extremes

_UNIT_M = 0.5  # of heights as 16-bit integers, which hold all heights on Earth
_NONE = -32768


def largest_needle(cell: float, spacing: float, parameters: NeedleParameters = FUSION.needles) -> int:
    """The largest number of cells of the side ``cell`` that a needle has, for pixels ``spacing`` apart (both m)."""
    return max(1, min(round(parameters.speckle_px * (spacing / cell) ** 2), parameters.most_cells))


def needles(
    height: FloatImage, count: FloatImage, cell: float, largest: int, parameters: NeedleParameters = FUSION.needles
) -> Mask:
    """(H, W) the cells that are needles, of heights (m, NaN = none) that so many maps have matched (NaN = none).

    ``cell`` is the side of a cell, m; ``largest`` is as of :func:`largest_needle`. Whether a cell is one depends on
    the cells as far as ``largest + around_cells`` around it.
    """
    known = np.isfinite(height)
    steps = np.where(known, np.rint(np.nan_to_num(height) / _UNIT_M), _NONE).astype(np.int16)
    left, most = steps.copy(), int(parameters.step_m / _UNIT_M)
    cv2.filterSpeckles(left, _NONE, largest, most)
    small = known & (left == _NONE)
    low, high = extremes(height, known, parameters.around_cells)
    apart = np.where(small, np.maximum(height - low, high - height), np.float32(0))
    far = apart > parameters.slender * cell
    result = np.zeros(height.shape, bool)
    if not far.any():
        return result
    from scipy import ndimage

    labels = _components(steps.astype(np.int64), small, most)
    places = ndimage.find_objects(labels)
    by = parameters.around_cells
    # A cell beside what stands out is as far from it as that is slender: most components have none.
    size = np.bincount(labels.ravel())
    reach = np.zeros(size.size, apart.dtype)
    np.maximum.at(reach, labels[far], apart[far])
    lone = reach > parameters.slender * cell * np.sqrt(size)
    lone[labels[np.nan_to_num(count) >= 2]] = False
    lone[0] = False
    for label in np.flatnonzero(lone):
        near = tuple(slice(max(side.start - by, 0), side.stop + by) for side in places[label - 1])
        own = labels[near] == label
        if _stands_out(own, height[near], cell, parameters):
            result[near] |= own
    return result


def _stands_out(own: Mask, height: FloatImage, cell: float, parameters: NeedleParameters) -> bool:
    """Whether cells are above all around them, or below them, by so much more than they are wide."""
    side = 2 * parameters.around_cells + 1
    around = (cv2.dilate(own.astype(np.uint8), np.ones((side, side), np.uint8)) > 0) & ~own & np.isfinite(height)
    if not around.any():
        return False
    width = cell * math.sqrt(int(own.sum()))
    own_height, other = height[own], height[around]
    gap = max(own_height.min() - other.max(), other.min() - own_height.max())
    return bool(gap > parameters.slender * width)


def _components(steps: IntArray, cells: Mask, most: int) -> IntArray:
    """(H, W) the numbers of the connected components of some cells, from 1 on; 0 elsewhere."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    number = np.full(steps.shape, -1, np.int64)
    count = int(cells.sum())
    number[cells] = np.arange(count)
    pairs = []
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        apart = np.abs(steps[here] - steps[there])
        same = cells[here] & cells[there] & (apart <= most)
        pairs.append((number[here][same], number[there][same]))
    rows, columns = (np.concatenate(parts) for parts in zip(*pairs))
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(count, count))
    _, names = connected_components(graph, directed=False)
    labels = np.zeros(steps.shape, np.int64)
    labels[cells] = names + 1
    return labels
