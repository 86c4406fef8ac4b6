"""Pictures of rasters as RGB arrays and PNG bytes, with numpy and GDAL's PNG driver only.

Arrays are (rows, columns, 3 or 4) uint8 with row 0 at the top (north). Cells without data are transparent where
there is an alpha channel, else white. Nothing here changes GDAL's global state.
"""

from __future__ import annotations

import os
import uuid
from typing import Mapping, Optional, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import AnyArray, ByteImage, FloatImage, Floats, Size
from ..contracts.errors import ImageError
from ..evaluation.grids import Grid, metres_per_unit
from ..imagery import raster
from ..imagery.heights import read_heights

_PNG_LEVEL = "ZLEVEL=4"  # of a shaded surface 6 % more bytes than level 7, in a fifth of the time

# Anchor colours, evenly spaced from low to high and interpolated linearly. "viridis" is sampled from the public-domain
# (CC0) table of N. Smith and S. van der Walt; "elevation" and "diverging" are our own, their lightness rising steadily
# (elevation) or falling evenly to both sides of white (diverging).
_ANCHORS = {
    "viridis": "#440154 #482878 #3e4a89 #31688e #26828e #1f9e89 #35b779 #6ece58 #b5de2b #fde725",
    "elevation": "#1d4f4a #2f6f55 #568a58 #86a05b #b4ae68 #cdb27c #dcbf9a #ead6bf #f8f2ea",
    "diverging": "#0b3c78 #2a6db0 #6aa4d4 #b3d1e9 #ffffff #f6c3ae #e2806a #c03b3b #7d0f24",
    "grey": "#000000 #ffffff",
}
RAMPS = {name: tuple(colours.split()) for name, colours in _ANCHORS.items()}
CLASSES = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999")
"""Colours of discrete values that nobody confuses, with whatever colour vision: Okabe and Ito (2008)."""


def rgb(hexadecimal: str) -> Tuple[int, int, int]:
    """``"#2a6db0"`` as three numbers of 0..255."""
    red, green, blue = bytes.fromhex(hexadecimal[1:])
    return red, green, blue


def ramp_table(ramp: str, count: int = 256) -> ByteImage:
    """(count, 3) colours of a ramp of :data:`RAMPS`, low to high."""
    anchors = np.array([rgb(colour) for colour in RAMPS[ramp]], float)
    at, steps = np.linspace(0, len(anchors) - 1, count), np.arange(len(anchors))
    return np.column_stack([np.interp(at, steps, band) for band in anchors.T]).round().astype(np.uint8)


def percentile_range(values: Floats, low: float = 2.0, high: float = 98.0) -> Tuple[float, float]:
    """The low and high percentile of the finite values; (0, 1) where there are none, never an empty range."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    vmin, vmax = (float(v) for v in np.percentile(finite, (low, high)))
    return (vmin, vmax) if vmax > vmin else (vmin - 0.5, vmin + 0.5)


def colour_map(array: Floats, low: float, high: float, ramp: str = "viridis") -> ByteImage:
    """Colours (rows, columns, 4) of an array; NaN becomes transparent, values out of range take the end colours."""
    values = np.asarray(array, float)
    good = np.isfinite(values)
    scaled = np.where(good, (values - low) / ((high - low) or 1.0), 0.0)
    out = np.empty(values.shape + (4,), np.uint8)
    out[..., :3] = ramp_table(ramp)[(np.clip(scaled, 0, 1) * 255).round().astype(np.intp)]
    out[..., 3] = np.where(good, 255, 0)
    return out


def categories(values: Floats, colours: Mapping[int, str]) -> ByteImage:
    """The colours (rows, columns, 4) of classes by their numbers; NaN, and what is no class, is transparent."""
    out = np.zeros((*values.shape, 4), np.uint8)
    for value, colour in colours.items():
        out[values == value] = (*rgb(colour), 255)
    return out


def over(base: ByteImage, colours: ByteImage, share: float = 0.6) -> ByteImage:
    """Colours (rows, columns, 4) laid over a picture (rows', columns', 4) of the same ground in greys, so that a reader
    sees where they are: they make ``share`` of what is shown, and where there are none the picture stands alone."""
    rows, columns = (np.arange(n) * m // n for n, m in zip(colours.shape[:2], base.shape[:2]))
    below = base[rows][:, columns].astype(np.float32)
    grey = below[..., :3] @ np.array([0.299, 0.587, 0.114], np.float32)
    known, seen = colours[..., 3] > 0, below[..., 3] > 0
    mixed = share * colours[..., :3] + (1 - share) * grey[..., None]
    out = np.where((known & seen)[..., None], mixed, np.where(known[..., None], colours[..., :3], grey[..., None]))
    alpha = np.where(known | seen, 255, 0)
    laid: ByteImage = np.concatenate([out, alpha[..., None]], axis=-1).round().astype(np.uint8)
    return laid


def grey_relief(heights: Floats, cell: float) -> ByteImage:
    """A surface's shading alone, in greys, (rows, columns, 4): what :func:`over` lays colours on."""
    east, north = gradients(np.asarray(heights, np.float32), cell)
    light = hillshade(east, north)
    known = np.isfinite(heights)
    grey = np.where(known, 80 + 175 * np.nan_to_num(light), 0)
    shaded: ByteImage = np.stack([grey, grey, grey, np.where(known, 255, 0)], axis=-1).round().astype(np.uint8)
    return shaded


def gradients(heights: FloatImage, cell: float) -> Tuple[FloatImage, FloatImage]:
    """How much a surface rises to the east and to the north, m per m (rows, columns), NaN where a height is missing.

    Horn's 3 x 3 gradient; where a neighbour is missing the cell's own height stands in for it, so that shading goes
    up to the edge of the data. ``cell`` in the unit of the heights (m).
    """
    padded = np.pad(heights, 1, mode="edge")
    rows, columns = heights.shape

    def near(dr: int, dc: int) -> FloatImage:
        other = padded[1 + dr : 1 + dr + rows, 1 + dc : 1 + dc + columns]
        return np.where(np.isfinite(other), other - heights, np.float32(0))

    corners = [near(down, right) for down, right in ((-1, 1), (1, -1), (1, 1), (-1, -1))]
    east = 2 * (near(0, 1) - near(0, -1)) + corners[0] - corners[1] + corners[2] - corners[3]
    north = 2 * (near(-1, 0) - near(1, 0)) + corners[0] - corners[1] - corners[2] + corners[3]
    good, unit, none = np.isfinite(heights), np.float32(8.0 * cell), np.float32(np.nan)
    return np.where(good, east / unit, none), np.where(good, north / unit, none)


def hillshade(
    east: FloatImage, north: FloatImage, azimuth: float = 315.0, altitude: float = 45.0, exaggeration: float = 1.0
) -> FloatImage:
    """The light on a surface with these :func:`gradients`, 0..1; azimuth clockwise from north, degrees."""
    azimuth, altitude = np.radians(azimuth), np.radians(altitude)
    along = east * np.float32(exaggeration * np.sin(azimuth)) + north * np.float32(exaggeration * np.cos(azimuth))
    steep = np.sqrt(1 + np.float32(exaggeration**2) * (east**2 + north**2))
    light: FloatImage = np.clip((np.float32(np.sin(altitude)) - np.float32(np.cos(altitude)) * along) / steep, 0, 1)
    return light


def shaded_relief(heights: Floats, cell: float, low: Optional[float] = None, high: Optional[float] = None) -> ByteImage:
    """Elevation colours under two lights, (rows, columns, 4), transparent where there is no height.

    ``cell`` in metres; the colours' range is by default the heights' :func:`percentile_range`. Flat terrain is
    exaggerated until its slopes can be seen (at most 5 times).
    """
    z = np.asarray(heights, np.float32)
    slope = np.abs(np.diff(z, axis=1)) / cell
    steep = float(np.nanpercentile(slope, 75)) if np.isfinite(slope).any() else 1.0
    exaggeration = float(np.clip(0.25 / max(steep, 1e-6), 1.0, 5.0))
    if low is None or high is None:
        low, high = percentile_range(z.astype(np.float64))
    east, north = gradients(z, cell)
    light = 0.7 * hillshade(east, north, 315, 45, exaggeration) + 0.3 * hillshade(east, north, 270, 60, exaggeration)
    out = colour_map(z, low, high, "elevation")
    # Flat ground (light about 0.76) keeps its colour; slopes to the sun brighten towards white, away darken.
    light = np.nan_to_num(light, nan=0.76)[..., None]
    colour = out[..., :3].astype(np.float32)
    dark = colour * (0.25 + 0.75 * np.clip(light / 0.76, 0, 1))
    bright = colour + (255 - colour) * np.clip((light - 0.76) / 0.24, 0, 1) * 0.55
    out[..., :3] = np.where(light < 0.76, dark, bright).round().astype(np.uint8)
    return out


def colour_limits(path: str | os.PathLike[str], band: int, max_px: int = 1200) -> Tuple[float, float]:
    """The values of a colour image's band that are shown as black and as white: of 8 bits all, else 2 to 98 %."""
    with raster.opened(os.fspath(path)) as dataset:
        byte = dataset.GetRasterBand(band).DataType == gdal.GDT_Byte
    return (0.0, 255.0) if byte else percentile_range(preview(path, max_px, band)[0])


def photograph(path: str | os.PathLike[str], max_px: int, size: Optional[Size] = None) -> ByteImage:
    """An orthophoto in its colours, or in greys where it has fewer than three bands, (rows, columns, 4); transparent
    where it shows nothing; of another picture's ``size`` (columns, rows) where that is given. Raises ImageError where
    it cannot be read."""
    with raster.opened(os.fspath(path)) as dataset:
        bands = (1, 2, 3) if dataset.RasterCount >= 3 else (1, 1, 1)
    planes = []
    for band in bands:
        low, high = colour_limits(path, band)
        planes.append((preview(path, max_px, band, size=size)[0] - low) / (high - low))
    values = np.stack(planes, axis=-1)
    out = np.empty(values.shape[:2] + (4,), np.uint8)
    out[..., :3] = (255 * np.clip(np.nan_to_num(values), 0, 1)).round()
    out[..., 3] = np.where(np.isfinite(values).all(axis=-1), 255, 0)
    return out


def thumbnail(path: str | os.PathLike[str], max_px: int) -> ByteImage:
    """A small picture of an image, (rows, columns, 4), stretched from 2 to 98 % of each band, of single pixels: so it
    takes no time however large the image is. Raises ImageError where it cannot be read."""
    with raster.opened(os.fspath(path)) as dataset:
        bands = (1, 2, 3) if dataset.RasterCount >= 3 else (1, 1, 1)
    planes = [preview(path, max_px, band, nearest=True)[0] for band in bands]
    stretched = []
    for values in planes:
        low, high = percentile_range(values)
        stretched.append(np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0, 1) * 255)
    alpha = np.where(np.isfinite(planes[0]), 255, 0)
    picture: ByteImage = np.stack([*stretched, alpha], axis=-1).round().astype(np.uint8)
    return picture


def png_bytes(picture: AnyArray) -> bytes:
    """A (rows, columns), (..., 3) or (..., 4) uint8 array as the bytes of a PNG. Raises ValueError for other arrays."""
    return _encoded(picture, "PNG", _PNG_LEVEL)


def jpeg_bytes(picture: AnyArray, quality: int) -> bytes:
    """A (rows, columns), (..., 1) or (..., 3) uint8 array as the bytes of a JPEG; ``quality`` up to 100.

    Raises ValueError for other arrays.
    """
    return _encoded(picture, "JPEG", f"QUALITY={quality}")


def _encoded(picture: AnyArray, driver: str, option: str) -> bytes:
    planes = picture[..., None] if picture.ndim == 2 else picture
    if picture.dtype != np.uint8 or planes.ndim != 3 or picture.size == 0 or planes.shape[2] > 4:
        raise ValueError(f"A picture must be uint8 (rows, columns[, 1..4]), not {picture.dtype} {picture.shape}.")
    rows, columns, bands = planes.shape
    memory = gdal.GetDriverByName("MEM").Create("", columns, rows, bands, gdal.GDT_Byte)
    for index in range(bands):
        memory.GetRasterBand(index + 1).WriteArray(planes[..., index])
    name = f"/vsimem/repm_{uuid.uuid4().hex}"
    try:
        copy = gdal.GetDriverByName(driver).CreateCopy(name, memory, options=[option])
        if copy is None:
            remedy = f"check that its {driver} driver is there (gdalinfo --formats)"
            raise ImageError(f"GDAL could not make a {driver} in memory: {remedy}.")
        copy = None  # noqa: F841 - closes and flushes the file
        stream = gdal.VSIFOpenL(name, "rb")
        data = bytes(gdal.VSIFReadL(1, gdal.VSIStatL(name).size, stream))
        gdal.VSIFCloseL(stream)
        return data
    finally:
        memory = None  # noqa: F841
        for leftover in (name, name + ".aux.xml"):
            if gdal.VSIStatL(leftover) is not None:
                gdal.Unlink(leftover)


def preview(
    path: str | os.PathLike[str],
    max_px: int,
    band: int = 1,
    *,
    nearest: bool = False,
    size: Optional[Size] = None,
    heights: bool = False,
) -> Tuple[FloatImage, float]:
    """Read a raster small, by averaging valid cells (from overviews where there are any), or by taking single ones.

    Returns (rows, columns) with NaN for nodata, at most ``max_px`` on the longer side or of this ``size`` (columns,
    rows), and the size of its cells in metres (1 where the raster has no place on the ground). ``heights`` are those of
    any DSM, in metres (:func:`~repm_qgis.imagery.heights.read_heights`). Raises ImageError where the raster cannot be
    read.
    """
    with raster.opened(os.fspath(path)) as dataset:
        columns, rows = dataset.RasterXSize, dataset.RasterYSize
        factor = columns / size[0] if size else max(1.0, max(columns, rows) / float(max(1, max_px)))
        small = size or (max(1, round(columns / factor)), max(1, round(rows / factor)))
        reduced = None if small == (columns, rows) else small
        if heights:
            values = read_heights(dataset, None, band, reduced)
        else:
            values = raster.read(dataset, band=band, size=reduced, nearest=nearest)
        per_unit = metres_per_unit(Grid.of(dataset))
        cell = abs(dataset.GetGeoTransform()[1]) * per_unit[0]
        return values, cell * factor
