"""The orthophoto in greys, made from the finished DSM block by block: each cell from the most vertical view that sees
it. The visibility test of a cell looks at the whole DSM around its block; the result does not depend on the number of
workers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Callable, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Window
from ..contracts.options import DsmFuseOptions
from ..fusion.finished import FinishedSurface
from ..fusion.visible import orthophoto
from ..geometry.cell_grid import overlapping_blocks
from ..runtime.memory import Work, colouring_mib, workers_within
from ..runtime.parallel import run_tasks
from ..runtime.progress import Progress
from ..runtime.workspace import ensure_folder, writing
from ..scene import View
from .parameters import ORTHO, OrthoParameters
from .seen_surface import Blocks, SeenSurface, write_blocks


@dataclass(frozen=True)
class GreyTask:
    """What a worker needs to make one block: the views, the most vertical one first, the surface, the block's ``own``
    cells of it, and the file for their intensities."""

    views: Tuple[View, ...]
    surface: SeenSurface
    own: Window
    path: str


def make_grey_ortho(
    views: Sequence[View],
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
    """Write the orthophoto of a finished DSM from ``views``, the most vertical one first, on cells of a side (m, 0 for
    the DSM's own).

    ``folder`` is for blocks; ``require_same`` is called when all pixels are read, before the file is made. Raises
    ImageError where a view cannot be read, WorkspaceError where the file cannot be written.
    """
    side = parameters.block_cells
    work = Work("one block of the orthophoto", colouring_mib(side**2, 1, 1), lambda _: "do without ORTHO")
    workers = workers_within(options.workers, work, options.memory, progress)
    surface = SeenSurface.of(dsm, views, parameters, cell)
    whole = GreyTask(tuple(views), surface, Window(0, 0, 0, 0), "")
    ensure_folder(folder)
    tasks = [
        replace(whole, own=own, path=f"{folder}/greys_{index}.npy")
        for index, (own, _) in enumerate(overlapping_blocks(surface.grid.size, side))
    ]
    run_tasks(_block, tasks, workers, progress, lambda _: "taking greys")
    parts = tuple((task.own, task.path) for task in tasks)
    require_same()
    write_blocks(path, Blocks(dsm, surface.grid, parts, ("brightness",)), progress)


def _block(task: GreyTask) -> None:
    """Write the brightness of a block's cells into its file."""
    surface, own = task.surface, task.own
    height = surface.heights(own)
    seen = partial(surface.seen, window=own, height=height)
    part, crs, numbers = surface.grid.part(own), surface.dsm.layout.crs, surface.parameters.visibility
    found = orthophoto(task.views, part, height, crs, numbers, seen, surface.kernel)
    with writing(task.path):
        np.save(task.path, found[None])
