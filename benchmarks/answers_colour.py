"""Orthophotos in colour: whether they lie where their DSM lies, keep the multispectral mean, and what they cost."""

from __future__ import annotations

import json
import sys
import tempfile
from itertools import combinations
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal
from scipy import ndimage

from benchmarks import answers_change
from benchmarks.colour_scene import WEIGHTS, make_colour_scene
from benchmarks.runner import ROOT, is_quick, measured, pipeline, stage, there
from benchmarks.scenes import CACHE, SHARED, made_once, not_measured, quick_size
from benchmarks.tables import table
from repm_qgis.contracts.arrays import Window
from repm_qgis.contracts.options import DsmFuseOptions
from repm_qgis.contracts.stages import DSMFUSE
from repm_qgis.fusion.finished import FinishedSurface
from repm_qgis.geometry.vertical import HeightDatum
from repm_qgis.imagery.raster import opened, read
from repm_qgis.ortho.colour_blocks import ColourTask
from repm_qgis.ortho.colour_sources import colour_plan
from repm_qgis.ortho.parameters import ORTHO
from repm_qgis.ortho.seen_surface import SeenSurface
from repm_qgis.runtime.progress import Silent
from repm_qgis.scene import Scene
from repm_qgis.simulation.scene import SceneSpec

_TOWN = SHARED / "jax_068"
_BLOCK, _REACH = 96, 5  # cells of a block in which a shift is measured, and of the largest one
_WALL_M = 3.0  # heights of neighbouring cells that differ by more are a wall
_LEAST_WALLS = 60  # cells of walls that a block needs
_CLEAR = 0.1  # correlation that the best shift of a block must have


def colours() -> List[str]:
    """Simulated multispectral images first: there the true colours are known."""
    texts = [*_sharpening()]
    if not _TOWN.exists():
        return [*texts, not_measured("jax_068")]
    return [*texts, *_town()]


# --- the simulated town ---


def _sharpening() -> List[str]:
    size = quick_size(1000)
    folder = CACHE / f"colours_{size}"
    made_once(folder, lambda: make_colour_scene(SceneSpec.default("urban", size, 5), str(folder)))
    every, truth = sorted(str(path) for path in folder.glob("img_0?.tif")), str(folder / "colours.tif")
    images = every[: 2 if is_quick() else None]
    with tempfile.TemporaryDirectory() as work:
        options = {"colour": "all", "resolution": 0.5, "ortho_resolution": 0.5}
        made = {name: f"{work}/{name}.tif" for name in ("pansharpened", "resampled")}
        pipeline(images, work, ortho=made["pansharpened"], pansharpen=True, **options)
        again = {"scene": f"{work}/w/reconstructed.json", "output": f"{work}/again.tif", "ortho": made["resampled"]}
        stage(DSMFUSE, pansharpen=False, **again, **options)
        rows = _against_truth(made, truth)
    headers = "band | mean, pansharpened : resampled | median error, pansharpened, % | resampled, % | correlation "
    headers += "with the truth, pansharpened | resampled"
    return [
        "**Pansharpening**, simulated: three panchromatic images of 0.5 m with multispectral ones of 2 m, which have "
        "RPCs and pointing errors of their own; the true colour of every place is known. Errors are medians of "
        "absolute differences from it, in % of the band's mean, over all cells with a colour.",
        table(headers, rows),
    ]


def _against_truth(made: Dict[str, str], truth: str) -> List[List[object]]:
    orthos = {name: _bands(path) for name, path in made.items()}
    known = np.all([np.isfinite(ortho).all(axis=0) for ortho in orthos.values()], axis=0)
    with opened(next(iter(made.values()))) as dataset:
        x, cell, _, y, _, down = dataset.GetGeoTransform()
        ends = (x, y + down * dataset.RasterYSize, x + cell * dataset.RasterXSize, y)
        where = dataset.GetProjection()
    options = {"outputBounds": ends, "xRes": cell, "yRes": cell, "dstSRS": where, "resampleAlg": "average"}
    true = gdal.Warp("", truth, format="MEM", **options).ReadAsArray()
    # The scene has no control points: its place is that of the RPCs.
    shift = there(shift_of(orthos["pansharpened"][1], true[1], known))
    moved = np.stack([ndimage.shift(band, (shift[1], shift[0]), order=1, mode="nearest") for band in true])
    rows = []
    for band, name in enumerate(WEIGHTS):
        values = {key: ortho[band][known] for key, ortho in orthos.items()}
        at = moved[band][known]
        errors = [100.0 * float(np.median(np.abs(each - at))) / float(at.mean()) for each in values.values()]
        alike = [float(np.corrcoef(each, at)[0, 1]) for each in values.values()]
        ratio = float(values["pansharpened"].mean()) / float(values["resampled"].mean())
        rows.append([name, f"{ratio:.4f}", *errors, *alike])
    return rows


# --- the real town ---


def _town() -> List[str]:
    numbers = sorted(path.name.split("_")[2] for path in _TOWN.glob("*_RGB.tif"))
    images = answers_change.QUICK_VIEWS if is_quick() else numbers
    scene = str(answers_change.real_scene(images) / "w" / "reconstructed.json")
    with tempfile.TemporaryDirectory() as work:
        costs, made, cells = [], {}, {"resolution": 0.5, "ortho_resolution": 0.5}
        for colour in ("greys", "auto"):
            made[colour] = f"{work}/{colour}.tif"
            paths = {"scene": scene, "output": f"{work}/{colour}_dsm.tif", "ortho": made[colour]}
            job = Path(work, "job.json")
            job.write_text(json.dumps({**paths, **cells, "colour": colour, "workers": 1}), encoding="utf-8")
            costs.append(measured([sys.executable, "-m", "repm_qgis", "dsmfuse", str(job)], str(ROOT))[1])
        million = int(np.isfinite(_bands(made["auto"])[0]).sum()) / 1e6
        rows = [_registration(name, made[name], f"{work}/auto_dsm.tif") for name in made]
        apart = _views_apart(scene, f"{work}/auto_dsm.tif")
    more = costs[1].cpu_s - costs[0].cpu_s
    shares = ", ".join(f"{100.0 * float((apart < limit).mean()):.0f} % below {limit:g}" for limit in (0.5, 1.0))
    return [
        f"**Registration**, `jax_068`, {len(images)} real images, cells of 0.5 m. How far the orthophoto's edges lie "
        f"from the walls of its DSM (steps of {_WALL_M:g} m): the shift with the highest correlation of both "
        f"gradients' magnitudes, in blocks of {_BLOCK} cells, cells.",
        table("orthophoto | blocks | median shift | 90 % of blocks below | mean east | mean north", rows),
        f"**Between views**: the orthophotos of single views on this DSM are {float(np.median(apart)):.2f} cells apart "
        f"(median over {len(apart)} blocks of pairs of the most vertical views; {shares}).",
        f"**Cost** of the fusion: {costs[0].cpu_s:.1f} s of CPU and {costs[0].peak_gib:.2f} GiB with greys, "
        f"{costs[1].cpu_s:.1f} s and {costs[1].peak_gib:.2f} GiB in colour: {more / million:.0f} s more for each "
        f"million cells with {len(images)} views.",
    ]


def _bands(path: str) -> np.ndarray:
    """(B, H, W) values, NaN where there are none."""
    with opened(path) as dataset:
        return np.stack([read(dataset, None, band + 1) for band in range(dataset.RasterCount)])


def _registration(name: str, ortho: str, dsm: str) -> List[object]:
    brightness = _bands(ortho).mean(axis=0)
    with opened(dsm) as dataset:
        heights = read(dataset)
    edges, walls = _gradient(brightness), np.minimum(_gradient(heights), 10.0)
    known = np.isfinite(edges) & np.isfinite(walls)
    shifts = []
    for rows, columns in _blocks(known.shape):
        part = known[rows, columns]
        if (walls[rows, columns][part] > _WALL_M / 2).sum() < _LEAST_WALLS:
            continue
        # Dark and bright roofs count alike.
        found = shift_of(np.sqrt(edges[rows, columns]), np.sqrt(walls[rows, columns]), part, _CLEAR)
        if found is not None:
            shifts.append(found)
    lengths = np.hypot(*np.array(shifts).T)
    east, north = np.array(shifts).mean(axis=0) * (1, -1)
    ends = float(np.median(lengths)), float(np.percentile(lengths, 90))
    return [name, len(shifts), *ends, float(east), float(north)]


def _views_apart(scene_path: str, dsm: str) -> np.ndarray:
    """(N,) cells between the orthophotos of two views, in each block of each pair of the most vertical ones."""
    scene = Scene.load(scene_path)
    plan = there(colour_plan(scene, DsmFuseOptions(scene=scene_path, output=dsm), Silent(), ORTHO.sharpening))
    surface = FinishedSurface.of(dsm, scene.crs, HeightDatum.of(""))
    seen = SeenSurface.of(surface, [source.view for source in plan.sources])
    task = ColourTask(plan, seen, 1, ORTHO, Window(0, 0, 0, 0))
    whole = Window(0, 0, *surface.grid.size)
    heights = surface.heights(whole)
    own = [task.colours(source, whole, heights).mean(axis=0) for source in plan.sources[:5]]
    found = []
    for first, second in combinations(own, 2):
        edges = [np.sqrt(_gradient(each)) for each in (first, second)]
        known = np.isfinite(edges[0]) & np.isfinite(edges[1])
        for rows, columns in _blocks(known.shape):
            if known[rows, columns].mean() > 0.5:
                shift = shift_of(edges[0][rows, columns], edges[1][rows, columns], known[rows, columns], _CLEAR)
                found += [] if shift is None else [float(np.hypot(shift[0], shift[1]))]
    return np.array(found)


def _blocks(shape: Tuple[int, ...]) -> List[Tuple[slice, slice]]:
    starts = [range(0, length - _BLOCK + 1, _BLOCK) for length in shape]
    return [(slice(row, row + _BLOCK), slice(col, col + _BLOCK)) for row in starts[0] for col in starts[1]]


def _gradient(values: np.ndarray) -> np.ndarray:
    """(H, W) by how much values change from cell to cell; NaN beside gaps."""
    down, right = np.gradient(values)
    return np.hypot(down, right)


def shift_of(moved: np.ndarray, fixed: np.ndarray, known: np.ndarray, least: float = 0.0) -> Optional[Sequence[float]]:
    """(columns, rows) by which the first of two images lies farther right and down than the second, to a fraction of a
    cell; None where no shift within the reach correlates by ``least``, or the best is at its end."""
    span = range(-_REACH, _REACH + 1)
    scores = np.array([[_alike(moved, fixed, known, right, down) for right in span] for down in span])
    row, col = np.unravel_index(np.nanargmax(scores), scores.shape)
    if scores[row, col] < least or not (0 < row < 2 * _REACH and 0 < col < 2 * _REACH):
        return None
    return [
        float(place - _REACH + _vertex(line, place))
        for place, line in ((int(col), scores[row]), (int(row), scores[:, col]))
    ]


def _alike(moved: np.ndarray, fixed: np.ndarray, known: np.ndarray, right: int, down: int) -> float:
    """The correlation of one image, moved back, with the other; over the cells that all shifts have."""
    rows, columns = known.shape
    inner = slice(_REACH, rows - _REACH), slice(_REACH, columns - _REACH)
    there = slice(_REACH + down, rows - _REACH + down), slice(_REACH + right, columns - _REACH + right)
    both = known[inner] & known[there]
    return float(np.corrcoef(moved[there][both], fixed[inner][both])[0, 1])


def _vertex(line: np.ndarray, place: int) -> float:
    before, here, after = line[place - 1 : place + 2]
    bend = before - 2 * here + after
    return 0.0 if bend >= 0 else float(0.5 * (before - after) / bend)
