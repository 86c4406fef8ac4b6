"""Ground that is steeper than the search for objects allows: there a terrain is cut, and hillsides become buildings.

A wall is a step, and beside it the roof and the ground go on as level as they were. A hillside rises the same way from
cell to cell over tens of metres. So ground is as steep as the gradients around a place are in all directions but for a
share of them: walls, crowns and the opposite slopes of a roof have gradients of their own, and level parts between
them. This is the quantile of a rank filter, as the median is (Huber 1981, "Robust Statistics").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import FloatImage, Mask, Window
from ..contracts.findings import Finding
from ..imagery.cell_polygons import burned
from ..imagery.heights import read_heights
from ..imagery.raster import opened
from ..imagery.sampling import neighbours, quantile_of_known
from .inputs import Surface
from .parameters import TERRAIN, SteepnessParameters

_STEEPEST = 300  # that SLOPE may be, %
_STRIP = 64  # coarse rows that are looked at together


@dataclass(frozen=True)
class Slopes:
    """Of a DSM's ground in coarse cells, (rows, columns), NaN where they are not known: ``height`` (m), the ``slope``
    (m per m) that most gradients around a cell have at least, and the ``usual`` one, their median; ``transform`` is
    GDAL's geotransform of these cells."""

    height: FloatImage
    slope: FloatImage
    usual: FloatImage
    transform: Tuple[float, ...]

    def steeper(self, slope: float) -> Mask:
        """Where the ground is steeper than this, m per m."""
        with np.errstate(invalid="ignore"):
            result: Mask = self.slope > slope
        return result


def slopes_of(
    surface: Surface,
    check: Callable[[], None] = lambda: None,
    parameters: SteepnessParameters = TERRAIN.steepness,
) -> Slopes:
    """Look at a DSM in coarse cells; ``check`` is called now and then. Raises ImageError for a damaged file."""
    factor = max(1, round(parameters.cell_m / surface.cell))
    columns, rows = (-(-count // factor) for count in surface.size)
    height = _reduced(surface.path, (columns, rows), factor, check)
    slope, usual = np.full((2, rows, columns), np.nan, np.float32)
    reduced, cell = height, factor * surface.cell
    for scale in range(parameters.scales):
        check()
        square = np.ones((1 << scale, 1 << scale), np.float32)
        own, middle = (np.kron(part, square)[:rows, :columns] for part in _slopes(reduced, cell, parameters))
        steeper = own > np.nan_to_num(slope, nan=-1.0)
        slope, usual = np.where(steeper, own, slope), np.where(steeper, middle, usual)
        reduced, cell = _means(reduced, 2), 2 * cell
    for whole in (slope, usual):
        whole[~np.isfinite(height)] = np.nan
    x0, dx, rx, y0, ry, dy = surface.transform
    return Slopes(height, slope, usual, (x0, dx * factor, rx * factor, y0, ry * factor, dy * factor))


def _slopes(height: FloatImage, cell: float, parameters: SteepnessParameters) -> Tuple[FloatImage, FloatImage]:
    """The slope and the usual one of heights on cells of so many metres, see :class:`Slopes`."""
    gradients = [_gradient(height, axis) / np.float32(cell) for axis in (1, 0)]
    slope, usual = (np.full(height.shape, np.nan, np.float32) for _ in range(2))
    margin, rows = parameters.window // 2, height.shape[0]
    for top in range(0, rows, _STRIP):
        first, last = max(top - margin, 0), min(top + _STRIP + margin, rows)
        found = [_ranked(part[first:last], parameters) for part in gradients]
        own = slice(top - first, top - first + _STRIP)
        for whole, parts in zip((slope, usual), zip(*found)):
            whole[top : top + _STRIP] = np.hypot(*(part[own] for part in parts))
    return slope, usual


def _ranked(gradient: FloatImage, parameters: SteepnessParameters) -> Tuple[FloatImage, FloatImage]:
    """Of the gradients around each cell along one axis: what all but a share exceed on the side of zero that they lie
    (0 where they lie on both), and their median."""
    least = math.ceil(parameters.least_share * parameters.window**2)
    stack = neighbours(gradient, parameters.window)
    low, middle, high = (
        quantile_of_known(stack, share, least) for share in (parameters.others, 0.5, 1 - parameters.others)
    )
    with np.errstate(invalid="ignore"):
        inner = np.where(low > 0, low, np.where(high < 0, high, low * np.float32(0)))
    return inner, middle


def _reduced(path: str, size: Tuple[int, int], factor: int, check: Callable[[], None]) -> FloatImage:
    """Means of the known heights of ``factor`` x ``factor`` cells of a raster, m, (rows, columns) for a ``size`` of
    columns and rows; the last ones are those of fewer cells."""
    result = np.full(size[::-1], np.nan, np.float32)
    with opened(path) as dataset:
        across, down = dataset.RasterXSize, dataset.RasterYSize
        for top in range(0, size[1], _STRIP):
            check()
            count = min(_STRIP, size[1] - top)
            window = Window(0, top * factor, across, min(count * factor, down - top * factor))
            result[top : top + count] = _means(read_heights(dataset, window), factor)
    return result


def _means(height: FloatImage, factor: int) -> FloatImage:
    """Means of the known heights of ``factor`` x ``factor`` cells, the last ones of fewer."""
    rows, columns = (-(-count // factor) for count in height.shape)
    cells = np.full((rows * factor, columns * factor), np.nan, np.float32)
    cells[: height.shape[0], : height.shape[1]] = height
    blocks = cells.reshape(rows, factor, columns, factor)
    known = np.isfinite(blocks)
    total = np.where(known, blocks, 0).sum(axis=(1, 3), dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        means: FloatImage = (total / known.sum(axis=(1, 3))).astype(np.float32)
    return means


def _gradient(height: FloatImage, axis: int) -> FloatImage:
    """The difference to the next cell, m; NaN where one of the two is not known, and at the end."""
    result = np.full(height.shape, np.nan, np.float32)
    result[(slice(None),) * axis + (slice(None, -1),)] = np.diff(height, axis=axis)
    return result


@dataclass(frozen=True)
class Cut:
    """What a terrain lacks: the ``percent`` of a DSM's heights that lie on ground steeper than the search allowed and
    are objects all the same, the ``deepest`` of these cuts (m), and the ``slope`` (m per m) that nearly all of this
    ground keeps to."""

    percent: float
    deepest: float
    slope: float

    def finding(self, searched: float) -> Finding:
        """What is wrong, of a search with this steepest slope (m per m), and what to do."""
        better = min(10 * math.ceil(10 * self.slope + 0.5), _STEEPEST)
        return Finding(
            "terrain-cut",
            f"{self.percent:.1f} % of the DSM's heights lie on ground steeper than SLOPE ({100 * searched:g} %) and "
            f"count as objects: the terrain is cut there, by up to {self.deepest:.0f} m. Choose SLOPE={better} or a "
            "smaller LARGEST, or leave such ground out.",
            "doubt",
        )


def cut_of(
    slopes: Slopes,
    surface: Surface,
    terrain: str,
    slope: float,
    check: Callable[[], None] = lambda: None,
    parameters: SteepnessParameters = TERRAIN.steepness,
) -> Optional[Cut]:
    """What a ``terrain`` on the cells of a DSM lacks, which was searched with this steepest ``slope`` (m per m); None
    where it is next to nothing. Raises ImageError for a damaged file."""
    factor = round(slopes.transform[1] / surface.transform[1])
    rows, columns = slopes.height.shape
    below = _reduced(terrain, (columns, rows), factor, check)
    with np.errstate(invalid="ignore"):
        cut = slopes.steeper(slope) & (slopes.height - below > parameters.cut_m)
    percent = 100.0 * float(cut.sum()) / max(int(np.isfinite(slopes.height).sum()), 1)
    if percent <= parameters.most_cut_percent:
        return None
    deepest, steep = np.max((slopes.height - below)[cut]), np.percentile(slopes.usual[cut], 95)
    return Cut(percent, deepest=float(deepest), slope=float(steep))


def on_steep_ground(
    slopes: Slopes, shapes: Sequence[ogr.Geometry], parameters: SteepnessParameters = TERRAIN.steepness
) -> Tuple[int, float]:
    """How many of some footprints are hillsides by at least half, and the share of all their area."""
    steep = slopes.steeper(parameters.hillside)
    numbers = burned(shapes, range(len(shapes)), slopes.height.shape, slopes.transform)
    known = np.isfinite(numbers) & np.isfinite(slopes.slope)
    index = numbers[known].astype(np.intp)
    cells, on = (np.bincount(index, weights, len(shapes)) for weights in (None, steep[known]))
    hillside = (cells > 0) & (on >= 0.5 * cells)
    return int(hillside.sum()), float(cells[hillside].sum()) / max(float(cells.sum()), 1.0)
