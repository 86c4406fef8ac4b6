"""Which points of the height maps are in the cloud: those on the DSM, and those on the walls between its cells.

A cell has one height, that of a roof or of the ground before it. A point of the facade between them lies metres from
both. It is kept if it lies between the lowest and the highest of the cells around it, farther from each than matching
errs, and if the height map goes on there: wrong matches in mid-air stand alone.
"""

from __future__ import annotations

from typing import List, Sequence, Tuple

import numpy as np

from ..arrays import FloatArray, Floats, IntArray, Mask
from ..geometry.cell_grid import CellGrid
from ..stereo.height_maps import HeightMap, HeightSource
from .normals import normals
from .outliers import remove_isolated_points
from .parameters import FUSION, FusionParameters


def cloud_points(
    sources: Sequence[HeightSource],
    metres_per_px: Sequence[float],
    grid: CellGrid,
    height: Floats,
    own: Mask,
    with_normals: bool = False,
    parameters: FusionParameters = FUSION,
) -> FloatArray:
    """(N, 4) x, y, height, score of all matched points that lie on the fused surface or on its walls; (N, 7) with the
    unit normal east, north, up where that is wanted.

    Parameters
    ----------
    sources, metres_per_px : the height maps, and how many metres of height a px of disparity is in each.
    grid, height : the fused cells and their heights (rows, columns), NaN where there are none. They should reach
        ``parameters.cloud.wall_cells`` beyond the cells that have points, because walls are known from both sides.
    own : (rows, columns) the cells that have points.

    Raises SceneError where a height map is missing or damaged.
    """
    parts = [np.empty((0, 7 if with_normals else 4))]
    for source, scale in zip(sources, metres_per_px):
        heights = source.within()
        points, wall = _of_map(heights, scale, grid, height, own, parameters)
        if with_normals:
            points = np.column_stack([points, normals(points[:, :3], wall, heights.ray, parameters.cloud)])
        parts.append(points)
    return np.concatenate(parts)


def _of_map(
    heights: HeightMap, scale: float, grid: CellGrid, height: Floats, own: Mask, parameters: FusionParameters
) -> Tuple[FloatArray, Mask]:
    """(N, 4) the points of one map that are kept, and which of them lie on walls."""
    matched = np.where(heights.filled, np.nan, heights.height)
    continued = np.isfinite(remove_isolated_points(matched, scale, parameters.isolated))
    known = np.flatnonzero(np.isfinite(matched))
    x, y, z, score = (part.ravel()[known] for part in (heights.x, heights.y, matched, heights.score))
    row, column, inside = grid.cells_of(x, y)
    inside[inside] = own[row[inside], column[inside]]
    points = np.column_stack([x, y, z, score])[inside]
    z, row, column, continued = z[inside], row[inside], column[inside], continued.ravel()[known][inside]
    with np.errstate(invalid="ignore"):
        surface = np.abs(z - height[row, column]) <= parameters.cloud.surface_px * scale
    other = np.flatnonzero(~surface & continued)
    low, high = _around(height, row[other], column[other], parameters.cloud.wall_cells)
    margin = parameters.cloud.wall_px * scale
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
