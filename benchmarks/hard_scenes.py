"""Simulated scenes that are hard to match: equal roofs on a grid, another sun, another season."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Callable, Sequence

import numpy as np
from scipy import ndimage

from benchmarks.scenes import simulation
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.gcps import common_square
from repm_qgis.simulation.render import render_view
from repm_qgis.simulation.scene import SceneSpec, make_surface, make_views, surface_bounds, write_truth
from repm_qgis.simulation.sensor import PushbroomView
from repm_qgis.simulation.surface import Ground, SimulatedSurface, Sun, fractal

MORNING = Sun(azimuth_deg=105.0, elevation_deg=28.0)
AFTERNOON = Sun(azimuth_deg=245.0, elevation_deg=32.0)
_HOUSE_M = (5.0, 4.0)  # half the length and width of every house
_EAVES_M, _RIDGE_M = 5.0, 2.5
_FIELD_M = 45.0
Writer = Callable[[Path, np.ndarray], object]


def estate(
    bounds: Bounds, spec: SceneSpec, spacing_m: Sequence[float], turn_deg: float, trees: float, garden: float = 0.004
) -> SimulatedSurface:
    """Equal houses on a regular grid of a spacing along two axes, on plain ground; ``trees`` for each house."""
    rng = np.random.default_rng([spec.seed, 9])
    ground = Ground.empty(bounds, spec.cell_m / spec.surface_step)
    shape, cell = ground.height.shape, ground.cell
    terrain = np.float32(spec.base_m) + 1.5 * fractal(rng, shape, cell, 600.0, 150.0)
    ground.height[:] = terrain
    ground.albedo[:] = 0.11 + garden * fractal(rng, shape, cell, 6.0, 0.0, 0.2)
    ground.wall_albedo[:] = 0.3
    turn = math.radians(turn_deg)
    u, v = _axes(ground, turn)
    house = [np.mod(w + s / 2, s) - s / 2 for w, s in zip((u, v), spacing_m)]
    inside = (np.abs(house[0]) <= _HOUSE_M[0]) & (np.abs(house[1]) <= _HOUSE_M[1])
    roof = _EAVES_M + _RIDGE_M * (1 - np.abs(house[1]) / _HOUSE_M[1])
    stack = inside & (np.abs(house[0] - 2.5) < 0.5) & (np.abs(house[1] - 1.0) < 0.5)
    # The terrain of the house's middle, so that roofs are level.
    floor = ndimage.uniform_filter(terrain, int(12 / cell) | 1, mode="nearest")
    ground.height[:] = np.where(inside, floor + roof + 1.5 * stack, ground.height)
    courses = 0.012 * np.sign(np.sin(2 * np.pi * house[1] / 1.4))
    ground.albedo[:] = np.where(inside, np.where(stack, 0.33, 0.22 + courses), ground.albedo)
    _plant(ground, rng, int(trees * shape[0] * shape[1] * cell**2 / (spacing_m[0] * spacing_m[1])), terrain, inside)
    return ground.finish(spec.crs, spec.sun, 0.9)


def _axes(ground: Ground, turn: float) -> Sequence[np.ndarray]:
    """Metres along the grid's two axes at every node."""
    rows, cols = ground.height.shape
    x, y = (np.arange(cols) - cols / 2)[None, :] * ground.cell, (rows / 2 - np.arange(rows))[:, None] * ground.cell
    return x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)


def _plant(ground: Ground, rng: np.random.Generator, count: int, terrain: np.ndarray, houses: np.ndarray) -> None:
    """Trees: the only things that stand in no order; none on a house."""
    rows, cols = ground.height.shape
    for row, col, radius in zip(rng.uniform(0, rows, count), rng.uniform(0, cols, count), rng.uniform(1.5, 3.5, count)):
        patch = ground.patch(ground.west + col * ground.cell, ground.north - row * ground.cell, radius)
        if patch is None or houses[patch[0]].any():
            continue
        area, x, y = patch
        dome = 1.0 - (x * x + y * y) / radius**2
        crown = terrain[area] + radius * (1 + np.sqrt(np.maximum(dome, 0)))
        ground.height[area] = np.where(dome > 0, crown, ground.height[area])
        ground.albedo[area] = np.where(dome > 0, 0.06, ground.albedo[area])


def another_season(surface: SimulatedSurface, seed: int, inverted: float = 0.5) -> SimulatedSurface:
    """Fields of some 45 m, each with another intensity, and a share of them with inverted contrast."""
    rng = np.random.default_rng([seed, 10])
    rows, cols = surface.radiance.shape
    side = _FIELD_M / surface.cell
    seeds = np.stack([rng.uniform(0, n, int(rows * cols / side**2) + 1) for n in (rows, cols)], axis=-1)
    points = np.ones((rows, cols), bool)
    field = np.zeros((rows, cols), int)
    field[tuple(seeds.astype(int).T)] = np.arange(1, len(seeds) + 1)
    points[field > 0] = False
    nearest = ndimage.distance_transform_edt(points, return_distances=False, return_indices=True)
    field = field[tuple(nearest)] - 1
    gain = np.exp(rng.normal(0, 0.35, len(seeds)))
    sign = np.where(rng.uniform(size=len(seeds)) < inverted, -1.0, 1.0)
    mean = ndimage.uniform_filter(surface.radiance, int(10 / surface.cell) | 1, mode="nearest")
    radiance = gain[field] * (mean + sign[field] * (surface.radiance - mean))
    return dataclasses.replace(surface, radiance=np.maximum(radiance, 60.0).astype(np.float32))


def town_under(spec: SceneSpec, sun: Sun) -> SimulatedSurface:
    """The spec's ground with the sun elsewhere: the same houses, other light and other shadows."""
    other = dataclasses.replace(spec, sun=sun)
    return make_surface(other, surface_bounds(other, make_views(other)), Silent())


def exposed(surface: SimulatedSurface, view: PushbroomView, seed: int) -> np.ndarray:
    """The whole image (rows, columns) of a view."""
    return np.concatenate([strip for _, strip in render_view(surface, view, seed, Silent(), simulation().render)])


def write_scene(folder: Path, spec: SceneSpec, surfaces: Sequence[SimulatedSurface], write: Writer) -> None:
    """A view of each surface, the true DSM and heights of the first: what ``Case`` of the pointing benchmark reads.

    ``write`` is given a path and an image.
    """
    folder.mkdir(parents=True, exist_ok=True)
    views = make_views(spec)
    for number, (view, surface) in enumerate(zip(views, surfaces)):
        write(folder / f"{view.name}.tif", exposed(surface, view, spec.seed + number))
    write_truth(
        str(folder / "truth.tif"), surfaces[0], common_square(surfaces[0], views, spec.surface_step), spec.surface_step
    )
    (folder / "truth.json").write_text(json.dumps({"height_range_m": list(surfaces[0].height_range())}))
