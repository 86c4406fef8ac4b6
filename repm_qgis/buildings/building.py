"""One building: its heights with their errors, its roof, and its solids."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, Optional, Tuple

import numpy as np
from osgeo import ogr
from scipy import ndimage

from ..contracts.arrays import FloatArray, Mask
from ..imagery.cell_polygons import inside
from ..numerics.robust import nmad
from .cells import Cells, Rasters
from .footprints import disc, in_cells
from .parameters import BUILDINGS, BuildingParameters
from .partition import Frame, roof_parts, whole
from .roofs import FLAT, Plane, RoofCells, RoofPlanes, kind_of, roof_planes, spread
from .solids import Face, RoofPart, is_closed, is_flat, solid, volume


@dataclass(frozen=True)
class Heights:
    """Heights of a building, m, in the datum of the DSM: the lowest terrain at its outline, and of its roof the eave,
    the median and the ridge (low, middle and high percentiles of its cells). ``error`` is the standard error of the
    median's height above the ground; ``residual`` the spread of the cells about the roof's model, and
    ``level_residual`` about one height. ``measured`` is the share of the roof's cells whose heights were measured,
    ``gaps`` that of the outline beyond which the DSM has no heights: there, the building may go on."""

    ground: float
    eave: float
    median: float
    ridge: float
    error: float
    residual: float
    level_residual: float
    measured: float
    gaps: float

    @property
    def tall(self) -> float:
        """How high the roof is above the ground, m."""
        return self.median - self.ground


@dataclass(frozen=True)
class Building:
    """A building: its number from 1, its footprint in the DSM's CRS as WKB and that one's area, m2; its heights, the
    kind of its roof, its planes (x, y from ``origin``), and its solids: ``block`` (LoD 1) with one height, and
    ``roofed`` (LoD 2), empty where one height is as good, or the planes give no valid solid. ``scale_m2`` is how many
    square metres on the ground a square metre of the CRS has; area and volume are those on the ground."""

    number: int
    outline: bytes
    area: float
    heights: Heights
    kind: str
    planes: List[Plane]
    origin: Tuple[float, float]
    block: List[Face] = field(default_factory=list)
    roofed: List[Face] = field(default_factory=list)
    scale_m2: float = 1.0

    @property
    def lod(self) -> int:
        return 2 if self.roofed else 1

    @property
    def volume(self) -> float:
        """m3, of the finer solid."""
        return volume(self.roofed or self.block) * self.scale_m2


@dataclass(frozen=True)
class _Patch:
    """The cells around a footprint, with it as a mask, and their place."""

    cells: Cells
    roof: RoofCells
    frame: Frame
    rim: Mask


def building_of(
    rasters: Rasters,
    footprint: ogr.Geometry,
    number: int,
    parameters: BuildingParameters = BUILDINGS,
) -> Optional[Building]:
    """The building on a footprint; None where it has too few heights."""
    patch = _patch(rasters, footprint, parameters)
    known = patch.roof.inner & np.isfinite(patch.cells.above)
    if known.sum() < parameters.heights.least_cells:
        return None
    ground_error = _ground_error(patch, rasters.surface.cell, parameters)
    noise = max(rasters.surface.usual_error, ground_error)
    planes = roof_planes(patch.roof, noise, parameters.roofs)
    heights = _roof_heights(patch, planes, known)
    eave, median, ridge = np.percentile(
        heights, (parameters.heights.eave_percent, 50.0, parameters.heights.ridge_percent)
    )
    ground = _ground(patch)
    if not math.isfinite(ground) or median <= ground:
        return None
    level = spread(heights, np.full_like(heights, median))
    block = solid([whole(footprint)], [Plane(round(float(median), 3), 0.0, 0.0)], round(ground, 3), patch.frame.origin)
    if not is_closed(block):
        return None
    expected = _expected(patch, known)
    roofed, residual = _roofed(footprint, patch, planes, ground, level, expected, parameters)
    beside = patch.rim & ~patch.roof.inside
    error = math.hypot(residual if math.isnan(expected) else expected, ground_error)
    return Building(
        number=number,
        outline=bytes(footprint.ExportToWkb()),
        area=float(footprint.GetArea()) * rasters.scale_m2,
        heights=Heights(
            ground=ground,
            eave=float(eave),
            median=float(median),
            ridge=float(ridge),
            error=max(error, parameters.heights.least_error_m),
            residual=residual,
            level_residual=level,
            measured=float(patch.cells.measured[patch.roof.inside].mean()),
            gaps=float(np.isnan(patch.cells.surface[beside]).mean()) if beside.any() else 0.0,
        ),
        kind=planes.roof_kind(parameters.roofs),
        planes=planes.planes,
        origin=patch.frame.origin,
        block=block,
        roofed=roofed,
        scale_m2=rasters.scale_m2,
    )


def _patch(rasters: Rasters, footprint: ogr.Geometry, parameters: BuildingParameters) -> _Patch:
    surface = rasters.surface
    window = rasters.window(footprint, in_cells(parameters.heights.ring_m, surface.cell) + 1)
    cells = rasters.read(window)
    transform = rasters.grid.window(window).transform
    shape = cells.surface.shape
    within = inside(footprint, shape, transform)
    xmin, xmax, ymin, ymax = footprint.GetEnvelope()
    origin = round((xmin + xmax) / 2, 3), round((ymin + ymax) / 2, 3)
    x = transform[0] + (np.arange(shape[1]) + 0.5) * transform[1] - origin[0]
    y = transform[3] + (np.arange(shape[0]) + 0.5) * transform[5] - origin[1]
    depth = ndimage.distance_transform_edt(np.pad(within, 1))[1:-1, 1:-1] * surface.cell
    known = within & cells.measured & np.isfinite(cells.surface)
    inner = known & (depth > parameters.heights.inner_m)
    if inner.sum() < parameters.heights.least_cells:
        inner = known
    roof = RoofCells(
        height=cells.surface,
        inside=within,
        inner=inner,
        x=np.broadcast_to(x, shape),
        y=np.broadcast_to(y[:, None], shape),
        cell=surface.cell,
    )
    rim = ndimage.binary_dilation(within, disc(1)) & ~ndimage.binary_erosion(within, disc(1))
    return _Patch(cells, roof, Frame(origin, transform), rim)


def _roof_heights(patch: _Patch, roof: RoofPlanes, known: Mask) -> FloatArray:
    """(N,) heights of a roof, m: those of its inner cells, and beside its walls those of its planes, or slopes would
    lack their lower ends."""
    inner = patch.roof.height[known].astype(np.float64)
    beside = patch.roof.inside & ~known
    planes = [plane.at(patch.roof.x, patch.roof.y)[beside & (roof.numbers == i)] for i, plane in enumerate(roof.planes)]
    return np.concatenate([inner, *planes])


def _ground(patch: _Patch) -> float:
    """The lowest terrain at the outline, m; NaN where there is none."""
    rim = patch.cells.ground[patch.rim]
    rim = rim[np.isfinite(rim)]
    return float(rim.min()) if rim.size else math.nan


def _ground_error(patch: _Patch, cell: float, parameters: BuildingParameters) -> float:
    """The spread of the DSM about the terrain on the ground around a building, m; 0 where none is seen."""
    choices = parameters.heights
    away = ndimage.distance_transform_edt(~patch.roof.inside) * cell
    above = patch.cells.above
    with np.errstate(invalid="ignore"):
        ring = (away > choices.ring_from_m) & (away < choices.ring_m) & (np.abs(above) < choices.ring_low_m)
    ring &= patch.cells.measured
    return nmad(above[ring].astype(np.float64), 0.0) if ring.sum() > choices.least_cells else 0.0


def _expected(patch: _Patch, known: Mask) -> float:
    """The error that the DSM expects of a roof, m; NaN where it says none. Neighbours share errors, so many cells are
    no surer than one."""
    expected = patch.cells.error[known]
    expected = expected[np.isfinite(expected)]
    return float(np.median(expected)) if expected.size else math.nan


def _roofed(
    footprint: ogr.Geometry,
    patch: _Patch,
    roof: RoofPlanes,
    ground: float,
    level: float,
    expected: float,
    parameters: BuildingParameters,
) -> Tuple[List[Face], float]:
    """The solid with the roof's planes and the spread of the heights about them; no solid, and the spread about one
    height, where that is as good, or where what the planes explain is no more than the expected error: a false match
    is as smooth as a roof."""
    if not roof.planes or (len(roof.planes) == 1 and kind_of(roof.planes, parameters.roofs) == FLAT):
        return [], level
    origin = patch.frame.origin
    if len(roof.planes) == 1:
        parts = [whole(footprint)]
    else:
        parts = roof_parts(footprint, patch.roof, roof, patch.frame, parameters)
    if not parts:
        return [], level
    modelled = modelled_heights(parts, roof.planes, patch.roof, patch.frame)
    known = patch.roof.inner & np.isfinite(modelled)
    if not known.any():
        return [], level
    away = spread(patch.roof.height[known].astype(np.float64), modelled[known])
    better = away < parameters.roofs.better * level and level - away > max(parameters.roofs.better_m, 0.0)
    better &= math.isnan(expected) or level**2 - away**2 > expected**2
    faces = solid(parts, roof.planes, round(ground, 3), origin) if better else []
    valid = faces and is_closed(faces) and all(map(is_flat, faces)) and volume(faces) > 0
    return (faces, away) if valid else ([], level)


def modelled_heights(parts: List[RoofPart], planes: List[Plane], cells: RoofCells, frame: Frame) -> FloatArray:
    """(rows, columns) the heights of a roof's parts, m; NaN outside of them."""
    found = np.full(cells.inside.shape, np.nan)
    for part in parts:
        here = inside(polygon_of(part), cells.inside.shape, frame.transform)
        found[here] = planes[part.plane].at(cells.x, cells.y)[here]
    return found


def polygon_of(part: RoofPart) -> ogr.Geometry:
    shape = ogr.Geometry(ogr.wkbPolygon)
    for ring in part.rings:
        line = ogr.Geometry(ogr.wkbLinearRing)
        for x, y in [*ring, ring[0]]:
            line.AddPoint_2D(x, y)
        shape.AddGeometry(line)
    return shape
