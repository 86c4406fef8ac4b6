"""Which pairs of views to match."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from itertools import combinations
from statistics import median
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import Bounds, FloatArray, Mask
from ..contracts.errors import EmptyResultError
from ..contracts.records import ViewPair
from ..geometry.footprints import footprint, geometry_of
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic
from ..geometry.sun import shadow_shift, sun_angle, sun_position
from ..geometry.tiles import enclosing
from ..imagery.parameters import SAMPLING
from ..runtime.progress import listed
from ..scene import Scene, View
from ..stereo.pairing import convergence
from .graph import components
from .parameters import PLANNING, PairParameters

_YEAR = 365.25
Seen = Mapping[str, Mask]
"""For each view's name, which of the places it sees."""


def choose_pairs(scene: Scene, parameters: PairParameters = PLANNING.pairs) -> List[ViewPair]:
    """Pairs that share tiles and are neither too narrow to measure heights nor too wide to match, best first.

    Of up to three views, these are all pairs that can measure heights. Of more views, each one keeps its two best
    good pairs (:func:`pair_cost`), and further pairs are added, good ones first, until all views are connected. Where
    many pairs cover the same ground, those that neither of their views needs are removed; where two views see ground
    that no pair covers, a pair is added. Raises EmptyResultError with the angles where no pair is usable.
    """
    candidates, seen = _candidates(scene, parameters)
    return best_pairs(candidates, seen, [view.name for view in scene.views], parameters)


def best_pairs(
    candidates: Sequence[ViewPair], seen: Seen, names: Sequence[str], parameters: PairParameters = PLANNING.pairs
) -> List[ViewPair]:
    """Those of the pairs of the named views that are matched: see :func:`choose_pairs` and :func:`places_seen`."""
    usable = [c for c in candidates if c.base_to_height >= parameters.least_base_to_height]
    if not usable:
        widest = sorted(candidates, key=lambda pair: -pair.angle_deg)
        angles = listed([f"{c.first} and {c.second}: {c.angle_deg:.1f} degrees" for c in widest])
        why = f"No pair of images can measure heights ({angles or 'they share no tile'})"
        raise EmptyResultError(f"{why}: choose images with lines of sight at least 3 degrees apart.")
    if len(names) <= parameters.all_up_to:
        return sorted(usable, key=lambda pair: abs(math.log(pair.base_to_height / parameters.best_base_to_height)))
    unknown = usual_change(usable, parameters)
    finest = min((pair.gsd_m for pair in usable if pair.gsd_m), default=0.0)

    def cost(pair: ViewPair) -> float:
        return pair_cost(pair, unknown, parameters, finest)

    ranked = sorted(usable, key=cost)
    few = _few(ranked, names, parameters)
    return sorted([*few, *_uncovered(few, ranked, seen, parameters)], key=cost)


def pair_cost(
    pair: ViewPair, unknown: float = 0.0, parameters: PairParameters = PLANNING.pairs, finest: float = 0.0
) -> float:
    """How unsuitable a pair is: 0 is best; half or twice the best convergence angle alone costs ln(2) = 0.69.

    The sum of four terms:

    * convergence: abs(ln(angle / 20 degrees)); semi-global matching is best at 15 to 25 degrees;
    * overlap: -ln(part of the area that both see), so that half of it costs as much as twice the angle;
    * time: :func:`change_cost`, or ``unknown`` where a time is not known;
    * ground sampling distance: ln of how many times coarser the pair is matched than the ``finest`` one (m; 0: not
      known), apart from what counts as equal: an error in px is that many times as large in metres.

    References
    ----------
    Qin, "A critical analysis of satellite stereo pairs for digital surface model generation and a matching quality
    prediction model", ISPRS Journal of Photogrammetry and Remote Sensing 154 (2019): of over 1000 pairs of one place,
    those with angles of 15 to 25 degrees still differ much in accuracy; the difference of the suns decides.
    """
    change = change_cost(pair, parameters)
    overlap = math.log(max(pair.share, parameters.least_share))
    angle = abs(math.log(pair.angle_deg / parameters.best_deg))
    coarse = math.log(max(pair.gsd_m / (SAMPLING.alike * finest), 1.0)) if pair.gsd_m and finest else 0.0
    return angle - overlap + coarse + (unknown if change is None else change)


def is_good(pair: ViewPair, parameters: PairParameters = PLANNING.pairs) -> bool:
    """Whether a pair is neither too narrow to measure heights well nor too wide to match well."""
    fair = parameters.narrow <= pair.base_to_height <= parameters.wide
    return fair and pair.angle_deg >= parameters.least_good_deg


def change_cost(pair: ViewPair, parameters: PairParameters = PLANNING.pairs) -> Optional[float]:
    """The cost of what changed between two images: the ground with time and season, the shadows with the sun.

    A half for each power of ten of 1 + days (same pass 0, ten days 0.52, a year 1.28), up to a half for the opposite
    season, and one for each ten degrees between the two suns. None where the time is not known.
    """
    if pair.days is None:
        return None
    season = (1.0 - math.cos(2.0 * math.pi * pair.days / _YEAR)) / 2.0
    time = parameters.decade_cost * math.log10(1.0 + pair.days) + parameters.season_cost * season
    return time + (pair.sun_deg or 0.0) / parameters.sun_cost_deg


def usual_change(pairs: Sequence[ViewPair], parameters: PairParameters = PLANNING.pairs) -> float:
    """The median change cost of the pairs whose times are known: a neutral cost for the others."""
    known = [cost for cost in (change_cost(pair, parameters) for pair in pairs) if cost is not None]
    return median(known) if known else 0.0


def days_off_season(days: float) -> float:
    """Days between two times of the year, 0 to 183."""
    rest = days % _YEAR
    return min(rest, _YEAR - rest)


def sun_over(scene: Scene, view: View) -> Optional[Tuple[float, float]]:
    """The sun's azimuth and elevation (degrees) over the scene's middle as a view was taken; None if unknown."""
    return sun_at(view, scene.frame.lon, scene.frame.lat)


def sun_at(view: View, lon: float, lat: float) -> Optional[Tuple[float, float]]:
    """The sun's azimuth and elevation (degrees) over a place as a view was taken; None if the time is unknown."""
    return sun_position(view.time, lon, lat) if view.time is not None else None


def places_seen(
    outlines: Mapping[str, FloatArray], bounds: Bounds, parameters: PairParameters = PLANNING.pairs
) -> Dict[str, Mask]:
    """Which of the places of a lattice over bounds lie within each view's outline, (N, 2) x and y in the same CRS."""
    side = parameters.places
    x, y = (low + (np.arange(side) + 0.5) * (high - low) / side for low, high in zip(bounds[:2], bounds[2:]))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return {name: _inside(outline, places) for name, outline in outlines.items()}


def _inside(outline: FloatArray, places: FloatArray) -> Mask:
    """(N,) which places lie within a polygon: a line from there to the right crosses it an odd number of times."""
    inside: Mask = np.zeros(len(places), dtype=bool)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0)):
        between = (y0 > places[:, 1]) != (y1 > places[:, 1])
        if between.any():
            inside ^= between & (places[:, 0] < x0 + (places[:, 1] - y0) * (x1 - x0) / (y1 - y0))
    return inside


def _candidates(scene: Scene, parameters: PairParameters) -> Tuple[List[ViewPair], Dict[str, Mask]]:
    """All pairs that share a tile, and which places of the tiles' ground each view sees."""
    altitude = sum(scene.altitudes) / 2
    places = {view.name: footprint(view.localise, view.size, altitude) for view in scene.views}
    outlines = {name: projected_from_geodetic(scene.crs, place) for name, place in places.items()}
    shapes = {name: geometry_of(outline) for name, outline in outlines.items()}
    area = ogr.CreateGeometryFromWkt(scene.area) if scene.area else None
    found: List[ViewPair] = []
    few = len(scene.views) <= parameters.all_up_to
    for first, second in combinations(scene.views, 2):
        shared = sum(first.name in tile.views and second.name in tile.views for tile in scene.tiles)
        if shared and (few or shared_part(shapes[first.name], shapes[second.name]) >= parameters.least_overlap):
            share = shared_part(shapes[first.name], shapes[second.name], area)
            lon, lat = _place_of(scene, shapes[first.name], shapes[second.name])
            found.append(pair_at(first, second, (lon, lat, altitude), shared, share))
    return found, places_seen(outlines, enclosing([tile.bounds for tile in scene.tiles]), parameters)


def _place_of(scene: Scene, first: ogr.Geometry, second: ogr.Geometry) -> Tuple[float, float]:
    """Longitude and latitude where two views' lines of sight are compared: the scene's middle or, where these do not
    show it, as frames of a block do, the middle of what they share. An RPC is only valid around its image."""
    x, y = projected_from_geodetic(scene.crs, np.array([scene.frame.lon, scene.frame.lat]))
    middle = ogr.Geometry(ogr.wkbPoint)
    middle.AddPoint_2D(float(x), float(y))
    common = first.Intersection(second)
    if common is None or common.GetArea() <= 0 or common.Contains(middle):
        return scene.frame.lon, scene.frame.lat
    centre = common.Centroid()
    lon, lat = geodetic_from_projected(scene.crs, np.array([centre.GetX(), centre.GetY()]))
    return float(lon), float(lat)


def pair_at(first: View, second: View, place: Tuple[float, float, float], tiles: int, share: float) -> ViewPair:
    """Two views as they look at a place (longitude, latitude, height): angles, and how far time and sun differ."""
    lon, lat, height = place
    angle, base_to_height = convergence(first, second, lon, lat, height)
    days, sun, shadow = _apart(first, second, lon, lat)
    return ViewPair(
        first=first.name,
        second=second.name,
        angle_deg=angle,
        base_to_height=base_to_height,
        tiles=tiles,
        share=share,
        days=days,
        sun_deg=sun,
        shadow=shadow,
        gsd_m=max(first.gsd_m, second.gsd_m),
    )


def shared_part(first: ogr.Geometry, second: ogr.Geometry, area: Optional[ogr.Geometry] = None) -> float:
    """The part of an area (of the smaller outline where there is none) that lies within two outlines."""
    common = first.Intersection(second)
    if area is not None and common is not None:
        common = common.Intersection(area)
    whole = area.GetArea() if area is not None else min(first.GetArea(), second.GetArea())
    return min(1.0, common.GetArea() / whole) if common is not None and whole > 0 else 0.0


def _apart(
    first: View, second: View, lon: float, lat: float
) -> Tuple[Optional[float], Optional[float], Optional[float]]:
    """Days, angle between the suns and shadow shift; None where a time is unknown or the sun had set."""
    if first.time is None or second.time is None:
        return None, None, None
    days = abs((second.time - first.time).total_seconds()) / 86400.0
    one, two = (sun_position(time, lon, lat) for time in (first.time, second.time))
    if min(one[1], two[1]) <= 0:
        return days, None, None
    return days, sun_angle(one, two), shadow_shift(one, two)


def _few(ranked: Sequence[ViewPair], names: Sequence[str], parameters: PairParameters) -> List[ViewPair]:
    """Of pairs, best first, the best good ones of each view, and those that connect all views."""
    count = dict.fromkeys(names, 0)
    kept: List[ViewPair] = []

    def keep(pair: ViewPair) -> None:
        kept.append(pair)
        count[pair.first] += 1
        count[pair.second] += 1

    good = [pair for pair in ranked if is_good(pair, parameters)]
    for pair in good:
        counts = count[pair.first], count[pair.second]
        if min(counts) < parameters.per_view and max(counts) < parameters.most_per_view:
            keep(pair)
    for pair in (*good, *ranked):
        if not any(pair.first in group and pair.second in group for group in _groups(names, kept)):
            keep(pair)
    return _without_surplus(kept, names, parameters)


def _without_surplus(kept: List[ViewPair], names: Sequence[str], parameters: PairParameters) -> List[ViewPair]:
    """Where enough pairs cover the ground, those that neither of their views needs are removed, worst first."""
    count = Counter(name for pair in kept for name in pair.names)
    connected = len(_groups(names, kept))
    for pair in reversed(kept):
        rest = [other for other in kept if other is not pair]
        if sum(other.share for other in rest) < parameters.enough:
            break
        if min(count[pair.first], count[pair.second]) > parameters.per_view and len(_groups(names, rest)) == connected:
            kept = rest
            count.subtract(pair.names)
    return kept


def _uncovered(
    kept: Sequence[ViewPair], ranked: Sequence[ViewPair], seen: Seen, parameters: PairParameters
) -> List[ViewPair]:
    """Further good pairs, until little ground is left that good pairs see and no kept pair does. Of the pairs that
    cover at least half as much of it as any other, the best comes first."""

    def covered(pairs: Sequence[ViewPair]) -> Mask:
        ground: Mask = np.any([seen[pair.first] & seen[pair.second] for pair in pairs], axis=0)
        return ground

    good = [pair for pair in ranked if is_good(pair, parameters)]
    if not good:
        return []
    whole, added = covered(good), []
    rest, least = whole & ~covered(kept), parameters.uncovered * int(whole.sum())
    while int(rest.sum()) > least:
        gains = [int((rest & covered([pair])).sum()) for pair in good]
        if max(gains) <= least:
            break
        best = next(pair for pair, gain in zip(good, gains) if gain >= max(gains) / 2)
        added.append(replace(best, tied=False))  # under another sun it may have too few ties, and views have others
        rest &= ~covered([best])
    return added


def _groups(names: Sequence[str], pairs: Sequence[ViewPair]) -> List[List[str]]:
    return components(names, [pair.names for pair in pairs])
