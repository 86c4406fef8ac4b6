"""Point and polygon layers, written with OGR."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Iterable, Mapping, Sequence, Tuple

from osgeo import gdal, ogr, osr

from .errors import WorkspaceError
from .workspace import temporary_name

_DRIVERS = {".gpkg": "GPKG", ".geojson": "GeoJSON", ".json": "GeoJSON", ".shp": "ESRI Shapefile", ".fgb": "FlatGeobuf"}
_TYPES = {str: ogr.OFTString, int: ogr.OFTInteger, float: ogr.OFTReal}


def write_layer(path: str, crs: str, geometry_type: int, fields: Mapping[str, type],
                features: Iterable[Tuple[ogr.Geometry, Sequence[Any]]]) -> str:
    """Write a vector layer in the format of the file's extension (GeoPackage where it has none we know).

    Parameters
    ----------
    crs : any text PROJ understands.
    geometry_type : ``ogr.wkbPolygon``, ``ogr.wkbPoint``, ...
    fields : names and types (str, int, float), in order.
    features : geometries with their values, in the order of the fields; None leaves a field empty.

    Raises WorkspaceError where the file cannot be written.
    """
    driver = ogr.GetDriverByName(_DRIVERS.get(Path(path).suffix.lower(), "GPKG"))
    in_place = driver.GetName() == "ESRI Shapefile"  # several files: they cannot be renamed as one
    target = path if in_place else temporary_name(path)
    for stale in (path, target):
        if os.path.exists(stale):
            os.unlink(stale)
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        _fill(driver, target, crs, geometry_type, fields, features, Path(path).stem)
    except RuntimeError as error:
        raise WorkspaceError(f"Cannot write '{path}' ({error}): choose another place.") from error
    finally:
        gdal.PopErrorHandler()
    if not in_place:
        os.replace(target, path)
    return path


def _fill(driver: ogr.Driver, target: str, crs: str, geometry_type: int, fields: Mapping[str, type],
          features: Iterable[Tuple[ogr.Geometry, Sequence[Any]]], name: str) -> None:
    source = driver.CreateDataSource(target)
    if source is None:
        raise RuntimeError(gdal.GetLastErrorMsg() or "no reason given")
    reference = osr.SpatialReference()
    reference.SetFromUserInput(crs)
    reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    layer = source.CreateLayer(name, reference, geometry_type)
    for field, kind in fields.items():
        layer.CreateField(ogr.FieldDefn(field, _TYPES[kind]))
    layer.StartTransaction()
    for geometry, values in features:
        feature = ogr.Feature(layer.GetLayerDefn())
        feature.SetGeometry(geometry)
        for index, value in enumerate(values):
            if value is not None:
                feature.SetField(index, value)
        layer.CreateFeature(feature)
        feature = None
    layer.CommitTransaction()
    layer = source = None
