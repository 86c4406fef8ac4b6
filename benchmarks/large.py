"""Large scenes: a ZY-3 tri-stereo of 3 x 5120 x 5120 px over 1500 m of relief, and cost from 4 to 100 Mpx.

'make bench-large' (an hour with the first simulation; the images are kept in the cache of benchmarks/dsm.py).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.dsm import CACHE, Scene, simulated, zy3  # noqa: E402
from benchmarks.runner import Cost, Failed, measured, repm, say, scores  # noqa: E402
from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.evaluation.metrics import nmad  # noqa: E402
from repm_qgis.imagery.raster import created, opened  # noqa: E402
from repm_qgis.imagery.warping import sample_array  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.scene import Scene as SceneFile  # noqa: E402
from repm_qgis.simulation.rpc_fit import fit_rpc  # noqa: E402
from repm_qgis.simulation.scene import SceneSpec, make_views, rpc_tags  # noqa: E402
from repm_qgis.simulation.sensor import PLEIADES  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402
from repm_qgis.stereo.pairing import rectified_pair  # noqa: E402
from repm_qgis.stereo.triangulation import pair_geometry  # noqa: E402

SIDES = (2000, 4000, 7000, 10000)
TILE = 4200
GSD = 2.5  # of the forward and backward view, m
_STRIP = 500
_SMALL_MPX, _REPEATS = 20, 3  # small scenes take seconds, of which chance takes a tenth


LOAD = (
    "Load: the machine's average over the last minute as the run ended, our own share being as many as there are "
    "cores; what is above that, others used, and wall times are upper bounds."
)


def load() -> float:
    return round(os.getloadavg()[0], 1)


def relief() -> Scene:
    return simulated("zy3_5120_1500", zy3(5120, 1500.0), 5.0)


# The whole scene --------------------------------------------------------------------------------------------------


def whole() -> List[str]:
    """Accuracy and cost of the whole scene, with each refinement model and else default options."""
    scene = relief()
    scene.make()
    rows = []
    for label, options in (
        ("none", {"MODEL": "none"}),
        ("polynomial (the default)", {}),
        ("terrain, no DEM given", {"MODEL": "terrain"}),
    ):
        say(f"{scene.name}: {label} ...")
        with tempfile.TemporaryDirectory() as work:
            try:
                dsm, cost, _ = repm(scene.images, scene.resolution, Path(work), **options)
            except Failed as error:
                rows.append([label, str(error), *[""] * 9])
                continue
            found = scores(dsm, scene.reference, scene.align)
        rows.append(
            [
                label,
                *(round(found[k], 3) for k in ("valid", "RMSE", "MAE", "ME", "C2.5", "C5")),
                round(cost.wall_s, 1),
                round(cost.cpu_s, 1),
                round(cost.peak_gib, 2),
                load(),
            ]
        )
        say(str(rows[-1]))
    return [
        "**ZY-3 tri-stereo**, 3 x 5120 x 5120 px (2.1 to 2.5 m) over 1500 m of relief, simulated, DSM of 5 m "
        f"against the true surface; through `scripts/qgis-headless` on {len(os.sched_getaffinity(0))} cores. "
        f"{LOAD} Bars: 180 s by the clock, 3 GiB. (The paper: 7.3 minutes on an A100.)",
        table(
            [
                "refinement",
                "valid %",
                "RMSE m",
                "MAE m",
                "ME m",
                "C2.5 %",
                "C5 %",
                "wall s",
                "CPU s",
                "peak GiB",
                "load",
            ],
            rows,
        ),
    ]


# Refinement -------------------------------------------------------------------------------------------------------

_MODEL = """
import json, sys
import numpy as np
from osgeo import gdal
gdal.UseExceptions()
from repm_qgis.imagery.parameters import WARPING
from repm_qgis.imagery.raster import read
from repm_qgis.matching import coarse
from repm_qgis.matching.pair_backend import rectified_over_tile
from repm_qgis.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.stages import run_stage
from repm_qgis.stereo.triangulation import pair_geometry

def left_as_they_are(self, pair, geometry):
    rows, columns = (WARPING.node_step_px * np.arange(n, dtype=np.float64) for n in self.nodes.shape)
    columns, rows = np.meshgrid(columns - self.high, rows)
    return pair.second_original(np.stack([columns - self.nodes, rows], axis=-1))

job = json.loads(sys.argv[1])
if job.pop("rows_left"):
    coarse.Guide.second_original = left_as_they_are
scene = Scene.load(run_stage("pipeline", job, Silent())["scene"])
square, count, most = 0.0, 0, 0.0
for tile in scene.tiles:
    for record in tile.heights:
        first, second = (scene.view(name) for name in record.pair)
        pair = rectified_over_tile(scene, first, second, tile.bounds, record.altitudes)
        geometry = pair_geometry(pair, first, second, record.altitudes, scene.crs)
        heights = read(gdal.Open(record.file))
        rows = geometry.row.on_grid(*(np.arange(n, dtype=float) for n in heights.shape[::-1]), heights)
        rows = np.abs(rows[np.isfinite(rows)])
        square, count, most = square + float((rows ** 2).sum()), count + rows.size, max(most, float(rows.max()))
print(json.dumps([len(scene.tiles), (square / count) ** 0.5, most]))
"""


def models() -> List[str]:
    """One large tile of the scene by each model, with and without the rows put right on the coarse surface."""
    scene = relief()
    scene.make()
    extent, crs = middle_of(scene.reference, 0.49 * TILE * GSD)
    rows = []
    for left in (True, False):
        for model in ("none", "polynomial", "terrain"):
            say(f"one tile, {model}, rows {'left' if left else 'put right'} ...")
            with tempfile.TemporaryDirectory() as work:
                job = {
                    "images": [scene.images[0], scene.images[2]],
                    "workspace": f"{work}/w",
                    "output": f"{work}/dsm.tif",
                    "resolution": 5.0,
                    "extent": extent,
                    "extent_crs": crs,
                    "tile_size": TILE,
                    "model": model,
                    "workers": 1,
                    "rows_left": left,
                }
                done = subprocess.run(
                    [sys.executable, "-c", _MODEL, json.dumps(job)], cwd=ROOT, capture_output=True, text=True
                )
                if done.returncode:
                    rows.append(
                        [
                            model,
                            "left" if left else "put right",
                            (done.stderr.strip().splitlines() or ["failed"])[-1][:200],
                            *[""] * 4,
                        ]
                    )
                    continue
                truth = cropped(scene.reference, extent, f"{work}/truth.tif")
                found = scores(f"{work}/dsm.tif", truth, True)
            rows.append(
                [
                    model,
                    "left" if left else "put right",
                    *(round(found[k], 3) for k in ("valid", "RMSE", "MAE", "C2.5", "C5")),
                ]
            )
            say(str(rows[-1]))
    return [
        f"**What refinement gains**: one tile of {TILE} px in the middle of the same scene, forward and backward "
        "view. *left*: rows as the model leaves them, as in the paper; *put right*: where the guide of the coarse "
        "level says what altitude the ground has, the RPCs say in which row it lies (the default), and the model "
        "matters no more.",
        table(["refinement", "rows", "valid %", "RMSE m", "MAE m", "C2.5 %", "C5 %"], rows),
    ]


def rows_left() -> List[str]:
    """What each model leaves of the rows on the true surface, before anything is matched, by the size of the tile."""
    scene = relief()
    scene.make()
    rows = []
    for side in (800, 1300, TILE, 5000):
        extent, crs = middle_of(scene.reference, 0.49 * side * GSD)
        with tempfile.TemporaryDirectory() as work:
            fitted = run_stage(
                "epmfit",
                {
                    "images": [scene.images[0], scene.images[2]],
                    "workspace": work,
                    "tile_size": side,
                    "extent": extent,
                    "extent_crs": crs,
                },
                Silent(),
            )["scene"]
            for model in ("none", "polynomial", "terrain"):
                dem = {"dem": scene.reference} if model == "terrain" else {}
                refined = run_stage(
                    "refine",
                    {
                        "scene": fitted,
                        "model": model,
                        "output_scene": f"{work}/{model}.json",
                        "write_images": False,
                        **dem,
                    },
                    Silent(),
                )["output_scene"]
                off = rows_on_ground(refined, scene.reference)
                rows.append(
                    [side, model, round(float(np.sqrt((off**2).mean())), 3), round(float(np.abs(off).max()), 3)]
                )
        say(str(rows[-3:]))
    return [
        "**Rows before anything is matched**: one tile in the middle of the ZY-3 scene, forward and backward view; "
        "by how much the rectified pair's rows miss each other on the true surface, px of 2.5 m, the median taken "
        "out (relative pointing). The terrain model's surface is here the true one in cells of 48 px. What "
        "the models leave of the equivalent error is mostly the same in both views: little of it is in the rows.",
        table(["tile, px", "refinement", "RMS px", "Max px"], rows),
    ]


def rows_on_ground(path: str, reference: str) -> np.ndarray:
    """Row differences of the first tile's two views at the places that a surface has in the rectified frame."""
    scene = SceneFile.load(path)
    tile = scene.tiles[0]
    pair = rectified_pair(scene, *scene.views, tile.bounds, tile.altitudes)
    geometry = pair_geometry(pair, *scene.views, tile.altitudes, scene.crs)
    raster = gdal.Open(reference)
    g, truth = raster.GetGeoTransform(), raster.ReadAsArray().astype(np.float32)
    truth[truth < -9000] = np.nan
    columns, rows = (np.arange(0, n, 16, dtype=np.float64) for n in pair.size)
    z = np.full((len(rows), len(columns)), sum(tile.altitudes) / 2)
    for step in range(20):
        x, y = (t.on_grid(columns, rows, z) for t in (geometry.x, geometry.y))
        ground = sample_array(truth, np.stack([(x - g[0]) / g[1] - 0.5, (y - g[3]) / g[5] - 0.5], axis=-1), "bilinear")
        z = np.where(np.isfinite(ground), (z + ground) / 2, np.nan if step > 15 else z)
    inside = (x > tile.bounds[0]) & (x < tile.bounds[2]) & (y > tile.bounds[1]) & (y < tile.bounds[3])
    off = geometry.row.on_grid(columns, rows, z)[inside & np.isfinite(z)]
    return off - np.median(off)


def middle_of(path: str, half_m: float) -> Tuple[Tuple[float, float, float, float], str]:
    """A square around a raster's middle, and the raster's CRS."""
    raster = gdal.Open(path)
    g = raster.GetGeoTransform()
    x, y = g[0] + g[1] * raster.RasterXSize / 2, g[3] + g[5] * raster.RasterYSize / 2
    return (x - half_m, y - half_m, x + half_m, y + half_m), pyproj.CRS.from_wkt(raster.GetProjection()).to_string()


def cropped(path: str, extent: Tuple[float, float, float, float], target: str) -> str:
    gdal.Translate(target, path, projWin=(extent[0], extent[3], extent[2], extent[1]))
    return target


# Scale ------------------------------------------------------------------------------------------------------------


def smooth_pair(side: int) -> List[str]:
    """A pair of ``side`` px over rolling ground with a noise texture, sampled from one painted ground plane.

    Cheap, and true to the RPCs: a pixel's brightness is the texture where its ray meets the ground, which is found by
    a fixed point. Kept in the cache.
    """
    folder = CACHE / f"smooth_{side}"
    images = [str(folder / f"img_{i}.tif") for i in (1, 3)]
    if (folder / "done").exists():
        return images
    say(f"simulating a pair of {side} px ...")
    folder.mkdir(parents=True, exist_ok=True)
    spec = SceneSpec(
        "mountains",
        side,
        3,
        PLEIADES.at_gsd(1.0),
        cell_m=1.0,
        surface_step=1,
        base_m=300.0,
        relief_m=120.0,
        lon=6.65,
        lat=44.38,
    )
    texture = noise(2048)
    for path, view in zip(images, [make_views(spec)[i] for i in (0, 2)]):
        fitted = fit_rpc(view.localise, view.size, (250.0, 500.0)).rpc
        with created(path, (side, side), np.dtype(np.uint16), 1, None, "", nodata=None, compress=False) as target:
            target.set_metadata(rpc_tags(fitted), "RPC")
            for row in range(0, side, _STRIP):
                rows = min(_STRIP, side - row)
                target.write(painted(fitted, spec.crs, texture, row, (rows, side)), 0, row)
    (folder / "done").write_text("")
    return images


def noise(side: int) -> np.ndarray:
    """A texture that repeats every ``side`` m without a seam, digital numbers: fine grain on coarser patches."""
    rng = np.random.default_rng(5)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side), np.fft.rfftfreq(side), indexing="ij"))
    spectrum = np.fft.rfft2(rng.normal(size=(side, side))) / np.maximum(frequency, 1.0 / side) ** 0.7
    spectrum *= np.exp(-((frequency / 0.35) ** 2))
    field = np.fft.irfft2(spectrum, s=(side, side))
    return (900 + 220 * field / field.std()).clip(60, 4000).astype(np.float32)


def rolling(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of smooth hills, m, anywhere."""
    return (
        370.0
        + 35 * np.sin(x / 530.0) * np.cos(y / 610.0)
        + 18 * np.sin((x + y) / 210.0)
        + 4 * np.cos((x - 2 * y) / 63.0)
    )


def painted(rpc: Any, crs: str, texture: np.ndarray, row: int, shape: Tuple[int, int]) -> np.ndarray:
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
    rows: List[List[Any]] = []
    start = start_of_qgis()
    for side in SIDES:
        images = smooth_pair(side)
        say(f"pair of {side} px ...")
        mpx = side * side / 1e6
        try:
            runs = [one_run(images) for _ in range(_REPEATS if mpx < _SMALL_MPX else 1)]
        except Failed as error:
            rows.append([f"2 x {side} x {side}", str(error), *[""] * 8])
            continue
        cost, valid, error = sorted(runs, key=lambda run: run[0].cpu_s)[len(runs) // 2]
        rows.append(
            [
                f"2 x {side} x {side}",
                mpx,
                round(cost.cpu_s, 1),
                round(cost.cpu_s / mpx, 2),
                round((cost.cpu_s - start) / mpx, 2),
                round(cost.wall_s, 1),
                round(cost.peak_gib, 2),
                round(valid, 1),
                round(error, 3),
                load(),
            ]
        )
        say(str(rows[-1]))
    return [
        "**Scale**: pairs of simulated images (1 m, B/H 0.42, rolling ground with a noise texture, 2 m cells), "
        f"whole commands; *ours* is without the start of QGIS, {start:.2f} CPU s in the same run (the median of "
        f"five commands that join two words). Below {_SMALL_MPX} Mpx: the middle one of {_REPEATS} runs. Bars: CPU "
        f"seconds a Mpx (of one image) constant within 20 %, memory flat. {LOAD}",
        table(
            [
                "images",
                "Mpx each",
                "CPU s",
                "CPU s a Mpx",
                "ours, CPU s a Mpx",
                "wall s",
                "peak GiB",
                "valid % of the tiles",
                "NMAD against the ground, m",
                "load",
            ],
            rows,
        ),
    ]


def one_run(images: Sequence[str]) -> Tuple[Cost, float, float]:
    """The cost of a pair's DSM, its valid cells in percent, and its NMAD against the ground, m."""
    with tempfile.TemporaryDirectory() as work:
        dsm, cost, results = repm(images, 2.0, Path(work))
        return cost, results.get("VALID_PERCENT", np.nan), off_the_hills(dsm)


def start_of_qgis() -> float:
    """CPU seconds of a command that does nothing worth mentioning."""
    command = [
        str(ROOT / "scripts" / "qgis-headless"),
        "run",
        "native:stringconcatenation",
        "--",
        "INPUT_1=a",
        "INPUT_2=b",
    ]
    return float(np.median([measured(command)[1].cpu_s for _ in range(5)]))


def off_the_hills(dsm: str) -> float:
    """NMAD of a DSM against the hills it shows, at every third cell."""
    with opened(dsm) as raster:
        g, size = raster.GetGeoTransform(), (raster.RasterXSize, raster.RasterYSize)
        heights = raster.ReadAsArray()[::3, ::3].astype(np.float64)
    heights[heights < -9000] = np.nan
    x, y = (g[0] + g[1] * (np.arange(0, size[0], 3) + 0.5), g[3] + g[5] * (np.arange(0, size[1], 3) + 0.5))
    error = heights - rolling(*np.meshgrid(x, y))
    return nmad(error[np.isfinite(error)])


PARTS: Dict[str, Tuple[str, Callable[[], List[str]]]] = {
    "whole": ("A large scene", whole),
    "rows": ("Rows that refinement leaves", rows_left),
    "models": ("What refinement gains", models),
    "scale": ("Cost and size", scale),
}


def main() -> int:
    gdal.UseExceptions()
    for name, (title, part) in PARTS.items():
        if name in (sys.argv[1:] or PARTS):
            publish(f"large_{name}", title, "make bench-large", part())
    return 0


if __name__ == "__main__":
    sys.exit(main())
