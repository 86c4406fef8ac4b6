"""Point clouds (LAS, LAZ): their points in parts; as references, means over cells, as a raster of them would have."""

from __future__ import annotations

import math
import struct
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Callable, Iterator, Optional

import numpy as np
import pyproj

from ..contracts.arrays import Bounds, FloatArray, Mask
from ..contracts.errors import ImageError, RepmError
from ..files.las import impossible_header, required_laspy
from ..files.untrusted import refusal_of
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import flat_crs, on_earth
from ..geometry.vertical import metres_per_unit, stated_datum
from .found import FoundHeights, Within, no_heights, places_unit
from .parameters import REGISTRATION, RegistrationParameters
from .rasters import slopes_of

_POINTS, _BYTES = 1_000_000, 256 << 20  # that are read at once, at most
_MARGIN_M = 1.0  # by which a cloud may extend beyond the bounds in its header
_DAMAGED = (OSError, ValueError, ArithmeticError, RuntimeError, LookupError, EOFError, AssertionError, struct.error)
_GROUND, _NOISE = 2, (7, 18)  # classes of LAS 1.4


def read_cloud(
    path: str,
    crs: str,
    bounds: Bounds,
    least_m: float,
    check: Callable[[], None] = lambda: None,
    parameters: RegistrationParameters = REGISTRATION,
) -> FoundHeights:
    """The heights of a cloud within bounds of the scene's projected CRS, as means over cells of ``least_m``, at least.

    A cloud with so few points that hardly any cell has enough of them gives its points themselves.

    Points of the class ground (2) only, where there are any, else all but noise. The scene's surface shows roofs and
    trees, which ground points do not: the robust weights of the solution exclude them. A mean lies at the mean place of
    its points, which on a slope need not be the cell's middle. ``check`` is called between parts, and may raise to
    stop.

    Raises ImageError for a file that cannot be read, or has no CRS; OverlapError where it has no
    points within the bounds; MissingPackageError without laspy.
    """
    with opened_cloud(path) as cloud:
        common = cloud.common(crs, bounds)
        area = (common.xmax - common.xmin) * (common.ymax - common.ymin)
        grid = CellGrid.covering(common, max(least_m, math.sqrt(area / parameters.cloud_cells)))
        ground, others = CellSums(grid), CellSums(grid)
        for part in cloud.parts(crs, common, check):
            others.add(part.xyz)
            ground.add(part.xyz[part.ground])
        system = cloud.system
    ground_only = ground.any()
    sums = ground if ground_only else others
    if sums.share(parameters.cloud_points) < parameters.sparse:
        return _read_points(path, crs, common, ground_only, check, parameters)
    return sums.found(path, parameters.cloud_points, system)


def _read_points(
    path: str,
    crs: str,
    bounds: Bounds,
    ground_only: bool,
    check: Callable[[], None],
    parameters: RegistrationParameters,
) -> FoundHeights:
    """The points themselves; of very many, every second, third ... of them."""
    with opened_cloud(path) as cloud:
        parts = [part.xyz[part.ground] if ground_only else part.xyz for part in cloud.parts(crs, bounds, check)]
        system = cloud.system
    xyz = np.concatenate(parts) if parts else np.empty((0, 3))
    if not len(xyz):
        raise no_heights(path)
    xyz = xyz[:: -(-len(xyz) // parameters.cloud_single)]
    return FoundHeights(
        name=path,
        xy=xyz[:, :2],
        height=xyz[:, 2],
        width_m=(0.0, 0.0),
        datum=stated_datum(system),
        places_in=places_unit(system),
        about=f"Single points, {len(xyz)} of them: they lie too far apart for means over cells.",
    )


@dataclass(frozen=True)
class CloudPart:
    """(N, 3) points in the CRS that was asked for, heights in metres; which are ground, and which the first return of
    their pulse: what a DSM shows."""

    xyz: FloatArray
    ground: Mask
    first: Mask


@dataclass(frozen=True)
class OpenedCloud:
    """A LAS or LAZ file that is open; ``system`` is its CRS."""

    path: str
    reader: Any
    system: pyproj.CRS

    def common(self, crs: str, bounds: Bounds) -> Bounds:
        """Bounds in a projected CRS, cut to those in the cloud's header; raises OverlapError where nothing is left. So
        an area without points does not make cells larger.
        """
        header = self.reader.header
        to_flat = pyproj.Transformer.from_crs(flat_crs(self.system), crs, always_xy=True)
        west, south, east, north = to_flat.transform_bounds(*header.mins[:2], *header.maxs[:2])
        left, bottom = max(west - _MARGIN_M, bounds.xmin), max(south - _MARGIN_M, bounds.ymin)
        right, top = min(east + _MARGIN_M, bounds.xmax), min(north + _MARGIN_M, bounds.ymax)
        if not (left < right and bottom < top):
            raise no_heights(self.path)
        return Bounds(left, bottom, right, top)

    def parts(self, crs: str, bounds: Bounds, check: Callable[[], None] = lambda: None) -> Iterator[CloudPart]:
        """The points within bounds of a projected CRS, but for noise and those that are withheld, some at a time."""
        within = Within(flat_crs(self.system), crs, bounds)
        for points in self.records(check):
            x, y = np.asarray(points.x), np.asarray(points.y)
            kind = np.asarray(points.classification)
            use = within.near(x, y) & meant(points)
            xy, inside = within.places(x[use], y[use])
            xyz = np.column_stack([xy, np.asarray(points.z)[use] * self.unit_m])[inside]
            if len(xyz):
                first = np.asarray(points.return_number)[use][inside] <= 1
                yield CloudPart(xyz, kind[use][inside] == _GROUND, first)

    @property
    def unit_m(self) -> float:
        """The unit of the heights, m."""
        return metres_per_unit(self.system) or 1.0

    def records(self, check: Callable[[], None] = lambda: None) -> Iterator[Any]:
        """All points as laspy's records, some at a time."""
        for points in self.reader.chunk_iterator(max(1, min(_POINTS, _BYTES // self.reader.header.point_format.size))):
            check()
            yield points


def meant(points: Any) -> Mask:
    """(N,) which of laspy's records are points of the ground and of what is on it: neither noise nor withheld."""
    use: Mask = ~np.isin(np.asarray(points.classification), _NOISE) & (np.asarray(points.withheld) == 0)
    return use


@contextmanager
def opened_cloud(path: str, option: str = "REFERENCE") -> Iterator[OpenedCloud]:
    """A point cloud opened for reading; ``option`` is the one that names it.

    Raises ImageError for a file that cannot be read or has no CRS, in the block too, MissingPackageError without laspy.
    """
    laspy, wrong = required_laspy(option), refusal_of(path)
    if wrong:
        raise ImageError(f"'{path}' {wrong}")
    try:
        impossible = impossible_header(path)
        if impossible:
            raise _unreadable(path, impossible)
        with laspy.open(path) as reader:
            yield OpenedCloud(path, reader, _system(path, reader.header))
    except RepmError:
        raise
    except (*_DAMAGED, laspy.errors.LaspyException) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: str, reason: object) -> ImageError:
    return ImageError(f"Cannot read the point cloud '{path}' ({str(reason)[:300]}): get it again.")


def _system(path: str, header: Any) -> pyproj.CRS:
    """The CRS of a cloud; raises ImageError where it has none on the Earth."""
    try:
        system: Optional[pyproj.CRS] = header.parse_crs()
    except (pyproj.exceptions.ProjError, ValueError, LookupError, struct.error) as error:
        raise _unreadable(path, error) from error
    if system is None:
        raise ImageError(f"The point cloud '{path}' has no coordinate reference system: assign it one first (PDAL).")
    return on_earth(system, path)


class CellSums:
    """Sums of the places and heights of points in the cells of a grid."""

    def __init__(self, grid: CellGrid) -> None:
        self._grid, cells = grid, grid.shape[0] * grid.shape[1]
        self._count, self._sums = np.zeros(cells), np.zeros((3, cells))

    def add(self, xyz: FloatArray) -> None:
        """(N, 3) points within the grid."""
        grid = self._grid
        away = xyz[:, :2] - [grid.west, grid.north]
        col, row = (np.abs(away) / grid.cell).astype(np.int64).T
        cell = np.minimum(row, grid.shape[0] - 1) * grid.shape[1] + np.minimum(col, grid.shape[1] - 1)
        self._count += np.bincount(cell, minlength=len(self._count))
        for sums, values in zip(self._sums, (away[:, 0], away[:, 1], xyz[:, 2])):
            sums += np.bincount(cell, values, len(sums))

    def means(self, least: int = 1) -> FloatArray:
        """(rows, columns) mean heights of the cells with at least so many points, NaN in the others."""
        heights = np.full(len(self._count), np.nan)
        known = self._count >= least
        heights[known] = self._sums[2, known] / self._count[known]
        return heights.reshape(self._grid.shape)

    def share(self, least: int) -> float:
        """The share of the points that lie in cells with at least so many."""
        total = float(self._count.sum())
        return float(self._count[self._count >= least].sum()) / total if total else 1.0

    def any(self) -> bool:
        """Whether there is any point."""
        return bool(self._count.any())

    def found(self, path: str, least: int, system: pyproj.CRS) -> FoundHeights:
        """Means of the cells with at least so many points; raises OverlapError where there is none."""
        grid, known = self._grid, self._count >= least
        if not known.any():
            raise no_heights(path)
        x, y, height = self._sums[:, known] / self._count[known]
        slopes = slopes_of(self.means(least), np.diag([grid.cell, -grid.cell])).reshape(-1, 2)[known]
        xy = np.column_stack([x + grid.west, y + grid.north])
        return FoundHeights(
            name=path,
            xy=xy,
            height=height,
            width_m=(grid.cell, grid.cell),
            slopes=slopes,
            datum=stated_datum(system),
            places_in=places_unit(system),
        )
