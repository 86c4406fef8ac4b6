"""Mosaics: twelve DSMs of a simulated town whose heights differ by up to 3 m, and memory from small to large ones."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np
import pyproj

from benchmarks.runner import alone, few, is_quick, say, stage
from benchmarks.scenes import CACHE, made_once
from benchmarks.tables import Section, table
from repm_qgis.contracts.arrays import Bounds
from repm_qgis.contracts.stages import MOSAIC
from repm_qgis.imagery import raster
from repm_qgis.numerics.robust import nmad
from repm_qgis.runtime.process_limits import bound_cache
from repm_qgis.runtime.progress import Silent
from repm_qgis.simulation.surface import Ground, fractal
from repm_qgis.simulation.town import Town

CRS = "EPSG:32631"
CELL = 0.5
COLUMNS, ROWS = 4, 3
OVERLAP = 0.3  # of a DSM's side
OFFSETS = np.random.default_rng(5).uniform(-3, 3, ROWS * COLUMNS)  # of the DSMs' heights, m
WEST, NORTH = 374000.0, 4828000.0
_TRUTH = "truth.tif"


def side() -> int:
    """Cells of a DSM's side."""
    return 300 if is_quick() else 1000


def wkt() -> str:
    return str(pyproj.CRS.from_user_input(CRS).to_wkt())


def town() -> Path:
    """The true surface and twelve DSMs of it, in the cache."""
    step = int(side() * (1 - OVERLAP))
    shape = (step * (ROWS - 1) + side(), step * (COLUMNS - 1) + side())

    def make() -> None:
        bounds = Bounds(WEST, NORTH - (shape[0] - 1) * CELL, WEST + (shape[1] - 1) * CELL, NORTH)
        ground = Ground.empty(bounds, CELL)
        Town(ground, 190.0, 7, Silent()).build()
        write(folder / _TRUTH, ground.height, 0, 0)
        for number in range(ROWS * COLUMNS):
            row, col = (step * place for place in divmod(number, COLUMNS))
            part = slice(row, row + side()), slice(col, col + side())
            height, error = observed(ground.height, part, np.random.default_rng([11, number]))
            height += OFFSETS[number]
            write(folder / f"dsm_{number + 1:02d}.tif", height, col, row)
            write(folder / f"confidence_{number + 1:02d}.tif", error, col, row)

    folder = CACHE / f"mosaic_{side()}"
    return made_once(folder, make)


def write(path: Path, values: np.ndarray, col: int, row: int) -> None:
    place = (WEST + (col - 0.5) * CELL, CELL, 0.0, NORTH - (row - 0.5) * CELL, 0.0, -CELL)
    tags = {"VERTICAL_DATUM": "WGS 84 ellipsoid"}
    raster.write(str(path), [values.astype(np.float32)], place, wkt(), unit="m", metadata=tags)


def observed(truth: np.ndarray, part: Tuple[slice, slice], rng: np.random.Generator) -> Tuple[np.ndarray, np.ndarray]:
    """A DSM of a part of the town, and its expected error: what stereo makes of a surface.

    Its edges lie up to a cell beside the true ones, it has noise with a grain of some cells that differs from place to
    place, a broad error of 4 cm, and holes of 1 to 30 m.
    """
    shape = tuple(s.stop - s.start for s in part)
    error = (0.12 * np.exp(0.35 * fractal(rng, shape, CELL, 60.0, 8.0))).astype(np.float32)
    rows, cols = np.indices(shape)
    rows, cols = (
        np.clip(np.rint(axis + 0.6 * fractal(rng, shape, CELL, 12.0, 3.0)).astype(int) + s.start, 0, size - 1)
        for axis, s, size in zip((rows, cols), part, truth.shape)
    )
    noise = error * fractal(rng, shape, CELL, 6.0, 0.0, 0.3) + 0.04 * fractal(rng, shape, CELL, 250.0, 60.0)
    height = truth[rows, cols] + noise
    height[fractal(rng, shape, CELL, 30.0, 2.0) > 2.0] = np.nan
    return height, error


# Seams ------------------------------------------------------------------------------------------------------------


def read(path: Any, band: int = 1) -> np.ndarray:
    with raster.opened(str(path)) as dataset:
        return raster.read(dataset, band=band)


def steps(error: np.ndarray, source: np.ndarray) -> List[float]:
    """How much the error of a mosaic changes, m, medians of absolute values: from cell to cell across its seams and
    elsewhere, and from a strip of ten cells to the next one across its seams and elsewhere."""
    found: List[List[np.ndarray]] = [[], [], [], []]
    for e, s in ((error, source), (error.T, source.T)):
        seam = s[:, 1:] != s[:, :-1]
        change = np.abs(np.diff(e, axis=1))
        found[0].append(change[seam])
        found[1].append(change[~seam][::17])
        for place, chosen, every in ((2, seam, 1), (3, ~seam, 97)):
            rows, cols = (axis[::every] for axis in np.nonzero(chosen))
            inside = (cols >= 10) & (cols < e.shape[1] - 11)
            rows, cols = rows[inside], cols[inside]
            errors, sources = (np.stack([a[rows, cols + k] for k in range(-9, 11)]) for a in (e, s))
            # Only seams between two areas, not the borders of filled holes.
            pure = (sources[:10] == sources[0]).all(axis=0) & (sources[10:] == sources[10]).all(axis=0)
            errors = errors[:, pure & np.isfinite(errors).all(axis=0)]
            found[place].append(np.abs(np.median(errors[10:], axis=0) - np.median(errors[:10], axis=0)))
    return [float(np.nanmedian(np.concatenate(parts))) for parts in found]


def aligned(error: np.ndarray) -> np.ndarray:
    """Without the mean of all offsets, which no DSM knows."""
    return error - np.nanmedian(error)


def pasted(folder: Path, truth: np.ndarray, source: np.ndarray, added: List[float]) -> np.ndarray:
    """What the same seams look like without the mosaic's work: each cell has its DSM's height and ``added``."""
    height = np.full(truth.shape, np.nan, np.float32)
    step = int(side() * (1 - OVERLAP))
    for number in range(ROWS * COLUMNS):
        row, col = (step * place for place in divmod(number, COLUMNS))
        part = slice(row, row + side()), slice(col, col + side())
        own = source[part] == number + 1
        height[part][own] = read(folder / f"dsm_{number + 1:02d}.tif")[own] + added[number]
    return height


def first_come(dsms: List[str], shape: Tuple[int, ...]) -> np.ndarray:
    """The DSMs laid over each other as they are, the first on top."""
    height = np.full(shape, np.nan, np.float32)
    step = int(side() * (1 - OVERLAP))
    for number, path in enumerate(dsms):
        row, col = (step * place for place in divmod(number, COLUMNS))
        part = height[row : row + side(), col : col + side()]
        part[np.isnan(part)] = read(path)[np.isnan(part)]
    return height


def seams() -> List[str]:
    folder = town()
    truth = read(folder / _TRUTH)
    dsms = [str(folder / f"dsm_{i + 1:02d}.tif") for i in range(ROWS * COLUMNS)]
    errors = [path.replace("dsm_", "confidence_") for path in dsms]
    rows: List[List[object]] = []
    off = 0.0
    no_errors: Dict[str, List[str]] = {}
    with tempfile.TemporaryDirectory() as work:
        for label, more in few([("equal weights", no_errors), ("expected errors given", {"confidences": errors})]):
            out = {"output": f"{work}/mosaic.tif", "sources": f"{work}/sources.tif", "report": f"{work}/report.html"}
            start = time.monotonic()
            made = stage(MOSAIC, dsms=dsms, **out, **more)
            seconds = time.monotonic() - start
            mosaic, source = read(out["output"])[: truth.shape[0], : truth.shape[1]], read(out["sources"])
            source = source[: truth.shape[0], : truth.shape[1]]
            if not rows:
                kept = [[0.0] * len(dsms), [each.added for each in made.offsets]]
                for name, each in zip(("pasted, no offsets", "pasted, with the offsets"), kept):
                    rows.append([name, *figures(pasted(folder, truth, source, each) - truth, source), ""])
            added = np.array([each.added for each in made.offsets])
            off = float(np.abs(added + OFFSETS - OFFSETS.mean()).max())
            rows.append([label, *figures(mosaic - truth, source), round(seconds, 1)])
            say(rows[-1])
    return [
        f"**Twelve DSMs** of {side()} x {side()} cells of 0.5 m that overlap by {OVERLAP:.0%}, of one simulated town "
        f"of {truth.size / 1e6:.1f} million cells: offsets of up to 3 m, noise of 0.06 to 0.25 m with a grain of some "
        "cells, a broad error of 0.04 m, edges up to a cell beside the true ones, holes. The largest error of an "
        f"offset is {off:.3f} m. Step: how much the mosaic's error (against the true surface) changes from one cell "
        "to the next across a seam; and from the ten cells before a seam to the ten behind it. Elsewhere, where no "
        "seam is, the same figures are noise. Medians of absolute values, m. *Pasted*: each cell has its DSM's "
        "height, without feathering. Bar: seams below 0.1 m.",
        table(
            "mosaic | step, cells, across seams | elsewhere | step, ten cells, across seams | elsewhere | NMAD m | "
            "within 1 m % | wall s",
            rows,
        ),
    ]


def figures(error: np.ndarray, source: np.ndarray) -> List[object]:
    error = aligned(error)
    known = error[np.isfinite(error)]
    values = (*steps(error, source), nmad(known), 100.0 * float((np.abs(known) < 1).mean()))
    return [round(value, 3) for value in values]


# Cost -------------------------------------------------------------------------------------------------------------


def enlarged(times: int, folder: str) -> float:
    """A mosaic of the town's DSMs in cells ``times`` finer along each side, made in this process alone."""
    bound_cache()  # as the engine does
    town_folder = town()
    dsms = [str(town_folder / f"dsm_{i + 1:02d}.tif") for i in range(ROWS * COLUMNS)]
    made = stage(
        MOSAIC, dsms=dsms, output=f"{folder}/m.tif", sources=f"{folder}/s.tif", workers=1, resolution=CELL / times
    )
    return made.seconds


def memory() -> List[str]:
    rows = []
    for times in few((1, 2, 3)):
        with tempfile.TemporaryDirectory() as work:
            found = alone(enlarged, times, work)
        step = int(side() * (1 - OVERLAP))
        cells = (step * (ROWS - 1) + side()) * (step * (COLUMNS - 1) + side()) * times**2
        rows.append([round(cells / 1e6, 1), round(found.mib), round(found.cpu_s, 1)])
        say(rows[-1])
    return [
        "**Memory** of a mosaic with its sources by one process that does all: the DSMs of the town, and in cells of "
        "half and a third of the side.",
        table("million cells | peak MiB | CPU s", rows),
    ]


SECTIONS = [Section("mosaic", "Mosaics", "make bench-mosaic", {"seams": seams, "memory": memory})]
