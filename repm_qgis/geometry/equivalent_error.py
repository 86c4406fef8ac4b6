"""The equivalent error: how far the pinhole camera's pixel of a ground point lies from the RPC's.

Paper: Section 3.2.2 (the formula) and 4.2 (the measure L_E, Samp RMSE, Line RMSE, RMSE and Max).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Optional, Tuple

import numpy as np

from ..arrays import FloatArray
from ..errors import OptionError
from ..records import Record
from .frames import EnuFrame
from .pinhole import PinholeCamera, factorise, fit_projection
from .refinement import RefinementMap, Terrain, TerrainMap, fit_map

Localise = Callable[[FloatArray, FloatArray], FloatArray]

GRID = (25, 25, 11)
"""Columns, rows and altitudes of the virtual grid of a whole scene, ends included."""

TILE_GRID = (13, 13, 7)
"""The same for a tile: the model is so smooth there that a finer grid gives the same camera (to 1e-4 px)."""


@dataclass(frozen=True)
class EquivalentError(Record):
    """Statistics over the virtual grid in px; ``predicted`` is the paper's bound |x (Z - Zmean) / Zmean|."""

    samp_rmse: float
    line_rmse: float
    rmse: float
    max: float
    predicted: float

    @classmethod
    def of(cls, difference: FloatArray, predicted: float) -> "EquivalentError":
        """From (N, 2) differences in column and row."""
        square = difference**2
        return cls(
            float(np.sqrt(square[:, 0].mean())),
            float(np.sqrt(square[:, 1].mean())),
            float(np.sqrt(square.sum(axis=1).mean())),
            float(np.sqrt(square.sum(axis=1).max())),
            predicted,
        )


@dataclass(frozen=True)
class VirtualGrid:
    """Ground points over a pixel window and an altitude range, with their RPC pixels (paper, Algorithm 1, step 1)."""

    pixels: FloatArray
    ground: FloatArray
    enu: FloatArray


def virtual_grid(
    localise: Localise,
    window: Tuple[float, float, float, float],
    altitudes: Tuple[float, float],
    frame: EnuFrame,
    shape: Tuple[int, int, int] = GRID,
) -> VirtualGrid:
    """Spread a regular grid over a window (col, row, width, height) and an altitude range.

    The paper projects a grid in longitude and latitude and drops what falls outside the image; localising a grid of
    pixels gives the same correspondences without the loss.
    """
    col, row, width, height = window
    cols, rows, heights = np.meshgrid(
        np.linspace(col, col + width - 1, shape[0]),
        np.linspace(row, row + height - 1, shape[1]),
        np.linspace(altitudes[0], altitudes[1], shape[2]),
        indexing="ij",
    )
    pixels = np.stack([cols.ravel(), rows.ravel()], axis=1)
    ground = localise(pixels, heights.ravel())
    known = np.isfinite(ground).all(axis=1)
    ground = ground[known]
    return VirtualGrid(pixels[known], ground, frame.from_geodetic(ground))


def predicted_error(camera: PinholeCamera, grid: VirtualGrid) -> float:
    """The paper's prediction for a window, px: the largest |x (Z - Zmean) / Zmean| of the virtual grid.

    x is the distance from the window's centre, Z the depth.
    """
    depth = camera.depth(grid.enu)
    x = np.linalg.norm(grid.pixels - grid.pixels.mean(axis=0), axis=1)
    return float(np.abs(x * (depth - depth.mean()) / depth.mean()).max())


@dataclass(frozen=True)
class EquivalentPinhole:
    """A window's fitted camera (original pixels, with skew), and what it costs."""

    camera: PinholeCamera
    error: EquivalentError


def fit_pinhole(grid: VirtualGrid) -> EquivalentPinhole:
    """Fit and factorise the equivalent pinhole camera of a window, and measure its error (paper, Algorithm 1)."""
    camera = factorise(fit_projection(grid.enu, grid.pixels))
    return EquivalentPinhole(
        camera, EquivalentError.of(camera.project(grid.enu) - grid.pixels, predicted_error(camera, grid))
    )


@dataclass(frozen=True)
class RefinedPinhole(Record):
    """A zero-skew camera, the map M from its image's pixels to the original's, that image's size, and what is left."""

    camera: PinholeCamera
    to_original: RefinementMap
    size: Tuple[int, int]
    error: EquivalentError


def surface_grid(
    terrain: Terrain,
    window: Tuple[float, float, float, float],
    uncertainty_m: float = 10.0,
    shape: Tuple[int, int, int] = GRID,
) -> VirtualGrid:
    """Ground points within ``uncertainty_m`` of a surface, over a window: a terrain-aware camera must hold there."""
    cols, rows, above = np.meshgrid(
        np.linspace(window[0], window[0] + window[2] - 1, shape[0]),
        np.linspace(window[1], window[1] + window[3] - 1, shape[1]),
        np.linspace(-uncertainty_m, uncertainty_m, shape[2]),
        indexing="ij",
    )
    pixels = np.stack([cols.ravel(), rows.ravel()], axis=1)
    height = np.full(len(pixels), float(terrain.surface.heights.mean()))
    for _ in range(40):
        ground = terrain.sensor.localise(pixels, height)
        before = height
        height = terrain.surface.height(ground[:, 0], ground[:, 1]) + above.ravel()
        if not (np.abs(height - before) > 0.01).any():
            break
    known = np.isfinite(ground).all(axis=1)
    return VirtualGrid(pixels[known], ground[known], terrain.frame.from_geodetic(ground[known]))


def refine_pinhole(
    model: str,
    camera: PinholeCamera,
    grid: VirtualGrid,
    window: Tuple[float, float, float, float],
    order: int = 2,
    terrain: Optional[Terrain] = None,
) -> RefinedPinhole:
    """Find M for a window, and place the refined image so that it holds all of the window (paper, Algorithm 2).

    The error is measured in original pixels: M(p') against p, where p' is the zero-skew camera's pixel of a ground
    point and p the RPC's; over ``grid``, or for the ``terrain`` model over points within 10 m of its surface.
    """
    straight = camera.without_skew()
    to_original: RefinementMap
    if model == "terrain":
        if terrain is None:
            raise OptionError("MODEL", model, "needs a surface: give a DEM")
        to_original = TerrainMap(straight, terrain)
        grid = surface_grid(terrain, window)
        refined = straight.project(grid.enu)
    else:
        refined = straight.project(grid.enu)
        affinity = camera.K @ np.linalg.inv(straight.K)
        to_original = fit_map(model, refined, grid.pixels, affinity, order)
    difference = to_original.original_from_refined(refined) - grid.pixels
    error = EquivalentError.of(difference, predicted_error(straight, grid))
    corners = to_original.refined_from_original(_border(window))
    low = np.floor(corners.min(axis=0))
    high = np.ceil(corners.max(axis=0))
    size = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
    return RefinedPinhole(straight.moved(*low), to_original.moved(*low), size, error)


def _border(window: Tuple[float, float, float, float], points: int = 9) -> FloatArray:
    """(4 * points, 2) pixels along a window's border."""
    col, row, width, height = window
    u, v = np.linspace(col, col + width - 1, points), np.linspace(row, row + height - 1, points)
    return np.concatenate(
        [
            np.column_stack([u, np.full(points, v[0])]),
            np.column_stack([u, np.full(points, v[-1])]),
            np.column_stack([np.full(points, u[0]), v]),
            np.column_stack([np.full(points, u[-1]), v]),
        ]
    )
