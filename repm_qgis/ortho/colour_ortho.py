"""The orthophoto in colour, made from the finished DSM block by block.

Three passes: what pansharpening needs is measured in each pair of images; colours at places all over the DSM balance
the views; then each block chooses its views and takes their colours. What hides a cell is looked for in the whole DSM
around a block, not in its tile alone. The result does not depend on the number of workers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Tuple

import numpy as np

from ..arrays import Altitudes, FloatArray, FloatImage, Floats, Mask, Size, Window
from ..fusion.layout import DsmLayout
from ..fusion.visible import blocked
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..geometry.footprints import ray_slope
from ..geometry.frames import geodetic_from_projected
from ..imagery.raster import NODATA, created, opened, read
from ..memory import Work, colouring_mib, workers_within
from ..options import DsmFuseOptions
from ..parallel import run_tasks
from ..progress import Part, Progress, counted
from ..scene import View
from ..workspace import ensure_folder, writing
from .colour_balance import balanced, contrasts
from .colour_sources import ColourPlan, ColourSource
from .pansharpening import Multispectral, fitted
from .parameters import OrthoParameters
from .view_choice import chosen_views, feathered_colours


@dataclass(frozen=True)
class ColourTask:
    """What a worker needs to make one block: the file of the DSM, whose ``grid`` and ``layout`` (without windows)
    say where it lies; how many cells away (``reach``) its surface may hide something; and the ``own`` cells.

    Each ``step``-th cell is compared between views; ``contrast`` is the unit of their differences; ``path`` is where
    the block's colours are kept.
    """

    plan: ColourPlan
    dsm: str
    grid: CellGrid
    layout: DsmLayout
    reach: int
    step: int
    parameters: OrthoParameters
    own: Window
    contrast: Tuple[float, ...] = ()
    path: str = ""

    def heights(self, window: Window) -> Floats:
        """(H, W) m above the ellipsoid; NaN where the DSM has none."""
        with opened(self.dsm) as dataset:
            height = read(dataset, window)
        return height + self.layout.undulation(self.grid.part(window))

    def colours(self, source: ColourSource, window: Window, height: Floats, step: int = 1) -> FloatImage:
        """(B, H, W) colours of every ``step``-th cell of a window of these heights; NaN where the view sees none."""
        nodes, crs = self.parameters.visibility.nodes, self.layout.crs
        found = source.colours(self.grid.part(window), height, crs, nodes, step)
        return np.where(self.seen(source.view, window, height)[::step, ::step], found, np.float32(np.nan))

    def seen(self, view: View, window: Window, height: Floats) -> Mask:
        """(H, W) the cells of a window of these heights that nothing hides from a view."""
        middle = geodetic_from_projected(self.layout.crs, np.array(self.grid.part(window).middle))
        east, north = ray_slope(view, middle, float(np.nanmedian(height)))
        steepness = max(math.hypot(east, north), 1e-9)
        right, up = (int(self.reach * way / steepness) for way in (east, north))
        wide = Window.spanning(
            max(window.col + min(right, 0), 0),
            max(window.row - max(up, 0), 0),
            min(window.col + window.width + max(right, 0), self.grid.size[0]),
            min(window.row + window.height - min(up, 0), self.grid.size[1]),
        )
        clearance = self.parameters.visibility.clearance_m
        hidden = blocked(view, self.grid.part(wide), self.heights(wide), self.layout.crs, clearance)
        mask: Mask = np.isfinite(height) & ~hidden[window.inside(wide)]
        return mask


def make_colour_ortho(
    plan: ColourPlan,
    options: DsmFuseOptions,
    path: str,
    layout: DsmLayout,
    folder: str,
    progress: Progress,
    parameters: OrthoParameters,
) -> None:
    """Write the orthophoto of the finished DSM (``options.output``) on its cells.

    ``folder`` is for blocks. Raises OverlapError for a multispectral image that shows nothing of its panchromatic one,
    WorkspaceError where the file cannot be written.
    """
    grid, heights = _cells(options.output)
    numbers = parameters.colour
    middle = geodetic_from_projected(layout.crs, np.array(grid.middle))
    steepest = max(float(np.linalg.norm(ray_slope(s.view, middle, sum(heights) / 2))) for s in plan.sources)
    reach = min(math.ceil((heights[1] - heights[0]) * steepest / grid.cell) + 1, numbers.reach_cells)
    side = numbers.block_cells + 2 * numbers.halo_cells
    takes = colouring_mib(side**2, numbers.most_views, len(plan.names))
    work = Work("one block of the orthophoto in colour", takes, lambda _: "choose COLOUR=greys")
    workers = workers_within(options.workers, work, options.memory, progress)
    plan = _sharpened(plan, sum(heights) / 2, workers, Part(progress, 0.0, 0.1), parameters)
    step = max(1, math.ceil(math.sqrt(grid.size[0] * grid.size[1] / parameters.balance.samples)))
    whole = ColourTask(
        plan, options.output, grid, replace(layout, windows=()), reach, step, parameters, Window(0, 0, 0, 0)
    )
    tasks = [replace(whole, own=own) for own, _ in overlapping_blocks(grid.size, numbers.block_cells)]
    sampled = run_tasks(_samples, tasks, workers, Part(progress, 0.1, 0.4), lambda _: "comparing the views' colours")
    plan, contrast = _balanced(plan, np.concatenate(sampled), progress, parameters)
    ensure_folder(folder)
    tasks = [
        replace(task, plan=plan, contrast=contrast, path=f"{folder}/colours_{index}.npy")
        for index, task in enumerate(tasks)
    ]
    run_tasks(_block, tasks, workers, Part(progress, 0.4, 0.95), lambda _: "taking colours")
    _write(path, plan, grid, options.output, tasks)


def _cells(dsm: str) -> Tuple[CellGrid, Altitudes]:
    """The cells of a DSM, and its least and greatest height."""
    with opened(dsm) as dataset:
        place, size = dataset.GetGeoTransform(), (dataset.RasterXSize, dataset.RasterYSize)
        low, high = dataset.GetRasterBand(1).ComputeRasterMinMax(False)
    return CellGrid(place[0], place[3], place[1], (size[1], size[0])), (low, high)


def _sharpened(
    plan: ColourPlan, level: float, workers: int, progress: Progress, parameters: OrthoParameters
) -> ColourPlan:
    """The plan with the weights and the shift of each pair of a panchromatic and a multispectral image."""
    pairs = [source.multispectral for source in plan.sources if source.multispectral is not None]
    if not pairs:
        return plan
    work = [(pair, level, parameters) for pair in pairs]
    found = run_tasks(_fit, work, workers, progress, lambda _: "comparing panchromatic and multispectral images")
    for pair in found:
        column, row = pair.shift
        progress.info(
            f"'{pair.image.image}' beside '{pair.pan.name}': correlation {pair.correlation:.2f}, moved by "
            f"{column:+.2f}, {row:+.2f} of its px."
        )
        if pair.correlation < parameters.sharpening.least_correlation:
            progress.warn(
                f"'{pair.image.image}' hardly resembles '{pair.pan.image}' (correlation {pair.correlation:.2f}): check "
                "that both are of one acquisition, or set PANSHARPEN=false."
            )
    return replace(plan, sources=tuple(replace(s, multispectral=pair) for s, pair in zip(plan.sources, found)))


def _fit(work: Tuple[Multispectral, float, OrthoParameters]) -> Multispectral:
    pair, level, parameters = work
    return fitted(pair, level, parameters.sharpening)


def _samples(task: ColourTask) -> FloatImage:
    """(N, views, bands) colours of every ``step``-th cell of a block that two views see."""
    height = task.heights(task.own)
    shape = 0, len(task.plan.sources), len(task.plan.names)
    if not np.isfinite(height).any():
        return np.empty(shape, np.float32)
    found = [task.colours(source, task.own, height, task.step) for source in task.plan.sources]
    samples = np.stack(found).reshape(*shape[1:], -1).transpose(2, 0, 1)
    shared: FloatImage = samples[np.isfinite(samples[..., 0]).sum(axis=1) > min(1, shape[1] - 1)]
    return shared


def _balanced(
    plan: ColourPlan, samples: FloatImage, progress: Progress, parameters: OrthoParameters
) -> Tuple[ColourPlan, Tuple[float, ...]]:
    """The plan with the gains and offsets of each view, and the contrast of the balanced colours."""
    gains, offsets = balanced(samples, parameters.balance)
    if len(plan.sources) > 1:
        ends = f"{gains.min():.2f} to {gains.max():.2f}"
        progress.info(f"Colours of {counted(len(plan.sources), 'view')} balanced: gains of {ends}.")
    sources = [replace(s, gains=tuple(g), offsets=tuple(o)) for s, g, o in zip(plan.sources, gains, offsets)]
    contrast: FloatArray = contrasts(samples * gains.astype(np.float32) + offsets.astype(np.float32))
    return replace(plan, sources=tuple(sources)), tuple(map(float, contrast))


def _block(task: ColourTask) -> str:
    """Write the colours of a block's own cells into a file of its own."""
    numbers = task.parameters.colour
    wide = task.own.grown(numbers.halo_cells, task.grid.size)
    height = task.heights(wide)
    inner = task.own.inside(wide)
    found = np.full((len(task.plan.names), *height.shape), np.nan, np.float32)
    chosen, colours, others = _candidates(task, wide, height) if np.isfinite(height).any() else ([], [], found)
    if chosen:
        middle = geodetic_from_projected(task.layout.crs, np.array(task.grid.part(wide).middle))
        level = float(np.nanmedian(height))
        steepness = [float(np.linalg.norm(ray_slope(source.view, middle, level))) for source in chosen]
        stack, contrast, seams = np.stack(colours), np.array(task.contrast), task.parameters.seams
        found = feathered_colours(stack, chosen_views(stack, steepness, contrast, seams), contrast, seams)
        found = np.where(np.isfinite(found), found, others)
    with writing(task.path):
        np.save(task.path, task.plan.stored(found[(slice(None), *inner)]))
    return task.path


def _candidates(
    task: ColourTask, window: Window, height: Floats
) -> Tuple[List[ColourSource], List[FloatImage], FloatImage]:
    """The views of a block among which each cell can choose, from the most vertical one on, with their colours; and
    (B, H, W) the colours of cells that none of these sees, but another view does."""
    numbers = task.parameters.colour
    missing = np.isfinite(height)
    worthwhile = numbers.worthwhile * missing.sum()
    chosen: List[ColourSource] = []
    colours: List[FloatImage] = []
    others = np.full((len(task.plan.names), *height.shape), np.nan, np.float32)
    for source in task.plan.sources:
        if len(chosen) >= numbers.least_views and not missing.any():
            break
        found = task.colours(source, window, height)
        shown = np.isfinite(found[0])
        few = len(chosen) < numbers.least_views and shown.any()
        if few or (len(chosen) < numbers.most_views and (shown & missing).sum() > worthwhile):
            chosen.append(source)
            colours.append(found)
        else:
            others = np.where(shown & missing, found, others)
        missing &= ~shown
    return chosen, colours, others


def _write(path: str, plan: ColourPlan, grid: CellGrid, dsm: str, tasks: List[ColourTask]) -> None:
    """Put the blocks together."""
    with opened(dsm) as dataset:
        crs, metadata = dataset.GetProjection(), dataset.GetMetadata()
    kept = {name: value for name, value in metadata.items() if name in ("REPM_SCENE", "REPM_ENGINE")}
    size: Size = grid.size
    frame = (size[1], size[0]), np.dtype(plan.kind), len(plan.names), grid.geotransform, crs
    nodata = NODATA if plan.nodata is None else plan.nodata
    with created(path, *frame, nodata=nodata, descriptions=plan.names, metadata=kept, cog=True) as raster:
        if plan.natural:
            raster.set_natural_colours()
        for task in tasks:
            for band, values in enumerate(np.load(task.path, allow_pickle=False), start=1):
                raster.write(values, task.own.col, task.own.row, band)
