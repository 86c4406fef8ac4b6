"""Compare a DSM with a reference, on the reference's grid, in blocks: memory does not grow with the rasters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal

from ..arrays import Window
from ..errors import EmptyResultError, ImageError
from ..geometry.cell_grid import overlapping_blocks
from ..imagery import raster
from ..progress import Part, Progress
from . import coregistration
from .classes import ErrorsByClass
from .coregistration import Alignment, Patch
from .grids import Grid, HeightWarper, aligned_heights, metres_per_unit, overlap, read_heights
from .metrics import ErrorCollector, HeightMetrics
from .profiles import Profile, ProfileLine, cut, through_the_middle

SLOPE_EDGES_DEG = (0.0, 5.0, 15.0, 30.0, 45.0, 90.0)
HISTOGRAM_BIN_M = 0.001
_HISTOGRAM_HALF = 200_000  # bins on each side of zero
_THUMBNAIL_PX = 1000
_SAMPLE_CELLS = 2_000_000  # aligned on all cells up to here, on patches spread over the overlap beyond
_PATCHES, _PATCH_CELLS = 5, 320


@dataclass
class Comparison:
    """What was found. Thumbnails are (rows, columns) float32 means of ``thumbnail_factor``² cells, NaN = none."""

    dsm: Grid
    reference: Grid
    cell_m: Tuple[float, float]
    alignment: Alignment
    metrics: HeightMetrics
    exact: bool
    by_slope: List[Tuple[str, HeightMetrics]]
    by_class: List[Tuple[str, HeightMetrics]]
    profiles: List[Profile]
    histogram: np.ndarray
    thumbnails: Dict[str, np.ndarray]
    thumbnail_factor: int
    warnings: List[str] = field(default_factory=list)

    def histogram_edges(self) -> np.ndarray:
        """Edges (n + 1,) in metres of the ``histogram``'s bins; the outermost bins hold all that lies beyond."""
        return np.arange(-_HISTOGRAM_HALF, _HISTOGRAM_HALF + 1) * HISTOGRAM_BIN_M


def compare(
    dsm: gdal.Dataset,
    reference: gdal.Dataset,
    align: str,
    thresholds: Sequence[float],
    progress: Progress,
    error: Optional[raster.RasterWriter] = None,
    classes: Optional[gdal.Dataset] = None,
    lines: Sequence[ProfileLine] = (),
) -> Comparison:
    """Compare two open rasters; ``error``, where given, takes DSM - reference on the reference's grid.

    ``align`` is one of repm_qgis.options.ALIGNMENTS. ``classes`` is a raster whose values errors are told apart by,
    ``lines`` those to cut profiles along (none: two through the middle). Raises OverlapError, ImageError (no CRS, no
    vertical transformation, unreadable, no class raster) and EmptyResultError (nothing to compare).
    """
    grid, source = Grid.of(reference), Grid.of(dsm)
    cell = _cell_metres(grid)
    common = overlap(source, grid)
    warper = HeightWarper(dsm, grid)
    alignment = _align(align, warper, reference, grid, common, cell, Part(progress, 0.0, 0.25, "Alignment"))
    by_class = ErrorsByClass(classes, grid, thresholds) if classes is not None else None
    work = _Blocks(warper, reference, grid, cell, alignment, thresholds, by_class)
    work.run(Part(progress, 0.25, 1.0, "Comparison"), error)
    metrics = work.total.metrics()
    if metrics.cells == 0:
        raise EmptyResultError(
            f"No cell has a height in both rasters: the reference '{grid.path}' has heights in "
            f"{metrics.reference_cells} cells, '{source.path}' in none of them; choose a reference that covers the DSM."
        )
    along = HeightWarper(reference, grid)
    return Comparison(
        source,
        grid,
        cell,
        alignment,
        metrics,
        work.total.exact,
        [(name, collector.metrics()) for name, collector in zip(slope_names(), work.by_slope)],
        by_class.metrics() if by_class is not None else [],
        [cut(line, warper, along, grid, alignment) for line in lines or through_the_middle(common)],
        work.histogram,
        work.thumbnails,
        work.factor,
        warper.warnings,
    )


def slope_names() -> List[str]:
    return [f"{low:g}–{high:g}°" for low, high in zip(SLOPE_EDGES_DEG, SLOPE_EDGES_DEG[1:])]


def slope_degrees(heights: np.ndarray, cell: Tuple[float, float]) -> np.ndarray:
    """Slope by central differences (rows - 2, columns - 2) of (rows, columns) heights; NaN beside holes."""
    across = (heights[1:-1, 2:] - heights[1:-1, :-2]) / (2 * abs(cell[0]))
    along = (heights[2:, 1:-1] - heights[:-2, 1:-1]) / (2 * abs(cell[1]))
    return np.degrees(np.arctan(np.hypot(across, along)))


class _Blocks:
    """Goes over the reference block by block and collects."""

    def __init__(
        self,
        warper: HeightWarper,
        reference: gdal.Dataset,
        grid: Grid,
        cell: Tuple[float, float],
        alignment: Alignment,
        thresholds: Sequence[float],
        by_class: Optional[ErrorsByClass],
    ) -> None:
        self._warper, self._reference, self._grid, self._cell = warper, reference, grid, cell
        self._by_class = by_class
        self._alignment = alignment
        self.total = ErrorCollector(thresholds)
        self.by_slope = [ErrorCollector(thresholds, keep=0, bin_m=0.005, range_m=200.0) for _ in slope_names()]
        self.histogram = np.zeros(2 * _HISTOGRAM_HALF, np.int64)
        columns, rows = grid.size
        self.factor = 2 ** max(0, math.ceil(math.log2(max(columns, rows) / _THUMBNAIL_PX)))
        shape = (-(-rows // self.factor), -(-columns // self.factor))
        self.thumbnails = {name: np.full(shape, np.nan, np.float32) for name in ("dsm", "reference", "error")}

    def run(self, progress: Progress, error: Optional[raster.RasterWriter]) -> None:
        windows = list(_windows(self._grid.size, self._side()))
        for index, (column, row, width, height) in enumerate(windows):
            progress.check_cancelled()
            progress.step(index / len(windows), f"block {index + 1} of {len(windows)}")
            outer, reference = self._reference_with_margin(column, row, width, height)
            cells = self._grid.window(column, row, width, height)
            dsm = aligned_heights(self._warper, cells, self._alignment)
            difference = dsm - reference
            self._collect(difference, reference, slope_degrees(outer, self._cell))
            if self._by_class is not None:
                self._by_class.add(cells, difference, np.isfinite(reference))
            self._draw(column, row, dsm=dsm, reference=reference, error=difference)
            if error is not None:
                error.write(difference, column, row)
            if column + width == self._grid.size[0]:
                _flush(error, self._reference, self._warper.dataset)
        progress.step(1.0)

    def _side(self) -> int:
        """Cells of a block's side: powers of two cut neither thumbnail cells nor a GeoTIFF's tiles."""
        most = 2048 / self._warper.cells_ratio  # its part of the DSM stays small too
        return max(self.factor, 2 ** int(np.clip(math.log2(most), 6, 10)))

    def _reference_with_margin(self, column: int, row: int, width: int, height: int) -> Tuple[np.ndarray, np.ndarray]:
        c0, r0 = max(column - 1, 0), max(row - 1, 0)
        c1, r1 = min(column + width + 1, self._grid.size[0]), min(row + height + 1, self._grid.size[1])
        outer = np.full((height + 2, width + 2), np.nan, np.float32)
        outer[r0 - row + 1 : r1 - row + 1, c0 - column + 1 : c1 - column + 1] = read_heights(
            self._reference, (c0, r0, c1 - c0, r1 - r0)
        )
        return outer, outer[1:-1, 1:-1]

    def _collect(self, difference: np.ndarray, reference: np.ndarray, slope: np.ndarray) -> None:
        known = np.isfinite(reference)
        self.total.add(difference, int(known.sum()))
        values = difference[np.isfinite(difference)]
        bins = np.clip(np.floor(values / HISTOGRAM_BIN_M), -_HISTOGRAM_HALF, _HISTOGRAM_HALF - 1).astype(np.int64)
        self.histogram += np.bincount(bins + _HISTOGRAM_HALF, minlength=2 * _HISTOGRAM_HALF)
        for low, high, collector in zip(SLOPE_EDGES_DEG, SLOPE_EDGES_DEG[1:], self.by_slope):
            inside = known & (slope >= low) & (slope < high)
            collector.add(difference[inside], int(inside.sum()))

    def _draw(self, column: int, row: int, **parts: np.ndarray) -> None:
        for name, values in parts.items():
            small = coregistration.shrunk(values, self.factor)
            r, c = row // self.factor, column // self.factor
            self.thumbnails[name][r : r + small.shape[0], c : c + small.shape[1]] = small


def _flush(error: Optional[raster.RasterWriter], *datasets: gdal.Dataset) -> None:
    """Let GDAL forget blocks that are done with: its cache may take 5 % of the machine's memory otherwise."""
    if error is not None:
        error.flush()
    for dataset in datasets:
        dataset.FlushCache()


def _align(
    align: str,
    warper: HeightWarper,
    reference: gdal.Dataset,
    grid: Grid,
    common: Tuple[float, ...],
    cell: Tuple[float, float],
    progress: Progress,
) -> Alignment:
    if align == "none":
        return Alignment("none")
    progress.step(0.0, "reading")
    patches: List[Patch] = []
    windows = _sample_windows(grid, common)
    for index, window in enumerate(windows):
        progress.check_cancelled()
        progress.step(0.5 * index / len(windows), f"part {index + 1} of {len(windows)}")
        patches.append((warper.read(grid.window(*window)), read_heights(reference, window)))
    progress.step(0.5, "shift")
    if align == "vertical":
        return coregistration.align_vertical(patches)
    return coregistration.align_3d(patches, cell, progress.check_cancelled)


def _sample_windows(grid: Grid, common: Tuple[float, ...]) -> List[Window]:
    """The overlap in one window, or where that is large, in patches at full resolution spread evenly over it."""
    x = np.array([common[0], common[2], common[0], common[2]])
    y = np.array([common[1], common[1], common[3], common[3]])
    column, row = grid.cells(x, y)
    c0, r0 = max(0, math.floor(column.min())), max(0, math.floor(row.min()))
    c1, r1 = min(grid.size[0], math.ceil(column.max())), min(grid.size[1], math.ceil(row.max()))
    if (c1 - c0) * (r1 - r0) <= _SAMPLE_CELLS:
        return [Window.spanning(c0, r0, c1, r1)]
    across = _starts(c0, c1)
    along = _starts(r0, r1)
    return [Window(c, r, min(_PATCH_CELLS, c1 - c), min(_PATCH_CELLS, r1 - r)) for r in along for c in across]


def _starts(low: int, high: int) -> List[int]:
    last = max(high - _PATCH_CELLS, low)
    count = max(1, min(_PATCHES, (high - low) // _PATCH_CELLS))
    return sorted({round(low + (last - low) * (i + 0.5) / count) for i in range(count)})


def _windows(size: Tuple[int, int], side: int) -> Iterator[Window]:
    return (window for window, _ in overlapping_blocks(size, side))


def _cell_metres(grid: Grid) -> Tuple[float, float]:
    """Width and height of a cell in metres; the height is positive where row 0 is in the north."""
    _, b, c, _, e, f = grid.transform
    if grid.transform == (0.0, 1.0, 0.0, 0.0, 0.0, 1.0):
        raise ImageError(f"The reference '{grid.path}' is not georeferenced: give it a place on the ground first.")
    if abs(c) > 1e-9 * abs(b) or abs(e) > 1e-9 * abs(f):
        raise ImageError(
            f"The reference '{grid.path}' has a rotated grid: bring it north up first (Raster > Projections > Warp)."
        )
    per_unit = metres_per_unit(grid)
    return b * per_unit[0], -f * per_unit[1]
