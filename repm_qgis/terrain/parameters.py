"""The numbers that the search for bare earth chooses; docs/method.md, "Bare earth", says what each is for."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.parameters import Parameters


@dataclass(frozen=True)
class ObjectParameters(Parameters):
    """Objects by openings with growing windows (Zhang et al. 2003); found on truth scenes (`make bench-answers`)."""

    cell_m: float = 1.0  # finer cells are averaged to about this: outlines are found again on the DSM's own cells
    first_m: float = 1.0  # half the side of the first window, and
    step_m: float = 2.0  # how much wider the next ones are: terrain that is no object sinks little from one to the next
    rise: float = 0.15  # m for each m that the window grows: what sinks by more may be an object (Pingel et al. 2013)
    least_m: float = 0.5  # and not less
    walled_m: float = 2.0  # windows narrower than this on each side find objects without looking for walls
    wall_m: float = 1.0  # on both sides of an outline: how far a wall is smeared in a DSM
    wall_noise_m: float = 0.5  # a wall is so much higher than what ground of the steepest slope rises across it
    wall_share: float = 0.3  # of the outlines nearby that must be walls: hill tops have none
    nearby: int = 2  # windows on each side within which outlines are counted
    pit_m: float = 5.0  # half the side of the widest pit that is taken as wrong heights
    pit_depth_m: float = 1.0  # and its least depth, on level ground


@dataclass(frozen=True)
class GroundParameters(Parameters):
    """From the cells without objects to a surface; found on truth scenes, unless a source is given."""

    coarse_m: float = 4.0  # cells of the surface that is solved as a whole, at least
    tolerance_m: float = 0.5  # how far ground cells may be from the surface (Pingel et al. 2013), or the usual error
    rim_cells: int = 1  # around objects, whose walls are smeared
    object_m: float = 1.0  # what stands higher above level ground is an object
    first_stiffness: float = 0.05  # weight of a difference of neighbours against that of a height of usual error:
    stiffness: float = 3.0  # at first, and of the finished surface, whose noise it halves
    seen_share: float = 0.5  # of a coarse cell that must be ground for the terrain's curvature to be measured there
    curved_m: float = 4.0  # how far the curvature is averaged
    fading_m: float = 20.0  # and how far it continues where no ground is seen: it falls to 1/e there
    relaxations: int = 6  # on each level, after which the next finer one starts (Bornemann and Deuflhard 1996)
    coarsest_relaxations: int = 240  # on a few cells: a solution


@dataclass(frozen=True)
class SteepnessParameters(Parameters):
    """Ground that is steeper than SLOPE (terrain/steepness.py)."""

    cell_m: float = 4.0  # of the gradients; as the coarse surface's
    scales: int = 3  # and of cells twice and four times as wide, on which the benches of a quarry are a slope
    window: int = 7  # cells a side in which gradients are compared: 28, 56 and 112 m
    others: float = 0.3  # of the gradients there that may differ: with these values, 0 to 0.3 % of the heights of towns
    # (jax_068, truth_urban, whu_tlc) are steep objects, and 5 to 20 % of those of mountains and of quarries; with
    # windows of 5 cells and a half 8 % of jax_068
    least_share: float = 0.5  # of them that must be known
    cut_m: float = 1.0  # by which a terrain must lie below such ground; as GroundParameters.object_m
    most_cut_percent: float = 1.0  # of a DSM's heights
    hillside: float = 0.4  # m per m: SLOPE's default, with which buildings are searched where no terrain is given
    most_hillside: float = 0.1  # of the area of all buildings


@dataclass(frozen=True)
class TerrainParameters(Parameters):
    """All choices of the bare earth."""

    objects: ObjectParameters = ObjectParameters()
    ground: GroundParameters = GroundParameters()
    steepness: SteepnessParameters = SteepnessParameters()
    block_cells: int = 2048  # side of a block, at most; bounds the memory, and changes no byte


TERRAIN = TerrainParameters()
