"""A preview: all the ground of all images at a multiple of their ground sampling distance, and what it shows.

The pipeline runs as always, on reduced images of its own workspace. Their RPCs are those of the images, scaled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import List, Optional, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatImage, Window
from ..contracts.errors import ImageError
from ..contracts.options import PREVIEW, PipelineOptions
from ..contracts.results import FusedSurface
from ..fusion.finished import FinishedSurface
from ..geometry.vertical import HeightDatum
from ..imagery.raster import NODATA, RasterFrame, created, opened, opened_masked, raster_identity, read
from ..planning.altitudes import AltitudeParameters
from ..planning.inspection import Place, inspect_views
from ..rpc.writers import rpc_tags
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..runtime.workspace import ensure_folder, fingerprint, write_text
from ..scene import Scene, View, load_views
from .inspect import write_footprints, write_overlaps
from .parameters import EngineParameters

REDUCTION = 8
"""Pixels of an image, along each side, for one of its preview."""

_LEAST_PX = 100  # a side of a reduced image: small images are reduced less
_STRIP = 64  # rows of a reduced image that are made at once
_SOURCE = "REPM_SOURCE"
_WHOLE_PIXELS = (".tif", ".tiff")  # overviews of other files are part of them, or as costly to do without
_NO_WALLS = 1e9
_WATER_CELLS = 600_000
_SUBPIXEL = ("step", "step", "median", "mean")
_LEAST_COVERED = 50.0  # %, of a surface that shows the altitudes where the sweep before it did not


@dataclass(frozen=True)
class Reduced:
    """The images of a preview: the views in full, and how many pixels of theirs are one of the preview's."""

    views: Tuple[View, ...]
    step: int


@dataclass(frozen=True)
class Preview:
    """What a preview shows beside its surface: the place with its pairs at the ground's altitude, the layers of both,
    the image files of matched pairs, and the altitudes to work in, m above the ellipsoid; None where it does not show
    them."""

    place: Place
    footprints: str
    overlaps: str
    images: Tuple[str, ...]
    altitudes: Optional[Altitudes]


def parameters_of(parameters: EngineParameters, step: int) -> EngineParameters:
    """The parameters of a preview: cells of a pixel, no walls, which such pixels do not show, water on fewer cells,
    fewer subpixel steps, and the sweep for altitudes at the scale that whole images have it."""
    planning = parameters.pointing.planning
    sweep = replace(planning.sweep, reduction=max(1, planning.sweep.reduction // step))
    pointing = replace(parameters.pointing, planning=replace(planning, sweep=sweep))
    fusion = parameters.fusion
    water = replace(fusion.water, most_cells=_WATER_CELLS, part_m=step * fusion.water.part_m)
    fusion = replace(fusion, walls=replace(fusion.walls, least_tail=_NO_WALLS), water=water)
    matching = parameters.matching
    matching = replace(matching, subpixel=replace(matching.subpixel, operations=_SUBPIXEL))
    tiles = replace(parameters.tiles, cell_gsd=1.0)
    return replace(parameters, pointing=pointing, matching=matching, fusion=fusion, tiles=tiles)


def with_reduced_images(options: PipelineOptions, progress: Progress) -> Tuple[PipelineOptions, Reduced]:
    """The options of a preview's run on reduced images, which are made in the workspace where they are not there yet.

    Raises whatever :func:`~repm_qgis.scene.load_views` raises, and WorkspaceError.
    """
    fit = options.fit
    views = load_views(fit.images, fit.rpcs, fit.masks, fit.extent is None, fit.ortho_ready_height)
    step = max(1, min(REDUCTION, min(min(view.size) for view in views) // _LEAST_PX))
    folder = ensure_folder(str(Path(fit.workspace) / "images"))
    tasks = [(view, step, str(folder / f"{view.name}.tif")) for view in views]
    progress.info(f"Images are read at {step} times their ground sampling distance.")
    run_tasks(_reduce, tasks, options.reconstruct.workers, progress, lambda task: f"reducing {task[0].name}")
    fit = replace(fit, images=tuple(path for _, _, path in tasks), rpcs=(), masks=())
    mask = options.fuse.water_mask or beside(options, "water.tif")
    return replace(options, fit=fit, fuse=replace(options.fuse, water_mask=mask)), Reduced(views, step)


def beside(options: PipelineOptions, name: str) -> str:
    """A file of the preview with this OUTPUT, in the workspace: QGIS may still show that of the preview before."""
    return str(Path(options.fit.workspace) / f"{Path(options.fuse.output).stem}_{name}")


def _reduce(task: Tuple[View, int, str]) -> None:
    """Write an image reduced, as floats, with its RPC, time, satellite and map; NaN where its mask excludes pixels."""
    view, step, path = task
    files = [raster_identity(file) for file in (view.image, view.mask) if file]
    plane = repr(view.plane)
    key = fingerprint(PREVIEW, step, view.band, view.rpc.digest, files, plane, view.acquired, view.sensor)
    if _is_made(path, key):
        return
    columns, rows = view.width // step, view.height // step
    place, crs, rpc = None, "", view.rpc.resampled(step, step)
    if view.plane is not None:
        rpc = view.rpc  # of lines of sight, in the sensor's own pixels
        x, right, row_right, y, col_down, down = view.plane.geotransform
        place, crs = (x, right * step, row_right * step, y, col_down * step, down * step), view.plane.crs
        height = f"terrainHAE = {view.plane.height!r};\n" if view.plane.source else ""
        write_text(str(Path(path).with_suffix(".IMD")), f'imageDescriptor = "ORStandard2A";\n{height}END;\n')
    frame = RasterFrame((rows, columns), np.float32, 1, place, crs)
    overviews = not view.image.lower().endswith(_WHOLE_PIXELS)
    with (
        opened_masked(view.image, view.mask, overviews) as image,
        created(path, frame, nodata=NODATA, metadata={_SOURCE: key}) as made,
    ):
        made.set_metadata(rpc_tags(rpc), "RPC")
        known = {"ACQUISITIONDATETIME": view.acquired.replace("T", " ").rstrip("Z"), "SATELLITEID": view.sensor}
        made.set_metadata({name: text for name, text in known.items() if text}, "IMAGERY")
        for row in range(0, rows, _STRIP):
            count = min(_STRIP, rows - row)
            window = Window(0, row * step, columns * step, count * step)
            made.write(read(image, window, view.band, (columns, count)), 0, row)


def _is_made(path: str, key: str) -> bool:
    if not Path(path).exists():
        return False
    try:
        with opened(path) as dataset:
            return bool(dataset.GetMetadataItem(_SOURCE) == key)
    except ImageError:
        return False


def seen_in(
    scene: Scene, fused: FusedSurface, options: PipelineOptions, reduced: Reduced, parameters: EngineParameters
) -> Preview:
    """What a finished preview shows; writes the layers of footprints and overlaps into the workspace."""
    kept = {view.name for view in scene.views}
    views = [view for view in reduced.views if view.name in kept]
    levels = _levels(fused, HeightDatum.of(options.fuse.vertical_datum))
    (place, *_) = inspect_views(
        views,
        parameters.tiles.least_overlap_px,
        parameters=parameters.pointing.planning,
        altitude=levels[1],
    )
    footprints, overlaps = (beside(options, f"{name}.gpkg") for name in ("footprints", "overlaps"))
    write_footprints([place], place.crs, footprints)
    write_overlaps([place], place.crs, overlaps)
    matched = {name for tile in scene.tiles for record in tile.heights if record.valid for name in record.pair}
    images = tuple(view.image for view in reduced.views if view.name in matched)
    altitudes = _altitudes(scene, fused.valid_percent, levels, parameters.altitudes)
    return Preview(place, footprints, overlaps, images, altitudes)


def _altitudes(
    scene: Scene, valid_percent: float, levels: Tuple[float, float, float], parameters: AltitudeParameters
) -> Optional[Altitudes]:
    """The range for the DSM: around the heights of the preview, which show no more of a building than a DEM, and never
    narrower than what the images showed before it; None where neither shows enough."""
    low, high = parameters.around_dem(levels[0], levels[2])
    record = scene.record_of("epmfit")
    if record is not None and any(each.id == "altitudes-of-rpcs" for each in record.warnings):
        return (low, high) if valid_percent >= _LEAST_COVERED else None
    return min(low, scene.altitudes[0]), max(high, scene.altitudes[1])


def _levels(fused: FusedSurface, datum: HeightDatum) -> Tuple[float, float, float]:
    """The least, the median and the greatest height of a DSM, m above the ellipsoid."""
    surface = FinishedSurface.of(fused.output, fused.crs, datum)
    rows, columns = surface.grid.shape
    found: List[FloatImage] = []
    ends: List[float] = []
    for row in range(0, rows, _STRIP):
        height = surface.heights(Window(0, row, columns, min(_STRIP, rows - row)))
        known = height[np.isfinite(height)]
        if known.size:
            ends += [float(known.min()), float(known.max())]
            found.append(known[:: max(1, known.size // 4096)])
    return min(ends), float(np.median(np.concatenate(found))), max(ends)
