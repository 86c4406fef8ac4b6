"""From which DSM each cell of a mosaic has its height, and how neighbouring DSMs are blended.

Every cell belongs to the DSM inside which it lies farthest, measured from the borders and holes of each and divided by
its expected error: a Voronoi diagram of the areas (Pan, Wang and Li 2009, IEEE TGRS 47-6). Where the seam crosses an
object that the DSMs show differently (a tree, a displaced wall, a new house), the whole object goes to one of them, so
that seams run where the surfaces agree (as Chon, Kim and Lin 2010, ISPRS J. 65-1, ask for). Along seams heights are
averaged with weights that change from one DSM to the other and fall with the squared expected error, but only where
they belong to the same surface, all of them within half of the tolerance and none beyond it: a roof is never averaged
with the ground.

All data that a cell depends on lie within :func:`reach`, so a mosaic does not depend on the blocks it is made in.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, IntArray, Mask, Window
from .parameters import MOSAIC, SeamParameters


@dataclass(frozen=True)
class Mosaicked:
    """The cells of a block (rows, columns): height in m, NaN for none; the place of its DSM in the stack, -1 for none;
    how many DSMs have a height, and their standard deviation in m, NaN for fewer than two. ``steps`` (n,) are the
    differences in m of two DSMs where their cells meet."""

    height: FloatImage
    source: IntArray
    count: IntArray
    spread: FloatImage
    steps: FloatImage


def reach(parameters: SeamParameters = MOSAIC.seams) -> int:
    """How many cells around a cell its height depends on."""
    return 2 * parameters.feather_cells + 2 * parameters.object_cells + parameters.closed_cells


def without_small_holes(known: Mask, parameters: SeamParameters = MOSAIC.seams) -> Mask:
    """Where a surface is known, with holes that are small enough filled."""
    side = 2 * parameters.closed_cells + 1
    filled: Mask = known | (cv2.blur(known.astype(np.float32), (side, side)) >= 0.5)
    return filled


def mosaicked(
    heights: FloatImage, errors: FloatImage, interior: FloatImage, own: Window, parameters: SeamParameters
) -> Mosaicked:
    """One surface from a stack (DSMs, rows, columns) of heights (m, NaN for none).

    ``errors`` are the expected ones, m, finite. ``interior`` is how far inside a DSM a place lies, in cells, roughly.
    ``own`` is the part of the cells that is asked for; the rest is the margin of :func:`reach`, where there is one.
    """
    known = np.isfinite(heights)
    side = 2 * parameters.feather_cells + 1
    usual = np.stack([cv2.blur(error, (side, side)) for error in errors])
    score = np.stack([_inside(cells, far, parameters) for cells, far in zip(known, interior)]) / usual
    score[~known] = -1.0
    source = _around_objects(heights, errors, usual, score, parameters)
    height = _feathered(heights, errors, source, parameters)
    cut = (slice(None), *own.inside(Window(0, 0, *heights.shape[:0:-1])))
    count = known[cut].sum(axis=0)
    return Mosaicked(
        height[cut[1:]],
        np.where(count > 0, source[cut[1:]], -1),
        count,
        _spread(heights[cut], count),
        _steps(heights[cut], source[cut[1:]]),
    )


def _inside(known: Mask, interior: FloatImage, parameters: SeamParameters) -> FloatImage:
    """How far inside a DSM each cell lies, in cells: exactly near borders and holes, else as ``interior`` says."""
    away = to_unknown(without_small_holes(known, parameters))
    inside: FloatImage = np.minimum(away, np.float32(parameters.object_cells)) + interior
    return inside


def to_unknown(known: Mask) -> FloatImage:
    """The distance of each cell to the nearest one that is not known, in cells."""
    away = cv2.distanceTransform(known.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # OpenCV's root is good to 21 bits, and the others change from run to run: squares are whole numbers.
    exact: FloatImage = np.sqrt(np.rint(np.square(away, dtype=np.float64))).astype(np.float32)
    return exact


def _tolerance(error: FloatImage, other: FloatImage, parameters: SeamParameters) -> FloatImage:
    """How far apart two heights of one surface may be, m."""
    return np.hypot(error, other) * np.float32(parameters.tolerance)


def _taken(stack: FloatImage, source: IntArray) -> FloatImage:
    """The values of each cell's own DSM."""
    values: FloatImage = np.take_along_axis(stack, source[None], axis=0)[0]
    return values


def _around_objects(
    heights: FloatImage, errors: FloatImage, usual: FloatImage, score: FloatImage, parameters: SeamParameters
) -> IntArray:
    """The DSM of each cell: that of the best score, but of one object where DSMs differ all cells have the same."""
    source: IntArray = score.argmax(axis=0)
    height, error, best = _taken(heights, source), _taken(errors, source), score.max(axis=0)
    # Beyond this corridor a small object lies wholly on one side of the seam.
    near = best - 2 * parameters.object_cells / _taken(usual, source)
    differs = np.zeros(source.shape, np.uint8)
    with np.errstate(invalid="ignore"):
        for other, other_error, other_score in zip(heights, errors, score):
            apart = np.abs(other - height) > _tolerance(other_error, error, parameters)
            differs |= apart & (other_score > near)
    count, labels, facts, _ = cv2.connectedComponentsWithStats(differs, connectivity=8)
    small = (facts[:, cv2.CC_STAT_WIDTH] < parameters.object_cells) & (
        facts[:, cv2.CC_STAT_HEIGHT] < parameters.object_cells
    )
    small[0] = False
    places = np.flatnonzero(small[labels])
    if not places.size:
        return source
    objects = labels.ravel()[places]
    gains = np.where(score >= 0, score, -best).reshape(len(score), -1)[:, places]
    chosen = np.stack([np.bincount(objects, gain, count) for gain in gains]).argmax(axis=0)[objects]
    has = score.reshape(len(score), -1)[chosen, places] >= 0
    source.ravel()[places[has]] = chosen[has]
    return source


def _feathered(heights: FloatImage, errors: FloatImage, source: IntArray, parameters: SeamParameters) -> FloatImage:
    """The heights of the cells' DSMs, blended with those of neighbouring DSMs along the seams."""
    width = 2 * parameters.feather_cells
    side = (width + 1, width + 1)
    height, error = _taken(heights, source), _taken(errors, source)
    change, total = np.zeros_like(height), np.zeros_like(height)
    for number, (other, other_error) in enumerate(zip(heights, errors)):
        known = np.isfinite(other)
        share = cv2.blur(cv2.blur(((source == number) & known).astype(np.float32), side), side)
        # Heights do not change abruptly either where a DSM ends or has a hole.
        share *= np.minimum(to_unknown(known) / np.float32(width), np.float32(1))
        gap = other - height
        with np.errstate(invalid="ignore"):
            alike = np.clip(2 - 2 * np.abs(gap) / _tolerance(other_error, error, parameters), 0, 1)
        weight = np.where(known, share * alike / np.square(other_error), np.float32(0))
        change += np.where(weight > 0, weight * gap, np.float32(0))
        total += weight
    mixed: FloatImage = height + change / np.where(total > 0, total, np.float32(1))
    return mixed


def _spread(heights: FloatImage, count: IntArray) -> FloatImage:
    """The standard deviation between DSMs, NaN for fewer than two."""
    known = np.isfinite(heights)
    some = np.maximum(count, 1).astype(np.float32)
    mean = np.where(known, heights, np.float32(0)).sum(axis=0) / some
    square = np.where(known, np.square(heights - mean), np.float32(0)).sum(axis=0) / some
    return np.where(count > 1, np.sqrt(square), np.float32(np.nan))


def _steps(heights: FloatImage, source: IntArray) -> FloatImage:
    """How far apart two DSMs are where a cell of one meets a cell of the other, m, at cells that have both."""
    found = []
    sides = (source[:, :-1], source[:, 1:], heights[:, :, :-1]), (source[:-1], source[1:], heights[:, :-1])
    for here, there, stack in sides:
        rows, columns = np.nonzero(here != there)
        pairs = stack[:, rows, columns]
        each = np.arange(rows.size)
        found.append(np.abs(pairs[here[rows, columns], each] - pairs[there[rows, columns], each]))
    steps = np.concatenate(found)
    known: FloatImage = steps[np.isfinite(steps)]
    return known
