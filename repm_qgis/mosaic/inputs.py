"""The DSMs of a mosaic: whether they can be put together, and where they lie on its cells."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal
from pyproj.exceptions import ProjError

from ..contracts.arrays import Bounds, Window
from ..contracts.checks import as_text
from ..contracts.errors import ImageError, OptionError
from ..contracts.findings import Finding
from ..contracts.options import MosaicOptions
from ..evaluation.grids import Grid, cell_sides, metric_of, require_place
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import flat_crs, on_earth, projected_crs_at, utm_crs, vertical_part
from ..geometry.ground_metric import MOST_DISTORTION, GroundMetric
from ..geometry.tiles import enclosing
from ..geometry.vertical import ELLIPSOID, TAG, HeightDatum
from ..imagery.confidence import confidence_bands
from ..imagery.heights import stated_deviation, to_metres
from ..imagery.raster import opened
from ..runtime.progress import Progress, warn_all
from .parameters import MOSAIC


@dataclass(frozen=True)
class Surface:
    """An input of a mosaic: the file that the user named, a DSM or a scene; the raster with its heights; the
    one with their expected error ("" for none); and why its heights are fixed ("" where they are not)."""

    name: str
    path: str
    confidence: str = ""
    fixed: str = ""


@dataclass(frozen=True)
class Dsm(Surface):
    """A surface with the band of its expected error, and its place in the mosaic.

    ``ratio`` is how many of its cells one cell of the mosaic is wide, ``deviation`` the standard deviation of its
    absolute height, m (None: not stated).
    """

    band: int = 0
    window: Window = Window(0, 0, 0, 0)
    ratio: float = 1.0
    deviation: Optional[float] = None


@dataclass(frozen=True)
class Layout:
    """The mosaic's cells, its projected CRS as WKT, the datum of its heights (None: unknown), and its DSMs."""

    grid: CellGrid
    crs: str
    datum: Optional[HeightDatum]
    dsms: Tuple[Dsm, ...]

    @property
    def file_crs(self) -> str:
        return self.datum.file_crs(self.crs) if self.datum else self.crs

    @property
    def target(self) -> Grid:
        """The mosaic's frame as rasters are warped onto it; its CRS is horizontal, as all have one datum."""
        return Grid("the mosaic", self.grid.size, self.grid.geotransform, self.crs)


@dataclass(frozen=True)
class Found:
    """A DSM's frame, the datum of its heights, and the standard deviation of its absolute height, m (None: not
    stated)."""

    grid: Grid
    datum: Optional[HeightDatum]
    deviation: Optional[float] = None


def layout_of(options: MosaicOptions, surfaces: Sequence[Surface], progress: Progress) -> Layout:
    """Look at all DSMs; raises ImageError for one that cannot be used, and OptionError for an unsuitable CRS."""
    found = []
    for surface in surfaces:
        progress.check_cancelled()
        with opened(surface.path) as dataset:
            found.append(looked_at(dataset, surface.name))
    datum = _common_datum([surface.name for surface in surfaces], found, progress)
    crs, cell, corner = _frame(options, found[0].grid)
    metric = _metric(found[0].grid, crs)
    warn_all(progress, metric.finding(f"the mosaic, {crs.name}"))
    side = cell * min(metric.per_unit)
    ratio = max(_ratio(each.grid, side) for each in found)  # by the finest of all
    if ratio < MOSAIC.finest_cell:
        finest = f"{1.001 * MOSAIC.finest_cell * cell / ratio:.3g} m, a quarter of the finest DSM's cells"
        raise OptionError("RESOLUTION", options.resolution, f"must be at least {finest}: finer cells add no detail")
    boxes = [_bounds_in(each.grid, crs) for each in found]
    west, north = corner
    whole = enclosing(boxes)
    cells = CellGrid.covering((whole.xmin - west, whole.ymin - north, whole.xmax - west, whole.ymax - north), cell)
    grid = replace(cells, west=cells.west + west, north=cells.north + north)
    dsms = tuple(
        Dsm(
            **vars(surface),
            band=_error_band(surface.confidence) if surface.confidence else 0,
            window=grid.window(box),
            ratio=_ratio(each.grid, side),
            deviation=each.deviation,
        )
        for surface, each, box in zip(surfaces, found, boxes)
    )
    return Layout(grid, crs.to_wkt("WKT2_2019"), datum, dsms)


def require_datum_of_scenes(options: MosaicOptions, layout: Layout) -> None:
    """Raise ImageError where the DSMs have another vertical datum than scenes; that is known before these are fused."""
    if options.dsms and layout.datum and layout.datum.name != ELLIPSOID:
        _require_one_datum([(options.dsms[0], layout.datum), (options.scenes[0], HeightDatum("", ELLIPSOID))])


def looked_at(dataset: gdal.Dataset, path: str) -> Found:
    """A DSM's frame and what its heights refer to; ``path`` is how messages name it. Raises ImageError where it has no
    place on the ground, or heights in a unit that is not known."""
    grid = replace(Grid.of(dataset), path=path)
    require_place(grid)
    to_metres(dataset)  # raises ImageError where that cannot be
    crs, deviation = grid.crs, stated_deviation(dataset)
    vertical = vertical_part(crs)
    if vertical is None:
        name = as_text(dataset.GetMetadataItem(TAG) or "")
        return Found(grid, HeightDatum("", name) if name else None, deviation)
    if crs.is_compound:
        return Found(grid, HeightDatum.of(crs.to_wkt("WKT2_2019")), deviation)
    return Found(grid, HeightDatum("", ELLIPSOID if "WGS 84" in vertical else vertical), deviation)


def _common_datum(paths: Sequence[str], found: Sequence[Found], progress: Progress) -> Optional[HeightDatum]:
    """What all heights refer to; raises ImageError where two DSMs say otherwise."""
    known = [(path, each.datum) for path, each in zip(paths, found) if each.datum is not None]
    _require_one_datum(known)
    silent = [path for path, each in zip(paths, found) if each.datum is None]
    if silent:
        more = f" and {len(silent) - 1} more" if len(silent) > 1 else ""
        others = known[0][1].name if known else "one datum, which is unknown"
        text = f"'{silent[0]}'{more} do not state" if more else f"'{silent[0]}' does not state"
        progress.warn(
            Finding("datum-unknown", f"{text} a vertical datum: all heights are assumed to refer to {others}.")
        )
    return known[0][1] if known else None


def _require_one_datum(known: Sequence[Tuple[str, HeightDatum]]) -> None:
    for path, datum in known:
        if datum.name != known[0][1].name:
            first = f"'{known[0][0]}' has heights above '{known[0][1].name}', '{path}' above '{datum.name}'"
            raise ImageError(f"{first}: convert all DSMs to one vertical datum first.")


def _frame(options: MosaicOptions, first: Grid) -> Tuple[pyproj.CRS, float, Tuple[float, float]]:
    """The mosaic's CRS and cell size, and a corner of its cells: those of the first DSM where nothing else is asked."""
    own, (_, width, turn, _, tilt, height) = flat_crs(on_earth(first.crs, first.path)), first.transform
    middle = pyproj.Transformer.from_crs(own, "EPSG:4326", always_xy=True).transform(*_middle(first))
    if options.crs:
        crs = projected_crs_at(options.crs, *middle)
    elif own.is_projected and all(abs(axis.unit_conversion_factor - 1.0) < 1e-9 for axis in own.axis_info):
        crs = own
    else:
        such = f"such as {utm_crs(*middle)}"
        raise ImageError(f"'{first.path}' is in {own.name}, whose unit is not the metre: give a projected CRS, {such}.")
    cell = math.sqrt(abs(width * height - turn * tilt))
    here, there = metric_of(first), _metric(first, crs)
    if here.unit_m is not None and max(here.distortion, there.distortion) <= MOST_DISTORTION:
        cell *= here.unit_m
    elif crs != own:  # as large on the ground
        cell *= math.sqrt(here.area_per_unit / there.area_per_unit)
    cell = float(f"{cell:.6g}")
    same = crs == own and not turn and not tilt and width == -height
    if same and options.resolution in (0.0, width):
        return crs, width, (first.transform[0], first.transform[3])
    return crs, options.resolution or cell, (0.0, 0.0)


def _metric(first: Grid, crs: pyproj.CRS) -> GroundMetric:
    """The scale of the mosaic's CRS in the middle of the first DSM."""
    to_crs = pyproj.Transformer.from_crs(flat_crs(first.crs), crs, always_xy=True)
    x, y = to_crs.transform(*_middle(first))
    return GroundMetric.at(crs, x, y)


def _middle(grid: Grid) -> Tuple[float, float]:
    xmin, ymin, xmax, ymax = grid.bounds
    return (xmin + xmax) / 2, (ymin + ymax) / 2


def _bounds_in(grid: Grid, crs: pyproj.CRS) -> Bounds:
    transformer = pyproj.Transformer.from_crs(flat_crs(grid.crs), crs, always_xy=True)
    try:
        bounds = Bounds(*transformer.transform_bounds(*grid.bounds, densify_pts=21))
    except ProjError:
        bounds = Bounds(math.nan, math.nan, math.nan, math.nan)
    if not np.isfinite(bounds).all():
        raise ImageError(f"The DSM '{grid.path}' has no place in {crs.name}: choose a CRS that suits all DSMs.")
    return bounds


def _ratio(grid: Grid, side: float) -> float:
    """How many of a DSM's cells one of this side (m) is wide."""
    return side / min(cell_sides(grid))


def _error_band(path: str) -> int:
    """The band with the expected error, m."""
    with opened(path) as dataset:
        Grid.of(dataset).crs  # noqa: B018 - raises ImageError where there is none
        return confidence_bands(dataset, "CONFIDENCES").error
