"""Where the images really look: what the adjustment recovers, on truth scenes and real images ('make bench-pointing').

Own truth scenes are simulated once and kept in the temporary folder. Real images are taken from the folder that
REPM_SHARED_DATA names (default: ../shared/data beside the checkout); parts that need them say so where it is absent.
Names of parts (``python benchmarks/pointing.py pairs``) run those alone, and only print them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal
from scipy import ndimage

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import hard_scenes  # noqa: E402
from benchmarks.tables import publish, table  # noqa: E402
from repm_qgis.errors import RepmError  # noqa: E402
from repm_qgis.evaluation.metrics import NMAD_FACTOR, nmad  # noqa: E402
from repm_qgis.geometry.footprints import bounds_of, footprint, seen_twice  # noqa: E402
from repm_qgis.geometry.frames import EnuFrame, projected_from_geodetic, utm_crs  # noqa: E402
from repm_qgis.imagery.acquisition import apart_text, moment, time_of_name  # noqa: E402
from repm_qgis.imagery.enhancement import view_stretch  # noqa: E402
from repm_qgis.progress import Silent  # noqa: E402
from repm_qgis.rpc.readers import read_rpc_file  # noqa: E402
from repm_qgis.scene import Scene, Tile, View, load_views  # noqa: E402
from repm_qgis.sfm.adjustment import Track, adjust  # noqa: E402
from repm_qgis.sfm.colmap_adjustment import adjust_colmap  # noqa: E402
from repm_qgis.sfm.ground_control import Gcp  # noqa: E402
from repm_qgis.sfm.pair_selection import choose_pairs, pair_cost  # noqa: E402
from repm_qgis.sfm.parameters import POINTING  # noqa: E402
from repm_qgis.sfm.pointing import Pointing, point_views  # noqa: E402
from repm_qgis.simulation.rpc_fit import fit_rpc  # noqa: E402
from repm_qgis.simulation.scene import SceneSpec, make_scene, make_views, rpc_tags, surface_bounds  # noqa: E402
from repm_qgis.simulation.sensor import ZY3  # noqa: E402
from repm_qgis.simulation.surface import SimulatedSurface  # noqa: E402
from repm_qgis.stages import run_stage  # noqa: E402
from repm_qgis.stereo.pairing import convergence  # noqa: E402

SHARED = Path(os.environ.get("REPM_SHARED_DATA", ROOT.parent / "shared" / "data"))
CACHE = Path(tempfile.gettempdir()) / "repm_bench_pointing"
SIZE, SEED = 800, 5
BIG = 5120
DRAWS = 10  # of noisy control points


def simulated(name: str, spec: SceneSpec) -> Path:
    """The folder of a truth scene, made where it is not there yet."""
    folder = CACHE / name
    if not (folder / "done").exists():
        make_scene(spec, str(folder), Silent())
        (folder / "done").write_text("")
    return folder


def town() -> Tuple[SceneSpec, Path]:
    spec = SceneSpec.default("urban", SIZE, SEED)
    return spec, simulated(f"town_{SIZE}", spec)


def hills() -> Tuple[SceneSpec, Path]:
    spec = SceneSpec.default("mountains", SIZE, SEED)
    return spec, simulated(f"hills_{SIZE}", spec)


def write_image(path: Path, pixels: np.ndarray, tags: Dict[str, str]) -> str:
    dataset = gdal.GetDriverByName("GTiff").Create(
        str(path), pixels.shape[1], pixels.shape[0], 1, gdal.GDT_UInt16, ["TILED=YES"]
    )
    dataset.SetMetadata(tags, "RPC")
    dataset.GetRasterBand(1).WriteArray(pixels)
    dataset = None
    return str(path)


def pixels_of(path: Path) -> np.ndarray:
    return gdal.Open(str(path)).ReadAsArray()


class Case:
    """A truth scene whose RPCs are wrong by known affine pointings, (2, 3) a view: vendor's pixel to the real one."""

    def __init__(self, made: Tuple[SceneSpec, Path], pointings: Sequence[np.ndarray], folder: Path) -> None:
        spec, base = made
        folder.mkdir(parents=True, exist_ok=True)
        self.truth, self.folder = base / "truth.tif", folder
        self.true = make_views(spec)
        record = json.loads((base / "truth.json").read_text())
        self.heights = tuple(record["height_range_m"])
        self.pointings = {view.name: A for view, A in zip(self.true, pointings)}
        self.images = []
        for view, A in zip(self.true, pointings):
            fit = fit_rpc(
                lambda px, h, view=view, A=A: view.localise(px @ A[:, :2].T + A[:, 2], h),
                view.size,
                (self.heights[0] - 30, self.heights[1] + 30),
            )
            self.images.append(
                write_image(folder / f"{view.name}.tif", pixels_of(base / f"{view.name}.tif"), rpc_tags(fit.rpc))
            )
        gdal.UseExceptions()
        truth = gdal.Open(str(self.truth))
        self.surface, self.transform = truth.ReadAsArray(), truth.GetGeoTransform()
        self.crs = truth.GetProjection()

    def scene(self) -> Scene:
        return fitted(self.images, self.folder / "w")

    def ground(self, count: int, seed: int) -> np.ndarray:
        """(N, 3) points of the true surface."""
        rng = np.random.default_rng(seed)
        rows, cols = (rng.integers(8, n - 8, count) for n in self.surface.shape)
        x = self.transform[0] + (cols + 0.5) * self.transform[1]
        y = self.transform[3] + (rows + 0.5) * self.transform[5]
        lon, lat = pyproj.Transformer.from_crs(self.crs, "EPSG:4326", always_xy=True).transform(x, y)
        return np.column_stack([lon, lat, self.surface[rows, cols]])

    def gcps(self, count: int, noise: float, wrong: int, seed: int) -> List[Gcp]:
        """Control points on the true surface; the first ``wrong`` were measured some 10 px beside."""
        rng = np.random.default_rng(seed)
        points = []
        for number, ground in enumerate(self.ground(count, seed)):
            pixels = {view.name: view.project(ground[None])[0] + rng.normal(0, noise, 2) for view in self.true}
            if number < wrong:
                error = rng.uniform(4, 12, 2) * rng.choice((-1, 1), 2)
                pixels = {name: pixel + error for name, pixel in pixels.items()}
            points.append(Gcp(f"G{number + 1:02d}", *map(float, ground), "control", pixels))
        return points

    def observable_px(self, pointing: Dict[str, np.ndarray]) -> np.ndarray:
        """(N,) what a recovered pointing leaves that no move of the ground points takes up, px a view (RMS)."""
        ground = self.ground(600, 77)
        enu = EnuFrame(*ground.mean(axis=0))
        misfit, moves = [], []
        for view, vendor in zip(self.true, load_views(tuple(self.images))):
            found = vendor.with_pointing(pointing[vendor.name])
            seen = found.project(ground)
            misfit.append(view.project(ground) - seen)
            local = enu.from_geodetic(ground)
            moves.append(np.stack([found.project(enu.to_geodetic(local + d)) - seen for d in np.eye(3)], axis=-1))
        residual, jacobian = np.concatenate(misfit, axis=1), np.concatenate(moves, axis=1)
        left = residual - np.einsum("nij,njk,nk->ni", jacobian, np.linalg.pinv(jacobian), residual)
        return np.sqrt((left**2).sum(axis=1) / len(self.true))

    def absolute_px(self, pointing: Dict[str, np.ndarray]) -> np.ndarray:
        """(N,) the largest error of a recovered pointing over the views at points of the surface, px."""
        ground = self.ground(600, 78)
        found = [view.with_pointing(pointing[view.name]) for view in load_views(tuple(self.images))]
        return np.max(
            [
                np.linalg.norm(true.project(ground) - view.project(ground), axis=1)
                for true, view in zip(self.true, found)
            ],
            axis=0,
        )


def fitted(images: Sequence[str], workspace: Path, **options: Any) -> Scene:
    """The scene with cameras, as the pipeline makes it by default."""
    made = run_stage("epmfit", {"images": list(images), "workspace": str(workspace), **options}, Silent())
    return replace(Scene.load(made["scene"]), refinement="polynomial")


def pointed(scene: Scene, gcps: Sequence[Gcp] = (), model: str = "auto") -> Pointing:
    pairs = choose_pairs(scene)
    stretches = {view.name: view_stretch(view.image, view.band) for view in scene.views}
    return point_views(scene, pairs, stretches, model, gcps, Silent())


def with_outliers(tracks: Sequence[Track], share: float, seed: int) -> List[Track]:
    """Tie points of which a share is wrong by up to 30 px in one view."""
    rng = np.random.default_rng(seed)
    result = []
    for track in tracks:
        pixels = dict(track.pixels)
        if rng.uniform() < share:
            name = sorted(pixels)[rng.integers(len(pixels))]
            pixels[name] = pixels[name] + rng.uniform(-30, 30, 2)
        result.append(Track(pixels))
    return result


def shift_of(col: float, row: float) -> np.ndarray:
    return np.array([[1.0, 0.0, col], [0.0, 1.0, row]])


def known_pointings(kind: str) -> List[np.ndarray]:
    """Shifts of up to 15 px; ``affine``: and a drift of up to 3 px from one side of the image to the other."""
    pointings = [shift_of(15.0, -11.0), shift_of(-12.0, 15.0), shift_of(4.0, -14.0)]
    if kind == "shift":
        return pointings
    middle = (SIZE - 1) / 2
    drifts = [[3.0, -1.5], [1.0, 2.0]], [[-2.0, 3.0], [-3.0, 1.0]], [[1.5, -2.5], [3.0, -3.0]]
    for A, linear in zip(pointings, drifts):
        linear = np.array(linear) / SIZE
        A[:, :2] += linear
        A[:, 2] -= linear @ [middle, middle]
    return pointings


# 1 --------------------------------------------------------------------------------------------------------------


def dsm(images: Sequence[str], folder: Path, **options: Any) -> Dict[str, Any]:
    """The pipeline's products and its reconstructed scene."""
    made = run_stage(
        "pipeline",
        {
            "images": list(images),
            "workspace": str(folder / "w"),
            "output": str(folder / "dsm.tif"),
            "resolution": 0.5,
            **options,
        },
        Silent(),
    )
    return {**made, "facts": Scene.load(made["scene"]).pointing}


def errors_of(path: str, truth: Path) -> np.ndarray:
    """DSM less truth on the truth's grid (bilinear), NaN where either has nothing; no alignment."""
    target = gdal.Open(str(truth))
    g, known = target.GetGeoTransform(), target.ReadAsArray().astype(float)
    nodata = target.GetRasterBand(1).GetNoDataValue()
    known[(known == nodata) | (known < -9000)] = np.nan
    right, bottom = g[0] + g[1] * target.RasterXSize, g[3] + g[5] * target.RasterYSize
    warped = (
        gdal.Warp(
            "",
            gdal.Open(path),
            format="MEM",
            dstSRS=target.GetProjection(),
            resampleAlg="bilinear",
            outputBounds=(g[0], bottom, right, g[3]),
            width=target.RasterXSize,
            height=target.RasterYSize,
            dstNodata=-99999,
            outputType=gdal.GDT_Float32,
        )
        .ReadAsArray()
        .astype(float)
    )
    warped[warped < -9000] = np.nan
    return warped - known


def truth_urban() -> List[str]:
    """Point 1: two views under real RPCs, the second wrong by (1.7, -2.3) px."""
    data = SHARED / "truth_urban"
    if not data.exists():
        return [f"truth_urban: not measured, '{data}' is absent."]
    images = [str(data / f"img_0{i}.tif") for i in (1, 2)]
    rows = []
    for label, options in (("without", {}), ("with gcps.csv", {"gcps": str(data / "gcps.csv")})):
        with tempfile.TemporaryDirectory() as folder:
            made = dsm(images, Path(folder), **options)
            error = errors_of(made["output"], data / "truth.tif")
            error = error[np.isfinite(error)]
            pair, facts = made["facts"].pairs[0], made["facts"]
            said = (
                f"{facts.height_uncertainty_m:.1f} m"
                if facts.height_uncertainty_m is not None
                else f"{len(facts.rejected_gcps)} of {len(facts.gcps)} points rejected"
            )
            rows.append(
                [
                    label,
                    pair.count,
                    abs(pair.before_px),
                    pair.after_px,
                    float(np.median(error)),
                    nmad(error),
                    said,
                ]
            )
    return [
        "**1. truth_urban**: two views, real Pleiades RPCs, the second wrong by (1.7, -2.3) px; GCPs with 0.3 px "
        "of noise. Bars: row residual below 0.1 px; bias with GCPs below 0.15 m without any alignment; without "
        "GCPs the report says how uncertain the absolute height is.",
        table(
            [
                "GCPs",
                "ties",
                "row residual before, px",
                "after (median of absolute), px",
                "bias of the DSM, m",
                "NMAD, m",
                "said of the absolute height",
            ],
            rows,
        ),
    ]


# 2 --------------------------------------------------------------------------------------------------------------


def numeric_moves(view: Any, ground: np.ndarray) -> np.ndarray:
    """(N, 2, 3) how pixels move with ground points, px/m."""
    enu = EnuFrame(*ground.mean(axis=0))
    local, seen = enu.from_geodetic(ground), view.project(ground)
    return np.stack([view.project(enu.to_geodetic(local + d)) - seen for d in np.eye(3)], axis=-1)


def pointing_basis(pixels: np.ndarray, kind: str) -> np.ndarray:
    """(N, 2, p) how a view's pixels move with its shift or affine correction."""
    scaled = 2 * pixels / (SIZE - 1) - 1
    one = np.column_stack([np.ones(len(pixels)), *([scaled] if kind == "affine" else [])])
    return np.concatenate([np.stack([one, 0 * one], axis=1), np.stack([0 * one, one], axis=1)], axis=2)


def tie_information(case: Case, tracks: Sequence[Track], ground: np.ndarray, kind: str) -> np.ndarray:
    """Fisher information of the ties about all views' corrections, with the noise that they have about the truth."""
    p = 2 if kind == "shift" else 6
    moves = [numeric_moves(view, ground) for view in case.true]
    seen = [view.project(ground) for view in case.true]
    parts, sizes = [], []
    for k, track in enumerate(tracks):
        views = [i for i, view in enumerate(case.true) if view.name in track.pixels]
        J = np.concatenate([moves[i][k] for i in views])
        free = np.eye(len(J)) - J @ np.linalg.pinv(J)
        design = np.zeros((len(J), p * len(case.true)))
        for row, i in enumerate(views):
            design[2 * row : 2 * row + 2, i * p : (i + 1) * p] = pointing_basis(seen[i][k : k + 1], kind)[0]
        misfit = free @ np.concatenate([track.pixels[case.true[i].name] - seen[i][k] for i in views])
        sizes.append(np.linalg.norm(misfit) / np.sqrt(len(J) - 3))
        parts.append(free @ design)
    design = np.concatenate(parts)
    return design.T @ design / (NMAD_FACTOR * float(np.median(sizes))) ** 2


def expected_px(case: Case, ties: np.ndarray, gcps: Sequence[Gcp], noise: float, kind: str) -> float:
    """The Cramer-Rao bound of the absolute error: RMS over the views at points of the surface, px."""
    information = ties.copy()
    surface, p, variance = case.ground(600, 78), 2 if kind == "shift" else 6, []
    for gcp in gcps:
        for i, view in enumerate(case.true):
            basis = pointing_basis(view.project(gcp.lon_lat_h[None]), kind)[0]
            information[i * p : (i + 1) * p, i * p : (i + 1) * p] += basis.T @ basis / noise**2
    covariance = np.linalg.inv(information)
    for i, view in enumerate(case.true):
        basis = pointing_basis(view.project(surface), kind)
        variance.append(np.einsum("nij,jk,nik->n", basis, covariance[i * p : (i + 1) * p, i * p : (i + 1) * p], basis))
    return float(np.sqrt(np.mean(variance)))


def controlled(case: Case, found: Pointing, altitude: float, kind: str) -> List[Any]:
    """The table's columns of ground control: absolute errors with exact and noisy points, and what noise allows."""
    plain = load_views(tuple(case.images))
    ties = tie_information(case, found.tracks, found.adjusted.ground, kind)
    cells, named, right = [], [], 0
    for noise, draws in ((0.0, 1), (0.3, DRAWS)):
        square, bound = [], []
        for draw in range(draws):
            gcps = case.gcps(12, noise, 2, 4 + draw)
            made = adjust(plain, found.tracks, altitude, "auto", gcps)
            error = case.absolute_px(made.pointing)
            named.append(", ".join(sorted(made.rejected)) or "none")
            right += made.model == kind
            if draw == 0:
                cells.append(f"{np.median(error):.3f} / {error.max():.3f}")
            if noise:
                views = [view.with_pointing(made.pointing[view.name]) for view in plain]
                surface = case.ground(600, 78)
                square.append(
                    np.mean(
                        [
                            ((true.project(surface) - view.project(surface)) ** 2).sum(axis=1)
                            for true, view in zip(case.true, views)
                        ]
                    )
                )
                bound.append(expected_px(case, ties, gcps[2:], noise, kind) ** 2)
    return [
        *cells,
        f"{np.sqrt(np.mean(square)):.3f}",
        f"{np.sqrt(np.mean(bound)):.3f}",
        f"{right} of {DRAWS + 1}",
        "; ".join(f"{name} ({named.count(name)})" for name in dict.fromkeys(named)),
    ]


def known_errors() -> List[str]:
    """Point 2: own truth scenes with known pointing errors."""
    found_rows, control_rows = [], []
    for label, made in (("town", town()), ("hills", hills())):
        for kind, bar in (("shift", 0.05), ("affine", 0.1)):
            case = Case(made, known_pointings(kind), CACHE / f"{label}_{kind}")
            scene = case.scene()
            found = pointed(scene)
            altitude = sum(scene.altitudes) / 2
            dirty = adjust(load_views(tuple(case.images)), with_outliers(found.tracks, 0.2, 3), altitude, "auto")
            observable = [case.observable_px(a.pointing) for a in (found.adjusted, dirty)]
            found_rows.append(
                [
                    label,
                    kind,
                    len(found.tracks),
                    found.adjusted.model,
                    *(f"{np.median(o):.3f} / {o.max():.3f}" for o in observable),
                    bar,
                ]
            )
            control_rows.append([label, kind, *controlled(case, found, altitude, kind), bar])
    return [
        f"**2. Known errors**: simulated tri-stereo, {SIZE} px, RPCs shifted by up to 15 px; *affine*: with drift "
        "of up to 3 px across the image besides. Observable: what no move of the ground points takes up, RMS over "
        "the views, at 600 points of the surface (median / largest), px.",
        table(["scene", "errors", "ties", "model chosen", "observable", "with 20 % gross outliers", "bar"], found_rows),
        "With 12 control points, of which G01 and G02 are wrong by 4 to 12 px in each direction. Absolute: the "
        "error of the view that is worst at each of 600 points of the surface (median / largest), px; the bar is "
        f"for exact points. RMS: over points and views, of {DRAWS} draws of points with 0.3 px of noise; beside it "
        "the Cramer-Rao bound: what ten good points of that noise and the ties allow an unbiased adjustment that "
        "knows which two are wrong, and how noisy all are.",
        table(
            [
                "scene",
                "errors",
                "absolute, exact GCPs",
                "absolute, GCPs of 0.3 px",
                "RMS of the draws",
                "bound",
                "right model",
                "named as wrong (draws)",
                "bar",
            ],
            control_rows,
        ),
    ]


# 3 --------------------------------------------------------------------------------------------------------------


def pairwise_dsms(images: Sequence[str], folder: Path, **options: Any) -> Dict[Tuple[str, str], str]:
    """One DSM for each pair of views, all from one adjustment."""
    made = run_stage("epmfit", {"images": list(images), "workspace": str(folder)}, Silent())
    made = run_stage(
        "reconstruct", {"scene": made["scene"], "output_scene": str(folder / "all.json"), **options}, Silent()
    )
    result = {}
    names = [view.name for view in Scene.load(made["output_scene"]).views]
    for pair in combinations(names, 2):
        scene = Scene.load(made["output_scene"])
        scene = scene.with_tiles(
            lambda tile, of=set(pair): replace(tile, heights=tuple(r for r in tile.heights if set(r.pair) == of))
        )
        path = scene.save(str(folder / f"{'_'.join(pair)}.json"))
        result[pair] = run_stage(
            "dsmfuse", {"scene": path, "output": str(folder / f"{'_'.join(pair)}.tif"), "resolution": 0.5}, Silent()
        )["output"]
    return result


def difference(a: str, b: str) -> np.ndarray:
    """Cells of two DSMs that both have, a less b: (rows, columns) over their common area, NaN else."""
    x, y = gdal.Open(a), gdal.Open(b)
    boxes = []
    for d in (x, y):
        g = d.GetGeoTransform()
        boxes.append((g[0], g[3] + g[5] * d.RasterYSize, g[0] + g[1] * d.RasterXSize, g[3]))
    low = max(boxes[0][0], boxes[1][0]), max(boxes[0][1], boxes[1][1])
    high = min(boxes[0][2], boxes[1][2]), min(boxes[0][3], boxes[1][3])
    arrays = []
    for d in (x, y):
        array = (
            gdal.Warp(
                "", d, format="MEM", outputBounds=(*low, *high), xRes=0.5, yRes=0.5, resampleAlg="near", dstNodata=-9999
            )
            .ReadAsArray()
            .astype(float)
        )
        array[array < -9000] = np.nan
        arrays.append(array)
    return arrays[0] - arrays[1]


def triplet() -> List[str]:
    """Point 3: the pairwise DSMs of three real images agree."""
    data = SHARED / "pleiades_triplet"
    if not data.exists():
        return [f"pleiades_triplet: not measured, '{data}' is absent."]
    with tempfile.TemporaryDirectory() as folder:
        made = pairwise_dsms([str(data / f"img_0{i}.tif") for i in (1, 2, 3)], Path(folder))
        rows = []
        for (one, first), (two, second) in combinations(made.items(), 2):
            error = difference(first, second)
            height, width = error.shape
            corners = [
                error[r, c]
                for r in (slice(0, height // 4), slice(-(height // 4), None))
                for c in (slice(0, width // 4), slice(-(width // 4), None))
            ]
            worst = max((abs(float(np.nanmedian(part))) for part in corners if np.isfinite(part).any()), default=0.0)
            rows.append(
                [
                    " and ".join(one),
                    " and ".join(two),
                    float(np.nanmedian(error)),
                    worst,
                    nmad(error[np.isfinite(error)]),
                ]
            )
    return [
        "**3. pleiades_triplet**: the DSMs of the three pairs against each other after adjustment, 0.5 m cells, no "
        "alignment. Bar: median within 0.3 m (S2P's raw pairs differ by 4.8 m; CARS leaves up to 2.4 m in "
        "corners).",
        table(["DSM of", "less DSM of", "median, m", "worst corner's median, m", "NMAD, m"], rows),
    ]


# 4 --------------------------------------------------------------------------------------------------------------


def clouds(shape: Tuple[int, int], seed: int) -> np.ndarray:
    """Bright fractal texture, 0..1."""
    rng = np.random.default_rng(seed)
    total = np.zeros(shape)
    for octave in range(2, 8):
        nodes = 2**octave + 1
        rough = rng.normal(size=(nodes, nodes)) / 1.8**octave
        total += ndimage.zoom(rough, (shape[0] / nodes, shape[1] / nodes), order=1)[: shape[0], : shape[1]]
    return (total - total.min()) / np.ptp(total)


def flooded(case: Case, folder: Path, share: float) -> List[str]:
    """The images with water (one brightness, noise) but for a disc of land, a share of the area, on one place."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(8)
    ground = case.ground(1, 12)
    radius = float(np.sqrt(share * SIZE * SIZE / np.pi))
    result = []
    for view, path in zip(case.true, case.images):
        source = gdal.Open(path)
        pixels, tags = source.ReadAsArray(), source.GetMetadata("RPC")
        place = view.project(ground)[0]
        rows, cols = np.indices(pixels.shape)
        water = np.hypot(cols - place[0], rows - place[1]) > radius
        level = np.clip(np.rint(180 + rng.normal(0, 4, pixels.shape)), 1, 4095).astype(np.uint16)
        result.append(write_image(folder / f"{view.name}.tif", np.where(water, level, pixels), tags))
    return result


def clouded(case: Case, folder: Path, halves: Sequence[Optional[str]]) -> List[str]:
    """The images with clouds of their own over one half each."""
    folder.mkdir(parents=True, exist_ok=True)
    result = []
    for number, (view, path, half) in enumerate(zip(case.true, case.images, halves)):
        source = gdal.Open(path)
        pixels, tags = source.ReadAsArray(), source.GetMetadata("RPC")
        top = float(np.percentile(pixels, 99.5))
        cover = np.rint(top * (1.0 + 0.8 * clouds(pixels.shape, 20 + number))).clip(1, 4095).astype(np.uint16)
        rows, cols = np.indices(pixels.shape)
        under = {"left": cols < SIZE / 2, "top": rows < SIZE / 2, None: np.zeros(pixels.shape, bool)}[half]
        result.append(write_image(folder / f"{view.name}.tif", np.where(under, cover, pixels), tags))
    return result


def hard(name: str, surfaces: Callable[[SceneSpec], Sequence[SimulatedSurface]]) -> Tuple[Case, List[str]]:
    """A scene of which each view may see another surface, rendered where it is not there yet."""
    spec = SceneSpec.default("urban", SIZE, SEED)
    folder = CACHE / name
    if not (folder / "done").exists():
        hard_scenes.write_scene(folder, spec, surfaces(spec), lambda path, pixels: write_image(path, pixels, {}))
        (folder / "done").write_text("")
    case = Case((spec, folder), known_pointings("shift"), CACHE / f"{name}_shift")
    return case, case.images


def estates(garden: float, spec: SceneSpec) -> List[SimulatedSurface]:
    bounds = surface_bounds(spec, make_views(spec))
    return [hard_scenes.estate(bounds, spec, (18.0, 24.0), -11.0, 0.3, garden)] * 3


def sunny(spec: SceneSpec, *suns: hard_scenes.Sun) -> List[SimulatedSurface]:
    return [hard_scenes.town_under(spec, sun) for sun in suns]


def seasons(spec: SceneSpec) -> List[SimulatedSurface]:
    plain = hard_scenes.town_under(spec, spec.sun)
    return [plain, hard_scenes.another_season(plain, 1), hard_scenes.another_season(plain, 2)]


def poor_scenes() -> List[str]:
    """Point 4: water, clouds, equal roofs, other suns and seasons."""
    case = Case(town(), known_pointings("shift"), CACHE / "town_shift")
    rows = []
    kinds: List[Tuple[str, Callable[[], Tuple[Case, List[str]]]]] = [
        ("water but for 2 %", lambda: (case, flooded(case, CACHE / "water_2", 0.02))),
        ("water but for 0.2 %", lambda: (case, flooded(case, CACHE / "water_02", 0.002))),
        ("one image half under cloud", lambda: (case, clouded(case, CACHE / "cloud_1", ("left", None, None)))),
        (
            "every image half under its own clouds",
            lambda: (case, clouded(case, CACHE / "cloud_3", ("left", "left", "left"))),
        ),
        ("clouds over different halves", lambda: (case, clouded(case, CACHE / "cloud_2", ("left", "top", None)))),
        ("equal roofs on a grid, gardens", lambda: hard("estate_gardens", lambda spec: estates(0.016, spec))),
        ("equal roofs on a grid, plain ground", lambda: hard("estate_plain", lambda spec: estates(0.004, spec))),
        ("one image in the morning", lambda: hard("morning", lambda s: sunny(s, s.sun, hard_scenes.MORNING, s.sun))),
        (
            "morning, noon, afternoon",
            lambda: hard("day", lambda s: sunny(s, hard_scenes.MORNING, s.sun, hard_scenes.AFTERNOON)),
        ),
        ("three seasons", lambda: hard("seasons", seasons)),
    ]
    for label, make in kinds:
        seen, images = make()
        try:
            found = pointed(fitted(images, Path(images[0]).parent / "w"))
            left = seen.observable_px(found.adjusted.pointing)
            rows.append(
                [
                    label,
                    len(found.tracks),
                    found.figures.after_px,
                    f"{np.median(left):.3f} / {left.max():.3f}",
                    found.adjusted.reason,
                ]
            )
        except RepmError as error:
            rows.append([label, 0, "", "stopped", str(error)])
    return [
        "**4. Poor scenes**: the town of point 2 (shifts of up to 15 px), most of it hidden; an estate of equal "
        "houses every 18 x 24 m (36 x 48 px, within the search), on gardens of the town's texture or on nearly "
        "plain ground; the town with the sun at 105, 152 and 245 degrees of azimuth and 28, 48 and 32 degrees "
        "high, with the shadows that belong to it; the town with fields of 45 m of another brightness, half of "
        "them with inverted contrast, in the second and third image. What is left that could be observed, px "
        "(median / largest); or the sentence that it stops with.",
        table(["scene", "ties", "median residual, px", "left, px", "why this model, or why it stopped"], rows),
    ]


# 5 --------------------------------------------------------------------------------------------------------------

_COST = """
import json, os, resource, sys, time
from benchmarks.pointing import Scene, pointed, replace
from repm_qgis.sfm import keypoints

def main():
    if {detector!r} != "opencv":
        keypoints.best_detector = lambda parameters: keypoints.ColmapSift("cpu")
    scene = replace(Scene.load({scene!r}), refinement="polynomial")
    wall, before = time.perf_counter(), os.times()
    found = pointed(scene)
    wall, after = time.perf_counter() - wall, os.times()
    cpu = sum(after[:4]) - sum(before[:4])
    # Not getrusage's, which begins with the memory of the process that started this one.
    own = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
    child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(json.dumps(dict(wall=wall, cpu=cpu, own=own / 1024, child=child / 1024, ties=len(found.tracks),
                          after=found.figures.after_px, pairs=found.figures.to_mapping()["pairs"],
                          pointing={{name: A.tolist() for name, A in found.adjusted.pointing.items()}})))

if __name__ == "__main__":
    main()
"""


def cost(images: Sequence[str], detector: str = "opencv") -> Dict[str, Any]:
    """Ties and adjustment of a scene in a process of its own: wall and CPU seconds, MiB of itself and of a worker.

    ``detector`` is opencv or colmap, both on the CPU.
    """
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "cost.py"
        script.write_text(_COST.format(scene=str(fitted(images, Path(folder) / "w").path), detector=detector))
        done = subprocess.run(
            [sys.executable, str(script)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
    return json.loads(done.stdout.strip().splitlines()[-1])


def costs() -> List[str]:
    """Point 5: what it costs."""
    rows = []
    data = SHARED / "pleiades_triplet"
    if data.exists():
        found = cost([str(data / f"img_0{i}.tif") for i in (1, 2, 3)])
        rows.append(["pleiades_triplet", *_cost_row(found), "6 s, 1024 MiB"])
    spec = SceneSpec(
        "mountains", BIG, 11, ZY3, cell_m=5.0, surface_step=2, base_m=300.0, relief_m=800.0, lon=6.65, lat=44.38
    )
    folder = simulated(f"zy3_{BIG}", spec)
    found = cost([str(folder / f"img_0{i}.tif") for i in (1, 2, 3)])
    rows.append([f"3 x {BIG} x {BIG} (ZY-3 simulated)", *_cost_row(found), "30 s, 1024 MiB"])
    return [
        f"**5. Cost** of ties and adjustment, on {len(os.sched_getaffinity(0))} cores that others used too (load "
        f"{os.getloadavg()[0]:.1f}); memory of the process plus, where there are worker processes, of as many "
        "of the largest.",
        table(["scene", "ties", "median residual, px", "wall, s", "CPU, s", "memory, MiB", "bar"], rows),
    ]


def _cost_row(found: Dict[str, Any]) -> List[Any]:
    workers = len(os.sched_getaffinity(0)) if found["child"] > 100 else 0
    return [
        found["ties"],
        found["after"],
        found["wall"],
        found["cpu"],
        f"{found['own'] + workers * found['child']:.0f}",
    ]


# Detectors --------------------------------------------------------------------------------------------------------


def detectors() -> List[str]:
    """OpenCV's SIFT and COLMAP's, both on the CPU."""
    scenes: List[Tuple[str, List[str], Optional[Case]]] = [
        (name, [str(SHARED / name / f"img_0{i + 1}.tif") for i in range(count)], None)
        for name, count in (("truth_urban", 2), ("pleiades_triplet", 3))
        if (SHARED / name).exists()
    ]
    for label, made in (("town", town()), ("hills", hills())):
        case = Case(made, known_pointings("shift"), CACHE / f"{label}_shift")
        scenes.append((label, case.images, case))
    rows = []
    for label, images, case in scenes:
        for detector in ("opencv", "colmap"):
            found = cost(images, detector)
            left = (
                ""
                if case is None
                else float(np.median(case.observable_px({name: np.array(A) for name, A in found["pointing"].items()})))
            )
            rows.append(
                [
                    label,
                    detector,
                    sum(pair["candidates"] for pair in found["pairs"]),
                    found["ties"],
                    float(np.mean([pair["after_px"] for pair in found["pairs"]])),
                    left,
                    found["cpu"],
                    f"{found['own']:.0f}",
                ]
            )
    return [
        "**Detectors**: SIFT of OpenCV and of COLMAP (pycolmap, VLFeat's code), both on the CPU with the same "
        "budget of keypoints; ties and adjustment together, CPU seconds of all threads. Left: where observable, "
        "shifts of up to 15 px. COLMAP's gives somewhat more ties of the same quality for more time and memory, so "
        "OpenCV's is the default on the CPU. COLMAP's on a GPU was not measured: there was none.",
        table(
            [
                "scene",
                "SIFT of",
                "matches",
                "ties",
                "row residual, px (median, mean of pairs)",
                "left, px",
                "CPU, s",
                "memory, MiB",
            ],
            rows,
        ),
    ]


# COLMAP -----------------------------------------------------------------------------------------------------------


def two_routes() -> List[str]:
    """The adjustment against the RPCs, and COLMAP's of principal points: figures of both, and their DSMs."""
    rows = []
    for label, made in (("town", town()), ("hills", hills())):
        case = Case(made, known_pointings("shift"), CACHE / f"{label}_shift")
        scene = case.scene()
        found = pointed(scene, model="shift")
        start = time.process_time()
        other = adjust_colmap(scene, found.tracks, Silent())
        colmap_s = time.process_time() - start
        start = time.process_time()
        adjust(load_views(tuple(case.images)), found.tracks, sum(scene.altitudes) / 2, "shift")
        rpc_s = time.process_time() - start
        apart = max(float(np.abs(other.shifts[n] - found.adjusted.shifts[n]).max()) for n in other.shifts)
        with tempfile.TemporaryDirectory() as folder:
            paths = [route_dsm(case.images, Path(folder) / route, route) for route in ("rpc", "colmap")]
            error = difference(*paths)
        rows.append(
            [
                label,
                *(f"{case.observable_px(a.pointing).max():.3f}" for a in (found.adjusted, other)),
                apart,
                float(np.nanmedian(error)),
                float(np.nanmedian(np.abs(error))),
                rpc_s,
                colmap_s,
            ]
        )
    return [
        "**Both routes**: against the original RPCs (the default), and the paper's: COLMAP's bundle adjustment of "
        "principal points only. Bar: their DSMs differ by less than 0.05 m (median).",
        table(
            [
                "scene",
                "left where observable, RPC route, px",
                "COLMAP route, px",
                "largest difference of shifts, px",
                "DSM difference, median, m",
                "median of absolute, m",
                "RPC route, CPU s",
                "COLMAP route, CPU s",
            ],
            rows,
        ),
    ]


def route_dsm(images: Sequence[str], folder: Path, route: str) -> str:
    made = run_stage("epmfit", {"images": list(images), "workspace": str(folder)}, Silent())
    made = run_stage(
        "reconstruct",
        {"scene": made["scene"], "output_scene": str(folder / "r.json"), "pointing": "shift", "adjustment": route},
        Silent(),
    )
    return run_stage(
        "dsmfuse", {"scene": made["output_scene"], "output": str(folder / "dsm.tif"), "resolution": 0.5}, Silent()
    )["output"]


# 6 --------------------------------------------------------------------------------------------------------------


def scene_of_rpcs(files: Sequence[Path]) -> Scene:
    """A scene of full images that are not there: RPCs, times from the files' names, one tile over what all overlap."""
    views = []
    for path in files:
        rpc = read_rpc_file(str(path))
        taken = moment(time_of_name(path.name.partition("__")[2] or path.name))
        views.append(
            View(
                path.stem[-8:],
                "",
                1,
                round(2 * rpc.col_off),
                round(2 * rpc.row_off),
                rpc,
                0.7,
                acquired=taken.isoformat() if taken else "",
            )
        )
    lon, lat = (float(np.median([getattr(view.rpc, name) for view in views])) for name in ("lon_off", "lat_off"))
    crs, middle = utm_crs(lon, lat), float(np.median([view.rpc.height_off for view in views]))
    area = seen_twice([[projected_from_geodetic(crs, footprint(v.localise, v.size, middle)) for v in views]])
    tile = Tile("r000c000", bounds_of(area), (middle - 50, middle + 50), {view.name: None for view in views})
    return Scene(views, EnuFrame(lon, lat), crs, area.ExportToWkt(), tile.altitudes, [tile])


def pair_selection() -> List[str]:
    """Point 6: which of the 136 pairs of 17 views are matched."""
    files = sorted((SHARED / "rpc" / "pleiades").glob("melbourne__*.XML"))
    if not files:
        return [f"Pair selection: not measured, '{SHARED / 'rpc' / 'pleiades'}' is absent."]
    scene = scene_of_rpcs(files)
    start = time.process_time()
    pairs = choose_pairs(scene)
    seconds = time.process_time() - start
    every = [
        convergence(a, b, scene.frame.lon, scene.frame.lat, sum(scene.altitudes) / 2)
        for a, b in combinations(scene.views, 2)
    ]
    good = POINTING.pairs
    out = sum(ratio < good.narrow for _, ratio in every), sum(ratio > good.wide for _, ratio in every)
    slanting = max(ratio for angle, ratio in every if angle < 8)
    count = [sum(view.name in (pair.first, pair.second) for pair in pairs) for view in scene.views]
    rows = [
        [
            pair.first,
            pair.second,
            pair.angle_deg,
            pair.base_to_height,
            100.0 * pair.share,
            apart_text(pair.days),
            pair.sun_deg,
            pair_cost(pair),
        ]
        for pair in pairs
    ]
    return [
        f"**6. Pair selection**: the RPCs of {len(files)} full Pleiades scenes of Melbourne, one pass (times from "
        f"the files' names). Of {len(every)} pairs ({min(a for a, _ in every):.1f} to "
        f"{max(a for a, _ in every):.1f} degrees; {out[0]} too narrow, {out[1]} too wide) {len(pairs)} are "
        f"matched, {min(count)} to {max(count)} a view, in {seconds:.2f} CPU s. Score: what speaks against a pair "
        f"([method](method.md#pairs)). Slanting looks less than 8 degrees apart have B/H up to {slanting:.2f}: "
        "hence the score by the angle.",
        table(
            [
                "first",
                "second",
                "convergence, degrees",
                "B/H",
                "of the area, %",
                "taken apart",
                "between the suns, degrees",
                "score",
            ],
            rows,
        ),
    ]


PARTS: Dict[str, Callable[[], List[str]]] = {
    "urban": truth_urban,
    "known": known_errors,
    "triplet": triplet,
    "poor": poor_scenes,
    "cost": costs,
    "detectors": detectors,
    "routes": two_routes,
    "pairs": pair_selection,
}


def main() -> int:
    gdal.UseExceptions()
    chosen = sys.argv[1:]
    parts = [text for name, part in PARTS.items() if not chosen or name in chosen for text in part()]
    if chosen:
        print("\n\n".join(parts))
    else:
        publish("pointing", "Where the images really look", "make bench-pointing", parts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
