"""What views show of a surface: which cells each one sees, at which pixels, and how bright they are there."""

from __future__ import annotations

import math
from functools import partial
from typing import Callable, Iterator, List, Optional, Protocol, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray, FloatImage, Floats, Mask, Window
from ..contracts.errors import RpcInvalidError
from ..geometry.cell_grid import CellGrid
from ..geometry.footprints import ray_slope
from ..geometry.frames import geodetic_from_projected
from ..geometry.interpolation import on_lattice
from ..imagery.raster import opened_masked
from ..imagery.warping import sample_source
from ..scene import Scene, View
from .parameters import FUSION, VisibilityParameters


class Camera(Protocol):
    """What takes longitude, latitude and height (..., 3) to an image's column and row (..., 2)."""

    def project(self, lon_lat_h: FloatArray) -> FloatArray: ...


def nadir_first(scene: Scene) -> List[View]:
    """The views, the most vertical one first."""
    centre = np.array([scene.frame.lon, scene.frame.lat])
    altitude = sum(scene.altitudes) / 2
    return sorted(scene.views, key=lambda view: float(np.linalg.norm(ray_slope(view, centre, altitude))))


def orthophoto(
    views: Sequence[View],
    grid: CellGrid,
    height: Floats,
    crs: str,
    parameters: VisibilityParameters = FUSION.visibility,
    seen: Optional[Callable[[View], Mask]] = None,
    kernel: str = "bilinear",
) -> FloatImage:
    """Intensity of each cell from the first of ``views`` that sees it; NaN where none does, or without a height.

    ``seen`` says which cells a view sees, where more of the surface is known than the grid; without it, only objects on
    the grid hide cells. ``kernel`` is how pixels are interpolated.
    """
    result = np.full(grid.shape, np.nan, dtype=np.float32)
    if not np.isfinite(height).any():
        return result
    for view in views:
        open_cells = np.isnan(result) & np.isfinite(height)
        if not open_cells.any():
            break
        with opened_masked(view.image, view.mask) as dataset:
            pixels = pixels_on(view, grid, height, crs, parameters)
            values = sample_source(dataset, view.band, pixels, kernel)
        open_cells &= np.isfinite(values)
        if open_cells.any():  # the visibility test takes longest
            open_cells &= (
                seen(view)
                if seen
                else ~blocked(slope_over(view, grid, height, crs), grid, height, parameters.clearance_m)
            )
            result = np.where(open_cells, values, result)
    return result


def pixels_on(
    camera: Camera,
    grid: CellGrid,
    height: Floats,
    crs: str,
    parameters: VisibilityParameters = FUSION.visibility,
    altitudes: Optional[Altitudes] = None,
) -> FloatArray:
    """(H, W, 2) pixels of the cells: exact at two ``altitudes`` (m, those of the heights where None is given) on the
    lattices of squares that are fixed on the ground, linear between."""
    low, high = altitudes or (float(np.nanmin(height)), float(np.nanmax(height)))
    high += 1.0

    def project(xy: FloatArray, altitude: float) -> FloatArray:
        lon_lat = geodetic_from_projected(crs, xy)
        return camera.project(np.concatenate([lon_lat, np.full(lon_lat.shape[:2] + (1,), altitude)], axis=-1))

    result = np.empty((*grid.shape, 2))
    share = np.nan_to_num((height - low) / (high - low), nan=-1e6)[..., None]
    nodes = (parameters.nodes, parameters.nodes)
    for square, place, inner in _squares(grid, parameters.square_cells):
        at_low, at_high = (
            on_lattice(*square.centres(), partial(project, altitude=z), nodes)[inner] for z in (low, high)
        )
        result[place] = at_low + share[place] * (at_high - at_low)
    return result


def _squares(grid: CellGrid, side: int) -> Iterator[Tuple[CellGrid, Tuple[slice, slice], Tuple[slice, slice]]]:
    """The squares of cells, whole multiples of their side on the ground, that a grid has parts of; which part that is,
    in the grid and in the square."""
    first_column, first_row = math.floor(grid.west / grid.cell + 0.5), -math.floor(grid.north / grid.cell + 0.5)
    east, north = grid.west - first_column * grid.cell, grid.north + first_row * grid.cell  # of a grid off the lattice
    rows, columns = grid.shape
    whole = Window(0, 0, columns, rows)
    for row in range(math.floor(first_row / side) * side, first_row + rows, side):
        for column in range(math.floor(first_column / side) * side, first_column + columns, side):
            square = CellGrid(column * grid.cell + east, -row * grid.cell + north, grid.cell, (side, side))
            place = Window(column - first_column, row - first_row, side, side)
            common = place.common(whole)
            if common is not None:
                yield square, common.inside(whole), common.inside(place)


def slope_over(view: View, grid: CellGrid, height: Floats, crs: str) -> FloatArray:
    """:func:`line_of_sight` over the middle of some cells."""
    xs, ys = grid.centres()
    centre = geodetic_from_projected(crs, np.array([xs[len(xs) // 2], ys[len(ys) // 2]]))
    return line_of_sight(view, centre, float(np.nanmedian(height)))


def line_of_sight(view: View, lon_lat: FloatArray, altitude: float) -> FloatArray:
    """(2,) how far a view's line of sight goes east and north, m for each m up; raises RpcInvalidError where its model
    has none there."""
    slope = ray_slope(view, lon_lat, altitude)
    if not np.isfinite(slope).all():
        raise RpcInvalidError(
            f"The RPC of '{view.image}' has no line of sight over the surface: use the image's own RPC."
        )
    return slope


def blocked(
    slope: FloatArray, grid: CellGrid, height: Floats, clearance_m: float, most_cells: Optional[int] = None
) -> Mask:
    """(H, W) cells whose ray to the satellite meets a higher part of the surface on its way up; ``slope`` is as of
    :func:`slope_over`. Objects more than ``most_cells`` away block nothing."""
    blocked = np.zeros(grid.shape, dtype=bool)
    for here, there, rise in _way_up(slope, grid, height, most_cells):
        ray = height[here] + rise + clearance_m
        with np.errstate(invalid="ignore"):
            blocked[here] |= height[there] > ray
    return blocked


def horizon(slope: FloatArray, grid: CellGrid, height: Floats, most_cells: Optional[int] = None) -> Floats:
    """(H, W) the height below which the surface around a cell hides a point of it, in the unit of the heights; that of
    the lowest cell where nothing does. Arguments as of :func:`blocked`; unlike its answer, it lies smoothly between
    cells."""
    known = np.where(np.isfinite(height), height, -np.inf)
    found = np.full(grid.shape, float(np.nanmin(height)))
    for here, there, rise in _way_up(slope, grid, height, most_cells):
        np.maximum(found[here], known[there] - rise, out=found[here])
    return found


def _way_up(
    slope: FloatArray, grid: CellGrid, height: Floats, most_cells: Optional[int]
) -> Iterator[Tuple[Tuple[slice, slice], Tuple[slice, slice], float]]:
    """Step by step towards the satellite: some cells, those over which their rays pass, and by how much these rise."""
    steepness = float(np.linalg.norm(slope))
    relief = float(np.nanmax(height) - np.nanmin(height))
    reach = int(relief * steepness / grid.cell) + 1
    if steepness < 1e-3:
        return
    rows, columns = grid.shape
    for step in range(1, min(reach, most_cells or max(rows, columns)) + 1):
        # One cell nearer to the satellite, the ray is cell / steepness metres higher.
        dc = int(round(step * slope[0] / steepness))
        dr = -int(round(step * slope[1] / steepness))
        r0, r1 = max(0, -dr), min(rows, rows - dr)
        c0, c1 = max(0, -dc), min(columns, columns - dc)
        if r0 >= r1 or c0 >= c1:
            return
        here, there = (slice(r0, r1), slice(c0, c1)), (slice(r0 + dr, r1 + dr), slice(c0 + dc, c1 + dc))
        yield here, there, math.hypot(dr, dc) * grid.cell / steepness
