"""Which bands of an image are which colours: what the file says, else what the satellite's vendor is known to write."""

from __future__ import annotations

import re
from typing import List, Optional, Sequence, Tuple

from osgeo import gdal

from ..contracts.checks import as_text
from .raster import COLOURS, colour_interpretations

_NAMES = ("red", "green", "blue")
_INFRARED = "near infrared"
_GDALS_INFRARED = getattr(gdal, "GCI_NIRBand", -1)  # since GDAL 3.10
_NOT_PLAIN = ("edge", "coastal", "deep")  # words of bands that are called after a colour and are not it
_NEAR_INFRARED = re.compile(r"\b(?:nir|near[-_ ]?infra[-_ ]?red)(?:[-_ ]?1)?\b(?![-_ ]?2)", re.ASCII)
# The order of bands in vendors' files, by the satellites' names (imagery/sensors.py) and the number of bands.
_RED_FIRST = re.compile(r"Pleiades|SPOT [67]")  # red, green, blue, near infrared: Pleiades Imagery User Guide, 2012
_BLUE_FIRST = re.compile(r"WorldView|GeoEye|QuickBird|IKONOS|KOMPSAT|SkySat|ZY-3|GF-7")  # blue, green, red, ...
_COASTAL_FIRST = re.compile(r"WorldView-[23]")  # eight bands: coastal, blue, green, yellow, red, ...
_ORDERS = (
    (_RED_FIRST, ("red", "green", "blue")),
    (_RED_FIRST, ("red", "green", "blue", _INFRARED)),
    (_BLUE_FIRST, ("blue", "green", "red", _INFRARED)),
    (_COASTAL_FIRST, ("coastal", "blue", "green", "yellow", "red", "red edge", _INFRARED, "near infrared 2")),
)


def natural_bands(dataset: gdal.Dataset, sensor: str = "") -> Optional[Tuple[int, int, int]]:
    """The numbers of an image's red, green and blue bands; None where nothing says which they are.

    ``sensor`` is the satellite's name as in ``imagery/sensors.py``, "" where it is unknown.
    """
    meanings = colour_interpretations(dataset)
    if all(colour in meanings for colour in COLOURS):
        red, green, blue = (meanings.index(colour) + 1 for colour in COLOURS)
        return red, green, blue
    described = [_colour_of(text) for text in _descriptions(dataset)]
    order = described if all(described.count(name) == 1 for name in _NAMES) else _vendors_order(dataset, sensor)
    if not order:
        return None
    red, green, blue = (order.index(name) + 1 for name in _NAMES)
    return red, green, blue


def water_bands(dataset: gdal.Dataset, sensor: str = "") -> Optional[Tuple[int, int]]:
    """The numbers of an image's green and near infrared bands, which tell water from land; None where nothing says
    which they are. ``sensor`` is as in :func:`natural_bands`."""
    natural, infrared = natural_bands(dataset, sensor), _infrared_band(dataset, sensor)
    green = natural[1] if natural else _described(dataset, "green")
    return (green, infrared) if green and infrared and infrared != green else None


def vegetation_bands(dataset: gdal.Dataset, sensor: str = "") -> Optional[Tuple[int, int]]:
    """The numbers of an image's red and near infrared bands, which tell plants from all else, as :func:`water_bands`
    gives others."""
    natural, infrared = natural_bands(dataset, sensor), _infrared_band(dataset, sensor)
    red = natural[0] if natural else _described(dataset, "red")
    return (red, infrared) if red and infrared and infrared != red else None


def _described(dataset: gdal.Dataset, colour: str) -> int:
    """The number of the band that is called after a colour; 0 where there is none, or there are several."""
    found = [index for index, text in enumerate(_descriptions(dataset), start=1) if _colour_of(text) == colour]
    return found[0] if len(found) == 1 else 0


def _infrared_band(dataset: gdal.Dataset, sensor: str) -> int:
    """The number of the near infrared band; 0 where nothing says which one it is."""
    order = _vendors_order(dataset, sensor)
    found = [i for i, text in enumerate(_descriptions(dataset), start=1) if _NEAR_INFRARED.search(text.lower())]
    if not found:
        found = [i for i, meaning in enumerate(colour_interpretations(dataset), start=1) if meaning == _GDALS_INFRARED]
    if not found and _INFRARED in order:
        found = [order.index(_INFRARED) + 1]
    return found[0] if len(found) == 1 else 0


def _vendors_order(dataset: gdal.Dataset, sensor: str) -> Sequence[str]:
    """What the satellite's vendor is known to write into the bands, in their order; empty where that is unknown."""
    count = len(intensity_bands(dataset))
    return next((order for known, order in _ORDERS if len(order) == count and known.match(sensor)), ())


def _descriptions(dataset: gdal.Dataset) -> List[str]:
    return [as_text(dataset.GetRasterBand(band).GetDescription()) for band in range(1, dataset.RasterCount + 1)]


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
