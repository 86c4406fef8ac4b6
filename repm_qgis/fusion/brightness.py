"""How bright the cells of a DSM are: the median of several views, so that a shadow that moved counts for little.

Neither the block in which cells are asked for nor its place has a part in their brightness: views have one range for
the whole scene, and what is interpolated lies on a lattice that is fixed on the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Iterator, List, Tuple

import numpy as np

from ..arrays import Altitudes, FloatArray, FloatImage, Window
from ..geometry.cell_grid import CellGrid
from ..geometry.footprints import ray_slope
from ..geometry.frames import geodetic_from_projected
from ..geometry.interpolation import on_lattice
from ..geometry.tiles import pixel_window
from ..imagery.enhancement import Stretch, view_stretch
from ..imagery.parameters import STRETCH, StretchParameters
from ..imagery.raster import opened_masked
from ..imagery.sampling import median_of_known
from ..imagery.warping import sample_source
from ..scene import Scene, View
from .parameters import FUSION, BrightnessParameters
from .visible import blocked, nadir_first


@dataclass(frozen=True)
class Witnesses:
    """The views that tell how bright cells are, the most vertical ones first, with their stretches and how far their
    lines of sight go sideways (m east and north for each m up); the scene's CRS of cells, and its altitudes."""

    views: Tuple[View, ...]
    stretches: Tuple[Stretch, ...]
    slopes: Tuple[FloatArray, ...]
    crs: str
    altitudes: Altitudes

    @classmethod
    def of(cls, scene: Scene, crs: str, parameters: StretchParameters = STRETCH) -> Witnesses:
        """All views of a scene whose images are there; raises ImageError where one cannot be read."""
        views = tuple(view for view in nadir_first(scene) if not view.missing)
        place, level = np.array([scene.frame.lon, scene.frame.lat]), sum(scene.altitudes) / 2
        stretches = tuple(view_stretch(v.image, v.band, v.mask, parameters, v.part) for v in views)
        return cls(views, stretches, tuple(ray_slope(view, place, level) for view in views), crs, scene.altitudes)


def brightness(
    witnesses: Witnesses, grid: CellGrid, height: FloatImage, parameters: BrightnessParameters = FUSION.brightness
) -> FloatImage:
    """(H, W) brightness of cells with their heights (m above the ellipsoid): 0 to 1 is the range of nearly all pixels
    of a view. NaN is unknown.

    The first views that show the grid are taken, as many as the parameters say; each counts where it sees a cell past
    all that stands higher within ``hidden_cells`` of it.
    """
    nothing = np.full(grid.shape, np.nan, np.float32)
    known = np.isfinite(height)
    if not known.any():
        return nothing
    seen: List[FloatImage] = []
    to_geodetic = partial(geodetic_from_projected, witnesses.crs)
    for view, stretch, slope in zip(witnesses.views, witnesses.stretches, witnesses.slopes):
        if len(seen) == parameters.views:
            break
        if pixel_window(view.project, to_geodetic, grid.bounds, witnesses.altitudes, view.size, smallest=1) is None:
            continue
        with opened_masked(view.image, view.mask) as dataset:
            # OpenCV resamples at 32nds of a pixel, counted from the window that is read: these are the same in any.
            pixels = np.round(_pixels_on(view, witnesses, grid, height, parameters) * 32) / 32
            values = sample_source(dataset, view.band, pixels, "bilinear")
        hidden = blocked(slope, grid, height, parameters.clearance_m, parameters.hidden_cells)
        light = (values - np.float32(stretch.low)) / np.float32(stretch.high - stretch.low)
        seen.append(np.where(known & ~hidden, light, np.float32(np.nan)))
    return median_of_known(np.stack(seen)) if seen else nothing


def _pixels_on(
    view: View, witnesses: Witnesses, grid: CellGrid, height: FloatImage, parameters: BrightnessParameters
) -> FloatArray:
    """(H, W, 2) pixels of the cells: exact at two altitudes on the lattice of each square of cells, linear between."""
    low, high = witnesses.altitudes[0], witnesses.altitudes[1] + 1.0

    def project(xy: FloatArray, altitude: float) -> FloatArray:
        lon_lat = geodetic_from_projected(witnesses.crs, xy)
        return view.project(np.concatenate([lon_lat, np.full(lon_lat.shape[:2] + (1,), altitude)], axis=-1))

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
    first_column, first_row = round(grid.west / grid.cell), -round(grid.north / grid.cell)
    rows, columns = grid.shape
    for row in range(math.floor(first_row / side) * side, first_row + rows, side):
        for column in range(math.floor(first_column / side) * side, first_column + columns, side):
            square = CellGrid(column * grid.cell, -row * grid.cell, grid.cell, (side, side))
            whole = Window(column - first_column, row - first_row, side, side)
            common = whole.common(Window(0, 0, columns, rows))
            if common is not None:
                yield square, common.inside(Window(0, 0, columns, rows)), common.inside(whole)
