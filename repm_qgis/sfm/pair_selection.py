"""Which pairs of views to match."""

from __future__ import annotations

import math
from itertools import combinations
from statistics import median
from typing import Dict, List, Optional, Sequence, Tuple

from osgeo import ogr

from ..errors import EmptyResultError
from ..geometry.footprints import footprint, geometry_of
from ..geometry.frames import projected_from_geodetic
from ..geometry.sun import shadow_shift, sun_angle, sun_position
from ..records import ViewPair
from ..scene import Scene, View
from ..stereo.pairing import convergence

NARROW, WIDE = 0.1, 0.9
"""Base-to-height ratios between which a pair is good: 5.7 to 48 degrees about the vertical."""

_BEST_RATIO, _BEST_DEG = 0.35, 20.0  # the same about the vertical
_LEAST_RATIO = 0.05
_LEAST_GOOD_DEG = 5.0  # slanting looks have a fair ratio at angles too small to tell heights well
_ALL_UP_TO = 3  # views: up to so many, all pairs
_WANTED = 3  # pairs a view
_BUSIEST = 5  # pairs a view that is a good partner to many; more only where it takes that to connect all views

_YEAR = 365.25
_DECADE_COST, _SEASON_COST, _SUN_COST_DEG = 0.25, 0.5, 30.0
_LEAST_SHARE = 0.01


def choose_pairs(scene: Scene) -> List[ViewPair]:
    """Pairs that share tiles and are neither too narrow to tell heights nor too wide to match, best first.

    Up to three views: all that can tell heights. Of more, each view keeps its three best good pairs (:func:`badness`),
    and as many more, good ones first, as it takes to connect all views. Raises EmptyResultError with the angles where
    no pair will do.
    """
    candidates = _candidates(scene)
    usable = [c for c in candidates if c.base_to_height >= _LEAST_RATIO]
    if not usable:
        angles = ", ".join(f"{c.first} and {c.second}: {c.angle_deg:.1f} degrees" for c in candidates)
        angles = angles or "they share no tile"
        raise EmptyResultError(
            f"No pair of images can tell heights ({angles}): choose images that look at the ground "
            "from directions at least 3 degrees apart."
        )
    if len(scene.views) <= _ALL_UP_TO:
        return sorted(usable, key=lambda pair: abs(math.log(pair.base_to_height / _BEST_RATIO)))
    unknown = usual_change(usable)
    return _few(sorted(usable, key=lambda pair: badness(pair, unknown)), [view.name for view in scene.views], unknown)


def badness(pair: ViewPair, unknown: float = 0.0) -> float:
    """What speaks against a pair; 0 is best.

    Everything is counted in the unit of the first term: 1 is as bad as an angle wrong by a factor of e.

    * convergence: abs(ln(angle / 20 degrees)); semi-global matching does best at 15 to 25;
    * overlap: -ln(part of the area that both see), so that half of it costs as much as twice the angle;
    * time: :func:`change_cost`, ``unknown`` where a time is.

    References
    ----------
    Qin, "A critical analysis of satellite stereo pairs for digital surface model generation and a matching quality
    prediction model", ISPRS Journal of Photogrammetry and Remote Sensing 154 (2019): of over 1000 pairs of one place,
    those with angles of 15 to 25 degrees still differ much in accuracy; the difference of the suns decides.
    """
    cost = change_cost(pair)
    return (
        abs(math.log(pair.angle_deg / _BEST_DEG))
        - math.log(max(pair.share, _LEAST_SHARE))
        + (unknown if cost is None else cost)
    )


def is_good(pair: ViewPair) -> bool:
    """Whether a pair is neither too narrow to tell heights well nor too wide to match well."""
    return NARROW <= pair.base_to_height <= WIDE and pair.angle_deg >= _LEAST_GOOD_DEG


def change_cost(pair: ViewPair) -> Optional[float]:
    """What changed between two images: the ground with time and season, the shadows with the sun; None if unknown.

    A quarter for each power of ten of 1 + days (same pass 0, ten days 0.26, a year 0.64), up to a half for the
    opposite season, and one for each 30 degrees between the suns.
    """
    if pair.days is None:
        return None
    season = (1.0 - math.cos(2.0 * math.pi * pair.days / _YEAR)) / 2.0
    return _DECADE_COST * math.log10(1.0 + pair.days) + _SEASON_COST * season + (pair.sun_deg or 0.0) / _SUN_COST_DEG


def usual_change(pairs: Sequence[ViewPair]) -> float:
    """The median change cost of the pairs whose times are known: what speaks neither for nor against another."""
    known = [cost for cost in map(change_cost, pairs) if cost is not None]
    return median(known) if known else 0.0


def days_off_season(days: float) -> float:
    """Days between two times of the year, 0 to 183."""
    rest = days % _YEAR
    return min(rest, _YEAR - rest)


def sun_over(scene: Scene, view: View) -> Optional[Tuple[float, float]]:
    """The sun's azimuth and elevation (degrees) over the scene's middle as a view was taken; None if unknown."""
    return sun_position(view.time, scene.frame.lon, scene.frame.lat) if view.time is not None else None


def _candidates(scene: Scene) -> List[ViewPair]:
    """All pairs that share a tile."""
    altitude = sum(scene.altitudes) / 2
    outlines = {
        view.name: geometry_of(projected_from_geodetic(scene.crs, footprint(view.localise, view.size, altitude)))
        for view in scene.views
    }
    area = ogr.CreateGeometryFromWkt(scene.area) if scene.area else None
    found: List[ViewPair] = []
    for first, second in combinations(scene.views, 2):
        shared = sum(first.name in tile.views and second.name in tile.views for tile in scene.tiles)
        if shared:
            angle, ratio = convergence(first, second, scene.frame.lon, scene.frame.lat, altitude)
            found.append(
                ViewPair(
                    first.name,
                    second.name,
                    angle,
                    ratio,
                    shared,
                    _share(outlines[first.name], outlines[second.name], area),
                    *_apart(scene, first, second),
                )
            )
    return found


def _share(first: ogr.Geometry, second: ogr.Geometry, area: Optional[ogr.Geometry]) -> float:
    """The part of an area (else of the smaller outline) that lies within two outlines."""
    common = first.Intersection(second)
    if area is not None and common is not None:
        common = common.Intersection(area)
    whole = area.GetArea() if area is not None else min(first.GetArea(), second.GetArea())
    return min(1.0, common.GetArea() / whole) if common is not None and whole > 0 else 0.0


def _apart(scene: Scene, first: View, second: View) -> Tuple[Optional[float], Optional[float], Optional[float]]:
    """Days, angle between the suns and shadow shift; None where a time is unknown or the sun had set."""
    if first.time is None or second.time is None:
        return None, None, None
    days = abs((second.time - first.time).total_seconds()) / 86400.0
    suns = sun_over(scene, first), sun_over(scene, second)
    if min(sun[1] for sun in suns) <= 0:
        return days, None, None
    return days, sun_angle(*suns), shadow_shift(*suns)


def _few(ranked: Sequence[ViewPair], names: Sequence[str], unknown: float) -> List[ViewPair]:
    """Of pairs, best first, each view's best good ones, and those that connect all views."""
    group: Dict[str, str] = {name: name for name in names}
    count = dict.fromkeys(names, 0)
    kept: List[ViewPair] = []

    def root(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    def keep(pair: ViewPair) -> None:
        kept.append(pair)
        group[root(pair.first)] = root(pair.second)
        count[pair.first] += 1
        count[pair.second] += 1

    good = [pair for pair in ranked if is_good(pair)]
    for pair in good:
        counts = count[pair.first], count[pair.second]
        if min(counts) < _WANTED and max(counts) < _BUSIEST:
            keep(pair)
    for pair in (*good, *ranked):
        if root(pair.first) != root(pair.second):
            keep(pair)
    return sorted(kept, key=lambda pair: badness(pair, unknown))
