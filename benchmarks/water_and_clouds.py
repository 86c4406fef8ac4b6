"""Simulated pairs with water and clouds in them, and where they are: for the benchmark and the tests.

Water has its level and no texture of its own: what a view shows of it is the sensor's noise (``still``), ripples that
are others a second later (``ripples``), the sun's glint on them (``glint``), or them on water that is as bright as much
of the land (``murky``). Clouds are textured, half transparent at their rims, and far above the ground: each view has
them in front of other ground.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import List, Mapping, Sequence, Tuple

import numpy as np
from scipy.interpolate import RectBivariateSpline

from benchmarks.colour_scene import RATIO
from benchmarks.scenes import simulation
from benchmarks.water_spectra import BANDS, in_band, land_cover
from repm_qgis.geometry.frames import geodetic_from_projected, projected_from_geodetic
from repm_qgis.imagery.raster import RasterFrame, created
from repm_qgis.rpc.model import Rpc
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.gcps import common_square
from repm_qgis.simulation.parameters import LightParameters
from repm_qgis.simulation.render import render_view
from repm_qgis.simulation.scene import (
    SceneSpec,
    fit_view_rpcs,
    make_surface,
    make_views,
    pointing_errors,
    surface_bounds,
    write_truth,
)
from repm_qgis.simulation.sensor import Look, PushbroomView
from repm_qgis.simulation.surface import SimulatedSurface, Sun, fractal

LAND, RIM = 0, 9
WATER = {"still": 1, "ripples": 2, "glint": 3, "murky": 5}
CLOUD = 4
DARK = {"shade": 6, "tarmac": 7}

_WATER_DN = 150.0  # haze and little more
_RIPPLES_DN = {"still": 0.0, "ripples": 8.0, "glint": 120.0, "murky": 30.0}
_MURKY_DN = 450.0  # and more
_CLOUD_DN = 3300.0
_RIM_ALPHA = (0.02, 0.5)
_DARK_ALBEDO = {"shade": 0.18, "tarmac": 0.045}


@dataclass(frozen=True)
class Cloud:
    """East, north and up of a cloud from the scene's middle, its radius, and the wind's way between the views; m."""

    east: float
    north: float
    up: float
    radius: float
    drift: float = 0.0


@dataclass(frozen=True)
class Disturbed:
    """A pair on disk with its true DSM, and (rows, columns) of that DSM's cells what each is: LAND, WATER, ..."""

    images: List[str]
    truth: str
    classes: np.ndarray
    xs: List[str]


LAKES = {"still": (-0.25, 0.24, 0.1), "ripples": (0.24, 0.24, 0.1), "glint": (0.02, -0.26, 0.1)}
"""East, north and radius as shares of the scene's side."""
MORE_LAKES = {**LAKES, "murky": (0.0, 0.03, 0.1)}
PATCHES = {"shade": (-0.27, -0.29, 0.1), "tarmac": (0.28, -0.29, 0.1)}
"""Of dark ground, between the lakes."""


def make_pair(
    folder: str,
    kind: str = "urban",
    size: int = 1000,
    seed: int = 5,
    water: bool = True,
    clouds: bool = True,
    river: bool = False,
    xs: bool = False,
    dark: bool = False,
    sun_deg: float = Sun().elevation_deg,
) -> Disturbed:
    """Simulate a pair 20 degrees apart with three lakes, or a river in their place, and two clouds, or without them.

    ``xs``: with a fourth lake, of murky water, and a multispectral image of a quarter of the resolution beside each
    view, its name in the vendors' manner. ``dark``: with a patch of shade and one of tarmac. ``sun_deg`` is the sun's
    elevation.
    """
    spec = SceneSpec.default(kind, size, seed)
    spec = replace(spec, sun=replace(spec.sun, elevation_deg=sun_deg))
    gsd = spec.sensor.looks[0].gsd_m
    spec = replace(spec, sensor=replace(spec.sensor, looks=(Look(10.0, gsd), Look(-10.0, gsd))))
    views = make_views(spec)
    surface = make_surface(spec, surface_bounds(spec, views), Silent())
    lakes = np.zeros(surface.height.shape, np.uint8)
    if water or river:
        lakes_of = MORE_LAKES if xs else LAKES
        surface, lakes = _with_river(surface, size * gsd) if river else _with_lakes(surface, size * gsd, lakes_of)
    if dark:
        surface = _with_patches(surface, size * gsd, spec.sun, lakes)
    fits = fit_view_rpcs(views, surface.height_range())
    square = common_square(surface, views, spec.surface_step)
    os.makedirs(folder, exist_ok=True)
    truth = os.path.join(folder, "truth.tif")
    write_truth(truth, surface, square, spec.surface_step)
    images, alphas = [], []
    for number, (view, fit, bias) in enumerate(zip(views, fits, pointing_errors(2, seed))):
        lit = _rippled(surface, lakes, seed + number)
        pixels = np.concatenate(
            [strip for _, strip in render_view(lit, view, seed + number, Silent(), simulation().render)]
        )
        alpha = np.zeros(pixels.shape)
        for index, cloud in enumerate(_clouds(size * gsd) if clouds else ()):
            pixels, alpha = _clouded(pixels, alpha, view, spec, cloud, number, index)
        images.append(os.path.join(folder, f"img_{number + 1:02d}.tif"))
        _write(images[-1], pixels, fit.rpc.shifted(-bias[0], -bias[1]))
        alphas.append(alpha)
    classes = _classes(surface, lakes, square, spec.surface_step, [f.rpc for f in fits], alphas)
    beside = _multispectral(folder, spec, surface, lakes, clouds) if xs else []
    return Disturbed(images, truth, classes, beside)


def _multispectral(
    folder: str, spec: SceneSpec, surface: SimulatedSurface, lakes: np.ndarray, clouds: bool
) -> List[str]:
    """The multispectral images, with RPCs of their own and the panchromatic images' pointing errors."""
    looks = tuple(replace(look, gsd_m=RATIO * look.gsd_m) for look in spec.sensor.looks)
    small = replace(spec, size=spec.size // RATIO, sensor=replace(spec.sensor, looks=looks))
    views, cover, paths = make_views(small), land_cover(surface, spec), []
    fits = fit_view_rpcs(views, surface.height_range())
    for number, (view, fit, bias) in enumerate(zip(views, fits, pointing_errors(2, spec.seed) / RATIO)):
        paths.append(os.path.join(folder, f"img_{number + 1:02d}_XS.tif"))
        planes, seen = [], _rippled(surface, lakes, spec.seed + number)
        for index, name in enumerate(BANDS):
            lit = in_band(surface, spec, name, cover, _reflected(seen, spec.sun, lakes, name))
            strips = render_view(lit, view, spec.seed + 50 * index + number, Silent(), simulation().render)
            pixels, alpha = np.concatenate([strip for _, strip in strips]), np.zeros(view.size[::-1])
            tone = BANDS[name].white_dn / surface.light.sun_dn
            for puff, cloud in enumerate(_clouds(spec.size * spec.sensor.looks[0].gsd_m) if clouds else ()):
                pixels, alpha = _clouded(pixels, alpha, view, spec, cloud, number, puff, tone)
            planes.append(pixels)
        _write(paths[-1], np.stack(planes), fit.rpc.shifted(-bias[0], -bias[1]), tuple(BANDS))
    return paths


def _reflected(seen: SimulatedSurface, sun: Sun, lakes: np.ndarray, name: str) -> np.ndarray:
    """What the water of a view's surface reflects in a band, its own colour and the waves' grey, and what dark patches
    do; NaN on other land."""
    band = BANDS[name]
    found = np.full(lakes.shape, np.nan, np.float32)
    for kind, number in WATER.items():
        own, grey = (band.murky, _MURKY_DN) if kind == "murky" else (band.clear, _WATER_DN)
        waves = (seen.radiance - grey) / seen.light.sun_dn
        found = np.where(lakes == number, np.maximum(own + waves, 0.002), found)
    for kind, number in DARK.items():
        seen_grey = (seen.radiance - seen.light.haze_dn) / seen.light.sun_dn / _light_on(kind, sun, seen.light, 1.0)
        lit = band.bare * seen_grey * _light_on(kind, sun, seen.light, band.sky)
        found = np.where(lakes == number, lit, found)
    return found


def _clouds(side: float) -> Sequence[Cloud]:
    return (
        Cloud(-0.28 * side, -0.1 * side, 250.0, 0.09 * side),
        Cloud(0.27 * side, -0.02 * side, 120.0, 0.07 * side, drift=25.0),
    )


def _with_lakes(
    surface: SimulatedSurface, side: float, lakes_of: Mapping[str, Tuple[float, float, float]]
) -> Tuple[SimulatedSurface, np.ndarray]:
    """The surface with level water in it, and each node's lake (0 none)."""
    rows, columns = surface.height.shape
    x = (np.arange(columns) - (columns - 1) / 2) * surface.cell
    y = ((rows - 1) / 2 - np.arange(rows)) * surface.cell
    lakes = np.zeros(surface.height.shape, np.uint8)
    height = surface.height.copy()
    for name, (east, north, radius) in lakes_of.items():
        dx, dy = x[None, :] - east * side, y[:, None] - north * side
        angle = np.arctan2(dy, dx)
        shore = radius * side * (1 + 0.15 * np.sin(3 * angle + 1) + 0.08 * np.sin(7 * angle))
        inside = np.hypot(dx, dy) < shore
        lakes[inside] = WATER[name]
        height[inside] = np.percentile(surface.height[inside], 2) - 0.5
    shade = np.where(lakes > 0, -1e3, surface.shade) if surface.shade.shape == lakes.shape else surface.shade
    return replace(surface, height=height, shade=shade.astype(np.float32)), lakes


def _with_patches(surface: SimulatedSurface, side: float, sun: Sun, lakes: np.ndarray) -> SimulatedSurface:
    """The surface with the patches of dark ground, which are entered among the ``lakes``; a town has none of its houses
    on them."""
    rows, columns = surface.height.shape
    x = (np.arange(columns) - (columns - 1) / 2) * surface.cell
    y = ((rows - 1) / 2 - np.arange(rows)) * surface.cell
    height, radiance, light = surface.height.copy(), surface.radiance.copy(), surface.light
    tones = 1 + 0.003 * fractal(np.random.default_rng(12), height.shape, surface.cell, 30.0, 4.0)
    for name, (east, north, radius) in PATCHES.items():
        dx, dy = x[None, :] - east * side, y[:, None] - north * side
        inside = np.hypot(dx, dy) < radius * side * (1 + 0.2 * np.sin(2 * np.arctan2(dy, dx)))
        lakes[inside] = DARK[name]
        if np.isfinite(surface.wall_m):
            height[inside] = np.percentile(surface.height[inside], 10) + 0.02 * dx.repeat(rows, axis=0)[inside]
        lit = _light_on(name, sun, light, 1.0)
        radiance[inside] = (light.haze_dn + light.sun_dn * _DARK_ALBEDO[name] * lit * tones)[inside]
    dry = (lakes != DARK["shade"]) & (lakes != DARK["tarmac"])
    shade = np.where(dry, surface.shade, -1e3) if surface.shade.shape == lakes.shape else surface.shade
    return replace(surface, height=height, radiance=radiance, shade=shade.astype(np.float32))


def _light_on(name: str, sun: Sun, light: LightParameters, sky: float) -> float:
    """What light falls on a patch, as a share of the sun's, in a band in which the sky is so bright."""
    return float(sun.direction()[2]) * (name == "tarmac") + light.sky_share * sky


def _with_river(surface: SimulatedSurface, side: float) -> Tuple[SimulatedSurface, np.ndarray]:
    """The surface with a winding river of still water from west to east, 0.12 of the side wide, and its cells.

    It falls by 8 m from one side to the other, in the middle of a valley whose floor is half a metre higher.
    """
    rows, columns = surface.height.shape
    x = (np.arange(columns) - (columns - 1) / 2) * surface.cell
    y = ((rows - 1) / 2 - np.arange(rows)) * surface.cell
    away = np.abs(y[:, None] - 0.06 * side * np.sin(2 * np.pi * x / side)[None, :])
    level = float(np.percentile(surface.height, 20)) - 8.0 * x[None, :] / side + np.zeros_like(surface.height)
    floor = level + 0.5 + np.maximum(away - 0.16 * side, 0.0) * 0.5
    inside = away < 0.06 * side
    valley = (away < 0.16 * side) | (surface.height > floor) & (away < 0.3 * side)
    height = np.where(inside, level, np.where(valley, floor, surface.height)).astype(surface.height.dtype)
    lakes = np.where(inside, WATER["still"], LAND).astype(np.uint8)
    shade = np.where((inside | valley), -1e3, surface.shade) if surface.shade.shape == lakes.shape else surface.shade
    return replace(surface, height=height, shade=shade.astype(np.float32)), lakes


def _rippled(surface: SimulatedSurface, lakes: np.ndarray, seed: int) -> SimulatedSurface:
    """The surface as one view finds it: the same land, water as it is at that moment."""
    rng = np.random.default_rng([seed, 77])
    radiance = surface.radiance.copy()
    waves = fractal(rng, lakes.shape, surface.cell, 8.0, 1.0, 0.5)
    for name, number in WATER.items():
        strength = _RIPPLES_DN[name]
        calm = _MURKY_DN if name == "murky" else _WATER_DN
        tone = calm + strength * (np.maximum(waves, -1.0) + (1.0 if name == "glint" else 0.0))
        radiance = np.where(lakes == number, np.maximum(tone, 100.0), radiance)
    return replace(surface, radiance=radiance.astype(np.float32))


def _clouded(
    pixels: np.ndarray,
    alpha: np.ndarray,
    view: PushbroomView,
    spec: SceneSpec,
    cloud: Cloud,
    number: int,
    index: int,
    tone: float = 1.0,
) -> Tuple[np.ndarray, np.ndarray]:
    """An image with a cloud before it, which is so bright in its band, and the opacity of all clouds so far."""
    middle = projected_from_geodetic(spec.crs, np.array([[spec.lon, spec.lat, 0.0]]))[0]
    rows, columns = pixels.shape
    nodes = (np.linspace(0, rows - 1, 12), np.linspace(0, columns - 1, 12))
    grid = np.stack(np.meshgrid(nodes[1], nodes[0]), axis=-1).reshape(-1, 2)
    ground = projected_from_geodetic(spec.crs, view.localise(grid, spec.base_m + cloud.up)) - middle
    east, north = (
        RectBivariateSpline(*nodes, ground[:, axis].reshape(12, 12))(np.arange(rows), np.arange(columns))
        for axis in (0, 1)
    )
    east = east - cloud.east - number * cloud.drift
    north = north - cloud.north
    puffs = fractal(np.random.default_rng([99, index]), (512, 512), 1.0, 60.0, 0.0, 0.8)
    row = np.clip(np.rint(255 - north * 200 / cloud.radius / 1.6), 0, 511).astype(int)
    column = np.clip(np.rint(255 + east * 200 / cloud.radius / 1.6), 0, 511).astype(int)
    puff = puffs[row, column]
    own = np.clip((1.0 + 0.15 * puff - np.hypot(east, north) / cloud.radius) / 0.3, 0.0, 1.0)
    rng = np.random.default_rng([spec.seed, 31, number, index])
    bright = tone * (_CLOUD_DN + 350.0 * puff)
    mixed = pixels * (1 - own) + own * (bright + np.sqrt(0.05 * bright) * rng.standard_normal(pixels.shape))
    return np.clip(np.rint(mixed), 1, 4095).astype(np.uint16), 1 - (1 - alpha) * (1 - own)


def _write(path: str, pixels: np.ndarray, rpc: Rpc, names: Tuple[str, ...] = ()) -> None:
    planes = pixels.reshape(-1, *pixels.shape[-2:])
    frame = RasterFrame(planes.shape[1:], np.uint16, len(planes))
    with created(path, frame, nodata=None, descriptions=names, compress=False) as dataset:
        dataset.set_metadata(rpc_tags(rpc), "RPC")
        for band, plane in enumerate(planes, start=1):
            dataset.write(plane, 0, 0, band)


def _classes(
    surface: SimulatedSurface,
    lakes: np.ndarray,
    square: Tuple[int, int, int],
    step: int,
    rpcs: Sequence[Rpc],
    alphas: Sequence[np.ndarray],
) -> np.ndarray:
    """What each cell of the true DSM is; under a cloud in either view it is CLOUD, under its thin rim RIM."""
    row, col, count = square
    rows, columns = row + step * np.arange(count), col + step * np.arange(count)
    place = np.stack(np.meshgrid(surface.west + columns * surface.cell, surface.north - rows * surface.cell), axis=-1)
    height = surface.height[np.ix_(rows, columns)].astype(np.float64)
    ground = np.concatenate([geodetic_from_projected(surface.crs, place), height[..., None]], axis=-1)
    opacity = np.zeros((count, count))
    for rpc, alpha in zip(rpcs, alphas):
        pixels = np.rint(rpc.project(ground)).astype(int)
        inside = ((pixels >= 0) & (pixels < alpha.shape[::-1])).all(axis=-1)
        seen = alpha[np.where(inside, pixels[..., 1], 0), np.where(inside, pixels[..., 0], 0)]
        opacity = np.maximum(opacity, np.where(inside, seen, 0.0))
    classes = lakes[np.ix_(rows, columns)].copy()
    classes[opacity > _RIM_ALPHA[0]] = RIM
    classes[opacity > _RIM_ALPHA[1]] = CLOUD
    return classes
