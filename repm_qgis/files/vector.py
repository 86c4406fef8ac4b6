"""Vector layers, read and written with OGR."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Callable, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from osgeo import gdal, ogr, osr

from ..contracts.arrays import FloatArray
from ..contracts.errors import InputTableError, WorkspaceError
from ..contracts.findings import Finding
from ..contracts.formats import GEOPACKAGE, vector_format
from ..contracts.records import GroundShift
from ..runtime.progress import listed
from ..runtime.workspace import not_written, take_name, temporary_folder
from .untrusted import VECTORS, drivers_for, refusal_of

_MOST_POLYGONS = 100_000
_MARK = "Written by REPM"  # the description of layers of ours in GeoPackages
Features = Iterable[Tuple[Optional[ogr.Geometry], Sequence[object]]]
"""Geometries, None for a feature without, with their values, in the order of the fields; None leaves a field empty."""
_TYPES = {str: ogr.OFTString, int: ogr.OFTInteger, float: ogr.OFTReal}


def open_vector(path: str) -> Optional[gdal.Dataset]:
    """A file or database of layers; None where it cannot be opened, or is not to be (:func:`refusal_of`)."""
    if refusal_of(path):
        return None
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        return gdal.OpenEx(path, gdal.OF_VECTOR | gdal.OF_READONLY, allowed_drivers=drivers_for(path, VECTORS))
    except RuntimeError:
        return None
    finally:
        gdal.PopErrorHandler()


def file_and_layer(path: str) -> Tuple[str, str]:
    """The file and the layer ("": the first one) of a name in QGIS's form: ``points.gpkg|layername=gcps``.

    A "|" belongs to the file's own name where there is such a file.
    """
    parts = path.split("|")
    ends = [end for end in range(len(parts), 1, -1) if os.path.exists("|".join(parts[:end]))]
    count = ends[0] if ends else 1
    name = next((part[len("layername=") :] for part in parts[count:] if part.startswith("layername=")), "")
    return "|".join(parts[:count]), name


def open_layer(file: str, name: str = "") -> Tuple[Optional[gdal.Dataset], Optional[ogr.Layer]]:
    """A file and its layer of a name ("": the first one); None and None where the file holds no layers.

    The layer can be used as long as the file is kept. Raises InputTableError where no layer of the file has that name.
    """
    source = open_vector(file)
    if source is None or not source.GetLayerCount():
        return None, None
    layer = source.GetLayerByName(name) if name else source.GetLayer(0)
    if layer is None:
        raise InputTableError(f"'{file}' has no layer '{name}': choose an existing one.")
    return source, layer


def reference_of(layer: ogr.Layer) -> Optional[osr.SpatialReference]:
    """A layer's CRS, x before y; None where it states none: GeoPackages have "Undefined SRS"."""
    stated = layer.GetSpatialRef()
    if stated is None or str(stated.GetName()).startswith("Undefined"):
        return None
    own = stated.Clone()
    own.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    return own


def require_reference(layer: ogr.Layer, path: str) -> osr.SpatialReference:
    """As :func:`reference_of`; raises InputTableError, with the layer's file, where there is none on the Earth."""
    own = reference_of(layer)
    if own is None or own.IsLocal():
        raise InputTableError(
            f"The layer '{path}' has no coordinate reference system: assign it one first (Assign projection, in the "
            "processing toolbox)."
        )
    return own


def polygons_of(
    layer: ogr.Layer, path: str, option: str, target: osr.SpatialReference, warn: Callable[[Finding], None]
) -> Iterator[Tuple[ogr.Feature, ogr.Geometry]]:
    """The polygons of a layer of an option, flat and in another CRS, with their features; those that cross themselves
    are named. Raises InputTableError for a layer without a CRS or polygons, or with too many."""
    transformation = osr.CoordinateTransformation(require_reference(layer, path), target)
    if layer.GetFeatureCount() > _MOST_POLYGONS:
        raise InputTableError(
            f"'{path}' has {layer.GetFeatureCount()} polygons, and {option} takes {_MOST_POLYGONS}: dissolve them "
            "first."
        )
    count, crossed = 0, []
    for feature in layer:
        shape = feature.GetGeometryRef()
        if shape is None or ogr.GT_Flatten(shape.GetGeometryType()) not in (ogr.wkbPolygon, ogr.wkbMultiPolygon):
            continue
        shape, count = shape.Clone(), count + 1
        shape.FlattenTo2D()
        shape.Transform(transformation)
        crossed += [str(count)] if crosses_itself(shape) else []
        yield feature, shape
    if not count:
        raise InputTableError(f"The layer '{path}' has no polygons: {option} takes polygons.")
    name_crossed(path, crossed, warn)


def crosses_itself(shape: ogr.Geometry) -> bool:
    """Whether a polygon covers ground twice, or by turns to the left and the right: its area is then not what its
    outline shows. Outlines that only touch themselves are none such."""
    gdal.PushErrorHandler("CPLQuietErrorHandler")  # GEOS says where it crosses itself
    try:
        area = shape.GetArea()
        return not shape.IsValid() and abs(shape.Buffer(0.0).GetArea() - area) > 1e-6 * area
    finally:
        gdal.PopErrorHandler()


def name_crossed(path: str, numbers: Sequence[str], warn: Callable[[Finding], None]) -> None:
    """Name the polygons of a file with these numbers, if any, as ones that cross themselves."""
    if numbers:
        text = (
            f"Polygons of '{path}' cross themselves ({listed(numbers)}), and what they cover twice does not count: "
            "repair them (Fix geometries, in the processing toolbox)."
        )
        warn(Finding("polygons-crossed", text))


def strangers_in(path: str) -> List[str]:
    """The layers and rasters in a GeoPackage that replacing it would lose: those that this module has not written.
    Empty for other files, and where there is none."""
    names: List[str] = []
    if vector_format(path).driver != GEOPACKAGE or not os.path.isfile(path):
        return names
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        for kind in (gdal.OF_VECTOR, gdal.OF_RASTER):
            with suppress(RuntimeError):  # it has none of the kind, or is damaged
                source = gdal.OpenEx(path, kind | gdal.OF_READONLY, allowed_drivers=[GEOPACKAGE])
                if source is not None and kind == gdal.OF_VECTOR:
                    for index in range(source.GetLayerCount()):
                        layer = source.GetLayer(index)
                        names += [layer.GetName()] if layer.GetMetadataItem("DESCRIPTION") != _MARK else []
                    layer = None
                elif source is not None:
                    parts = [name.rsplit(":", 1)[-1] for name, _ in source.GetSubDatasets()]
                    names += parts or [source.GetMetadataItem("IDENTIFIER") or "a raster"]
                source = None
    finally:
        gdal.PopErrorHandler()
    return names


def read_points(path: str, fields: Sequence[str], most: int = 1 << 40) -> FloatArray:
    """(N, 2 + fields) x, y and numbers of the first layer's points that have them all, of at most ``most`` points.

    Empty where the file cannot be read, or its layer lacks a field.
    """
    source, values = open_vector(path), []
    if source is not None and source.GetLayerCount():
        layer = source.GetLayer(0)
        indices = [layer.GetLayerDefn().GetFieldIndex(name) for name in fields]
        for feature, _ in zip(layer if min(indices) >= 0 else (), range(most)):
            if all(feature.IsFieldSetAndNotNull(index) for index in indices):
                point = feature.GetGeometryRef()
                values.append((point.GetX(), point.GetY(), *map(feature.GetFieldAsDouble, indices)))
        feature = layer = source = None  # noqa: F841 - in this order, or OGR's objects outlive their file
    return np.array(values, dtype=np.float64).reshape(-1, 2 + len(fields))


def copy_layer(source: str, path: str, moved: Optional[GroundShift] = None) -> str:
    """Write the first layer of a file again under another name, in the format of that name's extension.

    ``moved`` is added to its points and to their field ``height``, in the layer's CRS. Raises WorkspaceError where the
    source cannot be read or the file cannot be written.
    """
    opened = open_vector(source)
    if opened is None or not opened.GetLayerCount():
        raise WorkspaceError(f"Cannot read the layer '{source}': remove it, and run again, which makes it again.")
    layer = opened.GetLayer(0)
    definition = layer.GetLayerDefn()
    fields = [definition.GetFieldDefn(index) for index in range(definition.GetFieldCount())]
    kinds = {each.GetName(): next(kind for kind, code in _TYPES.items() if code == each.GetType()) for each in fields}

    def rows() -> Features:
        for feature in layer:
            geometry = feature.GetGeometryRef().Clone()
            values = {name: feature.GetField(name) for name in kinds}
            if moved is not None:
                x, y = geometry.GetX(), geometry.GetY()
                geometry.SetPoint_2D(0, x + moved.moved[0], y + moved.moved[1])
                if values.get("height") is not None:
                    values["height"] += moved.up_at((x, y))
            yield geometry, list(values.values())

    write_layer(path, layer.GetSpatialRef().ExportToWkt(), layer.GetGeomType(), kinds, rows())
    layer = opened = None  # noqa: F841 - in this order, or OGR's objects outlive their file
    return path


def write_layer(path: str, crs: str, geometry_type: int, fields: Mapping[str, type], features: Features) -> str:
    """Write a vector layer in the format of the file's extension (GeoPackage where it has none we know).

    ``crs`` is any text PROJ understands, ``geometry_type`` ``ogr.wkbPolygon``, ``ogr.wkbPoint``, ...; ``fields`` has
    names and types (str, int, float), in order. Raises WorkspaceError where the file cannot be written, or holds other
    layers.
    """
    others = [name for name in strangers_in(path) if name != _layer_name(Path(path).stem)]
    if others:
        raise WorkspaceError(f"'{path}' holds '{others[0]}', which would be lost: choose another file.")
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        with temporary_folder(path) as folder:  # some formats are several files
            try:
                _fill(Path(folder) / Path(path).name, crs, geometry_type, fields, features)
            except RuntimeError as error:
                raise not_written(path, str(error), folder) from error
            for part in sorted(Path(folder).iterdir()):
                take_name(str(part), str(Path(path).with_name(part.name)))
    finally:
        gdal.PopErrorHandler()
    return path


def _fill(target: Path, crs: str, geometry_type: int, fields: Mapping[str, type], features: Features) -> None:
    name = vector_format(str(target)).driver
    driver, options = ogr.GetDriverByName(name), [f"DESCRIPTION={_MARK}"] if name == GEOPACKAGE else []
    source = driver.CreateDataSource(str(target))
    _see(source is not None)
    reference = osr.SpatialReference()
    reference.SetFromUserInput(crs)
    reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    layer = feature = None
    try:
        layer = source.CreateLayer(_layer_name(target.stem), reference, geometry_type, options)
        _see(layer is not None)
        for field, kind in fields.items():
            layer.CreateField(ogr.FieldDefn(field, _TYPES[kind]))
        layer.StartTransaction()
        count = 0
        for geometry, values in features:
            feature = ogr.Feature(layer.GetLayerDefn())
            if geometry is not None:
                feature.SetGeometry(geometry)
            for index, value in enumerate(values):
                if value is not None:
                    feature.SetField(index, value)
            _see(layer.CreateFeature(feature) == 0)
            feature, count = None, count + (geometry is not None)
        _see(layer.CommitTransaction() == 0)
        gdal.ErrorReset()
    finally:  # an exception keeps references to objects on its way, and Windows removes no open file
        layer = feature = source = None
    _see(gdal.GetLastErrorType() < gdal.CE_Failure and _features(str(target)) == count)


def _features(path: str) -> int:
    """How many features a file really holds: OGR does not report a full disk when it writes GeoJSON."""
    source = open_vector(path)
    layer = source.GetLayer(0) if source is not None and source.GetLayerCount() else ()
    count = sum(feature.GetGeometryRef() is not None for feature in layer)
    layer = source = None
    return count


def _layer_name(stem: str) -> str:
    """A file's name as its layer's: GeoPackage's tables may not begin with a sign, nor with words that it reserves."""
    return stem if re.match(r"(?!gpkg|sqlite_|rtree_)\w", stem, re.IGNORECASE) else f"_{stem}"


def _see(well: bool) -> None:
    if not well:
        raise RuntimeError(gdal.GetLastErrorMsg() or "no reason given")
