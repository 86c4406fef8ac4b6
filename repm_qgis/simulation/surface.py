"""Known ground: a height field with sunlight on it, in a UTM zone, with heights above the WGS 84 ellipsoid.

A surface is a grid of nodes. Between four nodes it is bilinear, unless they differ by more than ``wall_m``: there the
nearest node holds, which makes a vertical wall. So the height at a node is exact, whatever the interpolation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..arrays import FloatArray
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..progress import Progress, Silent

Float32Array = NDArray[np.float32]
Bounds = Tuple[float, float, float, float]

SILENT = Silent()

_HAZE_DN = 120.0  # light that the air scatters into the camera
_SUN_DN = 5200.0  # what a white, flat surface facing the sun reflects
_SKY_SHARE = 0.22  # light of the open sky, as a share of the sun's


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
    """A height field and the light that leaves it.

    Attributes
    ----------
    crs : the UTM zone, as PROJ names it. ``west, north``: position of node (0, 0); nodes go east by columns and
        south by rows.
    cell : spacing of nodes, m. ``wall_m``: see the module; inf for a surface without walls.
    height : (R, C) float32 metres above the ellipsoid, at the nodes.
    radiance : (R, C) float32 digital numbers that the top of the surface sends to a camera.
    shade : (R, C) float32 metres: below this height a point over the node is in the shadow of something.
    facade : (R, C) float32 digital numbers that sunlit walls near the node send, without shadow and windows.
    """

    crs: str
    west: float
    north: float
    cell: float
    wall_m: float
    height: Float32Array
    radiance: Float32Array
    shade: Float32Array
    facade: Float32Array

    def grid(self, lon_lat: FloatArray) -> Tuple[FloatArray, FloatArray]:
        """Fractional columns and rows (N,) of longitudes and latitudes (N, 2 or more)."""
        east, north = projected_from_geodetic(self.crs, lon_lat).T
        return (east - self.west) / self.cell, (self.north - north) / self.cell

    def ground(self, col: FloatArray, row: FloatArray) -> FloatArray:
        """(N, 3) longitude, latitude, height of the surface at fractional columns and rows (N,)."""
        place = np.stack([self.west + col * self.cell, self.north - row * self.cell], axis=1)
        return np.column_stack([geodetic_from_projected(self.crs, place), self.heights(col, row)])

    def heights(self, col: FloatArray, row: FloatArray) -> FloatArray:
        """Heights at fractional columns and rows; the edge's height outside."""
        return interpolate(self.height, col, row, self.wall_m)

    def height_range(self) -> Tuple[float, float]:
        """Lowest and highest node, m."""
        return float(self.height.min()), float(self.height.max())


def _corners(shape: Tuple[int, int], col: FloatArray, row: FloatArray):
    """Flat index of the upper left node, and the fractions right and down, of positions clamped to the grid."""
    col = np.clip(col, 0, shape[1] - 1.001)
    row = np.clip(row, 0, shape[0] - 1.001)
    left, top = col.astype(np.int64), row.astype(np.int64)
    return top * shape[1] + left, col - left, row - top


def interpolate(values: Float32Array, col: FloatArray, row: FloatArray, wall: float = math.inf) -> FloatArray:
    """Bilinear values at fractional columns and rows, but the nearest node's where four nodes differ by > wall."""
    index, right, down = _corners(values.shape, col, row)
    flat, width = values.reshape(-1), values.shape[1]
    a, b, c, d = flat[index], flat[index + 1], flat[index + width], flat[index + width + 1]
    upper, lower = a + (b - a) * right, c + (d - c) * right
    smooth = upper + (lower - upper) * down
    if not math.isfinite(wall):
        return smooth
    spread = np.maximum(np.maximum(a, b), np.maximum(c, d)) - np.minimum(np.minimum(a, b), np.minimum(c, d))
    nearest = np.where(down < 0.5, np.where(right < 0.5, a, b), np.where(right < 0.5, c, d))
    return np.where(spread > wall, nearest, smooth)


# Noise -----------------------------------------------------------------------------------------------------------


def _doubled(values: Float32Array, shape: Tuple[int, int]) -> Float32Array:
    """Twice as many rows and columns by quadratic B-spline subdivision along both axes, cut to ``shape``."""
    for axis in (0, 1):
        values = np.moveaxis(values, axis, 0)
        inner, near, far = values[1:-1], values[:-2], values[2:]
        fine = np.empty((2 * inner.shape[0],) + values.shape[1:], np.float32)
        fine[0::2] = 0.75 * inner + 0.25 * near
        fine[1::2] = 0.75 * inner + 0.25 * far
        values = np.moveaxis(fine[: shape[axis]], 0, axis)
    return values


def fractal(
    rng: np.random.Generator,
    shape: Tuple[int, int],
    cell: float,
    longest: float,
    shortest: float = 0.0,
    roughness: float = 1.0,
) -> Float32Array:
    """Band-limited fractal noise of zero mean and unit standard deviation.

    Parameters
    ----------
    shape : rows, columns. cell : m. longest, shortest : wavelengths, m; detail below the shortest is left out.
    roughness : amplitudes fall as wavelength ** roughness; 1 is like mountains, 0 gives every octave equal weight.
    """
    octaves = max(int(math.log2(max(longest / cell, 2.0))) - 1, 0)
    shapes = [shape]
    for _ in range(octaves):
        shapes.append((shapes[-1][0] // 2 + 3, shapes[-1][1] // 2 + 3))
    values = rng.standard_normal(shapes[-1], dtype=np.float32)
    for octave in range(octaves - 1, -1, -1):
        values = _doubled(values, shapes[octave])
        wavelength = 4.0 * cell * 2**octave
        if wavelength >= shortest:
            values += np.float32((wavelength / longest) ** roughness) * rng.standard_normal(
                shapes[octave], dtype=np.float32
            )
    values -= values.mean(dtype=np.float64)
    return values / np.float32(max(values.std(dtype=np.float64), 1e-12))


# Light -----------------------------------------------------------------------------------------------------------


def _shifted(values: Float32Array, right: float, down: float) -> Float32Array:
    """Values at positions ``right`` columns and ``down`` rows away, bilinear; the edge's beyond the edge."""
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


def shadow_height(height: Float32Array, cell: float, sun: Sun) -> Float32Array:
    """(R, C) m: the height up to which points over each node lie in shadow.

    The highest of H(x + s d) - s tan(elevation) over all distances s > 0 towards the sun, by doubling: with the
    answer for distances up to s in hand, the one up to 2 s is the higher of it and of itself moved by s.
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


def slopes(height: Float32Array, cell: float, edges: bool) -> Tuple[Float32Array, Float32Array]:
    """Slopes eastwards and southwards; where ``edges``, the flatter of both one-sided ones, so walls do not count."""
    result = []
    for axis in (1, 0):
        step = np.diff(height, axis=axis) / np.float32(cell)
        pad = [(0, 0), (0, 0)]
        pad[axis] = (1, 0)
        before = np.pad(step, pad, mode="edge")
        pad[axis] = (0, 1)
        after = np.pad(step, pad, mode="edge")
        result.append(np.where(np.abs(before) < np.abs(after), before, after) if edges else 0.5 * (before + after))
    return result[0], result[1]


def illuminate(
    height: Float32Array,
    albedo: Float32Array,
    cell: float,
    sun: Sun,
    wall_m: float,
    wall_albedo: Optional[Float32Array] = None,
) -> Tuple[Float32Array, Float32Array, Float32Array]:
    """Radiance, shade and facade of a :class:`SimulatedSurface` with a given albedo (0..1), all (R, C) float32."""
    east, north, up = map(np.float32, sun.direction())
    walls = math.isfinite(wall_m)
    right, down = slopes(height, cell, walls)
    facing = up - east * right + north * down
    facing /= np.sqrt(1 + right * right + down * down)
    del right, down
    np.maximum(facing, 0, out=facing)
    shade = shadow_height(height, cell, sun)
    # Over 0.3 m the shadow turns to light: the sun is a disc, and a crisp edge would alias.
    lit = np.clip((height - shade) / np.float32(0.3 if walls else cell), 0, 1)
    # The sky seen from a node: less where the surroundings stand higher.
    around = ndimage.uniform_filter(height, max(int(12.0 / cell) | 1, 3), mode="nearest")
    sky = np.clip(1.0 - 0.035 * np.maximum(around - height, 0), 0.35, 1).astype(np.float32)
    radiance = albedo * (lit * facing + np.float32(_SKY_SHARE) * sky) * np.float32(_SUN_DN) + np.float32(_HAZE_DN)
    if not walls:
        return radiance, shade, np.zeros((1, 1), np.float32)
    soft = ndimage.gaussian_filter(height, max(1.5 / cell, 1.0), mode="nearest")
    right, down = slopes(soft, cell, False)
    facing = np.maximum(-(east * right - north * down), 0) / np.sqrt(right * right + down * down + np.float32(1e-6))
    tone = wall_albedo if wall_albedo is not None else np.float32(0.3)
    return radiance, shade, (tone * facing * np.float32(_SUN_DN)).astype(np.float32)


def facade_radiance(sunlit: FloatArray, lit: FloatArray, height: FloatArray, along: FloatArray) -> FloatArray:
    """Digital numbers of walls: windows in floors of 3 m, sun where it comes, and light of the sky.

    ``sunlit``: :attr:`SimulatedSurface.facade` there. ``lit`` 0..1. ``height``, ``along``: place on the wall, m.
    """
    windows = (np.mod(height, 3.0) > 1.2) & (np.mod(along, 2.6) > 1.3)
    paint = np.where(windows, 0.55, 1.0)
    return _HAZE_DN + paint * (sunlit * lit + 0.3 * 0.5 * _SKY_SHARE * _SUN_DN)


# Builders --------------------------------------------------------------------------------------------------------


@dataclass
class Ground:
    """A surface under construction: grids of one shape, and where they lie."""

    west: float
    north: float
    cell: float
    height: Float32Array
    albedo: Float32Array
    wall_albedo: Float32Array

    @classmethod
    def empty(cls, bounds: Bounds, cell: float) -> Ground:
        """Flat and black, over xmin, ymin, xmax, ymax; nodes lie at multiples of the cell."""
        west, north = math.floor(bounds[0] / cell) * cell, math.ceil(bounds[3] / cell) * cell
        shape = (int(math.ceil((north - bounds[1]) / cell)) + 1, int(math.ceil((bounds[2] - west) / cell)) + 1)
        return cls(west, north, cell, *(np.zeros(shape, np.float32) for _ in range(3)))

    def patch(self, east: float, north: float, radius: float):
        """Slices of the nodes within a square around a position, and their metres east and north of it; or None."""
        col, row, reach = (east - self.west) / self.cell, (self.north - north) / self.cell, radius / self.cell + 1
        left, right = max(int(col - reach), 0), min(int(col + reach) + 2, self.height.shape[1])
        top, bottom = max(int(row - reach), 0), min(int(row + reach) + 2, self.height.shape[0])
        if left >= right or top >= bottom:
            return None
        x = (np.arange(left, right) - col) * self.cell
        y = (row - np.arange(top, bottom)) * self.cell
        return (slice(top, bottom), slice(left, right)), x[None, :], y[:, None]

    def finish(self, crs: str, sun: Sun, wall_m: float) -> SimulatedSurface:
        """Let the sun shine on it."""
        light = illuminate(self.height, self.albedo, self.cell, sun, wall_m, self.wall_albedo)
        return SimulatedSurface(crs, self.west, self.north, self.cell, wall_m, self.height, *light)


def build_mountains(
    bounds: Bounds, cell: float, crs: str, base: float, relief: float, sun: Sun, seed: int, progress: Progress = SILENT
) -> SimulatedSurface:
    """Mountains from ``base`` to ``base + relief`` metres: ridges and valleys, rock, meadows, woods and snow.

    Deterministic for the same arguments. Meadows and snow have little texture.
    """
    rng = np.random.default_rng([seed, 1])
    ground = Ground.empty(bounds, cell)
    shape = ground.height.shape
    extent = cell * max(shape)
    progress.step(0.1, "mountains")
    # Large scenes have tens of millions of nodes: what has served its turn goes at once.
    share = np.abs(fractal(rng, shape, cell, extent / 2.0, extent / 40))
    share *= np.float32(-0.64)
    share += fractal(rng, shape, cell, extent / 1.5, 0.0, 1.25)
    share -= share.min()
    share /= share.max()
    progress.check_cancelled()
    height = ground.height
    np.multiply(share, np.float32(relief), out=height)
    height += np.float32(base)
    rock = np.hypot(*slopes(height, cell, False))
    rock /= np.median(rock)
    progress.step(0.4, "rock, woods and snow")
    progress.check_cancelled()
    fine = fractal(rng, shape, cell, 12 * cell, 0.0, 0.3)
    broad = fractal(rng, shape, cell, extent / 6, 8 * cell, 0.5)
    # Half the ground is rock, whatever the relief: it starts where the slope passes its median.
    rock = np.clip((rock + 0.3 * broad - 1.0) / 0.35, 0, 1)
    wood = np.clip((broad - 0.35) / 0.2, 0, 1) * (1 - rock) * np.clip((0.6 - share) / 0.1, 0, 1)
    snow = np.clip((share + 0.05 * broad - 0.74) / 0.03, 0, 1) * (1 - 0.8 * rock)
    del share
    height += 0.35 * cell * fine * rock
    height += 1.6 * wood * np.maximum(fine + 0.3, 0)
    albedo = 0.115 + 0.012 * broad + 0.007 * fine
    del broad
    albedo += rock * (0.07 + 0.035 * fine)
    albedo += wood * (0.02 * fine - 0.055)
    albedo += snow * (0.36 - albedo + 0.004 * fine)
    del rock, wood, snow, fine
    np.clip(albedo, 0.02, 0.6, out=ground.albedo)
    del albedo
    progress.step(0.7, "sunlight")
    return ground.finish(crs, sun, math.inf)


def build_urban(
    bounds: Bounds, cell: float, crs: str, base: float, sun: Sun, seed: int, progress: Progress = SILENT
) -> SimulatedSurface:
    """A town on gentle ground around ``base`` metres: blocks, streets, houses, halls, towers, parks and a field.

    Deterministic for the same arguments. Plain roofs and fields have little texture.
    """
    from .town import Town

    rng = np.random.default_rng([seed, 2])
    ground = Ground.empty(bounds, cell)
    shape = ground.height.shape
    ground.height[:] = np.float32(base) + 3.0 * fractal(rng, shape, cell, 500.0, 120.0)
    progress.step(0.1, "town")
    Town(ground, rng, progress).build()
    progress.step(0.7, "sunlight")
    return ground.finish(crs, sun, 0.9)
