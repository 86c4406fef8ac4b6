"""All numbers that the choice of images, pairs and altitudes takes, and those of promises and warnings.

"Chosen" means that no experiment is recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Tuple

from ..contracts.parameters import Parameters
from ..numerics.accuracy import CE90, LE90


@dataclass(frozen=True)
class SweepParameters(Parameters):
    """The plane sweep that finds the altitude range (Collins 1996). All values are chosen."""

    reduction: int = 8  # image px for one cell, along each side
    cells: int = 160  # cells along a side of a patch
    most_stretch: float = 1.5  # how much larger a patch may be than that, where it saves a patch that overlaps others
    patches: int = 3  # patches along a side of the area, at most
    window_radius: int = 5  # of the correlation window, cells
    least_correlation: float = 0.7  # a cell with less gives no altitude
    least_contrast: float = 1e-4  # variance of the root intensity over its squared mean: less is noise
    joined_planes: float = 2.0  # between neighbours of one connected part; smaller parts than the window are wrong
    least_known: float = 0.8  # share of a correlation window that both images must show
    least_cells: int = 60  # cells with an altitude: fewer are no evidence
    least_share: float = 0.01  # the same as a share of all cells
    enough_share: float = 0.1  # of all cells with an altitude: with fewer, the next best pair is tried,
    pairs: int = 4  # up to so many pairs
    block_share: float = 0.25  # of the area: where no pair sees so much, each part of it has a pair of its own
    block_levels: int = 3  # heights of the RPCs at which that is tested: the ground's height is not known yet
    most_seen: float = 0.8  # of what any pair sees of a part: the best pair that sees so much is taken
    most_planes: int = 180  # planes of a sweep
    shift_planes: int = 40  # planes that are tried when the shift between two views is searched
    most_shift: int = 3  # cells across the parallax, searched in both directions: errors of RPCs of tens of px
    tail_percent: float = 0.5  # heights at either end that may be wrong matches
    best_base_to_height: float = 0.3  # wide enough to measure heights, narrow enough to match
    least_base_to_height: float = 0.05  # a narrower pair measures no heights


@dataclass(frozen=True)
class PlaneParameters(Parameters):
    """The height that ortho-ready images were projected to, where nobody says it. All values are chosen."""

    reach_m: float = 500.0  # by which the assumed height may be wrong: vendors take a mean height of the ground
    fine_reduction: int = 2  # image px for one cell of the second sweep, whose planes are as much closer
    fine_reach_m: float = 40.0  # beyond the DEM's heights, searched by the second sweep


@dataclass(frozen=True)
class PairParameters(Parameters):
    """Which pairs are matched (Qin 2019; see docs/method.md, "Pairs"). Weights of time and sun are chosen."""

    narrow: float = 0.1  # base-to-height ratio of a good pair, at least: 5.7 degrees about the vertical
    wide: float = 0.9  # and at most: 48 degrees
    best_base_to_height: float = 0.35
    best_deg: float = 20.0  # convergence angle: semi-global matching is best at 15 to 25 degrees (Qin 2019)
    least_base_to_height: float = 0.05  # about 3 degrees: a narrower pair is never matched
    least_good_deg: float = 5.0  # oblique views have a fair ratio at angles that are too small for good heights
    all_up_to: int = 3  # views: of up to so many, all pairs are matched
    per_view: int = 2  # good pairs that each view gets; more cost time, and gain nothing (`make bench-towns`)
    enough: float = 12.0  # pairs over the ground, in the mean: what more of them add is no gain (`make bench-towns`)
    uncovered: float = 0.03  # of the ground that good pairs see: so much may be without one of those that are matched
    places: int = 64  # of the ground along each side, at which the coverage by pairs is tested; chosen
    most_per_view: int = 3  # pairs of a view that is a good partner of many; more only to connect all views
    decade_cost: float = 0.5  # for each power of ten of days between two images; `make bench-towns`
    season_cost: float = 0.5  # of the opposite season
    sun_cost_deg: float = 10.0  # angle between two suns that is as bad as an angle of convergence wrong by a factor e
    least_overlap: float = 0.05  # of the smaller image, where there are many: less has too few tie points. Chosen
    least_share: float = 0.01  # of the area: smaller overlaps cost as much as this one

    def fewest(self) -> "PairParameters":
        """Only as many pairs as connect all views."""
        return replace(self, all_up_to=2, per_view=1, uncovered=1.0)


@dataclass(frozen=True)
class PromiseParameters(Parameters):
    """What vendors promise of the position without ground control, where ``imagery/sensors.py`` has no figure."""

    unknown_m: float = 20.0  # CE90; chosen between the best satellites (4 m) and older ones
    unknown_px: float = 20.0  # the same in ground sampling distances, if that is more: coarser ones are worse. Chosen
    ce90: float = CE90  # by the standard deviation in each direction (normal distribution)
    le90: float = LE90  # by the standard deviation of heights (normal distribution)
    freedom: float = 8.0  # observed disagreements that a promise counts as much as; chosen
    gross_share: float = 0.05  # of scenes in which an RPC is not as promised, but grossly wrong; chosen
    gross_most: float = 100.0  # times as wrong as promised, at most; chosen


@dataclass(frozen=True)
class RpcHeightParameters(Parameters):
    """When the ground lies outside the heights that the RPCs were made for."""

    tail_percent: float = 5.0  # of the good ties' heights, at either end, that may be wrong; chosen
    room_m: float = 30.0  # of good ground outside: errors of SRTM (LE90 16 m, Farr 2007), trees, pits; chosen
    default_scale_m: Tuple[float, float] = (500.0, 501.0)  # of WorldView's RPCs, whatever the relief


@dataclass(frozen=True)
class AdviceParameters(Parameters):
    """When a report warns. Values without a source are chosen."""

    matching_px: float = 0.25  # expected accuracy of dense matching: the height accuracy is so many px of parallax
    sun_deg: float = 10.0  # between two suns: 40 minutes of a day, or four weeks in spring and autumn
    season_days: float = 60.0
    old_days: float = 365.0
    building_m: float = 10.0  # the example of a shadow
    few_ties: int = 5  # around a tile or in a part of the scene
    few_share: float = 0.25  # of a part's mean: with few ties in all, no part is worse than the others
    trend_px: float = 1.0  # over an image: sound RPCs need 0.01 to 0.21 px
    disagreement: float = 3.0  # times what the promised errors of the RPCs would cause: sound ones have 0.005 to 0.14
    uncertain: float = 2.0  # times the promised uncertainty of the height
    least_part: float = 0.1  # of a ninth of the area's bounds: less of it is a corner
    cells: int = 5  # along a side of the scene: ties of a tile are counted in at least such a cell around it
    small_overlap: float = 0.3  # of the smaller of two images: a smaller overlap is a strip along a border
    first_side_m: float = 1000.0  # of the small area that is proposed for a first trial


@dataclass(frozen=True)
class PlanningParameters(Parameters):
    """All parameters of this package."""

    sweep: SweepParameters = SweepParameters()
    planes: PlaneParameters = PlaneParameters()
    pairs: PairParameters = PairParameters()
    promises: PromiseParameters = PromiseParameters()
    rpc_heights: RpcHeightParameters = RpcHeightParameters()
    advice: AdviceParameters = AdviceParameters()
    area_altitudes: int = 5  # of a range, at which the images' footprints are intersected; chosen
    usual_px: float = 2.0  # by which RPCs of one pass usually disagree in each direction: tells datums apart; chosen


PLANNING = PlanningParameters()
