"""Ortho-ready images: projected to a map at one height by their vendor, with the RPC of their lines of sight.

Maxar calls them Ortho Ready Standard (OR2A), Airbus projected, and GF and ZY level 2A. A pixel is a place on the map,
the place at the image's height is a point in space, and the line of sight through that point is the pixel's. So the
image has an exact sensor model without being resampled to the sensor's geometry: map, height, RPC.

It does not matter which pixels the RPC counts, the original image's or a tile's: only its lines of sight are used.
Where it counts those of the projected image itself, which its own numbers show, it is the whole model, and no height
is needed.

An orthoimage was displaced by a terrain model, which nobody knows later: its lines of sight are lost.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Iterator, List, Optional, Tuple

import numpy as np
import pyproj
from osgeo import gdal

from ..contracts.arrays import FloatArray
from ..contracts.checks import as_text
from ..contracts.errors import RpcError, RpcInvalidError
from ..geometry.map_plane import MapPlane
from ..rpc.formats import sidecar_text, xml_inside, xml_texts
from ..rpc.model import Rpc
from .acquisition import time_sidecars

OPTION = "ORTHO_READY_HEIGHT"

_OWN_PX = 3.0  # between what an RPC and the map say of the same pixels, where the RPC is that of these pixels
_BIAS_PX = 100.0  # by which such an RPC may have been corrected, and the map not
_SAME_M = 0.5  # between heights that a file repeats
_HEIGHTS_M = -12_000.0, 10_000.0
_SQUARE = 1e-6

_READY = re.compile(r"PROJECTED|\w*_PROJECTED|(?:ORSTANDARD|STEREOOR|OR)_?2A|LEVEL_?2A?|L2A?")
_ORTHO = re.compile(r"ORTHO|MOSAIC|\w*_(?:ORTHO|MOSAIC)|ORTHORECTIFIED\w*|STANDARD2A|LEVEL_?[34]A?|L[34]A?")
_LEVELS = ("PROCESSING_LEVEL", "METADATA_PROFILE", "IMAGEDESCRIPTOR", "ProductLevel")
_IMD = re.compile(r"^\s*(imageDescriptor|DEMCorrection|terrainHAE)\s*=\s*\"?([^\";\r\n]{1,80})", re.I | re.M | re.ASCII)
_METRES = re.compile(r"[+-]?\d{1,5}(?:\.\d{0,12})?(?:[eE][+-]?\d{1,2})?", re.ASCII)


@dataclass(frozen=True)
class OrthoReady:
    """The exact model of an ortho-ready image: the same interface as :class:`~repm_qgis.rpc.model.Rpc`."""

    rpc: Rpc
    plane: MapPlane

    def project(self, lon_lat_h: FloatArray) -> FloatArray:
        """(..., 3) degrees, degrees, metres above the ellipsoid to (..., 2) column, row; NaN in gives NaN out."""
        points = np.asarray(lon_lat_h, dtype=np.float64)
        drift = (self.plane.height - points[..., 2:]) * self._lean(points)
        ground = self.rpc.localise(self.rpc.project(points), self.plane.height, near=points[..., :2] + drift)
        return self.plane.pixels(ground)

    def localise(self, col_row: FloatArray, height: FloatArray | float) -> FloatArray:
        """(..., 2) column, row and heights (m above the ellipsoid) to (..., 3) longitude, latitude, height; NaN where
        the RPC has no answer."""
        on_plane = self.plane.ground(col_row)
        heights = np.broadcast_to(np.asarray(height, dtype=np.float64), on_plane.shape[:-1])
        drift = (heights - self.plane.height)[..., None] * self._lean(on_plane)
        return self.rpc.localise(self.rpc.project(on_plane), heights, near=on_plane[..., :2] + drift)

    def _lean(self, points: FloatArray) -> FloatArray:
        """(2,) degrees of longitude and latitude that the lines of sight of points move by for each metre up."""
        known = points[np.isfinite(points).all(axis=-1)]
        if not len(known):
            return np.zeros(2)
        middle = known[len(known) // 2].copy()
        middle[2] = self.plane.height
        above = self.rpc.localise(self.rpc.project(middle), middle[2] + 1.0)
        lean: FloatArray = above[:2] - middle[:2]
        return lean if np.isfinite(lean).all() else np.zeros(2)


def plane_of(dataset: gdal.Dataset, path: str, rpc: Rpc, height: Optional[float] = None) -> Optional[MapPlane]:
    """The plane that an opened image was projected to; None for one in its sensor's geometry, also for one whose RPC
    is that of its own projected pixels.

    The plane's height is that of the product's metadata, else ``height`` (m above the ellipsoid), else the RPC's middle
    height, which is only assumed. Raises RpcInvalidError for an orthoimage.
    """
    lattice = _lattice(dataset)
    if lattice is None:
        return None
    facts = _facts(path)
    if facts.ortho:
        raise RpcInvalidError(
            f"'{path}' is an orthoimage ({facts.ortho}): its lines of sight are lost, because the terrain model that "
            "displaced its pixels is not known: order the Basic, Sensor or Primary level, or an ortho-ready one."
        )
    crs, transform = lattice
    assumed = MapPlane(crs, transform, rpc.height_off, "")
    if _of_these_pixels(rpc, assumed, (dataset.RasterXSize, dataset.RasterYSize)):
        return None
    if not (facts.ready or height is not None or _is_map_product(crs, transform)):
        return None  # a sensor's image with a rough place on the map, as many programs write
    if facts.height is not None:
        metres, source = facts.height
        return MapPlane(crs, transform, metres, source)
    return assumed if height is None else MapPlane(crs, transform, height, OPTION)


# --- what the image itself says -------------------------------------------------------------------------------------


def _lattice(dataset: gdal.Dataset) -> Optional[Tuple[str, Tuple[float, float, float, float, float, float]]]:
    """The CRS and the geotransform of an image that lies on a map; None for others.

    A NITF's geotransform is made of corners that are rounded to seconds of arc: it is no map.
    """
    transform, text = dataset.GetGeoTransform(can_return_null=True), as_text(dataset.GetProjection())
    if not transform or not text or dataset.GetDriver().ShortName == "NITF":
        return None
    if not np.isfinite(transform).all() or abs(transform[1] * transform[5] - transform[2] * transform[4]) < 1e-18:
        return None
    try:
        crs = pyproj.CRS.from_wkt(text)
    except pyproj.exceptions.CRSError:
        return None
    if not (crs.is_projected or crs.is_geographic) or len(crs.axis_info) != 2:
        return None
    a, b, c, d, e, f = map(float, transform)
    return text, (a, b, c, d, e, f)


def _is_map_product(crs: str, transform: Tuple[float, ...]) -> bool:
    """Whether a lattice is what products have: north up, square pixels of a projected CRS."""
    _, right, row_right, _, col_down, down = transform
    square = abs(right + down) <= _SQUARE * abs(right)
    return right > 0 and square and row_right == col_down == 0 and pyproj.CRS.from_wkt(crs).is_projected


def _of_these_pixels(rpc: Rpc, plane: MapPlane, size: Tuple[int, int]) -> bool:
    """Whether the RPC counts the pixels of the projected image: it projects their places on the map, at some height, to
    these same pixels, apart from a shift that all pixels share."""
    columns, rows = np.meshgrid(*(np.linspace(0, side - 1, 5) for side in size))
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    ground = plane.ground(pixels)
    if not np.isfinite(ground).all():
        return False

    def apart(height: float) -> FloatArray:
        with np.errstate(all="ignore"):
            found: FloatArray = rpc.project(np.column_stack([ground[:, :2], np.full(len(ground), height)])) - pixels
        return found

    height = plane.height
    slope = (apart(height + 100.0) - apart(height)) / 100.0  # px for one metre, almost the same at all heights
    steep = float((slope**2).sum())
    if np.isfinite(steep) and steep > 1e-12:
        height = float(np.clip(height - (slope * apart(height)).sum() / steep, *_HEIGHTS_M))
    left = apart(height)
    if not np.isfinite(left).all():
        return False
    bias = left.mean(axis=0)
    return bool(np.abs(left - bias).max() <= _OWN_PX and np.abs(bias).max() <= _BIAS_PX)


# --- what the product's files say -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Facts:
    """What a product's files say: the words that make it an orthoimage, or an ortho-ready one ("" for none), and the
    height of its plane with the file that states it."""

    ortho: str = ""
    ready: str = ""
    height: Optional[Tuple[float, str]] = None


def _facts(path: str) -> _Facts:
    """What the files beside an image say of its level; files that cannot be read are ignored."""
    ortho, ready, heights = "", "", []
    for file in time_sidecars(path):
        name = re.split(r"[/\\]", file)[-1]
        try:
            said = list(_stated(sidecar_text(file)))
        except RpcError:
            continue
        for key, value in said:
            if key == "height":
                match = _METRES.fullmatch(value)
                if match and _HEIGHTS_M[0] <= float(value) <= _HEIGHTS_M[1]:
                    heights.append((float(value), f"'{name}'"))
            elif key == "dem":
                ortho = ortho or (f"{value} in '{name}'" if re.search(r"\bDEM\b", value, re.I) else "")
            elif _ORTHO.fullmatch(value.upper()):
                ortho = ortho or f"{value} in '{name}'"
            elif _READY.fullmatch(value.upper()):
                ready = ready or f"{value} in '{name}'"
    # Only a product at one height states one height: each corner of an orthoimage has its own.
    one = bool(heights) and max(h for h, _ in heights) - min(h for h, _ in heights) <= _SAME_M
    return _Facts(ortho, ready, heights[0] if one and (ready or ortho == "") else None)


def _stated(text: str) -> Iterator[Tuple[str, str]]:
    """(what, value) of a product's file: "level", "dem" (how heights were treated) and "height"."""
    if text.lstrip().startswith("<"):
        found = xml_texts(text, (*_LEVELS, "DEMCORRECTION", "TERRAINHAE"))
        yield from (("level", value.strip()) for name in _LEVELS for value in found[name][:8])
        yield from (("dem", value.strip()) for value in found["DEMCORRECTION"][:8])
        heights: List[str] = found["TERRAINHAE"] or xml_inside(text, "Bounding_Polygon", "H")
        yield from (("height", value.strip()) for value in heights[:64])
        return
    keys = {"imagedescriptor": "level", "demcorrection": "dem", "terrainhae": "height"}
    yield from ((keys[key.lower()], value.strip()) for key, value in _IMD.findall(text)[:64])
