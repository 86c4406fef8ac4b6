"""From images to a DSM: the four stages in one workspace, each continued where an earlier run stopped."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Callable, Dict, List, Sequence, TypeVar

from osgeo import ogr

from ..contracts.options import PRESETS, PREVIEW, Options, PipelineOptions
from ..contracts.products import FOLDER, paths_of
from ..contracts.records import ViewPair
from ..contracts.results import FusedSurface, PipelineResult, Result
from ..geometry.footprints import bounds_of
from ..imagery.deliveries import with_images
from ..matching.backends import matched_pairs, require, resolve
from ..names import scene_title
from ..planning.disk_space import Need, fusion_needs, heights_need, require_space
from ..planning.overlap import views_of
from ..planning.run_estimate import TimeLeft
from ..pointing.control_places import require_places
from ..pointing.ground_control import read_gcps
from ..reports.stage_reports import pipeline_report
from ..runtime.parallel import kept_workers
from ..runtime.progress import Part, Progress, Recorder, Silent
from ..runtime.workspace import ensure_folder, with_copy
from ..scene import Scene
from ..solids.ept import require_ept_place
from . import dsmfuse, epmfit, preview, reconstruct, refine, register
from .early import cell_of, require_cell, require_ortho_cell
from .parameters import ENGINE, EngineParameters

_REDUCED, _FITTED, _REFINED = 0.05, 0.08, 0.1
"""The progress of the whole when the images of a preview are there, the cameras, and their refinement."""
Own = TypeVar("Own", bound=Options)
R = TypeVar("R", bound=Result)


def run(options: PipelineOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> PipelineResult:
    """Run all stages; gives every product, and the seconds of each stage."""
    with kept_workers():
        return _run(options, TimeLeft(progress), parameters)


def _run(options: PipelineOptions, clock: TimeLeft, parameters: EngineParameters) -> PipelineResult:
    progress = Recorder(clock)
    if options.preset != "none":
        values = ", ".join(f"{name.upper()} {value}" for name, value in PRESETS[options.preset].items())
        progress.info(f"Preset {options.preset}: {values}, where they are not given.")
    options = replace(options, fit=with_images(options.fit, progress))  # which refuses one image, too
    _check_early(options, parameters)
    seconds: Dict[str, float] = {}
    begin, reduced = 0.0, None
    if options.preset == PREVIEW:
        start = time.monotonic()
        options, reduced = preview.with_reduced_images(options, Part(progress, 0.0, _REDUCED))
        parameters = preview.parameters_of(parameters, reduced.step)
        begin, seconds[PREVIEW] = _REDUCED, round(time.monotonic() - start, 3)

    def stage(end: float, name: str, title: str, work: Callable[[Own, Progress, EngineParameters], R], own: Own) -> R:
        nonlocal begin
        start = time.monotonic()
        part = Part(progress, begin, end, title)
        part.step(0.0, "begins")
        result = work(own, part, parameters)
        begin, seconds[name] = end, round(time.monotonic() - start, 3)
        return result

    first = stage(_FITTED, "epmfit", "Pinhole cameras", epmfit.run, options.fit)
    scene = Scene.load(first.scene)
    xmin, ymin, xmax, ymax = bounds_of(ogr.CreateGeometryFromWkt(scene.area))
    require_cell(options.fuse.resolution, min(xmax - xmin, ymax - ymin), scene.gsd_m, parameters.tiles)
    cell = cell_of(options.fuse.resolution, scene.gsd_m, parameters.tiles)
    require_ortho_cell(options.fuse.ortho_resolution, cell, scene.gsd_m, parameters.tiles)
    if options.register is not None:
        register.require_references(options.register, scene, progress, parameters)
    pairs = reconstruct.pairs_of(scene, options.reconstruct, parameters)
    backend = resolve(options.reconstruct.backend)[0]
    require_space("this run", _needs(options, scene, matched_pairs(pairs, backend), parameters), progress)
    stage(_REFINED, "refine", "Refinement", refine.run, options.refine)
    expected = reconstruct.expected(options.reconstruct, parameters)
    if backend.name == "sgm" and not options.reconstruct.cluster:  # other backends were not measured
        progress.info(expected.sentence())
    last = [expected.ties_s + expected.matching_s, expected.fusion_s * (options.register is not None)]
    rest = sum(last) + expected.fusion_s
    clock.expect(rest)
    matched, registered = (_REFINED + (1.0 - _REFINED) * end / rest for end in accumulate(last))
    heights = stage(matched, "reconstruct", "Reconstruction", reconstruct.run, options.reconstruct)
    if options.register is not None:
        stage(registered, "register", "Registration", register.run, options.register)
    fused = stage(1.0, "dsmfuse", "Fusion", dsmfuse.run, options.fuse)
    scene_path = options.fuse.scene
    scene = Scene.load(scene_path)
    if scene.preset != options.preset:
        scene = replace(scene, preset=options.preset)
        scene.save(scene_path)
    seen = preview.seen_in(scene, fused, options, reduced, parameters) if reduced is not None else None
    low, high = (seen.altitudes if seen is not None else None) or (None, None)
    report_paths = with_copy(str(Path(options.fit.workspace) / "report.html"), options.report)
    result = PipelineResult(
        **fused.fields_of(FusedSurface),
        workspace=options.fit.workspace,
        tiles=first.tiles,
        tie_points=heights.tie_points,
        heights=heights.heights,
        report=report_paths[-1],
        scene=scene_path,
        rmse=first.rmse,
        max_error=first.max_error,
        n_tie_points=heights.n_tie_points,
        seconds=seconds,
        footprints=seen.footprints if seen is not None else None,
        overlaps=seen.overlaps if seen is not None else None,
        matched_images=seen.images if seen is not None else None,
        lowest=low,
        highest=high,
    )
    place = seen.place if seen is not None else None
    report = pipeline_report(scene, result, options.command, place).of(scene_title(scene, scene_path))
    for path in report_paths:
        report.write(path, progress)
    progress.step(1.0, "done")
    return result


def _needs(
    options: PipelineOptions, scene: Scene, matched: Sequence[ViewPair], parameters: EngineParameters
) -> List[Need]:
    """The disk space of all stages to come."""
    cell = cell_of(options.fuse.resolution, scene.gsd_m, parameters.tiles)
    colours = dsmfuse.colours_of(scene, options.fuse, Silent(), parameters)  # which refuses unfit XS now
    dsmfuse.spectra_of(scene, scene.crs, options.fuse, colours, Silent(), parameters)  # and so does this
    heights = heights_need(scene, matched, reconstruct.heights_folder(options.reconstruct))
    ortho = dsmfuse.ortho_cell(scene, options.fuse, cell, colours, parameters.ortho)
    bands = len(colours.names) if colours else 0
    return [heights, *fusion_needs(scene, matched, options.fuse, cell, bands=bands, ortho_cell=ortho)]


def _check_early(options: PipelineOptions, parameters: EngineParameters) -> None:
    """Options that can be refused early are refused before hours of matching."""
    require(options.reconstruct.backend)
    for product, path in paths_of("pipeline", options):
        ensure_folder(path if product.form == FOLDER else str(Path(path).parent))
    if options.fuse.ept:
        require_ept_place(options.fuse.ept)
    if options.reconstruct.gcps:
        views, gcps = views_of(options.fit, parameters.tiles.least_overlap_px), options.reconstruct.gcps
        require_places(read_gcps(gcps, views, options.reconstruct.gcp_datum), views, gcps, parameters.pointing)
