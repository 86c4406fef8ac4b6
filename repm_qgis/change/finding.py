"""From two DSMs to their changes, block by block: memory does not grow with them, and blocks change no result."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from typing import ContextManager, Dict, List, Sequence

import numpy as np
from numpy.typing import DTypeLike
from osgeo import ogr

from .. import __version__
from ..contracts.arrays import FloatArray, FloatImage, IntArray, Window
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..contracts.options import ChangeOptions
from ..evaluation.comparison import Thumbnails
from ..evaluation.coregistration import Alignment
from ..evaluation.grids import Grid
from ..files.vector import write_layer
from ..gate.places import known_m2, partial_finding
from ..gate.reliefs import date_findings
from ..geometry.cell_grid import overlapping_blocks
from ..geometry.frames import flat_crs
from ..imagery import raster
from ..numerics.robust import nmad
from ..reports import verdict
from ..runtime.progress import Part, Progress
from ..runtime.workspace import temporary_folder
from .detection import detect
from .errors import Correlation, ErrorModel, correlation_of, fitted_model
from .parameters import CHANGE, ChangeParameters
from .surfaces import Cells, Surfaces, displacement, lay_on
from .volumes import FIELDS, GAIN, LOSS, Changed, Outlines, Sums, Total, kept_cells, total_of

HISTOGRAM_BIN = 0.05
"""Width of a bin of the standardised differences, which reach ten standard deviations to both sides."""
_HISTOGRAM_HALF = 200
SIGNIFICANT_BANDS = ("significant change (m)", "level of detection (m)")
_CHANGE, _LEVEL, _CORE_ERROR, _SUPPORT, _HIDDEN = 1, 2, 3, 4, 5  # bands of the raster between the passes


@dataclass(frozen=True)
class Found:
    """What was found, the largest volume first. ``compared`` are the cells that both DSMs have.

    ``offset_m`` is the standard deviation of the offset between the DSMs, ``level_m`` the median level of detection.
    ``histogram`` counts the differences on stable ground over their error, in bins of ``HISTOGRAM_BIN``. The pictures
    are small ones of BEFORE, AFTER and the change, with cells of ``picture_cell_m``. ``shared`` is the share of the
    larger DSM's ground that was compared.
    """

    grid: Grid
    cell_m2: float
    stated: bool
    alignment: Alignment
    model: ErrorModel
    correlation: Correlation
    changes: List[Changed]
    compared: int
    offset_m: float
    level_m: float
    histogram: IntArray
    pictures: Dict[str, FloatImage]
    picture_cell_m: float
    shared: float
    warnings: List[Finding]

    def total(self, gain: bool) -> Total:
        return total_of([each for each in self.changes if each.gain == gain], self.offset_m)

    @property
    def changed_share(self) -> float:
        """Changed cells, of those that both DSMs have."""
        return sum(each.cells for each in self.changes) / self.compared

    @property
    def shown_m(self) -> float:
        """The difference that maps and pictures show in the darkest tone, m: the usual size of changes, or the level of
        detection."""
        size = np.abs(self.pictures["change"])
        size = size[np.isfinite(size)]
        return max(float(np.median(size)), self.level_m) if size.size else self.level_m

    def histogram_edges(self) -> FloatArray:
        return np.arange(-_HISTOGRAM_HALF, _HISTOGRAM_HALF + 1) * HISTOGRAM_BIN


def find_changes(options: ChangeOptions, progress: Progress, parameters: ChangeParameters = CHANGE) -> Found:
    """Compare the DSMs, and write the rasters that the options name.

    Raises ImageError, OverlapError and OptionError for unsuitable input, EmptyResultError where nothing can be
    compared, WorkspaceError where a file cannot be written.
    """
    with ExitStack() as stack:
        surfaces = Surfaces(options, stack, parameters.detection)
        folder = stack.enter_context(temporary_folder(options.output))
        return _Work(options, surfaces, folder, progress, parameters).found()


class _Work:
    """The passes over both DSMs."""

    def __init__(
        self,
        options: ChangeOptions,
        surfaces: Surfaces,
        folder: str,
        progress: Progress,
        parameters: ChangeParameters,
    ) -> None:
        self._options, self._surfaces, self._progress, self._parameters = options, surfaces, progress, parameters
        self._signs, self._large, self._between = (f"{folder}/{name}.tif" for name in ("signs", "large", "between"))
        self._grid = surfaces.grid
        self._cell_m = math.sqrt(surfaces.cell_m2)
        self._thumbnails = Thumbnails(self._grid.size, ("before", "after", "change"))
        self._histogram = np.zeros(2 * _HISTOGRAM_HALF, np.int64)
        self._compared = 0
        self._levels: List[FloatImage] = []
        self._step = max(1, math.ceil(max(self._grid.size) / parameters.errors.thinned_side))
        columns, rows = self._grid.size
        self._thinned = np.full((-(-rows // self._step), -(-columns // self._step)), np.nan, np.float32)

    def found(self) -> Found:
        surfaces, progress, stable = self._surfaces, self._progress, self._parameters.errors.stable
        progress.step(0.02, "Alignment on stable ground")
        surfaces.alignment = lay_on(surfaces, self._options.align, stable, progress)
        beside = displacement(surfaces, self._options.align, progress)
        left: List[Finding] = []
        if self._options.align == "none":
            apart = lay_on(surfaces, "vertical", stable, progress)
            left = verdict.of_offset(-apart.dz, apart.nmad_after)
        progress.step(0.2, "Errors on stable ground")
        samples = [surfaces.read(window) for window in surfaces.samples()]
        model = fitted_model(samples, self._cell_m, self._parameters.errors)
        parts = [_standardised(cells, model, stable) for cells in samples]
        del samples
        self._detect(model, Part(progress, 0.25, 0.75))
        if not self._compared:
            raise EmptyResultError("No cell has a height in both DSMs: choose DSMs of the same ground.")
        progress.step(0.75, "Volumes")
        correlation = correlation_of(parts, self._thinned, self._cell_m, self._step, self._parameters.errors)
        spread = nmad(np.concatenate([np.empty(0), *(part[np.isfinite(part)] for part in parts)]), 0.0)
        level = float(np.median(np.concatenate(self._levels)))
        usual = level / self._parameters.detection.level * spread
        offset = usual * math.sqrt(correlation.variance_share(self._compared * surfaces.cell_m2))
        changes = self._volumes(model, correlation, offset, Part(progress, 0.75, 0.9))
        largest = max(map(known_m2, (self._options.before, self._options.after)))
        shared = min(self._compared * surfaces.cell_m2 / largest, 1.0)
        drawn, side = self._thumbnails.pictures, self._cell_m * self._thumbnails.factor
        return Found(
            self._grid,
            surfaces.cell_m2,
            surfaces.stated,
            surfaces.alignment,
            model,
            correlation,
            changes,
            self._compared,
            offset,
            level,
            self._histogram,
            drawn,
            side,
            shared,
            [
                *surfaces.warnings,
                *date_findings(
                    self._options.after, self._options.before, (drawn["after"], drawn["before"]), side, beside
                ),
                *partial_finding(shared, (self._options.before, self._options.after)),
                *left,
                *verdict.of_unsure([] if beside else self._unsure, self._parameters.detection.support_alone * level),
            ],
        )

    def _detect(self, model: ErrorModel, progress: Progress) -> None:
        """Write the difference, and what later passes need of each cell."""
        plan, grid = self._parameters.detection, self._grid
        windows = list(overlapping_blocks(grid.size, max(plan.block_cells, self._thumbnails.factor), plan.halo_cells))
        with ExitStack() as stack:
            output = stack.enter_context(self._product(self._options.output, ["AFTER - BEFORE (m)"]))
            signs = stack.enter_context(raster.created(self._signs, self._frame(1, np.uint8), nodata=None, own=True))
            between = stack.enter_context(raster.created(self._between, self._frame(_HIDDEN), own=True))
            for index, (own, wide) in enumerate(windows):
                progress.check_cancelled()
                progress.step(index / len(windows), f"block {index + 1} of {len(windows)}")
                cells, part = self._surfaces.read(wide), own.inside(wide)
                found = detect(cells, model, self._cell_m, plan)
                change, level = found.change[part], found.level[part]
                core_error = np.where(found.core, found.error, np.float32(np.nan))[part]
                cells = cells.inner(part)
                self._count(cells, level, model, own)
                self._thumbnails.draw(own, before=cells.before, after=cells.after)
                output.write(cells.difference, own.col, own.row)
                gain, loss = (np.uint8(value) * (side > 0) for value, side in ((GAIN, change), (LOSS, -change)))
                signs.write((gain + loss).astype(np.uint8), own.col, own.row)
                support = found.strength[part] >= cells.support
                hidden = found.beside_walls[part]
                for band, values in enumerate((change, level, core_error, support, hidden), start=_CHANGE):
                    between.write(values.astype(np.float32), own.col, own.row, band)
                if own.col + own.width == grid.size[0]:
                    for writer in (output, signs, between):
                        writer.flush()  # so that GDAL's cache does not grow
        progress.step(1.0)

    def _count(self, cells: Cells, level: FloatImage, model: ErrorModel, own: Window) -> None:
        """Add a block to the statistics."""
        self._compared += int(np.isfinite(cells.difference).sum())
        standard = _standardised(cells, model, _HISTOGRAM_HALF * HISTOGRAM_BIN)
        bins = np.floor(standard[np.isfinite(standard)] / HISTOGRAM_BIN).astype(np.int64) + _HISTOGRAM_HALF
        self._histogram += np.bincount(np.clip(bins, 0, 2 * _HISTOGRAM_HALF - 1), minlength=2 * _HISTOGRAM_HALF)
        first = -own.row % self._step, -own.col % self._step
        few = np.where(np.abs(standard) <= self._parameters.errors.stable, standard, np.float32(np.nan))
        few = few[first[0] :: self._step, first[1] :: self._step]
        row, col = -(-own.row // self._step), -(-own.col // self._step)
        self._thinned[row : row + few.shape[0], col : col + few.shape[1]] = few
        known = level[first[0] :: self._step, first[1] :: self._step]
        self._levels.append(known[np.isfinite(known)])

    def _volumes(
        self, model: ErrorModel, correlation: Correlation, offset_m: float, progress: Progress
    ) -> List[Changed]:
        """Measure the changes, and write the raster of those that are significant."""
        cell_m2, check = self._surfaces.cell_m2, progress.check_cancelled
        least = math.ceil(self._options.min_area / cell_m2 - 1e-9)
        outlines = Outlines(self._signs, self._large, self._grid, least, check)
        sums, size = Sums(len(outlines)), self._grid.size
        blocks = list(overlapping_blocks(size, max(self._parameters.detection.block_cells, self._thumbnails.factor)))
        with raster.opened(self._between) as between:
            for index, (own, _) in enumerate(blocks):
                check()
                progress.step(0.5 * index / len(blocks), f"block {index + 1} of {len(blocks)}")
                around = Window(own.col - 1, own.row - 1, own.width + 2, own.height + 2)
                inner = own.grown(1, size)
                numbers = np.zeros((around.height, around.width), np.int64)
                numbers[inner.inside(around)] = outlines.numbers(inner)
                bands = _CHANGE, _CORE_ERROR, _SUPPORT, _HIDDEN
                change, core_error, support, hidden = (raster.read(between, own, band) for band in bands)
                sums.add(numbers, change, core_error, support, hidden=hidden)
            plan = self._parameters.detection
            least_m2 = plan.support_share * self._options.min_area
            changes = sums.changes(outlines, model, correlation, cell_m2, offset_m, least_m2, plan)
            self._unsure = [] if self._surfaces.stated else sums.unsupported(cell_m2, least_m2)
            with ExitStack() as stack:
                target = None
                if self._options.significant:
                    target = stack.enter_context(self._product(self._options.significant, SIGNIFICANT_BANDS))
                for index, (own, _) in enumerate(blocks):
                    check()
                    progress.step(0.5 + 0.5 * index / len(blocks), f"block {index + 1} of {len(blocks)}")
                    kept = kept_cells(outlines.numbers(own), changes)
                    change = raster.read(between, own, _CHANGE)
                    change = np.where(kept, change, np.float32(np.nan))
                    self._thumbnails.draw(own, change=_strongest(change, self._thumbnails.factor))
                    if target is not None:
                        target.write(change, own.col, own.row, 1)
                        target.write(raster.read(between, own, _LEVEL), own.col, own.row, 2)
                        if own.col + own.width == size[0]:
                            target.flush()
        if self._options.volumes:
            self._write_volumes(changes)
        return changes

    def _write_volumes(self, changes: Sequence[Changed]) -> None:
        path, crs = str(self._options.volumes), flat_crs(self._grid.crs).to_wkt("WKT2_2019")
        features = ((ogr.CreateGeometryFromWkb(each.outline), each.values) for each in changes)
        write_layer(path, crs, ogr.wkbPolygon, FIELDS, features)

    def _frame(self, bands: int, kind: DTypeLike = np.float32) -> raster.RasterFrame:
        """That of all rasters: their CRS is horizontal, because differences have no vertical datum."""
        flat = flat_crs(self._grid.crs).to_wkt("WKT2_2019")
        return raster.RasterFrame(self._grid.size[::-1], kind, bands, self._grid.transform, flat)

    def _product(self, path: str, bands: Sequence[str]) -> ContextManager[raster.RasterWriter]:
        facts: Dict[str, object] = {
            "REPM_ENGINE": __version__,
            "BEFORE": self._options.before,
            "AFTER": self._options.after,
        }
        frame = self._frame(len(bands))
        return raster.created(path, frame, descriptions=bands, metadata=facts, unit="m", cog=True)


def _standardised(cells: Cells, model: ErrorModel, most: float) -> FloatImage:
    """Differences over their errors where both heights are measured, NaN elsewhere and beyond so many deviations."""
    with np.errstate(invalid="ignore"):
        result = np.where(cells.measured, cells.difference / model.of_cells(cells), np.float32(np.nan))
        return np.where(np.abs(result) <= most, result, np.float32(np.nan))


def _strongest(change: FloatImage, factor: int) -> FloatImage:
    """Each cell of a small picture shows the largest change of its cells."""
    if factor == 1:
        return change
    rows, columns = (-(-length // factor) for length in change.shape)
    padded = np.zeros((rows * factor, columns * factor), np.float32)
    padded[: change.shape[0], : change.shape[1]] = np.nan_to_num(change)
    blocks = padded.reshape(rows, factor, columns, factor).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    chosen = np.take_along_axis(blocks, np.abs(blocks).argmax(axis=-1)[..., None], axis=-1)[..., 0]
    whole = np.repeat(np.repeat(chosen, factor, axis=0), factor, axis=1)[: change.shape[0], : change.shape[1]]
    return np.where(whole != 0, whole, np.float32(np.nan))
