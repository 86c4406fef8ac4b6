"""Points as references: tables as CSV, those of SlideRule, NSIDC and EarthExplorer too, and layers that OGR opens."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass
from typing import Callable, Iterator, Mapping, Optional, Sequence, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import Bounds, FloatArray
from ..contracts.errors import InputTableError
from ..files.tables import CsvTable, LayerTable, Limits, number_in
from ..geometry.frames import flat_crs
from ..geometry.vertical import ELLIPSOID, HeightDatum, metres_per_unit, stated_datum
from .found import FoundHeights, FoundPoints, Within, places_unit
from .lasers import Laser, flags, lasers

TEXTS = (".csv", ".tsv", ".txt")
"""Extensions of tables."""

_LIMITS = Limits(bytes=1 << 30, rows=10_000_000, what="the points of the scene's surroundings")
_ROWS = 100_000  # that are added at once
_WGS84 = "EPSG:4326"

_DEGREES = (
    ("lon_lowestmode", "lat_lowestmode"),
    ("lon_ph", "lat_ph"),
    ("longitude", "latitude"),
    ("lon", "lat"),
    ("long", "lat"),
    ("lng", "lat"),
)
_METRES = (("x", "y"), ("easting", "northing"), ("east", "north"))
_TEXT = ("geometry", "wkt", "geom")  # "POINT (3.1 42.2)", as GeoPandas writes it
_POINT = re.compile(r"\s*POINT\s*(?:Z|M|ZM)?\s*\(\s*([-+.\deE]+)\s+([-+.\deE]+)", re.IGNORECASE)
_EMPTY = ("", "nan", "none", "null", "na")
_HEIGHTS = ("height", "h", "z", "elevation", "elev", "altitude", "alt")
_ELLIPSOIDAL = ("ellipsoidal_height", "height_ellipsoid", "h_ellipsoid", "height_above_datum")  # the last is ASP's
_LASER_HEIGHTS = {
    "h_ph": "ATL03",
    "h_li": "ATL06",
    "h_mean": "ATL06",  # SlideRule's
    "h_te_best_fit": "ATL08",
    "h_te_median": "ATL08",  # SlideRule's
    "elev_lowestmode": "GEDI L2A",
    "elevation_lm": "GEDI L2A",  # SlideRule's
}
_PHOTONS = ("atl03_cnf", "signal_conf_ph")  # SlideRule's photons have them beside a "height"


@dataclass(frozen=True)
class _Heights:
    """The field with heights, what they are of, and the fields of quality with the least and the greatest value."""

    field: str
    laser: Optional[Laser]
    quality: Tuple[Tuple[str, float, float], ...]
    datum: Optional[HeightDatum]

    @classmethod
    def of(cls, fields: Sequence[str]) -> Optional[_Heights]:
        """By the names of all fields, in lower case; None where there are no heights."""
        products = {laser.name: laser for laser in lasers()}
        named = next(((name, product) for name, product in _LASER_HEIGHTS.items() if name in fields), None)
        plain = next((name for name in (*_ELLIPSOIDAL, *_HEIGHTS) if name in fields), None)
        if named is None and plain and any(name in fields for name in _PHOTONS):
            named = (plain, "ATL03")
        ellipsoid = HeightDatum("", ELLIPSOID)
        if named is not None:
            quality = tuple((name, low, high) for name, (low, high) in flags().items() if name in fields)
            return cls(named[0], products[named[1]], quality, ellipsoid)
        return cls(plain, None, (), ellipsoid if plain in _ELLIPSOIDAL else None) if plain else None

    def of_row(self, place: str, row: Mapping[str, object]) -> float:
        """The height of a row, NaN where it is empty or of no good quality."""
        for name, low, high in self.quality:
            if not low <= _number(place, row, name) <= high:
                return math.nan
        return _number(place, row, self.field)

    def found(self, points: FoundPoints, system: pyproj.CRS) -> FoundHeights:
        """``system`` is the CRS of their places."""
        if self.laser is None:
            return points.found(datum=self.datum, places_in=places_unit(flat_crs(system)))
        return points.found(self.laser.width_m, self.laser.disc, self.datum)


def read_points_of_table(path: str, crs: str, bounds: Bounds, check: Callable[[], None] = lambda: None) -> FoundHeights:
    """The points of a CSV file within bounds of the scene's projected CRS, good ones where it says which are.

    Fields for longitude and latitude are in degrees (WGS 84); x and y are too if all are as small as degrees are, and
    are in the scene's CRS else. The names of heights and quality are those of :data:`_LASER_HEIGHTS` and
    :func:`~repm_qgis.registration.lasers.flags`; heights of other names, such as z, have an unknown datum.
    ``check`` is called between parts, and may raise to stop.

    Raises InputTableError with the file and the row for what cannot be read, OverlapError where no point is within the
    bounds.
    """
    _LIMITS.require_size(path)
    table = CsvTable(path)
    heights = _Heights.of(table.fields)
    degrees = next((pair for pair in _DEGREES if set(pair) <= set(table.fields)), None)
    metres = next((pair for pair in _METRES if set(pair) <= set(table.fields)), None)
    text = next((name for name in _TEXT if name in table.fields), None)
    if heights is None or not (degrees or metres or text):
        raise InputTableError(
            f"'{path}' has no fields that say where its points are: name them longitude, latitude and height, or x, y "
            "and z in the scene's CRS."
        )
    named = degrees or metres

    def rows() -> Iterator[_Xyz]:
        for line, row in table.rows():
            _LIMITS.require_count(path, line - 1)
            place = f"'{path}', row {line}"
            height = heights.of_row(place, row)
            if math.isfinite(height):
                x, y = (
                    (_number(place, row, name) for name in named) if named else _place(place, str(row.get(text or "")))
                )
                yield x, y, height

    parts = _parts(rows(), check)
    part = next(parts)
    small = metres != named or bool((np.abs(part[:2]) <= [[360], [90]]).all())
    system = pyproj.CRS(_WGS84 if small else crs)
    points = FoundPoints(path, Within(system, crs, bounds))
    for x, y, height in itertools.chain([part], parts):
        points.add(x, y, height)
    return heights.found(points, system)


def read_points_of_layer(
    path: str, name: str, crs: str, bounds: Bounds, check: Callable[[], None] = lambda: None
) -> FoundHeights:
    """The points of a layer ("": the first one) within bounds of the scene's projected CRS, as of a table.

    Places are the points' own. So are heights, where they have some and no field is one of a laser's.

    Raises InputTableError for a layer that cannot be read, has no points or no CRS, OverlapError where no point is
    within the bounds.
    """
    _LIMITS.require_size(path)
    layer = LayerTable(path, name)
    if not layer.placed:
        raise InputTableError(f"The layer of '{path}' does not hold points: choose a layer of points or a raster.")
    if layer.crs is None:
        raise InputTableError(f"The layer of '{path}' has no coordinate reference system: assign it one first.")
    fields = _Heights.of(layer.fields)
    own = layer.has_height and (fields is None or fields.laser is None)
    if fields is None and not own:
        raise InputTableError(f"The points of '{path}' have no heights: give points with Z, or a field 'height'.")
    unit, datum = metres_per_unit(layer.crs) or 1.0, stated_datum(layer.crs)
    points = FoundPoints(path, Within(flat_crs(layer.crs), crs, bounds))
    layer.keep_within(points.within.source_bounds)

    def rows() -> Iterator[_Xyz]:
        for line, row, point in layer.rows():
            _LIMITS.require_count(path, line)
            if point is not None:
                height = point[2] * unit if own or fields is None else fields.of_row(f"'{path}', row {line}", row)
                yield point[0], point[1], height

    for x, y, height in _parts(rows(), check):
        points.add(x, y, height)
    if own or fields is None:
        return points.found(datum=datum, places_in=places_unit(layer.crs))
    return fields.found(points, layer.crs)


_Xyz = Tuple[float, float, float]


def _parts(rows: Iterator[_Xyz], check: Callable[[], None]) -> Iterator[FloatArray]:
    """(3, N) x, y and heights of some rows at a time; one part without any where there are none."""
    while True:
        check()
        part = list(itertools.islice(rows, _ROWS))
        yield np.array(part, dtype=np.float64).reshape(-1, 3).T
        if len(part) < _ROWS:
            return


def _number(place: str, row: Mapping[str, object], name: str) -> float:
    """A field's number, NaN where it is empty."""
    value = row.get(name)
    text = "" if value is None else str(value).strip()
    if text.lower() in _EMPTY:
        return math.nan
    return number_in(place, name, text)


def _place(place: str, text: str) -> Tuple[float, float]:
    found = _POINT.match(text)
    try:
        return float(found[1]), float(found[2])  # type: ignore[index]
    except (TypeError, ValueError):
        raise InputTableError(f"{place}: its geometry is {text[:80]!r}, not a point: give POINT (lon lat).") from None
