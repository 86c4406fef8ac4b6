"""Where images lie on the ground, and where they overlap."""

from __future__ import annotations

from itertools import combinations
from typing import Callable, List, Optional, Sequence

import numpy as np
from osgeo import gdal, ogr, osr

from ..contracts.arrays import Bounds, FloatArray, Size
from .frames import EnuFrame
from .refinement import SensorModel

Polygon = FloatArray
"""(N, 2) vertices, not closed."""


def footprint(
    localise: Callable[[FloatArray, float], FloatArray], size: Size, altitude: float, points: int = 6
) -> Polygon:
    """The outline of an image on the ground at one altitude, (4 (points - 1), 2) longitude, latitude.

    ``localise`` maps (N, 2) pixels and a height to (N, 3) longitude, latitude, height. Vertices that the model cannot
    place are omitted.
    """
    u, v = np.linspace(-0.5, size[0] - 0.5, points), np.linspace(-0.5, size[1] - 0.5, points)
    ground = localise(ring(u, v), altitude)[:, :2]
    known: FloatArray = ground[np.isfinite(ground).all(axis=1)]
    return known


def ring(u: FloatArray, v: FloatArray) -> FloatArray:
    """(4 (n - 1), 2) the border of a grid of (n,) columns and (n,) rows, clockwise from the upper left."""
    columns = np.concatenate([u[:-1], np.full(len(v) - 1, u[-1]), u[:0:-1], np.full(len(v) - 1, u[0])])
    rows = np.concatenate([np.full(len(u) - 1, v[0]), v[:-1], np.full(len(u) - 1, v[-1]), v[:0:-1]])
    return np.column_stack([columns, rows])


def ray_slope(view: SensorModel, lon_lat: FloatArray, altitude: float) -> FloatArray:
    """(2,) how far a view's line of sight at a place goes east and north, m for each m that it rises."""
    pixel = view.project(np.array([*lon_lat, altitude]))
    points = view.localise(np.array([pixel, pixel]), np.array([altitude - 50.0, altitude + 50.0]))
    enu = EnuFrame(float(lon_lat[0]), float(lon_lat[1]), altitude).from_geodetic(points)
    step: FloatArray = enu[1] - enu[0]
    slope: FloatArray = step[:2] / step[2]
    return slope


def geometry_of(polygon: Polygon) -> ogr.Geometry:
    """An OGR polygon from vertices, made valid."""
    ring = ogr.Geometry(ogr.wkbLinearRing)
    for x, y in np.vstack([polygon, polygon[:1]]):
        ring.AddPoint_2D(float(x), float(y))
    geometry = ogr.Geometry(ogr.wkbPolygon)
    geometry.AddGeometry(ring)
    return geometry if geometry.IsValid() else geometry.Buffer(0.0)


def reprojected(geometry: ogr.Geometry, source: str, target: str) -> ogr.Geometry:
    """A copy of a geometry, brought vertex by vertex from one CRS (any text that PROJ knows) to another."""
    found = geometry.Clone()
    if source != target:
        references = [osr.SpatialReference(), osr.SpatialReference()]
        for reference, text in zip(references, (source, target)):
            reference.SetFromUserInput(text)
            reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
        found.Transform(osr.CoordinateTransformation(*references))
    return found


def seen_twice(footprints: Sequence[Sequence[Polygon]]) -> ogr.Geometry:
    """The area that at least two views see, over a range of altitudes.

    ``footprints[altitude][view]`` are outlines in one plane; the result is the union over all altitudes of all
    pairwise intersections (empty where no two views overlap).
    """
    union = ogr.Geometry(ogr.wkbPolygon)
    for outlines in footprints:
        shapes: List[ogr.Geometry] = [geometry_of(p) for p in outlines if len(p) >= 3]
        for first, second in combinations(shapes, 2):
            common = first.Intersection(second)
            if common is not None and common.GetArea() > 0:
                union = union.Union(common)
    return union


def bounds_of_wkt(wkt: str) -> Optional[Bounds]:
    """The bounding box of the area that a WKT describes; None where it describes none."""
    gdal.PushErrorHandler("CPLQuietErrorHandler")
    try:
        geometry = ogr.CreateGeometryFromWkt(wkt)
        bounds = bounds_of(geometry) if geometry is not None and geometry.GetArea() > 0 else None
    except RuntimeError:
        return None
    finally:
        gdal.PopErrorHandler()
    return bounds if bounds is not None and np.isfinite(bounds).all() else None


def box(bounds: Sequence[float]) -> ogr.Geometry:
    """The rectangle xmin, ymin, xmax, ymax."""
    xmin, ymin, xmax, ymax = bounds
    return geometry_of(np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]]))


def bounds_of(geometry: ogr.Geometry) -> Bounds:
    """The bounding box of a geometry."""
    xmin, xmax, ymin, ymax = geometry.GetEnvelope()
    return Bounds(xmin, ymin, xmax, ymax)
