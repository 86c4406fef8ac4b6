"""What fusing costs (``make bench-fusion``): height maps on disk to a DSM, without the matching.

The views are simulated, their images empty: fusion needs their RPCs only. The height maps hold a made-up town of
blocks on hills, with noise, gaps, and backgrounds beside the blocks. Each run is a process of its own with two workers;
memory is the sum of the largest resident sets of the process and its workers.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Tuple

import cv2
import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.imagery.raster import write  # noqa: E402
from repm_qgis.matching.pair_backend import rectified_over_tile  # noqa: E402
from repm_qgis.parallel import run_tasks  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.records import HeightMapRecord  # noqa: E402
from repm_qgis.scene import Scene  # noqa: E402
from repm_qgis.simulation.rpc_fit import fit_rpc  # noqa: E402
from repm_qgis.simulation.scene import SceneSpec, make_views, rpc_tags  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402
from repm_qgis.stereo.height_maps import BANDS  # noqa: E402
from repm_qgis.stereo.triangulation import pair_geometry  # noqa: E402

SIZE = int(os.environ.get("REPM_BENCH_CELLS", "10000"))  # cells a side of the largest DSM
WORKERS = 2


def empty_images(size: int, folder: Path) -> List[str]:
    """Images of nothing with RPCs: a sparse file takes no room."""
    spec = SceneSpec.default("urban", size, 1)
    paths = []
    for view in make_views(spec):
        path = str(folder / f"{view.name}.tif")
        dataset = gdal.GetDriverByName("GTiff").Create(
            path, size, size, 1, gdal.GDT_UInt16, ["SPARSE_OK=TRUE", "TILED=YES"]
        )
        dataset.SetMetadata(rpc_tags(fit_rpc(view.localise, view.size, (150.0, 300.0)).rpc), "RPC")
        dataset = None
        paths.append(path)
    return paths


def town(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of a town of blocks of 60 m with streets of 20 m, on hills."""
    blocks = (np.mod(x, 80.0) < 60.0) & (np.mod(y, 80.0) < 60.0)
    storeys = 6.0 + 3.0 * np.mod(np.floor(x / 80.0) * 7 + np.floor(y / 80.0) * 3, 5)
    return 200.0 + 15.0 * np.sin(x / 400.0) * np.cos(y / 300.0) + np.where(blocks, storeys, 0.0)


def height_map(
    work: Tuple[Scene, str, Tuple[float, ...], Tuple[float, float], Tuple[str, str], str],
) -> HeightMapRecord:
    """Write the height map that a pair would give of a tile, with 0.2 px of smooth noise; gives its record."""
    scene, tile, bounds, altitudes, names, path = work
    first, second = (scene.view(name) for name in names)
    pair = rectified_over_tile(scene, first, second, bounds, altitudes)
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
    write(
        path, [height.astype(np.float32), score, filled.astype(np.float32)], (0, 1, 0, 0, 0, 1), "", descriptions=BANDS
    )
    return HeightMapRecord(
        tile=tile,
        backend="sgm",
        pair=names,
        file=path,
        size=(width, rows),
        valid=int(np.isfinite(score).sum()),
        filled=int(filled.sum()),
        metres_per_px=geometry.metres_per_px,
        vertical_parallax_px=0.0,
        table_error_m=geometry.error_m,
        altitudes=altitudes,
    )


def scene_of(size: int, pairs: int, folder: Path) -> str:
    """A scene of ``size`` px a side with height maps of so many pairs; gives its path."""
    folder.mkdir(parents=True)
    made = run_stage(
        "epmfit",
        {
            "images": empty_images(size, folder),
            "workspace": str(folder / "w"),
            "altitude_min": 170.0,
            "altitude_max": 250.0,
        },
        Silent(),
    )
    scene = Scene.load(made["scene"])
    scene = replace(scene, refinement="polynomial")
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


def measured(scene: str, cell: float, folder: Path) -> Dict[str, float]:
    """Cells, wall and CPU seconds, and MiB of fusing a scene, in a process of its own."""
    job = folder / "job.json"
    job.write_text(
        json.dumps({"scene": scene, "output": str(folder / "dsm.tif"), "resolution": cell, "workers": WORKERS})
    )
    before, start = os.times(), time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "repm_qgis", "dsmfuse", str(job)],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    text: List[str] = []
    reader = threading.Thread(target=lambda: text.append(process.stdout.read()))
    reader.start()
    peaks: Dict[int, float] = {}
    while process.poll() is None:
        peaks.update(_largest(process.pid))
        time.sleep(0.1)
    reader.join()
    wall, after = time.perf_counter() - start, os.times()
    result = json.loads(text[0].splitlines()[-1])
    if process.returncode:
        raise SystemExit(f"fusion: {result}")
    cells = float(result["result"]["cells"])
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return {
        "cells": cells,
        "wall": wall,
        "cpu": cpu,
        "memory": sum(peaks.values()),
        "valid": result["result"]["valid_percent"],
    }


def _largest(group: int) -> Dict[int, float]:
    """MiB of the largest resident set so far of each process of a process group."""
    found = {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                if os.getpgid(int(name)) == group:
                    lines = Path(f"/proc/{name}/status").read_text().splitlines()
                    found[int(name)] = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024
            except (OSError, StopIteration):
                continue
    return found


def main() -> None:
    folder = Path(tempfile.mkdtemp(prefix="repm_bench_fusion"))
    rows = []
    try:
        for size, pairs, cell in ((SIZE, 1, 0.5), (SIZE // 2, 1, 1.0), (SIZE // 2, 3, 0.5), (SIZE // 4, 1, 0.5)):
            work = folder / f"{size}_{pairs}_{cell}"
            found = measured(scene_of(size, pairs, work), cell, work)
            shutil.rmtree(work)
            rate = found["cells"] / 1e6 / found["cpu"] * WORKERS
            rows.append(
                [
                    f"{found['cells'] / 1e6:.1f}",
                    pairs,
                    cell,
                    found["valid"],
                    found["wall"],
                    found["cpu"],
                    f"{rate:.2f}",
                    f"{found['memory']:.0f}",
                ]
            )
            print(rows[-1], flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    publish(
        "fusion",
        "The cost of fusing",
        "make bench-fusion",
        [
            f"Height maps of 0.5 m px on disk to a DSM, {WORKERS} workers. Cells a second are what {WORKERS} cores do that "
            f"nothing else uses: cells / CPU seconds x {WORKERS}. Bars: 3 Mcell/s, 1024 MiB. {__doc__.splitlines()[2]}",
            table(
                ["Mcells", "pairs", "cell, m", "valid %", "wall, s", "CPU, s", "Mcell/s on 2 cores", "memory, MiB"],
                rows,
            ),
        ],
    )


if __name__ == "__main__":
    main()
