"""All numbers that the search for altitudes, pairs, tie points and pointing chooses.

"Chosen" means that no experiment is recorded. "Pointing tables" are those of docs/benchmarks.md, "Where the images
really look".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Tuple

from ..accuracy import CE90, LE90
from ..contracts.parameters import Parameters


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
    least_cells: int = 60  # cells with an altitude: fewer say nothing
    least_share: float = 0.01  # the same as a share of all cells
    enough_share: float = 0.1  # of all cells with an altitude: with fewer, the next best pair is tried,
    pairs: int = 4  # up to so many pairs
    block_share: float = 0.25  # of the area: where no pair sees so much, each part of it has a pair of its own
    block_levels: int = 3  # heights of the RPCs at which that is asked: the ground's is not known yet
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
    places: int = 64  # of the ground along each side, of which it is asked whether a pair covers them; chosen
    most_per_view: int = 3  # pairs of a view that is a good partner of many; more only to connect all views
    decade_cost: float = 0.5  # for each power of ten of days between two images; `make bench-towns`
    season_cost: float = 0.5  # of the opposite season
    sun_cost_deg: float = 10.0  # angle between two suns that is as bad as an angle of convergence wrong by a factor e
    least_overlap: float = 0.05  # of the smaller of two of many images: less holds too few tie points. Chosen
    least_share: float = 0.01  # of the area: smaller overlaps cost as much as this one

    def fewest(self) -> "PairParameters":
        """Only as many pairs as connect all views."""
        return replace(self, all_up_to=2, per_view=1, uncovered=1.0)


@dataclass(frozen=True)
class KeypointParameters(Parameters):
    """SIFT (Lowe 2004), by OpenCV or COLMAP."""

    contrast: float = 0.02  # least contrast of a keypoint over the layers of an octave, as OpenCV counts; chosen
    layers: int = 3  # of an octave (Lowe 2004)
    colmap_on_cpu: bool = False  # COLMAP's SIFT without a GPU: more ties for more time; pointing tables, "Detectors"
    most_colmap: int = 32768  # keypoints of an image from COLMAP: above this number it keeps the coarse ones
    strength_window_px: int = 5  # window of the gradients that stand for the strength of COLMAP's keypoints; chosen
    gpu_workers: int = 4  # processes that share a GPU, each with a context of some hundred MiB there; chosen
    answer_s: float = 120.0  # how long a device may take to pass the self-test; chosen
    blob_px: float = 0.35  # by which a detector may miss the middle of a blob in the self-test: half a pixel fails


@dataclass(frozen=True)
class PatchParameters(Parameters):
    """Where tie points are searched. All values are chosen; the pointing tables show the ties that come of them."""

    whole_px: int = 1600  # a scene up to this side is one patch
    least_px: int = 300  # side of a patch, at least
    most_px: int = 500  # and at most
    scene_patches: int = 6  # side of the scene over that of a patch: nine patches are a quarter of it
    least_cells: int = 3  # cells along a side of the scene; each gives one patch a round
    most_cells: int = 5
    cell_patches: int = 3  # a cell is at least so many patches wide
    places: int = 6  # places of a cell, along a side, of which the best is searched first
    least_inside: float = 0.3  # share of a patch that must lie in the area
    texture_px: int = 5  # window of the gradients' matrix
    texture_quantile: float = 0.9  # of its smallest eigenvalue's root over a patch
    missed_weight: float = 0.5  # of a patch's texture, for each view that does not show it
    most_rounds: int = 5  # patches searched in a cell
    enough_ties: int = 100  # of every pair; with fewer, the next patches are searched
    block_share: float = 0.25  # of the area, which most pairs of a block of frames do not see
    frame_patches: int = 3  # of each pair of a block: with fewer, a frame's ties lie in one corner
    frame_seen: float = 0.2  # share of a patch that a pair must see to be searched there
    frame_places: int = 4  # along a side of the ground that a pair of frames sees, of which the best is searched first
    frame_inside: float = 0.7  # share of a patch that must lie on that ground
    frame_apart: float = 0.5  # of a patch may lie on another one
    frame_ties: int = 40  # of every pair of a block, as ``enough_ties``: each frame has several pairs


@dataclass(frozen=True)
class TieParameters(Parameters):
    """Keypoints of patches and their matches. Values without a source are chosen."""

    reduction: float = 2.0  # SIFT on images of half size takes a sixth of the time and gives enough ties
    small_px: int = 500  # images of a scene of one patch below this side are not reduced
    small_patch_px: int = 300  # the same for one of several patches
    features_per_mpx: int = 2500  # of a refined image
    least_features: int = 600  # of a scene of one patch
    most_features: int = 4000
    least_patch_features: int = 300  # of each of several patches, which share those of a scene
    spare_features: int = 3  # times as many are detected, for an even choice among them
    buckets: int = 12  # along a side of a patch, for an even choice
    border_px: int = 4  # keypoints so near to pixels without data are not used
    least_keypoints: int = 8  # of a view over a patch
    margin_px: int = 24  # around a patch, in the views
    tolerance_px: float = 64.0  # vertical parallax from errors of RPCs: up to tens of px a view
    near_px: float = 8.0  # around a patch's vertical parallax, in the second search
    close_px: float = 2.5  # around the trend of a patch's vertical parallax, in the third search
    likely_px: float = 6.0  # by which a trend over the images may leave the most frequent vertical parallax
    mode_px: float = 1.0  # width of the interval that gives the most frequent value over all patches
    patch_mode_px: float = 2.0  # the same over one patch
    patch_mode_share: float = 0.15  # of a patch's matches must lie there for a second search
    trend_matches: int = 40  # near the most frequent value, for a plane instead of a constant
    trend_reach_px: Tuple[float, ...] = (6.0, 4.0, 3.0, 2.0, 2.0)  # of Tukey's weights, iteration by iteration
    patch_reach_px: float = 2.5  # by which a patch's median may be off the trend
    agree_px: float = 1.5  # matches of a patch lie so near to its median
    least_patch_matches: int = 4  # of a patch near the trend
    neighbours: int = 10  # of a match, in the first image
    supporters: int = 3  # neighbours that must have nearly its disparity: a match with the next roof has not
    support_step_px: float = 6.0  # of disparity between neighbours: a house
    support_slope: float = 0.4  # and a share of their distance: sloping ground
    ratio: float = 0.85  # of the best and the second descriptor distance (Lowe 2004: 0.8 without other constraints)
    most_distance: float = 0.8  # between descriptors of unit length
    least_ties: int = 12  # of a pair


@dataclass(frozen=True)
class AlignmentParameters(Parameters):
    """Subpixel alignment of ties (Lucas and Kanade 1981).

    The spread of vertical parallax falls from 0.5 px to 0.1 px on real and simulated Pleiades pairs.
    """

    window_px: int = 11  # side of the neighbourhood that is aligned; chosen
    iterations: int = 30  # at most
    stop_px: float = 0.005  # a smaller step ends the iteration
    margin_px: int = 24  # around the ties of a patch
    patch_px: int = 1700  # side of the patches in which images are aligned, at most: bounds memory
    kept_px: int = 1 << 25  # of resampled pairs that are kept for further ties: bounds memory
    gap: float = 0.1  # of that side: nothing is aligned between ties that are farther apart
    farthest_px: float = 1.5  # SIFT's error is never so large: what moves farther has found something else
    return_px: float = 0.1  # distance of a position after the way to the second image and back to the first
    most_alike: float = 0.7  # share of a patch's ties that stay: at edges of roofs windows hold two parallaxes
    enough: int = 30  # with fewer ties in a patch, that share is not taken
    even_px: float = 5.0  # standard deviation of the Gaussian that evens out intensity and contrast
    even_contrast: float = 40.0  # grey values: the contrast afterwards
    noise: float = 0.012  # contrast of the stretched image (0..1) that may be noise and is not amplified
    least_texture: float = 1e-3  # smallest eigenvalue of the gradients' matrix, as OpenCV normalises it


@dataclass(frozen=True)
class AdjustmentParameters(Parameters):
    """The least-squares adjustment of pointing."""

    iterations: int = 10  # of Gauss-Newton, at most
    stop: float = 1e-4  # px: smaller steps end the iteration
    huber_px: float = 0.7  # residuals from which on Huber's weights (1964) fall; chosen
    tukey: float = 4.685  # standard deviations: 95 % efficient for Gaussian residuals (Beaton and Tukey 1974)
    least_sigma_px: float = 0.05  # noise of tie points, at least
    affine_ties: int = 60  # fewer carry no affine correction
    affine_cover: float = 0.4  # share of an image's width and height that ties must span for one
    cover_tail_percent: float = 2.0  # ties at either end that do not count for that span
    affine_control: int = 6  # control points that may ask for an affine correction where ties do not
    affine_gain: float = 0.9  # an affine correction must reduce the residuals below this share
    affine_limit: float = 3.0  # median residuals at which residuals are cut for the information criterion
    rank: float = 1e-6  # of the largest eigenvalue: what lies below is not determined
    known_px: float = 0.25  # nor is what ties determine with a larger standard deviation only
    control_known_px: float = 1.0  # the same with control points: vendors' RPCs are no better


@dataclass(frozen=True)
class JitterParameters(Parameters):
    """Waves of the attitude (sfm/jitter.py). Values without a source are chosen, on simulated scenes
    (`make bench-jitter`)."""

    knots_lines: Tuple[float, ...] = (300.0, 200.0, 130.0, 90.0)  # between two knots of the splines: a wave needs four
    asked_lines: float = 130.0  # of which it is asked whether there are waves at all
    least_intervals: int = 4  # between knots: shorter parts of images show no waves
    most_intervals: int = 160  # bounds memory and time,
    most_unknowns: int = 1200  # as does this, of many views
    ties_per_spline: float = 4.0  # of each view, at least
    gain: float = 0.75  # waves must reduce the residuals below this share
    least_px: float = 0.08  # root mean square of a view's wave, at least of one: what is smaller does no harm
    usual_px: float = 0.7  # standard deviation of a spline's coefficient beforehand (Tong et al. 2015: up to 1.5 px),
    trend_px: float = 0.01  # and of its mean and trend, which are the pointing's
    known_px: float = 2.0  # what ties determine less well is not applied
    limit: float = 3.0  # median residuals without waves at which residuals are cut for the information criterion
    patch_cells: Tuple[int, int] = (1, 12)  # cells of a scene with waves that are searched for more ties, a side
    patch_features: int = 1500  # of each of their patches
    features_per_mpx: int = 8000


@dataclass(frozen=True)
class ControlParameters(Parameters):
    """Noise and gross errors of ground control points."""

    prior_px: float = 0.1  # one more observation with this noise, as a single point has no redundancy
    least_noise_px: float = 0.02  # RPCs themselves are no better
    wrong_px: float = 0.5  # smaller errors are never reported
    false_alarm: float = 0.01  # probability that any good point of a table is rejected
    suspect: float = 2.5  # robust standard deviations from which on a point is tested


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
class ExchangeParameters(Parameters):
    """Whether two images have each other's RPC (sfm/exchanged.py; `make bench-own_rpcs`)."""

    least_ties: int = 20  # of two images: fewer say nothing. Chosen
    most_ties: int = 200  # that are asked: bounds the time. Chosen
    view_ties: int = 50  # for each of many views, of which it is asked whether its ties fit. Chosen
    limit: float = 5.0  # median residuals beyond which all ties count alike. Chosen
    most_views: int = 24  # of which all pairs are asked: the time grows with their square. Chosen
    least_base_to_height: float = 0.02  # of two images: an exchange of narrower ones turns no surface. Chosen
    least_evidence: float = 10.0  # for a warning: "very strong" (Kass and Raftery 1995, "Bayes factors"); -2 at most
    # on sound scenes, and 19 to 480 on exchanged ones
    sure_evidence: float = 30.0  # for a refusal, where the ties also fit to
    sure_px: float = 0.15  # after the exchange, as ties of sound RPCs do (0.03 to 0.11 px)


@dataclass(frozen=True)
class RpcHeightParameters(Parameters):
    """When the ground lies outside the heights that the RPCs were made for."""

    tail_percent: float = 5.0  # of the good ties' heights, at either end, that may be wrong; chosen
    room_m: float = 30.0  # of good ground outside: errors of SRTM (LE90 16 m, Farr 2007), trees, pits; chosen
    default_scale_m: Tuple[float, float] = (500.0, 501.0)  # of WorldView's RPCs, whatever the relief


@dataclass(frozen=True)
class PlaceParameters(Parameters):
    """How far control points may be from where the vendors' RPCs put their pixels, beyond the vendors' promise."""

    margin_m: float = 50.0  # errors of points from maps; a geoid of 100 m seen at 27 degrees. Chosen


@dataclass(frozen=True)
class ColmapAdjustmentParameters(Parameters):
    """COLMAP's bundle adjustment of principal points."""

    least_ties: int = 8  # of a patch
    passes: int = 3
    first_scale_px: float = 1.0  # of the Cauchy loss, before the residuals are known
    cauchy: float = 2.385  # standard deviations: 95 % efficient for Gaussian residuals (Holland and Welsch 1977)
    wrong: float = 4.685  # standard deviations from which on a tie is left out, as in AdjustmentParameters.tukey
    least_sigma_px: float = 0.03
    margin_px: int = 24  # around the ties of a patch, for the cameras
    tail_percent: float = 1.0  # heights at either end that may be wrong
    least_rank: float = 1e-3  # of the largest singular value: shifts below it are not determined


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
    disagreement: float = 3.0  # of RPCs, in what their promise lets expect: sound ones have 0.005 to 0.14
    uncertain: float = 2.0  # times the promised uncertainty of the height
    least_part: float = 0.1  # of a ninth of the area's bounds: less of it is a corner
    cells: int = 5  # along a side of the scene: ties of a tile are counted in at least such a cell around it
    small_overlap: float = 0.3  # of the smaller of two images: less of it is a strip along a border
    first_side_m: float = 1000.0  # of the small area that is proposed for a first trial


@dataclass(frozen=True)
class PointingParameters(Parameters):
    """All parameters of this package."""

    sweep: SweepParameters = SweepParameters()
    planes: PlaneParameters = PlaneParameters()
    pairs: PairParameters = PairParameters()
    keypoints: KeypointParameters = KeypointParameters()
    patches: PatchParameters = PatchParameters()
    ties: TieParameters = TieParameters()
    alignment: AlignmentParameters = AlignmentParameters()
    adjustment: AdjustmentParameters = AdjustmentParameters()
    jitter: JitterParameters = JitterParameters()
    control: ControlParameters = ControlParameters()
    promises: PromiseParameters = PromiseParameters()
    rpc_heights: RpcHeightParameters = RpcHeightParameters()
    exchange: ExchangeParameters = ExchangeParameters()
    places: PlaceParameters = PlaceParameters()
    colmap: ColmapAdjustmentParameters = ColmapAdjustmentParameters()
    advice: AdviceParameters = AdviceParameters()
    least_tracks: int = 20  # tie points after alignment; chosen
    track_base: float = 0.02  # base-to-height ratio of the views of a tie point: narrower ones give no height; chosen
    usual_px: float = 2.0  # by which RPCs of one pass usually disagree in each direction: tells datums apart; chosen
    most_trend_px: float = 10.0  # over an image, without ground control: no vendor's RPC drifts so far. Chosen
    good_px: float = 1.5  # a tie with a larger residual is a wrong match, and gives no altitude; chosen
    around: float = 0.25  # of a tile's side: ties so far around it also give its altitudes; chosen
    tail_percent: float = 0.5  # of these altitudes, at either end, that may be wrong; chosen

    def with_many_ties(self) -> "PointingParameters":
        """For a scene with jitter: more ties, of all lines."""
        least, most = self.jitter.patch_cells
        patches = replace(self.patches, whole_px=0, cell_patches=1, least_cells=least, most_cells=most)
        features = self.jitter.patch_features
        ties = replace(self.ties, least_patch_features=features, features_per_mpx=self.jitter.features_per_mpx)
        return replace(self, patches=patches, ties=ties)


POINTING = PointingParameters()
