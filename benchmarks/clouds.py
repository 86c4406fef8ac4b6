"""What a point cloud for display and a mesh cost: CPU seconds, memory, size.

Each is made by a process of its own, so that memory is that of the work alone; QGIS then opens and draws the results
once.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any, List, Tuple

import numpy as np

from benchmarks.runner import alone, is_quick
from benchmarks.tables import Section, table

CRS, WEST, NORTH = "EPSG:32631", 600000.0, 4800000.0


def heights(rows: range, columns: int) -> np.ndarray:
    """Hills with blocks on them, 0.5 m cells."""
    y, x = np.mgrid[rows.start : rows.stop, 0:columns] * 0.5
    return 100 + 20 * np.sin(x / 50) + 10 * ((x // 20 + y // 20) % 3)


def make(folder: str, side: int) -> None:
    """A cloud of a point a cell, and a DSM of the same cells."""
    from repm_qgis.geometry.vertical import HeightDatum
    from repm_qgis.imagery.raster import RasterFrame, created
    from repm_qgis.solids.point_cloud import created_cloud

    numbers = np.random.default_rng(0)
    wkt = HeightDatum.of("").file_crs(CRS)
    grid = (WEST, 0.5, 0, NORTH, 0, -0.5)
    with (
        created_cloud(f"{folder}/c.laz", CRS, (WEST, NORTH, 0)) as cloud,
        created(f"{folder}/d.tif", RasterFrame((side, side), np.float32, 1, grid, wkt)) as dsm,
    ):
        for row in range(0, side, 64):
            rows = range(row, min(row + 64, side))
            z = heights(rows, side)
            dsm.write(z.astype(np.float32), 0, row)
            y, x = (np.mgrid[rows.start : rows.stop, 0:side] + numbers.uniform(size=(2, *z.shape))) * 0.5
            noisy = z.ravel() + numbers.normal(0, 0.1, z.size)
            cloud.write(WEST + x.ravel(), NORTH - y.ravel(), noisy, np.full(z.size, 0.5))


def ept(folder: str) -> None:
    from repm_qgis.solids.ept import write_ept

    write_ept(f"{folder}/c.laz", f"{folder}/e", CRS)


def mesh(folder: str, vertices: int) -> None:
    from repm_qgis.solids.mesh import write_mesh

    write_mesh(f"{folder}/d.tif", f"{folder}/m.ply", vertices)


def draw(path: str, provider: str) -> None:
    """QGIS opens an EPT or a mesh, and draws all of it once."""
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    from qgis.core import QgsApplication, QgsMapRendererSequentialJob, QgsMapSettings, QgsMeshLayer, QgsPointCloudLayer
    from qgis.PyQt.QtCore import QSize

    application = QgsApplication([], False)
    application.initQgis()
    layer = (QgsMeshLayer if provider == "mdal" else QgsPointCloudLayer)(path, "", provider)
    settings = QgsMapSettings()
    settings.setLayers([layer])
    settings.setDestinationCrs(layer.crs())
    settings.setExtent(layer.extent())
    settings.setOutputSize(QSize(1000, 1000))
    job = QgsMapRendererSequentialJob(settings)
    job.start()
    job.waitForFinished()


def cost(function: Any, *arguments: object) -> Tuple[float, int]:
    """CPU seconds and MiB of a process that does one of these."""
    used = alone(function, *arguments)
    return used.cpu_s, round(used.mib)


def megabytes(path: str) -> float:
    files = [Path(path), *Path(path).rglob("*")]
    return sum(file.stat().st_size for file in files if file.is_file()) / 1e6


def displays() -> List[str]:
    rows: List[List[object]] = []
    for side in (300,) if is_quick() else (1400, 4472):
        with tempfile.TemporaryDirectory() as folder:
            alone(make, folder, side)
            count = side * side / 1e6
            rows.append(["EPT", count, *cost(ept, folder), megabytes(f"{folder}/e")])
            rows.append(["QGIS draws the EPT", count, *cost(draw, f"{folder}/e/ept.json", "ept"), ""])
            for vertices in (500_000, 0)[: 1 if side > 2000 else 2]:
                what = "mesh of all cells" if not vertices else "mesh, 500000 vertices at most"
                rows.append([what, count, *cost(mesh, folder, vertices), megabytes(f"{folder}/m.ply")])
                rows.append([f"QGIS draws the {what}", count, *cost(draw, f"{folder}/m.ply", "mdal"), ""])
    return [
        "Simulated hills with blocks, a point a cell of 0.5 m. CPU seconds and the largest memory are those of a "
        "process that does this alone, its start included.",
        table("what | Mpoints or Mcells | CPU, s | memory, MiB | MB on disk", rows),
    ]


SECTIONS = [Section("clouds", "Point clouds for display, and meshes", "make bench-clouds", {"clouds": displays})]
