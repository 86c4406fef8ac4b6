"""Distances of a surface from a reference: surfaces whose true distances are known, and what ours and open3d find."""

from __future__ import annotations

from typing import Callable, Dict, List, Tuple

import numpy as np

from benchmarks.beside import ABSENT, Beside, compared_with
from benchmarks.runner import few, say, stage
from repm_qgis.contracts.stages import COMPAREDSM
from repm_qgis.evaluation.comparison import gradient
from repm_qgis.imagery.raster import opened, read, write

_SIDE, _CELL = 1000, 0.5
_PLACE = (600000.0, _CELL, 0.0, 4800000.0, 0.0, -_CELL)
_AWAY_M, _HILL_M, _WAVE_M = 1.0, 20.0, 20.0  # distance along the normals; height and length of hills: up to 45 degrees
_MOVED_M = np.array([0.4, -0.3, 0.2])  # of houses, east, south and up
_APART_M, _HALF_M = 20.0, 5.0  # of houses, and half of a house's side
_RIGHT_M = 0.05

_Surfaces = Tuple[np.ndarray, np.ndarray, np.ndarray]


def _places() -> Tuple[np.ndarray, np.ndarray]:
    """East and south of the first cell's middle, m."""
    row, column = np.indices((_SIDE, _SIDE)) * _CELL
    return column, row


def _hills() -> _Surfaces:
    """Hills, the surface a metre outside of them along their normals, and that distance."""
    x, y = _places()

    def hill(x: np.ndarray, y: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b = x / _WAVE_M, y / _WAVE_M
        slope = _HILL_M / _WAVE_M
        return _HILL_M * np.sin(a) * np.cos(b), slope * np.cos(a) * np.cos(b), -slope * np.sin(a) * np.sin(b)

    foot_x, foot_y = x, y
    for _ in range(50):  # the foot of each place: it converges, as hills curve less than once in the distance
        _, east, south = hill(foot_x, foot_y)
        size = np.sqrt(1 + east**2 + south**2)
        foot_x, foot_y = x + _AWAY_M * east / size, y + _AWAY_M * south / size
    z, east, south = hill(foot_x, foot_y)
    outside = z + _AWAY_M / np.sqrt(1 + east**2 + south**2)
    return hill(x, y)[0], outside, np.full(x.shape, _AWAY_M)


def _houses() -> _Surfaces:
    """Flat roofs with vertical walls, the same moved to a side and up, and how far its cells are from the true ones."""
    x, y = _places()
    numbers = np.random.default_rng(0).uniform(3, 12, (_SIDE, _SIDE))

    def house(x: np.ndarray, y: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The height of the house whose lot a place is on, and the place from that house's middle."""
        i, j = (np.floor(part / _APART_M).astype(int) for part in (x, y))
        return numbers[i, j], x - (i + 0.5) * _APART_M, y - (j + 0.5) * _APART_M

    def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        tall, u, v = house(x, y)
        return np.where((np.abs(u) < _HALF_M) & (np.abs(v) < _HALF_M), tall, 0.0)

    moved = surface(x - _MOVED_M[0], y - _MOVED_M[1]) + _MOVED_M[2]
    tall, u, v = house(x, y)
    beside, ahead, above = np.abs(u) - _HALF_M, np.abs(v) - _HALF_M, moved - tall
    outer = np.sqrt(sum(np.maximum(part, 0) ** 2 for part in (beside, ahead, above)))
    inner = np.maximum(np.maximum(beside, ahead), above)  # negative in a house: the nearest of its walls and its roof
    return surface(x, y), moved, np.where(inner < 0, inner, np.minimum(outer, moved))


_CASES: Dict[str, Callable[[], _Surfaces]] = {
    f"hills of up to 45°, all points {_AWAY_M:g} m off along the normals": _hills,
    "houses with vertical walls, moved by 0.54 m": _houses,
}


def own(folder: str) -> None:
    """Our own comparison of the two rasters of a folder."""
    files = {"dsm": f"{folder}/dsm.tif", "reference": f"{folder}/reference.tif", "error": f"{folder}/error.tif"}
    stage(COMPAREDSM, align="none", **files)


def rows() -> List[Beside]:
    """RMS error of the distances, and the share of right ones."""
    found = []
    for name, make in few(list(_CASES.items())):
        say(f"distances: {name}")
        reference, surface, truth = make()
        x, y = _places()
        data = {
            "reference": reference.astype(np.float32),
            "cell": _CELL,
            "points": np.stack([x, y, surface], axis=-1).reshape(-1, 3),
        }

        def prepare(folder: str, surfaces: Tuple[np.ndarray, np.ndarray] = (surface, reference)) -> None:
            for file, heights in zip(("dsm", "reference"), surfaces):
                write(f"{folder}/{file}.tif", [heights.astype(np.float32)], _PLACE, "EPSG:32631", unit="m")

        def ours(folder: str, heights: np.ndarray = reference) -> np.ndarray:
            with opened(f"{folder}/error.tif") as dataset:
                difference = read(dataset)
            return np.asarray(difference[1:-1, 1:-1] / np.hypot(1.0, gradient(heights, (_CELL, _CELL))))

        both = compared_with("apart", data, own, prepare, ours)
        inner = truth[1:-1, 1:-1]
        errors = [both.ours - inner]
        if both.theirs is not None:
            errors.append(both.theirs["distances"].reshape(truth.shape)[1:-1, 1:-1] - inner)
        rms = [*(f"{np.sqrt(np.mean(error**2)):.3f}" for error in errors), ABSENT][:2]
        right = [*(f"{100 * (np.abs(error) < _RIGHT_M).mean():.1f}" for error in errors), ABSENT][:2]
        found.append(both.row("signed distances from a surface", name, "RMS error, m", *rms))
        found.append(both.row("", "", f"within {_RIGHT_M:g} m, %", *right))
    return found
