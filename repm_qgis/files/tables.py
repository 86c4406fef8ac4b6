"""Tables of points from users, as CSV files or layers that OGR opens: bounded in size, with a sentence for each
error."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

import pyproj
from osgeo import gdal, ogr

from ..contracts.arrays import Bounds
from ..contracts.checks import as_text
from ..contracts.errors import InputTableError
from ..geometry.frames import on_earth
from .untrusted import refusal_of
from .vector import open_layer, reference_of

_INDEXED = (".gpkg", ".shp", ".fgb", ".sqlite", ".gdb")  # read row by row, and know how many there are
_DELIMITERS = ",;\t"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
_UNIT = r"(?:\s*(?:°|º|deg|degrees?))"
_COMMA = re.compile(rf"[+-]?\d*,\d+{_UNIT}?", re.IGNORECASE)
_POINT = re.compile(rf"[+-]?\d*\.\d+{_UNIT}?", re.IGNORECASE)
_SEPARATOR = re.compile(r"sep=(.)\s*", re.IGNORECASE)  # the first line that spreadsheets write and read
_DEGREES = re.compile(rf"(.+?){_UNIT}", re.IGNORECASE)
_TEXTS = ("id", "name", "view", "role")  # fields that are no numbers, whatever they look like
_ANGLES = ("lon", "lat", "long", "lng", "longitude", "latitude")
# What spreadsheets take for a formula, whoever wrote the text (OWASP, CSV injection); a quote makes it a text.
_FORMULA = re.compile(r"[=+\-@\t\r]")
_QUOTED = re.compile(r"'[=+\-@\t\r]")


def number_in(place: str, name: str, value: object) -> float:
    """The number that a field of a row has, as text or as a number; raises InputTableError, which names ``place``.

    Python's own reading also accepts forms that users do not mean: 1_000, or digits of other scripts.
    """
    text = str(value).strip()
    degrees = _DEGREES.fullmatch(text) if name in _ANGLES else None
    text = degrees[1] if degrees else text
    if isinstance(value, (int, float)) or _NUMBER.fullmatch(text):
        return float(text)
    remedy = "; write decimals with a point" if _COMMA.fullmatch(text) else ""
    raise InputTableError(f"{place}: the field '{name}' is {text[:80]!r}, which is not a number{remedy}.")


@dataclass(frozen=True)
class Limits:
    """How much a table may hold; ``what`` is what users should choose instead, as in "choose the list of points"."""

    bytes: int
    rows: int
    what: str

    def require_size(self, path: str) -> None:
        """Raise InputTableError for a pipe or device, and for a file that would have to be read before its rows count.

        Layers that know how many rows they have may be larger.
        """
        wrong = refusal_of(path)
        if wrong:
            raise InputTableError(f"'{path}' {wrong}")
        size = os.path.getsize(path) if os.path.isfile(path) else 0
        if size > self.bytes and Path(path).suffix.lower() not in _INDEXED:
            limit = f"a table or text of points has at most {self.bytes >> 20} MiB"
            raise InputTableError(f"'{path}' has {size >> 20} MiB, and {limit}: choose {self.what}.")

    def require_count(self, path: str, rows: int) -> None:
        """Raise InputTableError for more rows."""
        if rows > self.rows:
            raise InputTableError(f"'{path}' has more than {self.rows} rows: choose {self.what}, or a part of it.")


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Rows as CSV with commas, one a line. A text that a spreadsheet would run as a formula gets a quote before it,
    which :class:`CsvTable` takes off again; numbers stay numbers."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in rows:
        writer.writerow([_harmless(cell) if isinstance(cell, str) else cell for cell in row])
    return text.getvalue()


def _harmless(text: str) -> str:
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


class CsvTable:
    """A CSV file in UTF-8 whose first line names the fields, after a line ``sep=;`` if there is one; they are read in
    lower case. Where a semicolon or a tabulator parts the fields, decimals may have a comma."""

    def __init__(self, path: str) -> None:
        """Raises InputTableError where the file cannot be read."""
        self._path = path
        with self._sentences(), open(path, encoding="utf-8-sig", newline="") as stream:
            head = stream.readline(1 << 16)
            stated = _SEPARATOR.fullmatch(head)
            head = stream.readline(1 << 16) if stated else head
            self._first = 2 if stated else 1  # the line with the fields' names
            self._delimiter = max(_DELIMITERS, key=head.count)  # the first of those that are as frequent
            if stated:
                self._delimiter = stated[1]
            elif self._delimiter not in head:
                self._delimiter = " "
            self.surplus = False  # whether the last row has texts beyond the fields
            self.fields = [(name or "").strip().lower() for name in next(self._reader(iter([head])), [])]

    def rows(self) -> Iterator[Tuple[int, Mapping[str, object]]]:
        """Each row's number in the file, the first line being 1, and its texts; None where it is too short.

        Raises InputTableError where some numbers have a decimal comma and others a point: either may part thousands.
        """
        decimals = _Decimals(self._path)
        with self._sentences(), open(self._path, encoding="utf-8-sig", newline="") as stream:
            reader = self._reader(stream)
            for _ in range(self._first):
                next(reader, None)
            for line, row in enumerate((row for row in reader if row), start=self._first + 1):
                self.surplus = any(row[len(self.fields) :])
                texts = [text[1:] if text and _QUOTED.match(text) else text for text in row]
                values = dict(zip(self.fields, texts + [None] * (len(self.fields) - len(texts))))
                yield line, values if self._delimiter == "," else decimals.with_points(line, values)

    def _reader(self, lines: Iterator[str]) -> Iterator[List[Optional[str]]]:
        yield from csv.reader(lines, delimiter=self._delimiter, skipinitialspace=True)

    def _sentences(self) -> "_Sentences":
        return _Sentences(self._path)


class _Decimals:
    """The decimals of a table whose fields no comma parts: all with a comma, or all with a point."""

    def __init__(self, path: str) -> None:
        self._path, self._commas, self._points = path, 0, 0

    def with_points(self, line: int, values: Dict[str, Optional[str]]) -> Dict[str, Optional[str]]:
        """The values of a row whose numbers have points; raises InputTableError for the second kind in a table."""
        numbers = {name: text.strip() for name, text in values.items() if text and name not in _TEXTS}
        commas = {name: text.replace(",", ".") for name, text in numbers.items() if _COMMA.fullmatch(text)}
        self._commas = self._commas or (line if commas else 0)
        self._points = self._points or (line if any(map(_POINT.fullmatch, numbers.values())) else 0)
        if self._commas and self._points:
            raise InputTableError(
                f"'{self._path}' has numbers with a decimal comma (row {self._commas}) and with a point (row "
                f"{self._points}): write all decimals alike."
            )
        return {**values, **commas}


class _Sentences:
    """Errors of reading become one sentence."""

    def __init__(self, path: str) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if isinstance(error, (OSError, UnicodeDecodeError, csv.Error)):
            text = f"Cannot read the table '{self._path}' ({error}): give a CSV file in UTF-8."
            raise InputTableError(text) from error


class LayerTable:
    """A layer that OGR opens: ``fields`` in lower case, ``placed`` whether it has points, ``crs`` of them."""

    def __init__(self, path: str, name: str = "") -> None:
        """The layer of a name, or the first one; raises InputTableError where there is none that can be read."""
        self._path = path
        self._source, layer = open_layer(path, name)
        if layer is None:
            raise InputTableError(f"Cannot open the points of '{path}': give a CSV file or a point layer.")
        self._layer = layer
        definition = layer.GetLayerDefn()
        self.fields = [as_text(definition.GetFieldDefn(i).GetName()).lower() for i in range(definition.GetFieldCount())]
        kind = layer.GetGeomType()
        self.placed, self.has_height = ogr.GT_Flatten(kind) == ogr.wkbPoint, bool(ogr.GT_HasZ(kind))
        self.known_count = layer.GetFeatureCount(0)  # 0: only where the format knows it without counting
        reference = reference_of(layer)
        self.crs: Optional[pyproj.CRS] = None
        if reference is not None:
            try:
                crs = pyproj.CRS.from_wkt(as_text(reference.ExportToWkt(["FORMAT=WKT2_2018"])))
            except (RuntimeError, pyproj.exceptions.CRSError) as error:
                raise self._damaged(error) from error
            self.crs = on_earth(crs, path, InputTableError)

    def keep_within(self, bounds: Bounds) -> None:
        """Let :meth:`rows` give only those within bounds in the layer's CRS, where these are finite."""
        if all(map(math.isfinite, bounds)):
            self._layer.SetSpatialFilterRect(*bounds)

    def rows(self) -> Iterator[Tuple[int, Dict[str, object], Optional[Tuple[float, float, float]]]]:
        """Each feature's number from 1, its fields, and x, y, z of its point (None where it has none).

        Raises InputTableError where the layer ends with an error.
        """
        self._layer.ResetReading()
        for line, feature in enumerate(iter(self._next, None), start=1):
            geometry = feature.GetGeometryRef() if self.placed else None
            place = None if geometry is None else (geometry.GetX(), geometry.GetY(), geometry.GetZ())
            values = (feature.GetField(index) for index in range(len(self.fields)))
            texts = (as_text(value) if isinstance(value, str) else value for value in values)
            yield line, dict(zip(self.fields, texts)), place

    def _next(self) -> Optional[ogr.Feature]:
        """The next feature; None at the end, which for OGR is also where it can read no further."""
        gdal.PushErrorHandler("CPLQuietErrorHandler")
        gdal.ErrorReset()
        try:
            feature = self._layer.GetNextFeature()
            failed, reason = (
                gdal.GetLastErrorType() >= gdal.CE_Failure,
                gdal.GetLastErrorMsg(),
            )  # the next call may reset
        except RuntimeError as error:
            raise self._damaged(error) from error
        finally:
            gdal.PopErrorHandler()
        if feature is None and failed:
            raise self._damaged(reason)
        return feature

    def _damaged(self, reason: object) -> InputTableError:
        return InputTableError(f"Cannot read the points of '{self._path}' ({str(reason)[:300]}): get the file again.")
