"""The HTML page of a series of dates."""

from __future__ import annotations

import math
from typing import Dict, List, Tuple

import numpy as np

from ..contracts.arrays import ByteImage, FloatArray, FloatImage
from ..contracts.findings import as_percent
from ..contracts.options import SeriesOptions
from ..reports import charts, pictures
from ..reports.report import Report, fixed
from ..reports.templates import Drawing
from .areas import AreaOverTime
from .finding import FoundSeries

_MOST_ROWS = 50
_MOST_LINES = 6  # areas in the chart
_MOST_NAMED = 8  # dates in a legend; more have a bar


def series_page(options: SeriesOptions, found: FoundSeries) -> Report:
    """What happened when, for the analyst, from the volumes to what the figures rest on."""
    first, last = found.series[0].label, found.series[-1].label
    page = Report("Series of dates", f"{len(found.series)} DSMs, {first} to {last}")
    good = f"The surface rises significantly on {found.rising:.0f} m2 and falls on {found.falling:.0f} m2."
    page.verdict(f"{good} All dates have at least {as_percent(found.shared)} of the largest DSM's ground.", about=True)
    _volumes(page, options, found)
    _pictures(page, found)
    _dates(page, options, found)
    return page


def _volumes(page: Report, options: SeriesOptions, found: FoundSeries) -> None:
    page.section("Volumes over time")
    where = (
        "The areas are those of AREAS."
        if options.areas
        else f"The areas are what changed significantly, of at least {options.min_area:g} m2, the largest volume first."
    )
    rows = []
    for each in found.areas[:_MOST_ROWS]:
        last = each.last
        volume = fixed(each.volume[last], decimals=0, sign="+") + fixed(each.deviation[last], decimals=0)
        trend = fixed(each.trend, decimals=0, sign="+") + fixed(each.trend_error, decimals=0)
        rows.append([each.name, f"{each.area:.0f}", f"{100 * each.known[last]:.0f}", *volume, *trend])
    page.table(
        "area | size, m2 | known, % | volume, m3 | standard deviation, m3 | trend, m3 per year | standard error",
        rows,
        f"Volumes at the last date, against the first. {where} Where heights are missing, the area's mean change is "
        "taken, and the deviation is larger.",
    )
    if found.areas:
        caption = "The volume of each area since the first date, with its standard deviation to both sides."
        page.svg(volume_chart(found.years, found.areas[:_MOST_LINES]), caption)
    files = [
        ("Heights of all dates", options.output),
        ("Trend", options.trend),
        ("Dates of change", options.changed),
        ("Volumes over time", options.volumes),
        ("Table of the volumes", options.table),
        ("Layers of the dates", options.layers),
    ]
    page.facts([(name, path) for name, path in files if path])


def volume_chart(years: FloatArray, areas: List[AreaOverTime]) -> Drawing:
    """Lines of volumes (m3) over the years since the first date, with a bar of the deviation at each date."""
    lines: Dict[str, Tuple[FloatArray, FloatArray]] = {}
    for each in areas:
        known = np.isfinite(each.volume)
        x, y, half = years[known], each.volume[known], each.deviation[known]
        bars = [np.column_stack([[a, a, math.nan], [b - c, b + c, math.nan]]) for a, b, c in zip(x, y, half)]
        points = np.concatenate([np.column_stack([x, y]), [[math.nan, math.nan]], *bars])
        lines[each.name] = points[:, 0], points[:, 1]
    return charts.curves(lines, "years since the first date", "volume (m³)", "Volumes over time")


def _pictures(page: Report, found: FoundSeries) -> None:
    heights, trend = found.pictures["heights"], found.pictures["trend"]
    limit = found.shown_m_a
    page.section("Pictures")
    page.png(_over_relief(heights, trend, found.picture_cell_m, -limit, limit, "diverging"), "Trend, over the relief.")
    page.svg(charts.colour_bar(pictures.RAMPS["diverging"], -limit, limit, "m per year"))
    labels = [each.label for each in found.series]
    for name, caption in (
        ("first", "The first date that shows a change. Grey: no date of change is known."),
        ("last", "The date at which the change had ended."),
    ):
        values = found.pictures[name]
        page.png(_over_relief(heights, values, found.picture_cell_m, 1.0, float(len(labels)), "viridis"), caption)
    if len(labels) <= _MOST_NAMED:
        table = pictures.ramp_table("viridis", len(labels))
        page.svg(charts.legend([("#" + bytes(colour).hex(), label) for colour, label in zip(table, labels)]))
    else:
        page.svg(charts.colour_bar(pictures.RAMPS["viridis"], 1, len(labels), "number of the date"))


def _over_relief(heights: FloatImage, values: FloatImage, cell_m: float, low: float, high: float, ramp: str) -> bytes:
    """A PNG of values in colours over the pale grey relief of heights."""
    relief = pictures.shaded_relief(heights, cell_m, *pictures.percentile_range(heights))
    light = relief[..., :3].mean(axis=-1, keepdims=True) * 0.4 + 153.0
    drawn: ByteImage = np.concatenate([np.repeat(light, 3, axis=-1).astype(np.uint8), relief[..., 3:]], axis=-1)
    coloured = pictures.colour_map(values, low, high, ramp)
    return pictures.png_bytes(np.where(np.isfinite(values)[..., None], coloured, drawn))


def _dates(page: Report, options: SeriesOptions, found: FoundSeries) -> None:
    rows = []
    for number, each in enumerate(found.series, start=1):
        moved = found.alignments[number - 1]
        shift = ", ".join(f"{value:+.2f}" for value in (moved.dx, moved.dy, moved.dz)) if number > 1 else "–"
        figures = fixed(found.offsets[number - 1], decimals=3, sign="+")
        figures += fixed(found.errors.usual_m[number - 1], found.errors.horizontal_m[number - 1], decimals=2)
        cells = f"{100.0 * found.known[number - 1] / math.prod(found.grid.size):.0f}"
        rows.append([number, each.label, each.path, cells, *figures, shift if moved.method != "none" else "–"])
    page.section("Dates and their errors").table(
        "number | date | DSM | cells with a height, % | offset, m | error of a height, m | horizontal error, m | "
        "moved by (east, north, up), m",
        rows,
        "Offset: how far the heights lie from those of the first date where nothing changed. "
        f"ALIGN is {options.align}. Errors: what the differences of dates that follow each other show on stable "
        "ground, shared out to the single dates.",
    )
