"""What workers do for the orthophoto in colour: colours to compare, the choice of views, and the colours of a block.

On the DSM's own cells, a block chooses its views and takes their colours in one. On finer cells, views are chosen on
the DSM's cells first, for the whole orthophoto: there the choice has the meaning that its numbers were made for, costs
as much as before, and seams go on from block to block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import FloatImage, Floats, Window
from ..geometry.footprints import ray_slope
from ..geometry.frames import geodetic_from_projected
from ..runtime.workspace import writing
from .colour_sources import ColourPlan, ColourSource
from .parameters import OrthoParameters
from .seen_surface import SeenSurface
from .view_choice import chosen_views, feathered_colours

Sources = NDArray[np.int16]
"""(H, W) numbers of a plan's sources, -1 where none shows the cell."""
Parts = Tuple[Tuple[Window, str], ...]
"""Windows of cells, and the files of what they have."""


@dataclass(frozen=True)
class ColourTask:
    """What a worker needs to make one block: the surface, and the ``own`` cells of the block.

    Each ``step``-th cell is compared between views; ``contrast`` is the unit of their differences; ``path`` is where
    what is made of the block is kept. ``chosen`` are sources that were chosen before, in parts of the DSM's cells.
    """

    plan: ColourPlan
    surface: SeenSurface
    step: int
    parameters: OrthoParameters
    own: Window
    contrast: Tuple[float, ...] = ()
    path: str = ""
    chosen: Parts = ()

    def colours(self, source: ColourSource, window: Window, height: Floats, step: int = 1) -> FloatImage:
        """(B, H, W) colours of every ``step``-th cell of a window of these heights; NaN where the view sees none."""
        surface, crs = self.surface, self.surface.dsm.layout.crs
        cells, visibility, kernel = surface.grid.part(window), surface.parameters.visibility, surface.kernel
        found = source.colours(cells, height, crs, visibility, step, kernel=kernel)
        return np.where(surface.seen(source.view, window, height)[::step, ::step], found, np.float32(np.nan))

    def sources_before(self, window: Window) -> Sources:
        """What was chosen before of a window of the DSM's cells; -1 where nothing was."""
        found = np.full((window.height, window.width), -1, np.int16)
        for own, path in self.chosen:
            common = own.common(window)
            if common is not None:
                kept = np.load(path, mmap_mode="r", allow_pickle=False)
                found[common.inside(window)] = kept[common.inside(own)]
        return found


@dataclass(frozen=True)
class _Candidates:
    """The views of a block among which each cell can choose: their numbers in the plan and their (B, H, W) colours; and
    for cells that none of these shows, ``others``: the colours and the numbers of those that do."""

    numbers: List[int]
    colours: List[FloatImage]
    others: FloatImage
    by_others: Sources


def samples(task: ColourTask) -> FloatImage:
    """(N, views, bands) colours of every ``step``-th cell of a block that two views see."""
    height = task.surface.heights(task.own)
    shape = 0, len(task.plan.sources), len(task.plan.names)
    if not np.isfinite(height).any():
        return np.empty(shape, np.float32)
    found = [task.colours(source, task.own, height, task.step) for source in task.plan.sources]
    values = np.stack(found).reshape(*shape[1:], -1).transpose(2, 0, 1)
    shared: FloatImage = values[np.isfinite(values[..., 0]).sum(axis=1) > min(1, shape[1] - 1)]
    return shared


def block(task: ColourTask) -> str:
    """Write the colours of a block's own cells, which are the DSM's, into a file of its own."""
    wide = task.own.grown(task.parameters.colour.halo_cells, task.surface.grid.size)
    height = task.surface.heights(wide)
    found = np.full((len(task.plan.names), *height.shape), np.nan, np.float32)
    if np.isfinite(height).any():
        candidates = _candidates(task, wide, height)
        found = candidates.others
        if candidates.numbers:
            labels = _labels(task, candidates, wide, height)
            stack, contrast = np.stack(candidates.colours), np.array(task.contrast)
            found = feathered_colours(stack, labels, contrast, task.parameters.seams)
            found = np.where(np.isfinite(found), found, candidates.others)
    return _kept(task, found, wide)


def choice(task: ColourTask) -> str:
    """Write which source each of a block's own cells, which are the DSM's, is best taken from; where blocks beside it
    have chosen before, it goes on from there."""
    wide = task.own.grown(task.parameters.colour.halo_cells, task.surface.grid.size)
    height = task.surface.heights(wide)
    found: Sources = np.full(height.shape, -1, np.int16)
    if np.isfinite(height).any():
        candidates = _candidates(task, wide, height)
        found = candidates.by_others
        if candidates.numbers:
            labels = _labels(task, candidates, wide, height)
            found = np.where(labels >= 0, np.array(candidates.numbers, np.int16)[labels], found)
    with writing(task.path):
        np.save(task.path, found[task.own.inside(wide)])
    return task.path


def finer_block(task: ColourTask) -> str:
    """Write the colours of a block's own cells, which are finer than the DSM's, from the sources that were chosen.

    Where such a cell is hidden from the source of its place, it takes another one of the block, or else any that sees
    it, the most vertical one first; so the orthophoto is as complete as on the DSM's cells.
    """
    surface, seams = task.surface, task.parameters.seams
    ratio = surface.cells.coarse.cell / surface.grid.cell
    feather = max(1, round(seams.feather_cells * ratio))
    wide = task.own.grown(feather, surface.grid.size)
    height, place = surface.heights(wide), surface.cells.around(wide)
    wanted = surface.cells.nearest(task.sources_before(place), place, wide)
    wanted[~np.isfinite(height)] = -1
    found = np.full((len(task.plan.names), *height.shape), np.nan, np.float32)
    taken = [int(number) for number in np.unique(wanted) if number >= 0]
    if taken:
        stack = np.stack([task.colours(task.plan.sources[number], wide, height) for number in taken])
        labels = np.where(wanted >= 0, np.searchsorted(taken, wanted), -1)
        shown = np.isfinite(stack[:, 0])
        blind = (labels >= 0) & ~np.take_along_axis(shown, np.maximum(labels, 0)[None], axis=0)[0]
        labels = np.where(blind, np.where(shown.any(axis=0), shown.argmax(axis=0), -1), labels).astype(np.int8)
        numbers = replace(seams, feather_cells=feather)
        found = feathered_colours(stack, labels, np.array(task.contrast), numbers)
        found = _from_others(task, found, wide, height, missing=(wanted >= 0) & (labels < 0), taken=taken)
    return _kept(task, found, wide)


def _from_others(
    task: ColourTask,
    found: FloatImage,
    window: Window,
    height: Floats,
    *,
    missing: "NDArray[np.bool_]",
    taken: Sequence[int],
) -> FloatImage:
    """Colours with those of missing cells from other sources than were taken, of which not too many are asked."""
    left = max(1, task.parameters.colour.most_views - len(taken))
    for source in [each for number, each in enumerate(task.plan.sources) if number not in taken][:left]:
        if not missing.any():
            break
        colours = task.colours(source, window, height)
        shown = missing & np.isfinite(colours[0])
        found = np.where(shown, colours, found)
        missing = missing & ~shown
    return found


def _kept(task: ColourTask, found: FloatImage, window: Window) -> str:
    with writing(task.path):
        np.save(task.path, task.plan.stored(found[(slice(None), *task.own.inside(window))]))
    return task.path


def _labels(task: ColourTask, candidates: _Candidates, window: Window, height: Floats) -> "NDArray[np.int8]":
    """Which candidate each cell of a window is best taken from."""
    surface = task.surface
    middle = geodetic_from_projected(surface.dsm.layout.crs, np.array(surface.grid.part(window).middle))
    level = float(np.nanmedian(height))
    views = [task.plan.sources[number].view for number in candidates.numbers]
    steepness = [float(np.linalg.norm(ray_slope(view, middle, level))) for view in views]
    held = None
    if task.chosen:
        before = task.sources_before(window)
        held = np.full(before.shape, -1, np.int8)
        for label, number in enumerate(candidates.numbers):
            held[before == number] = label
    stack, contrast = np.stack(candidates.colours), np.array(task.contrast)
    return chosen_views(stack, steepness, contrast, task.parameters.seams, held)


def _candidates(task: ColourTask, window: Window, height: Floats) -> _Candidates:
    """The views of a block, from the most vertical one on, as many as show what the others do not."""
    numbers = task.parameters.colour
    missing = np.isfinite(height)
    worthwhile = numbers.worthwhile * missing.sum()
    others = np.full((len(task.plan.names), *height.shape), np.nan, np.float32)
    found = _Candidates([], [], others, np.full(height.shape, -1, np.int16))
    for number, source in enumerate(task.plan.sources):
        if len(found.numbers) >= numbers.least_views and not missing.any():
            break
        colours = task.colours(source, window, height)
        shown = np.isfinite(colours[0])
        few = len(found.numbers) < numbers.least_views and shown.any()
        if few or (len(found.numbers) < numbers.most_views and (shown & missing).sum() > worthwhile):
            found.numbers.append(number)
            found.colours.append(colours)
        else:
            found.others[:, shown & missing] = colours[:, shown & missing]
            found.by_others[shown & missing] = number
        missing &= ~shown
    return found
