"""The surface, block by block: intensities of cells, the heights that are chosen, their provenance and errors. The
cells of a block depend on the cells around it as far as its halo, and on nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Iterator, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatImage, Window
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..imagery.confidence import Provenance
from ..runtime.workspace import writing
from .brightness import Witnesses, brightness
from .choice import Problem, chosen, near_reach, reach_cells
from .joining import JoinedTiles
from .needles import needles
from .parameters import FUSION, FusionParameters
from .provenance import SurfaceCells, described


@dataclass(frozen=True)
class Block:
    """A block's ``own`` cells of the whole, of which something is, or will be, in a file."""

    own: Window
    path: str

    def keep(self, wide: Window, values: FloatImage) -> None:
        """Write (..., H, W) values of the window around the block, as far as they are the block's own."""
        with writing(self.path):
            np.save(self.path, values[(..., *self.own.inside(wide))].astype(np.float32))

    def surface(self) -> SurfaceCells:
        """The surface of the block's own cells; heights are above the ellipsoid."""
        return SurfaceCells.of(np.load(self.path, allow_pickle=False))


def blocks_of(
    grid: CellGrid, name: str, halo: int, parameters: FusionParameters = FUSION
) -> Iterator[Tuple[Block, Window]]:
    """The blocks of a grid, with the windows of ``halo`` cells around them; the names of their files begin with
    ``name``."""
    for number, (own, wide) in enumerate(overlapping_blocks(grid.size, parameters.hole_block_cells, halo)):
        yield Block(own, f"{name}_{number}.npy"), wide


@dataclass(frozen=True)
class LightTask:
    """All a worker needs for the intensities of a block: the ``joined`` tiles on the ``grid``, the ``wide`` window in
    which objects may hide its cells, and the views as ``witnesses``."""

    block: Block
    wide: Window
    joined: JoinedTiles
    grid: CellGrid
    witnesses: Witnesses
    parameters: FusionParameters = FUSION


def light_block(task: LightTask) -> None:
    """Write the brightness of a block into its file. Raises ImageError where a view cannot be read."""
    height = task.joined.first_heights(task.wide)
    p, grid = task.parameters, task.grid.part(task.wide)
    light = brightness(task.witnesses, grid, height, p.brightness, p.visibility)
    task.block.keep(task.wide, light)


@dataclass(frozen=True)
class SurfaceTask:
    """All a worker needs to make a block: the ``joined`` tiles on the ``grid``, the ``wide`` window on which its own
    cells depend, and the blocks of brightness; without these, in a scene without walls, nothing is chosen. ``filled``:
    cells may have heights that no map has. A needle has ``largest`` cells at most (:func:`.needles.largest_needle`)."""

    block: Block
    wide: Window
    joined: JoinedTiles
    grid: CellGrid
    lights: Tuple[Block, ...]
    filled: bool
    largest: int
    parameters: FusionParameters = FUSION


def halo(grid: CellGrid, walls: bool, largest: int, parameters: FusionParameters = FUSION) -> int:
    """How many cells around a block its surface depends on; needles have ``largest`` cells at most."""
    around = _far(grid.cell, parameters) + largest + parameters.needles.around_cells
    return around + (reach_cells(grid.cell, parameters.choice) if walls else 0)


def _far(cell: float, parameters: FusionParameters) -> int:
    """How many cells away what makes an error gross may lie."""
    return max(near_reach(cell, parameters.choice), round(parameters.error.far_m / cell))


def make_block(task: SurfaceTask) -> int:
    """Write the surface of a block into its file; gives how many of its own cells were needles."""
    p, cell, fused = task.parameters, task.grid.cell, task.joined.fused(task.wide)
    ground, height = task.joined.ground(task.wide), fused.height
    if task.lights:
        light = _light(task.lights, task.wide)
        height = chosen(Problem(fused, ground, light, cell, p.evidence, p.choice))
    surface = described(fused, ground, height, near_reach(cell, p.choice), _far(cell, p), p.evidence, p.error)
    values = np.stack([getattr(surface, field.name) for field in fields(surface)])
    gone = needles(surface.height, surface.count, cell, task.largest, p.needles)
    values[:, gone] = np.nan
    if not task.filled:
        values[:, surface.source != Provenance.MATCHED] = np.nan
    task.block.keep(task.wide, values)
    return int(gone[task.block.own.inside(task.wide)].sum())


def _light(blocks: Sequence[Block], window: Window) -> FloatImage:
    """(H, W) brightness of a window, from the blocks that it has parts of."""
    light = np.full((window.height, window.width), np.nan, np.float32)
    for block in blocks:
        common = block.own.common(window)
        if common is not None:
            kept = np.load(block.path, mmap_mode="r", allow_pickle=False)
            light[common.inside(window)] = kept[common.inside(block.own)]
    return light
