"""From images to a DSM: the four stages in one workspace, each taken up where an earlier run left it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Callable, Dict

from ..dsm.ept import require_ept_place
from ..evaluation.stage_reports import pipeline_report
from ..geometry.vertical import HeightDatum
from ..matching.backends import require
from ..options import DsmFuseOptions, PipelineOptions, ReconstructOptions, RefineOptions
from ..parallel import kept_workers
from ..progress import Part, Progress
from ..scene import Scene, load_views
from ..sfm.ground_control import read_gcps
from ..workspace import ensure_folder
from . import dsmfuse, epmfit, reconstruct, refine

_SHARES = {"epmfit": 0.15, "refine": 0.2, "reconstruct": 0.85, "dsmfuse": 1.0}
"""How far the whole has come when each stage ends."""


def run(options: PipelineOptions, progress: Progress) -> Dict[str, Any]:
    """Run all stages; gives every product, and the seconds of each stage."""
    with kept_workers():
        return _run(options, progress)


def _run(options: PipelineOptions, progress: Progress) -> Dict[str, Any]:
    require(options.backend)  # refused, if at all, before any work
    folder = ensure_folder(options.workspace)
    for path in (
        options.output,
        options.confidence,
        options.ortho,
        options.cloud,
        options.ept,
        options.mesh,
        options.report,
    ):
        if path:  # hours of matching are not to end at a folder that cannot be written
            ensure_folder(str(Path(path).parent))
    if options.ept:
        require_ept_place(options.ept)
    if options.gcps:  # nor at a table's misspelt field
        read_gcps(options.gcps, load_views(options.images, options.rpcs), options.gcp_datum)
    datum = HeightDatum.of(options.vertical_datum)
    fitted, refined, scene_path = (str(folder / name) for name in ("scene.json", "refined.json", "reconstructed.json"))
    seconds: Dict[str, float] = {}
    begin = 0.0

    def stage(name: str, title: str, work: Callable[[Progress], Dict[str, Any]]) -> Dict[str, Any]:
        nonlocal begin
        start = time.monotonic()
        part = Part(progress, begin, _SHARES[name], title)
        part.step(0.0, "begins")
        result = work(part)
        begin, seconds[name] = _SHARES[name], round(time.monotonic() - start, 3)
        return result

    first = stage("epmfit", "Pinhole cameras", lambda p: epmfit.run(options.fit_options(), p))
    middle = Scene.load(fitted).frame
    datum.require(middle.lon, middle.lat)
    surface = options.dem if options.model == "terrain" else None
    # Without a DEM the surface is that of the coarse level, which needs the pointing: the next stage refines on it.
    own = options.model == "terrain" and not surface
    stage(
        "refine",
        "Refinement",
        lambda p: refine.run(
            RefineOptions(
                fitted, refined, "polynomial" if own else options.model, surface, options.order, write_images=False
            ),
            p,
        ),
    )
    heights = stage(
        "reconstruct",
        "Reconstruction",
        lambda p: reconstruct.run(
            ReconstructOptions(
                refined,
                scene_path,
                options.backend,
                options.gcps,
                options.gcp_datum,
                options.pointing,
                options.tie_points,
                workers=options.workers,
                adjustment=options.adjustment,
                memory=options.memory,
                geometric=options.geometric,
                colmap_fusion=options.colmap_fusion,
                window_radius=options.window_radius,
                gpu_memory=options.gpu_memory,
                own_surface=own,
            ),
            p,
        ),
    )
    fused = stage(
        "dsmfuse",
        "Fusion",
        lambda p: dsmfuse.run(
            DsmFuseOptions(
                scene_path,
                options.output,
                options.resolution,
                options.crs,
                options.method,
                options.fill,
                options.outlier_radius,
                options.confidence,
                options.ortho,
                options.cloud,
                options.workers,
                options.vertical_datum,
                options.memory,
                options.ept,
                options.mesh,
                options.mesh_vertices,
                options.view_heights,
            ),
            p,
        ),
    )
    report_path = options.report or str(folder / "report.html")
    products = {
        **fused,
        "scene": scene_path,
        "report": report_path,
        "tiles": first["tiles"],
        "tie_points": heights["tie_points"],
        "heights": heights["heights"],
    }
    pipeline_report(Scene.load(scene_path), products, seconds, options.command).write(report_path)
    progress.step(1.0, "done")
    return {
        **products,
        "rmse": first["rmse"],
        "max_error": first["max_error"],
        "n_tie_points": heights["n_tie_points"],
        "seconds": seconds,
    }
