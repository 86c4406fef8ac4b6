"""The height maps of a scene fused tile by tile on the DSM's cells, and the rasters that all tiles make."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import List, Optional, Tuple

from ..contracts.arrays import Window
from ..contracts.errors import RepmError
from ..contracts.findings import Finding
from ..contracts.options import DsmFuseOptions
from ..contracts.products import product
from ..contracts.records import DemOffset, FusionFacts
from ..fusion.brightness import Witnesses
from ..fusion.coarse_means import CoarseMeans
from ..fusion.joining import JoinedTiles, join_tiles
from ..fusion.layout import DsmLayout
from ..fusion.needles import largest_needle
from ..fusion.rasters import write_products
from ..fusion.surface import Block, LightTask, SurfaceTask, blocks_of, halo, light_block, make_block
from ..fusion.tile_fusion import FuseTask, StoredTile, fuse_to_disk
from ..fusion.walls import has_walls
from ..fusion.water import DARK, Water, find_water
from ..fusion.water_index import WaterIndex
from ..geometry.ground_metric import metric_at
from ..registration.dem_offset import dem_offset, stated_height_deviation
from ..registration.laying import prior_of
from ..reports.styles import write_style
from ..runtime.memory import Work, fitting_mib, fusing_mib, tile_work, workers_within
from ..runtime.parallel import run_tasks, run_whole
from ..runtime.progress import KEPT, Part, Progress, Uneven, counted
from ..runtime.workspace import ensure_folder, fingerprint
from ..scene import Scene
from .parameters import EngineParameters

_TILES = 0.7  # of the fusion's progress, for the tiles


@dataclass(frozen=True)
class Fusion:
    """What is fused: a scene's tiles, which all have heights, on the layout's cells; ``folder`` is for fused tiles.
    ``spectra`` distinguish water from land."""

    options: DsmFuseOptions
    parameters: EngineParameters
    scene: Scene
    layout: DsmLayout
    folder: Path
    spectra: Optional[WaterIndex] = None

    @classmethod
    def in_folder(
        cls, kept: Path, options: DsmFuseOptions, parameters: EngineParameters, scene: Scene, layout: DsmLayout
    ) -> Fusion:
        """With its own folder in ``kept``: whatever changes the cells of a fused tile changes the folder."""
        records = [record.to_mapping() for tile in scene.tiles for record in tile.heights]
        chosen = options.method, options.fill, options.outlier_radius
        cells = layout.crs, layout.grid.bounds, layout.grid.cell, layout.windows
        parts = "dsmfuse", scene.fingerprint, records, chosen, cells, *parameters.in_fingerprint()
        return cls(options, parameters, scene, layout, kept / fingerprint(*parts))


def fused(fusion: Fusion, progress: Progress) -> Tuple[FusionFacts, List[StoredTile]]:
    """Fuse tile by tile and write DSM and confidence; gives what was counted, and the tiles."""
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
        radius=options.outlier_radius,
        parameters=parameters.fusion,
        matching=parameters.matching,
    )
    places = zip(scene.tiles, layout.windows)
    tasks = [replace(task, bounds=tile.bounds, records=tile.heights, window=window) for tile, window in places]
    ensure_folder(str(fusion.folder))
    works = [(task, f"{fusion.folder}/{i}.npz") for i, task in enumerate(tasks)]
    stored: List[StoredTile] = run_tasks(
        fuse_to_disk,
        works,
        _workers(fusion, progress),
        Uneven(progress, 0.0, _TILES, [KEPT if os.path.exists(path) else 1.0 for _, path in works]),
        lambda work: f"fusing {work[0].records[0].tile}",
    )
    reused = sum(tile.reused for tile in stored)
    if reused:
        progress.info(f"Reused {reused} of {counted(len(stored), 'fused tile')} that an earlier run had finished.")
    walls: bool = run_whole(_walls, fusion, progress, "looking for walls")
    joined: JoinedTiles = run_whole(_joined, (fusion, stored, walls), progress, "joining the tiles")
    blocks, gone = _chosen(fusion, joined, walls, Part(progress, _TILES, 1.0))
    if gone:
        progress.info(
            f"Removed {counted(gone, 'cell')} of spikes and pits: small groups of cells far above or below everything "
            "around them, which only one pair of images has."
        )
    water: Optional[Water] = None
    if options.water == "flatten" or options.water_mask:
        water = run_whole(_water, (fusion, joined, blocks), progress, "looking for water")
    facts: FusionFacts = run_whole(_written, (fusion, joined, blocks, water), progress, "writing the products")
    bodies = water.bodies if water else ()
    crs, frame = fusion.layout.crs, fusion.scene.frame
    area = sum(body.area for body in bodies) * metric_at(crs, frame.lon, frame.lat).area_per_unit
    evidence = water.evidence if water else ""
    return replace(facts, needles=gone, water=len(bodies), water_m2=area, water_evidence=evidence), stored


def _walls(fusion: Fusion, progress: Progress) -> bool:
    numbers = fusion.parameters.fusion
    subpixel, near_m = fusion.parameters.matching.subpixel, numbers.choice.near_m
    return has_walls(fusion.scene, numbers.walls, subpixel, numbers.isolated, near_m)


def _joined(task: Tuple[Fusion, List[StoredTile], bool], progress: Progress) -> JoinedTiles:
    fusion, stored, walls = task
    folder, numbers = str(fusion.folder), fusion.parameters.fusion
    return join_tiles(
        fusion.options, fusion.scene, fusion.layout, stored=stored, folder=folder, walls=walls, parameters=numbers
    )


def _chosen(fusion: Fusion, joined: JoinedTiles, walls: bool, progress: Progress) -> Tuple[List[Block], int]:
    """The surface of all blocks, and how many cells were needles."""
    options, numbers = fusion.options, fusion.parameters.fusion
    grid, name = fusion.layout.grid.part(joined.crop), f"{fusion.folder}/surface"
    lights = _lights(fusion, joined, Part(progress, 0.0, 0.3)) if walls else ()
    largest = largest_needle(grid.cell, fusion.scene.gsd_m, numbers.needles)
    around, filled = halo(grid, walls, largest, numbers), options.fill != "none"
    tasks = [
        SurfaceTask(block, wide, joined, grid, lights, filled, largest, numbers)
        for block, wide in blocks_of(grid, name, around, numbers)
    ]
    workers = _workers_of_blocks(fusion, [task.wide for task in tasks], progress)
    part = Part(progress, 0.3 if walls else 0.0, 1.0)
    gone: List[int] = run_tasks(make_block, tasks, workers, part, lambda _: "choosing heights")
    return [task.block for task in tasks], sum(gone)


def _lights(fusion: Fusion, joined: JoinedTiles, progress: Progress) -> Tuple[Block, ...]:
    """The intensities of the cells of all blocks."""
    numbers, grid = fusion.parameters.fusion, fusion.layout.grid.part(joined.crop)
    witnesses: Witnesses = run_whole(_witnesses, fusion, progress, "reading intensities")
    if len(witnesses.views) < len(fusion.scene.views):
        missing = counted(len(fusion.scene.views) - len(witnesses.views), "image")
        progress.info(f"{missing} of the scene cannot be found: the intensities of cells come from the others only.")
    around = numbers.brightness.hidden_cells
    tasks = [
        LightTask(block, wide, joined, grid, witnesses, numbers)
        for block, wide in blocks_of(grid, f"{fusion.folder}/light", around, numbers)
    ]
    workers = _workers_of_blocks(fusion, [task.wide for task in tasks], progress)
    run_tasks(light_block, tasks, workers, progress, lambda _: "comparing heights with the images")
    return tuple(task.block for task in tasks)


def _witnesses(fusion: Fusion, progress: Progress) -> Witnesses:
    return Witnesses.of(fusion.scene, fusion.layout.crs, fusion.parameters.stretch)


def _workers_of_blocks(fusion: Fusion, windows: List[Window], progress: Progress) -> int:
    """How many workers the memory allows, by the largest window of a block."""
    takes = fitting_mib(max(window.width * window.height for window in windows))
    work = Work("one block of the DSM", takes, lambda _: "choose a larger RESOLUTION")
    return workers_within(fusion.options.workers, work, fusion.options.memory, progress)


def _water(task: Tuple[Fusion, JoinedTiles, List[Block]], progress: Progress) -> Water:
    """The water of the surface, named in the log."""
    fusion, joined, blocks = task
    grid, numbers = fusion.layout.grid.part(joined.crop), fusion.parameters.fusion
    witnesses, check = _witnesses(fusion, progress), progress.check_cancelled
    water = find_water(blocks, grid, witnesses, check, numbers, fusion.spectra)
    rivers = [body for body in water.bodies if body.falls]
    lakes, area = len(water.bodies) - len(rivers), sum(body.area for body in water.bodies)
    found = f"{counted(lakes, 'lake')}, {counted(len(rivers), 'river')}"
    progress.info(f"Water was found on {area:.0f} m2: {found} ({water.evidence}).")
    _say_doubts(water, progress)
    return water


def _say_doubts(water: Water, progress: Progress) -> None:
    if water.patches:
        areas = counted(water.patches, "dark area")
        progress.info(f"Left out of the water: {areas}, because other ground that is as dark has the same NDWI.")
    if water.bodies and water.evidence.endswith(DARK):
        progress.warn(
            Finding(
                "water-unsure",
                "Dark, smooth ground, such as tarmac or deep shade, looks like water where no multispectral image "
                "shows it: check on the images what was found (WATER_MASK), or give XS.",
            )
        )
    unknown = [body for body in water.bodies if not body.known]
    if unknown:
        progress.warn(
            Finding(
                "water-level-unknown",
                f"The level of {counted(len(unknown), 'lake')} is not known, because too little of the shore has "
                "heights: WATER_MASK shows the water, but it is not flattened.",
            )
        )


def _written(task: Tuple[Fusion, JoinedTiles, List[Block], Optional[Water]], progress: Progress) -> FusionFacts:
    """Write DSM, confidence and water, with their styles, and compare the heights with the scene's DEM."""
    fusion, joined, blocks, water = task
    options, folder, layout, numbers = fusion.options, str(fusion.folder), fusion.layout, fusion.parameters
    means = CoarseMeans(layout.grid, numbers.registration.dem_cells) if fusion.scene.dem else None
    stated = stated_height_deviation(fusion.scene)
    facts = write_products(
        options,
        fusion.scene,
        layout,
        joined=joined,
        blocks=blocks,
        folder=folder,
        parameters=numbers.fusion,
        means=means,
        deviation_m=stated,
        water=water,
    )
    if means is not None:
        facts = replace(facts, dem_offset=_dem_offset(fusion, means, progress))
    for name in ("output", "confidence", "water_mask"):
        path = getattr(options, name)
        if path:
            write_style(product("dsmfuse", name).style, path, taken=fusion.scene.taken())
    return facts


def _dem_offset(fusion: Fusion, means: CoarseMeans, progress: Progress) -> Optional[DemOffset]:
    """How far the DSM lies above the DEM; None, with the reason in the log, where it cannot be measured."""
    scene, numbers = fusion.scene, fusion.parameters.registration
    height = means.means(numbers.covered)
    prior = prior_of(scene, fusion.parameters.pointing.planning, numbers)
    try:
        check = progress.check_cancelled
        return dem_offset(
            scene, fusion.layout.crs, means.grid, height=height, prior=prior, check=check, parameters=numbers
        )
    except RepmError as error:
        progress.info(f"The DSM was not compared with the DEM '{scene.dem}': {error}")
        return None


def _workers(fusion: Fusion, progress: Progress) -> int:
    """How many workers the memory allows, by the tile that needs most."""
    options, sizes = fusion.options, [[record.pixels for record in tile.heights] for tile in fusion.scene.tiles]
    each = [fusing_mib(pixels, w.width * w.height) for pixels, w in zip(sizes, fusion.layout.windows)]
    xmin, ymin, xmax, ymax = fusion.scene.tiles[each.index(max(each))].bounds
    side = math.ceil(max(xmax - xmin, ymax - ymin) / fusion.scene.gsd_m)
    return workers_within(options.workers, tile_work(side, max(each)), options.memory, progress)
