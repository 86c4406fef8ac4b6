"""The DSMs of a series on one grid: what is read of them in a window, and two of them at a time."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence

import numpy as np

from ..change.parameters import CHANGE
from ..change.surfaces import Cells, opened_confidence, opened_surfaces
from ..change.volumes import Shapes
from ..contracts.arrays import FloatImage, Mask, Window
from ..contracts.errors import OverlapError
from ..contracts.findings import Finding, distinct
from ..evaluation.comparison import gradient, sample_windows
from ..evaluation.coregistration import Alignment
from ..evaluation.grids import Grid, HeightWarper, bounds_on, cell_metres, overlap
from ..evaluation.parameters import EVALUATION
from ..geometry.vertical import TAG
from .parameters import SERIES
from .times import DatedDsm

LEAST_DATES = 3
"""Two dates have a change, and no trend."""


@dataclass(frozen=True)
class SeriesCells:
    """A window of all dates: ``heights`` (dates, rows, columns) in m, NaN where there is none or it was filled in;
    ``stated`` errors of these, m, 1 where nothing states them; ``gradient`` (rows, columns) of their mean, m per m."""

    heights: FloatImage
    stated: FloatImage
    gradient: FloatImage


class Stack:
    """All DSMs and their confidences, opened on the grid of the coarsest one, where three of them may have heights.

    ``alignments`` are what each date is moved by. Close it with the stack that it was given.
    """

    def __init__(self, series: Sequence[DatedDsm], stack: ExitStack) -> None:
        """Raises ImageError (no CRS, rotated, other units than metres, no vertical transformation), OverlapError."""
        datasets, grids, sides = opened_surfaces([each.path for each in series], stack)
        chosen = next(index for index, side in enumerate(sides) if side * 1.001 >= max(sides))
        self.grid = _common(grids[chosen], grids)
        for grid in grids:
            overlap(grid, self.grid)
        self.cell = cell_metres(self.grid)
        self.crs_wkt = datasets[chosen].GetProjection()
        self.datum = datasets[chosen].GetMetadataItem(TAG) or ""
        self.alignments = [Alignment("none")] * len(series)
        self.areas: Optional[Shapes] = None
        """Where the ground is not stable, as the user says."""
        self.moving: Dict[Window, Mask] = {}
        """The cells of samples that were seen to change."""
        self._warpers = [HeightWarper(dataset, self.grid) for dataset in datasets]
        self._confidences = [opened_confidence(each.confidence, "CONFIDENCES", self.grid, stack) for each in series]

    def __len__(self) -> int:
        return len(self._warpers)

    @property
    def cell_m2(self) -> float:
        return abs(self.cell[0] * self.cell[1])

    @property
    def warnings(self) -> List[Finding]:
        return distinct(finding for warper in self._warpers for finding in warper.warnings)

    def read(self, window: Window, dates: Sequence[int] = ()) -> SeriesCells:
        """A window of the grid, of all dates or some; beyond the grid's edge there is no gradient."""
        read = [self.read_date(index, window) for index in dates or range(len(self))]
        heights, stated = (np.stack(parts) for parts in zip(*read))
        known = np.isfinite(heights)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(known, heights, np.float32(0)).sum(axis=0) / known.sum(axis=0, dtype=np.float32)
        return SeriesCells(heights, stated, self.gradient_of(mean))

    def read_date(self, index: int, window: Window) -> List[FloatImage]:
        """Heights (rows, columns) of one date, NaN where they were filled in, and their stated errors, m."""
        cells, move = self.grid.window(window), self.alignments[index]
        heights = self._warpers[index].read(cells, move)
        stated = np.ones(heights.shape, np.float32)
        confidence, flat = self._confidences[index], replace(move, dz=0.0)
        if confidence.error is not None:
            stated = confidence.error.read(cells, flat)
            heights = np.where(np.isfinite(stated), heights, np.float32(np.nan))
        if confidence.source is not None:
            measured = confidence.source.read(cells, flat) < CHANGE.detection.filled
            heights = np.where(measured, heights, np.float32(np.nan))
        return [heights, stated]

    def gradient_of(self, heights: FloatImage) -> FloatImage:
        """How steep a surface is, m per m; NaN beside holes and at the edge."""
        steep = np.full(heights.shape, np.nan, np.float32)
        steep[1:-1, 1:-1] = gradient(heights, self.cell)
        return steep

    def samples(self) -> List[Window]:
        """The grid as one window, or patches that are spread evenly over it where it is large."""
        plan = EVALUATION.comparison
        most = min(plan.sample_cells, SERIES.stack_values // len(self))
        return sample_windows(self.grid, self.grid.bounds, replace(plan, sample_cells=most))

    def unnamed(self, window: Window) -> Mask:
        """(rows, columns) the cells of a window that are in no area."""
        return (
            self.areas.numbers(window) == 0 if self.areas is not None else np.ones((window.height, window.width), bool)
        )

    def stable(self, window: Window) -> Mask:
        """(rows, columns) the cells of a window that are in no area, and were not seen to change."""
        known = self.unnamed(window)
        return known & ~self.moving[window] if window in self.moving else known

    def pair(self, before: int, after: int) -> PairOfDates:
        return PairOfDates(self, before, after)


class PairOfDates:
    """Two dates of a stack, as :class:`~repm_qgis.change.surfaces.TwoDates`; ``measured`` is stable ground only where
    the stack has areas."""

    def __init__(self, stack: Stack, before: int, after: int) -> None:
        self._stack, self._dates, self.cell = stack, (before, after), stack.cell

    def samples(self) -> List[Window]:
        return self._stack.samples()

    def read(self, window: Window) -> Cells:
        """A window of the grid, with the steepness of both dates' mean."""
        (before, own), (after, others) = (self._stack.read_date(date, window) for date in self._dates)
        measured = np.isfinite(before) & np.isfinite(after) & self._stack.stable(window)
        steep = self._stack.gradient_of((before + after) / 2)
        support = np.ones(before.shape, np.float32)
        return Cells(before, after, np.hypot(own, others), measured, support, steep)


def _common(lattice: Grid, grids: Sequence[Grid]) -> Grid:
    """The cells of a grid, continued beyond its raster, that at least three rasters may cover: a frame around them."""
    extents = np.array([bounds_on(grid, lattice) for grid in grids])
    low, high = np.sort(extents[:, :2], axis=0)[LEAST_DATES - 1], np.sort(extents[:, 2:], axis=0)[-LEAST_DATES]
    if not (low < high).all():
        raise OverlapError(
            "The DSMs have no ground in common that three of them cover: choose DSMs of one place, or correct a "
            "wrongly assigned CRS."
        )
    columns, rows = lattice.to_cells(np.array([low[0], high[0]]), np.array([low[1], high[1]]))
    first = (math.floor(min(place) + 1e-6) for place in (columns, rows))
    last = (math.ceil(max(place) - 1e-6) for place in (columns, rows))
    return lattice.window(Window.spanning(*first, *last))
