"""Large scenes: a ZY-3 tri-stereo of 3 x 5120 x 5120 px over 1500 m of relief, and cost from 4 to 100 Mpx.

It takes an hour, with the first simulation.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from benchmarks.matching import MatchedPair, changed
from benchmarks.programs import QGIS, repm
from benchmarks.runner import CORES, Cost, alone, few, is_quick, measured, pipeline, say, stage, there
from benchmarks.scenes import CACHE, Scene, made_once, quick_size, simulated, zy3
from benchmarks.scoring import bounds_of, heights_of, nmad, scores, shares
from benchmarks.tables import Section, table
from repm_qgis.contracts.documents import JsonObject
from repm_qgis.contracts.stages import DSMFUSE, EPMFIT, REFINE
from repm_qgis.imagery.raster import RasterFrame, created
from repm_qgis.imagery.warping import sample_array
from repm_qgis.matching.pair_backend import match_to_disk
from repm_qgis.rpc import Rpc
from repm_qgis.rpc.fit import fit_rpc
from repm_qgis.rpc.writers import rpc_tags
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.simulation.scene import SceneSpec, make_views
from repm_qgis.simulation.sensor import PLEIADES
from repm_qgis.stereo.pairing import rectified_pair
from repm_qgis.stereo.triangulation import pair_geometry

SIDES = (2000, 4000, 7000, 10000)
TILE = 4200
GSD = 2.5  # of the forward and backward view, m
MODELS = ("none", "polynomial", "terrain")
_STRIP = 500
_SMALL_MPX, _REPEATS = 20, 3  # small scenes take seconds, of which chance takes a tenth

LOAD = (
    "Load: the machine's average over the last minute as the run ended, our own share being as many as there are "
    "cores; what is above that, others used, and wall times are upper bounds."
)


def load() -> float:
    return round(os.getloadavg()[0], 1)


def relief() -> Scene:
    return simulated("zy3_1500m", zy3(5120, 1500.0), 5.0)


def middle_of(path: str, side_px: int) -> JsonObject:
    """EXTENT and its CRS of a square of so many px around a raster's middle."""
    raster = gdal.Open(path)
    xmin, ymin, xmax, ymax = bounds_of(raster)
    x, y, half = (xmin + xmax) / 2, (ymin + ymax) / 2, 0.49 * side_px * GSD
    crs = pyproj.CRS.from_wkt(raster.GetProjection()).to_string()
    return {"extent": (x - half, y - half, x + half, y + half), "extent_crs": crs}


# The whole scene --------------------------------------------------------------------------------------------------


def whole() -> List[str]:
    """Accuracy and cost of the whole scene, with each refinement model and else default options."""
    scene = relief()
    rows: List[List[object]] = []
    for label, options in few(
        (
            ("none", {"MODEL": "none"}),
            ("polynomial (the default)", {}),
            ("terrain, no DEM given", {"MODEL": "terrain"}),
        )
    ):
        say(f"{scene.name}: {label} ...")
        with tempfile.TemporaryDirectory() as work:
            dsm, cost, _ = repm(scene.images, scene.resolution, Path(work), **options)
            found = scores(dsm, scene.reference, scene.align)
        errors = (found.valid, found.rmse, found.mae, found.medae, *shares(found)[1:])
        used = (round(cost.wall_s, 1), round(cost.cpu_s, 1), round(cost.peak_gib, 2), load())
        rows.append([label, *(round(value, 3) for value in errors), *used])
        say(rows[-1])
    return [
        "**ZY-3 tri-stereo**, 3 x 5120 x 5120 px (2.1 to 2.5 m) over 1500 m of relief, simulated, DSM of 5 m "
        f"against the true surface; through `scripts/qgis-headless` on {CORES} cores. "
        f"{LOAD} Bars: 180 s by the clock, 3 GiB. (The paper: 7.3 minutes on an A100.)",
        table(
            "refinement | valid % | RMSE m | MAE m | MedAE m | C2.5 % | C5 % | wall s | CPU s | peak GiB | load",
            rows,
        ),
    ]


# Refinement -------------------------------------------------------------------------------------------------------


def one_tile(images: Sequence[str], job: JsonObject, folder: str, corrected: bool) -> str:
    """The DSM of one tile; ``corrected``: without vertical parallax at the coarse level's altitude (the default)."""
    made = pipeline(images, folder, **job)
    if corrected:
        return made.output
    scene = SceneFile.load(made.scene)
    task = MatchedPair(scene, (0, 1)).task
    left = changed(prior={"remove_parallax": False})
    record = there(match_to_disk(replace(task, parameters=left, path=f"{folder}/left.tif")))
    path = scene.with_tiles(lambda tile: replace(tile, heights=(record,))).save(f"{folder}/left.json")
    return stage(DSMFUSE, scene=path, output=f"{folder}/left_dsm.tif", resolution=job["resolution"]).output


def models() -> List[str]:
    """One large tile of the scene by each model, with and without the vertical parallax corrected."""
    scene = relief()
    area = middle_of(scene.reference, quick_size(TILE, "ZY3"))
    images = [scene.images[0], scene.images[2]]
    job = {"resolution": 5.0, "tile_size": TILE, "workers": 1, **area}
    rows: List[List[object]] = []
    for corrected in few((False, True)):
        for model in few(MODELS):
            label = "corrected" if corrected else "left"
            say(f"one tile, {model}, vertical parallax {label} ...")
            with tempfile.TemporaryDirectory() as work:
                dsm = alone(one_tile, images, {**job, "model": model}, work, corrected).result
                xmin, ymin, xmax, ymax = area["extent"]
                gdal.Translate(f"{work}/truth.tif", scene.reference, projWin=(xmin, ymax, xmax, ymin))
                found = scores(dsm, f"{work}/truth.tif", True)
            errors = (found.valid, found.rmse, found.mae, *shares(found)[1:])
            rows.append([model, label, *(round(value, 3) for value in errors)])
            say(rows[-1])
    return [
        f"**What refinement gains**: one tile of {TILE} px in the middle of the same scene, forward and backward "
        "view. *left*: vertical parallax as the model leaves it, as in the paper; *corrected*: where the coarse level "
        "says which altitude the ground has, the RPCs say in which row it lies (the default), and the model matters no "
        "more.",
        table("refinement | vertical parallax | valid % | RMSE m | MAE m | C2.5 % | C5 %", rows),
    ]


def parallax() -> List[str]:
    """The vertical parallax that each model leaves on the true surface, before anything is matched, by tile size."""
    scene = relief()
    rows = []
    for side in few((800, 1300, TILE, 5000)):
        with tempfile.TemporaryDirectory() as work:
            images = [scene.images[0], scene.images[2]]
            area = middle_of(scene.reference, quick_size(side, "ZY3"))
            fitted = stage(EPMFIT, images=images, workspace=work, tile_size=side, **area).scene
            for model in few(MODELS):
                options: Dict[str, object] = {"model": model, "write_images": False}
                if model == "terrain":
                    options["dem"] = scene.reference
                refined = stage(REFINE, scene=fitted, output_scene=f"{work}/{model}.json", **options).output_scene
                off = parallax_on_ground(refined, scene.reference)
                rms, most = float(np.sqrt((off**2).mean())), float(np.abs(off).max())
                rows.append([side, model, round(rms, 3), round(most, 3)])
        say(rows[-3:])
    return [
        "**Vertical parallax before anything is matched**: one tile in the middle of the ZY-3 scene, forward and "
        "backward view; by how much the rectified pair's rows differ on the true surface, px of 2.5 m, the median "
        "taken out (relative pointing). The terrain model's surface is here the true one in cells of 48 px. What "
        "the models leave of the equivalent error is mostly the same in both views: little of it is vertical parallax.",
        table("tile, px | refinement | RMS px | Max px", rows),
    ]


def parallax_on_ground(path: str, reference: str) -> np.ndarray:
    """Row differences of the first tile's two views at the places that a surface has in the rectified frame."""
    scene = SceneFile.load(path)
    tile = scene.tiles[0]
    first, second = scene.views
    pair = there(rectified_pair(scene, first, second, tile.bounds, tile.altitudes))
    geometry = pair_geometry(pair, first, second, tile.altitudes, scene.crs)
    raster = gdal.Open(reference)
    g, truth = raster.GetGeoTransform(), heights_of(raster).astype(np.float32)
    columns, rows = (np.arange(0, n, 16, dtype=np.float64) for n in pair.size)
    z = np.full((len(rows), len(columns)), sum(tile.altitudes) / 2)
    for step in range(20):
        x, y = (t.on_grid(columns, rows, z) for t in (geometry.x, geometry.y))
        ground = sample_array(truth, np.stack([(x - g[0]) / g[1] - 0.5, (y - g[3]) / g[5] - 0.5], axis=-1), "bilinear")
        z = np.where(np.isfinite(ground), (z + ground) / 2, np.nan if step > 15 else z)
    inside = (x > tile.bounds[0]) & (x < tile.bounds[2]) & (y > tile.bounds[1]) & (y < tile.bounds[3])
    off = geometry.vertical_parallax.on_grid(columns, rows, z)[inside & np.isfinite(z)]
    return off - np.median(off)


# Scale ------------------------------------------------------------------------------------------------------------


def smooth_pair(side: int) -> List[str]:
    """A pair of ``side`` px over rolling ground with a noise texture, sampled from one painted ground plane.

    Cheap, and true to the RPCs: a pixel's intensity is the texture where its ray meets the ground, which is found by
    a fixed point. Kept in the cache.
    """
    folder = CACHE / f"smooth_{side}"
    images = [str(folder / f"img_{i}.tif") for i in (1, 3)]
    spec = SceneSpec(
        "mountains", side, 3, PLEIADES.at_gsd(1.0), 1.0, 1, base_m=300.0, relief_m=120.0, lon=6.65, lat=44.38
    )

    def make() -> None:
        texture = noise(2048)
        for path, view in zip(images, [make_views(spec)[i] for i in (0, 2)]):
            fitted = fit_rpc(view.localise, view.size, (250.0, 500.0)).rpc
            with created(path, RasterFrame((side, side), np.uint16), nodata=None, compress=False) as target:
                target.set_metadata(rpc_tags(fitted), "RPC")
                for row in range(0, side, _STRIP):
                    rows = min(_STRIP, side - row)
                    target.write(painted(fitted, spec.crs, texture, row, (rows, side)), 0, row)

    made_once(folder, make)
    return images


def noise(side: int) -> np.ndarray:
    """A texture that repeats every ``side`` m without a seam, digital numbers: fine grain on coarser patches."""
    rng = np.random.default_rng(5)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side, 1.0), np.fft.rfftfreq(side, 1.0), indexing="ij"))
    spectrum = np.fft.rfft2(rng.normal(size=(side, side))) / np.maximum(frequency, 1.0 / side) ** 0.7
    spectrum *= np.exp(-((frequency / 0.35) ** 2))
    field = np.fft.irfft2(spectrum, s=(side, side))
    return (900 + 220 * field / field.std()).clip(60, 4000).astype(np.float32)


def rolling(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of smooth hills, m, anywhere."""
    waves = 35 * np.sin(x / 530.0) * np.cos(y / 610.0) + 18 * np.sin((x + y) / 210.0)
    return 370.0 + waves + 4 * np.cos((x - 2 * y) / 63.0)


def painted(rpc: Rpc, crs: str, texture: np.ndarray, row: int, shape: Tuple[int, int]) -> np.ndarray:
    """Digital numbers of a strip: rays met with the ground at every 20th px, the texture sampled between."""
    step = 20
    transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    columns = np.arange(0, shape[1] + step, step, dtype=np.float64)
    rows = np.arange(0, shape[0] + step, step, dtype=np.float64) + row
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    ends = []
    for height in (250.0, 500.0):
        ground = rpc.localise(pixels, height)
        ends.append(np.stack(transformer.transform(ground[..., 0], ground[..., 1]), axis=-1))
    low, high = (_spread(end, step, shape) for end in ends)
    share = np.full(shape, 0.5)
    for _ in range(6):
        place = low + (high - low) * share[..., None]
        share = (rolling(place[..., 0], place[..., 1]) - 250.0) / 250.0
    place = np.mod(low + (high - low) * share[..., None], float(texture.shape[0]))
    values = sample_array(np.pad(texture, (0, 2), "wrap"), place, "bilinear")
    grain = np.random.default_rng([7, row]).normal(0, 6, shape)
    return np.clip(np.rint(values + grain), 1, 4095).astype(np.uint16)


def _spread(nodes: np.ndarray, step: int, shape: Tuple[int, int]) -> np.ndarray:
    """Bilinear interpolation of nodes ``step`` px apart to all pixels of a strip."""
    share = (np.arange(step) / step)[None, :, None, None]
    tall = (nodes[:-1, None] + np.diff(nodes, axis=0)[:, None] * share).reshape(-1, *nodes.shape[1:])[: shape[0]]
    wide = tall[:, :-1, None] + np.diff(tall, axis=1)[:, :, None] * (np.arange(step) / step)[:, None]
    return wide.reshape(shape[0], -1, 2)[:, : shape[1]]


def scale() -> List[str]:
    """CPU seconds a Mpx and peak memory of pairs of growing size, one kind of ground."""
    rows: List[List[object]] = []
    start = start_of_qgis()
    for side in few(SIDES):
        side = quick_size(side)
        images = smooth_pair(side)
        say(f"pair of {side} px ...")
        mpx, label = side * side / 1e6, f"2 x {side} x {side}"
        runs = [one_run(images) for _ in range(_REPEATS if mpx < _SMALL_MPX and not is_quick() else 1)]
        cost, valid, error = sorted(runs, key=lambda run: run[0].cpu_s)[len(runs) // 2]
        cpu = (round(cost.cpu_s, 1), round(cost.cpu_s / mpx, 2), round((cost.cpu_s - start) / mpx, 2))
        found = (round(cost.wall_s, 1), round(cost.peak_gib, 2), round(valid, 1), round(error, 3), load())
        rows.append([label, mpx, *cpu, *found])
        say(rows[-1])
    headers = (
        "images | Mpx each | CPU s | CPU s a Mpx | ours, CPU s a Mpx | wall s | peak GiB | valid % of the tiles | "
        "NMAD against the ground, m | load"
    )
    return [
        "**Scale**: pairs of simulated images (1 m, B/H 0.42, rolling ground with a noise texture, 2 m cells), "
        f"whole commands; *ours* is without the start of QGIS, {start:.2f} CPU s in the same run (the median of "
        f"five commands that join two words). Below {_SMALL_MPX} Mpx: the middle one of {_REPEATS} runs. Bars: CPU "
        f"seconds a Mpx (of one image) constant within 20 %, memory flat. {LOAD}",
        table(headers, rows),
    ]


def one_run(images: Sequence[str]) -> Tuple[Cost, float, float]:
    """The cost of a pair's DSM, its valid cells in percent, and its NMAD against the ground, m."""
    with tempfile.TemporaryDirectory() as work:
        dsm, cost, results = repm(images, 2.0, Path(work))
        return cost, results["VALID_PERCENT"], off_the_hills(dsm)


def start_of_qgis() -> float:
    """CPU seconds of a command that does nothing worth mentioning."""
    command = [QGIS, "run", "native:stringconcatenation", "--", "INPUT_1=a", "INPUT_2=b"]
    return float(np.median([measured(command)[1].cpu_s for _ in range(1 if is_quick() else 5)]))


def off_the_hills(dsm: str) -> float:
    """NMAD of a DSM against the hills it shows, at every third cell."""
    raster = gdal.Open(dsm)
    g, heights = raster.GetGeoTransform(), heights_of(raster)[::3, ::3]
    columns, rows = (np.arange(0, n, 3) + 0.5 for n in (raster.RasterXSize, raster.RasterYSize))
    x, y = g[0] + g[1] * columns, g[3] + g[5] * rows
    return nmad(heights - rolling(*np.meshgrid(x, y)))


SECTIONS = [
    Section("large_whole", "A large scene", "make bench-large", {"whole": whole}),
    Section("large_parallax", "Vertical parallax that refinement leaves", "make bench-large", {"parallax": parallax}),
    Section("large_models", "What refinement gains", "make bench-large", {"models": models}),
    Section("large_scale", "Cost and size", "make bench-large", {"scale": scale}),
]
