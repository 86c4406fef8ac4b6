"""The rasters that buildings are found in, read by window on the cells of the DSM."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from typing import List, Optional, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import FloatImage, Mask, Window
from ..contracts.errors import OverlapError
from ..contracts.findings import Finding, distinct
from ..evaluation.grids import Grid, HeightWarper, metric_of, overlap
from ..imagery import raster
from ..imagery.bands import vegetation_bands
from ..imagery.confidence import Provenance
from ..imagery.heights import read_heights
from ..terrain.inputs import Surface

_FILLED = (Provenance.INTERPOLATED, Provenance.INTERPOLATED_ON_DEM)


@dataclass(frozen=True)
class Cells:
    """A window (rows, columns): heights of the surface and of the terrain below it, m, NaN where there are none;
    ``error``: the expected ones of the surface, m, NaN where they are not known; ``measured``: heights that were not
    filled in; ``plants``: cells that the orthophoto shows to be green, None where it cannot tell."""

    surface: FloatImage
    ground: FloatImage
    error: FloatImage
    measured: Mask
    plants: Optional[FloatImage] = None

    @property
    def above(self) -> FloatImage:
        """Heights above the terrain, m."""
        return self.surface - self.ground


class Rasters:
    """The DSM, its terrain, and where they are given its confidence and an orthophoto, opened for reading.

    Close it with the stack that it was given.
    """

    def __init__(self, surface: Surface, terrain: str, ortho: Optional[str], stack: ExitStack) -> None:
        """Raises ImageError for a raster that cannot be used, OverlapError where the terrain, or the orthophoto, lies
        elsewhere."""
        self.surface = surface
        self._dsm = stack.enter_context(raster.opened(surface.path))
        self.grid = Grid.of(self._dsm)
        self.scale_m2 = metric_of(self.grid).area_per_unit
        ground = stack.enter_context(raster.opened(terrain))
        overlap(Grid.of(ground), self.grid)
        self._ground = HeightWarper(ground, self.grid)
        self._confidence = stack.enter_context(raster.opened(surface.confidence)) if surface.confidence else None
        self._colours = self._colours_of(ortho, stack) if ortho else ()
        self.shows_plants = bool(self._colours)

    @property
    def warnings(self) -> List[Finding]:
        return distinct(self._ground.warnings)

    def _colours_of(self, ortho: str, stack: ExitStack) -> Tuple[HeightWarper, ...]:
        dataset = stack.enter_context(raster.opened(ortho))
        try:
            overlap(Grid.of(dataset), self.grid)
        except OverlapError as error:
            raise OverlapError(
                f"The orthophoto '{ortho}' and the DSM '{self.surface.path}' do not overlap: choose the one that was "
                "written with this DSM, or leave ORTHO empty."
            ) from error
        bands = vegetation_bands(dataset)
        return tuple(HeightWarper(dataset, self.grid.flat, band=band, heights=False) for band in bands or ())

    def window(self, shape: ogr.Geometry, margin: int) -> Window:
        """The cells that a geometry touches, and a margin of cells."""
        x0, dx, _, y0, _, dy = self.surface.transform
        xmin, xmax, ymin, ymax = shape.GetEnvelope()
        ends = math.floor((xmin - x0) / dx), math.floor((ymax - y0) / dy)
        found = Window.spanning(*ends, math.ceil((xmax - x0) / dx), math.ceil((ymin - y0) / dy))
        return found.grown(margin, self.surface.size)

    def heights(self, window: Window) -> FloatImage:
        """The heights of the DSM alone, m."""
        return read_heights(self._dsm, window)

    def read(self, window: Window) -> Cells:
        """The cells of a window of the DSM."""
        place = self.grid.window(window)
        surface = self.heights(window)
        ground = self._ground.read(place)
        error = np.full(surface.shape, np.nan, np.float32)
        measured = np.isfinite(surface)
        if self._confidence is not None:
            error = raster.read(self._confidence, window, self.surface.error_band)
            if self.surface.source_band:
                measured &= ~np.isin(raster.read(self._confidence, window, self.surface.source_band), _FILLED)
        plants = None
        if self._colours:
            red, infrared = (colour.read(place.flat) for colour in self._colours)
            with np.errstate(invalid="ignore", divide="ignore"):
                plants = ((infrared - red) / (infrared + red)).astype(np.float32)
        return Cells(surface, ground, error, measured, plants)
