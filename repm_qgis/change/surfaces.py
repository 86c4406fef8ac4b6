"""Two DSMs on one grid: what is read of them in a window."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import List, Optional, Protocol, Sequence, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatImage, Mask, Window
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding, distinct
from ..contracts.options import ChangeOptions
from ..evaluation.comparison import gradient, sample_windows
from ..evaluation.coregistration import Alignment, Patch, align
from ..evaluation.grids import Grid, HeightWarper, cell_metres, overlap
from ..evaluation.parameters import EVALUATION
from ..gate.places import displaced_by
from ..geometry.frames import flat_crs
from ..imagery.confidence import confidence_bands
from ..imagery.heights import to_metres
from ..imagery.raster import opened
from ..numerics.robust import NMAD_FACTOR
from ..runtime.progress import Progress
from .parameters import CHANGE, DetectionParameters


@dataclass(frozen=True)
class Cells:
    """A window of both DSMs, (rows, columns) each.

    ``before``, ``after`` in m, NaN = none. ``error`` is the expected error of their difference as the confidence
    rasters state it, m, 1 everywhere without these, NaN where a height is interpolated. ``measured``: both heights are
    matched, not filled in. ``support``: how many levels of detection a change must exceed; infinite where fewer
    height maps agree than is usual in one of the DSMs. ``gradient`` is that of the steeper one, m per m, NaN beside
    holes.
    """

    before: FloatImage
    after: FloatImage
    error: FloatImage
    measured: Mask
    support: FloatImage
    gradient: FloatImage

    @property
    def difference(self) -> FloatImage:
        return self.after - self.before

    def inner(self, part: Tuple[slice, slice]) -> Cells:
        """A part of the window."""
        return Cells(**{name: values[part] for name, values in vars(self).items()})


class TwoDates(Protocol):
    """Two DSMs on one grid, with cells of this width and height (m), as :class:`Surfaces` has them."""

    cell: Tuple[float, float]

    def read(self, window: Window) -> Cells:
        """A window of the grid."""

    def samples(self) -> List[Window]:
        """The overlap as one window, or patches that are spread evenly over it."""


@dataclass(frozen=True)
class ReadConfidence:
    """What reads the bands of a confidence raster on a grid, without a vertical datum: expected errors, where heights
    come from, and how many height maps agree; None for what it does not have."""

    error: Optional[HeightWarper] = None
    source: Optional[HeightWarper] = None
    maps: Optional[HeightWarper] = None


_BANDS = ("error", "source", "maps")


def opened_confidence(path: Optional[str], option: str, grid: Grid, stack: ExitStack) -> ReadConfidence:
    """The confidence raster that an option names, if it names one, closed with the stack. Raises ImageError."""
    if not path:
        return ReadConfidence()
    dataset = stack.enter_context(opened(path))
    bands = confidence_bands(dataset, option)
    flat = replace(grid, wkt=flat_crs(grid.crs).to_wkt())  # errors have no vertical datum
    numbers = {name: getattr(bands, name) for name in _BANDS}
    return ReadConfidence(**{name: HeightWarper(dataset, flat, band=band) for name, band in numbers.items() if band})


def opened_surfaces(paths: Sequence[str], stack: ExitStack) -> Tuple[List[gdal.Dataset], List[Grid], List[float]]:
    """DSMs, closed with the stack, with their grids and the longer sides of their cells, m.

    Raises ImageError (no CRS, rotated, other units than metres).
    """
    datasets = [stack.enter_context(opened(path)) for path in paths]
    grids = [Grid.of(dataset) for dataset in datasets]
    sides = [max(map(abs, cell_metres(grid))) for grid in grids]
    for dataset in datasets:
        to_metres(dataset)  # raises ImageError where that cannot be
    return datasets, grids, sides


class Surfaces:
    """Both DSMs and their confidences, opened on the grid of the coarser one, cut to what both cover.

    ``alignment`` is what AFTER is moved by. Close it with the stack that it was given.
    """

    def __init__(self, options: ChangeOptions, stack: ExitStack, parameters: DetectionParameters = CHANGE.detection):
        """Raises ImageError (no CRS, rotated, other units than metres, no vertical transformation), OverlapError."""
        datasets, grids, sides = opened_surfaces((options.before, options.after), stack)
        coarser, finer = (grids[1], grids[0]) if sides[1] > sides[0] * 1.001 else (grids[0], grids[1])
        self.grid = _cut(coarser, finer)
        self.cell = cell_metres(self.grid)
        self.alignment = Alignment("none")
        self._parameters = parameters
        self._warpers = [HeightWarper(dataset, self.grid) for dataset in datasets]
        named = (options.before_confidence, "BEFORE_CONFIDENCE"), (options.after_confidence, "AFTER_CONFIDENCE")
        read = [opened_confidence(path, option, self.grid, stack) for path, option in named]
        self._errors, self._sources, self._counts = ([getattr(each, name) for each in read] for name in _BANDS)
        self._least_counts = [parameters.usual_maps * self._usual(each) for each in self._counts]

    @property
    def warnings(self) -> List[Finding]:
        return distinct(finding for warper in self._warpers for finding in warper.warnings)

    @property
    def stated(self) -> bool:
        """Whether confidence rasters state the errors of both DSMs."""
        return None not in self._errors

    @property
    def cell_m2(self) -> float:
        return abs(self.cell[0] * self.cell[1])

    def read(self, window: Window) -> Cells:
        """A window of the grid; beyond its edge there is no gradient."""
        cells = self.grid.window(window)
        moves = Alignment("none"), self.alignment
        before, after = (warper.read(cells, move) for warper, move in zip(self._warpers, moves))
        steep = np.full(before.shape, np.nan, np.float32)
        steep[1:-1, 1:-1] = np.fmax(gradient(before, self.cell), gradient(after, self.cell))
        measured = np.isfinite(before) & np.isfinite(after)
        error = np.ones(before.shape, np.float32)
        if self.stated:
            parts = [self._read(each, cells, move) for each, move in zip(self._errors, moves)]
            error = np.hypot(*parts)
        for source, move in zip(self._sources, moves):
            if source is not None:
                measured &= self._read(source, cells, move) < self._parameters.filled
        return Cells(before, after, error, measured, self._support(cells), steep)

    def _support(self, cells: Grid) -> FloatImage:
        """Where one height map has a height, or the number is unknown, an error of matching cannot be recognised."""
        plan = self._parameters
        support = np.full(cells.size[::-1], plan.support if self.stated else plan.support_alone, np.float32)
        for warper, least, move in zip(self._counts, self._least_counts, (Alignment("none"), self.alignment)):
            if warper is not None:
                count = self._read(warper, cells, move)
                alone = count < plan.least_maps
                needed = np.where(alone, np.float32(plan.support_alone), np.float32(plan.support))
                support = np.maximum(support, np.where(count >= least, needed, np.float32(np.inf)))
        return support

    def _usual(self, count: Optional[HeightWarper]) -> float:
        """The median of how many height maps agree."""
        if count is None:
            return 0.0
        known = [values[np.isfinite(values)] for values in (count.read(self.grid.window(w)) for w in self.samples())]
        return float(np.median(np.concatenate(known))) if any(each.size for each in known) else 0.0

    @staticmethod
    def _read(warper: Optional[HeightWarper], cells: Grid, move: Alignment) -> FloatImage:
        if warper is None:
            return np.zeros(cells.size[::-1], np.float32)
        return warper.read(cells, replace(move, dz=0.0))

    def samples(self) -> List[Window]:
        """The overlap as one window, or patches that are spread evenly over it where it is large."""
        return sample_windows(self.grid, self.grid.bounds, EVALUATION.comparison)


def lay_on(surfaces: TwoDates, method: str, stable: float, progress: Progress) -> Alignment:
    """The shift of AFTER onto BEFORE: found from all cells, then again from those that did not change.

    ``method`` is that of :func:`~repm_qgis.evaluation.coregistration.align`; ``stable`` are the standard deviations
    beyond which a difference is no longer one of stable ground. Raises EmptyResultError.
    """
    patches = _patches(surfaces, progress)
    if not any((np.isfinite(before) & np.isfinite(after)).any() for after, before in patches):
        raise EmptyResultError(
            "No cell of stable ground has a height in both DSMs: choose DSMs of the same ground, with fewer holes."
        )
    found = align(method, patches, surfaces.cell, progress.check_cancelled)
    if method == "none":
        return found
    steady = [(after, _steady(found.applied(after, surfaces.cell), before, stable)) for after, before in patches]
    # Both NMADs are those of unchanged cells: with changed cells in one of them, the shift would seem to gain more.
    return align(method, steady, surfaces.cell, progress.check_cancelled)


def displacement(surfaces: TwoDates, method: str, progress: Progress) -> float:
    """How far AFTER fits to BEFORE better beside its place, m, where the ``method`` of the alignment leaves it there; 0
    elsewhere."""
    moved = method in ("3d", "cells")
    return 0.0 if moved else displaced_by(_patches(surfaces, progress), surfaces.cell, progress.check_cancelled)


def _patches(surfaces: TwoDates, progress: Progress) -> List[Patch]:
    """AFTER and BEFORE in samples, where both are measured."""
    patches: List[Patch] = []
    for window in surfaces.samples():
        progress.check_cancelled()
        cells = surfaces.read(window)
        patches.append((cells.after, np.where(cells.measured, cells.before, np.float32(np.nan))))
    return patches


def _steady(after: FloatImage, before: FloatImage, stable: float) -> FloatImage:
    """BEFORE without the cells whose difference is far from the usual one."""
    away = np.abs(after - before)
    known = away[np.isfinite(away)]
    most = stable * NMAD_FACTOR * float(np.median(known)) if known.size else math.inf
    return np.where(away <= most, before, np.float32(np.nan))


def _cut(coarser: Grid, finer: Grid) -> Grid:
    """The cells of a grid that another one covers, at least one."""
    common = overlap(finer, coarser)
    columns, rows = coarser.to_cells(np.array(common[::2]), np.array(common[1::2]))
    low = (max(0, math.floor(min(place) + 1e-6)) for place in (columns, rows))
    high = (min(most, math.ceil(max(place) - 1e-6)) for most, place in zip(coarser.size, (columns, rows)))
    return coarser.window(Window.spanning(*low, *high))
