"""Areas whose volumes are followed over time: polygons of the user, or the outlines of what changed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import count
from typing import Callable, Dict, Iterator, List, Sequence

import numpy as np
from osgeo import ogr, osr

from ..change.errors import Correlation
from ..change.volumes import Outlines, Shapes
from ..contracts.arrays import FloatArray, FloatImage, IntArray, Window
from ..contracts.errors import InputTableError, OverlapError
from ..contracts.findings import Finding, as_percent
from ..evaluation.grids import Grid
from ..files.tables import csv_text
from ..files.vector import file_and_layer, open_layer, polygons_of, write_layer
from ..geometry.frames import flat_crs
from ..imagery import raster
from ..runtime.progress import listed
from ..runtime.workspace import write_text
from .parameters import SERIES, SeriesParameters
from .times import DatedDsm
from .trend import trends

_ROUNDING = 1e-4  # of a polygon's area that neighbours may share by it
_LEAST_INSIDE = 0.99  # of a polygon where the DSMs lie
_NAMES = ("name", "area", "id")  # fields that name an area
TABLE = ("area", "date", "area_m2", "known_percent", "mean_m", "volume_m3", "deviation_m3")
"""The columns of the table: one row for each area and date."""


class Areas(Shapes):
    """The polygons of a layer, in any CRS; those of one layer of :meth:`apart` do not overlap."""

    def __init__(self, path: str, grid: Grid, warn: Callable[[Finding], None] = lambda finding: None) -> None:
        """Raises InputTableError for a layer that cannot be used; ``warn`` hears of polygons that cross themselves."""
        super().__init__(grid)
        self.names: List[str] = []
        file, name = file_and_layer(path)
        source, layer = open_layer(file, name)
        if layer is None:
            raise InputTableError(f"The layer '{path}' of AREAS cannot be read: choose a layer of polygons.")
        flat = osr.SpatialReference()
        flat.ImportFromWkt(flat_crs(grid.crs).to_wkt("WKT2_2019"))
        flat.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
        definition = layer.GetLayerDefn()
        fields = {definition.GetFieldDefn(i).GetName().lower(): i for i in range(definition.GetFieldCount())}
        named = next((fields[name] for name in _NAMES if name in fields), None)
        polygons = [(feature, shape.Clone()) for feature, shape in polygons_of(layer, path, "AREAS", flat, warn)]
        self._layers = layers_apart([shape for _, shape in polygons])
        for feature, shape in polygons:
            moved = ogr.Feature(self._layer.GetLayerDefn())
            moved.SetField("sign", self._layers[len(self.names)])
            moved.SetField("number", len(self.names) + 1)
            moved.SetGeometry(shape)
            self._layer.CreateFeature(moved)
            text = feature.GetFieldAsString(named) if named is not None else ""
            self.names.append(text or str(len(self.names) + 1))
        del feature, polygons, layer, source  # in this order, or OGR's objects outlive their file

    def apart(self, window: Window) -> Iterator[IntArray]:
        """As :meth:`numbers`, once for each layer of polygons that do not overlap."""
        for layer in sorted(set(self._layers)):
            self._layer.SetAttributeFilter(f"sign={layer}")
            yield self.numbers(window)
        self._layer.SetAttributeFilter(None)

    def outlines(self) -> List[bytes]:
        """The polygons in the grid's CRS, as WKB, in their order."""
        self._layer.SetSpatialFilter(None)
        return [bytes(feature.GetGeometryRef().ExportToWkb()) for feature in self._layer]


def layers_apart(shapes: Sequence[ogr.Geometry]) -> List[int]:
    """For each polygon the first layer, from 0 on, in which no earlier one covers ground of it."""
    boxes = np.array([shape.GetEnvelope() for shape in shapes])  # xmin, xmax, ymin, ymax
    layers: List[int] = []
    with raster.quiet():  # GEOS says where polygons cross themselves
        for number, shape in enumerate(shapes):
            earlier, (west, east, south, north) = boxes[:number], boxes[number]
            near = (earlier[:, 0] < east) & (earlier[:, 1] > west) & (earlier[:, 2] < north) & (earlier[:, 3] > south)
            taken = {layers[i] for i in np.flatnonzero(near) if _share_ground(shapes[i], shape)}
            layers.append(next(layer for layer in count() if layer not in taken))
    return layers


def _share_ground(one: ogr.Geometry, other: ogr.Geometry) -> bool:
    """Whether two polygons overlap by more than rounding; they do where GEOS gives no answer."""
    common = one.Intersection(other)
    return common is None or common.GetArea() > _ROUNDING * min(one.GetArea(), other.GetArea())


@dataclass(frozen=True)
class AreaOverTime:
    """One area: its outline as WKB in the grid's CRS, its size where the DSMs lie, and (dates,) how it changed since
    the first date.

    ``inside`` is the share of the polygon where the DSMs lie, and ``known`` that of all of it with heights at the first
    date and at this one, ``mean`` in m, ``volume`` and its standard ``deviation`` in m3, NaN where no cell is known.
    ``trend`` is that of the volume, m3 per year, with its standard error. ``unsure``: errors alone may look so.
    """

    name: str
    outline: bytes
    area: float
    inside: float
    known: FloatArray
    mean: FloatArray
    volume: FloatArray
    deviation: FloatArray
    trend: float
    trend_error: float
    unsure: bool = False

    @property
    def last(self) -> int:
        """The last date with a volume."""
        known = np.flatnonzero(np.isfinite(self.volume))
        return int(known[-1]) if known.size else 0


class AreaSums:
    """What is added up over the cells of each area, block by block."""

    def __init__(self, areas: int, dates: int) -> None:
        self.cells = np.zeros(areas + 1)
        shape = dates, areas + 1
        self.known, self.change, self.squares = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.variance, self.first_variance = np.zeros(shape), np.zeros(shape)

    def add(self, numbers: IntArray, heights: FloatImage, errors: FloatImage) -> None:
        """Take up a block: ``numbers`` (rows, columns) of areas, (dates, rows, columns) heights and errors, m."""
        inside = numbers > 0
        own = numbers[inside]
        size = self.cells.size
        self.cells += np.bincount(own, minlength=size)
        first, first_error = (values[0][inside].astype(np.float64) for values in (heights, errors))
        for date in range(len(heights)):
            change = heights[date][inside].astype(np.float64) - first
            good = np.isfinite(change)
            here, values = own[good], change[good]
            for total, weights in (
                (self.known, None),
                (self.change, values),
                (self.squares, values**2),
                (self.variance, errors[date][inside][good].astype(np.float64) ** 2),
                (self.first_variance, first_error[good] ** 2),
            ):
                total[date] += np.bincount(here, weights, minlength=size)

    def over_time(
        self,
        names: Sequence[str],
        outlines: Sequence[bytes],
        grid: Grid,
        years: FloatArray,
        correlations: Sequence[Correlation],
        offset_m: FloatArray,
        cell_m2: float,
        chosen: bool,
        parameters: SeriesParameters = SERIES,
    ) -> List[AreaOverTime]:
        """The areas, in their order. ``correlations`` (dates,) say how alike the errors of neighbours are, ``offset_m``
        (dates,) how uncertain the common height of each date is against the first, m. ``chosen``: they lie where the
        change is largest, and so are the errors.

        A volume is uncertain by the errors of its heights, averaged over as many cells as are independent; by the
        offset; and where heights are missing, by as much as the change differs within the area. In a chosen area that
        errors alone may explain, none of them are averaged.
        """
        found = []
        for number, (name, outline) in enumerate(zip(names, outlines), start=1):
            inside = _inside(outline, grid) if self.known[:, number].any() else 0.0
            area, cells = self.cells[number] * cell_m2, max(self.cells[number], 1.0)
            known = self.known[:, number]
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = self.change[:, number] / known
                spread = np.sqrt(np.maximum(self.squares[:, number] / known - mean**2, 0.0))
                own, first = (values[:, number] / known for values in (self.variance, self.first_variance))
            shares = np.array([each.variance_share(max(area, cell_m2)) for each in correlations])
            gaps = (1 - known / cells) * spread
            size = np.abs(mean) / np.sqrt(own + first)  # in errors of a cell, of which all may be alike
            sure = (size > parameters.chosen_cells) | (size > parameters.chosen_areas * np.sqrt(shares))
            unsure = chosen and not sure[1:].any()
            shares = np.ones_like(shares) if unsure else shares
            date_error = np.sqrt(own * shares + offset_m**2 + gaps**2)
            whole = np.hypot(date_error, np.sqrt(first * shares))
            deviation = area * np.where(np.arange(len(years)) == 0, 0.0, whole)
            volume = area * mean
            slope = trends(years, volume[:, None, None], (area * date_error)[:, None, None])
            one = AreaOverTime(
                name=name,
                outline=outline,
                area=area,
                inside=inside,
                known=inside * known / cells,
                mean=mean,
                volume=volume,
                deviation=deviation,
                trend=float(slope.slope[0, 0]),
                trend_error=float(slope.error[0, 0]),
                unsure=unsure,
            )
            found.append(one)
        return found


def outlined(outlines: Outlines) -> Dict[str, bytes]:
    """The outlines of what changed, by their numbers as names."""
    return {str(number): outline for number, _, outline in outlines}


def _inside(outline: bytes, grid: Grid) -> float:
    """The share of a polygon that lies within a grid's bounds; all of one that crosses itself, and has no area."""
    shape, (west, south, east, north) = ogr.CreateGeometryFromWkb(outline), grid.bounds
    frame, ring = ogr.Geometry(ogr.wkbPolygon), ogr.Geometry(ogr.wkbLinearRing)
    for x, y in ((west, south), (east, south), (east, north), (west, north), (west, south)):
        ring.AddPoint_2D(x, y)
    frame.AddGeometry(ring)
    with raster.quiet():
        common = shape.Intersection(frame)
    return min(common.GetArea() / shape.GetArea(), 1.0) if common is not None and shape.GetArea() > 0 else 1.0


def inside_findings(found: Sequence[AreaOverTime], path: str) -> List[Finding]:
    """The areas that are cut by the DSMs' bounds, or have no heights. Raises OverlapError where none has heights."""
    if not any((each.known > 0).any() for each in found):
        raise OverlapError(
            f"No polygon of '{path}' has heights of the DSMs: choose areas that lie where at least three DSMs do."
        )
    cut = [each for each in found if each.inside < _LEAST_INSIDE]
    if not cut:
        return []
    named = listed([f"{each.name} ({as_percent(each.inside)})" for each in cut])
    text = f"Areas of '{path}' that lie only in part where the DSMs have heights, or not at all: {named}"
    return [Finding("areas-outside", f"{text}. Volumes are those of this part: use DSMs that cover all of them.")]


def unsure_findings(found: Sequence[AreaOverTime]) -> List[Finding]:
    """The areas that were outlined because errors of neighbours are alike, perhaps."""
    unsure = [each for each in found if each.unsure]
    if not unsure:
        return []
    text = (
        f"{len(unsure)} of {len(found)} outlined areas ({sum(each.area for each in unsure):.0f} m2) change by so "
        "little that errors of neighbouring cells alone may look so: give AREAS, or leave them out."
    )
    return [Finding("areas-unsure", text)]


def write_areas(path: str, grid: Grid, series: Sequence[DatedDsm], found: Sequence[AreaOverTime]) -> None:
    """The polygons, each with the volumes of all dates: a field for each, and the last one in ``volume_m3``."""
    kinds: Dict[str, type] = {"area": str, "change": str}
    kinds.update(dict.fromkeys(("area_m2", "known_percent", "mean_m", "volume_m3", "deviation_m3"), float))
    kinds.update(dict.fromkeys(("trend_m3_a", "trend_error"), float))
    labels = ["m3_" + "".join(mark for mark in each.label if mark.isdigit()) for each in series[1:]]
    kinds.update(dict.fromkeys(labels, float))

    def values(each: AreaOverTime) -> List[object]:
        last = each.last
        figures = [each.area, 100 * each.known[last], each.mean[last], each.volume[last], each.deviation[last]]
        figures += [each.trend, each.trend_error, *each.volume[1:]]
        kind = "gain" if each.volume[last] > 0 else "loss"
        return [each.name, kind, *(float(figure) if math.isfinite(figure) else None for figure in figures)]

    features = ((ogr.ForceToMultiPolygon(ogr.CreateGeometryFromWkb(each.outline)), values(each)) for each in found)
    write_layer(path, flat_crs(grid.crs).to_wkt("WKT2_2019"), ogr.wkbMultiPolygon, kinds, features)


def write_table(path: str, series: Sequence[DatedDsm], found: Sequence[AreaOverTime]) -> None:
    """A row for each area and date, as CSV; what is not known is empty."""
    rows: List[Sequence[object]] = [TABLE]
    for each in found:
        for index, date in enumerate(series):
            figures = each.area, 100 * each.known[index], each.mean[index], each.volume[index], each.deviation[index]
            numbers = [f"{figure:.3f}" if math.isfinite(figure) else "" for figure in figures]
            rows.append([each.name, date.label, *numbers])
    write_text(path, csv_text(rows))
