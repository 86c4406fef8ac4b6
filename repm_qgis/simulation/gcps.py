"""Ground control points of a truth scene: where all views see the ground, and what they measure there."""

from __future__ import annotations

from typing import List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.errors import OptionError
from ..pointing.ground_control import Gcp
from .parameters import SIMULATION, SimulatedGcpParameters
from .render import RayCaster
from .sensor import PushbroomView
from .surface import SimulatedSurface


def common_square(
    surface: SimulatedSurface,
    views: Sequence[PushbroomView],
    step: int,
    parameters: SimulatedGcpParameters = SIMULATION.control,
) -> Tuple[int, int, int]:
    """The largest square around the surface's middle that lies inside every image at every height.

    Returns the first row and column of nodes (multiples of ``step``), and the count of every ``step``-th node a side.
    Raises OptionError if there is no such square.
    """
    middle = [step * int(round((n - 1) / 2 / step)) for n in surface.height.shape]
    low, high = 0, min(min(m, n - 1 - m) for m, n in zip(middle, surface.height.shape)) // step
    while low < high:
        half = (low + high + 1) // 2
        if _seen_by_all(surface, views, middle, half * step, parameters.edge_px):
            low = half
        else:
            high = half - 1
    if low < 8:
        raise OptionError("SIZE", views[0].size[0], "is too small: the views have no ground in common")
    return middle[0] - low * step, middle[1] - low * step, 2 * low + 1


def _seen_by_all(
    surface: SimulatedSurface, views: Sequence[PushbroomView], middle: Sequence[int], half: int, edge_px: float
) -> bool:
    """Whether the edge of a square projects into every image at the surface's lowest and highest height."""
    side = np.linspace(-half, half, 5)
    col, row = (part.ravel() for part in np.meshgrid(middle[1] + side, middle[0] + side))
    ground = surface.ground(col, row)
    for view in views:
        for height in surface.height_range():
            ground[:, 2] = height
            pixels = view.project(ground)
            if pixels.min() < edge_px or (pixels > np.array(view.size) - 1 - edge_px).any():
                return False
    return True


def choose_gcps(
    surface: SimulatedSurface,
    views: Sequence[PushbroomView],
    square: Tuple[int, int, int],
    step: int,
    seed: int,
    parameters: SimulatedGcpParameters = SIMULATION.control,
) -> List[Gcp]:
    """Flat, visible places spread over the common square, measured in the real sensor with noise.

    In each field of the square, the candidate that most views see is taken: among flat ground and roofs if there are
    any, otherwise among the flattest places. Points that fewer than two views see are left out, and a view that does
    not see a point has no row for it. Every second point is a check point.
    """
    rng = np.random.default_rng([seed, 3])
    casters = [RayCaster(surface, view) for view in views]
    extent = (square[2] - 1) * step
    columns, rows = parameters.fields
    result: List[Gcp] = []
    for number in range(columns * rows):
        field_col, field_row = number % columns, number // columns
        place = rng.uniform(0.08, 0.92, (parameters.candidates, 2))
        col = square[1] + (field_col + place[:, 0]) / columns * extent
        row = square[0] + (field_row + place[:, 1]) / rows * extent
        # Places flatter than the limit keep their random order: a flat roof is no better than flat enough ground.
        uneven = np.maximum(_unevenness(surface, col, row, parameters.reach_cells * step), parameters.flat_m)
        flattest = np.argsort(uneven, kind="stable")[: parameters.flattest]
        noise = rng.normal(0.0, parameters.noise_px, (len(views), 2))
        best: List[Tuple[int, FloatArray]] = []
        for ground in surface.ground(col[flattest], row[flattest]):
            tried = [(n, _seen_at(caster, ground, parameters.visible_m)) for n, caster in enumerate(casters)]
            seen = [(n, pixel) for n, pixel in tried if pixel is not None]
            if len(seen) > len(best):
                best, (lon, lat, height) = seen, map(float, ground)
            if len(best) == len(views):
                break
        if len(best) < 2:
            continue
        role = "check" if number % 2 else "control"
        pixels = {views[n].name: pixel + noise[n] for n, pixel in best}
        result.append(Gcp(f"P{number + 1:02d}", lon, lat, height, role, pixels))
    return result


def _unevenness(surface: SimulatedSurface, col: FloatArray, row: FloatArray, reach: float) -> FloatArray:
    """(N,) highest less lowest of 25 heights within ``reach`` nodes of places, m."""
    side = np.linspace(-reach, reach, 5)
    right, down = (part.ravel() for part in np.meshgrid(side, side))
    heights = surface.heights(col[:, None] + right, row[:, None] + down)
    spread: FloatArray = np.ptp(heights, axis=1)
    return spread


def _seen_at(caster: RayCaster, ground: FloatArray, visible_m: float) -> Optional[FloatArray]:
    """The pixel at which a view really sees a ground point; None if something hides the point or it is outside."""
    pixel: FloatArray = caster.view.project(ground[None])[0]
    if pixel.min() < 0 or (pixel > np.array(caster.view.size) - 1).any():
        return None
    height = caster.cast(pixel[:1], pixel[1:])[1][0, 0]
    return pixel if abs(height - ground[2]) < visible_m else None
