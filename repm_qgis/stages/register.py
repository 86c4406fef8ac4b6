"""Lay reconstructed scenes onto references, and put the shifts into their images' pointing."""

from __future__ import annotations

import math
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Iterator, List, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import ogr

from ..contracts.errors import EmptyResultError, OverlapError, SceneError
from ..contracts.findings import Finding
from ..contracts.options import RegisterOptions
from ..contracts.products import registered_path
from ..contracts.records import GroundShift, RegistrationFigures
from ..contracts.results import RegisterResult
from ..files.vector import copy_layer, file_and_layer, write_layer
from ..fusion.own_surface import own_surface
from ..fusion.reference_waves import with_reference_waves
from ..gate.places import uncertain_findings
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..geometry.tiles import enclosing
from ..geometry.vertical import HeightDatum, named_datum
from ..imagery.raster import opened, raster_identity, read, write
from ..names import scene_title
from ..numerics.robust import nmad
from ..planning.height_uncertainty import height_le90_m
from ..registration.adjustment import Observation, Placed, contradictions, place_scenes
from ..registration.copies import copies
from ..registration.laying import Laid, OwnSurface, are_coarse, factor_for, finest_cell, lay, overlaps, prior_of
from ..registration.moved_scene import moved_scene
from ..registration.parameters import RegistrationParameters
from ..registration.references import FoundHeights, read_reference
from ..registration.solve import Prior, Shift, solve_shift
from ..registration.stable import stable_cells
from ..registration.surfaces import SupportMeans
from ..reports.registration_section import registration_page
from ..reports.styles import write_style
from ..reports.verdict import of_registration
from ..runtime.progress import Part, Progress, Recorder, warn_all
from ..runtime.workspace import ensure_folder, file_identity, fingerprint
from ..scene import Scene, folder_of, reusable
from .dsmfuse import reconstructed
from .parameters import ENGINE, EngineParameters


@dataclass(frozen=True)
class _Work:
    """One scene (whose path is that of the registered one), its surface, its prior, and the results of the
    references."""

    scene: Scene
    surface: OwnSurface
    prior: Prior
    laid: Tuple[Laid, ...]


def run(options: RegisterOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> RegisterResult:
    """Register; gives the scenes' paths, the shift (m east, north, up) and its standard deviations.

    Raises SceneError for a scene that has no heights, OverlapError for a reference that covers no scene,
    EmptyResultError for one with too few heights, OptionError for a datum that cannot be found, ImageError,
    InputTableError.
    """
    start, notes = time.monotonic(), Recorder(progress)
    datum = named_datum(options.reference_datum, "REFERENCE_DATUM")
    outputs = [options.output_scene, *map(registered_path, options.others)]
    scenes = [
        replace(_matched(path), path=Path(output)) for path, output in zip((options.scene, *options.others), outputs)
    ]
    key = _key(options, scenes, parameters)
    made = [scene for scene in (reusable(path, "register", key) for path in outputs) if scene and _whole(scene)]
    if len(made) == len(scenes):
        progress.info(f"Reused the registration in '{options.output_scene}'.")
    else:
        found = _registered(options, scenes, datum, notes, parameters)
        seconds, changes = round(time.monotonic() - start, 3), parameters.changes()
        chosen = options.to_json()
        made = [scene.recorded("register", key, chosen, seconds, notes.findings, changes) for scene in found]
        for scene, output in zip(made, outputs):
            scene.save(output)
    figures = _figures(made[0])
    _write_products(made[0], figures, options, notes)
    progress.step(1.0, "scene registered")
    east, north, up = figures.latest.moved
    east_deviation, north_deviation, up_deviation = figures.deviation
    return RegisterResult(
        output_scene=options.output_scene,
        differences=options.differences,
        offsets=options.offsets,
        report=options.report,
        other_scenes=tuple(outputs[1:]),
        east=east,
        north=north,
        up=up,
        determined=len(figures.determined),
        east_deviation=east_deviation,
        north_deviation=north_deviation,
        up_deviation=up_deviation,
        seconds=round(time.monotonic() - start, 3),
    )


def require_references(
    options: RegisterOptions, scene: Scene, progress: Progress, parameters: EngineParameters = ENGINE
) -> None:
    """Raise what reading the references over a scene raises, before anything is matched."""
    bounds, numbers = enclosing([tile.bounds for tile in scene.tiles]), parameters.registration
    cell = numbers.averaged_cells * finest_cell(bounds, parameters.tiles.cell_gsd * scene.gsd_m, numbers)
    around = bounds.grown(prior_of(scene, parameters.pointing.planning, numbers).most_m)
    for path in options.reference:
        read_reference(path, scene.crs, around, cell, progress.check_cancelled)


def _matched(path: str) -> Scene:
    """A scene that has heights, with all its tiles; raises SceneError where there are none."""
    scene = Scene.load(path)
    return scene if any(tile.heights for tile in scene.tiles) else reconstructed(path)


def _figures(scene: Scene) -> RegistrationFigures:
    if scene.registration is None:
        raise SceneError(f"The scene '{scene.path}' has no registration: register it again.")
    return scene.registration


def _whole(scene: Scene) -> bool:
    """Whether all is there that the registration of a scene has written beside it."""
    files = _figures(scene).differences, scene.tie_points
    return all(not file or os.path.exists(file) for file in files)


def _key(options: RegisterOptions, scenes: Sequence[Scene], parameters: EngineParameters) -> str:
    references = [_identity(path) for path in options.reference]
    stable = _identity(options.stable) if options.stable else None
    chosen = options.reference_datum, options.model
    made_from = [scene.fingerprint for scene in scenes]
    return fingerprint("register", made_from, references, stable, chosen, *parameters.in_fingerprint())


def _identity(path: str) -> List[object]:
    """What distinguishes a raster, a table or a cloud from a changed one."""
    file, layer = file_and_layer(path)
    return [layer, file_identity(file), raster_identity(file)]


# Finding the shifts -----------------------------------------------------------------------------------------------


def _registered(
    options: RegisterOptions,
    scenes: Sequence[Scene],
    datum: Optional[HeightDatum],
    progress: Progress,
    parameters: EngineParameters,
) -> List[Scene]:
    works, ends = [], np.linspace(0.0, 0.85, len(scenes) + 1)
    for scene, low, high in zip(scenes, ends, ends[1:]):
        works.append(_work(options, scene, datum, Part(progress, float(low), float(high)), parameters))
    observations, between = [], _between(works, Part(progress, 0.85, 0.95), parameters)
    for number, work in enumerate(works):
        observations += [Observation.of_shift(f"'{laid.reference.name}'", laid.shift, number) for laid in work.laid]
        if work.scene.pointing is not None and work.scene.pointing.control_information is not None:
            observations.append(Observation.of_control(work.scene.pointing.control_information, number))
    if not any(work.laid for work in works) and options.reference:
        names = ", ".join(f"'{path}'" for path in options.reference)
        raise OverlapError(f"No reference ({names}) covers the scene: choose one that does.")
    for name in dict.fromkeys(laid.reference.name for work in works for laid in work.laid):
        warn_all(progress, uncertain_findings(name))
    warn_all(progress, contradictions(observations, parameters.registration))
    observations += [Observation.of_shift("an overlap", shift, i, j) for i, j, shift in between]
    centres = [work.surface.grid.middle for work in works]
    placed = place_scenes(centres, [work.prior for work in works], observations)
    return [
        _moved(work, one, _neighbours(works, between, number), options, progress, parameters)
        for number, (work, one) in enumerate(zip(works, placed))
    ]


def _work(
    options: RegisterOptions,
    scene: Scene,
    datum: Optional[HeightDatum],
    progress: Progress,
    parameters: EngineParameters,
) -> _Work:
    """A scene's own surface, laid on all references that cover it."""
    numbers, check = parameters.registration, progress.check_cancelled
    prior = prior_of(scene, parameters.pointing.planning, numbers)
    bounds = enclosing([tile.bounds for tile in scene.tiles if tile.heights])
    native = parameters.tiles.cell_gsd * scene.gsd_m
    finest = finest_cell(bounds, native, numbers)
    found: List[FoundHeights] = []
    for path in options.reference:
        progress.step(0.0, f"reading {os.path.basename(path)}")
        try:
            around = bounds.grown(prior.most_m)
            found.append(read_reference(path, scene.crs, around, numbers.averaged_cells * finest, check))
            if found[-1].about:
                progress.info(f"'{os.path.basename(path)}': {found[-1].about}")
        except OverlapError:
            if len(options.others) + len(options.reference) < 2:
                raise
            progress.info(f"'{path}' does not cover the scene '{scene.path}'.")
    coarse = are_coarse(found, native, numbers) and not options.others
    finest = finest_cell(bounds, 2.0 * native, numbers) if coarse else finest
    grid, height = own_surface(
        scene,
        finest,
        options.workers,
        memory=options.memory,
        progress=Part(progress, 0.05, 0.8),
        coarse=coarse,
        parameters=parameters.fusion,
    )
    for later, first in reversed(copies(found, numbers)):
        text = (
            f"'{found[later].name}' has the same heights as '{found[first].name}': a copy is no second evidence, so it "
            "is left out."
        )
        progress.warn(Finding("reference-copied", text))
        del found[later]
    if options.stable:
        height[~stable_cells(options.stable, grid, scene.crs, progress.warn)] = np.nan
    surface = OwnSurface(scene.crs, grid, height).averaged(factor_for(found, finest, numbers), numbers.covered)
    laid = []
    for number, each in enumerate(found):
        progress.step(0.8 + 0.2 * number / len(found), f"laying the surface on {os.path.basename(each.name)}")
        laid.append(
            lay(surface, each, datum, prior=prior, tilted=options.model == "tilt", check=check, parameters=numbers)
        )
        _log(laid[-1], scene, prior, numbers, progress)
    return _Work(scene, surface, prior, tuple(laid))


def _promise(work: _Work, parameters: EngineParameters) -> Tuple[float, float]:
    """The CE90 and LE90 that are expected without a registration, m. The LE90 is the one in the scene's own report,
    which is larger than the usual error (the usual error serves to find the datum of a reference)."""
    numbers, ties = parameters.pointing.planning.promises, work.scene.pointing
    stated = height_le90_m(ties, parameters.pointing.planning) if ties is not None else None
    return numbers.ce90 * work.prior.horizontal_m, numbers.le90 * work.prior.up_m if stated is None else stated


def _between(works: Sequence[_Work], progress: Progress, parameters: EngineParameters) -> List[Tuple[int, int, Shift]]:
    """The shift of the first of two overlapping scenes onto the second, as both are now."""
    found = []
    for i, j in overlaps([work.surface for work in works]):
        first, second = works[i], works[j]
        reference = second.surface.as_reference(str(second.scene.path), first.scene.crs)
        means = SupportMeans(first.surface.grid, first.surface.height, reference, parameters.registration.covered)
        most = max(first.prior.most_m, second.prior.most_m)
        prior = Prior(math.hypot(first.prior.horizontal_m, second.prior.horizontal_m), first.prior.up_m, most)
        try:
            shift = solve_shift(means, reference, prior, False, progress.check_cancelled, parameters.registration)
        except EmptyResultError:
            continue
        found.append((i, j, shift))
        east, north, up = shift.ground.moved
        progress.info(
            f"'{second.scene.path}' lies ({east:+.2f}, {north:+.2f}, {up:+.2f}) m east, north and up of "
            f"'{first.scene.path}' where they overlap."
        )
    return found


def _neighbours(works: Sequence[_Work], between: Sequence[Tuple[int, int, Shift]], number: int) -> List[str]:
    """The scenes that one was placed together with, because they overlap."""
    others = [j if i == number else i for i, j, _ in between if number in (i, j)]
    return [str(works[other].scene.path) for other in others]


# Putting them into the scenes -------------------------------------------------------------------------------------


def _moved(
    work: _Work,
    placed: Placed,
    neighbours: Sequence[str],
    options: RegisterOptions,
    progress: Progress,
    parameters: EngineParameters,
) -> Scene:
    """The registered scene, with the layer and the raster that lie beside it."""
    scene, before = work.scene, work.scene.registration
    _require_found(work, placed, parameters.registration)
    changed, error = moved_scene(scene, placed.ground)
    differences = _write_differences(work, placed.ground)
    ties = ""
    if scene.tie_points and os.path.exists(scene.tie_points):
        ties = copy_layer(scene.tie_points, f"{folder_of(scene.path, 'tie_points')}.gpkg", placed.ground)
        write_style("tie_points", ties)
    east, north, up, *tilt = map(float, np.sqrt(np.diag(placed.covariance)))
    figures = RegistrationFigures(
        shift=before.shift.then(placed.ground) if before else placed.ground,
        matched=before.matched if before else {view.name: view.pointing for view in scene.views},
        latest=placed.ground,
        deviation=(east, north, up),
        tilt_deviation=(tilt[0], tilt[1]),
        determined=tuple((float(a), float(b)) for a, b in placed.determined),
        control=scene.pointing is not None and scene.pointing.control_information is not None,
        promised_m=_promise(work, parameters),
        pointing_px=error,
        references=tuple(laid.figures() for laid in work.laid),
        offsets=work.laid[0].shift.offsets if work.laid else (),
        differences=differences,
        neighbours=tuple(neighbours),
        matched_waves=before.matched_waves if before else {},
        waves_m=before.waves_m if before else None,
        waves_px=before.waves_px if before else 0.0,
    )
    _say(figures, progress)
    done = replace(changed, registration=figures, tie_points=ties)
    made = scene.record_of("reconstruct")
    asked = made is not None and made.options.get("pointing") == "jitter"
    if not (asked or any(view.jitter is not None for view in done.views)):
        return done  # where ties show no waves, errors of a reference would be mistaken for waves
    return with_reference_waves(
        done,
        [laid.reference for laid in work.laid],
        options.workers,
        memory=options.memory,
        progress=Part(progress, 0.95, 1.0),
        parameters=parameters.registration.waves,
    )


def _require_found(work: _Work, placed: Placed, numbers: RegistrationParameters) -> None:
    """Measure the heights again, where the surface lies now: what is stated must be found. Raises EmptyResultError.

    A position that is not determined stays, and houses stand elsewhere than those of the reference: then differences
    have their own spread.
    """
    for laid in work.laid:
        left, stated = laid.left_m(placed.ground), float(placed.deviations[2])
        apart = abs(placed.ground.moved[2] - laid.shift.moved[2])  # from other references, which has its own warning
        beside = nmad(laid.shift.after_m) if len(placed.determined) < 2 else 0.0
        most = numbers.contradiction * stated + numbers.least_contradiction_m + apart + beside
        if not abs(left) <= most:
            raise EmptyResultError(
                f"The heights of '{laid.reference.name}' give no reliable shift: after a move of "
                f"{placed.ground.moved[2]:+.2f} m in height they still lie {left:+.2f} m from the surface, where at "
                f"most {most:.2f} m are left of a sound one. Give a reference with more heights of this ground."
            )


def _say(figures: RegistrationFigures, progress: Progress) -> None:
    """Log the shift, with a warning where it is more than the vendor promises."""
    east, north, up = figures.latest.moved
    deviations = figures.deviation
    progress.info(
        f"The scene was moved by ({east:+.2f}, {north:+.2f}, {up:+.2f}) m to the east, to the north and up; the "
        f"standard deviations are {deviations[0]:.2f}, {deviations[1]:.2f} and {deviations[2]:.2f} m."
    )
    warn_all(progress, of_registration(figures))


def _log(laid: Laid, scene: Scene, prior: Prior, numbers: RegistrationParameters, progress: Progress) -> None:
    figures = laid.figures()
    east, north, up = figures.moved
    if laid.choice:
        if laid.choice.certain:
            progress.info(laid.choice.sentence)
        else:
            progress.warn(Finding("reference-datum-unsure", laid.choice.sentence))
    if laid.other_datum:
        progress.warn(Finding("reference-datum-contradicts", laid.other_datum, "doubt"))
    covered = laid.covered(numbers.cover_parts)
    if covered < numbers.least_covered:
        text = (
            f"'{figures.file}' has heights in {100 * covered:.0f} % of the scene only: the rest is moved by the same "
            "shift, which nothing there checks. Give a reference of the whole scene."
        )
        progress.warn(Finding("reference-covers-little", text))
    middle = geodetic_from_projected(scene.crs, np.array([laid.means.middle]))[0]
    cause = laid.cause(numbers.believable * prior.up_m, middle)
    if cause:
        text = (
            f"'{figures.file}' lies {up:+.1f} m from the scene in height, more than {numbers.believable:g} standard "
            f"deviations of the RPCs' errors ({prior.up_m:.1f} m) explain. It would lie {cause}: check its unit and "
            "REFERENCE_DATUM."
        )
        progress.warn(Finding("reference-unit-or-datum", text, "doubt"))
    progress.info(
        f"'{figures.file}': heights above the {figures.datum}{'' if laid.choice else f' ({figures.datum_from})'}; "
        f"{figures.used} of {figures.seen} heights on the scene's surface are used. They give a shift of "
        f"({east:+.2f}, {north:+.2f}, {up:+.2f}) m to the east, to the north and up; the NMAD of the differences goes "
        f"from {figures.before_m:.2f} to {figures.after_m:.2f} m."
    )


# Products ---------------------------------------------------------------------------------------------------------


def _write_differences(work: _Work, ground: GroundShift) -> str:
    """Both differences as a raster beside the scene: its cells have the width of the widest support, or more so that
    most have a value."""
    found = [laid.differences(ground) for laid in work.laid]
    if not found:
        return ""
    xy, before, after = (np.concatenate(parts) for parts in zip(*found))
    moved = work.surface.grid.bounds
    area = (moved.xmax - moved.xmin) * (moved.ymax - moved.ymin)
    widths = [max(laid.reference.width_m) for laid in work.laid]
    cell = max(*widths, work.surface.grid.cell, math.sqrt(area / max(len(xy), 1)))
    grid = CellGrid.covering(moved, cell)
    col = np.floor((xy[:, 0] - grid.west) / cell).astype(int)
    row = np.floor((grid.north - xy[:, 1]) / cell).astype(int)
    inside = (col >= 0) & (row >= 0) & (row < grid.shape[0]) & (col < grid.shape[1])
    index = row * grid.shape[1] + col
    bands = []
    for values in (before, after):
        use = inside & np.isfinite(values)
        count = np.bincount(index[use], minlength=grid.shape[0] * grid.shape[1])
        total = np.bincount(index[use], values[use], grid.shape[0] * grid.shape[1])
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        bands.append(mean.reshape(grid.shape).astype(np.float32))
    path = str(ensure_folder(str(folder_of(work.scene.path, "registration"))) / "differences.tif")
    wkt = pyproj.CRS.from_user_input(work.scene.crs).to_wkt()
    names = [f"reference minus surface {when} the registration (m)" for when in ("before", "after")]
    return write(path, bands, grid.geotransform, wkt, unit="m", descriptions=names)


def _write_products(scene: Scene, figures: RegistrationFigures, options: RegisterOptions, notes: Recorder) -> None:
    """The products that the user requested, from the files beside the scene."""
    if options.differences and figures.differences:
        with opened(figures.differences) as dataset:
            bands = [read(dataset, None, band) for band in (1, 2)]
            place, crs = dataset.GetGeoTransform(), dataset.GetProjection()
            names = [dataset.GetRasterBand(band).GetDescription() for band in (1, 2)]
        write(options.differences, bands, place, crs, unit="m", descriptions=names)
        write_style("differences", options.differences)
    if options.offsets:
        fields = dict.fromkeys(("east", "north", "up", "east_dev", "north_dev", "up_dev"), float)
        write_layer(options.offsets, scene.crs, ogr.wkbPoint, {"part": int, "heights": int, **fields}, _arrows(figures))
        longest = max((math.hypot(*offset.moved[:2]) for offset in figures.offsets), default=0.0)
        write_style("offsets", options.offsets, limits=(0.0, float(f"{longest / 2:.1g}") or 1.0))
    if options.report:
        page = registration_page(scene, figures)
        page.of(scene_title(scene, options.output_scene)).write(options.report, notes)


def _arrows(figures: RegistrationFigures) -> Iterator[Tuple[ogr.Geometry, Tuple[float, ...]]]:
    for number, offset in enumerate(figures.offsets, start=1):
        point = ogr.Geometry(ogr.wkbPoint)
        point.AddPoint_2D(offset.x, offset.y)
        yield point, (number, offset.count, *offset.moved, *offset.deviation)
