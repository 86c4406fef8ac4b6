"""Trials of the algorithms after the DSM: inputs that are drawn at random from surfaces known by formula, with what the
result must be.

Half of the trials are sound: their result must be right, without a warning. The others have one fault that real data
have: the result must be right, refused, or named.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np

from benchmarks.runner import stage
from benchmarks.twin_world import (
    FEET,
    FROM_ECEF,
    SIDE_M,
    Box,
    Change,
    Form,
    World,
    between,
    cells_of,
    read,
    store,
    undulation,
    write,
    write_boxes,
    write_errors,
)
from repm_qgis.contracts.stages import (
    BUILDINGS,
    CHANGE,
    CHECKGCPS,
    COMPAREDSM,
    DTM,
    EDITDSM,
    MOSAIC,
    SERIES,
    TILES3D,
)
from repm_qgis.runtime.progress import Silent

_HALVES = (-SIDE_M / 2, -SIDE_M / 2, 0.0, SIDE_M / 2)
_GEOID_GAP = 46.7
_UNSEEN_M = 1.0
Fault = Callable[[Form], Form]
"""What is wrong with a raster: its form with the fault."""


class Heard(Silent):
    """Keeps what a run warns of."""

    def __init__(self) -> None:
        self.findings: List[str] = []

    def warn(self, finding: str) -> None:
        self.findings.append(str(finding))


@dataclass(frozen=True)
class Trial:
    """What is tried, whether its input is sound, and the run, which gives "" or what is wrong with its result."""

    what: str
    sound: bool
    run: Callable[[Heard], str]


@dataclass(frozen=True)
class Draw:
    """A trial's world, its folder and its random numbers; ``shared`` is a folder for what all trials use."""

    world: World
    folder: Path
    rng: np.random.Generator
    shared: Path

    def path(self, name: str) -> str:
        return str(self.folder / name)

    def form(self, **fixed: object) -> Form:
        """A sound form: any CRS, cell, datum, unit, holes and type of numbers."""
        rng = self.rng
        crs = [self.world.utm(), self.world.utm(), self.world.utm(1), "EPSG:3857", "EPSG:3035"][rng.integers(5)]
        unit = ["m", "m", "ft"][rng.integers(3)]
        form = Form(
            crs=crs,
            cell=float([0.5, 0.6, 0.75, 1.0][rng.integers(4)]),
            datum=["ellipsoid", "EGM96"][rng.integers(2)],
            unit=unit,
            scaled=unit == "m" and rng.random() < 0.2,
            holes=float([0.0, 0.0, 0.04][rng.integers(3)]),
            fill=float([-9999.0, 32767.0, -3.4e38][rng.integers(3)]),
        )
        form = replace(form, fill=-9999.0) if form.scaled and form.fill < -1e6 else form
        return replace(form, **fixed)  # type: ignore[arg-type]

    def kind(self, *kinds: str) -> str:
        """One of some kinds of trials, "" for a sound one."""
        return kinds[self.rng.integers(len(kinds))]

    def any_fault(self, alone: bool = False) -> Tuple[str, Fault]:
        """A fault of a raster of heights; of one that is used alone, what it shows by itself."""
        faults = VOIDS if alone else FAULTS
        name = list(faults)[self.rng.integers(len(faults))]
        return name, faults[name]


VOIDS: Dict[str, Fault] = {
    "void of -9999 that nothing declares": lambda f: _void(f, -9999.0),
    "void of 32767 that nothing declares": lambda f: _void(f, 32767.0),
    "void of -3.4e38 that nothing declares": lambda f: replace(_void(f, -3.4028234663852886e38), scaled=False),
    "void of 0 that nothing declares": lambda f: _void(f, 0.0),
}
"""What shows in a raster alone."""
FAULTS: Dict[str, Fault] = {
    **VOIDS,
    "datum that nothing states, 46.7 m away": lambda f: replace(f, datum="", added=f.added - _GEOID_GAP, unit="m"),
    "feet that nothing states": lambda f: replace(f, unit="ft", states_unit=False, scaled=False),
    "place 25 m beside": lambda f: replace(f, moved=(25.0, 0.0)),
    "CRS of the zone beside": lambda f: replace(f, crs_of_file=_beside(f.crs)),
}
"""What shows beside another raster only."""
OTHER_GROUND: Dict[str, Fault] = {
    "of another town": lambda f: f,
    "mirrored": lambda f: replace(f, turned=(-1.0, 1.0)),
    "turned by 180 degrees": lambda f: replace(f, turned=(-1.0, -1.0)),
    "upside down": lambda f: replace(f, factor=-1.0),
    "in feet near the sea": lambda f: replace(f, unit="ft", states_unit=False),
}
"""What an alignment must not hide: the world of the raster is :func:`_other_ground`'s."""


def _other_ground(draw: Draw, fault: str, world: World) -> Tuple[World, World]:
    """A world with relief, near the sea, and what the wrong raster shows of it."""
    world = replace(world, base=float(draw.rng.uniform(0.5, 3.0)), relief=float(draw.rng.uniform(2, 5)))
    town = World.drawn(world.seed + 1) if fault == "of another town" else world
    return world, replace(world, seed=town.seed, houses=town.houses, slope=town.slope)


def _void(form: Form, fill: float) -> Form:
    return replace(form, holes=0.06, fill=fill, declares=False, unit="m")


def _beside(crs: str) -> str:
    code = int(crs.split(":")[1])
    return f"EPSG:{code + 1}" if 32600 < code < 32660 else crs


def with_houses(draw: Draw, least: int = 2) -> World:
    """A draw's world, or another one, with so many houses at least."""
    world = draw.world
    while len(world.houses) < least:  # what stands in a place without houses is no question
        world = World.drawn(int(draw.rng.integers(1 << 30)))
    return world


def off_by(value: float, true: float, most: float, what: str) -> str:
    """What is wrong with a figure that may be off by so much; "" where nothing is."""
    return "" if abs(value - true) <= most else f"{what} is {value:.2f} instead of {true:.2f} (at most {most:.2f} off)"


def _first(*found: str) -> str:
    return next(filter(None, found), "")


ERRORS: Dict[str, Tuple[str, float]] = {
    "zero errors": ("expected errors of 0", 0.0),
    "centimetres": ("expected errors in centimetres", 10.0),
    "negative errors": ("expected errors below 0", -0.1),
}
"""Expected errors that cannot be, of heights with a noise of 0.1 m."""


def change(draw: Draw) -> Trial:
    """Two dates: the volumes of a heap and a pit, and how the second date was moved."""
    before, rng = draw.world, draw.rng
    after = before.with_changes()
    moved = tuple(map(float, rng.uniform(-0.8, 0.8, 2)))
    # Without a datum that both state, a height between the dates is what the alignment takes out.
    one = draw.form(sigma=0.1, holes=0.0, scaled=False)
    two = draw.form(sigma=0.1, holes=0.0, scaled=False, moved=moved, added=float(rng.uniform(-1, 1)))
    two = replace(two, metadata={"REPM_DAYS": "2024-05-01"})
    one = replace(one, metadata={"REPM_DAYS": "2020-05-01"})
    kind = draw.kind(
        *("", "", "", "wall", "raster", "gap", "moved", "reversed", "copy", "zero errors", "beside", "half"),
        *("centimetres", "negative errors", "other"),
    )
    fault, hole, align, conf_two = "", None, "3d", two
    if kind == "raster":
        fault, change_it = draw.any_fault()
        two = conf_two = change_it(two)
    elif kind == "other":
        name = list(OTHER_GROUND)[rng.integers(len(OTHER_GROUND))]
        fault, align = f"a date {name}, aligned", ["vertical", "3d"][int(rng.integers(2))]
        before, after = _other_ground(draw, name, before)
        after, two = after.with_changes(), OTHER_GROUND[name](two)
        conf_two = replace(two, turned=(1.0, 1.0))
    elif kind == "gap":
        fault, hole = "expected errors without those of the heap", after.changes[0]
    elif kind == "moved":
        fault, conf_two = "expected errors of a place 40 m beside", replace(two, covers=_moved(two.covers, 40.0))
    elif kind == "reversed":
        fault = "dates in reverse"
    elif kind == "copy":
        fault = "a copy as the second date"
    elif kind in ERRORS:
        fault = ERRORS[kind][0]
    elif kind == "wall":  # sound: a heap on a roof and on the ground beside it
        before = replace(before, houses=((-8.0, -8.0, 8.0, 8.0, float(rng.uniform(5, 9))),))
        after = replace(before, changes=((-2.0, -4.0, 18.0, 11.0, 5.0), (-40.0, -45.0, -25.0, -25.0, -4.0)))
    elif kind == "beside":
        fault, align = "a date 5 m beside, not aligned", ["none", "vertical"][int(rng.integers(2))]
        two = conf_two = replace(two, moved=(5.0, 0.0), added=0.0)
    elif kind == "half":
        fault, two = "a date of one half", replace(two, covers=_HALVES)
        conf_two = two

    def run(heard: Heard) -> str:
        error = ERRORS[kind][1] if kind in ERRORS else 0.1
        paths = {"before": write(draw.path("a.tif"), before, one, seed=1)}
        paths["after"] = write(draw.path("b.tif"), before if kind == "copy" else after, two, seed=2)
        if kind == "copy":
            write(draw.path("b.tif"), before, one, seed=1)
        paths["before_confidence"] = write_errors(draw.path("ca.tif"), before, one, error)
        own = one if kind == "copy" else conf_two
        paths["after_confidence"] = write_errors(draw.path("cb.tif"), after, own, error, hole)
        added, taken = after.volumes()
        if kind == "reversed":
            paths = {
                "before": paths["after"],
                "after": paths["before"],
                "before_confidence": paths["after_confidence"],
                "after_confidence": paths["before_confidence"],
            }
        made = stage(CHANGE, heard, output=draw.path("d.tif"), report=draw.path("r.html"), align=align, **paths)
        most = 0.1 + 0.3 * max(one.cell, two.cell)
        return _first(
            off_by(made.gained_m3, added, 3 * made.gained_deviation_m3 + 0.08 * added, "what was gained, m3,"),
            off_by(made.lost_m3, taken, 3 * made.lost_deviation_m3 + 0.08 * taken, "what was lost, m3,"),
            off_by(made.dx, -two.moved[0], most, "the shift to the east, m,"),
            off_by(made.dy, -two.moved[1], most, "the shift to the north, m,"),
        )

    return Trial(fault or "sound", not fault, run)


def _moved(covers: Tuple[float, float, float, float], east: float) -> Tuple[float, float, float, float]:
    return covers[0] + east, covers[1], covers[2] + east, covers[3]


SERIES_FAULTS: Dict[str, Dict[str, object]] = {
    "offset": {"added": 2.0},
    "beside": {"moved": (5.0, 0.0)},
    "half": {"covers": _HALVES},
}


def series(draw: Draw) -> Trial:
    """Five dates of a box that rises: its volume against the first date."""
    world, rng = draw.world, draw.rng
    box = (-25.0, -25.0, 25.0, 25.0)
    rate = float(rng.uniform(0.8, 2.0))
    form = draw.form(sigma=0.1, scaled=False)
    kinds = (
        "",
        "",
        "",
        "errors",
        "raster",
        "copy",
        "reversed",
        "year",
        "offset",
        "beside",
        "half",
        "centimetres",
        "crossed",
        "other",
        "raised",
    )
    kind, fault, change_it, align = draw.kind(*kinds), "", None, "none"
    shown = world
    if kind in ("other", "raised"):
        align = ["vertical", "3d"][int(rng.integers(2))]
    if kind == "raster":
        fault, change_it = draw.any_fault()
    elif kind == "other":
        name = list(OTHER_GROUND)[rng.integers(len(OTHER_GROUND))]
        fault, change_it = f"a date {name}, aligned", OTHER_GROUND[name]
        world, shown = _other_ground(draw, name, world)
    elif kind != "errors":
        fault = {
            "": "",
            "raised": "a date with most of the ground raised, aligned",
            "centimetres": "expected errors in centimetres",
            "copy": "a copy as a date",
            "reversed": "DATES in reverse",
            "year": "a year that cannot be",
            "offset": "one date 2 m too high",
            "beside": "a date 5 m beside, not aligned",
            "half": "a date of one half",
            "crossed": "a polygon that crosses itself",
        }[kind]

    def run(heard: Heard) -> str:
        days, paths = [f"{2018 + 2 * k}-05-01" for k in range(4)], []
        for k, day in enumerate(days):
            dated = replace(form, metadata={"REPM_DAYS": day})
            if k == 2 and change_it is not None:
                dated = change_it(dated)
            if k == 2:
                dated = replace(dated, **SERIES_FAULTS.get(kind, {}))  # type: ignore[arg-type]
            source = k - 1 if kind == "copy" and k == 3 else k
            changes: Tuple[Box, ...] = ((*box, 2 * rate * source),)
            if kind == "raised" and k == 2:
                changes = (*changes, (-SIDE_M, -SIDE_M, SIDE_M, 15.0, 3.0))
            seen = replace(shown if k == 2 else world, changes=changes)
            paths.append(write(draw.path(f"{k}.tif"), seen, dated, seed=source))
        said = list(reversed(days)) if kind == "reversed" else list(days)
        if kind == "year":
            said[3] = ["0018-05-01", "2320-05-01"][int(rng.integers(2))]
        areas = write_boxes(draw.path("areas.geojson"), world, ((*box, 0.0),))
        if kind == "crossed":
            _cross(areas)
        target = {"output": draw.path("s.tif"), "report": draw.path("r.html")}
        errors = []
        if kind in ("errors", "centimetres"):
            errors = [write_errors(draw.path(f"e{k}.tif"), world, form, 0.1) for k in range(4)]
            errors[1] = write_errors(draw.path("e1.tif"), world, form, 10.0 if kind == "centimetres" else 0.1)
        made = stage(SERIES, heard, dsms=paths, dates=said, areas=areas, confidences=errors, align=align, **target)
        true = 6 * rate * 2500.0
        return off_by(made.volume_m3, true, 3 * made.volume_deviation_m3 + 0.05 * true, "the volume, m3,")

    return Trial(fault or "sound", not fault, run)


def _cross(path: str) -> None:
    """Exchange two vertices of a file's first polygon."""
    document = json.loads(Path(path).read_text(encoding="utf-8"))
    ring = document["features"][0]["geometry"]["coordinates"][0]
    ring[1], ring[2] = ring[2], ring[1]
    Path(path).write_text(json.dumps(document), encoding="utf-8")


def mosaic(draw: Draw) -> Trial:
    """Two DSMs that overlap: the mosaic's heights are those of the formula."""
    world = draw.world
    left = draw.form(covers=(-SIDE_M / 2, -SIDE_M / 2, 20.0, SIDE_M / 2))
    right = draw.form(covers=(-20.0, -SIDE_M / 2, SIDE_M / 2, SIDE_M / 2), datum=left.datum)
    kinds = "", "", "", "errors", "raster", "copy", "relief", "centimetres", "tilted", "bare"
    kind, fault, shown, surface = draw.kind(*kinds), "", world, "surface"
    if kind == "raster":
        fault, change_it = draw.any_fault()
        right = change_it(right)
        if right.moved != left.moved:
            right = replace(right, moved=(12.0, 0.0))  # what the overlap is wide enough to show
        if right.moved != left.moved and world.difference(right, left, (-20.0, 20.0))[1] < _UNSEEN_M:
            # Over smooth ground a displacement changes heights by less than DSMs are wrong.
            fault, right = "", replace(right, moved=left.moved)
    elif kind == "copy":
        fault = "a copy as a second DSM"
    elif kind == "centimetres":
        fault = "expected errors in centimetres"
    elif kind == "tilted":
        fault, tilt = "a DSM that is tilted", float(draw.rng.uniform(4, 9) * draw.rng.choice((-1, 1))) / SIDE_M
        shown = replace(world, slope=(world.slope[0] + tilt, world.slope[1]))
    elif kind == "bare":
        fault, surface = "a terrain as a second DSM", "ground"
        houses = tuple((x - 8.0, -8.0, x + 8.0, 8.0, float(draw.rng.uniform(5, 12))) for x in (0.0, 38.0))
        world = shown = replace(world, houses=(*houses, *world.houses))
    elif kind == "relief":
        fault = "a DSM of another relief"
        other = World.drawn(world.seed + 1)
        hills = float(draw.rng.uniform(3, 8))
        shown = replace(other, lon=world.lon, lat=world.lat, base=world.base, relief=hills)

    def run(heard: Heard) -> str:
        one = write(draw.path("a.tif"), world, left, seed=1)
        form, seed = (left, 1) if kind == "copy" else (right, 2)
        other = write(draw.path("b.tif"), shown, form, surface, seed)
        target = {"output": draw.path("m.tif"), "report": draw.path("r.html"), "crs": world.utm()}
        errors = []
        if kind in ("errors", "centimetres"):
            wrong = 5.0 if kind == "centimetres" else 0.05
            errors = [
                write_errors(draw.path(f"e{error}.tif"), world, form, error)
                for form, error in ((left, 0.05001), (right, wrong))
            ]
        made = stage(MOSAIC, heard, dsms=[one, other], confidences=errors, **target)
        above = undulation(world.lon, world.lat) if left.datum == "EGM96" else 0.0
        missing = "the second DSM's houses are missing" if kind == "bare" else ""
        return missing or _heights_right(str(made.output), world, above, 0.25)

    return Trial(fault or "sound", not fault, run)


def _heights_right(path: str, world: World, above: float, most: float, heights: str = "surface") -> str:
    """What is wrong with the heights of a raster whose zero lies so far above the ellipsoid."""
    values, x, y = read(path, world)
    away = values + above - getattr(world, heights)(x, y)
    low, middle, high = np.percentile(away, (10, 50, 90))
    return _first(
        off_by(float(middle), 0.0, most, "the median height error, m,"), off_by(low, 0.0, 4 * most, "P10, m,")
    )[:200] or off_by(float(high), 0.0, 4 * most, "P90, m,")


def comparedsm(draw: Draw) -> Trial:
    """A DSM with a known bias against a reference."""
    world, rng = draw.world, draw.rng
    dsm, reference = draw.form(added=float(rng.uniform(-0.4, 0.4))), draw.form()
    kind, fault, align = "", "", "none"
    kind = draw.kind("", "", "raster", "copy", "part", "beside", "classes", "other", "tilt", "burst")
    shown = world
    if kind == "classes":
        return _by_class(draw, *CLASSES[int(rng.integers(len(CLASSES)))])
    if kind == "raster":
        fault, change_it = draw.any_fault()
        reference = change_it(reference)
    elif kind == "beside":
        fault, align = "a DSM 5 m beside, not aligned", ["none", "vertical"][int(rng.integers(2))]
        dsm = replace(dsm, moved=(5.0, 0.0))
    elif kind == "other":
        name = list(OTHER_GROUND)[rng.integers(len(OTHER_GROUND))]
        fault, align = f"a DSM {name}", ["none", "vertical", "3d"][int(rng.integers(3))]
        world, shown = _other_ground(draw, name, world)
        dsm = OTHER_GROUND[name](replace(dsm, scaled=False))
    elif kind == "tilt":
        fault, dsm = "a DSM tilted by 1.5 to 5 m", replace(dsm, tilt=float(rng.uniform(1.5, 5) * rng.choice((-1, 1))))
    elif kind == "burst":
        fault, dsm = "a burst in one piece", replace(dsm, holes=0.0)
        x, y = rng.uniform(-50, 30, 2)
        shown = replace(world, changes=((x, y, x + 20.0, y + 18.0, float(rng.choice((-50.0, 50.0)))),))
    elif kind == "copy":
        fault = "the DSM as its own reference"
    elif kind == "part":
        fault, dsm = (
            "a DSM of a twentieth of the reference",
            replace(dsm, covers=(-60.0, -60.0, -33.0, -33.0), holes=0.0),
        )

    def run(heard: Heard) -> str:
        one = write(draw.path("a.tif"), shown, dsm, seed=1)
        other = one if kind == "copy" else write(draw.path("b.tif"), world, reference, seed=2)
        if kind == "copy":
            other = write(draw.path("c.tif"), world, dsm, seed=1)
        made = stage(COMPAREDSM, heard, dsm=one, reference=other, align=align, report=draw.path("r.html"))
        bias, spread = world.difference(replace(dsm, moved=(0.0, 0.0)), reference)
        if kind in ("other", "tilt", "burst"):
            return fault  # which medians may not show
        return _first(
            off_by(float(made.bias if made.bias is not None else np.nan), bias, 0.12, "the bias, m,"),
            off_by(float(made.nmad if made.nmad is not None else np.nan), spread, 0.25, "the NMAD, m,"),
        )

    return Trial(fault or "sound", not fault, run)


CLASSES: Tuple[Tuple[str, float, float], ...] = (
    ("", 0.0, 90.0),
    ("CLASSES 20 m beside", 20.0, 90.0),
    ("CLASSES of another place", 400.0, 90.0),
    ("CLASSES of a tenth", 0.0, 20.0),
    ("CLASSES turned by 180 degrees", 19.0, 90.0),
    ("CLASSES of another town", 0.0, 90.0),
    ("CLASSES without a value", 0.0, 90.0),
)
"""How far class rasters of houses lie beside their place, and to where they reach, m."""


def _by_class(draw: Draw, fault: str, beside: float, half: float) -> Trial:
    """The bias of roofs, which is not that of the ground."""
    world, rng = with_houses(draw, 4 if "CLASSES" in fault else 2), draw.rng
    bias, more = float(rng.uniform(-0.4, 0.4)), float(rng.uniform(0.5, 1.0))
    dsm, reference = draw.form(added=bias), draw.form()
    others = World.drawn(world.seed + 1).houses
    higher = replace(world, houses=tuple((*house[:4], house[4] + more) for house in world.houses))

    def run(heard: Heard) -> str:
        paths = {"dsm": write(draw.path("a.tif"), higher, dsm, seed=1)}
        paths["reference"] = write(draw.path("b.tif"), world, reference, seed=2)
        form = Form(world.utm(), 1.0, _moved((-half, -half, half, half), beside), datum="")
        transform, shape, x, y = cells_of(world, form)
        flat = replace(world, base=0.0, slope=(0.0, 0.0), relief=0.0)
        if "town" in fault:  # with its houses between the places of these
            flat = replace(
                flat, houses=tuple((x0 + 19, y0 + 11, x1 + 19, y1 + 11, 5.0) for x0, y0, x1, y1, _ in others)
            )
        turn = -1.0 if "turned" in fault else 1.0
        kinds = np.where(flat.surface(turn * (x - beside), turn * y) > 0.0, 6.0, 2.0)
        hidden = np.full(shape, "without" in fault)
        paths["classes"] = store(draw.path("k.tif"), kinds, hidden, transform, form)
        found = stage(COMPAREDSM, heard, report=draw.path("r.html"), **paths).by_class
        roofs, ground = (found[name].bias if name in found else None for name in ("6", "2"))
        return _first(
            off_by(np.nan if roofs is None else roofs, bias + more, 0.15, "the bias of roofs, m,"),
            off_by(np.nan if ground is None else ground, bias, 0.15, "the bias of the ground, m,"),
        )

    return Trial(fault or "sound", not fault, run)


def dtm(draw: Draw) -> Trial:
    """The terrain below a DSM is the ground of the formula."""
    world, rng = draw.world, draw.rng
    form = draw.form(datum="ellipsoid")
    kind, fault = draw.kind("", "", "raster", "steep"), ""
    if kind == "raster":
        fault, change_it = draw.any_fault(alone=True)
        form = change_it(form)
    elif kind == "steep":
        fault = "ground steeper than SLOPE"
        world = replace(world, slope=(float(rng.uniform(0.7, 1.2)), 0.0))

    def run(heard: Heard) -> str:
        path = write(draw.path("a.tif"), world, form, seed=1)
        made = stage(DTM, heard, dsm=path, largest=40.0, output=draw.path("t.tif"), report=draw.path("r.html"))
        return _heights_right(str(made.output), world, 0.0, 0.3, "ground")

    return Trial(fault or "sound", not fault, run)


TERRAINS: Dict[str, Change] = {
    "constant": lambda heights: np.full(heights.shape, np.median(heights)),
    "of another town": np.asarray,
    "upside down": np.flipud,
    "mirrored": np.fliplr,
    "of doubled relief": lambda heights: 2 * heights - np.median(heights),
}
"""Terrains that are not the DSM's."""


def buildings(draw: Draw) -> Trial:
    """Number, area and volume of the houses."""
    world, rng = with_houses(draw), draw.rng
    flat = {"crs": world.utm(), "cell": 0.5, "holes": 0.0}
    dsm, ground = draw.form(**flat), draw.form(**flat)
    kinds = "", "", "", "low", "near", "tilted", "half", "raster", "terrain", "web", *TERRAINS
    kind, fault, tilt = draw.kind(*kinds), "", 0.0
    if kind == "raster":
        fault, change_it = draw.any_fault()
        dsm = change_it(dsm)
    elif kind == "near":
        fault, ground = "a terrain 2 to 3 m off", replace(ground, added=float(rng.uniform(2, 3) * rng.choice((-1, 1))))
    elif kind == "tilted":
        fault, tilt = "a terrain tilted by 2 to 3 m", float(rng.uniform(4, 6)) / SIDE_M
    elif kind in TERRAINS:
        fault = f"a terrain that is {kind}"
        if rng.random() < 0.5:  # a tilt is named as such, and tells nothing of the relief
            world = replace(world, slope=(0.0, 0.0), relief=float(rng.uniform(0.2, 5.0)))
    elif kind == "web":
        fault, dsm = "a CRS that distorts", replace(dsm, crs="EPSG:3857")
    elif kind == "terrain":
        fault, change_it = draw.any_fault()
        fault, ground = f"terrain: {fault}", change_it(ground)
    elif kind == "low":
        fault, ground = "a terrain 46.7 m lower", replace(ground, added=-_GEOID_GAP)
    elif kind == "half":
        fault, ground = "a terrain of one half", replace(ground, covers=_HALVES)

    def run(heard: Heard) -> str:
        path = write(draw.path("a.tif"), world, dsm, seed=1)
        tilted = replace(world, slope=(world.slope[0] + tilt, world.slope[1]))
        if kind == "of another town":
            tilted = replace(World.drawn(world.seed + 1), lon=world.lon, lat=world.lat, base=world.base)
        below = write(draw.path("t.tif"), tilted, ground, "ground", 2, TERRAINS.get(kind, np.asarray))
        report = draw.path("r.html")
        made = stage(BUILDINGS, heard, dsm=path, dtm=below, output=draw.path("b.gpkg"), report=report)
        area = sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1, _ in world.houses)
        volume = sum(map(world.built, world.houses))
        return _first(
            off_by(float(made.n_buildings), float(len(world.houses)), 0.0, "the number of buildings"),
            off_by(made.area_m2, area, 0.1 * area + 5, "their area, m2,"),
            off_by(made.volume_m3, volume, 0.12 * volume + 30, "their volume, m3,"),
        )

    return Trial(fault or "sound", not fault, run)


def editdsm(draw: Draw) -> Trial:
    """A box whose heights are set."""
    world, rng = draw.world, draw.rng
    form = draw.form(datum="ellipsoid")
    box, value = (-15.0, -12.0, 14.0, 13.0, 0.0), float(world.base + rng.uniform(-3, 3))
    kind, fault = draw.kind("", "", "raster", "value", "far", "line", "line at 0", "crossed"), ""
    if kind == "raster":
        fault, change_it = draw.any_fault(alone=True)
        form = change_it(form)
    elif kind == "far":
        fault, value = "a height far from the ground", value + float(rng.uniform(150, 600) * rng.choice((-1, 1)))
    elif kind == "crossed":
        fault = "a polygon that crosses itself"
    elif kind == "line at 0":
        fault, value = "a breakline at 0", 0.0
    elif kind == "value":
        fault, value = "a height that cannot be", float([-9999.0, 32767.0, -3.4e38][rng.integers(3)])

    def run(heard: Heard) -> str:
        path = write(draw.path("a.tif"), world, form, seed=1)
        edits = write_boxes(draw.path("e.geojson"), world, (box,))
        if kind == "crossed":
            _cross(edits)
        document = json.loads(Path(edits).read_text(encoding="utf-8"))
        feature = document["features"][0]
        feature["properties"] = {"number": 1, "operation": "set", "value": value, "enabled": 1}
        if kind.startswith("line"):  # as wide as the box
            feature["properties"].update(operation="breakline", width=50.0)
            corners = feature["geometry"]["coordinates"][0]
            ends = [np.mean([corners[a], corners[b]], axis=0).tolist() for a, b in ((0, 1), (2, 3))]
            feature["geometry"] = {"type": "LineString", "coordinates": [[*end, value] for end in ends]}
        Path(edits).write_text(json.dumps(document), encoding="utf-8")
        made = stage(EDITDSM, heard, dsm=path, edits=edits, output=draw.path("o.tif"))
        set_to = replace(world, houses=(), slope=(0.0, 0.0), relief=0.0, base=value, changes=())
        values, x, y = read(str(made.output), world)
        line = kind.startswith("line")
        inside = (abs(x + 0.5) < (0.2 if line else 13.0)) & (abs(y - 0.5) < 11.0)
        away = values[inside] - set_to.surface(x[inside], y[inside])
        outside = (abs(x + 0.5) > (27.0 if line else 16.0)) | (abs(y - 0.5) > (40.0 if line else 14.0))
        rest = values[outside] - world.surface(x[outside], y[outside])
        return _first(
            f"the height set is {value:g} m" if kind in ("far", "line at 0") else "",
            off_by(float(np.abs(away).max(initial=0.0)), 0.0, 2.0 if line else 0.01, "the height in the box, m,"),
            off_by(float(np.percentile(np.abs(rest), 90)), 0.0, 0.5, "P90 of the errors outside, m,"),
        )

    return Trial(fault or "sound", not fault, run)


POINTS = {
    "feet": "points in feet",
    "geoid": "points above a geoid",
    "turned": "latitude as longitude",
    "near": "points 9 m beside",
    "far": "points 26 m beside",
    "zero": "heights of points that are 0",
    "random": "heights of points that are random",
    "constant": "a DSM that is constant",
}


def checkgcps(draw: Draw) -> Trial:
    """Points of known height on a DSM with a known bias."""
    world, rng = draw.world, draw.rng
    form = draw.form(added=float(rng.uniform(-0.4, 0.4)), datum="ellipsoid", holes=0.0)
    kind, fault = draw.kind("", "", "", "raster", *POINTS), ""
    if kind == "raster":
        fault, change_it = draw.any_fault()
        form = change_it(form)
    elif kind:
        fault = POINTS[kind]

    def run(heard: Heard) -> str:
        changed = TERRAINS["constant"] if kind == "constant" else np.asarray
        path = write(draw.path("a.tif"), world, form, seed=1, changed=changed)
        x, y = rng.uniform(-45, 45, (2, 30))
        height = world.surface(x, y)
        away = world.surface(x - form.moved[0], y - form.moved[1]) + form.added - height
        lon, lat = between(world.crs, "EPSG:4326").transform(x, y)
        if kind == "feet":
            height = height / FEET
        if kind == "geoid":
            height = height - undulation(world.lon, world.lat)
        if kind == "random":
            height = rng.uniform(height.min(), height.max(), height.shape)
        if kind in ("near", "far"):
            turn, by = rng.uniform(0, 2 * np.pi), 9.0 if kind == "near" else 26.0
            lon, lat = between(world.crs, "EPSG:4326").transform(x + by * np.cos(turn), y + by * np.sin(turn))
        height = height * (kind != "zero")
        lon, lat = (lat, lon) if kind == "turned" else (lon, lat)
        with open(draw.path("p.csv"), "w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            table.writerow(["id", "lon", "lat", "height", "role"])
            table.writerows(
                [f"P{k}", f"{a:.9f}", f"{b:.9f}", f"{h:.3f}", "check"]
                for k, (a, b, h) in enumerate(zip(lon, lat, height))
            )
        made = stage(CHECKGCPS, heard, gcps=draw.path("p.csv"), dsm=path, report=draw.path("r.html"))
        expected, most = float(np.median(np.abs(away))), _UNSEEN_M if kind in ("near", "far", "constant") else 0.2
        return off_by(float(made.dsm_medae or np.nan), expected, most, "the median absolute error, m,")

    return Trial(fault or "sound", not fault, run)


PICTURES = {
    "a picture of another place": (500.0, 500.0, 560.0, 560.0),
    "a picture of a quarter": (-SIDE_M / 2, -SIDE_M / 2, 0.0, 0.0),
    "a picture with colours in a quarter": (-SIDE_M / 2, -SIDE_M / 2, SIDE_M / 2, SIDE_M / 2),
}
PARTS: Dict[str, Change] = {
    "a picture with colours in a quarter": lambda values: np.where(
        np.indices(values.shape)[1] < values.shape[1] // 4, values, np.nan
    )
}


def tiles3d(draw: Draw) -> Trial:
    """The tileset's box lies where the surface is."""
    world = draw.world
    form = draw.form()
    kind, fault = draw.kind("", "", "raster", *PICTURES), ""
    if kind == "raster":
        fault, change_it = draw.any_fault(alone=True)
        form = change_it(form)
    elif kind in PICTURES:
        fault = kind

    def run(heard: Heard) -> str:
        path = write(draw.path("a.tif"), world, form, seed=1)
        extra: Dict[str, str] = {}
        if kind in PICTURES or not kind:
            covers = PICTURES.get(kind, (-SIDE_M, -SIDE_M, SIDE_M, SIDE_M))
            beside = draw.form(covers=covers, scaled=False, unit="m", holes=0.0)
            extra = {"ortho": write(draw.path("o.tif"), world, beside, "surface", 3, PARTS.get(kind, np.asarray))}
        made = stage(TILES3D, heard, dsm=path, tiles3d=draw.path("t"), **extra)
        root = json.loads(Path(made.tileset).read_text(encoding="utf-8"))["root"]
        wrong = "most of it has no colours" if kind in PICTURES else ""
        return wrong or _box_right(root["boundingVolume"]["box"], root.get("transform"), world)

    return Trial(fault or "sound", not fault, run)


def _box_right(box: List[float], transform: Optional[List[float]], world: World) -> str:
    """What is wrong with the middle of a tileset's box, and with how high it is."""
    matrix = np.array(transform or np.eye(4).ravel().tolist()).reshape(4, 4).T
    middle = (matrix @ [*box[:3], 1.0])[:3]
    lon, lat, height = FROM_ECEF.transform(*middle)
    x, y = between(world.crs, "EPSG:4326").transform(lon, lat, direction="INVERSE")
    grid = np.meshgrid(*[np.linspace(-SIDE_M / 2, SIDE_M / 2, 241)] * 2)
    surface = world.surface(*grid)
    low, high = float(surface.min()), float(surface.max())
    half = float(np.linalg.norm(np.array(box[9:12])))
    return _first(
        off_by(float(np.hypot(x, y)), 0.0, 3.0, "the distance of the box's middle, m,"),
        off_by(height, (low + high) / 2, 1.0, "the height of the box's middle, m,"),
        off_by(half, (high - low) / 2, 1.0, "half the height of the box, m,"),
    )


TRIALS: Dict[str, Callable[[Draw], Trial]] = {
    each.__name__: each for each in (change, series, mosaic, comparedsm, dtm, buildings, editdsm, checkgcps, tiles3d)
}
