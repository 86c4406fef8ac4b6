"""Heights from the user's elevation model: their range, and a coarse surface for the refinement."""

from __future__ import annotations

from functools import lru_cache
from typing import Optional, Sequence, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from ..contracts.arrays import Bounds, FloatArray, FloatImage, Window
from ..contracts.checks import as_text
from ..contracts.errors import ImageError, OverlapError
from ..geometry.frames import flat_crs, geodetic_from_projected, on_earth, vertical_part
from ..geometry.interpolation import on_lattice
from ..geometry.surface import Surface
from ..runtime.workspace import file_identity
from .heights import read_heights, to_metres, void_share
from .parameters import DEM
from .raster import NODATA, opened, quiet, read, write


def dem_range(path: str, crs: str, bounds: Sequence[float]) -> Tuple[float, float, bool]:
    """Lowest and highest height of a DEM within ``bounds`` (xmin, ymin, xmax, ymax in ``crs``).

    Returns the range in metres above the WGS 84 ellipsoid, and whether the DEM states its vertical datum: heights of a
    vertical CRS are transformed to the ellipsoid with PROJ, a DEM without one is taken as ellipsoidal.

    Raises ImageError where it cannot be read, OverlapError where it does not cover the bounds.
    """
    u, v = np.linspace(bounds[0], bounds[2], 5), np.linspace(bounds[1], bounds[3], 5)
    lon_lat = geodetic_from_projected(crs, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    with opened(path) as dataset:
        dem_crs = _crs_of(dataset, path)
        flat = pyproj.Transformer.from_crs("EPSG:4326", flat_crs(dem_crs), always_xy=True)
        x, y = flat.transform(lon_lat[:, 0], lon_lat[:, 1])
        heights = _window_values(dataset, path, np.column_stack([x, y]), DEM.range_cells)
    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    vertical = vertical_part(dem_crs) is not None
    if vertical:
        # The undulation changes by decimetres over a scene: that of the centre is enough for a range.
        zero = float(_to_ellipsoid(dem_crs, path, x.mean(keepdims=True), y.mean(keepdims=True))[0])
        low, high = low + zero, high + zero
    return low, high, vertical


def _crs_of(dataset: gdal.Dataset, path: str) -> pyproj.CRS:
    if not dataset.GetProjection():
        raise ImageError(f"The DEM '{path}' has no coordinate reference system: assign it one first.")
    return on_earth(pyproj.CRS.from_wkt(as_text(dataset.GetProjection())), path)


def _to_ellipsoid(crs: pyproj.CRS, path: str, x: FloatArray, y: FloatArray) -> FloatArray:
    """(N,) metres to add to a DEM's heights at positions in its CRS; raises ImageError where PROJ lacks the grid."""
    try:
        shift = pyproj.Transformer.from_crs(crs, "EPSG:4979", always_xy=True, allow_ballpark=False)
        result = np.asarray(shift.transform(x, y, np.zeros_like(x))[2])
    except pyproj.exceptions.ProjError as error:
        result, reason = np.array([np.inf]), str(error)
    else:
        reason = "its grid is not installed"
    if not np.isfinite(result).all():
        raise ImageError(
            f"PROJ cannot convert the heights of the DEM '{path}' ({crs.name}) to the ellipsoid: {reason}: "
            "'Report the environment' says where PROJ's grids belong; or give an ellipsoidal DEM."
        )
    return result


def make_surface(path: str, bounds: Bounds, cell_m: float, target: str) -> str:
    """A coarse surface from a DEM, written as a GeoTIFF in longitude, latitude and ellipsoidal heights.

    ``bounds`` are west, south, east, north in degrees; cells are averages over about ``cell_m``; gaps are filled
    from their border. Raises ImageError or OverlapError as :func:`dem_range` does. Returns ``target``.
    """
    heights, transform = _coarse(path, bounds, cell_m)
    wkt, names = pyproj.CRS("EPSG:4326").to_wkt(), ("height above the WGS 84 ellipsoid (m)",)
    return write(target, [heights.astype(np.float32)], transform, wkt, descriptions=names, unit="m")


def surface_of(path: str, bounds: Bounds, cell_m: float) -> Surface:
    """The surface of :func:`make_surface`, without a file."""
    heights, transform = _coarse(path, bounds, cell_m)
    return _on(heights, transform)


def _coarse(path: str, bounds: Bounds, cell_m: float) -> Tuple[FloatArray, Sequence[float]]:
    """The heights of :func:`make_surface` and their geotransform."""
    extents = (bounds[2] - bounds[0], bounds[3] - bounds[1])
    step = max(cell_m / 111000.0, *(extent / DEM.surface_cells for extent in extents))
    width, height = (max(2, int(np.ceil(extent / step))) for extent in extents)
    with opened(path) as dataset:
        crs = _crs_of(dataset, path)
        source, (factor, added) = _without_voids(dataset, crs, bounds)
        with quiet():
            # Two-dimensional, so that GDAL does not shift the heights by itself.
            systems = {"srcSRS": flat_crs(crs).to_wkt(), "dstSRS": "EPSG:4326"}
            grid = {"outputBounds": bounds, "width": width, "height": height, "resampleAlg": "average"}
            kind = {"format": "MEM", "dstNodata": NODATA, "outputType": gdal.GDT_Float32}
            warped = gdal.Warp("", source, **systems, **grid, **kind)
        if warped is None or not np.isfinite(read(warped)).any():
            raise OverlapError(f"The DEM '{path}' does not cover the scene: give one that does.")
        with quiet():
            gdal.FillNodata(warped.GetRasterBand(1), None, float(max(width, height)), 2)
        heights = read(warped).astype(np.float64) * factor + added
        transform = warped.GetGeoTransform()
        warped = None
    heights = np.where(np.isfinite(heights), heights, np.nanmean(heights))
    if vertical_part(crs):
        heights += _undulation(crs, path, bounds, (height, width))
    return heights, transform


def _without_voids(dataset: gdal.Dataset, crs: pyproj.CRS, bounds: Bounds) -> Tuple[gdal.Dataset, Tuple[float, float]]:
    """A DEM that GDAL may average within ``bounds`` (degrees), and what makes its numbers metres: itself, or its
    heights there in memory where it has voids that no nodata value declares."""
    to_dem = pyproj.Transformer.from_crs("EPSG:4326", flat_crs(crs), always_xy=True)
    u, v = np.meshgrid(np.linspace(bounds[0], bounds[2], 9), np.linspace(bounds[1], bounds[3], 9))
    window = _window(dataset, np.column_stack([np.ravel(each) for each in to_dem.transform(u, v)]))
    if window is None or not void_share(dataset, window):
        return dataset, to_metres(dataset)
    most = 2 * DEM.surface_cells
    heights = read_heights(dataset, window, 1, (min(window.width, most), min(window.height, most)))
    rows, columns = heights.shape
    clean = gdal.GetDriverByName("MEM").Create("", columns, rows, 1, gdal.GDT_Float32)
    x, width, turn, y, tilt, height = dataset.GetGeoTransform()
    x, y = x + window.col * width + window.row * turn, y + window.col * tilt + window.row * height
    east, south = window.width / columns, window.height / rows
    clean.SetGeoTransform((x, width * east, turn * south, y, tilt * east, height * south))
    clean.GetRasterBand(1).SetNoDataValue(NODATA)
    clean.GetRasterBand(1).WriteArray(np.where(np.isfinite(heights), heights, np.float32(NODATA)))
    return clean, (1.0, 0.0)


def _undulation(crs: pyproj.CRS, path: str, bounds: Bounds, shape: Tuple[int, int]) -> FloatArray:
    """The metres to add to a DEM's heights; geoids are smooth."""
    transformer = pyproj.Transformer.from_crs("EPSG:4326", flat_crs(crs), always_xy=True)

    def exact(lon_lat: FloatArray) -> FloatArray:
        x, y = transformer.transform(lon_lat[..., 0].ravel(), lon_lat[..., 1].ravel())
        return _to_ellipsoid(crs, path, np.asarray(x), np.asarray(y)).reshape(lon_lat.shape[:2])

    west, south, east, north = bounds
    return on_lattice(np.linspace(west, east, shape[1]), np.linspace(north, south, shape[0]), exact)


def load_surface(path: str) -> Surface:
    """A surface from :func:`make_surface`, read once a process."""
    return _surface(path, *file_identity(path)[1:])


@lru_cache(maxsize=4)
def _surface(path: str, *_: object) -> Surface:
    with opened(path) as dataset:
        return _on(read(dataset).astype(np.float64), dataset.GetGeoTransform())


def _on(heights: FloatArray, transform: Sequence[float]) -> Surface:
    west, step_lon, _, north, _, step_lat = transform
    return Surface(west + step_lon / 2, north + step_lat / 2, step_lon, -step_lat, heights)


def _window(dataset: gdal.Dataset, points: FloatArray) -> Optional[Window]:
    """The DEM's cells within the bounding box of (N, 2) points in its CRS; None where there are none."""
    inverse = gdal.InvGeoTransform(dataset.GetGeoTransform())
    known = points[np.isfinite(points).all(axis=1)]
    cells = np.array([gdal.ApplyGeoTransform(inverse, float(x), float(y)) for x, y in known])
    if not len(cells):
        return None
    low = np.maximum(np.floor(cells.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(cells.max(axis=0)).astype(int) + 1, (dataset.RasterXSize, dataset.RasterYSize))
    return None if (high <= low).any() else Window.spanning(*map(int, (*low, *high)))


def _window_values(dataset: gdal.Dataset, path: str, points: FloatArray, most: int) -> FloatImage:
    """The DEM's heights within the bounding box of points (in its CRS), reduced to at most so many a side."""
    window = _window(dataset, points)
    if window is None:
        raise OverlapError(f"The DEM '{path}' does not cover the scene: give one that does, or leave DEM empty.")
    values = read_heights(dataset, window, 1, (min(window.width, most), min(window.height, most)))
    if not np.isfinite(values).any():
        raise OverlapError(f"The DEM '{path}' has only nodata over the scene: give another one, or leave DEM empty.")
    return values
