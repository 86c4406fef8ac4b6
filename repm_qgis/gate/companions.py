"""Rasters that accompany a DSM: its confidence, the terrain below it, a picture over it."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatArray, FloatImage, Window
from ..contracts.errors import ImageError, OverlapError
from ..contracts.findings import Finding, as_percent
from ..evaluation.comparison import sample_windows
from ..evaluation.grids import Grid, HeightWarper, bounds_on, cell_metres, cell_sides, overlap
from ..evaluation.parameters import EVALUATION
from ..imagery.confidence import confidence_bands
from ..imagery.heights import read_heights, read_values
from ..imagery.raster import opened
from ..numerics.robust import NMAD_FACTOR, nmad
from ..registration.parameters import REGISTRATION
from ..registration.solve import mode, other_relief
from .open_ground import open_ground
from .parameters import GATE, GateParameters
from .places import ROWS, displaced_by

_LEAST_DRAPED = 0.5  # of a DSM's heights: differences and errors may have gaps of their own
_FEW_ROWS = 64  # of a raster, for medians


def confidence_findings(
    dsm: str, confidence: str, option: str, *, whole: bool = False, parameters: GateParameters = GATE
) -> List[Finding]:
    """What is to be known of a confidence raster that is used with a DSM: how many of its heights have no expected
    error.

    Raises ImageError for one that does not have the DSM's cells: all of them and no others where it must be ``whole``,
    else some of them, or more.
    """
    with opened(dsm) as heights, opened(confidence) as errors:
        band = confidence_bands(errors, option).error
        column, row = _place_on(Grid.of(heights), Grid.of(errors), option, whole)
        known, stated, alone, nothing = _counts(heights, errors, band, (column, row))
        _require_positive(nothing, stated, confidence, option, parameters)
        findings = error_findings(heights, errors, band, option, parameters)
    without = 1.0 - stated / max(known, 1)
    if without > parameters.most_unstated:
        text = f"{as_percent(without)} of the heights of '{dsm}' have no expected error in '{confidence}'"
        findings.append(Finding("error-unknown", f"{text}, and are left out of what needs one: give the whole raster."))
    strange = alone / max(alone + stated, 1)
    if known and strange > parameters.most_strange:
        text = f"{as_percent(strange)} of the expected errors of '{confidence}' belong to no height of '{dsm}'"
        findings.append(Finding("confidence-of-other", f"{text}: check that it was written with this DSM.", "doubt"))
    return findings


def error_findings(
    dsm: gdal.Dataset, confidence: gdal.Dataset, band: int, option: str, parameters: GateParameters = GATE
) -> List[Finding]:
    """Whether the expected errors in this band of a raster can be those of a DSM's heights, whatever its cells: heights
    vary by their errors at least, so far larger ones are of another unit.

    Raises ImageError where errors are negative.
    """
    path = confidence.GetDescription()
    errors = _rows(confidence, lambda window: read_values(confidence, window, band))
    _require_positive(int((errors < 0.0).sum()), errors.size, path, option, parameters)
    step = parameters.variation_cells
    bends = _rows(dsm, lambda window: np.diff(read_heights(dsm, window)[:, ::step], 2))
    if not errors.size or not bends.size:
        return []
    usual, varies = float(np.median(errors)), NMAD_FACTOR * float(np.median(np.abs(bends))) / np.sqrt(6.0)
    least = max(parameters.least_unlikely_m, parameters.least_unlikely_cells * max(cell_sides(Grid.of(dsm))))
    if usual <= min(max(parameters.most_error_variations * varies, least), parameters.most_error_m):
        return []
    text = (
        f"The median of the expected errors of '{path}' is {usual:.1f} m, and the heights of '{dsm.GetDescription()}' "
        f"vary by {varies:.2f} m over {step} cells"
    )
    return [Finding("errors-unlikely", f"{text}: check that the unit of the errors is the metre.", "doubt")]


def _rows(dataset: gdal.Dataset, read: Callable[[Window], FloatImage]) -> FloatArray:
    """The known values of some rows of a raster, spread evenly over it."""
    columns, rows = dataset.RasterXSize, dataset.RasterYSize
    chosen = np.unique(np.linspace(0, rows - 1, min(rows, _FEW_ROWS)).astype(int))
    values = np.concatenate([read(Window(0, int(row), columns, 1)).ravel() for row in chosen])
    known: FloatArray = values[np.isfinite(values)].astype(np.float64)
    return known


def _require_positive(nothing: int, stated: int, path: str, option: str, parameters: GateParameters) -> None:
    """Raise ImageError where more than single ones of the stated errors are not above 0."""
    if nothing > parameters.most_unstated * max(stated, 1):
        raise ImageError(
            f"{as_percent(nothing / max(stated, 1))} of the expected errors of '{path}' are 0 or less, which no "
            f"height has: give the raster that was written with the DSM, or leave {option} empty."
        )


def _place_on(dsm: Grid, confidence: Grid, option: str, whole: bool) -> Tuple[int, int]:
    """The column and row of the confidence raster's first cell among the DSM's cells; raises ImageError where its
    cells are others."""
    column, row = dsm.to_cells(confidence.transform[0], confidence.transform[3])
    steps = np.array([confidence.transform[i] - dsm.transform[i] for i in (1, 2, 4, 5)])
    side = abs(dsm.transform[1]) + abs(dsm.transform[2])
    drift = float(np.abs(steps).max()) * max(*dsm.size, *confidence.size)
    apart = max(abs(column - round(column)), abs(row - round(row)), drift / side)
    other = whole and (round(column), round(row), confidence.size) != (0, 0, dsm.size)
    if other or apart > 1e-2 or (dsm.wkt and confidence.wkt and dsm.flat.crs != confidence.flat.crs):
        raise ImageError(
            f"The confidence raster '{confidence.path}' does not have the cells of the DSM '{dsm.path}': give the one "
            f"that was written with this DSM, or leave {option} empty."
        )
    return round(column), round(row)


def _counts(
    heights: gdal.Dataset, errors: gdal.Dataset, band: int, place: Tuple[int, int]
) -> Tuple[int, int, int, int]:
    """Of evenly spaced rows: cells with a height, those of them with an expected error, errors without a height, and
    errors that are not above 0."""
    columns, rows = heights.RasterXSize, heights.RasterYSize
    counts = np.zeros(4, np.int64)
    for row in np.unique(np.linspace(0, rows - 1, min(rows, ROWS)).astype(int)):
        has = np.isfinite(read_heights(heights, Window(0, int(row), columns, 1))[0])
        error = np.full(columns, np.nan)
        own = Window(place[0], 0, errors.RasterXSize, 1).common(Window(0, 0, columns, 1))
        there = int(row) - place[1]
        if own is not None and own.width > 0 and 0 <= there < errors.RasterYSize:
            window = Window(own.col - place[0], there, own.width, 1)
            error[own.col : own.col + own.width] = read_values(errors, window, band)[0]
        says = np.isfinite(error)
        counts += [int(cells.sum()) for cells in (has, has & says, says & ~has, has & (error <= 0.0))]
    known, stated, alone, nothing = map(int, counts)
    return known, stated, alone, nothing


def terrain_findings(
    dsm: str, terrain: str, promised_m: float = 0.0, parameters: GateParameters = GATE
) -> List[Finding]:
    """What is to be known of a terrain that is used below a DSM, whose heights have this usual error (m): how much of
    it there is, and whether the two lie at the same height and have the same relief.

    Raises ImageError for one that cannot be used, OverlapError where it lies elsewhere.
    """
    with opened(dsm) as heights, opened(terrain) as ground:
        grid = Grid.of(heights)
        warper = HeightWarper(ground, grid)
        overlap(Grid.of(ground), grid)
        windows = sample_windows(grid, grid.bounds, EVALUATION.comparison)
        patches = [(read_heights(heights, window), warper.read(grid.window(window))) for window in windows]
        cell = cell_metres(grid)
    findings = list(warper.warnings)
    differences = [surface - below for surface, below in patches]
    above = np.concatenate([np.empty(0), *(each[np.isfinite(each)] for each in differences)])
    covered = above.size / max(sum(int(np.isfinite(surface).sum()) for surface, _ in patches), 1)
    if covered < 1.0 - parameters.most_uncovered:
        text = f"The terrain '{terrain}' covers {as_percent(covered)} of the heights of '{dsm}'"
        findings.append(
            Finding("terrain-partial", f"{text}: nothing is found elsewhere, and what its edge cuts is wrong.")
        )
    if above.size:
        ground = open_ground([surface for surface, _ in patches], differences, windows, cell, parameters)
        off, tilted = _off(above, ground.offsets, promised_m, parameters)
        relief = None
        if ground.heights.size >= parameters.open_cells:
            left = max(parameters.most_left_m, parameters.most_left_cells * max(cell), promised_m)
            bounds = replace(REGISTRATION, most_left_m=left, unexplained=parameters.unexplained)
            relief = other_relief(ground.heights, ground.heights - ground.above, bounds)
        if off:
            text = (
                f"The terrain '{terrain}' lies {'up to ' if tilted else ''}{abs(off):.1f} m "
                f"{'below' if off > 0 else 'above'} the ground of '{dsm}'"
            )
            remedy = "check that both have the same vertical datum and unit, and show the same place"
            findings.append(Finding("terrain-off", f"{text}: {remedy}.", "doubt"))
        elif relief is not None:
            findings.append(Finding("terrain-relief", relief.sentence(terrain), "doubt"))
        else:
            findings += _displacement(terrain, dsm, patches, cell, parameters)
    return findings


def _off(
    above: FloatArray, ground: Optional[FloatArray], promised_m: float, parameters: GateParameters
) -> Tuple[float, bool]:
    """How far a terrain lies below the ground, m, 0 where it fits, and whether this is so in a part only; ``above`` are
    all heights above it, ``ground`` those of the open ground."""
    if ground is None:
        low, middle = np.percentile(above, (parameters.ground_percent, 50.0))
        if low > parameters.most_unseen_off_m or middle < -parameters.most_unseen_off_m:
            return mode(above, parameters.mode_share), False
        return 0.0, False
    low, middle, high = np.percentile(ground, (2.0, 50.0, 98.0))
    tilted = bool(high - low > 0.5 * parameters.most_off_m)
    worst = max((low, high), key=abs) if tilted else middle
    return (float(worst), tilted) if abs(worst) > max(parameters.most_off_m, promised_m) else (0.0, False)


def _displacement(
    terrain: str,
    dsm: str,
    patches: List[Tuple[FloatImage, FloatImage]],
    cell: Tuple[float, float],
    parameters: GateParameters,
) -> List[Finding]:
    """Whether a terrain fits to the ground of a DSM better elsewhere."""
    ground = []
    for surface, below in patches:
        with np.errstate(invalid="ignore"):
            ground.append((np.where(np.abs(surface - below) < parameters.near_m, surface, np.float32(np.nan)), below))
    by = displaced_by(ground, cell, parameters=parameters)
    text = f"The terrain '{terrain}' fits to the ground of '{dsm}' better {by:.1f} m beside its place"
    return [Finding("terrain-displaced", f"{text}: check the CRS and the place of both.", "doubt")] if by else []


def picture_findings(
    dsm: str, picture: str, share: float, bands: Sequence[FloatImage], parameters: GateParameters = GATE
) -> List[Finding]:
    """What is to be known of a picture that is draped over a DSM, of whose heights it shows this share; ``bands`` are
    its values there."""
    found = []
    if share < 1.0 - parameters.most_uncovered:
        text = f"The picture '{picture}' shows {as_percent(share)} of the heights of '{dsm}'"
        found.append(Finding("picture-partial", f"{text}: the rest has no colours."))
    if share and all(np.ptp(np.percentile(band, (1.0, 99.0))) == 0.0 for band in bands):
        text = f"The picture '{picture}' has one colour nearly everywhere"
        found.append(Finding("picture-blank", f"{text}: check that it is the orthophoto of this DSM."))
    return found


def draped_findings(
    dsm: str, path: str, heights: FloatImage, bands: Sequence[FloatImage], kind: str, parameters: GateParameters = GATE
) -> List[Finding]:
    """What is to be known of a raster of this kind ("ortho", "confidence", "dsm_error") whose bands (rows, columns)
    are draped over heights of the same cells, m: how many of these it has values for, whether a picture shows nothing,
    and whether differences are heights."""
    both = np.isfinite(heights) & np.isfinite(bands[0])
    share = float(both.sum()) / max(int(np.isfinite(heights).sum()), 1)
    if kind == "ortho":
        return picture_findings(dsm, path, share, [band[both] for band in bands], parameters)
    found: List[Finding] = []
    if share < _LEAST_DRAPED:
        text = f"The raster '{path}' has values for {as_percent(share)} of the heights of '{dsm}'"
        found = [Finding("raster-partial", f"{text}: the rest has no colours.")]
    if both.any() and kind == "dsm_error":
        own, away = heights[both], bands[0][both] - heights[both]
        if nmad(away) < nmad(own) / 2 and abs(np.median(away)) < abs(np.median(own)) / 10:
            text = f"The differences in '{path}' are nearly the heights of '{dsm}'"
            found.append(Finding("difference-heights", f"{text}: give the difference of two DSMs.", "doubt"))
    return found


def shown_under(picture: gdal.Dataset, dsm: gdal.Dataset) -> Tuple[float, FloatImage]:
    """The share of a DSM's heights for which a picture has a value, by some rows, and the (N,) values of its first
    band there; raises OverlapError where it lies elsewhere."""
    grid, other = Grid.of(dsm), Grid.of(picture)
    outer, inner = bounds_on(other, grid) if other.wkt and grid.wkt else other.bounds, grid.bounds
    if not all(min(outer[i + 2], inner[i + 2]) > max(outer[i], inner[i]) for i in (0, 1)):
        raise OverlapError(
            f"The orthophoto '{other.path}' does not lie over the DSM '{grid.path}': choose the one of the same place."
        )
    warper, shown, known = HeightWarper(picture, grid, heights=False), [], 0
    for row in np.unique(np.linspace(0, grid.size[1] - 1, min(grid.size[1], _FEW_ROWS)).astype(int)):
        window = Window(0, int(row), grid.size[0], 1)
        has = np.isfinite(read_heights(dsm, window))
        known += int(has.sum())
        values = warper.read(grid.window(window))
        shown.append(values[has & np.isfinite(values)])
    values = np.concatenate(shown)
    return len(values) / max(known, 1), values
