"""The DSM whose terrain is searched, and its confidence raster: whether they can be used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, Optional, Tuple

import numpy as np
import pyproj

from .. import __version__
from ..contracts.arrays import Size
from ..contracts.errors import ImageError
from ..contracts.findings import Finding
from ..evaluation.grids import Grid, cell_sides, metric_of
from ..gate.companions import confidence_findings
from ..geometry.frames import flat_crs, on_earth, utm_crs
from ..geometry.ground_metric import MOST_DISTORTION
from ..geometry.vertical import TAG, HeightDatum
from ..imagery.confidence import confidence_bands
from ..imagery.raster import opened
from ..mosaic.inputs import looked_at
from ..reports.pictures import preview

_SAMPLE_PX = 1000  # of the confidence raster, from which the usual error is
_SQUARE = 0.01  # share by which the sides of a cell may differ
_LEAST_ERROR_M = 0.05


@dataclass(frozen=True)
class Surface:
    """A DSM: its file, cells, frame and datum; ``cell`` is the side of a cell in m. ``confidence`` is the raster of its
    expected errors, "" for none, with the bands of the error and of the source of each height (0: it has none), and
    the ``usual_error``, m; 0 where it is not known. ``findings``: what is to be known of the two together."""

    path: str
    size: Size
    transform: Tuple[float, ...]
    crs: str
    datum: Optional[HeightDatum]
    cell: float
    confidence: str = ""
    error_band: int = 0
    source_band: int = 0
    usual_error: float = 0.0
    findings: Tuple[Finding, ...] = ()

    @property
    def tags(self) -> Dict[str, str]:
        """Metadata of a raster with heights of the same datum."""
        return {"REPM_ENGINE": __version__, **({TAG: self.datum.name} if self.datum else {})}


def surface_of(path: str, confidence: Optional[str]) -> Surface:
    """Look at a DSM; raises ImageError for one that cannot be used, or a confidence raster that is not its own."""
    with opened(path) as dataset:
        found = looked_at(dataset, path)
        crs = dataset.GetProjection()
    grid, cell = found.grid, _cell(found.grid)
    surface = Surface(path, grid.size, grid.transform, crs, found.datum, cell)
    if not confidence:
        return surface
    findings = tuple(confidence_findings(path, confidence, "CONFIDENCE", whole=True))
    with opened(confidence) as dataset:
        bands = confidence_bands(dataset, "CONFIDENCE")
    errors = preview(confidence, _SAMPLE_PX, bands.error)[0]
    errors = errors[np.isfinite(errors)]
    usual = max(float(np.median(errors)), _LEAST_ERROR_M) if errors.size else 0.0
    known = confidence if usual else ""
    return replace(
        surface,
        confidence=known,
        error_band=bands.error,
        source_band=bands.source,
        usual_error=usual,
        findings=findings,
    )


def _cell(grid: Grid) -> float:
    """The side of a cell, m on the ground, where the CRS is not true to scale, and in its own metres elsewhere; raises
    ImageError for cells that are not squares in metres."""
    crs = flat_crs(grid.crs)
    sides = cell_sides(grid)
    if crs.is_geographic or abs(sides[0] - sides[1]) > _SQUARE * max(sides):
        longitude, latitude = _middle(grid)
        raise ImageError(
            f"The DSM '{grid.path}' in {crs.name} has no square cells in metres: reproject it first, such as to "
            f"{utm_crs(longitude, latitude)} (Raster > Projections > Warp)."
        )
    metric = metric_of(grid)
    if metric.distortion <= MOST_DISTORTION:  # cells of 0.5 m stay such: the method's sizes are in whole cells
        own = [(metric.unit_m or 1.0) * side / unit for side, unit in zip(sides, metric.per_unit)]
        sides = own[0], own[1]
    return float(f"{sum(sides) / 2:.9g}")


def _middle(grid: Grid) -> Tuple[float, float]:
    xmin, ymin, xmax, ymax = grid.bounds
    to_degrees = pyproj.Transformer.from_crs(flat_crs(on_earth(grid.crs, grid.path)), "EPSG:4326", always_xy=True)
    longitude, latitude = to_degrees.transform((xmin + xmax) / 2, (ymin + ymax) / 2)
    return float(longitude), float(latitude)
