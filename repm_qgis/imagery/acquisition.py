"""When an image was taken, and by which satellite: from the product's sidecar files, its own metadata, or its name.

Best first, for the time:

1. sidecar files: Airbus's ``DIM_*.XML``, Maxar's ``.IMD`` and ``.XML``, Orfeo ToolBox's ``.geom``;
2. GDAL's readers of vendors' files (``ACQUISITIONDATETIME`` in the domain IMAGERY);
3. a NITF's STDIDC and IDATIM, unless that is the constant that GDAL writes into files of its own;
4. the name of the product, where the vendor is known to write the time (UTC) into it;
5. tags of the image itself (``IMAGING_DATE`` and ``IMAGING_TIME``, and others), which anyone may have written.

TIFFTAG_DATETIME is not used: TIFF 6.0 defines it as the time when the *file* was made, without a time zone, and a wrong
time is worse than none: without times, pairs are chosen by geometry only. A time that cannot be read is unknown, never
an error: only advice and the choice of pairs use it. The satellite is looked for in the same order, and in metadata
that crops keep of their product (a NITF's titles, the GML of a JPEG 2000); unknown, it is "".
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Callable, Iterator, List, Optional, Tuple

from osgeo import gdal

from ..contracts.checks import as_texts
from ..contracts.errors import RpcError
from ..rpc.formats import sidecar_text, xml_texts
from ..rpc.readers import beside, files_in_folder, product_of
from .sensors import sensor_in
from .stac import facts_of

_MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
_MOST_ITEMS = 16  # files that may be STAC items, beside an image
_FIRST_YEAR, _LAST_YEAR = 1972, 2100
_GDALS_OWN = "20021216151629"
_ISO = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)[T ]+(\d\d):(\d\d)(?::(\d\d)(?:[.,](\d{1,9}))?)?\s*(?:Z|UTC|([+-])(\d\d):?(\d\d))?",
    re.ASCII | re.IGNORECASE,
)
_COMPACT = re.compile(r"(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)(?:\.?(\d{1,9}))?", re.ASCII)
_NITF20 = re.compile(r"(\d\d)(\d\d)(\d\d)(\d\d)Z([A-Z]{3})(\d\d)", re.ASCII)
_IN_NAMES = (
    re.compile(r"(?:PHR1[AB]|SPOT[67]|PNEO[3-6])_(?:[A-Z-]{1,6}_)?(\d{14}\d?)(?!\d)", re.ASCII | re.IGNORECASE),
    re.compile(r"^(20\d{6})_(\d{6})_(?:ssc?\d|(?:\d\d_)?[0-9a-f]{4}_)", re.ASCII),  # SkySat, PlanetScope
    re.compile(r"(?<!\d)(20\d{6})T(\d{6})Z", re.ASCII),
)
_MAXAR_NAME = re.compile(rf"(\d\d)({'|'.join(_MONTHS)})(\d\d)(\d{{6}})-[A-Z]\d[A-Z]{{2}}", re.ASCII)
_IMD = re.compile(r"^\s*(firstLineTime|TLCTime)\s*=\s*\"?([^;\"\s]{1,40})", re.MULTILINE)
_IMD_SENSOR = re.compile(r"^\s*satId\s*=\s*\"?([^;\"\s]{1,40})", re.MULTILINE)
_GEOM_SENSOR = re.compile(r"^(?:support_data\.sensorID|sensor):[ \t]*(\S[^\r\n]{0,40})", re.MULTILINE)
_XML_SENSORS = ("SATID", "SatelliteID", "SATELLITE_NAME", "AUX_SATELLITE_NAME")
_SENSOR_METADATA = (
    ("SATELLITEID", "IMAGERY"),
    ("NITF_STDIDC_MISSION", ""),
    ("NITF_FTITLE", ""),
    ("NITF_IID2", ""),
    ("gml.root-instance", ""),
    ("TIFFTAG_IMAGEDESCRIPTION", ""),
)
_TAGS = (  # of the image: a day or both, and the time of day that may stand beside it
    ("IMAGING_DATE", "IMAGING_TIME"),
    ("ACQUISITIONDATETIME", ""),
    ("ACQUISITION_DATETIME", ""),
    ("ACQUISITION_DATE", "ACQUISITION_TIME"),
    ("DATE_ACQUIRED", "TIME_ACQUIRED"),
    ("ACQUIRED", ""),
)
_GEOM = re.compile(r"^support_data\.(time_range_start|image_date):\s*(\S{1,40})", re.MULTILINE)


def acquired(dataset: gdal.Dataset, path: str) -> str:
    """When an opened image was taken, as ISO 8601 in UTC with milliseconds; "" where it is unknown."""
    for text in _candidates(dataset, path):
        found = moment(text)
        if found is not None:
            return found.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return ""


def sensor_of(dataset: gdal.Dataset, path: str) -> str:
    """Which satellite took an opened image, by its name in ``sensors.SENSORS``; "" where it is unknown."""

    def texts() -> Iterator[str]:
        yield from _in_sidecars(path, _sensors_in_file)
        yield from (platform.replace("-", " ") for _, platform in _in_items(path))
        yield from (dataset.GetMetadataItem(key, domain) or "" for key, domain in _SENSOR_METADATA)
        # Crops that were cut from Airbus's products keep the two fields of their DIM file as tags.
        yield " ".join(dataset.GetMetadataItem(key) or "" for key in ("MISSION", "MISSION_INDEX"))
        yield Path(path).name

    return next(filter(None, map(sensor_in, texts())), "")


def moment(text: str) -> Optional[datetime]:
    """A time in UTC from ISO 8601, ``CCYYMMDDhhmmss`` (more digits are fractions) or NITF 2.0's ``DDHHMMSSZMONYY``.

    None for anything else, for days that do not exist, and for years outside 1972 to 2100. A time without a zone is
    UTC, as in all products that we know.
    """
    text = str(text)[:64].strip()
    old = _NITF20.fullmatch(text)
    if old and old[5] in _MONTHS:
        century = "19" if int(old[6]) >= 72 else "20"
        text = f"{century}{old[6]}{_MONTHS.index(old[5]) + 1:02d}{old[1]}{old[2]}{old[3]}{old[4]}"
    match = _ISO.fullmatch(text) or _COMPACT.fullmatch(text)
    if not match or not _FIRST_YEAR <= int(match[1]) <= _LAST_YEAR:
        return None
    try:
        year, month, day, hour, minute, second = (int(part or 0) for part in match.groups()[:6])
        found = datetime(year, month, day, hour, minute, second, tzinfo=timezone.utc)
    except ValueError:
        return None
    found += timedelta(microseconds=int((match[7] or "0")[:6].ljust(6, "0")))
    if match.re is _ISO and match[8]:
        offset = timedelta(hours=int(match[9]), minutes=int(match[10]))
        found += -offset if match[8] == "+" else offset
    return found


def time_of_name(path: str) -> str:
    """The time in a product's file name, in a form that :func:`moment` reads; "" for names of other kinds."""
    stem = Path(path).stem
    for pattern in _IN_NAMES:
        match = pattern.search(stem)
        if match:
            return "".join(match.groups())
    match = _MAXAR_NAME.search(stem)
    return f"20{match[1]}{_MONTHS.index(match[2]) + 1:02d}{match[3]}{match[4]}" if match else ""


def time_sidecars(path: str) -> List[str]:
    """Sidecar files that may state when an image was taken and by which satellite, by their names, those of whole
    products first."""
    image = Path(path)
    core, stem = product_of(image), image.stem
    # Names of Pleiades Neo's images have the band after the name that the product's own file has.
    products = (core, re.sub(r"_[A-Za-z-]+$", "", core))
    names = [*(f"DIM_{name}.XML" for name in products), *(f"{stem}{ending}" for ending in (".IMD", ".XML", ".geom"))]
    there, keys = files_in_folder(image), dict.fromkeys(name.lower() for name in names)
    return [beside(image, name) for key in keys for name in there.get(key, ())]


def duration_text(days: Optional[float]) -> str:
    """A time between two images in a suitable unit; "unknown" for None."""
    if days is None:
        return "unknown"
    for unit, seconds, most in (("s", 1, 120), ("min", 60, 120), ("h", 3600, 48)):
        if days * 86400 < most * seconds:
            return f"{days * 86400 / seconds:.0f} {unit}"
    return f"{days:.0f} days"


def _candidates(dataset: gdal.Dataset, path: str) -> Iterator[str]:
    """Texts that may be the time, best first; files are opened only when they are needed."""
    yield from _in_sidecars(path, _times_in_file)
    yield dataset.GetMetadataItem("ACQUISITIONDATETIME", "IMAGERY") or ""
    for key in ("NITF_STDIDC_ACQUISITION_DATE", "NITF_IDATIM"):
        text = dataset.GetMetadataItem(key) or ""
        if text != _GDALS_OWN:
            yield text
    yield from (when for when, _ in _in_items(path))
    yield time_of_name(path)
    for domain in ("", "IMAGERY"):
        tags = {
            name.upper().removeprefix("TIFFTAG_"): text for name, text in as_texts(dataset.GetMetadata(domain)).items()
        }
        for day, time in _TAGS:
            yield f"{tags.get(day, '').strip()}T{tags[time].strip()}" if time in tags else tags.get(day, "")


def _in_items(path: str) -> Iterator[Tuple[str, str]]:
    """(time, platform) of an image by the STAC items that lie beside it and name it."""
    there = files_in_folder(Path(path))
    files = [beside(Path(path), name) for key in sorted(there) if key.endswith(".json") for name in there[key]]
    yield from facts_of(path, files[:_MOST_ITEMS])


def _in_sidecars(path: str, texts_of: Callable[[str, str], List[str]]) -> Iterator[str]:
    """What a function (of a file's path and its text) finds in the sidecar files of an image, one after the other."""
    for file in time_sidecars(path):
        try:
            yield from texts_of(file, sidecar_text(file))
        except RpcError:  # too large, or not a text or XML
            continue


def _sensors_in_file(path: str, text: str) -> List[str]:
    """Texts of a product's file that may name the satellite."""
    if text.lstrip().startswith("<"):
        found = xml_texts(text, ("MISSION", "MISSION_INDEX", *_XML_SENSORS))
        whole = [f"{name.strip()} {index.strip()}" for name, index in zip(found["MISSION"], found["MISSION_INDEX"])]
        return [*whole, *(value for name in _XML_SENSORS for value in found[name])][:64]
    pattern = _GEOM_SENSOR if path.lower().endswith(".geom") else _IMD_SENSOR
    return pattern.findall(text)[:64]


def _times_in_file(path: str, text: str) -> List[str]:
    """Texts of a product's file that may be the time."""
    if text.lstrip().startswith("<"):
        names = ("IMAGING_DATE", "IMAGING_TIME", "START", "TIME", "FIRSTLINETIME", "TLCTIME")
        found = xml_texts(text, names)
        whole = [f"{day.strip()}T{time.strip()}" for day, time in zip(found["IMAGING_DATE"], found["IMAGING_TIME"])]
        return [*whole, *(value for name in names[2:] for value in found[name])][:64]
    pattern = _GEOM if path.lower().endswith(".geom") else _IMD
    found_lines = dict(reversed(pattern.findall(text)))
    order = ("time_range_start", "image_date", "firstLineTime", "TLCTime")
    return [found_lines[name] for name in order if name in found_lines]
