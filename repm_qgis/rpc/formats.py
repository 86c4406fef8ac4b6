"""One parser for each format of RPC files, chosen by the content of the file and never by its name.

Each parser finds the texts of RPC00B's members under GDAL's names (``LINE_OFF`` ... ``SAMP_DEN_COEFF``);
:func:`rpc_from_texts` converts them to numbers, in one place and strictly. All files are untrusted: sizes, lines,
nesting and counts are bounded, XML must not declare a DOCTYPE or entities, a member that is missing or present twice is
an error, and a model that does not project its own centre is rejected.

Pixels of an :class:`~repm_qgis.rpc.model.Rpc` count from (0, 0) at the first pixel's centre. So do all formats here
but DIMAP v2 (Pleiades, SPOT 6 and 7), which counts from 1; DIMAP v3 (Pleiades Neo) counts from 0 (GDAL issue 5716).
"""

from __future__ import annotations

import json
import math
import os
import re
from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import FloatArray
from ..contracts.documents import JsonObject
from ..contracts.errors import RpcInvalidError, RpcMissingError, reason_of
from .model import Rpc

Node = List[Any]
"""An XML node as GDAL gives it: [kind, text, child, child, ...]."""
Texts = Dict[str, str]
"""RPC00B's members under GDAL's names, as the file has them."""

# Bounds against hostile files, far above what real ones have.
MAX_FILE_BYTES = 8 << 20  # Maxar's XML contains the orbit too
_MAX_TEXT = 1 << 20
_MAX_LINE = 4096
_MAX_LINES = 20_000
_MAX_JSON_DEPTH = 16
_MAX_XML_DEPTH = 64
_MAX_XML_MARKS = 100_000
_ROUND_TRIP_PX = 1e-3
_MOST_ERROR_M = 5000.0
_REACH = 3.0  # of the ground's normalisers, for the middle half of the pixels; 1.02 is the most in the files we know

# Our member, and GDAL's key for it.
_GDAL_NAMES = {"row": "LINE", "col": "SAMP", "lat": "LAT", "lon": "LONG", "height": "HEIGHT"}
GDAL_KEYS = {f"{ours}_{end}": f"{name}_{end.upper()}" for end in ("off", "scale") for ours, name in _GDAL_NAMES.items()}
for _axis in ("row", "col"):
    GDAL_KEYS.update({f"{_axis}_{part}": f"{_GDAL_NAMES[_axis]}_{part.upper()}_COEFF" for part in ("num", "den")})
_SCALARS = tuple(key for key in GDAL_KEYS.values() if not key.endswith("COEFF"))
_POLYNOMIALS = tuple(key for key in GDAL_KEYS.values() if key.endswith("COEFF"))
_ACCURACY = ("ERR_BIAS", "ERR_RAND")  # metres; Airbus's ERR_BIAS_ROW, _X ... are how well the RPC fits its own sensor
_INVERSE = ("LAT_NUM_COEFF", "LAT_DEN_COEFF", "LONG_NUM_COEFF", "LONG_DEN_COEFF")

_UNITS = {
    "LINE": ("pixels", "pixel", "px", "lines"),
    "SAMP": ("pixels", "pixel", "px", "samples"),
    "LAT": ("degrees", "degree", "deg"),
    "LONG": ("degrees", "degree", "deg"),
    "HEIGHT": ("meters", "metres", "meter", "metre", "m"),
}
_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,6})?|nan|inf|infinity)", re.ASCII | re.IGNORECASE)

# RPC00A orders its twenty terms otherwise: RPC00B's term i is RPC00A's term _FROM_RPC00A[i] (NIMA STDI-0002).
_FROM_RPC00A = (0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 7, 11, 14, 17, 12, 15, 18, 13, 16, 19)


@dataclass(frozen=True)
class FoundRpc:
    """An RPC and the name of the format that it was read from."""

    rpc: Rpc
    kind: str


# --- from texts to a model ------------------------------------------------------------------------------------------


def rpc_from_texts(texts: Mapping[str, str], first_pixel: float = 0.0) -> Rpc:
    """An RPC from its members under GDAL's names; raises RpcInvalidError that names the wrong one.

    ``first_pixel`` is the number that the format gives to the first pixel's centre.
    """
    values: JsonObject = {}
    for member, key in GDAL_KEYS.items():
        if key not in texts:
            raise RpcInvalidError(f"its {key} is missing.")
        values[member] = _series(texts[key], key) if key in _POLYNOMIALS else _scalar(texts[key], key)
    values["row_off"] -= first_pixel
    values["col_off"] -= first_pixel
    return Rpc(**values, accuracy_m=_accuracy(texts))


def _accuracy(texts: Mapping[str, str]) -> Optional[float]:
    """The vendor's figure for errors on the ground, m; None where it is missing, zero, negative or unreadable.

    It never makes a file invalid: no position depends on it.
    """
    numbers = []
    for key in _ACCURACY:
        word = next(iter(texts.get(key, "")[:_MAX_LINE].split()), "")
        number = _number(word, key) if _NUMBER.fullmatch(word) else math.nan
        numbers.append(number if 0.0 < number <= _MOST_ERROR_M else 0.0)
    return math.hypot(*numbers) if numbers[0] else None


def _short(text: object) -> str:
    """A text of a file as messages may show it: one line, printable, not long."""
    line = " ".join(str(text)[:400].split())[:60]
    return "".join(letter if letter.isprintable() else "?" for letter in line)


def _number(word: str, key: str) -> float:
    if len(word) > _MAX_LINE or not _NUMBER.fullmatch(word):
        raise RpcInvalidError(f"its {key} is '{_short(word)}', which is not a number.")
    return float(word.lower().replace("d", "e"))


def _scalar(text: str, key: str) -> float:
    """One number, with the unit that RPC00B gives it or without any."""
    words = text[:_MAX_LINE].split()
    if len(words) == 2:
        units = _UNITS[key.split("_")[0]]
        if words[1].lower() not in units:
            raise RpcInvalidError(f"its {key} is '{_short(text)}': it must be in {units[0]}.")
        words.pop()
    if len(words) != 1:
        raise RpcInvalidError(f"its {key} is '{_short(text)}', which is not a number.")
    return _number(words[0], key)


def _series(text: str, key: str) -> Tuple[float, ...]:
    if len(text) > 20 * _MAX_LINE:
        raise RpcInvalidError(f"its {key} has {len(text)} characters, more than twenty numbers need.")
    return tuple(_number(word, key) for word in text.split())


def checked(rpc: Rpc) -> Rpc:
    """The RPC itself, if its centre and the pixels around it can be localised; raises RpcInvalidError.

    Planet's latitudes have negative scales. Those of rows and columns are not negative in any vendor's file: a wrong
    sign mirrors the image.
    """
    for name, scale in (("row", rpc.row_scale), ("column", rpc.col_scale)):
        if scale < 0:
            raise RpcInvalidError(f"its {name} scale is {scale:g}: it must be above zero.")
    unit = np.stack(np.meshgrid([-0.5, 0.0, 0.5], [-0.5, 0.0, 0.5]), axis=-1).reshape(-1, 2)
    pixels = unit * [rpc.col_scale, rpc.row_scale] + [rpc.col_off, rpc.row_off]
    with np.errstate(all="ignore"):
        ground = rpc.localise(pixels, rpc.height_off)
        error = np.abs(rpc.project(ground) - pixels).max()
        reach = np.abs(ground[:, :2] - [rpc.lon_off, rpc.lat_off]) / np.abs([rpc.lon_scale, rpc.lat_scale])
        areas = _signed_areas(ground)
    if not (error < _ROUND_TRIP_PX and reach.max() < _REACH and ((areas > 0).all() or (areas < 0).all())):
        reason = "pixels around its centre have no ground points around its centre"
        raise RpcInvalidError(f"its numbers are not a sensor model: {reason}.")
    return rpc


def _signed_areas(ground: FloatArray) -> FloatArray:
    """Areas of the four cells between 3 x 3 ground points; a model that folds over gives both signs."""
    grid = ground[:, :2].reshape(3, 3, 2)
    right, down = grid[:-1, 1:] - grid[:-1, :-1], grid[1:, :-1] - grid[:-1, :-1]
    areas: FloatArray = (right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]).ravel()
    return areas


def _coefficients(found: Mapping[str, str], names: Sequence[str], first: int = 1) -> Iterator[Tuple[str, str]]:
    """(name, twenty numbers) of polynomials that are given as NAME_first ... or together as NAME."""
    for name in names:
        numbered = re.compile(rf"{name}_(\d{{1,3}})", re.ASCII)
        given = {int(match[1]): text for key, text in found.items() if (match := numbered.fullmatch(key))}
        if name in found and given:
            raise RpcInvalidError(f"its {name} is given both together and number by number.")
        if name in found:
            yield name, found[name]
            continue
        for index in range(first, first + 20):
            if index not in given:
                raise RpcInvalidError(f"its {name}_{index} is missing.")
        if len(given) != 20:
            raise RpcInvalidError(f"its {name} has {len(given)} coefficients: it must have 20.")
        for index, text in given.items():
            if len(text.split()) != 1:
                raise RpcInvalidError(f"its {name}_{index} is '{_short(text)}', which is not a number.")
        yield name, " ".join(given[index] for index in range(first, first + 20))


def _add(found: Dict[str, str], key: str, text: str) -> None:
    if key in found:
        raise RpcInvalidError(f"its {key} is given twice.")
    found[key] = text


# --- KEY: value, as IKONOS, Planet, SkySat, ZY-3, GF-7 and WHU-TLC write it -----------------------------------------


def _parse_key_value(text: str) -> Rpc:
    """``LINE_OFF: 5124.00 pixels`` line by line. WHU-TLC adds the 80 coefficients of the inverse model: they must be
    complete but are not used, because ours is found from the forward model."""
    found: Dict[str, str] = {}
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if "RFM_CORRECTION_PARAMETERS" in line.upper():
            _refuse_correction(lines[number + 1 : number + 7])
            break
        key, value = _key_and_value(line)
        key = re.sub(r"^LON_", "LONG_", key.upper())
        if re.sub(r"_\d+$", "", key) in _SCALARS + _POLYNOMIALS + _INVERSE + _ACCURACY:
            _add(found, _plain_index(key), value)
    texts = {key: value for key, value in found.items() if key in _SCALARS + _ACCURACY}
    texts.update(_coefficients(found, _POLYNOMIALS))
    if any(key.startswith(_INVERSE) for key in found):
        for name, series in _coefficients(found, _INVERSE):
            if not np.isfinite(_series(series, name)).all() or len(series.split()) != 20:
                raise RpcInvalidError(f"its {name} is not twenty finite numbers.")
    return rpc_from_texts(texts)


def _key_and_value(line: str) -> Tuple[str, str]:
    separator = ":" if ":" in line else "="
    key, _, value = line.partition(separator)
    return key.strip(), value.strip()


def _plain_index(key: str) -> str:
    """LINE_NUM_COEFF_07 is LINE_NUM_COEFF_7."""
    name, _, index = key.rpartition("_")
    return f"{name}_{int(index)}" if re.fullmatch(r"\d{1,3}", index, re.ASCII) else key


def _refuse_correction(lines: Sequence[str]) -> None:
    """Six affine numbers that some software appends to correct the RPC in the image; all zeros are no correction."""
    numbers = [word for line in lines for word in re.split(r"[\s:=]+", line) if _NUMBER.fullmatch(word)]
    if len(numbers) < 6 or any(_number(word, "RFM_CORRECTION_PARAMETERS") != 0 for word in numbers):
        remedy = "remove them, or use the vendor's file"
        raise RpcInvalidError(f"it has RFM_CORRECTION_PARAMETERS, which are not supported: {remedy}.")


# --- OSSIM and Orfeo ToolBox's .geom --------------------------------------------------------------------------------


def _parse_geom(text: str) -> Rpc:
    """``line_num_coeff_00:  0.003`` line by line; pixels count from 0. Polynomials in either order of RPC00."""
    found: Dict[str, str] = {}
    for line in text.splitlines():
        key, value = _key_and_value(line)
        if re.fullmatch(r"adjustment_\d+\.adj_param_\d+\.(parameter|center)", key):
            if not _NUMBER.fullmatch(value) or float(_number(value, key)) != 0:
                raise RpcInvalidError(
                    f"its {key} is '{_short(value)}': adjusted models are not supported, use the vendor's file."
                )
        elif re.sub(r"_\d+$", "", key.upper()) in _SCALARS + _POLYNOMIALS + ("POLYNOMIAL_FORMAT",):
            _add(found, _plain_index(key.upper()), value)
    order = found.get("POLYNOMIAL_FORMAT", "")
    if order not in ("A", "B"):
        raise RpcInvalidError(f"its polynomial_format is '{_short(order)}': it must be A or B.")
    texts = {key: value for key, value in found.items() if key in _SCALARS}
    for name, series in _coefficients(found, _POLYNOMIALS, first=0):
        words = series.split()
        texts[name] = " ".join(words[i] for i in _FROM_RPC00A) if order == "A" and len(words) == 20 else series
    return rpc_from_texts(texts)


# --- DigitalGlobe's .RPB --------------------------------------------------------------------------------------------

MAXAR_SCALARS = {key: key.split("_")[0].lower() + ("Offset" if key.endswith("OFF") else "Scale") for key in _SCALARS}
MAXAR_ACCURACY = {"ERR_BIAS": "errBias", "ERR_RAND": "errRand"}
MAXAR_SERIES = {key: f"{key[:4].lower()}{key[5:8].capitalize()}Coef" for key in _POLYNOMIALS}


# A value ends with its bracket, its semicolon or its line: some writers leave semicolons out, and GDAL reads these too.
_STATEMENT = re.compile(r"(?:^|;)[ \t]*(\w+)[ \t]*=\s*(\([^)]*\)?|[^;\n]*)", re.MULTILINE)


def _parse_rpb(text: str) -> Rpc:
    """``lineOffset = 5829;`` and ``lineNumCoef = ( ... );`` in a group IMAGE, with semicolons or without."""
    head, begun, body = text.partition("BEGIN_GROUP")
    body, ended, tail = body.partition("END_GROUP")
    if not begun or not ended:
        raise RpcInvalidError("its group IMAGE is not complete.")
    if "BEGIN_GROUP" in tail or "BEGIN_GROUP" in body:
        raise RpcInvalidError("it has more than one group.")
    body = body.partition("\n")[2]
    members = {theirs: ours for ours, theirs in {**MAXAR_SCALARS, **MAXAR_ACCURACY, **MAXAR_SERIES}.items()}
    texts: Texts = {}
    for key, value in _STATEMENT.findall(body):
        ours = members.get(key)
        if ours is not None:
            _add(texts, ours, _without_brackets(value.strip(), ours) if ours in MAXAR_SERIES else value.strip())
    return rpc_from_texts(texts)


def _without_brackets(value: str, key: str) -> str:
    if not (value.startswith("(") and value.endswith(")")):
        raise RpcInvalidError(f"its {key} is not in brackets.")
    words = [word.split() for word in value[1:-1].split(",")]
    if any(len(word) != 1 for word in words):
        raise RpcInvalidError(f"its {key} is not a list of numbers with commas.")
    return " ".join(word[0] for word in words)


# --- XML: Airbus's DIMAP and Maxar's ISD ----------------------------------------------------------------------------


def _tree(text: str) -> Node:
    """GDAL's tree of a bounded XML text; raises RpcInvalidError."""
    if re.search(r"<!(?!--|\[CDATA\[)", text):
        raise RpcInvalidError("it declares a DOCTYPE or entities, which no RPC file needs.")
    if text.count("<") + text.count("=") > _MAX_XML_MARKS:
        raise RpcInvalidError(f"it has more than {_MAX_XML_MARKS} elements and attributes, which no RPC file has.")
    depth = 0
    for mark in re.finditer(r"<(/?)[A-Za-z_][^<>]*>", text):
        depth += -1 if mark[1] else 0 if mark[0].endswith("/>") else 1
        if depth > _MAX_XML_DEPTH:
            raise RpcInvalidError(f"its elements nest deeper than {_MAX_XML_DEPTH}, which no RPC file's do.")
    gdal.ErrorReset()
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        # GDAL's parser splits characters into bytes, and its Python binding crashes on references to invalid
        # characters (&#xD800;). All texts that we look for are plain ASCII.
        tree = gdal.ParseXMLString(text.encode("ascii", "replace").decode("ascii").replace("&", "?"))
        reason = gdal.GetLastErrorMsg()
    except (RuntimeError, SystemError, UnicodeError) as error:
        tree, reason = None, str(error)
    finally:
        gdal.PopErrorHandler()
    if not tree:
        raise RpcInvalidError(f"it is not complete XML ({_short(reason)}).")
    found: Node = tree
    return found


def _elements(node: Node, name: Optional[str] = None) -> List[Node]:
    """The child elements of a node, those of one name or all."""
    return [child for child in node[2:] if child[0] == gdal.CXT_Element and name in (None, child[1].rpartition(":")[2])]


def _anywhere(tree: Node, name: str) -> List[Node]:
    """All elements of a name in a tree, at any depth."""
    found, pending = [], [[gdal.CXT_Element, "", tree]]
    while pending:
        node = pending.pop()
        found += _elements(node, name)
        pending += _elements(node)
    return found


def _only(nodes: List[Node], name: str) -> Node:
    """The one element of its kind; raises RpcInvalidError where there is none, or more."""
    if len(nodes) != 1:
        raise RpcInvalidError(f"it has {len(nodes)} elements {name}: it must have one.")
    return nodes[0]


def _leaf(node: Node) -> str:
    """An element's text, without attributes; with anything else in it, the text is empty and so not a number."""
    inside = [part for part in node[2:] if part[0] != gdal.CXT_Attribute]
    return inside[0][1] if len(inside) == 1 and inside[0][0] == gdal.CXT_Text else ""


def _parse_dimap(text: str) -> Rpc:
    """``RPC_*.XML`` of Pleiades and SPOT 6/7 (DIMAP v2) and of Pleiades Neo (DIMAP v3).

    v2 calls the model from the ground to the image Inverse_Model, v3 GroundtoImage_Values. v2 counts pixels from 1, v3
    from 0 (Airbus in GDAL issue 5716), whatever its validity domain starts with.
    """
    tree = _tree(text)
    model = _only(_anywhere(tree, "Global_RFM"), "Global_RFM")
    inverse = _elements(model, "Inverse_Model") + _elements(model, "GroundtoImage_Values")
    ground_to_image = _only(inverse, "Inverse_Model or GroundtoImage_Values")
    found: Dict[str, str] = {}
    for leaf in _elements(ground_to_image):
        if re.fullmatch(r"(LINE|SAMP)_(NUM|DEN)_COEFF_\d{1,3}", leaf[1]):
            _add(found, _plain_index(leaf[1]), _leaf(leaf))
    texts = dict(_coefficients(found, _POLYNOMIALS))
    for leaf in _elements(_only(_elements(model, "RFM_Validity"), "RFM_Validity")):
        key = re.sub(r"^LON_", "LONG_", leaf[1])
        if key in _SCALARS:
            _add(texts, key, _leaf(leaf))
    profiles = [_leaf(node).strip() for node in _anywhere(tree, "METADATA_PROFILE")]
    from_zero = ground_to_image[1] == "GroundtoImage_Values" or any(name.startswith("PNEO") for name in profiles)
    return rpc_from_texts(texts, first_pixel=0.0 if from_zero else 1.0)


def _parse_maxar(text: str) -> Rpc:
    """The block RPB of a WorldView or GeoEye XML: LINEOFFSET ..., and lists of twenty numbers."""
    image = _only(_elements(_only(_anywhere(_tree(text), "RPB"), "RPB"), "IMAGE"), "RPB/IMAGE")
    scalars = {ours: theirs.upper() for ours, theirs in MAXAR_SCALARS.items()}
    texts = {ours: _leaf(_only(_elements(image, theirs), theirs)) for ours, theirs in scalars.items()}
    texts.update({k: _leaf(node) for k, name in MAXAR_ACCURACY.items() for node in _elements(image, name.upper())})
    for ours, theirs in MAXAR_SERIES.items():
        block = _only(_elements(image, theirs.upper() + "List"), theirs.upper() + "List")
        texts[ours] = " ".join(_leaf(item) or "nothing" for item in _elements(block, theirs.upper()))
    return rpc_from_texts(texts)


def tile_size(path: str) -> Optional[Tuple[int, int]]:
    """Columns and rows of the tiles that a DIMAP product is divided into, from its ``DIM_*.XML``; None without tiles.

    Raises RpcInvalidError for a file that is not DIMAP, or whose tiles overlap.
    """
    tree = _tree(decoded(_content(path)))
    tilings = _anywhere(tree, "Regular_Tiling")
    if not tilings:
        return None
    tiling = _only(tilings, "Regular_Tiling")
    for name in ("OVERLAP_COL", "OVERLAP_ROW"):
        if any(_leaf(node).strip() not in ("0", "0.0") for node in _elements(tiling, name)):
            raise RpcInvalidError(f"the tiles of '{os.path.basename(path)}' overlap, which is not supported.")
    size = _only(_elements(tiling, "NTILES_SIZE"), "NTILES_SIZE")
    given = {part[1]: part[2][1] for part in size[2:] if part[0] == gdal.CXT_Attribute and len(part) > 2}
    numbers = [given.get(name, "") for name in ("ncols", "nrows")]
    if not all(re.fullmatch(r"[1-9]\d{0,6}", number) for number in numbers):
        raise RpcInvalidError(f"the tile size in '{os.path.basename(path)}' is {numbers}, which is not a size.")
    return int(numbers[0]), int(numbers[1])


# --- JSON of rpcm, S2P and the DFC2019 crops ------------------------------------------------------------------------

# rpcm's names: row_offset, alt_scale, col_num
_JSON_NAMES = {key: re.sub("off$", "offset", member).replace("height", "alt") for member, key in GDAL_KEYS.items()}


def _parse_json(text: str) -> Rpc:
    """rpcm's dictionary, or GDAL's names as in S2P's configurations, at the top or under "rpc"."""
    depth = 0
    for mark in re.finditer(r"[\[\]{}]", text):
        depth += 1 if mark[0] in "[{" else -1
        if depth > _MAX_JSON_DEPTH:
            raise RpcInvalidError(f"its brackets nest deeper than {_MAX_JSON_DEPTH}, which no RPC file's do.")
    try:
        # Numbers stay texts, so that all numbers are checked in one place.
        document = json.loads(text, object_pairs_hook=_unique, parse_int=str, parse_float=str, parse_constant=str)
    except RpcInvalidError:
        raise
    except (ValueError, RecursionError) as error:
        raise RpcInvalidError(f"it is not complete JSON ({_short(error)}).") from error
    record = document.get("rpc", document) if isinstance(document, dict) else None
    if not isinstance(record, dict):
        raise RpcInvalidError("it is not the record of one RPC.")
    names = _JSON_NAMES if "row_offset" in record else {key: key for key in GDAL_KEYS.values()}
    texts: Texts = {}
    for key, name in names.items():
        if name not in record:
            raise RpcInvalidError(f"its {name} is missing.")
        texts[key] = _json_text(record[name], name, key in _POLYNOMIALS)
    return rpc_from_texts(texts)


def _unique(pairs: Sequence[Tuple[str, Any]]) -> JsonObject:
    result: JsonObject = {}
    for key, value in pairs:
        _add(result, key, value)
    return result


def _json_text(value: object, name: str, is_series: bool) -> str:
    if isinstance(value, list) and is_series:
        if len(value) != 20 or not all(isinstance(item, str) and len(item.split()) == 1 for item in value):
            raise RpcInvalidError(f"its {name} is not a list of 20 numbers.")
        return " ".join(value)
    if not isinstance(value, str):
        raise RpcInvalidError(f"its {name} is {_short(value)}, which is not a number.")
    return value


# --- which format ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Format:
    name: str
    mark: "re.Pattern[str]"
    """Found in every file of the format, also in damaged ones, and in no file of another."""
    parse: Callable[[str], Rpc]


DIMAP = "DIMAP XML (Pleiades, SPOT, Pleiades Neo)"
_FORMATS = (
    _Format(DIMAP, re.compile(r"<(?:\w+:)?Global_RFM\b"), _parse_dimap),
    _Format("Maxar XML", re.compile(r"<RPB\b"), _parse_maxar),
    _Format("RPB", re.compile(r"\blineNumCoef\b"), _parse_rpb),
    _Format("OSSIM geom", re.compile(r"^line_num_coeff_\d\d?\s*:", re.MULTILINE), _parse_geom),
    _Format(
        "KEY: value text (_RPC.TXT, .rpc)",
        re.compile(r"^[ \t]*LINE_NUM_COEFF(_\d\d?)?[ \t]*[:=]", re.MULTILINE),
        _parse_key_value,
    ),
    _Format("JSON (rpcm, S2P)", re.compile(r"\"(?:row_num|LINE_NUM_COEFF)\"\s*:"), _parse_json),
)
FORMAT_NAMES = tuple(entry.name for entry in _FORMATS)


def decoded(data: bytes) -> str:
    """A file's text: UTF-8, UTF-16 with its mark, or Latin-1; raises RpcInvalidError where it is not a text."""
    try:
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):
            return data.decode("utf-16")
        if b"\0" in data:
            raise RpcInvalidError("it is not a text.")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise RpcInvalidError("it is marked as UTF-16 but is not.") from None
        return data.decode("latin-1")


ARCHIVED = re.compile(r"/vsi(?:zip|tar)/", re.IGNORECASE)
"""How GDAL's names of files in archives begin."""


def _content(path: str) -> bytes:
    data = _archived(path) if ARCHIVED.match(path) else _in_folder(path)
    if len(data) > MAX_FILE_BYTES:
        raise RpcInvalidError(f"it is larger than {MAX_FILE_BYTES >> 20} MiB, which no RPC file is.")
    return data


def _in_folder(path: str) -> bytes:
    if not os.path.isfile(path):
        raise RpcMissingError(f"There is no RPC file '{path}'.")
    try:
        with open(path, "rb") as stream:
            return stream.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise RpcMissingError(f"Cannot read the RPC file '{path}' ({reason_of(error)}).") from error


def _archived(path: str) -> bytes:
    stream = gdal.VSIFOpenL(path, "rb")
    if stream is None:
        raise RpcMissingError(f"There is no RPC file '{path}'.")
    try:
        return bytes(gdal.VSIFReadL(1, MAX_FILE_BYTES + 1, stream) or b"")
    finally:
        gdal.VSIFCloseL(stream)


def parsed(data: bytes) -> Optional[FoundRpc]:
    """The RPC in a file's content; None where it has the mark of no format.

    Raises RpcInvalidError, with a sentence that starts with "it" or "its", where the format is known and the
    model wrong.
    """
    text = decoded(data)
    if len(text) > _MAX_TEXT and not text.lstrip().startswith("<"):
        raise RpcInvalidError(f"it is larger than {_MAX_TEXT >> 20} MiB, which no RPC file but XML is.")
    fitting = [entry for entry in _FORMATS if entry.mark.search(text)]
    if len(fitting) > 1:
        raise RpcInvalidError(f"it fits several formats: {' or '.join(entry.name for entry in fitting)}.")
    if not fitting:
        return None
    if fitting[0].parse not in (_parse_dimap, _parse_maxar, _parse_json):
        _check_lines(text.splitlines())
    return FoundRpc(checked(fitting[0].parse(text)), fitting[0].name)


def _check_lines(lines: Sequence[str]) -> None:
    if max(map(len, lines), default=0) > _MAX_LINE:
        raise RpcInvalidError(f"it has a line of more than {_MAX_LINE} characters, which no RPC file has.")
    if len(lines) > _MAX_LINES:
        raise RpcInvalidError(f"it has {len(lines)} lines: no RPC file has more than {_MAX_LINES}.")


def read_sidecar(path: str) -> Optional[FoundRpc]:
    """The RPC of a text file; None where it has none of the formats. Raises RpcInvalidError with the file's name."""
    try:
        return parsed(_content(path))
    except RpcInvalidError as error:
        raise RpcInvalidError(f"'{os.path.basename(path)}' cannot be used: {error}") from error


# --- other facts in the same files ----------------------------------------------------------------------------------


def sidecar_text(path: str) -> str:
    """The text of a vendor's file; raises RpcMissingError or RpcInvalidError where it has none or is too large."""
    return decoded(_content(path))


def xml_texts(text: str, names: Sequence[str]) -> Dict[str, List[str]]:
    """The texts of all elements of some names in an XML text, bounded as RPC files are; raises RpcInvalidError."""
    tree = _tree(text)
    return {name: [_leaf(node) for node in _anywhere(tree, name)] for name in names}


def xml_inside(text: str, outer: str, inner: str) -> List[str]:
    """The texts of all elements of one name that lie in elements of another, as :func:`xml_texts` reads them."""
    tree = _tree(text)
    return [_leaf(node) for parent in _anywhere(tree, outer) for node in _anywhere(parent, inner)]


def xml_attributes(text: str, name: str, attribute: str) -> List[str]:
    """An attribute of all elements of one name in an XML text, bounded as RPC files are; raises RpcInvalidError."""
    found = []
    for node in _anywhere(_tree(text), name):
        inside = {part[1]: part[2][1] for part in node[2:] if part[0] == gdal.CXT_Attribute and len(part) > 2}
        found += [inside[attribute]] if attribute in inside else []
    return found
