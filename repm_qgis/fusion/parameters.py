"""The numbers that fusion chooses; docs/method.md says more about each subject."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..contracts.parameters import Parameters
from ..geometry.parameters import GriddingParameters
from ..matching.parameters import MATCHING


@dataclass(frozen=True)
class IsolatedPointParameters(Parameters):
    """Isolated points of a height map (paper, "DSMs aggregation", which gives no numbers); both values are chosen."""

    tolerance_px: float = 2.0  # of disparity: neighbours farther apart belong to different surfaces
    neighbours: int = 2  # of eight that a point needs; the points of a wall have so many


@dataclass(frozen=True)
class MapOffsetParameters(Parameters):
    """Offsets between the height maps of different pairs (docs/method.md, "Heights"; `make bench-towns`)."""

    compared: int = 24  # maps of a tile, those of the best geometry, with which all are compared: bounds the time
    every_px: int = 4  # of the maps' columns and rows that are compared; 3 and 5 do as well
    part_px: int = 120  # side of the parts of a tile whose differences have a median; 75 does as well
    lattice_px: int = 200  # between nodes of the error; 120 and 300 do as well
    most_steps: int = 16  # of the lattice along a side of the scene: bounds the time
    widest_px: float = 1.0  # of disparity by which two maps may differ in the mean; chosen
    same_px: float = 0.6  # around that: what differs by more is another surface; as the tolerance of the aggregation
    least_cells: int = 100  # of a part; chosen
    usual_px: float = 0.1  # standard deviation of a pair's mean error; 0.06 to 0.1 on real towns
    smooth_px: float = 0.05  # standard deviation of its change from node to node; 0.1 does as well
    known_px: float = 0.02  # standard deviation of a median, however many cells it has; chosen
    spread_px: float = 0.75  # of a cell, for the medians of few; chosen, with neighbours that are not independent
    huber: float = 2.0  # standard deviations from which on weights fall; chosen
    iterations: int = 5


@dataclass(frozen=True)
class OutlierParameters(Parameters):
    """Radius outlier removal on cells; the paper gives no numbers. All values are chosen for grids of known density."""

    most_cells: float = 30.0  # of a radius: 2800 neighbours; the time grows with their number, and more are refused
    share: float = 0.2  # of all cells within the radius: the corner of a roof has a quarter
    neighbours: int = 2  # and not less


@dataclass(frozen=True)
class NeedleParameters(Parameters):
    """Needles: a few cells far above or below all others around them, which only a single map has (docs/method.md,
    "Fusion")."""

    speckle_px: int = MATCHING.sgm.speckle_px  # pixels of the largest; matching removes smaller ones by this limit, too
    step_m: float = 3.0  # of height between two surfaces, as in the choice
    slender: float = 5.0  # times as high, above or below all around it, as it is wide (root of its area): 3 takes 29
    # right cells of a simulated town instead of one, and 8 leaves a quarter of the wrong ones of a real town
    around_cells: int = 2  # to each side, of what is around it; chosen: across a hole of one cell
    most_cells: int = 200  # of the largest, where cells are much finer than pixels: bounds what a block depends on


@dataclass(frozen=True)
class EvidenceParameters(Parameters):
    """The evidence of a map for a cell's height (fusion/aggregation.py; `make bench-ablation`). Gross errors were
    counted on scenes of four kinds with true surfaces; C1 hardly depends on these values."""

    best: float = 0.16  # standard deviation of a matched height at a correlation of 1, in units of HeightLayer
    per_score: float = 3.2  # and more for each 1 of correlation less; 2.4 does as well
    per_learned_score: float = 1.3  # the same of heights by learned features; seasons table
    least_trust: float = 0.05  # share of their evidence, which else is the square of their correlation; times that
    # of the share of the ground on which the pair's intensities agree, as a part of the most alike pair's
    same: float = 2.5  # standard deviations within which heights mean the same surface; 2 and 3 do as well
    rim_px: float = 2.5  # from a step down, where matching may have widened the object above it
    step_m: float = 1.5  # of such a step, and not less than
    step_px: float = 1.5  # so much disparity
    doubtful: float = 0.5  # evidence of a height there, beside a hole, or that covers half of its cell at most
    background: float = 0.2  # evidence of an occlusion's background
    of_background: float = 1.2  # its standard deviation, in these units
    ground_m: float = 0.5  # standard deviation of the ground in a shadow; its evidence is 1
    in_shadow: float = 0.3  # of the evidence of what maps have there


@dataclass(frozen=True)
class ChoiceParameters(Parameters):
    """One height for each cell of a town (fusion/choice.py; `make bench-ablation`)."""

    smoothness: float = 4.0  # evidence against a height that is far from all heights around it; 2 and 6 do as well
    scale_m: float = 0.5  # of the differences between neighbours
    most: float = 2.0  # of these scales that count: farther away is another surface
    near_m: float = 1.5  # of the neighbours to each side, and standard deviation of their weights; 1.0 loses courts
    contrast: float = 0.2  # of brightness, at which two cells are alike by 1 / e; 0.1 and 0.15 do as well
    appearance: float = 12.0  # evidence of a cell's appearance, for each power of e; 6 and 16 do as well
    far_m: float = 5.0  # to each side, of the cells that show what a surface looks like; 8 m loses small roofs
    step_m: float = 3.0  # of height between two surfaces
    sweeps: int = 6  # over the cells; 10 do as well


@dataclass(frozen=True)
class ShadedGroundParameters(Parameters):
    """Ground in shadows without texture (docs/method.md, "Fusion"; `make bench-towns`)."""

    weak_score: float = 0.85  # of a single map's height: below, the images hardly support it; 0.8 and 0.9 do as well
    least_slope: float = 0.3  # m per m: where it is steeper, no shadow ends
    slope_sigma_cells: float = 1.5  # of the mean whose slope that is; chosen
    clear_m: float = 0.5  # by which a shadow's edge must pass over a cell
    reach_m: float = 100.0  # of the search for a shadow's end
    reach_cells: int = 400  # and no farther: bounds the memory
    turns_deg: Tuple[float, ...] = tuple(range(-40, 41, 10))  # about the direction away from the sun
    around_m: float = 4.0  # to each side, of the places around a cell whose median it takes
    least_share: float = 0.35  # of these places that must have a ground; with 0.1 small gaps are filled from far away
    least_elevation_deg: float = 10.0  # of the sun: with less, shadows have no end


@dataclass(frozen=True)
class BrightnessParameters(Parameters):
    """How bright cells are (fusion/brightness.py)."""

    views: int = 6  # the most vertical ones; with 10 the time grows, and nothing else
    hidden_cells: int = 160  # objects farther away are not tested for hiding a cell: bounds the time


@dataclass(frozen=True)
class WallParameters(Parameters):
    """Whether a scene has walls (fusion/walls.py)."""

    least_tail: float = 10.0  # of the details of its maps (matching/detail.py): 14 to 140 in towns, 2 to 6 elsewhere
    neighbours: int = 4  # of eight that a height needs to be counted: gross errors have long tails, too
    maps: int = 9  # that are examined, evenly spread; their median decides
    window_px: int = 1000  # side of the part of each


@dataclass(frozen=True)
class HoleParameters(Parameters):
    """Interpolation of holes; both values are chosen."""

    reach_cells: int = 100  # heights farther away do not count
    widest_gap: int = 4  # of 16 directions in a row without a height; with more a cell lies beyond the border


@dataclass(frozen=True)
class ErrorParameters(Parameters):
    """Where heights come from, and their likely errors (docs/method.md, "Confidence"; `make bench-confidence`)."""

    of_sigma: float = 0.8  # of the standard deviation of matched heights, over the root of their number
    of_relief: float = 0.12  # of the relief around them: a height may lie anywhere in its cell; but not of more than
    relief_m: float = 4.0  # so much
    of_tail: float = 0.13  # of the deviation of gross errors, below
    least_m: float = 0.7  # of heights that no map has, and more:
    least_shadow_m: float = 2.0  # the same in a shadow, where the ground beside it may be a roof
    of_background: float = 0.35  # of the relief around them, behind an occlusion
    of_shadow: float = 0.3  # in a shadow
    of_neighbours: float = 0.35  # from the cells beside them
    # The LE90. Calibrated on simulated towns, one of them of many dates, mountains and three-line images, so that 85 to
    # 95 % of the errors of heights of one, two, three and more maps are smaller; checked on jax_068 and whu_tlc.
    le90_of_error: float = 1.35  # times the expected error, where none is gross; and for the tail of gross errors
    far_m: float = 5.0  # within which lie the relief and the maps that say how gross they are:
    tail_m: float = 10.0  # of this relief at most, and of the distance between two candidates,
    tail_beside: float = 0.8  # of this relief, beside a step or hole of all maps,
    tail_holes: float = 0.4  # where no cell beside it was matched,
    tail_alone: float = 0.06  # and for any height; over the root of the maps' number, this one over their number;
    tail_against: float = 1.8  # of the distance to the other candidate, where all evidence is against this one;
    tail_lacking: float = 0.6  # and so many times more, where maps with heights nearby have none here,
    enough_maps: int = 3  # of which so many are enough
    le90_of_others: float = 2.4  # times the expected error, of heights that no map has


@dataclass(frozen=True)
class WaterParameters(Parameters):
    """Water, and how high it is (fusion/water.py; `make bench-water`). Chosen, unless a source is given."""

    narrowest_m: float = 12.0  # narrower empty ground is a shadow, or what a wall hides
    least_m2: float = 2000.0  # of a body: shadows and haloes of single houses are smaller
    share: float = 0.6  # of the cells around one that must be dark and flat
    dark_percentile: float = 20.0  # of the brightness of land: water is darker
    flat: float = 0.5  # of the usual roughness of land: what is smoother shows noise alone
    window_cells: int = 5  # side of the window of a roughness
    index_bins: int = 200  # of the index of water from -1 to 1: narrower than its noise
    most_cuts: int = 8  # of the index, each through the upper part of the one before
    enriched: float = 3.0  # times as frequent as among matched cells must water be among those that were not
    valley: float = 0.5  # of the frequency of water's own index, at most, at the threshold: shadows have no such gap
    infrared_percentile: float = 50.0  # of land: what is brighter in the near infrared is a cloud or snow
    as_dark: float = 0.15  # by which share what is as dark as a body may be brighter or darker
    least_alike: float = 0.1  # of the smallest body: so much other ground must be as dark to be compared
    beyond_percentile: float = 98.0  # of the index of that ground, much of which is plants: water lies beyond,
    beyond: float = 0.03  # and by so much
    least_empty: float = 0.5  # of a body: roofs of metal may look like water, but are matched
    shore_m: float = 3.0  # width of the strip around water that says how high the water is,
    shore_cells: int = 3  # but at least so many cells
    shore_percentile: float = 10.0  # of its heights: banks and trees are higher, a tenth may be wrong and too low
    least_shore: int = 20  # heights of a shore, or of a part of it: fewer are no evidence
    known_shore: float = 0.5  # of a shore must be known: what a cloud hides may be lower,
    level_shore: float = 0.25  # unless so much of all the shore is known to be
    same_level_m: float = 1.0  # no higher than this above the lowest
    island_m2: float = 100.0  # smaller islands are wrong matches, boats and waves
    bin_m: float = 25.0  # of a river's length, in which its shore gives one level
    least_bins: int = 4  # of a river
    least_elongation: float = 6.0  # length times length over area: a river is six times as long as wide; a disc has 1.3
    least_fall_m: float = 1.0  # of a river over its length: the level of a lake's shores is known no better
    fall_scatters: float = 3.0  # by so many deviations of its parts must a river fall
    most_cells: int = 4_000_000  # in which water is looked for; larger DSMs are reduced
    most_nodes: int = 20_000  # cells of a body between which lengths are measured
    part_m: float = 2000.0  # side of the ground whose pixels are read at once: bounds the memory
    least_part: int = 64  # and not fewer cells


@dataclass(frozen=True)
class VisibilityParameters(Parameters):
    """Which cells of a surface a view shows, and where (fusion/visible.py); both values are chosen."""

    square_cells: int = 256  # side of the squares, fixed on the ground, on whose lattice views are projected exactly
    nodes: int = 5  # a side of this lattice
    clearance_m: float = 1.0  # by which a surface must stand above a line of sight to block it


@dataclass(frozen=True)
class FusionParameters(Parameters):
    """From height maps to a DSM."""

    isolated: IsolatedPointParameters = IsolatedPointParameters()
    offsets: MapOffsetParameters = MapOffsetParameters()
    gridding: GriddingParameters = GriddingParameters()
    evidence: EvidenceParameters = EvidenceParameters()
    walls: WallParameters = WallParameters()
    choice: ChoiceParameters = ChoiceParameters()
    outliers: OutlierParameters = OutlierParameters()
    needles: NeedleParameters = NeedleParameters()
    brightness: BrightnessParameters = BrightnessParameters()
    shaded: ShadedGroundParameters = ShadedGroundParameters()
    holes: HoleParameters = HoleParameters()
    error: ErrorParameters = ErrorParameters()
    water: WaterParameters = WaterParameters()
    visibility: VisibilityParameters = VisibilityParameters()
    step_px: float = MATCHING.occlusions.step_px  # of disparity: higher steps hide ground, as where matching fills it
    covered: float = 0.5  # of a cell: a map that covers less does not count where another covers more; chosen
    feather_cells: int = 8  # over which tiles are blended on both sides of a seam; chosen
    block_cells: int = 512  # side of what is fused at once; bounds the memory
    hole_block_cells: int = 1024  # side of what holes are filled in at once; bounds the memory
    terrain_margin_m: float = 300.0  # by which the terrain feedback's surface extends beyond the tiles; chosen


FUSION = FusionParameters()
