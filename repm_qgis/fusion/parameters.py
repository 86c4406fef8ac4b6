"""The numbers that fusion chooses; docs/method.md says more about each subject."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from ..geometry.parameters import GriddingParameters
from ..matching.parameters import MATCHING
from ..parameters import Parameters


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

    radius_cells: float = 3.0  # default radius: the disc has 28 neighbours on a whole surface
    radius_m: float = 1.5  # and not less
    most_cells: float = 30.0  # of a radius: 2800 neighbours; the time grows with their number, and more are refused
    share: float = 0.2  # of the neighbours that half the cells have: the corner of a roof has a quarter
    neighbours: int = 2  # and not less


@dataclass(frozen=True)
class OverhangParameters(Parameters):
    """Cells in which one map sees two surfaces (docs/method.md, "Fusion"; `make bench-towns`)."""

    step_px: float = 1.5  # of disparity between two surfaces, and not less than a cell's two have; 1 and 2.5 do as well
    least_share: float = 0.1  # of a cell's points that each of the two has; 0.25 does as well
    widest_cell: float = 2.0  # distances between points: wider cells hold edges of roofs as they are; chosen
    widest_base_to_height: float = MATCHING.subpixel.planes.widest_base_to_height  # of a narrow pair
    along: Tuple[float, ...] = (0.25, 0.5, 0.75)  # of the way up to the roof; 0.1 and 0.35 first are worse


@dataclass(frozen=True)
class AggregationParameters(Parameters):
    """One height from several maps (docs/method.md, "Fusion"); found on truth scenes (`make bench-views`)."""

    sigma_px: float = 0.2  # errors of matching, px of disparity (`make bench-subpixel`: 0.12 narrow, 0.25 wide)
    tolerance: float = 2.5  # sigmas: heights this close mean the same surface
    weight_power: float = 0.5  # of metres_per_px ** -0.5: between equal weights and those of disparity noise alone
    neighbours: int = 3  # of eight, of the same map, that a height in conflict must agree with
    neighbour_tolerance: float = 1.9  # times the tolerance, for neighbours: surfaces slope
    agreed_cells: int = 500  # fewer do not show how scores are distributed
    rank_single: float = 0.03  # least rank of a lower group's score among the agreed cells', against one map
    rank_outvoted: float = 0.05  # against two maps or more
    rank_unsupported: float = 0.1  # where no agreed cell nearby has its height
    confirmed: float = 0.45  # of backgrounds, where two maps were matched: else gaps are failures, not occlusions
    background_directions: int = 2  # of eight in which the agreed surface has a background's height
    reach_cells: int = 12  # how far away the agreed surface is looked for


@dataclass(frozen=True)
class SightLineParameters(Parameters):
    """Heights that other maps look through (docs/method.md, "Fusion"; `make bench-towns`, `make bench-views`)."""

    same_px: float = 1.25  # of disparity: a map that is so close to a height sees it
    through_px: float = 2.0  # of disparity: one that lies farther below, with all around it, looks through it
    rim_px: int = 2  # around a pixel: with 1, gross errors in mountains of narrow pairs take away what is right
    outvoting: int = 2  # maps that look through a height replace it if more than half as many see it
    rounds: int = 3  # of replacing; what is still looked through is dropped
    least_pixels: int = 100  # matched ones, of a map that is heard
    fitted_pixels: int = 4000  # of a map from which the course of its lines of sight is found, about


@dataclass(frozen=True)
class ShadedGroundParameters(Parameters):
    """Ground in shadows without texture (docs/method.md, "Fusion"; `make bench-towns`)."""

    weak_score: float = 0.85  # of a single map's height: below, the images hardly support it; 0.8 and 0.9 do as well
    least_slope: float = 0.3  # of what matching makes of nothing, m per m
    slope_sigma_cells: float = 1.5  # of the mean whose slope that is; chosen
    gap_m: float = 1.0  # along the sun's direction: narrower ones may belong to the roof
    clear_m: float = 0.5  # by which a shadow's edge must pass over a cell
    above_m: float = 0.5  # by which a weak height must stand above the ground to be replaced
    reach_m: float = 100.0  # of the search for a shadow's end
    reach_cells: int = 400  # and no farther: bounds the memory
    directions_deg: Tuple[float, ...] = tuple(
        range(-40, 41, 10)
    )  # about the one away from the sun; 30 and 60 lose 0.1 %
    quantile: float = 0.25  # of the ends in these directions: some lie on roofs; 0.35 loses courts in January
    level_m: float = 1.0  # by which two directions may differ
    lattice_m: float = 2.0  # between the places around a cell whose median it takes; 1 and 3 do as well
    lattice_reach: int = 2  # of them to each side; 3 does as well
    least_around: int = 5  # of these 25 that must have a ground; with 1 small gaps take what is far away
    least_elevation_deg: float = 10.0  # of the sun: with less, shadows have no end

    def reach(self, cell: float) -> int:
        """Cells of the side ``cell`` (m) within which a shadow's end is looked for."""
        return max(1, min(int(self.reach_m / cell), self.reach_cells))

    def lattice(self, cell: float) -> Tuple[int, int]:
        """Cells between the places around a cell, and those to the farthest of them."""
        step = max(1, round(self.lattice_m / cell))
        return step, self.lattice_reach * step

    def halo(self, cell: float) -> int:
        """Cells around a block on which its own cells depend, on either side."""
        return self.reach(cell) + self.lattice(cell)[1]


@dataclass(frozen=True)
class BrightnessParameters(Parameters):
    """How bright cells are (fusion/brightness.py)."""

    views: int = 6  # the most vertical ones; with 10 the time grows, and nothing else; towns table
    percents: Tuple[float, float] = (2.0, 98.0)  # of a view's values, which become 0 and 1; chosen
    least_range: float = 1e-3  # of its values: less is one brightness; chosen, for images in any unit


@dataclass(frozen=True)
class StrayParameters(Parameters):
    """Heights that stray from the surface around them (docs/method.md, "Fusion"; `make bench-towns`)."""

    reach_m: float = 1.5  # half a window's side; 2 m does as well, for more time
    reach_cells: int = 5  # and no more: bounds the time
    sigma_m: float = 1.5  # of the weights by distance; 4 m does as well
    contrast: float = 0.1  # of brightness, at which a cell's weight has fallen to 1 / e; 0.05 and 0.2 do as well
    unknown: float = 1.0  # of these contrasts, the difference from a cell of unknown brightness; with 0 roofs erode
    sigmas: float = 3.0  # of the distances from the median: heights farther away are replaced; 2 and 4.5 do as well
    least_m: float = 0.2  # and no nearer ones; with 0.5 less is gained
    tail: float = 9.0  # root mean square of these distances, in usual ones: 12 to 21 in towns, 3 to 7 in natural ground
    least_usual_m: float = 0.05  # and no smaller ones: windows of few cells have their own cell's height; chosen
    at_once: int = 1 << 14  # cells; bounds the memory

    def reach(self, cell: float) -> int:
        """Cells of the side ``cell`` (m) on each side of a cell in its window."""
        return max(1, min(round(self.reach_m / cell), self.reach_cells))


@dataclass(frozen=True)
class WidenedRoofParameters(Parameters):
    """Roofs over the shadow beside them (docs/method.md, "Fusion"; `make bench-towns`)."""

    step_m: float = 3.0  # from roof to ground, and not less than between two surfaces of a cell; 2 and 5 do as well
    reach_m: float = 6.0  # by which a roof may be too wide; 10 does as well
    reach_cells: int = 24  # and no more: bounds the time
    around_m: float = 8.0  # half the side of the window that shows what roof and ground look like; 6 and 12 do as well
    around_cells: int = 16  # and no more: bounds the time
    lattice: int = 8  # places on each side of a cell, in that window; chosen
    least_cells: int = 8  # of these places, that must show a surface; chosen
    like_m: float = 1.5  # of height by which a surface varies there, or half the step between two surfaces; chosen
    contrast: float = 0.45  # by which the roof is brighter; 0.4 and 0.5 do as well, with 0.3 dark roofs go
    weak_contrast: float = 0.3  # the same of its brighter part, for heights of weak support; 0.2 does as well
    weak_share: float = 0.75  # of the roof that is darker than this part; 0.9 does as well, for all heights roofs go
    at_once: int = 1 << 12  # cells; bounds the memory

    def rounds(self, cell: float) -> int:
        """Cells of the side ``cell`` (m) by which a roof is cut back at most."""
        return max(1, min(round(self.reach_m / cell), self.reach_cells))

    def window(self, cell: float) -> Tuple[int, int]:
        """Cells between the places of the window, and from its middle to the last of them."""
        reach = max(1, min(round(self.around_m / cell), self.around_cells))
        step = max(1, reach // self.lattice)
        return step, reach // step * step

    def halo(self, cell: float) -> int:
        """Cells around a block on which its own cells depend, on either side."""
        return self.rounds(cell) + self.window(cell)[1]


@dataclass(frozen=True)
class HoleParameters(Parameters):
    """Interpolation of holes; both values are chosen."""

    reach_cells: int = 100  # heights farther away do not count
    widest_gap: int = 4  # of 16 directions in a row without a height; with more a cell lies beyond the border


@dataclass(frozen=True)
class ExpectedErrorParameters(Parameters):
    """Errors in px of disparity (docs/method.md, "Confidence"; `make bench-confidence`)."""

    at_best_px: float = 0.15  # at a correlation of 1
    per_score_px: float = 0.85  # more for each 1 of correlation less
    background_px: float = 1.5  # of the background of an occlusion


@dataclass(frozen=True)
class VisibilityParameters(Parameters):
    """Which cells of a surface a view shows, and where (fusion/visible.py); both values are chosen."""

    nodes: int = 9  # a side of the lattice on which views are projected exactly
    clearance_m: float = 1.0  # by which a surface must stand above a line of sight to block it


@dataclass(frozen=True)
class FusionParameters(Parameters):
    """From height maps to a DSM."""

    isolated: IsolatedPointParameters = IsolatedPointParameters()
    offsets: MapOffsetParameters = MapOffsetParameters()
    gridding: GriddingParameters = GriddingParameters()
    overhangs: OverhangParameters = OverhangParameters()
    aggregation: AggregationParameters = AggregationParameters()
    sight_lines: SightLineParameters = SightLineParameters()
    outliers: OutlierParameters = OutlierParameters()
    brightness: BrightnessParameters = BrightnessParameters()
    strays: StrayParameters = StrayParameters()
    widened: WidenedRoofParameters = WidenedRoofParameters()
    shaded: ShadedGroundParameters = ShadedGroundParameters()
    holes: HoleParameters = HoleParameters()
    error: ExpectedErrorParameters = ExpectedErrorParameters()
    visibility: VisibilityParameters = VisibilityParameters()
    step_px: float = MATCHING.occlusions.step_px  # of disparity: higher steps hide ground, as where matching fills it
    covered: float = 0.5  # of a cell: a map that covers less does not count where another covers more; chosen
    feather_cells: int = 8  # over which tiles change into each other on both sides of a seam; chosen
    block_cells: int = 512  # side of what is fused at once; bounds the memory
    hole_block_cells: int = 1024  # side of what holes are filled in at once; bounds the memory
    terrain_margin_m: float = 300.0  # by which the terrain feedback's surface extends beyond the tiles; chosen


FUSION = FusionParameters()
