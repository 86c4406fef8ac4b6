"""Look at images before anything is computed: footprints, overlaps of pairs, and which pairs are worth matching."""

from __future__ import annotations

import math
import os
from typing import Dict, List, Optional, Sequence, Tuple

from osgeo import ogr

from ..contracts.errors import Cancelled, ImageError, RepmError
from ..contracts.findings import Finding
from ..contracts.options import InspectOptions
from ..contracts.results import InspectResult
from ..files.vector import Features, write_layer
from ..geometry.footprints import geometry_of, reprojected
from ..imagery.deliveries import with_images
from ..names import images_name
from ..planning.inspection import CARE, YES, Place, inspect_views
from ..planning.overlap import without_doublets
from ..planning.run_estimate import RunEstimate, estimate
from ..reports.inspection_page import Choice, inspection_page, verdict
from ..reports.styles import write_style
from ..runtime.progress import Part, Progress, Recorder
from ..scene import View, load_view
from .parameters import ENGINE, EngineParameters

_GEODETIC = "EPSG:4326"
_LOADED = 0.5  # of the progress


def run(options: InspectOptions, progress: Progress, parameters: EngineParameters = ENGINE) -> InspectResult:
    """Read RPCs and times, and write both layers and the page; gives them with the numbers of images and pairs.

    An image that cannot be used is named in a warning and on the page, and does not stop the others. Raises ImageError
    where none can be used, WorkspaceError.
    """
    options, run = with_images(options, progress), Recorder(progress)
    views, unusable = _loaded(options, run)
    if not views:
        path, reason = next(iter(unusable.items()))
        raise ImageError(f"No image can be used (images: {len(unusable)}); '{os.path.basename(path)}': {reason}")
    progress.step(_LOADED, "overlaps of pairs")
    part = Part(progress, _LOADED, 1.0)
    places = inspect_views(views, parameters.tiles.least_overlap_px, part, parameters.pointing.planning)
    crs = places[0].crs if len(places) == 1 else _GEODETIC
    if options.footprints:
        write_footprints(places, crs, options.footprints)
    if options.overlaps:
        write_overlaps(places, crs, options.overlaps)
    tile_px = max(parameters.tiles.sizes_px)
    outlook, choices = _outlook(places, tile_px), _choices(places, tile_px)
    if options.report:
        page = inspection_page(places, unusable, parameters.pointing.planning, outlook, choices)
        page.of(images_name(options.images)).write(options.report, run)
    progress.info(verdict(places, unusable))
    if outlook:
        progress.info(outlook)
    progress.step(1.0, "images inspected")
    worth = sum(facts.worth in (YES, CARE) for place in places for facts in place.pairs)
    best = {len(choice.images): tuple(view.image for view in choice.images) for choice in choices}
    return InspectResult(
        footprints=options.footprints,
        overlaps=options.overlaps,
        report=options.report,
        n_images=len(views),
        n_pairs=worth,
        pair=best.get(2),
        triplet=best.get(3),
    )


def _estimate(seen: Sequence[float], views: int, tile_px: int) -> Optional[RunEstimate]:
    """The time and memory of matching pairs that see so many pixels of ground each; None without a pair."""
    if not seen:
        return None
    tasks = sum(math.ceil(pixels / tile_px**2) for pixels in seen)
    side = max(min(math.sqrt(pixels), tile_px) for pixels in seen)
    return estimate(sum(seen), side, tasks, views=views, tied=len(seen))


def _outlook(places: Sequence[Place], tile_px: int) -> str:
    """About how long a DSM of all the ground takes, and how much memory; "" where there is none to make."""
    seen = [px for place in places for px in _all_px(place)]
    expected = _estimate(seen, sum(len(place.images) for place in places), tile_px)
    return expected.outlook() if expected else ""


def _all_px(place: Place) -> List[float]:
    chosen = [facts for facts in place.pairs if facts.chosen]
    return place.matched_px(chosen, [facts.view for facts in place.images]) if chosen else []


def _choices(places: Sequence[Place], tile_px: int) -> List[Choice]:
    """The images to begin with, of the place with most images: the best pair, the best triplet, all of them."""
    found: List[Choice] = []
    for place in places:
        views = {facts.view.name: facts.view for facts in place.images}
        sets = [(names, place.seen_px(names)) for names in place.best()]
        if sets and len(views) > max(len(names) for names, _ in sets):
            sets.append((tuple(views), _all_px(place)))
        for names, seen in sets:
            expected = _estimate(seen, len(names), tile_px)
            if expected is not None:
                found.append(Choice(tuple(views[name] for name in names), expected.wall_s))
        if found:
            break
    return found


def _loaded(options: InspectOptions, progress: Progress) -> Tuple[List[View], Dict[str, str]]:
    """The views, and why the other images cannot be used, by their paths."""
    views: List[View] = []
    unusable: Dict[str, str] = {}
    for index, (path, rpc) in enumerate(zip(options.images, options.rpcs or [""] * len(options.images))):
        progress.check_cancelled()
        progress.step(_LOADED * index / len(options.images), f"image {index + 1} of {len(options.images)}")
        try:
            views.append(load_view(path, rpc, others=views))
        except Cancelled:
            raise
        except RepmError as error:
            unusable[path] = str(error)
    try:
        views, doublets = without_doublets(views)
        unusable.update({each.view.image: each.text for each in doublets})
    except ImageError:
        pass  # pixels cannot be read: what the RPCs say can be shown without them
    for path, reason in unusable.items():
        progress.warn(Finding("image-unusable", f"'{os.path.basename(path)}' cannot be used: {reason}"))
    return views, unusable


def write_footprints(places: Sequence[Place], crs: str, path: str) -> None:
    """Write the layer of the images' outlines on the ground, with its style. Raises WorkspaceError."""
    texts = dict.fromkeys(("view", "file", "satellite", "taken"), str)
    numbers = ("gsd", "incidence", "azimuth", "sun_azimuth", "sun_elevation", "altitude")
    fields: Dict[str, type] = {**texts, "width": int, "height": int, **dict.fromkeys(numbers, float)}

    def features() -> Features:
        for place in places:
            for facts in place.images:
                view, sun = facts.view, facts.sun or (None, None)
                taken = f"{view.time:%Y-%m-%d %H:%M:%S}" if view.time else None
                looks = view.gsd_m, facts.incidence_deg, facts.azimuth_deg
                values = [view.name, view.image, view.sensor or None, taken, *view.size, *looks, *sun, place.altitude]
                yield reprojected(geometry_of(facts.outline), place.crs, crs), values

    write_layer(path, crs, ogr.wkbPolygon, fields, features())
    times = sorted(facts.view.acquired for place in places for facts in place.images if facts.view.time)
    write_style("footprints", path, taken=(times[0], times[-1]) if times else None)


def write_overlaps(places: Sequence[Place], crs: str, path: str) -> None:
    """Write the layer of what each two images share, with its style. Raises WorkspaceError."""
    texts = dict.fromkeys(("first", "second", "worth", "reason"), str)
    numbers = ("area_km2", "percent", "angle", "base_to_height", "days", "sun_angle")
    fields: Dict[str, type] = {**texts, "matched": int, **dict.fromkeys(numbers, float)}

    def features() -> Features:
        for place in places:
            for facts in reversed(place.pairs):  # the best is drawn last, on top of the others
                pair, area = facts.pair, facts.ground.GetArea() / 1e6
                looks = pair.angle_deg, pair.base_to_height, pair.days, pair.sun_deg
                words = pair.first, pair.second, facts.worth, facts.reason
                ground = ogr.ForceToMultiPolygon(reprojected(facts.ground, place.crs, crs))
                yield ground, [*words, int(facts.chosen), area, facts.percent, *looks]

    write_layer(path, crs, ogr.wkbMultiPolygon, fields, features())
    write_style("overlaps", path)
