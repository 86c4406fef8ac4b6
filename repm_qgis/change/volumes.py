"""Changed cells as polygons: their areas, heights and volumes, and how uncertain the volumes are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Iterator, List, Sequence, Tuple

import numpy as np
from osgeo import gdal, ogr, osr

from ..contracts.arrays import FloatArray, FloatImage, IntArray, Mask, Window
from ..contracts.errors import WorkspaceError
from ..evaluation.grids import Grid
from ..geometry.cell_grid import overlapping_blocks
from ..imagery import raster
from .errors import Correlation, ErrorModel
from .parameters import DetectionParameters

LOSS, GAIN = 1, 2
"""Values of the raster of signs; 0 is no change."""
FIELDS = {
    "change": str,
    "area_m2": float,
    "mean_m": float,
    "largest_m": float,
    "volume_m3": float,
    "deviation_m3": float,
}
"""The fields of the polygons, in their order: volume and heights are negative for losses, the deviation is standard."""
_CONNECTED = 4  # diagonal neighbours are apart: polygons that touch themselves in a point are not valid


@dataclass(frozen=True)
class Changed:
    """One change: outline in the grid's CRS as WKB, ``cells`` it consists of, m2, m, m3."""

    number: int
    outline: bytes
    gain: bool
    cells: int
    area: float
    mean: float
    largest: float
    volume: float
    deviation: float

    @property
    def values(self) -> Tuple[str, float, float, float, float, float]:
        """What the polygon's fields have."""
        kind = "gain" if self.gain else "loss"
        return kind, self.area, self.mean, self.largest, self.volume, self.deviation


class Shapes:
    """Polygons on a grid, in its CRS, numbered from 1."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._reference = osr.SpatialReference()
        self._reference.ImportFromWkt(grid.crs.to_wkt("WKT2_2019"))
        self._reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
        self._memory = ogr.GetDriverByName("Memory").CreateDataSource("changes")
        self._layer = self._memory.CreateLayer("changes", self._reference, ogr.wkbPolygon)
        for name in ("sign", "number"):
            self._layer.CreateField(ogr.FieldDefn(name, ogr.OFTInteger))

    def __len__(self) -> int:
        return int(self._layer.GetFeatureCount())

    def numbers(self, window: Window) -> IntArray:
        """(rows, columns) the number of the polygon that each cell of a window belongs to, 0 for none."""
        cells = self._grid.window(window)
        target = gdal.GetDriverByName("MEM").Create("", window.width, window.height, 1, gdal.GDT_Int32)
        target.SetGeoTransform(list(cells.transform))
        target.SetSpatialRef(self._reference)
        self._layer.SetSpatialFilterRect(*cells.bounds)
        with raster.quiet():
            gdal.RasterizeLayer(target, [1], self._layer, options=["ATTRIBUTE=number"])
        return np.asarray(target.ReadAsArray(), np.int64)


class Outlines(Shapes):
    """The connected parts of a raster of signs, numbered from 1, of at least so many cells."""

    def __init__(self, signs: str, large: str, grid: Grid, least_cells: int, check: Callable[[], None]) -> None:
        """``signs`` is the raster's path, ``large`` that of a raster to write with its parts that are large enough."""
        super().__init__(grid)
        _keep_large(signs, large, least_cells, check)
        with raster.opened(large) as dataset:
            band = dataset.GetRasterBand(1)
            with raster.quiet():
                gdal.Polygonize(band, band, self._layer, 0, [], callback=_asked(check))
        check()
        least = (least_cells - 0.5) * abs(grid.transform[1] * grid.transform[5])
        for feature in list(self._layer):  # the sieve leaves what has no larger neighbour
            if feature.GetGeometryRef().GetArea() < least:
                self._layer.DeleteFeature(feature.GetFID())
        for number, feature in enumerate(self._layer, start=1):
            feature.SetField("number", number)
            self._layer.SetFeature(feature)

    def __iter__(self) -> Iterator[Tuple[int, bool, bytes]]:
        """Number, whether it is a gain, and outline of each."""
        self._layer.SetSpatialFilter(None)
        for feature in self._layer:
            outline = bytes(feature.GetGeometryRef().ExportToWkb())
            yield feature.GetField("number"), feature.GetField("sign") == GAIN, outline


def _keep_large(signs: str, large: str, least_cells: int, check: Callable[[], None]) -> None:
    """Write the raster of signs again without its parts of fewer than ``least_cells`` cells."""
    with raster.opened(signs) as dataset:
        size, source = (dataset.RasterXSize, dataset.RasterYSize), dataset.GetRasterBand(1)
        copy = gdal.GetDriverByName("GTiff").Create(large, *size, 1, gdal.GDT_Byte, ["COMPRESS=DEFLATE", "TILED=YES"])
        if copy is None:
            raise WorkspaceError(f"'{large}' cannot be written ({gdal.GetLastErrorMsg()}): free space on its disk.")
        copy.SetGeoTransform(dataset.GetGeoTransform())
        target, most = copy.GetRasterBand(1), min(size[0] * size[1], 2**31 - 1)
        with raster.quiet():
            gdal.SieveFilter(source, None, target, min(max(least_cells, 1), most), _CONNECTED, callback=_asked(check))
        check()
        for window, _ in overlapping_blocks(size, 1024):  # the sieve also fills what is small and did not change
            place = window.col, window.row, window.width, window.height
            before, after = (band.ReadAsArray(*place) for band in (source, target))
            target.WriteArray(np.where(before == after, after, np.uint8(0)), window.col, window.row)
        copy.FlushCache()
        target = copy = None  # noqa: F841 - closes it


def _asked(check: Callable[[], None]) -> Callable[..., int]:
    """GDAL's callback: 0 stops it. The exception is raised by asking again."""

    def go_on(*_: object) -> int:
        try:
            check()
        except Exception:  # noqa: BLE001 - whatever stops us; it cannot pass through GDAL
            return 0
        return 1

    return go_on


class Sums:
    """What is added up over the cells of each change, block by block."""

    def __init__(self, count: int) -> None:
        self.cells = np.zeros(count + 1)
        self.change = np.zeros(count + 1)
        self.largest = np.zeros(count + 1)
        self.edge = np.zeros(count + 1)
        self.core = np.zeros(count + 1)
        self.core_variance = np.zeros(count + 1)
        self.supported = np.zeros(count + 1)
        self.hidden = np.zeros(count + 1)

    def add(
        self, numbers: IntArray, change: FloatImage, core_error: FloatImage, support: FloatImage, hidden: FloatImage
    ) -> None:
        """A block's cells, ``numbers`` with a margin of one around them; ``core_error`` is NaN outside of cores,
        ``support`` is above 0 in cells that no error explains, and ``hidden`` in the strips at walls."""
        inner = numbers[1:-1, 1:-1]
        edge = np.zeros(inner.shape, bool)
        for near in (numbers[:-2, 1:-1], numbers[2:, 1:-1], numbers[1:-1, :-2], numbers[1:-1, 2:]):
            edge |= near != inner
        values, errors = (array.astype(np.float64) for array in (change, core_error))
        core = np.isfinite(errors)
        for total, mask, weights in (
            (self.cells, None, None),
            (self.change, None, np.nan_to_num(values)),
            (self.edge, edge, None),
            (self.core, core, None),
            (self.core_variance, core, np.nan_to_num(errors) ** 2),
            (self.supported, support > 0, None),
            (self.hidden, hidden > 0, np.nan_to_num(values)),
        ):
            here = inner > 0 if mask is None else mask & (inner > 0)
            total += np.bincount(inner[here], None if weights is None else weights[here], minlength=total.size)
        inside = inner > 0
        np.maximum.at(self.largest, inner[inside], np.abs(np.nan_to_num(values[inside])))

    def changes(
        self,
        outlines: Outlines,
        model: ErrorModel,
        correlation: Correlation,
        cell_m2: float,
        offset_m: float,
        least_m2: float,
        parameters: DetectionParameters,
    ) -> List[Changed]:
        """The changes, the largest volume first, without those that their own uncertainty exceeds, or that are
        supported on less than ``least_m2``.

        Four independent parts make a volume uncertain: the errors of its heights, averaged over as many cells as are
        independent; the outline, which may be off by the horizontal error all around at the mean height, as matching
        makes objects too wide or too narrow on all sides; the offset between the DSMs (``offset_m``, its standard
        deviation); and what lies in the strips at walls, of which
        half is counted.
        """
        found = []
        for number, gain, outline in outlines:
            cells, sign = self.cells[number], 1.0 if gain else -1.0
            if not self._is_supported(number, cell_m2, least_m2):
                continue
            area = float(cells * cell_m2)
            mean = float(self.change[number] / cells)
            height = math.sqrt(self.core_variance[number] / self.core[number] * correlation.variance_share(area))
            edge = model.horizontal_m * math.sqrt(cell_m2) * float(self.edge[number]) * abs(mean)
            strips = cell_m2 * float(self.hidden[number])
            deviation = math.sqrt((area * height) ** 2 + edge**2 + (area * offset_m) ** 2 + strips**2)
            if abs(area * mean) > parameters.level * deviation:
                largest = sign * float(self.largest[number])
                found.append(Changed(number, outline, gain, int(cells), area, mean, largest, area * mean, deviation))
        return sorted(found, key=lambda each: -abs(each.volume))

    def unsupported(self, cell_m2: float, least_m2: float) -> List[float]:
        """The areas of the parts, m2, whose cores are so large, and that no error explains on less of them."""
        return [
            float(self.cells[number]) * cell_m2
            for number in np.flatnonzero(self.core[1:] * cell_m2 >= least_m2) + 1
            if not self._is_supported(number, cell_m2, least_m2)
        ]

    def _is_supported(self, number: int, cell_m2: float, least_m2: float) -> bool:
        return bool(self.supported[number] and self.supported[number] * cell_m2 >= least_m2)


@dataclass(frozen=True)
class Total:
    """All gains or all losses: how many, m2, m3 and its standard deviation."""

    count: int
    area: float
    volume: float
    deviation: float


def total_of(changes: Sequence[Changed], offset_m: float) -> Total:
    """The sum of changes, whose errors are independent apart from the common offset."""
    area, volume = (float(sum(getattr(each, name) for each in changes)) for name in ("area", "volume"))
    own = sum(each.deviation**2 - (each.area * offset_m) ** 2 for each in changes)
    return Total(len(changes), area, volume, math.sqrt(max(own, 0.0) + (area * offset_m) ** 2))


def kept_cells(numbers: IntArray, changes: Sequence[Changed]) -> Mask:
    """Which cells belong to one of the changes."""
    return np.isin(numbers, np.array([each.number for each in changes], np.int64))


def centre_of(outline: bytes) -> FloatArray:
    """(2,) x and y of a place inside an outline, in its CRS."""
    place = ogr.CreateGeometryFromWkb(outline).PointOnSurface()
    return np.array([place.GetX(), place.GetY()])
