"""The HTML page of a terrain."""

from __future__ import annotations

from typing import Dict, List, Mapping, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage
from ..contracts.options import DtmOptions
from ..contracts.results import DtmResult
from ..reports import charts, pictures
from ..reports.report import Report
from .inputs import Surface

_PICTURE_PX = 700
_TALL_M = 2.0  # lower heights are left out of the histogram: cars, hedges and noise


def terrain_page(options: DtmOptions, surface: Surface, result: DtmResult) -> Report:
    """What was found: DSM, terrain and their difference beside each other, figures, and two profiles."""
    page = Report("Terrain of a DSM", f"{options.output}, of {options.scene or options.dsm}")
    page.verdict(f"{result.objects_percent:.1f} % of the DSM's heights belong to objects.", about=True)
    heights: Dict[str, FloatImage] = {}
    cell = 1.0
    for name, path in (("DSM", surface.path), ("terrain", options.output)):
        heights[name], cell = pictures.preview(path, _PICTURE_PX, heights=True)
    above = heights["DSM"] - heights["terrain"]
    low, high = pictures.percentile_range(heights["DSM"])
    page.section("Pictures")
    above_datum = f"m above the {surface.datum.name}" if surface.datum else "m"
    captions = {
        "DSM": "The DSM, shaded from the north-west, north up. White: no height.",
        "terrain": "The terrain in the same colours.",
    }
    for name, caption in captions.items():
        page.png(pictures.png_bytes(pictures.shaded_relief(heights[name], cell, low, high)), caption)
    page.svg(charts.colour_bar(pictures.RAMPS["elevation"], low, high, above_datum))
    top = max(pictures.percentile_range(above)[1], 1.0)
    page.png(
        pictures.png_bytes(pictures.colour_map(above, 0.0, top, "viridis")),
        "Heights above the terrain (DSM − terrain), north up. White: the DSM has no height.",
    )
    page.svg(charts.colour_bar(pictures.RAMPS["viridis"], 0.0, top, "m above the terrain"))
    columns, rows = surface.size
    page.section("Figures").facts(
        [
            ("Cells", f"{columns} x {rows} of {surface.cell:g} m"),
            ("Heights of the DSM that belong to objects", f"{result.objects_percent:.1f} %"),
            ("Cells with a terrain", f"{result.valid_percent:.1f} %"),
            ("Largest object", f"{options.largest:g} m"),
            ("Steepest ground", f"{options.slope:g} %"),
            ("Confidence", surface.confidence or "none"),
        ]
    )
    tall = above[np.isfinite(above) & (above > _TALL_M)]
    if tall.size:
        title = f"Heights of what stands {_TALL_M:g} m and more above the terrain"
        page.svg(charts.histogram(tall, "m above the terrain", title))
    page.section("Profiles")
    for title, series in _profiles(heights, cell):
        page.svg(charts.curves(series, "distance (m)", "height (m)", title))
    return page


_Lines = Dict[str, Tuple[FloatArray, FloatImage]]


def _profiles(heights: Mapping[str, FloatImage], cell: float) -> List[Tuple[str, _Lines]]:
    """Both surfaces along the middle row and the middle column."""
    rows, columns = heights["DSM"].shape
    ways = (
        ("west to east through the middle", (rows // 2, slice(None)), columns),
        ("north to south through the middle", (slice(None), columns // 2), rows),
    )
    return [
        (title, {name: ((np.arange(count) + 0.5) * cell, values[cut]) for name, values in heights.items()})
        for title, cut, count in ways
    ]
