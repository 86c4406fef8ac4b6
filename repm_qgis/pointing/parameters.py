"""All numbers that the adjustment of pointing chooses.

"Chosen" means that no experiment is recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Tuple

from ..contracts.parameters import Parameters
from ..planning.parameters import PlanningParameters
from ..ties.parameters import TiesParameters


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
    """Waves of the attitude (pointing/jitter.py). Values without a source are chosen, on simulated scenes
    (`make bench-jitter`)."""

    knots_lines: Tuple[float, ...] = (300.0, 200.0, 130.0, 90.0)  # between two knots of the splines: a wave needs four
    asked_lines: float = 130.0  # of the first test for waves
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
class ExchangeParameters(Parameters):
    """Whether two images have each other's RPC (pointing/exchanged.py; `make bench-own_rpcs`)."""

    least_ties: int = 20  # of two images: fewer are no evidence. Chosen
    most_ties: int = 200  # that are fitted: bounds the time. Chosen
    view_ties: int = 50  # for each of many views, to test whether its ties fit. Chosen
    limit: float = 5.0  # median residuals beyond which all ties count alike. Chosen
    most_views: int = 24  # of which all pairs are tested: the time grows with their square. Chosen
    least_base_to_height: float = 0.02  # of two images: an exchange of narrower ones turns no surface. Chosen
    least_evidence: float = 10.0  # for a warning: "very strong" (Kass and Raftery 1995, "Bayes factors"); -2 at most
    # on sound scenes, and 19 to 480 on exchanged ones
    sure_evidence: float = 30.0  # for a refusal, where the ties also fit to
    sure_px: float = 0.15  # after the exchange, as ties of sound RPCs do (0.03 to 0.11 px)


@dataclass(frozen=True)
class PlaceParameters(Parameters):
    """How far control points may be from where the vendors' RPCs put their pixels, beyond the vendors' promise."""

    margin_m: float = 50.0  # errors of points from maps; a geoid of 100 m seen at 27 degrees. Chosen
    misread_px: float = 1.5  # (RMS) residuals that differ by more than this were read wrongly ...
    misread_gain: float = 5.0  # ... where what the table may mean brings them together so many times. Both chosen
    misread_points: int = 4  # in an image, at least; chosen
    believable: float = 3.0  # standard deviations of the RPCs' heights, beyond which those of points are named. Chosen


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
class PointingParameters(Parameters):
    """All parameters of this package, and of those that it calls."""

    planning: PlanningParameters = PlanningParameters()
    ties: TiesParameters = TiesParameters()
    adjustment: AdjustmentParameters = AdjustmentParameters()
    jitter: JitterParameters = JitterParameters()
    control: ControlParameters = ControlParameters()
    exchange: ExchangeParameters = ExchangeParameters()
    places: PlaceParameters = PlaceParameters()
    colmap: ColmapAdjustmentParameters = ColmapAdjustmentParameters()
    least_tracks: int = 20  # tie points after alignment; chosen
    track_base: float = 0.02  # base-to-height ratio of the views of a tie point: narrower ones give no height; chosen
    most_trend_px: float = 10.0  # over an image, without ground control: no vendor's RPC drifts so far. Chosen
    good_px: float = 1.5  # a tie with a larger residual is a wrong match, and gives no altitude; chosen
    around: float = 0.25  # of a tile's side: ties so far around it also give its altitudes; chosen
    tail_percent: float = 0.5  # of these altitudes, at either end, that may be wrong; chosen

    def with_many_ties(self) -> "PointingParameters":
        """For a scene with jitter: more ties, of all lines."""
        least, most = self.jitter.patch_cells
        patches = replace(self.ties.patches, whole_px=0, cell_patches=1, least_cells=least, most_cells=most)
        features = self.jitter.patch_features
        matches = replace(
            self.ties.matches, least_patch_features=features, features_per_mpx=self.jitter.features_per_mpx
        )
        return replace(self, ties=replace(self.ties, patches=patches, matches=matches))


POINTING = PointingParameters()
