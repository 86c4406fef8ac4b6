"""All numbers that matching chooses.

"Chosen" means that no experiment is recorded. "Matching table" is that of docs/benchmarks/matching.md, which changes
one choice of the matcher at a time (``make bench-matching``); "subpixel table" is ``make bench-subpixel``, "masks
table" ``make bench-masks``, "towns table" ``make bench-towns``. Intensities are 0..1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Tuple

from ..colmap.parameters import ColmapParameters
from ..contracts.parameters import Parameters
from ..planning.altitudes import ALTITUDES
from ..stereo.parameters import StereoParameters


@dataclass(frozen=True)
class SgmParameters(Parameters):
    """Semi-global matching (Hirschmueller 2008) in OpenCV's implementation, and the checks of its result."""

    block_px: int = 1  # side of a block: 1 keeps steps sharp, and the noise is removed afterwards; matching table
    p1: int = 12  # penalty of OpenCV's costs for a change of disparity by 1 px; matching table
    p2: int = 48  # penalty for a greater change; matching table
    paths: int = 3  # directions of aggregation, 3, 5 or 8: 3 are as good as 8 in a quarter of the time; matching table
    prefilter_cap: int = 31  # of OpenCV's gradients, in its intensities of 0..255; chosen
    left_right_px: float = 1.0  # by which the disparities of the two directions may differ; matching table
    speckle_px: int = 80  # connected components of so many pixels or fewer are removed; matching table
    speckle_step_px: float = 1.0  # of disparity between neighbours of one component; chosen
    tower_px: int = 12  # the same for components that match well: towers and chimneys; matching table
    tower_score: float = 0.8  # correlation of such a component's pixels; chosen
    score_window_px: int = 7  # side of the correlation window of the score; chosen
    unlike: int = 4  # times the penalties, with 8 paths, of images whose intensities agree on little; seasons table
    rim_px: int = 5  # window around pixels without data: the pre-filter and subpixel costs reach 2 px to each side

    def in_eight_directions(self) -> "SgmParameters":
        """The best that OpenCV has. More directions smooth more, so the penalty is less; `make bench-towns`."""
        return replace(self, paths=8, p2=36)

    def of_unlike_images(self) -> "SgmParameters":
        """Those of images whose intensities say less: costs at right disparities are nearer to those at random ones."""
        return replace(self, paths=8, p1=self.unlike * self.p1, p2=self.unlike * self.p2)


@dataclass(frozen=True)
class LearnedParameters(Parameters):
    """Semi-global matching of a learned cost, 0..1, and the chance that its disparity is wrong; seasons table."""

    p1: float = 0.8  # penalty of a change of disparity by 1 px
    p2: float = 4.0  # penalty of a greater change
    outside: float = 0.42  # cost of a match beyond the second image, which has no other
    contrast: float = 0.2  # of intensity from a pixel to the next, at which that penalty is half as large
    mean_px: int = 9  # windows of the means of margin and cost below,
    agreement_px: int = 25  # and of the share of pixels whose match points back to them within 1 px
    odds: Tuple[float, ...] = (
        3.179,
        -0.795,
        -1.591,
        -0.953,
        0.988,
    )  # logarithm of the odds that a disparity is wrong by
    # more than 3 m: itself, and more for each 1 of margin, lead, agreement and cost; fitted on simulated seasons
    most_doubt: float = 0.8  # chance of that from which on no disparity is used,
    most_shared_doubt: float = 0.5  # the same where other pairs may fill what this one leaves
    least_doubt: float = 0.3  # and up to which those of one direction alone are
    score_window_px: int = 7  # as of intensities
    support: float = 0.6  # added to correlations, with half of the margin, where both directions do not agree; 1 less
    # where they do: over water smoothness alone makes them agree, without margin; masks table
    least_days: float = 1.0  # between two images whose agreement is measured
    most_agreement: float = 0.9  # of intensities at the coarse level, from which on they are the better cost;
    most_undated: float = 0.75  # the same of images without a time: those of one pass have 0.82 to 0.95
    measured_tiles: int = 3  # of each pair


@dataclass(frozen=True)
class EdgeParameters(Parameters):
    """Correction of depth edges (guided filter of He, Sun and Tang 2013)."""

    median_px: int = 5  # side of the median that removes outliers first; chosen
    reach_px: int = 5  # pixels on each side of a step that are assigned again; matching table
    step_px: float = 1.5  # of disparity: a smaller difference is a slope; chosen
    surface_window_px: int = 9  # window of the mean disparity of each of the two surfaces; matching table
    gap_window_px: int = 15  # window of the mean that stands in for missing disparities; chosen
    intensity_cap: float = 0.045  # greater differences of intensity count as this one; chosen
    gradient_cap: float = 0.022  # the same for the gradient, for each px; chosen
    window_px: int = 7  # of the guided filter; matching table
    contrast: float = 0.02  # edges of the image that are much weaker do not limit the window; chosen


@dataclass(frozen=True)
class OcclusionParameters(Parameters):
    """Which gaps are occlusions. An occlusion is as long as the disparity rises (geometry of a pair)."""

    step_px: float = 1.5  # of disparity: a smaller difference is a slope; as at depth edges
    slack_px: float = 6.0  # by which a gap may be longer than the jump of disparity; chosen
    factor: float = 1.2  # and by which factor; towns table
    narrow_px: int = 8  # rows of a gap that matching leaves along edges in the rows' direction; matching table


@dataclass(frozen=True)
class DetailParameters(Parameters):
    """How much of the detail of disparities is kept; see ``matching/detail.py``."""

    scales_px: Tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)  # of the means that detail is taken apart by; matching table
    noise_share: float = 0.5  # of the variance of the last step, which the filters before it leave; matching table
    power: int = 1  # of the noise's share of the detail that is removed; chosen: Wiener's gain


@dataclass(frozen=True)
class PlaneDetailParameters(DetailParameters):
    """The same for planes; all of it is measured by `make bench-towns`."""

    scales_px: Tuple[float, ...] = (1.0, 2.0, 4.0, 8.0, 16.0)
    noise_share: float = 1.0
    power: int = 4


@dataclass(frozen=True)
class PlanesParameters(Parameters):
    """Narrow pairs over towns (docs/method.md, "Subpixel disparities"; `make bench-towns`)."""

    widest_base_to_height: float = 0.2  # of a narrow pair: a px of disparity is five px on the ground or more
    least_tail: float = 3.0  # mean square of a detail, in robust variances: 4 to 13 in towns, 1.2 to 1.8 without walls
    tail_scale: int = 2  # the detail that shows it: of the means over 2 and 4 px
    passes: int = 2
    kept: PlaneDetailParameters = PlaneDetailParameters()


@dataclass(frozen=True)
class SubpixelParameters(Parameters):
    """Subpixel disparities: Gauss-Newton steps on the intensities (Lucas and Kanade 1981) and filters, in turns."""

    operations: Tuple[str, ...] = ("step", "step", "median", "mean", "step", "mean", "step", "detail")
    # Half-quadratic splitting (Geman and Yang 1995); the first steps leave the whole pixels that semi-global matching
    # prefers before anything is averaged; matching table.
    most_step_px: float = 0.3  # of a step; chosen
    sigma_px: float = 1.2  # of the Gaussian window, which has 4 pi sigma^2 = 18 independent pixels; matching table
    prior_px: float = 0.27  # standard deviation that semi-global matching leaves in such a window; subpixel table
    least_noise: float = 1e-6  # variance of the intensity: below the noise of a sensor of 12 bits
    median_px: int = 5  # side of the median; chosen
    edge_px: float = 0.7  # no median moves a disparity farther: that would be an edge; matching table
    smooth_sigma_px: float = 1.5  # of the bilateral filter (Tomasi and Manduchi 1998) in space; chosen
    alike_sigma_px: float = 0.5  # the same in disparity; chosen
    smooth_window_px: int = 7  # side of its window; chosen
    detail: DetailParameters = DetailParameters()
    planes: PlanesParameters = PlanesParameters()
    full_scale_px: float = 2.0  # wider means are made at half the resolution, for a fifth of the time; chosen
    alike_detail_px: float = 0.3  # as alike_sigma_px, of these means: no more, or curbs and ridges go; matching table
    power_window: float = 2.0  # of a detail's mean square, in the sigmas of its scale; chosen
    variance_sigma_px: float = 4.0  # over which the variance of disparities is averaged; chosen
    correlation_sigma_px: float = 3.0  # wider differences of intensity are no noise; chosen
    correlation_lags: int = 3  # px over which the noise's correlation is summed up; chosen

    def of_pair(self, base_to_height: float) -> "SubpixelParameters":
        """Those of a pair of this geometry: in a narrow pair, noise is more of what the ground may be like."""
        if base_to_height > self.planes.widest_base_to_height:
            return self
        return replace(self, operations=tuple("planes" if name == "detail" else name for name in self.operations))


@dataclass(frozen=True)
class ReliabilityParameters(Parameters):
    """Which disparities the images do not support (water), and clouds; the masks table measures all of it."""

    correlation_px: int = 7  # window of a correlation
    support_px: int = 25  # window over which correlations are averaged
    least_support: float = 0.3  # water has 0.1 to 0.2, the weakest hundredth of fields and mountains 0.55
    own_px: int = 9  # a large window reaches over the shore: components grow where the average of this window
    own_support: float = 0.5  # is less than this,
    growth_px: int = 14  # by up to so much
    least_px: int = 4000  # pixels of a component: smaller ones (32 m x 32 m at 0.5 m) are roofs, shadows, pools
    endless_px: int = 20000  # larger ones (70 m x 70 m) are always removed: smoothness extends no height so far
    scatter_px: float = 0.7  # a disparity scatters that differs by more from the mean around it,
    scatter_window_px: int = 41  # in this window
    scatter_share: float = 0.25  # of a component's disparities: plain roofs have 0.1 at most, water 0.45 and more
    shore_px: int = 6  # removed around a component: the texture of a bank extends its height over the water
    shore_window_px: int = 7  # where the average of this window
    shore_support: float = 0.8  # is less than this
    bright: float = 0.6  # intensity of a cloud
    bright_share: float = 0.5  # of its pixels
    cloud_px: int = 4000  # pixels of it, at least
    cloud_m: float = 80.0  # above its surroundings: no white roof of the least size is so high
    cloud_step_px: float = 2.0  # of disparity between neighbours: more ends a component
    around_px: int = 30  # width of the surroundings
    around_share: float = 0.8  # of the surroundings' ground, which must lie so far below
    least_ground: float = 0.2  # share of the surroundings that must have a height


@dataclass(frozen=True)
class LearnedReliabilityParameters(ReliabilityParameters):
    """The same of learned features, which leave weak places in fields and gardens of another season, too."""

    own_support: float = 0.4
    least_px: int = 12000
    shore_window_px: int = 5


@dataclass(frozen=True)
class WideWindowParameters(Parameters):
    """Weak texture, matched at the coarse level, where the noise falls to a quarter; px are those of reduced images."""

    contrast_px: float = 4.0  # sigma of the window in which the contrast is made even
    contrast: float = 0.2  # standard deviation that intensities have then
    sigma_px: float = 2.0  # of the Gaussian window of the subpixel steps
    rim_px: int = 1  # at the border of the missing area that are left out of the correlation
    smooth_px: float = 4.0  # sigma of the mean of the disparities,
    most_smooth_m: float = 16.0  # at most: ground is not smooth over the 34 m that it is in images of 2.1 m
    score_window_px: int = 11  # side of a correlation window
    support_px: int = 15  # window over which correlations are averaged
    least_support: float = 0.65
    beside_px: int = 2  # from the disparity, where correlations must be less:
    least_lead: float = 0.15  # 98 % of snow has more, shaded lakes 0 to 0.1; masks table and tests
    narrowest_px: int = 9  # narrower parts are removed: windows reach from a bank over the water
    score_loss: Tuple[float, float] = (0.2, 2.2)  # 1 less the score: at full support, and more for each 1 less


@dataclass(frozen=True)
class PriorParameters(Parameters):
    """The disparity prior of the coarse level (docs/method.md, "Coarse to fine"). Values without source are chosen."""

    factor: int = 4  # fine px for one coarse px, along each side
    cell_px: int = 4  # coarse px of a cell of the prior, along each side: 16 fine px
    range_margin_px: int = 6  # disparities searched beyond the altitudes of the tile
    least_span_px: float = 48  # of disparities: a smaller search needs no prior
    least_gain: float = 0.8  # a prior that leaves more than this share of the search is not used
    most_rough: float = 0.5  # nor one that leaves more of the disparities' own range (0.2 to 0.65 in mountains, 0.75 to
    # 1.1 in towns on plains; towns table),
    walls: float = 16.0  # where that is more than so many NMAD of the rest: 6 to 14 in mountains, 20 to 60 in towns
    least_cells: float = 0.05  # share of the cells that must have a disparity
    median_cells: int = 5  # side of the median: houses are smaller, hills are not
    rise: float = 0.7  # of disparity for each px along a row, at most: with 1 the second image would fold
    fall: float = 1.75  # the same for a fall, which never folds it
    smooth_cells: float = 1.0  # sigma of the smoothing of the cells
    gap_cells: float = 2.0  # sigma of the first mean that fills gaps; each next one is twice as wide
    tail_percent: float = 0.05  # of the coarse residuals at either end that may be wrong matches
    margin_px: int = 8  # searched beyond what the coarse level found
    above_m: float = ALTITUDES.prior_above_m
    remove_parallax: bool = True  # the vertical parallax at the prior's altitude; table "What refinement gains"


@dataclass(frozen=True)
class CoarseSurfaceParameters(Parameters):
    """The coarse surface of a scene. All values are chosen; it takes 2 to 3 CPU seconds for 3 x 26 Mpx."""

    factor: int = 8  # fine px for one coarse px, along each side
    cell_px: int = 16  # fine px of a cell of the surface, along each side: two coarse ones
    block_px: int = 6400  # side of what is matched at once: 800 coarse px
    range_share: float = 0.15  # of the scene's altitude range, searched beyond each end: its margins may be too small
    range_margin_px: int = 2  # coarse px of disparity searched beyond that
    smallest_px: int = 16  # coarse px of a block's shorter side
    least_score: float = 0.6  # of a disparity
    median_cells: int = 5  # side of the median that removes wrong cells
    least_neighbours: int = 8  # known cells of that square
    least_share: float = 0.25  # of a tile's cells that must be known for its altitudes
    least_cells: int = 4  # the same as a number
    tail_percent: float = 0.2  # of the cells at either end that may be wrong
    room_cells: float = 1.25  # m of height for each m of cell: what narrow valleys and ridges may lose


@dataclass(frozen=True)
class MatchingParameters(Parameters):
    """All of matching, whichever backend."""

    stereo: StereoParameters = StereoParameters()
    sgm: SgmParameters = SgmParameters()
    learned: LearnedParameters = LearnedParameters()
    edges: EdgeParameters = EdgeParameters()
    occlusions: OcclusionParameters = OcclusionParameters()
    subpixel: SubpixelParameters = SubpixelParameters()
    reliability: ReliabilityParameters = ReliabilityParameters()
    learned_reliability: LearnedReliabilityParameters = LearnedReliabilityParameters()
    wide: WideWindowParameters = WideWindowParameters()
    prior: PriorParameters = PriorParameters()
    coarse_surface: CoarseSurfaceParameters = CoarseSurfaceParameters()
    colmap: ColmapParameters = ColmapParameters()

    def of_pairs(self, count: int) -> "MatchingParameters":
        """Those of a scene of so many pairs."""
        if count < 2:
            return self
        return replace(self, learned=replace(self.learned, most_doubt=self.learned.most_shared_doubt))


MATCHING = MatchingParameters()
