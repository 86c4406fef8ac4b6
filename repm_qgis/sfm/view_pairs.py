"""Which pairs of views to match."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Dict, List, Sequence

from ..errors import EmptyResultError
from ..mvs.pairing import convergence
from ..scene import Scene

_BEST_RATIO = 0.35
_LEAST_RATIO = 0.05
_ALL_UP_TO = 3      # views: up to so many, all pairs
_MOST_PER_VIEW = 3


@dataclass(frozen=True)
class ViewPair:
    """Two views with their convergence angle (degrees), base-to-height ratio, and the tiles that both see."""

    first: str
    second: str
    angle_deg: float
    base_to_height: float
    tiles: int


def choose_pairs(scene: Scene) -> List[ViewPair]:
    """Pairs that share tiles and are neither too narrow to tell heights nor too wide to match, best first.

    With more than three views, each keeps its three best pairs, and as many more as it takes to connect all views.
    Raises EmptyResultError with the angles where no pair will do.
    """
    altitude = sum(scene.altitudes) / 2
    candidates: List[ViewPair] = []
    for first, second in combinations(scene.views, 2):
        shared = sum(first.name in tile.views and second.name in tile.views for tile in scene.tiles)
        if shared:
            angle, ratio = convergence(first, second, scene.frame.lon, scene.frame.lat, altitude)
            candidates.append(ViewPair(first.name, second.name, angle, ratio, shared))
    usable = sorted((c for c in candidates if c.base_to_height >= _LEAST_RATIO), key=_badness)
    if not usable:
        angles = ", ".join(f"{c.first} and {c.second}: {c.angle_deg:.1f} degrees" for c in candidates)
        angles = angles or "they share no tile"
        raise EmptyResultError(f"No pair of images can tell heights ({angles}): choose images that look at the ground "
                               "from directions at least 3 degrees apart.")
    return usable if len(scene.views) <= _ALL_UP_TO else _few(usable, [view.name for view in scene.views])


def _badness(pair: ViewPair) -> float:
    return abs(math.log(pair.base_to_height / _BEST_RATIO))


def _few(ranked: Sequence[ViewPair], names: Sequence[str]) -> List[ViewPair]:
    group: Dict[str, str] = {name: name for name in names}

    def root(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    count = dict.fromkeys(names, 0)
    kept = []
    for pair in ranked:
        joins = root(pair.first) != root(pair.second)
        if joins or min(count[pair.first], count[pair.second]) < _MOST_PER_VIEW:
            kept.append(pair)
            group[root(pair.first)] = root(pair.second)
            count[pair.first] += 1
            count[pair.second] += 1
    return kept
