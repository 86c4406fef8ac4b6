"""The equivalent error: the distance between the pinhole camera's pixel of a ground point and the RPC's.

Paper: Section 3.2.2 (the formula) and 4.2 (the measure L_E, Samp RMSE, Line RMSE, RMSE and Max).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, Mapping, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray
from ..contracts.checks import typed
from ..contracts.errors import OptionError, RpcInvalidError
from ..contracts.record import Record
from ..contracts.records import Count, Pixels
from .footprints import ring
from .frames import EnuFrame
from .jitter import Jitter
from .parameters import VIRTUAL_GRID, VirtualGridParameters
from .pinhole import PinholeCamera, factorise, fit_projection
from .refinement import JitteredMap, RefinementMap, Terrain, TerrainMap, fit_map, map_from_mapping, whole_pixels

Localise = Callable[[FloatArray, FloatArray], FloatArray]
Shape = Tuple[int, int, int]


@dataclass(frozen=True)
class EquivalentError(Record):
    """Statistics over the virtual grid in px; ``predicted`` is the paper's bound |x (Z - Zmean) / Zmean|."""

    samp_rmse: Pixels
    line_rmse: Pixels
    rmse: Pixels
    max: Pixels
    predicted: Pixels

    @classmethod
    def of(cls, difference: FloatArray, predicted: float) -> "EquivalentError":
        """From (N, 2) differences in column and row."""
        square = difference**2
        both = square.sum(axis=1)
        means = (square[:, 0].mean(), square[:, 1].mean(), both.mean(), both.max())
        samp_rmse, line_rmse, rmse, largest = (float(np.sqrt(value)) for value in means)
        return cls(samp_rmse, line_rmse, rmse, largest, predicted)


@dataclass(frozen=True)
class VirtualGrid:
    """Ground points over a pixel window and an altitude range, with their RPC pixels (paper, Algorithm 1, step 1)."""

    pixels: FloatArray
    ground: FloatArray
    enu: FloatArray


def virtual_grid(
    localise: Localise,
    window: Sequence[float],
    altitudes: Altitudes,
    frame: EnuFrame,
    shape: Shape = VIRTUAL_GRID.scene,
) -> VirtualGrid:
    """A regular grid of ``shape`` (columns, rows, altitudes) over a window (col, row, width, height) and a range.

    The paper projects a grid in longitude and latitude and drops points outside the image; localising a grid of
    pixels gives the same correspondences without the loss.
    """
    pixels, heights = _pixel_grid(window, altitudes, shape)
    return _localised(pixels, localise(pixels, heights), frame)


def _pixel_grid(window: Sequence[float], levels: Tuple[float, float], shape: Shape) -> Tuple[FloatArray, FloatArray]:
    """(N, 2) pixels and (N,) levels of a regular grid."""
    col, row, width, height = window
    ends = ((col, col + width - 1), (row, row + height - 1), levels)
    cols, rows, values = np.meshgrid(*(np.linspace(*end, n) for end, n in zip(ends, shape)), indexing="ij")
    return np.stack([cols.ravel(), rows.ravel()], axis=1), values.ravel()


def _localised(pixels: FloatArray, ground: FloatArray, frame: EnuFrame) -> VirtualGrid:
    known = np.isfinite(ground).all(axis=1)
    if known.sum() < 6:  # fewer determine no camera
        raise RpcInvalidError("the RPC does not place the window on the ground: use the image's own RPC.")
    return VirtualGrid(pixels[known], ground[known], frame.from_geodetic(ground[known]))


def predicted_error(camera: PinholeCamera, grid: VirtualGrid) -> float:
    """The paper's prediction for a window, px: the largest |x (Z - Zmean) / Zmean| of the virtual grid.

    x is the distance from the window's centre, Z the depth.
    """
    depth = camera.depth(grid.enu)
    x = np.linalg.norm(grid.pixels - grid.pixels.mean(axis=0), axis=1)
    return float(np.abs(x * (depth - depth.mean()) / depth.mean()).max())


@dataclass(frozen=True)
class EquivalentPinhole:
    """A window's fitted camera (original pixels, with skew), and its error."""

    camera: PinholeCamera
    error: EquivalentError


def fit_pinhole(grid: VirtualGrid) -> EquivalentPinhole:
    """Fit and factorise the equivalent pinhole camera of a window, and measure its error (paper, Algorithm 1)."""
    camera = factorise(fit_projection(grid.enu, grid.pixels))
    difference = camera.project(grid.enu) - grid.pixels
    return EquivalentPinhole(camera, EquivalentError.of(difference, predicted_error(camera, grid)))


@dataclass(frozen=True)
class RefinedPinhole(Record):
    """A zero-skew camera, the map M from its image's pixels to the original's, that image's size, and its error."""

    camera: PinholeCamera
    to_original: RefinementMap
    size: Tuple[Count, Count]
    error: EquivalentError

    @classmethod
    def read(cls, values: Mapping[str, object], terrain: Callable[[], Optional[Terrain]]) -> RefinedPinhole:
        """From JSON; ``terrain`` gives what a terrain-aware refinement needs. Raises Misfit."""
        camera = typed(PinholeCamera, values.get("camera"))
        return cls.from_mapping({**values, "to_original": map_from_mapping(values.get("to_original"), camera, terrain)})

    def shaken(self, jitter: Optional[Jitter]) -> RefinedPinhole:
        """The same refined image, of an original that has jitter."""
        if jitter is None or isinstance(self.to_original, JitteredMap):
            return self
        return replace(self, to_original=JitteredMap(self.to_original, jitter))


def surface_grid(terrain: Terrain, window: Sequence[float], parameters: VirtualGridParameters) -> VirtualGrid:
    """Ground points near a surface, over a window: a terrain-aware camera must be exact there."""
    columns, rows, levels = parameters.scene
    col, row, width, height = window
    across, down = np.linspace(col, col + width - 1, columns), np.linspace(row, row + height - 1, rows)
    pixels = np.stack(np.meshgrid(across, down, indexing="ij"), axis=-1)[:, :, None]
    near = np.linspace(-parameters.near_surface_m, parameters.near_surface_m, levels)
    ground = terrain.seen_at(pixels, near)
    spread = np.broadcast_to(pixels, ground.shape[:3] + (2,)).reshape(-1, 2)
    return _localised(spread, ground.reshape(-1, 3), terrain.frame)


def refine_pinhole(
    model: str,
    camera: PinholeCamera,
    grid: VirtualGrid,
    *,
    window: Sequence[float],
    order: int = 2,
    terrain: Optional[Terrain] = None,
    parameters: VirtualGridParameters = VIRTUAL_GRID,
) -> RefinedPinhole:
    """Find M for a window, and place the refined image so that it holds all of the window (paper, Algorithm 2).

    The error is measured in original pixels: M(p') against p, where p' is the zero-skew camera's pixel of a ground
    point and p the RPC's; over ``grid``, or for the ``terrain`` model over points near its surface.
    """
    straight = camera.without_skew()
    to_original: RefinementMap
    if model == "terrain":
        if terrain is None:
            raise OptionError("MODEL", model, "needs a surface: give a DEM")
        to_original = TerrainMap(straight, terrain)
        grid = surface_grid(terrain, window, parameters)
        refined = straight.project(grid.enu)
    else:
        refined = straight.project(grid.enu)
        affinity = camera.K @ np.linalg.inv(straight.K)
        to_original = fit_map(model, refined, grid.pixels, affinity, order)
    difference = to_original.original_from_refined(refined) - grid.pixels
    error = EquivalentError.of(difference, predicted_error(straight, grid))
    col, row, width, height = window
    border = ring(np.linspace(col, col + width - 1, 9), np.linspace(row, row + height - 1, 9))
    corners = to_original.refined_from_original(border)
    low, high = whole_pixels(corners.min(axis=0), corners.max(axis=0))
    if not np.isfinite([low, high]).all():
        raise RpcInvalidError("the RPC gives no refinement that can be inverted: use the image's own RPC.")
    size = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
    return RefinedPinhole(straight.moved(*low), to_original.moved(*low), size, error)
