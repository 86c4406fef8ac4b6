"""What fusing costs: height maps on disk to a DSM, without the matching.

The views are simulated, and their images are noise. The height maps hold a made-up town
of blocks on hills, with noise, gaps, and backgrounds beside the blocks. Each run is a process of its own with two
workers; memory is the sum of the largest resident sets of the process and its workers.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Tuple

import cv2
import numpy as np
from osgeo import gdal

from benchmarks.runner import ROOT, few, is_quick, measured, resident_gib, say, stage, there
from benchmarks.tables import Section, table
from repm_qgis.contracts.arrays import Altitudes, Bounds
from repm_qgis.contracts.records import HeightMapRecord
from repm_qgis.contracts.results import DsmFuseResult
from repm_qgis.contracts.stages import EPMFIT
from repm_qgis.matching.pair_backend import rectified_over_tile
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.runtime.parallel import run_tasks
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.simulation.scene import SceneSpec, make_views
from repm_qgis.stereo.height_maps import write_height_map
from repm_qgis.stereo.triangulation import pair_geometry

SIZE = int(os.environ.get("REPM_BENCH_CELLS", "10000"))  # cells a side of the largest DSM
WORKERS = 2
Work = Tuple[Scene, str, Bounds, Altitudes, Tuple[str, str], str]


def made_up_images(size: int, folder: Path) -> List[str]:
    """Images of noise with RPCs: the heights are made up as well, but a town's choice reads its images."""
    paths, random = [], np.random.default_rng(5)
    for view in make_views(SceneSpec.default("urban", size, 1)):
        noise = random.integers(40, 200, (256, size)).astype(np.uint8)  # of its own: no two files show the same image
        paths.append(str(folder / f"{view.name}.tif"))
        dataset = gdal.GetDriverByName("GTiff").Create(paths[-1], size, size, 1, gdal.GDT_Byte, ["TILED=YES"])
        for row in range(0, size, len(noise)):
            dataset.GetRasterBand(1).WriteArray(noise[: size - row], 0, row)
        dataset.SetMetadata(rpc_tags(fit_rpc(view.localise, view.size, (150.0, 300.0)).rpc), "RPC")
        dataset = None
    return paths


def town(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of a town of blocks of 60 m with streets of 20 m, on hills."""
    blocks = (np.mod(x, 80.0) < 60.0) & (np.mod(y, 80.0) < 60.0)
    storeys = 6.0 + 3.0 * np.mod(np.floor(x / 80.0) * 7 + np.floor(y / 80.0) * 3, 5)
    return 200.0 + 15.0 * np.sin(x / 400.0) * np.cos(y / 300.0) + np.where(blocks, storeys, 0.0)


def height_map(work: Work) -> HeightMapRecord:
    """Write the height map that a pair would give of a tile, with 0.2 px of smooth noise."""
    scene, tile, bounds, altitudes, names, path = work
    first, second = (scene.view(name) for name in names)
    pair = there(rectified_over_tile(scene, (first.name, second.name), bounds, altitudes))
    geometry = pair_geometry(pair, first, second, altitudes, scene.crs)
    width, rows = pair.size
    axes = np.arange(width, dtype=float), np.arange(rows, dtype=float)
    rng = np.random.default_rng([len(path), *map(ord, tile), *map(ord, names[1])])
    height = np.full((rows, width), 200.0)
    for _ in range(2):
        height = town(*(part.on_grid(*axes, height) for part in (geometry.x, geometry.y)))
    filled = np.zeros(height.shape, bool)
    step = np.abs(np.diff(height, axis=1, prepend=height[:, :1])) > 3
    for shift in range(4):
        filled[:, shift:] |= step[:, : step.shape[1] - shift]
    # Matched neighbours share most of their windows, and so of their noise.
    noise = cv2.GaussianBlur(rng.normal(0, 1.0, height.shape).astype(np.float32), (0, 0), 2.0)
    height += noise * (0.2 * geometry.metres_per_px / noise.std())
    gaps = np.kron(rng.random((rows // 8 + 1, width // 8 + 1)) < 0.02, np.ones((8, 8), bool))[:rows, :width]
    height[gaps & ~filled] = np.nan
    score = np.where(filled | np.isnan(height), np.nan, rng.beta(9, 1, height.shape)).astype(np.float32)
    record = HeightMapRecord(
        tile=tile,
        backend="sgm",
        pair=names,
        metres_per_px=geometry.metres_per_px,
        vertical_parallax_px=0.0,
        table_error_m=geometry.error_m,
        altitudes=altitudes,
    )
    return write_height_map(path, "made up", record, height.astype(np.float32), score, filled)


def scene_of(size: int, pairs: int, folder: Path) -> str:
    """A scene of ``size`` px a side with height maps of so many pairs; returns its path."""
    images = made_up_images(size, folder)
    made = stage(EPMFIT, images=images, workspace=str(folder / "w"), altitude_min=170.0, altitude_max=250.0)
    scene = replace(Scene.load(made.scene), refinement="polynomial")
    names = [(scene.views[i].name, scene.views[j].name) for i, j in ((0, 1), (1, 2), (0, 2))][:pairs]
    lean = scene.lean()
    tasks = [
        (lean, tile.id, tile.bounds, tile.altitudes, pair, str(folder / f"{tile.id}_{pair[0]}_{pair[1]}.tif"))
        for tile in scene.tiles
        for pair in names
        if pair[0] in tile.views and pair[1] in tile.views
    ]
    records = run_tasks(height_map, tasks, WORKERS, Silent(), str)
    scene = scene.with_tiles(lambda tile: replace(tile, heights=tuple(r for r in records if r.tile == tile.id)))
    return scene.save(str(folder / "scene.json"))


def fused(size: int, pairs: int, cell: float) -> List[object]:
    """The row of one DSM, fused by a process of its own."""
    with tempfile.TemporaryDirectory(prefix="repm_bench_fusion") as name:
        folder = Path(name)
        scene = scene_of(size, pairs, folder)
        options: Dict[str, object] = {"scene": scene, "output": str(folder / "dsm.tif"), "resolution": cell}
        (folder / "job.json").write_text(json.dumps({**options, "workers": WORKERS}))
        command = [sys.executable, "-m", "repm_qgis", "dsmfuse", str(folder / "job.json")]
        text, cost = measured(command, str(ROOT), resident_gib())
    result = DsmFuseResult.from_mapping(json.loads(text.splitlines()[-1])["result"])
    mcells = result.cells / 1e6
    rate, memory = f"{mcells / cost.cpu_s * WORKERS:.2f}", f"{1024 * cost.peak_gib:.0f}"
    return [f"{mcells:.1f}", pairs, cell, result.valid_percent, cost.wall_s, cost.cpu_s, rate, memory]


def costs() -> List[str]:
    size = 1000 if is_quick() else SIZE
    rows = []
    for case in few(((size, 1, 0.5), (size // 2, 1, 1.0), (size // 2, 3, 0.5), (size // 4, 1, 0.5))):
        rows.append(fused(*case))
        say(rows[-1])
    return [
        f"Height maps of 0.5 m px on disk to a DSM, {WORKERS} workers. Cells a second are what {WORKERS} cores do that "
        f"nothing else uses: cells / CPU seconds x {WORKERS}. Bars: 3 Mcell/s, 1024 MiB. The views are simulated, and "
        "their images are noise. The height maps hold a made-up town of blocks on hills.",
        table("Mcells | pairs | cell, m | valid % | wall, s | CPU, s | Mcell/s on 2 cores | memory, MiB", rows),
    ]


SECTIONS = [Section("fusion", "The cost of fusing", "make bench-fusion", {"fusion": costs})]
