"""Which points of the height maps are in the cloud: those on the DSM, and those on the walls between its cells.

A cell has one height, that of a roof or of the ground before it. A point of the facade between them lies metres from
both. It is kept if it lies between the lowest and the highest of the cells around it, farther from each than the error
of matching, and if the height map has neighbours there: wrong matches in mid-air are isolated.
"""

from __future__ import annotations

from typing import List, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Floats, IntArray, Mask
from ..fusion.outliers import remove_isolated_points
from ..fusion.parameters import FUSION, IsolatedPointParameters
from ..geometry.cell_grid import CellGrid
from ..stereo.height_maps import HeightMap
from .normals import normals
from .parameters import SOLIDS, CloudParameters


def cloud_points(
    heights: HeightMap,
    metres_per_px: float,
    grid: CellGrid,
    *,
    surface: Floats,
    own: Mask,
    with_normals: bool = False,
    parameters: CloudParameters = SOLIDS.cloud,
    isolated: IsolatedPointParameters = FUSION.isolated,
) -> FloatArray:
    """(N, 4) x, y, height, score of a map's matched points that lie on the DSM or on its walls; (N, 7) with the unit
    normal east, north, up where that is wanted.

    Parameters
    ----------
    heights, metres_per_px : the height map, and how many metres of height a px of disparity is in it.
    grid, surface : the DSM's cells and their heights (rows, columns), NaN where there are none. They should reach
        ``parameters.wall_cells`` beyond the cells that have points, because walls are known from both sides.
    own : (rows, columns) the cells that have points.
    """
    points, wall = _kept(heights, metres_per_px, grid, surface, own, parameters, isolated)
    if not with_normals:
        return points
    return np.column_stack([points, normals(points[:, :3], wall, heights.ray, parameters)])


def _kept(
    heights: HeightMap,
    scale: float,
    grid: CellGrid,
    height: Floats,
    own: Mask,
    parameters: CloudParameters,
    isolated: IsolatedPointParameters,
) -> Tuple[FloatArray, Mask]:
    """(N, 4) the points of the map that are kept, and which of them lie on walls."""
    matched = np.where(heights.filled, np.nan, heights.height)
    continued = np.isfinite(remove_isolated_points(matched, scale, isolated))
    known = np.flatnonzero(np.isfinite(matched))
    x, y, z, score = (part.ravel()[known] for part in (heights.x, heights.y, matched, heights.score))
    row, column, inside = grid.cells_of(x, y)
    inside[inside] = own[row[inside], column[inside]]
    points = np.column_stack([x, y, z, score])[inside]
    z, row, column, continued = z[inside], row[inside], column[inside], continued.ravel()[known][inside]
    with np.errstate(invalid="ignore"):
        surface = np.abs(z - height[row, column]) <= parameters.surface_px * scale
    other = np.flatnonzero(~surface & continued)
    low, high = _around(height, row[other], column[other], parameters.wall_cells)
    margin = parameters.wall_px * scale
    wall = np.zeros(len(z), dtype=bool)
    wall[other] = (z[other] >= low + margin) & (z[other] <= high - margin)
    kept = surface | wall
    return points[kept], wall[kept]


def _around(height: Floats, row: IntArray, column: IntArray, reach: int) -> Tuple[FloatArray, FloatArray]:
    """(N,) the lowest and the highest of the cells up to ``reach`` rows and columns away; NaN where none is known."""
    low, high = (np.full(row.shape, np.nan) for _ in range(2))
    offsets: List[int] = list(range(-reach, reach + 1))
    for down in offsets:
        for right in offsets:
            r, c = row + down, column + right
            there = (r >= 0) & (r < height.shape[0]) & (c >= 0) & (c < height.shape[1])
            near = height[r[there], c[there]]
            low[there], high[there] = np.fmin(low[there], near), np.fmax(high[there], near)
    return low, high
