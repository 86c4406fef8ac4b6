"""The numbers that the search for buildings chooses; `make bench-buildings` measures what comes of them."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class FootprintParameters(Parameters):
    """From heights above the terrain to cells of buildings; chosen, unless a source is given."""

    plane_m: float = 3.0  # side of the window to whose heights a plane is fitted: narrower than crowns of trees
    planar_m: float = 0.8  # RMS of the heights about that plane, up to which cells look like a roof, or
    planar_errors: float = 2.0  # so many times the usual error of the DSM, if that is more
    steepest: float = 1.5  # m per m: roofs up to 56 degrees
    wall_m: float = 1.5  # how far a wall is smeared to each side: what is lower than half the roof there is its foot
    opening_m: float = 1.5  # half the width of the narrowest part of a building: tree rows and walls are narrower
    rim_m: float = 2.5  # how far the cells beside a wall lie from the nearest planar ones
    closed_m: float = 0.75  # gaps up to twice this are closed: single cells without a height
    vegetation: float = 0.3  # of the vegetation index (Rouse et al. 1974), from which on cells are plants
    hole_m2: float = 10.0  # smaller courtyards are filled


@dataclass(frozen=True)
class SegmentParameters(Parameters):
    """Roofs that touch and are divided by walls; chosen."""

    wall_m: float = 2.0  # between the highest and the lowest of a cell and its neighbours,
    steepest: float = 1.5  # m per m, or as much as the steepest roof has
    neck_m: float = 0.75  # half the width of the narrowest connection that does not divide
    least_m2: float = 40.0  # of a part that has walls around it: smaller ones are on a roof
    below_m: float = 1.0  # how far a lower part reaches below a higher one, before that is taken off it


@dataclass(frozen=True)
class OutlineParameters(Parameters):
    """From the border of cells to a polygon with walls (Sampath and Shan 2007); chosen."""

    tolerance_m: float = 0.8  # of the simplified border (Douglas and Peucker 1973), and not less than
    tolerance_cells: float = 1.2
    step_deg: float = 0.5  # of the main direction
    turned_deg: float = 30.0  # walls within this of the main directions take them
    offset_m: float = 1.0  # parallel walls that are nearer to each other are one, and not less than
    offset_cells: float = 1.5
    least_common: float = 0.8  # of the border's area and the polygon's: intersection over union


@dataclass(frozen=True)
class RoofParameters(Parameters):
    """Planes of a roof, and which of them are kept; chosen, unless a source is given."""

    tolerance_m: float = 0.3  # of cells on a plane, or
    tolerance_errors: float = 1.5  # so many times the usual error of the DSM, if that is more
    turned_deg: float = 20.0  # between a cell's own plane and that of the roof
    tries: int = 150  # planes that are tried for each that is kept (Fischler and Bolles 1981)
    most_cells: int = 20_000  # of a roof on which planes are tried
    most_planes: int = 8
    least_m2: float = 8.0  # of a plane
    least_share: float = 0.06  # of the roof
    kind_share: float = 0.15  # of the roof: smaller planes, such as dormers, do not change its kind
    level_deg: float = 5.0  # flatter planes are level
    step_m: float = 1.0  # between two planes along their border: a wall stands there
    joined_m: float = 0.015  # heights of one corner that are nearer to each other are one (planar within 1 cm)
    better: float = 0.8  # the spread about the planes over that about one height, below which the planes are kept,
    better_m: float = 0.1  # and by how much smaller it is at least
    seed: int = 39  # of the planes that are tried: the same roof has the same planes


@dataclass(frozen=True)
class HeightParameters(Parameters):
    """How the heights of a building follow from its cells; chosen."""

    inner_m: float = 1.0  # cells nearer to the outline are walls
    least_cells: int = 4  # of a roof
    eave_percent: float = 5.0  # of the roof's cells are lower than its eave,
    ridge_percent: float = 95.0  # and so many lower than its ridge
    ring_m: float = 6.0  # of ground around a building, on which the error of heights above the ground is measured
    ring_from_m: float = 2.0
    ring_low_m: float = 1.0  # what is higher is no ground
    least_error_m: float = 0.05


@dataclass(frozen=True)
class BuildingParameters(Parameters):
    """All choices of the buildings."""

    footprints: FootprintParameters = FootprintParameters()
    segments: SegmentParameters = SegmentParameters()
    outlines: OutlineParameters = OutlineParameters()
    roofs: RoofParameters = RoofParameters()
    heights: HeightParameters = HeightParameters()
    block_cells: int = 1024  # side of a block; bounds the memory, and changes no byte


BUILDINGS = BuildingParameters()
