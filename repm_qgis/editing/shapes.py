"""What an edit covers of a DSM's cells: polygons by the cells' centres, lines with their width, in blocks.

Shapes are in units of cells: (0, 0) is the outer corner of the DSM's first cell, and rows run down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np
from osgeo import ogr, osr

from ..contracts.arrays import FloatArray, Mask, Window
from ..contracts.errors import InputTableError
from ..contracts.findings import Finding
from ..evaluation.grids import Grid
from ..files.vector import crosses_itself, name_crossed
from ..geometry.frames import flat_crs
from ..imagery.cell_polygons import inside
from ..imagery.heights import read_heights
from ..imagery.raster import opened
from .edits import Edit, Edits
from .parameters import EDITING, EditingParameters


@dataclass(frozen=True)
class Shape:
    """An edit's polygon (None for lines), or its lines: each (N, 3) column, row and height (m, NaN where it has none).

    ``half`` is half the width of lines, in cells.
    """

    polygon: Optional[ogr.Geometry]
    lines: Tuple[FloatArray, ...]
    half: float

    def window(self, grid: Grid) -> Optional[Window]:
        """The cells of a DSM that the shape may cover; None where there are none."""
        if self.polygon is not None:
            left, right, top, bottom = self.polygon.GetEnvelope()
        else:
            points = np.concatenate(self.lines)
            (left, top), (right, bottom) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        col, row = math.floor(left - self.half), math.floor(top - self.half)
        end_col, end_row = math.ceil(right + self.half) + 1, math.ceil(bottom + self.half) + 1
        return Window.spanning(col, row, end_col, end_row).common(Window(0, 0, *grid.size))

    def covered(self, window: Window) -> Mask:
        """(H, W) the cells of a window whose centres the shape covers."""
        if self.polygon is None:
            return self.along(window)[0] <= self.half
        return inside(self.polygon, (window.height, window.width), (window.col, 1.0, 0.0, window.row, 0.0, 1.0))

    def along(self, window: Window) -> Tuple[FloatArray, FloatArray]:
        """(H, W) how far each cell's centre is from the lines, in cells, infinite beyond their width; and the lines'
        height at the nearest place, m. Of places that are equally near the first one counts."""
        nearest = np.full((window.height, window.width), np.inf)
        height = np.full(nearest.shape, np.nan)
        for line in self.lines:
            for start, end in zip(line[:-1], line[1:]):
                self._look_at(start, end, window, nearest, height)
        return nearest, height

    def _look_at(
        self, start: FloatArray, end: FloatArray, window: Window, nearest: FloatArray, height: FloatArray
    ) -> None:
        low, high = np.minimum(start, end)[:2] - self.half - 1, np.maximum(start, end)[:2] + self.half + 1
        ends = [*map(math.floor, low), *map(math.ceil, high)]
        near = Window.spanning(*ends).common(window)
        if near is None:
            return
        column = near.col + np.arange(near.width) + 0.5
        row = (near.row + np.arange(near.height) + 0.5)[:, None]
        along, length = (end - start)[:2], float(np.sum((end - start)[:2] ** 2))
        way = (column - start[0]) * along[0] + (row - start[1]) * along[1]
        share = np.clip(way / length, 0.0, 1.0) if length else np.zeros(way.shape)
        away = np.hypot(column - start[0] - share * along[0], row - start[1] - share * along[1])
        cut = near.inside(window)
        closer = (away < nearest[cut]) & (away <= self.half)
        nearest[cut][closer] = away[closer]
        height[cut][closer] = ((1 - share) * start[2] + share * end[2])[closer]


def shapes_of(edits: Edits, grid: Grid, cell: float) -> List[Tuple[Edit, Shape]]:
    """The edits that are enabled with their shapes on a DSM's cells, whose side is ``cell`` m.

    Raises InputTableError where a shape has no place in the DSM's CRS.
    """
    source, target = osr.SpatialReference(), osr.SpatialReference()
    target.SetFromUserInput(flat_crs(grid.crs).to_wkt())
    source.SetFromUserInput(edits.crs)
    for reference in (source, target):
        reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    if source.IsCompound():
        source.DemoteTo2D("")  # heights of breaklines are metres in the DSM's own datum
    same = bool(source.IsSame(target))
    transformation = None if same else osr.CoordinateTransformation(source, target)
    return [(edit, _shape(edits.path, edit, transformation, grid, cell)) for edit in edits.edits if edit.enabled]


def height_findings(
    dsm: str, edits: Edits, grid: Grid, shapes: Sequence[Tuple[Edit, Shape]], parameters: EditingParameters = EDITING
) -> List[Finding]:
    """The edits whose own heights lie far from all heights of the DSM around them, or are 0 as those of lines that
    were drawn without heights; and those whose polygons cross themselves."""
    found: List[Finding] = []
    crossed = [
        str(edit.number) for edit, shape in shapes if shape.polygon is not None and crosses_itself(shape.polygon)
    ]
    name_crossed(edits.path, crossed, found.append)
    with opened(dsm) as dataset:
        whole = Window(0, 0, *grid.size)
        for edit, shape in shapes:
            window, drawn = shape.window(grid), np.concatenate([np.empty((0, 3)), *shape.lines])[:, 2]
            values = drawn[np.isfinite(drawn)] if edit.operation == "breakline" else np.array([edit.value], np.float64)
            if window is None or edit.operation not in ("breakline", "set", "flatten") or not values.size:
                continue
            for part in (window.grown(parameters.shore_cells, grid.size), whole):
                size = min(part.width, parameters.looked_px), min(part.height, parameters.looked_px)
                around = read_heights(dataset, part, size=size)
                around = around[np.isfinite(around)].astype(np.float64)
                if around.size:
                    break
            away = np.maximum(around.min() - values, values - around.max()) if around.size else np.zeros(1)
            worst = int(away.argmax())
            far = parameters.line_far_m if edit.operation == "breakline" else parameters.far_m
            if away[worst] > (parameters.drawn_m if len(values) > 1 and not values.any() else far):
                text = (
                    f"Edit {edit.number} has the height {values[worst]:g} m, {away[worst]:.0f} m beyond all heights of "
                    f"'{dsm}' around it: check its value, or the heights of its vertices and their datum."
                )
                found.append(Finding("edit-far", text, "doubt"))
    return found


def _shape(path: str, edit: Edit, transformation: osr.CoordinateTransformation, grid: Grid, cell: float) -> Shape:
    geometry = ogr.CreateGeometryFromWkb(edit.geometry)
    has_heights = bool(geometry.Is3D())
    parts = (
        [geometry] if not _is_collection(geometry) else [geometry.GetGeometryRef(i) for i in range(_count(geometry))]
    )
    is_area = ogr.GT_Flatten(parts[0].GetGeometryType()) == ogr.wkbPolygon
    try:
        if transformation is not None:
            geometry.Transform(transformation)
        lines = []
        for part in parts:
            rings = [part.GetGeometryRef(i) for i in range(_count(part))] if is_area else [part]
            lines.append([_on_cells(ring, grid, has_heights) for ring in rings])
        if not all(np.isfinite(points[:, :2]).all() for rings in lines for points in rings):
            raise RuntimeError
    except RuntimeError:
        raise InputTableError(
            f"Edit {edit.number} of '{path}' has no place in the DSM's coordinate reference system: draw it again."
        ) from None
    if not is_area:
        return Shape(None, tuple(points for rings in lines for points in rings), 0.5 * float(edit.width or 0.0) / cell)
    polygon = ogr.Geometry(ogr.wkbMultiPolygon)
    for rings in lines:
        area = ogr.Geometry(ogr.wkbPolygon)
        for points in rings:
            ring = ogr.Geometry(ogr.wkbLinearRing)
            for column, row, _ in points:
                ring.AddPoint_2D(float(column), float(row))
            area.AddGeometry(ring)
        polygon.AddGeometry(area)
    return Shape(polygon, (), 0.0)


def _is_collection(geometry: ogr.Geometry) -> bool:
    return ogr.GT_Flatten(geometry.GetGeometryType()) in (ogr.wkbMultiPolygon, ogr.wkbMultiLineString)


def _count(geometry: ogr.Geometry) -> int:
    return int(geometry.GetGeometryCount())


def _on_cells(line: ogr.Geometry, grid: Grid, has_heights: bool) -> FloatArray:
    points = np.array(line.GetPoints(), dtype=np.float64)
    column, row = grid.to_cells(points[:, 0], points[:, 1])
    height = points[:, 2] if has_heights else np.full(len(points), np.nan)
    return np.stack([column, row, height], axis=1)
