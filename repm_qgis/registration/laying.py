"""Laying the own surface of one scene onto its references, one after the other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds, FloatArray, Floats
from ..contracts.errors import RepmError
from ..contracts.records import GroundShift, ReferenceFigures
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.height_causes import likely_cause
from ..geometry.vertical import HeightDatum
from ..numerics.robust import nmad
from ..planning.height_uncertainty import usual_height_deviation
from ..planning.parameters import PLANNING, PlanningParameters
from ..planning.promises import promised
from ..scene import Scene
from .datums import DatumChoice, likely_datum
from .parameters import REGISTRATION, RegistrationParameters
from .rasters import block_means, slopes_of
from .references import FoundHeights, in_datum
from .solve import Prior, Shift, solve_shift, with_height
from .surfaces import Reference, SupportMeans

Check = Callable[[], None]
_SAME_DATUM_M = 0.02  # by which heights differ in realisations of one datum


@dataclass(frozen=True)
class OwnSurface:
    """A scene's surface: (rows, columns) heights of a grid in its CRS, metres above the ellipsoid, NaN = unknown."""

    crs: str
    grid: CellGrid
    height: Floats

    def averaged(self, factor: int, covered: float) -> OwnSurface:
        """In cells so many times as wide: means of the known cells, where at least ``covered`` of the area is known.

        Coarse cells are not fused at once: where roofs and ground share a cell, a fused height is that of one of them.
        """
        if factor == 1:
            return self
        rows, columns = (-(-count // factor) * factor for count in self.height.shape)
        padded = np.full((rows, columns), np.nan)
        padded[: self.height.shape[0], : self.height.shape[1]] = self.height
        shape = rows // factor, columns // factor
        grid = CellGrid(self.grid.west, self.grid.north, factor * self.grid.cell, shape)
        return OwnSurface(self.crs, grid, block_means(padded, factor, covered))

    def as_reference(self, name: str, crs: str) -> Reference:
        """Its cells as a reference for a surface in another CRS, with their slopes; grid norths that differ by a few
        degrees hardly change means over cells of this size."""
        cell, known = self.grid.cell, np.isfinite(self.height)
        slopes = slopes_of(self.height.astype(np.float64), np.diag([cell, -cell]))[known]
        xy = np.column_stack([each[known] for each in np.meshgrid(*self.grid.centres())])
        if crs != self.crs:
            xy = projected_from_geodetic(crs, geodetic_from_projected(self.crs, xy))
        return Reference(name, np.column_stack([xy, self.height[known]]), (cell, cell), False, slopes)


@dataclass(frozen=True)
class Laid:
    """A surface on a reference: where the datum of its heights comes from, and the shift."""

    reference: Reference
    means: SupportMeans
    datum: HeightDatum
    datum_from: str
    shift: Shift
    choice: Optional[DatumChoice] = None  # where neither the user nor the file states the datum
    about: str = ""  # a sentence about the kind of heights
    other_datum: str = ""  # a sentence where the user's choice is not what the file states

    def cause(self, within_m: float, lon_lat: FloatArray) -> str:
        """What a shift in height of more than ``within_m`` may come from; "" for a smaller one, for one onto another
        relief, and where nothing explains it."""
        up = float(self.shift.moved[2])
        if abs(up) <= within_m or self.shift.other_relief is not None:
            return ""
        middle = float(np.median(self.reference.xyz[:, 2]))
        return likely_cause(-up, middle, float(lon_lat[0]), float(lon_lat[1]), within_m)

    def figures(self) -> ReferenceFigures:
        """What a scene keeps of it."""
        before = self.shift.before_m[np.isfinite(self.shift.before_m)]
        east, north, up = map(float, self.shift.deviations)
        return ReferenceFigures(
            file=self.reference.name,
            datum=self.datum.name,
            datum_from=self.datum_from,
            width_m=self.reference.width_m,
            seen=len(self.shift.xy),
            used=self.shift.used,
            moved=self.shift.ground.moved,
            deviation=(east, north, up),
            determined=tuple((float(a), float(b)) for a, b in self.shift.determined),
            before_m=float(nmad(before)) if len(before) else 0.0,
            after_m=float(nmad(self.shift.after_m, 0.0)),
            bias_m=float(np.median(before)) if len(before) else 0.0,
            range_m=self.shift.range_m,
            other_relief=self.shift.other_relief,
            unsure_m=self.shift.unsure_m,
            about=self.about,
        )

    def left_m(self, ground: GroundShift) -> float:
        """How much higher the surface would have to lie after it was moved, m: measured again, at the heights that gave
        the shift and with their weights. NaN where none of them sees the surface any more."""
        x, y, z = self.reference.xyz.T
        left = z - self.means.at(x - ground.moved[0], y - ground.moved[1])[0]
        left -= ground.up(x - ground.moved[0], y - ground.moved[1])
        count = np.where(np.isfinite(left), self.shift.precision, 0.0)
        return float(count @ np.nan_to_num(left) / count.sum()) if count.any() else math.nan

    def covered(self, parts: int) -> float:
        """The share of the scene's parts with heights, of so many along a side, in which the reference has some too."""
        east, north = self.shift.ground.moved[:2]
        return self.means.shared(self.shift.xy[:, 0] - east, self.shift.xy[:, 1] - north, parts)

    def differences(self, ground: GroundShift) -> Tuple[FloatArray, FloatArray, FloatArray]:
        """(N, 2) places, and (N,) the reference minus the surface, m, before and after it is moved; NaN = unknown."""
        x, y, z = self.reference.xyz.T
        before = z - self.means.at(x, y)[0]
        east, north = x - ground.moved[0], y - ground.moved[1]
        after = z - self.means.at(east, north)[0] - ground.up(east, north)
        seen = np.isfinite(before) | np.isfinite(after)
        return self.reference.xyz[seen, :2], before[seen], after[seen]


def prior_of(
    scene: Scene, planning: PlanningParameters = PLANNING, parameters: RegistrationParameters = REGISTRATION
) -> Prior:
    """The prior of a scene's position before any registration: the vendors' promise, and for heights the usual
    errors."""
    horizontal, up = promised(scene.views, planning)
    ties = scene.pointing
    if ties is not None and not ties.controlled:  # errors that images share do not change heights
        up = min(up, usual_height_deviation(scene.pairs, ties, scene.gsd_m, planning))
    circle = planning.promises.ce90
    return Prior(horizontal, up, max(parameters.search * circle * horizontal, parameters.least_search_m))


def finest_cell(bounds: Bounds, native: float, parameters: RegistrationParameters = REGISTRATION) -> float:
    """The side of the finest cell of a surface that is worth its work, m; ``native`` is that of the DSM."""
    area = (bounds.xmax - bounds.xmin) * (bounds.ymax - bounds.ymin)
    return max(native, math.sqrt(area / parameters.most_cells))


def are_coarse(
    references: Sequence[FoundHeights], native: float, parameters: RegistrationParameters = REGISTRATION
) -> bool:
    """Whether cells twice as wide as the DSM's are enough for all references: rasters with wide cells, whose noise is
    larger than that of the surface, which that of lasers is not."""
    least = 2.0 * native * parameters.coarse_cells
    wide = [found.slopes is not None and min(found.width_m) >= least for found in references]
    return bool(wide) and all(wide)


def factor_for(
    references: Sequence[FoundHeights], finest: float, parameters: RegistrationParameters = REGISTRATION
) -> int:
    """How many times as wide as the finest ones cells of a surface are best, for references."""
    widths = [min(found.width_m) for found in references]
    wanted = min(widths, default=parameters.averaged_cells * finest * parameters.cells_across)
    return max(1, int(wanted / parameters.cells_across / finest + 1e-6))


def solved_on(
    surface: OwnSurface,
    reference: Reference,
    prior: Prior,
    tilted: bool = False,
    check: Check = lambda: None,
    parameters: RegistrationParameters = REGISTRATION,
) -> Tuple[SupportMeans, Shift]:
    """The surface as a reference sees it, and the shift that lays it on that.

    A point stands for itself, and a town's surface has as many shifts that fit a few hundred points as it has edges
    near them. So the position is found on means over some cells, and the height and tilt, which have no such choice, on
    the surface itself. Raises EmptyResultError where too few heights lie on the surface.
    """
    means = SupportMeans(surface.grid, surface.height, reference, parameters.covered)
    if max(reference.width_m) > 0.0:
        return means, solve_shift(means, reference, prior, tilted, check, parameters)
    side = parameters.cells_across * surface.grid.cell
    wide = replace(reference, width_m=(side, side))
    around = SupportMeans(surface.grid, surface.height, wide, parameters.covered)
    shift = solve_shift(around, wide, prior, tilted, check, parameters)
    return means, with_height(shift, means, reference, check, parameters)


def lay(
    surface: OwnSurface,
    found: FoundHeights,
    datum: HeightDatum | None,
    *,
    prior: Prior,
    tilted: bool,
    check: Check,
    parameters: RegistrationParameters = REGISTRATION,
) -> Laid:
    """Lay a surface on a reference. ``datum`` is the user's choice; with None it is the datum that the file states, or
    else the one that fits.

    Raises EmptyResultError where too few heights lie on the surface, OptionError where the datum cannot be found.
    """

    def solved(reference: Reference) -> Shift:
        return solved_on(surface, reference, prior, tilted, check, parameters)[1]

    said, choice, other = "REFERENCE_DATUM says so", None, ""
    if datum is not None and found.datum is not None:
        other = _other_datum(found, surface.crs, datum)
    if datum is None and found.datum is not None:
        datum, said = found.datum, "the file says so"
    if datum is None:
        choice = likely_datum(found, surface.crs, solved, prior.up_m)
        datum, said = choice.datum, choice.sentence
    reference = in_datum(found, surface.crs, datum)
    if choice:
        means, shift = SupportMeans(surface.grid, surface.height, reference, parameters.covered), choice.shift
    else:
        means, shift = solved_on(surface, reference, prior, tilted, check, parameters)
    return Laid(reference, means, datum, said, shift, choice, found.about, other)


def _other_datum(found: FoundHeights, crs: str, chosen: HeightDatum) -> str:
    """A sentence where a file states another datum than the user has chosen, and its heights differ by it."""
    stated = found.datum
    if stated is None or stated.code == chosen.code:
        return ""
    try:
        heights = [in_datum(found, crs, datum).xyz[:, 2] for datum in (chosen, stated)]
        apart = float(np.median(heights[0] - heights[1]))
    except RepmError:  # PROJ lacks a grid
        apart = math.nan
    if abs(apart) < _SAME_DATUM_M:
        return ""
    if math.isfinite(apart):
        return (
            f"'{found.name}' states that its heights refer to {stated.name}, and REFERENCE_DATUM says {chosen.name}, "
            f"which moves them by {apart:+.2f} m: REFERENCE_DATUM is followed. Set it to auto unless the file is wrong."
        )
    return (
        f"'{found.name}' states that its heights refer to {stated.name}, and REFERENCE_DATUM says {chosen.name}: "
        "REFERENCE_DATUM is followed. Set it to auto unless the file is wrong."
    )


def overlaps(surfaces: Sequence[OwnSurface]) -> List[Tuple[int, int]]:
    """The pairs of surfaces whose cells may share ground."""
    boxes = []
    for surface in surfaces:
        x0, y0, x1, y1 = surface.grid.bounds
        corners = np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]])
        there = projected_from_geodetic(surfaces[0].crs, geodetic_from_projected(surface.crs, corners))
        boxes.append((*there.min(axis=0), *there.max(axis=0)))
    return [
        (i, j)
        for i in range(len(boxes))
        for j in range(i + 1, len(boxes))
        if boxes[i][0] < boxes[j][2]
        and boxes[j][0] < boxes[i][2]
        and boxes[i][1] < boxes[j][3]
        and boxes[j][1] < boxes[i][3]
    ]
