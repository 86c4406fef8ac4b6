"""Roofs that matching widened over the shadow beside them, cut back to where the images have their edge.

A deep shadow has next to no texture, so that matching continues the roof into it, in some places for several metres
and in all pairs alike: no vote between maps finds that out. What tells is the brightness: beside a roof that is far
brighter, cells as dark as the shadowed ground next to them belong to that ground. From the foot of the wall the ground
grows up to the edge that the images show.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np

from ..arrays import FloatImage, Floats, IntArray, Mask
from ..geometry.gridding import surface_step
from ..imagery.sampling import median_of_known
from .parameters import FUSION, FusionParameters

_NEIGHBOURS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)


def widened_over_shadow(
    height: Floats, brightness: FloatImage, cell: float, parameters: FusionParameters = FUSION
) -> FloatImage:
    """(H, W) heights, m, of the ground for cells that are not the roof's whose height they have; NaN for all others.

    ``brightness`` (H, W) is as of :func:`.brightness.brightness`: a cell of unknown brightness stays. ``cell`` in m.
    """
    p = parameters.widened
    step = max(p.step_m, surface_step(cell, parameters.gridding))
    surface = np.asarray(height, np.float32).copy()
    result = np.full(surface.shape, np.nan, np.float32)
    asked: Mask = np.isfinite(brightness) & np.isfinite(surface)
    for _ in range(p.rounds(cell)):
        cells, ground = _beside_lower(surface, asked, step)
        taken = _in_shadow(cells, ground, surface, brightness, cell, parameters)
        if not taken.any():
            break
        cells, ground = cells[taken], ground[taken]
        surface.ravel()[cells] = result.ravel()[cells] = ground
        asked = _around(cells, (surface.shape[0], surface.shape[1])) & np.isfinite(brightness) & np.isnan(result)
    return result


def _beside_lower(surface: FloatImage, asked: Mask, step: float) -> Tuple[IntArray, FloatImage]:
    """(N,) those of the cells asked for that have a neighbour more than ``step`` m lower, and the lowest of these."""
    columns = surface.shape[1]
    padded = np.pad(surface, 1, constant_values=np.inf)
    cells = np.flatnonzero(asked)
    row, column = np.divmod(cells, columns)
    around = np.stack([padded[row + 1 + down, column + 1 + right] for down, right in _NEIGHBOURS])
    lowest = np.where(np.isnan(around), np.float32(np.inf), around).min(axis=0)
    lower = surface.ravel()[cells] - lowest > step
    return cells[lower], lowest[lower]


def _in_shadow(
    cells: IntArray, ground: FloatImage, surface: FloatImage, brightness: FloatImage, cell: float, p: FusionParameters
) -> Mask:
    """(N,) whether cells are far darker than the surface whose height they have, and more like the ground's."""
    numbers, columns = p.widened, surface.shape[1]
    step, reach = numbers.window(cell)
    heights, lights = (np.pad(values, reach, constant_values=np.nan) for values in (surface, brightness))
    like = max(numbers.like_m, 0.5 * surface_step(cell, p.gridding))
    offsets = [(down, right) for down in range(0, 2 * reach + 1, step) for right in range(0, 2 * reach + 1, step)]

    def around(image: FloatImage, some: IntArray) -> FloatImage:
        row, column = np.divmod(some, columns)
        return np.stack([image[row + down, column + right] for down, right in offsets])

    result = np.zeros(len(cells), dtype=bool)
    for first in range(0, len(cells), numbers.at_once):
        part = np.arange(first, min(first + numbers.at_once, len(cells)))
        light, seen = brightness.ravel()[cells[part]], around(lights, cells[part])
        maybe = np.fmax.reduce(seen) - light > numbers.contrast  # most cells have nothing so bright near them
        part, light, seen = part[maybe], light[maybe], seen[:, maybe]
        z = around(heights, cells[part])
        with np.errstate(invalid="ignore"):
            roof, shade = (
                median_of_known(np.where(np.abs(z - level) < like, seen, np.float32(np.nan)), numbers.least_cells)
                for level in (surface.ravel()[cells[part]], ground[part])
            )
            brighter = roof - light
            result[part] = (brighter > numbers.contrast) & (np.abs(light - shade) < brighter)
    return result


def _around(cells: IntArray, shape: Tuple[int, int]) -> Mask:
    """(H, W) the neighbours of cells."""
    padded = np.zeros((shape[0] + 2, shape[1] + 2), dtype=bool)
    row, column = np.divmod(cells, shape[1])
    for down, right in _NEIGHBOURS:
        padded[row + 1 + down, column + 1 + right] = True
    around: Mask = padded[1:-1, 1:-1]
    return around
