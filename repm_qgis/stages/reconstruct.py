"""Tie points and relative pointing, then dense matching of every pair over every tile."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import Altitudes, Bounds, FloatArray
from ..contracts.errors import EmptyResultError
from ..contracts.findings import Finding
from ..contracts.options import ReconstructOptions
from ..contracts.paths import real_path
from ..contracts.records import HeightMapRecord, ViewPair
from ..contracts.results import ReconstructResult
from ..files.vector import Features, copy_layer, write_layer
from ..fusion.map_offsets import with_agreeing_maps
from ..imagery.enhancement import Stretch
from ..imagery.parameters import StretchParameters
from ..imagery.raster import raster_identity
from ..matching.backends import Backend, MatchingJob, match_scene, matched_pairs, pair_matcher, resolve
from ..matching.coarse_surface import coarse_surface
from ..matching.pair_backend import expected_factor
from ..matching.parameters import MatchingParameters
from ..names import scene_title
from ..planning.advice import advice
from ..planning.altitudes import AltitudeParameters
from ..planning.disk_space import heights_need, require_space
from ..planning.pair_selection import choose_pairs
from ..planning.run_estimate import RunEstimate, estimate_run
from ..pointing.adjustment import Adjustment
from ..pointing.control_heights import heights_off
from ..pointing.control_places import require_places
from ..pointing.ground_control import Gcp, read_gcps
from ..pointing.pointing import point_views
from ..pointing.vertical_parallax import largest_parallax
from ..reports.stage_reports import reconstruct_report
from ..reports.styles import write_style
from ..reports.verdict import of_run
from ..runtime.parallel import run_tasks
from ..runtime.progress import Part, Progress, Recorder, counted, warn_all
from ..runtime.workspace import ensure_folder, fingerprint, with_copy
from ..scene import Scene, Tile, View, folder_of, reusable
from ..stereo.height_maps import is_whole
from ..ties.tie_patches import covered_by_ties
from ..ties.tracks import Track
from .parameters import ENGINE, EngineParameters, TileParameters
from .refine import refined_tiles, with_surface

_END = 0.98  # of the progress, for ties and matching
Stretches = Dict[str, Stretch]  # by the views' names


@dataclass(frozen=True)
class _Inputs:
    """What a run begins with; ``key`` is the fingerprint of all that its height maps depend on."""

    scene: Scene
    backends: List[Backend]
    gcps: List[Gcp]
    elsewhere: List[Finding]
    key: str

    @classmethod
    def of(cls, options: ReconstructOptions, parameters: EngineParameters) -> _Inputs:
        backends = resolve(options.backend)
        scene = Scene.load(options.scene)
        scene.require_images()
        if not scene.refinement:
            scene = replace(scene, refinement="polynomial")
        elsewhere: List[Finding] = []
        gcps = read_gcps(options.gcps, scene.views, options.gcp_datum, elsewhere.append) if options.gcps else []
        # The contents of control points: QGIS writes those of a layer into another temporary file for every run.
        control = [gcp.to_mapping() for gcp in gcps] or None
        chosen = backends[0].name, options.pointing, options.adjustment, options.own_surface, control
        files = [raster_identity(path) for v in scene.views for path in (v.image, v.mask) if path]
        few = [options.pairs] if options.pairs != "best" else []
        others = *backends[0].settings(options), *few, *parameters.in_fingerprint()
        key = fingerprint("reconstruct", scene.fingerprint, *chosen, files, *others)
        return cls(scene, backends, gcps, elsewhere, key)

    def job(
        self, scene: Scene, stretches: Stretches, options: ReconstructOptions, parameters: MatchingParameters
    ) -> MatchingJob:
        """The matching of a scene that is made from these."""
        folder = heights_folder(options)
        return MatchingJob(scene, scene.tiles, scene.pairs, stretches, options, self.key, folder, parameters)


def expected(options: ReconstructOptions, parameters: EngineParameters = ENGINE) -> RunEstimate:
    """The time and memory from images to the DSM, without what an earlier run has left of the height maps."""
    parameters = parameters.of_quality(options.quality)
    inputs = _Inputs.of(options, parameters)
    return _expected(inputs, pairs_of(inputs.scene, options, parameters), options, parameters)


def _expected(
    inputs: _Inputs, pairs: Sequence[ViewPair], options: ReconstructOptions, parameters: EngineParameters
) -> RunEstimate:
    """The same, with what a run has read already."""
    job = inputs.job(replace(inputs.scene, pairs=tuple(pairs)), {}, options, parameters.matching)
    left = inputs.backends[0].share_left(job)
    pointed = not left and reusable(options.output_scene, "reconstruct", inputs.key) is not None
    estimate = estimate_run(inputs.scene, pairs, options.own_surface, options.workers, parameters.matching.sgm.paths)
    factor = left * expected_factor(pairs, options.matching_cost, parameters.matching.learned)
    return estimate._replace(ties_s=0.0 if pointed else estimate.ties_s, matching_s=factor * estimate.matching_s)


def run(options: ReconstructOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> ReconstructResult:
    """Point the views relative to each other, match tiles; gives the scene with height maps, ties, and the folder."""
    start, parameters, notes = time.monotonic(), parameters.of_quality(options.quality), Recorder(progress)
    inputs = _Inputs.of(options, parameters)
    scene, backends, key = inputs.scene, inputs.backends, inputs.key
    require_places(inputs.gcps, scene.views, options.gcps or "", parameters.pointing)
    place = Path(options.output_scene)
    report_path = str(place.with_name("reconstruction.html"))
    folder = ensure_folder(heights_folder(options))
    done = reusable(options.output_scene, "reconstruct", key)
    if done is not None and _complete(done, folder) and os.path.exists(done.tie_points):
        maps = counted(sum(len(t.heights) for t in done.tiles), "height map")
        progress.info(f"Reused {maps} and the relative pointing in '{options.output_scene}'.")
    else:
        warn_all(notes, inputs.elsewhere)
        pairs = pairs_of(scene, options, parameters)
        require_space("matching", [heights_need(scene, matched_pairs(pairs, backends[0]), str(folder))], progress)
        ties = f"{folder_of(place, 'tie_points')}.gpkg"
        scene = replace(scene, path=place, pairs=tuple(pairs), tie_points=ties, backend=backends[0].name)
        _log_pairs(scene, notes)
        times = _expected(inputs, pairs, options, parameters)
        tied = _END * times.ties_s / ((times.ties_s + times.matching_s) or 1.0)
        stretches = _stretches(scene, options.workers, parameters, Part(notes, 0.0, 0.1 * tied))
        scene = _pointed(scene, stretches, inputs.gcps, options, parameters, Part(notes, 0.1 * tied, 0.8 * tied))
        part = Part(notes, 0.8 * tied, tied)
        scene = _with_coarse_surface(scene, stretches, backends[0], options, parameters, part)
        job = inputs.job(scene, stretches, options, parameters.matching)
        scene = _matched(job, backends, parameters.tiles, Part(notes, tied, _END))
        part = Part(notes, _END, 1.0)
        scene = with_agreeing_maps(scene, options.workers, options.memory, part, parameters.fusion, parameters.matching)
        scene.require_same_images()  # at the end, too: one may have been replaced during the work
        warn_all(notes, of_run(scene))
        seconds, changes = time.monotonic() - start, parameters.changes()
        done = scene.recorded("reconstruct", key, options.to_json(), seconds, notes.findings, changes)
        done.save(options.output_scene)
    ties_path = with_copy(done.tie_points, options.tie_points)[-1]
    if ties_path != done.tie_points:
        copy_layer(done.tie_points, ties_path)
    write_style("tie_points", ties_path)  # of those that are reused too: their reader may have another language
    reconstruct_report(done).of(scene_title(done, options.output_scene)).write(report_path, notes)
    progress.step(1.0, "heights reconstructed")
    return ReconstructResult(
        output_scene=options.output_scene,
        tie_points=ties_path,
        heights=str(folder),
        report=report_path,
        n_tie_points=done.pointing.count if done.pointing else 0,
    )


def pairs_of(scene: Scene, options: ReconstructOptions, parameters: EngineParameters = ENGINE) -> List[ViewPair]:
    """The pairs that are matched, best first; raises SceneError for one image alone, EmptyResultError where no pair is
    usable."""
    scene.require_two_images()
    numbers = parameters.of_quality(options.quality).pointing.planning.pairs
    return choose_pairs(scene, numbers.fewest() if options.pairs == "fewest" else numbers)


def heights_folder(options: ReconstructOptions) -> str:
    """The folder of the height maps: the one that was given, or one beside the scene."""
    place = Path(options.output_scene)
    return options.heights or str(place.parent / f"{place.stem}_heights")


def _stretches(scene: Scene, workers: int, parameters: EngineParameters, progress: Progress) -> Stretches:
    """Each view's stretch: an image without overviews is read as a whole for it."""
    tasks = [(view, parameters.stretch) for view in scene.views]
    found = run_tasks(_stretch, tasks, workers, progress, lambda task: f"intensities of {task[0].name}")
    return {view.name: stretch for view, stretch in zip(scene.views, found)}


def _stretch(task: Tuple[View, StretchParameters]) -> Stretch:
    view, parameters = task
    return view.stretch(parameters)


def _log_pairs(scene: Scene, progress: Progress) -> None:
    """How many pairs of many views are matched."""
    possible = len(scene.views) * (len(scene.views) - 1) // 2
    if len(scene.pairs) < possible:
        angles = [pair.angle_deg for pair in scene.pairs]
        range_ = f"{min(angles):.1f} to {max(angles):.1f} degrees"
        progress.info(f"{len(scene.pairs)} of {possible} possible pairs of images will be matched, at {range_}.")


def _complete(scene: Scene, folder: Path) -> bool:
    """Whether all height maps are there, as they were written, in the folder where they are wanted."""
    records = [record for tile in scene.tiles for record in tile.heights]
    return all(real_path(Path(each.file).parent) == real_path(folder) and is_whole(each) for each in records)


def _pointed(
    scene: Scene,
    stretches: Stretches,
    gcps: Sequence[Gcp],
    options: ReconstructOptions,
    parameters: EngineParameters,
    progress: Progress,
) -> Scene:
    """The scene with its views pointed and its tiles' altitudes narrowed by the tie points, which are written."""
    if gcps and not any(gcp.role == "control" and gcp.pixels for gcp in gcps):
        remedy = "fill the fields view, col and row of points with the role control"
        effect = f"the absolute position is that of the vendors' RPCs; {remedy}"
        progress.warn(
            Finding("gcps-unmeasured", f"No control point of '{options.gcps}' was measured in an image: {effect}.")
        )
    tied = [pair for pair in scene.pairs if pair.tied]
    found = point_views(
        scene,
        tied,
        stretches,
        model=options.pointing,
        gcps=gcps,
        progress=progress,
        workers=options.workers,
        route=options.adjustment,
        parameters=parameters.pointing,
        altitudes=parameters.altitudes,
    )
    scene = replace(scene, views=tuple(found.views), pointing=found.figures)
    _write_ties(scene, found.tracks, found.adjusted, found.xy)
    off = heights_off(gcps, scene.views, tied, found.figures, parameters.pointing)
    if off is not None:
        progress.warn(off)
    warn_all(progress, advice(scene, scene.pairs, found.figures, parameters.pointing.planning))
    return _narrowed(scene, lambda bounds: found.altitudes(bounds, parameters.pointing), parameters.altitudes)


def _narrowed(scene: Scene, found: Callable[[Bounds], Optional[Altitudes]], parameters: AltitudeParameters) -> Scene:
    """The scene with the altitudes that were found for each tile, and headroom; its own where none were found."""

    def narrowed(tile: Tile) -> Tile:
        ends = found(tile.bounds)
        return replace(tile, altitudes=scene.altitudes if ends is None else parameters.around_ground(*ends))

    return scene.with_tiles(narrowed)


def _with_coarse_surface(
    scene: Scene,
    stretches: Stretches,
    backend: Backend,
    options: ReconstructOptions,
    parameters: EngineParameters,
    progress: Progress,
) -> Scene:
    """The scene with altitudes of the coarse surface, where ties do not cover it or the refinement needs it."""
    if covered_by_ties(scene, parameters.pointing.ties.patches) and not options.own_surface:
        return scene
    names = [pair.names for pair in scene.pairs]
    match = pair_matcher(backend)
    surface = coarse_surface(
        scene, names, stretches, match=match, workers=options.workers, progress=progress, parameters=parameters.matching
    )
    scene = _narrowed(scene, surface.altitudes, parameters.altitudes)
    if not options.own_surface:
        return scene
    source = surface.write(str(scene.folder("surface") / "coarse.tif"), scene.crs)
    scene = with_surface(scene, source, parameters, progress)
    return refined_tiles(scene, options.workers, options.memory, progress)


def _write_ties(scene: Scene, tracks: Sequence[Track], adjusted: Adjustment, xy: FloatArray) -> None:
    rows, directions = largest_parallax(scene.views, tracks, adjusted.ground)
    figures = np.column_stack([adjusted.ground[:, 2], adjusted.residual_px, adjusted.before_px, rows, directions])

    def features() -> Features:
        for number, (track, (x, y), values) in enumerate(zip(tracks, xy, figures.tolist())):
            point = ogr.Geometry(ogr.wkbPoint)
            point.AddPoint_2D(float(x), float(y))
            yield point, (number, ", ".join(sorted(track.pixels)), *values)

    fields: Dict[str, type] = {"track": int, "views": str}
    fields.update(dict.fromkeys(("height", "residual", "before", "row", "direction"), float))
    write_layer(scene.tie_points, scene.crs, ogr.wkbPoint, fields, features())
    write_style("tie_points", scene.tie_points)


def _matched(job: MatchingJob, backends: Sequence[Backend], parameters: TileParameters, progress: Progress) -> Scene:
    """Match all pairs over all tiles; gives the scene with the height maps."""
    records = match_scene(job, backends, progress)
    reused = sum(bool(record and record.reused) for record in records)
    if reused:
        progress.info(f"Reused {reused} of {len(records)} height maps that an earlier run had finished.")
    remade = ", ".join(f"'{record.file}'" for record in records if record and record.remade)
    if remade:
        progress.warn(Finding("maps-remade", f"These height maps were damaged and have been made again: {remade}."))
    _check(records, parameters, progress)
    kept = [replace(record, reused=False, remade=False) for record in records if record and record.valid]
    return job.scene.with_tiles(lambda tile: replace(tile, heights=tuple(r for r in kept if r.tile == tile.id)))


def _check(records: Sequence[Optional[HeightMapRecord]], parameters: TileParameters, progress: Progress) -> None:
    made = [record for record in records if record]
    pixels = sum(record.pixels for record in made)
    valid = sum(record.valid for record in made)
    if valid < max(parameters.least_matched, parameters.least_matched_share * pixels):
        question = "Are the altitudes right, and do the images show the same ground without clouds?"
        found = f"only {valid} of {pixels} pixels on {len(made)} of {len(records)} tile pairs"
        raise EmptyResultError(f"Matching found heights for {found}. {question}")
    found = f"{100 * valid / pixels:.0f} % of {pixels / 1e6:.1f} million pixels on {counted(len(made), 'tile pair')}"
    progress.info(f"Heights for {found}; the empty corners of rectified images are counted as pixels without a height.")
