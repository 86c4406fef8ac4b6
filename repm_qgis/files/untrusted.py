"""Checks of files before GDAL opens them, and of rasters before they are read: data may come from anybody. Network
paths work where the user typed them, for the file itself. A file that came with data must not lead to the network, and
must not claim more pixels than it can hold.
"""

from __future__ import annotations

import ntpath
import os
import re
import stat
from functools import lru_cache
from itertools import islice
from typing import Dict, List, Optional, Sequence, Tuple
from xml.parsers import expat  # declarations of types, and so of entities, are refused

from osgeo import gdal

from ..contracts.arrays import Window
from ..contracts.checks import INLINE
from ..contracts.paths import real_path
from ..runtime.workspace import file_identity

# Formats of files with pixels or shapes, and of files that list such files. None of them is a service of the network,
# runs programs, or names files of any other format; VRT does, and is looked through.
RASTERS = (
    "GTiff VRT NITF JP2OpenJPEG JP2KAK JP2ECW JP2MrSID JPEG2000 ECW MrSID HFA ENVI EHdr PCIDSK DIMAP TIL RPFTOC "
    "ECRGTOC SENTINEL2 netCDF HDF4 HDF4Image HDF5 HDF5Image GPKG MBTiles AAIGrid GRASSASCIIGrid AIG SRTMHGT DTED "
    "USGSDEM BAG SAGA GSAG GSBG GS7BG XYZ PCRaster ILWIS RST RRASTER GTX NTv2 FITS PNG JPEG BMP GIF WEBP PNM"
).split()
VECTORS = (
    "GPKG,ESRI Shapefile,GeoJSON,GeoJSONSeq,FlatGeobuf,SQLite,CSV,MapInfo File,OpenFileGDB,KML,LIBKML,GPX,DXF,"
    "Parquet,Arrow"
).split(",")
_PARTS = ("GTIFF_DIR", "NITF_IM", "HDF4_SDS", "HDF5", "NETCDF", "GPKG")  # parts of files: format, colon, file, part
_FILE_KEYS = {"X_DATASET": "GEOLOCATION", "Y_DATASET": "GEOLOCATION", "OVERVIEW_FILE": "OVERVIEWS"}  # with domains

_NETWORK = re.compile(r"/vsi(?!(?:zip|tar|gzip)/)\w*", re.IGNORECASE)  # all of GDAL's file systems but archives
_ARCHIVE = re.compile(r"/vsi(?:zip|tar|gzip)/", re.IGNORECASE)
_REMOTE = re.compile(r"[a-z][a-z0-9+.-]*://", re.IGNORECASE)
_DRIVER = re.compile(r'"?(\w{2,}):', re.ASCII)
_MOST_BYTES = 64 << 20  # of a VRT; those of mosaics with 100,000 parts have 50 MB
_DEEPEST = 8  # VRTs that name each other
_MOST_FILES = 200_000  # that one file leads to; mosaics have 100,000 parts
_MOST_OPENED = 1_000_000  # each counted as often as it is named: mosaics of VRTs with three bands name each part thrice
_MOST_ENTRIES = 100_000  # of a folder that are looked at
_INDEXED = re.compile(rb"(?:DATA_FILE_PATH[^>]{0,200}?href|filename)\s{0,9}=\s{0,9}[\"']([^\"']{0,255})", re.IGNORECASE)
_OTHER_INDEX = re.compile(rb"COMPONENT_TYPE\s{0,9}>\s{0,9}DIMAP", re.IGNORECASE)  # of which a DIMAP volume names images
_MOST_INDEX_BYTES = 16 << 20  # of one with 20,000 tiles; GDAL reads no more of a DIMAP file's text than it holds
_AROUND_NAMES = re.compile(r"^img_|_r\d+c\d+$")  # of image files whose product has one file of metadata for all parts

MOST_SIDE_PX = 1_000_000
"""The longest strips of today's satellites have 720,000 lines: 360 km of 0.5 m."""
_MOST_PX = 50_000_000_000
_HARMLESS_PX = 100_000_000  # read within a second, whatever the file holds
_MOST_PX_A_BYTE = 100_000  # a JPEG 2000 of one value has 35,000, real images have less than 100
_LEAST_SHARE = 1.0  # per cent


def drivers_for(path: str, formats: Sequence[str]) -> List[str]:
    """GDAL's drivers for a file of these formats; none, which GDAL takes as all, for a network path that was typed."""
    return list(formats) if os.path.exists(path) else []


def refusal_of(path: str) -> str:
    """Why a path should not be opened, as the rest of a sentence that begins with it; "" where it may be.

    Not opened are pipes and devices, on which reading would wait, XML and JSON in place of a path, and files that reach
    for the network, run Python, or are in a format that might.
    """
    if path.lstrip().startswith(INLINE):
        return "is a description and not a path: choose a file."
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return _archived_description(path)  # no file of this machine: GDAL opens it, or reports the error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        return "is a pipe or a device, not a file: choose a file."
    return _distrust(*file_identity(path))


@lru_cache(maxsize=4096)
def _distrust(path: str, *_: object) -> str:
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        _look_through(path, 0, {})
    except _DistrustedError as error:
        return str(error)
    except RuntimeError:  # GDAL's, about a file that it cannot open: the error is reported later
        return ""
    finally:
        gdal.PopErrorHandler()
    return ""


def claimed(dataset: gdal.Dataset) -> str:
    """Why an opened raster cannot be what it claims to be, in the form of :func:`refusal_of`; "" where it can.

    Raster files of a few kB can claim billions of pixels: reading them takes as long as if they were there.
    """
    try:
        _look_at_metadata(dataset, os.path.abspath(dataset.GetDescription()), 0, {})
    except _DistrustedError as error:
        return str(error)
    size = f"{dataset.RasterXSize} x {dataset.RasterYSize} px"
    pixels = dataset.RasterXSize * dataset.RasterYSize
    if pixels <= _HARMLESS_PX:
        return ""
    held = [gdal.VSIStatL(file) for file in dataset.GetFileList() or ()]
    total = sum(file.size for file in held if file is not None)
    if total and pixels > total * _MOST_PX_A_BYTE:
        return f"claims {size} and has only {total} bytes, too few for any image: get the file again."
    return ""


def unlike_an_image(dataset: gdal.Dataset) -> str:
    """Why an opened raster is no satellite image, in the form of :func:`refusal_of`; "" where it may be one."""
    width, height = dataset.RasterXSize, dataset.RasterYSize
    if max(width, height) > MOST_SIDE_PX or width * height > _MOST_PX:
        most = f"{MOST_SIDE_PX} px a side and {_MOST_PX:.0e} px in all"
        return f"claims {width} x {height} px, more than any satellite's image ({most}): get the file again."
    return ""


def refusal_of_empty(dataset: gdal.Dataset, part: Optional[Window] = None) -> str:
    """Why a part of an opened raster (None: all of it) is not worth reading, as :func:`refusal_of` says it; "" where it
    is."""
    col, row, width, height = part or (0, 0, dataset.RasterXSize, dataset.RasterYSize)
    if width * height > _HARMLESS_PX:
        flags, share = dataset.GetRasterBand(1).GetDataCoverageStatus(col, row, width, height)[:2]
        if not flags & gdal.GDAL_DATA_COVERAGE_STATUS_UNIMPLEMENTED and 0 <= share < _LEAST_SHARE:
            held = f"claims {width} x {height} px and holds {share:.2g} % of them, the rest of the file is empty"
            return f"{held}: get the file again, crop it to what it holds, or give an EXTENT there."
    return ""


class _DistrustedError(Exception):
    """The rest of a sentence that begins with the path that was given."""


def _look_through(path: str, depth: int, seen: Dict[str, int]) -> int:
    """Raise _DistrustedError for what a file would make GDAL open: itself, what lies beside it, what it names.

    Gives how many files GDAL opens for it, in which a file counts as often as others name it: ten VRTs, each of which
    names the next one ten times, are ten files and ten thousand million openings.
    """
    real = real_path(path)
    if real in seen:
        return seen[real]
    seen[real] = 1  # for files that name each other, which GDAL refuses
    if len(seen) > _MOST_FILES:
        raise _DistrustedError(f"leads to more than {_MOST_FILES} files: make one VRT of the images themselves.")
    opened = 1 + _looked_through(path, depth, seen)
    if opened > _MOST_OPENED:
        raise _DistrustedError(
            f"makes GDAL open more than {_MOST_OPENED} files, as its VRTs name each other many times: make one VRT of "
            "the images themselves."
        )
    seen[real] = opened
    return opened


def _looked_through(path: str, depth: int, seen: Dict[str, int]) -> int:
    """The checks of :func:`_look_through` for a file that it has not seen; how many files it leads to."""
    opened = 0
    if depth > _DEEPEST:
        raise _DistrustedError(f"is a VRT of VRTs more than {_DEEPEST} deep: make one VRT of the images themselves.")
    _refuse_pipes(path)
    for beside in (f"{path}.ovr", f"{path}.msk"):
        if os.path.exists(beside):
            opened += _look_through(beside, depth + 1, seen)
    if os.path.exists(f"{path}.aux.xml"):
        opened += _look_at_xml(f"{path}.aux.xml", depth, seen)
    head = _head(path)
    if b"\0" in head or not head:
        # Binary files hold pixels: only in their metadata can they name other files.
        if depth:  # else whoever opens it looks there
            alone = [os.path.basename(path)]  # without a listing of its folder, which may have as many files as the VRT
            dataset = gdal.OpenEx(path, gdal.OF_RASTER, allowed_drivers=RASTERS, sibling_files=alone)
            if dataset is not None:
                opened += _look_at_metadata(dataset, path, depth, seen)
        return opened
    name, found = _format(path, gdal.OF_RASTER), ""
    if name not in RASTERS:
        found = _format(path, gdal.OF_VECTOR) or name
    if found and found not in VECTORS:
        raise _DistrustedError(
            f"leads to a file of the format {found}, which is not opened here: use the data themselves."
        )
    if name in ("VRT", "DIMAP") or b"<VRTDataset" in head:
        opened += _look_at_xml(path, depth, seen)
    elif name == "TIL":
        _refuse_network(head.decode("latin-1"))
    return opened


def _refuse_pipes(path: str) -> None:
    """Refuse a pipe or a device that has a name as of the files beside an image: GDAL opens these, and would wait."""
    folder, name = os.path.split(os.path.abspath(path))
    core = re.escape(_AROUND_NAMES.sub("", os.path.splitext(name)[0].lower()))
    try:
        found = _pipes_in(folder, os.stat(folder).st_mtime_ns)
    except OSError:  # a folder that cannot be listed: GDAL tries the names themselves
        found = tuple(f"{name}{ending}" for ending in (".ovr", ".msk", ".aux.xml") if _waits(f"{path}{ending}"))
    for pipe in found:
        if re.search(f"(?<![a-z0-9]){core}(?![a-z0-9])", pipe.lower()):
            raise _DistrustedError(f"has the pipe or device '{pipe}' beside it: remove that.")


@lru_cache(maxsize=256)
def _pipes_in(folder: str, _: int) -> Tuple[str, ...]:
    """The pipes and devices in a folder; after a change of the folder's time they are listed again."""
    with os.scandir(folder) as entries:
        some = islice(entries, _MOST_ENTRIES)
        return tuple(sorted(e.name for e in some if not (e.is_file() or e.is_dir()) and _waits(e.path)))


def _waits(path: str) -> bool:
    """Whether something is a pipe or a device, on which reading would wait."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _archived_description(path: str) -> str:
    """Why a path into an archive should not be opened: what lies there names other files, and is not looked through."""
    if not _ARCHIVE.match(path) or _NETWORK.search(path):
        return ""
    head = _archived_bytes(path, 1024)
    index = b"<Dimap_Document" in head or path.lower().endswith(".til")
    safe = _names_tiles_alone(path) if index else not _is_description(head)
    return "" if safe else "is a description in an archive: unpack the archive."


def _archived_bytes(path: str, most: int) -> bytes:
    """The beginning of a file in an archive; nothing where there is no such file."""
    stream = gdal.VSIFOpenL(path, "rb")
    if stream is None:
        return b""
    try:
        return bytes(gdal.VSIFReadL(1, most, stream) or b"")
    finally:
        gdal.VSIFCloseL(stream)


def _is_description(head: bytes) -> bool:
    return head.lstrip().startswith(tuple(mark.encode() for mark in INLINE)) or b"<VRTDataset" in head


def _names_tiles_alone(path: str) -> bool:
    """Whether the index of a product in tiles, in an archive, names files of its own folder that are no descriptions,
    and GDAL opens nothing else because of it."""
    text = _archived_bytes(path, _MOST_INDEX_BYTES)
    names = [name.decode("utf-8", "replace") for name in _INDEXED.findall(text)[:_MOST_ENTRIES]]
    if _OTHER_INDEX.search(text) or b"<VRTDataset" in text or any(re.search(r"[/\\:]", name) for name in names):
        return False
    folder = path.rsplit("/", 1)[0]
    return not any(_is_description(_archived_bytes(f"{folder}/{name}", 1024)) for name in names)


def _format(path: str, kind: int) -> str:
    driver = gdal.IdentifyDriverEx(path, kind)
    return str(driver.ShortName) if driver is not None else ""


def _head(path: str) -> bytes:
    try:
        with open(path, "rb") as stream:
            return stream.read(1024)
    except OSError:
        return b""


def _look_at_xml(path: str, depth: int, seen: Dict[str, int]) -> int:
    """All texts and attributes of a VRT, and of the metadata beside an image, with entities replaced; how many files
    they lead to."""
    try:
        texts = _texts(path)
    except OSError:
        return 0
    except (expat.ExpatError, ValueError) as error:
        raise _DistrustedError(f"leads to '{path}', which cannot be read ({error}): get the file again.") from error
    opened = 0
    for element, key, relative, text in texts:
        if element == "pixelfunctionlanguage" and text.lower() == "python":
            raise _DistrustedError("is a VRT that runs Python: save it as a GeoTIFF.")
        if element in ("mdi", "option"):
            if key in _FILE_KEYS or key == "RPC_DEM":
                opened += _look_at(text, path, depth, seen)
        elif element.startswith("source") or element == "dempath":
            opened += _look_at(text, path, depth, seen, relative)
        else:
            _refuse_network(text)
    return opened


def _texts(path: str) -> List[Tuple[str, str, bool, str]]:
    """Each element's name in lower case, its key, whether it is relative, and its text; attributes have no name."""
    if os.path.getsize(path) > _MOST_BYTES:
        raise ValueError(f"it is larger than {_MOST_BYTES >> 20} MiB")
    found: List[Tuple[str, str, bool, str]] = []
    stack: List[Tuple[str, str, bool, List[str]]] = []

    def start(name: str, attributes: Dict[str, str]) -> None:
        found.extend(("", "", False, value) for value in attributes.values())
        relative = attributes.get("relativeToVRT", attributes.get("relativetoVRT", "0")) == "1"
        stack.append((name.lower(), attributes.get("key", attributes.get("name", "")).upper(), relative, []))

    def end(_: str) -> None:
        name, key, relative, parts = stack.pop()
        text = "".join(parts).strip()
        if text:
            found.append((name, key, relative, text))

    def refuse(*_: object) -> None:
        raise ValueError("it declares a type or entities")

    # GDAL takes all bytes as they are, whatever the encoding that the file declares.
    parser = expat.ParserCreate("iso-8859-1")
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = lambda text: stack[-1][3].append(text)
    parser.StartDoctypeDeclHandler = refuse
    parser.buffer_text = True
    with open(path, "rb") as stream:
        data = stream.read().rstrip(b"\0")
    parser.Parse(data[3:] if data.startswith(b"\xef\xbb\xbf") else data, True)
    return found


def _look_at_metadata(dataset: gdal.Dataset, path: str, depth: int, seen: Dict[str, int]) -> int:
    opened = 0
    for key, domain in _FILE_KEYS.items():
        named = dataset.GetMetadataItem(key, domain)
        if named:
            opened += _look_at(named.replace(":::BASE:::", ""), path, depth, seen)
    return opened


def _look_at(text: str, base: str, depth: int, seen: Dict[str, int], relative: bool = True) -> int:
    """What a file names as a source: it must be a file of this machine, and is looked through itself; how many files
    that makes GDAL open."""
    _refuse_network(text)
    driver = _DRIVER.match(text)
    elsewhere = os.name == "nt" and ntpath.splitdrive(text)[0].startswith(("\\\\", "//"))
    if elsewhere and ntpath.splitdrive(text)[0].lower() == ntpath.splitdrive(os.path.abspath(base))[0].lower():
        elsewhere = False
    if text.startswith(INLINE) or _REMOTE.match(text) or elsewhere or (driver and driver[1].upper() not in _PARTS):
        raise _names_network(text)
    archived = _archived_description(text)
    if archived:
        raise _DistrustedError(f"leads to '{text}', which {archived}")
    try:
        name = os.fsdecode(text.encode("latin-1"))
    except UnicodeEncodeError:
        name = text
    opened = 0
    for source in {os.path.join(os.path.dirname(base), name) if relative else name, name}:
        if os.path.isfile(source):
            opened = max(opened, _look_through(source, depth + 1, seen))
        elif _waits(source):
            raise _DistrustedError(f"leads to '{text}', which is a pipe or a device: use the data themselves.")
    return opened


def _refuse_network(text: str) -> None:
    found = _NETWORK.search(text)
    if found:
        raise _names_network(found.group())


def _names_network(text: str) -> _DistrustedError:
    return _DistrustedError(
        f"leads to the network source '{text[:80].splitlines()[0]}': files that come with data must not; download the "
        "image, or give its network path itself."
    )
