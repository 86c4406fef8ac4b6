"""Planes of roofs: simulated houses whose planes are known, and the lidar of a real town."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks import buildings
from benchmarks.answers_dtm import _on_truth
from benchmarks.beside import ABSENT, Beside, Both, compared_with
from benchmarks.runner import few, say
from repm_qgis.buildings.parameters import BUILDINGS
from repm_qgis.buildings.roofs import RoofCells, fitted, roof_planes
from repm_qgis.buildings.segments import segment_numbers
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.terrain.inputs import surface_of

_EVEN_M = 0.02  # the bend of the true surface, within a cell to each side, up to which its slope is known
_PLANES = {"flat": 1, "gable": 2}
_FEW_PERCENT = 10.0


@dataclass(frozen=True)
class Roofs:
    """Heights on cells, m, with errors of about ``noise``, m; the number of each cell's roof (0: none); the true
    heights and the true kinds of the roofs, where these are known."""

    name: str
    height: np.ndarray
    noise: float
    numbers: np.ndarray
    cell: float
    truth: np.ndarray
    kinds: Optional[Dict[int, str]]


def _roofs(case: buildings.Case, height: np.ndarray, noise: float, name: str) -> Roofs:
    cell = float(np.sqrt(buildings._cell_m2(case)))
    sizes = np.bincount(case.numbers.ravel())
    small = np.flatnonzero(sizes * cell**2 < buildings._LEAST_M2)
    numbers = np.where(np.isin(case.numbers, small) | ~case.judged, 0, case.numbers)
    if case.kinds is None:  # roofs of the real town that touch: the truth's own walls divide them
        numbers = segment_numbers(case.surface, numbers > 0, cell)
    return Roofs(name, height, noise, numbers, cell, case.surface, case.kinds)


def _cases() -> List[Roofs]:
    """The DSMs of both towns on the true outlines, and the lidar itself."""
    found = []
    for case in buildings._cases():
        height = _on_truth(case.dsm, case, score_files(case.dsm, case.reference, "3d").alignment)
        noise = surface_of(case.dsm, case.confidence).usual_error
        found.append(_roofs(case, height, noise, f"roofs, {case.name}"))
        if case.kinds is None:
            found.append(_roofs(case, case.surface, 0.0, "roofs, `jax_068`, its lidar itself"))
    return found


def _places(shape: Tuple[int, ...], cell: float) -> Tuple[np.ndarray, np.ndarray]:
    row, column = np.indices(shape) * cell
    return column, -row


def _inner(roofs: Roofs) -> np.ndarray:
    """Cells a metre and more inside their roof, with a height."""
    inner = np.zeros(roofs.numbers.shape, bool)
    for number, where in enumerate(ndimage.find_objects(roofs.numbers), start=1):
        if where is not None:
            here = roofs.numbers[where] == number
            depth = ndimage.distance_transform_edt(np.pad(here, 1))[1:-1, 1:-1] * roofs.cell
            inner[where] |= depth > BUILDINGS.heights.inner_m
    return inner & np.isfinite(roofs.height)


def own(folder: str) -> None:
    """The planes of a folder's roofs: heights and slopes at each point, and how many each roof has."""
    given = np.load(f"{folder}/own_data.npz")
    height, numbers, inner, cell = (given[name] for name in ("height", "numbers", "inner", "cell"))
    x, y = _places(height.shape, float(cell))
    found, counts = np.full((3, *height.shape), np.nan), []
    for number, where in enumerate(ndimage.find_objects(numbers), start=1):
        chosen = inner[where] & (numbers[where] == number) if where is not None else inner[:0]
        if not chosen.any():
            continue
        cells = RoofCells(height[where], numbers[where] == number, chosen, x[where], y[where], float(cell))
        roof = roof_planes(cells, float(given["noise"]))
        counts.append(len(roof.planes))
        for index, plane in enumerate(roof.planes):
            on = chosen & (roof.numbers == index)
            values = plane.at(x[where], y[where]), np.asarray(plane.east), np.asarray(plane.north)
            for band, value in zip(found, values):
                band[where] = np.where(on, value, band[where])
    np.savez(f"{folder}/own.npz", found=found, counts=np.array(counts))


def _theirs(points: np.ndarray, ends: np.ndarray, numbers: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """(N, 3) height and slopes of open3d's planes at each point, and how many each roof has; points without a plane
    get that of the nearest one that has one."""
    found, counts, start = np.full(points.shape, np.nan), [], 0
    for end in ends:
        part, labels = points[start:end], numbers[start:end].copy()
        counts.append(len(np.unique(labels[labels >= 0])))
        if counts[-1]:
            on = labels >= 0
            planes = {label: fitted(*part[labels == label].T) for label in np.unique(labels[on])}
            labels[~on] = labels[on][cKDTree(part[on, :2]).query(part[~on, :2])[1]]
            for label, plane in planes.items():
                chosen = np.flatnonzero(labels == label) + start
                found[chosen, 0] = plane.at(points[chosen, 0], points[chosen, 1])
                found[chosen, 1:] = plane.east, plane.north
        start = int(end)
    return found, np.array(counts)


def _figures(roofs: Roofs, points: np.ndarray, where: np.ndarray, found: np.ndarray, counts: np.ndarray) -> List[str]:
    """``where`` is the cell of each point. Cells with a plane, %; 68 % of the heights' errors, m; the median angle from
    the true slope, degrees; planes for each roof; roofs with the true number of planes, %."""
    has = np.isfinite(found[:, 0])
    truth = roofs.truth.ravel()[where]
    away = np.abs(found[:, 0] - truth)
    known = has & np.isfinite(truth)
    if not known.any():
        return [f"{100 * has.mean():.1f}", *["–"] * (len(_NAMES) - 1)]
    figures = [f"{100 * has.mean():.1f}", f"{np.percentile(away[known], 68):.3f}"]
    if roofs.kinds is None:
        return [*figures, "–", f"{counts.mean():.1f}", "–"]
    true = _true_slopes(roofs).reshape(2, -1)[:, where].T
    normals = [np.column_stack([-slopes, np.ones(len(slopes))]) for slopes in (found[:, 1:], true)]
    normals = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in normals]
    angle = np.degrees(np.arccos(np.clip((normals[0] * normals[1]).sum(axis=1), -1, 1)))
    kinds = [roofs.kinds[number] for number in _order(roofs)]
    right = np.mean([count == _PLANES[kind] for count, kind in zip(counts, kinds)])
    return [*figures, f"{np.nanmedian(angle):.2f}", f"{counts.mean():.1f}", f"{100 * right:.0f}"]


def _true_slopes(roofs: Roofs) -> np.ndarray:
    """(2, rows, columns) rise to the east and to the north, NaN where the true surface bends."""
    padded = np.pad(roofs.truth.astype(np.float64), 1, mode="edge")
    middle = padded[1:-1, 1:-1]
    ends = ((padded[1:-1, 2:], padded[1:-1, :-2]), (padded[:-2, 1:-1], padded[2:, 1:-1]))
    even = np.logical_and(*(np.abs(one + other - 2 * middle) < _EVEN_M for one, other in ends))
    return np.where(even, np.stack([(one - other) / (2 * roofs.cell) for one, other in ends]), np.nan)


def _order(roofs: Roofs) -> List[int]:
    """The numbers of the roofs that have points, in the points' order."""
    return [int(number) for number in np.unique(roofs.numbers[_inner(roofs)]) if number]


def _data(roofs: Roofs) -> Tuple[Dict[str, Any], np.ndarray]:
    """What open3d gets, and the cell of each point."""
    inner, (x, y) = _inner(roofs), _places(roofs.numbers.shape, roofs.cell)
    order = _order(roofs)
    where = [np.flatnonzero((inner & (roofs.numbers == number)).ravel()) for number in order]
    choices = BUILDINGS.roofs
    least = [max(choices.least_m2 / roofs.cell**2, choices.least_share * len(part), 4.0) for part in where]
    every = np.concatenate(where)
    points = np.column_stack([part.ravel()[every] for part in (x, y, roofs.height)]).astype(np.float64)
    tolerance = max(choices.tolerance_m, choices.tolerance_errors * roofs.noise)
    ends = np.cumsum([len(part) for part in where])
    return {"points": points, "ends": ends, "least": np.ceil(least), "tolerance": tolerance}, every


_NAMES = (
    "cells with a plane, %",
    "68 % of the heights' errors, m",
    "median angle from the true slope, °",
    "planes for each roof",
    "roofs with as many planes as they have, %",
)


def rows() -> List[Beside]:
    """Planes by RANSAC and by planar patches beside ours."""
    found = []
    for number, roofs in enumerate(few(_cases())):
        data, where = _data(roofs)

        def prepare(folder: str, roofs: Roofs = roofs) -> None:
            more = {"height": roofs.height, "numbers": roofs.numbers, "inner": _inner(roofs)}
            np.savez(f"{folder}/own_data.npz", **more, cell=roofs.cell, noise=roofs.noise)

        for way, name in (("ransac", "segment_plane"), ("patches", "detect_planar_patches")):
            say(f"{roofs.name}: {name}")
            both: Both = compared_with(way, data, own, prepare)
            ours = both.ours["found"].reshape(3, -1)[:, where].T
            own_figures = _figures(roofs, data["points"], where, ours, both.ours["counts"])
            their_figures, few_planes = [ABSENT] * len(_NAMES), False
            if both.theirs is not None:
                theirs = _theirs(data["points"], data["ends"], both.theirs["numbers"])
                their_figures = _figures(roofs, data["points"], where, *theirs)
                few_planes = float(their_figures[0]) < _FEW_PERCENT  # of which other figures say nothing
            for index, figure in enumerate(_NAMES):
                if (few_planes and index > 0) or own_figures[index] == their_figures[index] == "–":
                    continue
                part = "planes of roofs" if number == index == 0 and way == "ransac" else ""
                label = f"{roofs.name}; open3d: `{name}`" if index == 0 else ""
                found.append(both.row(part, label, figure, own_figures[index], their_figures[index]))
    return found
