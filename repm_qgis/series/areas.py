"""Areas whose volumes are followed over time: polygons of the user, or the outlines of what changed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Dict, List, Sequence

import numpy as np
from osgeo import ogr, osr

from ..change.errors import Correlation
from ..change.volumes import Outlines, Shapes
from ..contracts.arrays import FloatArray, FloatImage, IntArray
from ..contracts.errors import InputTableError, OverlapError
from ..contracts.findings import Finding
from ..evaluation.grids import Grid
from ..files.tables import csv_text
from ..files.vector import file_and_layer, open_layer, polygons_of, write_layer
from ..geometry.frames import flat_crs
from ..runtime.workspace import write_text
from .times import DatedDsm
from .trend import trends

_NAMES = ("name", "area", "id")  # fields that name an area
TABLE = ("area", "date", "area_m2", "known_percent", "mean_m", "volume_m3", "deviation_m3")
"""The columns of the table: one row for each area and date."""


class Areas(Shapes):
    """The polygons of a layer, in any CRS; where two overlap, a cell belongs to the later one."""

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
        for feature, shape in polygons_of(layer, path, "AREAS", flat, warn):
            moved = ogr.Feature(self._layer.GetLayerDefn())
            moved.SetField("number", len(self.names) + 1)
            moved.SetGeometry(shape)
            self._layer.CreateFeature(moved)
            text = feature.GetFieldAsString(named) if named is not None else ""
            self.names.append(text or str(len(self.names) + 1))
        del feature, layer, source  # in this order, or OGR's objects outlive their file

    def outlines(self) -> List[bytes]:
        """The polygons in the grid's CRS, as WKB, in their order."""
        self._layer.SetSpatialFilter(None)
        return [bytes(feature.GetGeometryRef().ExportToWkb()) for feature in self._layer]


@dataclass(frozen=True)
class AreaOverTime:
    """One area: its outline as WKB in the grid's CRS, its size, and (dates,) how it changed since the first date.

    ``known`` is the share of cells with heights at the first date and at this one, ``mean`` in m, ``volume`` and its
    standard ``deviation`` in m3, NaN where no cell is known. ``trend`` is that of the volume, m3 per year, with its
    standard error.
    """

    name: str
    outline: bytes
    area: float
    known: FloatArray
    mean: FloatArray
    volume: FloatArray
    deviation: FloatArray
    trend: float
    trend_error: float

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
        years: FloatArray,
        correlations: Sequence[Correlation],
        offset_m: FloatArray,
        cell_m2: float,
    ) -> List[AreaOverTime]:
        """The areas, in their order. ``correlations`` (dates,) say how alike the errors of neighbours are, ``offset_m``
        (dates,) how uncertain the common height of each date is against the first, m.

        A volume is uncertain by the errors of its heights, averaged over as many cells as are independent; by the
        offset; and where heights are missing, by as much as the change differs within the area.
        """
        found = []
        for number, (name, outline) in enumerate(zip(names, outlines), start=1):
            if not self.cells[number]:
                continue
            area = self.cells[number] * cell_m2
            known = self.known[:, number]
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = self.change[:, number] / known
                spread = np.sqrt(np.maximum(self.squares[:, number] / known - mean**2, 0.0))
                own, first = (values[:, number] / known for values in (self.variance, self.first_variance))
            shares = np.array([each.variance_share(max(area, cell_m2)) for each in correlations])
            gaps = (1 - known / self.cells[number]) * spread
            date_error = np.sqrt(own * shares + offset_m**2 + gaps**2)
            whole = np.hypot(date_error, np.sqrt(first * shares))
            deviation = area * np.where(np.arange(len(years)) == 0, 0.0, whole)
            volume = area * mean
            slope = trends(years, volume[:, None, None], (area * date_error)[:, None, None])
            one = AreaOverTime(
                name=name,
                outline=outline,
                area=area,
                known=known / self.cells[number],
                mean=mean,
                volume=volume,
                deviation=deviation,
                trend=float(slope.slope[0, 0]),
                trend_error=float(slope.error[0, 0]),
            )
            found.append(one)
        return found


def outlined(outlines: Outlines) -> Dict[str, bytes]:
    """The outlines of what changed, by their numbers as names."""
    return {str(number): outline for number, _, outline in outlines}


def require_inside(found: Sequence[AreaOverTime], path: str) -> None:
    """Raise OverlapError where no area lies where the DSMs do."""
    if not any((each.known > 0).any() for each in found):
        raise OverlapError(
            f"No polygon of '{path}' has heights of the DSMs: choose areas that lie where at least three DSMs do."
        )


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
