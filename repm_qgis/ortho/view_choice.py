"""Which view each cell of the orthophoto is taken from: smooth patches, whose seams run where the views agree.

Each cell would have the view that sees it from nearest to the vertical, away from what hides the ground, and with the
colour that most views see there (cars and shadows move). A seam between two views costs what they differ by on both of
its sides (Kwatra et al. 2003, Graphcut Textures, ACM Transactions on Graphics 22), so that it runs along edges or where
it is not visible. Costs are minimised along rows and columns in both directions, and their sums decide (semi-global
matching, Hirschmueller 2008, IEEE TPAMI 30): a graph cut's minimum is lower, but its time grows faster than the cells.
"""

from __future__ import annotations

from typing import Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import FloatImage, Floats, Mask
from ..imagery.sampling import median_of_known
from .parameters import ORTHO, SeamParameters

Labels = NDArray[np.int8]
"""(H, W) numbers of views, -1 where none sees the cell."""


def chosen_views(
    colours: FloatImage,
    steepness: Sequence[float],
    contrast: Floats,
    parameters: SeamParameters = ORTHO.seams,
    held: Optional[Labels] = None,
) -> Labels:
    """The view of each cell.

    Parameters
    ----------
    colours : (K, B, H, W) balanced, NaN where a view does not see a cell.
    steepness : (K,) how far each line of sight goes sideways, m for each m that it rises.
    contrast : (B,) the unit of differences.
    held : the views of cells that were chosen before, -1 for the others, which go on from these.
    """
    seen = np.isfinite(colours[:, 0])
    labels = np.where(seen.any(axis=0), 0, -1).astype(np.int8)
    if len(colours) == 1 or not seen.any():
        return labels
    scaled = colours / np.asarray(contrast, np.float32)[None, :, None, None]
    costs = _costs(scaled, seen, steepness, parameters)
    if held is not None:
        for view in range(len(colours)):
            costs[..., view] += np.where((held >= 0) & (held != view), np.float32(parameters.hidden), np.float32(0))
    differences = _differences(scaled, seen, parameters)
    total = np.zeros_like(costs)
    for backwards in (False, True):
        along = slice(None, None, -1 if backwards else 1)
        total[along] += _swept(costs[along], differences[along], parameters.seam)
        turned = _swept(costs[:, along].swapaxes(0, 1), differences[:, along].swapaxes(0, 1), parameters.seam)
        total[:, along] += turned.swapaxes(0, 1)
    # Whatever the neighbours have, a cell is taken from a view that sees it.
    total[~np.moveaxis(seen, 0, -1)] = np.inf
    return np.where(labels >= 0, np.argmin(total, axis=-1), -1).astype(np.int8)


def feathered_colours(
    colours: FloatImage, labels: Labels, contrast: Floats, parameters: SeamParameters = ORTHO.seams
) -> FloatImage:
    """(B, H, W) the chosen colours, blended near a seam; arguments as of :func:`chosen_views`.

    Only views that see a cell are blended, with weights that fall with their difference from the chosen one: an object
    that only one of two dates shows is either complete or absent. Cells that no view sees stay NaN.
    """
    chosen = np.take_along_axis(colours, np.maximum(labels, 0)[None, None].astype(np.intp), axis=0)[0]
    unit = np.asarray(contrast, np.float32)[:, None, None] * np.float32(parameters.blended)
    total, weights = np.zeros_like(chosen), np.zeros(labels.shape, np.float32)
    side = (2 * parameters.feather_cells + 1,) * 2
    for view, values in enumerate(colours):
        share = cv2.blur((labels == view).astype(np.float32), side, borderType=cv2.BORDER_REPLICATE)
        with np.errstate(invalid="ignore"):
            apart = np.nan_to_num(np.abs((values - chosen) / unit).mean(axis=0), nan=1.0)
        share *= np.maximum(1 - apart, 0) * (labels >= 0)
        total += share * np.nan_to_num(values)
        weights += share
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weights > 0, total / weights, np.float32(np.nan)).astype(np.float32)


def _costs(scaled: FloatImage, seen: Mask, steepness: Sequence[float], parameters: SeamParameters) -> FloatImage:
    """(H, W, K) what each view costs in each cell by itself."""
    views = len(scaled)
    costs = np.empty(seen.shape[1:] + (views,), np.float32)
    middle = None
    if views >= parameters.least_views:
        middle = np.stack([median_of_known(scaled[:, band], parameters.least_views) for band in range(len(scaled[0]))])
    least = min(steepness)
    window = np.ones((2 * parameters.edge_cells + 1,) * 2, np.uint8)
    for view in range(views):
        cost = np.full(seen.shape[1:], parameters.steepness * (steepness[view] - least), np.float32)
        cost += parameters.edge * cv2.dilate((~seen[view]).astype(np.uint8), window)
        if middle is not None:
            off = np.abs(scaled[view] - middle).mean(axis=0)
            cost += parameters.odd * np.minimum(np.nan_to_num(off), parameters.oddest)
        costs[..., view] = np.where(seen[view], cost, parameters.hidden)
    return costs


def _differences(scaled: FloatImage, seen: Mask, parameters: SeamParameters) -> FloatImage:
    """(H, W, K, K) what a seam between two views costs on its side in a cell, in addition to its length."""
    views = len(scaled)
    found = np.zeros(seen.shape[1:] + (views, views), np.float32)
    for first in range(views):
        for second in range(first):
            apart = np.nan_to_num(np.abs(scaled[first] - scaled[second]).mean(axis=0), nan=parameters.most_apart)
            cost = parameters.apart * np.minimum(apart, parameters.most_apart)
            found[..., first, second] = found[..., second, first] = cost
    return found


def _swept(costs: FloatImage, differences: FloatImage, seam: float) -> FloatImage:
    """(H, W, K) costs with the best way that leads to each cell from the first row on."""
    views = costs.shape[-1]
    length = np.float32(seam) * (1 - np.eye(views, dtype=np.float32))
    found = np.empty_like(costs)
    found[0] = costs[0]
    for row in range(1, len(costs)):
        step = length + 0.5 * (differences[row] + differences[row - 1])
        before = found[row - 1]
        best = (before[:, None, :] + step).min(axis=-1)
        found[row] = costs[row] + best - before.min(axis=-1, keepdims=True)
    return found
