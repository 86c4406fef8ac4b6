"""The HTML page of the buildings of a DSM."""

from __future__ import annotations

import numpy as np
from osgeo import ogr

from ..contracts.arrays import ByteImage, FloatArray, FloatImage
from ..contracts.options import BuildingsOptions
from ..imagery.cell_polygons import burned
from ..reports import charts, pictures
from ..reports.report import Report, fixed
from ..runtime.progress import counted
from .finding import FoundBuildings

_PICTURE_PX = 900
_MOST_ROWS = 100


def buildings_page(options: BuildingsOptions, found: FoundBuildings, terrain: str) -> Report:
    """What was found: the footprints over the surface, figures, errors, and each building."""
    page = Report("Buildings of a DSM", f"{options.output}, of {options.dsm}")
    buildings = found.buildings
    errors = np.array([each.heights.error for each in buildings])
    known = f"; the height of half of them is known to {_median(errors):.2f} m or better (standard error)"
    page.verdict(f"{counted(len(buildings), 'building')}{known if buildings else ''}.", about=True)
    page.section("Picture")
    picture, low, high = _picture(found)
    page.png(pictures.png_bytes(picture), "Footprints over the shaded surface, coloured by their height; north is up.")
    page.svg(charts.colour_bar(pictures.RAMPS["viridis"], low, high, "m above the ground"))
    _figures(page, options, found, terrain, errors)
    if buildings:
        page.svg(charts.histogram(errors, "m", "Standard errors of the heights above the ground"))
        _table(page, found)
    return page


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _figures(page: Report, options: BuildingsOptions, found: FoundBuildings, terrain: str, errors: FloatArray) -> None:
    kinds = sorted({each.kind for each in found.buildings})
    counts = ", ".join(f"{sum(each.kind == kind for each in found.buildings)} {kind}" for kind in kinds)
    page.section("Figures").facts(
        [
            ("Buildings", len(found.buildings)),
            ("with the planes of their roofs (LoD 2)", sum(each.lod == 2 for each in found.buildings)),
            ("Kinds of roofs", counts or "none"),
            ("Area of all footprints", f"{sum(each.area for each in found.buildings):.0f} m2"),
            ("Volume of all buildings", f"{sum(each.volume for each in found.buildings):.0f} m3"),
            ("Terrain", options.dtm or "made of the DSM"),
            ("Heights refer to", found.surface.datum.name if found.surface.datum else "not stated by the DSM"),
            ("Plants by near infrared", "yes" if found.shows_plants else "no"),
            ("Lowest and smallest building", f"{options.min_height:g} m, {options.min_area:g} m2"),
        ]
    )


def _table(page: Report, found: FoundBuildings) -> None:
    rows = []
    for each in found.buildings:
        heights = each.heights
        figures = fixed(
            heights.tall, heights.error, heights.ground, heights.eave, heights.ridge, heights.residual, decimals=2
        )
        rows.append([each.number, each.kind, each.lod, f"{each.area:.0f}", *figures, f"{100 * heights.measured:.0f}"])
    page.section("Buildings").table(
        "id | roof | LoD | area, m2 | height, m | standard error, m | ground, m | eave, m | ridge, m | residual, m | "
        "measured, %",
        rows,
        "The largest first. The height is that of the roof's median above the lowest ground at the outline; the "
        "residual is the spread of the DSM about the solid's roof.",
        most=_MOST_ROWS,
        where="The layer has all of them.",
    )


def _picture(found: FoundBuildings) -> tuple[ByteImage, float, float]:
    surface, cell = pictures.preview(found.surface.path, _PICTURE_PX, heights=True)
    heights = _heights_on(found, surface.shape)
    low, high = 0.0, max(pictures.percentile_range(heights)[1], 1.0)
    colours = pictures.colour_map(heights, low, high, "viridis")
    return pictures.over(pictures.grey_relief(surface, cell), colours), low, high


def _heights_on(found: FoundBuildings, shape: tuple[int, ...]) -> FloatImage:
    """(rows, columns) the height of the building on each cell of a smaller picture of the DSM, m; NaN for none."""
    x0, dx, _, y0, _, dy = found.surface.transform
    columns, rows = found.surface.size
    transform = [x0, dx * columns / shape[1], 0, y0, 0, dy * rows / shape[0]]
    shapes = [ogr.CreateGeometryFromWkb(each.outline) for each in found.buildings]
    return burned(shapes, [each.heights.tall for each in found.buildings], shape, transform).astype(np.float32)
