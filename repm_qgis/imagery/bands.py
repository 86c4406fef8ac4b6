"""Which bands of an image are which colours: what the file says, else what the satellite's vendor is known to write."""

from __future__ import annotations

import re
from typing import List, Optional, Tuple

from osgeo import gdal

from ..contracts.checks import as_text
from .raster import COLOURS, colour_interpretations

_NAMES = ("red", "green", "blue")
_NOT_PLAIN = ("edge", "coastal", "deep")  # words of bands that are called after a colour and are not it
# The order of bands in vendors' files, by the satellites' names (imagery/sensors.py) and the number of bands.
_RED_FIRST = re.compile(r"Pleiades|SPOT [67]")  # red, green, blue, near infrared: Pleiades Imagery User Guide, 2012
_BLUE_FIRST = re.compile(r"WorldView|GeoEye|QuickBird|IKONOS|KOMPSAT|SkySat|ZY-3|GF-7")  # blue, green, red, ...
_COASTAL_FIRST = re.compile(r"WorldView-[23]")  # eight bands: coastal, blue, green, yellow, red, ...


def natural_bands(dataset: gdal.Dataset, sensor: str = "") -> Optional[Tuple[int, int, int]]:
    """The numbers of an image's red, green and blue bands; None where nothing says which they are.

    ``sensor`` is the satellite's name as in ``imagery/sensors.py``, "" where it is unknown.
    """
    meanings = colour_interpretations(dataset)
    if all(colour in meanings for colour in COLOURS):
        red, green, blue = (meanings.index(colour) + 1 for colour in COLOURS)
        return red, green, blue
    described = [_colour_of(as_text(dataset.GetRasterBand(band + 1).GetDescription())) for band in range(len(meanings))]
    if all(described.count(name) == 1 for name in _NAMES):
        red, green, blue = (described.index(name) + 1 for name in _NAMES)
        return red, green, blue
    count = len(intensity_bands(dataset))
    if count in (3, 4) and _RED_FIRST.match(sensor):
        return 1, 2, 3
    if count == 4 and _BLUE_FIRST.match(sensor):
        return 3, 2, 1
    if count == 8 and _COASTAL_FIRST.match(sensor):
        return 5, 3, 2
    return None


def intensity_bands(dataset: gdal.Dataset) -> List[int]:
    """The numbers of the bands that show something: all but alpha and palette bands."""
    without = (gdal.GCI_AlphaBand, gdal.GCI_PaletteIndex)
    return [band for band, meaning in enumerate(colour_interpretations(dataset), start=1) if meaning not in without]


def band_name(dataset: gdal.Dataset, band: int) -> str:
    """What the file calls a band, or its number."""
    return as_text(dataset.GetRasterBand(band).GetDescription()) or f"band {band}"


def _colour_of(description: str) -> str:
    """The colour that a band's description names; "" for none."""
    words = set(re.findall(r"[a-z]+", description.lower()))
    found = [name for name in _NAMES if name in words]
    return found[0] if len(found) == 1 and not words & set(_NOT_PLAIN) else ""
