"""Colours of points and vertices: those of the orthophoto in colour at their places."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import Iterator, List, Tuple

import numpy as np
from numpy.typing import NDArray
from osgeo import gdal

from ..contracts.arrays import FloatArray, FloatImage, Window
from ..evaluation.grids import Grid, HeightWarper
from ..imagery.raster import opened, read
from .parameters import SOLIDS, PaintingParameters

Colours = NDArray[np.uint16]
"""(..., 3) red, green, blue over the whole range of 16 bits, as LAS has them."""


@dataclass(frozen=True)
class Paint:
    """An opened orthophoto in colour, its three shown bands, and their values that become black and white."""

    dataset: gdal.Dataset
    bands: Tuple[int, int, int]
    limits: Tuple[Tuple[float, float], ...]

    def cells(self, window: Window) -> Colours:
        """(H, W, 3) colours of the cells; cells without one take the nearest colour in the window, or black."""
        return self._colours([read(self.dataset, window, band) for band in self.bands])

    def on(self, surface: gdal.Dataset, window: Window) -> Colours:
        """(H, W, 3) colours of a window of a surface's cells, which may be wider than the orthophoto's: means."""
        cells = Grid.of(surface)
        own = Grid.of(self.dataset)
        if (own.size, own.transform) == (cells.size, cells.transform):
            return self.cells(window)
        return self.onto(cells.window(window))

    def onto(self, cells: Grid) -> Colours:
        """(H, W, 3) colours of the cells of a grid: means where they are wider than the orthophoto's."""
        flat = cells.flat
        warpers = [HeightWarper(self.dataset, flat, band=band, heights=False) for band in self.bands]
        return self._colours([warper.read(flat) for warper in warpers])

    def _colours(self, planes: List[FloatImage]) -> Colours:
        """(H, W, 3) of what the shown bands have in some cells, NaN where they have nothing."""
        from scipy import ndimage

        scaled = [
            np.clip((plane - low) * np.float32(65535.0 / (high - low)), 0, 65535)
            for plane, (low, high) in zip(planes, self.limits)
        ]
        colours = np.stack(scaled, axis=-1)
        missing = ~np.isfinite(colours).all(axis=-1)
        if missing.all():
            return np.zeros(colours.shape, np.uint16)
        if missing.any():
            rows, columns = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
            colours = colours[rows, columns]
        painted: Colours = np.rint(colours).astype(np.uint16)
        return painted

    def points(self, x: FloatArray, y: FloatArray) -> Colours:
        """(N, 3) colours at places in the orthophoto's CRS; the memory is that of their cells' rectangle."""
        x0, cell, _, y0, _, down = self.dataset.GetGeoTransform()
        column = np.clip(np.floor((x - x0) / cell).astype(np.int64), 0, self.dataset.RasterXSize - 1)
        row = np.clip(np.floor((y - y0) / down).astype(np.int64), 0, self.dataset.RasterYSize - 1)
        ends = (column.min(), row.min(), column.max() + 1, row.max() + 1)
        window = Window.spanning(*map(int, ends))
        painted: Colours = self.cells(window)[row - window.row, column - window.col]
        return painted


@contextmanager
def opened_paint(path: str, parameters: PaintingParameters = SOLIDS.painting) -> Iterator[Paint]:
    """The colours of an orthophoto: 8 bits as they are, others from 2 to 98 % of the values, as in its style."""
    with opened(path) as dataset:
        bands = (1, 2, 3) if dataset.RasterCount >= 3 else (1, 1, 1)
        byte = dataset.GetRasterBand(1).DataType == gdal.GDT_Byte
        limits = tuple((0.0, 255.0) if byte else _limits(dataset, band, parameters) for band in bands)
        yield Paint(dataset, bands, limits)


def _limits(dataset: gdal.Dataset, band: int, parameters: PaintingParameters) -> Tuple[float, float]:
    factor = max(1.0, max(dataset.RasterXSize, dataset.RasterYSize) / parameters.preview_px)
    size = tuple(max(1, round(side / factor)) for side in (dataset.RasterXSize, dataset.RasterYSize))
    values = read(dataset, None, band, (size[0], size[1]))
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = map(float, np.percentile(known, parameters.percents))
    return (low, high) if high > low else (low - 0.5, low + 0.5)
