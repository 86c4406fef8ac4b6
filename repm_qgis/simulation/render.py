"""Pixels: every ray of a pushbroom view cast onto a surface, then blurred, made noisy and quantised.

A ray is a straight line in space; over the surface's grid it is ``place(h) = a + b h + c h^2``, where c (the Earth's
curvature) is tiny and the same for a whole block. Rays start at a height that lies safely above everything around
them, found by casting one ray in 8 x 8 onto the surface's coarse maxima, and descend by half a cell a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from ..progress import Part, Progress
from .sensor import PushbroomView
from .surface import SILENT, Float32Array, FloatArray, SimulatedSurface, facade_radiance, interpolate

_STRIP_ROWS = 256  # rows that are finished together: the height of the files' tiles
_CHUNK_COLS = 256
_NODE_PX = 64  # spacing of exactly computed rays; cubic splines between them are true to 1e-4 px
_HALO_PX = 3  # reach of the point spread
_COARSE = 8  # cells of a coarse maximum, and sub-pixels between coarse rays
_WALL_HIT_M = 0.3  # a hit so far below the surface there is on a wall
_BISECTIONS = 6


class RayCaster:
    """Meets a view's rays with a surface. Memory: a quarter more than the surface's heights, and one block."""

    def __init__(self, surface: SimulatedSurface, view: PushbroomView) -> None:
        self._surface, self.view = surface, view
        low, high = surface.height_range()
        self._low, self._high = low - 1.0, high + 1.0
        self._ceiling = _quad_maxima(surface.height)
        self._coarse = _coarse_maxima(self._ceiling)
        self._place = _ray_splines(surface, view, (self._low, 0.5 * (self._low + self._high), self._high))

    def rays(self, cols: FloatArray, rows: FloatArray) -> Rays:
        """The rays of a grid of image columns (C,) and rows (R,), both increasing."""
        bottom, middle, top = ((x(rows, cols), y(rows, cols)) for x, y in self._place)
        span = self._high - self._low
        # c of the parabola from the sag at the middle height, which does not vary within a block.
        bend = [float(4 * (0.5 * (b + t) - m).mean()) for b, m, t in zip(bottom, middle, top)]
        return Rays(bottom[0], bottom[1], top[0] - bottom[0], top[1] - bottom[1], bend[0], bend[1], self._low, span)

    def cast(self, cols: FloatArray, rows: FloatArray) -> Tuple[Rays, FloatArray]:
        """Where rays of a grid of image columns (C,) and rows (R,) first meet the surface.

        Returns
        -------
        The rays, and (R, C) heights in metres of their first meeting with the surface.
        """
        rays = self.rays(cols, rows)
        start = self._start_heights(rays)
        flat = rays.flat()
        return rays, self._descend(flat, start.reshape(-1)).reshape(start.shape)

    def heights_at(self, col_row: FloatArray) -> FloatArray:
        """(N,) heights at which single pixels (N, 2) see the surface."""
        return np.array([self.cast(np.array([c]), np.array([r]))[1][0, 0] for c, r in np.asarray(col_row)])

    def _step(self, rays: Rays, cells: float) -> float:
        """Metres of height in which no ray moves by more than ``cells``."""
        slant = float(np.hypot(rays.right, rays.down).max()) / rays.span
        return cells / max(slant, 1e-6)

    def _start_heights(self, rays: Rays) -> FloatArray:
        """(R, C) heights from which rays may start without having passed through anything."""
        rows, cols = rays.left.shape
        sub = _sub_step(rays)
        # A group of rays must stay well inside the 3 x 3 coarse cells around its middle one.
        group = int(max(1, min(_COARSE, 0.9 * _COARSE / max(sub, 1e-3))))
        picks_r = np.minimum(np.arange(0, rows, group) + group // 2, rows - 1)
        picks_c = np.minimum(np.arange(0, cols, group) + group // 2, cols - 1)
        few = rays.pick(np.ix_(picks_r, picks_c)).flat()
        step = self._step(few, 0.4 * _COARSE)
        start = np.full(few.left.size, self._low)
        active = np.arange(few.left.size)
        height = self._high
        while active.size and height > self._low:
            following = max(height - step, self._low)
            x, y = few.at(following, active)
            top = _nearest(self._coarse, x / _COARSE, y / _COARSE)
            hit = top >= following
            start[active[hit]] = np.minimum(top[hit], height)
            active, height = active[~hit], following
        start = start.reshape(picks_r.size, picks_c.size)
        return np.repeat(np.repeat(start, group, axis=0)[:rows], group, axis=1)[:, :cols]

    def _descend(self, rays: Rays, start: FloatArray) -> FloatArray:
        """(N,) heights of first meetings, descending from (N,) start heights by half a cell a step."""
        step = min(self._step(rays, 0.5), max(2.0 * self._surface.cell, 0.05 * rays.span))
        result = np.full(start.shape, self._low)
        active = np.arange(start.size)
        height = start + 1e-3
        while active.size:
            height = np.maximum(height - step, self._low)
            x, y = rays.at(height, active)
            near = np.flatnonzero(_nearest(self._ceiling, x, y) >= height)
            hit = near[self._surface.heights(x[near], y[near]) >= height[near]]
            if hit.size:
                found = active[hit]
                result[found] = self._narrow(rays, found, height[hit], height[hit] + step)
            going = height > self._low
            going[hit] = False
            active, height = active[going], height[going]
        return result

    def _narrow(self, rays: Rays, which: NDArray[np.int64], below: FloatArray, above: FloatArray) -> FloatArray:
        """(N,) heights of meetings that lie between ``below`` (inside the ground) and ``above`` (in the air).

        One secant step solves every plane; what is left is cut in half again and again, which finds walls too.
        """
        depth = self._depth(rays, which, below)
        air = self._depth(rays, which, above)
        guess = below + (above - below) * np.clip(depth / np.maximum(depth - air, 1e-9), 0, 1)
        miss = self._depth(rays, which, guess)
        rest = np.flatnonzero(np.abs(miss) > 0.01)
        if not rest.size:
            return guess
        low, high, names = below[rest], above[rest], which[rest]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            inside = self._depth(rays, names, middle) >= 0
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        guess[rest] = low
        return guess

    def _depth(self, rays: Rays, which: NDArray[np.int64], height: FloatArray) -> FloatArray:
        """How deep inside the ground rays are at heights, m."""
        x, y = rays.at(height, which)
        return self._surface.heights(x, y) - height

    def radiance(self, rays: Rays, height: FloatArray) -> FloatArray:
        """(R, C) digital numbers of what rays meet at heights."""
        surface, flat, heights = self._surface, rays.flat(), height.reshape(-1)
        x, y = flat.at(heights, slice(None))
        seen = interpolate(surface.radiance, x, y)
        if math.isfinite(surface.wall_m):
            wall = np.flatnonzero(surface.heights(x, y) - heights > _WALL_HIT_M)
            x, y, on = x[wall], y[wall], heights[wall]
            lit = np.clip((on - interpolate(surface.shade, x, y, surface.wall_m)) / 0.3, 0, 1)
            along = (0.62 * x + 0.78 * y) * surface.cell
            seen[wall] = facade_radiance(interpolate(surface.facade, x, y), lit, on, along)
        return seen.reshape(height.shape)


@dataclass
class Rays:
    """Rays over a surface's grid: fractional columns and rows as parabolas of the height above ``low``.

    Arrays have the shape of the block, or are flat: ``left, top`` at the lowest height, ``right, down`` the way to
    the highest; ``bend_*`` are the second-order terms.
    """

    left: FloatArray
    top: FloatArray
    right: FloatArray
    down: FloatArray
    bend_right: float
    bend_down: float
    low: float
    span: float

    def flat(self) -> Rays:
        return (
            self.pick(slice(None))
            if self.left.ndim == 1
            else Rays(
                *(a.reshape(-1) for a in (self.left, self.top, self.right, self.down)),
                self.bend_right,
                self.bend_down,
                self.low,
                self.span,
            )
        )

    def pick(self, which) -> Rays:
        return Rays(
            self.left[which],
            self.top[which],
            self.right[which],
            self.down[which],
            self.bend_right,
            self.bend_down,
            self.low,
            self.span,
        )

    def at(self, height: FloatArray | float, which) -> Tuple[FloatArray, FloatArray]:
        """Fractional columns and rows of the chosen rays at heights."""
        share = (height - self.low) / self.span
        sag = share * (share - 1.0)
        return (
            self.left[which] + share * self.right[which] + sag * self.bend_right,
            self.top[which] + share * self.down[which] + sag * self.bend_down,
        )


def _sub_step(rays: Rays) -> float:
    """Cells between neighbouring rays of a block, at most."""
    steps = [0.0]
    for axis in (0, 1):
        if rays.left.shape[axis] > 1:
            steps.append(float(np.hypot(np.diff(rays.left, axis=axis), np.diff(rays.top, axis=axis)).max()))
    return max(steps)


def _nearest(values: Float32Array, x: FloatArray, y: FloatArray) -> Float32Array:
    """Values of the cells that hold fractional columns and rows, those at the edge beyond it."""
    row = np.clip(y, 0, values.shape[0] - 1).astype(np.int64)
    row *= values.shape[1]
    row += np.clip(x, 0, values.shape[1] - 1).astype(np.int64)
    return np.take(values.reshape(-1), row)


def _quad_maxima(height: Float32Array) -> Float32Array:
    """The highest of the four nodes around each quad; same shape, the last row and column of one node less."""
    top = height.copy()
    np.maximum(top[:, :-1], height[:, 1:], out=top[:, :-1])
    below = top[1:].copy()
    np.maximum(top[:-1], below, out=top[:-1])
    return top


def _coarse_maxima(ceiling: Float32Array) -> Float32Array:
    """The highest quad in each 3 x 3 neighbourhood of cells of 8 x 8 quads."""
    rows, cols = (-(-n // _COARSE) for n in ceiling.shape)
    padded = np.pad(ceiling, ((0, rows * _COARSE - ceiling.shape[0]), (0, cols * _COARSE - ceiling.shape[1])), "edge")
    coarse = padded.reshape(rows, _COARSE, cols, _COARSE).max(axis=(1, 3))
    return ndimage.maximum_filter(coarse, 3, mode="nearest")


def _ray_splines(surface: SimulatedSurface, view: PushbroomView, heights: Sequence[float]):
    """For each height, splines of the grid column and row at which a view's pixels see it: f(rows, cols)."""

    def nodes(count: int) -> FloatArray:
        return np.linspace(-8.0, count + 7.0, max(int(math.ceil(count / _NODE_PX)) + 1, 6))

    cols, rows = nodes(view.size[0]), nodes(view.size[1])
    pixels = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    splines = []
    for height in heights:
        x, y = surface.grid(view.localise(pixels, height))
        shape = (rows.size, cols.size)
        splines.append(tuple(RectBivariateSpline(rows, cols, v.reshape(shape)) for v in (x, y)))
    return splines


def render_view(
    surface: SimulatedSurface, view: PushbroomView, seed: int, progress: Progress = SILENT, oversample: int = 2
) -> Iterator[Tuple[int, NDArray[np.uint16]]]:
    """Expose an image, a strip of rows at a time.

    Parameters
    ----------
    seed : of the noise. oversample : rays a pixel along each axis.

    Yields
    ------
    First row, and (rows, columns) uint16 digital numbers from 1 to 2 ** bits - 1. Strips do not depend on each other,
    and memory does not grow with the image's rows.

    Raises Cancelled between blocks of 256 x 256 px if the user asked to stop.
    """
    caster = RayCaster(surface, view)
    cols, rows = view.size
    strips = range(0, rows, _STRIP_ROWS)
    for number, first in enumerate(strips):
        last = min(first + _STRIP_ROWS, rows)
        part = Part(progress, number / len(strips), (number + 1) / len(strips))
        fine = _fine_strip(caster, first, last, oversample, part)
        yield first, _expose(fine, view, np.random.default_rng([seed, first]), oversample)


def render_views(
    surface: SimulatedSurface, views: Sequence[PushbroomView], seed: int, progress: Progress = SILENT
) -> Iterator[Tuple[PushbroomView, NDArray[np.uint16]]]:
    """Whole images of several views, for use in memory: yields each view and its (rows, columns) uint16 image."""
    for number, view in enumerate(views):
        part = Part(progress, number / len(views), (number + 1) / len(views), view.name)
        yield view, np.concatenate([strip for _, strip in render_view(surface, view, seed + number, part)])


def _fine_strip(caster: RayCaster, first: int, last: int, oversample: int, progress: Progress) -> Float32Array:
    """Noise-free, sharp digital numbers of rows first..last with a halo all around, ``oversample`` times denser."""

    def places(begin: int, end: int) -> FloatArray:
        count = (end - begin) * oversample
        return begin - 0.5 + (np.arange(count) + 0.5) / oversample

    cols = caster.view.size[0]
    rows = places(first - _HALO_PX, last + _HALO_PX)
    fine = np.empty((rows.size, (cols + 2 * _HALO_PX) * oversample), np.float32)
    begins = range(-_HALO_PX, cols + _HALO_PX, _CHUNK_COLS)
    for number, begin in enumerate(begins):
        progress.check_cancelled()
        progress.step(number / len(begins), "rays")
        end = min(begin + _CHUNK_COLS, cols + _HALO_PX)
        rays, height = caster.cast(places(begin, end), rows)
        target = slice((begin + _HALO_PX) * oversample, (end + _HALO_PX) * oversample)
        fine[:, target] = caster.radiance(rays, height)
    return fine


def _expose(fine: Float32Array, view: PushbroomView, rng: np.random.Generator, oversample: int) -> NDArray[np.uint16]:
    """Point spread, pixel aperture, noise and quantisation of a strip with its halo; the halo is cut off."""
    blurred = ndimage.gaussian_filter(fine, view.sensor.blur_px * oversample, truncate=3.5, mode="nearest")
    edge = _HALO_PX * oversample
    blurred = blurred[edge:-edge, edge:-edge]
    rows, cols = (n // oversample for n in blurred.shape)
    signal = blurred.reshape(rows, oversample, cols, oversample).mean(axis=(1, 3))
    deviation = np.sqrt(view.sensor.read_noise_dn**2 + view.sensor.photon_gain * np.maximum(signal, 0))
    noisy = signal + deviation * rng.standard_normal(signal.shape, dtype=np.float32)
    # Zero is left to mean "no data", as vendors do.
    return np.clip(np.rint(noisy), 1, 2**view.sensor.bits - 1).astype(np.uint16)
