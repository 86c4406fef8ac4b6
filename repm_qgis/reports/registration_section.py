"""How a scene was laid onto references: a section of the run's page, and a page of its own."""

from __future__ import annotations

import math
import os
from typing import List

import numpy as np

from ..contracts.records import ReferenceFigures, RegistrationFigures
from ..imagery.raster import opened, read
from ..numerics.robust import nmad
from ..scene import Scene
from . import charts, pictures, verdict
from .geometry_section import add_jitter
from .report import Report, fixed

_BINS = 61
_PICTURE_PX = 480  # along the longer side


def registration_page(scene: Scene, figures: RegistrationFigures) -> Report:
    """How the references place a scene, for the analyst."""
    names = ", ".join(f"'{os.path.basename(each.file)}'" for each in figures.references)
    page = Report("Registration to a reference", names or "Scenes that overlap")
    east, north, up = figures.latest.moved
    record = scene.record_of("register")
    page.verdict(
        f"The scene was moved by {math.hypot(east, north):.2f} m horizontally and {up:+.2f} m in height.",
        record.warnings if record else verdict.of_registration(figures),
    )
    add_registration(page, figures)
    if figures.waves_m is not None:
        add_jitter(page, scene)
    if record:
        inputs = [(name, str(record.options.get(name) or "")) for name in ("scene", "model", "stable")]
        page.section("Inputs").facts([(name, value) for name, value in inputs if value])
    return page


def add_registration(page: Report, figures: RegistrationFigures) -> None:
    """The shift with its uncertainty, each reference, the parts' offsets, and the differences before and after."""
    page.section("Registration")
    rows = []
    promised = (figures.promised_m[0], figures.promised_m[0], figures.promised_m[1])
    # A component is determined where its axis lies in the directions that are.
    known = [sum(direction[axis] ** 2 for direction in figures.determined) > 0.99 for axis in range(2)] + [True]
    for name, moved, deviation, promise, yes in zip(
        ("east", "north", "height"), figures.latest.moved, figures.deviation, promised, known
    ):
        state = "determined" if yes else "not determined: as the vendors' RPCs give it"
        rows.append([name, f"{moved:+.3f}", f"{deviation:.3f}", f"{promise:.1f}", state])
    control = " The scene's ground control points count too, by their noise." if figures.control else ""
    page.table(
        "component | added, m | standard deviation, m | expected error without it, m | state",
        rows,
        "The shift of the scene's ground. It is in the pointing of every image, so that every product follows. The "
        "standard deviations take into account that errors of neighbouring heights are correlated. Without a "
        "registration, nine of ten scenes have errors below the expected ones (CE90, LE90), which follow from the "
        f"vendors' promise and, for the height, from how well their RPCs agree.{control}",
    )
    if any(figures.latest.tilt):
        tilts = zip(figures.latest.tilt, figures.tilt_deviation)
        tilt = ", ".join(f"{1000 * each:+.3f} ± {1000 * deviation:.3f}" for each, deviation in tilts)
        page.facts([("Tilt to the east and north", f"{tilt} m per km")])
    if figures.references:
        page.table(
            "reference | heights above | cells or footprints, m | heights on the surface | heights used | "
            "east, m | north, m | height, m | NMAD before, m | NMAD after, m",
            [_reference_row(each) for each in figures.references],
            "The shift that each reference alone would give. Heights that are not used differ by more than the noise: "
            "trees and roofs above bare ground, water, changes. The NMAD is the spread of the differences.",
        )
        for each in figures.references:
            page.facts([(f"Datum of '{os.path.basename(each.file)}'", f"{each.datum}: {each.datum_from}")])
            if each.about:
                page.facts([(f"Heights of '{os.path.basename(each.file)}'", each.about)])
    if figures.waves_m is not None:
        without, taken = (f"{each:.2f}" for each in figures.waves_m)
        page.paragraph(
            f"The reference shows jitter along the parallax, of up to {figures.waves_px:.2f} px. It is removed from "
            f"heights and pointing: the NMAD of the differences from single height maps falls from {without} to "
            f"{taken} m."
        )
    if figures.neighbours:
        page.facts([("Placed together with", ", ".join(figures.neighbours))])
    _offsets(page, figures)
    _differences(page, figures)


def _reference_row(each: ReferenceFigures) -> List[str]:
    width = "points" if not max(each.width_m) else f"{each.width_m[0]:.1f} x {each.width_m[1]:.1f}"
    shifts = [f"{m:+.2f} ± {d:.2f}" for m, d in zip(each.moved, each.deviation)]
    counts = [str(each.seen), str(each.used)]
    return [os.path.basename(each.file), each.datum, width, *counts, *shifts, *fixed(each.before_m, each.after_m)]


def _offsets(page: Report, figures: RegistrationFigures) -> None:
    if len(figures.offsets) < 2:
        return
    at = np.array([(offset.x, offset.y) for offset in figures.offsets]) * (1, -1)
    before = np.array([offset.moved[:2] for offset in figures.offsets]) * (1, -1)
    moved = np.array(figures.latest.moved[:2]) * (1, -1)
    page.svg(
        charts.arrows(at, before, "Before the registration", "m"),
        "The horizontal shift that each part of the scene would need, north up. Arrows that agree show a wrong "
        "pointing, "
        "which the registration removes.",
    )
    page.svg(
        charts.arrows(at, before - moved, "After the registration", "m"),
        "The shifts that remain. Arrows that agree over only a part of the scene show a distortion, which no shift "
        "removes.",
    )


def _differences(page: Report, figures: RegistrationFigures) -> None:
    if not figures.differences or not os.path.exists(figures.differences):
        return
    with opened(figures.differences) as dataset:
        bands = [read(dataset, None, band) for band in (1, 2)]
    known = [band[np.isfinite(band)] for band in bands]
    if not all(len(values) for values in known):
        return
    limit = max(abs(value) for value in pictures.percentile_range(bands[0]))
    limit = max(limit, 3.0 * nmad(known[1]), 0.1)
    edges = np.linspace(-limit, limit, _BINS + 1)
    middle = (edges[:-1] + edges[1:]) / 2
    series = {
        name: (middle, 100.0 * np.histogram(values, edges)[0] / len(values))
        for name, values in zip(("before", "after"), known)
    }
    page.svg(
        charts.curves(series, "reference minus surface (m)", "heights (%)"),
        "Distribution of the differences before and after the registration.",
    )
    captions = (
        "The reference minus the surface before the registration, north up.",
        "The reference minus the surface after the registration, north up.",
    )
    for caption, band in zip(captions, bands):
        step = max(1, math.ceil(max(band.shape) / _PICTURE_PX))
        picture = pictures.png_bytes(pictures.colour_map(band[::step, ::step], -limit, limit, "diverging"))
        page.png(picture, caption)
    page.svg(charts.colour_bar(pictures.RAMPS["diverging"], -limit, limit, "m"))
