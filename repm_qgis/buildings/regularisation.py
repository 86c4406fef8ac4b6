"""A polygon with straight walls in place of a border of cells (Sampath and Shan 2007, PE&RS 73).

The border is simplified (Douglas and Peucker 1973). What is left of it are walls, most of which run along two
perpendicular main directions; each becomes the line through all the border's parts that belong to it, and the lines are
intersected. Where the polygon differs from the border by too much, the simplified border is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import List, Optional, Tuple

import numpy as np
from osgeo import ogr

from ..contracts.arrays import FloatArray, IntArray
from .parameters import BUILDINGS, OutlineParameters

_ROUNDED = 3  # decimals of coordinates in metres
_NARROWED_M = 0.05
_ROUND_M = 1.5  # at corners the border of cells is round
_PARALLEL = math.sin(math.radians(20.0))


@dataclass(frozen=True)
class Line:
    """A wall's line: all places p with p . (-sin, cos) of its ``angle`` (radians) equal to ``offset`` (m); ``length``
    is how much of the border it stands for, m, and ``middle`` (2,) the mean place of that."""

    angle: float
    offset: float
    length: float
    middle: FloatArray

    @property
    def normal(self) -> FloatArray:
        return np.array([-math.sin(self.angle), math.cos(self.angle)])


def regular(border: ogr.Geometry, cell: float, parameters: OutlineParameters = BUILDINGS.outlines) -> ogr.Geometry:
    """The polygon of a border of cells of a side ``cell``, in metres; always a valid polygon."""
    tolerance = max(parameters.tolerance_m, parameters.tolerance_cells * cell)
    apart = max(parameters.offset_m, parameters.offset_cells * cell)
    rings = [_ring(border.GetGeometryRef(number)) for number in range(border.GetGeometryCount())]
    kept = [simplified(ring, tolerance) for ring in rings]
    angle = main_direction(rings[0], kept[0], parameters)
    made = [
        _walls(ring, corners, angle, apart, parameters) if len(corners) > 2 else None
        for ring, corners in zip(rings, kept)
    ]
    least = parameters.least_common
    straight = _polygon([ring for ring in made if ring is not None]) if made[0] is not None else None
    if straight is not None and len(straight) and _common(straight[0], border) >= least:
        return straight[0]
    large = [ring[corners] for ring, corners in zip(rings, kept) if len(corners) > 2]
    simple = _polygon(large) if len(kept[0]) > 2 else []  # without an outline, holes have nothing to lie in
    if len(simple) and _common(simple[0], border) >= least:
        return simple[0]
    return _polygon(rings)[0] if _polygon(rings) else border.Clone()


def _ring(ring: ogr.Geometry) -> FloatArray:
    """(N, 2) the corners of a ring, the last one not repeated, at each of which it turns."""
    points = np.array(ring.GetPoints())[:-1, :2]
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    turns = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) > 1e-9
    return np.asarray(points[turns])


def simplified(ring: FloatArray, tolerance: float) -> IntArray:
    """Which of a ring's corners (N, 2) are left after Douglas and Peucker's simplification, in their order."""
    first = int(np.argmax(((ring - ring.mean(axis=0)) ** 2).sum(axis=1)))
    other = int(np.argmax(((ring - ring[first]) ** 2).sum(axis=1)))
    low, high = min(first, other), max(first, other)
    count = len(ring)
    kept = {low, high}
    parts = [(low, high), (high, low + count)]
    while parts:
        start, end = parts.pop()
        if end - start < 2:
            continue
        between = ring[np.arange(start + 1, end) % count]
        a, b = ring[start % count], ring[end % count]
        along = b - a
        length = math.hypot(*along)
        if length > 0:
            share = np.clip(((between - a) @ along) / length**2, 0, 1)
            away = np.linalg.norm(between - a - share[:, None] * along, axis=1)
        else:
            away = np.linalg.norm(between - a, axis=1)
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            middle = start + 1 + worst
            kept.add(middle % count)
            parts += [(start, middle), (middle, end)]
    return np.array(sorted(kept), np.int64)


def _part(ring: FloatArray, start: int, end: int) -> Tuple[FloatArray, FloatArray]:
    """Middles (N, 2) and lengths (N,) of the border from one corner to another, without its ends, which are rounded."""
    count = len(ring)
    places = ring[np.arange(start, end + 1 if end > start else end + 1 + count) % count]
    middles, steps = (places[1:] + places[:-1]) / 2, places[1:] - places[:-1]
    lengths = np.hypot(*steps.T)
    away = np.cumsum(lengths) - lengths / 2
    cut = min(_ROUND_M, away[-1] / 4)
    inner = (away > cut) & (away < lengths.sum() - cut)
    return (middles[inner], steps[inner]) if inner.sum() > 1 else (middles, steps)


def _direction(ring: FloatArray, start: int, end: int) -> float:
    """The direction of a wall, radians: the first principal axis of the border along it."""
    chord = ring[end] - ring[start]
    middles, steps = _part(ring, start, end)
    weights = np.hypot(*steps.T)
    around = middles - (middles * weights[:, None]).sum(axis=0) / weights.sum()
    _, axes = np.linalg.eigh((around * weights[:, None]).T @ around)
    axis = axes[:, 1] * (1.0 if axes[:, 1] @ chord >= 0 else -1.0)
    straight = len(middles) > 3 and abs(axis @ chord) > 0.9 * np.hypot(*chord)
    return math.atan2(axis[1], axis[0]) if straight else math.atan2(chord[1], chord[0])


def main_direction(ring: FloatArray, corners: IntArray, parameters: OutlineParameters = BUILDINGS.outlines) -> float:
    """The direction, radians in 0..pi/2, that the walls between corners of a ring (N, 2) run along or at right angles
    to: the one from which their lengths deviate least, and of the walls near it the mean."""
    ends = np.roll(corners, -1)
    lengths = np.hypot(*(ring[ends] - ring[corners]).T)
    angles = np.array([_direction(ring, start, end) for start, end in zip(corners, ends)])
    quarter = math.pi / 2

    def away(direction: float) -> FloatArray:
        return np.asarray(np.mod(angles - direction + quarter / 2, quarter) - quarter / 2)

    tried = np.arange(0.0, 90.0, parameters.step_deg)
    limit = math.radians(parameters.turned_deg)
    costs = [float((lengths * np.minimum(np.abs(away(math.radians(each))), limit)).sum()) for each in tried]
    best = math.radians(float(tried[int(np.argmin(costs))]))
    near = np.abs(away(best)) < limit / 3
    if near.any():
        weights = lengths[near] ** 2  # a wall's direction is the surer the longer it is
        best += float((weights * away(best)[near]).sum() / weights.sum())
    return best % quarter


def _walls(
    ring: FloatArray, corners: IntArray, main: float, apart: float, parameters: OutlineParameters
) -> Optional[FloatArray]:
    """(N, 2) a ring of lines through the parts of a border; None where they make no polygon."""
    lines = [_line(ring, start, end, main, parameters) for start, end in zip(corners, [*corners[1:], corners[0]])]
    lines = _with_steps(_joined(lines, apart), ring)
    while len(lines) >= 3:
        made = _corners(lines)
        if made is None:
            return None
        sides = np.linalg.norm(made - np.roll(made, 1, axis=0), axis=1)  # of line i: from corner i - 1 to corner i
        short = int(np.argmin(sides))
        if sides[short] >= apart or len(lines) <= 4:
            return made if len(lines) > 2 and sides.min() > 0 else None
        before, after = lines[short - 1], lines[(short + 1) % len(lines)]
        order = [lines[(short + 2 + k) % len(lines)] for k in range(len(lines) - 3)]
        if _are_parallel(before, after):
            lines = [*order, _mean(before, after)]
        else:
            lines = [after, *order, before]
        lines = _joined(lines, apart)
    return None


def _line(ring: FloatArray, start: int, end: int, main: float, parameters: OutlineParameters) -> Line:
    """The line of the border from one corner to another, along a main direction where it is near to one."""
    along = ring[end] - ring[start]
    angle = math.atan2(along[1], along[0])
    quarter = math.pi / 2
    turned = (angle - main + quarter / 2) % quarter - quarter / 2
    if abs(turned) <= math.radians(parameters.turned_deg):
        angle -= turned
    direction = np.array([math.cos(angle), math.sin(angle)])
    middles, steps = _part(ring, start, end)
    weights = np.abs(steps @ direction)
    middle = (middles * weights[:, None]).sum(axis=0) / weights.sum() if weights.sum() > 0 else middles.mean(axis=0)
    line = Line(angle, 0.0, float(np.linalg.norm(along)), middle)
    return replace(line, offset=float(line.normal @ middle))


def _are_parallel(one: Line, other: Line) -> bool:
    return abs(math.sin(one.angle - other.angle)) < _PARALLEL


def _mean(one: Line, other: Line) -> Line:
    """One line for two, in the direction of the longer one."""
    longer = max(one, other, key=lambda each: each.length)
    total = one.length + other.length
    middle = (one.middle * one.length + other.middle * other.length) / total if total > 0 else longer.middle
    return Line(longer.angle, float(longer.normal @ middle), total, middle)


def _joined(lines: List[Line], apart: float) -> List[Line]:
    """The lines without neighbours that are parallel and near to each other."""
    changed = True
    while changed and len(lines) > 3:
        changed = False
        for index, line in enumerate(lines):
            following = lines[(index + 1) % len(lines)]
            same_way = math.cos(line.angle - following.angle) > 0
            if same_way and _are_parallel(line, following) and _distance(line, following) < apart:
                rest = [lines[(index + 2 + k) % len(lines)] for k in range(len(lines) - 2)]
                lines, changed = [*rest, _mean(line, following)], True
                break
    return lines


def _distance(one: Line, other: Line) -> float:
    longer, shorter = (one, other) if one.length >= other.length else (other, one)
    return abs(float(longer.normal @ shorter.middle) - longer.offset)


def _with_steps(lines: List[Line], ring: FloatArray) -> List[Line]:
    """The lines with a short wall between neighbours that are parallel: halfway between the places that they stand
    for."""
    found: List[Line] = []
    for index, line in enumerate(lines):
        found.append(line)
        following = lines[(index + 1) % len(lines)]
        if _are_parallel(line, following):
            angle = line.angle + math.pi / 2
            direction = np.array([math.cos(line.angle), math.sin(line.angle)])
            end = line.middle + direction * line.length / 2
            start = following.middle - direction * following.length / 2
            step = Line(angle, 0.0, 0.0, (end + start) / 2)
            found.append(replace(step, offset=float(step.normal @ step.middle)))
    return found


def _corners(lines: List[Line]) -> Optional[FloatArray]:
    """(N, 2) where each line meets the next one; None where two of them are parallel."""
    found = []
    for line, following in zip(lines, [*lines[1:], lines[0]]):
        if _are_parallel(line, following):
            return None
        both = np.array([line.normal, following.normal])
        found.append(np.linalg.solve(both, [line.offset, following.offset]))
    return np.array(found)


def _polygon(rings: List[FloatArray]) -> List[ogr.Geometry]:
    """A valid polygon of an outer ring and others, those that lie inside it; empty where there is none."""
    made = _plain(rings[0])
    if not made.IsValid() or made.GetArea() <= 0:
        return []
    for ring in rings[1:]:
        hole = _plain(ring)
        if hole.IsValid() and hole.Within(made):
            less = made.Difference(hole)
            if less is not None and less.GetGeometryType() == ogr.wkbPolygon and less.IsValid():
                made = less
    return [made]


def _plain(ring: FloatArray) -> ogr.Geometry:
    made, shape = ogr.Geometry(ogr.wkbLinearRing), ogr.Geometry(ogr.wkbPolygon)
    for x, y in np.round([*ring, ring[0]], _ROUNDED):
        made.AddPoint_2D(float(x), float(y))
    shape.AddGeometry(made)
    return shape


def _common(one: ogr.Geometry, other: ogr.Geometry) -> float:
    """Intersection over union of two polygons."""
    both = one.Intersection(other)
    common = both.GetArea() if both is not None else 0.0
    return float(common / max(one.GetArea() + other.GetArea() - common, 1e-9))


def apart(shapes: List[ogr.Geometry]) -> List[ogr.Geometry]:
    """Polygons that do not overlap: each without what those before it cover, and of that the largest part; an empty
    polygon where nothing is left."""
    found: List[ogr.Geometry] = []
    ends = np.array([shape.GetEnvelope() for shape in shapes]).reshape(-1, 4)
    for number, shape in enumerate(shapes):
        xmin, xmax, ymin, ymax = ends[number]
        before = ends[:number]
        near = (before[:, 0] < xmax) & (before[:, 1] > xmin) & (before[:, 2] < ymax) & (before[:, 3] > ymin)
        rest = largest(shape)
        for other in np.flatnonzero(near):
            if rest.Intersects(found[other]):
                rest = largest(rest.Difference(found[other]))
        found.append(rest)
    return found


def largest(shape: Optional[ogr.Geometry]) -> ogr.Geometry:
    """The largest polygon of a geometry, valid in whole millimetres; an empty one where there is none. Where it touches
    itself, it is narrowed by a few centimetres, which divides it there."""
    found = [made for polygon in _polygons(shape) for made in _in_millimetres(polygon) or _narrowed(polygon)]
    return max(found, key=lambda each: float(each.GetArea())) if found else ogr.Geometry(ogr.wkbPolygon)


def _polygons(shape: Optional[ogr.Geometry]) -> List[ogr.Geometry]:
    """The polygons of a geometry of any kind."""
    if shape is None or ogr.GT_Flatten(shape.GetGeometryType()) == ogr.wkbPolygon:
        return [] if shape is None or shape.IsEmpty() else [shape]
    parts = [shape.GetGeometryRef(number).Clone() for number in range(shape.GetGeometryCount())]
    return [polygon for part in parts for polygon in _polygons(part)]


def _in_millimetres(polygon: ogr.Geometry) -> List[ogr.Geometry]:
    made = _polygon([_points(polygon.GetGeometryRef(number)) for number in range(polygon.GetGeometryCount())])
    return [each for each in made if not _touches_itself(each)]


def _touches_itself(polygon: ogr.Geometry) -> bool:
    """Whether two corners of a polygon are at one place: it has no solid then."""
    rings = [_points(polygon.GetGeometryRef(number)) for number in range(polygon.GetGeometryCount())]
    places = [tuple(place) for ring in rings for place in ring]
    return len(set(places)) < len(places)


def _narrowed(polygon: ogr.Geometry) -> List[ogr.Geometry]:
    narrow = polygon.Buffer(-_NARROWED_M)
    return [made for part in _polygons(narrow) for made in _in_millimetres(part.SimplifyPreserveTopology(_NARROWED_M))]


def _points(ring: ogr.Geometry) -> FloatArray:
    return np.array(ring.GetPoints())[:-1, :2]
