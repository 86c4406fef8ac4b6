"""Pointing: one small correction of each image, from tie points and ground control, with the original RPCs.

A vendor's RPC is wrong by pixels, differently in each view. Each view gets a shift in image space, or an affine
correction where the residuals require it; each tie point gets a ground point. Without ground control the smallest
corrections are used: their mean is zero, and no view is assumed to be right. With control points the corrections are
absolute.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import OptionError
from ..geometry.frames import EnuFrame, mean_place
from ..imagery.sampling import nmad
from ..scene import View
from .control_noise import ControlEquations, contradicts, first_noise, robust_weight, suspects, variance_component
from .graph import components
from .ground_control import Gcp
from .parameters import POINTING, AdjustmentParameters, PointingParameters
from .tie_points import PairMatches

Weights = Callable[[FloatArray, float, AdjustmentParameters], FloatArray]

MODELS = ("auto", "shift", "affine")


@dataclass(frozen=True)
class Track:
    """One ground point: the views that see it with their (2,) pixels."""

    pixels: Dict[str, FloatArray]


def track_pixels(tracks: Sequence[Track], name: str, numbers: Sequence[int]) -> FloatArray:
    """(n, 2) the pixels of some tracks in a view."""
    return np.array([tracks[k].pixels[name] for k in numbers])


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
    the standard deviation of a coordinate of the others (None: there are none).
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


def tracks_from(matches: Sequence[PairMatches]) -> List[Track]:
    """Join pairwise matches into tracks: keypoints that are the same pixel (to a tenth) of a view are one.

    A track that has two pixels in one view contradicts itself and is dropped.
    """
    pixels: Dict[Tuple[str, int, int], FloatArray] = {}

    def node_of(view: str, pixel: FloatArray) -> Tuple[str, int, int]:
        node = (view, int(round(pixel[0] * 10)), int(round(pixel[1] * 10)))
        pixels.setdefault(node, pixel)
        return node

    pairs = ((match, a, b) for match in matches for a, b in zip(match.first_px, match.second_px))
    edges = [(node_of(match.first, a), node_of(match.second, b)) for match, a, b in pairs]
    joined = components(list(pixels), edges)
    consistent = [nodes for nodes in joined if len({node[0] for node in nodes}) == len(nodes) >= 2]
    return [Track({node[0]: pixels[node] for node in nodes}) for nodes in consistent]


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
        residuals fall by a tenth, and the ties cover enough of the images.
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
    names = ("shift", "affine") if model == "auto" else (model,)
    solved = [_Solution(views, tracks, altitude, name, gcps, parameters).solved() for name in names]
    if model != "auto":
        return solved[0].adjustment("asked for")
    better, reason = _compared(solved[0], solved[1], parameters.adjustment)
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
        self._parameters, self._noise = parameters.adjustment, parameters.control
        self.views = [view.with_pointing(np.eye(2, 3)) for view in views]
        self.tracks, self.model = tracks, model
        self.control = [gcp for gcp in gcps if gcp.role == "control" and gcp.pixels]
        self.rejected: Tuple[str, ...] = ()
        self.control_noise_px = self._parameters.control_known_px
        self._redundancy = 0.0
        self.corrections = np.zeros((len(views), 2 if model == "shift" else 6))
        self.groups = _groups(self.views, tracks, altitude)
        self._intersect()
        self.before = self._residuals()

    def solved(self) -> "_Solution":
        for weights in (_huber, _tukey):
            self._solve(weights, robust=True)
        self._set_wrong_control_aside()
        return self

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
            known = self._covariance, self.control_noise_px, self._redundancy, len(everyone), self._noise
            wrong = [k for k in outside if contradicts(self._equations(everyone[k]), *known)]
            if len(wrong) == len(outside):
                break
            outside = wrong
        self.rejected = tuple(everyone[k].id for k in outside)

    def _equations(self, gcp: Gcp) -> ControlEquations:
        """A control point's observations in the views that see it, linear in all views' corrections."""
        count, p = self.corrections.shape
        misclosure, design = [], []
        for i, view in enumerate(self.views):
            if view.name in gcp.pixels:
                base = view.project(gcp.lon_lat_h)
                rows = np.zeros((2, count * p))
                rows[:, i * p : (i + 1) * p] = self._basis(view, base)
                design.append(rows)
                misclosure.append(gcp.pixels[view.name] - base - self._correction(i, base))
        return ControlEquations(np.concatenate(misclosure), np.concatenate(design))

    def _basis(self, view: View, pixels: FloatArray) -> FloatArray:
        """(..., 2, p) derivative of the corrected pixel with respect to a view's parameters."""
        one = np.ones(pixels.shape[:-1] + (1,))
        if self.model == "affine":
            centre = (np.array(view.size) - 1) / 2
            one = np.concatenate([one, (pixels - centre) / np.maximum(centre, 1)], axis=-1)
        result = np.zeros(one.shape[:-1] + (2, 2 * one.shape[-1]))
        result[..., 0, : one.shape[-1]] = one
        result[..., 1, one.shape[-1] :] = one
        return result

    def _correction(self, i: int, pixels: FloatArray) -> FloatArray:
        return np.asarray(self._basis(self.views[i], pixels) @ self.corrections[i])

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
            bases = [self._basis(self.views[i], base[:, k]) for k, i in enumerate(group.views)]
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
        values, vectors = np.linalg.eigh(normal)
        # Before the first corrections residuals are not noise, and say nothing about what is determined.
        limit = self._parameters.control_known_px if control else self._parameters.known_px
        noise = 0.0 if weights is _huber else sigma / limit
        enough = values > max(self._parameters.rank * values[-1], noise**2)
        known = vectors[:, enough]
        # The whole corrections are solved for, not only the step: they must be the smallest that fit.
        whole = right + normal @ self.corrections.ravel()
        step = known @ ((known.T @ whole) / values[enough]) - self.corrections.ravel()
        self._covariance = sigma**2 * (known / values[enough]) @ known.T
        if control:
            self._estimate_noise(control, share, step, robust)
        return np.asarray(step.reshape(count, p))

    def _tie_normals(self, weights: Weights) -> Tuple[FloatArray, FloatArray, float]:
        """The ties' (n, n) normal matrix and (n,) right side, each tie with weight one at most, and their noise, px."""
        count, p = self.corrections.shape
        normal, right = np.zeros((count * p, count * p)), np.zeros(count * p)
        linear = self._linearised(self._frame()) if self.groups else ()
        parts = [_reduced(residual, jacobian, bases) for _, residual, jacobian, bases in linear]
        # Degrees of freedom of a track: two for each view, less the three of its ground point.
        sizes = [np.linalg.norm(reduced, axis=1) / math.sqrt(max(reduced.shape[1] - 3, 1)) for reduced, _ in parts]
        sigma = self._parameters.least_sigma_px
        if sizes:
            sigma = max(nmad(np.concatenate(sizes), 0.0), sigma)
        for group, (reduced, design), size in zip(self.groups, parts, sizes):
            weighted = design * weights(size, sigma, self._parameters)[:, None, None]
            columns = np.concatenate([np.arange(i * p, (i + 1) * p) for i in group.views])
            flat = design.reshape(-1, design.shape[2])
            normal[np.ix_(columns, columns)] += weighted.reshape(flat.shape).T @ flat
            right[columns] += weighted.reshape(flat.shape).T @ reduced.ravel()
        return normal, right, sigma

    def _estimate_noise(
        self, control: Sequence[ControlEquations], share: Sequence[float], step: FloatArray, robust: bool
    ) -> None:
        """Set the control points' noise and its redundancy."""
        residuals = [point.after(step) for point in control]
        known = self._covariance, self.control_noise_px
        self._redundancy = sum(point.redundancy(*known, part) for point, part in zip(control, share))
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
            corrections = [self._correction(i, base[:, k]) for k, i in enumerate(group.views)]
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
        noise, residuals = self.control_noise_px if self.control else None, self._residuals()
        return Adjustment(pointing, self.model, reason, ground, residuals, self.before, self.rejected, noise, sizes)

    def _pointing(self, i: int) -> FloatArray:
        """(2, 3) affine map from the pixel of the vendor's RPC to the real one."""
        view, theta = self.views[i], self.corrections[i].reshape(2, -1)
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


def _reduced(residual: FloatArray, jacobian: FloatArray, bases: Sequence[FloatArray]) -> Tuple[FloatArray, FloatArray]:
    """(n, 2v) residuals and (n, 2v, v p) their derivative by the corrections, moves of the ground removed."""
    # The space that no move of the ground point reaches: I - J J^+.
    projector = np.eye(residual.shape[1]) - jacobian @ _pseudo_inverse(jacobian)
    reduced = np.einsum("nij,nj->ni", projector, residual)
    design = np.concatenate([projector[:, :, 2 * k : 2 * k + 2] @ basis for k, basis in enumerate(bases)], axis=2)
    return reduced, design


def _pseudo_inverse(jacobian: FloatArray) -> FloatArray:
    """(n, 3, m) of (n, m, 3) with rank three, which rays that meet at an angle give; far faster than an SVD."""
    transposed = np.swapaxes(jacobian, 1, 2)
    square = transposed @ jacobian
    # Rays from one place meet nowhere: a small ridge keeps their point where it is.
    ridge = 1e-12 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.linalg.solve(square + ridge, transposed)


def _log_mean(square: Any) -> float:
    return math.log(max(float(np.mean(square)), 1e-12))


def _huber(size: FloatArray, sigma: float, parameters: AdjustmentParameters) -> FloatArray:
    return np.minimum(1.0, parameters.huber_px / np.maximum(size, 1e-9))


def _tukey(size: FloatArray, sigma: float, parameters: AdjustmentParameters) -> FloatArray:
    # In the residuals' own standard deviation: a poor model must not reject good matches.
    return np.asarray(np.maximum(1.0 - (size / (parameters.tukey * sigma)) ** 2, 0.0) ** 2)
