"""Connected cells of buildings divided where walls stand between roofs: each part has a height of its own."""

from __future__ import annotations

from typing import List

import numpy as np
from osgeo import ogr
from scipy import ndimage

from ..contracts.arrays import FloatImage, IntArray, Mask
from ..imagery.cell_polygons import inside, outlined
from .cells import Rasters
from .footprints import disc, in_cells, without_small_holes
from .parameters import BUILDINGS, BuildingParameters, SegmentParameters

_AROUND = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right]


def segment_numbers(
    height: FloatImage, within: Mask, cell: float, parameters: SegmentParameters = BUILDINGS.segments
) -> IntArray:
    """(rows, columns) the number of each cell's part, from 1, 0 for cells that are not ``within``. Walls are where the
    heights (m) of neighbours differ by more than any roof's; their cells go to the part whose height is nearer."""
    known = np.where(np.isfinite(height) & within, height, np.nan)
    around = np.ones((3, 3), bool)
    top = ndimage.maximum_filter(np.where(np.isnan(known), -np.inf, known), footprint=around)
    bottom = ndimage.minimum_filter(np.where(np.isnan(known), np.inf, known), footprint=around)
    with np.errstate(invalid="ignore"):
        level = ~np.isnan(known) & (top - bottom < max(parameters.wall_m, 2 * cell * parameters.steepest))
    level = ndimage.binary_opening(level, disc(in_cells(parameters.neck_m, cell)))
    labels, count = ndimage.label(level)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    large = np.flatnonzero(sizes[1:] * cell**2 >= parameters.least_m2) + 1
    if len(large) < 2:
        return within.astype(np.int64)
    numbers = np.zeros(count + 1, np.int64)
    numbers[large] = np.arange(1, len(large) + 1)
    return _grown(numbers[labels], known, within)


def _grown(numbers: IntArray, height: FloatImage, within: Mask) -> IntArray:
    """The parts grown over all cells within, ring by ring, each cell to the neighbour whose height is nearest."""
    left = within & (numbers == 0)
    z = np.where(np.isnan(height), 0.0, height)
    while left.any():
        padded, padded_z = np.pad(numbers, 1), np.pad(z, 1)
        best, chosen = np.full(z.shape, np.inf), np.zeros_like(numbers)
        for down, right in _AROUND:
            cut = slice(1 + down, 1 + down + z.shape[0]), slice(1 + right, 1 + right + z.shape[1])
            away = np.where(padded[cut] > 0, np.abs(z - padded_z[cut]), np.inf)
            nearer = left & (away < best)
            best[nearer], chosen[nearer] = away[nearer], padded[cut][nearer]
        found = chosen > 0
        if not found.any():
            break
        numbers = np.where(found, chosen, numbers)
        left &= ~found
    return numbers


def divided(rasters: Rasters, border: ogr.Geometry, parameters: BuildingParameters = BUILDINGS) -> List[ogr.Geometry]:
    """The borders of the parts of connected cells, the highest first. The border of a lower one reaches a little below
    those beside it that are higher, so that no gap is left where it is straightened and they are taken off it."""
    cell, choices = rasters.surface.cell, parameters.segments
    window = rasters.window(border, 1)
    transform = rasters.grid.window(window).transform
    height = rasters.heights(window)
    within = inside(border, height.shape, transform)
    numbers = segment_numbers(height, within, cell, choices)
    count = int(numbers.max())
    if count < 2:
        return [border]
    means = np.array([float(np.nanmedian(height[numbers == number])) for number in range(1, count + 1)])
    found, higher = [], np.zeros_like(within)
    for number in np.argsort(-means, kind="stable") + 1:
        own = numbers == number
        below = ndimage.binary_dilation(own, disc(in_cells(choices.below_m, cell))) & higher
        shapes = [
            without_small_holes(shape, parameters.footprints.hole_m2) for shape in outlined(own | below, transform)
        ]
        found += [max(shapes, key=lambda each: each.GetArea())] if shapes else []
        higher |= own
    return found
