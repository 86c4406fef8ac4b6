"""STAC items as lists of images: which of their assets are images, the RPC files beside them, and when they were taken.

An item, a collection of items (GeoJSON), or a collection or catalogue with links to items. Only files of this machine
are taken from them: a file that came with data may not send anybody to the network.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from itertools import islice
from typing import Dict, Iterator, List, Mapping, Sequence, Tuple, Union
from urllib.parse import unquote

from ..contracts.errors import ImageError, RpcError
from ..contracts.file_kinds import IMAGE_ENDS
from ..rpc.formats import sidecar_text

_MOST_ITEMS = 1000
_DEEPEST = 3  # catalogues that link to others
_DEEPEST_JSON = 32
_IMAGES = re.compile(r"image/(?:tiff|jp2|vnd\.stac\.geotiff)|application/vnd\.nitf", re.IGNORECASE)
_OTHER_ROLES = {"thumbnail", "overview", "metadata", "mask", "data-mask", "cloud", "snow-ice", "udm", "udm2"}
_RPC_FILES = re.compile(r"_rpc\.(?:txt|xml)$|\.rp[bc]$|(?:^|/)rpc_[^/]*\.xml$", re.IGNORECASE)


@dataclass(frozen=True)
class StacItem:
    """The files of one item: ``images`` and ``rpcs`` by their paths; ``when`` it was taken (ISO 8601) and by which
    ``platform``, "" where it does not say."""

    images: Tuple[str, ...]
    rpcs: Tuple[str, ...]
    when: str
    platform: str


def items_of(path: str) -> List[StacItem]:
    """The items that a file is, holds or links to.

    Raises ImageError for a file that is no STAC, or names files on the network.
    """
    return [_item(file, feature) for file, feature in _features_of(path)[:_MOST_ITEMS]]


def named_items(path: str) -> List[Tuple[str, Union[StacItem, ImageError]]]:
    """The ids of the items that a file is, holds or links to, each with its item, or with what is wrong with it.

    Raises ImageError for a file that is no STAC, and for more items than this program takes.
    """
    named: List[Tuple[str, Union[StacItem, ImageError]]] = []
    features = _features_of(path)
    if len(features) > _MOST_ITEMS:
        raise ImageError(f"'{path}' has more than {_MOST_ITEMS} items: choose a catalogue of fewer.")
    for file, feature in features:
        name = str(feature.get("id") or os.path.splitext(os.path.basename(file))[0])
        try:
            named.append((name, _item(file, feature)))
        except ImageError as error:
            named.append((name, error))
    return named


def _features_of(path: str) -> List[Tuple[str, Dict[str, object]]]:
    found = list(islice(_features(path, 0), _MOST_ITEMS + 1))
    if not found:
        raise ImageError(
            f"'{path}' is no STAC item, and links to none: choose an item's file, or the images themselves."
        )
    return found


def _features(path: str, depth: int) -> Iterator[Tuple[str, Dict[str, object]]]:
    """Items as they stand in files, each with its file."""
    document = _document(path)
    features = document.get("features") if document.get("type") == "FeatureCollection" else [document]
    for feature in features if isinstance(features, list) else []:
        if isinstance(feature, dict) and feature.get("type") == "Feature" and "stac_version" in feature:
            yield path, feature
    links = document.get("links") if document.get("type") in ("Collection", "Catalog") else None
    for link in links[:_MOST_ITEMS] if isinstance(links, list) and depth < _DEEPEST else []:
        if isinstance(link, dict) and link.get("rel") in ("item", "child"):
            yield from _features(_local(path, str(link.get("href", ""))), depth + 1)


def _item(path: str, feature: Mapping[str, object]) -> StacItem:
    assets, properties = (_object(feature.get(name)) for name in ("assets", "properties"))
    images: List[str] = []
    rpcs: List[str] = []
    for key, asset in assets.items():
        href, roles = str(_object(asset).get("href", "")), _object(asset).get("roles")
        named = {str(role).lower() for role in roles} if isinstance(roles, list) else set()
        kind = str(_object(asset).get("type", ""))
        if "rpc" in named or "rpc" in key.lower() or _RPC_FILES.search(href):
            rpcs.append(_local(path, href))
        elif (_IMAGES.match(kind) or href.lower().endswith(IMAGE_ENDS)) and not named & _OTHER_ROLES:
            images.append(_local(path, href))
    when = properties.get("datetime") or properties.get("start_datetime") or ""
    return StacItem(tuple(images), tuple(rpcs), str(when), str(properties.get("platform") or ""))


def _local(path: str, href: str) -> str:
    """The path of a file that an item names; raises ImageError for one on the network."""
    text = href[len("file://") :] if href.startswith("file://") else href
    if re.match(r"[a-z][a-z0-9+.-]+://|/vsi", text, re.IGNORECASE) or text.startswith("\\\\"):
        raise ImageError(
            f"'{path}' names files on the network ('{text[:80]}'): download them and choose the copies, or give their "
            "network paths (/vsicurl/https://...) as images themselves."
        )
    folder = os.path.dirname(os.path.abspath(path))
    plain, spelt = (os.path.normpath(os.path.join(folder, each)) for each in (text, unquote(text)))  # item%201
    return plain if os.path.exists(plain) else spelt


def _document(path: str) -> Dict[str, object]:
    if not os.path.isfile(path):
        raise ImageError(f"There is no STAC file '{path}': get all files of the catalogue.")
    try:
        text = sidecar_text(path)
        depth = 0
        for mark in re.finditer(r"[\[\]{}]", text):
            depth += 1 if mark[0] in "[{" else -1
            if depth > _DEEPEST_JSON:
                raise ImageError(f"'{path}' is nested deeper than any STAC item: choose another file.")
        return _object(json.loads(text))
    except (ValueError, RecursionError, RpcError) as error:
        raise ImageError(f"Cannot read the STAC item '{path}' ({str(error)[:200]}): get it again.") from error


def _object(value: object) -> Dict[str, object]:
    return value if isinstance(value, dict) else {}


def facts_of(image: str, files: Sequence[str]) -> Iterator[Tuple[str, str]]:
    """(time, platform) of an image by the items among the files beside it."""
    name = os.path.basename(image)
    for file in files:
        try:
            if '"stac_version"' not in sidecar_text(file):
                continue
            found = items_of(file)
        except (ImageError, RpcError):
            continue
        for item in found:
            if any(os.path.basename(each) == name for each in item.images):
                yield item.when, item.platform
