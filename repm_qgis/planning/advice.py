"""What the pairs and ties of a scene mean for its heights, and what the analyst can do about it, in sentences."""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, Sequence, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import Bounds, FloatArray
from ..contracts.findings import Finding
from ..contracts.records import PointingFigures, ViewPair
from ..geometry.footprints import bounds_of, box
from ..imagery.acquisition import duration_text
from ..runtime.progress import counted, listed
from ..scene import Scene, View, pair_gsd_m
from .graph import components
from .height_uncertainty import height_le90_m, height_uncertainty
from .pair_selection import days_off_season, sun_over
from .parameters import PLANNING, AdviceParameters, PlanningParameters, PromiseParameters
from .promises import promise_of

_PARTS = (("north-west", "north", "north-east"), ("west", "middle", "east"), ("south-west", "south", "south-east"))


def ties_by_tile(scene: Scene, xy: FloatArray, parameters: AdviceParameters = PLANNING.advice) -> Dict[str, int]:
    """The number of ties (N, 2) in each tile, or in a fifth of the scene around its middle where that is larger.

    Ties of a large scene lie in patches, so that a small tile may contain none.
    """
    bounds = np.array([tile.bounds for tile in scene.tiles])
    least = (bounds[:, 2:].max(axis=0) - bounds[:, :2].min(axis=0)) / parameters.cells
    result = {}
    for tile, own in zip(scene.tiles, bounds):
        middle, reach = (own[:2] + own[2:]) / 2, np.maximum(own[2:] - own[:2], least) / 2
        result[tile.id] = int((np.abs(xy - middle) <= reach).all(axis=1).sum())
    return result


def ties_by_part(scene: Scene, xy: FloatArray, parameters: AdviceParameters = PLANNING.advice) -> Dict[str, int]:
    """The number of ties (N, 2) in the north-west, north ... of the area: in each ninth of the area's bounds that the
    area fills."""
    area = ogr.CreateGeometryFromWkt(scene.area)
    xmin, ymin, xmax, ymax = bounds_of(area)
    x, y = np.linspace(xmin, xmax, 4), np.linspace(ymax, ymin, 4)
    result = {}
    for row, column in np.ndindex(3, 3):
        ninth = Bounds(x[column], y[row + 1], x[column + 1], y[row])
        part = box(ninth)
        if area.Intersection(part).GetArea() >= parameters.least_part * part.GetArea():
            inside = ((xy >= ninth[:2]) & (xy <= ninth[2:])).all(axis=1)
            result[_PARTS[row][column]] = int(inside.sum())
    return result


def advice(
    scene: Scene, pairs: Sequence[ViewPair], figures: PointingFigures, parameters: PlanningParameters = PLANNING
) -> List[Finding]:
    """Warnings, each with what the analyst can do."""
    limits = parameters.advice
    spare = len(scene.views) > 2  # of two, none can be left out
    sentences = {
        "pair-geometry": [text for pair in pairs for text in _geometry(pair, scene.gsd_m, spare, parameters)],
        "views-left-out": _left_out(scene, pairs),
        "pairs-in-groups": _groups(scene, pairs),
        "image-at-night": _at_night(scene),
        "suns-differ": _suns(pairs, spare, limits),
        "dates-differ": _dates(pairs, spare, limits),
        "ties-thin": _thin(scene, figures, limits),
        "rpcs-disagree": _beyond_promise(scene, figures, parameters) or _uncertain(scene, figures, parameters),
        "ground-outside": _outside(scene, figures, parameters),
        "pointing-trend": _trends(figures, limits),
    }
    return [Finding(name, text) for name, texts in sentences.items() for text in texts]


def absolute_height(
    views: Sequence[View], figures: PointingFigures, parameters: PlanningParameters = PLANNING
) -> List[str]:
    """How uncertain the absolute height is, from what, and what the vendors promise; nothing with ground control.

    Every figure is an LE90, as vendors give theirs, so that they can be compared.
    """
    uncertain_m = height_le90_m(figures, parameters)
    if uncertain_m is None:
        return []
    seen = [pair.before_px for pair in figures.pairs if pair.count]
    apart = float(np.sqrt(np.mean(np.square(seen)))) if seen else 0.0
    promises = parameters.promises
    known = height_uncertainty(views, figures, parameters)
    promised_m = promises.le90 * known.promised_m
    uncertain = (
        f"The absolute height is uncertain by {uncertain_m:.1f} m (LE90: nine of ten scenes like this one are off by "
        "no more). Relative heights are not affected."
    )
    if all(promise_of(view, promises).vertical_m is not None for view in views):
        promise = f"The vendors promise that the RPCs' errors are at most {_promises(views, promises)}"
        promise = f"{promise} and, in height, LE90 {promised_m:.1f} m."
    else:
        promise = (
            f"The RPCs' errors are promised, or assumed, to be at most {_promises(views, promises)}. In this geometry "
            f"they cause height errors of LE90 {promised_m:.1f} m, if the errors of the images are independent."
        )
    measured = (
        f"The RPCs disagree by {apart:.2f} px across the parallax, {known.disagreement:.2f} times what such errors "
        "would cause."
    )
    if known.outside is not None:
        measured = f"{measured} The ground lies outside the heights that they were made for."
    return [uncertain, promise, measured]


def _promises(views: Iterable[View], parameters: PromiseParameters) -> str:
    """The views' CE90 by its source, the largest where RPCs have their own."""
    most: Dict[str, float] = {}
    for promise in (promise_of(view, parameters) for view in views):
        most[promise.source] = max(most.get(promise.source, 0.0), promise.horizontal_m)
    return "; ".join(f"CE90 {metres:.1f} m ({source})" for source, metres in most.items())


def _beyond_promise(scene: Scene, figures: PointingFigures, parameters: PlanningParameters) -> List[str]:
    """Pairs whose RPCs disagree by more than their vendors promise, where no ground control corrects them."""
    named: Dict[str, Tuple[View, View]] = {}
    for pair in figures.pairs:
        first, second = map(scene.view, pair.pair)
        most = math.hypot(*(promise_of(view, parameters.promises).horizontal_m for view in (first, second)))
        metres = abs(pair.before_px) * scene.gsd_m
        if pair.count and metres > most:
            apart = (
                f"{abs(pair.before_px):.1f} px, {metres:.1f} m on the ground, where at most {most:.1f} m are expected"
            )
            named[f"{first.name} and {second.name} ({apart})"] = first, second
    uncertain_m = height_le90_m(figures, parameters)
    if not named or uncertain_m is None:
        return []
    promises = _promises((view for views in named.values() for view in views), parameters.promises)
    common = set.intersection(*({view.name for view in views} for views in named.values()))
    culprit = f" ({min(common)} is in all of these pairs)" if len(common) == 1 else ""
    return [
        f"The RPCs disagree by more than their vendors promise, which is {promises}: {listed(list(named), '; ')}; the "
        f"absolute height is uncertain by {uncertain_m:.1f} m (LE90); check that each RPC belongs to its "
        f"image{culprit}, give ground control points (GCPS), or align the DSM with a reference ('Compare a DSM with a "
        "reference', ALIGN=3d)."
    ]


def _uncertain(scene: Scene, figures: PointingFigures, parameters: PlanningParameters) -> List[str]:
    """RPCs that contradict each other or are corrected by much more than their vendors promise, and what follows for
    the height; one sentence for all that has one cause."""
    uncertain_m = height_le90_m(figures, parameters)
    if uncertain_m is None:
        return []
    reasons, limits, known = [], parameters.advice, height_uncertainty(scene.views, figures, parameters)
    promised_m = parameters.promises.le90 * known.promised_m
    if known.disagreement > limits.disagreement:
        reasons.append(
            f"they disagree by {known.disagreement:.1f} times what the promised errors would cause (sound RPCs: less "
            f"than {limits.disagreement:g} times)"
        )
    for view in scene.views:
        moved_m = math.hypot(*figures.shifts_px.get(view.name, (0.0, 0.0))) * view.gsd_m
        promise = promise_of(view, parameters.promises)
        if moved_m > promise.horizontal_m:
            most = f"CE90 {promise.horizontal_m:.1f} m, {promise.source}"
            reasons.append(f"the pointing of {view.name} is corrected by {moved_m:.1f} m on the ground ({most})")
    if uncertain_m > limits.uncertain * promised_m:
        reasons.append(f"the absolute height is uncertain by {uncertain_m:.0f} m instead of {promised_m:.0f} m (LE90)")
    if not reasons:
        return []
    return [
        f"The RPCs are worse than their vendors promise: {listed(reasons, '; ')}; check that each RPC belongs to its "
        "image, or give ground control points (GCPS) or a reference."
    ]


def _trends(figures: PointingFigures, limits: AdviceParameters) -> List[str]:
    """Corrections that change over an image by more than those of sound RPCs do."""
    large = [f"{name} ({px:.1f} px)" for name, px in figures.trends_px.items() if px > limits.trend_px]
    if not large:
        return []
    return [
        f"The correction of the pointing changes from the middle of an image to its corners by more than "
        f"{limits.trend_px:g} px: {listed(large)}. Sound RPCs need less: check that each RPC belongs to its image and "
        "is not damaged, or give ground control points (GCPS)."
    ]


def _outside(scene: Scene, figures: PointingFigures, parameters: PlanningParameters) -> List[str]:
    """Ground outside the heights that the RPCs were made for, where nothing else gives its height."""
    uncertain_m = height_le90_m(figures, parameters)
    if uncertain_m is None:
        return []
    found = height_uncertainty(scene.views, figures, parameters).outside
    if found is None:
        return []
    ground, rpc = ("{:.0f} to {:.0f} m".format(*ends) for ends in (found.ground, found.rpc))
    return [
        f"The ground is found at {ground}, but its RPCs were made for {rpc}: one of them is probably wrong along the "
        "parallax, which makes wrong heights and leaves no other trace; the absolute height is uncertain by "
        f"{uncertain_m:.1f} m (LE90); check that each RPC belongs to its image, give ground control points "
        "(GCPS) or a DEM of this place (DEM), or lay the scene on known heights with 'Register to a reference' "
        "(REFERENCE)."
    ]


def _geometry(pair: ViewPair, gsd_m: float, spare: bool, parameters: PlanningParameters) -> List[str]:
    """A pair that is too narrow or too wide."""
    names = f"{pair.first} and {pair.second}"
    angles = f"(B/H {pair.base_to_height:.2f}, {pair.angle_deg:.1f} degrees)"
    if pair.base_to_height < parameters.pairs.narrow:
        accuracy = expected_accuracy_m(pair, gsd_m, parameters.advice)
        remedy = "add an image from another direction"
        return [
            f"{names} were taken from nearly the same direction {angles}: heights of this pair are accurate to about "
            f"{accuracy:.1f} m only; {f'{remedy}, or leave out one of the two' if spare else remedy}."
        ]
    if pair.base_to_height > parameters.pairs.wide:
        wide = f"{names} were taken from very different directions {angles}"
        return [f"{wide}: walls and trees will not match; add an image from a direction between them."]
    return []


def _left_out(scene: Scene, pairs: Sequence[ViewPair]) -> List[str]:
    """Views that no pair uses."""
    used = {name for pair in pairs for name in pair.names}
    names = [view.name for view in scene.views if view.name not in used]
    why = "no other image of the same ground was taken from a direction at least 3 degrees away"
    text = f"{listed(names)}: not used, because {why}; leave it out, or add an image from another direction."
    return [text] if names else []


def _groups(scene: Scene, pairs: Sequence[ViewPair]) -> List[str]:
    """Groups of views that no pair connects."""
    groups = components([view.name for view in scene.views], [pair.names for pair in pairs])
    names = [", ".join(sorted(group)) for group in groups if len(group) > 1]
    text = (
        f"The images form {len(names)} groups that no pair connects ({listed(names, '; ')}): their heights may differ "
        "by metres; add an image that overlaps both, give ground control points (GCPS), or process each group by "
        "itself."
    )
    return [text] if len(names) > 1 else []


def _at_night(scene: Scene) -> List[str]:
    """Times at which no satellite takes pictures."""
    suns = ((view, sun_over(scene, view)) for view in scene.views)
    names = [f"{view.name} ({view.time:%Y-%m-%d %H:%M} UTC)" for view, sun in suns if sun is not None and sun[1] <= 0]
    text = "the sun had set at the time in the product's files, so that only its date was used"
    return [f"{listed(names)}: {text}; check the sidecar files of the image."] if names else []


def _suns(pairs: Sequence[ViewPair], spare: bool, parameters: AdviceParameters) -> List[str]:
    """Pairs whose shadows differ."""
    high = parameters.building_m
    named = [
        f"{pair.first} and {pair.second} ({duration_text(pair.days)}, {pair.sun_deg:.0f} degrees between the suns: the "
        f"shadow of a {high:.0f} m building ends {high * (pair.shadow or 0.0):.0f} m elsewhere)"
        for pair in pairs
        if other_sun(pair, parameters)
    ]
    remedy = "take images of one pass or with similar suns"
    text = (
        f"The sun had different directions over {listed(named)}: edges of shadows are matched as if they were ground, "
        f"and ground in shadow is not matched; {f'{remedy}, or leave one image out' if spare else remedy}."
    )
    return [text] if named else []


def other_sun(pair: ViewPair, parameters: AdviceParameters = PLANNING.advice) -> bool:
    """Whether the sun stood so differently over the two views that their shadows do not match."""
    return pair.sun_deg is not None and pair.sun_deg > parameters.sun_deg


def other_season(pair: ViewPair, parameters: AdviceParameters = PLANNING.advice) -> bool:
    """Whether seasons or years lie between the two views."""
    if pair.days is None:
        return False
    return days_off_season(pair.days) > parameters.season_days or pair.days > parameters.old_days


def expected_accuracy_m(pair: ViewPair, gsd_m: float, parameters: AdviceParameters = PLANNING.advice) -> float:
    """How accurate the heights of a pair are where matching is as accurate as expected, m; ``gsd_m`` is that of the
    finest pair. Infinite where both look from one direction: they measure none."""
    if pair.base_to_height == 0:
        return math.inf
    return parameters.matching_px * pair_gsd_m(pair.gsd_m or gsd_m, gsd_m) / pair.base_to_height


def _dates(pairs: Sequence[ViewPair], spare: bool, parameters: AdviceParameters) -> List[str]:
    """Pairs of different seasons or years, except those with different suns, which are named already."""
    named = []
    for pair in pairs:
        if other_season(pair, parameters) and not other_sun(pair, parameters):
            named.append(f"{pair.first} and {pair.second} ({duration_text(pair.days)})")
    remedy = "take images of one pass"
    text = (
        f"Images were taken seasons or years apart: {listed(named)}; fields, leaves, snow and building sites have "
        f"changed, which causes gaps or wrong heights; {f'{remedy}, or leave one image out' if spare else remedy}."
    )
    return [text] if named else []


def _thin(scene: Scene, figures: PointingFigures, parameters: AdviceParameters) -> List[str]:
    """Where the area has hardly any tie."""
    tiles, parts = figures.ties_by_tile, figures.ties_by_part
    # With few ties in all, every part has few; then none is worse than the others.
    limit = min(parameters.few_ties, parameters.few_share * sum(parts.values()) / max(len(parts), 1))
    bare = [name for name, count in parts.items() if count < limit]
    few = [name for name, count in tiles.items() if count < parameters.few_ties] if len(tiles) > 1 else []
    if not few and not bare:
        return []
    where = listed(list(dict.fromkeys([*bare, *(_part_of(scene, tile) for tile in few)])))
    names = f" ({counted(len(few), 'tile')} of {len(tiles)}: {listed(few)})" if few else ""
    return [
        f"There are hardly any tie points in the {where} of the overlap{names}, because of water, clouds, shadow or "
        "changes; the pointing comes from the rest of the scene; check the arrows of the tie points around it (their "
        "field 'row') and its vertical parallax in 'Height maps', or leave it out with EXTENT."
    ]


def _part_of(scene: Scene, tile_id: str) -> str:
    """The ninth of the area in which a tile's middle lies."""
    xmin, ymin, xmax, ymax = bounds_of(ogr.CreateGeometryFromWkt(scene.area))
    x0, y0, x1, y1 = next(tile.bounds for tile in scene.tiles if tile.id == tile_id)
    column = int(np.clip(3 * ((x0 + x1) / 2 - xmin) / (xmax - xmin), 0, 2))
    row = int(np.clip(3 * (ymax - (y0 + y1) / 2) / (ymax - ymin), 0, 2))
    return _PARTS[row][column]
