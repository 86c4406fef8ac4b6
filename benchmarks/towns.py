"""Towns of many dates: nineteen WorldView-3 images of one of the DFC2019 sites, and a simulated town like it.

The simulated town is made with all that images of different dates differ by, then without one after the other. Its
rows are also those of an earlier revision's engine, that of REPM_BENCH_TOWNS_BEFORE.
"""

from __future__ import annotations

import csv
import os
import tempfile
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
from scipy import ndimage

from benchmarks import season_scenes
from benchmarks.runner import ROOT, earlier, few, is_quick, made_by, pipeline, say, stage
from benchmarks.scenes import CACHE, SHARED, default, made_once, middle_of, not_measured, real
from benchmarks.simulated.dates import WORLDVIEW3_JACKSONVILLE, DatedSpec, make_dated_scene
from benchmarks.simulated.parameters import DATED, REAL, EffectParameters
from benchmarks.tables import Section, table
from repm_qgis.contracts.options import QUALITIES
from repm_qgis.contracts.stages import DSMFUSE
from repm_qgis.evaluation import coregistration
from repm_qgis.evaluation.grids import Grid, HeightWarper
from repm_qgis.evaluation.metrics import THRESHOLDS_M, height_metrics
from repm_qgis.evaluation.scoring import score_files
from repm_qgis.imagery.heights import read_heights
from repm_qgis.imagery.raster import opened, read, write
from repm_qgis.runtime.progress import Silent
from repm_qgis.stages.parameters import ENGINE
from repm_qgis.ties.parameters import TIES

_FOLDER = SHARED / "jax_068"
_CLASSES = {"ground": 2, "trees": 5, "buildings": 6}
_JANUARY = ("009", "010", "011")
_COUNTS = (2, 3, 6, 12, 19)
_PUBLISHED = (
    "Published for this site, MAE / RMSE in m: S2P 1.6 to 2.1 / 4.6, EO-NeRF 1.2 to 1.6 / 2.2, EOGS 1.0 / 2.3, HLC-GS "
    "0.74 / 1.91; the paper's REPM RMSE 3.75, ME 0.26, C1 72.5 %. They are for the whole square, with other choices of "
    "images, other alignments and filled DSMs, and take minutes to hours of a GPU: the rows *FILL = all* are the ones "
    "to look at beside them, and none of the differences below 0.2 m means much."
)
_FIGURES = (
    "valid, % | C1, % | MAE, m | RMSE, m | MedAE, m | NMAD, m | C1 without mid-air, % | ground, % | trees, % | "
    "buildings, % | walls off, m | wider, m | CPU s"
)
_CONTRASTS = (0.019, 0.021, 0.0195, 0.0205, 0.01925, 0.02075, 0.01975, 0.02025)  # of keypoints, about the engine's
_STEP_M, _WINDOW_M = 3.0, 2.5  # a wall: the truth's heights differ by so much within a window of this side


def _names() -> List[str]:
    """The images' numbers in the order of their dates; of a quick run, the first four."""
    with open(_FOLDER / "acquisitions.csv", encoding="utf-8", newline="") as stream:
        names = [row["image"].split("_")[2] for row in csv.DictReader(stream)]
    return names[: 4 if is_quick() else None]


def images_of(names: Sequence[str]) -> List[str]:
    """The images' files by their numbers."""
    return [str(_FOLDER / f"JAX_068_{name}_RGB.tif") for name in names]


def _surroundings(truth: np.ndarray, cell: float) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The truth with its median in its gaps, and the highest and lowest of it in a wall's window around each cell."""
    side = int(round(_WINDOW_M / cell)) | 1
    filled = np.where(np.isfinite(truth), truth, np.nanmedian(truth))
    return filled, ndimage.maximum_filter(filled, side), ndimage.minimum_filter(filled, side)


def _walls(dsm: np.ndarray, truth: np.ndarray, cell: float) -> Tuple[float, float]:
    """How far the DSM's walls are from the truth's (mean, m), and by how much objects are too wide on each side (m).

    A wall is the border between what lies above and below the middle of the truth's heights around it.
    """
    _, top, bottom = _surroundings(truth, cell)
    near = (top - bottom > _STEP_M) & np.isfinite(truth) & np.isfinite(dsm)
    middle = (top + bottom) / 2
    high = [np.where(near, values > middle, False) for values in (truth, dsm)]
    borders = [(ndimage.maximum_filter(part, 3) != ndimage.minimum_filter(part, 3)) & near for part in high]
    # The outline of the walls' neighbourhood is no border of a surface.
    inside = ndimage.binary_erosion(near, iterations=2)
    borders = [border & inside for border in borders]
    distance = ndimage.distance_transform_edt(~borders[0]) * cell
    length = borders[0].sum() * cell / 2  # a border is two cells wide
    wider = (int(high[1].sum()) - int(high[0].sum())) * cell**2 / length
    return float(distance[borders[1]].mean()), float(wider)


@dataclass(frozen=True)
class Truth:
    """Heights of lidar, or simulated, and the classes of its cells."""

    heights: str
    classes: str


_LIDAR = Truth(str(_FOLDER / "truth_west.tif"), str(_FOLDER / "classes_west.tif"))


def _made(images: Sequence[str], folder: str, tree: Path = ROOT, **options: object) -> Tuple[str, float]:
    """The DSM that a checkout's pipeline makes, and its CPU seconds."""
    dsm, cost = made_by(tree, images, folder, **{"resolution": 0.5, **options})
    return dsm, cost.cpu_s


def _rows(label: str, names: Sequence[str]) -> List[List[object]]:
    """The DSM of some images with its holes, and with holes interpolated."""
    images = images_of(names)
    with tempfile.TemporaryDirectory() as folder:
        dsm, cost = _made(images, folder, **quick_area())
        full = stage(DSMFUSE, scene=f"{folder}/w/reconstructed.json", output=f"{folder}/full.tif", fill="all").output
        return [[label, "", *_scores(dsm, _LIDAR), cost], [label, "FILL = all", *_scores(full, _LIDAR), ""]]


def _mid_air(truth: np.ndarray, cell: float) -> np.ndarray:
    """Cells beside walls whose height is neither the upper nor the lower surface's: more than 1 m from both."""
    filled, top, bottom = _surroundings(truth, cell)
    between: np.ndarray = (top - bottom > _STEP_M) & (filled - bottom > 1.0) & (top - filled > 1.0)
    return between & np.isfinite(truth)


def write_mid_air(path: str) -> str:
    """Write a raster that is 1 where the lidar's own cells hang in mid-air, and 0 elsewhere; gives its path."""
    with opened(_LIDAR.heights) as dataset:
        lost = _mid_air(read(dataset), dataset.GetGeoTransform()[1])
        return write(path, [lost.astype(np.float32)], dataset.GetGeoTransform(), dataset.GetProjection())


def real_sets() -> List[Tuple[str, List[str]]]:
    """Sets of the real town's images, by their names: two, three of one month, six, and every second date."""
    if not _FOLDER.exists():
        return []
    names = _names()
    sets = {"2": names[:2], "3, January": list(_JANUARY), "6": names[:6], "every second date": names[::2]}
    return [(f"jax_068, {label}", images_of(chosen)) for label, chosen in sets.items()]


def simulated_town(dates: int) -> Path:
    """The folder of the simulated town of the first dates, with all that real images of many dates differ by."""
    return _simulated_scene("all effects", dates, {})


def _mid_air_share() -> float:
    with opened(_LIDAR.heights) as dataset:
        heights, cell = read(dataset), dataset.GetGeoTransform()[1]
    return 100.0 * float(_mid_air(heights, cell).sum() / np.isfinite(heights).sum())


def _scores(dsm: str, truth: Truth) -> List[float]:
    found = score_files(dsm, truth.heights, "3d")
    with opened(truth.heights) as dataset, opened(truth.classes) as kinds:
        heights, kind, cell = read(dataset), read(kinds), dataset.GetGeoTransform()[1]
    within = np.abs(found.error) < 1.0
    m = found.metrics
    errors = [m.valid, dict(m.completeness)[1.0], m.mae, m.rmse, m.medae, m.nmad]
    shares = [100.0 * float(within[kind == code].mean()) for code in _CLASSES.values()]
    plain = np.isfinite(heights) & ~_mid_air(heights, cell)
    return [*errors, 100.0 * float(within[plain].mean()), *shares, *_walls(heights + found.error, heights, cell)]


def towns() -> List[str]:
    if not _FOLDER.exists():
        return [not_measured("jax_068")]
    names = _names()
    sets = [(str(count), names[:count]) for count in _COUNTS] + [("3, January", list(_JANUARY))]
    return [
        "WorldView-3, 0.3 m, 8 bit, pansharpened, October 2014 to November 2015, against the airborne lidar of the "
        "western half of `jax_068`, in cells of 0.5 m, default settings, aligned in 3-D (the images have no ground "
        "control). The first images by date; *3, January* are 009, 010 and 011 (sun at 36 degrees). C1: share of all "
        "cells of the lidar within 1 m, and the same for cells of three classes; *without mid-air*: without the "
        "lidar's own heights between a roof and the ground below it (more than 1 m from both within 2.5 m of a wall of "
        f"3 m: {_mid_air_share():.1f} % of its cells, where no surface is); MedAE is the median of absolute errors; "
        "*walls off*: mean distance of the DSM's walls of 3 m and more from the lidar's; *wider*: how much wider "
        "objects are, on each side. More images give heights to more of the difficult cells; only the rows *FILL = "
        "all* compare nearly the same cells.",
        table(f"images | holes | {_FIGURES}", [row for label, chosen in few(sets) for row in _rows(label, chosen)]),
        _PUBLISHED,
    ]


# What lidar, time and the alignment leave of these figures ----------------------------------------------------------


def _ideal(truth: np.ndarray, cell: float) -> Dict[str, np.ndarray]:
    """Perfect surfaces with vertical walls: each cell of the lidar in mid-air on a surface beside it."""
    filled, top, bottom = _surroundings(truth, cell)
    lost = _mid_air(truth, cell)
    like = np.where(filled - bottom < top - filled, bottom, top)
    beside = ndimage.distance_transform_edt(lost, return_distances=False, return_indices=True)
    return {
        "the lidar, such cells at the height of roof or ground, whichever is nearer": np.where(lost, like, filled),
        "the lidar, such cells at the height of the nearest other cell": filled[tuple(beside)],
    }


def _repeated(truth: np.ndarray) -> float:
    """The share of squares of 2 x 2 cells, from the corner on, whose heights differ by less than a millimetre, %."""
    rows, columns = (side // 2 * 2 for side in truth.shape)
    squares = truth[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2)
    return 100.0 * float((np.ptp(squares, axis=(1, 3)) < 1e-3).mean())


def _c1_mae_rmse(error: np.ndarray) -> List[float]:
    m = height_metrics(error, error.size, THRESHOLDS_M)
    return [dict(m.completeness)[1.0], m.mae, m.rmse]


def _aligned_otherwise(dsm: str, by: float) -> List[List[float]]:
    """The figures of a DSM whose alignment is moved by so many metres, or not, to the east and to the north."""
    with opened(dsm) as source, opened(_LIDAR.heights) as target:
        grid = Grid.of(target)
        warper, heights = HeightWarper(source, grid), read_heights(target)
        found = coregistration.align("3d", [(warper.read(grid), heights)], (grid.transform[1], -grid.transform[5]))
        moves = [(east * by, north * by) for east in (-1, 0, 1) for north in (-1, 0, 1)]
        moved = [replace(found, dx=found.dx + east, dy=found.dy + north) for east, north in moves]
        return [_c1_mae_rmse(warper.read(grid, alignment) - heights) for alignment in moved]


def quick_area() -> Dict[str, Any]:
    """Options of the pipeline for a quick run: a part of the lidar's area."""
    return middle_of(_LIDAR.heights) if is_quick() else {}


def limits() -> List[str]:
    if not _FOLDER.exists():
        return [not_measured("jax_068")]
    with opened(_LIDAR.heights) as dataset:
        truth, cell = read(dataset), dataset.GetGeoTransform()[1]
    lost, names = _mid_air(truth, cell), _names()
    sets = {
        "19 images": names[: 2 if is_quick() else None],
        "dates 1, 3, 5, ...": names[::2],
        "dates 2, 4, 6, ...": names[1::2],
    }
    rows = [[label, *_c1_mae_rmse(ideal - truth)] for label, ideal in _ideal(truth, cell).items()]
    errors: Dict[str, np.ndarray] = {}
    spread: List[List[float]] = []
    for label, chosen in sets.items():
        say(f"limits, {label} ...")
        with tempfile.TemporaryDirectory() as folder:
            dsm = _made(images_of(chosen), folder, ROOT, **quick_area())[0]
            errors[label] = score_files(dsm, _LIDAR.heights, "3d").error
            spread = spread or _aligned_otherwise(dsm, 0.15)
    whole, *halves = errors.values()
    known = np.isfinite(whole)
    share = [float((np.abs(whole[known & lost]) ** k).sum() / (np.abs(whole[known]) ** k).sum()) for k in (1, 2)]
    wrong = np.all([np.abs(error) > 1.0 for error in halves], axis=0) & (np.abs(halves[0] - halves[1]) < 0.5)
    changed = 100.0 * float((wrong & ~lost).sum()) / truth.size
    between = [f"{min(values):.4g} to {max(values):.4g}" for values in zip(*spread)]
    rows.append(
        ["the DSM of 19 images, without the lidar's cells in mid-air", *_c1_mae_rmse(whole[~lost & np.isfinite(truth)])]
    )
    rows.append(["the DSM of 19 images, its alignment moved by 0 or 0.15 m in each direction", *between])
    return [
        f"What of this is not the DSM's. The lidar's raster has cells of 1 m: {_repeated(truth):.1f} % of its squares "
        "of 2 x 2 cells have one height. Walls are ramps of one to several of these. Its cells in mid-air have "
        f"{100 * share[0]:.0f} % of the absolute and {100 * share[1]:.0f} % of the squared errors of 19 images. DSMs "
        "of two sets of dates without a common image agree within 0.5 m, and are both more than 1 m off the lidar, in "
        f"another {changed:.1f} % of its cells: cars, trees, and what was built or moved.",
        table("surface | C1, % | MAE, m | RMSE, m", rows),
    ]


# How much of it is chance -------------------------------------------------------------------------------------------


def spread_of_draws(names: Sequence[str], count: int) -> List[object]:
    """The number of runs with other keypoints, and mean, standard deviation and range of their C1, MAE and RMSE."""
    runs = np.array([_run(names, contrast) for contrast in few(_CONTRASTS[:count])])
    figures = zip(runs.mean(axis=0), runs.std(axis=0), runs.min(axis=0), runs.max(axis=0))
    return [len(runs), *(f"{m:.4g} ± {s:.2g} ({low:.4g} to {high:.4g})" for m, s, low, high in figures)]


def _run(names: Sequence[str], contrast: float) -> List[float]:
    """C1, MAE and RMSE of some images' DSM with other keypoints, and so with ties and pointings a little different."""
    ties = replace(TIES, keypoints=replace(TIES.keypoints, contrast=contrast))
    pointing = replace(ENGINE.pointing, ties=ties)
    with tempfile.TemporaryDirectory() as folder:
        options = {"resolution": 0.5, **quick_area()}
        dsm = pipeline(images_of(names), folder, Silent(), replace(ENGINE, pointing=pointing), **options).output
        return _c1_mae_rmse(score_files(dsm, _LIDAR.heights, "3d").error)


def chance() -> List[str]:
    if not _FOLDER.exists():
        return [not_measured("jax_068")]
    names, rows = _names(), []
    for label, chosen, count in few((("2", names[:2], 8), ("3, January", list(_JANUARY), 8), ("19", names, 4))):
        say(f"chance, {label} ...")
        rows.append([label, *spread_of_draws(chosen, count)])
    return [
        "How much of this is chance: the same with another threshold of the keypoints' contrast "
        f"({min(_CONTRASTS)} to {max(_CONTRASTS)} instead of {TIES.keypoints.contrast}), which moves the "
        "pointings by some thousandths of a px. Rectified images then have their pixels elsewhere, and each match in a "
        "shadow falls anew. Mean, standard deviation and range of such runs; a row above is one more draw.",
        table("images | runs | C1, % | MAE, m | RMSE, m", rows),
    ]


# QUALITY ----------------------------------------------------------------------------------------------------------


def quality() -> List[str]:
    """Each value of QUALITY on real and simulated scenes."""
    cases: List[Tuple[str, List[str], str, str]] = []
    if _FOLDER.exists():
        for label, names in (("6 images", _names()[: 3 if is_quick() else 6]), ("3, January", list(_JANUARY))):
            images = images_of(names)
            cases.append((f"`jax_068`, {label}", images, _LIDAR.heights, "3d"))
    if not (cases and is_quick()):
        scenes = [*real("truth_urban", "pleiades_pair"), default("urban", 800, 4), default("mountains", 400, 7)]
        cases += [(f"`{scene.name}`", list(scene.images), scene.reference, "cells") for scene in scenes]
    rows = []
    for label, images, reference, align in few(cases):
        for value in few(QUALITIES):
            say(f"{label}, {value} ...")
            with tempfile.TemporaryDirectory() as folder:
                dsm, cost = _made(images, folder, quality=value, **(quick_area() if align == "3d" else {}))
                m = score_files(dsm, reference, align).metrics
                rows.append([label, value, m.valid, dict(m.completeness)[1.0], m.mae, m.rmse, m.nmad, cost])
    return [
        "QUALITY `fast` matches only as many pairs as connect all images, `best` in eight directions instead of three. "
        "The pair's reference is S2P's DSM.",
        table("scene | QUALITY | valid, % | C1, % | MAE, m | RMSE, m | NMAD, m | CPU s", rows),
    ]


# The simulated town -----------------------------------------------------------------------------------------------

BEFORE = os.environ.get("REPM_BENCH_TOWNS_BEFORE", "8cf13de")
_SIMULATED_SETS = {"2": (0, 1), "3, January": (7, 8, 9), "6": range(6), "12": range(12)}
_OFF = EffectParameters()
_WITHOUT: Dict[str, Dict[str, Any]] = {
    "all effects": {},
    "one sun": {"moving_sun": False},
    "crisp shadows": {"sun_disc_deg": _OFF.sun_disc_deg},
    "no seasons": {"seasons": _OFF.seasons},
    "smooth crowns": {"rough_crowns": False},
    "no gloss": {"gloss": _OFF.gloss},
    "the same cars": {"moving_cars": False},
    "colours as sharp as the panchromatic band": {"colour_ratio": 1, "chip_blur_px": 0.0},
    "12 bits, no tone curve": {"tone_curve": False},
    "no effect at all": {field.name: getattr(_OFF, field.name) for field in fields(_OFF)},
}


def _simulated_scene(name: str, dates: int, changes: Dict[str, Any]) -> Path:
    """The folder of the simulated town of the first dates, with the real effects but for changes.

    Only scenes of equally many dates show the same town.
    """
    spec = DatedSpec(acquisitions=WORLDVIEW3_JACKSONVILLE[:dates])
    if is_quick():
        dates, spec = 2, replace(spec, side_m=96.0, acquisitions=spec.acquisitions[:2])
    every = replace(DATED, effects=replace(REAL, **changes))
    folder = CACHE / f"district_{dates}_{name.replace(' ', '_').replace(',', '')}"
    return made_once(folder, lambda: make_dated_scene(spec, str(folder), Silent(), every))


@cache  # in a quick run, one scene is all of them
def _simulated_figures(scene: Path, chosen: Tuple[int, ...], tree: Path) -> List[float]:
    say(f"{scene.name}, {len(chosen)} images ...")
    images = [str(scene / f"img_{number + 1:02d}.tif") for number in chosen]
    with tempfile.TemporaryDirectory() as folder:
        dsm, cost = _made(images, folder, tree)
        return [*_scores(dsm, Truth(str(scene / "truth.tif"), str(scene / "classes.tif"))), cost]


def simulated() -> List[str]:
    scene = _simulated_scene("all effects", 12, {})
    sets = few(list(_SIMULATED_SETS.items()))
    with tempfile.TemporaryDirectory() as place:
        trees = [(f"before ({BEFORE})", earlier(BEFORE, Path(place))), ("now", ROOT)]
        compared = [
            [label, when, *_simulated_figures(scene, tuple(chosen), tree)]
            for label, chosen in sets
            for when, tree in trees
            if tree is not None
        ]
    single = [
        [label, name, *_simulated_figures(_simulated_scene(name, 6, changes), tuple(_SIMULATED_SETS[label]), ROOT)]
        for label in few(("2", "6"))
        for name, changes in few(list(_WITHOUT.items()))
    ]
    return [
        "A simulated town of large flat buildings, car parks and trees, with the suns, times and view angles of the "
        "first twelve images of `jax_068`, the true surface as lidar has it (crowns in leaf, cars of another day); "
        "columns as above. *before*: the engine before its detail filter and its choice of pairs by sun and time.",
        table(f"images | engine | {_FIGURES}", compared),
        "What each effect costs: another such town, of six dates, with all effects, then without one of them. It is "
        "one town with one seed: differences of half a per cent say little. The two images are of one day, so that the "
        "sun and the season cost them nothing. The truth has the cars of another day, and with *the same cars* those "
        "of the images.",
        table(f"images | effects | {_FIGURES}", single),
    ]


SECTIONS = [
    Section(
        "towns",
        "A real town of many dates against lidar",
        "make bench-towns",
        {"towns": towns, "chance": chance, "limits": limits},
    ),
    Section("quality", "What QUALITY costs and gives", "make bench-towns", {"quality": quality}),
    Section("district", "A simulated town of many dates", "make bench-towns", {"simulated": simulated}),
    Section(
        "season_scenes",
        "Simulated scenes of two seasons",
        "make bench-towns",
        {"seasons": season_scenes.seasons},
    ),
]
