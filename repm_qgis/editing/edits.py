"""The records of edits: a vector layer with one feature for each edit, read and written.

Fields: ``number`` (the order; without it, the features' own), ``operation`` (one of :data:`OPERATIONS`), ``value``
(m), ``width`` (m) and ``enabled`` (0: the edit is passed over). Others are not read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Optional, Sequence, Tuple, Union

from osgeo import ogr

from ..contracts.errors import InputTableError
from ..files.vector import file_and_layer, open_layer, require_reference, write_layer
from ..imagery.heights import HIGHEST_M, LOWEST_M
from ..imagery.raster import NODATA

OPERATIONS = ("remove", "fill", "set", "flatten", "breakline")
"""What an edit does: removes heights, fills from the rim, sets a value, flattens water, keeps a breakline."""

FIELDS: Dict[str, type] = {"number": int, "operation": str, "value": float, "width": float, "enabled": int, "made": str}
MOST_WIDTH_M = 10_000.0
_MOST_EDITS, _MOST_VERTICES = 10_000, 200_000
_LINES = (ogr.wkbLineString, ogr.wkbMultiLineString)
_AREAS = (ogr.wkbPolygon, ogr.wkbMultiPolygon)


@dataclass(frozen=True)
class Edit:
    """One record. ``geometry`` is ISO WKB in the layer's CRS; ``value`` in m, None where the operation finds it, and
    ``width`` of a line in m. ``made`` is the time in ISO 8601, for information only."""

    number: int
    operation: str
    geometry: bytes
    value: Optional[float] = None
    width: Optional[float] = None
    enabled: bool = True
    made: str = ""

    def record(self) -> Dict[str, object]:
        """What the edit does, as JSON can hold it."""
        wkt = ogr.CreateGeometryFromWkb(self.geometry).ExportToIsoWkt()
        found = {"number": self.number, "operation": self.operation, "value": self.value, "width": self.width}
        return {**{name: value for name, value in found.items() if value is not None}, "geometry": wkt}


@dataclass(frozen=True)
class Edits:
    """The records of a layer in the order of their numbers, and its CRS: its code where it has one, else WKT."""

    path: str
    crs: str
    edits: Tuple[Edit, ...]


def read_edits(path: str) -> Edits:
    """Read the records of a layer (``file|layername=name``, or a file's first layer), also those that are not enabled.

    Raises InputTableError, with the edit's number, for what is none.
    """
    file, name = file_and_layer(path)
    source, layer = open_layer(file, name)
    if layer is None:
        raise InputTableError(f"Cannot read the edits '{file}': give a GeoPackage with a layer of edits.")
    try:
        found = _read(file, layer)
    finally:
        del layer, source  # in this order, or OGR's objects outlive their file
    return found


def _read(path: str, layer: ogr.Layer) -> Edits:
    reference = require_reference(layer, path)
    if layer.GetFeatureCount() > _MOST_EDITS:
        raise InputTableError(
            f"'{path}' has {layer.GetFeatureCount()} edits, and EDITS takes {_MOST_EDITS}: apply them in parts."
        )
    definition = layer.GetLayerDefn()
    places = {definition.GetFieldDefn(i).GetName().lower(): i for i in range(definition.GetFieldCount())}
    if "operation" not in places:
        raise InputTableError(
            f"The layer '{path}' has no field 'operation': add one with {', '.join(OPERATIONS)} for each edit."
        )
    edits = [_edit(path, feature, places, index) for index, feature in enumerate(layer, start=1)]
    code = reference.GetAuthorityCode(None)  # WKT of one CRS differs from one version of PROJ to the next
    crs = f"{reference.GetAuthorityName(None)}:{code}" if code else reference.ExportToWkt(["FORMAT=WKT2_2018"])
    return Edits(path, crs, tuple(sorted(edits, key=lambda each: each.number)))


def _edit(path: str, feature: ogr.Feature, places: Dict[str, int], index: int) -> Edit:
    def field(name: str) -> Union[float, str, None]:
        place = places.get(name, -1)
        return feature.GetField(place) if place >= 0 and feature.IsFieldSetAndNotNull(place) else None

    given = _number(path, index, "number", field("number"))
    number = index if given is None else int(given)
    operation = str(field("operation") or "").strip().lower()
    if operation not in OPERATIONS:
        known = ", ".join(OPERATIONS)
        raise InputTableError(f"Edit {number} of '{path}' has the operation '{operation}': it must be one of {known}.")
    value, width, enabled = (_number(path, number, name, field(name)) for name in ("value", "width", "enabled"))
    geometry = feature.GetGeometryRef()
    wkb = _checked(path, number, operation, geometry, width)
    if operation == "set" and value is None:
        raise InputTableError(f"Edit {number} of '{path}' sets a value and has none: give its field 'value' in metres.")
    if value is not None and not LOWEST_M <= value <= HIGHEST_M:
        limits = f"{LOWEST_M:g} to {HIGHEST_M:g}"
        raise InputTableError(f"Edit {number} of '{path}' has the value {value:g}: heights are {limits} m.")
    if value == NODATA:
        remedy = "choose 'remove' for an edit that takes heights away"
        raise InputTableError(f"Edit {number} of '{path}' has the value {value:g}, which means no height: {remedy}.")
    return Edit(number, operation, wkb, value, width, enabled is None or bool(enabled), str(field("made") or ""))


def _number(path: str, number: int, name: str, value: Union[float, str, None]) -> Optional[float]:
    try:
        found = None if value is None else float(value)
    except ValueError:
        found = math.nan
    if found is not None and not math.isfinite(found):
        raise InputTableError(f"Edit {number} of '{path}' has the {name} '{value}', which is no number.")
    return found


def _checked(path: str, number: int, operation: str, geometry: Optional[ogr.Geometry], width: Optional[float]) -> bytes:
    """The shape of an edit as WKB; raises InputTableError where the operation cannot take it."""
    if geometry is None or geometry.IsEmpty():
        raise InputTableError(f"Edit {number} of '{path}' has no shape: draw it again, or delete it.")
    geometry = geometry.GetLinearGeometry()
    flat, wkb = ogr.GT_Flatten(geometry.GetGeometryType()), bytes(geometry.ExportToIsoWkb())
    if flat not in (*_LINES, *_AREAS):
        raise InputTableError(f"Edit {number} of '{path}' is neither a line nor a polygon: delete it.")
    if operation == "breakline" and flat not in _LINES:
        raise InputTableError(f"Edit {number} of '{path}' is a breakline and a polygon: draw a line.")
    if flat in _LINES and not (width and 0 < width <= MOST_WIDTH_M):
        raise InputTableError(
            f"Edit {number} of '{path}' is a line with the width {width or 0:g}: give its field 'width' in metres, "
            f"up to {MOST_WIDTH_M:g}."
        )
    if len(wkb) > 32 * _MOST_VERTICES:
        raise InputTableError(f"Edit {number} of '{path}' has more than {_MOST_VERTICES} vertices: simplify its shape.")
    return wkb


def write_edits(path: str, edits: Sequence[Edit], crs: str) -> str:
    """Write records as a GeoPackage, whole or not at all; raises WorkspaceError. ``crs`` is any text PROJ knows."""
    rows = (
        (
            ogr.CreateGeometryFromWkb(edit.geometry),
            (edit.number, edit.operation, edit.value, edit.width, int(edit.enabled), edit.made),
        )
        for edit in edits
    )
    return write_layer(path, crs, ogr.wkbUnknown, FIELDS, rows)
