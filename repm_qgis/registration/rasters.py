"""Rasters as references: their cells, or means of many of them where they are finer than the scene's own surface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from ..contracts.arrays import Bounds, FloatArray, Floats, IntArray, Window
from ..contracts.checks import as_text
from ..contracts.errors import ImageError, OverlapError
from ..geometry.frames import flat_crs, on_earth
from ..geometry.vertical import TAG, stated_datum
from ..imagery.heights import read_heights
from ..imagery.raster import opened
from .found import FoundHeights, no_heights, places_unit
from .parameters import REGISTRATION

_STRIP_CELLS = 1 << 24  # of the raster that are read at once
_REACHES = (1, 2, 4)  # cells to each side that a plane is fitted to, where neighbours are unknown


def read_raster(
    path: str, crs: str, bounds: Bounds, least_m: float, check: Callable[[], None] = lambda: None
) -> FoundHeights:
    """The heights of a raster within bounds of the scene's projected CRS.

    Cells smaller than ``least_m`` are averaged in blocks of whole cells, those without heights left out; a block needs
    half of its cells. Heights become metres, whatever unit, scale and offset the band has. ``check`` is called between
    strips, and may raise to stop.

    Raises ImageError for a raster without a CRS or with heights in another unit, OverlapError where it has no heights
    within the bounds.
    """
    with opened(path) as dataset:
        if not dataset.GetProjection():
            raise ImageError(f"The reference '{path}' has no coordinate reference system: assign it one first.")
        system = on_earth(pyproj.CRS.from_wkt(as_text(dataset.GetProjection())), path)
        places_in = None if dataset.GetRasterBand(1).GetUnitType() else places_unit(system)
        datum = stated_datum(system, as_text(dataset.GetMetadataItem(TAG) or ""))
        place = dataset.GetGeoTransform()
        to_flat = pyproj.Transformer.from_crs(crs, flat_crs(system), always_xy=True)
        back = pyproj.Transformer.from_crs(flat_crs(system), crs, always_xy=True)
        window = _window(dataset, place, to_flat, bounds)
        if window is None:
            raise OverlapError(f"The reference '{path}' does not cover the scene: choose one that does.")
        jacobian = _jacobian(place, back, window)
        widths = np.hypot(*jacobian)
        factor = max(1, math.ceil(least_m / float(widths.min()) - 1e-6))
        blocks = _read_blocks(dataset, window, factor, check)
    heights, right, below = blocks.means(0.5)
    if np.isfinite(heights).sum() < REGISTRATION.sparse * (blocks.count > 0).sum():
        heights, right, below = blocks.means(0.0)  # narrow stripes, or single cells: no block has half of its cells
    rows, columns = heights.shape
    col = window.col + factor * np.arange(columns) + right
    row = window.row + factor * np.arange(rows)[:, None] + below
    x, y = _moved(back, place[0] + col * place[1] + row * place[2], place[3] + col * place[4] + row * place[5])
    slopes = slopes_of(heights, jacobian * factor)
    known = np.isfinite(heights) & np.isfinite(x) & np.isfinite(y)
    if not known.any():
        raise no_heights(path)
    xy, width = np.column_stack([x[known], y[known]]), factor * widths
    return FoundHeights(
        name=path,
        xy=xy,
        height=heights[known],
        width_m=(float(width[0]), float(width[1])),
        slopes=slopes[known],
        datum=datum,
        places_in=places_in,
    )


def _window(
    dataset: gdal.Dataset, place: Tuple[float, ...], to_flat: pyproj.Transformer, bounds: Bounds
) -> Optional[Window]:
    """The cells that bounds may need, and two more on each side; None where there are none."""
    u, v = np.linspace(bounds.xmin, bounds.xmax, 9), np.linspace(bounds.ymin, bounds.ymax, 9)
    x, y = (values.ravel() for values in _moved(to_flat, *np.meshgrid(u, v)))
    inverse = gdal.InvGeoTransform(place)
    col, row = inverse[0] + x * inverse[1] + y * inverse[2], inverse[3] + x * inverse[4] + y * inverse[5]
    good = np.isfinite(col) & np.isfinite(row)
    if not good.any():
        return None
    low = [max(math.floor(each[good].min()) - 2, 0) for each in (col, row)]
    high = [
        min(math.ceil(each[good].max()) + 2, most)
        for each, most in zip((col, row), (dataset.RasterXSize, dataset.RasterYSize))
    ]
    return Window.spanning(*low, *high) if low[0] < high[0] and low[1] < high[1] else None


def _jacobian(place: Tuple[float, ...], back: pyproj.Transformer, window: Window) -> FloatArray:
    """(2, 2) metres to the east and north (rows) for a cell to the right and a cell down (columns), at the middle."""
    col, row = window.col + window.width / 2, window.row + window.height / 2
    cells = np.array([[col, row], [col + 1, row], [col, row + 1]])
    x, y = _moved(
        back,
        place[0] + cells[:, 0] * place[1] + cells[:, 1] * place[2],
        place[3] + cells[:, 0] * place[4] + cells[:, 1] * place[5],
    )
    at = np.column_stack([x, y])
    return np.column_stack([at[1] - at[0], at[2] - at[0]])


def _moved(to: pyproj.Transformer, x: FloatArray, y: FloatArray) -> Tuple[FloatArray, FloatArray]:
    found = to.transform(x, y)
    return np.asarray(found[0]), np.asarray(found[1])


@dataclass(frozen=True)
class _Blocks:
    """Of blocks of factor x factor cells: how many are known, and the sums of their heights and of their places, in
    cells right and down from the block's corner; (rows, columns) each."""

    factor: int
    count: FloatArray
    sums: FloatArray

    def means(self, covered: float) -> FloatArray:
        """(3, rows, columns) mean heights and mean places, which in a block with gaps are not its middle; NaN where no
        more than ``covered`` of a block is known, or nothing."""
        known = (self.count >= covered * self.factor**2) & (self.count > 0)
        return np.asarray(np.where(known, self.sums / np.maximum(self.count, 1), np.nan))


def _read_blocks(dataset: gdal.Dataset, window: Window, factor: int, check: Callable[[], None]) -> _Blocks:
    """Strip by strip; the raster's overviews are not used: they may be shifted by half a cell."""
    columns, rows = window.width // factor, window.height // factor
    count, sums = np.zeros((rows, columns)), np.zeros((3, rows, columns))
    strip = max(1, _STRIP_CELLS // max(window.width * factor, 1))
    inner = np.arange(factor) + 0.5
    for begin in range(0, rows, strip):
        check()
        some = slice(begin, min(begin + strip, rows))
        number = some.stop - begin
        part = Window(window.col, window.row + begin * factor, columns * factor, number * factor)
        cells = read_heights(dataset, part).reshape(number, factor, columns, factor)
        known = np.isfinite(cells)
        by_column = known.sum(axis=1)
        count[some] = by_column.sum(axis=2)
        sums[0, some] = np.nansum(cells, axis=(1, 3), dtype=np.float64)
        sums[1, some], sums[2, some] = by_column @ inner, np.moveaxis(known.sum(axis=3), 1, 2) @ inner
    return _Blocks(factor, count, sums)


def block_means(cells: Floats, factor: int, covered: float) -> FloatArray:
    """Means of blocks of factor x factor cells, of which ``covered`` must be known (NaN: unknown)."""
    rows, columns = (count // factor for count in cells.shape)
    blocks = cells.reshape(rows, factor, columns, factor)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    total = np.nansum(blocks, axis=(1, 3), dtype=np.float64)
    return np.asarray(np.where(known >= covered * factor**2, total / np.maximum(known, 1), np.nan))


def slopes_of(heights: FloatArray, jacobian: FloatArray) -> FloatArray:
    """(rows, columns, 2) slopes to the east and north by central differences; NaN at borders and beside gaps.

    Where gaps leave most cells without (stripes, a checker pattern, sparse points), slopes are those of planes through
    the known cells around, NaN where these determine none.
    """
    right, down = np.full(heights.shape, np.nan), np.full(heights.shape, np.nan)
    right[:, 1:-1] = (heights[:, 2:] - heights[:, :-2]) / 2
    down[1:-1] = (heights[2:] - heights[:-2]) / 2
    known = np.isfinite(heights)
    without = known & ~(np.isfinite(right) & np.isfinite(down))
    for reach in _REACHES if without.sum() > REGISTRATION.known_slopes * known.sum() else ():
        rows, columns = np.nonzero(without)
        right[rows, columns], down[rows, columns] = _planes(heights, rows, columns, reach)
        without &= ~np.isfinite(right)
    slopes: FloatArray = np.stack([right, down], axis=-1) @ np.linalg.inv(jacobian)
    return slopes


def _planes(heights: FloatArray, rows: IntArray, columns: IntArray, reach: int) -> Tuple[FloatArray, FloatArray]:
    """Slopes to the right and down, m per cell, of planes through the known cells of squares around (N,) cells; NaN
    where these lie on a line."""
    padded, middle = np.pad(heights, reach, constant_values=np.nan), heights[rows, columns]
    sums = np.zeros((9, len(rows)))
    for v, u in np.ndindex(2 * reach + 1, 2 * reach + 1):
        z = padded[rows + v, columns + u] - middle
        known = np.isfinite(z)
        x, y, z = float(u - reach), float(v - reach), np.where(known, z, 0.0)
        for total, part in zip(sums, (1.0, x, y, x * x, x * y, y * y)):
            total += part * known
        for total, part in zip(sums[6:], (1.0, x, y)):
            total += part * z
    n, x, y, xx, xy, yy, z, xz, yz = sums
    a, b, c = xx - x * x / n, xy - x * y / n, yy - y * y / n
    p, q, determinant = xz - x * z / n, yz - y * z / n, a * c - b * b
    least = (a + c - np.hypot(a - c, 2.0 * b)) / 2.0  # eigenvalue: how far the cells spread across their own line
    flat = least < 1.0
    determinant = np.where(flat, np.nan, determinant)
    return (c * p - b * q) / determinant, (a * q - b * p) / determinant
