"""References: heights of known place from files of any kind, as what the solution of the shift needs."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import numpy as np

from ..contracts.arrays import Bounds
from ..contracts.file_kinds import is_cloud
from ..files.vector import file_and_layer, open_vector
from ..geometry.vertical import HeightDatum
from .clouds import read_cloud
from .found import FoundHeights
from .lasers import read_lasers
from .points import TEXTS, read_points_of_layer, read_points_of_table
from .rasters import read_raster
from .surfaces import Reference

__all__ = ["FoundHeights", "in_datum", "read_reference"]

_LASERS = (".h5", ".hdf5", ".he5")


def read_reference(
    path: str, crs: str, bounds: Bounds, least_m: float, check: Callable[[], None] = lambda: None
) -> FoundHeights:
    """The heights of a file within bounds of the scene's projected CRS.

    The file is a raster, a point cloud (.las, .laz), a table (.csv, .txt, .tsv) or layer of points, or an HDF5 file of
    ICESat-2 or GEDI (.h5). Rasters finer than ``least_m`` and clouds become means over cells of about that size.
    ``check`` is called between parts, and may raise to stop.

    Raises ImageError, InputTableError or MissingPackageError for what cannot be read, OverlapError where the file has
    no heights within the bounds.
    """
    file, layer = file_and_layer(path)
    suffix = Path(file).suffix.lower()
    if is_cloud(file):
        return read_cloud(file, crs, bounds, least_m, check)
    if suffix in _LASERS:
        return read_lasers(file, crs, bounds, check)
    if suffix in TEXTS:
        return read_points_of_table(file, crs, bounds, check)
    if layer or _has_layers(file):
        return read_points_of_layer(file, layer, crs, bounds, check)
    return read_raster(file, crs, bounds, least_m, check)


def in_datum(found: FoundHeights, crs: str, datum: HeightDatum) -> Reference:
    """The heights brought from a datum to the WGS 84 ellipsoid; ``crs`` is the CRS of their places.

    Where the file does not say what they are in, they are in the datum's unit.

    Raises MissingPackageError with the grid's name where PROJ lacks it.
    """
    remedy = "give a reference whose heights are above the ellipsoid"
    unit = 1.0 if found.places_in is None else datum.unit_m
    height = found.height * unit + datum.undulation(crs, found.xy, remedy)
    slopes = None if found.slopes is None else found.slopes * unit
    return Reference(found.name, np.column_stack([found.xy, height]), found.width_m, found.disc, slopes)


def _has_layers(path: str) -> bool:
    """Whether a file holds layers, and no raster: a GeoPackage may hold either."""
    source = open_vector(path)
    return source is not None and source.GetLayerCount() > 0
