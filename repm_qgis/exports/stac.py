"""A STAC item beside a DSM: the facts about it and its products that catalogues, and programs that read them, need.

The item is of STAC 1.0.0 with the extensions Projection, Raster and Processing, each 1.1.0. It names its files from
its own folder, so that all can be moved together. https://github.com/radiantearth/stac-spec
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from .. import __version__
from ..contracts.arrays import FloatArray
from ..contracts.checks import as_text
from ..contracts.errors import OptionError
from ..geometry.footprints import ring
from ..geometry.frames import flat_crs
from ..imagery.raster import opened
from ..runtime.workspace import write_text
from ..scene import Scene

_EXTENSIONS = tuple(
    f"https://stac-extensions.github.io/{name}/v1.1.0/schema.json" for name in ("projection", "raster", "processing")
)
_COG = "image/tiff; application=geotiff; profile=cloud-optimized"
_KINDS = {
    ".tif": _COG,
    ".tiff": _COG,
    ".laz": "application/vnd.laszip",
    ".las": "application/vnd.las",
    ".glb": "model/gltf-binary",
    ".html": "text/html",
}
_TYPES = {gdal.GDT_Byte: "uint8", gdal.GDT_UInt16: "uint16", gdal.GDT_Int16: "int16", gdal.GDT_Float32: "float32"}
_DIGITS = 9  # of degrees: a tenth of a millimetre


def require_times(scene: Scene) -> Tuple[str, str]:
    """When the first and the last image were taken; raises OptionError where no image states it, which an item must."""
    taken = scene.taken()
    if taken is None:
        reason = "needs the time of acquisition, which no image states: keep the vendor's metadata beside the images"
        raise OptionError("STAC", "", f"{reason}, or leave STAC empty")
    return taken


def write_item(path: str, scene: Scene, products: Mapping[str, Tuple[str, str]]) -> str:
    """Write the item of a DSM and what was made with it; returns ``path``.

    ``products`` are titles and files by the options that name them, "output" for the DSM; files that are not there are
    left out. Raises OptionError as :func:`require_times` does, ImageError, WorkspaceError.
    """
    first, last = require_times(scene)
    folder = os.path.dirname(os.path.abspath(path))
    with opened(products["output"][1]) as dataset:
        place = _place(dataset)
        outline = _outline(dataset)
    assets = {
        option: _asset(option, title, file, folder=folder, place=place)
        for option, (title, file) in products.items()
        if file and os.path.isfile(file)
    }
    satellites = sorted({view.sensor for view in scene.views if view.sensor})
    properties: Dict[str, object] = {
        "datetime": first if first == last else None,
        "start_datetime": first,
        "end_datetime": last,
        **({"platform": satellites[0].lower()} if len(satellites) == 1 else {}),
        "gsd": place.pop("gsd"),
        "processing:software": {"REPM": __version__},
        "processing:lineage": f"DSM of {len(scene.views)} satellite images: {', '.join(v.name for v in scene.views)}",
        **place,
    }
    item = {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": list(_EXTENSIONS),
        "id": Path(products["output"][1]).stem,
        "geometry": {"type": "Polygon", "coordinates": [[*outline.tolist(), outline[0].tolist()]]},
        "bbox": [*outline.min(axis=0).tolist(), *outline.max(axis=0).tolist()],
        "properties": properties,
        "links": [],
        "assets": assets,
    }
    return write_text(path, json.dumps(item, indent=1, allow_nan=False) + "\n")


def _place(dataset: gdal.Dataset) -> Dict[str, object]:
    """The fields of the Projection extension of a raster, and its cells' side, m."""
    x, cell, _, y, _, down = dataset.GetGeoTransform()
    columns, rows = dataset.RasterXSize, dataset.RasterYSize
    crs = pyproj.CRS.from_wkt(as_text(dataset.GetProjection()))
    return {
        "gsd": abs(cell),
        "proj:epsg": flat_crs(crs).to_epsg(),
        "proj:wkt2": crs.to_wkt("WKT2_2019"),
        "proj:shape": [rows, columns],
        "proj:transform": [cell, 0.0, x, 0.0, down, y],
        "proj:bbox": [x, y + rows * down, x + columns * cell, y],
    }


def _outline(dataset: gdal.Dataset) -> FloatArray:
    """(N, 2) longitudes and latitudes around a raster, against the clock."""
    x, cell, _, y, _, down = dataset.GetGeoTransform()
    columns, rows = (np.linspace(0, side, 5) for side in (dataset.RasterXSize, dataset.RasterYSize))
    around = ring(x + cell * columns, y + down * rows[::-1])
    crs = flat_crs(pyproj.CRS.from_wkt(as_text(dataset.GetProjection())))
    lon_lat = np.column_stack(pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(*around.T))
    rounded: FloatArray = np.round(lon_lat, _DIGITS)
    return rounded


def _asset(option: str, title: str, file: str, *, folder: str, place: Dict[str, object]) -> Dict[str, object]:
    """A file with its bands, and its own fields of the item's ``place`` where its cells are others."""
    kind = _KINDS.get(Path(file).suffix.lower())
    asset: Dict[str, object] = {
        "href": f"./{Path(os.path.relpath(os.path.abspath(file), folder)).as_posix()}",
        "title": title,
        "roles": ["overview" if option in ("viewer", "report") else "visual" if option == "ortho" else "data"],
    }
    if kind:
        asset["type"] = kind
    if kind == _COG:
        with opened(file) as dataset:
            asset["raster:bands"] = _bands(dataset)
            own = _place(dataset)
        cells = ("proj:shape", "proj:transform", "proj:bbox")
        asset.update({name: own[name] for name in cells if own[name] != place[name]})
    return asset


def _bands(dataset: gdal.Dataset) -> List[Dict[str, object]]:
    """The Raster extension's facts of each band."""
    found = []
    for number in range(1, dataset.RasterCount + 1):
        band = dataset.GetRasterBand(number)
        facts: Dict[str, object] = {
            "data_type": _TYPES.get(band.DataType, "other"),
            "spatial_resolution": abs(float(dataset.GetGeoTransform()[1])),
        }
        nodata = band.GetNoDataValue()
        if nodata is not None:
            facts["nodata"] = nodata
        if band.GetUnitType():
            facts["unit"] = as_text(band.GetUnitType())
        statistics = _statistics(band)
        if statistics:
            facts["statistics"] = statistics
        found.append(facts)
    return found


def _statistics(band: gdal.Band) -> Optional[Dict[str, float]]:
    """What the file itself states; None where it does not."""
    names: Sequence[Tuple[str, str]] = (
        ("minimum", "MINIMUM"),
        ("maximum", "MAXIMUM"),
        ("mean", "MEAN"),
        ("stddev", "STDDEV"),
    )
    items = {name: band.GetMetadataItem(f"STATISTICS_{theirs}") for name, theirs in names}
    return {name: float(text) for name, text in items.items()} if all(items.values()) else None
