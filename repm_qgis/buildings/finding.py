"""All buildings of a DSM: from its cells to footprints, heights, roofs and solids."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import List, Optional

from osgeo import ogr

from ..contracts.errors import ImageError
from ..contracts.findings import Finding
from ..contracts.options import BuildingsOptions
from ..evaluation.grids import Grid, metric_of
from ..imagery.raster import quiet
from ..runtime.progress import Progress
from ..terrain.inputs import Surface
from ..terrain.parameters import TERRAIN
from ..terrain.steepness import Slopes, on_steep_ground, slopes_of
from .building import Building, building_of
from .cells import Rasters
from .footprints import borders, write_cells
from .parameters import BUILDINGS, BuildingParameters
from .regularisation import apart, regular
from .segments import divided


@dataclass(frozen=True)
class FoundBuildings:
    """The buildings, the largest first, of a surface; ``shows_plants``: whether an orthophoto showed plants."""

    surface: Surface
    buildings: List[Building]
    shows_plants: bool
    warnings: List[Finding]


def require_metres(surface: Surface) -> None:
    """Raise ImageError for a DSM whose cells do not run east and south in metres, as long as those on the ground."""
    for finding in metric_of(Grid(surface.path, surface.size, surface.transform, surface.crs)).finding(
        f"'{surface.path}'"
    ):
        raise ImageError(finding)
    _, right, turn, _, tilt, down = surface.transform
    straight = turn == tilt == 0 and right > 0 > down
    if not straight or abs(right - surface.cell) > 0.01 * surface.cell:
        raise ImageError(
            f"The cells of the DSM '{surface.path}' do not run east and south in metres: bring it into a projected CRS "
            "in metres first (Raster > Projections > Warp)."
        )


def find_buildings(
    options: BuildingsOptions,
    surface: Surface,
    terrain: str,
    slopes: Optional[Slopes],
    folder: str,
    progress: Progress,
    parameters: BuildingParameters = BUILDINGS,
) -> FoundBuildings:
    """Find the buildings of a DSM, which :func:`require_metres` has let pass, above a terrain; ``folder`` takes what
    exists between, ``slopes`` are the DSM's where they are known.

    Raises ImageError and OverlapError for rasters that cannot be used, WorkspaceError.
    """
    with ExitStack() as stack, quiet():
        rasters = Rasters(surface, terrain, options.ortho, stack)

        def step(share: float) -> None:
            progress.check_cancelled()
            progress.step(0.4 * share, "looking for buildings")

        cells = f"{folder}/cells.tif"
        write_cells(rasters, cells, options.min_height, step, parameters)
        found = borders(cells, surface.cell, options.min_area, parameters.footprints.hole_m2, progress.check_cancelled)
        shapes: List[ogr.Geometry] = []
        for number, border in enumerate(sorted(found, key=lambda each: -each.area)):
            progress.check_cancelled()
            progress.step(0.4 + 0.1 * number / len(found), "straightening outlines")
            parts = divided(rasters, ogr.CreateGeometryFromWkb(border.outline), parameters)
            shapes += [regular(part, surface.cell, parameters.outlines) for part in parts]
        buildings: List[Building] = []
        for number, shape in enumerate(apart(shapes)):
            progress.check_cancelled()
            progress.step(0.5 + 0.5 * number / max(len(shapes), 1), "measuring roofs")
            if shape.GetArea() < options.min_area:
                continue
            building = building_of(rasters, shape, len(buildings) + 1, parameters)
            if building is not None and building.heights.tall >= options.min_height:
                buildings.append(building)
        buildings = sorted(buildings, key=lambda each: -each.area)
        buildings = [replace(each, number=number) for number, each in enumerate(buildings, start=1)]
        slopes = slopes or slopes_of(surface, progress.check_cancelled)
        warnings = rasters.warnings + _hillsides(slopes, buildings)
        return FoundBuildings(surface, buildings, rasters.shows_plants, warnings)


def _hillsides(slopes: Slopes, buildings: List[Building]) -> List[Finding]:
    """A warning where many of the buildings are steep ground that the terrain does not follow."""
    shapes = [ogr.CreateGeometryFromWkb(each.outline) for each in buildings]
    count, share = on_steep_ground(slopes, shapes)
    if share <= TERRAIN.steepness.most_hillside:
        return []
    text = (
        f"{count} of the {len(buildings)} buildings ({100 * share:.0f} % of their area) are surfaces steeper than "
        f"{100 * TERRAIN.steepness.hillside:g} % that no walls bound: probably hillsides, which the terrain cuts off. "
        "Make the terrain with 'Find the terrain below houses and trees' and a larger SLOPE first, and give it as DTM."
    )
    return [Finding("buildings-hillsides", text, "doubt")]
