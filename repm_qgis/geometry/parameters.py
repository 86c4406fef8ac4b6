"""The numbers that the geometry chooses: grids of correspondences, and how points make heights of cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class VirtualGridParameters(Parameters):
    """Correspondences that cameras are fitted to (paper, Algorithm 1): columns, rows and altitudes, ends included."""

    scene: Tuple[int, int, int] = (25, 25, 11)  # a whole image; chosen
    tile: Tuple[int, int, int] = (13, 13, 7)  # models are so smooth that finer grids give the same camera to 1e-4 px
    near_surface_m: float = 10.0  # the terrain model's error is measured this far below and above; chosen


@dataclass(frozen=True)
class GriddingParameters(Parameters):
    """How the points of a height map become heights of cells. All values are chosen, on scenes with true surfaces."""

    surface_step: float = 3.0  # m for each m of cell: points farther apart belong to two surfaces (roof, ground)
    surface_step_cell_m: float = 0.33  # smaller cells have the step of this one
    mixed: float = 0.3  # of that step: cells whose heights have this standard deviation may have two surfaces
    surface_weight: float = 0.02  # of a point: what covers less of a cell is no evidence of another surface
    cell_weight: float = 0.15  # of a point: a cell that is covered less has no height
    wider: float = 0.4  # of a cell: points that are farther apart by so much than a cell is wide leave none empty


VIRTUAL_GRID = VirtualGridParameters()
GRIDDING = GriddingParameters()
