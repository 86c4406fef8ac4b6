"""Heights of a raster in metres: the one reader of DSMs, DEMs and references, whatever form the file has them in.

A band may hold numbers that become heights by a scale and an offset (GDAL's, as in scaled integers), in the unit that
the band or else its vertical CRS states.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Iterator, List, NamedTuple, Optional, Tuple

import numpy as np
import pyproj
from osgeo import gdal
from pyproj.exceptions import CRSError

from ..contracts.arrays import FloatImage, Size, Window
from ..contracts.checks import as_text
from ..contracts.errors import ImageError
from ..geometry.height_causes import FOOT_M
from ..geometry.vertical import DEVIATION_TAG, metres_per_unit
from . import raster

LOWEST_M, HIGHEST_M = -12000.0, 9000.0
"""Numbers below or above are no heights of the Earth's surface: the Challenger Deep lies at -10935 m, Everest's summit
at 8849 m, and ellipsoid and geoid are at most 107 m apart. Voids are such numbers: 32767, -32768, 3.4e38, ..."""
_UNDECLARED = (-9999.0, -32768.0, -32767.0)
"""Numbers that writers mean as "none" although the file declares no nodata value, or another one."""
_OURS = "REPM_ENGINE"  # a tag of all our rasters, whose voids are declared
_STRIP_CELLS = 1 << 22  # that are read at once
_SAMPLES, _SAMPLE_CELLS = 8, 512  # windows along each side, and their sides: the share of voids is taken from them
_CONSTANT_CELLS = 20  # that are the same, at least: one cell may be a tower
_CONSTANT_SHARE, _CONSTANT_GAP_M = 5e-4, 20.0  # of the heights, that are the same; and how far all others are
_SURVEY_FOOT = 1200 / 3937
_UNITS = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0),
    **dict.fromkeys(("cm", "centimetre", "centimeter", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimeter", "millimetres", "millimeters"), 0.001),
    **dict.fromkeys(("ft", "foot", "feet"), FOOT_M),
    **dict.fromkeys(("us-ft", "ftus", "us survey foot", "foot_us"), _SURVEY_FOOT),
}


def unit_m(dataset: gdal.Dataset, band: int = 1) -> float:
    """The unit of a band's heights, m: what the band says, else its vertical CRS, else the metre.

    Raises ImageError for a unit that is not known.
    """
    name = as_text(dataset.GetRasterBand(band).GetUnitType() or "")
    if not name:
        return _unit_of_crs(as_text(dataset.GetProjection() or ""))
    if name.strip().lower() not in _UNITS:
        raise ImageError(
            f"'{dataset.GetDescription()}' has heights in '{name}': convert them to metres first (gdal_calc)."
        )
    return _UNITS[name.strip().lower()]


@lru_cache(maxsize=64)  # PROJ takes milliseconds, and blocks ask again and again
def _unit_of_crs(wkt: str) -> float:
    try:
        return (metres_per_unit(pyproj.CRS.from_user_input(wkt)) or 1.0) if wkt else 1.0
    except CRSError:  # whoever needs the CRS reports the error
        return 1.0


def scaling(dataset: gdal.Dataset, band: int = 1) -> Tuple[float, float]:
    """Factor and addition that make a band's numbers values in its unit; raises ImageError for what is no scale."""
    handle = dataset.GetRasterBand(band)
    scale, offset = handle.GetScale(), handle.GetOffset()
    factor, added = 1.0 if scale is None else float(scale), 0.0 if offset is None else float(offset)
    if not (math.isfinite(factor) and math.isfinite(added) and factor):
        raise ImageError(
            f"'{dataset.GetDescription()}' has a band scale of {factor:g} and an offset of {added:g}, which give no "
            "heights: correct them (gdal_edit -scale, -offset)."
        )
    return factor, added


def to_metres(dataset: gdal.Dataset, band: int = 1) -> Tuple[float, float]:
    """Factor and addition that make a band's numbers metres; raises ImageError as :func:`unit_m` and :func:`scaling`
    do."""
    (factor, added), unit = scaling(dataset, band), unit_m(dataset, band)
    return factor * unit, added * unit


def read_heights(
    dataset: gdal.Dataset, window: Optional[Window] = None, band: int = 1, size: Optional[Size] = None
) -> FloatImage:
    """Heights of a band in metres (rows, columns), NaN where there is none.

    -9999 and the like count as none, but where a declared nodata value comes with a scale; and numbers that cannot be
    heights never count.
    ``size`` (columns, rows) reads means, as :func:`~repm_qgis.imagery.raster.read` does, without what does not count.
    Raises ImageError for a damaged file, an unknown unit or no scale.
    """
    if size is not None and void_share(dataset, window, band):
        return _means(dataset, window or Window(0, 0, dataset.RasterXSize, dataset.RasterYSize), band, size)
    plain = scaling(dataset, band) == (1.0, 0.0)
    return _possible(_scaled(_known(dataset, window, band, size, plain), to_metres(dataset, band)))


def void_share(dataset: gdal.Dataset, window: Optional[Window] = None, band: int = 1) -> float:
    """The share of a band's cells (0..1, of a window's) with numbers that are no heights, and that no nodata value
    declares: :func:`read_heights` leaves them out. Reads all cells but those of our own rasters, which have none."""
    if dataset.GetMetadataItem(_OURS):
        return 0.0
    voids = 0
    whole = window or Window(0, 0, dataset.RasterXSize, dataset.RasterYSize)
    for strip in _strips(whole):
        stated = np.isfinite(raster.read(dataset, strip, band))
        voids += int((stated & ~np.isfinite(read_heights(dataset, strip, band))).sum())
    return voids / max(whole.width * whole.height, 1)


def stated_deviation(dataset: gdal.Dataset) -> Optional[float]:
    """The standard deviation of the absolute height that a raster states, m; None where it states none, or nonsense."""
    try:
        found = float(as_text(dataset.GetMetadataItem(DEVIATION_TAG) or ""))
    except ValueError:
        return None
    return found if 0.0 <= found < math.inf else None


class StrayNumbers(NamedTuple):
    """Shares of a band's cells (0..1) with numbers that cannot be heights (``impossible``), with those that mean "none"
    although no nodata value declares them (``marked``), and with one height, ``constant_m``, that lies far from all
    others: a void that could be a height (``constant``). ``possible`` is the share of what can be heights."""

    impossible: float = 0.0
    marked: float = 0.0
    constant: float = 0.0
    constant_m: float = 0.0
    possible: float = 1.0


def stray_numbers(dataset: gdal.Dataset, band: int = 1) -> StrayNumbers:
    """What a band has beside heights; of large rasters by evenly spread windows."""
    if dataset.GetMetadataItem(_OURS):
        return StrayNumbers()
    windows = _spread(Window(0, 0, dataset.RasterXSize, dataset.RasterYSize))
    values = np.concatenate([raster.read(dataset, window, band).ravel() for window in windows])
    stated = np.isfinite(values)
    plain = scaling(dataset, band) == (1.0, 0.0) or dataset.GetRasterBand(band).GetNoDataValue() is None
    marked = stated & np.isin(values, _UNDECLARED) & plain
    heights = _possible(_scaled(values, to_metres(dataset, band)))
    left = np.isfinite(heights)
    share, constant_m = _constant(heights[left & ~marked], values[left & ~marked])
    impossible = float((stated & ~marked & ~left).mean())
    possible = float((left & ~marked).mean())
    return StrayNumbers(impossible, float(marked.mean()), share * possible, constant_m, possible)


def _constant(heights: FloatImage, numbers: FloatImage) -> Tuple[float, float]:
    """The share of (N,) heights that are exactly the lowest or the highest, where many are and the next one is far; and
    that height, m. Their ``numbers`` in the file are whole ones: a level roof hardly has such a height."""
    for end in (np.min, np.max):
        if heights.size:
            value = end(heights)
            if end(numbers) != np.rint(end(numbers)):
                continue
            others = heights[heights != value]
            share = 1.0 - others.size / heights.size
            many = heights.size - others.size >= _CONSTANT_CELLS and share > _CONSTANT_SHARE
            if many and others.size and abs(end(others) - value) > _CONSTANT_GAP_M:
                return share, float(value)
    return 0.0, 0.0


def _spread(whole: Window) -> List[Window]:
    """All of a raster, or a few windows on it: single cells all over it would take as long as all of them."""
    if whole.width * whole.height <= _SAMPLES**2 * _SAMPLE_CELLS**2:
        return [whole]
    side = min(_SAMPLE_CELLS, whole.width), min(_SAMPLE_CELLS, whole.height)
    rows, cols = (np.linspace(0, end - own, _SAMPLES).astype(int) for end, own in zip((whole[3], whole[2]), side[::-1]))
    return [Window(int(col), int(row), *side) for row in rows for col in cols]


def _strips(window: Window) -> Iterator[Window]:
    rows = max(1, _STRIP_CELLS // max(window.width, 1))
    for row in range(0, window.height, rows):
        yield Window(window.col, window.row + row, window.width, min(rows, window.height - row))


def _means(dataset: gdal.Dataset, window: Window, band: int, size: Size) -> FloatImage:
    """Means of the heights in (columns, rows) nearly equal parts of a window, NaN where a part has none.

    GDAL's own means would have voids in them, which then look like heights.
    """
    columns, rows = min(size[0], window.width), min(size[1], window.height)
    sums, counts = np.zeros((rows, columns)), np.zeros((rows, columns))
    first = np.arange(columns) * window.width // columns
    for strip in _strips(window):
        heights = read_heights(dataset, strip, band).astype(np.float64)
        known = np.isfinite(heights)
        target = (np.arange(strip.height) + strip.row - window.row) * rows // window.height
        np.add.at(sums, target, np.add.reduceat(np.where(known, heights, 0.0), first, axis=1))
        np.add.at(counts, target, np.add.reduceat(known.astype(np.float64), first, axis=1))
    means: FloatImage = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan).astype(np.float32)
    if means.shape == size[::-1]:
        return means
    row, column = np.arange(size[1]) * rows // size[1], np.arange(size[0]) * columns // size[0]
    return np.asarray(means[row[:, None], column])


def read_values(
    dataset: gdal.Dataset, window: Optional[Window] = None, band: int = 1, size: Optional[Size] = None
) -> FloatImage:
    """Values of a band that are no heights, in its own unit, else as :func:`read_heights` gives them."""
    return _scaled(_known(dataset, window, band, size), scaling(dataset, band))


def _known(
    dataset: gdal.Dataset, window: Optional[Window], band: int, size: Optional[Size], always: bool = False
) -> FloatImage:
    """A band's numbers, NaN for those that mean "none": undeclared ones ``always``, or if no nodata value is."""
    values = raster.read(dataset, window, band, size)
    if always or dataset.GetRasterBand(band).GetNoDataValue() is None:
        for value in _UNDECLARED:
            values[values == value] = np.nan
    return values


def _possible(heights: FloatImage) -> FloatImage:
    """Without the numbers that cannot be heights; changes the array."""
    with np.errstate(invalid="ignore"):
        heights[(heights < LOWEST_M) | (heights > HIGHEST_M)] = np.nan
    return heights


def _scaled(values: FloatImage, scale: Tuple[float, float]) -> FloatImage:
    if scale == (1.0, 0.0):
        return values  # to the bit
    factor, added = scale
    heights: FloatImage = (values.astype(np.float64) * factor + added).astype(np.float32)
    return heights
