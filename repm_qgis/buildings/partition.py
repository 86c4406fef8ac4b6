"""A footprint divided into the parts of its roof: an arrangement of lines, whose faces each take the plane that fits
(Zebedin et al. 2008, "Fusion of feature- and area-based information for urban buildings modeling", ECCV).

Two neighbouring planes are divided by the line in which they intersect; where a wall stands between them, by the
straightened border of the cells of the higher one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr
from scipy import ndimage

from ..contracts.arrays import FloatArray, IntArray, Mask
from ..imagery.cell_polygons import burned, outlined
from .parameters import BUILDINGS, BuildingParameters
from .regularisation import regular
from .roofs import Plane, RoofCells, RoofPlanes
from .solids import Node, Ring, RoofPart, edges_of, signed_area, traced

_ROUNDED = 3


@dataclass(frozen=True)
class Frame:
    """Where the cells of a roof lie: ``origin`` (x, y) of its places, and GDAL's geotransform of the cells."""

    origin: Node
    transform: Tuple[float, ...]


def whole(footprint: ogr.Geometry) -> RoofPart:
    """A footprint as one part."""
    return RoofPart(_rings(footprint), 0)


def roof_parts(
    footprint: ogr.Geometry,
    cells: RoofCells,
    roof: RoofPlanes,
    frame: Frame,
    parameters: BuildingParameters = BUILDINGS,
) -> List[RoofPart]:
    """The parts of a roof with several planes; empty where the lines do not divide the footprint."""
    lines = _dividing_lines(footprint, cells, roof, frame, parameters)
    faces = _faces(footprint, lines)
    if not faces:
        return []
    labels = _labels(faces, cells, roof, frame)
    return _merged(faces, labels)


def _rings(shape: ogr.Geometry) -> List[Ring]:
    """The outer ring of a polygon counterclockwise, and its holes clockwise."""
    found = []
    for number in range(shape.GetGeometryCount()):
        points = [(round(x, _ROUNDED), round(y, _ROUNDED)) for x, y, *_ in shape.GetGeometryRef(number).GetPoints()]
        ring = [point for point, after in zip(points, points[1:]) if point != after]
        outward = signed_area(ring) > 0
        found.append(ring if outward == (number == 0) else ring[::-1])
    return found


def _dividing_lines(
    footprint: ogr.Geometry,
    cells: RoofCells,
    roof: RoofPlanes,
    frame: Frame,
    parameters: BuildingParameters,
) -> List[ogr.Geometry]:
    xmin, xmax, ymin, ymax = footprint.GetEnvelope()
    reach = 2 * (xmax - xmin + ymax - ymin)
    lines: List[ogr.Geometry] = []
    stepped = set()
    for (one, other), (x, y) in _common_borders(cells, roof).items():
        first, second = roof.planes[one], roof.planes[other]
        gap = first.at(x, y) - second.at(x, y)
        if float(np.median(np.abs(gap))) > parameters.roofs.step_m:
            stepped.add(one if float(np.median(gap)) > 0 else other)
            continue
        line = _crossing(first, second, frame.origin, reach, (float(x.mean()), float(y.mean())))
        if line is not None:
            lines.append(line)
    for number in sorted(stepped):
        lines += _outlines(roof.numbers == number, frame, cells.cell, parameters)
    return lines


def _common_borders(cells: RoofCells, roof: RoofPlanes) -> Dict[Tuple[int, int], Tuple[FloatArray, FloatArray]]:
    """For each two planes whose cells touch, x and y of the cells at their common border, m."""
    found: Dict[Tuple[int, int], List[Tuple[FloatArray, FloatArray]]] = {}
    numbers = roof.numbers
    for cut, beside in (
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
        ((slice(1, None),), (slice(None, -1),)),
    ):
        here, there = numbers[cut], numbers[beside]
        apart = (here >= 0) & (there >= 0) & (here != there)
        low, high = np.minimum(here, there)[apart], np.maximum(here, there)[apart]
        x, y = cells.x[cut][apart], cells.y[cut][apart]
        for pair in sorted(set(zip(low.tolist(), high.tolist()))):
            chosen = (low == pair[0]) & (high == pair[1])
            found.setdefault(pair, []).append((x[chosen], y[chosen]))
    least = max(2.0, 1.0 / cells.cell)
    joined = {
        pair: (np.concatenate([x for x, _ in parts]), np.concatenate([y for _, y in parts]))
        for pair, parts in found.items()
    }
    return {pair: places for pair, places in joined.items() if len(places[0]) >= least}


def _crossing(
    one: Plane, other: Plane, origin: Node, reach: float, near: Tuple[float, float]
) -> Optional[ogr.Geometry]:
    """The line in which two planes intersect, as long as the footprint; None where it passes far from their border, or
    they are parallel."""
    height, east, north = one.height - other.height, one.east - other.east, one.north - other.north
    steep = float(np.hypot(east, north))
    if steep < 1e-3:
        return None
    away = (height + east * near[0] + north * near[1]) / steep
    if abs(away) > reach / 4:
        return None
    foot = np.array(near) - away * np.array([east, north]) / steep
    along = np.array([-north, east]) / steep * reach
    return _line([tuple(foot - along + origin), tuple(foot + along + origin)])


def _line(places: Sequence[Tuple[float, ...]]) -> ogr.Geometry:
    made = ogr.Geometry(ogr.wkbLineString)
    for place in places:
        made.AddPoint_2D(float(place[0]), float(place[1]))
    return made


def _outlines(mask: Mask, frame: Frame, cell: float, parameters: BuildingParameters) -> List[ogr.Geometry]:
    """The straightened borders of the cells of a plane that walls surround."""
    clean = ndimage.binary_opening(mask, np.ones((3, 3), bool)) if mask.sum() > 50 else mask
    return [
        regular(shape, cell, parameters.outlines).GetBoundary().Clone()
        for shape in outlined(clean, frame.transform)
        if shape.GetArea() >= parameters.roofs.least_m2
    ]


def _faces(footprint: ogr.Geometry, lines: Sequence[ogr.Geometry]) -> List[ogr.Geometry]:
    """The faces into which lines divide a footprint: they have all places of their common borders in common."""
    net = footprint.GetBoundary()
    for line in lines:  # whole ones: the end of one that was cut there would not exactly be on the outline
        net = net.Union(line)
    net = _rounded(net)
    if net is None:
        return []
    made = net.Polygonize()
    faces = [made.GetGeometryRef(i).Clone() for i in range(made.GetGeometryCount())] if made is not None else []
    return [face for face in faces if face.PointOnSurface().Within(footprint) and face.GetArea() > 0]


def _rounded(net: ogr.Geometry) -> Optional[ogr.Geometry]:
    """Lines with places in whole millimetres, divided where they meet."""
    segments = set()
    for part in [net.GetGeometryRef(i) for i in range(net.GetGeometryCount())] or [net]:
        if ogr.GT_Flatten(part.GetGeometryType()) != ogr.wkbLineString:
            continue
        places = [(round(x, _ROUNDED), round(y, _ROUNDED)) for x, y, *_ in part.GetPoints()]
        segments |= {tuple(sorted(pair)) for pair in zip(places, places[1:]) if pair[0] != pair[1]}
    made = ogr.Geometry(ogr.wkbMultiLineString)
    for pair in sorted(segments):
        made.AddGeometry(_line(pair))
    return made if segments else None


def _labels(faces: Sequence[ogr.Geometry], cells: RoofCells, roof: RoofPlanes, frame: Frame) -> List[int]:
    """For each face the plane from which the heights in it differ least; where it has no height, that of a
    neighbour's cells."""
    numbers = burned(faces, range(1, len(faces) + 1), cells.inside.shape, frame.transform)
    away = np.stack([np.abs(cells.height - plane.at(cells.x, cells.y)) for plane in roof.planes])
    away = np.minimum(np.nan_to_num(away, nan=2.0), 2.0)  # a chimney is no reason for another plane
    known = np.isfinite(cells.height) & cells.inside
    found = []
    for number, face in enumerate(faces, start=1):
        here = (numbers == number) & known & cells.inner
        if not here.any():
            here = (numbers == number) & known
        if here.any():
            found.append(int(np.argmin(away[:, here].mean(axis=1))))
        else:
            found.append(_nearest(face, roof.numbers, frame))
    return found


def _nearest(face: ogr.Geometry, numbers: IntArray, frame: Frame) -> int:
    """The plane of the cell in which a small face lies, or of the nearest one that has a plane."""
    place = face.PointOnSurface()
    x0, dx, _, y0, _, dy = frame.transform
    row, column = int((place.GetY() - y0) / dy), int((place.GetX() - x0) / dx)
    rows, columns = np.nonzero(numbers >= 0)
    nearest = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
    return int(numbers[rows[nearest], columns[nearest]])


def _merged(faces: Sequence[ogr.Geometry], labels: Sequence[int]) -> List[RoofPart]:
    """Faces of one plane that touch along an edge, as one part; without the corners that no part needs."""
    edges: Dict[Tuple[Node, Node], int] = {}
    for index, face in enumerate(faces):
        for ring in _rings(face):
            edges.update({edge: index for edge in edges_of(ring)})
    group = list(range(len(faces)))

    def root(index: int) -> int:
        while group[index] != index:
            index = group[index]
        return index

    for (a, b), index in edges.items():
        other = edges.get((b, a))
        if other is not None and labels[other] == labels[index]:
            group[max(root(other), root(index))] = min(root(other), root(index))
    borders: Dict[int, List[Tuple[Node, Node]]] = {}
    for (a, b), index in edges.items():
        other = edges.get((b, a))
        if other is None or root(other) != root(index):
            borders.setdefault(root(index), []).append((a, b))
    needed = _needed([edge for each in borders.values() for edge in each])
    parts = []
    for index, border in borders.items():
        rings = [[node for node in ring if node in needed] for ring in traced(border)]
        rings = sorted((ring for ring in rings if len(ring) > 2), key=signed_area, reverse=True)
        if not rings or signed_area(rings[0]) <= 0 or any(signed_area(ring) > 0 for ring in rings[1:]):
            return []
        parts.append(RoofPart(rings, labels[index]))
    return parts


def _needed(edges: Sequence[Tuple[Node, Node]]) -> set[Node]:
    """The places at which borders turn or meet."""
    around: Dict[Node, set[Node]] = {}
    for a, b in edges:
        around.setdefault(a, set()).add(b)
        around.setdefault(b, set()).add(a)
    found = set()
    for node, others in around.items():
        if len(others) == 2:
            first, second = others
            ux, uy = first[0] - node[0], first[1] - node[1]
            vx, vy = second[0] - node[0], second[1] - node[1]
            size = float(np.hypot(ux, uy) * np.hypot(vx, vy))
            if abs(ux * vy - uy * vx) < 1e-3 * size and ux * vx + uy * vy < 0:
                continue
        found.add(node)
    return found
