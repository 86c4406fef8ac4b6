"""The HTML page about images before anything is computed."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import List, Mapping, Sequence, Tuple

import numpy as np

from ..contracts.errors import RepmError
from ..contracts.results import PipelineResult
from ..imagery.acquisition import duration_text
from ..planning.advice import expected_accuracy_m
from ..planning.inspection import CARE, NO, YES, PairFacts, Place
from ..planning.parameters import PLANNING, PlanningParameters
from ..planning.run_estimate import duration
from ..runtime.progress import counted
from ..scene import Scene, View
from . import charts, pictures
from .report import Report, fixed

_MOST_PAIRS = 200
_MOST_PICTURES, _PICTURE_PX = 40, 260


@dataclass(frozen=True)
class Choice:
    """Images to make a DSM of, and how long that takes, seconds of wall time."""

    images: Tuple[View, ...]
    wall_s: float


def inspection_page(
    places: Sequence[Place],
    unusable: Mapping[str, str],
    parameters: PlanningParameters = PLANNING,
    outlook: str = "",
    choices: Sequence[Choice] = (),
) -> Report:
    """Where images lie, how pairs overlap, and what to match; ``unusable`` are reasons by the files' paths.

    ``outlook`` is what a run would take, "" where there is nothing to run; ``choices`` are images to begin with.
    """
    count = sum(len(place.images) for place in places)
    overlaps = sum(len(place.pairs) for place in places)
    page = Report("Images inspected", f"{counted(count, 'image')}, {counted(overlaps, 'overlap')}")
    page.paragraph(verdict(places, unusable))
    if outlook:
        page.paragraph(outlook)
    _choices(page, choices)
    for number, place in enumerate(places, start=1):
        of = f" of place {number}" if len(places) > 1 else ""
        ground = "where the images show the ground" if place.shown else "the middle of the RPCs' heights"
        caption = f"Footprints{of} at {place.altitude:.0f} m above the ellipsoid ({ground}), north up ({place.crs})."
        page.svg(charts.footprints({facts.view.name: facts.outline for facts in place.images}), caption)
    _images(page, places, unusable)
    _pictures(page, [facts.view for place in places for facts in place.images])
    _overlaps(page, places, parameters)
    _first_area(page, places, parameters)
    return page


def _choices(page: Report, choices: Sequence[Choice]) -> None:
    """The images to begin with, and how long each choice takes."""
    if not choices:
        return
    names = {2: "the best pair", 3: "the best triplet"}
    page.section("Images to begin with").table(
        "choice | images | about",
        [
            [
                names.get(len(each.images), "all images"),
                ", ".join(view.name for view in each.images),
                duration(each.wall_s),
            ]
            for each in choices
        ],
        "The time is that of 'Make a DSM from satellite images' with the quality 'default' on this computer, if it "
        "does nothing else; it is right within a factor of two. A third image fills what two do not see, and finds "
        "gross errors. In QGIS, the message above the map opens the dialog with the pair or the triplet.",
    )


def add_preview(page: Report, place: Place, scene: Scene, result: PipelineResult) -> None:
    """What a preview is for: the altitudes and pairs of the DSM's run, and where it will have no heights."""
    page.section("What the preview shows").paragraph(
        "The images were reduced, each to cells of the size above: heights are as much coarser. Ground without a "
        "height is water, or what matching does not hold on: clouds, haze, shadows, changed ground. A DSM in full "
        "has no height there either, unless other images show it."
    )
    empty = 100.0 - result.valid_percent
    water = 100.0 * result.water_m2 / (result.cells * result.resolution**2)
    altitudes = "not known from this preview"
    if result.lowest is not None and result.highest is not None:
        altitudes = f"{result.lowest:.0f} to {result.highest:.0f} m above the ellipsoid"
    page.facts(
        [
            ("Altitudes for the DSM", altitudes),
            ("Median altitude of the ground", f"{place.altitude:.0f} m above the ellipsoid"),
            ("Without a height", f"{empty:.1f} %"),
            ("Water", f"{water:.1f} %"),
        ]
    )
    _pictures(page, scene.views)
    _overlaps(page, [place], PLANNING, "Overlaps of pairs")


def _pictures(page: Report, images: Sequence[View]) -> None:
    """A small picture of each image, to see clouds."""
    drawn = []
    for view in images[:_MOST_PICTURES]:
        try:
            picture = pictures.thumbnail(view.image, _PICTURE_PX)
        except RepmError:
            continue  # the image's RPC could be read, and more is not needed here
        drawn.append((pictures.png_bytes(picture), view.name))
    if drawn:
        more = f" {len(images) - len(drawn)} more images are not shown here." if len(images) > len(drawn) else ""
        page.gallery(drawn, f"The images as they were taken, not north up: look for clouds, haze and snow.{more}")


def verdict(places: Sequence[Place], unusable: Mapping[str, str]) -> str:
    """In one or two sentences: whether these images can give a DSM, and with which pair to begin."""
    pairs = [facts for place in places for facts in place.pairs]
    worth = {grade: [facts for facts in pairs if facts.worth == grade] for grade in (YES, CARE, NO)}
    count = sum(len(place.images) for place in places)
    missing = f" {counted(len(unusable), 'image')} cannot be used." if unusable else ""
    if count < 2:
        return f"One image alone gives no heights: add another image of the same ground.{missing}"
    if not pairs:
        return f"No two of these {count} images show the same ground: choose images of one place.{missing}"
    best = next(iter([*worth[YES], *worth[CARE]]), None)
    if best is None:
        return (
            f"No pair can measure heights, because all images look from nearly one direction: add an image from at "
            f"least 3 degrees away.{missing}"
        )
    begin = f"begin with {best.pair.first} and {best.pair.second} ({_looks(best)})"
    if not worth[YES]:
        return f"A DSM is possible, but every pair has a weakness ({best.reason}): {begin}.{missing}"
    care = f", and {len(worth[CARE])} with care" if worth[CARE] else ""
    places_text = f" The images show {len(places)} places: process each by itself." if len(places) > 1 else ""
    return (
        f"Good: {counted(len(worth[YES]), 'pair')} of {len(pairs)} {'is' if len(worth[YES]) == 1 else 'are'} worth "
        f"matching{care}; {begin}.{places_text}{missing}"
    )


def _looks(facts: PairFacts) -> str:
    pair = facts.pair
    apart = "" if pair.days is None else f", {duration_text(pair.days)} apart"
    return f"{pair.angle_deg:.0f} degrees, B/H {pair.base_to_height:.2f}, {facts.percent:.0f} % overlap{apart}"


def _images(page: Report, places: Sequence[Place], unusable: Mapping[str, str]) -> None:
    rows: List[List[object]] = []
    for number, place in enumerate(places, start=1):
        for facts in place.images:
            view, sun = facts.view, facts.sun
            looks = fixed(view.gsd_m, decimals=2) + fixed(facts.incidence_deg, facts.azimuth_deg, decimals=1)
            taken = f"{view.time:%Y-%m-%d %H:%M}" if view.time else "unknown"
            stood = "{:.0f}°, {:.0f}°".format(*sun) if sun else "unknown"
            of = [f"place {number}"] * (len(places) > 1)
            when = view.sensor or "unknown", taken, stood
            rows.append([", ".join([view.name, *of]), f"{view.width} x {view.height}", *looks, *when])
    rows += [[os.path.basename(path), "cannot be used", *[None] * 3, *"–––"] for path in unusable]
    page.section("Images").table(
        "image | size, px | GSD, m | incidence, ° | azimuth, ° | satellite | taken (UTC) | sun's azimuth, elevation",
        rows,
        "The incidence angle lies between the line of sight and the vertical on the ground; the off-nadir angle at the "
        "satellite is somewhat smaller. The azimuth is the direction to the satellite. Satellite and time are from "
        "the product's files or name; the sun's direction is computed from the time.",
        where="The layer has them all.",
    )


def _overlaps(page: Report, places: Sequence[Place], parameters: PlanningParameters, title: str = "Pairs") -> None:
    rows: List[List[object]] = []
    for place in places:
        gsd = {facts.view.name: facts.view.gsd_m for facts in place.images}
        for facts in place.pairs:
            pair = facts.pair
            area = f"{facts.ground.GetArea() / 1e6:.2f} km², {facts.percent:.0f} %"
            accuracy = expected_accuracy_m(pair, min(gsd.values()), parameters.advice)
            looks = *fixed(pair.base_to_height, decimals=2), *fixed(pair.angle_deg, decimals=1)
            sun = "unknown" if pair.sun_deg is None else f"{pair.sun_deg:.0f}°"
            figures = *looks, area, *fixed(accuracy, decimals=2), duration_text(pair.days), sun
            rows.append([f"{pair.first}, {pair.second}", facts.worth, facts.reason, *figures])
    limits, advice = parameters.pairs, parameters.advice
    page.section(title).table(
        "pair | worth matching | why | B/H | convergence, ° | overlap | accuracy, m | time between | angle between "
        "suns",
        rows,
        "'Overlap' is the ground that both show and its part of the smaller image, and 'accuracy' that of single "
        f"heights where matching is accurate to {advice.matching_px:g} px. A pair is good with B/H from "
        f"{limits.narrow:g} to {limits.wide:g}; below {limits.least_base_to_height:g} it measures no heights. With "
        f"more than {advice.sun_deg:g}° between the directions to the sun, shadows lie elsewhere; with more than "
        f"{advice.season_days:.0f} days of the year between the images, plants have changed. Pairs that are not "
        "needed are left out where 'Make a DSM from satellite images' is given "
        "all these images.",
        most=_MOST_PAIRS,
        where="The layer has them all.",
    )


def _first_area(page: Report, places: Sequence[Place], parameters: PlanningParameters) -> None:
    """A small square to begin with, as the parameter EXTENT of the other algorithms."""
    for place in places:
        area = place.first_area(parameters)
        if area is not None:
            xmin, ymin, xmax, ymax = np.round(area).astype(int)
            page.section("A small area to start with").paragraph(
                "Draw it on the map over the overlap of the best pair, or give this as the area (EXTENT):"
            )
            page.command(f"{xmin},{xmax},{ymin},{ymax} [{place.crs}]")
            return
