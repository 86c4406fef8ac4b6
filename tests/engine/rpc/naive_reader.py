"""A second, naive reader of RPC files: regular expressions, and no check of anything else.

An input that is read as another model than the one it was made from is explained only if this reader finds exactly
that model's ninety numbers in it.
"""

from __future__ import annotations

import re
import struct
from typing import Dict, Optional, Tuple

import numpy as np

from repm_qgis.rpc import Rpc
from tests.engine.rpc.mutations import NUMBER
from tests.engine.rpc.writers import RPC00A, RPC00B

_AXES = (
    ("row", "LINE", "line"),
    ("col", "SAMP", "samp"),
    ("lat", "LAT", "lat"),
    ("lon", "LONG", "long"),
    ("height", "HEIGHT", "height"),
)
Numbers = Dict[str, Tuple[float, ...]]


def naive(kind: str, data: bytes) -> Optional[Numbers]:
    """The ninety numbers as regular expressions find them; None where they do not. No check of anything else."""
    if kind == "GeoTIFF":
        return _naive_tiff(data)
    text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1", errors="replace")
    try:
        numbers = {
            f"{ours}_{end}": _find(kind, text, axis, end, theirs)
            for ours, axis, theirs in _AXES
            for end, theirs in (("off", theirs), ("scale", theirs))
        }
        for ours, axis, theirs in _AXES[:2]:
            for part in ("num", "den"):
                numbers[f"{ours}_{part}"] = _find(kind, text, axis, part, theirs)
    except (TypeError, IndexError, ValueError):  # a number is not there
        return None
    if kind == "DIMAP v2":
        numbers["row_off"] = (numbers["row_off"][0] - 1,)
        numbers["col_off"] = (numbers["col_off"][0] - 1,)
    if kind.startswith("OSSIM") and re.search(r"^polynomial_format:\s*A", text, re.MULTILINE):
        for name in ("row_num", "row_den", "col_num", "col_den"):
            of_term = dict(zip(RPC00A, numbers[name]))
            numbers[name] = tuple(of_term[term] for term in RPC00B)
    return numbers


def _floats(text: str) -> Tuple[float, ...]:
    return tuple(float(word.lower().replace("d", "e")) for word in re.findall(NUMBER, text))


def _find(kind: str, text: str, axis: str, end: str, theirs: str) -> Tuple[float, ...]:
    polynomial = end in ("num", "den")
    if kind == "RPB":
        name = theirs + {"off": "Offset", "scale": "Scale", "num": "NumCoef", "den": "DenCoef"}[end]
        return _floats(re.search(rf"\b{name}\s*=\s*([^;]*);", text)[1])
    if kind == "Maxar XML":
        name = axis + {"off": "OFFSET", "scale": "SCALE", "num": "NUMCOEF", "den": "DENCOEF"}[end]
        return _floats(re.search(rf"<{name}\b[^>]*>([^<]*)</", text)[1])
    if kind == "JSON rpcm":
        ours = {"LINE": "row", "SAMP": "col", "LAT": "lat", "LONG": "lon", "HEIGHT": "alt"}[axis]
        name = f"{ours}_{'offset' if end == 'off' else end}"
        return _floats(re.search(rf'"{name}"\s*:\s*(\[[^\]]*\]|[^,}}]*)', text)[1])
    name = f"{axis}_{end.upper()}"
    if kind == "JSON GDAL":
        return _floats(re.search(rf'"{name}{"_COEFF" * polynomial}"\s*:\s*"?([^",}}]*)', text)[1])
    if kind.startswith("DIMAP"):
        part = re.search(r"<(Inverse_Model|GroundtoImage_Values)\b.*?</\1", text, re.DOTALL)[0]
        find = lambda key, where: _floats(re.search(rf"<{key}\b[^>]*>([^<]*)</", where)[1])[0]  # noqa: E731
        return tuple(find(f"{name}_COEFF_0*{i}", part) for i in range(1, 21)) if polynomial else (find(name, text),)
    value_of = lambda key: _floats(re.search(rf"^\s*{key}\s*[:=]([^\n\r]*)", text, re.M | re.I)[1])[0]  # noqa: E731
    first = 0 if kind.startswith("OSSIM") else 1
    return tuple(value_of(f"{name}_COEFF_0*{i}") for i in range(first, first + 20)) if polynomial else (value_of(name),)


def _naive_tiff(data: bytes) -> Optional[Numbers]:
    """The RPC tag (50844) of a little-endian TIFF's first directory: two errors, ten normalisers, 80 coefficients."""
    try:
        (directory,) = struct.unpack_from("<I", data, 4)
        (count,) = struct.unpack_from("<H", data, directory)
        for entry in range(directory + 2, directory + 2 + 12 * count, 12):
            tag, kind, length, place = struct.unpack_from("<HHII", data, entry)
            if (tag, kind, length) == (50844, 12, 92):
                v = struct.unpack_from("<92d", data, place)
                numbers: Numbers = {
                    f"{ours}_{end}": (v[2 + 5 * half + axis],)
                    for axis, (ours, *_) in enumerate(_AXES)
                    for half, end in enumerate(("off", "scale"))
                }
                for index, name in enumerate(("row_num", "row_den", "col_num", "col_den")):
                    numbers[name] = v[12 + 20 * index : 32 + 20 * index]
                return numbers
    except struct.error:
        pass
    return None


def says(rpc: Rpc, numbers: Optional[Numbers], digits: float) -> bool:
    """Whether a model holds these numbers; ``digits`` is the relative rounding on the way."""
    if numbers is None:
        return False
    for name, values in numbers.items():
        ours = np.atleast_1d(getattr(rpc, name))
        if ours.shape != (len(values),) or not np.allclose(ours, values, rtol=digits, atol=0.0):
            return False
    return True
