"""The HTML page of the change between two dates."""

from __future__ import annotations

import math

import numpy as np
from pyproj import Transformer

from ..contracts.findings import as_percent
from ..contracts.options import ChangeOptions
from ..geometry.frames import flat_crs
from ..reports import charts, pictures
from ..reports.report import Report, fixed
from .finding import Found
from .parameters import CHANGE
from .volumes import centre_of

_MOST_ROWS = 50


def change_page(options: ChangeOptions, found: Found) -> Report:
    """What changed, for the analyst: from the totals to the figures that they are based on."""
    page = Report("Change between two dates", f"{options.before}, then {options.after}")
    gains, losses = found.total(True), found.total(False)
    good = (
        f"Significant changes: {len(found.changes)}, with {gains.volume:.0f} m3 gained and "
        f"{abs(losses.volume):.0f} m3 lost."
        if found.changes
        else "Nothing changed significantly between the two dates."
    )
    page.verdict(f"{good} Compared: {as_percent(found.shared)} of the larger DSM's ground.", about=True)
    _totals(page, options, found)
    _pictures(page, found)
    _largest(page, options, found)
    _stable_ground(page, options, found)
    return page


def _totals(page: Report, options: ChangeOptions, found: Found) -> None:
    rows = []
    for name, gain in (("gained", True), ("lost", False)):
        total = found.total(gain)
        rows.append([name, total.count, *fixed(total.area, total.volume, total.deviation, decimals=0)])
    page.section("Volumes").table(
        "change | number | area, m2 | volume, m3 | standard deviation, m3",
        rows,
        "Two of three true volumes lie within one standard deviation, if the heights are as accurate there as on "
        "stable ground.",
    )
    files = [
        ("Difference (AFTER minus BEFORE)", options.output),
        ("Significant change and level of detection", options.significant),
        ("Volumes", options.volumes),
    ]
    page.facts([(name, path) for name, path in files if path])


def _pictures(page: Report, found: Found) -> None:
    before, after, change = (found.pictures[name] for name in ("before", "after", "change"))
    both = np.concatenate([before.ravel(), after.ravel()])
    low, high = pictures.percentile_range(both)
    page.section("Pictures")
    reliefs = [pictures.shaded_relief(heights, found.picture_cell_m, low, high) for heights in (before, after)]
    page.png(pictures.png_bytes(reliefs[0]), "BEFORE, shaded from the north-west, north up.")
    page.png(pictures.png_bytes(reliefs[1]), "AFTER, moved onto BEFORE, in the same colours.")
    page.svg(charts.colour_bar(pictures.RAMPS["elevation"], low, high, "m"))
    limit = found.shown_m
    light = reliefs[1][..., :3].mean(axis=-1, keepdims=True) * 0.4 + 153.0
    drawn = np.concatenate([np.repeat(light, 3, axis=-1).astype(np.uint8), reliefs[1][..., 3:]], axis=-1)
    coloured = pictures.colour_map(change, -limit, limit, "diverging")
    drawn = np.where(np.isfinite(change)[..., None], coloured, drawn)
    caption = (
        f"Significant change over the grey AFTER. Red: gained. Blue: lost, in the darkest tone from {limit:.1f} m "
        "upwards. White: no height in AFTER."
    )
    page.png(pictures.png_bytes(drawn), caption)
    page.svg(charts.colour_bar(pictures.RAMPS["diverging"], -limit, limit, "m"))


def _largest(page: Report, options: ChangeOptions, found: Found) -> None:
    to_geodetic = Transformer.from_crs(flat_crs(found.grid.crs), 4326, always_xy=True)
    rows = []
    for number, each in enumerate(found.changes[:_MOST_ROWS], start=1):
        x, y = centre_of(each.outline)
        longitude, latitude = to_geodetic.transform(x, y)
        place = f"{latitude:.5f}, {longitude:.5f}"
        heights = fixed(each.mean, each.largest, decimals=2, sign="+")
        volume = fixed(each.volume, decimals=0, sign="+") + fixed(each.deviation, decimals=0)
        rows.append([number, "gain" if each.gain else "loss", place, f"{each.area:.0f}", *heights, *volume])
    left = len(found.changes) - len(rows)
    more = f" {left} smaller ones are only in the layer of the volumes." if left else ""
    page.section("Largest changes").table(
        "number | change | latitude, longitude | area, m2 | mean, m | largest, m | volume, m3 | standard deviation, m3",
        rows,
        f"Changes of at least {options.min_area:g} m2, the largest volume first.{more}",
    )


def _stable_ground(page: Report, options: ChangeOptions, found: Found) -> None:
    moved, model = found.alignment, found.model
    page.section("Stable ground")
    facts = [("Alignment (ALIGN)", moved.method)]
    if moved.method != "none":
        shifts = ", ".join(f"{shift:+.3f}" for shift in (moved.dx, moved.dy, moved.dz))
        facts += [
            ("Moved AFTER by (east, north, up), m", shifts),
            ("NMAD of the differences before and after, m", f"{moved.nmad_before:.3f}, {moved.nmad_after:.3f}"),
        ]
    facts += [
        ("Level of detection, median, m", f"{found.level_m:.2f}"),
        ("Horizontal error between the DSMs, m", f"{model.horizontal_m:.2f}"),
        ("Standard deviation of the offset between the DSMs, m", f"{found.offset_m:.3f}"),
    ]
    if found.stated:
        facts.append(("Errors that the confidence rasters state, times", f"{model.scale:.2f}"))
    else:
        facts.append(("Error of a difference on level ground, m", f"{model.scale:.2f}"))
    page.facts(facts)
    counts, edges = found.histogram.reshape(-1, 2).sum(axis=1), found.histogram_edges()[::2]
    inside = np.abs(edges[:-1] + edges[1:]) / 2 < 6
    level, share = CHANGE.detection.level, 100.0 * counts[inside] / max(counts.sum(), 1)
    middles = ((edges[:-1] + edges[1:]) / 2)[inside]
    normal = 100.0 * (edges[1] - edges[0]) * np.exp(-0.5 * middles**2) / math.sqrt(2 * math.pi)
    most = float(share.max())
    lines = {
        "differences": (middles, share),
        "normal errors": (middles, normal),
        "level of detection": (np.array([-1, -1, math.nan, 1, 1]) * level, np.array([0, 1, math.nan, 0, 1]) * most),
    }
    page.svg(
        charts.curves(lines, "difference over its expected error", "cells (%)", "Differences against their errors"),
        "All cells that both DSMs have. A difference beyond the level of detection is significant only where "
        "neighbours agree with it, and where no edge or hidden strip explains it.",
    )
    middle = [(each.low + each.high) / 2 for each in model.classes]
    slopes = {
        "found": (middle, [each.spread for each in model.classes]),
        "expected": (middle, [each.expected for each in model.classes]),
    }
    page.svg(
        charts.curves(slopes, "slope (°)", "NMAD of the differences (m)", "Spread of the differences by slope"),
        "The level of detection follows the expected spread, which grows with the slope: a horizontal error turns into "
        "a height error there.",
    )
    alike = found.correlation
    reach = float(alike.distances[min(int((alike.values > 0).sum()) + 1, alike.values.size - 1)])
    page.svg(
        charts.curves(
            {"correlation": (np.concatenate([[0.0], alike.distances]), np.concatenate([[1.0], alike.values]))},
            "distance (m)",
            "correlation",
            "Correlation of errors",
            xlim=(0.0, reach),
        ),
        "From the variogram of stable ground. The uncertainty of volumes counts only as many cells as are independent.",
    )
