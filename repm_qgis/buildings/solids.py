"""Closed solids of a building: its ground, its roof in faces, and the walls around them and between them.

A roof is a partition of the footprint into faces, each of which has a plane. Where two faces meet at different heights,
a vertical wall stands; each corner of a wall is also one of all other faces that touch it there, so that each edge
belongs to two faces that run along it in opposite directions: the solid is closed, which :func:`is_closed` checks.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Dict, List, Sequence, Set, Tuple, TypeVar

import numpy as np

from ..contracts.arrays import FloatArray
from .parameters import BUILDINGS
from .roofs import Plane

GROUND, WALL, ROOF = "GroundSurface", "WallSurface", "RoofSurface"
"""The kinds of faces, by CityGML's names."""
Node = Tuple[float, float]
Corner = Tuple[float, float, float]
Ring = List[Node]
_Place = TypeVar("_Place")


@dataclass(frozen=True)
class Face:
    """One flat face: an outer ring and holes of corners (x, y, z in m), which seen from outside run counterclockwise
    and clockwise; ``kind`` is what it is, ``plane`` the number of a roof's plane, -1 for others."""

    rings: List[List[Corner]]
    kind: str
    plane: int = -1


@dataclass(frozen=True)
class RoofPart:
    """A part of the footprint with a plane: an outer ring, counterclockwise, and holes, clockwise, of places (x, y)."""

    rings: List[Ring]
    plane: int


def solid(parts: Sequence[RoofPart], planes: Sequence[Plane], floor: float, origin: Node) -> List[Face]:
    """The faces of a building with these parts of its roof, down to ``floor`` (m). ``planes`` count x, y from
    ``origin``; parts that meet have the same places along their common border. Empty where a part lies below the
    floor."""
    parts = _without_crossings(parts, planes, origin)
    heights = _heights(parts, planes, origin)
    if min(heights.values()) <= floor:
        return []
    columns: Dict[Node, List[float]] = defaultdict(list)
    for (node, _), height in heights.items():
        if height not in columns[node]:
            columns[node].append(height)
    owner = {edge: index for index, part in enumerate(parts) for ring in part.rings for edge in edges_of(ring)}
    for a, b in owner:
        if (b, a) not in owner:  # an outer wall
            for node in (a, b):
                if floor not in columns[node]:
                    columns[node].append(floor)
    faces = [
        Face([[(*node, heights[node, index]) for node in ring] for ring in part.rings], ROOF, part.plane)
        for index, part in enumerate(parts)
    ]
    outer = []
    for (a, b), index in owner.items():
        other = owner.get((b, a))
        low = [floor, floor] if other is None else [heights[a, other], heights[b, other]]
        if other is None:
            outer.append((a, b))
        faces += _wall((a, b), [heights[a, index], heights[b, index]], low, columns)
    base = [_flat(ring, floor) for ring in traced(outer)]
    return faces + _grounds(base)


def edges_of(ring: Sequence[_Place]) -> List[Tuple[_Place, _Place]]:
    """The edges of a ring, the last one of which leads back to its first place."""
    return list(zip(ring, [*ring[1:], ring[0]]))


def _heights(parts: Sequence[RoofPart], planes: Sequence[Plane], origin: Node) -> Dict[Tuple[Node, int], float]:
    """The height of each part at each of its places; those of one place that are nearly the same are the same."""
    found: Dict[Node, List[Tuple[float, int]]] = defaultdict(list)
    for index, part in enumerate(parts):
        plane = planes[part.plane]
        for node in {node for ring in part.rings for node in ring}:
            height = plane.height + plane.east * (node[0] - origin[0]) + plane.north * (node[1] - origin[1])
            found[node].append((height, index))
    heights = {}
    for node, several in found.items():
        several.sort()
        group: List[Tuple[float, int]] = []
        for each in several:
            if group and each[0] - group[0][0] > BUILDINGS.roofs.joined_m:
                heights.update(_one_height(node, group))
                group = []
            group.append(each)
        heights.update(_one_height(node, group))
    return heights


def _one_height(node: Node, group: Sequence[Tuple[float, int]]) -> Dict[Tuple[Node, int], float]:
    mean = round(sum(height for height, _ in group) / len(group), 3)
    return {(node, index): mean for _, index in group}


def _without_crossings(parts: Sequence[RoofPart], planes: Sequence[Plane], origin: Node) -> List[RoofPart]:
    """The parts with a place more on each common border along which one plane crosses the other."""
    owner = {edge: part for part in parts for ring in part.rings for edge in edges_of(ring)}
    extra: Dict[Tuple[Node, Node], Node] = {}
    for (a, b), part in owner.items():
        other = owner.get((b, a))
        if other is None or (a, b) in extra:
            continue
        gaps = []
        for node in (a, b):
            x, y = np.array(node[0] - origin[0]), np.array(node[1] - origin[1])
            gaps.append(float(planes[part.plane].at(x, y) - planes[other.plane].at(x, y)))
        if gaps[0] * gaps[1] < 0 and min(map(abs, gaps)) > BUILDINGS.roofs.joined_m:
            share = gaps[0] / (gaps[0] - gaps[1])
            middle = round(a[0] + share * (b[0] - a[0]), 3), round(a[1] + share * (b[1] - a[1]), 3)
            extra[a, b] = extra[b, a] = middle

    def longer(ring: Ring) -> Ring:
        found = []
        for edge in edges_of(ring):
            found += [edge[0], extra[edge]] if edge in extra else [edge[0]]
        return found

    return [RoofPart([longer(ring) for ring in part.rings], part.plane) for part in parts]


def _wall(edge: Tuple[Node, Node], top: List[float], low: List[float], columns: Dict[Node, List[float]]) -> List[Face]:
    """The wall below a part's edge down to what is lower there; none where nothing is."""
    (a, b) = edge
    if top[0] < low[0] or top[1] < low[1] or (top[0] == low[0] and top[1] == low[1]):
        return []  # the other part is the higher one, whose wall this is
    left = sorted(z for z in set(columns[a]) if low[0] <= z <= top[0])
    right = sorted(z for z in set(columns[b]) if low[1] <= z <= top[1])
    ring = [(*a, z) for z in reversed(left)] + [(*b, z) for z in right]
    return [Face([ring], WALL)]


def traced(edges: Sequence[Tuple[Node, Node]]) -> List[Ring]:
    """Rings of the directed edges around an area that lies to their left; where it touches itself the rings do not
    cross. Empty where the edges do not close."""
    following: Dict[Node, List[Node]] = defaultdict(list)
    for a, b in edges:
        following[a].append(b)
    rings = []
    while following:
        start = next(iter(following))
        ring, before, node = [start], start, following[start].pop(0)
        while node != start:
            choices = following.get(node, [])
            if not choices:
                return []
            after = min(choices, key=lambda each: _turn(before, node, each))  # noqa: B023 - asked at once
            choices.remove(after)
            ring.append(node)
            before, node = node, after
        following = defaultdict(list, {node: others for node, others in following.items() if others})
        rings.append(ring)
    return rings


def _turn(before: Node, node: Node, after: Node) -> float:
    """How far to turn clockwise from where one came to where one goes, radians."""
    back = math.atan2(before[1] - node[1], before[0] - node[0])
    ahead = math.atan2(after[1] - node[1], after[0] - node[0])
    return (back - ahead) % (2 * math.pi) or 2 * math.pi


def _flat(ring: Ring, floor: float) -> List[Corner]:
    """A ring of the roof's outline on the ground, seen from below."""
    return [(x, y, floor) for x, y in reversed(ring)]


def _grounds(rings: List[List[Corner]]) -> List[Face]:
    """The ground of one outer ring and the courtyards in it."""
    outer = [ring for ring in rings if signed_area([corner[:2] for corner in ring]) < 0]
    holes = [ring for ring in rings if signed_area([corner[:2] for corner in ring]) > 0]
    return [Face([outer[0], *holes], GROUND)] if len(outer) == 1 else []


def signed_area(ring: Sequence[Sequence[float]]) -> float:
    """The area of a ring of places, positive where it runs counterclockwise."""
    places = np.asarray(ring, np.float64) - np.asarray(ring[0], np.float64)
    x, y = places[:, 0], places[:, 1]
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def is_closed(faces: Sequence[Face]) -> bool:
    """Whether each edge of the faces is run along once in each direction, and no face has less than three corners."""
    seen: Set[Tuple[Corner, Corner]] = set()
    for face in faces:
        for ring in face.rings:
            if len(set(ring)) < max(3, len(ring)):
                return False
            for edge in edges_of(ring):
                if edge in seen:
                    return False
                seen.add(edge)
    return bool(seen) and all((b, a) in seen for a, b in seen)


def volume(faces: Sequence[Face]) -> float:
    """What closed faces contain, m3, by the divergence theorem: triangles with the first corner of each ring."""
    start = np.array(faces[0].rings[0][0])
    total = 0.0
    for face in faces:
        for ring in face.rings:
            corners = np.array(ring) - start
            for one, other in zip(corners[1:-1], corners[2:]):
                total += float(corners[0] @ np.cross(one, other)) / 6.0
    return total


def normal(ring: Sequence[Corner]) -> FloatArray:
    """(3,) the direction a ring's face looks in, of its area's length (Newell; Sutherland et al. 1974)."""
    corners = np.asarray(ring, np.float64) - np.asarray(ring[0], np.float64)
    return np.asarray(np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0) / 2)


def is_flat(face: Face, tolerance: float = 0.01) -> bool:
    """Whether all corners of a face lie within a tolerance (m) of a plane."""
    direction = normal(face.rings[0])
    size = math.sqrt(float(direction @ direction))
    if size == 0:
        return False
    corners = np.array([corner for ring in face.rings for corner in ring])
    away = (corners - corners.mean(axis=0)) @ direction / size
    return bool(np.abs(away).max() <= tolerance)
