"""Finding and reading an image's RPC, whatever form its vendor gave it.

Through GDAL: GeoTIFF tags, NITF, ``.RPB``, ``_RPC.TXT`` and DIMAP products. By our own reader: the ``RPC_*.XML`` of
Pleiades and SPOT that lies beside an image without its DIMAP file. All files are untrusted: sizes are bounded, XML
is parsed by GDAL's minimal parser, which knows no entities, and every number is checked by :class:`Rpc`.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Iterator, Mapping, Optional

import numpy as np
from osgeo import gdal

from ..errors import RpcInvalidError, RpcMissingError
from .model import Rpc

_MAX_XML_BYTES = 4 << 20

# Our member, and GDAL's key for it.
_GDAL_KEYS = {
    "row_off": "LINE_OFF", "row_scale": "LINE_SCALE", "col_off": "SAMP_OFF", "col_scale": "SAMP_SCALE",
    "lat_off": "LAT_OFF", "lat_scale": "LAT_SCALE", "lon_off": "LONG_OFF", "lon_scale": "LONG_SCALE",
    "height_off": "HEIGHT_OFF", "height_scale": "HEIGHT_SCALE",
    "row_num": "LINE_NUM_COEFF", "row_den": "LINE_DEN_COEFF",
    "col_num": "SAMP_NUM_COEFF", "col_den": "SAMP_DEN_COEFF",
}


def rpc_of(dataset: gdal.Dataset, path: str) -> Rpc:
    """The RPC of an opened image.

    Raises
    ------
    RpcMissingError
        With the list of places that were looked at; a projected product gets its own sentence.
    RpcInvalidError
        With the file's name, the number that is wrong, and what to do.
    """
    tried = [f"{dataset.GetDriver().ShortName} metadata (RPC tags, .RPB, _RPC.TXT, DIMAP)"]
    try:
        metadata = dataset.GetMetadata("RPC")
        if metadata:
            return rpc_from_gdal(metadata)
        for candidate in _xml_candidates(Path(path)):
            tried.append(candidate.name)
            rpc = rpc_from_xml(candidate)
            if rpc is not None:
                return rpc
    except RpcInvalidError as error:
        raise RpcInvalidError(f"The RPC of '{path}' cannot be used: {error} Get the file again, or use the original "
                              "product's RPC file.") from error
    if dataset.GetProjection() and dataset.GetGeoTransform(can_return_null=True):
        raise RpcMissingError(
            f"'{path}' has no RPC and is already projected to a map (an ortho-ready or orthorectified product): "
            "order the Basic, Sensor or Primary level, which comes with RPCs.")
    raise RpcMissingError(
        f"No RPC found for '{path}'. Looked in: {', '.join(tried)}. Put the vendor's RPC file beside the image under "
        "its original name.")


def rpc_from_gdal(metadata: Mapping[str, str]) -> Rpc:
    """An RPC from GDAL's metadata domain ``RPC``; raises RpcInvalidError."""
    values: dict[str, Any] = {}
    for member, key in _GDAL_KEYS.items():
        if key not in metadata:
            raise RpcInvalidError(f"its {key} is missing.")
        numbers = _numbers(metadata[key], key)
        values[member] = tuple(numbers) if member.endswith(("num", "den")) else numbers[0]
    return Rpc(**values)


def _numbers(text: str, key: str) -> list[float]:
    """All numbers of a text, units after them forgiven; raises RpcInvalidError for anything that is none."""
    words = str(text)[:4096].split()
    try:
        return [float(word) for word in (words if len(words) > 2 else words[:1])]
    except ValueError as error:
        raise RpcInvalidError(f"its {key} is '{str(text)[:60]}', which is not a number.") from error


def _xml_candidates(image: Path) -> Iterator[Path]:
    """RPC_*.XML files beside an image whose name says that they belong to it, as Airbus names them.

    ``IMG_PHR1A_P_2012..._SEN_..._R1C1.TIF`` belongs to ``RPC_PHR1A_P_2012..._SEN_....XML``; an XML with the image's own
    name counts too.
    """
    core = re.sub(r"_R\d+C\d+$", "", re.sub(r"^(IMG|DS)_", "", image.stem, flags=re.IGNORECASE), flags=re.IGNORECASE)
    names = (f"RPC_{core}", f"{image.stem}_RPC", image.stem)
    for name in dict.fromkeys(names):
        for extension in (".XML", ".xml"):
            candidate = image.with_name(name + extension)
            if candidate.is_file():
                yield candidate
                break


def rpc_from_xml(path: Path) -> Optional[Rpc]:
    """The RPC of a DIMAP v2 ``RPC_*.XML`` (Pleiades, SPOT 6 and 7); None where the XML is of another kind.

    DIMAP counts pixels from 1, so both offsets lose 1. ``Inverse_Model`` maps ground to image.
    """
    if os.path.getsize(path) > _MAX_XML_BYTES:
        raise RpcInvalidError(f"'{path.name}' is larger than {_MAX_XML_BYTES >> 20} MiB, which no RPC file is.")
    text = path.read_bytes()
    if b"<!ENTITY" in text or b"<!DOCTYPE" in text:
        raise RpcInvalidError(f"'{path.name}' declares a DOCTYPE or entities, which no RPC file needs.")
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        tree = gdal.ParseXMLString(text.decode("utf-8", errors="replace"))
    except RuntimeError:
        tree = None
    finally:
        gdal.PopErrorHandler()
    leaves = _leaves(tree, ("Inverse_Model", "RFM_Validity")) if tree else {}
    if "HEIGHT_OFF" not in leaves:
        return None
    values: dict[str, Any] = {}
    for member, key in _GDAL_KEYS.items():
        if member.endswith(("num", "den")):
            values[member] = tuple(_leaf(leaves, f"{key}_{i}") for i in range(1, 21))
        else:
            values[member] = _leaf(leaves, key) - (1.0 if member in ("row_off", "col_off") else 0.0)
    return Rpc(**values)


def _leaf(leaves: Mapping[str, str], key: str) -> float:
    if key not in leaves:
        raise RpcInvalidError(f"its {key} is missing.")
    number = _numbers(leaves[key], key)[0] if leaves[key].split() else np.nan
    return number


def _leaves(tree: list, parents: tuple[str, ...]) -> dict[str, str]:
    """Texts of the elements right below the named parents; GDAL's tree is [kind, text, child, child, ...]."""
    found: dict[str, str] = {}
    pending = [tree]
    while pending:
        node = pending.pop()
        for child in node[2:]:
            if child[0] != gdal.CXT_Element:
                continue
            if node[1] in parents:
                found[child[1]] = "".join(part[1] for part in child[2:] if part[0] == gdal.CXT_Text)
            pending.append(child)
    return found


