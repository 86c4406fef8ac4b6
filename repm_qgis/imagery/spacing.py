"""The ground sampling distance that an image itself states, in its metadata or by its place on a map."""

from __future__ import annotations

import math
import re
from typing import Iterator, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from ..contracts.checks import as_text, as_texts
from ..geometry.frames import EnuFrame, geodetic_from_projected

_INCH_M = 0.0254
# Tags of the image itself. A product's files beside it speak of the whole product, which the image may be reduced from.
_ITEMS = (
    ("GSD", 1.0),
    ("MEAN_GSD", 1.0),
    ("GROUND_SAMPLE_DISTANCE", 1.0),
    ("GROUND_SAMPLING_DISTANCE", 1.0),
    ("NITF_USE00A_MEAN_GSD", _INCH_M),
    ("NITF_PIAIMC_MEANGSD", _INCH_M),
)
_LENGTH = re.compile(r"\+?(\d{1,6}(?:\.\d{0,12})?|\.\d{1,12})\s*(?:m|metres?|meters?)?", re.ASCII | re.IGNORECASE)


def stated_spacings(dataset: gdal.Dataset) -> Iterator[Tuple[float, str]]:
    """Each ground sampling distance (m, geometric mean of both axes) that an opened image states, and where it does.

    From metadata (a NITF's are in inches: STDI-0002, USE00A and PIAIMC), and from a geotransform with a CRS, at the
    image's middle. A NITF's geotransform is not used: it is made of corners that are rounded to seconds of arc.
    """
    for domain in ("", "IMAGERY"):
        items = {name.upper(): text for name, text in as_texts(dataset.GetMetadata(domain)).items()}
        for name, unit in _ITEMS:
            match = _LENGTH.fullmatch(items.get(name, "").strip())
            if match and float(match[1]) > 0:
                yield float(match[1]) * unit, f"its metadata item {name}"
    metres = _on_the_map(dataset)
    if math.isfinite(metres) and metres > 0:
        yield metres, "its geotransform"


def _on_the_map(dataset: gdal.Dataset) -> float:
    """The distance of neighbouring pixels on the map that an image lies on, m; NaN where it lies on none."""
    place, crs = dataset.GetGeoTransform(can_return_null=True), as_text(dataset.GetProjection())
    if not place or not crs or dataset.GetDriver().ShortName == "NITF" or tuple(map(abs, place)) == (0, 1, 0, 0, 0, 1):
        return math.nan
    pixels = np.array([dataset.RasterXSize, dataset.RasterYSize]) / 2 + np.array([[0, 0], [1, 0], [0, 1]])
    try:
        lon_lat = geodetic_from_projected(crs, pixels @ np.array([place[1:3], place[4:6]]).T + [place[0], place[3]])
    except pyproj.exceptions.ProjError:  # a CRS of its own, which lies nowhere on the Earth
        return math.nan
    if not np.isfinite(lon_lat).all():
        return math.nan
    ground = np.column_stack([lon_lat, np.zeros(3)])
    east_north = EnuFrame(*map(float, lon_lat[0])).from_geodetic(ground)[:, :2]
    return math.sqrt(abs(float(np.linalg.det(east_north[1:] - east_north[0]))))
