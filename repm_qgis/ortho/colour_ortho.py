"""The orthophoto in colour, made from the finished DSM block by block.

Three passes: the parameters of pansharpening are measured in each pair of images; colours at places all over the DSM
balance the views; then each block chooses its views and takes their colours. The visibility test of a cell looks at the
whole DSM around the block, not at its tile only. The result does not depend on the number of workers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Callable, List, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Floats, Window
from ..contracts.options import DsmFuseOptions
from ..fusion.finished import FinishedSurface
from ..geometry.cell_grid import overlapping_blocks
from ..geometry.footprints import ray_slope
from ..geometry.frames import geodetic_from_projected
from ..runtime.memory import Work, colouring_mib, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Part, Progress, counted
from ..runtime.workspace import ensure_folder, writing
from .colour_balance import balanced, contrasts
from .colour_sources import ColourPlan, ColourSource
from .pansharpening import Multispectral, fitted
from .parameters import ORTHO, OrthoParameters
from .seen_surface import Blocks, SeenSurface, write_blocks
from .view_choice import chosen_views, feathered_colours


@dataclass(frozen=True)
class ColourTask:
    """What a worker needs to make one block: the surface, and the ``own`` cells of the block.

    Each ``step``-th cell is compared between views; ``contrast`` is the unit of their differences; ``path`` is where
    the block's colours are kept.
    """

    plan: ColourPlan
    surface: SeenSurface
    step: int
    parameters: OrthoParameters
    own: Window
    contrast: Tuple[float, ...] = ()
    path: str = ""

    def colours(self, source: ColourSource, window: Window, height: Floats, step: int = 1) -> FloatImage:
        """(B, H, W) colours of every ``step``-th cell of a window of these heights; NaN where the view sees none."""
        dsm, visibility = self.surface.dsm, self.surface.parameters
        found = source.colours(dsm.grid.part(window), height, dsm.layout.crs, visibility, step)
        return np.where(self.surface.seen(source.view, window, height)[::step, ::step], found, np.float32(np.nan))


def make_colour_ortho(
    plan: ColourPlan,
    dsm: FinishedSurface,
    options: DsmFuseOptions,
    *,
    path: str,
    folder: str,
    progress: Progress,
    parameters: OrthoParameters = ORTHO,
    require_same: Callable[[], None] = lambda: None,
) -> None:
    """Write the orthophoto of a finished DSM on its cells.

    ``folder`` is for blocks; ``require_same`` is called when all pixels are read, before the file is made. Raises
    OverlapError for a multispectral image that shows nothing of its panchromatic one, WorkspaceError where the file
    cannot be written.
    """
    numbers = parameters.colour
    surface = SeenSurface.of(dsm, [source.view for source in plan.sources], parameters)
    side = parameters.block_cells + 2 * numbers.halo_cells
    takes = colouring_mib(side**2, numbers.most_views, len(plan.names))
    work = Work("one block of the orthophoto in colour", takes, lambda _: "choose COLOUR=greys")
    workers = workers_within(options.workers, work, options.memory, progress)
    plan = _sharpened(plan, surface.level, workers, Part(progress, 0.0, 0.1), parameters)
    size = dsm.grid.size
    step = max(1, math.ceil(math.sqrt(size[0] * size[1] / parameters.balance.samples)))
    whole = ColourTask(plan, surface, step, parameters, Window(0, 0, 0, 0))
    tasks = [replace(whole, own=own) for own, _ in overlapping_blocks(size, parameters.block_cells)]
    sampled = run_tasks(_samples, tasks, workers, Part(progress, 0.1, 0.4), lambda _: "comparing the views' colours")
    plan, contrast = _balanced(plan, np.concatenate(sampled), progress, parameters)
    ensure_folder(folder)
    tasks = [
        replace(task, plan=plan, contrast=contrast, path=f"{folder}/colours_{index}.npy")
        for index, task in enumerate(tasks)
    ]
    run_tasks(_block, tasks, workers, Part(progress, 0.4, 0.95), lambda _: "taking colours")
    parts = tuple((task.own, task.path) for task in tasks)
    require_same()
    write_blocks(path, Blocks(dsm, parts, plan.names, plan.kind, plan.nodata, plan.natural), progress)


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
    height = task.surface.dsm.heights(task.own)
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
    numbers, dsm = task.parameters.colour, task.surface.dsm
    wide = task.own.grown(numbers.halo_cells, dsm.grid.size)
    height = dsm.heights(wide)
    inner = task.own.inside(wide)
    found = np.full((len(task.plan.names), *height.shape), np.nan, np.float32)
    chosen, colours, others = _candidates(task, wide, height) if np.isfinite(height).any() else ([], [], found)
    if chosen:
        middle = geodetic_from_projected(dsm.layout.crs, np.array(dsm.grid.part(wide).middle))
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
