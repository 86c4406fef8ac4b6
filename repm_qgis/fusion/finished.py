"""The finished DSM, from which other products are made: its cells, and their heights above the ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.arrays import Altitudes, Floats, Window
from ..geometry.cell_grid import CellGrid
from ..geometry.vertical import HeightDatum
from ..imagery.raster import opened, read
from .layout import DsmLayout


@dataclass(frozen=True)
class FinishedSurface:
    """A written DSM: its file, and the layout of the file's own cells, without windows."""

    path: str
    layout: DsmLayout

    @classmethod
    def of(cls, path: str, crs: str, datum: HeightDatum) -> FinishedSurface:
        """The DSM of a file; ``crs`` is that of its cells, its heights are above the datum."""
        with opened(path) as dataset:
            place, size = dataset.GetGeoTransform(), (dataset.RasterXSize, dataset.RasterYSize)
        grid = CellGrid(place[0], place[3], place[1], (size[1], size[0]))
        return cls(path, DsmLayout(grid, crs, datum, ()))

    @property
    def grid(self) -> CellGrid:
        """The file's cells."""
        return self.layout.grid

    def levels(self) -> Altitudes:
        """The least and the greatest height, m above the datum, of a DSM that has any; all of it is read."""
        with opened(self.path) as dataset:
            low, high = dataset.GetRasterBand(1).ComputeRasterMinMax(False)
        return low, high

    def heights(self, window: Window) -> Floats:
        """(H, W) heights of a window of the file, m above the ellipsoid; NaN where the DSM has none."""
        with opened(self.path) as dataset:
            height = read(dataset, window)
        return height + self.layout.undulation(self.grid.part(window))
