"""What stages state about their results, as typed records that a scene keeps, and their mapping to JSON."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import (
    Annotated,
    Any,
    Callable,
    Dict,
    Mapping,
    Optional,
    Tuple,
    Type,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from .arrays import Altitudes, Bounds, Size

R = TypeVar("R", bound="Record")
FilePath = Annotated[str, "file"]
"""The path of a file that a record names: :func:`with_files` changes it, and a scene keeps it relative to itself."""
_FIELD_TYPES: Dict[Any, Dict[str, Any]] = {}


class Record:
    """The base of dataclasses that are written to JSON: one entry a field, under the field's name."""

    def to_mapping(self) -> Dict[str, Any]:
        return {name: _plain(getattr(self, name)) for name in _field_types(self.__class__)}

    @classmethod
    def from_mapping(cls: Type[R], values: Mapping[str, Any]) -> R:
        """Raises KeyError, TypeError or ValueError where an entry is missing or does not fit its field's type."""
        types = _field_types(cls)
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]  # every subclass is a dataclass
            if field.name not in values and field.default is field.default_factory is dataclasses.MISSING:
                raise KeyError(field.name)
        return cls(**{name: _typed(types[name], values[name]) for name in types if name in values})


def _field_types(cls: Any) -> Dict[str, Any]:
    if cls not in _FIELD_TYPES:  # reading annotations is slow
        hints = get_type_hints(cls, include_extras=True)
        _FIELD_TYPES[cls] = {field.name: hints[field.name] for field in dataclasses.fields(cls)}
    return _FIELD_TYPES[cls]


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
    if hasattr(value, "to_mapping"):
        return value.to_mapping()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def _typed(kind: Any, value: Any) -> Any:
    """A value from JSON as a field's type has it."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin is Annotated:
        return _typed(arguments[0], value)
    if origin is Union:
        return None if value is None else _typed(arguments[0], value)
    if origin is tuple:
        kinds = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else arguments
        if len(kinds) != len(value):
            raise ValueError(f"{value!r} should have {len(kinds)} entries")
        return tuple(_typed(kind, entry) for kind, entry in zip(kinds, value))
    if origin is dict:
        return {str(name): _typed(arguments[1], entry) for name, entry in value.items()}
    if origin is np.ndarray:
        return _finite(np.array(value, dtype=np.float64))
    if hasattr(kind, "from_mapping"):
        return kind.from_mapping(value)
    if hasattr(kind, "_fields"):
        return kind(*_typed(Tuple[tuple(get_type_hints(kind).values())], value))
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        return _finite(float(value))
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise TypeError(f"{value!r} should be of the type {kind.__name__}")
    return value


def with_files(record: R, change: Callable[[str], str]) -> R:
    """The record with every file changed that it, or a record in it, names; where none is named there is no change."""
    found = {
        name: _files_changed(kind, getattr(record, name), change) for name, kind in _field_types(type(record)).items()
    }
    changed = {name: value for name, value in found.items() if value is not getattr(record, name)}
    return dataclasses.replace(record, **changed) if changed else record  # type: ignore[type-var]


def _files_changed(kind: Any, value: Any, change: Callable[[str], str]) -> Any:
    if kind == FilePath:
        return change(value) if value else value
    if isinstance(value, Record):
        return with_files(value, change)
    if get_origin(kind) is Union and value is not None:
        return _files_changed(get_args(kind)[0], value, change)
    if isinstance(value, tuple) and value and isinstance(value[0], Record):
        return tuple(with_files(each, change) for each in value)
    if isinstance(value, dict) and value and isinstance(next(iter(value.values())), Record):
        return {name: with_files(each, change) for name, each in value.items()}
    return value


def _finite(value: Any) -> Any:
    """Numbers that are finite: a scene of ours has no others."""
    if not np.isfinite(value).all():
        raise ValueError(f"{value!r} should be finite")
    return value


@dataclass(frozen=True)
class HeightMapRecord(Record):
    """One height map: the tile and the pair of views that it was matched from, its file, and its figures.

    ``pair`` names the view whose (rectified) geometry the map has first. ``valid`` pixels were matched, ``filled`` ones
    have the height of the background of an occlusion. ``metres_per_px`` is the height of one px of parallax,
    ``vertical_parallax_px`` the largest that the pinhole model leaves, ``table_error_m`` the largest error of the
    interpolated triangulation. A map of several views (COLMAP) also states the ``sources`` it was matched with, all
    ``views`` of its frame, the ground ``bounds`` of that frame, and whether these are only a ``part`` of the tile.
    ``checksum`` is that of the file's values. ``reused``: an earlier, stopped run had finished the file; ``remade``: a
    file of an earlier run was damaged, and has been made again.
    """

    tile: str
    backend: str
    pair: Tuple[str, str]
    metres_per_px: float
    vertical_parallax_px: float
    table_error_m: float
    altitudes: Altitudes
    file: FilePath = ""
    size: Size = (0, 0)
    valid: int = 0
    filled: int = 0
    sources: Tuple[str, ...] = ()
    views: Tuple[str, ...] = ()
    bounds: Optional[Bounds] = None
    part: bool = False
    checksum: str = ""
    reused: bool = False
    remade: bool = False

    @property
    def pixels(self) -> int:
        return self.size[0] * self.size[1]


@dataclass(frozen=True)
class ViewPair(Record):
    """Two views by name: convergence angle (degrees), base-to-height ratio, and the number of tiles that both see.

    ``share`` is the part of the scene's area that both see. ``days`` is the time between the two images, ``sun_deg``
    the angle between the two directions to the sun, ``shadow`` the distance between the ends of the two shadows (m for
    each m of height). They are None where a time is unknown, the last two also where the sun had set.
    """

    first: str
    second: str
    angle_deg: float
    base_to_height: float
    tiles: int
    share: float = 1.0
    days: Optional[float] = None
    sun_deg: Optional[float] = None
    shadow: Optional[float] = None


@dataclass(frozen=True)
class PairFigures(Record):
    """The tie points of one pair: candidates, how many were kept, and their vertical parallax in px.

    ``before_px`` is the median with the vendors' RPCs, ``after_px`` the median of the absolute values after the
    correction, ``spread_px`` the NMAD then.
    """

    pair: Tuple[str, str]
    candidates: int
    count: int
    before_px: float
    after_px: float
    spread_px: float


@dataclass(frozen=True)
class GcpFigures(Record):
    """A ground control point: from its true place to where the corrected images put it, m."""

    id: str
    role: str
    rejected: bool
    east_m: float
    north_m: float
    up_m: float


@dataclass(frozen=True)
class PointingFigures(Record):
    """Tie points and the relative pointing that they gave.

    ``before_px`` and ``after_px`` are the ties' median residuals. ``shifts_px`` are the corrections (column, row) at
    the images' centres. ``ties_by_tile`` and ``ties_by_part`` (north-west, north, ...) count ties on the ground.
    ``control_noise_px`` is the control points' standard deviation, None where it cannot be estimated;
    ``height_uncertainty_m`` is two standard deviations of the absolute height, None with ground control.
    """

    count: int
    detector: str
    before_px: float
    after_px: float
    model: str
    reason: str
    shifts_px: Dict[str, Tuple[float, float]]
    pairs: Tuple[PairFigures, ...]
    gcps: Tuple[GcpFigures, ...] = ()
    rejected_gcps: Tuple[str, ...] = ()
    control_noise_px: Optional[float] = None
    height_uncertainty_m: Optional[float] = None
    ties_by_tile: Dict[str, int] = dataclasses.field(default_factory=dict)
    ties_by_part: Dict[str, int] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class FusionFacts(Record):
    """What fusion counted, in cells of the DSM: ``cells`` that tiles cover, ``valid`` ones with a height, and of these
    ``matched``, ``background`` (of an occlusion) and ``interpolated`` ones; ``removed`` were outliers. ``points`` are
    the cloud's, ``resolution`` is the side of a cell in units of the ``crs``."""

    cells: int
    valid: int
    valid_percent: float
    matched: int
    background: int
    interpolated: int
    points: int
    removed: int
    resolution: float
    crs: str


@dataclass(frozen=True)
class StageRecord(Record):
    """A finished stage in a scene's history: what it was made from, how long it took, and its warnings.

    ``parameters`` are those that were not the defaults.
    """

    stage: str
    fingerprint: str
    engine: str
    seconds: float
    options: Dict[str, Any]
    warnings: Tuple[str, ...] = ()
    parameters: Dict[str, Any] = dataclasses.field(default_factory=dict)
