"""Checks of values: those of options, which users give, and those in the JSON files that stages pass on.

A check has a method ``problem(value)``: what the value must be, "" where it is valid. Options name theirs in
``field(metadata=...)``, because dialogs read them too; records name theirs in the type, such as
``Annotated[float, Number(-90, 90)]``. :func:`typed` reads a value of JSON as described by such a type.
"""

from __future__ import annotations

import math
import re
from contextlib import contextmanager
from dataclasses import dataclass
from reprlib import Repr
from typing import (
    Annotated,
    Any,
    Dict,
    Iterator,
    Mapping,
    Sequence,
    Tuple,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

_NOT_IN_NAMES = re.compile(r'[\x00-\x1f\x7f/\\:*?"<>|\ud800-\udfff]')  # Windows allows the fewest characters
_DEVICES = re.compile(r"(?:CON|PRN|AUX|NUL|COM\d|LPT\d)(?:\..*)?", re.IGNORECASE)  # Windows: with any ending
_LONGEST_NAME = 255  # bytes that file systems take
_ROOM = 15  # of these for what makes names distinct
_DEEPEST = 50  # lists and objects within each other
INLINE = ("<", "{", "[")
"""How XML and JSON begin, which GDAL takes in place of a file."""
Kind = Any
"""A type, as an annotation has it."""
Typed = Any
"""A value of a type that only an annotation names."""
_types: Dict[Kind, Dict[str, object]] = {}
_words = Repr()
_words.maxstring = _words.maxother = _words.maxlong = 60


class Misfit(ValueError):
    """A value that does not pass its check: ``place`` are the names and numbers that lead to it, outermost first."""

    def __init__(self, must: str, found: str = "", place: Tuple[str, ...] = ()) -> None:
        self.must, self.found, self.place = must, found, place

    def in_member(self, name: object) -> Misfit:
        """The same, seen from the list or object that has the value under a name."""
        return Misfit(self.must, self.found, (shown(name).strip("'"), *self.place))

    def __str__(self) -> str:
        return f"{'.'.join(self.place)} {f'is {self.found}: it ' if self.found else ''}{self.must}".strip()


@contextmanager
def member(name: object) -> Iterator[None]:
    """Misfits of the block get the name of the list or object that they lie in."""
    try:
        yield
    except Misfit as misfit:
        raise misfit.in_member(name) from None


def mapping(value: object) -> Mapping[str, object]:
    """The value, if it is a JSON object; raises Misfit."""
    if not isinstance(value, Mapping):
        raise Misfit("must be an object", shown(value))
    return value


def as_text(value: object) -> str:
    """A text that GDAL gives of a file that does not say its encoding: what is no UTF-8 is read as Latin-1.

    GDAL gives such a text as bytes or with surrogates, which neither a page nor a file in UTF-8 can hold.
    """
    data = value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogateescape")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def as_texts(items: object) -> Dict[str, str]:
    """GDAL's metadata by name, each of them :func:`as_text`; empty for None."""
    return {as_text(name): as_text(text) for name, text in items.items()} if isinstance(items, Mapping) else {}


def shown(value: object) -> str:
    """A value as a message may show it: short, and on one line."""
    return _words.repr(value)


@dataclass(frozen=True)
class Choice:
    """A value that must be one of these words."""

    choices: Tuple[str, ...]

    def problem(self, value: object) -> str:
        return (
            "" if value in self.choices else f"must be one of {', '.join(word or 'nothing' for word in self.choices)}"
        )


@dataclass(frozen=True)
class Number:
    """A number within bounds, whole or not; 0 too where it means that the program decides."""

    low: float
    high: float
    unit: str = ""
    whole: bool = False
    automatic: bool = False

    def problem(self, value: object) -> str:
        if isinstance(value, (int, float)) and not isinstance(value, (bool, float) if self.whole else bool):
            if self.low <= value <= self.high or (self.automatic and value == 0):
                return ""
        kind = "a whole number" if self.whole else "a number"
        unit = f" {self.unit}" if self.unit else ""
        zero = ", or 0 for automatic" if self.automatic else ""
        return f"must be {kind} between {self.low:.10g} and {self.high:.10g}{unit}{zero}"


@dataclass(frozen=True)
class Given:
    """A file or folder that must be named."""

    def problem(self, value: object) -> str:
        named = isinstance(value, str) and value and not _text_problem(value)
        return "" if named else "must be the path of a file or folder"


@dataclass(frozen=True)
class Switch:
    """Yes or no."""

    def problem(self, value: object) -> str:
        return "" if isinstance(value, bool) else "must be true or false"


@dataclass(frozen=True)
class FileName:
    """A name that files get on every system: no path, no device, no character that Windows refuses."""

    def problem(self, value: str) -> str:
        bad = not value or value != value.rstrip(". ") or _NOT_IN_NAMES.search(value) or _DEVICES.fullmatch(value)
        if bad or len(value.encode("utf-8", "replace")) > _LONGEST_NAME:
            return f"must be a file's name without a folder, of at most {_LONGEST_NAME} bytes"
        return ""


def file_name(text: str) -> str:
    """The text as a :class:`FileName`: the same where it is one already."""
    name = _NOT_IN_NAMES.sub("_", text).encode()[: _LONGEST_NAME - _ROOM].decode("utf-8", "ignore").rstrip(". ")
    return f"{name}_" if not name or _DEVICES.fullmatch(name) else name


@dataclass(frozen=True)
class AnyFile:
    """A file that the user named, on the network too; "" for none."""

    def problem(self, value: str) -> str:
        return "must be a path and no description" if value.lstrip().startswith(INLINE) else ""


@dataclass(frozen=True)
class OwnFile:
    """A file that a stage wrote on this machine: no network path, no description in place of a file; "" for none."""

    def problem(self, value: str) -> str:
        start = value.lstrip()
        foreign = re.match(r"/vsi|[a-z][a-z0-9+.-]+:", start, re.IGNORECASE) or start.startswith(INLINE)
        return "must be the path of a file on this machine" if foreign else ""


@dataclass(frozen=True)
class Array:
    """Numbers of this shape, none of them beyond ``most``; -1 is any length."""

    shape: Tuple[int, ...]
    most: float = 1e12

    def problem(self, value: Any) -> str:
        fits = value.ndim == len(self.shape) and all(n in (-1, m) for n, m in zip(self.shape, value.shape))
        if fits and (abs(value) <= self.most).all():
            return ""
        return f"must have the shape {' x '.join(map(str, self.shape))} and numbers up to {self.most:g}"


@dataclass(frozen=True)
class Range:
    """Two numbers within bounds, the first one below the second."""

    low: float
    high: float
    unit: str = ""

    def problem(self, value: Sequence[float]) -> str:
        right = self.low <= value[0] < value[1] <= self.high
        limits = f"between {self.low:g} and {self.high:g} {self.unit}".strip()
        return "" if right else f"must be two numbers, the smaller one first, {limits}"


@dataclass(frozen=True)
class Rectangle:
    """Bounds (xmin, ymin, xmax, ymax) that hold something, no coordinate beyond ``most``."""

    most: float = 1e9

    def problem(self, value: Sequence[float]) -> str:
        right = value[0] < value[2] and value[1] < value[3] and max(map(abs, value)) <= self.most
        return "" if right else f"must be xmin < xmax and ymin < ymax, up to {self.most:g}"


def _text_problem(value: str) -> str:
    try:
        return "" if b"\0" not in value.encode() else "must be a text without the character 0"
    except UnicodeError:  # Python's stand-ins for bytes of another encoding: no report and no GDAL takes them
        return "must be a text in UTF-8: rename the file"


def types_of(cls: Kind) -> Dict[str, object]:
    """The annotations of a class, with their checks."""
    if cls not in _types:  # reading annotations is slow
        _types[cls] = get_type_hints(cls, include_extras=True)
    return _types[cls]


def typed(kind: Kind, value: object) -> Typed:
    """A value of JSON as a type has it: lists become arrays, tuples and named tuples, objects become records.

    Raises :class:`Misfit` where it does not fit, a check of the type included. Values that have the type already are
    kept.
    """
    origin: Kind = get_origin(kind)
    arguments = get_args(kind)
    if kind is object or kind is Any:
        return _shallow(value, _DEEPEST)
    if origin is Annotated:
        result, reason = typed(arguments[0], value), ""
        for check in arguments[1:]:
            reason = reason or check.problem(result)
        return _refuse_if(reason, value, result)
    if origin is Union:
        if value is None and type(None) in arguments:
            return value
        return typed(type(value) if type(value) in arguments else arguments[0], value)
    if origin is tuple:
        return _tuple(arguments, value)
    if origin is dict:
        return {str(name): _entry(arguments[1], entry, name) for name, entry in mapping(value).items()}
    if _is_array(origin):
        return _array(value)
    if isinstance(value, kind) and (kind is bool or not isinstance(value, bool)):
        infinite = "must be finite" if isinstance(value, float) and not math.isfinite(value) else ""
        return _refuse_if(_text_problem(value) if kind is str else infinite, value, value)
    if hasattr(kind, "from_mapping"):
        return kind.from_mapping(value)
    if hasattr(kind, "_fields"):
        return kind(*_tuple(tuple(types_of(kind).values()), value))
    if kind is float and isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**1000:
        return float(value)
    name = {str: "a text", int: "a whole number", float: "a number", bool: "true or false"}.get(kind, kind.__name__)
    raise Misfit(f"must be {name}", shown(value))


def _is_array(origin: Kind) -> bool:
    """Whether ``NDArray[...]`` has this origin: ``ndarray``, or since numpy 2.5 an alias that stands for it."""
    meant: Kind = getattr(origin, "__value__", origin)
    return getattr(get_origin(meant) or meant, "__name__", "") == "ndarray"


def unfit(kind: Kind, value: object) -> str:
    """What a value of JSON must be to have a type, "" where it has it."""
    try:
        typed(kind, value)
    except Misfit as misfit:
        entry = ".".join(misfit.place)
        return f"must be a list, and entry {entry} of it {misfit.must}" if entry else misfit.must
    return ""


def _refuse_if(reason: str, value: object, result: Typed = None) -> Typed:
    if reason:
        raise Misfit(reason, shown(value))
    return result


def _entry(kind: Kind, value: object, name: object) -> Typed:
    with member(name):
        return typed(kind, value)


def _tuple(kinds: Tuple[Kind, ...], value: Typed) -> Tuple[Typed, ...]:
    _refuse_if("" if isinstance(value, (list, tuple)) else "must be a list", value)
    wanted = [kinds[0]] * len(value) if kinds[-1] is Ellipsis else kinds
    _refuse_if("" if len(wanted) == len(value) else f"must have {len(wanted)} entries", value)
    return tuple(_entry(kind, entry, number) for number, (kind, entry) in enumerate(zip(wanted, value)))


def _array(value: object) -> Typed:
    import numpy as np  # options need no numpy, and QGIS loads the options only

    try:
        array = np.array(value)
    except ValueError:  # rows of unequal length
        array = np.empty(0, dtype=object)
    _refuse_if("" if array.dtype.kind in "iuf" else "must be a list of numbers", value)
    return _refuse_if("" if np.isfinite(array).all() else "must be finite", value, array.astype(np.float64))


def _shallow(value: object, depth: int) -> Typed:
    """What no type describes, such as the options of a stage; it is limited in depth, so that code can walk through
    it."""
    _refuse_if("" if depth else f"must not be nested {_DEEPEST} deep", [])
    for entry in value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else ():
        _shallow(entry, depth - 1)
    return value
