"""Bare earth against truth: a simulated town and hills, a real town with lidar, and other libraries beside it."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Protocol, Tuple

import numpy as np
from scipy import ndimage

from benchmarks import registration, towns
from benchmarks.runner import ROOT, Failed, few, measured, pipeline
from benchmarks.scenes import CACHE, SHARED, default, made_once, simulated
from benchmarks.tables import table
from repm_qgis.contracts.stages import DTM
from repm_qgis.evaluation.coregistration import Alignment
from repm_qgis.evaluation.grids import Grid, HeightWarper
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.imagery.raster import opened, read, write
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.scene import make_views, surface_bounds
from repm_qgis.simulation.surface import Ground
from repm_qgis.simulation.town import Town
from repm_qgis.stages import run_stage
from repm_qgis.stages.parameters import ENGINE

_PYTHON = os.environ.get("REPM_TERRAIN_PYTHON", "")  # has bulldozer-dtm, cloth-simulation-filter and rasterio
_NO_WALLS = replace(ENGINE, terrain=replace(ENGINE.terrain, objects=replace(ENGINE.terrain.objects, wall_share=0.0)))
_MOST_CELLS = {"bulldozer": 20e6, "cloth": 1e6}  # of a DSM: more take a library many minutes
_HILL_M, _WAVE_M = 25.0, 300.0  # hills that are added to the town: slopes of up to 52 %
_INNER_CELLS = 2  # within the class of the lidar: its rim has heights of the roof beside it
_OWN_CELLS = 11  # of 0.5 m, the side of the windows in which the lidar's own ground is looked for
_OWN_M = 1.0  # what the lidar calls ground and is farther from its own ground is a car, a wall or the rim of a roof
_TALL_M, _CORE_CELLS = 2.0, 10  # of simulated buildings: no tree holds a diamond of 5 m on each side


class OnCells(Protocol):
    """A DSM with its confidence, and a raster on whose cells the truth is."""

    @property
    def dsm(self) -> str: ...

    @property
    def confidence(self) -> str: ...

    @property
    def reference(self) -> str: ...


@dataclass(frozen=True)
class Case:
    """A DSM with its confidence, and the truth on the cells of ``reference``: the ground, where it can be seen, where
    buildings stand (None: there are none) and how high they are (None: not known). ``added`` (m, on the DSM's cells) is
    what was added to the DSM. ``lidar``: the truth is that of lidar."""

    name: str
    dsm: str
    confidence: str
    reference: str
    ground: np.ndarray
    seen: np.ndarray
    buildings: Optional[np.ndarray] = None
    tall: Optional[np.ndarray] = None
    added: Optional[np.ndarray] = None
    lidar: bool = False


def _dsm(name: str, images: Any, resolution: float) -> Path:
    """A DSM with its confidence by default settings, kept in the cache."""
    folder = CACHE / f"terrain_{name}"
    confidence = str(folder / "confidence.tif")
    return made_once(folder, lambda: pipeline(images, folder, resolution=resolution, confidence=confidence))


def _bare(scene: Any) -> Tuple[np.ndarray, np.ndarray]:
    """The true surface of a simulated town, and its ground without what stands on it, on the truth's cells."""
    spec = scene.made
    nodes = Ground.empty(surface_bounds(spec, make_views(spec)), spec.cell_m / spec.surface_step)
    Town(nodes, spec.base_m, spec.seed, Silent())._open_ground()
    with opened(scene.reference) as dataset:
        surface, (west, cell, _, north, _, _) = read(dataset), dataset.GetGeoTransform()
    col, row = (round(d / nodes.cell) for d in (west + cell / 2 - nodes.west, nodes.north - north + cell / 2))
    step = spec.surface_step
    rows, columns = surface.shape
    return surface, nodes.height[row : row + step * rows : step, col : col + step * columns : step]


def _town(size: int = 1600) -> Case:
    scene = default("urban", size, 4)
    folder = _dsm(scene.name, scene.images, 0.5)
    surface, bare = _bare(scene)
    tall = surface - bare
    core = ndimage.binary_opening(tall > _TALL_M, iterations=_CORE_CELLS)
    files = str(folder / "dsm.tif"), str(folder / "confidence.tif")
    return Case("town, 3 views of 0.5 m", *files, scene.reference, bare, tall < 0.05, core & (tall > _TALL_M), tall)


def _town_on_hills(folder: str) -> Case:
    """The town's DSM with hills added to all its heights."""
    flat = _town()
    with opened(flat.dsm) as dataset:
        heights, place, crs = read(dataset), dataset.GetGeoTransform(), dataset.GetProjection()
    rows, columns = np.indices(heights.shape) * (2 * np.pi * place[1] / _WAVE_M)
    added = (_HILL_M * np.sin(rows) * np.cos(columns)).astype(np.float32)
    path = write(f"{folder}/hilly.tif", [heights + added], place, crs, unit="m")
    name = f"the same, on hills of {2 * _HILL_M:g} m and up to 52 %"
    return replace(flat, name=name, dsm=path, added=added)


def _hills() -> Case:
    spec = registration._specs()["hills"]
    scene = simulated("registration_hills", spec, spec.cell_m)
    folder = _dsm(scene.name, scene.images, 1.0)
    with opened(scene.reference) as dataset:
        truth = read(dataset)
    files = str(folder / "dsm.tif"), str(folder / "confidence.tif")
    return Case("hills of 150 m, 3 views of 2 m", *files, scene.reference, truth, np.isfinite(truth))


def _own_ground(case: Case) -> np.ndarray:
    """Medians of the ground cells around each of them, and around the nearest one, m: a terrain by the lidar alone."""
    around = np.pad(np.where(case.seen, case.ground, np.nan), _OWN_CELLS // 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(around, (_OWN_CELLS, _OWN_CELLS))[case.seen]
    own = np.empty(case.ground.shape, np.float32)
    own[case.seen] = np.nanmedian(windows.reshape(len(windows), -1), axis=1)
    nearest = ndimage.distance_transform_edt(~case.seen, return_distances=False, return_indices=True)
    return np.asarray(own[tuple(nearest)])


def _lidar_itself() -> Case:
    """The lidar's own surface as a DSM, to be compared with its ground class."""
    folder = SHARED / "jax_068"
    truth = str(folder / "truth_west.tif")
    with opened(truth) as dataset, opened(str(folder / "classes_west.tif")) as kinds:
        heights, kind = read(dataset), read(kinds)
    return Case("`jax_068`, the lidar itself", truth, "", truth, heights, kind == 2, kind == 6, lidar=True)


def _lidar(count: int) -> Case:
    images = [str(SHARED / "jax_068" / f"JAX_068_{name}_RGB.tif") for name in towns._names()[:count]]
    made = _dsm(f"jax_068_{count}", images, 0.5)
    dsm, confidence = str(made / "dsm.tif"), str(made / "confidence.tif")
    return replace(_lidar_itself(), name=f"`jax_068`, {count} views", dsm=dsm, confidence=confidence)


def _cases(folder: str) -> List[Callable[[], Case]]:
    """The cases, which are made when they are called for."""
    found: List[Callable[[], Case]] = [_town, lambda: _town_on_hills(folder), _hills]
    real: List[Callable[[], Case]] = [lambda: _lidar(2), lambda: _lidar(19), _lidar_itself]
    return found + (real if (SHARED / "jax_068").exists() else [])


def _on_truth(path: str, case: OnCells, alignment: Alignment, added: Optional[np.ndarray] = None) -> np.ndarray:
    """A raster on the truth's cells, moved as the DSM has to be."""
    with opened(path) as dataset, opened(case.reference) as target:
        grid, cell = Grid.of(target), target.GetGeoTransform()[1]
        if added is not None:
            with tempfile.TemporaryDirectory() as folder:
                less = [read(dataset) - added]
                flat = write(f"{folder}/flat.tif", less, dataset.GetGeoTransform(), dataset.GetProjection(), unit="m")
                with opened(flat) as source:
                    values = HeightWarper(source, grid).read(grid)
        else:
            values = HeightWarper(dataset, grid).read(grid)
        return alignment.applied(values, (cell, cell))


def _ours(case: OnCells, folder: str, parameters: Any = ENGINE, **options: object) -> Tuple[str, str]:
    out = {"output": f"{folder}/dtm.tif", "heights": f"{folder}/heights.tif"}
    run_stage(DTM, {"dsm": case.dsm, "confidence": case.confidence or None, **out, **options}, Silent(), parameters)
    return out["output"], out["heights"]


def _medians(case: Case, folder: str) -> Tuple[str, str]:
    """The lidar's own ground, and what is above it."""
    own = _own_ground(case)
    with opened(case.reference) as dataset:
        place, crs = dataset.GetGeoTransform(), dataset.GetProjection()
    made = {"dtm": own, "heights": case.ground - own}
    dtm, heights = (write(f"{folder}/{name}.tif", [values], place, crs, unit="m") for name, values in made.items())
    return dtm, heights


def _theirs(name: str) -> Callable[[Case, str], Tuple[str, str]]:
    def made(case: Case, folder: str) -> Tuple[str, str]:
        with opened(case.dsm) as dsm:
            if dsm.RasterXSize * dsm.RasterYSize > _MOST_CELLS[name]:
                raise Failed("not measured: more cells than it does in minutes")
        script = str(ROOT / "benchmarks" / "terrain_libraries.py")
        measured([_PYTHON, script, name, case.dsm, f"{folder}/dtm.tif"], folder)
        with opened(case.dsm) as dsm, opened(f"{folder}/dtm.tif") as dtm:
            above = [read(dsm) - read(dtm)]
            place, crs = dsm.GetGeoTransform(), dsm.GetProjection()
        return f"{folder}/dtm.tif", write(f"{folder}/heights.tif", above, place, crs, unit="m")

    return made


def _share(above: np.ndarray, cells: Optional[np.ndarray]) -> Any:
    """How many of some cells stand higher than a metre, %; a dash where there are none."""
    found = above[cells & np.isfinite(above)] if cells is not None else above[:0]
    return 100.0 * float((found > 1.0).mean()) if found.size else "–"


def _scores(case: Case, terrain: str, heights: str) -> List[object]:
    """RMSE on all, inner and the lidar's own ground, mean error and NMAD; flagged cells of buildings and ground, %."""
    flat = case if case.added is None else _town()
    found = score_files(flat.dsm, case.reference, "3d").alignment
    error = _on_truth(terrain, case, found, case.added) - case.ground
    above = _on_truth(heights, case, replace(found, dz=0.0))
    seen = case.seen & np.isfinite(error)
    # In the simulation, ground is where nothing stands; the lidar's classes are wrong along walls.
    inner = ndimage.binary_erosion(case.seen, iterations=_INNER_CELLS, border_value=1) & np.isfinite(error)
    rmse: List[object] = [float(np.sqrt(np.mean(error[cells] ** 2))) for cells in (seen, inner)]
    rmse.append("–")
    if case.lidar:
        sound = seen & (np.abs(case.ground - _own_ground(case)) < _OWN_M)
        rmse[2] = float(np.sqrt(np.mean(error[sound] ** 2)))
    values = error[seen]
    spread = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    return [*rmse, float(error[inner].mean()), spread, _share(above, case.buildings), _share(above, seen)]


def terrain() -> List[str]:
    methods: Dict[str, Callable[..., Tuple[str, str]]] = {
        "`repm:dtm`": _ours,
        "openings alone (walls do not count)": lambda case, folder: _ours(case, folder, _NO_WALLS),
    }
    if _PYTHON:
        methods.update({"bulldozer-dtm": _theirs("bulldozer"), "cloth-simulation-filter": _theirs("cloth")})
    rows: List[List[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for make in few(_cases(folder)):
            case = make()
            alone: Dict[str, Callable[..., Tuple[str, str]]] = (
                {_PERFECT: _medians} if case.dsm == case.reference else {}
            )
            for name, method in {**methods, **alone}.items():
                start = time.monotonic()
                try:
                    made = method(case, folder)
                except Failed as error:
                    rows.append([case.name, name, *["–"] * 7, str(error)[:80]])
                    continue
                rows.append([case.name, name, *_scores(case, *made), time.monotonic() - start])
    rows.append(["–", "PDAL: SMRF", *["–"] * 7, "not measured: no package in Debian 12, no wheel on PyPI"])
    absent = [] if _PYTHON else ["The libraries were not measured: REPM_TERRAIN_PYTHON names no interpreter."]
    return [
        "**Bare earth** by default settings (LARGEST 150 m, SLOPE 40 %), from DSMs of the default pipeline that were "
        "aligned to the truth in 3-D. Ground: cells where nothing stands, and the lidar's ground class; *inner*: more "
        "than a metre inside it; *the lidar's own*: within a metre of the median of the ground class in the 5.5 m "
        f"around. {_hanging()}Flagged: higher than a metre above the terrain. Bar: RMSE of 0.5 m simulated, 0.6 m "
        "real, 1 m on hills, and 90 % of the cells of buildings.",
        table(
            "DSM | method | RMSE m, all ground | inner ground | the lidar's own | mean error m, inner | NMAD m | "
            "buildings flagged, % | ground flagged, % | s",
            rows,
        ),
        *absent,
        _LIBRARIES,
    ]


def _hanging() -> str:
    """What the lidar's ground class has that is no ground; nothing where there is no lidar."""
    if not (SHARED / "jax_068").exists():
        return ""
    case = _lidar_itself()
    off = (case.ground - _own_ground(case))[case.seen]
    return (
        f"{100.0 * float((np.abs(off) > _OWN_M).mean()):.1f} % of the cells of the lidar's ground class are farther "
        "from it: rims of roofs, walls and parked cars. So even these medians, which know the ground class, are more "
        "than a metre off on all ground (the last row of the lidar itself), and the bar is asked of the two other "
        "columns, whose cells the lidar alone chooses. "
    )


_PERFECT = "medians of the lidar's own ground class"
_LIBRARIES = (
    "Wheels for Linux, Windows and macOS: bulldozer-dtm 1.3.1 (Apache-2.0) for Python 3.10 and later, which needs "
    "rasterio with a GDAL of its own beside QGIS's, scikit-image and more; cloth-simulation-filter 1.1.7 (Apache-2.0) "
    "for 3.9 and later; PDAL has none on PyPI. None of them takes confidences."
)


def heights() -> List[str]:
    """Each building's median height against the true one."""
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for make in few(_cases(folder)[:2]):
            case = make()
            _, above = _ours(case, folder)
            flat = case if case.added is None else _town()
            alignment = replace(score_files(flat.dsm, case.reference, "3d").alignment, dz=0.0)
            found = _on_truth(above, case, alignment) - case.tall
            labels, count = ndimage.label(case.buildings)
            medians = np.array(
                [np.nanmedian(found[labels == n]) for n in range(1, count + 1) if (labels == n).sum() > 100]
            )
            off = np.abs(medians)
            near = [100.0 * float((off < limit).mean()) for limit in (0.5, 1.0)]
            rows.append([case.name, len(off), float(np.median(medians)), float(np.median(off)), *near])
    return [
        "**Heights of buildings** in the simulated town: each building's median difference from its true heights. Bar: "
        "a median error of 0.3 m.",
        table("DSM | buildings | median difference, m | median error, m | within 0.5 m, % | within 1 m, %", rows),
    ]
