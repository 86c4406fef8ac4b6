"""open3d beside our own parts: one table of accuracy on data whose truth is known, CPU seconds and memory.

REPM_SOLIDS_PYTHON names a Python that has open3d and trimesh.
"""

from __future__ import annotations

from typing import List, Tuple

import numpy as np

from benchmarks import answers_solids, beside_distances, beside_normals, beside_roofs, buildings
from benchmarks.answers_solids import has_library, library
from benchmarks.beside import ABSENT, HEADERS, Beside, compared_with
from benchmarks.runner import Failed, few, say
from benchmarks.tables import Section, table
from repm_qgis.evaluation.icp import shift_onto
from repm_qgis.evaluation.parameters import ICP
from repm_qgis.imagery.raster import opened, read

_POINTS, _NOISE_M = 100_000, 0.3  # of each of two clouds of one surface
_SHIFT_M, _STARTS_M = np.array([1.37, -2.21, 0.83]), 0.5  # between the clouds, and how far off a start is


def own_icp(folder: str) -> None:
    """The shift of two clouds from a start."""
    given = np.load(f"{folder}/data.npz")
    np.savez(f"{folder}/own.npz", shift=shift_onto(given["points"], given["reference"], given["start"]))


def _clouds_of(reference: str) -> Tuple[np.ndarray, np.ndarray]:
    """Two clouds of one surface, each of its own places and noise, the first one moved; x, y, z in m."""
    with opened(reference) as dataset:
        heights, place = read(dataset), dataset.GetGeoTransform()
    numbers, known = np.random.default_rng(3), np.argwhere(np.isfinite(heights))
    clouds = []
    for noise in (_NOISE_M, answers_solids._NOISE_M):
        row, column = numbers.permutation(known)[:_POINTS].T
        inside = numbers.uniform(size=(2, len(row)))
        z = heights[row, column] + numbers.normal(0, noise, len(row))
        clouds.append(np.column_stack([(column + inside[0]) * place[1], (row + inside[1]) * place[5], z]))
    return clouds[0] - _SHIFT_M, clouds[1]


def _icp() -> List[Beside]:
    """Two clouds of one surface, whose shift is known."""
    found: List[Beside] = []
    for case in few(buildings._cases()):
        say(f"icp: {case.name}")
        points, reference = _clouds_of(case.reference)
        spacing = 1 / np.sqrt(len(reference) / np.ptp(reference[:, 0]) / np.ptp(reference[:, 1]))
        start = _SHIFT_M + np.random.default_rng(5).normal(0, _STARTS_M / np.sqrt(3), 3)
        data = {"points": points, "reference": reference, "start": start, "reaches": np.array(ICP.reaches) * spacing}
        both = compared_with("icp", data, own_icp)
        found_by = [both.ours] if both.theirs is None else [both.ours, both.theirs]
        errors = [*(f"{np.linalg.norm(each['shift'] - _SHIFT_M):.3f}" for each in found_by), ABSENT][:2]
        part = "" if found else "shift by points (ICP)"
        name = f"true surface of {case.name}, two clouds of {_POINTS} points, noise of {_NOISE_M:g} m"
        found.append(both.row(part, name, "error of the shift, m", *errors))
    return found


def _picture() -> List[Beside]:
    say("picture")
    try:
        answer = f"{library('picture')['size']}" if has_library() else ABSENT
    except Failed as error:
        answer = f"no: {error}"
    return [
        [
            "picture without a display",
            "a sphere",
            "is drawn",
            "map in the report, page of `repm:viewer`",
            answer,
            *[""] * 4,
        ]
    ]


def parts() -> List[str]:
    """The table; without open3d, of our own parts."""
    rows: List[Beside] = []
    for measured in (beside_roofs.rows, beside_normals.rows, _icp, beside_distances.rows, _picture):
        rows += measured()
        say("\n".join(map(str, rows)))
    version = library("version")["version"] if has_library() else "(absent: REPM_SOLIDS_PYTHON names no Python)"
    return [
        f"open3d {version} and our own parts on the same data, whose truth is known: simulated surfaces and towns, and "
        "the lidar of `jax_068`. CPU seconds are those of the work alone, memory is the largest of the process. Meshes "
        "with fewer triangles and surfaces of points stand "
        "[further up](#point-clouds-for-display-and-meshes), filters of outliers in [answers](benchmarks/answers.md). "
        "What follows for each part: [dependencies](dependencies.md).",
        table(HEADERS, rows),
    ]


SECTIONS = [
    Section("beside_open3d", "open3d beside our own parts", "make bench-beside_open3d", {"beside_open3d": parts}),
]
