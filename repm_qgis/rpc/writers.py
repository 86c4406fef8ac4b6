"""An RPC in the forms that other software reads; :mod:`.formats` reads them back.

All of them count pixels from (0, 0) at the first pixel's centre, as :class:`~repm_qgis.rpc.model.Rpc` does. Numbers
have all digits of a double.
"""

from __future__ import annotations

from typing import Dict, Iterator

from .formats import GDAL_KEYS, MAXAR_ACCURACY, MAXAR_SCALARS, MAXAR_SERIES
from .model import Rpc


def rpc_tags(rpc: Rpc) -> Dict[str, str]:
    """GDAL's RPC metadata of an RPC (GDAL RFC 22); the vendor's accuracy is in it where it is known."""
    tags: Dict[str, str] = {}
    if rpc.accuracy_m is not None:  # the vendor's bias and random part together, as their sum is all that is kept
        tags.update(ERR_BIAS=repr(float(rpc.accuracy_m)), ERR_RAND="0.0")
    for member, key in GDAL_KEYS.items():
        value = getattr(rpc, member)
        numbers = value if isinstance(value, tuple) else (value,)
        tags[key] = " ".join(repr(float(number)) for number in numbers)
    return tags


def rpc_txt(rpc: Rpc) -> str:
    """The text of ``NAME_RPC.TXT``, one number a line, as GDAL's GTiff driver (RPCTXT=YES) writes it."""
    return "".join(f"{line}\n" for line in _txt_lines(rpc))


def _txt_lines(rpc: Rpc) -> Iterator[str]:
    for key, text in rpc_tags(rpc).items():
        if key.endswith("_COEFF"):
            yield from (f"{key}_{number}: {word}" for number, word in enumerate(text.split(), start=1))
        else:
            yield f"{key}: {text}"


def rpb_text(rpc: Rpc) -> str:
    """The text of ``NAME.RPB``, DigitalGlobe's form; an unknown accuracy is 0 there, as GDAL writes it."""
    return "".join(f"{line}\n" for line in _rpb_lines(rpc))


def _rpb_lines(rpc: Rpc) -> Iterator[str]:
    tags = rpc_tags(rpc)
    yield from ('satId = "UNKNOWN";', 'bandId = "P";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE")
    scalars = {**MAXAR_ACCURACY, **MAXAR_SCALARS}
    yield from (f"\t{name} = {tags.get(key, '0.0')};" for key, name in scalars.items())
    for key, name in MAXAR_SERIES.items():
        yield f"\t{name} = ("
        yield "\t\t\t" + ",\n\t\t\t".join(tags[key].split()) + ");"
    yield from ("END_GROUP = IMAGE", "END;")
