"""Ground in the shadow of what stands on it, where the images show next to nothing.

Matching has little to go by in a deep shadow, and continues the surface beside it: the roof that casts the shadow, or
its wall. The sun's direction tells which of the surfaces beside a shadow goes on in it: on its far side, away from the
sun, a shadow ends on the ground that it lies on. So this is one more kind of occlusion, of the ground from the sun.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional, Tuple

import numpy as np

from ..arrays import FloatImage, Floats, IntArray, Mask
from ..geometry.frames import projected_from_geodetic
from ..geometry.sun import mean_position, sun_position
from ..imagery.warping import gaussian_mean
from ..scene import Scene
from .aggregation import FusedCells
from .parameters import FUSION, ShadedGroundParameters


@dataclass(frozen=True)
class Sun:
    """Where shadows come from: the azimuth of the sun, degrees clockwise from the grid's north, and its elevation."""

    azimuth: float
    elevation: float

    @classmethod
    def over(cls, scene: Scene, crs: str, parameters: ShadedGroundParameters = FUSION.shaded) -> Optional[Sun]:
        """The mean sun of a scene's views over its middle, in a projected CRS; None where no time is known, or where
        the sun was so low that shadows have no end."""
        lon, lat = scene.frame.lon, scene.frame.lat
        positions = [sun_position(view.time, lon, lat) for view in scene.views if view.time is not None]
        if not positions:
            return None
        azimuth, elevation = mean_position(positions)
        if elevation < parameters.least_elevation_deg:
            return None
        (x, y), (x_north, y_north) = projected_from_geodetic(crs, np.array([[lon, lat], [lon, lat + 1e-3]]))
        return cls(azimuth + math.degrees(math.atan2(x_north - x, y_north - y)), elevation)


def weak_cells(fused: FusedCells, parameters: ShadedGroundParameters = FUSION.shaded) -> Mask:
    """Cells whose height a single map has, which the images hardly support, and cells without a height."""
    with np.errstate(invalid="ignore"):
        weak: Mask = (fused.count == 1) & ~fused.filled & ~(fused.score >= parameters.weak_score)
    weak |= np.isnan(fused.height)
    return weak


def shaded_ground(
    height: Floats, weak: Mask, cell: float, sun: Sun, parameters: ShadedGroundParameters = FUSION.shaded
) -> FloatImage:
    """(H, W) heights of the ground on which shadows lie, for cells that take them; NaN for all others.

    Cells in shadow take them that have no height, or a ``weak`` one on a slope above that ground: what matching makes
    of nothing leads down from the roof. ``height`` (H, W) is in m, NaN = none; ``cell`` in m. Rows run from north to
    south.

    The ground is that of the nearest cell out of the shadow away from the sun, with a height that is not weak, in
    several directions about the sun's: the second lowest of them, because a shadow may end on a roof and one may be
    wrong, where another one is at the same level. On slopes nothing is known, nor in narrow gaps, which may belong to
    the roof's edge.
    """
    steep = _steep(height, cell, parameters)
    doubted = np.isnan(height) | (weak & steep)
    known = np.where(doubted, np.float32(np.nan), height).astype(np.float32)
    reach, away = parameters.halo(cell), sun.azimuth + 180.0
    gap = sum(_next_known(known, towards)[1] for towards in (sun.azimuth, away)) * cell
    doubted &= gap >= parameters.gap_m
    result = np.full(height.shape, np.nan, np.float32)
    surface = height.astype(np.float32)
    for _ in range(parameters.rounds):  # what stands too high lies in no shadow until it is replaced
        shadow = cast_shadow(surface, cell, sun, parameters)
        lit = np.where(shadow, np.float32(np.nan), known)
        ends = np.stack([_level_end(lit, steep, away + turn, reach) for turn in parameters.directions_deg])
        lowest, ground, third = np.sort(ends, axis=0)[:3]
        with np.errstate(invalid="ignore"):
            level = (ground - lowest <= parameters.level_m) | (third - ground <= parameters.level_m)
            taken = shadow & doubted & level & ~(height <= ground + parameters.above_m)
        result = np.where(taken, ground, np.float32(np.nan))
        surface = np.where(np.isfinite(result), result, height).astype(np.float32)
    return result


def _level_end(lit: FloatImage, steep: Mask, towards: float, reach: int) -> FloatImage:
    """(H, W) height of the nearest lit cell in a direction; NaN on a slope, or beyond the reach (cells)."""
    height, distance = _next_known(lit, towards)
    slope, _ = _next_known(np.where(np.isfinite(lit), steep.astype(np.float32), np.float32(np.nan)), towards)
    return np.where((distance <= reach) & (slope == 0), height, np.float32(np.nan))


def _steep(height: Floats, cell: float, parameters: ShadedGroundParameters) -> Mask:
    """Cells on a slope: the mean of the rises between known neighbours around them."""
    means = []
    for axis in (0, 1):
        rise = np.diff(height.astype(np.float32), axis=axis, append=np.float32(np.nan)) / np.float32(cell)
        mean = gaussian_mean(np.isfinite(rise), parameters.slope_sigma_cells)
        means.append(mean(np.nan_to_num(rise)))
    steep: Mask = np.hypot(*means) > parameters.least_slope
    return steep


def cast_shadow(height: Floats, cell: float, sun: Sun, parameters: ShadedGroundParameters = FUSION.shaded) -> Mask:
    """(H, W) cells in the shadow of others; what has no height casts none, and may lie as low as what follows it."""
    rise = cell * math.tan(math.radians(sun.elevation))

    def in_shadow(columns: FloatImage, step: float) -> FloatImage:
        rays = np.arange(len(columns), dtype=np.float32)[:, None] * np.float32(rise * step)
        known = np.isfinite(columns)
        beyond = _last_known(columns[::-1], known[::-1])[0][::-1]
        low = np.where(np.isfinite(beyond), beyond, np.float32(-np.inf)) + rays
        highest = np.maximum.accumulate(np.where(known, columns + rays, np.float32(-np.inf)), axis=0)
        hidden: FloatImage = (highest > low + np.float32(parameters.clear_m)).astype(np.float32)
        return hidden

    shadow: Mask = _along(height.astype(np.float32), sun.azimuth + 180.0, in_shadow) > 0
    return shadow


def _next_known(values: FloatImage, towards: float) -> Tuple[FloatImage, FloatImage]:
    """(H, W) the nearest known value in a direction (degrees clockwise from north), and its distance in cells;
    infinite where there is none."""

    def value(columns: FloatImage, step: float) -> FloatImage:
        return _last_known(columns, np.isfinite(columns))[0]

    def distance(columns: FloatImage, step: float) -> FloatImage:
        found, rows = _last_known(columns, np.isfinite(columns))
        return np.where(np.isfinite(found), rows * np.float32(step), np.float32(np.inf)).astype(np.float32)

    from_there = towards + 180.0  # lines that come from there
    return _along(values, from_there, value), _along(values, from_there, distance)


def _last_known(columns: FloatImage, known: Mask) -> Tuple[FloatImage, IntArray]:
    """(H, W) the last known value at or above each place, NaN where there is none, and how many rows above it lies."""
    rows = np.arange(len(columns))[:, None]
    last = np.maximum.accumulate(np.where(known, rows, 0), axis=0)
    return np.take_along_axis(columns, last, axis=0), rows - last


def _along(values: FloatImage, towards: float, work: Callable[[FloatImage, float], FloatImage]) -> FloatImage:
    """Work on lines that run in a direction (degrees clockwise from north), as columns, from their first cell on.

    Rows are shifted by whole cells, so that the lines become columns; ``work`` also gets the distance between two cells
    of a line, in cells.
    """
    east, south = math.sin(math.radians(towards)), -math.cos(math.radians(towards))
    turned = abs(east) > abs(south)
    if turned:
        values, east, south = values.T, south, east
    if south < 0:
        values = values[::-1]
    slope = east / abs(south)
    rows, columns = values.shape
    shift = np.rint(np.arange(rows) * slope).astype(np.intp)
    shift -= shift.min()
    place = np.arange(columns)[None, :] + (shift.max() - shift)[:, None]
    lines = np.full((rows, columns + int(shift.max())), np.nan, np.float32)
    np.put_along_axis(lines, place, values, axis=1)
    result = np.take_along_axis(work(lines, math.hypot(1.0, slope)), place, axis=1)
    if south < 0:
        result = result[::-1]
    return np.ascontiguousarray(result.T if turned else result)
