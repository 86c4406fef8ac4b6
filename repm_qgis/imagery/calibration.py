"""What the digital numbers of a multispectral image's bands mean, so that bands can be compared with one another.

Airbus's DIMAP has for each band a gain and a bias (radiance = DN / gain + bias) and the sun's irradiance, or gain and
bias of reflectances (Pleiades Imagery User Guide, 2012). Maxar's IMD and XML have a factor and a bandwidth (radiance =
DN factor / bandwidth; Kuester 2017, "Radiometric use of WorldView-3 imagery"). Otherwise the scale and the offset that
the file itself gives its bands are used, such as those of surface reflectances.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

from osgeo import gdal

from ..contracts.errors import RpcError
from ..rpc.formats import sidecar_text, xml_inside
from .acquisition import time_sidecars

# The sun's irradiance in the middle of each band, W / m2 / um, rounded from those of Pleiades and WorldView-2, which
# differ by 1 %: only bands' ratios count here.
SUN = {"green": 1840.0, "near infrared": 1065.0}
_AIRBUS = {"green": ("B1", "G", "GREEN"), "near infrared": ("B3", "NIR")}
_MAXAR = {"green": ("BAND_G",), "near infrared": ("BAND_N", "BAND_N1")}
_MOST_BANDS = 64
_NUMBER = re.compile(r"[+-]?\d{1,9}(?:\.\d{0,18})?(?:[eE][+-]?\d{1,3})?", re.ASCII)
_GROUP = re.compile(r"BEGIN_GROUP\s*=\s*(BAND_\w{1,4})\b(.{0,4000}?)END_GROUP", re.ASCII | re.DOTALL)


@dataclass(frozen=True)
class Calibration:
    """The gain and the offset of each band that make digital numbers comparable: reflectances at the top of the
    atmosphere, but for a factor that all bands have in common."""

    gains: Tuple[float, ...]
    offsets: Tuple[float, ...]


def calibration(dataset: gdal.Dataset, path: str, bands: Dict[str, int]) -> Optional[Calibration]:
    """The calibration of an opened image's bands, by their names in ``SUN`` and numbers; None where neither the
    product's files nor the image have it. Files that cannot be read are ignored."""
    names = tuple(bands)
    for file in time_sidecars(path):
        try:
            text = sidecar_text(file)
            if text.lstrip().startswith("<"):
                found = _in_dimap(text, names) or _in_groups(list(_xml_groups(text, names)), names)
            else:
                found = _in_groups([(group.upper(), _imd_texts(body)) for group, body in _GROUP.findall(text)], names)
        except RpcError:  # too large, or not a text or XML
            continue
        if found is not None:
            return found
    handles = [dataset.GetRasterBand(number) for number in bands.values()]
    scales = [(handle.GetScale(), handle.GetOffset()) for handle in handles]
    if any(scale is None or not _usable(scale) for scale, _ in scales):
        return None
    offsets = tuple(float(offset or 0.0) for _, offset in scales)
    return Calibration(gains=tuple(float(scale) for scale, _ in scales), offsets=offsets)


def _in_dimap(text: str, names: Sequence[str]) -> Optional[Calibration]:
    """Airbus's: lists of the bands' measurements, in which each has the band's name before its values."""
    for kind in ("Band_Reflectance", "Band_Radiance"):
        ids, gains, biases = (xml_inside(text, kind, field)[:_MOST_BANDS] for field in ("BAND_ID", "GAIN", "BIAS"))
        if not ids or not len(ids) == len(gains) == len(biases):
            continue
        suns = [xml_inside(text, "Band_Solar_Irradiance", field)[:_MOST_BANDS] for field in ("BAND_ID", "VALUE")]
        lights = dict(zip(*suns)) if len(suns[0]) == len(suns[1]) else {}
        found: List[Tuple[float, float]] = []
        for name in names:
            place = next((index for index, band in enumerate(ids) if band.strip().upper() in _AIRBUS[name]), None)
            gain, bias = (_number(each[place]) if place is not None else None for each in (gains, biases))
            if gain is None or bias is None or not _usable(gain) or not abs(bias) < 1e9:
                break
            light = 1.0
            if kind == "Band_Radiance" and place is not None:
                stated = _number(lights.get(ids[place], ""))
                light = stated if stated is not None and _usable(stated) else SUN[name]
            found.append((1.0 / gain / light, bias / light))
        else:
            return Calibration(gains=tuple(gain for gain, _ in found), offsets=tuple(offset for _, offset in found))
    return None


def _in_groups(groups: Sequence[Tuple[str, Tuple[str, str]]], names: Sequence[str]) -> Optional[Calibration]:
    """Maxar's: a group for each band, with its factor and its bandwidth."""
    found: List[float] = []
    for name in names:
        own = [texts for group, texts in groups if group in _MAXAR[name]]
        factor, width = (_number(text) for text in own[0]) if own else (None, None)
        if factor is None or width is None or not (_usable(factor) and _usable(width)):
            return None
        found.append(factor / width / SUN[name])
    return Calibration(tuple(found), (0.0,) * len(found))


def _xml_groups(text: str, names: Sequence[str]) -> Iterator[Tuple[str, Tuple[str, str]]]:
    for group in (group for name in names for group in _MAXAR[name]):
        factors, widths = (xml_inside(text, group, field) for field in ("ABSCALFACTOR", "EFFECTIVEBANDWIDTH"))
        if factors and widths:
            yield group, (factors[0], widths[0])


def _imd_texts(body: str) -> Tuple[str, str]:
    """The factor and the bandwidth in a group of an IMD file."""
    fields = dict(re.findall(r"(absCalFactor|effectiveBandwidth)\s*=\s*\"?([^\";\r\n]{1,40})", body))
    return fields.get("absCalFactor", ""), fields.get("effectiveBandwidth", "")


def _number(text: str) -> Optional[float]:
    text = text.strip()
    return float(text) if _NUMBER.fullmatch(text) else None


def _usable(value: float) -> bool:
    return math.isfinite(value) and 1e-9 < value < 1e9
