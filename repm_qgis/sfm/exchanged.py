"""Whether two images have each other's RPC.

Seen from far away, two images that are exchanged show the same ground upside down: their ties fit ground points just as
well, and nothing but the small things that differ between two lines of sight tells (scale, rotation, the change of both
with height). So the ties of each pair are fitted twice, with the RPCs as they are and exchanged, with shifts alone:
what sound RPCs need no more than. An affine correction would take these small things away.

The better fit counts by Schwarz's information criterion; both models have the same number of parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Callable, Iterator, Sequence, Tuple

import numpy as np

from ..errors import RpcInvalidError
from ..scene import View
from .adjustment import Track, adjust
from .parameters import POINTING, PointingParameters


@dataclass(frozen=True)
class Exchange:
    """Two views with the median residuals of their ties, px, with the RPCs as they are and exchanged, and by how much
    the exchange is better: the difference of the information criteria, negative where it is worse."""

    pair: Tuple[str, str]
    own_px: float
    exchanged_px: float
    evidence: float


def exchanges(
    views: Sequence[View], tracks: Sequence[Track], altitude: float, parameters: PointingParameters = POINTING
) -> Iterator[Exchange]:
    """What an exchange of the RPCs of two views would change, for all two that share enough ties.

    ``altitude`` is where ground points start from, metres above the ellipsoid.
    """
    p = parameters.exchange
    for pair in combinations(views, 2):
        names = pair[0].name, pair[1].name
        shared = [track for track in tracks if all(name in track.pixels for name in names)]
        if len(shared) < p.least_ties:
            continue
        # Evenly spread over the list, which goes through the images part by part.
        some = [shared[k] for k in np.linspace(0, len(shared) - 1, min(len(shared), p.most_ties)).astype(int)]
        ties = [Track({name: track.pixels[name] for name in names}) for track in some]
        crossed = [replace(view, rpc=other.rpc) for view, other in zip(pair, pair[::-1])]
        own, other = (adjust(each, ties, altitude, "shift", (), parameters).residual_px for each in (pair, crossed))
        limit = p.limit * min(float(np.median(own)), float(np.median(other)))
        fits = [len(ties) * np.log(np.mean(np.minimum(each, limit) ** 2) + 1e-12) for each in (own, other)]
        yield Exchange(names, float(np.median(own)), float(np.median(other)), float(fits[0] - fits[1]))


def require_own_rpcs(
    views: Sequence[View],
    tracks: Sequence[Track],
    altitude: float,
    warn: Callable[[str], None],
    parameters: PointingParameters = POINTING,
) -> None:
    """Warn where the ties say that two images have each other's RPC; raise RpcInvalidError where they leave no doubt.

    Views, tracks and altitude are those of :func:`exchanges`.
    """
    p = parameters.exchange
    for each in sorted(exchanges(views, tracks, altitude, parameters), key=lambda each: -each.evidence):
        if each.evidence <= p.least_evidence:
            return
        first, second = each.pair
        found = (
            f"their tie points fit to {each.own_px:.2f} px with their own RPCs, and to {each.exchanged_px:.2f} px with "
            "those exchanged (medians, with shifts alone)"
        )
        remedy = "give each image its own RPC (the file beside it, or RPCS)"
        if each.evidence > p.sure_evidence and each.exchanged_px <= p.sure_px:
            raise RpcInvalidError(
                f"The images {first} and {second} have each other's RPC: {found}. Heights would be upside down: "
                f"{remedy}."
            )
        warn(
            f"The images {first} and {second} may have each other's RPC: {found}. Heights may be upside down: compare "
            f"them with a DEM, or {remedy}."
        )
