"""The heights of a block of the DSM's cells that fit the images: without strays, and roofs no wider than they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Iterator, Tuple

import numpy as np

from ..arrays import FloatImage, Mask, Window
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..scene import View
from ..workspace import writing
from .brightness import brightness
from .parameters import FUSION, FusionParameters
from .strays import SurfaceAround
from .widened_roofs import widened_over_shadow


@dataclass(frozen=True)
class FittedBlock:
    """A block's ``own`` cells of the whole, whose heights are, or will be, in a file."""

    own: Window
    path: str

    def load(self) -> Tuple[FloatImage, FloatImage]:
        """(H, W) the heights, m above the ellipsoid, and the ground where roofs were cut back; NaN = none."""
        with np.load(self.path, allow_pickle=False) as kept:
            return kept["height"], kept["ground"]


@dataclass(frozen=True)
class FitTask:
    """All a worker needs to fit a block: what gives the ``heights`` of a window of the ``grid`` (m above the ellipsoid,
    NaN = none) and which of them are ``weak``, because the images hardly support them; the ``wide`` window on which its
    own cells depend; and the views, the most vertical ones first."""

    block: FittedBlock
    wide: Window
    heights: Callable[[Window], FloatImage]
    weak: Callable[[Window], Mask]
    grid: CellGrid
    crs: str
    views: Tuple[View, ...]
    parameters: FusionParameters = FUSION


def blocks_of(
    grid: CellGrid, folder: str, parameters: FusionParameters = FUSION
) -> Iterator[Tuple[FittedBlock, Window]]:
    """The blocks of a grid, with the windows on which they depend; their files are in ``folder``."""
    halo = 2 * parameters.strays.reach(grid.cell) + parameters.widened.halo(grid.cell)
    for number, (own, wide) in enumerate(overlapping_blocks(grid.size, parameters.hole_block_cells, halo)):
        yield FittedBlock(own, f"{folder}/fitted_{number}.npz"), wide


def fit_block(task: FitTask) -> None:
    """Write the heights of a block into its file; without walls in it, they stay as they are.

    Raises ImageError where a view cannot be read.
    """
    p, grid = task.parameters, task.grid.part(task.wide)
    height = task.heights(task.wide)
    light = brightness(task.views, grid, height, task.crs, p)
    ground = np.full(height.shape, np.nan, np.float32)
    around = SurfaceAround(height, light, grid.cell, p.strays)
    if around.walls:
        height = around.without_strays()
        ground = widened_over_shadow(height, light, task.weak(task.wide), grid.cell, p)
        height = np.where(np.isfinite(ground), ground, height)
        # What is left of a roof over the shadow strays now.
        height = SurfaceAround(height, light, grid.cell, p.strays).without_strays()
    inner = task.block.own.inside(task.wide)
    with writing(task.block.path):
        np.savez(task.block.path, height=height[inner].astype(np.float32), ground=ground[inner])
