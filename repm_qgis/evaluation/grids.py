"""Where a raster's cells lie, and another raster resampled onto them: the ground on which two DSMs are compared."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import List, Optional, Tuple, TypeVar

import numpy as np
from osgeo import gdal, osr
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from ..contracts.arrays import Bounds, FloatArray, FloatImage, Size, Window
from ..contracts.checks import as_text
from ..contracts.errors import ImageError, OverlapError
from ..contracts.findings import Finding
from ..geometry.frames import flat_crs, install_grid, on_earth, vertical_operations, vertical_part
from ..geometry.ground_metric import GroundMetric
from ..geometry.interpolation import upsample_grid
from ..geometry.vertical import ELLIPSOID, TAG, geodetic_with_heights
from ..geometry.vertical import metres_per_unit as unit_of_heights
from ..imagery import raster
from ..imagery.heights import read_heights, read_values
from ..imagery.sampling import sample
from .coregistration import Alignment
from .parameters import COMPARISON, ComparisonParameters

_ROUNDING = 1e-9  # of a cell for each cell along a row: 1e-4 cells over 100,000 of them
_NO_ALIGNMENT = Alignment("none")
_KERNEL_MARGIN = 3  # cells of the source around a window; bilinear needs one at its scale, the rest is for curvature


Places = TypeVar("Places", float, FloatArray)


@dataclass(frozen=True)
class Grid:
    """A raster's frame: ``size`` (columns, rows), GDAL's geotransform, CRS as WKT or other PROJ text ("" = none)."""

    path: str
    size: Size
    transform: Tuple[float, ...]
    wkt: str

    @classmethod
    def of(cls, dataset: gdal.Dataset) -> Grid:
        reference = dataset.GetSpatialRef()
        if reference is not None and dataset.GetMetadataItem(TAG) == ELLIPSOID and reference.GetAxesCount() == 2:
            reference = reference.Clone()
            reference.PromoteTo3D("")  # our own DSMs state their datum in this tag, as GeoTIFF keys cannot
        wkt = as_text(reference.ExportToWkt(["FORMAT=WKT2_2018"])) if reference is not None else ""
        size = dataset.RasterXSize, dataset.RasterYSize
        return cls(dataset.GetDescription(), size, tuple(dataset.GetGeoTransform()), wkt)

    @property
    def crs(self) -> CRS:
        """Raises ImageError where the raster has no CRS, or one that PROJ does not know."""
        if not self.wkt:
            remedy = "assign the right one (Raster > Projections > Assign projection) and try again."
            raise ImageError(f"'{self.path}' has no coordinate reference system: {remedy}")
        try:
            return _parsed(self.wkt)
        except CRSError as error:
            unknown = f"The coordinate reference system of '{self.path}' is not understood ({error})"
            raise ImageError(f"{unknown}: assign the right one and try again.") from error

    @property
    def bounds(self) -> Bounds:
        width, height = self.size
        x, y = self.to_ground(np.array([0, width, 0, width]), np.array([0, 0, height, height]))
        return Bounds(float(x.min()), float(y.min()), float(x.max()), float(y.max()))

    @property
    def is_turned(self) -> bool:
        """Whether rows and columns do not run along the axes of the CRS; rounding in a geotransform turns nothing."""
        _, b, c, _, e, f = self.transform
        return abs(c) > _ROUNDING * abs(b) or abs(e) > _ROUNDING * abs(f)

    @property
    def is_north_up(self) -> bool:
        """Whether columns run east and rows run south, neither turned nor mirrored."""
        return not self.is_turned and self.transform[1] > 0 > self.transform[5]

    @property
    def flat(self) -> Grid:
        """The same cells without a vertical datum: for values that are no heights."""
        return replace(self, wkt=flat_crs(self.crs).to_wkt("WKT2_2019")) if self.wkt else self

    def to_ground(self, column: Places, row: Places) -> Tuple[Places, Places]:
        """Ground x, y of places (numbers or arrays): (0, 0) is the first cell's outer corner, (0.5, 0.5) its centre."""
        a, b, c, d, e, f = self.transform
        return a + b * column + c * row, d + e * column + f * row

    def to_cells(self, x: Places, y: Places) -> Tuple[Places, Places]:
        """The inverse of :meth:`to_ground`."""
        a, b, c, d, e, f = self.transform
        determinant = b * f - c * e
        return ((x - a) * f - (y - d) * c) / determinant, ((y - d) * b - (x - a) * e) / determinant

    def window(self, window: Window) -> Grid:
        """The grid of a part of this raster."""
        x, y = self.to_ground(float(window.col), float(window.row))
        _, b, c, _, e, f = self.transform
        return replace(self, size=(window.width, window.height), transform=(x, b, c, y, e, f))

    def shifted(self, x: float, y: float) -> Grid:
        """The same cells, moved by x, y in units of the CRS."""
        a, b, c, d, e, f = self.transform
        return replace(self, transform=(a + x, b, c, d + y, e, f))


# Work in blocks opens the same rasters many times, and PROJ takes 5 ms for each CRS and each way between two.


@lru_cache(maxsize=64)
def _parsed(wkt: str) -> CRS:
    return CRS.from_user_input(wkt)


@lru_cache(maxsize=64)
def _flat(crs: CRS) -> CRS:
    return flat_crs(crs)


@lru_cache(maxsize=64)
def _between(source: CRS, target: CRS) -> Transformer:
    return Transformer.from_crs(source, target, always_xy=True)


def metric_of(grid: Grid) -> GroundMetric:
    """The true scale of a grid's CRS at its middle."""
    xmin, ymin, xmax, ymax = grid.bounds
    return GroundMetric.at(grid.crs, (xmin + xmax) / 2, (ymin + ymax) / 2)


def metres_per_unit(grid: Grid) -> Tuple[float, float]:
    """How many metres on the ground one unit of x and of y has at the grid's middle; (1, 1) without a CRS."""
    return metric_of(grid).per_unit if grid.wkt else (1.0, 1.0)


def cell_sides(grid: Grid) -> Tuple[float, float]:
    """The sides of a cell along its row and its column, m on the ground, however the grid is turned; positive."""
    _, b, c, _, e, f = grid.transform
    steps = np.array([[b, c], [e, f]])
    along, down = np.linalg.norm(metric_of(grid).jacobian @ steps if grid.wkt else steps, axis=0)
    return float(along), float(down)


def require_place(grid: Grid) -> None:
    """Raise ImageError for a raster that has no place on the ground."""
    if grid.transform == (0.0, 1.0, 0.0, 0.0, 0.0, 1.0):
        raise ImageError(f"The DSM '{grid.path}' is not georeferenced: give it a place on the ground first.")


def cell_metres(grid: Grid) -> Tuple[float, float]:
    """Width and height of a cell in metres on the ground; the height is positive where row 0 is in the north.

    Raises ImageError for a raster without a place on the ground, or with a rotated grid.
    """
    require_place(grid)
    if grid.is_turned:
        rotated = f"The DSM '{grid.path}' has a rotated grid"
        raise ImageError(f"{rotated}: bring it north up first (Raster > Projections > Warp).")
    per_unit = metres_per_unit(grid)
    return grid.transform[1] * per_unit[0], -grid.transform[5] * per_unit[1]


def bounds_on(dsm: Grid, reference: Grid) -> Bounds:
    """The extent of a raster in another one's CRS; NaN where PROJ cannot bring it there."""
    source, target = (flat_crs(on_earth(each.crs, each.path)) for each in (dsm, reference))
    to_reference = Transformer.from_crs(source, target, always_xy=True)
    try:
        return Bounds(*to_reference.transform_bounds(*dsm.bounds, densify_pts=21))
    except ProjError:
        return Bounds(math.nan, math.nan, math.nan, math.nan)


def overlap(dsm: Grid, reference: Grid) -> Bounds:
    """The common extent of both rasters, in the reference's CRS; raises OverlapError with both extents without one."""
    ours, theirs = bounds_on(dsm, reference), reference.bounds
    both = Bounds.between(map(max, ours[:2], theirs[:2]), map(min, ours[2:], theirs[2:]))
    if not (both.xmin < both.xmax and both.ymin < both.ymax):
        raise OverlapError(
            f"The DSMs '{dsm.path}' and '{reference.path}' do not overlap. In {flat_crs(reference.crs).name} the first "
            f"lies at {_text(ours)} and the second at {_text(theirs)}: choose DSMs of the same place, or correct a "
            "wrongly assigned CRS."
        )
    return both


def _text(bounds: Bounds) -> str:
    if all(abs(v) < 1000 for v in bounds):
        return "x {0:.6g}..{2:.6g}, y {1:.6g}..{3:.6g}".format(*[round(v, 5) for v in bounds])
    return "x {0:.0f}..{2:.0f}, y {1:.0f}..{3:.0f}".format(*bounds)


class HeightWarper:
    """One DSM, resampled onto parts of another grid, in that grid's CRS and vertical datum; heights in metres.

    Bilinear, by GDAL's warper, which widens its kernel where it makes cells larger; exact to 0.02 cells. Cells without
    a height have no weight, and where less than ``least_share`` of the kernel has heights the cell is NaN. So nodata is
    never mixed into heights, and holes keep their size, which the completeness would show. (A rule that drops every
    cell next to a hole removes 20 % of the cells of a speckled DSM where the grids lie 0.2 m apart; GDAL's own rule,
    which accepts any weight, closes the small holes.)

    A ``band`` that does not hold heights (``heights`` False) keeps its unit.

    Raises ImageError where the vertical datums differ and PROJ lacks the grid between them.
    """

    def __init__(
        self,
        dataset: gdal.Dataset,
        target: Grid,
        parameters: ComparisonParameters = COMPARISON,
        band: int = 1,
        heights: bool = True,
    ) -> None:
        self._values = read_heights if heights else read_values
        self.dataset, self._source, self._target, self._band = dataset, Grid.of(dataset), target, band
        self._least_share = parameters.least_share
        self._source_flat, self._target_flat = _flat(self._source.crs), _flat(target.crs)
        self._to_source = _between(self._target_flat, self._source_flat)
        self.warnings: List[Finding] = []
        self._units = (1.0, 1.0)
        self.vertical = self._vertical_transformer()

    @property
    def cells_ratio(self) -> float:
        """How many cells of the DSM one target cell is wide."""
        x0, y0, x1, y1 = self._target.bounds
        u, v = (x0 + x1) / 2, (y0 + y1) / 2
        _, b, c, _, e, f = self._target.transform
        x, y = self._to_source.transform([u, u + b, u + c], [v, v + e, v + f])
        column, row = self._source.to_cells(np.asarray(x), np.asarray(y))
        ratio = max(np.hypot(column[i] - column[0], row[i] - row[0]) for i in (1, 2))
        return float(ratio) if np.isfinite(ratio) and ratio > 0 else 1.0

    def read(self, cells: Grid, alignment: Alignment = _NO_ALIGNMENT) -> FloatImage:
        """The aligned DSM on ``cells``, which are a part of the target grid: (rows, columns), NaN = no height."""
        cells = self._before(cells, alignment)
        window = self._source_window(cells)
        heights = self._values(self.dataset, window, self._band) if window is not None else np.empty(0, np.float32)
        good = np.isfinite(heights)
        if window is None or not good.any():
            return np.full(cells.size[::-1], np.nan, np.float32)
        # Both bands go through the same kernel. The second one becomes the share of it that had heights, and with that
        # the level that filled the holes is removed again.
        level = np.float32(heights[good].mean())
        bands = [np.where(good, heights, level), good.astype(np.float32)]
        warped, share = self._warp(bands, self._source.window(window), cells)
        beside = (share >= self._least_share) & (np.abs(share - 1) > 1e-5)
        warped[beside] = level + (warped[beside] - level) / share[beside]
        warped[share < self._least_share] = np.nan
        if self.vertical is not None:
            scale, offset = self._vertical_at(self.vertical, cells, float(level))
            warped = (warped * scale + offset).astype(np.float32)
        return warped + np.float32(alignment.dz)

    def own_cells(self, cells: Grid) -> Grid:
        """The DSM's own cells over a part of the target grid's ground, or, where the two have different CRS, cells of
        their size."""
        if self._source_flat == self._target_flat:
            window = self._source_window(cells) or Window(0, 0, 0, 0)
            return replace(self._source.window(window), wkt=self._target.wkt)
        x, b, c, y, e, f = cells.transform
        columns, rows = (max(1, round(side * self.cells_ratio)) for side in cells.size)
        right, down = cells.size[0] / columns, cells.size[1] / rows
        return replace(cells, size=(columns, rows), transform=(x, b * right, c * down, y, e * right, f * down))

    def heights_of(self, xyz: FloatArray) -> FloatArray:
        """(N,) heights in the target's vertical datum, m, of (N, 3) points in its CRS with heights in the DSM's, m."""
        if self.vertical is None or not len(xyz):
            return xyz[:, 2]
        x, y = self._to_source.transform(xyz[:, 0], xyz[:, 1])
        return self._in_target(self.vertical, x, y, xyz[:, 2])

    def along(self, cells: Grid, alignment: Alignment = _NO_ALIGNMENT) -> FloatImage:
        """The aligned DSM at the centres of one row of cells in any direction: (columns,), NaN = no height.

        Bilinear; a point beside a hole has none. The warper would blur a slanting row, as if it were a reduced picture.
        """
        cells, columns = self._before(cells, alignment), cells.size[0]
        window = self._source_window(cells)
        if window is None:
            return np.full(columns, np.nan, np.float32)
        x, y = self._to_source.transform(*cells.to_ground(np.arange(columns) + 0.5, np.full(columns, 0.5)))
        column, row = self._source.window(window).to_cells(np.asarray(x), np.asarray(y))
        heights = sample(self._values(self.dataset, window, self._band), column - 0.5, row - 0.5)
        if self.vertical is not None and np.isfinite(heights).any():
            scale, offset = self._vertical_at(self.vertical, cells, float(np.nanmean(heights)))
            heights = (heights * scale + offset[0]).astype(np.float32)
        return heights + np.float32(alignment.dz)

    def _before(self, cells: Grid, alignment: Alignment) -> Grid:
        """A surface that moves by (dx, dy) is, at a cell, what it was at the cell minus (dx, dy).

        The scale is that of the target's middle, so that all its parts move alike.
        """
        if not alignment.dx and not alignment.dy:
            return cells
        per_unit = metres_per_unit(self._target)
        return cells.shifted(-alignment.dx / per_unit[0], -alignment.dy / per_unit[1])

    def _source_window(self, cells: Grid) -> Optional[Window]:
        columns, rows = cells.size
        t = np.linspace(0, 1, 21)
        u, v = (a.ravel() for a in np.meshgrid(t * columns, t * rows))
        x, y = self._to_source.transform(*cells.to_ground(u, v))
        column, row = self._source.to_cells(np.asarray(x), np.asarray(y))
        good = np.isfinite(column) & np.isfinite(row)
        if not good.any():
            return None
        margin = _KERNEL_MARGIN + math.ceil(2 * self.cells_ratio)
        low = (math.floor(v[good].min()) - margin for v in (column, row))
        high = (math.ceil(v[good].max()) + margin for v in (column, row))
        return Window.spanning(*low, *high).common(Window(0, 0, *self._source.size))

    def _warp(self, bands: List[FloatImage], source: Grid, cells: Grid) -> List[FloatImage]:
        memory = gdal.GetDriverByName("MEM")
        inputs = _in_memory(memory, source, len(bands), self._source_flat)
        for index, values in enumerate(bands, start=1):
            inputs.GetRasterBand(index).WriteArray(values)
        outputs = _in_memory(memory, cells, len(bands), self._target_flat)
        with raster.quiet():
            done = gdal.Warp(outputs, inputs, resampleAlg="bilinear", errorThreshold=0.02)
        if not done:
            failed = f"'{self._source.path}' could not be resampled onto the grid of '{self._target.path}'"
            reason = gdal.GetLastErrorMsg() or "GDAL gave no reason"
            raise ImageError(f"{failed} ({reason}): check both rasters' CRS.")
        result = [outputs.GetRasterBand(index).ReadAsArray() for index in range(1, len(bands) + 1)]
        inputs = outputs = done = None  # noqa: F841 - closes them
        return result

    def _vertical_transformer(self) -> Optional[Transformer]:
        source, target = self._source.crs, self._target.crs
        ours, theirs = vertical_part(source), vertical_part(target)
        if ours == theirs:
            return None
        if ours is None or theirs is None:
            silent = self._source if ours is None else self._target
            unknown = f"'{silent.path}' does not state its vertical datum"
            self.warnings.append(
                Finding(
                    "datum-unknown",
                    f"{unknown}; its heights are assumed to be in the other raster's ({ours or theirs}).",
                )
            )
            return None
        return self._best_operation(source, target, ours, theirs)

    def _best_operation(self, source: CRS, target: CRS, from_name: str, to_name: str) -> Transformer:
        to_geodetic = Transformer.from_crs(self._target_flat, 4326, always_xy=True)
        place = to_geodetic.transform_bounds(*self._target.bounds, densify_pts=5)
        ours, theirs = geodetic_with_heights(source), geodetic_with_heights(target)
        self._units = unit_of_heights(ours) or 1.0, unit_of_heights(theirs) or 1.0
        group, missing = vertical_operations(ours, theirs, place)
        if not group.transformers:
            grids = f"PROJ's grid {' or '.join(missing)} is not installed" if missing else "PROJ has no transformation"
            remedy = f"{install_grid(missing)}, or transform" if missing else "transform"
            raise ImageError(
                f"Heights of '{self._source.path}' ({from_name}) cannot be transformed into those of "
                f"'{self._target.path}' ({to_name}): {grids}: {remedy} both to one vertical datum first."
            )
        if not group.best_available:
            poor = f"less accurately than possible ({group.transformers[0].description}), because a PROJ grid"
            task = f"Heights are transformed from {from_name} to {to_name}"
            self.warnings.append(Finding("geoid-approximate", f"{task} {poor} is missing: {', '.join(missing)}."))
        return group.transformers[0]

    def _in_target(self, vertical: Transformer, x: FloatArray, y: FloatArray, height: FloatArray) -> FloatArray:
        """Heights in the target's vertical datum, m, at places in the DSM's CRS; PROJ has those of each in its own
        unit."""
        own, theirs = self._units
        lon, lat = _between(self._source_flat, CRS.from_epsg(4326)).transform(x, y)
        return np.asarray(vertical.transform(lon, lat, height / own)[2]) * theirs

    def _vertical_at(self, vertical: Transformer, cells: Grid, height: float) -> Tuple[float, FloatArray]:
        """Scale and offset (rows, columns) of heights, from a coarse lattice: datums differ smoothly."""
        columns, rows = cells.size
        u, v = np.linspace(0.5, columns - 0.5, 9), np.linspace(0.5, rows - 0.5, 9)
        east, north = cells.to_ground(*np.meshgrid(u, v))
        x, y = self._to_source.transform(east.ravel(), north.ravel())
        low, high = (self._in_target(vertical, x, y, np.full(81, h)) for h in (height, height + 100.0))
        scale = (high - low) / 100.0
        if not np.isfinite(low).all():
            task = f"'{self._source.path}' cannot be transformed to the vertical datum of '{self._target.path}'"
            raise ImageError(f"Heights of {task} everywhere: a PROJ grid does not cover the place.")
        return float(np.mean(scale)), upsample_grid((low - scale * height).reshape(9, 9), (rows, columns))


def _in_memory(driver: gdal.Driver, grid: Grid, bands: int, crs: CRS) -> gdal.Dataset:
    dataset = driver.Create("", grid.size[0], grid.size[1], bands, gdal.GDT_Float32)
    dataset.SetGeoTransform(list(grid.transform))
    reference = osr.SpatialReference()
    reference.ImportFromWkt(crs.to_wkt("WKT2_2019"))
    reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    dataset.SetSpatialRef(reference)
    return dataset
