"""The surface, block by block: the heights that are chosen, where each comes from, and its likely error."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Iterator, Tuple

import numpy as np

from ..arrays import Window
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..imagery.confidence import Provenance
from ..workspace import writing
from .brightness import Witnesses, brightness
from .choice import Problem, chosen, near_reach, reach_cells
from .joining import JoinedTiles
from .parameters import FUSION, FusionParameters
from .provenance import SurfaceCells, described

_FROM_MAPS = (Provenance.MATCHED,)


@dataclass(frozen=True)
class SurfaceBlock:
    """A block's ``own`` cells of the whole, whose surface is, or will be, in a file."""

    own: Window
    path: str

    def load(self) -> SurfaceCells:
        """The surface of the block's own cells; heights are above the ellipsoid."""
        return SurfaceCells(*np.load(self.path, allow_pickle=False))


@dataclass(frozen=True)
class SurfaceTask:
    """All a worker needs to make a block: the ``joined`` tiles on the ``grid``, the ``wide`` window on which its own
    cells depend, and the ``witnesses`` of brightness. ``walls``: heights are chosen among several. ``filled``: cells
    may have heights that no map has."""

    block: SurfaceBlock
    wide: Window
    joined: JoinedTiles
    grid: CellGrid
    witnesses: Witnesses
    walls: bool
    filled: bool
    parameters: FusionParameters = FUSION


def blocks_of(
    grid: CellGrid, folder: str, walls: bool, parameters: FusionParameters = FUSION
) -> Iterator[Tuple[SurfaceBlock, Window]]:
    """The blocks of a grid, with the windows on which they depend; their files are in ``folder``."""
    halo = near_reach(grid.cell, parameters.choice) + (reach_cells(grid.cell, parameters.choice) if walls else 0)
    for number, (own, wide) in enumerate(overlapping_blocks(grid.size, parameters.hole_block_cells, halo)):
        yield SurfaceBlock(own, f"{folder}/surface_{number}.npy"), wide


def make_block(task: SurfaceTask) -> None:
    """Write the surface of a block into its file. Raises ImageError where a view cannot be read."""
    p, grid, fused = task.parameters, task.grid.part(task.wide), task.joined.fused(task.wide)
    ground, height = task.joined.ground(task.wide), fused.height
    if task.walls:
        start = np.where(np.isfinite(ground), ground, height)
        light = brightness(task.witnesses, grid, start, p.brightness)
        height = chosen(Problem(fused, ground, light, grid.cell, p.evidence, p.choice))
    surface = described(fused, ground, height, near_reach(grid.cell, p.choice), p.error)
    values = np.stack([getattr(surface, field.name) for field in fields(surface)]).astype(np.float32)
    if not task.filled:
        values[:, ~np.isin(surface.source, _FROM_MAPS)] = np.nan
    own = (slice(None), *task.block.own.inside(task.wide))
    with writing(task.block.path):
        np.save(task.block.path, values[own])
