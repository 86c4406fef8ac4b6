"""Orthophotos at the images' own resolution: how sharp they are, where they lie, their seams, and what they cost."""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal
from scipy import ndimage

from benchmarks.answers_colour import _BLOCK, _CLEAR, _bands, _blocks, _gradient, shift_of
from benchmarks.colour_scene import make_colour_scene
from benchmarks.runner import ROOT, is_quick, measured, pipeline, stage
from benchmarks.scenes import CACHE, SHARED, made_once, not_measured, quick_size
from benchmarks.tables import Section, table
from benchmarks.towns import quick_area
from repm_qgis.contracts.arrays import Window
from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.contracts.stages import EXPORTRPC
from repm_qgis.fusion.finished import FinishedSurface
from repm_qgis.fusion.visible import nadir_first
from repm_qgis.geometry.cell_grid import overlapping_blocks
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.ortho.colour_blocks import ColourTask, choice, samples
from repm_qgis.ortho.colour_ortho import _balanced, _finer
from repm_qgis.ortho.colour_sources import colour_plan
from repm_qgis.ortho.grey_ortho import make_grey_ortho
from repm_qgis.ortho.parameters import ORTHO, OrthoParameters
from repm_qgis.ortho.seen_surface import SeenSurface
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene, View
from repm_qgis.simulation.scene import SceneSpec

_TOWN = SHARED / "jax_068"
_IMAGES = ("002", "004", "005", "007", "011", "012")  # of one winter
_REACH_M = 2.5  # to each side of an edge: what lies there, but for its inner half, are the two plateaus
_LEAST_STEP = 25.0  # grey levels between them
_ROUGHEST = 0.15  # of this step: their standard deviation
_SIDE = 128  # of the DSM's cells: blocks so small that there are many borders
_ASIDE = ((3, 0), (-3, 0), (0, 3), (0, -3))  # rows and columns by which seams are moved


# --- what is measured ---


def edge_width(values: np.ndarray, cell: float) -> Tuple[float, int]:
    """The median width of an image's clear edges, m: the step between two level sides over the steepest slope between
    them, along rows and columns; and how many edges there are. The best that cells can do is their own side."""
    widths = np.concatenate([_widths(values, cell), _widths(values.T, cell)])
    return float(np.median(widths)), len(widths)


def _widths(values: np.ndarray, cell: float) -> np.ndarray:
    reach = max(3, round(_REACH_M / cell))
    inner = reach // 2  # cells to each side that may change
    slopes = np.abs(np.diff(values, axis=1))
    windows = np.lib.stride_tricks.sliding_window_view(values, 2 * reach + 2, axis=1)
    steps = np.lib.stride_tricks.sliding_window_view(slopes, 2 * inner + 3, axis=1)
    left, right = windows[..., : reach - inner], windows[..., reach + inner + 2 :]
    with np.errstate(invalid="ignore"):
        step = np.abs(right.mean(axis=-1) - left.mean(axis=-1))
        level = np.maximum(left.std(axis=-1), right.std(axis=-1)) < _ROUGHEST * step
        near = steps[:, reach - inner - 1 : reach - inner - 1 + windows.shape[1]]
        middle = near[..., inner + 1]
        edge = (step > _LEAST_STEP) & level & (middle == near.max(axis=-1))
    return step[edge] / middle[edge] * cell


def _energy(values: np.ndarray, cell: float, known: np.ndarray) -> float:
    """The mean squared slope of an image, for each m."""
    found = (_gradient(values) / cell) ** 2
    return float(found[known & np.isfinite(found)].mean())


def _apart(moved: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """(N, 2) by how many cells the blocks of one image lie off the other's, right and down."""
    known, found = np.isfinite(moved) & np.isfinite(fixed), []
    for rows, columns in _blocks(known.shape):
        if known[rows, columns].mean() > 0.5:
            shift = shift_of(moved[rows, columns], fixed[rows, columns], known[rows, columns], _CLEAR)
            found += [] if shift is None else [shift]
    return np.array(found).reshape(-1, 2)


def _on(path: str, like: str, algorithm: str = "cubic", /, **options: object) -> np.ndarray:
    """(B, H, W) a raster or an image on another raster's cells, by GDAL alone; NaN where it has nothing."""
    dataset = gdal.Open(like)
    x, cell, _, y, _, down = dataset.GetGeoTransform()
    ends = (x, y + down * dataset.RasterYSize, x + cell * dataset.RasterXSize, y)
    frame = {"outputBounds": ends, "xRes": cell, "yRes": cell, "dstSRS": dataset.GetProjection(), "format": "MEM"}
    kind = {"outputType": gdal.GDT_Float32, "dstNodata": float("nan"), "resampleAlg": algorithm}
    made = gdal.Warp("", path, **frame, **kind, **options).ReadAsArray()
    return made if made.ndim == 3 else made[None]


def _grey_ortho(scene: Scene, views: Sequence[View], dsm: str, cell: float, parameters: OrthoParameters = ORTHO) -> str:
    path = str(Path(tempfile.mkdtemp(dir=Path(dsm).parent)) / "ortho.tif")
    options, surface = DsmFuseOptions(scene=str(scene.path), output=dsm, workers=1), _surface(scene, dsm)
    make_grey_ortho(
        views,
        surface,
        options,
        path=path,
        folder=str(Path(path).parent),
        progress=Silent(),
        cell=cell,
        parameters=parameters,
    )
    return path


def _surface(scene: Scene, dsm: str) -> FinishedSurface:
    return FinishedSurface.of(dsm, scene.crs, HeightDatum.of(""))


# --- the real town ---


def town() -> List[str]:
    """WorldView-3: sharpness and place against the images themselves, through GDAL."""
    if not _TOWN.exists():
        return [not_measured("jax_068")]
    scene, dsm = _reconstructed()
    with tempfile.TemporaryDirectory() as work:
        rows = _sharpness(scene, dsm, work)
        places = _places(scene, dsm, work)
        seams = _seams(scene, dsm, work)
    return [
        f"**Sharpness**, `jax_068`, {len(_IMAGES)} real images of 0.31 m, DSM of 0.62 m (both automatic), greys. "
        "*Edges*: the step between two level sides over the steepest slope between them, median of all clear edges "
        "along rows and columns; cells cannot show less than their own side. *Slopes*: mean of squared slopes on "
        "the ground that all rows show, against GDAL's projection of the most vertical image.",
        table("image | cells, m | edges, m | number | slopes", rows),
        "**Place**: the orthophoto of each image alone (cells of 0.31 m, DSM of 0.62 m) against `gdalwarp -rpc` of the "
        f"same image with the RPC of `repm:exportrpc`, on the same DSM; shifts of blocks of {_BLOCK} cells, px of "
        "0.31 m.",
        table("image | blocks | median shift | 90 % of blocks below | mean right | mean down", places),
        f"**Seams** in colour, chosen on the DSM's cells, in blocks of {_SIDE} of them (512 in a run). *Differ*: by "
        "how much the two views that meet differ in the cells of a seam that both see, standard deviations of the "
        "colours; *aside*: if all seams lay 3 cells up, down, left or right. *Borders*: how much of the blocks' "
        "borders is a seam.",
        table("choice | seams, m | differ | differ aside | borders, % | differ at borders", seams),
    ]


def _reconstructed() -> Tuple[Scene, str]:
    images = [str(_TOWN / f"JAX_068_{name}_RGB.tif") for name in _IMAGES[: 3 if is_quick() else None]]
    folder = CACHE / f"orthophoto_jax_068{'_quick' * is_quick()}"
    made_once(folder, lambda: pipeline(images, folder, **quick_area()))
    return Scene.load(str(folder / "w" / "reconstructed.json")), str(folder / "dsm.tif")


def _sharpness(scene: Scene, dsm: str, work: str) -> List[List[object]]:
    views, cell = nadir_first(scene), gdal.Open(dsm).GetGeoTransform()[1]
    first = views[0]
    made = {
        "orthophoto on the DSM's cells": _grey_ortho(scene, views, dsm, cell),
        "orthophoto, bilinear": _grey_ortho(scene, views, dsm, cell / 2, replace(ORTHO, kernel="bilinear")),
        "orthophoto (default)": _grey_ortho(scene, views, dsm, cell / 2),
        "orthophoto, half of that": _grey_ortho(scene, views, dsm, cell / 4),
    }
    fine = made["orthophoto (default)"]
    projected = _projected(scene, first, dsm, fine, work)
    known = np.isfinite(projected) & np.isfinite(_bands(fine)[0])
    own = gdal.Open(first.image).ReadAsArray().astype(np.float32)
    image = own if own.ndim == 2 else np.tensordot((0.299, 0.587, 0.114), own, axes=1).astype(np.float32)
    rows: List[List[object]] = [["the image itself", round(first.gsd_m, 3), *edge_width(image, first.gsd_m), "–"]]
    whole = _energy(projected, cell / 2, known)
    rows.append(["GDAL's projection, cubic", cell / 2, *edge_width(projected, cell / 2), 1.0])
    for name, path in made.items():
        (values,), side = _bands(path), gdal.Open(path).GetGeoTransform()[1]
        here = _on_shape(known, values.shape)
        rows.append([name, side, *edge_width(values, side), _energy(values, side, here) / whole])
    return rows


def _on_shape(known: np.ndarray, shape: Tuple[int, ...]) -> np.ndarray:
    factor = known.shape[0] / shape[0]
    rows, columns = ((np.arange(count) * factor).astype(int) for count in shape)
    return known[np.minimum(rows, known.shape[0] - 1)][:, np.minimum(columns, known.shape[1] - 1)]


def _projected(scene: Scene, view: View, dsm: str, like: str, work: str) -> np.ndarray:
    """A view's brightness on a raster's cells, by GDAL's own RPC transformer, which draws what hides the ground too."""
    folder = Path(work) / "rpcs"
    if not folder.exists():
        stage(EXPORTRPC, scene=str(scene.path), rpc_folder=str(folder))
    ways = {"rpc": True, "errorThreshold": 0.0, "transformerOptions": [f"RPC_DEM={dsm}"]}
    found = _on(str(folder / f"{view.name}.vrt"), like, **ways)
    if len(found) == 1:
        return found[0]
    grey: np.ndarray = np.tensordot((0.299, 0.587, 0.114), found[:3], axes=1).astype(np.float32)
    return grey


def _places(scene: Scene, dsm: str, work: str) -> List[List[object]]:
    cell, rows = gdal.Open(dsm).GetGeoTransform()[1] / 2, []
    for view in nadir_first(scene):
        path = _grey_ortho(scene, [view], dsm, cell)
        shifts = _apart(_bands(path)[0], _projected(scene, view, dsm, path, work))
        lengths = np.hypot(*shifts.T)
        mean = [float(each) for each in shifts.mean(axis=0)]
        ends = float(np.median(lengths)), float(np.percentile(lengths, 90))
        rows.append([view.name, len(shifts), *ends, *mean])
    return rows


def _seams(scene: Scene, dsm: str, work: str) -> List[List[object]]:
    """The choice of views in small blocks, each by itself and as finer orthophotos have it."""
    options = DsmFuseOptions(scene=str(scene.path), output=dsm, workers=1)
    plan = colour_plan(scene, options, Silent(), ORTHO.sharpening)
    if plan is None:
        raise ValueError("The images have no colours.")
    dsm_surface, small = _surface(scene, dsm), replace(ORTHO, block_cells=_SIDE)
    surface = SeenSurface.of(dsm_surface, [source.view for source in plan.sources], small)
    whole = Window(0, 0, *surface.grid.size)
    task = ColourTask(plan, surface, 2, small, whole)
    plan, contrast = _balanced(plan, samples(task), Silent(), small)
    task = replace(task, plan=plan, contrast=contrast)
    heights = surface.heights(whole)
    colours = np.stack([task.colours(source, whole, heights) for source in plan.sources])
    scaled = colours / np.array(contrast, np.float32)[None, :, None, None]
    rows = []
    for name, alone in (("each block by itself", True), ("blocks that go on from each other", False)):
        folder = Path(work) / f"views_{alone}"
        folder.mkdir()
        if alone:
            for own, _ in overlapping_blocks(surface.grid.size, _SIDE):
                choice(replace(task, own=own, path=f"{folder}/views_{own.row}_{own.col}.npy"))
        else:
            finer = SeenSurface.of(dsm_surface, [source.view for source in plan.sources], small, surface.grid.cell / 2)
            _finer(task, finer, str(folder), workers=1, progress=Silent())
        rows.append([name, *_seam_figures(_chosen(folder, heights.shape), scaled, surface.grid.cell)])
    return rows


def _seam_figures(labels: np.ndarray, scaled: np.ndarray, cell: float) -> List[object]:
    """Length of the seams where both views see both sides, m; what the views differ by there, and where all seams would
    lie some cells aside; share of the blocks' borders that are seams, %, and what the views differ by there."""
    shown = np.isfinite(scaled[:, 0])
    costs: Dict[str, List[np.ndarray]] = {"seams": [], "aside": [], "borders": []}
    both = 0
    for axis in (0, 1):
        one, other = _sides(labels, axis)
        border = np.expand_dims(np.arange(1, labels.shape[axis]) % _SIDE == 0, 1 - axis)
        both += int(((one >= 0) & (other >= 0) & border).sum())
        for first, second in combinations(range(len(scaled)), 2):
            apart = np.where(shown[first] & shown[second], np.abs(scaled[first] - scaled[second]).mean(axis=0), np.nan)
            line = ((one == first) & (other == second)) | ((one == second) & (other == first))
            cost = 0.5 * np.add(*_sides(apart, axis))
            costs["seams"].append(cost[line])
            costs["borders"].append(cost[line & border])
            costs["aside"] += [np.roll(cost, shift, (0, 1))[line] for shift in _ASIDE]
    known = {name: np.concatenate(each) for name, each in costs.items()}
    seams, aside, borders = (each[np.isfinite(each)] for each in known.values())
    share = 100.0 * len(known["borders"]) / both
    return [cell * len(seams), float(seams.mean()), float(aside.mean()), share, float(borders.mean())]


def _sides(values: np.ndarray, axis: int) -> Tuple[np.ndarray, np.ndarray]:
    """What lies on both sides of the lines between rows, or between columns."""
    return (values[:-1], values[1:]) if axis == 0 else (values[:, :-1], values[:, 1:])


def _chosen(folder: Path, shape: Tuple[int, ...]) -> np.ndarray:
    """(H, W) the source of each cell, as blocks left them."""
    found = np.full(shape, -1, np.int16)
    for path in folder.glob("views_*.npy"):
        row, col = map(int, path.stem.split("_")[1:])
        part = np.load(path)
        found[row : row + part.shape[0], col : col + part.shape[1]] = part
    return found


# --- the simulated town ---


def truth() -> List[str]:
    """A town whose true brightness is known everywhere: how much of it the orthophotos show, and where."""
    size = quick_size(500)
    folder = CACHE / f"colours_{size}"
    made_once(folder, lambda: make_colour_scene(SceneSpec.default("urban", size, 5), str(folder)))
    images = sorted(str(path) for path in folder.glob("img_0?.tif"))
    with tempfile.TemporaryDirectory() as work:
        pipeline(images, work, colour="greys")
        scene, dsm = Scene.load(f"{work}/w/reconstructed.json"), f"{work}/dsm.tif"
        cell = gdal.Open(dsm).GetGeoTransform()[1]
        paths = [_grey_ortho(scene, nadir_first(scene), dsm, side) for side in (cell, cell / 2)]
        true = _on(str(folder / "colours.tif"), paths[1], "average")
        weights = (0.3, 0.35, 0.2, 0.15)
        whole = np.tensordot(weights, true, axes=1).astype(np.float32)
        rows = [_against(path, whole, paths[1]) for path in paths]
    return [
        f"**Truth**, simulated town, {len(images)} images of 0.5 m, DSM of {cell:g} m: greys against the true "
        "brightness of the ground in cells of 0.5 m, on which the coarser orthophoto is interpolated (cubic). The "
        "scene has no control points: the mean shift of all blocks is that of the RPCs, and is taken out.",
        table("cells, m | correlation | median error, % | blocks | median shift, px | 90 % of blocks below", rows),
    ]


def _against(path: str, true: np.ndarray, like: str) -> List[object]:
    (values,) = _on(path, like)
    shifts = _apart(values, true)
    right, down = np.median(shifts, axis=0)
    moved = ndimage.shift(true, (down, right), order=1, mode="nearest")
    known = np.isfinite(values) & np.isfinite(moved)
    # The images' gain is not the surface's: brightness is compared after a line through both.
    gain, offset = np.polyfit(moved[known], values[known], 1)
    errors = np.abs(values[known] - gain * moved[known] - offset) / float(values[known].mean())
    lengths = np.hypot(*(shifts - (right, down)).T)
    alike = float(np.corrcoef(values[known], moved[known])[0, 1])
    ends = float(np.median(lengths)), float(np.percentile(lengths, 90))
    return [gdal.Open(path).GetGeoTransform()[1], alike, 100.0 * float(np.median(errors)), len(shifts), *ends]


# --- what it costs ---


def cost() -> List[str]:
    """The fusion of the real town, with orthophotos of more and more cells."""
    if not _TOWN.exists():
        return []
    scene, _ = _reconstructed()
    cases: List[Tuple[str, Dict[str, object]]] = [("none", {})]
    for colour, cells in (("greys", (0.62, 0.31)), ("auto", (0.62, 0.31, 0.155))):
        cases += [(f"{colour}, {cell} m", {"colour": colour, "ortho_resolution": cell}) for cell in cells]
    rows = []
    least: Optional[float] = None
    with tempfile.TemporaryDirectory() as work:
        for name, options in cases[: 2 if is_quick() else None]:
            made = {"ortho": f"{work}/ortho.tif"} if options else {}
            job = Path(work, "job.json")
            given = {"scene": str(scene.path), "output": f"{work}/dsm.tif", "workers": 1, **made, **options}
            job.write_text(json.dumps(given), encoding="utf-8")
            used = measured([sys.executable, "-m", "repm_qgis", "dsmfuse", str(job)], str(ROOT))[1]
            least = used.cpu_s if least is None else least
            count = int(np.isfinite(_bands(made["ortho"])[0]).sum()) / 1e6 if made else 0.0
            rows.append([name, count, used.cpu_s, used.cpu_s - least, used.peak_gib])
    return [
        "**Cost** of the fusion of `jax_068`, one worker: CPU seconds and the largest memory of all processes "
        "together, and how much of the seconds is the orthophoto's.",
        table("orthophoto | Mcells | CPU, s | of it the orthophoto's | memory, GiB", rows),
    ]


SECTIONS = [
    Section(
        "orthophoto",
        "Orthophotos at the images' resolution",
        "make bench-orthophoto",
        {"town": town, "truth": truth, "cost": cost},
    )
]
