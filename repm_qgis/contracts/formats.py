"""The formats of products, which the extensions of their names choose: the one table that dialogs, checks and writers
read. Rasters are made as GeoTIFF and brought into another format when they are complete."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

from .errors import OptionError
from .options import Options
from .products import FILE, POINTS, POLYGONS, RASTER, Product, paths_of


@dataclass(frozen=True)
class Format:
    """How GDAL calls a format, the endings of what it writes beside the file (in place of its extension, or after the
    whole name where they begin with that), whether it holds one band only, and options of its writer."""

    driver: str
    beside: Tuple[str, ...] = ()
    one_band: bool = False
    options: Tuple[str, ...] = ()


# Only formats that keep cells, place, nodata and the vertical datum: GDAL's netCDF loses the last, DXF all fields.
GEOTIFF, GEOPACKAGE = "GTiff", "GPKG"
RASTERS: Dict[str, Format] = {
    ".tif": Format(GEOTIFF),
    ".tiff": Format(GEOTIFF),
    ".img": Format("HFA", (".ige",), options=("COMPRESSED=YES",)),
    ".asc": Format("AAIGrid", (".prj",), one_band=True, options=("DECIMAL_PRECISION=4",)),
}
VECTORS: Dict[str, Format] = {
    ".gpkg": Format(GEOPACKAGE),
    ".geojson": Format("GeoJSON"),
    ".json": Format("GeoJSON"),
    ".shp": Format("ESRI Shapefile", (".shx", ".dbf", ".prj", ".cpg")),
    ".fgb": Format("FlatGeobuf"),
}
_ALSO = {".html": ".htm"}  # endings that the filters of dialogs do not list
_LAYER = re.compile(r"\w{2,}:")  # a provider and its connection; one letter is a drive


def raster_format(path: str) -> Format:
    """The format of a raster by its name: GeoTIFF where the name has none that we know, as files of our own may."""
    return RASTERS.get(_ending(path), RASTERS[".tif"])


def vector_format(path: str) -> Format:
    """The format of a vector layer by its name: GeoPackage where the name has none that we know."""
    return VECTORS.get(_ending(path), VECTORS[".gpkg"])


def require_formats(stage: str, options: Options) -> None:
    """Raise OptionError for a product whose name is that of a format which is not written, or of a layer in a database
    or in another file."""
    for product, path in paths_of(stage, options):
        if product.form in (RASTER, POINTS, POLYGONS, FILE):
            problem = _problem(product, path)
            if problem:
                raise OptionError(product.option.upper(), path, problem)


def extension_of(product: Product) -> str:
    """The usual extension of a product's name, "" for a folder."""
    return _endings(product)[0] if product.form in (RASTER, POINTS, POLYGONS, FILE) else ""


def companions(product: Product, path: str) -> List[str]:
    """All files that belong to a product beside its own: its style, what GDAL keeps of it, parts of its format."""
    ends, more = [".qml"], [".aux.xml"]
    if product.form == RASTER:
        ends += raster_format(path).beside
    elif product.form in (POINTS, POLYGONS):
        ends += vector_format(path).beside
    elif _ending(path) == ".obj":
        more += [".jpg", ".mtl"]
    stem = os.path.splitext(path)[0]
    return [*(stem + end for end in ends), *(path + end for end in more)]


def is_layer(path: str) -> bool:
    """Whether a name is that of a layer in a database or in another file, as QGIS writes it: ``ogr:dbname=...``."""
    return bool(_LAYER.match(path))


def _problem(product: Product, path: str) -> str:
    """What is wrong with a product's name, as the end of a sentence; "" where nothing is."""
    if is_layer(path):
        reason = "must be a file of its own, as nothing is added to a database or to another file"
        return f"{reason}: give a name that ends with {_listed(_endings(product))}"
    ending, known = _ending(path), _endings(product)
    if not ending:  # the format is the usual one
        return ""
    if ending not in known and ending not in (_ALSO.get(each) for each in known):
        return f"must end with {_listed(known)}, which says in what format it is written"
    if product.form == RASTER and product.several and raster_format(path).one_band:
        several = [each for each in known if each == ".vrt" or not RASTERS[each].one_band]
        return f"must end with {_listed(several)}: it has several bands, which {ending} does not hold"
    return ""


def _endings(product: Product) -> List[str]:
    """The extensions that a product may have."""
    if product.form == FILE:
        return re.findall(r"\*(\.\w+)", product.filter)
    if product.form == RASTER:
        return [*RASTERS, *([".vrt"] if product.tiled else [])]
    return list(VECTORS)


def _listed(endings: Sequence[str]) -> str:
    *first, last = endings
    return f"{', '.join(first)} or {last}" if first else last


def _ending(path: str) -> str:
    return os.path.splitext(path)[1].lower()
