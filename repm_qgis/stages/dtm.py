"""Bare earth from a DSM: the terrain without houses and trees, how high these are, and where they stand."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from typing import Callable, Dict, List, Optional, Sequence, Tuple, TypeVar

import numpy as np

from ..contracts.options import DsmFuseOptions, DtmOptions
from ..contracts.products import product
from ..contracts.results import DtmResult
from ..imagery.raster import NODATA, RasterFrame, created
from ..names import surface_title
from ..planning.disk_space import require_space, terrain_needs
from ..reports.styles import write_style
from ..reports.verdict import of_terrain
from ..runtime.memory import Work, workers_within
from ..runtime.parallel import kept_workers, run_tasks, run_whole
from ..runtime.progress import Part, Progress, Recorder, warn_all
from ..runtime.workspace import temporary_folder
from ..terrain import blocks
from ..terrain.inputs import Surface, surface_of
from ..terrain.page import terrain_page
from ..terrain.steepness import Cut, Slopes, cut_of, slopes_of
from ..terrain.whole import coarse_of
from . import dsmfuse
from .parameters import ENGINE, EngineParameters

_FUSION_SHARE = 0.5  # of the progress, where the DSM is made of a scene
T = TypeVar("T")
R = TypeVar("R")
_RASTERS = {  # option: the name of the band, and its unit
    "output": ("height of the terrain (m)", "m"),
    "heights": ("height above the terrain (m)", "m"),
    "mask": ("0 ground, 1 object", ""),
}


def run(options: DtmOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> DtmResult:
    """Find the ground, and write the terrain and the objects on it; gives the products' paths and shares of cells.

    Raises what :func:`made` raises.
    """
    return made(options, progress, parameters)[0]


def made(options: DtmOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> Tuple[DtmResult, Slopes]:
    """The result of a run, and the slopes of the DSM.

    Raises ImageError for a DSM or a confidence raster that cannot be used, SceneError for such a scene,
    EmptyResultError where no ground is left, WorkspaceError, OutOfMemoryError and ClusterError.
    """
    start, progress = time.monotonic(), Recorder(progress)
    with kept_workers(), temporary_folder(options.output) as folder:
        if options.scene:
            dsm, confidence = f"{folder}/dsm.tif", f"{folder}/confidence.tif"
            share = _FUSION_SHARE
            fuse = DsmFuseOptions(
                scene=options.scene,
                output=dsm,
                confidence=confidence,
                workers=options.workers,
                memory=options.memory,
            )
            dsmfuse.run(fuse, Part(progress, 0.0, share), parameters)
            surface = surface_of(dsm, confidence)
        else:
            share, surface = 0.0, surface_of(str(options.dsm), options.confidence)
        warn_all(progress, surface.findings)
        result, slopes = _make(options, surface, folder, progress, share, parameters)
    return replace(result, seconds=round(time.monotonic() - start, 3)), slopes


def _make(
    options: DtmOptions,
    surface: Surface,
    folder: str,
    progress: Recorder,
    share: float,
    parameters: EngineParameters,
) -> Tuple[DtmResult, Slopes]:
    """The result, without its seconds, and the slopes."""
    search = blocks.Search(surface, options.largest, options.slope / 100.0, parameters.terrain)
    columns, rows = surface.size
    progress.info(
        f"Terrain of {columns} x {rows} cells of {surface.cell:g} m: objects of up to {options.largest:g} m in width, "
        f"ground of up to {options.slope:g} %."
    )
    require_space("the terrain", terrain_needs(options, columns * rows, folder), progress)
    margins = [blocks.search_margin(search), blocks.finishing_margin(search)]
    searched, finished = (blocks.windows(search, margin) for margin in margins)
    mib = blocks.block_mib([wide for _, wide in searched], [wide for _, wide in finished])
    work = Work("a block of the DSM", mib, lambda _: "choose a smaller LARGEST")
    workers = workers_within(options.workers, work, options.memory, progress)

    def step(low: float, high: float, text: str, make: Callable[[T], R], tasks: Sequence[T]) -> List[R]:
        part = Part(progress, share + (1 - share) * low, share + (1 - share) * high)
        return run_tasks(make, tasks, workers, part, lambda task: text)

    ground, level = parameters.terrain.ground, search.level
    tasks = [blocks.BlockTask(own, wide, search) for own, wide in searched]
    parts = step(0.0, 0.5, "looking for objects", blocks.first_ground, tasks)
    coarse = coarse_of(search, parts, ground.first_stiffness, options.voids)
    for low in (0.5, 0.6):  # the ground that is near the first surface, and the surface of that ground
        before = coarse
        near = [blocks.NearTask(own, wide, search, before.part(wide, level)) for own, wide in finished]
        parts = step(low, low + 0.1, "finding the ground", blocks.better_ground, near)
        coarse = coarse_of(search, parts, ground.stiffness, options.voids)
    last = [
        blocks.FinishTask(own, wide, search, before.part(wide, level), coarse.part(wide, level), f"{folder}/{i}.npz")
        for i, (own, wide) in enumerate(finished)
    ]
    made = step(0.7, 0.9, "making the terrain", blocks.make_block, last)
    paths = {name: getattr(options, name) for name in _RASTERS if getattr(options, name)}
    slopes, cut = run_whole(_write, (paths, surface, made, search), Part(progress, 0.9, 0.97), "writing the terrain")
    if cut is not None:
        progress.warn(cut.finding(search.slope))
    known, objects, terrain = (sum(getattr(block, name) for block in made) for name in ("known", "objects", "terrain"))
    result = DtmResult(
        output=options.output,
        heights=options.heights,
        mask=options.mask,
        report=options.report,
        objects_percent=100.0 * objects / max(known, 1),
        valid_percent=100.0 * terrain / (rows * columns),
        vertical_datum=surface.datum.name if surface.datum else None,
        seconds=0.0,
    )
    progress.info(
        f"{result.objects_percent:.1f} % of the DSM's heights belong to objects; {result.valid_percent:.1f} % of "
        "the cells have a terrain."
    )
    warn_all(progress, of_terrain(result.objects_percent))
    if options.report:
        terrain_page(options, surface, result).of(surface_title(surface.path)).write(options.report, progress)
    progress.step(1.0, "Terrain made")
    return result, slopes


def _write(
    task: Tuple[Dict[str, str], Surface, List[blocks.Block], blocks.Search], progress: Progress
) -> Tuple[Slopes, Optional[Cut]]:
    """The rasters with their styles; all of them get their names when the last one is complete. Gives the DSM's slopes,
    and what the terrain lacks on steep ground."""
    paths, surface, made, search = task
    shape = (surface.size[1], surface.size[0])
    with ExitStack() as stack:
        files = {}
        for name, path in paths.items():
            band, unit = _RASTERS[name]
            whole = name == "mask"
            kind = np.uint8 if whole else np.float32
            raster = created(
                path,
                RasterFrame(shape, kind, 1, surface.transform, surface.crs),
                nodata=blocks.UNKNOWN if whole else NODATA,
                descriptions=(band,),
                metadata=surface.tags if name == "output" else {},
                unit=unit,
                cog=True,
                overviews="NEAREST" if whole else "AVERAGE",
            )
            files[name] = stack.enter_context(raster)
        for number, block in enumerate(made):
            progress.check_cancelled()
            progress.step(number / len(made), "writing the terrain")
            with np.load(block.path, allow_pickle=False) as stored:
                for name, file in files.items():
                    file.write(stored[name], block.own.col, block.own.row)
                    file.flush()  # so that GDAL's cache does not grow
    for name, path in paths.items():
        write_style(product("dtm", name).style, path)
    check, choices = progress.check_cancelled, search.parameters.steepness
    slopes = slopes_of(surface, check, choices)
    return slopes, cut_of(slopes, surface, paths["output"], search.slope, check, choices)
