"""From the DSMs of a series to its maps and volumes, block by block: memory does not grow with them, and blocks change
no result."""

from __future__ import annotations

import math
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import ContextManager, Dict, Iterator, List, Sequence, Tuple, Union

import numpy as np

from .. import __version__
from ..change.errors import Correlation, correlation_of
from ..change.parameters import CHANGE
from ..change.surfaces import displacement, lay_on
from ..change.volumes import GAIN, LOSS, Outlines
from ..contracts.arrays import AnyArray, FloatArray, FloatImage, IntArray, Mask, Window
from ..contracts.documents import Keywords
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..contracts.options import SeriesOptions
from ..evaluation.comparison import Thumbnails
from ..evaluation.coregistration import Alignment
from ..evaluation.grids import Grid
from ..gate.places import known_m2, partial_finding
from ..gate.reliefs import date_findings, far_share, of_dsm
from ..geometry.cell_grid import overlapping_blocks
from ..geometry.frames import flat_crs
from ..geometry.vertical import TAG
from ..imagery import raster
from ..numerics.robust import nmad
from ..reports import verdict
from ..reports.parameters import VERDICT
from ..runtime.progress import Part, Progress, warn_all
from ..runtime.workspace import temporary_folder
from .areas import AreaOverTime, Areas, AreaSums, inside_findings, outlined, unsure_findings, write_areas, write_table
from .errors import DateErrors, errors_of_dates
from .parameters import SERIES, SeriesParameters
from .surfaces import SeriesCells, Stack
from .times import DatedDsm, dated, years_of
from .trend import ChangeDates, Trends, around, change_dates, coherent_signs, interval_rank, trends

TREND_BANDS = (
    "trend (m per year)",
    "standard error of the trend (m per year)",
    "dates with a height",
    "lower end of the 95 % interval (m per year)",
    "upper end of the 95 % interval (m per year)",
)
_PLAIN_BANDS = 3  # where there are too few dates for an interval
DATE_BANDS = ("number of the first date of change", "number of the last date of change")
_DATE_PX = 500  # of the picture of a date that is compared with the first one
_PICTURES = ("heights", "trend", "first", "last")


@dataclass(frozen=True)
class FoundSeries:
    """What was found. ``offsets`` (dates,) is how far each DSM lay above the first where nothing changed, m, and
    ``alignments`` what each was moved by; ``known`` (dates,) the cells with a height. ``rising`` and ``falling`` are m2
    with a significant trend. The pictures are small ones, with cells of ``picture_cell_m``. ``shared`` is the least
    share of the largest DSM's ground on which a date has heights.
    """

    series: List[DatedDsm]
    years: FloatArray
    grid: Grid
    offsets: FloatArray
    alignments: List[Alignment]
    errors: DateErrors
    known: IntArray
    areas: List[AreaOverTime]
    rising: float
    falling: float
    changed: float
    pictures: Dict[str, FloatImage]
    picture_cell_m: float
    shared: float
    warnings: List[Finding]

    @property
    def shown_m_a(self) -> float:
        """The trend that maps and pictures show in the darkest tone, m per year."""
        size = np.abs(self.pictures["trend"])
        size = size[np.isfinite(size)]
        return max(float(np.percentile(size, 98)), 1e-3) if size.size else 1.0


def find_series(options: SeriesOptions, progress: Progress, parameters: SeriesParameters = SERIES) -> FoundSeries:
    """Put the DSMs on one grid, and write the products that the options name.

    Raises ImageError, OverlapError, InputTableError and OptionError for unsuitable input, EmptyResultError where
    nothing can be compared, WorkspaceError where a file cannot be written.
    """
    series = dated(options.dsms, options.confidences, options.dates)
    with ExitStack() as stack:
        surfaces = Stack(series, stack)
        folder = stack.enter_context(temporary_folder(options.output))
        return _Work(options, series, surfaces, folder, progress, parameters).found()


@dataclass(frozen=True)
class _Block:
    """A block's own cells: heights of all dates and their errors without offsets, the bands of the trend, the numbers
    of the dates of change (0 where there is none), and the sign of what is significant."""

    heights: FloatImage
    errors: FloatImage
    trend: List[FloatImage]
    changed: List[IntArray]
    signs: IntArray


class _Work:
    """The passes over all DSMs."""

    def __init__(
        self,
        options: SeriesOptions,
        series: List[DatedDsm],
        surfaces: Stack,
        folder: str,
        progress: Progress,
        parameters: SeriesParameters,
    ) -> None:
        self._options, self._series, self._surfaces, self._folder = options, series, surfaces, folder
        self._progress, self._parameters = progress, parameters
        self._years = years_of(series)
        self._grid, self._cell_m = surfaces.grid, math.sqrt(surfaces.cell_m2)
        interval = interval_rank(len(series), parameters.share) > 0
        self._bands = len(TREND_BANDS) if interval else _PLAIN_BANDS
        self._thumbnails = Thumbnails(self._grid.size, _PICTURES)
        self._small = Thumbnails(self._grid.size, list(map(str, range(len(series)))), _DATE_PX)
        dates, errors = len(series), CHANGE.errors
        self._known = np.zeros(dates, np.int64)
        self._common = np.zeros(dates, np.int64)
        self._signs = np.zeros(3)
        self._changed = 0
        self._beside = [0.0] * dates
        self._step = max(1, math.ceil(max(self._grid.size) / errors.thinned_side))
        columns, rows = self._grid.size
        self._thinned = np.full((dates, -(-rows // self._step), -(-columns // self._step)), np.nan, np.float32)

    def found(self) -> FoundSeries:
        surfaces, progress = self._surfaces, self._progress
        if self._options.areas:
            surfaces.areas = Areas(self._options.areas, self._grid, progress.warn)
        offsets = self._aligned(Part(progress, 0.0, 0.15))
        removed = self._options.align != "none"
        left = np.zeros_like(offsets) if removed else offsets
        errors = errors_of_dates(surfaces, left, Part(progress, 0.15, 0.18))
        with suppress(EmptyResultError):  # nearly all of it changes: then the first errors are the best that is known
            for start in (0.18, 0.21):  # what changes is seen the better, the less of it is taken as stable
                self._set_moving(errors)
                errors = errors_of_dates(surfaces, left, Part(progress, start, start + 0.03))
        self._maps(errors, Part(progress, 0.25, 0.75))
        if not self._signs.sum():
            raise EmptyResultError(
                "No cell has a height at three dates or more: choose DSMs of the same ground, or with fewer holes."
            )
        progress.step(0.75, "Volumes")
        areas = self._volumes(errors, Part(progress, 0.75, 0.98))
        cell_m2 = surfaces.cell_m2
        rising, falling = (float(self._signs[index] * cell_m2) for index in (2, 0))
        shares = self._known * cell_m2 / max(known_m2(each.path) for each in self._series)
        least, shared = int(shares.argmin()), min(float(shares.min()), 1.0)
        warnings = [
            *surfaces.warnings,
            *([] if removed else self._offset_warnings(errors)),
            *self._date_warnings(),
            *partial_finding(shared, [self._series[least].path]),
        ]
        return FoundSeries(
            self._series,
            self._years,
            self._grid,
            offsets,
            surfaces.alignments,
            errors,
            self._known,
            areas,
            rising,
            falling,
            float(self._changed * cell_m2),
            self._thumbnails.pictures,
            self._cell_m * self._thumbnails.factor,
            shared,
            warnings,
        )

    def _aligned(self, progress: Progress) -> FloatArray:
        """(dates,) how far each date lies above the first where nothing changed, m; what is asked for is removed."""
        method, offsets = self._options.align, [0.0]
        for date in range(1, len(self._series)):
            progress.step(date / len(self._series), f"Alignment of date {date + 1} of {len(self._series)}")
            pair = self._surfaces.pair(0, date)
            found = lay_on(pair, "vertical" if method == "none" else method, CHANGE.errors.stable, progress)
            self._beside[date] = displacement(pair, method, progress)
            offsets.append(-found.dz)
            if method != "none":
                self._surfaces.alignments[date] = found
        return np.array(offsets)

    def _set_moving(self, errors: DateErrors) -> None:
        """Note which cells of the samples change significantly: they, and what is beside them, are no stable ground."""
        for window in self._surfaces.samples():
            self._progress.check_cancelled()
            cells = self._surfaces.read(window)
            signs = self._significant(cells, errors)[2]
            self._surfaces.moving[window] = around(signs != 0, self._parameters.beside_cells) > 0

    def _significant(self, cells: SeriesCells, errors: DateErrors) -> Tuple[Trends, ChangeDates, IntArray]:
        """Trends, dates of change, and the signs of what is significant by one of them, and coherent."""
        spread = errors.of_cells(cells)
        found = trends(self._years, cells.heights, spread, self._parameters)
        dates = change_dates(cells.heights, spread, self._parameters)
        return found, dates, coherent_signs(np.where(found.signs != 0, found.signs, dates.sign))

    def _date_warnings(self) -> List[Finding]:
        """What contradicts that the other dates show the ground of the first one, and what the alignment removed."""
        first, side, drawn, found = self._series[0], self._cell_m * self._small.factor, self._small.pictures, []
        for date, (own, moved) in enumerate(zip(self._series, self._surfaces.alignments)):
            theirs, said = drawn[str(date)], verdict.of_shift((moved.dx, moved.dy, moved.dz))
            if date:
                found += date_findings(own.path, first.path, (theirs, drawn["0"]), side, self._beside[date])
                said += verdict.of_changed(far_share(theirs, drawn["0"]))
            found += of_dsm(own.path, said)
        return found

    def _offset_warnings(self, errors: DateErrors) -> List[Finding]:
        plan, texts = self._parameters, []
        for date, offset, usual in zip(self._series, errors.offset_m, errors.usual_m):
            if abs(offset) > max(plan.offset_errors * usual, plan.least_offset_m):
                where = "from those of the other dates where nothing changed"
                remedy = "register the DSMs, or set ALIGN to vertical or 3d, which removes it"
                if abs(offset) > VERDICT.most_offset_m:
                    remedy = "check the unit of its heights (a foot is 0.3048 m), its vertical datum and its place"
                texts.append(
                    Finding("date-apart", f"The heights of {date.label} lie {offset:+.2f} m {where}: {remedy}.")
                )
        return texts

    # Maps -----------------------------------------------------------------------------------------------------------

    def _blocks(self, halo: int) -> List[Tuple[Window, Window]]:
        """Blocks of all cells: powers of two cut neither thumbnail cells nor a GeoTIFF's tiles."""
        plan = self._parameters
        side = math.sqrt(plan.stack_values / len(self._series))
        side = 1 << int(math.log2(min(max(side, plan.least_block_cells), plan.block_cells)))
        return list(overlapping_blocks(self._grid.size, max(side, self._small.factor), halo))

    def _maps(self, errors: DateErrors, progress: Progress) -> None:
        blocks = self._blocks(2 * CHANGE.detection.coherent_radius + 1)
        with ExitStack() as stack:
            written = [stack.enter_context(each) for each in self._rasters()]
            for index, (own, wide) in enumerate(blocks):
                progress.check_cancelled()
                progress.step(index / len(blocks), f"block {index + 1} of {len(blocks)}")
                block = self._block(errors, own, wide)
                self._count(block, errors, own)
                for file, bands in zip(written, self._layers(block)):
                    for band, values in enumerate(bands, start=1):
                        file.write(values, own.col, own.row, band)
                if own.col + own.width == self._grid.size[0]:
                    for file in written:
                        file.flush()  # so that GDAL's cache does not grow
        progress.step(1.0)

    def _block(self, errors: DateErrors, own: Window, wide: Window) -> _Block:
        cells, (rows, columns) = self._surfaces.read(wide), own.inside(wide)
        found, dates, signs = self._significant(cells, errors)
        signs = signs[rows, columns]
        changed = [np.where(signs != 0, values[rows, columns], 0) for values in (dates.first, dates.last)]
        bands = [values[rows, columns] for values in (found.slope, found.error, found.count, found.low, found.high)]
        plain = errors.of_cells(cells, offsets=False)[:, rows, columns]
        return _Block(cells.heights[:, rows, columns], plain, bands, changed, signs)

    def _rasters(self) -> Iterator[ContextManager[raster.RasterWriter]]:
        """The rasters that are written, in the order of :meth:`_layers`."""
        labels = [each.label for each in self._series]
        shape, place = self._grid.size[::-1], self._grid.transform
        flat = flat_crs(self._grid.crs).to_wkt("WKT2_2019")
        facts: Dict[str, object] = {"REPM_ENGINE": __version__}
        facts.update({f"DATE_{number}": label for number, label in enumerate(labels, start=1)})
        more: Keywords = {"metadata": facts, "cog": True}
        heights = {**more, "metadata": {**facts, **({TAG: self._surfaces.datum} if self._surfaces.datum else {})}}
        stack = raster.RasterFrame(shape, np.float32, len(labels), place, self._surfaces.crs_wkt)
        yield raster.created(self._options.output, stack, descriptions=labels, unit="m", **heights)
        signs = raster.RasterFrame(shape, np.uint8, 1, place, flat)
        yield raster.created(f"{self._folder}/signs.tif", signs, nodata=None, own=True)
        if self._options.trend:
            bands = TREND_BANDS[: self._bands]
            trend = raster.RasterFrame(shape, np.float32, len(bands), place, flat)
            yield raster.created(self._options.trend, trend, descriptions=bands, **more)
        if self._options.changed:
            frame, names = raster.RasterFrame(shape, np.uint8, len(DATE_BANDS), place, flat), DATE_BANDS
            yield raster.created(
                self._options.changed, frame, descriptions=names, nodata=0, overviews="NEAREST", **more
            )

    def _layers(self, block: _Block) -> Iterator[Sequence[AnyArray]]:
        """The bands of each raster in a block."""
        yield list(block.heights)
        yield [np.where(block.signs > 0, GAIN, np.where(block.signs < 0, LOSS, 0)).astype(np.uint8)]
        if self._options.trend:
            yield block.trend[: self._bands]
        if self._options.changed:
            yield [values.astype(np.uint8) for values in block.changed]

    def _count(self, block: _Block, errors: DateErrors, own: Window) -> None:
        """Take up what statistics and pictures need of a block."""
        known = np.isfinite(block.heights)
        self._known += known.sum(axis=(1, 2))
        self._common += (known & known[0]).sum(axis=(1, 2))
        slope = block.trend[0]
        self._signs += np.bincount(block.signs[np.isfinite(slope)] + 1, minlength=3)
        self._changed += int((block.changed[0] > 0).sum())
        first = -own.row % self._step, -own.col % self._step
        row, col = -(-own.row // self._step), -(-own.col // self._step)
        few = (slice(None), slice(first[0], None, self._step), slice(first[1], None, self._step))
        stable = (self._surfaces.stable(own) & (block.signs == 0))[few[1:]]
        standard = _standardised(block.heights[few], block.errors[few], stable, errors.offset_m)
        self._thinned[:, row : row + standard.shape[1], col : col + standard.shape[2]] = standard
        where = self._surfaces.unnamed(own)
        for date, heights in enumerate(block.heights):
            self._small.draw(own, **{str(date): np.where(where, heights, np.float32(np.nan))})
        dates = [_sampled(np.where(each > 0, each, np.nan), self._thumbnails.factor) for each in block.changed]
        self._thumbnails.draw(own, heights=_latest(block.heights), trend=slope, first=dates[0], last=dates[1])

    # Volumes --------------------------------------------------------------------------------------------------------

    def _volumes(self, errors: DateErrors, progress: Progress) -> List[AreaOverTime]:
        """The volumes of all areas over time, written to the files that the options name."""
        shapes, names, wkbs = self._shapes(progress)
        correlations, offset_m = self._correlations(errors, Part(progress, 0.0, 0.4))
        sums, blocks = AreaSums(len(names), len(self._series)), self._blocks(1)
        for index, (own, wide) in enumerate(blocks):
            progress.check_cancelled()
            progress.step(0.4 + 0.6 * index / len(blocks), f"block {index + 1} of {len(blocks)}")
            layers = shapes.apart(own) if isinstance(shapes, Areas) else [shapes.numbers(own)]
            layers = [numbers for numbers in layers if numbers.any()]
            if layers:
                cells, (rows, columns) = self._surfaces.read(wide), own.inside(wide)
                spread = errors.of_cells(cells, offsets=False)[:, rows, columns]
                for numbers in layers:
                    sums.add(numbers, cells.heights[:, rows, columns], spread)
        found = sums.over_time(
            names,
            wkbs,
            self._grid,
            self._years,
            correlations,
            offset_m=offset_m,
            cell_m2=self._surfaces.cell_m2,
            chosen=not self._options.areas,
        )
        if self._options.areas:
            warn_all(progress, inside_findings(found, self._options.areas))
        else:
            warn_all(progress, unsure_findings(found))
            found.sort(key=lambda each: -abs(each.volume[each.last]))
            found = [replace(each, name=str(number)) for number, each in enumerate(found, start=1)]
        if self._options.volumes:
            write_areas(self._options.volumes, self._grid, self._series, found)
        if self._options.table:
            write_table(self._options.table, self._series, found)
        return found

    def _shapes(self, progress: Progress) -> Tuple[Union[Areas, Outlines], List[str], List[bytes]]:
        """The areas, their names and outlines."""
        areas = self._surfaces.areas
        if isinstance(areas, Areas):
            return areas, areas.names, areas.outlines()
        least = max(1, math.ceil(self._options.min_area / self._surfaces.cell_m2 - 1e-9))
        signs, large = (f"{self._folder}/{name}.tif" for name in ("signs", "large"))
        outlines = Outlines(signs, large, self._grid, least, progress.check_cancelled)
        named = outlined(outlines)
        return outlines, list(named), list(named.values())

    def _correlations(self, errors: DateErrors, progress: Progress) -> Tuple[List[Correlation], FloatArray]:
        """(dates,) how alike errors are on stable ground, and how uncertain the height of each date is against the
        first, m: what was not removed of an offset counts whole."""
        surfaces = self._surfaces
        found, offset_m = [], [0.0]
        for date in range(1, len(self._series)):
            progress.check_cancelled()
            progress.step(date / len(self._series))
            both, parts = (0, date), []
            for window in surfaces.samples():
                cells = surfaces.read(window, both)
                spread = errors.of_cells(cells, both, offsets=False)
                left = errors.offset_m[list(both)]
                parts.append(_standardised(cells.heights, spread, surfaces.stable(window), left)[1])
            alike = correlation_of(parts, self._thinned[date], self._cell_m, self._step, CHANGE.errors)
            values = np.concatenate([part[np.isfinite(part)] for part in parts])
            usual = float(np.hypot(errors.usual_m[0], errors.usual_m[date]))
            usual *= nmad(values, 0.0) if values.size else 1.0
            share = alike.variance_share(max(self._common[date], 1) * surfaces.cell_m2)
            found.append(alike)
            offset_m.append(math.hypot(usual * math.sqrt(share), float(errors.offset_m[date] - errors.offset_m[0])))
        return [found[0], *found], np.array(offset_m)


def _standardised(heights: FloatImage, errors: FloatImage, stable: Mask, offsets: FloatArray) -> FloatImage:
    """(dates, rows, columns) what heights differ from those of the first date, without offsets, over the error of that;
    NaN where the ground is not stable, or differs by more than errors do."""
    plain = heights - offsets.astype(np.float32)[:, None, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        result = (plain - plain[0]) / np.hypot(errors, errors[0])
        good = stable & (np.abs(result) <= CHANGE.errors.stable)
        return np.asarray(np.where(good, result, np.float32(np.nan)))


def _sampled(values: FloatImage, factor: int) -> FloatImage:
    """One cell's value for each cell of a small picture: numbers of dates have no mean."""
    if factor == 1:
        return values
    whole = np.repeat(np.repeat(values[::factor, ::factor], factor, axis=0), factor, axis=1)
    return np.asarray(whole[: values.shape[0], : values.shape[1]])


def _latest(heights: FloatImage) -> FloatImage:
    """The heights of the last date that has one."""
    result: FloatImage = heights[0]
    for values in heights[1:]:
        result = np.asarray(np.where(np.isfinite(values), values, result))
    return result
