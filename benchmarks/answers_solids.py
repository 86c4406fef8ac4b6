"""Clouds and meshes: known shifts found by points and by slopes; sizes, times, memory; readers of other programs.

REPM_SOLIDS_PYTHON names a Python that has open3d and trimesh, which read what is written; CloudCompare is taken from
PATH. Programs that are absent give a row that says so.
"""

from __future__ import annotations

import glob
import json
import math
import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from benchmarks import answers_dtm, answers_walls
from benchmarks.clouds import make, megabytes
from benchmarks.runner import ROOT, Alone, Failed, alone, few, is_quick, say, stage, there
from benchmarks.scenes import SHARED
from benchmarks.tables import table
from repm_qgis.contracts.stages import COMPAREDSM, DSMFUSE
from repm_qgis.imagery.raster import opened, read, write
from repm_qgis.solids.mesh import write_mesh
from repm_qgis.solids.parameters import SOLIDS
from repm_qgis.solids.point_cloud import created_cloud

_PYTHON = os.environ.get("REPM_SOLIDS_PYTHON", "")
_SHIFTS_M = ((0.3, -0.2, 0.1), (1.37, -2.21, 0.83), (-4.1, 3.3, -6.0))
_POINTS_M2, _NOISE_M = 2.0, 0.05  # of the lidar points that are drawn from the truth
_MESH_STEPS = (4, 7)  # of rows and columns of meshes that are compared with simplified ones
_CELLS, _PLACES, _HALF_M = 300_000, 100_000, 75.0  # of the DSM and of the truth, and half the truth's square


def solids() -> List[str]:
    """All parts of the table."""
    return [
        *answers_walls.walls(),
        *answers_walls.outliers(),
        *_shifts(),
        *([] if is_quick() else _clouds()),
        *_meshes(),
        *_surfaces(),
    ]


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
    result = stage(COMPAREDSM, dsm=dsm, reference=reference, align=method)
    return [result.dx, result.dy, result.dz], there(result.rmse)


def _cases() -> List[answers_dtm.Case]:
    """The simulated town, and the real one where it is."""
    real = (SHARED / "jax_068").exists() and not is_quick()
    return [answers_dtm._town(), *([answers_dtm._lidar(19)] if real else [])]


def _shifts() -> List[str]:
    rows: List[List[object]] = []
    for case in few(_cases()):
        with tempfile.TemporaryDirectory() as folder:
            cloud, moved = f"{folder}/lidar.laz", f"{folder}/moved.tif"
            _lidar(case.reference, cloud)
            for name, reference in few((("lidar points", cloud), ("raster", case.reference))):
                for method in few(("3d", "icp")):
                    say(f"solids: {case.name}, {name}, {method}")
                    base = alone(found_shift, case.dsm, reference, method)
                    errors = []
                    for shift in few(_SHIFTS_M):
                        _moved(case.dsm, shift, moved)
                        place, _ = found_shift(moved, reference, method)
                        errors.append(np.abs(np.add(place, shift) - base.result[0]))
                    flat, up = np.max(errors, axis=0)[:2].max(), np.max(errors, axis=0)[2]
                    found = ", ".join(f"{value:+.2f}" for value in base.result[0])
                    cost = [f"{base.cpu_s:.1f}", round(base.mib)]
                    row = [f"{flat:.3f}", f"{up:.3f}", found, f"{base.result[1]:.2f}", *cost]
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
    facts = write_mesh(dsm, path, vertices, ortho=dsm)
    return [facts.vertices, facts.faces]


def fuse_cloud(scene: str, folder: str, cloud: str, normals: bool) -> int:
    """Fuse a scene with a cloud, "" for none; the number of points."""
    files = {"output": f"{folder}/dsm.tif", "cloud": cloud or None}
    made = stage(DSMFUSE, scene=scene, resolution=0.5, colour="greys", workers=1, cloud_normals=normals, **files)
    return int(made.points)


def _clouds() -> List[str]:
    rows: List[List[object]] = []
    town = answers_walls.towns()[0]()
    with tempfile.TemporaryDirectory() as folder:
        for name, file, normals in few(
            (
                ("no cloud", "", False),
                ("LAZ", "a.laz", False),
                ("LAZ, normals", "b.laz", True),
                ("PLY, normals", "c.cloud.ply", True),
            )
        ):
            say(f"solids: {name}")
            path = f"{folder}/{file}" if file else ""
            used = alone(fuse_cloud, town.scene, folder, path, normals)
            cost = [used.result, f"{used.cpu_s:.1f}", round(max(used.mib, used.child_mib))]
            if not path:
                rows.append([name, *cost, "", "", "", ""])
                continue
            programs = _open3d(path) if file.endswith(".ply") else "reads no LAZ"
            read = [_cloudcompare(path), programs, "–"]
            if not normals:
                alone(make_ept, path, f"{folder}/e")
                read[2] = f"as EPT: {_qgis(f'{folder}/e/ept.json', 'ept')}"
            rows.append([name, *cost, f"{megabytes(path):.1f}", *read])
    headers = "cloud | points | CPU of the fusion, s | memory, MiB | MB on disk | CloudCompare | open3d, trimesh | QGIS"
    return [
        "**Clouds** of the town that is seen from two sides, fused by one worker into cells of 0.5 m. Normals are "
        "extra bytes of LAZ.",
        table(headers, rows),
    ]


def make_ept(cloud: str, folder: str) -> None:
    """Write an EPT of a cloud."""
    from repm_qgis.solids.ept import write_ept

    write_ept(cloud, folder, "EPSG:32631")


def _meshes() -> List[str]:
    rows: List[List[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for side in (300,) if is_quick() else (1400, 4472):
            alone(make, folder, side)
            for kind in few(("ply", "glb", "obj")):
                say(f"solids: {kind} of {side} cells a side")
                path = f"{folder}/m.{kind}"
                used = alone(write_mesh_of, f"{folder}/d.tif", path, 500_000)
                cost = [f"{used.cpu_s:.1f}", round(used.mib), f"{sum(map(megabytes, glob.glob(path + '*'))):.1f}"]
                readers = _open3d(path), _cloudcompare(path), _qgis(path, "mdal") if kind == "ply" else "–"
                rows.append([kind.upper(), f"{side * side / 1e6:.1f}", *used.result, *cost, *readers])
    headers = (
        "mesh | Mcells of the DSM | vertices | triangles | CPU, s | memory, MiB | MB on disk | open3d, trimesh | "
        "CloudCompare | QGIS"
    )
    return ["**Meshes** with a picture or colours, 500000 vertices at most.", table(headers, rows)]


# Readers of other programs ----------------------------------------------------------------------------------------


def has_library() -> bool:
    """Whether REPM_SOLIDS_PYTHON names a Python."""
    return Path(_PYTHON).is_file()


def library(*arguments: str) -> Dict[str, Any]:
    script = str(ROOT / "benchmarks" / "solids_libraries.py")
    done = subprocess.run([_PYTHON, script, *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise Failed((done.stderr.strip().splitlines() or ["ended"])[-1][:100])
    found: Dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def _open3d(path: str) -> str:
    if not has_library():
        return "not tried: REPM_SOLIDS_PYTHON names no Python"
    try:
        found = library("read", path)
    except Failed as error:
        return f"no: {error}"
    more = [name for name in ("picture", "normals") if found.get(name)]
    return " and ".join(map(str, sorted(set(found["counts"])))) + (f", {', '.join(more)}" if more else "")


def _cloudcompare(path: str) -> str:
    """What CloudCompare's command line finds in a file."""
    if not (shutil.which("CloudCompare") and shutil.which("xvfb-run")):
        return "not tried: absent"
    with tempfile.TemporaryDirectory() as folder:
        text = f"{folder}/a.asc"
        save = ["-C_EXPORT_FMT", "ASC", "-ADD_HEADER", "-O", path, "-SAVE_CLOUDS", "FILE", text]
        command = ["xvfb-run", "-a", "CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF", *save]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        header = ""
        if os.path.exists(text):
            with open(text, encoding="utf-8") as stream:
                header = stream.readline()
    said = done.stdout + done.stderr
    found = re.search(r"Found one (?:cloud|mesh) with (\d+)", said)
    if not found:
        reason = re.search(r"\[Load\] (.*)", said)
        return f"no: {reason.group(1) if reason else said.strip().splitlines()[-1][:100]}"
    return found.group(1) + (", normals" if " Nx" in header else "") + (", picture" if "tex. coords" in said else "")


def qgis_count(path: str, provider: str) -> int:
    """The points or triangles of a layer in QGIS; -1 where it is not valid."""
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    from qgis.core import QgsApplication, QgsMeshLayer, QgsPointCloudLayer

    application = QgsApplication([], False)
    application.initQgis()
    layer = (QgsMeshLayer if provider == "mdal" else QgsPointCloudLayer)(path, "", provider)
    if not layer.isValid():
        return -1
    return int(layer.dataProvider().faceCount() if provider == "mdal" else layer.pointCount())


def _qgis(path: str, provider: str) -> str:
    if find_spec("qgis") is None:
        return "not tried: QGIS is absent"
    count = alone(qgis_count, path, provider).result
    return str(count) if count >= 0 else "no: not a valid layer"


# Other surfaces ---------------------------------------------------------------------------------------------------


def _surfaces() -> List[str]:
    """What open3d makes of the same mesh and cloud."""
    if not has_library():
        return ["Simplified meshes and surfaces of points were not measured: REPM_SOLIDS_PYTHON names no Python."]
    town = answers_walls.towns()[0]()
    simple: List[List[object]] = []
    surfaces: List[List[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        dsm, cloud = answers_walls.fused(town, folder, cloud=f"{folder}/c.cloud.ply", cloud_normals=True)
        cells, truth = f"{folder}/cells.npz", f"{folder}/truth.npz"
        _write_places(dsm, town, cells, truth)
        full = f"{folder}/full.ply"
        write_mesh(dsm, full)
        for step in few(_MESH_STEPS):
            say(f"solids: as many triangles as every {step} rows and columns have")
            path = f"{folder}/few.ply"
            rows = alone(write_thinned, dsm, path, step)
            vertices, faces = rows.result
            simple.append(
                _mesh_row(f"one of {step} rows and columns", vertices, rows, library("distance", path, cells))
            )
            triangles = write_mesh(dsm, path, vertices).faces
            chosen = alone(write_mesh_of, dsm, path, round(vertices * faces / triangles))
            found = library("distance", path, cells)
            simple.append(_mesh_row("**MESH_VERTICES, about as many triangles**", chosen.result[0], chosen, found))
            found = library("simplify", full, cells, str(faces))
            simple.append(
                ["open3d's quadric decimation", "", found["triangles"], *found["cells"]]
                + [f"{found['cpu_s']:.1f}", round(found["mib"])]
            )
        for name, kind, path in (
            ("the DSM's mesh of all cells", "distance", full),
            ("Poisson (depth 9)", "poisson", cloud),
            ("ball pivoting (1, 2, 4 distances of points)", "pivoting", cloud),
        ):
            say(f"solids: {name}")
            found = library(kind, path, truth)
            cost = ["", ""] if kind == "distance" else [f"{found['cpu_s']:.1f}", round(found["mib"])]
            surfaces.append([name, found["walls"][1], found["tops"][1], found["walls"][0], found["tops"][0], *cost])
    return [
        "**Simplified meshes** of the DSM of the town that is seen from two sides: distances of its cells from them.",
        table("mesh | vertices | triangles | RMS, m | cells within 0.5 m, % | CPU, s | memory, MiB", simple),
        "**Surfaces of the cloud's points** (with normals) by open3d, in the middle 150 m of that town: places on the "
        f"true walls of 3 m and more, and on roofs and ground ({_PLACES} each), within 0.5 m of the surface. Neither "
        "is built in: the mesh of the DSM is nearer to both.",
        table(
            "surface | walls, % | roofs and ground, % | RMS of walls, m | of the others, m | CPU, s | memory, MiB",
            surfaces,
        ),
    ]


def write_thinned(dsm: str, path: str, step: int) -> List[int]:
    """Write the mesh of every ``step``-th row and column; its vertices and triangles."""
    with opened(dsm) as dataset:
        most = math.ceil(dataset.RasterXSize * dataset.RasterYSize / step**2)
    few_cells = replace(SOLIDS, simplification=replace(SOLIDS.simplification, cells=most))
    facts = write_mesh(dsm, path, most, parameters=few_cells)
    return [facts.vertices, facts.faces]


def _mesh_row(name: str, vertices: int, made: Alone, found: Dict[str, Any]) -> List[object]:
    return [name, vertices, found["triangles"], *found["cells"], f"{made.cpu_s:.1f}", round(made.mib)]


def _write_places(dsm: str, town: answers_walls.Town3d, cells: str, truth: str) -> None:
    """Places of the DSM's cells and of the true surface, as the script of open3d takes them."""
    with opened(dsm) as dataset:
        heights, place = read(dataset), dataset.GetGeoTransform()
    known = np.argwhere(np.isfinite(heights))
    row, column = np.random.default_rng(0).choice(known, _CELLS).T
    x, y = place[0] + (column + 0.5) * place[1], place[3] + (row + 0.5) * place[5]
    points = np.column_stack([x, y, heights[row, column]])
    np.savez(cells, cells=points, origin=points.mean(axis=0).round())
    samples = {name: part - town.shift for name, part in town.truth.samples(_HALF_M, _PLACES).items()}
    np.savez(truth, origin=points.mean(axis=0).round(), **samples)
