"""Pointing: one small correction a whole image, from tie points and ground control, against the original RPCs.

A vendor's RPC is off by pixels, differently in each view. Each view gets a shift in image space, or an affine
correction where the residuals ask for it; each tie point a ground point. Without ground control the free frame is
fixed by the smallest corrections that do: their mean stays where the vendors put it, and no view is silently taken
for the truth. With control points the correction is absolute.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import OptionError
from ..geometry.frames import EnuFrame
from ..scene import View
from .control_noise import (
    LEAST_NOISE_PX,
    ControlEquations,
    contradicts,
    first_noise,
    robust_weight,
    suspects,
    variance_component,
)
from .ground_control import Gcp
from .tie_points import PairMatches

Weights = Callable[[FloatArray, float], FloatArray]

MODELS = ("auto", "shift", "affine")

_ROUNDS = 10
_HUBER_PX = 0.7
_TUKEY = 4.685  # standard deviations from which on residuals are wrong matches, and count for nothing in the end
_LEAST_SIGMA_PX = 0.05
_AFFINE_TIES = 60
_AFFINE_COVER = 0.4  # of an image's width and height that the ties must span
_AFFINE_CONTROL = 6  # control points that may ask for it where ties do not
_AFFINE_GAIN = 0.9  # of the shifts' residual that the affine correction must get below
_RANK = 1e-6  # of the largest eigenvalue: what lies below, the ties do not tell
_KNOWN_PX = 0.25  # nor do they tell what they would tell with a larger standard deviation
_CONTROL_KNOWN_PX = 1.0  # vendors know no better than that what only control points tell


@dataclass(frozen=True)
class Track:
    """One ground point: the views that see it with their (2,) pixels."""

    pixels: Dict[str, FloatArray]


@dataclass
class _Group:
    """All tracks that the same views see, so that numpy may work on them at once.

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
    its best ground point). ``rejected`` names control points that contradict all others, and
    ``control_noise_px`` is the good ones' standard deviation of a coordinate, as their residuals tell it (None: there
    are none).
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


def tracks_from(matches: Sequence[PairMatches]) -> List[Track]:
    """Join pairwise matches into tracks: keypoints that are the same pixel (to a tenth) of a view are one.

    A track that meets a view twice contradicts itself and is dropped.
    """
    parent: Dict[Tuple[str, int, int], Tuple[str, int, int]] = {}
    pixels: Dict[Tuple[str, int, int], FloatArray] = {}

    def root(node: Tuple[str, int, int]) -> Tuple[str, int, int]:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    def node_of(view: str, pixel: FloatArray) -> Tuple[str, int, int]:
        node = (view, int(round(pixel[0] * 10)), int(round(pixel[1] * 10)))
        parent.setdefault(node, node)
        pixels.setdefault(node, pixel)
        return node

    for match in matches:
        for a, b in zip(match.first_px, match.second_px):
            ends = root(node_of(match.first, a)), root(node_of(match.second, b))
            parent[ends[1]] = ends[0]
    members: Dict[Tuple[str, int, int], List[Tuple[str, int, int]]] = {}
    for node in parent:
        members.setdefault(root(node), []).append(node)
    return [
        Track({node[0]: pixels[node] for node in nodes})
        for nodes in members.values()
        if len({node[0] for node in nodes}) == len(nodes) >= 2
    ]


def adjust(
    views: Sequence[View], tracks: Sequence[Track], altitude: float, model: str = "shift", gcps: Sequence[Gcp] = ()
) -> Adjustment:
    """Gauss-Newton with the ground points eliminated; Huber weights first, then Tukey's, which forget wrong matches.

    Parameters
    ----------
    views : their vendor RPCs are what is corrected; their present pointing is not used.
    tracks : at least one.
    altitude : where ground points start from, metres above the ellipsoid.
    model : ``shift`` or ``affine`` a view, or ``auto``: affine where Schwarz's information criterion (1978) prefers
        it, the residuals fall by a tenth, and the ties span the images well enough to carry it.
    gcps : ground control; those of the role ``control`` fix the absolute frame, with the weight that their own
        residuals give them; wrong ones are found and left out.

    Notes
    -----
    For each track the residuals' projection onto the space that no move of the ground point reaches depends on the
    corrections alone (variable projection, Golub and Pereyra 1973). Without control the normal matrix is singular
    along the corrections that all views share and along those that mimic heights; its pseudo-inverse gives the
    smallest corrections.
    """
    if model not in MODELS:
        raise OptionError("POINTING", model, f"must be one of {', '.join(MODELS)}")
    shift = _Solution(views, tracks, altitude, "shift", gcps).solved()
    if model == "shift":
        return shift.adjustment("asked for")
    affine = _Solution(views, tracks, altitude, "affine", gcps).solved()
    if model == "affine":
        return affine.adjustment("asked for")
    better, reason = _compared(shift, affine)
    return better.adjustment(reason)


def with_shifts(
    views: Sequence[View], tracks: Sequence[Track], altitude: float, shifts: Dict[str, FloatArray], reason: str
) -> Adjustment:
    """The ground points and residuals of shifts, (2,) px a view, that were found otherwise."""
    return _Solution(views, tracks, altitude, "shift", ()).with_shifts(shifts).adjustment(reason)


def _compared(shift: "_Solution", affine: "_Solution") -> Tuple["_Solution", str]:
    """Shift or affine, and why: control points have a say beside the ties, for a tilt of the whole no tie sees."""
    cover = min(shift.cover)
    if len(shift.tracks) < _AFFINE_TIES or cover < _AFFINE_COVER:
        return shift, (
            f"{len(shift.tracks)} ties over {100 * cover:.0f} % of the images' sides carry no affine correction"
        )
    # What either calls wrong, both are spared.
    good = [gcp for gcp in shift.control if gcp in affine.control]
    criterion = affine.criterion(3.0 * shift.typical_px, good) - shift.criterion(3.0 * shift.typical_px, good)
    told = f"(information criterion {criterion:+.0f})"
    if criterion < 0 and affine.typical_px < _AFFINE_GAIN * max(shift.typical_px, 1e-9):
        return affine, (
            f"residuals show a trend: {shift.typical_px:.3f} px with shifts, {affine.typical_px:.3f} px "
            f"with affine corrections {told}"
        )
    misses = [solution.control_misses(good) for solution in (shift, affine)]
    if criterion < 0 and len(good) >= _AFFINE_CONTROL and misses[1] < _AFFINE_GAIN * misses[0]:
        return affine, (
            f"control points show a trend: {misses[0]:.3f} px with shifts, {misses[1]:.3f} px with affine "
            f"corrections {told}"
        )
    return shift, (
        f"an affine correction gains nothing: {shift.typical_px:.3f} px with shifts, "
        f"{affine.typical_px:.3f} px affine {told}"
    )


class _Solution:
    """The adjusted corrections of one model, ``parameters`` (views, p): px over normalised pixels."""

    def __init__(
        self, views: Sequence[View], tracks: Sequence[Track], altitude: float, model: str, gcps: Sequence[Gcp]
    ) -> None:
        self.views = [view.with_pointing(np.eye(2, 3)) for view in views]
        self.tracks, self.model = tracks, model
        self.control = [gcp for gcp in gcps if gcp.role == "control" and gcp.pixels]
        self.rejected: Tuple[str, ...] = ()
        self.control_noise_px = _CONTROL_KNOWN_PX
        self._redundancy = 0.0
        self.parameters = np.zeros((len(views), 2 if model == "shift" else 6))
        self.groups = _groups(self.views, tracks, altitude)
        for group in self.groups:
            self._intersect(group)
        self.before = self._residuals()

    def solved(self) -> "_Solution":
        for weights in (_huber, _tukey):
            self._solve(weights, robust=True)
        self._set_wrong_control_aside()
        return self

    def with_shifts(self, shifts: Dict[str, FloatArray]) -> "_Solution":
        """The corrections that another adjustment found, and the ground points that fit them."""
        self.parameters = np.array([shifts[view.name] for view in self.views])
        for group in self.groups:
            self._intersect(group)
        return self

    def _solve(self, weights: Weights, robust: bool = False) -> None:
        """Gauss-Newton; ``robust`` also against wrong control points, else all in use are taken for good."""
        for _ in range(_ROUNDS):
            step = self._step(weights, robust)
            self.parameters = self.parameters + step
            for group in self.groups:
                self._intersect(group, passes=1)
            if np.abs(step).max() < 1e-4:
                break

    def _set_wrong_control_aside(self) -> None:
        """Solve without the suspects, and readmit all that agree with what the others say; name those that do not."""
        if not self.control:
            return
        everyone = self.control
        outside = suspects([self._equations(gcp).misclosure for gcp in everyone], self.control_noise_px)
        while True:
            self.control = [gcp for k, gcp in enumerate(everyone) if k not in outside]
            self._solve(_tukey)
            wrong = [
                k
                for k in outside
                if contradicts(
                    self._equations(everyone[k]),
                    self._covariance,
                    self.control_noise_px,
                    self._redundancy,
                    len(everyone),
                )
            ]
            if len(wrong) == len(outside):
                break
            outside = wrong
        self.rejected = tuple(everyone[k].id for k in outside)

    def _equations(self, gcp: Gcp) -> ControlEquations:
        """A control point's observations in the views that see it, linear in all views' corrections."""
        count, p = self.parameters.shape
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
        return self._basis(self.views[i], pixels) @ self.parameters[i]

    def _linearised(self, group: _Group, frame: EnuFrame) -> Tuple[FloatArray, FloatArray, List[FloatArray]]:
        """(n, 2v) residuals, (n, 2v, 3) their derivative by the ground point in px/m, and each view's basis."""
        enu = frame.from_geodetic(group.ground)
        moved = [frame.to_geodetic(enu + delta) for delta in np.eye(3)]
        residual = np.empty(group.pixels.shape)
        jacobian = np.empty(group.pixels.shape + (3,))
        bases = []
        for k, i in enumerate(group.views):
            base = self.views[i].project(group.ground)
            bases.append(self._basis(self.views[i], base))
            residual[:, k] = group.pixels[:, k] - base - bases[-1] @ self.parameters[i]
            jacobian[:, k] = np.stack([self.views[i].project(ground) - base for ground in moved], axis=-1)
        n, v = group.pixels.shape[:2]
        return residual.reshape(n, 2 * v), jacobian.reshape(n, 2 * v, 3), bases

    def _intersect(self, group: _Group, passes: int = 3) -> None:
        """Move a group's ground points to where they fit their pixels best (least squares)."""
        for _ in range(passes):
            frame = EnuFrame(*map(float, group.ground.mean(axis=0)))
            residual, jacobian, _ = self._linearised(group, frame)
            step = np.einsum("nij,nj->ni", _pseudo_inverse(jacobian), residual)
            group.ground = frame.to_geodetic(frame.from_geodetic(group.ground) + step)

    def _step(self, weights: Weights, robust: bool) -> FloatArray:
        """(views, p) Gauss-Newton step of the parameters, ground points eliminated; notes how well they are known."""
        count, p = self.parameters.shape
        normal, right, sigma = self._tie_normals(weights)
        control = [self._equations(gcp) for gcp in self.control]
        share = [robust_weight(point.misclosure, self.control_noise_px) if robust else 1.0 for point in control]
        for point, part in zip(control, share):
            weight = part * (sigma / self.control_noise_px) ** 2
            normal += weight * point.design.T @ point.design
            right += weight * point.design.T @ point.misclosure
        values, vectors = np.linalg.eigh(normal)
        # Before the first corrections residuals are no noise, and tell nothing of what the ties can tell.
        noise = 0.0 if weights is _huber else sigma / (_CONTROL_KNOWN_PX if control else _KNOWN_PX)
        enough = values > max(_RANK * values[-1], noise**2)
        known = vectors[:, enough]
        # All of the corrections is solved for, not only the step: they are to be the smallest that do.
        whole = right + normal @ self.parameters.ravel()
        step = known @ ((known.T @ whole) / values[enough]) - self.parameters.ravel()
        self._covariance = sigma**2 * (known / values[enough]) @ known.T
        if control:
            self._note_control(control, share, step, robust)
        return step.reshape(count, p)

    def _tie_normals(self, weights: Weights) -> Tuple[FloatArray, FloatArray, float]:
        """The ties' (n, n) normal matrix and (n,) right side, each tie of weight one at most, and their noise, px."""
        count, p = self.parameters.shape
        normal, right = np.zeros((count * p, count * p)), np.zeros(count * p)
        parts = [self._reduced(group) for group in self.groups]
        # One degree of freedom of a track: two a view, less the three of its ground point.
        sizes = [np.linalg.norm(reduced, axis=1) / math.sqrt(max(reduced.shape[1] - 3, 1)) for reduced, _ in parts]
        sigma = max(1.4826 * float(np.median(np.concatenate(sizes))), _LEAST_SIGMA_PX) if sizes else _LEAST_SIGMA_PX
        for group, (reduced, design), size in zip(self.groups, parts, sizes):
            weighted = design * weights(size, sigma)[:, None, None]
            columns = np.concatenate([np.arange(i * p, (i + 1) * p) for i in group.views])
            flat = design.reshape(-1, design.shape[2])
            normal[np.ix_(columns, columns)] += weighted.reshape(flat.shape).T @ flat
            right[columns] += weighted.reshape(flat.shape).T @ reduced.ravel()
        return normal, right, sigma

    def _note_control(
        self, control: Sequence[ControlEquations], share: Sequence[float], step: FloatArray, robust: bool
    ) -> None:
        """Estimate the control points' noise and its redundancy anew."""
        residuals = [point.after(step) for point in control]
        self._redundancy = sum(
            point.redundancy(self._covariance, self.control_noise_px, part) for point, part in zip(control, share)
        )
        self.control_noise_px = first_noise(residuals) if robust else variance_component(residuals, self._redundancy)

    def _reduced(self, group: _Group) -> Tuple[FloatArray, FloatArray]:
        """(n, 2v) residuals and (n, 2v, v p) their derivative by the corrections, free of any move of the ground."""
        frame = EnuFrame(*map(float, group.ground.mean(axis=0)))
        residual, jacobian, bases = self._linearised(group, frame)
        # What no move of the ground point reaches: I - J J^+.
        projector = np.eye(residual.shape[1]) - jacobian @ _pseudo_inverse(jacobian)
        reduced = np.einsum("nij,nj->ni", projector, residual)
        design = np.concatenate([projector[:, :, 2 * k : 2 * k + 2] @ basis for k, basis in enumerate(bases)], axis=2)
        return reduced, design

    def _residuals(self) -> FloatArray:
        """(tracks,) root mean square reprojection distance of each track, px."""
        result = np.zeros(len(self.tracks))
        for group in self.groups:
            square = []
            for k, i in enumerate(group.views):
                base = self.views[i].project(group.ground)
                square.append(((group.pixels[:, k] - base - self._correction(i, base)) ** 2).sum(axis=1))
            result[group.members] = np.sqrt(np.mean(square, axis=0))
        return result

    @property
    def typical_px(self) -> float:
        """The median residual of the tracks."""
        return float(np.median(self._residuals()))

    def criterion(self, limit_px: float, control: Sequence[Gcp] = ()) -> float:
        """Schwarz's information criterion: smaller is better.

        Ties (the largest residuals cut at a limit) and control points are each of a noise of their own.
        """
        square = np.minimum(self._residuals(), limit_px) ** 2
        count, fit = len(square), len(square) * _log_mean(square)
        if control:
            off = np.concatenate([self._equations(gcp).misclosure for gcp in control])
            count, fit = count + len(off), fit + len(off) * _log_mean(off**2 + LEAST_NOISE_PX**2)
        return fit + self.parameters.size * math.log(count)

    def control_misses(self, control: Sequence[Gcp]) -> float:
        """The root mean square residual of control points, a coordinate, px; nought where there are none."""
        if not control:
            return 0.0
        return float(np.sqrt(np.mean(np.concatenate([self._equations(gcp).misclosure for gcp in control]) ** 2)))

    @property
    def cover(self) -> Tuple[float, ...]:
        """For each view that has ties, the lesser share of its width and height that they span."""
        spans = []
        for i, view in enumerate(self.views):
            parts = [group.pixels[:, group.views.index(i)] for group in self.groups if i in group.views]
            if parts:
                low, high = np.percentile(np.concatenate(parts), (2, 98), axis=0)
                spans.append(float(((high - low) / view.size).min()))
        return tuple(spans) or (0.0,)

    def adjustment(self, reason: str) -> Adjustment:
        ground = np.empty((len(self.tracks), 3))
        for group in self.groups:
            ground[group.members] = group.ground
        pointing = {view.name: self._pointing(i) for i, view in enumerate(self.views)}
        noise = self.control_noise_px if self.control else None
        return Adjustment(
            pointing,
            self.model,
            reason,
            ground,
            self._residuals(),
            self.before,
            self.rejected,
            noise,
            {view.name: view.size for view in self.views},
        )

    def _pointing(self, i: int) -> FloatArray:
        """(2, 3) affine map from the vendor's pixel to the real one."""
        view, theta = self.views[i], self.parameters[i].reshape(2, -1)
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


def _pseudo_inverse(jacobian: FloatArray) -> FloatArray:
    """(n, 3, m) of (n, m, 3): of rank three, as rays that meet at an angle have it; far faster than by SVD."""
    transposed = np.swapaxes(jacobian, 1, 2)
    square = transposed @ jacobian
    # Rays from one place meet nowhere: a trace of a ridge keeps their point where it is.
    ridge = 1e-12 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.linalg.solve(square + ridge, transposed)


def _log_mean(square: FloatArray) -> float:
    return math.log(max(float(np.mean(square)), 1e-12))


def _huber(size: FloatArray, sigma: float) -> FloatArray:
    return np.minimum(1.0, _HUBER_PX / np.maximum(size, 1e-9))


def _tukey(size: FloatArray, sigma: float) -> FloatArray:
    # In the residuals' own standard deviation: where the model is poor, the matches are not to blame.
    return np.maximum(1.0 - (size / (_TUKEY * sigma)) ** 2, 0.0) ** 2
