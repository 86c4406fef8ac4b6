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
_NOTHING = np.float32(np.nan)


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
    asked, seen = known, _Appearance(brightness, weak, cell, parameters)
    for _ in range(p.rounds(cell)):
        cells, ground = _beside_lower(surface, asked, step)
        taken = seen.in_shadow(cells, ground, surface)
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


class _Appearance:
    """What the images show of the cells of a surface, which changes while roofs are cut back."""

    def __init__(self, brightness: FloatImage, weak: Mask, cell: float, parameters: FusionParameters) -> None:
        p = self._parameters = parameters.widened
        step, self._reach = p.window(cell)
        places = range(0, 2 * self._reach + 1, step)
        self._offsets = [(down, right) for down in places for right in places]
        self._like = max(p.like_m, 0.5 * surface_step(cell, parameters.gridding))
        self._brightness = brightness
        self._lights, self._sure_lights = map(self._padded, (brightness, np.where(weak, _NOTHING, brightness)))
        self._contrast, self._share = (
            np.where(weak, np.float32(less), np.float32(usual))
            for less, usual in ((p.weak_contrast, p.contrast), (p.weak_share, 0.5))
        )

    def in_shadow(self, cells: IntArray, ground: FloatImage, surface: FloatImage) -> Mask:
        """(N,) whether cells are far darker than the surface whose height they have, and more like the ground's."""
        p, heights = self._parameters, self._padded(surface)
        result = np.zeros(len(cells), dtype=bool)
        for first in range(0, len(cells), p.at_once):
            part = np.arange(first, min(first + p.at_once, len(cells)))
            light, seen = self._brightness.ravel()[cells[part]], self._around(self._lights, cells[part])
            contrast = self._contrast.ravel()[cells[part]]
            maybe = np.fmax.reduce(seen) - light > contrast  # most cells have nothing so bright near them
            part, light, seen, contrast = part[maybe], light[maybe], seen[:, maybe], contrast[maybe]
            some = cells[part]
            z, sure_seen = self._around(heights, some), self._around(self._sure_lights, some)
            with np.errstate(invalid="ignore"):
                on_roof, below = (np.abs(z - level) < self._like for level in (surface.ravel()[some], ground[part]))
                roof = quantile_of_known(
                    np.where(on_roof, sure_seen, _NOTHING), self._share.ravel()[some], p.least_cells
                )
                shade = median_of_known(np.where(below, seen, _NOTHING), p.least_cells)
                brighter = roof - light
                result[part] = (brighter > contrast) & (np.abs(light - shade) < brighter)
        return result

    def _padded(self, values: FloatImage) -> FloatImage:
        return np.pad(values, self._reach, constant_values=_NOTHING)

    def _around(self, padded: FloatImage, cells: IntArray) -> FloatImage:
        """(places, N) the values in the window of each of N cells."""
        row, column = np.divmod(cells, self._brightness.shape[1])
        return np.stack([padded[row + down, column + right] for down, right in self._offsets])
