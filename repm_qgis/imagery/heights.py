"""Heights of a raster in metres: the one reader of DSMs, DEMs and references, whatever form the file has them in.

A band may hold numbers that become heights by a scale and an offset (GDAL's, as in scaled integers), in the unit that
the band or else its vertical CRS states.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Optional, Tuple

import numpy as np
import pyproj
from osgeo import gdal
from pyproj.exceptions import CRSError

from ..contracts.arrays import FloatImage, Size, Window
from ..contracts.checks import as_text
from ..contracts.errors import ImageError
from ..geometry.vertical import metres_per_unit
from . import raster

_UNDECLARED = (-9999.0, -32768.0, -32767.0)
"""Heights that writers mean as "none" although the file declares no nodata value."""
_FOOT, _SURVEY_FOOT = 0.3048, 1200 / 3937
_UNITS = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0),
    **dict.fromkeys(("cm", "centimetre", "centimeter", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimeter", "millimetres", "millimeters"), 0.001),
    **dict.fromkeys(("ft", "foot", "feet"), _FOOT),
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

    -9999 and the like count as none if no nodata value is declared. ``size`` (columns, rows) reads means, as
    :func:`~repm_qgis.imagery.raster.read` does. Raises ImageError for a damaged file, an unknown unit or no scale.
    """
    return _scaled(_known(dataset, window, band, size), to_metres(dataset, band))


def read_values(
    dataset: gdal.Dataset, window: Optional[Window] = None, band: int = 1, size: Optional[Size] = None
) -> FloatImage:
    """Values of a band that are no heights, in its own unit, else as :func:`read_heights` gives them."""
    return _scaled(_known(dataset, window, band, size), scaling(dataset, band))


def _known(dataset: gdal.Dataset, window: Optional[Window], band: int, size: Optional[Size]) -> FloatImage:
    values = raster.read(dataset, window, band, size)
    if dataset.GetRasterBand(band).GetNoDataValue() is None:
        for value in _UNDECLARED:
            values[values == value] = np.nan
    return values


def _scaled(values: FloatImage, scale: Tuple[float, float]) -> FloatImage:
    if scale == (1.0, 0.0):
        return values  # to the bit
    factor, added = scale
    heights: FloatImage = (values.astype(np.float64) * factor + added).astype(np.float32)
    return heights
