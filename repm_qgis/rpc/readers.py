"""Finding an image's RPC: in its tags, in its sidecar files, or in the file that the user names.

:mod:`.formats` reads files; this module decides which file belongs to the image, and to which of its pixels.

An image may be a crop of the product that its RPC file describes. There are three signs of that:

* RPC tags inside an image are those of its own pixels: ``gdal_translate -srcwin`` shifts them with the crop. They are
  never shifted again. A vendor's file that was copied next to such a crop differs from the tags by the crop's origin,
  in whole pixels: then the tags are right (GDAL itself would use the file).
* An image without a CRS whose geotransform counts pixels, as Orfeo ToolBox and GDAL write for crops, is a window of the
  image that its sidecar file describes: the file's RPC is shifted, unless its domain starts there already. Steps other
  than 1 are those of a reduced or enlarged image: the file's RPC is scaled by them.
* ``IMG_..._R2C1.TIF`` is a tile of an Airbus product, whose RPC is that of the whole image: it is shifted by the
  tile size in ``DIM_*.XML``, and refused without that file.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatArray
from ..contracts.checks import as_texts
from ..contracts.errors import RpcInvalidError, RpcMissingError
from .formats import ARCHIVED, DIMAP, FORMAT_NAMES, FoundRpc, checked, read_sidecar, rpc_from_texts, tile_size
from .model import Rpc

_AGREE_PX = 0.5  # vendors round the same model to different digits in its different files
_WHOLE_PX = 1e-3
_STEPS = 1 / 32, 32.0  # of geotransforms that count pixels: those of world files in degrees are below
_BEYOND = 0.05  # of an RPC's domain, by which an image may reach out of it: vendors round their domains
_MAX_FOLDER = 20_000

_IMAGE_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"NITF", b"NSIF", b"\0\0\0\x0cjP  ")
_IMAGE_DRIVERS = ("GTiff", "NITF", "JP2OpenJPEG", "JP2KAK", "JP2ECW", "JP2MrSID")
_ADVICE = "Get the file again, or use the original product's RPC file."


def rpc_of(dataset: gdal.Dataset, path: str, rpc_file: Optional[str] = None) -> Rpc:
    """The RPC of an opened image, for the pixels that the image has.

    ``rpc_file`` names the file to read it from, whatever its format; the image itself may be named, for its tags.

    Raises
    ------
    RpcMissingError
        With the list of places that were searched; a projected product gets its own sentence.
    RpcInvalidError
        With the file's name, the number that is wrong, and what to do; also where two sidecar files disagree.
    """
    try:
        if rpc_file:
            return _placed(_read(rpc_file), dataset, path)
        tried = [f"{dataset.GetDriver().ShortName} metadata (RPC tags, .RPB, _RPC.TXT, DIMAP)"]
        rpc = _from_sidecars(dataset, path, tried) or _from_metadata(dataset)
    except RpcInvalidError as error:
        raise RpcInvalidError(f"The RPC of '{path}' cannot be used: {error} {_ADVICE}") from error
    if rpc is not None:
        return rpc
    if dataset.GetProjection() and dataset.GetGeoTransform(can_return_null=True):
        reason = "is already projected to a map"
        remedy = (
            "an ortho-ready product comes with one, which belongs into its folder or into RPCS; instead of an "
            "orthoimage, order the Basic, Sensor or Primary level"
        )
        raise RpcMissingError(f"'{path}' has no RPC and {reason}: {remedy}.")
    remedy = "Put the vendor's RPC file into the image's folder under its original name, or name it in RPCS"
    raise RpcMissingError(f"No RPC found for '{path}'. Looked in: {', '.join(tried)}. {remedy}.")


def read_rpc_file(path: str) -> Rpc:
    """The RPC of any file that holds one, chosen by its content: a vendor's text, XML or JSON, or an image's tags.

    Raises RpcMissingError where there is no such file, RpcInvalidError where it holds no RPC (with the formats that
    were tried) or a wrong one (with the number that is wrong).
    """
    return _read(str(path)).rpc


# --- one file -------------------------------------------------------------------------------------------------------


def _read(path: str) -> FoundRpc:
    found = _tags_of_file(path) if _is_image(path) else read_sidecar(path)
    if found is None:
        tried = f"{', '.join(FORMAT_NAMES)}, GeoTIFF, NITF and JPEG 2000 tags"
        raise RpcInvalidError(f"'{os.path.basename(path)}' is not an RPC file of a known format; tried: {tried}.")
    return found


def _is_image(path: str) -> bool:
    if not os.path.isfile(path):  # opening a pipe would wait for ever
        return False
    try:
        with open(path, "rb") as stream:
            return stream.read(12).startswith(_IMAGE_STARTS)
    except OSError:
        return False


def _tags_of_file(path: str) -> Optional[FoundRpc]:
    tags = _tags(path)
    try:
        return FoundRpc(checked(rpc_from_texts(tags)), "tags") if tags else None
    except RpcInvalidError as error:
        raise RpcInvalidError(f"the RPC tags of '{os.path.basename(path)}' cannot be used: {error}") from error


def _tags(path: str) -> Dict[str, str]:
    """RPC metadata inside an image file, without its sidecar files; empty where there is none."""
    dataset = None
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        siblings = [os.path.basename(path)]
        dataset = gdal.OpenEx(path, gdal.OF_RASTER, allowed_drivers=list(_IMAGE_DRIVERS), sibling_files=siblings)
        return as_texts(dataset.GetMetadata("RPC")) if dataset is not None else {}
    except RuntimeError:
        return {}
    finally:
        dataset = None  # noqa: F841
        gdal.PopErrorHandler()


# --- which file -----------------------------------------------------------------------------------------------------


def _from_metadata(dataset: gdal.Dataset) -> Optional[Rpc]:
    """The RPC that GDAL finds: tags, and the sidecar files of vendors that only GDAL reads."""
    try:
        metadata = dataset.GetMetadata("RPC")
    except RuntimeError:  # where GDAL raises exceptions it does so for a damaged sidecar file, when it first reads it
        metadata = dataset.GetMetadata("RPC")
    return checked(rpc_from_texts(as_texts(metadata))) if metadata else None


def _from_sidecars(dataset: gdal.Dataset, path: str, tried: List[str]) -> Optional[Rpc]:
    """The RPC of the sidecar files whose names belong to an image; None where there is none.

    The names of all files that were opened are added to ``tried``. Raises RpcInvalidError where two of them, or one and
    the image's tags, describe different models.
    """
    placed: List[Tuple[str, Rpc]] = []
    for candidate in rpc_sidecars(path):
        tried.append(os.path.basename(candidate))
        found = read_sidecar(candidate)
        if found is not None:
            placed.append((f"'{tried[-1]}'", _placed(found, dataset, path)))
    if not placed:
        return None
    name, rpc = placed[0]
    for other_name, other in placed[1:]:
        _require_agreement(name, rpc, other_name, other)
    tags = _tags_of_file(path) if _is_image(path) else None
    if tags is not None:
        if _is_crop(tags.rpc, rpc):
            return tags.rpc
        _require_agreement(name, rpc, "the image's own tags", tags.rpc)
    return rpc


def rpc_sidecars(path: str) -> List[str]:
    """Sidecar files that may contain an image's RPC, by their names; upper and lower case are the same.

    Airbus's ``IMG_PHR1A_P_2012..._SEN_..._R1C1.TIF`` belongs to ``RPC_PHR1A_P_2012..._SEN_....XML``; others use
    the image's own name.
    """
    image = Path(path)
    core, stem = product_of(image), image.stem
    possible = [f"RPC_{core}.XML", f"RPC_{core}_P.XML"]
    possible += [stem + end for end in ("_RPC.XML", ".XML", ".RPB", "_RPC.TXT", ".RPC", ".geom", ".JSON")]
    there = files_in_folder(image)
    names = [name for key in dict.fromkeys(name.lower() for name in possible) for name in there.get(key, ())]
    return [beside(image, name) for name in names if name != image.name]


def beside(image: Path, name: str) -> str:
    """The path of another file in an image's folder, which may be one in an archive."""
    path = image.with_name(name)
    return _in_archive(path) if ARCHIVED.match(path.as_posix()) else str(path)


def _in_archive(path: Path) -> str:
    """GDAL's name of a file or folder in an archive. That of an archive with an absolute path has two slashes after
    its first word, of which a Path keeps one."""
    text = path.as_posix()
    return text if gdal.VSIStatL(text) is not None else re.sub(r"^(/vsi\w+/)", r"\1/", text)


def product_of(image: Path) -> str:
    """The part of an Airbus file's name that its product's files share."""
    core = re.sub(r"^(IMG|DS|DIM)_", "", image.stem, flags=re.IGNORECASE)
    return re.sub(r"_R\d+C\d+$", "", core, flags=re.IGNORECASE)


def files_in_folder(image: Path) -> Dict[str, List[str]]:
    """Names of the files in an image's folder by their lower-case form; empty where the folder cannot be listed."""
    names: Dict[str, List[str]] = {}
    if ARCHIVED.match(image.as_posix()):
        for name in (gdal.ReadDir(_in_archive(image.parent)) or [])[:_MAX_FOLDER]:
            names.setdefault(name.lower(), []).append(name)
        return {key: sorted(found) for key, found in names.items()}
    try:
        with os.scandir(image.parent) as entries:
            for number, entry in enumerate(entries):
                if number >= _MAX_FOLDER:
                    break
                if entry.is_file():
                    names.setdefault(entry.name.lower(), []).append(entry.name)
    except OSError:
        return {}
    return {key: sorted(found) for key, found in names.items()}


def _require_agreement(name: str, rpc: Rpc, other_name: str, other: Rpc) -> None:
    """Raises RpcInvalidError where two models project the ground around the first one's centre to different pixels."""
    unit = np.stack(np.meshgrid(*[[-0.5, 0.0, 0.5]] * 3), axis=-1).reshape(-1, 3)
    pixels = unit[:, :2] * [rpc.col_scale, rpc.row_scale] + [rpc.col_off, rpc.row_off]
    ground = rpc.localise(pixels, rpc.height_off + unit[:, 2] * rpc.height_scale)
    ground = ground[np.isfinite(ground).all(axis=1)]
    with np.errstate(all="ignore"):
        apart = np.abs(rpc.project(ground) - other.project(ground)).max(initial=0.0)
    if not apart <= _AGREE_PX:
        remedy = "name the right one in RPCS (the image itself stands for its tags), or remove the other"
        raise RpcInvalidError(f"{name} and {other_name} differ by {apart:.3g} px: {remedy}.")


# --- which pixels ---------------------------------------------------------------------------------------------------


def _placed(found: FoundRpc, dataset: gdal.Dataset, path: str) -> Rpc:
    """A file's RPC, shifted to the pixels of an image that is a tile or a crop of the image that it describes."""
    if found.kind == "tags":
        return found.rpc
    rpc = found.rpc
    if found.kind == DIMAP:
        rpc = rpc.shifted(*_tile_origin(Path(path)))
    return _of_window(dataset, rpc)


def _tile_origin(image: Path) -> Tuple[int, int]:
    """Column and row of a tile's first pixel in its Airbus product; (0, 0) for an image that is not a tile."""
    match = re.search(r"_R(\d{1,4})C(\d{1,4})$", image.stem, flags=re.IGNORECASE)
    row, col = (int(match[1]), int(match[2])) if match else (1, 1)
    if (row, col) == (1, 1):
        return 0, 0
    core, there = product_of(image), files_in_folder(image)
    # Names of Pleiades Neo's images have the band after the name that the product's own file has.
    for product in (core, re.sub(r"_[A-Za-z-]+$", "", core)):
        for name in there.get(f"dim_{product}.xml".lower(), ()):
            size = tile_size(beside(image, name))
            if size is not None:
                return (col - 1) * size[0], (row - 1) * size[1]
    reason = f"'DIM_{core}.XML', which says where it lies, is not in its folder"
    remedy = "put it there, or choose that file as the image"
    raise RpcInvalidError(f"the image is tile R{row}C{col} of its product and {reason}: {remedy}.")


def _of_window(dataset: gdal.Dataset, rpc: Rpc) -> Rpc:
    """A file's RPC, shifted and scaled to the pixels of an image whose geotransform counts pixels of the file's image.

    Such a geotransform has no CRS, steps within ``_STEPS``, and an origin inside the RPC's domain. The domain may start
    at the crop's origin: then the RPC was shifted with the crop already. It may also start at this origin counted in
    the crop's own pixels: then it was scaled too. Raises RpcInvalidError for a rotated window, and for a resampled one
    that extends beyond the domain.
    """
    transform = dataset.GetGeoTransform(can_return_null=True)
    if not transform or dataset.GetProjection():
        return rpc
    col, right, row_right, row, col_down, down = transform
    origin, step = np.array([col, row * np.sign(down)]), np.array([right, abs(down)])
    start, end = _domain(rpc)
    if (step < _STEPS[0]).any() or (step > _STEPS[1]).any() or (origin < 0).any():
        return rpc
    size = np.array([dataset.RasterXSize, dataset.RasterYSize])
    done = [  # what the RPC may contain already: where its domain starts then, and the RPC that results
        (0 * origin, rpc.shifted(*origin).resampled(*step)),
        (-origin, rpc.resampled(*step)),
        (-origin / step, rpc),
    ]

    def unlike(each: Tuple[FloatArray, Rpc]) -> Tuple[float, float]:
        # For a crop at the origin (0, 0) all domains start alike: the right RPC is the one whose domain ends closest to
        # the image's end.
        last = np.maximum(_domain(each[1])[1] + 1, 1)
        return float(np.abs(start - each[0]).sum()), float(np.abs(np.log(last / size)).sum())

    from_start, placed = min(done, key=unlike)
    if not from_start.any() and (origin > end).any():
        return rpc
    if row_right or col_down:
        raise RpcInvalidError(
            f"the image's geotransform {tuple(transform)} counts pixels along rotated axes: cut the crop again without "
            "rotating it, or remove the geotransform if the RPC is that of these pixels."
        )
    if (step != 1).any() and (size > (1 + _BEYOND) * (_domain(placed)[1] + 1)).any():
        raise RpcInvalidError(
            f"the image's geotransform {tuple(transform)} puts its end at column {origin[0] + step[0] * size[0]:.0f}, "
            f"row {origin[1] + step[1] * size[1]:.0f} of an image whose RPC is made for {end[0] + 1:.0f} x "
            f"{end[1] + 1:.0f} px: remove the geotransform if the RPC is that of these pixels."
        )
    return placed


def _domain(rpc: Rpc) -> Tuple[FloatArray, FloatArray]:
    """(2,) first and last column, row that an RPC was made for."""
    middle, reach = np.array([rpc.col_off, rpc.row_off]), np.abs([rpc.col_scale, rpc.row_scale])
    return middle - reach, middle + reach


def _is_crop(tags: Rpc, whole: Rpc) -> bool:
    """Whether an image's tags are a file's RPC, only shifted by whole pixels to the right and down."""
    moved = np.array([whole.col_off - tags.col_off, whole.row_off - tags.row_off])
    if (moved < -_WHOLE_PX).any() or moved.max() < 1 - _WHOLE_PX or (np.abs(moved - moved.round()) > _WHOLE_PX).any():
        return False
    try:
        _require_agreement("", whole.shifted(*moved), "", tags)
    except RpcInvalidError:
        return False
    return True
