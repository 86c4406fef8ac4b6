"""What vendors promise of the position without ground control: for one image, and for the ground that several show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple, Optional, Sequence

from ..imagery.sensors import sensor_named
from ..scene import View, middle_of
from ..stereo.pairing import convergence
from .parameters import PLANNING, PlanningParameters, PromiseParameters


@dataclass(frozen=True)
class Promise:
    """How far positions are off at most, nine times in ten: on the ground (CE90, m), in height (LE90, m); who says so.

    ``vertical_m`` is None for an image whose vendor publishes none: an image alone has no height.
    """

    horizontal_m: float
    vertical_m: Optional[float]
    source: str


class Deviations(NamedTuple):
    """Standard deviations of a position, m: in each horizontal direction, and of the height."""

    horizontal_m: float
    vertical_m: float


def promise_of(view: View, parameters: PromiseParameters = PLANNING.promises) -> Promise:
    """The promise for one image: the RPC's own figure, else that of its satellite, else the one for unknown ones."""
    sensor = sensor_named(view.sensor)
    vertical = sensor.le90_m if sensor else None
    if view.rpc.accuracy_m is not None:
        return Promise(parameters.ce90 * view.rpc.accuracy_m, vertical, "the RPC's ERR_BIAS and ERR_RAND")
    if sensor and sensor.ce90_m is not None:
        return Promise(sensor.ce90_m, vertical, f"{sensor.name}: {sensor.source}")
    unknown = max(parameters.unknown_m, parameters.unknown_px * view.gsd_m)
    return Promise(unknown, vertical, "assumed, because no promise of its vendor is known")


def published_vertical(promises: Sequence[Promise]) -> Optional[float]:
    """The LE90 (m) of what several images show: the largest, where the vendors of all publish one; None elsewhere."""
    published = [promise.vertical_m for promise in promises if promise.vertical_m is not None]
    return max(published) if len(published) == len(promises) else None


def promised(views: Sequence[View], parameters: PlanningParameters = PLANNING) -> Deviations:
    """How well the vendors promise the ground that at least one view shows.

    Horizontally it is the root mean square of the views': those of one pass are wrong together, so that more of them do
    not make it better. Vertically it is the vendors' LE90 (the largest) where all of them publish one. Otherwise it
    follows from the widest pair that would be matched: independent errors of two lines of sight move their intersection
    up by sqrt(2) / (B/H) times the horizontal error, and errors of one pass by less.
    """
    promises = [promise_of(view, parameters.promises) for view in views]
    square = sum(promise.horizontal_m**2 for promise in promises) / len(promises)
    horizontal = math.sqrt(square) / parameters.promises.ce90
    published = published_vertical(promises)
    if published is not None:
        return Deviations(horizontal, published / parameters.promises.le90)
    (lon, lat), height = middle_of(views), sum(view.rpc.height_off for view in views) / len(views)
    ratios = [convergence(first, second, lon, lat, height)[1] for first, second in combinations(views, 2)]
    pairs = parameters.pairs
    ratio = max([pairs.least_base_to_height, *(found for found in ratios if found <= pairs.wide)])
    return Deviations(horizontal, math.sqrt(2.0) * horizontal / ratio)
