"""Ground in the shadow of objects, where the images have almost no texture. In a deep shadow, matching continues the
surface beside it: the roof that casts the shadow, or its wall. The sun's direction shows which of the surfaces beside a
shadow continues in it: on the far side, away from the sun, a shadow ends on the ground on which it lies. So this is
another kind of occlusion: of the ground from the sun.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional, Tuple

import numpy as np

from ..contracts.arrays import ByteImage, FloatImage, Floats, IntArray, Mask
from ..geometry.frames import projected_from_geodetic
from ..geometry.sun import mean_position
from ..imagery.sampling import median_of_known
from ..imagery.warping import gaussian_mean
from ..planning.pair_selection import sun_over
from ..scene import Scene
from .aggregation import Candidate
from .parameters import FUSION, ShadedGroundParameters
from .surroundings import farthest, places

SUPPORTED, WEAK, NOTHING = range(3)
"""The image support of a height, see :func:`support`."""


@dataclass(frozen=True)
class Sun:
    """Where shadows come from: the azimuth of the sun, degrees clockwise from the grid's north, and its elevation."""

    azimuth: float
    elevation: float

    @classmethod
    def over(cls, scene: Scene, crs: str, parameters: ShadedGroundParameters = FUSION.shaded) -> Optional[Sun]:
        """The mean sun of a scene's views over its middle, in a projected CRS; None where no time is known, or where
        the sun was so low that shadows have no end."""
        positions = [sun for sun in (sun_over(scene, view) for view in scene.views) if sun is not None]
        if not positions:
            return None
        azimuth, elevation = mean_position(positions)
        if elevation < parameters.least_elevation_deg:
            return None
        lon, lat = scene.frame.lon, scene.frame.lat
        (x, y), (x_north, y_north) = projected_from_geodetic(crs, np.array([[lon, lat], [lon, lat + 1e-3]]))
        return cls(azimuth + math.degrees(math.atan2(x_north - x, y_north - y)), elevation)


def support(first: Candidate, parameters: ShadedGroundParameters = FUSION.shaded) -> ByteImage:
    """The image support of each height: :data:`SUPPORTED` by the images, :data:`WEAK` (a single map's, which the
    images hardly support), or :data:`NOTHING` (no height, or one that matching took from the background)."""
    result = np.full(first.height.shape, SUPPORTED, np.uint8)
    with np.errstate(invalid="ignore"):
        result[(first.count == 1) & ~(first.score >= parameters.weak_score)] = WEAK
    result[first.filled | np.isnan(first.height)] = NOTHING
    return result


def shaded_ground(
    height: Floats,
    supports: ByteImage,
    cell: float,
    sun: Sun,
    parameters: ShadedGroundParameters = FUSION.shaded,
    first: Tuple[int, int] = (0, 0),
) -> FloatImage:
    """(H, W) heights of the ground on which shadows lie, for cells that take them; NaN for all others.

    Shadowed cells whose measured height is missing or weak take the height of the ground. ``height`` (H, W) is in m,
    NaN = none, ``supports`` (H, W) as of :func:`support`; ``cell`` in m. Rows run from north to south. ``first`` are
    row and column of the first cell on the ground: rays are the same for every part of a DSM.

    The ground is that of the next reliable cell away from the sun: a lit cell, or a shadowed one whose height the
    images support. Several directions about the sun's are searched, and the second lowest ground is used, because some
    directions end on roofs. No ground is found on slopes and beyond the DSM's border. Finally each cell takes the
    median of the grounds found around it.
    """
    doubted = supports != SUPPORTED
    trusted = np.where(doubted, np.float32(np.nan), height.astype(np.float32))
    steep = _steep(trusted, cell, parameters)
    shadow = cast_shadow(trusted, cell, sun, parameters, first)  # wrong heights may cast a shadow, or rise out of one
    cells = _enclosed(np.flatnonzero(shadow & doubted), np.isfinite(height), cell, sun, parameters)
    sure = ~doubted & ~(shadow & steep)
    ground = np.full(height.shape, np.nan, np.float32)
    ground.ravel()[cells] = _shadow_ends(height, cells, sure, steep=steep, cell=cell, sun=sun, parameters=parameters)
    smooth = np.full(height.shape, np.nan, np.float32)
    smooth.ravel()[cells] = _like_around(ground, cells, cell, parameters)
    return smooth


def _enclosed(cells: IntArray, known: Mask, cell: float, sun: Sun, parameters: ShadedGroundParameters) -> IntArray:
    """Those of (N,) cells that have heights on both sides across the sun's direction: beyond the DSM's border no shadow
    can be recognised."""
    for side in (90.0, -90.0):
        cells = cells[_next(known, cells, sun.azimuth + 180.0 + side, _reach(cell, parameters))[0] >= 0]
    return cells


def _shadow_ends(
    height: Floats,
    cells: IntArray,
    sure: Mask,
    *,
    steep: Mask,
    cell: float,
    sun: Sun,
    parameters: ShadedGroundParameters,
) -> FloatImage:
    """(N,) the level ground at which the shadow of each of N cells ends; NaN where fewer than two directions end so."""
    turns, reach = parameters.turns_deg, _reach(cell, parameters)
    ends = np.full((len(turns), len(cells)), np.nan, np.float32)
    for end, turn in zip(ends, turns):
        place, _ = _next(sure, cells, sun.azimuth + 180.0 + turn, reach)
        level = (place >= 0) & ~steep.ravel()[place]
        end[level] = height.ravel()[place[level]]
    second: FloatImage = np.sort(ends, axis=0)[1]  # NaN last
    return second


def _like_around(ground: FloatImage, cells: IntArray, cell: float, parameters: ShadedGroundParameters) -> FloatImage:
    """(N,) the ground of N cells: the median of the grounds found around them, so that rays leave no streaks."""
    around = places(parameters.around_m, cell)
    reach, least = farthest(around), math.ceil(parameters.least_share * len(around))
    padded = np.pad(ground, reach, constant_values=np.nan)
    row, column = np.divmod(cells, ground.shape[1])
    found = np.stack([padded[row + reach + down, column + reach + right] for down, right in around])
    middle = median_of_known(found, least)
    return np.where(np.isnan(middle), ground.ravel()[cells], middle)


def halo(cell: float, parameters: ShadedGroundParameters = FUSION.shaded) -> int:
    """Cells of the side ``cell`` (m) around a block on which its own cells depend, on either side."""
    # The end of a shadow is one reach away, and the object that shades this place is another reach away.
    return 2 * _reach(cell, parameters) + farthest(places(parameters.around_m, cell))


def _reach(cell: float, parameters: ShadedGroundParameters) -> int:
    """How many cells away the end of a shadow is searched."""
    return max(1, min(int(parameters.reach_m / cell), parameters.reach_cells))


def _next(known: Mask, cells: IntArray, towards: float, reach: int) -> Tuple[IntArray, Floats]:
    """(N,) the nearest known cell from each of N in a direction (degrees clockwise from north), -1 where there is none
    within so many cells, and its distance in cells, infinite then."""
    south, east = -math.cos(math.radians(towards)), math.sin(math.radians(towards))
    step = 1.0 / max(abs(south), abs(east))
    row, column = np.divmod(cells, known.shape[1])
    found, distance = np.full(len(cells), -1, np.int64), np.full(len(cells), np.inf)
    todo = np.arange(len(cells))
    for count in range(1, int(reach / step) + 1):
        r, c = row[todo] + round(count * step * south), column[todo] + round(count * step * east)
        inside = (r >= 0) & (r < known.shape[0]) & (c >= 0) & (c < known.shape[1])
        todo, place = todo[inside], (r * known.shape[1] + c)[inside]
        hit = known.ravel()[place]
        found[todo[hit]], distance[todo[hit]] = place[hit], count * step
        todo = todo[~hit]
        if not todo.size:
            break
    return found, distance


def _steep(height: Floats, cell: float, parameters: ShadedGroundParameters) -> Mask:
    """Cells on a slope: the mean of the rises between known neighbours around them."""
    means = []
    for axis in (0, 1):
        rise = np.diff(height.astype(np.float32), axis=axis, append=np.float32(np.nan)) / np.float32(cell)
        mean = gaussian_mean(np.isfinite(rise), parameters.slope_sigma_cells)
        means.append(mean(np.nan_to_num(rise)))
    steep: Mask = np.hypot(*means) > parameters.least_slope
    return steep


def cast_shadow(
    height: Floats,
    cell: float,
    sun: Sun,
    parameters: ShadedGroundParameters = FUSION.shaded,
    first: Tuple[int, int] = (0, 0),
) -> Mask:
    """(H, W) cells in the shadow of others; a cell without a height casts no shadow, and counts as low as the next cell
    with one. ``first`` is as of :func:`shaded_ground`."""
    rise = cell * math.tan(math.radians(sun.elevation))

    def in_shadow(columns: FloatImage, step: float) -> FloatImage:
        rays = np.arange(len(columns))[:, None] * (rise * step)
        known = np.isfinite(columns)
        low = _following(columns, known) + rays
        highest = np.maximum.accumulate(np.where(known, columns + rays, -np.inf), axis=0)
        hidden: FloatImage = (highest > low + parameters.clear_m).astype(np.float32)
        return hidden

    shadow: Mask = _along(height.astype(np.float32), sun.azimuth + 180.0, in_shadow, first) > 0
    return shadow


def _following(columns: FloatImage, known: Mask) -> FloatImage:
    """(H, W) the first known value at or below each place; -inf where there is none."""
    last = len(columns) - 1
    rows = np.where(known, np.arange(len(columns), dtype=np.int32)[:, None], np.int32(last))
    nearest = np.minimum.accumulate(rows[::-1], axis=0)[::-1]
    found = np.take_along_axis(columns, nearest, axis=0)
    return np.where(np.isfinite(found), found, np.float32(-np.inf))


def _along(
    values: FloatImage, towards: float, work: Callable[[FloatImage, float], FloatImage], first: Tuple[int, int]
) -> FloatImage:
    """Work on lines that run in a direction (degrees clockwise from north), as columns, from their first cell on.

    Rows are shifted by whole cells, so that the lines become columns; ``work`` also gets the distance between two cells
    of a line, in cells.
    """
    east, south = math.sin(math.radians(towards)), -math.cos(math.radians(towards))
    turned = abs(east) > abs(south)
    begin = first[0]
    if turned:
        values, east, south, begin = values.T, south, east, first[1]
    rows, columns = values.shape
    if south < 0:
        values, begin = values[::-1], -(begin + rows - 1)
    slope = east / abs(south)
    shift = np.rint((begin + np.arange(rows)) * slope).astype(np.intp)
    shift -= shift.min()
    place = np.arange(columns)[None, :] + (shift.max() - shift)[:, None]
    lines = np.full((rows, columns + int(shift.max())), np.nan, np.float32)
    np.put_along_axis(lines, place, values, axis=1)
    result = np.take_along_axis(work(lines, math.hypot(1.0, slope)), place, axis=1)
    if south < 0:
        result = result[::-1]
    return np.ascontiguousarray(result.T if turned else result)
