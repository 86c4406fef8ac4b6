"""Whether two images have each other's RPC.

Seen from far away, two images that are exchanged show the same ground upside down: their ties fit ground points just as
well, and only small differences between two lines of sight reveal the exchange (scale, rotation, the change of both
with height). So the ties of each pair are fitted twice, with the RPCs as they are and exchanged, and with shifts only:
sound RPCs need no more. An affine correction would absorb these small differences.

Where two images alone leave a doubt, as forward and backward ones of a satellite do, the ties that each has with all
other images are fitted with them: a third line of sight gives more evidence.

The fits are compared by Schwarz's information criterion; both models have the same number of parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Callable, Dict, Iterator, List, Sequence, Set, Tuple

import numpy as np

from ..contracts.errors import RpcInvalidError
from ..contracts.findings import Finding
from ..scene import View
from ..stereo.pairing import convergence
from ..ties.tracks import Track
from .adjustment import adjust
from .parameters import POINTING, PointingParameters


@dataclass(frozen=True)
class Exchange:
    """Two views with the median residuals of their ties, px, with the RPCs as they are and exchanged, and by how much
    the exchange is better: the difference of the information criteria, negative where it is worse. The ties are those
    of both or, where these leave a doubt, all that either of the two has."""

    pair: Tuple[str, str]
    own_px: float
    exchanged_px: float
    evidence: float


def exchanges(
    views: Sequence[View], tracks: Sequence[Track], altitude: float, parameters: PointingParameters = POINTING
) -> Iterator[Exchange]:
    """What an exchange of the RPCs of two views would change: for all two that share enough ties, and for those whose
    ties with other views fit badly. Of many views, these alone: an exchange would spoil the fit of their neighbours.

    ``altitude`` is where ground points start from, metres above the ellipsoid.
    """
    p, bad = parameters.exchange, _badly_fitting(views, tracks, altitude, parameters)
    of: Dict[str, Set[int]] = {view.name: set() for view in views}
    for number, track in enumerate(tracks):
        for name in track.pixels:
            of[name].add(number)
    for pair in combinations(views, 2):
        names = pair[0].name, pair[1].name
        both = sorted(of[names[0]] & of[names[1]])
        found = None
        if both and _base_to_height(pair, tracks[both[len(both) // 2]], altitude) < p.least_base_to_height:
            continue  # neighbouring frames of one pass
        if len(views) > p.most_views and bad.isdisjoint(names):
            continue
        if len(both) >= p.least_ties:
            ties = [Track({name: tracks[k].pixels[name] for name in names}) for k in both]
            found = _exchange(pair, pair, ties, altitude, parameters)
        elif not bad.issuperset(names):
            continue
        if len(views) > 2 and (found is None or found.evidence > -p.sure_evidence):
            either = [tracks[k] for k in sorted(of[names[0]] | of[names[1]])]
            found = _exchange(pair, views, either, altitude, parameters)
        if found is not None:
            yield found


def _base_to_height(pair: Tuple[View, View], track: Track, altitude: float) -> float:
    """Of two views, where both see a track."""
    lon, lat, _ = pair[0].localise(track.pixels[pair[0].name], altitude)
    return convergence(pair[0], pair[1], float(lon), float(lat), altitude)[1]


def _exchange(
    pair: Tuple[View, View],
    views: Sequence[View],
    tracks: Sequence[Track],
    altitude: float,
    parameters: PointingParameters,
) -> Exchange:
    """What the exchange of a pair's RPCs changes in the fit of some ties of these views, to which the pair belongs."""
    p, names = parameters.exchange, (pair[0].name, pair[1].name)
    ties = _some(tracks, p.most_ties)
    seen = {name for track in ties for name in track.pixels}
    rpcs = dict(zip(names, (pair[1].rpc, pair[0].rpc)))
    sound = [view for view in views if view.name in seen]
    crossed = [replace(view, rpc=rpcs.get(view.name, view.rpc)) for view in sound]
    own, other = (adjust(each, ties, altitude, "shift", (), parameters).residual_px for each in (sound, crossed))
    limit = p.limit * min(float(np.median(own)), float(np.median(other)))
    fits = [len(ties) * np.log(np.mean(np.minimum(each, limit) ** 2) + 1e-12) for each in (own, other)]
    return Exchange(names, float(np.median(own)), float(np.median(other)), float(fits[0] - fits[1]))


def _some(tracks: Sequence[Track], most: int) -> List[Track]:
    """So many tracks at most, evenly spread over the list, which goes through the images part by part."""
    return [tracks[k] for k in np.linspace(0, len(tracks) - 1, min(len(tracks), most)).astype(int)]


def _badly_fitting(
    views: Sequence[View], tracks: Sequence[Track], altitude: float, parameters: PointingParameters
) -> Set[str]:
    """The names of the views whose ties do not fit as those of sound RPCs do, where all are fitted together."""
    p = parameters.exchange
    if len(views) < 3:
        return set()
    ties = _some(tracks, p.view_ties * len(views))
    residuals = adjust(views, ties, altitude, "shift", (), parameters).residual_px
    of_views = {view.name: [px for track, px in zip(ties, residuals) if view.name in track.pixels] for view in views}
    return {name for name, found in of_views.items() if found and np.median(found) > p.sure_px}


def require_own_rpcs(
    views: Sequence[View],
    tracks: Sequence[Track],
    altitude: float,
    warn: Callable[[Finding], None],
    parameters: PointingParameters = POINTING,
    *,
    info: Callable[[str], None] = lambda text: None,
) -> None:
    """Warn where the ties suggest that two images have each other's RPC; raise RpcInvalidError where they leave no
    doubt, and give information where they do not decide it.

    Views, tracks and altitude are those of :func:`exchanges`.
    """
    p = parameters.exchange
    for each in sorted(exchanges(views, tracks, altitude, parameters), key=lambda each: -each.evidence):
        if each.evidence < -p.least_evidence:
            return
        first, second = each.pair
        found = (
            f"their tie points fit to {each.own_px:.2f} px with their own RPCs, and to {each.exchanged_px:.2f} px with "
            "those exchanged (medians, with shifts alone)"
        )
        remedy = "give each image its own RPC (the file beside it, or RPCS)"
        if each.evidence <= p.least_evidence:
            info(
                f"The images do not show whether {first} and {second} have each other's RPC, which would turn the "
                f"surface upside down: {found}. Compare the DSM with a DEM or a reference."
            )
            continue
        if each.evidence > p.sure_evidence and each.exchanged_px <= p.sure_px:
            raise RpcInvalidError(
                f"The images {first} and {second} have each other's RPC: {found}. Heights would be upside down: "
                f"{remedy}."
            )
        text = f"The images {first} and {second} may have each other's RPC: {found}. Heights may be upside down"
        warn(Finding("rpcs-exchanged", f"{text}: compare them with a DEM, or {remedy}.", "doubt"))
