"""Normals of a cloud's points that look to the satellites: a simulated town whose surface and walls are known."""

from __future__ import annotations

import tempfile
from typing import Any, Dict, List, Sequence, Tuple
from unittest import mock

import numpy as np
from scipy.spatial import cKDTree

from benchmarks import answers_walls
from benchmarks.beside import ABSENT, Beside, compared_with
from benchmarks.runner import few, is_quick, say
from repm_qgis.simulation.surface import interpolate
from repm_qgis.solids import cloud_points
from repm_qgis.solids.normals import normals

_MOST, _ALTITUDE_M = 300_000, 600_000.0  # points that are judged, and how far the cameras are
_STEP_M, _EVEN_M, _ON_M = 0.5, 0.02, 0.5  # even places: heights to both sides, their bend, points' distances from them
_AROUND, _STRAIGHT = 24, 0.02  # places of a wall, and the share of their variance across a straight one
_TALL_M, _BESIDE_M = 3.0, 1.0

Map = Tuple[np.ndarray, np.ndarray, Tuple[float, float]]


def _maps(town: answers_walls.Town3d) -> List[Map]:
    """Points, which of them lie on walls, and the line of sight, as the cloud's normals get them: map by map."""
    found: List[Map] = []

    def record(xyz: np.ndarray, wall: np.ndarray, ray: Tuple[float, float], *_: Any) -> np.ndarray:
        found.append((xyz.copy(), wall.copy(), ray))
        return np.zeros(xyz.shape)

    with tempfile.TemporaryDirectory() as folder, mock.patch.object(cloud_points, "normals", record):
        answers_walls.fused(town, folder, cloud_normals=True, workers=1)
    return [each for each in found if len(each[0])]


def own(folder: str) -> None:
    """Our own normals of all maps of a folder's data."""
    given, made, number = np.load(f"{folder}/data.npz"), {}, 0
    walls = np.load(f"{folder}/walls.npz")
    while f"xyz_{number}" in given.files:
        east, north = (float(part) for part in walls[f"ray_{number}"])
        made[f"normals_{number}"] = normals(given[f"xyz_{number}"], walls[f"wall_{number}"], (east, north))
        number += 1
    np.savez(f"{folder}/own.npz", **made)


def _true_normals(town: answers_walls.Town3d, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3) unit normals of the true surface at points on the truth, NaN where it is uneven, bent or far; which
    points are on a facade; and the heights of the surface beside them, for each of their own normals."""
    up, _, facade = town.truth.score(points)
    true = np.full(points.shape, np.nan)
    x, y = points[:, 0], points[:, 1]
    places = ((0, 0), (_STEP_M, 0), (-_STEP_M, 0), (0, _STEP_M), (0, -_STEP_M))
    middle, east, west, north, south = (_height(town, x + dx, y + dy) for dx, dy in places)
    even = (np.abs(east + west - 2 * middle) < _EVEN_M) & (np.abs(north + south - 2 * middle) < _EVEN_M)
    even &= ~facade & (up < _ON_M)
    slopes = np.column_stack([west - east, south - north, np.full(len(x), 2 * _STEP_M)])
    true[even] = (slopes / np.linalg.norm(slopes, axis=1, keepdims=True))[even]
    walls = town.truth.walls
    corners = np.unique(np.round(walls[walls[:, 4] - walls[:, 3] > _TALL_M, :2], 3), axis=0)
    _, near = cKDTree(corners).query(points[facade, :2], _AROUND)
    around = corners[near] - corners[near].mean(axis=1, keepdims=True)
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    across = np.column_stack([axes[:, :, 0], np.zeros(len(axes))])
    beside = points[facade, :2, None] + _BESIDE_M * np.stack([across[:, :2], -across[:, :2]], axis=2)
    ahead, behind = (_height(town, beside[:, 0, k], beside[:, 1, k]) for k in (0, 1))
    straight = (variances[:, 0] < _STRAIGHT * variances[:, 1]) & (np.abs(ahead - behind) > _TALL_M)
    true[facade] = np.where(straight[:, None], across * np.sign(behind - ahead)[:, None], np.nan)
    return true, even, facade & np.isfinite(true[:, 0])


def _height(town: answers_walls.Town3d, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    nodes = town.truth._nodes
    return interpolate(
        nodes.height, (x - nodes.west) / nodes.cell, (nodes.north - y) / nodes.cell, answers_walls._WALL_M
    )


def _data(maps: Sequence[Map], origin: np.ndarray) -> Dict[str, Any]:
    data: Dict[str, Any] = {}
    for number, (xyz, _, ray) in enumerate(maps):
        data[f"xyz_{number}"] = xyz - origin
        data[f"camera_{number}"] = (xyz - origin).mean(axis=0) + _ALTITUDE_M * np.array([*ray, 1.0])
    return data


def _all(found: Dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate([found[f"normals_{number}"] for number in range(len(found))])


def _figures(normal: np.ndarray, true: np.ndarray, even: np.ndarray, facade: np.ndarray) -> List[str]:
    """Median angles from the truth, degrees, of even places and of straight facades; how many of those look outward."""
    cosine = np.clip((normal * true).sum(axis=1), -1, 1)
    angles = [np.degrees(np.arccos(np.abs(cosine[part]))) for part in (even, facade)]
    return [*(f"{np.median(angle):.1f}" for angle in angles), f"{100 * (cosine[facade] > 0).mean():.1f}"]


def rows() -> List[Beside]:
    """Angles from the true normals, with the points of each map by themselves, and all together under one camera."""
    say("normals")
    town = answers_walls.towns()[0]()
    maps = few(_maps(town))
    points = np.concatenate([xyz for xyz, _, _ in maps])
    origin = points.mean(axis=0).round()
    chosen = np.flatnonzero(town.truth.inside(points + town.shift))
    chosen = np.random.default_rng(0).permutation(chosen)[: _MOST // (10 if is_quick() else 1)]
    judged = _true_normals(town, points[chosen] + town.shift)

    def prepare(folder: str) -> None:
        walls = {f"wall_{number}": wall for number, (_, wall, _) in enumerate(maps)}
        rays = {f"ray_{number}": np.array(ray) for number, (_, _, ray) in enumerate(maps)}
        np.savez(f"{folder}/walls.npz", **walls, **rays)

    def nothing(_: str) -> None:
        return None

    alike = compared_with("normals", _data(maps, origin), own, prepare)
    above = (0.0, 0.0)
    together = compared_with(
        "normals", _data([(points, np.zeros(len(points), bool), above)], origin), skipped, read=nothing
    )
    ours = _figures(_all(alike.ours)[chosen], *judged)
    found = []
    names = "median angle on even places, °", "median angle on straight facades, °", "facades that look outward, %"
    for both, data in (
        (alike, "points of each pair by themselves"),
        (together, "open3d: of all pairs, one camera above"),
    ):
        theirs = [ABSENT] * 3 if both.theirs is None else _figures(_all(both.theirs)[chosen], *judged)
        for number, figure in enumerate(names):
            part = "normals that look to the cameras" if both is alike and number == 0 else ""
            row = both.row(part, "" if number else data, figure, ours[number], theirs[number])
            found.append(row if both is alike else [*row[:5], "", row[6], "", row[8]])
    return found


def skipped(_: str) -> None:
    """Ours is not asked twice."""
