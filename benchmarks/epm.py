"""The equivalent pinhole model measured: fit, refinement, terrain, agreement with GDAL, cost."""

from __future__ import annotations

import tempfile
import time
from typing import Any, Dict, Iterator, List, Tuple

import numpy as np
from osgeo import gdal

from benchmarks.runner import alone, few, is_quick, stage, there
from benchmarks.scenes import SHARED
from benchmarks.tables import Details, Section, table
from repm_qgis.contracts.stages import EPMFIT, ERRORMAP, EXPORTCAMERAS, REFINE, SAMPLEDATA
from repm_qgis.geometry.equivalent_error import (
    EquivalentError,
    VirtualGrid,
    fit_pinhole,
    refine_pinhole,
    virtual_grid,
)
from repm_qgis.geometry.frames import EnuFrame
from repm_qgis.geometry.interpolation import upsample_grid
from repm_qgis.geometry.refinement import PolynomialMap, Terrain
from repm_qgis.geometry.surface import Surface
from repm_qgis.imagery.raster import write
from repm_qgis.rpc import Rpc
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.rpc.parameters import RpcFitParameters
from repm_qgis.rpc.readers import read_rpc_file
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import Scene
from repm_qgis.simulation.sensor import GF7, ZY3, Look, Sensor, aim

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


def real_rpcs() -> List[Tuple[str, Rpc]]:
    paths = sorted((SHARED / "rpc" / "pleiades").glob("*.XML"))
    return [(path.name.split("__")[0] + path.name[-8:-4], read_rpc_file(str(path))) for path in few(paths)]


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
    refined = refine_pinhole(
        "terrain", fit_pinhole(grid).camera, grid, window=window, terrain=Terrain(rpc, frame, surface)
    )
    rng = np.random.default_rng(seed)
    places = [rng.uniform(window[i], window[i] + window[i + 2] - 1, 7000) for i in (0, 1)]
    pixels = np.column_stack(places)
    wrong = rng.uniform(-10.0, 10.0, len(pixels))
    height = np.full(len(pixels), sum(altitudes) / 2)
    for _ in range(40):
        ground = rpc.localise(pixels, height)
        height = surface.height(ground[:, 0], ground[:, 1]) + wrong
    truth = VirtualGrid(rpc.project(ground), ground, frame.from_geodetic(ground))
    difference = refined.to_original.original_from_refined(refined.camera.project(truth.enu)) - truth.pixels
    return EquivalentError.of(difference, 0.0)


def full_scenes() -> List[str]:
    """Every Pleiades scene, whole and its middle 5120 px, by each refinement."""
    rows, compared, terrain = [], {}, []
    for seed, (name, rpc) in enumerate(real_rpcs()):
        frame, altitudes = EnuFrame(rpc.lon_off, rpc.lat_off), rpc.height_range
        window = window_of(rpc)
        start = time.process_time()
        grid = virtual_grid(rpc.localise, window, altitudes, frame)
        fitted = fit_pinhole(grid)
        seconds = time.process_time() - start
        homography, polynomial = (
            refine_pinhole(model, fitted.camera, grid, window=window).error for model in ("homography", "polynomial")
        )
        middle = (rpc.col_off - 2560, rpc.row_off - 2560, 5120.0, 5120.0)
        terrain.append([terrain_error(rpc, frame, part, altitudes, seed) for part in (window, middle)])
        errors = (fitted.error, homography, polynomial, *terrain[-1])
        cells = (f"{e.rmse:.3g} / {e.max:.3g}" for e in errors)
        rows.append([name, f"{altitudes[0]:.0f}..{altitudes[1]:.0f}", *cells, seconds])
        ours = (fitted.error.rmse, fitted.error.max, polynomial.rmse, polynomial.max)
        design = DESIGN.get(name[:-4], ())
        if design and name[:-4] not in compared:
            compared[name[:-4]] = [f"{a:.3g} ({100 * (a / b - 1):+.1f} %)" for a, b in zip(ours, design)]
    if not rows:
        return [f"Real RPCs: not measured, '{SHARED}' is absent."]
    (full, full_most), (tile, tile_most) = (
        (max(errors[i].rmse for errors in terrain), max(errors[i].max for errors in terrain)) for i in (0, 1)
    )
    headers = (
        "scene | altitudes, m | uncorrected | homography | polynomial | terrain | terrain, middle 5120 px | fit, CPU s"
    )
    return [
        Details(
            "RMSE / maximum of the equivalent error in px over full scenes and the RPC's own altitude range (25 x 25 "
            "px x 11 altitudes); terrain: 7000 random points, surface wrong by up to 10 m, fractal ground all over."
        ),
        Details(table(headers, rows)),
        f"RMSE / maximum of the equivalent error. Terrain, worst of {len(rows)} scenes: full {full:.3f} / "
        f"{full_most:.3f} px (bars 0.16 / 0.40), 5120 px tiles {tile:.4f} / {tile_most:.4f} px (bar 0.015 RMSE).",
        "Against DESIGN.md's table (bar: 3 %):",
        table(
            "first scene of | uncorrected RMSE | max | polynomial RMSE | max",
            [[site, *cells] for site, cells in compared.items()],
        ),
    ]


def other_rpcs() -> List[str]:
    """Every other RPC file of the folder fits; windows are what the RPC was made for."""
    rows = []
    for path in few(sorted((SHARED / "rpc" / "other").glob("*"))):
        rpc = read_rpc_file(str(path))
        frame = EnuFrame(rpc.lon_off, rpc.lat_off)
        window = (rpc.col_off - rpc.col_scale, rpc.row_off - rpc.row_scale, 2 * rpc.col_scale, 2 * rpc.row_scale)
        grid = virtual_grid(rpc.localise, window, rpc.height_range, frame)
        fitted = fit_pinhole(grid)
        left = refine_pinhole("polynomial", fitted.camera, grid, window=window).error
        altitudes = "{:.0f}..{:.0f}".format(*rpc.height_range)
        rows.append([path.name, f"{window[2]:.0f} x {window[3]:.0f}", altitudes, fitted.error.rmse, left.rmse])
    headers = "file | px | altitudes, m | uncorrected RMSE, px | polynomial RMSE, px"
    texts = ["The other sensors' files, over their RPC's own domain:", table(headers, rows)]
    return [Details(text) for text in texts] if rows else []


def simulated(sensor: Sensor, look: Look, size: Tuple[int, int], altitudes: Tuple[float, float]) -> Rpc:
    """The RPC of a simulated full scene."""
    view = aim(sensor, look, (6.6, 43.4, sum(altitudes) / 2), size=size, heading_deg=190.0, seed=7, name="view")
    return fit_rpc(view.localise, size, altitudes, RpcFitParameters(nodes=(21, 21, 9))).rpc


def paper_table() -> List[str]:
    """The paper's table on simulated sensors."""
    rows = []
    cases = (("ZY3", ZY3, (24576, 24576), (0.0, 1200.0)), ("GF7", GF7, (35864, 40000), (20.0, 320.0)))
    for name, sensor, size, altitudes in few(cases):
        rpc = simulated(sensor, sensor.looks[0], size, altitudes)
        frame = EnuFrame(rpc.lon_off, rpc.lat_off)
        for label, side in (("full", None), ("10000", 10000), ("5120", 5120)):
            width, height = size if side is None else (side, side)
            window = ((size[0] - width) / 2, (size[1] - height) / 2, float(width), float(height))
            grid = virtual_grid(rpc.localise, window, altitudes, frame)
            fitted = fit_pinhole(grid)
            results = {"uncorrected": fitted.error}
            for model in ("homography", "polynomial"):
                results[model] = refine_pinhole(model, fitted.camera, grid, window=window).error
            for (model, ours), theirs in zip(results.items(), PAPER[name, label]):
                rows.append([name, label, model, ours.samp_rmse, ours.line_rmse, ours.rmse, ours.max, *theirs])
    headers = (
        "sensor | size | model | Samp RMSE | Line RMSE | RMSE | Max | paper Samp | paper Line | paper RMSE | paper Max"
    )
    return [
        "The paper's table on simulated sensors (forward views; ZY-3 24576 px over 1200 m of relief, GF-7 35864 x "
        "40000 px over 300 m): ours, then the paper's printed figures, px.",
        table(headers, rows),
    ]


def gdal_difference(rpc: Rpc, count: int = 2000) -> float:
    """Largest difference from GDAL's RPC transformer, px; GDAL's pixels begin at the first pixel's corner."""
    dataset = gdal.GetDriverByName("MEM").Create("", 10, 10)
    dataset.SetMetadata(rpc_tags(rpc), "RPC")
    transformer = gdal.Transformer(dataset, None, ["METHOD=RPC"])
    rng = np.random.default_rng(1)
    pixels = rng.uniform((0, 0), (2 * rpc.col_off, 2 * rpc.row_off), (count, 2))
    ground = rpc.localise(pixels, rng.uniform(*rpc.height_range, count))
    theirs, _ = transformer.TransformPoints(1, [tuple(point) for point in ground])
    return float(np.abs(np.array(theirs)[:, :2] - 0.5 - rpc.project(ground)).max())


def differences(rpc: Rpc, seed: int, rng: np.random.Generator) -> Iterator[Tuple[str, float, float]]:
    """What is compared, the largest difference, px, and its bar."""
    yield "projection against GDAL's transformer", gdal_difference(rpc), 1e-6
    frame, altitudes, window = EnuFrame(rpc.lon_off, rpc.lat_off), rpc.height_range, window_of(rpc)
    pixels = rng.uniform((0, 0), window[2:], (5000, 2))
    back = rpc.project(rpc.localise(pixels, rng.uniform(*altitudes, len(pixels))))
    yield "localisation round trip", float(np.abs(back - pixels).max()), 1e-6
    grid = virtual_grid(rpc.localise, window, altitudes, frame)
    camera = fit_pinhole(grid).camera
    terrain = Terrain(rpc, frame, rough_surface(rpc, altitudes, seed))
    for model in ("polynomial", "terrain"):
        M = refine_pinhole(model, camera, grid, window=window, terrain=terrain).to_original
        error = np.abs(M.original_from_refined(M.refined_from_original(pixels)) - pixels).max()
        yield f"M round trip, {model}", float(error), 1e-3


def accuracies() -> List[str]:
    """GDAL, and the round trips."""
    rpcs = [rpc for _, rpc in real_rpcs()] or [simulated(ZY3, ZY3.looks[0], (20000, 20000), (0.0, 1000.0))]
    rng = np.random.default_rng(2)
    worst: Dict[str, Tuple[float, float]] = {}
    for seed, rpc in enumerate(rpcs):
        for name, px, bar in differences(rpc, seed, rng):
            worst[name] = max(px, worst.get(name, (0.0, 0.0))[0]), bar
    worst["COLMAP export, projected by pycolmap"] = colmap_difference(), 1e-3
    return [
        f"Agreement and round trips, worst over {len(rpcs)} RPCs, px:",
        table("what | px | bar", [[name, f"{px:.1e}", f"{bar:g}"] for name, (px, bar) in worst.items()]),
    ]


def colmap_difference() -> float:
    """Largest difference, px, between pycolmap's projection of an exported model and the refined camera's."""
    import pycolmap

    with tempfile.TemporaryDirectory() as folder:
        town = stage(SAMPLEDATA, folder=folder, size=400)
        fitted = stage(EPMFIT, images=town.images, workspace=folder)
        refined = stage(REFINE, scene=fitted.scene, output_scene=f"{folder}/refined.json").output_scene
        made = stage(EXPORTCAMERAS, scene=refined, folder=f"{folder}/export", format="colmap", centre=False)
        scene = Scene.load(refined)
        model = pycolmap.Reconstruction(f"{made.models[0]}/sparse/0")
        tile = scene.tiles[0]
        low, high = scene.altitudes
        ground = np.random.default_rng(3).uniform((-80, -80, low), (80, 80, high), (500, 3))
        worst = 0.0
        for image in model.images.values():
            view = next(view for name, view in tile.views.items() if image.name.startswith(name))
            theirs = np.array([image.project_point(point) for point in ground])
            # COLMAP's pixels begin at the first pixel's corner.
            worst = max(worst, float(np.abs(theirs - 0.5 - there(view.refined).camera.project(ground)).max()))
    return worst


# Cost: each of these is run by a process of its own, and returns seconds. What only one of them needs is imported in
# it, as the memory of imports counts too.


def full_rpc(look: int = 1) -> Rpc:
    return simulated(GF7, GF7.looks[look], (40000, 40000), (0.0, 1500.0))


def fit_seconds() -> float:
    rpc = full_rpc()
    frame = EnuFrame(rpc.lon_off, rpc.lat_off)
    start = time.process_time()
    fit_pinhole(virtual_grid(rpc.localise, (0, 0, 40000, 40000), rpc.height_range, frame))
    return time.process_time() - start


def project_seconds() -> float:
    rpc = full_rpc()
    ground = np.tile(rpc.localise(np.random.default_rng(0).uniform(0, 40000, (1000, 2)), 100.0), (10000, 1))
    start = time.process_time()
    rpc.project(ground)
    return time.process_time() - start


def full_image(look: int, folder: str) -> str:
    """A full scene's image with content everywhere: a small one of noise, enlarged by a VRT."""
    small, path = f"{folder}/{look}_small.tif", f"{folder}/{look}.vrt"
    write(small, [np.random.default_rng(look).integers(200, 2000, (400, 400)).astype(np.uint16)], None, "")
    image = gdal.Translate(path, small, format="VRT", width=40000, height=40000)
    image.SetMetadata(rpc_tags(full_rpc(look)), "RPC")
    image = None  # noqa: F841 - it is written now
    return path


def error_map_seconds() -> float:
    with tempfile.TemporaryDirectory() as folder:
        images = [full_image(look, folder) for look in (1, 0)]
        area: Dict[str, object] = {"altitude_min": 0.0, "altitude_max": 1500.0, "tile_size": 10000}
        made = stage(EPMFIT, images=images, workspace=f"{folder}/w", **area)
        start = time.perf_counter()
        stage(ERRORMAP, scene=made.scene, output=f"{folder}/error.tif")
        return time.perf_counter() - start


def warp_seconds() -> float:
    """Seconds for 60 Mpx."""
    from repm_qgis.imagery.raster import opened
    from repm_qgis.imagery.warping import warp_strips

    gdal.SetCacheMax(64 << 20)
    side = 10000
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/full.tif"
        image = gdal.GetDriverByName("GTiff").Create(path, side, side, 1, gdal.GDT_UInt16, ["TILED=YES"])
        rng = np.random.default_rng(0)
        for row in range(0, side, 1000):
            image.GetRasterBand(1).WriteArray(rng.integers(200, 2000, (1000, side), dtype=np.uint16), 0, row)
        image = None
        terms = np.array([[3, 2], [5, 1], [1, 4], [2, 2], [3, 1], [1, 2.0]])
        M = PolynomialMap(2, np.array([5000.0, 5000.0]), 5000.0, terms)
        start = time.perf_counter()
        with opened(path) as dataset:
            pixels = sum(strip.size for _, strip in warp_strips(dataset, 1, M.original_from_refined, (side, side)))
        return (time.perf_counter() - start) / pixels * 60e6


def costs() -> List[str]:
    rows = []
    for what, unit, function, bar in (
        ("fit of one 40000 x 40000 view at all altitudes", "CPU s", fit_seconds, "< 1"),
        ("1e7 points projected, one core", "CPU s", project_seconds, "< 3"),
        ("error map of a full 40000 x 40000 scene", "s", error_map_seconds, "< 10"),
        ("refining 10000 x 10000 px, bilinear", "s for 60 Mpx", warp_seconds, "< 1 (60 Mpx/s)"),
    ):
        used = alone(function)
        speed = f": {60 / used.result:.0f} Mpx/s" if function is warp_seconds else ""
        rows.append([what + speed, unit, used.result, bar, used.mib])
    return [
        "Cost (memory is the peak of the process):",
        table("what | unit | measured | bar | peak MiB (bar 500)", rows),
    ]


def fuzzing() -> List[str]:
    from tests.engine.rpc.fuzz import fuzz

    found = fuzz(300 if is_quick() else 20000, 1).table().strip()
    title = "Broken and hostile RPC files (`python -m tests.engine.rpc.fuzz`):"
    return [Details(title), Details(f"```\n{found}\n```")]


PARTS = {
    "scenes": full_scenes,
    "others": other_rpcs,
    "paper": paper_table,
    "accuracy": accuracies,
    "cost": costs,
    "fuzz": fuzzing,
}
SECTIONS = [Section("epm", "The equivalent pinhole model", "make bench-epm", PARTS)]
