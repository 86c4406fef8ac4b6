"""Whether a class raster belongs to the reference whose heights it names.

What stands on the ground has classes of its own, so the heights within a class vary least where the raster lies at its
place. Heights within districts vary as much wherever these lie: such rasters have no finding. Classes as narrow as
houses that explain nothing of the heights of a town are those of another one, or are flipped.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatArray
from ..contracts.errors import OverlapError
from ..contracts.findings import Finding, as_percent
from ..evaluation.classes import ClassRaster
from ..evaluation.comparison import sample_windows
from ..evaluation.grids import Grid, cell_metres, cell_sides
from ..evaluation.parameters import EVALUATION
from ..imagery.heights import read_heights
from .open_ground import opened_surface
from .parameters import GATE, GateParameters


def class_findings(
    reference: gdal.Dataset, classes: gdal.Dataset, parameters: GateParameters = GATE
) -> Tuple[Finding, ...]:
    """What is to be known of a class raster that is used with a reference: how many of its heights it covers, and
    whether it lies at its place.

    Raises OverlapError where it has no class at any height, ImageError for one that cannot be used.
    """
    grid, path = Grid.of(reference), classes.GetDescription()
    source, cell = ClassRaster(classes, grid), cell_metres(grid)
    known = covered = classed = 0
    misfits: FloatArray = np.zeros(1)
    factor, narrow, raised = 1, False, 0.0
    windows = sample_windows(grid, grid.bounds, EVALUATION.comparison)
    for window in windows:
        heights = read_heights(reference, window)
        kinds, inside = source.read(grid.window(window))
        classed += int((np.isfinite(heights) & np.isfinite(kinds)).sum())
        kinds[inside & np.isnan(kinds)] = np.inf  # a mask's rest is a class, too
        has = np.isfinite(heights)
        known, covered = known + int(has.sum()), covered + int((has & inside).sum())
        coarse, low, factor = opened_surface(heights, cell, parameters)
        rows, columns = (
            np.minimum(np.arange(n) * factor + factor // 2, m - 1) for n, m in zip(coarse.shape, has.shape)
        )
        there, above, side = kinds[np.ix_(rows, columns)], coarse - low, abs(cell[0]) * factor
        misfits = misfits + _misfits(there, above, side, parameters) / len(windows)
        narrow |= _has_narrow(there, side, parameters)
        raised += float(np.mean(above[np.isfinite(above)] > parameters.open_near_m)) / len(windows)
    if known and not classed:
        raise OverlapError(
            f"The class raster '{path}' has no class at any height of '{grid.path}': choose the one of the same place."
        )
    if covered < (1.0 - parameters.most_uncovered) * known:
        text = f"The class raster '{path}' covers {as_percent(covered / known)} of the heights of '{grid.path}'"
        return (Finding("classes-partial", f"{text}: the errors by class are those of this part."),)
    side = max(parameters.open_cell_m, *cell_sides(grid), *cell_sides(source.grid))
    place = np.unravel_index(int(np.argmin(misfits)), misfits.shape)
    steps = [n - size if n > size // 2 else n for n, size in zip(map(int, place), misfits.shape)]
    by = float(np.hypot(steps[0] * cell[1], steps[1] * cell[0])) * factor
    most = min(parameters.displaced_gain * misfits.flat[0], parameters.most_unexplained)
    if by <= max(parameters.most_displaced_m, parameters.most_displaced_cells * side) or misfits[place] >= most:
        if not narrow or raised < parameters.least_raised or misfits.flat[0] < parameters.nothing_explained:
            return ()
        text = f"The classes of '{path}' are as narrow as houses, and explain nothing of the heights of '{grid.path}'"
        return (Finding("classes-other", f"{text}: check that they are of this place, and not flipped.", "doubt"),)
    text = f"The classes of '{path}' fit to the heights of '{grid.path}' better {by:.1f} m beside their place"
    return (Finding("classes-displaced", f"{text}: check the CRS and the place of both.", "doubt"),)


def _has_narrow(kinds: FloatArray, side_m: float, parameters: GateParameters) -> bool:
    """Whether a class (rows, columns; cells of this side, m) has hardly a part as wide as a large house."""
    from scipy import ndimage  # QGIS's own process may lack it

    width = 2 * max(1, round(parameters.narrow_m / 2 / side_m)) + 1
    for kind in np.unique(kinds[~np.isnan(kinds)]):
        inside = kinds == kind
        wide = ndimage.grey_opening(inside.astype(np.uint8), size=(width, width)).sum()
        if inside.mean() >= parameters.least_class and wide <= parameters.most_wide * inside.sum():
            return True
    return False


def _misfits(kinds: FloatArray, above: FloatArray, side_m: float, parameters: GateParameters) -> FloatArray:
    """The sum of the variance within classes for each shift by whole cells, (2r + 1, 2r + 1) with the shift 0 first and
    negative ones last; ``kinds`` and heights ``above`` the ground (rows, columns), cells of this side, m.

    It is a share of the variance of all cells that both have after the shift.
    """
    reach = min(int(parameters.class_search_m / side_m), min(kinds.shape) // 4)
    shape = tuple(size + reach for size in kinds.shape)
    has = np.isfinite(above)
    height = np.where(has, np.minimum(above, parameters.class_height_m), 0.0).astype(np.float64)
    sums = [np.fft.rfft2(values, shape) for values in (has.astype(np.float64), height, height**2)]
    kept = np.concatenate([np.arange(reach + 1), np.arange(-reach, 0)])
    total, within = np.zeros((3, kept.size, kept.size)), np.zeros((kept.size, kept.size))
    for kind in np.unique(kinds[~np.isnan(kinds)]):
        inside = kinds == kind
        if inside.mean() >= parameters.least_class:
            turned = np.conj(np.fft.rfft2(inside.astype(np.float64), shape))
            count, first, second = own = [np.fft.irfft2(each * turned, shape)[np.ix_(kept, kept)] for each in sums]
            within += second - first**2 / np.maximum(count, 0.5)
            total += own
    count, first, second = total
    variance = np.maximum(second - first**2 / np.maximum(count, 0.5), 1e-6 * np.maximum(count, 1.0))
    return np.where(count > 0.5 * count.flat[0], within / variance, 1.0)
