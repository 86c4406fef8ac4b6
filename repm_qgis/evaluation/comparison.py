"""Compare a DSM with a reference, on the reference's grid, in blocks: memory does not grow with the rasters."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import Bounds, FloatArray, FloatImage, IntArray, Size, Window
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..geometry.cell_grid import overlapping_blocks
from ..imagery import raster
from ..imagery.heights import read_heights
from ..runtime.progress import Part, Progress
from .classes import ErrorsByClass
from .clouds import Surface
from .coregistration import Alignment, Patch, align, block_means, moved_by
from .grids import Grid, HeightWarper, cell_metres, cell_sides, overlap
from .icp import shift_onto
from .metrics import ErrorCollector, HeightMetrics
from .parameters import EVALUATION, ComparisonParameters, EvaluationParameters
from .profiles import Profile, ProfileLine, middle_lines, sample_profile

HISTOGRAM_BIN_M = 0.001
_HISTOGRAM_HALF = 200_000  # bins on each side of zero
_THUMBNAIL_PX = 1000


@dataclass(frozen=True)
class Comparison:
    """What was found. Thumbnails are (rows, columns) means of ``thumbnail_factor``² cells, NaN = none.

    ``along_normals`` has the signed distances from the reference to the DSM along the reference's normals, not up:
    the height differences times the cosines of the reference's slopes, for cells between neighbours with heights.
    """

    dsm: Grid
    reference: Grid
    cell_m: Tuple[float, float]
    alignment: Alignment
    metrics: HeightMetrics
    exact: bool
    by_slope: List[Tuple[str, HeightMetrics]]
    along_normals: HeightMetrics
    by_class: List[Tuple[str, HeightMetrics]]
    profiles: List[Profile]
    histogram: IntArray
    thumbnails: Dict[str, FloatImage]
    thumbnail_factor: int
    warnings: List[Finding]

    def histogram_edges(self) -> FloatArray:
        """Edges (n + 1,) in metres of the ``histogram``'s bins; the outermost bins hold all that lies beyond."""
        return np.arange(-_HISTOGRAM_HALF, _HISTOGRAM_HALF + 1) * HISTOGRAM_BIN_M


def compare(
    dsm: gdal.Dataset,
    reference: gdal.Dataset,
    method: str,
    *,
    thresholds: Sequence[float],
    progress: Progress,
    error: Optional[raster.RasterWriter] = None,
    classes: Optional[gdal.Dataset] = None,
    lines: Sequence[ProfileLine] = (),
    clouds: Tuple[str, str] = ("", ""),
    parameters: EvaluationParameters = EVALUATION,
) -> Comparison:
    """Compare two open rasters; ``error``, where given, takes DSM - reference on the reference's grid.

    ``method`` is that of :func:`~repm_qgis.evaluation.coregistration.align`, or ``icp``, which goes on from ``3d``
    with the cells of both as points, or with those of the ``clouds`` that they are rasters of ("" = none).
    ``classes`` is a raster for whose values errors are also counted apart, ``lines`` those to cut profiles along
    (none: two through the middle). Raises OverlapError, ImageError (no CRS, no vertical transformation, unreadable,
    no class raster) and EmptyResultError (nothing to compare).
    """
    grid, source = Grid.of(reference), Grid.of(dsm)
    cell, common = cell_metres(grid), overlap(source, grid)
    warper = HeightWarper(dsm, grid, parameters.comparison)
    alignment, astray = Alignment("none"), []
    if method != "none":
        part = Part(progress, 0.0, 0.25, "Alignment")
        patches = _patches(warper, reference, common, part, parameters.comparison)
        if not _any_in_both(patches):
            _require_filled(dsm, reference, cell, common, progress, parameters.comparison)
        by_slopes = "3d" if method == "icp" else method
        alignment = align(by_slopes, patches, cell, progress.check_cancelled, parameters.coregistration)
        if method == "icp":
            ours, theirs = Surface(warper, grid, clouds[0]), Surface(HeightWarper(reference, grid), grid, clouds[1])
            windows = sample_windows(grid, common, parameters.comparison)
            shift = _shift_of_points(ours, theirs, windows, alignment, progress.check_cancelled, parameters)
            apart = float(np.hypot(shift[0] - alignment.dx, shift[1] - alignment.dy))
            alignment = moved_by(method, patches, cell, shift, parameters.coregistration)
            if apart > parameters.icp.most_apart_sides * max(cell_sides(grid)):
                text = f"ALIGN=icp moves the DSM {apart:.2f} m farther to the side than ALIGN=3d"
                remedy = "what is tilted, bent or has grown leads points astray, so compare with 3d"
                astray.append(Finding("icp-apart", f"{text}: {remedy}.", "doubt"))
    by_class = ErrorsByClass(classes, grid, thresholds) if classes is not None else None
    work = _Blocks(warper, reference, cell, alignment, thresholds, by_class, parameters.comparison)
    work.run(Part(progress, 0.25, 1.0, "Comparison"), error)
    metrics = work.total.metrics()
    if metrics.cells == 0:
        _require_filled(dsm, reference, cell, common, progress, parameters.comparison)
        text = f"the reference '{grid.path}' has heights in {metrics.reference_cells} cells, '{source.path}' in none"
        raise EmptyResultError(
            f"No cell has a height in both rasters: {text} of them; choose a reference that covers the DSM."
        )
    along = HeightWarper(reference, grid)
    slopes = [(f"{low:g}–{high:g}°", collector.metrics()) for low, high, collector in work.by_slope]
    kinds = by_class.metrics() if by_class is not None else []
    profiles = [sample_profile(line, warper, along, grid, alignment) for line in lines or middle_lines(common)]
    return Comparison(
        dsm=source,
        reference=grid,
        cell_m=cell,
        alignment=alignment,
        metrics=metrics,
        exact=work.total.exact,
        by_slope=slopes,
        along_normals=work.along_normals.metrics(),
        by_class=kinds,
        profiles=profiles,
        histogram=work.histogram,
        thumbnails=work.thumbnails.pictures,
        thumbnail_factor=work.thumbnails.factor,
        warnings=[*warper.warnings, *astray],
    )


def _shift_of_points(
    dsm: Surface,
    reference: Surface,
    windows: Sequence[Window],
    start: Alignment,
    check: Callable[[], None],
    parameters: EvaluationParameters,
) -> FloatArray:
    """The shift (3,) of the DSM's points onto the reference's, from a shift that is nearly right."""
    points = dsm.points(windows, 0, check)
    around = reference.points(windows, parameters.coregistration.search, check)
    return shift_onto(points, around, np.array([start.dx, start.dy, start.dz]), check, parameters.icp)


def gradient(heights: FloatImage, cell: Tuple[float, float]) -> FloatImage:
    """The steepest rise, m per m, by central differences (rows - 2, columns - 2) of (rows, columns) heights in cells of
    a width and height (m); NaN beside holes."""
    across = (heights[1:-1, 2:] - heights[1:-1, :-2]) / (2 * abs(cell[0]))
    along = (heights[2:, 1:-1] - heights[:-2, 1:-1]) / (2 * abs(cell[1]))
    rise: FloatImage = np.hypot(across, along)
    return rise


class Thumbnails:
    """Small pictures of large rasters that are processed in blocks: ``pictures`` by their names, each (rows, columns)
    means of ``factor``² cells, NaN = none. The factor is a power of two, and so must the blocks' side be."""

    def __init__(self, size: Size, names: Sequence[str], most_px: int = _THUMBNAIL_PX) -> None:
        columns, rows = size
        self.factor = 1 << max(0, math.ceil(math.log2(max(columns, rows) / most_px)))
        shape = (-(-rows // self.factor), -(-columns // self.factor))
        self.pictures = {name: np.full(shape, np.nan, np.float32) for name in names}

    def draw(self, window: Window, **parts: FloatImage) -> None:
        """Put the blocks' values into the pictures of these names."""
        row, column = window.row // self.factor, window.col // self.factor
        for name, values in parts.items():
            small = block_means(values, self.factor)
            self.pictures[name][row : row + small.shape[0], column : column + small.shape[1]] = small


class _Blocks:
    """Processes the reference block by block and collects errors."""

    def __init__(
        self,
        warper: HeightWarper,
        reference: gdal.Dataset,
        cell: Tuple[float, float],
        alignment: Alignment,
        thresholds: Sequence[float],
        by_class: Optional[ErrorsByClass],
        parameters: ComparisonParameters,
    ) -> None:
        self._warper, self._reference, self._grid, self._cell = warper, reference, Grid.of(reference), cell
        self._alignment, self._by_class, self._parameters = alignment, by_class, parameters
        self.total = ErrorCollector(thresholds)
        edges = parameters.slope_edges_deg
        self.by_slope = [(low, high, ErrorCollector.of_part(thresholds)) for low, high in zip(edges, edges[1:])]
        self.along_normals = ErrorCollector.of_part(thresholds)
        self.histogram = np.zeros(2 * _HISTOGRAM_HALF, np.int64)
        self.thumbnails = Thumbnails(self._grid.size, ("dsm", "reference", "error"))

    def run(self, progress: Progress, error: Optional[raster.RasterWriter]) -> None:
        windows = [window for window, _ in overlapping_blocks(self._grid.size, self._side())]
        for index, window in enumerate(windows):
            progress.check_cancelled()
            progress.step(index / len(windows), f"block {index + 1} of {len(windows)}")
            outer = self._reference_with_margin(window)
            reference, cells = outer[1:-1, 1:-1], self._grid.window(window)
            dsm = self._warper.read(cells, self._alignment)
            difference = dsm - reference
            self._collect(difference, reference, gradient(outer, self._cell))
            if self._by_class is not None:
                self._by_class.add(cells, difference, np.isfinite(reference))
            self.thumbnails.draw(window, dsm=dsm, reference=reference, error=difference)
            if error is not None:
                error.write(difference, window.col, window.row)
            if window.col + window.width == self._grid.size[0]:
                _flush(error, self._reference, self._warper.dataset)
        progress.step(1.0)

    def _side(self) -> int:
        """Cells of a block's side: powers of two cut neither thumbnail cells nor a GeoTIFF's tiles."""
        most = math.log2(self._parameters.block_cells)
        power = np.clip(math.log2(self._parameters.source_cells / self._warper.cells_ratio), 6, most)
        return max(self.thumbnails.factor, 1 << int(power))

    def _reference_with_margin(self, window: Window) -> FloatImage:
        """The reference's heights in a window and one cell around it, NaN outside the raster."""
        around = Window(window.col - 1, window.row - 1, window.width + 2, window.height + 2)
        inner = window.grown(1, self._grid.size)
        outer = np.full((around.height, around.width), np.nan, np.float32)
        outer[inner.inside(around)] = read_heights(self._reference, inner)
        return outer

    def _collect(self, difference: FloatImage, reference: FloatImage, rise: FloatImage) -> None:
        known, slope = np.isfinite(reference), np.degrees(np.arctan(rise))
        self.total.add(difference, int(known.sum()))
        values = difference[np.isfinite(difference)]
        bins = np.clip(np.floor(values / HISTOGRAM_BIN_M), -_HISTOGRAM_HALF, _HISTOGRAM_HALF - 1).astype(np.int64)
        self.histogram += np.bincount(bins + _HISTOGRAM_HALF, minlength=2 * _HISTOGRAM_HALF)
        for low, high, collector in self.by_slope:
            inside = known & (slope >= low) & (slope < high)
            collector.add(difference[inside], int(inside.sum()))
        self.along_normals.add(difference / np.hypot(1.0, rise), int((known & np.isfinite(rise)).sum()))


def _flush(error: Optional[raster.RasterWriter], *datasets: gdal.Dataset) -> None:
    """Let GDAL drop blocks that are done: its cache may otherwise take 5 % of the machine's memory."""
    if error is not None:
        error.flush()
    for dataset in datasets:
        dataset.FlushCache()


def _patches(
    warper: HeightWarper, reference: gdal.Dataset, common: Bounds, progress: Progress, parameters: ComparisonParameters
) -> List[Patch]:
    """Parts of both surfaces that the alignment is estimated from."""
    found: List[Patch] = []
    grid = Grid.of(reference)
    windows = sample_windows(grid, common, parameters)
    for index, window in enumerate(windows):
        progress.check_cancelled()
        progress.step(0.5 * index / len(windows), f"reading part {index + 1} of {len(windows)}")
        found.append((warper.read(grid.window(window)), read_heights(reference, window)))
    progress.step(0.5, "estimating the shift")
    return found


def _any_in_both(patches: Sequence[Patch]) -> bool:
    return any(bool((np.isfinite(dsm) & np.isfinite(reference)).any()) for dsm, reference in patches)


def _require_filled(
    dsm: gdal.Dataset,
    reference: gdal.Dataset,
    cell: Tuple[float, float],
    common: Bounds,
    progress: Progress,
    parameters: ComparisonParameters,
) -> None:
    """Raise EmptyResultError where the DSM has heights within the reference's cells, but fills too little of each."""
    grid = Grid.of(reference)
    loose = HeightWarper(dsm, grid, replace(parameters, least_share=1e-6))
    if _any_in_both(_patches(loose, reference, common, Part(progress, 1.0, 1.0), parameters)):
        size, share = f"{abs(cell[0]):.3g} x {abs(cell[1]):.3g} m", f"{100 * parameters.least_share:g} %"
        raise EmptyResultError(
            f"The reference '{grid.path}' covers the DSM '{dsm.GetDescription()}', but its cells are {size}, and the "
            f"DSM has heights in less than {share} of each: choose a finer reference, fill the DSM's holes (FILL), or "
            "make it with larger cells (RESOLUTION)."
        )


def sample_windows(grid: Grid, common: Bounds, parameters: ComparisonParameters) -> List[Window]:
    """The overlap in one window, or where that is large, patches at full resolution spread evenly over it."""
    x, y = common[::2] * 2, np.repeat(common[1::2], 2)
    places = grid.to_cells(np.array(x), y)
    low = (max(0, math.floor(place.min())) for place in places)
    high = (min(most, math.ceil(place.max())) for most, place in zip(grid.size, places))
    whole = Window.spanning(*low, *high)
    if whole.width * whole.height <= parameters.sample_cells:
        return [whole]
    side, count = parameters.patch_cells, parameters.patches
    rows, columns = _starts(whole.row, whole.height, side, count), _starts(whole.col, whole.width, side, count)
    return [Window(c, r, min(side, whole.width), min(side, whole.height)) for r in rows for c in columns]


def _starts(low: int, length: int, side: int, most: int) -> List[int]:
    last = max(length - side, 0)
    count = max(1, min(most, length // side))
    return sorted({round(low + last * (i + 0.5) / count) for i in range(count)})
