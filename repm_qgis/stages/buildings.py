"""Buildings of a DSM: footprints with heights and their errors, and closed solids with simple roofs."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import Optional, Sequence, Tuple

from ..buildings.cityjson import write_cityjson
from ..buildings.finding import FoundBuildings, find_buildings, require_metres
from ..buildings.layer import write_footprints
from ..buildings.page import buildings_page
from ..contracts.findings import Finding
from ..contracts.options import BuildingsOptions, DtmOptions
from ..contracts.results import BuildingsResult
from ..evaluation.grids import Grid
from ..gate.companions import terrain_findings
from ..geometry.frames import flat_crs
from ..imagery.raster import opened
from ..names import surface_title
from ..reports.styles import write_style
from ..reports.verdict import of_buildings
from ..runtime.parallel import kept_workers, run_whole
from ..runtime.progress import Part, Progress, Recorder, counted, warn_all
from ..runtime.workspace import temporary_folder
from ..terrain.inputs import Surface, surface_of
from ..terrain.steepness import Slopes
from . import dtm
from .parameters import ENGINE, EngineParameters

_TERRAIN_SHARE = 0.5  # of the progress, where the terrain is made first
_Task = Tuple[BuildingsOptions, Surface, str, Optional[Slopes], str, Sequence[Finding], EngineParameters]


def run(options: BuildingsOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> BuildingsResult:
    """Find the buildings, and write them; gives the products' paths, and how many buildings there are.

    Raises ImageError and OverlapError for rasters that cannot be used, EmptyResultError where there is no ground,
    WorkspaceError, OutOfMemoryError and ClusterError.
    """
    start, progress = time.monotonic(), Recorder(progress)
    surface = surface_of(options.dsm, options.confidence)
    require_metres(surface)
    warn_all(progress, surface.findings)
    if options.dtm:
        warn_all(progress, terrain_findings(options.dsm, options.dtm, surface.usual_error))
    with kept_workers(), temporary_folder(options.output) as folder:
        terrain, share, slopes = options.dtm, 0.0, None
        if not terrain:
            terrain, share = f"{folder}/dtm.tif", _TERRAIN_SHARE
            ground = DtmOptions(
                dsm=options.dsm,
                confidence=options.confidence,
                output=terrain,
                workers=options.workers,
                memory=options.memory,
            )
            _, slopes = dtm.made(ground, Part(progress, 0.0, share), parameters)
        task = options, surface, str(terrain), slopes, folder, progress.findings, parameters
        result: BuildingsResult = run_whole(_found, task, Part(progress, share, 1.0), "finding buildings")
        progress.step(1.0, "Buildings found")
    return replace(result, seconds=round(time.monotonic() - start, 3))


def _found(task: _Task, progress: Progress) -> BuildingsResult:
    """The result, without its seconds."""
    options, surface, terrain, slopes, folder, before, parameters = task
    run = Recorder(progress, before)
    found = find_buildings(options, surface, terrain, slopes, folder, Part(run, 0.0, 0.9), parameters.buildings)
    figures = [(each.area, each.heights.measured, each.heights.gaps) for each in found.buildings]
    areas, measured, gaps = zip(*figures) if figures else ((), (), ())
    warn_all(run, [*found.warnings, *of_buildings(areas, measured, gaps, options.min_height, options.min_area)])
    if options.ortho and not found.shows_plants:
        progress.info(
            f"'{options.ortho}' names no near infrared band: only their heights distinguish trees from roofs."
        )
    progress.step(0.9, "writing the buildings")
    _write(options, found, terrain, run)
    roofed = sum(each.lod == 2 for each in found.buildings)
    progress.info(
        f"{counted(len(found.buildings), 'building')}, {roofed} of them with the planes of their roofs, on "
        f"{sum(each.area for each in found.buildings):.0f} m2."
    )
    return BuildingsResult(
        output=options.output,
        cityjson=options.cityjson,
        report=options.report,
        n_buildings=len(found.buildings),
        n_roofed=roofed,
        area_m2=float(sum(each.area for each in found.buildings)),
        volume_m3=float(sum(each.volume for each in found.buildings)),
        seconds=0.0,
    )


def _write(options: BuildingsOptions, found: FoundBuildings, terrain: str, run: Recorder) -> None:
    with opened(options.dsm) as dataset:
        crs = flat_crs(Grid.of(dataset).crs)
    write_footprints(options.output, crs.to_wkt("WKT2_2019"), found.buildings, os.path.basename(options.dsm))
    write_style("buildings", options.output)
    if options.cityjson:
        write_cityjson(options.cityjson, found.buildings, crs, found.surface.datum, surface_title(options.dsm))
    if options.report:
        buildings_page(options, found, terrain).of(surface_title(options.dsm)).write(options.report, run)
