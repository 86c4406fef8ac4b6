"""What analysts receive: products in tiles, and folders or archives as they were delivered.

A product that its vendor cut into tiles is one image with one RPC. Its index names the tiles: Maxar's ``NAME.TIL``,
Airbus's ``DIM_NAME.XML``; GDAL opens the index as the whole image. Naming any of the tiles means the whole.

A folder, an archive, or a STAC item or catalogue stands for all images in it that have an RPC: the panchromatic images
(or all, where none is panchromatic) are matched, and the multispectral ones are listed because their colours may be
needed. Quick looks, masks and orthoimages have no RPC.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, Optional, Sequence, Tuple, TypeVar

from osgeo import gdal

from ..contracts.errors import ImageError, OptionError, RepmError, RpcError
from ..contracts.file_kinds import IMAGE_ENDS, is_archive, is_catalogue, is_delivery, is_packed_whole
from ..contracts.options import EpmFitOptions, InspectOptions
from ..rpc.formats import ARCHIVED, sidecar_text, xml_attributes
from ..rpc.readers import beside, files_in_folder, product_of, rpc_of
from ..runtime.progress import Progress, counted, listed
from .bands import intensity_bands
from .raster import opened
from .stac import StacItem, items_of

T = TypeVar("T", EpmFitOptions, InspectOptions)

_TILE = re.compile(r"_R\d{1,4}C\d{1,4}(?=[-_.]|$)", re.IGNORECASE)
_TIL_FILES = re.compile(r"^\s*filename\s*=\s*\"([^\"\r\n]{1,255})\"", re.IGNORECASE | re.MULTILINE)
_NO_IMAGES = re.compile(r"^(?:msk|prv|icon|browse)|_(?:msk|browse|preview|udm2?)\b|-browse", re.IGNORECASE)
_MOST_ENTRIES = 20_000
_DEEPEST = 8
_ZIP_END_BYTES = 22 + 0xFFFF  # the record at the end of a ZIP file, with the longest comment


@dataclass(frozen=True)
class Delivery:
    """The images to match, their RPC files as STAC items name them ("" where they do not), and the multispectral images
    that came with them."""

    images: Tuple[str, ...]
    rpcs: Tuple[str, ...]
    xs: Tuple[str, ...] = ()


def delivered(named: Sequence[str]) -> Delivery:
    """The images that paths stand for, each once, in the paths' order: a tile for its whole, a folder, an archive or a
    STAC item for all its images.

    Raises ImageError for one of these without any image that has an RPC, and for an archive to be unpacked first.
    """
    images: List[str] = []
    xs: List[str] = []
    rpcs: Dict[str, str] = {}
    for path in named:
        if not is_delivery(path):
            images.append(whole_of(path))
            continue
        own = _rpcs_of_items(items_of(path)) if is_catalogue(path) else None
        rpcs.update(own or {})
        greys, colours = _inside(path) if own is None else _usable(path, list(own), own)
        images += greys or colours
        xs += colours if greys else []
    each = tuple(dict.fromkeys(images))
    return Delivery(each, tuple(rpcs.get(image, "") for image in each), tuple(dict.fromkeys(xs)))


def delivered_item(path: str, item: StacItem) -> Delivery:
    """The images of one item, of those that a STAC file holds or links to; raises ImageError where none has an RPC."""
    own = _rpcs_of_items([item])
    greys, colours = _usable(path, list(own), own)
    images = greys or colours
    return Delivery(tuple(images), tuple(own[image] for image in images), tuple(colours if greys else ()))


def with_images(options: T, progress: Progress) -> T:
    """The options of a stage whose ``images`` are files, after a sentence about those that stand for others.

    Raises OptionError where lists of files beside the images cannot be in their order any more, or where a folder has
    too few images for the stage.
    """
    found = delivered(options.images)
    if found.images == options.images:
        return options
    for name in ("rpcs", "masks"):
        files = getattr(options, name, ())
        if files:
            reason = (
                "must be empty where a folder, an archive, an item or a tile stands for images: name these in IMAGES"
            )
            raise OptionError(name.upper(), list(files), reason)
    names = [os.path.basename(path) for path in found.images]
    progress.info(f"IMAGES stands for {counted(len(names), 'image')}: {listed(names)}.")
    if found.xs:
        colours = listed([f"'{path}'" for path in found.xs])
        progress.info(f"Multispectral images came with them. To use their colours, give them as XS: {colours}.")
    return replace(options, images=found.images, rpcs=found.rpcs if any(found.rpcs) else ())


def whole_of(path: str) -> str:
    """The index of the product whose tile a path is; the path itself where it is none, where the product has only this
    tile, or where other tiles are missing."""
    image = Path(path)
    if not _TILE.search(image.stem) or not (ARCHIVED.match(path) or os.path.isfile(path)):
        return path
    there = files_in_folder(image)
    for index in _indexes(image, there):
        tiles = _tiles_of(index)
        mine = image.name.lower() in (tile.lower() for tile in tiles)
        if mine and len(tiles) > 1 and all(tile.lower() in there for tile in tiles):
            return index
    return path


def _indexes(image: Path, there: Dict[str, List[str]]) -> Iterator[str]:
    """The files in an image's folder that may be the index of its product: those of its own name first."""
    plain = _TILE.sub("", image.stem)
    core = product_of(image)
    # Names of Pleiades Neo's images have the band after the name that the product's own file has.
    own = [f"{plain}.til", *(f"dim_{name}.xml" for name in (core, re.sub(r"_[A-Za-z-]+$", "", core)))]
    others = sorted(key for key in there if key.endswith(".til"))
    for key in dict.fromkeys(name.lower() for name in (*own, *others)):
        yield from (beside(image, name) for name in there.get(key, ()))


def _tiles_of(index: str) -> List[str]:
    """The names of the image files in its own folder that an index names; empty for a file that is no index."""
    try:
        text = sidecar_text(index)
        if index.lower().endswith(".til"):
            names = _TIL_FILES.findall(text)
        else:
            names = [name for name in xml_attributes(text, "DATA_FILE_PATH", "href") if name]
    except RpcError:
        return []
    return [name for name in names[:_MOST_ENTRIES] if os.path.basename(name.replace("\\", "/")) == name]


# --- folders and archives -------------------------------------------------------------------------------------------


def _inside(path: str) -> Tuple[List[str], List[str]]:
    """The panchromatic and the other images with an RPC in a folder or an archive."""
    files = [file for file in _files(path) if _looks_like_one(file)]
    whole = dict.fromkeys(whole_of(file) for file in files if not file.lower().endswith((".til", ".xml")))
    return _usable(path, list(whole), {})


def _rpcs_of_items(items: Sequence[StacItem]) -> Dict[str, str]:
    """The images of STAC items, with their RPC files, "" where these name none."""
    found: Dict[str, str] = {}
    for item in items:
        for image in item.images:
            alike = [rpc for rpc in item.rpcs if Path(image).stem.lower() in Path(rpc).stem.lower()]
            several = item.rpcs[0] if len(item.rpcs) == 1 else ""
            found[image] = alike[0] if alike else several
    return found


def _usable(path: str, files: Sequence[str], rpcs: Mapping[str, str]) -> Tuple[List[str], List[str]]:
    """The panchromatic and the other images among files that have an RPC; raises ImageError where there is none."""
    greys: List[str] = []
    colours: List[str] = []
    reasons: List[str] = []
    for image in files:
        try:
            with opened(image) as dataset:
                rpc_of(dataset, image, rpcs.get(image) or None)
                (greys if len(intensity_bands(dataset)) == 1 else colours).append(image)
        except RepmError as error:
            reasons.append(str(error))
    if not greys and not colours:
        first = f": {reasons[0]}" if reasons else f": none of its files ends with {', '.join(IMAGE_ENDS)}."
        raise ImageError(f"'{path}' holds no image with an RPC{first}")
    return greys, colours


def _looks_like_one(file: str) -> bool:
    name = os.path.basename(file)
    return name.lower().endswith((*IMAGE_ENDS, ".til")) and not _NO_IMAGES.search(name) and not name.startswith(".")


def _files(path: str) -> List[str]:
    """The files in a folder or an archive, sorted; links to folders are not followed, nor names that lead out."""
    if is_packed_whole(path):
        raise ImageError(
            f"'{path}' is compressed as a whole, so that no part of an image in it can be read alone: unpack it, and "
            "choose its folder."
        )
    if is_archive(path):
        system = "tar" if path.lower().endswith(".tar") else "zip"
        root = f"/vsi{system}/{os.path.abspath(path).replace(os.sep, '/')}"
        if system == "zip" and _names_in_zip(path) > _MOST_ENTRIES:
            raise _too_many(path)
        found: Optional[List[str]] = gdal.ReadDirRecursive(root)
        if found is not None and len(found) > _MOST_ENTRIES:
            raise _too_many(path)
        inside = (name for name in found or [] if not name.endswith("/"))
        return sorted(f"{root}/{name}" for name in inside if ".." not in name.split("/"))
    files: List[str] = []
    start = path.rstrip("/\\").count(os.sep)
    for folder, folders, names in os.walk(path):
        folders[:] = sorted(folders) if folder.count(os.sep) - start < _DEEPEST else []
        files += [os.path.join(folder, name) for name in names]
        if len(files) > _MOST_ENTRIES:
            raise _too_many(path)
    return sorted(files)


def _too_many(path: str) -> ImageError:
    return ImageError(f"'{path}' holds more than {_MOST_ENTRIES} files: choose the folder of one product.")


def _names_in_zip(path: str) -> int:
    """How many names a ZIP file says that it has, at most 65535, from the record at its end (APPNOTE 4.3.16): GDAL
    would read them all first, which takes a minute for 60,000. 0 for a file without that record."""
    try:
        with open(path, "rb") as stream:
            stream.seek(max(os.path.getsize(path) - _ZIP_END_BYTES, 0))
            end = stream.read(_ZIP_END_BYTES)
    except OSError:  # GDAL reports it
        return 0
    place = end.rfind(b"PK\5\6")
    return int.from_bytes(end[place + 10 : place + 12], "little") if place >= 0 else 0
