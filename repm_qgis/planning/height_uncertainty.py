"""How uncertain the absolute height is without ground control: what vendors promise, and how much RPCs disagree.

The errors of the images' lines of sight on the ground are taken as normal and different in each image. The vendors
promise their deviation; the factor by which this deviation is wrong in a scene has a prior distribution: the root of a
scaled inverse chi-square around one (Gelman et al., Bayesian Data Analysis, 2013, section 2.6), and in a few scenes,
with an RPC of another image or a gross error, anything above one. The disagreement of the RPCs is evidence of the
factor, and the height is distributed as a mixture of normal distributions over it. Ground outside the heights that the
RPCs were made for is evidence of a gross error, and bounds its size on both sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.records import PointingFigures, ViewPair
from ..geometry.frames import EnuFrame
from ..scene import View, middle_of
from .graph import components
from .parameters import PLANNING, PlanningParameters, PromiseParameters
from .promises import promise_of, published_vertical
from .rpc_heights import OutsideRpcHeights, outside_rpc_heights


@dataclass(frozen=True)
class HeightUncertainty:
    """Standard deviations of the absolute height, m: ``promised_m`` by the vendors' promise alone, ``deviation_m`` with
    what the RPCs' disagreement and ground ``outside`` their heights add to it: 95 % of the errors lie within two of
    these.

    ``disagreement`` is how large the observed disagreement is, as a share of what the promised errors would cause (root
    mean square of ``freedom`` independent parts: one for a pair, 2 n - 3 for n images).
    """

    promised_m: float
    disagreement: float
    freedom: int
    deviation_m: float
    outside: Optional[OutsideRpcHeights] = None


def height_uncertainty(
    views: Sequence[View], figures: PointingFigures, parameters: PlanningParameters = PLANNING
) -> HeightUncertainty:
    """From the RPCs of views, and their relative pointing without ground control.

    Where ties do not connect all views, it is that of the group whose height is least certain.
    """
    tied = [pair.pair for pair in figures.pairs if pair.count]
    names = [view.name for view in views]
    groups = [group for group in components(names, tied) if len(group) > 1] or [names]
    found = [_of_group([v for v in views if v.name in group], figures.shifts_px, parameters) for group in groups]
    promised_m = max(height for height, _, _ in found)
    square, freedom = sum(each for _, each, _ in found), sum(each for _, _, each in found)
    outside = outside_rpc_heights(views, figures, parameters.rpc_heights)
    error = (0.0, math.inf) if outside is None else (outside.least_m / promised_m, outside.most_m / promised_m)
    deviation_m = promised_m * _stated(square, freedom, error, parameters.promises)
    return HeightUncertainty(promised_m, math.sqrt(square / freedom), freedom, deviation_m, outside)


def _stated(square: float, freedom: int, error: Tuple[float, float], parameters: PromiseParameters) -> float:
    """Half of what holds 95 % of the errors of a height whose promised deviation is one, given the sum of squares of
    so many independent disagreements, and the least and most that the error can be, in promised deviations.

    A least error that is not zero is a gross one: ground does not lie outside of its RPCs' heights where they are as
    promised.
    """
    from scipy.special import erfc

    factors = np.geomspace(0.05, 20.0 * parameters.gross_most, 1200)
    chi = factors**-parameters.freedom * np.exp(-parameters.freedom / (2.0 * factors**2))
    gross = ((factors >= 1.0) & (factors <= parameters.gross_most)).astype(np.float64)
    share = 1.0 if error[0] > 0 else parameters.gross_share
    prior = (1.0 - share) * chi / chi.sum() + share * gross / gross.sum()
    # The logarithm, because a gross disagreement is all but impossible with most factors.
    evidence = -freedom * np.log(factors) - square / (2.0 * factors**2)
    posterior = prior * np.exp(evidence - evidence[prior > 0].max())
    low, high = least, most = error[0], min(error[1], 10.0 * float(factors[-1]))

    def beyond(end: float) -> FloatArray:
        """How probable a greater error is with each factor: complements, because errors may be far out."""
        probable: FloatArray = erfc(end / (math.sqrt(2.0) * factors))
        return probable

    beyond_least = beyond(least)

    def between(most: float) -> float:
        return float(posterior @ (beyond_least - beyond(most)))

    every = between(most)
    while high - low > 1e-6 * high:
        middle = (low + high) / 2.0
        low, high = (middle, high) if between(middle) < 0.95 * every else (low, middle)
    return high / 2.0


def height_le90_m(figures: PointingFigures, parameters: PlanningParameters = PLANNING) -> Optional[float]:
    """The LE90 of the absolute height, m: how reports and warnings give its uncertainty, because vendors promise it so.

    It is 1.645 standard deviations (NIMA STDI-0002), of which ``height_uncertainty_m`` has two. None with ground
    control.
    """
    stated = figures.height_uncertainty_m
    return None if stated is None else parameters.promises.le90 * stated / 2.0


def usual_height_deviation(
    pairs: Sequence[ViewPair], figures: PointingFigures, gsd_m: float, parameters: PlanningParameters = PLANNING
) -> float:
    """The standard deviation of the absolute height of a scene as scenes usually are, m: smaller than what vendors
    promise, and nothing to rely on.

    Along the parallax, where an error looks like a height, RPCs usually disagree by ``usual_px`` or by as much as they
    do across it. A registration takes it to tell one vertical datum from another.
    """
    seen = [pair.before_px for pair in figures.pairs if pair.count]
    deviation = math.sqrt((parameters.usual_px**2 + sum(each**2 for each in seen)) / (1 + len(seen)))
    return deviation * gsd_m / max(pair.base_to_height for pair in pairs)


def _of_group(
    views: Sequence[View], shifts_px: Dict[str, Tuple[float, float]], parameters: PlanningParameters
) -> Tuple[float, float, int]:
    """The deviation of the height by promise, m; the sum of squares of the disagreement, in promised standard
    deviations; and of how many independent parts it is."""
    place = np.array([*middle_of(views), sum(view.rpc.height_off for view in views) / len(views)])
    frame = EnuFrame(*map(float, place))
    moved = frame.to_geodetic(np.eye(3))
    promises = [promise_of(view, parameters.promises) for view in views]
    deviations = [promise.horizontal_m / parameters.promises.ce90 for promise in promises]
    jacobians, across, errors = [], [], []
    for view, deviation in zip(views, deviations):
        jacobian = (view.project(moved) - view.project(place)).T  # (2, 3) px for each metre east, north and up
        # How far errors of one promised deviation on the ground move pixels in the image; and the shift in these units.
        scaled = jacobian[:, :2] * deviation
        jacobians.append(jacobian)
        across.append(scaled)
        errors.append(np.linalg.solve(scaled, np.column_stack([shifts_px.get(view.name, (0.0, 0.0)), jacobian])))
    whitened: FloatArray = np.concatenate(errors)
    shifts, design = whitened[:, 0], whitened[:, 1:]
    left = shifts - design @ np.linalg.lstsq(design, shifts, rcond=None)[0]
    published = published_vertical(promises)
    if published is not None:
        return published / parameters.promises.le90, float(left @ left), len(left) - 3
    # The smallest corrections are used, in px: the rest of the errors moves the ground by J^+ e.
    height: List[FloatArray] = np.split(np.linalg.pinv(np.concatenate(jacobians))[2], len(views))
    variance = sum(float(((row @ each) ** 2).sum()) for row, each in zip(height, across))
    return math.sqrt(variance), float(left @ left), len(left) - 3
