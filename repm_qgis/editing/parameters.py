"""The numbers that edits of a surface choose."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters
from ..fusion.parameters import FUSION


@dataclass(frozen=True)
class EditingParameters(Parameters):
    """Chosen, unless a source is given."""

    shore_cells: int = FUSION.water.shore_cells  # width of the strip around water that says how high the water is
    shore_percentile: float = FUSION.water.shore_percentile  # of its heights, as where water is found in images
    looked_px: int = 256  # side of the picture of the heights around an edit
    far_m: float = 30.0  # from all of these to a height that an edit sets: more than houses
    line_far_m: float = 10.0  # the same to the vertices of a breakline, which follow the ground
    most_edited: float = 0.5  # of a DSM's cells that one edit may replace or remove
    drawn_m: float = 1.0  # the same where all vertices of a line have 0
    most_solved: int = 1_000_000  # cells of a window whose fill is solved as a whole; of more, on coarser cells
    accurate_m: float = 1e-4  # how exactly a fill is solved
    most_iterations: int = 200  # 30 are usual
    smoothings: int = 4  # relaxations on the DSM's own cells for each step from coarser ones
    block_cells: int = 1024  # side of a block, at most; bounds the memory, and changes no byte


EDITING = EditingParameters()
