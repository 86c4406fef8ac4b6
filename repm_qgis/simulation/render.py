"""Pixels: every ray of a pushbroom view is cast onto a surface; the result is blurred, made noisy and quantised.

A ray is a straight line in space; over the surface's grid it is ``place(h) = a + b h + c h^2``, where c (the Earth's
curvature) is tiny and the same for a whole block. Rays start at a height that is safely above everything near them,
which one ray in 8 x 8, cast onto the surface's coarse maxima, finds. They descend by half a cell a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Callable, Iterator, List, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from ..contracts.arrays import FloatArray, FloatImage, IntArray
from ..runtime.progress import Part, Progress
from .parameters import SIMULATION, RenderParameters
from .sensor import PushbroomView
from .surface import SimulatedSurface, facade_radiance, interpolate

Chosen = Union[IntArray, slice, Tuple[IntArray, ...]]
Digital = NDArray[np.uint16]


class RayCaster:
    """Intersects a view's rays with a surface. Memory: a quarter more than the surface's heights, and one block."""

    def __init__(
        self, surface: SimulatedSurface, view: PushbroomView, parameters: RenderParameters = SIMULATION.render
    ) -> None:
        self._surface, self.view, self._parameters = surface, view, parameters
        low, high = surface.height_range()
        self._low, self._high = low - 1.0, high + 1.0
        self._ceiling = _quad_maxima(surface.height)
        self._coarse = _coarse_maxima(self._ceiling, parameters.coarse_cells)
        heights = (self._low, 0.5 * (self._low + self._high), self._high)
        along = [int(sine.period_lines / parameters.nodes_per_wave) for sine in view.jitter]
        node_px = max(1, min([parameters.node_px, *along]))
        self._place = _ray_splines(surface, view, heights, parameters.node_px, node_px)

    def rays(self, cols: FloatArray, rows: FloatArray) -> Rays:
        """The rays of a grid of image columns (C,) and rows (R,), both increasing."""
        bottom, middle, top = ((x(rows, cols), y(rows, cols)) for x, y in self._place)
        span = self._high - self._low
        # c of the parabola from the sag at the middle height, which does not vary within a block.
        bend = [float(4 * (0.5 * (b + t) - m).mean()) for b, m, t in zip(bottom, middle, top)]
        return Rays(bottom[0], bottom[1], top[0] - bottom[0], top[1] - bottom[1], bend[0], bend[1], self._low, span)

    def cast(self, cols: FloatArray, rows: FloatArray) -> Tuple[Rays, FloatArray]:
        """Rays of a grid of image columns (C,) and rows (R,), and (R, C) heights (m) at which they meet the surface."""
        rays = self.rays(cols, rows)
        start = self._start_heights(rays)
        flat = rays.flat()
        return rays, self._descend(flat, start.reshape(-1)).reshape(start.shape)

    def _step(self, rays: Rays, cells: float) -> float:
        """Metres of height in which no ray moves by more than ``cells``."""
        slant = float(np.hypot(rays.right, rays.down).max()) / rays.span
        return cells / max(slant, 1e-6)

    def _start_heights(self, rays: Rays) -> FloatArray:
        """(R, C) heights from which rays can start without having passed through anything."""
        rows, cols = rays.left.shape
        coarse = self._parameters.coarse_cells
        sub = _sub_step(rays)
        # A group of rays must stay well inside 3 x 3 coarse cells, of which its middle ray is in the middle one.
        group = int(max(1, min(coarse, 0.9 * coarse / max(sub, 1e-3))))
        picks_r = np.minimum(np.arange(0, rows, group) + group // 2, rows - 1)
        picks_c = np.minimum(np.arange(0, cols, group) + group // 2, cols - 1)
        few = rays.pick(np.ix_(picks_r, picks_c)).flat()
        step = self._step(few, 0.4 * coarse)
        start = np.full(few.left.size, self._low)
        active = np.arange(few.left.size)
        height = self._high
        while active.size and height > self._low:
            following = max(height - step, self._low)
            x, y = few.at(following, active)
            top = _nearest(self._coarse, x / coarse, y / coarse)
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

    def _narrow(self, rays: Rays, which: IntArray, below: FloatArray, above: FloatArray) -> FloatArray:
        """(N,) heights of meetings that lie between ``below`` (inside the ground) and ``above`` (in the air).

        One secant step solves every plane; the other rays are bisected, which finds walls too.
        """
        depth = self._depth(rays, which, below)
        air = self._depth(rays, which, above)
        guess: FloatArray = below + (above - below) * np.clip(depth / np.maximum(depth - air, 1e-9), 0, 1)
        miss = self._depth(rays, which, guess)
        rest = np.flatnonzero(np.abs(miss) > 0.01)
        if not rest.size:
            return guess
        low, high, names = below[rest], above[rest], which[rest]
        for _ in range(self._parameters.bisections):
            middle = 0.5 * (low + high)
            inside = self._depth(rays, names, middle) >= 0
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        guess[rest] = low
        return guess

    def _depth(self, rays: Rays, which: IntArray, height: FloatArray) -> FloatArray:
        """How deep inside the ground rays are at heights, m."""
        depth: FloatArray = self._surface.heights(*rays.at(height, which)) - height
        return depth

    def radiance(self, rays: Rays, height: FloatArray, band: Optional[SimulatedSurface] = None) -> FloatArray:
        """(R, C) digital numbers of what rays meet at heights; ``band`` is the surface in another colour's light."""
        surface, flat, heights = band or self._surface, rays.flat(), height.reshape(-1)
        x, y = flat.at(heights, slice(None))
        seen = interpolate(surface.radiance, x, y)
        if math.isfinite(surface.wall_m):
            wall = np.flatnonzero(surface.heights(x, y) - heights > self._parameters.wall_hit_m)
            x, y, on = x[wall], y[wall], heights[wall]
            lit = np.clip((on - interpolate(surface.shade, x, y, surface.wall_m)) / surface.light.penumbra_m, 0, 1)
            along = (0.62 * x + 0.78 * y) * surface.cell
            seen[wall] = facade_radiance(interpolate(surface.facade, x, y), lit, on, along, surface.light)
        return seen.reshape(height.shape)


@dataclass
class Rays:
    """Rays over a surface's grid: fractional columns and rows as parabolas of the height above ``low``.

    Arrays have the shape of the block, or are flat: ``left, top`` is the place at the lowest height, ``right, down``
    the way from there to the highest; ``bend_*`` are the second-order terms.
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
        return self._each(np.ravel)

    def pick(self, which: Chosen) -> Rays:
        return self._each(lambda values: values[which])

    def _each(self, change: Callable[[FloatArray], FloatArray]) -> Rays:
        left, top, right, down = (change(values) for values in (self.left, self.top, self.right, self.down))
        return replace(self, left=left, top=top, right=right, down=down)

    def at(self, height: FloatArray | float, which: Chosen) -> Tuple[FloatArray, FloatArray]:
        """Fractional columns and rows of the chosen rays at heights."""
        share = (height - self.low) / self.span
        sag = share * (share - 1.0)
        x = self.left[which] + share * self.right[which] + sag * self.bend_right
        return x, self.top[which] + share * self.down[which] + sag * self.bend_down


def _sub_step(rays: Rays) -> float:
    """Cells between neighbouring rays of a block, at most."""
    steps = [0.0]
    for axis in (0, 1):
        if rays.left.shape[axis] > 1:
            steps.append(float(np.hypot(np.diff(rays.left, axis=axis), np.diff(rays.top, axis=axis)).max()))
    return max(steps)


def _nearest(values: FloatImage, x: FloatArray, y: FloatArray) -> FloatImage:
    """Values of the cells that hold fractional columns and rows, those at the edge beyond it."""
    row = np.clip(y, 0, values.shape[0] - 1).astype(np.int64)
    row *= values.shape[1]
    row += np.clip(x, 0, values.shape[1] - 1).astype(np.int64)
    return np.take(values.reshape(-1), row)


def _quad_maxima(height: FloatImage) -> FloatImage:
    """The highest of the four nodes around each quad; same shape, the last row and column of one node less."""
    top = height.copy()
    np.maximum(top[:, :-1], height[:, 1:], out=top[:, :-1])
    below = top[1:].copy()
    np.maximum(top[:-1], below, out=top[:-1])
    return top


def _coarse_maxima(ceiling: FloatImage, side: int) -> FloatImage:
    """The highest quad in each 3 x 3 neighbourhood of cells of ``side`` x ``side`` quads."""
    rows, cols = (-(-n // side) for n in ceiling.shape)
    padded = np.pad(ceiling, ((0, rows * side - ceiling.shape[0]), (0, cols * side - ceiling.shape[1])), "edge")
    coarse: FloatImage = padded.reshape(rows, side, cols, side).max(axis=(1, 3))
    highest: FloatImage = ndimage.maximum_filter(coarse, 3, mode="nearest")
    return highest


def _ray_splines(
    surface: SimulatedSurface, view: PushbroomView, heights: Sequence[float], across_px: int, along_px: int
) -> List[Tuple[RectBivariateSpline, ...]]:
    """For each height, splines f(rows, cols) of the grid column and row where a view's pixels see that height, with
    nodes so many px apart."""

    def nodes(count: int, node_px: int) -> FloatArray:
        return np.linspace(-8.0, count + 7.0, max(int(math.ceil(count / node_px)) + 1, 6))

    cols, rows = nodes(view.size[0], across_px), nodes(view.size[1], along_px)
    pixels = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    splines = []
    for height in heights:
        x, y = surface.grid(view.localise(pixels, height))
        shape = (rows.size, cols.size)
        splines.append(tuple(RectBivariateSpline(rows, cols, v.reshape(shape)) for v in (x, y)))
    return splines


def render_view(
    surface: SimulatedSurface,
    view: PushbroomView,
    seed: int,
    progress: Progress,
    parameters: RenderParameters = SIMULATION.render,
) -> Iterator[Tuple[int, Digital]]:
    """Expose an image, a strip of rows at a time; ``seed`` is that of the noise.

    Yields the first row, and (rows, columns) uint16 digital numbers from 1 to 2 ** bits - 1. Strips do not depend on
    each other, and memory does not grow with the number of rows. Raises Cancelled if the user asked to stop.
    """
    caster = RayCaster(surface, view, parameters)
    rows = view.size[1]
    strips = range(0, rows, parameters.strip_rows)
    for number, first in enumerate(strips):
        last = min(first + parameters.strip_rows, rows)
        part = Part(progress, number / len(strips), (number + 1) / len(strips))
        fine = _fine_strip(caster, first, last, parameters, part)
        yield first, _expose(fine, view, np.random.default_rng([seed, first]), parameters)


def _fine_strip(
    caster: RayCaster, first: int, last: int, parameters: RenderParameters, progress: Progress
) -> FloatImage:
    """Sharp digital numbers without noise of rows first..last, with a halo on all sides, denser by the oversampling."""
    oversample, halo, chunk = parameters.oversample, parameters.halo_px, parameters.chunk_cols

    def places(begin: int, end: int) -> FloatArray:
        count = (end - begin) * oversample
        return begin - 0.5 + (np.arange(count) + 0.5) / oversample

    cols = caster.view.size[0]
    rows = places(first - halo, last + halo)
    fine = np.empty((rows.size, (cols + 2 * halo) * oversample), np.float32)
    begins = range(-halo, cols + halo, chunk)
    for number, begin in enumerate(begins):
        progress.check_cancelled()
        progress.step(number / len(begins), "lines of sight")
        end = min(begin + chunk, cols + halo)
        rays, height = caster.cast(places(begin, end), rows)
        target = slice((begin + halo) * oversample, (end + halo) * oversample)
        fine[:, target] = caster.radiance(rays, height)
    return fine


def _expose(fine: FloatImage, view: PushbroomView, rng: np.random.Generator, parameters: RenderParameters) -> Digital:
    """Point spread, pixel aperture, noise and quantisation of a strip with its halo, which is cut off."""
    oversample = parameters.oversample
    blurred = ndimage.gaussian_filter(fine, view.sensor.blur_px * oversample, truncate=3.5, mode="nearest")
    edge = parameters.halo_px * oversample
    blurred = blurred[edge:-edge, edge:-edge]
    rows, cols = (n // oversample for n in blurred.shape)
    signal = blurred.reshape(rows, oversample, cols, oversample).mean(axis=(1, 3))
    deviation = np.sqrt(view.sensor.read_noise_dn**2 + view.sensor.photon_gain * np.maximum(signal, 0))
    noisy = signal + deviation * rng.standard_normal(signal.shape, dtype=np.float32)
    # Zero means "no data", as in vendors' images.
    image: Digital = np.clip(np.rint(noisy), 1, 2**view.sensor.bits - 1).astype(np.uint16)
    return image
