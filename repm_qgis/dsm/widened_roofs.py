"""Roofs that matching widened over the shadow beside them, cut back to where the images have their edge.

A deep shadow has next to no texture, so that matching continues the roof into it, in some places for several metres
and in all pairs alike: no vote between maps finds that out. What tells is the brightness: beside a roof that is far
brighter, cells as dark as the shadowed ground next to them belong to that ground. From the foot of the wall the ground
grows up to the edge that the images show. Where the images hardly support a height, less contrast will do, and what
such cells look like is not taken for the roof's brightness: they may be more than it has cells of its own.
"""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np

from ..arrays import FloatImage, Floats, IntArray, Mask
from ..geometry.gridding import surface_step
from ..imagery.sampling import median_of_known, quantile_of_known
from .parameters import FUSION, FusionParameters

_AROUND = np.ones((3, 3), np.uint8)


def widened_over_shadow(
    height: Floats, brightness: FloatImage, weak: Mask, cell: float, parameters: FusionParameters = FUSION
) -> FloatImage:
    """(H, W) heights, m, of the ground for cells that are not the roof's whose height they have; NaN for all others.

    ``brightness`` (H, W) is as of :func:`.brightness.brightness`: a cell of unknown brightness stays. ``weak`` (H, W)
    cells have heights that the images hardly support (:data:`.shaded.WEAK`). ``cell`` in m.
    """
    p = parameters.widened
    step = max(p.step_m, surface_step(cell, parameters.gridding))
    surface = np.asarray(height, np.float32).copy()
    result = np.full(surface.shape, np.nan, np.float32)
    known: Mask = np.isfinite(brightness) & np.isfinite(surface)
    asked = known
    for _ in range(p.rounds(cell)):
        cells, ground = _beside_lower(surface, asked, step)
        taken = _in_shadow(cells, ground, surface, brightness, weak, cell, parameters)
        if not taken.any():
            break
        cells, ground = cells[taken], ground[taken]
        surface.ravel()[cells] = result.ravel()[cells] = ground
        new = np.zeros(surface.shape, np.uint8)
        new.ravel()[cells] = 1
        asked = (cv2.dilate(new, _AROUND) > 0) & known & np.isnan(result)
    return result


def _beside_lower(surface: FloatImage, asked: Mask, step: float) -> Tuple[IntArray, FloatImage]:
    """(N,) those of the cells asked for that have a neighbour more than ``step`` m lower, and the lowest of these."""
    lowest = cv2.erode(np.where(np.isnan(surface), np.float32(np.inf), surface), _AROUND)
    with np.errstate(invalid="ignore"):
        cells = np.flatnonzero(asked & (surface - lowest > step))
    return cells, lowest.ravel()[cells]


def _in_shadow(
    cells: IntArray,
    ground: FloatImage,
    surface: FloatImage,
    brightness: FloatImage,
    weak: Mask,
    cell: float,
    p: FusionParameters,
) -> Mask:
    """(N,) whether cells are far darker than the surface whose height they have, and more like the ground's."""
    numbers, columns = p.widened, surface.shape[1]
    step, reach = numbers.window(cell)
    nothing = np.float32(np.nan)
    sure = np.where(weak, nothing, brightness)
    heights, lights, sure_lights = (
        np.pad(values, reach, constant_values=nothing) for values in (surface, brightness, sure)
    )
    like = max(numbers.like_m, 0.5 * surface_step(cell, p.gridding))
    offsets = [(down, right) for down in range(0, 2 * reach + 1, step) for right in range(0, 2 * reach + 1, step)]
    contrast, share = (
        np.where(weak.ravel()[cells], np.float32(less), np.float32(usual))
        for less, usual in ((numbers.weak_contrast, numbers.contrast), (numbers.weak_share, 0.5))
    )

    def around(image: FloatImage, some: IntArray) -> FloatImage:
        row, column = np.divmod(some, columns)
        return np.stack([image[row + down, column + right] for down, right in offsets])

    result = np.zeros(len(cells), dtype=bool)
    for first in range(0, len(cells), numbers.at_once):
        part = np.arange(first, min(first + numbers.at_once, len(cells)))
        light, seen = brightness.ravel()[cells[part]], around(lights, cells[part])
        maybe = np.fmax.reduce(seen) - light > contrast[part]  # most cells have nothing so bright near them
        part, light, seen = part[maybe], light[maybe], seen[:, maybe]
        z, sure_seen = around(heights, cells[part]), around(sure_lights, cells[part])
        with np.errstate(invalid="ignore"):
            on_roof, below = (np.abs(z - level) < like for level in (surface.ravel()[cells[part]], ground[part]))
            roof = quantile_of_known(np.where(on_roof, sure_seen, nothing), share[part], numbers.least_cells)
            shade = median_of_known(np.where(below, seen, nothing), numbers.least_cells)
            brighter = roof - light
            result[part] = (brighter > contrast[part]) & (np.abs(light - shade) < brighter)
    return result
