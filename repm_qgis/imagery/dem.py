"""Heights from an elevation model that the user gives."""

from __future__ import annotations

from typing import Tuple

import numpy as np
import pyproj
from osgeo import gdal

from ..errors import ImageError, OverlapError
from ..geometry.frames import geodetic_from_projected
from .raster import opened, read

_MOST_CELLS = 512


def dem_range(path: str, crs: str, bounds: Tuple[float, float, float, float]) -> Tuple[float, float, bool]:
    """Lowest and highest height of a DEM within ``bounds`` (xmin, ymin, xmax, ymax in ``crs``).

    Returns the range in metres above the WGS 84 ellipsoid, and whether the DEM says what its heights refer to: a
    vertical CRS is transformed to the ellipsoid with PROJ, a DEM without one is taken as ellipsoidal.

    Raises ImageError where it cannot be read, OverlapError where it does not cover the bounds.
    """
    u, v = np.linspace(bounds[0], bounds[2], 5), np.linspace(bounds[1], bounds[3], 5)
    lon_lat = geodetic_from_projected(crs, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    with opened(path) as dataset:
        if not dataset.GetProjection():
            raise ImageError(f"The DEM '{path}' has no coordinate reference system: assign it one first.")
        dem_crs = pyproj.CRS.from_wkt(dataset.GetProjection())
        flat = pyproj.Transformer.from_crs("EPSG:4326", dem_crs.to_2d(), always_xy=True)
        x, y = flat.transform(lon_lat[:, 0], lon_lat[:, 1])
        heights = _window_values(dataset, path, np.column_stack([x, y]))
    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    vertical = any(part.is_vertical for part in dem_crs.sub_crs_list) or len(dem_crs.axis_info) == 3
    if vertical:
        # The undulation changes by decimetres over a scene: the centre's is enough for a range.
        shift = pyproj.Transformer.from_crs(dem_crs, "EPSG:4979", always_xy=True, allow_ballpark=False)
        zero = shift.transform(float(x.mean()), float(y.mean()), low)[2] - low
        low, high = low + zero, high + zero
    return low, high, vertical


def _window_values(dataset: gdal.Dataset, path: str, points: np.ndarray) -> np.ndarray:
    """The DEM's cells within the bounding box of points (in its CRS), decimated."""
    inverse = gdal.InvGeoTransform(dataset.GetGeoTransform())
    cells = np.array([gdal.ApplyGeoTransform(inverse, float(x), float(y)) for x, y in points
                      if np.isfinite(x) and np.isfinite(y)])
    if not len(cells):
        raise OverlapError(f"The DEM '{path}' does not cover the scene: give one that does, or leave DEM empty.")
    low = np.maximum(np.floor(cells.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(cells.max(axis=0)).astype(int) + 1, (dataset.RasterXSize, dataset.RasterYSize))
    if (high <= low).any():
        raise OverlapError(f"The DEM '{path}' does not cover the scene: give one that does, or leave DEM empty.")
    width, height = (high - low).tolist()
    values = read(dataset, (int(low[0]), int(low[1]), width, height), 1,
                  (min(width, _MOST_CELLS), min(height, _MOST_CELLS)))
    if not np.isfinite(values).any():
        raise OverlapError(f"The DEM '{path}' has only nodata over the scene: give another one, or leave DEM empty.")
    return values
