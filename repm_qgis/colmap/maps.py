"""COLMAP's depth maps: ``WIDTH&HEIGHT&1&`` in ASCII, then float32, little-endian, row by row.

https://colmap.github.io/format.html (dense reconstruction). A depth is along the optical axis, 0 where there is none.
"""

from __future__ import annotations

import os
import re

import numpy as np

from ..contracts.arrays import FloatImage, Size
from ..contracts.errors import ImageError, reason_of

_HEADER = re.compile(rb"(\d{1,6})&(\d{1,6})&(\d{1,2})&")
_HEADER_BYTES = 24


def read_map(path: str, size: Size) -> FloatImage:
    """Read a (height, width) map that must have this size.

    Raises ImageError for a file that is missing, no such map, truncated or of another size; the values are read only if
    the header agrees.
    """
    width, height = size
    try:
        with open(path, "rb") as stream:
            start = stream.read(_HEADER_BYTES)
            found = _HEADER.match(start)
            if found is None:
                raise ImageError(f"'{path}' is not a map of COLMAP (it begins with {start[:12]!r}): reconstruct again.")
            if tuple(map(int, found.groups())) != (width, height, 1):
                its = " x ".join(number.decode() for number in found.groups())
                raise ImageError(
                    f"The map '{path}' has {its} values, the image {width} x {height} x 1: reconstruct again."
                )
            expected = found.end() + 4 * width * height
            if os.fstat(stream.fileno()).st_size != expected:
                raise ImageError(f"The map '{path}' is damaged (it should have {expected} bytes): reconstruct again.")
            stream.seek(found.end())
            values = np.frombuffer(stream.read(), dtype="<f4")
    except ImageError:
        raise
    except OSError as error:
        raise ImageError(f"Cannot read the map '{path}' ({reason_of(error)}): reconstruct again.") from error
    return values.astype(np.float32).reshape(height, width)
