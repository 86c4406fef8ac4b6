"""Whether the ground that the tie points show lies at the heights that the RPCs were made for.

An RPC that is wrong along the parallax moves the ground up or down and leaves no other trace in the images. Vendors
choose an RPC's heights so that they hold the terrain of the image, so ground outside them is evidence of such an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

from ..contracts.arrays import Altitudes
from ..contracts.records import PointingFigures
from ..scene import View
from .parameters import PLANNING, RpcHeightParameters


@dataclass(frozen=True)
class OutsideRpcHeights:
    """Ground outside the heights of all RPCs, m above the ellipsoid: ``ground`` and ``rpc`` are the two ranges.

    The heights found are off by ``least_m`` to ``most_m``, if the true ground lies at the RPCs' heights, or no farther
    outside than that of good RPCs.
    """

    ground: Altitudes
    rpc: Altitudes
    least_m: float
    most_m: float


def outside_rpc_heights(
    views: Sequence[View], figures: PointingFigures, parameters: RpcHeightParameters = PLANNING.rpc_heights
) -> Optional[OutsideRpcHeights]:
    """How far the ground of ``figures`` lies outside the heights that the RPCs of views were made for.

    None where it does not, and where nothing is known: no ground is recorded, an RPC has its vendor's default
    heights, or the ground has more relief than they allow.
    """
    if figures.ground_m is None or any(_default(view, parameters) for view in views):
        return None
    lows, highs = zip(*(view.rpc.height_range for view in views))
    rpc, (low, middle, high) = (min(lows), max(highs)), figures.ground_m
    # The middle is compared with the upper end: above it, there may be roofs that a terrain model does not have.
    over, under = middle - rpc[1] - parameters.room_m, rpc[0] - parameters.room_m - low
    if (over > 0) == (under > 0):
        return None
    least, most = (over, -under) if over > 0 else (under, -over)
    return OutsideRpcHeights((low, high), rpc, least, most)


def _default(view: View, parameters: RpcHeightParameters) -> bool:
    low, high = parameters.default_scale_m
    return low <= abs(view.rpc.height_scale) <= high
