"""The orthophoto in colour, made from the finished DSM block by block.

Three passes: the parameters of pansharpening are measured in each pair of images; colours at places all over the DSM
balance the views; then each block chooses its views and takes their colours. The visibility test of a cell looks at the
whole DSM around the block, not at its tile only. The result does not depend on the number of workers.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Callable, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Window
from ..contracts.findings import Finding
from ..contracts.options import DsmFuseOptions
from ..fusion.finished import FinishedSurface
from ..geometry.cell_grid import overlapping_blocks
from ..runtime.memory import Work, colouring_mib, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Part, Progress, counted
from ..runtime.workspace import ensure_folder
from .colour_balance import balanced, contrasts
from .colour_blocks import ColourTask, Parts, block, choice, finer_block, samples
from .colour_sources import ColourPlan
from .pansharpening import Multispectral, fitted
from .parameters import ORTHO, OrthoParameters
from .seen_surface import Blocks, SeenSurface, write_blocks


def make_colour_ortho(
    plan: ColourPlan,
    dsm: FinishedSurface,
    options: DsmFuseOptions,
    *,
    path: str,
    folder: str,
    progress: Progress,
    cell: float = 0.0,
    parameters: OrthoParameters = ORTHO,
    require_same: Callable[[], None] = lambda: None,
) -> None:
    """Write the orthophoto of a finished DSM on cells of a side (m, 0 for the DSM's own).

    ``folder`` is for blocks; ``require_same`` is called when all pixels are read, before the file is made. Raises
    OverlapError for a multispectral image that shows nothing of its panchromatic one, WorkspaceError where the file
    cannot be written.
    """
    numbers = parameters.colour
    surface = SeenSurface.of(dsm, [source.view for source in plan.sources], parameters, cell)
    side = parameters.block_cells + 2 * numbers.halo_cells
    takes = colouring_mib(side**2, numbers.most_views, len(plan.names))
    work = Work("one block of the orthophoto in colour", takes, lambda _: "choose COLOUR=greys")
    workers = workers_within(options.workers, work, options.memory, progress)
    plan = _sharpened(plan, surface.level, workers, Part(progress, 0.0, 0.1), parameters)
    size = dsm.grid.size
    step = max(1, math.ceil(math.sqrt(size[0] * size[1] / parameters.balance.samples)))
    # Colours are compared on the DSM's cells: what balances them does not depend on the orthophoto's.
    whole = ColourTask(plan, surface.on_dsm(), step, parameters, Window(0, 0, 0, 0))
    tasks = [replace(whole, own=own) for own, _ in overlapping_blocks(size, parameters.block_cells)]
    sampled = run_tasks(samples, tasks, workers, Part(progress, 0.1, 0.4), lambda _: "comparing the views' colours")
    plan, contrast = _balanced(plan, np.concatenate(sampled), progress, parameters)
    ensure_folder(folder)
    whole = replace(whole, plan=plan, contrast=contrast)
    if surface.cells.same:
        parts = _made(block, whole, folder, workers, Part(progress, 0.4, 0.95))
    else:
        parts = _finer(whole, surface, folder, workers=workers, progress=Part(progress, 0.4, 0.95))
    require_same()
    write_blocks(path, Blocks(dsm, surface.grid, parts, plan.names, plan.kind, plan.nodata, plan.natural), progress)


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
        if pair.misplaced_px:
            progress.warn(
                Finding(
                    "xs-misplaced",
                    f"'{pair.image.image}' lies {pair.misplaced_px:.1f} of its px beside '{pair.pan.image}': its RPC "
                    "may be that of another image or crop; colours are taken from where it says.",
                    "doubt",
                )
            )
        if pair.correlation < parameters.sharpening.least_correlation:
            progress.warn(
                Finding(
                    "xs-unlike",
                    f"'{pair.image.image}' hardly resembles '{pair.pan.image}' (correlation {pair.correlation:.2f}): "
                    "check that both are of one acquisition, or set PANSHARPEN=false.",
                )
            )
    return replace(plan, sources=tuple(replace(s, multispectral=pair) for s, pair in zip(plan.sources, found)))


def _fit(work: Tuple[Multispectral, float, OrthoParameters]) -> Multispectral:
    pair, level, parameters = work
    return fitted(pair, level, parameters.sharpening)


def _balanced(
    plan: ColourPlan, found: FloatImage, progress: Progress, parameters: OrthoParameters
) -> Tuple[ColourPlan, Tuple[float, ...]]:
    """The plan with the gains and offsets of each view, and the contrast of the balanced colours."""
    gains, offsets = balanced(found, parameters.balance)
    if len(plan.sources) > 1:
        ends = f"{gains.min():.2f} to {gains.max():.2f}"
        progress.info(f"Colours of {counted(len(plan.sources), 'view')} balanced: gains of {ends}.")
    sources = [replace(s, gains=tuple(g), offsets=tuple(o)) for s, g, o in zip(plan.sources, gains, offsets)]
    contrast: FloatArray = contrasts(found * gains.astype(np.float32) + offsets.astype(np.float32))
    return replace(plan, sources=tuple(sources)), tuple(map(float, contrast))


def _made(work: Callable[[ColourTask], str], whole: ColourTask, folder: str, workers: int, progress: Progress) -> Parts:
    """The parts that blocks of a task's cells are made of, one after the other or side by side."""
    windows = [own for own, _ in overlapping_blocks(whole.surface.grid.size, whole.parameters.block_cells)]
    tasks = [replace(whole, own=own, path=f"{folder}/colours_{index}.npy") for index, own in enumerate(windows)]
    if whole.chosen:
        tasks = [replace(task, chosen=_near(task)) for task in tasks]
    run_tasks(work, tasks, workers, progress, lambda _: "taking colours")
    return tuple((task.own, task.path) for task in tasks)


def _near(task: ColourTask) -> Parts:
    """What was chosen around a block's cells, which are finer than the DSM's."""
    grid = task.surface.dsm.grid
    return _beside(task.surface.cells.around(task.own).grown(task.parameters.colour.halo_cells, grid.size), task.chosen)


def _beside(window: Window, parts: Parts) -> Parts:
    """The parts that have some of a window's cells."""
    return tuple((own, path) for own, path in parts if own.common(window) is not None)


def _finer(whole: ColourTask, surface: SeenSurface, folder: str, *, workers: int, progress: Progress) -> Parts:
    """The parts on cells that are finer than the DSM's, whose views are chosen on the DSM's cells."""
    side, halo = whole.parameters.block_cells, whole.parameters.colour.halo_cells
    windows = [own for own, _ in overlapping_blocks(surface.dsm.grid.size, side)]
    chosen: Parts = ()
    # Blocks as the fields of a chessboard: the black ones choose by themselves, the white ones go on from these, so
    # that seams run where views agree and not along the blocks' borders.
    for first, last, white in ((0.0, 0.15, 0), (0.15, 0.3, 1)):
        own = [window for window in windows if (window.col // side + window.row // side) % 2 == white]
        tasks = [replace(whole, own=each, path=f"{folder}/views_{each.row}_{each.col}.npy") for each in own]
        tasks = [replace(task, chosen=_beside(task.own.grown(halo, surface.dsm.grid.size), chosen)) for task in tasks]
        run_tasks(choice, tasks, workers, Part(progress, first, last), lambda _: "choosing views")
        chosen += tuple((task.own, task.path) for task in tasks)
    return _made(finer_block, replace(whole, surface=surface, chosen=chosen), folder, workers, Part(progress, 0.3, 1.0))
