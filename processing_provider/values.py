"""Processing's parameter values as the engine's options: plain strings, numbers and lists."""

from __future__ import annotations

import os
import shlex
import subprocess  # nosec B404 # for its quoting alone
from typing import Optional, Union

from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsMapLayer,
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingOutputLayerDefinition,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterNumber,
    QgsProcessingUtils,
    QgsProperty,
    QgsProviderRegistry,
    QgsVectorFileWriter,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QUrl, QUrlQuery, QVariant

from ..repm_qgis.contracts.documents import JsonMapping, JsonObject
from ..repm_qgis.contracts.formats import is_layer
from .language import said


def is_empty(value: object) -> bool:
    """Whether a parameter's value means "not given"."""
    return value is None or value == "" or value == [] or (isinstance(value, QVariant) and value.isNull())


def layer_path(layer: QgsMapLayer) -> str:
    """The file behind a layer: what its provider decodes, or the source where that is no file (subdatasets)."""
    path = QgsProviderRegistry.instance().decodeUri(layer.providerType(), layer.source()).get("path", "")
    subdataset = ":" in layer.source().split(path, 1)[0] if path else True
    return layer.source() if subdataset else path


def raster_items(value: object, context: QgsProcessingContext) -> list[Union[QgsMapLayer, str]]:
    """A raster parameter's value as a list of QgsMapLayer, and str for files that are no layer of the project."""
    if isinstance(value, QgsProperty):
        value = value.valueAsString(context.expressionContext())[0]
    if is_empty(value):
        return []
    if isinstance(value, (list, tuple)):
        return [item for element in value for item in raster_items(element, context)]
    if isinstance(value, QgsMapLayer):
        return [value]
    text = str(value)
    # A file is the engine's to open: loading it as a layer here would cost time, and lose the name of a damaged one.
    if not os.path.exists(text):
        layer = QgsProcessingUtils.mapLayerFromString(text, context, allowLoadingNewLayers=False)
        if layer is not None:
            return [layer]
    return [text]


def raster_paths(value: object, context: QgsProcessingContext) -> list[str]:
    """Absolute paths of the rasters that a parameter's value names."""
    found = (layer_path(item) if isinstance(item, QgsMapLayer) else item for item in raster_items(value, context))
    return [os.path.abspath(path) if os.path.exists(path) else path for path in found]


def file_paths(value: object, context: QgsProcessingContext) -> list[str]:
    """Absolute paths of a list of files, in its order; "" stays where one is left out between others."""
    if isinstance(value, QgsProperty):
        value = value.valueAsString(context.expressionContext())[0]
    values = value if isinstance(value, (list, tuple)) else [value]
    paths = ["" if is_empty(item) else os.path.abspath(str(item)) for item in values]
    return paths if any(paths) else []


def points_path(value: object, context: QgsProcessingContext) -> Optional[str]:
    """The file of a point layer or table (``file|layername=name`` where the layer is one of several).

    A layer that is no file, or of which a filter shows a part, is written to a temporary one.
    """
    from ..repm_qgis.files.vector import file_and_layer

    item = next(iter(raster_items(value, context)), None)
    if item is None:
        return None
    if not isinstance(item, QgsVectorLayer):
        path, name = file_and_layer(str(item))
        return f"{os.path.abspath(path)}|layername={name}" if name else os.path.abspath(path)
    parts = QgsProviderRegistry.instance().decodeUri(item.providerType(), item.source())
    path, name = parts.get("path", ""), parts.get("layerName")
    plain = (
        _is_plain_table(item.source(), path) if item.providerType() == "delimitedtext" else item.providerType() == "ogr"
    )
    if plain and os.path.exists(path) and not item.subsetString():
        return f"{path}|layername={name}" if name else path
    return _written(item, context)


def _is_plain_table(source: str, path: str) -> bool:
    """Whether a text layer is read as the engine reads a table: commas, names in the first line, place in fields."""
    keys = {key for key, _ in QUrlQuery(QUrl(source)).queryItems()}
    return path.lower().endswith(".csv") and keys <= {"type", "detectTypes", "watchFile", "spatialIndex", "subsetIndex"}


def _written(layer: QgsVectorLayer, context: QgsProcessingContext) -> str:
    """A copy of a layer in a temporary GeoPackage; raises QgsProcessingException where that fails."""
    path = QgsProcessingUtils.generateTempFilename("points.gpkg")
    options = QgsVectorFileWriter.SaveVectorOptions()
    options.driverName = "GPKG"
    options.layerOptions = ["FID=repm_fid"]  # the table may have a field of that name
    error, text, *_ = QgsVectorFileWriter.writeAsVectorFormatV3(layer, path, context.transformContext(), options)
    if error != QgsVectorFileWriter.WriterError.NoError:
        reason = f"The layer '{layer.name()}' cannot be read ({text}): save it as a GeoPackage, and choose that."
        raise QgsProcessingException(said(reason))
    return path


def any_paths(value: object, context: QgsProcessingContext, only_named: bool = False) -> list[str]:
    """The files of rasters, point layers, tables and clouds; with ``only_named`` no layer is written for that."""
    paths = []
    for item in raster_items(value, context):
        if isinstance(item, QgsMapLayer) and not isinstance(item, QgsVectorLayer):
            paths.append(layer_path(item))
        elif only_named:
            paths.append(item.source() if isinstance(item, QgsMapLayer) else item)
        else:
            paths.append(points_path(item, context) or "")
    return paths


def _paths(
    definition: QgsProcessingParameterDefinition, given: object, context: QgsProcessingContext, only_named: bool = False
) -> list[str]:
    """The paths that a parameter of several layers or files names."""
    kind, kinds = definition.layerType(), QgsProcessing.SourceType
    if kind == kinds.TypeRaster:
        return raster_paths(given, context)
    return any_paths(given, context, only_named) if kind == kinds.TypeMapLayer else file_paths(given, context)


def crs_text(crs: QgsCoordinateReferenceSystem) -> Optional[str]:
    """The authority's code where there is one, else WKT 2; None for no CRS."""
    if not crs.isValid():
        return None
    return crs.authid() or crs.toWkt(QgsCoordinateReferenceSystem.WktVariant.WKT_PREFERRED)


def _extent(
    algorithm: QgsProcessingAlgorithm, name: str, parameters: JsonMapping, context: QgsProcessingContext
) -> JsonObject:
    if is_empty(parameters.get(name)):
        return {name.lower(): None}
    box = algorithm.parameterAsExtent(parameters, name, context)
    crs = crs_text(algorithm.parameterAsExtentCrs(parameters, name, context)) or "EPSG:4326"
    corners = [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()]
    return {name.lower(): corners, f"{name.lower()}_crs": crs}


def input_options(
    algorithm: QgsProcessingAlgorithm,
    definition: QgsProcessingParameterDefinition,
    parameters: JsonMapping,
    context: QgsProcessingContext,
) -> JsonObject:
    """One input parameter as engine options: the parameter's name in lower case, and its value.

    Reads the project through the context: main thread only.
    """
    name, kind = definition.name(), definition.type()
    given = parameters.get(name, definition.defaultValue())
    if kind == "extent":
        return _extent(algorithm, name, parameters, context)
    if kind == "multilayer":
        value: object = _paths(definition, given, context)
    elif kind == "layer":
        value = next(iter(any_paths(given, context)), None)
    elif kind == "raster":
        value = next(iter(raster_paths(given, context)), None)
    elif kind == "vector":
        value = points_path(given, context)
    elif kind == "crs":
        value = crs_text(algorithm.parameterAsCrs(parameters, name, context))
    elif kind == "number":
        whole = definition.dataType() == QgsProcessingParameterNumber.Type.Integer
        read = algorithm.parameterAsInt if whole else algorithm.parameterAsDouble
        value = definition.defaultValue() if is_empty(given) else read(parameters, name, context)
    elif kind == "boolean":
        value = algorithm.parameterAsBool(parameters, name, context)
    elif kind == "enum" and definition.allowMultiple():
        value = _words(algorithm, definition, given, parameters, context)
    elif kind == "enum":
        value = algorithm.parameterAsEnumString(parameters, name, context)
    elif kind == "file":
        text = algorithm.parameterAsString(parameters, name, context)
        value = os.path.abspath(text) if text else None
    else:
        value = algorithm.parameterAsString(parameters, name, context)
    return {name.lower(): value}


def checked_value(
    algorithm: QgsProcessingAlgorithm,
    definition: QgsProcessingParameterDefinition,
    parameters: JsonMapping,
    context: QgsProcessingContext,
) -> object:
    """One parameter as the engine's checks take it: nothing is read or written, and a layer only counts as given."""
    name, kind = definition.name(), definition.type()
    given = parameters.get(name, definition.defaultValue())
    if kind == "boolean":
        return algorithm.parameterAsBool(parameters, name, context)
    if kind == "multilayer":
        return _paths(definition, given, context, only_named=True)
    if kind == "number":
        # A model passes None on for a number that its command leaves out.
        return definition.defaultValue() if is_empty(given) else _number(algorithm, definition, parameters, context)
    if kind == "enum" and definition.allowMultiple():
        return _words(algorithm, definition, given, parameters, context)
    if kind in ("enum", "string"):
        return given if isinstance(given, str) else algorithm.parameterAsString(parameters, name, context)
    if kind in ("extent", "crs"):
        return None
    if isinstance(given, QgsProcessingOutputLayerDefinition):
        given = given.sink.staticValue()
    if definition.isDestination() and (not isinstance(given, str) or given == QgsProcessing.TEMPORARY_OUTPUT):
        if definition.flags() & QgsProcessingParameterDefinition.Flag.FlagOptional:
            return None
        # As QGIS will name it: some stages write only what has the right extension.
        return "-" if definition.type() == "folderDestination" else f"-.{definition.defaultFileExtension()}"
    return None if is_empty(given) else str(given)


def _words(
    algorithm: QgsProcessingAlgorithm,
    definition: QgsProcessingParameterDefinition,
    given: object,
    parameters: JsonMapping,
    context: QgsProcessingContext,
) -> list[str]:
    """The words of a choice of several; the engine refuses those that it does not know."""
    if isinstance(given, str):
        return [word.strip() for word in given.split(",") if word.strip()]
    return [] if is_empty(given) else list(algorithm.parameterAsEnumStrings(parameters, definition.name(), context))


def _number(
    algorithm: QgsProcessingAlgorithm,
    definition: QgsProcessingParameterDefinition,
    parameters: JsonMapping,
    context: QgsProcessingContext,
) -> object:
    """A number; other values stay as they are, for the engine to refuse."""
    given = parameters.get(definition.name(), definition.defaultValue())
    if isinstance(given, QgsProperty):
        given = algorithm.parameterAsDouble(parameters, definition.name(), context)
    try:
        number = float(given)
    except (TypeError, ValueError):
        return given
    whole = definition.dataType() == QgsProcessingParameterNumber.Type.Integer
    return int(number) if whole and number.is_integer() else given if whole else number


def destination(
    algorithm: QgsProcessingAlgorithm,
    definition: QgsProcessingParameterDefinition,
    parameters: JsonMapping,
    context: QgsProcessingContext,
) -> str:
    """Where an output goes, as QGIS keeps it; "" for an output that is not wanted."""
    if definition.type() in ("rasterDestination", "vectorDestination"):
        return algorithm.parameterAsOutputLayer(parameters, definition.name(), context) or ""
    return algorithm.parameterAsFileOutput(parameters, definition.name(), context) or ""


def absolute(path: str) -> str:
    """A destination's absolute path; that of a layer in a database or another file stays, for the engine to refuse."""
    return path if is_layer(path) else os.path.abspath(path)


def command_line(algorithm_id: str, options: JsonMapping) -> str:
    """The ``qgis_process`` command that repeats a run with these engine options, as this system's shell reads it."""
    words = []
    for name, value in options.items():
        if is_empty(value) or name in ("extent_crs", "workers", "memory", "command"):
            continue
        if name == "extent" and not isinstance(value, str):
            xmin, ymin, xmax, ymax = value
            value = f"{xmin!r},{xmax!r},{ymin!r},{ymax!r} [{options.get('extent_crs', 'EPSG:4326')}]"
        values = value if isinstance(value, (list, tuple)) else [value]
        words += [f"{name.upper()}={item}" for item in values]
    command = ["qgis_process", "run", algorithm_id, "--", *words]
    return subprocess.list2cmdline(command) if os.name == "nt" else shlex.join(command)
