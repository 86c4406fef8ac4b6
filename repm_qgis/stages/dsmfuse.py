"""Fuse height maps into a DSM with confidence, orthophoto, point cloud and mesh."""

from __future__ import annotations

import os
import re
import shutil
import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, List, Optional, Tuple

from ..contracts.documents import Keywords
from ..contracts.errors import EmptyResultError, ImageError, OptionError, SceneError
from ..contracts.file_kinds import is_textured
from ..contracts.findings import Finding
from ..contracts.formats import companions
from ..contracts.options import DsmFuseOptions, ViewerOptions
from ..contracts.paths import real_path
from ..contracts.products import paths_of, product, products_of
from ..contracts.records import FusionFacts, ViewPair
from ..contracts.results import DsmFuseResult
from ..exports.stac import require_times, write_item
from ..fusion.finished import FinishedSurface
from ..fusion.layout import DsmLayout
from ..fusion.outliers import needed_neighbours
from ..fusion.visible import nadir_first
from ..geometry.finer_cells import FinerCells, finer_cell
from ..geometry.frames import projected_crs_at
from ..geometry.gridding import widening
from ..geometry.ground_metric import metric_at
from ..geometry.vertical import HeightDatum
from ..imagery.raster import content_of
from ..names import scene_title
from ..ortho.colour_ortho import make_colour_ortho
from ..ortho.colour_sources import ColourPlan, colour_plan, water_sources
from ..ortho.grey_ortho import make_grey_ortho
from ..ortho.parameters import OrthoParameters
from ..ortho.spectra import Spectra
from ..planning.disk_space import fusion_needs, require_space
from ..reports.stage_reports import fusion_report
from ..reports.styles import height_limits, write_style
from ..reports.verdict import of_surface
from ..runtime.parallel import run_whole
from ..runtime.progress import Part, Progress, Recorder, warn_all
from ..runtime.together import join
from ..runtime.workspace import ensure_folder, temporary_folder
from ..scene import Scene
from ..solids.cloud import TilePoints, clouds_of, gathered_points, write_cloud
from ..solids.derived import FinishedDsm, make_derived
from ..solids.ept import require_ept_place
from ..solids.parameters import PaintingParameters
from . import viewer
from .early import cell_of, require_cell, require_ortho_cell
from .fusing import Fusion, fused
from .kept import drop_others, kept_until_done
from .parameters import ENGINE, EngineParameters

_DRAPED = ("ortho", "confidence")
_ORTHO, _POINTS = 0.25, 0.2  # of the time that the DSM takes, for the orthophoto and for the points of a cloud


def run(options: DsmFuseOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> DsmFuseResult:
    """Grid, aggregate, filter and write; gives the products' paths and the share of valid cells."""
    start, progress = time.monotonic(), Recorder(progress)
    scene = reconstructed(options.scene)
    scene.require_same_images()  # a town's brightness is of them, without an orthophoto as well
    layout = _laid_out(scene, options, progress, parameters)
    pairs = sorted({record.pair for tile in scene.tiles for record in tile.heights}) if options.view_heights else []
    plan = colours_of(scene, options, progress, parameters)
    spectra = spectra_of(scene, layout.crs, options, plan, progress, parameters)
    require_same = _same_images(scene, [*(plan.files if plan else ()), *(spectra.files if spectra else ())])
    bands = len(plan.names) if plan else 0
    ortho_m = ortho_cell(scene, options, layout.grid.cell, plan, parameters.ortho)
    needs = fusion_needs(scene, _matched(scene), options, layout.grid.cell, bands=bands, ortho_cell=ortho_m)
    require_space("fusion", needs, progress)
    whole = 1.0 / (1.0 + 0.7 * len(pairs))  # of the progress, for the products of all pairs together
    with kept_until_done(scene.folder("fusion"), "dsmfuse", progress) as kept, _draped(options, kept) as draped:
        fusion = replace(Fusion.in_folder(kept, draped, parameters, scene, layout), spectra=spectra)
        drop_others(kept, fusion.folder)
        clouds = clouds_of(options, str(fusion.folder))
        painted = bool(plan or draped.ortho)
        finer = (layout.grid.cell / ortho_m) ** 2
        weights = 1.0, _ORTHO * finer * painted, _POINTS * bool(clouds)
        ends = [whole * (end / sum(weights)) for end in accumulate(weights)]
        facts, stored = fused(fusion, Part(progress, 0.0, ends[0]))
        dsm = FinishedSurface.of(options.output, layout.crs, layout.datum)
        part = Part(progress, ends[0], ends[1])
        ortho = _orthophoto(fusion, dsm, plan, require_same, cell=ortho_m, progress=part) if painted else None
        colours = ortho if plan else None
        facts = _clouds(fusion, dsm, clouds, colours, facts, Part(progress, ends[1], ends[2]))
        cloud = clouds[-1] if facts.points else None
        finished = FinishedDsm(options, cloud, layout.file_crs, parameters.solids, colours)
        made = _derived(finished, progress)
        if options.viewer:
            shown = {name: getattr(draped, name) for name in ("viewer", *_DRAPED)}
            written = partial(viewer.written, name=scene_title(scene, options.scene))
            run_whole(written, ViewerOptions(dsm=options.output, **shown), progress, "making the page")
        _each_alone(fusion, pairs, Part(progress, whole, 1.0))
    require_same()
    if options.stac:
        titles = {each.option: (each.title, getattr(options, each.option)) for each in products_of("dsmfuse")}
        write_item(options.stac, scene, {name: each for name, each in titles.items() if name not in ("stac", "report")})
    _log(options, parameters, facts, progress)
    result = DsmFuseResult(
        output=options.output,
        confidence=options.confidence,
        ortho=options.ortho,
        water_mask=options.water_mask,
        cloud=options.cloud,
        ept=made.get("ept"),
        mesh=made.get("mesh"),
        view_heights=options.view_heights,
        viewer=options.viewer,
        stac=options.stac,
        vertical_datum=layout.datum.name,
        cells=facts.cells,
        valid=facts.valid,
        valid_percent=facts.valid_percent,
        matched=facts.matched,
        background=facts.background,
        interpolated=facts.interpolated,
        points=facts.points,
        removed=facts.removed,
        resolution=facts.resolution,
        crs=facts.crs,
        dem_offset=facts.dem_offset.to_mapping() if facts.dem_offset else None,
        needles=facts.needles,
        water=facts.water,
        water_m2=facts.water_m2,
        water_evidence=facts.water_evidence,
        report=options.report,
        seconds=round(time.monotonic() - start, 3),
    )
    if options.report:
        fusion_report(scene, result, options.scene).of(scene_title(scene, options.scene)).write(
            options.report, progress
        )
    progress.step(1.0, "DSM fused")
    return result


def _laid_out(scene: Scene, options: DsmFuseOptions, progress: Progress, parameters: EngineParameters) -> DsmLayout:
    """The DSM's cells; options that cannot be met are refused here.

    Raises SceneError, OptionError, MissingPackageError and WorkspaceError.
    """
    if options.ortho or options.viewer or options.water_mask or options.water == "flatten":
        scene.require_images()
    crs = options.crs or scene.crs
    projected_crs_at(crs, scene.frame.lon, scene.frame.lat)
    warn_all(progress, metric_at(crs, scene.frame.lon, scene.frame.lat).finding(crs))
    datum = HeightDatum.of(options.vertical_datum)
    datum.require(scene.frame.lon, scene.frame.lat)
    if options.ept:
        require_ept_place(options.ept)
    if options.stac:
        require_times(scene)
    cell, numbers = cell_of(options.resolution, scene.gsd_m, parameters.tiles), parameters.fusion
    layout = DsmLayout.of(scene, scene.tiles, crs, datum, cell)
    require_cell(options.resolution, min(layout.grid.shape) * cell, scene.gsd_m, parameters.tiles)
    require_ortho_cell(options.ortho_resolution, cell, scene.gsd_m, parameters.tiles)
    rows, columns = layout.grid.shape
    cells = f"{columns} x {rows} cells of {cell:g} m in {crs}"
    progress.info(f"DSM of {cells}, heights above the {datum.name}.")
    if widening(cell, scene.gsd_m, numbers.gridding) > 1:
        progress.info(
            f"Cells of {cell:g} m are finer than the images' ground sampling distance of {scene.gsd_m:.2g} "
            "m: between the matched points they are interpolated, and show no more detail."
        )
    return layout


@contextmanager
def _draped(options: DsmFuseOptions, folder: Path) -> Iterator[DsmFuseOptions]:
    """The options with all rasters that a page drapes, where one is asked for: temporary ones if they are no
    products."""
    if not options.viewer:
        yield options
        return
    with temporary_folder(str(folder / "draped")) as name:
        ortho, confidence = (getattr(options, each) or f"{name}/{each}.tif" for each in _DRAPED)
        yield replace(options, ortho=ortho, confidence=confidence)


def reconstructed(path: str) -> Scene:
    """A scene with the tiles that have heights; raises SceneError where there are none."""
    scene = Scene.load(path)
    scene.require_two_images()
    scene = replace(scene, tiles=tuple(tile for tile in scene.tiles if tile.heights))
    if not scene.tiles:
        raise SceneError(f"The scene '{path}' has no height maps: run 'Reconstruct heights' first.")
    return scene


def colours_of(
    scene: Scene, options: DsmFuseOptions, progress: Progress, parameters: EngineParameters = ENGINE
) -> Optional[ColourPlan]:
    """The colours of the requested products; None where there are none, or where no product shows them."""
    shown = options.ortho, options.cloud, options.ept, options.mesh, options.viewer
    if not any(shown) or options.colour == "greys":
        return None
    scene.require_images()
    plan = colour_plan(scene, options, progress, parameters.ortho.sharpening)
    _require_others(options, plan.files if plan else ())
    return plan


def ortho_cell(
    scene: Scene,
    options: DsmFuseOptions,
    cell: float,
    plan: Optional[ColourPlan],
    parameters: OrthoParameters = ENGINE.ortho,
) -> float:
    """The side (m) of the cells of an orthophoto of a DSM of a ``cell``: as asked for, or else the ground sampling
    distance of the finest image that it shows. One that nobody keeps has the DSM's own."""
    if options.ortho_resolution:
        return options.ortho_resolution
    if not options.ortho:
        return cell
    gsd_m = min(each.gsd_m for each in (plan.sources if plan else scene.views))
    return finer_cell(cell, gsd_m, parameters.nested)


def spectra_of(
    scene: Scene,
    crs: str,
    options: DsmFuseOptions,
    plan: Optional[ColourPlan],
    progress: Progress,
    parameters: EngineParameters = ENGINE,
) -> Optional[Spectra]:
    """The multispectral images that distinguish water from land; None where water is not requested, or no image can."""
    if not (options.water_mask or options.water == "flatten"):
        return None
    sources = water_sources(scene, options, plan, progress, parameters.ortho.sharpening)
    if not sources:
        return None
    spectra = Spectra.of(scene, crs, sources)
    _require_others(options, spectra.files)
    return spectra


def _require_others(options: DsmFuseOptions, images: Iterable[str]) -> None:
    """Raise OptionError for a product that would replace an image that is read for its colours."""
    files = {real_path(path) for path in images}
    for each, path in paths_of("dsmfuse", options):
        if real_path(path) in files:
            reason = "is also an image that is read for its colours, which would be lost: choose another name"
            raise OptionError(each.option.upper(), path, reason)


def _same_images(scene: Scene, images: Iterable[str]) -> Callable[[], None]:
    """What raises SceneError where an image of the scene is another one than it was made from, and ImageError where one
    of these ``images``, which are read for their colours only, has been replaced since this call."""
    known = {real_path(view.image) for view in scene.views}
    files = [path for path in images if real_path(path) not in known]
    before = {path: content_of(path) for path in files}

    def require() -> None:
        scene.require_same_images()
        for path, content in before.items():
            if content_of(path) != content:
                raise ImageError(f"'{path}' was replaced while its colours were read: run again with the right image.")

    return require


def _matched(scene: Scene) -> List[ViewPair]:
    """The pairs that the height maps were matched from; the first views of a tile where all were matched together."""
    made = {record.pair for tile in scene.tiles for record in tile.heights}
    return [pair for pair in scene.pairs if pair.names in made]


def _orthophoto(
    fusion: Fusion,
    dsm: FinishedSurface,
    plan: Optional[ColourPlan],
    require_same: Callable[[], None],
    *,
    cell: float,
    progress: Progress,
) -> str:
    """Make the orthophoto from the finished DSM, on cells of a side (m), in colour where there is a plan, and a
    temporary one if it is no product; gives its path."""
    wanted, folder = fusion.options.ortho, str(fusion.folder)
    path, numbers = wanted or f"{folder}/colours.tif", fusion.parameters.ortho
    columns, rows = FinerCells.over(dsm.grid, cell).fine.size
    progress.info(f"Orthophoto of {columns} x {rows} cells of {cell:g} m.")
    make = partial(make_colour_ortho, plan) if plan else partial(make_grey_ortho, nadir_first(fusion.scene))
    make(
        dsm,
        fusion.options,
        path=path,
        folder=folder,
        progress=progress,
        cell=cell,
        parameters=numbers,
        require_same=require_same,
    )
    if wanted:
        write_style(product("dsmfuse", "ortho").style, wanted, taken=fusion.scene.taken())
    return path


def _clouds(
    fusion: Fusion,
    dsm: FinishedSurface,
    clouds: List[str],
    ortho: Optional[str],
    facts: FusionFacts,
    progress: Progress,
) -> FusionFacts:
    """Write the clouds of the finished DSM, with the colours of an orthophoto where there is one; gives the facts with
    the number of their points."""
    if not clouds:
        return facts
    options, numbers = fusion.options, fusion.parameters
    tiles = gathered_points(
        fusion.scene,
        dsm,
        fusion.layout,
        options=options,
        folder=str(fusion.folder),
        progress=progress,
        parameters=numbers.solids.cloud,
        isolated=numbers.fusion.isolated,
        matching=numbers.matching,
    )
    points = 0
    for path in clouds:
        normals = options.cloud_normals and path == options.cloud
        parts = path, fusion.layout, tiles, ortho, normals, numbers.solids.painting
        points = run_whole(_cloud_written, parts, progress, "writing the cloud")
    return replace(facts, points=points)


def _cloud_written(
    task: Tuple[str, DsmLayout, List[TilePoints], Optional[str], bool, PaintingParameters], progress: Progress
) -> int:
    """The number of points that were written."""
    path, layout, tiles, ortho, normals, parameters = task
    return write_cloud(path, layout, tiles, ortho, normals, parameters)


def _derived(finished: FinishedDsm, progress: Progress) -> Dict[str, Optional[str]]:
    """Make what is made from the finished DSM, with its style; gives the option of each product and its path."""
    made: Dict[str, Optional[str]] = {}
    for each, path, file in make_derived(finished, progress):
        made[each.option] = path if file else None
        if file and each.style and not is_textured(file):
            write_style(each.style, file, height_limits(finished.options.output))
    return made


def _each_alone(fusion: Fusion, pairs: List[Tuple[str, str]], progress: Progress) -> None:
    """The surface of each pair alone, with its confidence, on the DSM's cells: the parts that the DSM was made of."""
    if pairs:
        folder = str(ensure_folder(str(fusion.options.view_heights)))
        files = [path for pair in pairs for path in paths_of("dsmfuse", _alone(fusion, pair).options)]
        join(folder, [os.path.basename(path) for each, file in files for path in (file, *companions(each, file))])
    for index, pair in enumerate(pairs):
        alone = _alone(fusion, pair)
        try:
            fused(alone, Part(progress, index / len(pairs), (index + 1) / len(pairs)))
        except EmptyResultError:
            file = Path(alone.options.output).name
            progress.warn(
                Finding(
                    "pair-without-heights",
                    f"{pair[0]} and {pair[1]} alone have no height in the DSM: '{file}' is not written.",
                )
            )
        shutil.rmtree(alone.folder, ignore_errors=True)  # with many pairs these would take much of the disk


def _alone(fusion: Fusion, pair: Tuple[str, str]) -> Fusion:
    """Make the surface of one pair alone, in the folder of VIEW_HEIGHTS."""
    own = fusion.scene.with_tiles(lambda t: replace(t, heights=tuple(r for r in t.heights if r.pair == pair))).tiles
    tiles, windows = zip(*((tile, window) for tile, window in zip(own, fusion.layout.windows) if tile.heights))
    # Without the DEM, which all pairs together are compared with.
    scene, layout = replace(fusion.scene, tiles=tiles, dem=""), replace(fusion.layout, windows=windows)
    place = ensure_folder(str(fusion.options.view_heights)) / re.sub(r"[^\w.-]", "_", "_".join(pair))
    left_out: Keywords = {each.option: None for each in products_of("dsmfuse")}
    made = {**left_out, "output": f"{place}.tif", "confidence": f"{place}_confidence.tif"}
    options = replace(fusion.options, fill="none", water="keep", **made)
    return Fusion.in_folder(fusion.folder.parent, options, fusion.parameters, scene, layout)


def _log(options: DsmFuseOptions, parameters: EngineParameters, facts: FusionFacts, progress: Progress) -> None:
    """Log the cells that were filtered and filled."""
    radius = options.outlier_radius
    if radius > 0:
        least = needed_neighbours(facts.resolution, radius, parameters.fusion.outliers)
        progress.info(
            f"Removed {facts.removed} isolated cells: they had fewer than {least} neighbours within {radius:g} m."
        )
    counts = facts.matched, facts.background, facts.interpolated
    matched, background, interpolated = (100.0 * count / facts.cells for count in counts)
    progress.info(
        f"Heights in {facts.valid_percent:.1f} % of {facts.cells} cells that two images see: "
        f"{matched:.1f} % matched, {background:.1f} % from the ground behind occlusions and in shadows and from "
        f"neighbouring cells, {interpolated:.1f} % interpolated."
    )
    if facts.dem_offset is not None and not facts.dem_offset.unexpected:
        progress.info(facts.dem_offset.sentence())
    if facts.interpolated and not options.confidence:
        cells = f"Cells of '{options.output}' that are interpolated, not measured: {facts.interpolated}"
        progress.info(f"{cells}. Ask for CONFIDENCE to see which (band 4).")
    warn_all(progress, of_surface(facts))
