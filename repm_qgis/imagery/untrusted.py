"""What is asked of a raster's file before GDAL opens it: files that came with data are not trusted."""

from __future__ import annotations

import os
import re
import stat
from typing import Set

from ..errors import ImageError

_NETWORK = re.compile(rb"/vsi(?:curl|s3|gs|az|adls|oss|swift|webhdfs|hdfs)\w*|(?:https?|ftp)://|<GDAL_W[MC][TS]", re.I)
_SOURCE = re.compile(rb"<Source(?:Filename|DataSet|Dataset)([^>]*)>([^<]*)<", re.I)
_MOST_BYTES = 64 << 20  # of a VRT; those of mosaics with 100,000 parts have 50 MB
_DEEPEST = 8  # VRTs that name each other


def require_trusted(path: str) -> None:
    """Raise ImageError for a pipe or device, on which reading would wait, and for a VRT that reaches for the network.

    Network paths work where the user typed them, for the image itself; a VRT beside data may not send anybody there.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return  # no file of this machine: GDAL knows, or says what is wrong
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise ImageError(f"'{path}' is a pipe or a device, not a file: choose an image file.")
    if stat.S_ISREG(mode):
        _require_local(path, path, set())


def _require_local(path: str, given: str, seen: Set[str]) -> None:
    text = _vrt(path)
    if not text or os.path.realpath(path) in seen:
        return
    seen.add(os.path.realpath(path))
    if len(seen) > _DEEPEST:
        raise ImageError(
            f"'{given}' is a VRT of VRTs more than {_DEEPEST} deep: make one VRT of the images themselves."
        )
    found = _NETWORK.search(text)
    if found:
        raise ImageError(
            f"'{given}' is a VRT that names the network source '{found.group().decode('ascii', 'replace')}': a file "
            "that comes with data may not do that; download the image, or give its network path itself."
        )
    for attributes, name in _SOURCE.findall(text):
        source = os.fsdecode(name.strip())
        beside = b'relativeToVRT="1"' in attributes
        source = os.path.join(os.path.dirname(path), source) if beside else source
        if os.path.isfile(source):
            _require_local(source, given, seen)


def _vrt(path: str) -> bytes:
    """The text of a VRT; nothing for other files."""
    try:
        with open(path, "rb") as stream:
            head = stream.read(1024)
            if b"<VRTDataset" not in head:
                return b""
            return head + stream.read(_MOST_BYTES)
    except OSError:
        return b""
