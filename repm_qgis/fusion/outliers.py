"""Outliers removed: isolated points of a height map, and cells with few neighbours (paper, "DSMs aggregation")."""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from ..contracts.arrays import Floats, Mask
from .parameters import FUSION, IsolatedPointParameters, OutlierParameters


def remove_isolated_points(
    height: Floats, metres_per_px: float, parameters: IsolatedPointParameters = FUSION.isolated
) -> Floats:
    """The (H, W) heights, NaN where too few of the eight neighbours belong to the same surface.

    Matching leaves none, because it removes speckles by disparity. This is for height maps of other origin and damaged
    ones, and for cells with so few points that the others do not outvote an isolated one.
    """
    z = np.pad(height.astype(np.float64), 1, constant_values=np.nan)
    count = np.zeros(height.shape, np.uint8)
    rows, columns = height.shape
    tolerance = parameters.tolerance_px * metres_per_px
    centre = z[1:-1, 1:-1]
    with np.errstate(invalid="ignore"):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):  # each pair of neighbours once
            near = np.abs(z[1 + down : 1 + down + rows, 1 + right : 1 + right + columns] - centre) <= tolerance
            count += near
            here = near[: rows - down, max(-right, 0) : columns - max(right, 0)]
            count[down:, max(right, 0) : columns + min(right, 0)] += here
    return np.where(count >= parameters.neighbours, height, np.nan)


def needed_neighbours(cell: float, radius: float, parameters: OutlierParameters = FUSION.outliers) -> int:
    """How many neighbours a cell needs within a radius (m): a share of all cells there."""
    return max(parameters.neighbours, round(parameters.share * len(_disc(cell, radius))))


def radius_outliers(
    height: Floats, cell: float, radius: float, parameters: OutlierParameters = FUSION.outliers
) -> Mask:
    """Cells with too few neighbours within ``radius`` metres.

    Neighbours count on a disc of that radius where they differ by no more than the radius in height: in a ball, a
    steep slope would have fewer neighbours than level ground.
    """
    disc = _disc(cell, radius)
    reach = max(max(map(abs, place)) for place in disc) if disc else 0
    rows, columns = height.shape
    neighbours = np.zeros(height.shape, dtype=np.uint16)
    padded = np.pad(height, reach, constant_values=np.nan)
    for dr, dc in disc:
        other = padded[reach + dr : reach + dr + rows, reach + dc : reach + dc + columns]
        with np.errstate(invalid="ignore"):
            neighbours += np.abs(other - height) <= radius
    isolated: Mask = np.isfinite(height) & (neighbours < needed_neighbours(cell, radius, parameters))
    return isolated


def _disc(cell: float, radius: float) -> List[Tuple[int, int]]:
    """The rows and columns to the cells within a radius of a cell."""
    reach = max(1, int(radius / cell))
    places = [(row, column) for row in range(-reach, reach + 1) for column in range(-reach, reach + 1)]
    return [place for place in places if any(place) and math.hypot(*place) * cell <= radius + 1e-9]
