"""Relative pointing: one small correction a whole image, found from tie points against the original RPCs.

A vendor's RPC is off by pixels, differently in each view. Each view gets a shift in image space; each tie point a
ground point. The free frame is fixed by the smallest shifts that do: their mean stays where the vendors put it, and
no view is silently taken for the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict, List, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.frames import EnuFrame
from ..scene import View
from .tie_points import PairMatches

FloatArray = NDArray[np.float64]

_ROUNDS = 8
_HUBER_PX = 0.7
_TUKEY_PX = 1.5     # residuals from here on are wrong matches, and count for nothing in the end


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
    """Shifts (2,) in px for each view, adjusted ground points, and residuals.

    ``ground`` (N, 3) longitude, latitude, height; ``residual_px`` and ``before_px`` (N,) root mean square distance
    between measured and projected pixels of a track, after and before the correction (each with its best ground
    point).
    """

    shifts: Dict[str, FloatArray]
    ground: FloatArray
    residual_px: FloatArray
    before_px: FloatArray


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
    return [Track({node[0]: pixels[node] for node in nodes}) for nodes in members.values()
            if len({node[0] for node in nodes}) == len(nodes) >= 2]


def adjust_shifts(views: Sequence[View], tracks: Sequence[Track], altitude: float) -> Adjustment:
    """Gauss-Newton with the ground points eliminated; Huber weights first, then Tukey's, which forget wrong matches.

    Parameters
    ----------
    views : their vendor RPCs are what is corrected; their present pointing is not used.
    tracks : at least one.
    altitude : where ground points start from, metres above the ellipsoid.

    Notes
    -----
    For each track the residuals' projection onto the space that no move of the ground point reaches depends on the
    shifts alone (variable projection, Golub and Pereyra 1973). The normal matrix is singular along the shifts that
    all views share and along those that mimic a height; its pseudo-inverse gives the smallest shifts.
    """
    vendor = [view.with_pointing(np.eye(2, 3)) for view in views]
    groups = _groups(vendor, tracks, altitude)
    shifts = np.zeros((len(views), 2))
    for group in groups:
        _intersect(vendor, group, shifts)
    before = _residuals(vendor, groups, shifts, len(tracks))
    for weights in (_huber, _tukey):
        for _ in range(_ROUNDS):
            step = _shift_step(vendor, groups, shifts, weights)
            shifts = shifts + step
            for group in groups:
                _intersect(vendor, group, shifts, passes=1)
            if np.abs(step).max() < 1e-4:
                break
    ground = np.empty((len(tracks), 3))
    for group in groups:
        ground[group.members] = group.ground
    return Adjustment({view.name: shifts[i] for i, view in enumerate(views)}, ground,
                      _residuals(vendor, groups, shifts, len(tracks)), before)


def _groups(views: Sequence[View], tracks: Sequence[Track], altitude: float) -> List[_Group]:
    index_of = {view.name: i for i, view in enumerate(views)}
    by_views: Dict[Tuple[int, ...], List[int]] = {}
    for number, track in enumerate(tracks):
        by_views.setdefault(tuple(sorted(index_of[name] for name in track.pixels)), []).append(number)
    groups = []
    for seen, members in sorted(by_views.items()):
        pixels = np.array([[tracks[k].pixels[views[i].name] for i in seen] for k in members])
        groups.append(_Group(list(seen), np.array(members), pixels,
                             views[seen[0]].localise(pixels[:, 0], altitude)))
    return groups


def _linearised(views: Sequence[View], group: _Group, shifts: FloatArray,
                frame: EnuFrame) -> Tuple[FloatArray, FloatArray]:
    """(n, 2v) residuals and (n, 2v, 3) their derivative with respect to the ground point in ``frame``, px and px/m."""
    enu = frame.from_geodetic(group.ground)
    moved = [frame.to_geodetic(enu + delta) for delta in np.eye(3)]
    residual = np.empty(group.pixels.shape)
    jacobian = np.empty(group.pixels.shape + (3,))
    for k, i in enumerate(group.views):
        base = views[i].project(group.ground)
        residual[:, k] = group.pixels[:, k] - base - shifts[i]
        jacobian[:, k] = np.stack([views[i].project(ground) - base for ground in moved], axis=-1)
    n, v = group.pixels.shape[:2]
    return residual.reshape(n, 2 * v), jacobian.reshape(n, 2 * v, 3)


def _intersect(views: Sequence[View], group: _Group, shifts: FloatArray, passes: int = 3) -> None:
    """Move a group's ground points to where they fit their pixels best (least squares)."""
    for _ in range(passes):
        frame = EnuFrame(*map(float, group.ground.mean(axis=0)))
        residual, jacobian = _linearised(views, group, shifts, frame)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(jacobian), residual)
        group.ground = frame.to_geodetic(frame.from_geodetic(group.ground) + step)


def _huber(size: FloatArray) -> FloatArray:
    return np.minimum(1.0, _HUBER_PX / np.maximum(size, 1e-9))


def _tukey(size: FloatArray) -> FloatArray:
    # Where most residuals are large, the model (one shift a view) is poor and the matches are not to blame.
    limit = max(_TUKEY_PX, 4.685 * 1.4826 * float(np.median(size)))
    return np.maximum(1.0 - (size / limit) ** 2, 0.0) ** 2


def _shift_step(views: Sequence[View], groups: Sequence[_Group], shifts: FloatArray,
                weights: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """(views, 2) Gauss-Newton step of the shifts, ground points eliminated."""
    count = 2 * len(views)
    normal, right = np.zeros((count, count)), np.zeros(count)
    for group in groups:
        frame = EnuFrame(*map(float, group.ground.mean(axis=0)))
        residual, jacobian = _linearised(views, group, shifts, frame)
        # What no move of the ground point reaches: I - J J^+.
        projector = np.eye(residual.shape[1]) - jacobian @ np.linalg.pinv(jacobian)
        reduced = np.einsum("nij,nj->ni", projector, residual)
        weight = weights(np.linalg.norm(reduced, axis=1))
        columns = np.concatenate([[2 * i, 2 * i + 1] for i in group.views])
        normal[np.ix_(columns, columns)] += np.einsum("n,nij->ij", weight, projector)
        right[columns] += weight @ reduced
    return (np.linalg.pinv(normal, rcond=1e-6, hermitian=True) @ right).reshape(-1, 2)


def _residuals(views: Sequence[View], groups: Sequence[_Group], shifts: FloatArray, count: int) -> FloatArray:
    """(count,) root mean square reprojection distance of each track, px."""
    result = np.zeros(count)
    for group in groups:
        square = [((group.pixels[:, k] - views[i].project(group.ground) - shifts[i]) ** 2).sum(axis=1)
                  for k, i in enumerate(group.views)]
        result[group.members] = np.sqrt(np.mean(square, axis=0))
    return result
