"""The meaning of a confidence raster's bands, in our rasters and in those of other programs."""

from __future__ import annotations

from enum import IntEnum
from typing import List, NamedTuple

from osgeo import gdal

from ..contracts.checks import as_text
from ..contracts.errors import ImageError


class Provenance(IntEnum):
    """Where a height comes from: the values of the band ``source``."""

    MATCHED = 0
    BACKGROUND = 1
    INTERPOLATED = 2
    INTERPOLATED_ON_DEM = 3
    SHADOW = 4
    NEIGHBOURS = 5
    EDITED = 6
    WATER = 7


CONFIDENCE_BANDS = (
    "height maps that agree",
    "spread between them (m)",
    "mean matching score",
    "source: 0 matched, 1 background of an occlusion, 2 interpolated, 3 interpolated on the DEM, "
    "4 ground in a shadow, 5 taken from neighbouring cells, 6 edited by hand, 7 level of the water",
    "expected error (m): two of three errors are smaller",
    "LE90 (m): nine of ten errors are smaller, apart from the error that all heights share",
)
SOURCE_BAND, ERROR_BAND = 4, 5
_SOURCE, _ERROR = CONFIDENCE_BANDS[SOURCE_BAND - 1].split(":")[0], CONFIDENCE_BANDS[ERROR_BAND - 1].split(" (")[0]


class ConfidenceBands(NamedTuple):
    """The bands of a file, from 1: the expected error of each height in metres, its source, and how many height maps
    agree; 0 where that is not stated."""

    error: int
    source: int
    maps: int


def confidence_bands(dataset: gdal.Dataset, option: str) -> ConfidenceBands:
    """The bands by their names; a raster of one band is one of errors.

    Raises ImageError, with the option's name, where there are several bands and none has the name of the errors.
    """
    names: List[str] = [as_text(dataset.GetRasterBand(i).GetDescription()) for i in range(1, dataset.RasterCount + 1)]
    error, source, maps = (
        next((band for band, name in enumerate(names, start=1) if name.startswith(wanted)), 0)
        for wanted in (_ERROR, _SOURCE, CONFIDENCE_BANDS[0])
    )
    if not error and len(names) > 1:
        raise ImageError(
            f"'{dataset.GetDescription()}' of {option} has {len(names)} bands, and none is called '{_ERROR}': give the "
            "confidence raster of the DSM, or one band of errors."
        )
    return ConfidenceBands(error=error or 1, source=source, maps=maps)
