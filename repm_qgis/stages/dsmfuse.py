"""Fuse height maps into a DSM with confidence, orthophoto, point cloud and mesh."""

from __future__ import annotations

import math
import os
import re
import shutil
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple

from ..disk_space import fusion_needs, require_space
from ..dsm.coarse_means import CoarseMeans
from ..dsm.colour_ortho import make_colour_ortho
from ..dsm.colour_sources import ColourPlan, colour_plan
from ..dsm.derived import FinishedDsm, make_derived
from ..dsm.ept import require_ept_place
from ..dsm.fusion import FuseTask, StoredTile, fuse_to_disk
from ..dsm.ortho import nadir_first
from ..dsm.outliers import automatic_radius
from ..dsm.products import DsmLayout, cloud_of, write_cloud, write_products
from ..errors import EmptyResultError, OptionError, RepmError, SceneError
from ..evaluation.styles import height_limits, write_style
from ..geometry.frames import projected_crs_at
from ..geometry.gridding import widening
from ..geometry.vertical import HeightDatum
from ..imagery.raster import raster_identity
from ..memory import fusing_mib, tile_work, workers_within
from ..options import DsmFuseOptions, ViewerOptions, is_glb
from ..parallel import run_tasks, run_whole
from ..products import not_requested, paths_of, product, products_of
from ..progress import Part, Progress, counted
from ..records import DemOffset, FusionFacts, ViewPair
from ..registration.dem_offset import dem_offset
from ..registration.laying import prior_of
from ..scene import Scene
from ..workspace import ensure_folder, fingerprint, temporary_folder
from . import viewer
from .early import require_cell
from .kept import drop_others, kept_until_done
from .parameters import ENGINE, EngineParameters

_DRAPED = ("ortho", "confidence")


@dataclass(frozen=True)
class _Fusion:
    """What is fused: a scene's tiles, which all have heights, on the layout's cells; ``folder`` is for fused tiles."""

    options: DsmFuseOptions
    parameters: EngineParameters
    scene: Scene
    layout: DsmLayout
    folder: Path


def run(options: DsmFuseOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> Dict[str, Any]:
    """Grid, aggregate, filter and write; gives the products' paths and the share of valid cells."""
    start = time.monotonic()
    scene = reconstructed(options.scene)
    if options.ortho or options.viewer:
        scene.require_images()
    crs = options.crs or scene.crs
    projected_crs_at(crs, scene.frame.lon, scene.frame.lat)
    datum = HeightDatum.of(options.vertical_datum)
    datum.require(scene.frame.lon, scene.frame.lat)
    if options.ept:
        require_ept_place(options.ept)
    cell = options.resolution or _round_cell(parameters.tiles.cell_gsd * scene.gsd_m)
    layout = DsmLayout.of(scene, scene.tiles, crs, datum, cell)
    require_cell(options.resolution, min(layout.grid.shape) * layout.grid.cell, scene.gsd_m, parameters.tiles)
    radius = options.outlier_radius
    if radius is None:
        radius = automatic_radius(layout.grid.cell, scene.gsd_m, parameters.fusion.outliers)
    options = replace(options, outlier_radius=radius)
    rows, columns = layout.grid.shape
    cells = f"{columns} x {rows} cells of {layout.grid.cell:g} m in {crs}"
    progress.info(f"DSM of {cells}, heights above the {datum.name}; outlier radius {radius:g} m.")
    if widening(layout.grid.cell, scene.gsd_m, parameters.fusion.gridding) > 1:
        progress.info(
            f"Cells of {layout.grid.cell:g} m are finer than the images' ground sampling distance of {scene.gsd_m:.2g} "
            "m: between the matched points they are interpolated, and show no more detail."
        )
    pairs = sorted({record.pair for tile in scene.tiles for record in tile.heights}) if options.view_heights else []
    share = 1.0 / (1.0 + 0.7 * len(pairs))
    plan = colours_of(scene, options, progress, parameters)
    bands = len(plan.names) if plan else 0
    require_space("fusion", fusion_needs(scene, _matched(scene), options, cell, bands), progress)
    made: Dict[str, Any] = {each.option: getattr(options, each.option) for each in products_of("dsmfuse")}
    with kept_until_done(scene.folder("fusion"), "dsmfuse", progress) as kept, _draped(options, kept) as draped:
        grey = draped if plan is None else replace(draped, ortho=None)
        fusion = _Fusion(grey, parameters, scene, layout, _folder_of(kept, grey, scene, layout, parameters))
        drop_others(kept, fusion.folder)
        end = 0.8 * share if plan else share
        facts, stored = _fused(fusion, Part(progress, 0.0, end))
        ortho = None
        if plan is not None:
            ortho = draped.ortho or f"{fusion.folder}/colours.tif"
            place = options, ortho, layout, str(fusion.folder)
            make_colour_ortho(plan, *place, Part(progress, end, share), parameters.fusion)
            if options.ortho:
                write_style(product("dsmfuse", "ortho").style, options.ortho, taken=scene.taken())
        cloud = cloud_of(options, str(fusion.folder))
        if cloud:
            points = run_whole(_cloud_written, (cloud, layout, stored, ortho), progress, "writing the cloud")
            facts = replace(facts, points=points)
        finished = FinishedDsm(options, cloud if facts.points else None, datum.file_crs(crs), parameters.fusion, ortho)
        for each, path, file in make_derived(finished, progress):
            made[each.option] = path if file else None
            if file and each.style and not is_glb(file):
                write_style(each.style, file, height_limits(options.output))
        if options.viewer:
            shown = {name: getattr(draped, name) for name in ("viewer", *_DRAPED)}
            run_whole(viewer.written, ViewerOptions(dsm=options.output, **shown), progress, "making the page")
        for index, pair in enumerate(pairs):
            low, high = (share + (1 - share) * i / len(pairs) for i in (index, index + 1))
            _one_pair(fusion, pair, Part(progress, low, high))
    _log(replace(fusion, options=options), facts, [tile.needed for tile in stored], progress)
    progress.step(1.0, "DSM fused")
    seconds = round(time.monotonic() - start, 3)
    return {**made, "vertical_datum": datum.name, "seconds": seconds, **facts.to_mapping()}


@contextmanager
def _draped(options: DsmFuseOptions, folder: Path) -> Iterator[DsmFuseOptions]:
    """The options with all rasters that a page drapes, where one is asked for: temporary ones if nobody keeps them."""
    if not options.viewer:
        yield options
        return
    with temporary_folder(str(folder / "draped")) as name:
        ortho, confidence = (getattr(options, each) or f"{name}/{each}.tif" for each in _DRAPED)
        yield replace(options, ortho=ortho, confidence=confidence)


def reconstructed(path: str) -> Scene:
    """A scene with the tiles that have heights; raises SceneError where there are none."""
    scene = Scene.load(path)
    scene = replace(scene, tiles=tuple(tile for tile in scene.tiles if tile.heights))
    if not scene.tiles:
        raise SceneError(f"The scene '{path}' has no height maps: run 'Reconstruct heights' first.")
    return scene


def colours_of(
    scene: Scene, options: DsmFuseOptions, progress: Progress, parameters: EngineParameters = ENGINE
) -> Optional[ColourPlan]:
    """The colours of what is asked for; None where there are none, or where nothing shows them."""
    shown = options.ortho, options.cloud, options.ept, options.mesh, options.viewer
    if not any(shown) or options.colour == "greys":
        return None
    scene.require_images()
    plan = colour_plan(scene, options, progress, parameters.fusion)
    files = {os.path.realpath(path) for path in (plan.files if plan else ())}
    for each, path in paths_of("dsmfuse", options):
        if os.path.realpath(path) in files:
            reason = "is also an image that is read for its colours, which would be lost: choose another name"
            raise OptionError(each.option.upper(), path, reason)
    return plan


def _matched(scene: Scene) -> List[ViewPair]:
    """The pairs that the height maps were matched from; the first views of a tile where all were matched together."""
    made = {record.pair for tile in scene.tiles for record in tile.heights}
    return [pair for pair in scene.pairs if (pair.first, pair.second) in made]


def _folder_of(
    folder: Path, options: DsmFuseOptions, scene: Scene, layout: DsmLayout, parameters: EngineParameters
) -> Path:
    """The folder for the fused tiles of what is fused: another one wherever a tile would have other cells."""
    records = [record.to_mapping() for tile in scene.tiles for record in tile.heights]
    images = [raster_identity(view.image) for view in scene.views] if options.ortho else []
    chosen = options.method, options.fill, options.outlier_radius, bool(options.cloud or options.ept)
    cells = layout.crs, layout.grid.bounds, layout.grid.cell, layout.windows
    return folder / fingerprint(
        "dsmfuse", scene.fingerprint, records, images, chosen, cells, *parameters.in_fingerprint()
    )


def _fused(fusion: _Fusion, progress: Progress) -> Tuple[FusionFacts, List[StoredTile]]:
    """Fuse tile by tile and write the products, but for the cloud; gives what was counted, and the tiles."""
    options, parameters, scene, layout = fusion.options, fusion.parameters, fusion.scene, fusion.layout
    task = FuseTask(
        scene=scene.lean(),
        bounds=scene.tiles[0].bounds,
        records=(),
        grid=layout.grid,
        window=layout.windows[0],
        crs=layout.crs,
        method=options.method,
        fill=options.fill,
        radius=options.outlier_radius or 0.0,
        ortho_views=tuple(nadir_first(scene)) if options.ortho else (),
        cloud=bool(options.cloud or options.ept),
        parameters=parameters.fusion,
        matching=parameters.matching,
    )
    places = zip(scene.tiles, layout.windows)
    tasks = [replace(task, bounds=tile.bounds, records=tile.heights, window=window) for tile, window in places]
    ensure_folder(str(fusion.folder))
    stored: List[StoredTile] = run_tasks(
        fuse_to_disk,
        [(task, f"{fusion.folder}/{i}.npz") for i, task in enumerate(tasks)],
        _workers(fusion, progress),
        progress,
        lambda work: f"fusing {work[0].records[0].tile}",
    )
    reused = sum(tile.reused for tile in stored)
    if reused:
        progress.info(f"Reused {reused} of {counted(len(stored), 'fused tile')} that an earlier run had finished.")
    facts: FusionFacts = run_whole(_written, (fusion, stored), progress, "writing the products")
    return facts, stored


def _written(task: Tuple[_Fusion, List[StoredTile]], progress: Progress) -> FusionFacts:
    """Write the products of all tiles, with their styles, and compare the heights with the scene's DEM."""
    fusion, stored = task
    options, folder, layout, numbers = fusion.options, str(fusion.folder), fusion.layout, fusion.parameters
    means = CoarseMeans(layout.grid, numbers.registration.dem_cells) if fusion.scene.dem else None
    facts = write_products(options, fusion.scene, layout, stored, folder, numbers.fusion, means)
    if means is not None:
        facts = replace(facts, dem_offset=_dem_offset(fusion, means, progress))
    for each, path in paths_of("dsmfuse", options):
        if each.style and not each.maker:
            write_style(each.style, path, taken=fusion.scene.taken())
    return facts


def _cloud_written(task: Tuple[str, DsmLayout, List[StoredTile], Optional[str]], progress: Progress) -> int:
    """The number of points that were written, with the colours of an orthophoto where there is one."""
    path, layout, stored, ortho = task
    return write_cloud(path, layout, stored, ortho)


def _dem_offset(fusion: _Fusion, means: CoarseMeans, progress: Progress) -> Optional[DemOffset]:
    """How far the DSM lies above the DEM; None, with the reason in the log, where that cannot be told."""
    scene, numbers = fusion.scene, fusion.parameters.registration
    surface = fusion.layout.crs, means.grid, means.means(numbers.covered)
    prior = prior_of(scene, fusion.parameters.pointing, numbers)
    try:
        return dem_offset(scene, *surface, prior, progress.check_cancelled, numbers)
    except RepmError as error:
        progress.info(f"The DSM was not compared with the DEM '{scene.dem}': {error}")
        return None


def _one_pair(fusion: _Fusion, pair: Tuple[str, str], progress: Progress) -> None:
    """The surface that one pair alone sees, with its confidence, on the DSM's cells: what the DSM was made of."""
    own = fusion.scene.with_tiles(lambda t: replace(t, heights=tuple(r for r in t.heights if r.pair == pair))).tiles
    tiles, windows = zip(*((tile, window) for tile, window in zip(own, fusion.layout.windows) if tile.heights))
    name = re.sub(r"[^\w.-]", "_", "_".join(pair))
    target = ensure_folder(str(fusion.options.view_heights))
    output, confidence = str(target / f"{name}.tif"), str(target / f"{name}_confidence.tif")
    wanted = {**not_requested("dsmfuse"), "output": output, "confidence": confidence, "fill": "none"}
    alone = replace(fusion.options, **wanted)
    # Without the DEM, which all pairs together are compared with.
    scene, layout = replace(fusion.scene, tiles=tiles, dem=""), replace(fusion.layout, windows=windows)
    folder = _folder_of(fusion.folder.parent, alone, scene, layout, fusion.parameters)
    try:
        _fused(replace(fusion, options=alone, scene=scene, layout=layout, folder=folder), progress)
    except EmptyResultError:
        progress.warn(f"{pair[0]} and {pair[1]} alone have no height in the DSM: '{Path(output).name}' is not written.")
    shutil.rmtree(folder, ignore_errors=True)  # with many pairs these would take much of the disk


def _workers(fusion: _Fusion, progress: Progress) -> int:
    """How many workers the memory allows, by the tile that takes most."""
    options, sizes = fusion.options, [[record.pixels for record in tile.heights] for tile in fusion.scene.tiles]
    each = [fusing_mib(pixels, w.width * w.height) for pixels, w in zip(sizes, fusion.layout.windows)]
    xmin, ymin, xmax, ymax = fusion.scene.tiles[each.index(max(each))].bounds
    side = math.ceil(max(xmax - xmin, ymax - ymin) / fusion.scene.gsd_m)
    return workers_within(options.workers, tile_work(side, max(each)), options.memory, progress)


def _round_cell(cell: float) -> float:
    """Two significant digits: a cell of 1.0 m, not of 1.0122 m."""
    return float(f"{cell:.2g}")


def _log(fusion: _Fusion, facts: FusionFacts, needed: List[int], progress: Progress) -> None:
    """What was filtered and filled, in the log."""
    options, radius = fusion.options, fusion.options.outlier_radius or 0.0
    if radius > 0:
        least = f"{min(needed)}" if min(needed) == max(needed) else f"{min(needed)} to {max(needed)}, by tile"
        progress.info(
            f"Removed {facts.removed} isolated cells: fewer neighbours within {radius:g} m than needed ({least})."
        )
    counts = facts.matched, facts.background, facts.interpolated
    matched, background, interpolated = (100.0 * count / facts.cells for count in counts)
    progress.info(
        f"Heights in {facts.valid_percent:.1f} % of {facts.cells} cells that two images see: "
        f"{matched:.1f} % matched, {background:.1f} % from the background of occlusions, "
        f"{interpolated:.1f} % interpolated."
    )
    if facts.dem_offset is not None:
        say = progress.warn if facts.dem_offset.unexpected else progress.info
        say(facts.dem_offset.sentence())
    if facts.interpolated and not options.confidence:
        cells = f"{facts.interpolated} cells of '{options.output}' are interpolated, not measured"
        progress.warn(f"{cells}: ask for CONFIDENCE to see which (band 4).")
    if facts.valid_percent < fusion.parameters.tiles.few_cells_percent:
        advice = "look at the confidence and at the reconstruction's report before you use this DSM"
        progress.warn(f"Only {facts.valid_percent:.0f} % of the cells have a height: {advice}.")
