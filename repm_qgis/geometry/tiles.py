"""Tiles on the ground, and the windows of the images that see them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import Altitudes, Bounds, FloatArray, Size, Window
from .footprints import box


@dataclass(frozen=True)
class GroundTile:
    """A rectangle of the scene's CRS; tiles share borders and do not overlap: matching adds its own margin."""

    id: str
    bounds: Bounds


def enclosing(boxes: Sequence[Bounds]) -> Bounds:
    """The rectangle around rectangles (at least one)."""
    xmin, ymin, xmax, ymax = zip(*boxes)
    return Bounds(min(xmin), min(ymin), max(xmax), max(ymax))


def lay_tiles(area: ogr.Geometry, size_m: float) -> List[GroundTile]:
    """Cover an area with equal rectangles of at most ``size_m`` a side, rounded up to whole metres.

    Those outside the area are omitted. Rows count from the north, columns from the west.
    """
    xmin, xmax, ymin, ymax = area.GetEnvelope()
    columns = max(1, math.ceil((xmax - xmin) / size_m - 1e-9))
    rows = max(1, math.ceil((ymax - ymin) / size_m - 1e-9))
    # Whole metres keep the borders on cell borders for the usual resolutions.
    west, north = math.floor(xmin), math.ceil(ymax)
    width, height = math.ceil((xmax - west) / columns), math.ceil((north - ymin) / rows)
    tiles = []
    for i in range(rows):
        for j in range(columns):
            top, left = float(north - i * height), float(west + j * width)
            bounds = Bounds(left, top - height, left + width, top)
            if box(bounds).Intersects(area):
                tiles.append(GroundTile(f"r{i:03d}c{j:03d}", bounds))
    return tiles


def pixel_window(
    project: Callable[[FloatArray], FloatArray],
    to_geodetic: Callable[[FloatArray], FloatArray],
    bounds: Bounds,
    *,
    altitudes: Altitudes,
    size: Size,
    margin: int = 0,
    smallest: int = 48,
) -> Optional[Window]:
    """The window of an image that shows a ground rectangle at all altitudes of a range.

    ``project`` maps (N, 3) longitude, latitude, height to pixels, ``to_geodetic`` (N, 2) x, y to longitude, latitude.
    None where it has fewer than ``smallest`` px a side inside the image.
    """
    u = np.linspace(bounds[0], bounds[2], 5)
    v = np.linspace(bounds[1], bounds[3], 5)
    xy = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    lon_lat = to_geodetic(xy)
    pixels = np.concatenate([project(np.column_stack([lon_lat, np.full(len(xy), h)])) for h in altitudes])
    if not np.isfinite(pixels).all():
        return None
    low = np.maximum(np.floor(pixels.min(axis=0)) - margin, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)) + margin + 1, size)
    if (high - low < smallest).any():
        return None
    return Window.spanning(int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def largest_within(budget: float, sizes: Sequence[int], error_of: Callable[[int], float]) -> Tuple[int, float]:
    """The largest of descending ``sizes`` whose error is within the budget, with that error; else the smallest."""
    error = math.inf
    for size in sizes:
        error = error_of(size)
        if error <= budget:
            return size, error
    return sizes[-1], error
