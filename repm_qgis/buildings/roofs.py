"""The planes of a roof: the ones on which most of its cells lie, one after the other (Fischler and Bolles 1981).

What is tried are the planes of single cells with their neighbours, rather than of three cells anywhere: so few tries
are enough, and cells belong to a plane only where their own slopes agree with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Tuple

import numpy as np
from scipy import ndimage

from ..contracts.arrays import FloatArray, FloatImage, IntArray, Mask
from ..numerics.robust import nmad
from .local_planes import local_planes
from .parameters import BUILDINGS, RoofParameters

FLAT, SHED, GABLE, HIP, STEPPED, OTHER = "flat", "shed", "gable", "hip", "stepped", "other"
"""Kinds of roofs: level; one slope; two slopes that face away from each other; four; level parts at several heights."""


@dataclass(frozen=True)
class Plane:
    """Heights (m): ``height`` + ``east`` * x + ``north`` * y, with x, y in m from the origin of the roof."""

    height: float
    east: float
    north: float

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(self.height + self.east * x + self.north * y)

    @property
    def slope_deg(self) -> float:
        return math.degrees(math.atan(math.hypot(self.east, self.north)))

    @property
    def faces_deg(self) -> float:
        """The direction that water runs in, clockwise from north."""
        return math.degrees(math.atan2(-self.east, -self.north)) % 360.0


@dataclass(frozen=True)
class RoofPlanes:
    """The planes of a roof, and (rows, columns) the number of each cell's plane from 0, -1 outside of the roof."""

    planes: List[Plane]
    numbers: IntArray

    def roof_kind(self, parameters: RoofParameters = BUILDINGS.roofs) -> str:
        """What the roof is called, by its larger planes; "" without planes."""
        cells = np.bincount(self.numbers[self.numbers >= 0], minlength=len(self.planes))
        large = cells >= parameters.kind_share * cells.sum()
        return kind_of([plane for plane, is_large in zip(self.planes, large) if is_large], parameters)


@dataclass(frozen=True)
class RoofCells:
    """The cells of a building: heights (rows, columns), m; which ones are ``inside`` its outline, and which of these
    are ``inner`` ones, away from walls, with a height that was measured. ``x``, ``y`` (rows, columns): places of the
    cells, m from the roof's origin; ``cell`` is their side, m."""

    height: FloatImage
    inside: Mask
    inner: Mask
    x: FloatArray
    y: FloatArray
    cell: float


def roof_planes(cells: RoofCells, noise: float, parameters: RoofParameters = BUILDINGS.roofs) -> RoofPlanes:
    """The planes of a roof whose heights have errors of about ``noise`` (m); without any where it has too few cells."""
    tolerance = max(parameters.tolerance_m, parameters.tolerance_errors * noise)
    total = int(cells.inner.sum())
    least = max(parameters.least_m2 / cells.cell**2, parameters.least_share * total, 4.0)
    own = local_planes(cells.height, cells.inner, max(1, round(1.0 / cells.cell)), cells.cell)
    left = cells.inner & np.isfinite(own.rms)
    numbers = np.full(cells.inner.shape, -1, np.int64)
    planes: List[Plane] = []
    generator = np.random.default_rng(parameters.seed)
    while len(planes) < parameters.most_planes and left.sum() >= least:
        plane, found = _largest(cells, left, (own.east, own.north), tolerance, generator, parameters)
        if found.sum() < least:
            break
        numbers[found] = len(planes)
        planes.append(plane)
        left &= ~found
    return _everywhere(cells, planes, numbers, tolerance)


def _largest(
    cells: RoofCells,
    left: Mask,
    slopes: Tuple[FloatArray, FloatArray],
    tolerance: float,
    generator: np.random.Generator,
    parameters: RoofParameters,
) -> Tuple[Plane, Mask]:
    """The plane with the most connected cells of those that are left, and which these are."""
    rows, columns = np.nonzero(left)
    if len(rows) > parameters.most_cells:
        chosen = np.sort(generator.choice(len(rows), parameters.most_cells, replace=False))
        rows, columns = rows[chosen], columns[chosen]
    x, y, z = (values[rows, columns].astype(np.float64) for values in (cells.x, cells.y, cells.height))
    east, north = (values[rows, columns] for values in slopes)
    best, most = np.zeros(len(rows), bool), -1
    limit = math.tan(math.radians(parameters.turned_deg))
    for index in generator.integers(len(rows), size=parameters.tries):
        away = np.abs(z - z[index] - east[index] * (x - x[index]) - north[index] * (y - y[index]))
        turned = np.hypot(east - east[index], north - north[index])
        on = (away < tolerance) & (turned < limit)
        if on.sum() > most:
            best, most = on, int(on.sum())
    plane = fitted(x[best], y[best], z[best])
    found = np.zeros_like(left)
    for _ in range(2):
        away = np.abs(cells.height - plane.at(cells.x, cells.y))
        turned = np.hypot(slopes[0] - plane.east, slopes[1] - plane.north)
        with np.errstate(invalid="ignore"):
            on = left & (away < tolerance) & (turned < limit)
        labels, count = ndimage.label(on)
        if not count:
            return plane, found
        sizes = np.bincount(labels.ravel())[1:]
        found = labels == 1 + int(np.argmax(sizes))
        plane = _fitted_on(cells, found)
    return plane, found


def _fitted_on(cells: RoofCells, chosen: Mask) -> Plane:
    x, y, heights = (values[chosen].astype(np.float64) for values in (cells.x, cells.y, cells.height))
    return fitted(x, y, heights)


def fitted(x: FloatArray, y: FloatArray, z: FloatArray) -> Plane:
    """The least-squares plane through (N,) places and heights, m; level where they are too few or in a row."""
    if len(z) < 3:
        return Plane(float(z.mean()) if len(z) else 0.0, 0.0, 0.0)
    centre = x.mean(), y.mean(), z.mean()
    design = np.column_stack([x - centre[0], y - centre[1]])
    (east, north), _, rank, _ = np.linalg.lstsq(design, z - centre[2], rcond=1e-6)
    if rank < 2:
        east = north = 0.0
    return Plane(float(centre[2] - east * centre[0] - north * centre[1]), float(east), float(north))


def _everywhere(cells: RoofCells, planes: List[Plane], numbers: IntArray, tolerance: float) -> RoofPlanes:
    """Every cell of the building with the plane of the nearest cells that lie on one; planes that are one surface are
    joined."""
    if not planes:
        return RoofPlanes([], np.where(cells.inside, 0, -1))
    planes, numbers = _joined(cells, planes, numbers, tolerance)
    nearest = ndimage.distance_transform_edt(numbers < 0, return_distances=False, return_indices=True)
    return RoofPlanes(planes, np.where(cells.inside, numbers[tuple(nearest)], -1))


def _joined(cells: RoofCells, planes: List[Plane], numbers: IntArray, tolerance: float) -> Tuple[List[Plane], IntArray]:
    """Planes that one plane fits about as well are one."""
    numbers = numbers.copy()
    changed = True
    while changed:
        changed = False
        for one in range(len(planes)):
            for other in range(len(planes) - 1, one, -1):
                parts = [numbers == one, numbers == other]
                both = parts[0] | parts[1]
                together = _fitted_on(cells, both)
                away = np.abs(cells.height - together.at(cells.x, cells.y))
                if all(float(np.median(away[part])) < tolerance / 2 for part in parts):
                    planes = [together if k == one else plane for k, plane in enumerate(planes) if k != other]
                    numbers[parts[1]] = one
                    numbers[numbers > other] -= 1
                    changed = True
    return planes, numbers


def kind_of(planes: List[Plane], parameters: RoofParameters = BUILDINGS.roofs) -> str:
    """What a roof with these planes is called: one of :data:`FLAT`, :data:`SHED`, ...; "" without planes."""
    if not planes:
        return ""
    level = [plane.slope_deg < parameters.level_deg for plane in planes]
    if all(level):
        return FLAT if len(planes) == 1 else STEPPED
    if len(planes) == 1:
        return SHED
    if any(level):
        return OTHER
    turned = [(plane.faces_deg - planes[0].faces_deg) % 360.0 for plane in planes]
    if len(planes) == 2:
        return GABLE if abs(turned[1] - 180.0) < 2 * parameters.turned_deg else OTHER
    quarters = [round(angle / 90.0) % 4 for angle in turned]
    near = all(abs((angle + 45.0) % 90.0 - 45.0) < parameters.turned_deg for angle in turned)
    return HIP if len(planes) in (3, 4) and near and len(set(quarters)) == len(planes) else OTHER


def spread(height: FloatArray, modelled: FloatArray) -> float:
    """The NMAD of heights from modelled ones, m, about zero."""
    return nmad(np.asarray(height - modelled, np.float64), 0.0)
