"""A DSM and other rasters on the cells of a page: means where the page has fewer, resampled where the grids differ."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Callable

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatImage, Window
from ..contracts.errors import OverlapError
from ..evaluation.grids import Grid, HeightWarper
from ..geometry.frames import flat_crs
from ..geometry.levels import halved
from ..imagery.heights import read_heights, read_values
from .parameters import VIEWER, ViewerParameters

_NEAR = 1e-3  # cells: bounds that differ by less are the same


def page_grid(grid: Grid, most_cells: int, parameters: ViewerParameters = VIEWER) -> Grid:
    """The cells of a page of a raster: its own where they are few enough and lie north up, else larger ones."""
    xmin, ymin, xmax, ymax = grid.bounds
    _, b, c, _, e, f = grid.transform
    width, height = grid.size
    if not grid.is_north_up:
        cell = math.sqrt(abs(b * f - c * e))
        width, height = (max(round(side / cell), 1) for side in (xmax - xmin, ymax - ymin))
    factor = max(1.0, math.sqrt(width * height / most_cells), max(width, height) / parameters.most_side)
    columns, rows = (max(int(side / factor), 1) for side in (width, height))
    transform = xmin, (xmax - xmin) / columns, 0.0, ymax, 0.0, (ymin - ymax) / rows
    return replace(grid, size=(columns, rows), transform=transform)


def read_on(
    dataset: gdal.Dataset,
    cells: Grid,
    band: int,
    check: Callable[[], None],
    parameters: ViewerParameters = VIEWER,
    heights: bool = True,
) -> FloatImage:
    """One band on the cells of a page: (rows, columns), NaN = no value; ``heights`` become metres.

    ``check`` is called often, and may raise to stop. Raises ImageError for a raster that cannot be read, or that has
    other cells and no CRS.
    """
    own = Grid.of(dataset)
    if _same_ground(own, cells):
        if own.size == cells.size:
            return (read_heights if heights else read_values)(dataset, None, band)
        handle = dataset.GetRasterBand(band)
        if handle.GetNoDataValue() is not None or handle.GetMaskFlags() & gdal.GMF_PER_DATASET:
            return (read_heights if heights else read_values)(dataset, None, band, cells.size)
    warper = HeightWarper(dataset, cells, band=band, heights=heights)
    columns, rows = cells.size
    lines = max(int(parameters.block_cells / (columns * max(warper.cells_ratio, 1.0) ** 2)), 1)
    found = np.empty((rows, columns), np.float32)
    for row in range(0, rows, lines):
        check()
        part = Window(0, row, columns, min(lines, rows - row))
        found[row : row + part.height] = warper.read(cells.window(part))
    return found


def read_draped(
    dataset: gdal.Dataset, cells: Grid, band: int, check: Callable[[], None], parameters: ViewerParameters = VIEWER
) -> FloatImage:
    """As :func:`read_on`, for values that are no heights: a vertical datum means nothing to them.

    Raises OverlapError too where the raster has no value on the page.
    """
    values = read_on(dataset, cells.flat, band, check, parameters, heights=False)
    if not np.isfinite(values).any():
        raise OverlapError(
            f"The raster '{dataset.GetDescription()}' has no value where the DSM '{cells.path}' lies: choose one of "
            "the same place, or correct a wrongly assigned CRS."
        )
    return values


def without_holes(values: FloatImage) -> FloatImage:
    """The values with those of ever larger squares around them where there is none; 0 where there is none at all."""
    good = np.isfinite(values)
    if good.all():
        return values
    if min(values.shape) < 1 or not good.any():
        return np.zeros_like(values)
    rows, columns = values.shape
    total, count = halved(np.where(good, values, 0.0)), halved(good.astype(np.float32))
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
    around = without_holes(means).repeat(2, axis=0).repeat(2, axis=1)[:rows, :columns]
    return np.where(good, values, around)


def _same_ground(own: Grid, cells: Grid) -> bool:
    """Whether two rasters that lie north up cover the same ground; one without a CRS is taken to have the other's."""
    tolerance = _NEAR * abs(cells.transform[1])
    if not own.is_north_up or any(abs(a - b) > tolerance for a, b in zip(own.bounds, cells.bounds)):
        return False
    return not own.wkt or not cells.wkt or flat_crs(own.crs) == flat_crs(cells.crs)
