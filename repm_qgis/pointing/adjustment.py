"""Pointing: one small correction of each image, from tie points and ground control, with the original RPCs.

A vendor's RPC is wrong by pixels, differently in each view. Each view gets a shift in image space, or an affine
correction where the residuals require it; each tie point gets a ground point. Without ground control the smallest
corrections are used: their mean is zero, and no view is assumed to be right. With control points the corrections are
absolute.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import AnyArray, FloatArray
from ..contracts.errors import OptionError
from ..geometry.frames import EnuFrame, mean_place
from ..geometry.jitter import Jitter
from ..numerics.robust import huber, nmad, tukey
from ..scene import View
from ..ties.tracks import Track
from .control_noise import ControlEquations, contradicts, first_noise, robust_weight, suspects, variance_component
from .ground_control import Gcp
from .jitter import Waves, can_jitter, ladder, waves_over
from .parameters import POINTING, AdjustmentParameters, JitterParameters, PointingParameters

Weights = Callable[[FloatArray, float, AdjustmentParameters], FloatArray]

MODELS = ("auto", "shift", "affine", "jitter")
_BLOCK = 512  # tracks


@dataclass
class _Group:
    """All tracks that the same views see, because numpy works on them at once.

    ``views`` (v,) indices, ``members`` (n,) track numbers, ``pixels`` (n, v, 2) measured, ``ground`` (n, 3).
    """

    views: List[int]
    members: NDArray[np.intp]
    pixels: FloatArray
    ground: FloatArray


@dataclass(frozen=True)
class Adjustment:
    """Corrections of all views, adjusted ground points, and residuals.

    ``pointing`` (2, 3) for each view, from the vendor's pixel to the real one; ``model`` is shift or affine, and
    ``reason`` says why. ``ground`` (N, 3) longitude, latitude, height; ``residual_px`` and ``before_px`` (N,) root
    mean square distance between measured and projected pixels of a track, after and before the correction (each with
    its best ground point). ``rejected`` names control points that contradict all others, and ``control_noise_px`` is
    the standard deviation of a coordinate of the others (None: there are none). ``jitter`` are the waves of each view,
    which come on top of its pointing; empty where there are none.
    """

    pointing: Dict[str, FloatArray]
    model: str
    reason: str
    ground: FloatArray
    residual_px: FloatArray
    before_px: FloatArray
    rejected: Tuple[str, ...] = ()
    control_noise_px: Optional[float] = None
    sizes: Dict[str, Tuple[int, int]] = field(default_factory=dict)
    jitter: Dict[str, Jitter] = field(default_factory=dict)

    def applied(self, views: Sequence[View]) -> List[View]:
        """The views with their corrections."""
        return [view.with_pointing(self.pointing[view.name], self.jitter.get(view.name)) for view in views]

    @property
    def shifts(self) -> Dict[str, FloatArray]:
        """(2,) the correction at each image's centre, px."""
        shifts = {}
        for name, A in self.pointing.items():
            centre = np.array([(n - 1) / 2 for n in self.sizes[name]])
            shifts[name] = A[:, :2] @ centre + A[:, 2] - centre
        return shifts

    @property
    def trends_px(self) -> Dict[str, float]:
        """How far the correction of each image differs between its centre and its corners at most, px."""
        return {
            name: float(np.hypot(*(np.abs(A[:, :2] - np.eye(2)) @ ((np.array(self.sizes[name]) - 1) / 2))))
            for name, A in self.pointing.items()
        }


def adjust(
    views: Sequence[View],
    tracks: Sequence[Track],
    altitude: float,
    model: str = "shift",
    gcps: Sequence[Gcp] = (),
    parameters: PointingParameters = POINTING,
) -> Adjustment:
    """Gauss-Newton with the ground points eliminated; with Huber's weights first, then with Tukey's.

    Parameters
    ----------
    views : the RPCs are corrected; the present pointing is not used.
    tracks : at least one.
    altitude : where ground points start from, metres above the ellipsoid.
    model : ``shift`` or ``affine``, or ``auto``: affine where Schwarz's information criterion (1978) prefers it, the
        residuals fall by a tenth, and the ties cover enough of the images; with waves where it prefers these, too.
        ``jitter`` is the same, with waves in any case.
    gcps : those with the role ``control`` make the result absolute. Their weight follows from their own residuals, and
        wrong ones are found and left out.

    Notes
    -----
    The part of a track's residuals that no move of the ground point can change depends on the corrections alone
    (variable projection, Golub and Pereyra 1973). Without control the normal matrix is singular along corrections that
    all views share and along those that look like heights; its pseudo-inverse gives the smallest corrections.
    """
    if model not in MODELS:
        raise OptionError("POINTING", model, f"must be one of {', '.join(MODELS)}")
    names = (model,) if model in ("shift", "affine") else ("shift", "affine")
    solved = [_Solution(views, tracks, altitude, name, gcps, parameters).solved() for name in names]
    if len(names) == 1:
        return solved[0].adjustment("asked for")
    better, reason = _compared(solved[0], solved[1], parameters.adjustment)
    if not can_jitter(views):
        reason += "; the lines of a map show no waves" if model == "jitter" else ""
    elif model == "jitter" or _may_jitter(better, parameters.jitter):
        better, reason = _with_jitter(better, reason, model == "jitter", parameters.jitter)
    return better.adjustment(reason)


def with_shifts(
    views: Sequence[View], tracks: Sequence[Track], altitude: float, shifts: Dict[str, FloatArray], reason: str
) -> Adjustment:
    """The ground points and residuals that belong to known shifts, (2,) px for each view."""
    return _Solution(views, tracks, altitude, "shift", (), POINTING).with_shifts(shifts).adjustment(reason)


def _compared(shift: "_Solution", affine: "_Solution", parameters: AdjustmentParameters) -> Tuple["_Solution", str]:
    """Shift or affine, and why. Control points count beside the ties, because no tie shows a tilt of the whole."""
    cover = min(shift.cover)
    if len(shift.tracks) < parameters.affine_ties or cover < parameters.affine_cover:
        few = f"{len(shift.tracks)} ties over {100 * cover:.0f} % of the images' sides"
        return shift, f"{few} are too few for an affine correction"
    # Points that either model rejects count for neither.
    good = [gcp for gcp in shift.control if gcp in affine.control]
    limit = parameters.affine_limit * shift.typical_px
    criterion = affine.criterion(limit, good) - shift.criterion(limit, good)
    gain, typical, misses = parameters.affine_gain, shift.typical_px, shift.control_misses(good)
    figures = f"{typical:.3f} px with shifts, {affine.typical_px:.3f} px"
    stated = f"(information criterion {criterion:+.0f})"
    if criterion < 0 and affine.typical_px < gain * max(typical, 1e-9):
        return affine, f"residuals show a trend: {figures} with affine corrections {stated}"
    if criterion < 0 and len(good) >= parameters.affine_control and affine.control_misses(good) < gain * misses:
        figures = f"{misses:.3f} px with shifts, {affine.control_misses(good):.3f} px"
        return affine, f"control points show a trend: {figures} with affine corrections {stated}"
    return shift, f"an affine correction does not improve the fit: {figures} affine {stated}"


def _may_jitter(steady: "_Solution", parameters: JitterParameters) -> bool:
    """Whether the ties' residuals suggest waves, tested at the cost of one step of the solution."""
    waves = waves_over(steady.rows, parameters.asked_lines, parameters)
    if waves is None:
        return False
    limit = parameters.limit * steady.typical_px
    asked = steady.with_waves(waves).looked_at()
    without = steady.waves_criterion(limit)
    return asked.waves_criterion(limit) < without and asked.typical_px < parameters.gain * steady.typical_px


def _with_jitter(
    steady: "_Solution", reason: str, wanted: bool, parameters: JitterParameters
) -> Tuple["_Solution", str]:
    """The solution with the waves that Schwarz's criterion prefers, and why; without any where they are not ``wanted``
    and do not improve the fit, or where there are too few ties for them."""
    limit = parameters.limit * steady.typical_px
    found = [steady.with_waves(waves).solved() for waves in ladder(steady.rows, parameters)]
    if not found:
        return steady, f"{reason}; the images have too few lines or ties for waves" if wanted else reason
    best = min(found, key=lambda each: each.waves_criterion(limit))
    criterion = best.waves_criterion(limit) - steady.waves_criterion(limit)
    sizes = [max(jitter.rms_px) for jitter in best.jitter.values()]
    clear = criterion < 0 and best.typical_px < parameters.gain * steady.typical_px and max(sizes) > parameters.least_px
    if not (wanted or clear):
        return steady, reason
    count = best.waves.count if best.waves else 0
    figures = f"{steady.typical_px:.3f} px without waves, {best.typical_px:.3f} px with {count} splines for each image"
    return best, f"{reason}; residuals show jitter: {figures} (information criterion {criterion:+.0f})"


class _Solution:
    """The adjusted corrections of one model: (views, p), px over normalised pixels."""

    def __init__(
        self,
        views: Sequence[View],
        tracks: Sequence[Track],
        altitude: float,
        model: str,
        gcps: Sequence[Gcp],
        parameters: PointingParameters,
    ) -> None:
        self._parameters, self._noise, self._jitter = parameters.adjustment, parameters.control, parameters.jitter
        self.waves: Optional[Waves] = None
        self.views = [view.with_pointing(np.eye(2, 3)) for view in views]
        self.tracks, self.model = tracks, model
        self.control = [gcp for gcp in gcps if gcp.role == "control" and gcp.pixels]
        self._everyone = self.control
        self.rejected: Tuple[str, ...] = ()
        self.control_noise_px = self._parameters.control_known_px
        self._redundancy = self._determined = 0.0
        self.corrections = np.zeros((len(views), 2 if model == "shift" else 6))
        self.groups = _groups(self.views, tracks, altitude)
        self._intersect()
        self.before = self._residuals()

    def solved(self) -> "_Solution":
        for weights in (_huber, _tukey):
            self._solve(weights, robust=True)
        self._set_wrong_control_aside()
        return self

    def with_waves(self, waves: Waves) -> "_Solution":
        """The same corrections and, as unknowns that are zero now, splines of the images' lines."""
        found = copy(self)
        found.waves, found.groups = waves, [copy(group) for group in self.groups]
        found.control = self._everyone  # waves may be the reason why some contradicted the others
        own = self.corrections.reshape(len(self.views), 2, -1)
        splines = np.zeros((*own.shape[:2], waves.count))
        found.corrections = np.concatenate([own, splines], axis=2).reshape(len(self.views), -1)
        return found

    def looked_at(self) -> "_Solution":
        """One step towards the solution, enough to see whether there are waves."""
        self.corrections = self.corrections + self._step(_huber, False)
        self._intersect(passes=1)
        return self

    @property
    def rows(self) -> List[FloatArray]:
        """The lines of each view's ties."""
        parts: List[List[FloatArray]] = [[np.empty(0)] for _ in self.views]
        for group in self.groups:
            for k, i in enumerate(group.views):
                parts[i].append(group.pixels[:, k, 1])
        return [np.concatenate(each) for each in parts]

    def waves_criterion(self, limit_px: float) -> float:
        """Schwarz's information criterion of the ties, each with all its degrees of freedom; smaller is better."""
        freedom = np.array([2.0 * len(track.pixels) - 3.0 for track in self.tracks])
        views = np.array([float(len(track.pixels)) for track in self.tracks])
        square = np.minimum(self._residuals() ** 2 * views / freedom, limit_px**2)
        total = float(freedom.sum())
        return total * _log_mean(np.sum(freedom * square) / total) + self._determined * math.log(total)

    @property
    def jitter(self) -> Dict[str, Jitter]:
        """Each view's waves."""
        if self.waves is None:
            return {}
        own = self.corrections.reshape(len(self.views), 2, -1)[..., -self.waves.count :]
        return {view.name: self.waves.jitter(i, own[i]) for i, view in enumerate(self.views)}

    def with_shifts(self, shifts: Dict[str, FloatArray]) -> "_Solution":
        """The corrections of another adjustment, and the ground points that fit them."""
        self.corrections = np.array([shifts[view.name] for view in self.views])
        self._intersect()
        return self

    def _solve(self, weights: Weights, robust: bool = False) -> None:
        """Gauss-Newton; where not ``robust``, all control points in use are assumed to be good."""
        for _ in range(self._parameters.iterations):
            step = self._step(weights, robust)
            self.corrections = self.corrections + step
            self._intersect(passes=1)
            if np.abs(step).max() < self._parameters.stop:
                break

    def _set_wrong_control_aside(self) -> None:
        """Solve without the suspects, and readmit all that agree with the others; name those that do not."""
        if not self.control:
            return
        everyone = self.control
        outside = suspects([self._equations(gcp).misclosure for gcp in everyone], self.control_noise_px, self._noise)
        while True:
            self.control = [gcp for k, gcp in enumerate(everyone) if k not in outside]
            self._solve(_tukey)
            wrong = [k for k in outside if self._contradicts(everyone[k], len(everyone))]
            if len(wrong) == len(outside):
                break
            outside = wrong
        self.rejected = tuple(everyone[k].id for k in outside)

    def _contradicts(self, gcp: Gcp, points: int) -> bool:
        return contradicts(
            self._equations(gcp),
            self._covariance,
            noise_px=self.control_noise_px,
            redundancy=self._redundancy,
            points=points,
            parameters=self._noise,
        )

    def _equations(self, gcp: Gcp) -> ControlEquations:
        """A control point's observations in the views that see it, linear in all views' corrections."""
        count, p = self.corrections.shape
        misclosure, design = [], []
        for i, view in enumerate(self.views):
            if view.name in gcp.pixels:
                base = view.project(gcp.lon_lat_h)
                rows = np.zeros((2, count * p))
                measured = gcp.pixels[view.name]
                rows[:, i * p : (i + 1) * p] = self._basis(i, base, measured)
                design.append(rows)
                misclosure.append(measured - base - self._correction(i, base, measured))
        return ControlEquations(np.concatenate(misclosure), np.concatenate(design))

    def _basis(self, i: int, pixels: FloatArray, measured: FloatArray) -> FloatArray:
        """(..., 2, p) derivative of the corrected pixel with respect to a view's parameters; the pixels (..., 2) of its
        RPC, and the ``measured`` ones, whose line the jitter depends on."""
        one = np.ones(pixels.shape[:-1] + (1,))
        if self.model == "affine":
            centre = (np.array(self.views[i].size) - 1) / 2
            one = np.concatenate([one, (pixels - centre) / np.maximum(centre, 1)], axis=-1)
        if self.waves is not None:
            one = np.concatenate([one, self.waves.values(i, measured[..., 1])], axis=-1)
        result = np.zeros(one.shape[:-1] + (2, 2 * one.shape[-1]))
        result[..., 0, : one.shape[-1]] = one
        result[..., 1, one.shape[-1] :] = one
        return result

    def _correction(self, i: int, pixels: FloatArray, measured: FloatArray) -> FloatArray:
        return np.asarray(self._basis(i, pixels, measured) @ self.corrections[i])

    def _projected(self, ground: FloatArray) -> List[FloatArray]:
        """For each group, (..., n, v, 2) RPC pixels of all groups' ground points (..., N, 3), one after the other.

        Each view projects all its points in one call: many views make many small groups.
        """
        ends = np.cumsum([0, *(len(group.ground) for group in self.groups)])
        found = [np.empty((*ground.shape[:-2], *group.pixels.shape)) for group in self.groups]
        for i, view in enumerate(self.views):
            seen = [number for number, group in enumerate(self.groups) if i in group.views]
            if seen:
                pixels = view.project(np.concatenate([ground[..., ends[k] : ends[k + 1], :] for k in seen], axis=-2))
                stops = np.cumsum([len(self.groups[k].ground) for k in seen])[:-1]
                for k, part in zip(seen, np.split(pixels, stops, axis=-2)):
                    found[k][..., self.groups[k].views.index(i), :] = part
        return found

    def _linearised(self, frame: EnuFrame) -> Iterator[Tuple[_Group, FloatArray, FloatArray, List[FloatArray]]]:
        """Each group with its (n, 2v) residuals, (n, 2v, 3) their derivative by the ground point in px/m, and each
        view's basis."""
        ground = np.concatenate([group.ground for group in self.groups])
        enu = frame.from_geodetic(ground)
        moved = np.stack([ground, *(frame.to_geodetic(enu + delta) for delta in np.eye(3))])
        for group, pixels in zip(self.groups, self._projected(moved)):
            base, (n, v) = pixels[0], group.pixels.shape[:2]
            bases = [self._basis(i, base[:, k], group.pixels[:, k]) for k, i in enumerate(group.views)]
            corrections = [basis @ self.corrections[i] for basis, i in zip(bases, group.views)]
            residual = group.pixels - base - np.stack(corrections, axis=1)
            jacobian = np.moveaxis(pixels[1:] - base, 0, -1)
            yield group, residual.reshape(n, 2 * v), jacobian.reshape(n, 2 * v, 3), bases

    def _frame(self) -> EnuFrame:
        """The local frame in which ground points move."""
        return EnuFrame(*map(float, mean_place(np.concatenate([group.ground for group in self.groups]))))

    def _intersect(self, passes: int = 3) -> None:
        """Move all ground points to where they fit their pixels best (least squares)."""
        for _ in range(passes if self.groups else 0):
            frame = self._frame()
            for group, residual, jacobian, _ in self._linearised(frame):
                step = np.einsum("nij,nj->ni", _pseudo_inverse(jacobian), residual)
                group.ground = frame.to_geodetic(frame.from_geodetic(group.ground) + step)

    def _step(self, weights: Weights, robust: bool) -> FloatArray:
        """(views, p) Gauss-Newton step of the corrections, ground points eliminated; sets their covariance."""
        count, p = self.corrections.shape
        normal, right, sigma = self._tie_normals(weights)
        control = [self._equations(gcp) for gcp in self.control]
        share = [robust_weight(point.misclosure, self.control_noise_px) if robust else 1.0 for point in control]
        for point, part in zip(control, share):
            weight = part * (sigma / self.control_noise_px) ** 2
            normal += weight * point.design.T @ point.design
            right += weight * point.design.T @ point.misclosure
        # The whole corrections are solved for, not only the step: they must be the smallest that fit.
        whole = right + normal @ self.corrections.ravel()
        if self.waves is not None:
            normal = normal + self._prior(self.waves, sigma)
        values, vectors = np.linalg.eigh(normal)
        # Before the first corrections the residuals are not noise, and do not show which parameters are determined.
        limit = self._parameters.control_known_px if control else self._parameters.known_px
        limit = limit if self.waves is None else max(limit, self._jitter.known_px)
        noise = 0.0 if weights is _huber else sigma / limit
        enough = values > max(self._parameters.rank * values[-1], noise**2)
        known = vectors[:, enough]
        step = known @ ((known.T @ whole) / values[enough]) - self.corrections.ravel()
        self._covariance = sigma**2 * (known / values[enough]) @ known.T
        self._determined = float(np.count_nonzero(enough))
        if self.waves is not None:  # what only the prior determines does not count as a parameter of the fit
            self._determined -= float(np.sum(self._covariance * self._prior(self.waves, 1.0)))
        if control:
            self._estimate_noise(control, share, step, robust)
        return np.asarray(step.reshape(count, p))

    def _prior(self, waves: Waves, sigma: float) -> FloatArray:
        """(n, n) the prior of all corrections, as normal equations of ties with this noise: how large waves are, and
        how large affine corrections are where waves could take their place."""
        n = self.corrections.shape[1] // 2
        one: FloatArray = np.zeros((n, n))
        one[-waves.count :, -waves.count :] = waves.prior(self._jitter)
        affine = np.arange(1, n - waves.count)
        one[affine, affine] = self._parameters.known_px**-2
        return np.kron(np.eye(2 * len(self.views)), one) * sigma**2

    def _tie_normals(self, weights: Weights) -> Tuple[FloatArray, FloatArray, float]:
        """The ties' (n, n) normal matrix and (n,) right side, each tie with weight one at most, and their noise, px."""
        count, p = self.corrections.shape
        normal, right = np.zeros((count * p, count * p)), np.zeros(count * p)
        linear = self._linearised(self._frame()) if self.groups else ()
        parts = [(*_reduced(residual, jacobian), bases) for _, residual, jacobian, bases in linear]
        # Degrees of freedom of a track: two for each view, less the three of its ground point.
        sizes = [np.linalg.norm(part[0], axis=1) / math.sqrt(max(part[0].shape[1] - 3, 1)) for part in parts]
        sigma = self._parameters.least_sigma_px
        if sizes:
            sigma = max(nmad(np.concatenate(sizes), 0.0), sigma)
        for group, (reduced, projector, bases), size in zip(self.groups, parts, sizes):
            columns = np.concatenate([np.arange(i * p, (i + 1) * p) for i in group.views])
            share = weights(size, sigma, self._parameters)[:, None, None]
            for part in self._blocks(len(reduced)):
                design = _design(projector[part], [basis[part] for basis in bases])
                weighted = design * share[part]
                flat = design.reshape(-1, design.shape[2])
                normal[np.ix_(columns, columns)] += weighted.reshape(flat.shape).T @ flat
                right[columns] += weighted.reshape(flat.shape).T @ reduced[part].ravel()
        return normal, right, sigma

    def _blocks(self, tracks: int) -> List[slice]:
        """Tracks that are worked on together: with splines there are so many unknowns that memory counts."""
        step = tracks if self.waves is None else _BLOCK
        return [slice(start, start + step) for start in range(0, tracks, max(step, 1))]

    def _estimate_noise(
        self, control: Sequence[ControlEquations], share: Sequence[float], step: FloatArray, robust: bool
    ) -> None:
        """Set the control points' noise and its redundancy."""
        residuals = [point.after(step) for point in control]
        noise = self.control_noise_px
        self._redundancy = sum(point.redundancy(self._covariance, noise, part) for point, part in zip(control, share))
        if robust:
            self.control_noise_px = first_noise(residuals, self._noise)
        else:
            self.control_noise_px = variance_component(residuals, self._redundancy, self._noise)

    def _residuals(self) -> FloatArray:
        """(tracks,) root mean square reprojection distance of each track, px."""
        result = np.zeros(len(self.tracks))
        if not self.groups:
            return result
        everywhere = self._projected(np.concatenate([group.ground for group in self.groups]))
        for group, base in zip(self.groups, everywhere):
            corrections = [self._correction(i, base[:, k], group.pixels[:, k]) for k, i in enumerate(group.views)]
            square = ((group.pixels - base - np.stack(corrections, axis=1)) ** 2).sum(axis=2)
            result[group.members] = np.sqrt(square.mean(axis=1))
        return result

    @property
    def typical_px(self) -> float:
        """The median residual of the tracks."""
        return float(np.median(self._residuals()))

    def criterion(self, limit_px: float, control: Sequence[Gcp] = ()) -> float:
        """Schwarz's information criterion: smaller is better.

        Ties (their largest residuals are cut at a limit) and control points have a noise of their own.
        """
        square = np.minimum(self._residuals(), limit_px) ** 2
        count, fit = len(square), len(square) * _log_mean(square)
        if control:
            off = np.concatenate([self._equations(gcp).misclosure for gcp in control])
            count, fit = count + len(off), fit + len(off) * _log_mean(off**2 + self._noise.least_noise_px**2)
        return fit + self.corrections.size * math.log(count)

    def control_misses(self, control: Sequence[Gcp]) -> float:
        """The root mean square residual of control points, a coordinate, px; 0 where there are none."""
        if not control:
            return 0.0
        return float(np.sqrt(np.mean(np.concatenate([self._equations(gcp).misclosure for gcp in control]) ** 2)))

    @property
    def cover(self) -> Tuple[float, ...]:
        """For each view with ties, the share of its width or height that they span, whichever is smaller."""
        spans = []
        for i, view in enumerate(self.views):
            parts = [group.pixels[:, group.views.index(i)] for group in self.groups if i in group.views]
            if parts:
                tail = self._parameters.cover_tail_percent
                low, high = np.percentile(np.concatenate(parts), (tail, 100.0 - tail), axis=0)
                spans.append(float(((high - low) / view.size).min()))
        return tuple(spans) or (0.0,)

    def adjustment(self, reason: str) -> Adjustment:
        ground = np.empty((len(self.tracks), 3))
        for group in self.groups:
            ground[group.members] = group.ground
        pointing = {view.name: self._pointing(i) for i, view in enumerate(self.views)}
        sizes = {view.name: view.size for view in self.views}
        return Adjustment(
            pointing=pointing,
            model=self.model,
            reason=reason,
            ground=ground,
            residual_px=self._residuals(),
            before_px=self.before,
            rejected=self.rejected,
            control_noise_px=self.control_noise_px if self.control else None,
            sizes=sizes,
            jitter=self.jitter,
        )

    def _pointing(self, i: int) -> FloatArray:
        """(2, 3) affine map from the pixel of the vendor's RPC to the real one."""
        view, theta = self.views[i], self.corrections[i].reshape(2, -1)
        if self.waves is not None:
            theta = theta[:, : -self.waves.count]
        if self.model == "shift":
            return np.column_stack([np.eye(2), theta[:, 0]])
        centre = (np.array(view.size) - 1) / 2
        linear = theta[:, 1:] / np.maximum(centre, 1)
        return np.column_stack([np.eye(2) + linear, theta[:, 0] - linear @ centre])


def _groups(views: Sequence[View], tracks: Sequence[Track], altitude: float) -> List[_Group]:
    index_of = {view.name: i for i, view in enumerate(views)}
    by_views: Dict[Tuple[int, ...], List[int]] = {}
    for number, track in enumerate(tracks):
        by_views.setdefault(tuple(sorted(index_of[name] for name in track.pixels)), []).append(number)
    groups = []
    for seen, members in sorted(by_views.items()):
        pixels = np.array([[tracks[k].pixels[views[i].name] for i in seen] for k in members])
        groups.append(_Group(list(seen), np.array(members), pixels, views[seen[0]].localise(pixels[:, 0], altitude)))
    return groups


def _reduced(residual: FloatArray, jacobian: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """(n, 2v) residuals, moves of the ground removed, and the (n, 2v, 2v) projector that does it."""
    # The space that no move of the ground point reaches: I - J J^+.
    projector = np.eye(residual.shape[1]) - jacobian @ _pseudo_inverse(jacobian)
    return np.einsum("nij,nj->ni", projector, residual), projector


def _design(projector: FloatArray, bases: Sequence[FloatArray]) -> FloatArray:
    """(n, 2v, v p) derivative of the reduced residuals by the corrections."""
    return np.concatenate([projector[:, :, 2 * k : 2 * k + 2] @ basis for k, basis in enumerate(bases)], axis=2)


def _pseudo_inverse(jacobian: FloatArray) -> FloatArray:
    """(n, 3, m) of (n, m, 3) with rank three, which rays that meet at an angle give; far faster than an SVD."""
    transposed = np.swapaxes(jacobian, 1, 2)
    square = transposed @ jacobian
    # Rays from one place do not intersect: a small ridge keeps their point where it is. A point that has left the Earth
    # is not moved back.
    trace = np.trace(square, axis1=1, axis2=2)[:, None, None]
    ridge = np.maximum(1e-12 * trace, np.finfo(float).tiny) * np.eye(3)
    return np.linalg.solve(square + ridge, transposed)


def _log_mean(square: AnyArray) -> float:
    return math.log(max(float(np.mean(square)), 1e-12))


def _huber(size: FloatArray, sigma: float, parameters: AdjustmentParameters) -> FloatArray:
    return huber(size, parameters.huber_px)


def _tukey(size: FloatArray, sigma: float, parameters: AdjustmentParameters) -> FloatArray:
    # In the residuals' own standard deviation: a poor model must not reject good matches.
    return tukey(size / (parameters.tukey * sigma))
