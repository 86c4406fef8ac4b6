"""The facts about stages' results, as typed records that a scene keeps, and their mapping to JSON."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Callable, Dict, List, Optional, Tuple, Union, get_args, get_origin

import numpy as np

from .arrays import Altitudes, Bounds, FloatArray
from .checks import AnyFile, Array, FileName, Number, OwnFile, Range, Rectangle, types_of
from .findings import Finding
from .record import R, Record

FilePath = Annotated[str, AnyFile()]
"""The path of a file that a record names: :func:`with_files` changes it, and a scene keeps it relative to itself."""
OwnFilePath = Annotated[str, OwnFile()]
"""The same for a file that a stage wrote."""

# What a scene may hold. Our own stages stay far inside: these are the bounds of what the code after them can work with.
Name = Annotated[str, FileName()]
"""Of a view or a tile: products are files of that name."""
Count = Annotated[int, Number(0, 1 << 53, whole=True)]
Pixels = Annotated[float, Number(0, 1e9, "px")]
Metres = Annotated[float, Number(0, 1e9, "m")]
Heights = Annotated[Altitudes, Range(-22_000, 20_000, "m")]
"""Those of the Earth's surface, -12,000 to 10,000 m, with as much room."""
Ground = Annotated[Bounds, Rectangle()]
Offset = Annotated[float, Number(-1e5, 1e5, "m")]
Pointing = Annotated[FloatArray, Array((2, 3), most=1e7)]
"""An affine map of pixels, (2, 3)."""
PackedWaves = Annotated[FloatArray, Array((-1, 2), most=1e9)]
"""Jitter as one array: its first and last line, and below them its coefficients."""


def with_files(record: R, change: Callable[[str], str]) -> R:
    """The record with every file changed that it, or a record in it, names; where none is named there is no change."""
    found = {
        field.name: _files_changed(types_of(type(record))[field.name], getattr(record, field.name), change)
        for field in dataclasses.fields(record)  # type: ignore[arg-type]
    }
    changed = {name: value for name, value in found.items() if value is not getattr(record, name)}
    return dataclasses.replace(record, **changed) if changed else record  # type: ignore[type-var]


def _files_changed(kind: object, value: object, change: Callable[[str], str]) -> object:
    if kind in (FilePath, OwnFilePath):
        return change(str(value)) if value else value
    if isinstance(value, Record):
        return with_files(value, change)
    if get_origin(kind) is Union and value is not None:
        return _files_changed(get_args(kind)[0], value, change)
    if isinstance(value, tuple) and value and isinstance(value[0], Record):
        return tuple(with_files(each, change) for each in value)
    if isinstance(value, dict) and value and isinstance(next(iter(value.values())), Record):
        return {name: with_files(each, change) for name, each in value.items()}
    return value


@dataclass(frozen=True)
class HeightMapRecord(Record):
    """One height map: the tile and the pair of views that it was matched from, its file, and its figures.

    ``pair`` names the view whose (rectified) geometry the map has first. ``valid`` pixels were matched, ``filled`` ones
    have the height of the background of an occlusion. ``metres_per_px`` is the height of one px of parallax,
    ``vertical_parallax_px`` the largest that the pinhole model leaves, ``table_error_m`` the largest error of the
    interpolated triangulation. A map of several views (COLMAP) also states the ``sources`` it was matched with, all
    ``views`` of its frame, the ground ``bounds`` of that frame, and whether these are only a ``part`` of the tile.
    ``cost`` is what the pair was matched by, ``intensity`` or ``learned``, and ``alike`` the share of the ground, 0..1,
    on which the intensities of its images agree, where this is little.
    ``ground`` are the tile's bounds when it was matched, where a registration has moved them since; None where not.
    ``offsets`` (m) are to be added to the file's heights, so that they agree with those of other pairs: rows of nodes
    that are evenly spaced from the first to the last pixel; () for none.
    ``checksum`` is that of the file's values. ``reused``: an earlier, stopped run had finished the file; ``remade``: a
    file of an earlier run was damaged, and has been made again.
    """

    tile: Name
    backend: str
    pair: Tuple[Name, Name]
    metres_per_px: Metres
    vertical_parallax_px: Pixels
    table_error_m: Metres
    altitudes: Heights
    file: OwnFilePath = ""
    size: Tuple[Count, Count] = (0, 0)
    valid: Count = 0
    filled: Count = 0
    sources: Tuple[Name, ...] = ()
    views: Tuple[Name, ...] = ()
    bounds: Optional[Ground] = None
    part: bool = False
    ground: Optional[Ground] = None
    cost: str = "intensity"
    alike: float = 1.0
    checksum: str = ""
    offsets: Tuple[Tuple[Offset, ...], ...] = ()
    reused: bool = False
    remade: bool = False

    @property
    def pixels(self) -> int:
        return self.size[0] * self.size[1]

    def contradiction(self) -> str:
        rows = set(map(len, self.offsets))
        wrong = self.offsets and (len(self.offsets) < 2 or len(rows) > 1 or min(rows) < 2)
        return "has offsets that are not rows of equally many nodes, two or more" if wrong else ""


@dataclass(frozen=True)
class ViewPair(Record):
    """Two views by name: convergence angle (degrees), base-to-height ratio, and the number of tiles that both see.

    ``share`` is the part of the scene's area that both see. ``days`` is the time between the two images, ``sun_deg``
    the angle between the two directions to the sun, ``shadow`` the distance between the ends of the two shadows (m for
    each m of height). They are None where a time is unknown, the last two also where the sun had set.
    ``tied``: whether tie points are searched in it; else it only covers ground that no other pair does. ``gsd_m`` is
    the ground sampling distance of the coarser view, at which the pair is matched; None in scenes of earlier versions.
    """

    first: Name
    second: Name
    angle_deg: Annotated[float, Number(0, 180, "degrees")]
    base_to_height: Annotated[float, Number(1e-6, 1e6)]
    tiles: Count
    share: Annotated[float, Number(0, 1e6)] = 1.0
    days: Optional[float] = None
    sun_deg: Optional[float] = None
    shadow: Optional[float] = None
    tied: bool = True
    gsd_m: Optional[Annotated[float, Number(0.01, 1000.0, "m")]] = None

    @property
    def names(self) -> Tuple[str, str]:
        return self.first, self.second


@dataclass(frozen=True)
class PairFigures(Record):
    """The tie points of one pair: candidates, how many were kept, and their vertical parallax in px.

    ``before_px`` is the median with the vendors' RPCs, ``after_px`` the median of the absolute values after the
    correction, ``spread_px`` the NMAD then.
    """

    pair: Tuple[Name, Name]
    candidates: Count
    count: Count
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
    the images' centres, and ``trends_px`` how much more they are in a corner at most. ``ties_by_tile`` and
    ``ties_by_part`` (north-west, north, ...) count ties on the ground. ``control_noise_px`` is the control points'
    standard deviation, None where it cannot be estimated; ``control_information`` (3, 3) is their information about a
    shift of the whole (east, north, up), 1 / m²; ``height_uncertainty_m`` is two standard deviations of the absolute
    height, None with ground control. ``ground_m`` are heights of the ground (low, middle, high) that are known from the
    RPCs only, None with a DEM or ground control.
    """

    count: Count
    before_px: float
    after_px: float
    model: str
    reason: str
    shifts_px: Dict[str, Tuple[float, float]]
    pairs: Tuple[PairFigures, ...]
    gcps: Tuple[GcpFigures, ...] = ()
    rejected_gcps: Tuple[str, ...] = ()
    control_noise_px: Optional[float] = None
    control_information: Optional[Annotated[FloatArray, Array((3, 3), most=1e12)]] = None
    height_uncertainty_m: Optional[float] = None
    ground_m: Optional[Tuple[float, float, float]] = None
    ties_by_tile: Dict[str, Count] = dataclasses.field(default_factory=dict)
    ties_by_part: Dict[str, Count] = dataclasses.field(default_factory=dict)
    trends_px: Dict[str, Pixels] = dataclasses.field(default_factory=dict)

    @property
    def controlled(self) -> bool:
        """Whether ground control points have given the pointing its absolute position."""
        return self.height_uncertainty_m is None


@dataclass(frozen=True)
class GroundShift(Record):
    """What is added to places on the ground, in a projected CRS: ``moved`` metres east, north and up, and ``tilt`` more
    height for each metre east and north of ``centre``."""

    moved: Tuple[Offset, Offset, Offset]
    tilt: Tuple[Annotated[float, Number(-0.1, 0.1)], Annotated[float, Number(-0.1, 0.1)]] = (0.0, 0.0)
    centre: Tuple[float, float] = (0.0, 0.0)

    def up(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """What is added to heights at places, m."""
        up: FloatArray = self.moved[2] + (x - self.centre[0]) * self.tilt[0] + (y - self.centre[1]) * self.tilt[1]
        return up

    def up_at(self, place: Tuple[float, float]) -> float:
        """The same at one place."""
        x, y = (np.array([each]) for each in place)
        return float(self.up(x, y)[0])

    def applied(self, xyz: FloatArray) -> FloatArray:
        """(N, 3) places and heights, moved."""
        x, y, z = xyz.T
        return np.column_stack([x + self.moved[0], y + self.moved[1], z + self.up(x, y)])

    def then(self, later: GroundShift) -> GroundShift:
        """This shift, and a later one of what it has moved."""
        east, north, _ = (a + b for a, b in zip(self.moved, later.moved))
        up = self.moved[2] + later.up_at((self.centre[0] + self.moved[0], self.centre[1] + self.moved[1]))
        tilt = (self.tilt[0] + later.tilt[0], self.tilt[1] + later.tilt[1])
        return GroundShift((east, north, up), tilt, self.centre)

    def of_bounds(self, bounds: Bounds, sign: int = 1) -> Bounds:
        """A rectangle moved east and north; with the sign -1, back."""
        east, north = sign * self.moved[0], sign * self.moved[1]
        return Bounds(bounds[0] + east, bounds[1] + north, bounds[2] + east, bounds[3] + north)


@dataclass(frozen=True)
class LocalOffset(Record):
    """The shift that a part of a scene alone would need: its place in the scene's CRS, metres east, north and up before
    the registration, their standard deviations, and the number of heights used."""

    x: float
    y: float
    moved: Tuple[Offset, Offset, Offset]
    deviation: Tuple[Metres, Metres, Metres]
    count: Count


@dataclass(frozen=True)
class OtherRelief(Record):
    """A surface whose relief is not that of a reference: the rank ``correlation`` of the two heights, and how many
    times as high the surface's relief is (``ratio`` of the NMADs)."""

    correlation: Annotated[float, Number(-1, 1)]
    ratio: Annotated[float, Number(0, 1e9)]

    def sentence(self, reference: str) -> str:
        """The sentence for the user."""
        if self.correlation == 0.0:  # exactly: one of the two is level
            if self.ratio < 1.0:
                return f"The surface has no relief, and '{reference}' has: check what the surface shows."
            return f"'{reference}' has no relief, and the surface has: choose one that shows the heights of this place."
        if self.correlation < -0.5:
            what = "upside down, or of another place: check that each RPC belongs to its image, and the reference"
        elif self.correlation < 0.5:
            what = "of another place, or one of them noise: check that each RPC belongs to its image, and the reference"
        elif 0.6 < self.ratio < 1.6 and self.correlation < 0.95:
            what = "another surface, such as the ground below a forest: check what the reference shows"
        else:
            what = "scaled: check the units of both heights (a foot is 0.3048 m)"
        return (
            f"The surface's relief is not that of '{reference}' (correlation {self.correlation:+.2f}, "
            f"{self.ratio:.2f} times as high): it may be {what}."
        )


@dataclass(frozen=True)
class ReferenceFigures(Record):
    """A reference, and the shift of a scene that it alone gives. ``file`` as the user named it; ``datum`` of its
    heights, and ``datum_from``: the source of this datum. ``width_m`` of its cells or footprints, 0 for points.
    ``seen`` heights lie on the scene's surface, ``used`` ones have a weight. ``moved`` (m east, north, up) with
    ``deviation`` (of a direction that the relief does not determine the vendor's promise), and ``determined``
    horizontal directions (unit vectors). ``before_m`` and ``after_m`` are NMADs of the differences, ``bias_m`` their
    median before; ``range_m`` is how far they are correlated. ``other_relief`` is None where the surface has the
    reference's relief, and where that has too little relief to compare. ``unsure_m`` is the standard deviation of a
    direction that is not determined, and the largest with which one is; None where the reference is level. ``about`` is
    a sentence about its heights and which of them were taken.
    """

    file: str
    datum: str
    datum_from: str
    width_m: Tuple[Metres, Metres]
    seen: Count
    used: Count
    moved: Tuple[Offset, Offset, Offset]
    deviation: Tuple[Metres, Metres, Metres]
    determined: Tuple[Tuple[float, float], ...]
    before_m: Metres
    after_m: Metres
    bias_m: float
    range_m: Metres
    other_relief: Optional[OtherRelief] = None
    unsure_m: Optional[Tuple[Metres, Metres]] = None
    about: str = ""


@dataclass(frozen=True)
class RegistrationFigures(Record):
    """How a scene was laid onto references, and the data that its height maps need to follow.

    ``shift`` is all that was added to the ground since matching; ``matched`` is the pointing of each view that the
    height maps were matched with. ``latest`` is what the last registration added, with the standard deviations of its
    east, north and up, and of its tilt (m per m); ``determined`` are the horizontal directions that it determined.
    ``control``: ground control points had a weight, too. ``promised_m`` are the expected errors without it (CE90,
    LE90). ``pointing_px`` is the largest error of the shift as pointing. ``differences`` is a raster of the references
    minus the surface, before and after. ``waves_m`` is the NMAD of a reference's differences from the maps, without and
    with the waves along the parallax that it has shown, None where it has shown none; ``waves_px`` is the largest of
    these. ``matched_waves`` are then those that the maps were matched with, of views that had some.
    """

    shift: GroundShift
    matched: Dict[Name, Pointing]
    latest: GroundShift
    deviation: Tuple[Metres, Metres, Metres]
    determined: Tuple[Tuple[float, float], ...]
    control: bool
    promised_m: Tuple[Metres, Metres]
    pointing_px: Pixels
    references: Tuple[ReferenceFigures, ...]
    offsets: Tuple[LocalOffset, ...] = ()
    differences: OwnFilePath = ""
    neighbours: Tuple[str, ...] = ()
    matched_waves: Dict[Name, PackedWaves] = dataclasses.field(default_factory=dict)
    waves_m: Optional[Tuple[Metres, Metres]] = None
    waves_px: Pixels = 0.0
    tilt_deviation: Tuple[float, float] = (0.0, 0.0)

    def unexpected(self) -> List[Tuple[str, float, float]]:
        """The parts of the shift that are larger than expected, beyond two deviations: direction, size and expected
        size, m."""
        east, north, up = self.latest.moved
        horizontal, height = self.promised_m
        parts = [
            ("horizontally", float(np.hypot(east, north)), horizontal, max(self.deviation[:2])),
            ("in height", abs(up), height, self.deviation[2]),
        ]
        return [(words, size, most) for words, size, most, deviation in parts if size > most + 2.0 * deviation]


@dataclass(frozen=True)
class DemOffset(Record):
    """How far the DSM lies above the DEM that was given, as ``file``: ``up_m`` with its standard deviation.

    ``most_m`` is the largest offset to expect, by the stated uncertainty of the absolute height; None where nothing is
    stated. ``other_relief`` is None where the DSM has the DEM's relief, and where that has too little relief to
    compare.
    """

    file: str
    up_m: Offset
    deviation_m: Metres
    most_m: Optional[Metres] = None
    other_relief: Optional[OtherRelief] = None

    @property
    def unexpected(self) -> bool:
        """Whether it is more than expected, or the relief is another one."""
        return self.other_relief is not None or self.most_m is not None and abs(self.up_m) > self.most_m

    def sentence(self) -> str:
        """The offset as a sentence: information, or a warning where it is more than expected."""
        where = f"{abs(self.up_m):.1f} m {'above' if self.up_m > 0 else 'below'} the DEM '{self.file}'"
        text = f"The DSM lies {where} (standard deviation {self.deviation_m:.2f} m)"
        if self.other_relief is not None:
            return self.other_relief.sentence(self.file)
        if self.most_m is None:
            return f"{text}."
        if not self.unexpected:
            return f"{text}, where up to {self.most_m:.1f} m are to be expected in 95 % of cases, by both their errors."
        return (
            f"{text}, where at most {self.most_m:.1f} m are to be expected (95 % of cases): check that each RPC "
            "belongs to its image and that the DEM is of this place and states its vertical datum, or lay the scene on "
            "known heights with 'Register to a reference' (REFERENCE)."
        )


@dataclass(frozen=True)
class FusionFacts(Record):
    """What fusion counted, in cells of the DSM: ``cells`` that two images see, ``valid`` ones with a height, of these
    ``matched``, ``background`` (all other sources but interpolation) and ``interpolated`` ones; ``removed`` were
    outliers, ``needles`` were far above or below all others and supported by a single map only. ``points`` are the
    cloud's, ``resolution`` is the side of a cell in units of the ``crs``. ``dem_offset`` is None where no DEM was
    given, or where it could not be compared. ``water`` are the bodies of water, of ``water_m2`` square metres together,
    that were found where the options asked for it, by the ``water_evidence``.
    """

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
    dem_offset: Optional[DemOffset] = None
    needles: int = 0
    water: int = 0
    water_m2: float = 0.0
    water_evidence: str = ""


@dataclass(frozen=True)
class StageRecord(Record):
    """A finished stage in a scene's history: what it was made from, how long it took, and its warnings.

    ``parameters`` are those that were not the defaults.
    """

    stage: str
    fingerprint: str
    engine: str
    seconds: Annotated[float, Number(0, 1e9, "s")]
    options: Dict[str, object]
    warnings: Tuple[Finding, ...] = ()
    parameters: Dict[str, object] = dataclasses.field(default_factory=dict)
