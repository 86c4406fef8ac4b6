"""Clouds and meshes: known shifts found by points and by slopes; sizes, times, memory; readers of other programs.

REPM_SOLIDS_PYTHON names a Python that has open3d and trimesh, which read what is written; without it they are absent.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any, List, Sequence, Tuple

import numpy as np

from benchmarks import answers_dtm, answers_walls
from benchmarks.clouds import make, megabytes
from benchmarks.runner import alone, few, say, stage
from benchmarks.scenes import SHARED
from benchmarks.tables import table
from repm_qgis.dsm.point_cloud import created_cloud
from repm_qgis.imagery.raster import opened, read, write

_PYTHON = os.environ.get("REPM_SOLIDS_PYTHON", "")
_SHIFTS_M = ((0.3, -0.2, 0.1), (1.37, -2.21, 0.83), (-4.1, 3.3, -6.0))
_POINTS_M2, _NOISE_M = 2.0, 0.05  # of the lidar points that are drawn from the truth
_READ = """
import json, sys
import open3d, trimesh
path = sys.argv[1]
mesh = open3d.io.read_triangle_mesh(path, True)
other = trimesh.load(path, force="mesh", process=False)
print(json.dumps([len(mesh.triangles), mesh.has_textures(), len(other.faces), len(other.vertices)]))
"""


def solids() -> List[str]:
    """All parts of the table."""
    return [*answers_walls.walls(), *_shifts(), *_meshes()]


def _lidar(reference: str, path: str) -> None:
    """Points at random on a raster's cells, with noise, as a cloud."""
    with opened(reference) as dataset:
        heights, place, crs = read(dataset), dataset.GetGeoTransform(), dataset.GetProjection()
    numbers, (rows, columns) = np.random.default_rng(1), heights.shape
    count = int(rows * columns * place[1] ** 2 * _POINTS_M2)
    column, row = numbers.uniform(0, columns, count), numbers.uniform(0, rows, count)
    z = heights[row.astype(int), column.astype(int)] + numbers.normal(0, _NOISE_M, count)
    known = np.isfinite(z)
    with created_cloud(path, crs, (place[0], place[3], 0.0)) as cloud:
        x, y = place[0] + column * place[1], place[3] + row * place[5]
        cloud.write(x[known], y[known], z[known], np.ones(int(known.sum())))


def _moved(dsm: str, shift: Sequence[float], path: str) -> None:
    with opened(dsm) as dataset:
        heights, place, crs = read(dataset), list(dataset.GetGeoTransform()), dataset.GetProjection()
    place[0], place[3] = place[0] + shift[0], place[3] + shift[1]
    write(path, [heights + np.float32(shift[2])], tuple(place), crs)


def found_shift(dsm: str, reference: str, method: str) -> Tuple[List[float], float]:
    """What is to be added to a DSM, and the RMSE after that."""
    result = stage("comparedsm", dsm=dsm, reference=reference, align=method)
    return [result[name] for name in ("dx", "dy", "dz")], result["rmse"]


def _cases() -> List[answers_dtm.Case]:
    """The simulated town, and the real one where it is."""
    return [answers_dtm._town(), *([answers_dtm._lidar(19)] if (SHARED / "jax_068").exists() else [])]


def _shifts() -> List[str]:
    rows: List[List[Any]] = []
    for case in few(_cases()):
        with tempfile.TemporaryDirectory() as folder:
            cloud, moved = f"{folder}/lidar.laz", f"{folder}/moved.tif"
            _lidar(case.reference, cloud)
            for name, reference in (("raster", case.reference), ("lidar points", cloud)):
                for method in ("3d", "icp"):
                    say(f"solids: {case.name}, {name}, {method}")
                    base = alone(found_shift, case.dsm, reference, method)
                    errors = []
                    for shift in _SHIFTS_M:
                        _moved(case.dsm, shift, moved)
                        place, _ = found_shift(moved, reference, method)
                        errors.append(np.abs(np.add(place, shift) - base.result[0]))
                    flat, up = np.max(errors, axis=0)[:2].max(), np.max(errors, axis=0)[2]
                    place = ", ".join(f"{value:+.2f}" for value in base.result[0])
                    cost = [f"{base.cpu_s:.1f}", round(base.mib)]
                    row = [f"{flat:.3f}", f"{up:.3f}", place, f"{base.result[1]:.2f}", *cost]
                    rows.append([case.name, name, method, *row])
    headers = (
        "DSM | reference | ALIGN | largest error of a known shift, m | of its height, m | dx, dy, dz of the DSM, m | "
        "RMSE then, m | CPU, s | memory, MiB"
    )
    return [
        f"**Known shifts.** DSMs of images, moved by {len(_SHIFTS_M)} known shifts of up to 4 m, against truth as "
        f"a raster and as {_POINTS_M2:g} lidar points per m2 with noise of {_NOISE_M:g} m. Bar: 0.02 m.",
        table(headers, rows),
    ]


def write_mesh_of(dsm: str, path: str, vertices: int) -> List[int]:
    """Write a mesh with the DSM itself as its picture; vertices and triangles."""
    from repm_qgis.dsm.mesh import write_mesh

    facts = write_mesh(dsm, path, vertices, ortho=dsm)
    return [facts.vertices, facts.faces]


def _meshes() -> List[str]:
    rows: List[List[Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for side in few((1400, 4472)):
            alone(make, folder, side)
            for kind in ("ply", "glb"):
                path = f"{folder}/m.{kind}"
                used = alone(write_mesh_of, f"{folder}/d.tif", path, 500_000)
                cost = [f"{used.cpu_s:.1f}", round(used.mib), f"{megabytes(path):.1f}"]
                rows.append(
                    [kind.upper(), f"{side * side / 1e6:.1f}", *used.result, *cost, _readers(path, used.result)]
                )
    headers = "mesh | Mcells of the DSM | vertices | triangles | CPU, s | memory, MiB | MB on disk | open3d and trimesh"
    return ["**Meshes** with a picture or colours, 500000 vertices at most.", table(headers, rows)]


def _readers(path: str, written: Sequence[int]) -> str:
    """What readers of other programs say of a mesh."""
    if not Path(_PYTHON).is_file():
        return "not tried: REPM_SOLIDS_PYTHON names no Python"
    done = subprocess.run([_PYTHON, "-c", _READ, path], capture_output=True, text=True, check=True)
    triangles, textured, faces, _ = json.loads(done.stdout.splitlines()[-1])
    same = "all triangles" if triangles == faces == written[1] else f"{triangles} and {faces} triangles"
    return f"{same}, {'with' if textured else 'no'} picture"
