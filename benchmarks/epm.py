"""The equivalent pinhole model measured: fit, refinement, terrain, agreement with GDAL, cost (``make bench-epm``).

Real RPCs are taken from the folder that REPM_SHARED_DATA names (default: ../shared/data beside the checkout); parts
that need them say so where it is absent.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import numpy as np
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.geometry.equivalent_error import (  # noqa: E402
    EquivalentError,
    VirtualGrid,
    fit_pinhole,
    refine_pinhole,
    virtual_grid,
)
from repm_qgis.geometry.frames import EnuFrame  # noqa: E402
from repm_qgis.geometry.interpolation import upsample_grid  # noqa: E402
from repm_qgis.geometry.refinement import Terrain  # noqa: E402
from repm_qgis.geometry.surface import Surface  # noqa: E402
from repm_qgis.rpc import Rpc  # noqa: E402
from repm_qgis.rpc.readers import read_rpc_file  # noqa: E402
from repm_qgis.simulation.parameters import RpcFitParameters  # noqa: E402
from repm_qgis.simulation.rpc_fit import fit_rpc  # noqa: E402
from repm_qgis.simulation.sensor import GF7, ZY3, Look, Sensor, aim  # noqa: E402

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))

# DESIGN.md, section 4: uncorrected and polynomial RMSE and maximum, px, of the first scene of each site.
DESIGN = {
    "giza": (22.5, 64.4, 1.23, 4.66),
    "toulouse": (19.0, 52.0, 1.13, 4.05),
    "calanques": (5.50, 20.5, 4.37, 13.0),
    "ubaye": (8.86, 25.7, 6.37, 19.4),
    "ossoue": (14.0, 48.0, 13.9, 44.2),
}

# The paper's Table "Equivalent errors of different scale images": Samp RMSE, Line RMSE, RMSE, Max.
PAPER = {
    ("ZY3", "full"): ((2.457, 2.462, 3.479, 15.402), (2.505, 2.483, 3.528, 16.855), (1.912, 1.897, 2.693, 8.156)),
    ("ZY3", "10000"): ((1.302, 1.314, 1.849, 7.622), (1.315, 1.303, 1.851, 7.738), (1.166, 1.166, 1.649, 4.871)),
    ("ZY3", "5120"): ((0.616, 0.617, 0.872, 3.112), (0.617, 0.619, 0.874, 3.271), (0.597, 0.596, 0.844, 2.450)),
    ("GF7", "full"): ((1.545, 1.328, 2.038, 8.959), (1.526, 1.365, 2.047, 9.104), (1.346, 1.206, 1.807, 5.339)),
    ("GF7", "10000"): ((0.342, 0.341, 0.483, 1.609), (0.342, 0.341, 0.483, 1.617), (0.338, 0.338, 0.478, 1.385)),
    ("GF7", "5120"): ((0.173, 0.174, 0.246, 0.721), (0.174, 0.174, 0.246, 0.725), (0.173, 0.173, 0.245, 0.689)),
}


def real_rpcs() -> Iterator[Tuple[str, Rpc]]:
    for path in sorted((SHARED / "rpc" / "pleiades").glob("*.XML")):
        yield path.name.split("__")[0] + path.name[-8:-4], read_rpc_file(str(path))


def window_of(rpc: Rpc) -> Tuple[float, float, float, float]:
    """From the first pixel to the last one that the RPC was made for."""
    return 0.0, 0.0, rpc.col_off + rpc.col_scale + 1, rpc.row_off + rpc.row_scale + 1


def rough_surface(rpc: Rpc, altitudes: Tuple[float, float], seed: int) -> Surface:
    """Fractal ground over a whole scene that uses all of the altitude range."""
    rng = np.random.default_rng(seed)
    size = 257
    heights = np.zeros((size, size))
    for octave in range(1, 6):
        nodes = 2**octave + 1
        heights += upsample_grid(rng.normal(size=(nodes, nodes)) / 2**octave, (size, size))
    heights = (heights - heights.min()) / np.ptp(heights) * (altitudes[1] - altitudes[0]) + altitudes[0]
    lon, lat = 1.2 * abs(rpc.lon_scale), 1.2 * abs(rpc.lat_scale)
    return Surface(rpc.lon_off - lon, rpc.lat_off + lat, 2 * lon / (size - 1), 2 * lat / (size - 1), heights)


def terrain_error(rpc: Rpc, frame: EnuFrame, window: Any, altitudes: Tuple[float, float], seed: int) -> EquivalentError:
    """The terrain model's error where its surface is wrong by up to 10 m, drawn anew at every point."""
    grid = virtual_grid(rpc.localise, window, altitudes, frame)
    surface = rough_surface(rpc, altitudes, seed)
    refined = refine_pinhole("terrain", fit_pinhole(grid).camera, grid, window, terrain=Terrain(rpc, frame, surface))
    rng = np.random.default_rng(seed)
    pixels = np.column_stack(
        [
            rng.uniform(window[0], window[0] + window[2] - 1, 7000),
            rng.uniform(window[1], window[1] + window[3] - 1, 7000),
        ]
    )
    wrong = rng.uniform(-10.0, 10.0, len(pixels))
    height = np.full(len(pixels), sum(altitudes) / 2)
    for _ in range(40):
        ground = rpc.localise(pixels, height)
        height = surface.height(ground[:, 0], ground[:, 1]) + wrong
    truth = VirtualGrid(rpc.project(ground), ground, frame.from_geodetic(ground))
    difference = refined.to_original.original_from_refined(refined.camera.project(truth.enu)) - truth.pixels
    return EquivalentError.of(difference, 0.0)


def full_scenes() -> List[str]:
    """Points 1 and 2: every Pleiades scene, whole and its middle 5120 px, by each refinement."""
    rows, compared, worst = [], [], {"full": [0.0, 0.0], "tile": [0.0, 0.0]}
    seen = set()
    for seed, (name, rpc) in enumerate(real_rpcs()):
        frame, altitudes = EnuFrame(rpc.lon_off, rpc.lat_off), rpc.height_range
        window = window_of(rpc)
        start = time.process_time()
        grid = virtual_grid(rpc.localise, window, altitudes, frame)
        fitted = fit_pinhole(grid)
        seconds = time.process_time() - start
        errors = {
            model: refine_pinhole(model, fitted.camera, grid, window).error for model in ("homography", "polynomial")
        }
        full = terrain_error(rpc, frame, window, altitudes, seed)
        tile = terrain_error(rpc, frame, (rpc.col_off - 2560, rpc.row_off - 2560, 5120.0, 5120.0), altitudes, seed)
        worst["full"] = [max(worst["full"][0], full.rmse), max(worst["full"][1], full.max)]
        worst["tile"] = [max(worst["tile"][0], tile.rmse), max(worst["tile"][1], tile.max)]
        rows.append(
            [
                name,
                f"{altitudes[0]:.0f}..{altitudes[1]:.0f}",
                *(
                    f"{e.rmse:.3g} / {e.max:.3g}"
                    for e in (fitted.error, errors["homography"], errors["polynomial"], full, tile)
                ),
                seconds,
            ]
        )
        site = name[:-4]
        if site in DESIGN and site not in seen:
            seen.add(site)
            ours = (fitted.error.rmse, fitted.error.max, errors["polynomial"].rmse, errors["polynomial"].max)
            compared.append([site, *(f"{a:.3g} ({100 * (a / b - 1):+.1f} %)" for a, b in zip(ours, DESIGN[site]))])
    if not rows:
        return [f"Real RPCs: not measured, '{SHARED}' is absent."]
    return [
        "RMSE / maximum of the equivalent error in px over full scenes and the RPC's own altitude range (25 x 25 px "
        "x 11 altitudes); terrain: 7000 random points, surface wrong by up to 10 m, fractal ground all over.",
        table(
            [
                "scene",
                "altitudes, m",
                "uncorrected",
                "homography",
                "polynomial",
                "terrain",
                "terrain, middle 5120 px",
                "fit, CPU s",
            ],
            rows,
        ),
        f"Terrain, worst of {len(rows)} scenes: full {worst['full'][0]:.3f} / {worst['full'][1]:.3f} px (bars 0.16 / "
        f"0.40), 5120 px tiles {worst['tile'][0]:.4f} / {worst['tile'][1]:.4f} px (bar 0.015 RMSE).",
        "Against DESIGN.md's table (bar: 3 %):",
        table(["first scene of", "uncorrected RMSE", "max", "polynomial RMSE", "max"], compared),
    ]


def simulated(sensor: Sensor, look: Look, size: Tuple[int, int], altitudes: Tuple[float, float]) -> Rpc:
    """The RPC of a simulated full scene."""
    view = aim(sensor, look, (6.6, 43.4, sum(altitudes) / 2), size, 190.0, 7, "view")
    return fit_rpc(view.localise, size, altitudes, RpcFitParameters(nodes=(21, 21, 9))).rpc


def paper_table() -> List[str]:
    """Point 3: the paper's table on simulated sensors."""
    rows = []
    cases = (
        ("ZY3", ZY3, ZY3.looks[0], (24576, 24576), (0.0, 1200.0)),
        ("GF7", GF7, GF7.looks[0], (35864, 40000), (20.0, 320.0)),
    )
    for name, sensor, look, size, altitudes in cases:
        rpc = simulated(sensor, look, size, altitudes)
        frame = EnuFrame(rpc.lon_off, rpc.lat_off)
        for label, side in (("full", None), ("10000", 10000), ("5120", 5120)):
            width, height = size if side is None else (side, side)
            window = ((size[0] - width) / 2, (size[1] - height) / 2, float(width), float(height))
            grid = virtual_grid(rpc.localise, window, altitudes, frame)
            fitted = fit_pinhole(grid)
            results = [fitted.error] + [
                refine_pinhole(model, fitted.camera, grid, window).error for model in ("homography", "polynomial")
            ]
            for model, ours, theirs in zip(("uncorrected", "homography", "polynomial"), results, PAPER[name, label]):
                rows.append([name, label, model, ours.samp_rmse, ours.line_rmse, ours.rmse, ours.max, *theirs])
    return [
        "The paper's table on simulated sensors (forward views; ZY-3 24576 px over 1200 m of relief, GF-7 35864 x "
        "40000 px over 300 m): ours, then the paper's printed figures, px.",
        table(
            [
                "sensor",
                "size",
                "model",
                "Samp RMSE",
                "Line RMSE",
                "RMSE",
                "Max",
                "paper Samp",
                "paper Line",
                "paper RMSE",
                "paper Max",
            ],
            rows,
        ),
    ]


def gdal_difference(rpc: Rpc, count: int = 2000) -> float:
    """Largest difference from GDAL's RPC transformer, px; GDAL's pixels begin at the first pixel's corner."""
    from repm_qgis.simulation.scene import rpc_tags

    dataset = gdal.GetDriverByName("MEM").Create("", 10, 10)
    dataset.SetMetadata(rpc_tags(rpc), "RPC")
    transformer = gdal.Transformer(dataset, None, ["METHOD=RPC"])
    rng = np.random.default_rng(1)
    pixels = rng.uniform((0, 0), (2 * rpc.col_off, 2 * rpc.row_off), (count, 2))
    ground = rpc.localise(pixels, rng.uniform(*rpc.height_range, count))
    theirs, _ = transformer.TransformPoints(1, [tuple(point) for point in ground])
    return float(np.abs(np.array(theirs)[:, :2] - 0.5 - rpc.project(ground)).max())


def accuracies() -> List[str]:
    """Point 4: GDAL, and the round trips."""
    worst = {
        "projection against GDAL's transformer": 0.0,
        "localisation round trip": 0.0,
        "M round trip, polynomial": 0.0,
        "M round trip, terrain": 0.0,
    }
    rpcs = [rpc for _, rpc in real_rpcs()] or [simulated(ZY3, ZY3.looks[0], (20000, 20000), (0.0, 1000.0))]
    rng = np.random.default_rng(2)
    for seed, rpc in enumerate(rpcs):
        frame, altitudes, window = EnuFrame(rpc.lon_off, rpc.lat_off), rpc.height_range, window_of(rpc)
        worst["projection against GDAL's transformer"] = max(
            worst["projection against GDAL's transformer"], gdal_difference(rpc)
        )
        pixels = rng.uniform((0, 0), window[2:], (5000, 2))
        back = rpc.project(rpc.localise(pixels, rng.uniform(*altitudes, len(pixels))))
        worst["localisation round trip"] = max(worst["localisation round trip"], float(np.abs(back - pixels).max()))
        grid = virtual_grid(rpc.localise, window, altitudes, frame)
        camera = fit_pinhole(grid).camera
        terrain = Terrain(rpc, frame, rough_surface(rpc, altitudes, seed))
        for model in ("polynomial", "terrain"):
            M = refine_pinhole(model, camera, grid, window, terrain=terrain).to_original
            error = np.abs(M.original_from_refined(M.refined_from_original(pixels)) - pixels).max()
            worst[f"M round trip, {model}"] = max(worst[f"M round trip, {model}"], float(error))
    worst["COLMAP export, projected by pycolmap"] = colmap_difference()
    bars = (1e-6, 1e-6, 1e-3, 1e-3, 1e-3)
    return [
        f"Agreement and round trips, worst over {len(rpcs)} RPCs, px:",
        table(["what", "px", "bar"], [[k, f"{v:.1e}", f"{bar:g}"] for (k, v), bar in zip(worst.items(), bars)]),
    ]


def other_rpcs() -> List[str]:
    """Point 1's rest: every other RPC file of the folder fits; windows are what the RPC was made for."""
    rows = []
    for path in sorted((SHARED / "rpc" / "other").glob("*")):
        rpc = read_rpc_file(str(path))
        frame = EnuFrame(rpc.lon_off, rpc.lat_off)
        window = (rpc.col_off - rpc.col_scale, rpc.row_off - rpc.row_scale, 2 * rpc.col_scale, 2 * rpc.row_scale)
        grid = virtual_grid(rpc.localise, window, rpc.height_range, frame)
        fitted = fit_pinhole(grid)
        left = refine_pinhole("polynomial", fitted.camera, grid, window).error
        rows.append(
            [
                path.name,
                f"{window[2]:.0f} x {window[3]:.0f}",
                "{:.0f}..{:.0f}".format(*rpc.height_range),
                fitted.error.rmse,
                left.rmse,
            ]
        )
    return (
        [
            "The other sensors' files, over their RPC's own domain:",
            table(["file", "px", "altitudes, m", "uncorrected RMSE, px", "polynomial RMSE, px"], rows),
        ]
        if rows
        else []
    )


def colmap_difference() -> float:
    """Largest difference, px, between pycolmap's projection of an exported model and the refined camera's."""
    import pycolmap

    from repm_qgis.progress import Silent
    from repm_qgis.scene import Scene
    from repm_qgis.stages import run_stage

    with tempfile.TemporaryDirectory() as folder:
        town = run_stage("sampledata", {"folder": folder, "size": 400}, Silent())
        fitted = run_stage("epmfit", {"images": town["images"], "workspace": folder}, Silent())
        refined = run_stage("refine", {"scene": fitted["scene"], "output_scene": f"{folder}/refined.json"}, Silent())
        made = run_stage(
            "exportcameras",
            {"scene": refined["output_scene"], "folder": f"{folder}/export", "format": "colmap", "centre": False},
            Silent(),
        )
        scene = Scene.load(refined["output_scene"])
        model = pycolmap.Reconstruction(f"{made['models'][0]}/sparse/0")
        tile = scene.tiles[0]
        low, high = scene.altitudes
        ground = np.random.default_rng(3).uniform((-80, -80, low), (80, 80, high), (500, 3))
        worst = 0.0
        for image in model.images.values():
            view = next(view for name, view in tile.views.items() if image.name.startswith(name))
            theirs = np.array([image.project_point(point) for point in ground])
            # COLMAP's pixels begin at the first pixel's corner.
            worst = max(worst, float(np.abs(theirs - 0.5 - view.refined.camera.project(ground)).max()))
    return worst


def fuzzing() -> List[str]:
    """Point 6: broken files."""
    from tests.engine.rpc.fuzz import fuzz

    found = fuzz(20000, 1).table().strip()
    return ["Broken and hostile RPC files (`python -m tests.engine.rpc.fuzz`):", f"```\n{found}\n```"]


def in_process(code: str) -> Dict[str, float]:
    """Run a measurement in a process of its own; it prints seconds and we add its peak memory."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    seconds, memory = (float(word) for word in done.stdout.split()[-2:])
    return {"seconds": seconds, "MiB": memory}


_MEMORY = "import resource; print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
_FULL = """
import time, numpy as np
from benchmarks.epm import simulated
from repm_qgis.simulation.sensor import GF7
rpc = simulated(GF7, GF7.looks[1], (40000, 40000), (0.0, 1500.0))
"""


def costs() -> List[str]:
    """Point 5: what it costs."""
    with tempfile.TemporaryDirectory() as folder:
        image = f"{folder}/full.tif"
        rows = [
            [
                "fit of one 40000 x 40000 view at all altitudes",
                "CPU s",
                in_process(
                    _FULL
                    + """
from repm_qgis.geometry.equivalent_error import fit_pinhole, virtual_grid
from repm_qgis.geometry.frames import EnuFrame
t = time.process_time()
fit_pinhole(virtual_grid(rpc.localise, (0, 0, 40000, 40000), rpc.height_range, EnuFrame(rpc.lon_off, rpc.lat_off)))
print(time.process_time() - t)
"""
                    + _MEMORY
                ),
                "< 1",
            ],
            [
                "1e7 points projected, one core",
                "CPU s",
                in_process(
                    _FULL
                    + """
ground = np.tile(rpc.localise(np.random.default_rng(0).uniform(0, 40000, (1000, 2)), 100.0), (10000, 1))
t = time.process_time()
rpc.project(ground)
print(time.process_time() - t)
"""
                    + _MEMORY
                ),
                "< 3",
            ],
            [
                "error map of a full 40000 x 40000 scene",
                "s",
                in_process(
                    _FULL
                    + f"""
from osgeo import gdal
from repm_qgis.simulation.scene import rpc_tags
from repm_qgis.stages import run_stage
from repm_qgis.progress import Silent
other = simulated(GF7, GF7.looks[0], (40000, 40000), (0.0, 1500.0))
for name, model in (("a", rpc), ("b", other)):
    image = gdal.GetDriverByName("GTiff").Create("{folder}/" + name + ".tif", 40000, 40000, 1, gdal.GDT_UInt16,
                                                 ["SPARSE_OK=TRUE", "TILED=YES"])
    image.SetMetadata(rpc_tags(model), "RPC")
    image = None
made = run_stage("epmfit", {{"images": ["{folder}/a.tif", "{folder}/b.tif"], "workspace": "{folder}/w",
                            "altitude_min": 0.0, "altitude_max": 1500.0, "tile_size": 10000}}, Silent())
t = time.perf_counter()
run_stage("errormap", {{"scene": made["scene"], "output": "{folder}/error.tif"}}, Silent())
print(time.perf_counter() - t)
"""
                    + _MEMORY
                ),
                "< 10",
            ],
        ]
        warp = in_process(
            f"""
import time, numpy as np
from osgeo import gdal
gdal.SetCacheMax(64 << 20)
from repm_qgis.geometry.refinement import PolynomialMap
from repm_qgis.imagery.raster import opened
from repm_qgis.imagery.warping import warp_strips
image = gdal.GetDriverByName("GTiff").Create("{image}", 10000, 10000, 1, gdal.GDT_UInt16, ["TILED=YES"])
rng = np.random.default_rng(0)
for row in range(0, 10000, 1000):
    image.GetRasterBand(1).WriteArray(rng.integers(200, 2000, (1000, 10000), dtype=np.uint16), 0, row)
image = None
M = PolynomialMap(2, np.array([5000.0, 5000.0]), 5000.0, np.array([[3, 2], [5, 1], [1, 4], [2, 2], [3, 1], [1, 2.0]]))
t = time.perf_counter()
with opened("{image}") as dataset:
    pixels = sum(strip.size for _, strip in warp_strips(dataset, 1, M.original_from_refined, (10000, 10000)))
print((time.perf_counter() - t) / pixels * 60e6)
"""
            + _MEMORY
        )
    rows.append(
        [
            f"refining 10000 x 10000 px, bilinear: {60 / warp['seconds']:.0f} Mpx/s",
            "s for 60 Mpx",
            warp,
            "< 1 (60 Mpx/s)",
        ]
    )
    return [
        "Cost (memory is the peak of the process):",
        table(
            ["what", "unit", "measured", "bar", "peak MiB (bar 500)"],
            [[what, unit, run["seconds"], bar, run["MiB"]] for what, unit, run, bar in rows],
        ),
    ]


def main() -> None:
    parts = full_scenes() + other_rpcs() + paper_table() + accuracies() + costs() + fuzzing()
    publish("epm", "The equivalent pinhole model", "make bench-epm", parts)
    print(f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB", file=sys.stderr)


if __name__ == "__main__":
    main()
