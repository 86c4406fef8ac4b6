"""Known ground: a height field in sunlight, in a UTM zone, with heights above the WGS 84 ellipsoid.

A surface is a grid of nodes. Between four nodes it is bilinear, unless they differ by more than ``wall_m``: then the
height is that of the nearest node, which makes a vertical wall. So the height at a node is always exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Optional, Tuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..contracts.arrays import Bounds, FloatArray, FloatImage, IntArray
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.levels import doubled
from .parameters import SIMULATION, LightParameters

Area = Tuple[slice, slice]
Shape = Tuple[int, ...]
Codes = NDArray[np.uint8]


class Cover(IntEnum):
    """What covers a node of the ground: plants and soil, streets, roofs, and crowns that keep or shed their leaves."""

    GRASS = 0
    SOIL = 1
    WINTER_CROPS = 2
    SUMMER_CROPS = 3
    STREET = 4
    ROOF = 5
    EVERGREEN = 6
    SHEDDING = 7


@dataclass(frozen=True)
class Sun:
    """Where the sun stands: azimuth clockwise from north, elevation above the horizon, degrees."""

    azimuth_deg: float = 152.0
    elevation_deg: float = 48.0

    def direction(self) -> Tuple[float, float, float]:
        """Unit vector to the sun: east, north, up."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return (math.sin(azimuth) * math.cos(elevation), math.cos(azimuth) * math.cos(elevation), math.sin(elevation))


@dataclass(frozen=True)
class SimulatedSurface:
    """A height field and the light that leaves it. Rasters are (R, C) float32, one value a node."""

    crs: str  # the UTM zone, as PROJ names it
    west: float  # position of node (0, 0); columns go east, rows south
    north: float
    cell: float  # spacing of nodes, m
    wall_m: float  # see the module; inf for a surface without walls
    height: FloatImage  # m above the ellipsoid
    radiance: FloatImage  # digital numbers that the top of the surface sends to a camera
    shade: FloatImage  # m: a point over the node is in shadow below this height
    facade: FloatImage  # digital numbers that sunlit walls near the node send, without shadow and windows
    light: LightParameters = SIMULATION.light

    def grid(self, lon_lat: FloatArray) -> Tuple[FloatArray, FloatArray]:
        """Fractional columns and rows (N,) of longitudes and latitudes (N, 2 or more)."""
        east, north = projected_from_geodetic(self.crs, lon_lat).T
        return (east - self.west) / self.cell, (self.north - north) / self.cell

    def ground(self, col: FloatArray, row: FloatArray) -> FloatArray:
        """(N, 3) longitude, latitude, height of the surface at fractional columns and rows (N,)."""
        place = np.stack([self.west + col * self.cell, self.north - row * self.cell], axis=1)
        return np.column_stack([geodetic_from_projected(self.crs, place), self.heights(col, row)])

    def heights(self, col: FloatArray, row: FloatArray) -> FloatArray:
        """Heights at fractional columns and rows; outside, the height of the edge."""
        return interpolate(self.height, col, row, self.wall_m)

    def height_range(self) -> Tuple[float, float]:
        """Lowest and highest node, m."""
        return float(self.height.min()), float(self.height.max())


def _corners(shape: Shape, col: FloatArray, row: FloatArray) -> Tuple[IntArray, FloatArray, FloatArray]:
    """Flat index of the upper left node, and the fractions right and down, of positions clamped to the grid."""
    col = np.clip(col, 0, shape[1] - 1.001)
    row = np.clip(row, 0, shape[0] - 1.001)
    left, top = col.astype(np.int64), row.astype(np.int64)
    return top * shape[1] + left, col - left, row - top


def interpolate(values: FloatImage, col: FloatArray, row: FloatArray, wall: float = math.inf) -> FloatArray:
    """Bilinear values at fractional columns and rows; the nearest node's where four nodes differ by more than wall."""
    index, right, down = _corners(values.shape, col, row)
    flat, width = values.reshape(-1), values.shape[1]
    a, b, c, d = flat[index], flat[index + 1], flat[index + width], flat[index + width + 1]
    upper, lower = a + (b - a) * right, c + (d - c) * right
    smooth: FloatArray = upper + (lower - upper) * down
    if not math.isfinite(wall):
        return smooth
    spread = np.maximum(np.maximum(a, b), np.maximum(c, d)) - np.minimum(np.minimum(a, b), np.minimum(c, d))
    nearest = np.where(down < 0.5, np.where(right < 0.5, a, b), np.where(right < 0.5, c, d))
    return np.where(spread > wall, nearest, smooth)


def fractal(
    rng: np.random.Generator, shape: Shape, cell: float, longest: float, shortest: float = 0.0, roughness: float = 1.0
) -> FloatImage:
    """Band-limited fractal noise (rows, columns) of zero mean and unit standard deviation.

    ``longest`` and ``shortest`` are wavelengths, m; finer detail is left out. Amplitudes fall as wavelength **
    roughness: 1 is like mountains, 0 gives every octave equal weight.
    """
    octaves = max(int(math.log2(max(longest / cell, 2.0))) - 1, 0)
    shapes = [shape]
    for _ in range(octaves):
        shapes.append(tuple(n // 2 + 3 for n in shapes[-1]))
    values = rng.standard_normal(shapes[-1], dtype=np.float32)
    for octave in range(octaves - 1, -1, -1):
        values = doubled(values, shapes[octave])
        wavelength = 4.0 * cell * 2**octave
        if wavelength >= shortest:
            amplitude = np.float32((wavelength / longest) ** roughness)
            values += amplitude * rng.standard_normal(shapes[octave], dtype=np.float32)
    values -= values.mean(dtype=np.float64)
    return values / np.float32(max(values.std(dtype=np.float64), 1e-12))


def _shifted(values: FloatImage, right: float, down: float) -> FloatImage:
    """Values at positions ``right`` columns and ``down`` rows away, bilinear; beyond the edge, those of the edge."""
    for axis, by in ((0, down), (1, right)):
        whole = math.floor(by)
        part = np.float32(by - whole)
        last = values.shape[axis] - 1
        here = np.clip(np.arange(last + 1) + whole, 0, last)
        first, second = np.take(values, here, axis), np.take(values, np.minimum(here + 1, last), axis)
        second -= first
        second *= part
        values = first + second
    return values


def shadow_height(height: FloatImage, cell: float, sun: Sun) -> FloatImage:
    """(R, C) m: the height up to which points over each node lie in shadow.

    It is the highest of H(x + s d) - s tan(elevation) over all distances s > 0 towards the sun, found by doubling: the
    answer for distances up to 2 s is the higher of the answer up to s and of the same moved by s.
    """
    east, north, up = sun.direction()
    flat = math.hypot(east, north)
    right, down, drop = east / flat, -north / flat, up / flat * cell
    reach = float(height.max() - height.min()) / drop + 1
    far = 0.5  # half a cell at first: whole cells would shorten shadows by one
    shade = _shifted(height, far * right, far * down) - np.float32(far * drop)
    while far < reach:
        np.maximum(shade, _shifted(shade, far * right, far * down) - np.float32(far * drop), out=shade)
        far *= 2
    return shade


def slopes(height: FloatImage, cell: float, edges: bool) -> Tuple[FloatImage, FloatImage]:
    """Slopes eastwards and southwards; with ``edges`` the flatter of both one-sided ones, so walls do not count."""
    result = []
    for axis in (1, 0):
        step = np.diff(height, axis=axis) / np.float32(cell)
        pads = ([side if k == axis else (0, 0) for k in (0, 1)] for side in ((1, 0), (0, 1)))
        before, after = (np.pad(step, pad, mode="edge") for pad in pads)
        result.append(np.where(np.abs(before) < np.abs(after), before, after) if edges else 0.5 * (before + after))
    return result[0], result[1]


def irradiance(
    height: FloatImage, cell: float, sun: Sun, wall_m: float, light: LightParameters
) -> Tuple[FloatImage, FloatImage, FloatImage]:
    """Light that reaches the nodes, as shares of the sun's on a surface that faces it: (R, C) float32 each.

    Returns the sun's, the sky's, and the shade of a :class:`SimulatedSurface`.
    """
    east, north, up = map(np.float32, sun.direction())
    walls = math.isfinite(wall_m)
    right, down = slopes(height, cell, walls)
    facing = up - east * right + north * down
    facing /= np.sqrt(1 + right * right + down * down)
    del right, down
    np.maximum(facing, 0, out=facing)
    shade = shadow_height(height, cell, sun)
    if light.sun_disc_deg is not None:
        lit = _lit_by_disc(height, cell, sun, light.sun_disc_deg)
    else:
        lit = np.clip((height - shade) / np.float32(light.penumbra_m if walls else cell), 0, 1)
    # The sky seen from a node: less of it where the surroundings stand higher.
    surroundings = ndimage.uniform_filter(height, max(int(light.sky_window_m / cell) | 1, 3), mode="nearest")
    sky = np.clip(1.0 - light.sky_loss_per_m * np.maximum(surroundings - height, 0), light.least_sky, 1)
    return lit * facing, np.float32(light.sky_share) * sky.astype(np.float32), shade


def _lit_by_disc(height: FloatImage, cell: float, sun: Sun, diameter_deg: float) -> FloatImage:
    """The share (R, C) of the sun's disc that each node sees, from nine suns on it; one for a point."""
    lit = np.zeros_like(height)
    ring = np.arange(8 if diameter_deg else 0) * math.pi / 4
    # Eight ninths of a disc's area lie beyond a third of its radius, and half of them within 0.745 of it.
    places = [(0.0, 0.0)] + [(0.3725 * math.cos(a), 0.3725 * math.sin(a)) for a in ring]
    for right, up in places:
        turn = right * diameter_deg / math.cos(math.radians(sun.elevation_deg))
        part = Sun(sun.azimuth_deg + turn, sun.elevation_deg + up * diameter_deg)
        # The shade of level ground is so far below it, because it is looked for half a cell away.
        free = 0.5 * cell * math.tan(math.radians(part.elevation_deg))
        lit += np.clip((height - shadow_height(height, cell, part)) / np.float32(free), 0, 1)
    return lit / np.float32(len(places))


def wall_light(height: FloatImage, cell: float, sun: Sun) -> FloatImage:
    """How much of the sun the walls near the nodes face, 0..1 (R, C)."""
    east, north, _ = map(np.float32, sun.direction())
    soft = ndimage.gaussian_filter(height, max(1.5 / cell, 1.0), mode="nearest")
    right, down = slopes(soft, cell, False)
    facing: FloatImage = np.maximum(-(east * right - north * down), 0)
    facing /= np.sqrt(right * right + down * down + np.float32(1e-6))
    return facing


def illuminate(
    ground: Ground, sun: Sun, wall_m: float, light: LightParameters
) -> Tuple[FloatImage, FloatImage, FloatImage]:
    """Radiance, shade and facade of a :class:`SimulatedSurface` with given albedos (0..1), all (R, C) float32."""
    direct, sky, shade = irradiance(ground.height, ground.cell, sun, wall_m, light)
    sun_dn, haze_dn = np.float32(light.sun_dn), np.float32(light.haze_dn)
    radiance = ground.albedo * (direct + sky) * sun_dn + haze_dn
    if not math.isfinite(wall_m):
        return radiance, shade, np.zeros((1, 1), np.float32)
    facing = wall_light(ground.height, ground.cell, sun)
    return radiance, shade, (ground.wall_albedo * facing * sun_dn).astype(np.float32)


def facade_radiance(
    sunlit: FloatArray, lit: FloatArray, height: FloatArray, along: FloatArray, light: LightParameters
) -> FloatArray:
    """Digital numbers of walls with rows of windows, in sunlight where it comes and in light of the sky.

    ``sunlit`` is :attr:`SimulatedSurface.facade`, ``lit`` 0..1; ``height`` and ``along`` are the place on the wall, m.
    """
    storey, sill = light.storey_m
    period, gap = light.window_m
    windows = (np.mod(height, storey) > sill) & (np.mod(along, period) > gap)
    paint = np.where(windows, light.window_tone, 1.0)
    skylight = light.wall_albedo * 0.5 * light.sky_share * light.sun_dn
    radiance: FloatArray = light.haze_dn + paint * (sunlit * lit + skylight)
    return radiance


@dataclass
class Ground:
    """A surface under construction: grids of one shape, and where they are."""

    west: float
    north: float
    cell: float
    height: FloatImage
    albedo: FloatImage
    wall_albedo: FloatImage
    cover: Codes  # values of Cover, which a town fills in

    @classmethod
    def empty(cls, bounds: Bounds, cell: float) -> Ground:
        """Flat and black over the bounds; nodes are at multiples of the cell."""
        west, north = math.floor(bounds[0] / cell) * cell, math.ceil(bounds[3] / cell) * cell
        shape = (int(math.ceil((north - bounds[1]) / cell)) + 1, int(math.ceil((bounds[2] - west) / cell)) + 1)
        height, albedo, walls = (np.zeros(shape, np.float32) for _ in range(3))
        cover = np.zeros(shape, np.uint8)
        return cls(west, north, cell, height=height, albedo=albedo, wall_albedo=walls, cover=cover)

    def patch(self, east: float, north: float, radius: float) -> Optional[Tuple[Area, FloatArray, FloatArray]]:
        """Slices of the nodes in a square around a position, and their metres east and north of it; None outside."""
        col, row, reach = (east - self.west) / self.cell, (self.north - north) / self.cell, radius / self.cell + 1
        left, right = max(int(col - reach), 0), min(int(col + reach) + 2, self.height.shape[1])
        top, bottom = max(int(row - reach), 0), min(int(row + reach) + 2, self.height.shape[0])
        if left >= right or top >= bottom:
            return None
        x = (np.arange(left, right) - col) * self.cell
        y = (row - np.arange(top, bottom)) * self.cell
        return (slice(top, bottom), slice(left, right)), x[None, :], y[:, None]

    def finish(self, crs: str, sun: Sun, wall_m: float, light: LightParameters = SIMULATION.light) -> SimulatedSurface:
        """The surface in sunlight."""
        radiance, shade, facade = illuminate(self, sun, wall_m, light)
        return SimulatedSurface(
            crs=crs,
            west=self.west,
            north=self.north,
            cell=self.cell,
            wall_m=wall_m,
            height=self.height,
            radiance=radiance,
            shade=shade,
            facade=facade,
            light=light,
        )
