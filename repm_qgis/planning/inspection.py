"""What images and their RPCs say before anything is matched: where they lie, how they overlap, which pairs fit.

Images of several places are treated place by place, each in a UTM zone of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import List, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import Bounds
from ..contracts.errors import EmptyResultError
from ..contracts.records import ViewPair
from ..geometry.footprints import Polygon, bounds_of, footprint, geometry_of, ray_slope, seen_twice
from ..geometry.frames import geodetic_from_projected, projected_from_geodetic, utm_crs
from ..geometry.tiles import enclosing
from ..imagery.acquisition import duration_text
from ..runtime.progress import Part, Progress, Silent
from ..scene import View, common_heights, finest_gsd_m, middle_of, pair_gsd_m
from .advice import expected_accuracy_m, other_season, other_sun
from .altitude_range import ground_altitude
from .overlap import places
from .pair_selection import Seen, best_pairs, pair_at, places_seen, shared_part, sun_at
from .parameters import PLANNING, PlanningParameters

YES, CARE, NO = "yes", "with care", "no"
_SILENT = Silent()


@dataclass(frozen=True)
class ImageFacts:
    """One image: its (N, 2) ``outline`` in its place's CRS, and how it looks at the middle of it.

    ``incidence_deg`` is the angle between the line of sight and the vertical on the ground, ``azimuth_deg`` the
    direction from the ground to the satellite, clockwise from north; ``sun`` its azimuth and elevation, None where the
    time is unknown.
    """

    view: View
    outline: Polygon
    incidence_deg: float
    azimuth_deg: float
    sun: Optional[Tuple[float, float]]


@dataclass(frozen=True)
class PairFacts:
    """Two images that overlap: their common ground, and whether matching them is worth it (YES, CARE, NO), with the
    reason.

    ``ground`` is the overlap in the place's CRS, ``percent`` its part of the smaller footprint. ``chosen``: the
    pipeline would match the pair, were it given all these images.
    """

    pair: ViewPair
    ground: ogr.Geometry
    percent: float
    chosen: bool
    worth: str
    reason: str


@dataclass(frozen=True)
class Place:
    """Images that lie together: their CRS, the altitude (m above the ellipsoid) of the outlines, images and pairs.

    ``shown``: the images show that the ground lies there; else it is the middle of the heights that their RPCs were
    made for.

    Images are in the order of their times, and pairs in that of their worth: those that are matched first, then others
    by the time between their images.
    """

    crs: str
    altitude: float
    shown: bool
    images: Tuple[ImageFacts, ...]
    pairs: Tuple[PairFacts, ...]

    def best(self) -> Tuple[Tuple[str, ...], ...]:
        """The images to begin with, by their names: the best pair, and with the best third image the best triplet.

        A third image must make a pair that is worth matching with both, or it is none. None at all where no pair is.
        """
        if not self.pairs or self.pairs[0].worth == NO:
            return ()
        grade = {frozenset(each.pair.names): rank for rank, each in enumerate(self.pairs) if each.worth != NO}
        first = self.pairs[0].pair.names
        ranks = {}
        for image in self.images:
            sides = [frozenset((image.view.name, name)) for name in first]
            if image.view.name not in first and all(side in grade for side in sides):
                ranks[image.view.name] = max(grade[side] for side in sides), sum(grade[side] for side in sides)
        third = min(ranks, key=lambda name: (*ranks[name], name), default=None)
        return (first,) if third is None else (first, (*first, third))

    def seen_px(self, names: Sequence[str]) -> List[float]:
        """The pixels of ground that each pair of these images sees which a run with them alone would match."""
        mine = [each for each in self.pairs if set(each.pair.names) <= set(names)]
        matched = [each for each in mine if each.chosen or (len(names) <= 3 and each.worth != NO)]
        return self.matched_px(matched, [each.view for each in self.images if each.view.name in names])

    @staticmethod
    def matched_px(pairs: Sequence[PairFacts], views: Sequence[View]) -> List[float]:
        """The pixels of ground that each of some pairs sees, as a run with these views matches them."""
        finest = finest_gsd_m(views)
        return [each.ground.GetArea() / pair_gsd_m(each.pair.gsd_m or finest, finest) ** 2 for each in pairs]

    def first_area(self, parameters: PlanningParameters = PLANNING) -> Optional[Bounds]:
        """A small square in the overlap of the best pair, for a first trial; None where no pair is worth it."""
        if not self.pairs or self.pairs[0].worth == NO:
            return None
        ground = self.pairs[0].ground
        half = min(parameters.advice.first_side_m, math.sqrt(ground.GetArea()) / 2) / 2
        x, y = _inner_point(ground)
        return Bounds(x - half, y - half, x + half, y + half)


def inspect_views(
    views: Sequence[View],
    least_px: float,
    progress: Progress = _SILENT,
    parameters: PlanningParameters = PLANNING,
    altitude: Optional[float] = None,
) -> Tuple[Place, ...]:
    """The places of the views (:func:`~repm_qgis.planning.overlap.places`), those with most images first.

    ``altitude`` is the ground's, m above the ellipsoid; None: it is found from the images.
    """
    groups = places(views, least_px)
    count = len(groups)
    parts = [Part(progress, number / count, (number + 1) / count) for number in range(count)]
    return tuple(_place(group, least_px, part, parameters, altitude) for group, part in zip(groups, parts))


def _place(
    views: Sequence[View],
    least_px: float,
    progress: Progress,
    parameters: PlanningParameters,
    known: Optional[float],
) -> Place:
    crs, search = utm_crs(*middle_of(views)), common_heights(views)
    altitude, shown = (
        ground_altitude(views, crs, search=search, progress=progress, parameters=parameters)
        if known is None
        else (known, True)
    )
    outlines = [projected_from_geodetic(crs, footprint(view.localise, view.size, altitude)) for view in views]
    images = tuple(_image(view, crs, outline, altitude) for view, outline in zip(views, outlines))
    shapes, area = [geometry_of(outline) for outline in outlines], seen_twice([outlines])
    found: List[Tuple[ViewPair, ogr.Geometry, float]] = []
    for i, j in combinations(range(len(views)), 2):
        ground = shapes[i].Intersection(shapes[j])
        if ground is None or ground.GetArea() < (least_px * min(views[i].gsd_m, views[j].gsd_m)) ** 2:
            continue
        lon, lat = geodetic_from_projected(crs, np.array(_inner_point(ground)))
        part = shared_part(shapes[i], shapes[j], area)
        pair = pair_at(views[i], views[j], (float(lon), float(lat), altitude), 0, part)
        found.append((pair, ground, 100.0 * shared_part(shapes[i], shapes[j])))
    named = {view.name: outline for view, outline in zip(views, outlines)}
    seen = places_seen(named, enclosing([bounds_of(shape) for shape in shapes]), parameters.pairs)
    matched = _matched([pair for pair, _, _ in found], seen, list(named), parameters)
    gsd, ranks = {view.name: view.gsd_m for view in views}, {pair.names: rank for rank, pair in enumerate(matched)}
    pairs = []
    for pair, ground, percent in found:
        is_matched = pair.names in ranks
        worth, reason = _worth(pair, percent, gsd, is_matched, parameters)
        pairs.append(PairFacts(pair, ground, percent, chosen=is_matched, worth=worth, reason=reason))
    pairs.sort(
        key=lambda facts: (
            (YES, CARE, NO).index(facts.worth),
            ranks.get(facts.pair.names, len(ranks)),
            math.inf if facts.pair.days is None else facts.pair.days,
            -facts.percent,
            facts.pair.names,
        )
    )
    images = tuple(sorted(images, key=lambda facts: (facts.view.acquired or "", facts.view.name)))
    return Place(crs, altitude, shown, images, tuple(pairs))


def _image(view: View, crs: str, outline: Polygon, altitude: float) -> ImageFacts:
    lon, lat = map(float, geodetic_from_projected(crs, np.array(_inner_point(geometry_of(outline)))))
    east, north = ray_slope(view, np.array([lon, lat]), altitude)
    incidence, azimuth = math.degrees(math.atan(math.hypot(east, north))), math.degrees(math.atan2(east, north)) % 360.0
    return ImageFacts(view, outline, incidence, azimuth, sun_at(view, lon, lat))


def _inner_point(geometry: ogr.Geometry) -> Tuple[float, float]:
    """The middle of a shape; some point in it where the middle lies outside."""
    middle = geometry.Centroid()
    point = middle if geometry.Contains(middle) else geometry.PointOnSurface()
    return point.GetX(), point.GetY()


def _matched(
    pairs: Sequence[ViewPair], seen: Seen, names: Sequence[str], parameters: PlanningParameters
) -> List[ViewPair]:
    """The pairs that the pipeline would match, best first."""
    try:
        return best_pairs(pairs, seen, names, parameters.pairs)
    except EmptyResultError:
        return []


def _worth(
    pair: ViewPair, percent: float, gsd: "dict[str, float]", is_matched: bool, parameters: PlanningParameters
) -> Tuple[str, str]:
    """Whether a pair is worth matching, and why (or why not)."""
    limits, advice = parameters.pairs, parameters.advice
    if pair.base_to_height < limits.least_base_to_height:
        return NO, "both look from the same direction: no heights"
    reasons = []
    if pair.base_to_height < limits.narrow or pair.angle_deg < limits.least_good_deg:
        accuracy = expected_accuracy_m(pair, min(gsd[pair.first], gsd[pair.second]), advice)
        reasons.append(f"narrow: heights accurate to about {accuracy:.1f} m only")
    elif pair.base_to_height > limits.wide:
        reasons.append("wide: walls and trees will not match")
    if other_sun(pair, advice):
        reasons.append(f"the sun stood {pair.sun_deg:.0f} degrees elsewhere: shadows do not match")
    if other_season(pair, advice):
        reasons.append(f"{duration_text(pair.days)} apart: fields, leaves and buildings have changed")
    if percent < 100.0 * advice.small_overlap:
        reasons.append(f"only {percent:.0f} % of the smaller image is shared")
    if not is_matched:
        reasons.append("not needed: both have better partners")
    fits = not reasons or (len(reasons) == 1 and not is_matched)
    fitting = "angle, overlap and sun fit" if pair.sun_deg is not None else "angle and overlap fit, times are unknown"
    return (YES if fits else CARE), "; ".join(reasons) or fitting
