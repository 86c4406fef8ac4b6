"""Heights along lines: a DSM and its reference in profile."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional

import numpy as np
import pyproj
from osgeo import ogr, osr

from ..contracts.arrays import Bounds, FloatArray, FloatImage
from ..contracts.checks import as_text
from ..contracts.errors import InputTableError
from ..files.vector import file_and_layer, open_layer, reference_of
from ..geometry.frames import flat_crs
from .coregistration import Alignment
from .grids import Grid, HeightWarper, metres_per_unit

_MOST_LINES = 8
_MOST_SAMPLES = 2000
_MOST_VERTICES = 10_000
_AT_ONCE = 64


@dataclass(frozen=True)
class ProfileLine:
    """A line that surfaces are sampled along: a name, and its corners (N, 2) in the reference's CRS."""

    name: str
    corners: FloatArray


@dataclass(frozen=True)
class Profile:
    """Heights (N,) in metres at distances (N,) in metres from the line's start; NaN = no height."""

    name: str
    distance: FloatArray
    dsm: FloatImage
    reference: FloatImage


def middle_lines(common: Bounds) -> List[ProfileLine]:
    """West to east and south to north through the middle of the common extent."""
    x0, y0, x1, y1 = common
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    ends = {"west to east": [[x0, y], [x1, y]], "south to north": [[x, y0], [x, y1]]}
    return [ProfileLine(f"{name} through the middle", np.array(corners)) for name, corners in ends.items()]


def read_lines(path: str, reference: Grid) -> List[ProfileLine]:
    """The first eight lines of a layer (``file`` or ``file|layername=name``), in the reference's CRS.

    A line is named by its field ``name``, or else by its number. Raises InputTableError where there is no line.
    """
    file, name = file_and_layer(path)
    source, layer = open_layer(file, name)
    if layer is None:
        raise InputTableError(f"Cannot open the profile lines of '{path}': give a line layer.")
    lines = []
    for number, feature in zip(range(1, _MOST_LINES + 1), layer):
        corners = _corners(feature.GetGeometryRef(), reference_of(layer), reference)
        if len(corners) > 1:
            lines.append(ProfileLine(_name_of(feature, number), corners))
    if not lines:
        none = f"'{path}' has no line among its first {_MOST_LINES} features"
        raise InputTableError(f"{none}: give a line layer, or leave PROFILES empty.")
    return lines


def sample_profile(
    line: ProfileLine, dsm: HeightWarper, reference: HeightWarper, grid: Grid, alignment: Alignment
) -> Profile:
    """Both surfaces along a line, at the spacing of the reference's cells (wider where that makes over 2000 points)."""
    per_unit = np.array(metres_per_unit(grid))
    lengths = np.hypot(*(np.diff(line.corners, axis=0) * per_unit).T)
    spacing = max(abs(grid.transform[1]) * per_unit[0], lengths.sum() / _MOST_SAMPLES)
    distances, ours, theirs, start = [np.empty(0)], [np.empty(0, np.float32)], [np.empty(0, np.float32)], 0.0
    for a, b, length in zip(line.corners, line.corners[1:], lengths):
        count = math.ceil(length / spacing)
        for first in range(0, count, _AT_ONCE):  # the rectangle around a long slanting line is the whole raster
            last = min(first + _AT_ONCE, count)
            along = _row_of_cells(grid, a + (b - a) * first / count, a + (b - a) * last / count, last - first)
            distances.append(start + (np.arange(first, last) + 0.5) * length / count)
            ours.append(dsm.along(along, alignment))
            theirs.append(reference.along(along))
        start += length
    return Profile(line.name, np.concatenate(distances), np.concatenate(ours), np.concatenate(theirs))


def _row_of_cells(grid: Grid, a: FloatArray, b: FloatArray, count: int) -> Grid:
    """One row of square cells whose middle line runs from ``a`` to ``b``."""
    step = (b - a) / count
    across = np.array([step[1], -step[0]])
    corner = a - across / 2
    return Grid(grid.path, (count, 1), (corner[0], step[0], across[0], corner[1], step[1], across[1]), grid.wkt)


def _name_of(feature: ogr.Feature, number: int) -> str:
    index = feature.GetFieldIndex("name")
    text = as_text(feature.GetFieldAsString(index)).strip() if index >= 0 else ""
    return text[:60] or f"line {number}"


def _corners(geometry: Optional[ogr.Geometry], crs: Optional[osr.SpatialReference], reference: Grid) -> FloatArray:
    """(N, 2) of a line (the first of several parts) in the reference's CRS; empty for other geometries."""
    if geometry is not None and ogr.GT_Flatten(geometry.GetGeometryType()) == ogr.wkbMultiLineString:
        geometry = geometry.GetGeometryRef(0)
    if geometry is None or ogr.GT_Flatten(geometry.GetGeometryType()) != ogr.wkbLineString:
        return np.empty((0, 2))
    points = np.array([point[:2] for point in geometry.GetPoints()[:_MOST_VERTICES]], np.float64).reshape(-1, 2)
    if crs is not None:
        to_reference = pyproj.Transformer.from_crs(crs.ExportToWkt(), flat_crs(reference.crs), always_xy=True)
        points = np.column_stack(to_reference.transform(points[:, 0], points[:, 1]))
    known: FloatArray = points[np.isfinite(points).all(axis=1)]
    return known
