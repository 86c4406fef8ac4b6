"""Surfaces that are known by formula anywhere on the Earth, and rasters of them as users have them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Callable, Dict, Optional, Tuple

import numpy as np
import pyproj
from osgeo import gdal, osr

Box = Tuple[float, float, float, float, float]
"""xmin, ymin, xmax, ymax (m from the world's middle) and a height above the ground, m."""
Change = Callable[[np.ndarray], np.ndarray]
SIDE_M = 120.0
NODATA = -9999.0
FEET = 0.3048
FROM_ECEF = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
"""From geocentric coordinates to longitude, latitude and ellipsoidal height."""


@dataclass(frozen=True)
class World:
    """A place (degrees) with ground, houses and changes; places are metres east and north of its middle, heights metres
    above the WGS 84 ellipsoid."""

    seed: int
    lon: float
    lat: float
    base: float = 300.0
    slope: Tuple[float, float] = (0.0, 0.0)
    relief: float = 2.0
    houses: Tuple[Box, ...] = ()
    changes: Tuple[Box, ...] = ()

    @classmethod
    def drawn(cls, seed: int) -> World:
        """A place in Europe with hills and houses."""
        rng = np.random.default_rng(seed)
        lon, lat = float(rng.uniform(-8, 16)), float(rng.uniform(36, 64))
        slope = tuple(map(float, rng.uniform(-0.08, 0.08, 2)))
        houses = []
        for east in (-38.0, 0.0, 38.0):
            for north in (-38.0, 0.0, 38.0):
                if rng.random() < 0.45:
                    width, length = rng.uniform(9, 18, 2)
                    x, y = float(width) / 2, float(length) / 2
                    houses.append((east - x, north - y, east + x, north + y))
        heights = rng.uniform(4, 12, len(houses))
        boxes = tuple((*box, float(height)) for box, height in zip(houses, heights))
        return cls(seed, lon, lat, float(rng.uniform(20, 900)), (slope[0], slope[1]), float(rng.uniform(0.5, 3)), boxes)

    def with_changes(self) -> World:
        """The same after a heap and a pit of some hundred m3 each came, beside the houses."""
        rng = np.random.default_rng(self.seed + 1)
        heap, pit = float(rng.uniform(4, 6)), -float(rng.uniform(4, 6))
        return replace(self, changes=((-31.0, -31.0, -11.0, -11.0, heap), (11.0, 11.0, 29.0, 29.0, pit)))

    def ground(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        phase = self.seed % 7
        waves = np.sin(x / 17.0 + phase) * np.cos(y / 23.0) + 0.4 * np.sin(x / 7.0 - y / 9.0)
        return self.base + self.slope[0] * x + self.slope[1] * y + self.relief * waves

    def surface(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(...) heights at places, m."""
        heights = self.ground(x, y)
        for xmin, ymin, xmax, ymax, added in (*self.houses, *self.changes):
            heights = heights + added * ((x > xmin) & (x < xmax) & (y > ymin) & (y < ymax))
        return heights

    def difference(self, one: Form, other: Form, between_x: Tuple[float, float] = (-55.0, 55.0)) -> Tuple[float, float]:
        """The median and the NMAD of the differences of two rasters, m, by the formula."""
        x, y = np.meshgrid(np.linspace(*between_x, 221), np.linspace(-55.0, 55.0, 221))
        heights = [self.surface(x - each.moved[0], y - each.moved[1]) + each.added for each in (one, other)]
        away = heights[0] - heights[1]
        middle = float(np.median(away))
        return middle, 1.4826 * float(np.median(np.abs(away - middle)))

    def built(self, box: Box) -> float:
        """The volume of a house from the lowest ground at its outline, m3."""
        x0, y0, x1, y1, _ = box
        x, y = np.meshgrid(np.linspace(x0, x1, 41), np.linspace(y0, y1, 41))
        inner = slice(1, -1)
        roof = self.surface(x[inner, inner], y[inner, inner])
        return float((np.median(roof) - self.ground(x, y).min()) * (x1 - x0) * (y1 - y0))

    @property
    def crs(self) -> pyproj.CRS:
        """The world's own metres, which are true around its middle."""
        return _own(self.lon, self.lat)

    def utm(self, beside: int = 0) -> str:
        """The code of its UTM zone, or of one beside it."""
        return f"EPSG:{32600 + int((self.lon + 180) // 6) % 60 + 1 + beside}"

    def volumes(self) -> Tuple[float, float]:
        """The volumes of what was added and taken away, m3."""
        sizes = [(x1 - x0) * (y1 - y0) * height for x0, y0, x1, y1, height in self.changes]
        return sum(size for size in sizes if size > 0), -sum(size for size in sizes if size < 0)


@lru_cache(maxsize=64)
def _own(lon: float, lat: float) -> pyproj.CRS:
    return pyproj.CRS(f"+proj=tmerc +lat_0={lat} +lon_0={lon} +k=1 +ellps=WGS84 +units=m")


@lru_cache(maxsize=256)
def between(source: pyproj.CRS, target: str) -> pyproj.Transformer:
    return pyproj.Transformer.from_crs(source, target, always_xy=True)


def undulation(lon: float, lat: float) -> float:
    """How far EGM96 lies above the ellipsoid, m, by PROJ."""
    to_geoid = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4326+5773", always_xy=True)
    return -float(to_geoid.transform(lon, lat, 0.0)[2])


@dataclass(frozen=True)
class Form:
    """How a raster of a world is made: CRS, cell (m on the ground), what it covers (m from the middle), what its
    heights refer to and are counted in, errors, holes, and metadata.

    ``turned`` multiplies true places, ``factor`` what is above the world's base; ``tilt`` is added from west to east.
    ``datum`` is "ellipsoid" (stated), "EGM96" (stated) or "" (not stated, above the ellipsoid). ``moved`` is added to
    true places, ``added`` to heights. ``unit`` "ft" counts in feet; it is stated where ``states_unit``. ``scaled``
    stores whole decimetres with a scale. ``fill`` is the value of holes, which is declared where ``declares``.
    """

    crs: str
    cell: float = 0.5
    covers: Tuple[float, float, float, float] = (-SIDE_M / 2, -SIDE_M / 2, SIDE_M / 2, SIDE_M / 2)
    datum: str = "ellipsoid"
    moved: Tuple[float, float] = (0.0, 0.0)
    added: float = 0.0
    turned: Tuple[float, float] = (1.0, 1.0)
    factor: float = 1.0
    tilt: float = 0.0
    sigma: float = 0.05
    unit: str = "m"
    states_unit: bool = True
    scaled: bool = False
    holes: float = 0.0
    fill: float = NODATA
    declares: bool = True
    metadata: Dict[str, str] = field(default_factory=dict)
    crs_of_file: str = ""


def cells_of(world: World, form: Form) -> Tuple[Tuple[float, ...], Tuple[int, int], np.ndarray, np.ndarray]:
    """GDAL's geotransform and (rows, columns) of a raster, and the (rows, columns) places of its centres, m."""
    there = between(world.crs, form.crs)
    x0, y0, x1, y1 = form.covers
    xs, ys = there.transform([x0, x1, x1, x0, -1, 1, 0, 0], [y0, y0, y1, y1, 0, 0, -1, 1])
    wide, high = abs(xs[5] - xs[4]) / 2 * form.cell, abs(ys[7] - ys[6]) / 2 * form.cell  # units of the CRS
    west, north = np.floor(min(xs[:4]) / wide) * wide, np.ceil(max(ys[:4]) / high) * high
    columns, rows = int((max(xs[:4]) - west) / wide), int((north - min(ys[:4])) / high)
    u, v = np.meshgrid(west + (np.arange(columns) + 0.5) * wide, north - (np.arange(rows) + 0.5) * high)
    x, y = there.transform(u, v, direction="INVERSE")
    return (west, wide, 0.0, north, 0.0, -high), (rows, columns), np.asarray(x), np.asarray(y)


def write(
    path: str, world: World, form: Form, heights: str = "surface", seed: int = 0, changed: Change = np.asarray
) -> str:
    """Write a raster of a world's surface or ground, whose (rows, columns) heights were changed; gives its path."""
    transform, shape, x, y = cells_of(world, form)
    rng = np.random.default_rng([world.seed, seed])
    true = changed(getattr(world, heights)(form.turned[0] * (x - form.moved[0]), form.turned[1] * (y - form.moved[1])))
    values = world.base + form.factor * (true - world.base) + form.added + form.tilt * x / SIDE_M
    values = values + form.sigma * rng.normal(size=shape)
    if form.datum == "EGM96":
        values = values - undulation(world.lon, world.lat)
    hidden = np.zeros(shape, bool)
    for _ in range(int(form.holes * 100)):
        row, column = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        hidden[row : row + max(shape[0] // 10, 1), column : column + max(shape[1] // 10, 1)] = True
    return store(path, values, hidden, transform, form)


def store(path: str, values: np.ndarray, hidden: np.ndarray, transform: Tuple[float, ...], form: Form) -> str:
    """Write (rows, columns) heights as a form has them."""
    values = values / FEET if form.unit == "ft" else values
    kind, scale = (gdal.GDT_Int32, 0.1) if form.scaled else (gdal.GDT_Float32, 1.0)
    stored = np.where(hidden, form.fill, np.rint(values / scale) if form.scaled else values)
    rows, columns = values.shape
    made = gdal.GetDriverByName("GTiff").Create(path, columns, rows, 1, kind)
    made.SetGeoTransform(transform)
    reference = osr.SpatialReference()
    reference.SetFromUserInput((form.crs_of_file or form.crs) + ("+5773" if form.datum == "EGM96" else ""))
    made.SetSpatialRef(reference)
    if form.datum == "ellipsoid":
        made.SetMetadataItem("VERTICAL_DATUM", "WGS 84 ellipsoid")
    for name, value in form.metadata.items():
        made.SetMetadataItem(name, value)
    band = made.GetRasterBand(1)
    if form.states_unit:
        band.SetUnitType(form.unit)
    if form.scaled:
        band.SetScale(scale)
    if form.declares:
        band.SetNoDataValue(form.fill)
    band.WriteArray(stored)
    made = band = None  # noqa: F841 - closes them
    return path


def write_errors(path: str, world: World, form: Form, error: float, hole: Optional[Box] = None) -> str:
    """Write a confidence raster of one band on the cells of a form, with no error in a box."""
    transform, shape, x, y = cells_of(world, form)
    hidden = np.zeros(shape, bool)
    if hole is not None:
        hidden = (x > hole[0]) & (x < hole[2]) & (y > hole[1]) & (y < hole[3])
    plain = replace(form, datum="", unit="m", scaled=False, fill=NODATA, declares=True, metadata={})
    return store(path, np.full(shape, error), hidden, transform, plain)


def write_boxes(path: str, world: World, boxes: Tuple[Box, ...]) -> str:
    """Write boxes as polygons in longitude and latitude."""
    to_degrees = between(world.crs, "EPSG:4326")
    features = []
    for x0, y0, x1, y1, _ in boxes:
        lon, lat = to_degrees.transform([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0])
        shape = {"type": "Polygon", "coordinates": [list(map(list, zip(lon, lat)))]}
        features.append({"type": "Feature", "properties": {}, "geometry": shape})
    with open(path, "w", encoding="utf-8") as stream:
        json.dump({"type": "FeatureCollection", "features": features}, stream)
    return path


def read(path: str, world: World) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A raster's heights with a value, as it stores them, and their places (m from the middle)."""
    dataset = gdal.Open(path)
    values = dataset.GetRasterBand(1).ReadAsArray().astype(np.float64)
    nodata, (west, wide, _, north, _, high) = dataset.GetRasterBand(1).GetNoDataValue(), dataset.GetGeoTransform()
    rows, columns = values.shape
    u, v = np.meshgrid(west + (np.arange(columns) + 0.5) * wide, north + (np.arange(rows) + 0.5) * high)
    crs = dataset.GetSpatialRef()
    crs = pyproj.CRS.from_wkt(crs.ExportToWkt(["FORMAT=WKT2_2018"]))
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    x, y = pyproj.Transformer.from_crs(world.crs, flat, always_xy=True).transform(u, v, direction="INVERSE")
    known = np.isfinite(values) & (values != nodata)
    return values[known], np.asarray(x)[known], np.asarray(y)[known]
