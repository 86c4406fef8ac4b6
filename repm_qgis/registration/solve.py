"""The shift that lays a surface onto a reference, and how well the heights determine it.

Where a surface with slopes g is displaced by s, its heights differ by g·s (Nuth and Kääb 2011, The Cryosphere 5);
here the reference's own resolution is imitated first, and every height is weighted by Tukey's biweight around the mode,
so that trees and roofs above a bare-earth reference count little, with a noise that grows with the slope (Hugonnet et
al. 2022, IEEE JSTARS 15). The noise of the scene's own surface also makes slopes, and these would bias the shift.
Therefore the slopes of a raster reference are the instruments of the solution (instrumental variables; Bound, Jaeger
and Baker 1995 on weak ones): the noise of the reference is independent of that of the surface. Errors of neighbouring
heights are correlated; the covariance of the solution takes their correlation from the residuals, and would be far too
small without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Callable, Iterator, Optional, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Mask
from ..contracts.errors import EmptyResultError
from ..contracts.records import GroundShift, LocalOffset, OtherRelief
from ..numerics.robust import NMAD_FACTOR, nmad, tukey
from . import estimation
from .estimation import Correlation
from .parameters import REGISTRATION, RegistrationParameters
from .surfaces import Reference, SupportMeans

_TUKEY_SCORES = 0.711
"""The mean square of normal residuals by Tukey's weights (limit 4.685), as a share of their weights'."""


@dataclass(frozen=True)
class Prior:
    """The vendor's promise for the pointing: the standard deviations of a position in one direction and of a height, m;
    and the largest shift that is searched."""

    horizontal_m: float
    up_m: float
    most_m: float


@dataclass(frozen=True)
class Shift:
    """What to add to the own surface's coordinates so that it lies on the reference.

    ``ground`` has its tilt around the middle of the surface's cells, zero where none was requested or where the heights
    do not determine it. ``covariance`` (5, 5) of ``moved`` and ``tilt``, as far as they are determined. ``determined``
    (k, 2) are the horizontal directions (unit vectors) that the relief determines well enough; in the others the
    surface stays as it was. Of the reference's heights: (N, 2) ``xy`` of those that see the surface, (N,) their
    differences (reference minus surface, m) ``before_m`` (NaN where the surface was not there) and ``after_m``, and
    their ``weight``; ``range_m`` is how far the differences are correlated. ``offsets`` are those of the surface's
    parts. ``other_relief``: the surface does not have the reference's relief. ``unsure_m``: the standard deviation of a
    direction that is not determined for its size, and the largest that would be. ``precision`` of all heights of the
    reference is what the difference of each counts for the height of the surface, 1 / m².
    """

    ground: GroundShift
    covariance: FloatArray
    determined: FloatArray
    xy: FloatArray
    before_m: FloatArray
    after_m: FloatArray
    weight: FloatArray
    range_m: float
    offsets: Tuple[LocalOffset, ...] = ()
    other_relief: Optional[OtherRelief] = None
    unsure_m: Optional[Tuple[float, float]] = None
    precision: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def moved(self) -> FloatArray:
        """(3,) metres east, north and up, in the middle."""
        return np.array(self.ground.moved)

    @property
    def deviations(self) -> FloatArray:
        """(3,) standard deviations of ``moved``, m."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def used(self) -> int:
        """How many heights have a weight."""
        return int((self.weight > 0).sum())


def solve_shift(
    surface: SupportMeans,
    reference: Reference,
    prior: Prior,
    tilted: bool = False,
    check: Callable[[], None] = lambda: None,
    parameters: RegistrationParameters = REGISTRATION,
) -> Shift:
    """The shift, and a tilt where it is requested and determined; ``check`` is called between steps, and may raise to
    stop.

    Raises EmptyResultError where too few heights of the reference see the surface.
    """
    xyz = reference.xyz
    start = _search(surface, xyz, prior, check, parameters)
    problem = _Problem(surface, reference, parameters)
    found = problem.determined(start, np.eye(2), tilted, check)
    if tilted and not _is_precise(found[1], surface, prior, parameters):
        tilted = False
        found = problem.determined(start, np.eye(2), tilted, check)
    coarse = max(parameters.trusted_widths * max(reference.width_m), parameters.trusted_m)
    most = min(parameters.undetermined * prior.horizontal_m, coarse)
    horizontal, directions = np.linalg.eigh(found[1][:2, :2])
    level = _is_level(xyz[:, 2], found[0], parameters)
    good = (horizontal <= most**2) & (not level)
    unsure = None if level or good.all() else (float(np.sqrt(horizontal[~good].max())), most)
    free = directions[:, good].T
    if not good.all():  # undetermined directions stay as they were
        found = problem.back(found, free, tilted)
    if free.size and problem.is_fine:
        found = problem.refined(found, free, tilted, check)
    solution, covariance, correlation = found
    covariance = covariance + _floor(surface, parameters)
    covariance[:2, :2] += prior.horizontal_m**2 * (np.eye(2) - free.T @ free)
    east, north, up, *tilt = map(float, solution.unknowns)
    seen = solution.seen
    return Shift(
        ground=GroundShift((east, north, up), (tilt[0], tilt[1]), (float(problem.centre[0]), float(problem.centre[1]))),
        covariance=covariance,
        determined=free,
        xy=xyz[seen, :2],
        before_m=xyz[seen, 2] - surface.at(xyz[seen, 0], xyz[seen, 1])[0],
        after_m=solution.residual[seen],
        weight=solution.weight[seen],
        range_m=correlation.range_m,
        offsets=tuple(problem.local_offsets(solution, free, correlation)),
        other_relief=other_relief(xyz[seen, 2] - solution.residual[seen], xyz[seen, 2], parameters),
        unsure_m=unsure,
        precision=solution.weight / solution.noise**2,
    )


def with_height(
    shift: Shift,
    surface: SupportMeans,
    reference: Reference,
    check: Callable[[], None] = lambda: None,
    parameters: RegistrationParameters = REGISTRATION,
) -> Shift:
    """A shift with the height, and the tilt where it has one, that another surface gives in its place: one that was not
    averaged for the position."""
    problem, none, tilted = _Problem(surface, reference, parameters), np.empty((0, 2)), any(shift.ground.tilt)
    solution, own, correlation = problem.determined(np.array([*shift.moved, *shift.ground.tilt]), none, tilted, check)
    seen, xyz, weight = solution.seen, reference.xyz, solution.weight / solution.noise**2
    basis = _basis(none, tilted)
    weighted = (solution.design @ basis * weight[:, None]).T
    follows = np.column_stack(  # how the height and the tilt follow the position
        [estimation.step(weighted @ solution.design @ basis, -weighted @ each, basis) for each in solution.design.T[:2]]
    )
    known = shift.determined.T @ shift.determined
    position = known @ shift.covariance[:2, :2] @ known
    covariance = own + _floor(surface, parameters) + follows @ position @ follows.T
    covariance[:2, :2] = shift.covariance[:2, :2]
    covariance[:2] += position @ follows.T
    covariance[:, :2] += follows @ position
    east, north, up, *tilt = map(float, solution.unknowns)
    return replace(
        shift,
        ground=replace(shift.ground, moved=(east, north, up), tilt=(tilt[0], tilt[1])),
        covariance=covariance,
        xy=xyz[seen, :2],
        before_m=xyz[seen, 2] - surface.at(xyz[seen, 0], xyz[seen, 1])[0],
        after_m=solution.residual[seen],
        weight=solution.weight[seen],
        range_m=correlation.range_m,
        other_relief=other_relief(xyz[seen, 2] - solution.residual[seen], xyz[seen, 2], parameters),
        precision=weight,
    )


def _floor(surface: SupportMeans, parameters: RegistrationParameters) -> FloatArray:
    """(5, 5) the covariance that no number of heights goes below."""
    return np.diag([0.0, 0.0, (parameters.floor_up_cells * surface.cell_m) ** 2, 0.0, 0.0])


def _is_level(heights: FloatArray, solution: _Solution, parameters: RegistrationParameters) -> bool:
    """Whether the reference's (N,) heights differ by less than they disagree with the surface: then the surface's own
    slopes alone make a shift look determined."""
    seen = solution.seen
    low, high = np.quantile(heights[seen], parameters.level)
    return bool(high - low < nmad(solution.residual[seen]))


def other_relief(own: FloatArray, reference: FloatArray, parameters: RegistrationParameters) -> Optional[OtherRelief]:
    """Whether (N,) heights of the surface have another relief than those of the reference; None where they have not,
    or are too level to tell.

    All heights count, not only those with a weight: those were chosen because they agree. A reference of the surface's
    ground leaves less spread than the surface has alone, by the shortest half of both: houses on a plain have none.
    """
    from scipy.stats import spearmanr

    relief, left = nmad(reference), half_spread(own - reference)
    explains = left <= max(parameters.most_left_m, parameters.unexplained * half_spread(own))
    if relief < parameters.relief_m and explains:
        return None
    level = np.ptp(reference) < parameters.least_noise_m or np.ptp(own) < parameters.least_noise_m
    correlation = 0.0 if level else float(spearmanr(own, reference)[0])
    found = OtherRelief(correlation, float(nmad(own) / max(relief, parameters.least_noise_m)))
    most = parameters.most_scaled
    if found.correlation >= parameters.certain_alike:  # of one surface, even a small factor is one of units
        most = parameters.most_alike_scaled
    alike = found.correlation >= parameters.least_alike and 1.0 / most <= found.ratio <= most
    return None if alike and explains else found


def _is_precise(
    covariance: FloatArray, surface: SupportMeans, prior: Prior, parameters: RegistrationParameters
) -> bool:
    """Whether heights at the surface's ends are precise enough with the tilt that was found."""
    ends = np.sqrt(np.diag(covariance)[3:]) * np.array(surface.extent_m) / 2
    return bool((ends <= parameters.undetermined * prior.up_m).all())


def mode(values: FloatArray, share: float) -> float:
    """The middle of the shortest interval that holds a share of the values: their mode, roughly, whatever the tails."""
    ordered = np.sort(values)
    count = max(int(math.ceil(share * len(ordered))), 1)
    if count >= len(ordered):
        return float(np.median(ordered))
    at = int(np.argmin(ordered[count - 1 :] - ordered[: len(ordered) - count + 1]))
    return float(np.median(ordered[at : at + count]))


def _enough(slopes: Optional[FloatArray], parameters: RegistrationParameters) -> Optional[FloatArray]:
    """A reference's (N, 2) slopes, None where most of its heights have none: the rest would not do for all."""
    if slopes is None or np.isfinite(slopes).all(axis=1).mean() < parameters.known_slopes:
        return None
    return slopes


def half_spread(values: FloatArray) -> float:
    """The standard deviation of (N,) values by the shortest interval that holds half of them (Rousseeuw and Leroy
    1988): that of normal ones, whatever the tails."""
    ordered = np.sort(values)
    half = len(ordered) // 2 + 1
    return float((ordered[half - 1 :] - ordered[: len(ordered) - half + 1]).min()) / 1.349


def _known(values: FloatArray) -> FloatArray:
    known: FloatArray = values[np.isfinite(values)]
    return known


def _search(
    surface: SupportMeans,
    xyz: FloatArray,
    prior: Prior,
    check: Callable[[], None],
    parameters: RegistrationParameters,
) -> FloatArray:
    """The shift by whole steps with the least truncated differences, coarse to fine: where the minimum is."""
    some = xyz[:: max(len(xyz) // parameters.search_supports, 1)]
    standing = np.isfinite(surface.at(some[:, 0], some[:, 1])[0]).sum()
    least = max(parameters.keep_share * standing, parameters.least_supports * len(some) / len(xyz))

    def cost(dx: float, dy: float) -> Tuple[float, float]:
        check()
        found = _known(some[:, 2] - surface.at(some[:, 0] - dx, some[:, 1] - dy)[0])
        if len(found) < max(least, 3):
            return math.inf, 0.0
        up = mode(found, parameters.mode_share)
        away = np.abs(found - up)
        cap = parameters.cap_nmad * max(NMAD_FACTOR * float(np.median(away)), parameters.least_noise_m)
        return float(np.minimum(away, cap).mean()), up

    best, (least_cost, up) = (0.0, 0.0), cost(0.0, 0.0)
    if math.isinf(least_cost):
        count = int(np.isfinite(surface.at(xyz[:, 0], xyz[:, 1])[0]).sum())
        few = f"Heights of the reference on the scene's own surface: {count}"
        remedy = f"at least {parameters.least_supports} are needed: choose a reference that covers the scene"
        raise EmptyResultError(f"{few}, and {remedy}.")
    step = prior.most_m / 4
    while step >= surface.resolution_m * parameters.search_step:
        around = 4 if step == prior.most_m / 4 else 2
        offsets = np.arange(-around, around + 1) * step
        centre = best
        for dx in centre[0] + offsets:
            for dy in centre[1] + offsets:
                if math.hypot(dx, dy) <= prior.most_m * 1.01:
                    found, height = cost(dx, dy)
                    if found < least_cost * (1 - 1e-9):
                        best, least_cost, up = (float(dx), float(dy)), found, height
        step /= 2
    return np.array([*best, up])


@dataclass(frozen=True)
class _Solution:
    """(5,) unknowns; of all heights of the reference: residuals, weights (0 .. 1), whether they see the surface,
    noise, m, the (N, 5) design and the (N, 5) instruments."""

    unknowns: FloatArray
    residual: FloatArray
    weight: FloatArray
    seen: Mask
    noise: FloatArray
    design: FloatArray
    instruments: FloatArray


_Found = Tuple[_Solution, FloatArray, Correlation]
"""A solution with its covariance, and the correlation of its differences."""


class _Problem:
    """Heights of a reference as observations of the shift: h = S(p - d) + dz + tilt (p - centre)."""

    def __init__(self, surface: SupportMeans, reference: Reference, parameters: RegistrationParameters) -> None:
        self._surface, self._xyz, self._parameters = surface, reference.xyz, parameters
        self._reference, self._slopes = reference, _enough(reference.slopes, parameters)
        self.is_fine = self._slopes is not None and max(reference.width_m) < parameters.fine_cells * surface.cell_m
        self.centre = np.array(surface.middle)

    def solve(self, start: FloatArray, free: FloatArray, tilted: bool, check: Callable[[], None]) -> _Solution:
        """Gauss-Newton steps with Tukey's weights, from (3,) a shift or (5,) with a tilt; ``free`` (k, 2) are the
        horizontal directions that may change."""
        p, unknowns = self._parameters, np.pad(start, (0, 5 - len(start)))
        basis = _basis(free, tilted)
        for iteration in range(p.iterations):
            check()
            residual, design, seen = self._linearised(unknowns)
            if seen.sum() < p.least_supports:
                few = f"Heights of the reference on the scene's own surface: {int(seen.sum())}"
                raise EmptyResultError(f"{few}. Choose a reference that covers more of the scene.")
            if iteration < 3:  # the middle of the differences until the shift is nearly right
                residual = residual - mode(residual[seen], p.mode_share)
            noise = self._noise(residual, np.hypot(design[:, 0], design[:, 1]), seen)
            weight = tukey(residual / noise / p.tukey) * seen
            weighted = (self._instruments(design) @ basis * (weight / noise**2)[:, None]).T
            step = estimation.step(weighted @ design @ basis, weighted @ residual, basis)
            longest = np.hypot(*step[:2])
            most = 2.0 * self._surface.resolution_m
            if longest > most:
                step = step * (most / longest)
            unknowns = unknowns + step
            if iteration >= 3 and np.abs(step[:3]).max() < p.converged_m:
                break
        residual, design, seen = self._linearised(unknowns)
        noise = self._noise(residual, np.hypot(design[:, 0], design[:, 1]), seen)
        weight = tukey(np.where(seen, residual, np.inf) / noise / p.tukey) * seen
        return _Solution(unknowns, residual, weight, seen, noise, design, self._instruments(design))

    def _instruments(self, design: FloatArray) -> FloatArray:
        """The design with the reference's own slopes, where it has some."""
        if self._slopes is None:
            return design
        known = np.isfinite(self._slopes).all(axis=1) & (design[:, 2] > 0)
        return np.column_stack([np.where(known[:, None], -self._slopes, 0.0), design[:, 2:]])

    def _linearised(self, unknowns: FloatArray) -> Tuple[FloatArray, FloatArray, Mask]:
        """(N,) residuals h - predicted, (N, 5) derivatives of the prediction, and which heights see the surface."""
        x, y, z = self._xyz.T
        value, east, north = self._surface.at(x - unknowns[0], y - unknowns[1])
        away = self._xyz[:, :2] - self.centre
        seen = np.isfinite(value)
        design = np.column_stack([-east, -north, np.ones(len(x)), away])  # the third is 0 where nothing is seen
        residual = z - value - unknowns[2] - away @ unknowns[3:]
        return np.where(seen, residual, 0.0), np.where(seen[:, None], design, 0.0), seen

    def _noise(self, residual: FloatArray, slope: FloatArray, seen: Mask) -> FloatArray:
        """(N,) standard deviation of the differences by slope, from the lower half of them: trees lie above."""
        p = self._parameters
        known = residual[seen]
        edges = np.quantile(slope[seen], np.linspace(0, 1, p.slope_bins + 1))
        middle, spread = [], []
        for low, high in zip(edges[:-1], edges[1:]):
            inside = known[(slope[seen] >= low) & (slope[seen] <= high)]
            if len(inside) >= 20:
                middle.append((low + high) / 2)
                spread.append(max(nmad(inside, 0.0), p.least_noise_m))
        if not middle:
            return np.full(len(residual), max(nmad(known, 0.0), p.least_noise_m))
        return np.asarray(np.interp(slope, middle, spread))

    # How well it is determined -------------------------------------------------------------------------------------

    def determined(self, start: FloatArray, free: FloatArray, tilted: bool, check: Callable[[], None]) -> "_Found":
        """The solution with its covariance, and the correlation of its differences."""
        solution = self.solve(start, free, tilted, check)
        correlation = self.correlation(solution)
        basis = _basis(free, tilted)
        return solution, self._whole(solution, basis, correlation), correlation

    def _whole(self, solution: _Solution, basis: FloatArray, correlation: Correlation) -> FloatArray:
        """The covariance by all heights that have a weight.

        Instruments do not know the surface's noise; without them, of several lengths for the slope of the equations,
        that counts which says less of the position.
        """
        use, lattice = solution.weight > 0, self._parameters.lattice
        if self._slopes is not None:
            return self.covariance(solution, basis, correlation, use, lattice)
        steps = [step * self._surface.resolution_m for step in self._parameters.slope_steps]
        found = [
            self.covariance(solution, basis, correlation, use, lattice, self.slope(solution, basis, step_m))
            for step_m in steps
        ]
        return max(found, key=lambda each: float(np.trace(each[:2, :2]) + each[2, 2]))

    def back(self, found: "_Found", free: FloatArray, tilted: bool) -> "_Found":
        """A solution whose directions that are not ``free`` are set back to their start.

        Heights follow by the mean slope alone, with the weights of the solution: elsewhere, houses and trees stand
        beside those of the reference, and their differences would have no mode at the ground.
        """
        solution, _, correlation = found
        basis, weight = _basis(free, tilted), solution.weight / solution.noise**2
        given = np.zeros(5)
        given[:2] = -(solution.unknowns[:2] - free.T @ (free @ solution.unknowns[:2]))
        design = solution.design @ basis
        right = -(design.T * weight) @ (solution.design @ given)
        step = estimation.step((design.T * weight) @ design, right, basis)
        moved = replace(solution, unknowns=solution.unknowns + given + step)
        return moved, self._whole(solution, basis, correlation), correlation

    def refined(self, found: "_Found", free: FloatArray, tilted: bool, check: Callable[[], None]) -> "_Found":
        """A solution with the own surface's slopes, from that with a fine reference's.

        At the edges of roofs the own surface has errors that the reference's slopes take for a shift; its own slopes do
        so less. Half of the difference between the two solutions is added to the deviations: it shows such errors.
        """
        first, own = found[0].unknowns, replace(self._reference, slopes=None)
        solution = _Problem(self._surface, own, self._parameters).solve(first[:3], free, tilted, check)
        apart = (solution.unknowns - first) / 2.0
        apart[3:] = 0.0
        return solution, found[1] + np.outer(apart, apart), found[2]

    def local_offsets(self, solution: _Solution, free: FloatArray, correlation: Correlation) -> Iterator[LocalOffset]:
        """The shifts that parts of the surface alone would need, in the directions that the whole determines: a step
        from the solution, as far as the part's own heights determine it."""
        p, basis = self._parameters, _basis(free, False)
        low, side = self.centre - np.array(self._surface.extent_m) / 2, np.array(self._surface.extent_m)
        part = np.floor((self._xyz[:, :2] - low) / side * p.local_parts).astype(int)
        for row, column in np.ndindex(p.local_parts, p.local_parts):
            use = (part == (column, row)).all(axis=1) & (solution.weight > 0)
            if use.sum() < p.least_supports:
                continue
            weighted = (solution.instruments[use] @ basis * (solution.weight / solution.noise**2)[use][:, None]).T
            normal = weighted @ solution.design[use] @ basis
            step = estimation.step(normal, weighted @ solution.residual[use], basis)
            variance = np.diag(self.covariance(solution, basis, correlation, use, p.lattice // p.local_parts))[:3]
            x, y = map(float, self._xyz[use, :2].mean(axis=0))
            tilt = solution.unknowns[3:] @ (np.array([x, y]) - self.centre)
            east, north, up = map(float, solution.unknowns[:3] + step[:3] + (0.0, 0.0, tilt))
            if max(abs(east - solution.unknowns[0]), abs(north - solution.unknowns[1])) < self._surface.resolution_m:
                deviation = tuple(float(each) for each in np.sqrt(np.clip(variance, 0.0, None)))
                yield LocalOffset(x, y, (east, north, up), (deviation[0], deviation[1], deviation[2]), int(use.sum()))

    def covariance(
        self,
        solution: _Solution,
        basis: FloatArray,
        correlation: Correlation,
        use: Mask,
        lattice: int,
        normal: Optional[FloatArray] = None,
    ) -> FloatArray:
        """(5, 5): the sandwich of the normal matrix and of the correlated noise of its right-hand side, of the heights
        that are used, summed up in a lattice of so many cells along a side."""
        instruments = solution.instruments[use] @ basis
        weighted, more = instruments * (solution.weight / solution.noise**2)[use][:, None], np.ones(basis.shape[1])
        scores = weighted * solution.noise[use][:, None]  # of a residual of one standard deviation
        if normal is not None:
            # Where slopes are steep, residuals are larger than their class says: their own scores count (White 1980).
            real = ((weighted * solution.residual[use][:, None]) ** 2).sum(axis=0)
            usual = _TUKEY_SCORES * (scores**2).sum(axis=0)
            more = np.sqrt(np.maximum(real / np.maximum(usual, 1e-300), 1.0))
        else:
            # Derivative of Tukey's psi: what a weight of residuals near the limit really counts.
            u = (solution.residual / solution.noise)[use] / self._parameters.tukey
            slope = (1 - u**2) * (1 - 5 * u**2) / solution.noise[use] ** 2
            normal = (instruments * slope[:, None]).T @ (solution.design[use] @ basis)
        middle = estimation.correlated_sum(scores * more, self._xyz[use, :2], correlation, lattice)
        return estimation.sandwich(normal, middle, basis)

    def slope(self, solution: _Solution, basis: FloatArray, step_m: float) -> FloatArray:
        """(k, k) the slope of the equations, by differences.

        The surface's noise makes slopes, which count in the product of slopes as if they were those of the ground; a
        shift changes the differences there at random, so that they determine nothing. Only the equations themselves
        show it, a step away to both sides.
        """

        u = solution.residual / solution.noise / self._parameters.tukey
        psi = (solution.weight * solution.residual / solution.noise**2)[:, None]
        derivative = np.where(np.abs(u) < 1.0, (1 - u**2) * (1 - 5 * u**2), 0.0)[:, None] / solution.noise[:, None] ** 2

        def at(unknowns: FloatArray) -> Tuple[FloatArray, FloatArray, Mask]:
            residual, design, seen = self._linearised(unknowns)
            return residual[:, None], self._instruments(design) @ basis, seen

        columns = []
        for direction in basis.T:
            by = step_m if not direction[3:].any() else step_m / max(self._surface.extent_m)
            (above, z_above, there), (below, z_below, here) = (
                at(solution.unknowns + sign * by * direction) for sign in (1, -1)
            )
            both = there & here & solution.seen
            change = solution.instruments @ basis * derivative * (below - above) + (z_below - z_above) * psi
            columns.append(change[both].sum(axis=0) / (2.0 * by))
        return np.column_stack(columns)

    def correlation(self, solution: _Solution) -> Correlation:
        """The correlation of standardised differences that have a weight."""
        use = solution.weight > 0
        return Correlation.of((solution.residual / solution.noise)[use], self._xyz[use, :2], self._parameters)


def _basis(free: FloatArray, tilted: bool) -> FloatArray:
    """(5, k): the unknowns that may change: free horizontal directions, the height, and the tilt where wanted."""
    columns = [np.array([*direction, 0.0, 0.0, 0.0]) for direction in free]
    columns.append(np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
    if tilted:
        columns += [np.array([0.0, 0.0, 0.0, 1.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.0, 1.0])]
    return np.column_stack(columns)
