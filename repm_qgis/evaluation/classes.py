"""Errors by class: a class raster (land cover, a mask) on the reference's cells."""

from __future__ import annotations

from typing import Dict, List, Sequence, Tuple

import numpy as np
from osgeo import gdal
from pyproj import Transformer

from ..contracts.arrays import FloatArray, Floats, Mask, Window
from ..contracts.errors import ImageError
from ..geometry.frames import flat_crs
from ..imagery import raster
from .grids import Grid
from .metrics import ErrorCollector, HeightMetrics

_MOST_CLASSES = 64


class ClassRaster:
    """A class raster as it is read on a reference's cells, whatever its CRS and grid."""

    def __init__(self, dataset: gdal.Dataset, reference: Grid) -> None:
        """Raises ImageError for one without a CRS."""
        self._dataset, self.grid = dataset, Grid.of(dataset)
        self._to_classes = Transformer.from_crs(flat_crs(reference.crs), flat_crs(self.grid.crs), always_xy=True)

    def read(self, cells: Grid) -> Tuple[FloatArray, Mask]:
        """(rows, columns) class at each cell's centre, NaN where there is none, and which of them the raster covers."""
        columns, rows = cells.size
        u, v = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        x, y = self._to_classes.transform(*cells.to_ground(u, v))
        column, row = self.grid.to_cells(np.asarray(x), np.asarray(y))
        width, height = self.grid.size
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        result = np.full((rows, columns), np.nan)
        if inside.any():
            c, r = column[inside].astype(np.intp), row[inside].astype(np.intp)
            window = Window(int(c.min()), int(r.min()), int(np.ptp(c)) + 1, int(np.ptp(r)) + 1)
            result[inside] = raster.read(self._dataset, window)[r - window.row, c - window.col]
        return result, inside


class ErrorsByClass:
    """Collects errors for each whole number of a class raster.

    A cell of the reference has the class at its centre; cells outside the raster, or where it has no data, belong to
    no class. Raises ImageError where the raster holds fractions or more than 64 values: it is no class raster then.
    """

    def __init__(self, dataset: gdal.Dataset, reference: Grid, thresholds: Sequence[float]) -> None:
        self._raster, self._thresholds = ClassRaster(dataset, reference), tuple(thresholds)
        self._names = _names(dataset)
        self._collectors: Dict[int, ErrorCollector] = {}

    def add(self, cells: Grid, difference: Floats, known: Mask) -> None:
        """Errors (rows, columns) of a part of the reference, and which of its cells have a reference height."""
        classes, _ = self._raster.read(cells)
        inside = np.isfinite(classes) & known
        for value in np.unique(classes[inside]):
            here = inside & (classes == value)
            self._collector(float(value)).add(difference[here], int(here.sum()))

    def metrics(self) -> List[Tuple[str, HeightMetrics]]:
        """Name and metrics of each class that occurs on the reference, by rising value."""
        ordered = sorted(self._collectors.items())
        return [(self._names.get(value, str(value)), collector.metrics()) for value, collector in ordered]

    def _collector(self, value: float) -> ErrorCollector:
        if value != round(value) or (int(value) not in self._collectors and len(self._collectors) >= _MOST_CLASSES):
            why = f"has the value {value:g}, which is not a whole number or is one value too many"
            remedy = f"give a raster of at most {_MOST_CLASSES} whole numbers, such as a land cover map or a mask"
            raise ImageError(f"The class raster '{self._raster.grid.path}' {why}: {remedy}.")
        return self._collectors.setdefault(int(value), ErrorCollector.of_part(self._thresholds))


def _names(dataset: gdal.Dataset) -> Dict[int, str]:
    """The raster's own names of its values, from its categories or its attribute table."""
    band = dataset.GetRasterBand(1)
    names = {index: name for index, name in enumerate(band.GetCategoryNames() or []) if name}
    table = band.GetDefaultRAT()
    if table is None:
        return names
    usages = {table.GetUsageOfCol(i): i for i in range(table.GetColumnCount())}
    value, name = (usages.get(usage) for usage in (gdal.GFU_MinMax, gdal.GFU_Name))
    if value is None or name is None:
        return names
    return {table.GetValueAsInt(i, value): table.GetValueAsString(i, name) for i in range(table.GetRowCount())}
