"""Registration: simulated scenes against references of every kind, real images against lidar and S2P, and the cost."""

from __future__ import annotations

import functools
import json
import shutil
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal
from scipy import ndimage

from benchmarks.corrected_rpcs import corrected_rpcs
from benchmarks.runner import ROOT, Cost, few, is_quick, measured, pipeline, stage, there
from benchmarks.scenes import CACHE, SHARED, Scene, absent, real, simulated, zy3
from benchmarks.scoring import difference
from benchmarks.tables import Section, table
from benchmarks.towns import quick_area
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.stages import DSMFUSE, REGISTER
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.fusion.own_surface import own_surface
from repm_qgis.geometry.cell_grid import CellGrid
from repm_qgis.geometry.tiles import enclosing
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.imagery.raster import write
from repm_qgis.planning.promises import promised
from repm_qgis.registration.found import FoundHeights
from repm_qgis.registration.laying import OwnSurface, are_coarse, factor_for, finest_cell, lay
from repm_qgis.registration.parameters import REGISTRATION
from repm_qgis.registration.solve import Prior
from repm_qgis.registration.surfaces import Reference, SupportMeans
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene as SceneFile
from repm_qgis.simulation.scene import SceneSpec
from repm_qgis.simulation.sensor import PLEIADES

_WRONG_M = 20.0  # how far a scene is put away from its place
_SEEDS = 30


def _specs() -> Dict[str, SceneSpec]:
    """Mountains and hills of 3.2 km at 2 m, and a flat town of 0.8 km at 0.5 m."""
    mountains = replace(SceneSpec.default("mountains", 1600, 5), sensor=PLEIADES.at_gsd(2.0), cell_m=2.0)
    return {
        "mountains": replace(mountains, relief_m=900.0),
        "hills": replace(mountains, relief_m=150.0, seed=6),
        "town": SceneSpec.default("urban", 1600, 5),
    }


@dataclass(frozen=True)
class Case:
    """A reconstructed scene: its own surface in cells, the true one, and by how much its DSM is off (m)."""

    scene: SceneFile
    truth: np.ndarray
    place: Tuple[float, ...]
    off: np.ndarray
    prior: Prior

    def surface(self, found: FoundHeights) -> OwnSurface:
        bounds, native = enclosing([tile.bounds for tile in self.scene.tiles]), 2.0 * self.scene.gsd_m
        coarse = are_coarse([found], native)
        finest = finest_cell(bounds, 2.0 * native if coarse else native)
        whole = OwnSurface(self.scene.crs, *_surface(self.scene, finest, coarse))
        return whole.averaged(factor_for([found], finest), REGISTRATION.covered)

    def means(self, cells: int) -> Tuple[np.ndarray, np.ndarray]:
        """(N, 2) centres and (rows, columns) means of the truth over blocks of cells."""
        rows, columns = (n // cells for n in self.truth.shape)
        blocks = self.truth[: rows * cells, : columns * cells].reshape(rows, cells, columns, cells).mean(axis=(1, 3))
        x0, step, _, y0, _, _ = self.place
        x, y = np.meshgrid(x0 + (np.arange(columns) + 0.5) * cells * step, y0 - (np.arange(rows) + 0.5) * cells * step)
        return np.column_stack([x.ravel(), y.ravel()]), blocks


_surfaces: Dict[Any, Tuple[CellGrid, np.ndarray]] = {}


def _surface(scene: SceneFile, cell: float, coarse: bool) -> Tuple[CellGrid, np.ndarray]:
    key = str(scene.path), cell, coarse
    if key not in _surfaces:
        _surfaces[key] = own_surface(scene, cell, 0, memory=0, progress=Silent(), coarse=coarse)
    return _surfaces[key]


@functools.lru_cache(maxsize=4)
def case_of(name: str) -> Case:
    """A simulated scene, reconstructed once; where its DSM really lies is measured with the whole true surface."""
    spec = _specs()[name]
    made: Scene = simulated(f"registration_{name}", spec, spec.cell_m)
    folder = CACHE / f"{made.name}_reconstructed"
    if not (folder / "dsm.tif").exists():
        pipeline(made.images, folder, resolution=spec.cell_m)
    scene = SceneFile.load(str(folder / "w" / "reconstructed.json"))
    aligned = score_files(str(folder / "dsm.tif"), made.reference, "3d").alignment
    dataset = gdal.Open(made.reference)
    truth, place = dataset.ReadAsArray().astype(np.float64), dataset.GetGeoTransform()
    nodata = dataset.GetRasterBand(1).GetNoDataValue()
    truth = np.where(truth == nodata, np.nan, truth) if nodata is not None else truth
    horizontal, up = promised(scene.views)
    circle = REGISTRATION.search * 2.146 * horizontal
    prior = Prior(horizontal, up, max(circle, REGISTRATION.least_search_m))
    return Case(scene, truth, place, np.array([aligned.dx, aligned.dy, aligned.dz]), prior)


def _correlated(rng: np.random.Generator, shape: Tuple[int, ...], metres: float, cells: float) -> np.ndarray:
    found = ndimage.gaussian_filter(rng.normal(size=shape), cells, mode="wrap")
    return found / found.std() * metres


def dem(case: Case, rng: np.random.Generator) -> FoundHeights:
    """Cells of 30 m with noise of 1.5 m RMS, correlated over some 60 m."""
    cells = round(30.0 / case.place[1])
    xy, height = case.means(cells)
    height = height + _correlated(rng, height.shape, 1.5, 1.5)
    down, right = np.gradient(height, cells * case.place[1])
    slopes = np.column_stack([right.ravel(), -down.ravel()])
    width = cells * case.place[1]
    return FoundHeights("dem", xy, height.ravel(), (width, width), slopes=slopes)


def lasers(case: Case, rng: np.random.Generator) -> FoundHeights:
    """2000 discs of 12 m along six tracks, with noise of 0.2 m."""
    x0, step, _, y0, _, _ = case.place
    rows, columns = case.truth.shape
    track = rng.uniform(0.05, 0.95, 6)[rng.integers(0, 6, 2000)]
    along = rng.uniform(0.02, 0.98, 2000)
    x = x0 + (track * columns + 0.08 * along * rows) % columns * step
    y = y0 - along * rows * step
    disc = Reference("", np.empty((0, 3)), (12.0, 12.0), True)
    means = SupportMeans(CellGrid(x0, y0, step, (rows, columns)), case.truth, disc, 0.99)
    height = means.at(x, y)[0] + rng.normal(size=2000) * 0.2
    known = np.isfinite(height)
    return FoundHeights("lasers", np.column_stack([x, y])[known], height[known], (12.0, 12.0), True)


def lidar(case: Case, rng: np.random.Generator) -> FoundHeights:
    """Cells of the true surface with noise of 0.1 m, averaged as a file's would be."""
    finest = finest_cell(case.scene.tiles[0].bounds, 2.0 * case.scene.gsd_m)
    cells = max(1, int(np.ceil(REGISTRATION.averaged_cells * finest / case.place[1] - 1e-6)))
    noisy = replace(case, truth=case.truth + rng.normal(size=case.truth.shape) * 0.1)
    xy, height = noisy.means(cells)
    width = cells * case.place[1]
    down, right = np.gradient(height, width)
    slopes = np.column_stack([right.ravel(), -down.ravel()])
    return FoundHeights("lidar", xy, height.ravel(), (width, width), slopes=slopes)


REFERENCES: Dict[str, Callable[[Case, np.random.Generator], FoundHeights]] = {
    "DEM of 30 m, noise 1.5 m": dem,
    "2000 laser discs of 12 m, noise 0.2 m": lasers,
    "lidar cells, noise 0.1 m": lidar,
}


def trial(case: Case, make: Callable[[Case, np.random.Generator], FoundHeights], seed: int) -> Tuple[object, ...]:
    """The error (m east, north, up), the claimed deviations, and how many directions were determined."""
    rng = np.random.default_rng(seed)
    away = rng.uniform(-1.0, 1.0, 3) * _WRONG_M
    found = make(case, rng)
    known = np.isfinite(found.height)
    slopes = None if found.slopes is None else found.slopes[known]
    found = replace(found, xy=found.xy[known], height=found.height[known], slopes=slopes)
    surface = case.surface(found)
    grid = replace(surface.grid, west=surface.grid.west + away[0], north=surface.grid.north + away[1])
    surface = replace(surface, grid=grid, height=surface.height + np.float32(away[2]))
    shift = lay(surface, found, HeightDatum.of(""), prior=case.prior, tilted=False, check=lambda: None).shift
    return shift.moved - (case.off - away), shift.deviations, len(shift.determined)


def simulated_scenes() -> List[str]:
    rows = []
    for name in few(list(_specs())):
        case = case_of(name)
        for label, make in few(list(REFERENCES.items())):
            found = [trial(case, make, seed) for seed in range(3 if is_quick() else _SEEDS)]
            error, claimed = (np.array([each[k] for each in found]) for k in (0, 1))
            determined = [each[2] for each in found]
            whole = np.array(determined) == 2
            use = whole if whole.any() else np.ones(len(found), dtype=bool)
            horizontal = np.hypot(error[use, 0], error[use, 1])
            near = np.abs(error[use]) < claimed[use]
            told = 100.0 * (near if whole.any() else near[:, 2:]).mean()
            flat = [f"{np.sqrt((horizontal**2).mean()):.3f}", f"{horizontal.max():.3f}"] if whole.any() else ["-", "-"]
            rms, most = np.sqrt((error[:, 2] ** 2).mean()), np.abs(error[:, 2]).max()
            sigma = np.sqrt((claimed[use] ** 2).mean(axis=0))
            rows.append([name, label, f"{int(whole.sum())} of {len(found)}", *flat, f"{rms:.3f}", f"{most:.3f}"])
            rows[-1] += [f"{np.hypot(*sigma[:2]):.3f}", f"{sigma[2]:.3f}", f"{told:.0f}"]
    headers = (
        "scene | reference | position determined | horizontal error, RMS m | largest | height error, RMS m | largest | "
        "claimed horizontally, m | claimed in height, m | within one deviation, %"
    )
    return [
        f"**1. Simulated scenes**, reconstructed from RPCs that are wrong, then put away by up to {_WRONG_M:g} m in "
        f"each direction; {_SEEDS} seeds of that and of the references' noise. Mountains (900 m of relief) and hills "
        "(150 m): 3 x 1600 px of 2 m; town: 3 x 1600 px of 0.5 m. The error is that of the shift which is found, where "
        "the right one is known from a 3-D alignment with the whole true surface. Bars: DEM below 1.5 m horizontally "
        "and 0.4 m in height on hills and mountains, lasers 0.8 and 0.15 m, lidar 0.1 and 0.05 m; 68 % within one "
        "deviation; a flat town against a DEM: height fixed, position declared undetermined.",
        table(headers, rows),
    ]


_TOWNS = (("001", "002", "003"), ("009", "010", "011"))


def town() -> List[str]:
    """Real WorldView-3 images against lidar."""
    folder, rows = SHARED / "jax_068", []
    truth = folder / "truth_west.tif"
    if not truth.exists():
        return [f"**2. jax_068** was not measured: absent from '{SHARED}'."]
    for views in few(_TOWNS):
        images = [str(folder / f"JAX_068_{view}_RGB.tif") for view in views]
        with tempfile.TemporaryDirectory() as place:
            for label, more in (("as delivered", {}), ("registered", {"reference": [str(truth)]})):
                made = pipeline(images, f"{place}/{label}", resolution=0.5, **quick_area(), **more)
                for how in ("none", "3d"):
                    found = score_files(made.output, str(truth), how)
                    aligned = "3-D aligned" if how == "3d" else ""
                    share = dict(found.metrics.completeness)[1.0]
                    rows.append([" + ".join(views), label, aligned, share, found.metrics.rmse, found.metrics.bias])
    return [
        "**2. jax_068**: three WorldView-3 images of a town, registered to `truth_west.tif`, whose datum is found from "
        "the fit. Bar: C1 without alignment within 2 points of the 3-D aligned one.",
        table("images | scene | before comparing | C1, % | RMSE, m | bias, m", rows),
    ]


def against_s2p() -> List[str]:
    """The real pair and triplet against S2P's DSM in cells of 30 m."""
    rows = []
    for scene in few(real("pleiades_pair", "pleiades_triplet")):
        with tempfile.TemporaryDirectory() as folder:
            coarse = f"{folder}/s2p_30m.tif"
            gdal.Warp(
                coarse, scene.reference, xRes=30.0, yRes=30.0, resampleAlg="average", srcNodata="nan", dstNodata="nan"
            )
            more = {"reference": [coarse], "reference_datum": "ellipsoid"}
            made = pipeline(scene.images, folder, resolution=scene.resolution, **more)
            left = score_files(made.output, scene.reference, "3d").alignment
            figures = there(SceneFile.load(made.scene).registration)
            horizontal = float(np.hypot(*figures.deviation[:2]))
            told = len(figures.determined)
            rows.append([scene.name, np.hypot(left.dx, left.dy), left.dz, horizontal, figures.deviation[2], told])
    headers = (
        "images | left horizontally, m | left in height, m | claimed horizontally, m | claimed in height, m | "
        "directions determined"
    )
    return [
        "**3. Real pair and triplet** registered to S2P's DSM averaged to 30 m; what a 3-D alignment with S2P's whole "
        "DSM still finds. Bars: 1 m and 0.3 m.",
        table(headers, rows),
        *absent("pleiades_pair", "pleiades_triplet"),
    ]


def _register(scene: str, reference: str, output: str) -> None:
    stage(REGISTER, scene=scene, reference=[reference], reference_datum="ellipsoid", output_scene=output)


def _cost(name: str, options: Dict[str, object], folder: str) -> Cost:
    """What a stage takes as a program, with all its workers."""
    job = f"{folder}/{name}.json"
    Path(job).write_text(json.dumps(options), encoding="utf-8")
    return measured([sys.executable, "-m", "repm_qgis", name, job], str(ROOT))[1]


def cost() -> List[str]:
    """What registration to a DEM of 30 m adds to a large scene.

    The noise of two whole runs is as large as the registration, so the whole is run once, and then what follows the
    matching is run again, without and with the reference in turn.
    """
    if is_quick():
        scene = simulated("registration_hills", _specs()["hills"], 2.0)
    else:
        scene = simulated("zy3_1500m", zy3(5120, 1500.0), 5.0)
    with tempfile.TemporaryDirectory() as folder:
        coarse = f"{folder}/dem.tif"
        gdal.Warp(coarse, scene.reference, xRes=30.0, yRes=30.0, resampleAlg="average")
        place = Path(folder, "run")
        ends = {"workspace": str(place), "output": str(place / "dsm.tif")}
        options = {"images": list(scene.images), "resolution": scene.resolution, **ends}
        whole = _cost("pipeline", options, folder).cpu_s
        registered = {"reference": [coarse], **_DATUM}
        pairs = [
            tuple(_again({**options, **more}, place, folder) for more in ({}, registered))
            for _ in range(1 if is_quick() else 5)
        ]
    added = [more - less for less, more in pairs]
    mean, least, most = sum(added) / len(added), min(added), max(added)
    row = [f"{scene.name}, 3 x {scene.made.size} px", whole, mean, f"{least:.1f} .. {most:.1f}", 100.0 * mean / whole]
    return [
        "**5. Cost** of registering a scene to a DEM of 30 m: a run of the whole pipeline as a program with its "
        "workers, and what it takes more with REFERENCE, from pairs of runs that take up the matched heights. Bar: "
        "5 % of the CPU.",
        table("scene | whole run, CPU s | added, CPU s | least .. most | added, %", [row]),
    ]


def _again(options: Dict[str, object], place: Path, folder: str) -> float:
    """CPU seconds of a run that finds the matched heights in its workspace, and nothing that comes after them."""
    for path in (*place.glob("dsm*"), *place.glob("registered*")):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return _cost("pipeline", options, folder).cpu_s


def strips() -> List[str]:
    """Four scenes that overlap, each with another wrong place, registered together."""
    case = case_of("hills")
    images = [str(view.image) for view in case.scene.views]
    x0, y0, x1, y1 = case.scene.tiles[0].bounds if len(case.scene.tiles) == 1 else enclosing(_boxes(case.scene))
    middle, half = (0.5 * (x0 + x1), 0.5 * (y0 + y1)), 0.07
    width, height = x1 - x0, y1 - y0
    rng, rows = np.random.default_rng(1), []
    with tempfile.TemporaryDirectory() as folder:
        scenes = []
        for number, (right, up) in enumerate(np.ndindex(1 if is_quick() else 2, 2)):
            west, east = (middle[0] - half * width, x1) if right else (x0, middle[0] + half * width)
            south, north = (middle[1] - half * height, y1) if up else (y0, middle[1] + half * height)
            where = {"extent": [west, south, east, north], "extent_crs": case.scene.crs}
            made = pipeline(images, f"{folder}/{number}", resolution=case.place[1], **where)
            place = rng.uniform(-1.0, 1.0, 3) * (8.0, 8.0, 8.0)
            wrong = _moved_truth(case, place, f"{folder}/wrong_{number}.tif")
            scenes.append(f"{folder}/{number}/w/wrong.json")
            _register(made.scene, wrong, scenes[-1])
        coarse = f"{folder}/dem.tif"
        _noisy_dem(case, coarse)
        ways: List[Tuple[str, Optional[Dict[str, List[str]]]]] = [
            ("as delivered", None),
            ("each alone, on a DEM of 30 m", {"reference": [coarse]}),
            ("together", {"others": scenes[1:]}),
            ("together, on a DEM of 30 m", {"reference": [coarse], "others": scenes[1:]}),
        ]
        for label, more in ways[-1 if is_quick() else 0 :]:
            paths = list(scenes)
            if more is not None and "others" in more:
                first = stage(REGISTER, scene=scenes[0], output_scene=f"{folder}/first.json", **_DATUM, **more)
                paths = [first.output_scene, *first.other_scenes]
            elif more is not None:
                outputs = [f"{folder}/alone_{number}.json" for number in range(len(scenes))]
                paths = [
                    stage(REGISTER, scene=scene, output_scene=output, **_DATUM, **more).output_scene
                    for scene, output in zip(scenes, outputs)
                ]
            dsms = [f"{folder}/{label.replace(' ', '_')}_{number}.tif" for number in range(len(paths))]
            for path, dsm in zip(paths, dsms):
                stage(DSMFUSE, scene=path, output=dsm, resolution=case.place[1])
            seams = [difference(a, b, case.place[1]) for i, a in enumerate(dsms) for b in dsms[i + 1 :]]
            apart = np.concatenate([seam[np.isfinite(seam)] for seam in seams])
            rows.append([label, float(np.median(np.abs(apart))), float(np.abs([np.nanmedian(s) for s in seams]).max())])
    return [
        "**6. Four scenes that overlap** by 14 % of the hills' width, each put to another place within 8 m. Difference "
        "of their DSMs where two overlap. Bar: 0.3 m median.",
        table("scenes | median of absolute differences, m | largest median of two scenes, m", rows),
    ]


_DATUM = {"reference_datum": "ellipsoid"}


def _boxes(scene: SceneFile) -> List[Bounds]:
    return [tile.bounds for tile in scene.tiles]


def _moved_truth(case: Case, moved: np.ndarray, path: str) -> str:
    """The true surface, elsewhere."""
    place = list(case.place)
    place[0], place[3] = place[0] + moved[0], place[3] + moved[1]
    return _written(case, case.truth + moved[2], place, path)


def _noisy_dem(case: Case, path: str) -> str:
    rng, cells = np.random.default_rng(2), round(30.0 / case.place[1])
    _, height = case.means(cells)
    place = [case.place[0], case.place[1] * cells, 0.0, case.place[3], 0.0, case.place[5] * cells]
    return _written(case, height + _correlated(rng, height.shape, 1.5, 1.5), place, path)


def _written(case: Case, heights: np.ndarray, place: Sequence[float], path: str) -> str:
    wkt = pyproj.CRS.from_user_input(case.scene.crs).to_wkt()
    return write(path, [heights.astype(np.float32)], place, wkt, unit="m")


PARTS = {
    "simulated": simulated_scenes,
    "town": town,
    "s2p": against_s2p,
    "rpcs": corrected_rpcs,
    "cost": cost,
    "strips": strips,
}
SECTIONS = [Section("registration", "Registration to a reference", "make bench-registration", PARTS)]
