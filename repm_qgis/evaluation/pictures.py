"""Pictures of rasters as RGB arrays and PNG bytes, with numpy and GDAL's PNG driver only.

Arrays are (rows, columns, 3 or 4) uint8 with row 0 at the top (north). Cells without data are transparent where
there is an alpha channel, else white. Nothing here changes GDAL's global state.
"""

from __future__ import annotations

import os
import uuid
from typing import Optional, Tuple, Union

import numpy as np
from osgeo import gdal

from ..errors import ImageError
from ..imagery import raster
from ..workspace import whole_file
from .grids import Grid, metres_per_unit

PathLike = Union[str, os.PathLike]

_PNG_LEVEL = "ZLEVEL=4"  # of a shaded surface 6 % more bytes than level 7, in a fifth of the time

# Anchor colours, evenly spaced from low to high and interpolated linearly. "viridis" and "magma" are sampled from the
# public-domain (CC0) tables of N. Smith and S. van der Walt; "elevation" and "diverging" are our own, their lightness
# rising steadily (elevation) or falling evenly to both sides of white (diverging).
RAMPS = {
    "viridis": (
        "#440154",
        "#482878",
        "#3e4a89",
        "#31688e",
        "#26828e",
        "#1f9e89",
        "#35b779",
        "#6ece58",
        "#b5de2b",
        "#fde725",
    ),
    "magma": (
        "#000004",
        "#180f3d",
        "#440f76",
        "#721f81",
        "#9e2f7f",
        "#cd4071",
        "#f1605d",
        "#fd9668",
        "#feca8d",
        "#fcfdbf",
    ),
    "elevation": ("#1d4f4a", "#2f6f55", "#568a58", "#86a05b", "#b4ae68", "#cdb27c", "#dcbf9a", "#ead6bf", "#f8f2ea"),
    "diverging": ("#0b3c78", "#2a6db0", "#6aa4d4", "#b3d1e9", "#ffffff", "#f6c3ae", "#e2806a", "#c03b3b", "#7d0f24"),
    "grey": ("#000000", "#ffffff"),
}


def rgb(hexadecimal: str) -> Tuple[int, int, int]:
    """``"#2a6db0"`` as three numbers of 0..255."""
    return tuple(int(hexadecimal[i : i + 2], 16) for i in (1, 3, 5))  # type: ignore[return-value]


def ramp_table(ramp: str, count: int = 256) -> np.ndarray:
    """(count, 3) uint8 colours of a ramp of :data:`RAMPS`, low to high."""
    anchors = np.array([rgb(colour) for colour in RAMPS[ramp]], float)
    at = np.linspace(0, len(anchors) - 1, count)
    return (
        np.column_stack([np.interp(at, np.arange(len(anchors)), anchors[:, i]) for i in range(3)])
        .round()
        .astype(np.uint8)
    )


def spread(values: np.ndarray, low: float = 2.0, high: float = 98.0) -> Tuple[float, float]:
    """The low and high percentile of the finite values; (0, 1) where there are none, never an empty range."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    vmin, vmax = (float(v) for v in np.percentile(finite, (low, high)))
    return (vmin, vmax) if vmax > vmin else (vmin - 0.5, vmin + 0.5)


def colour_map(
    array: np.ndarray, vmin: Optional[float] = None, vmax: Optional[float] = None, ramp: str = "viridis"
) -> np.ndarray:
    """Colour a (rows, columns) array; NaN becomes transparent, values outside the range take its end colours.

    ``vmin``, ``vmax``: None takes the 2 and 98 % percentile. Gives (rows, columns, 4) uint8.
    """
    values = np.asarray(array, float)
    low, high = spread(values)
    low, high = (low if vmin is None else vmin), (high if vmax is None else vmax)
    good = np.isfinite(values)
    scaled = np.where(good, (values - low) / ((high - low) or 1.0), 0.0)
    out = np.empty(values.shape + (4,), np.uint8)
    out[..., :3] = ramp_table(ramp)[(np.clip(scaled, 0, 1) * 255).round().astype(np.intp)]
    out[..., 3] = np.where(good, 255, 0)
    return out


def hillshade(
    heights: np.ndarray, cell: float, azimuth: float = 315.0, altitude: float = 45.0, exaggeration: float = 1.0
) -> np.ndarray:
    """Light that falls on a surface, 0..1 (rows, columns), NaN where a height is missing.

    Horn's 3 x 3 gradient; where a neighbour is missing the cell's own height stands in for it, so that shading goes
    up to the edge of the data. ``cell`` in the unit of the heights (m); azimuth clockwise from north, degrees.
    """
    return _light(*_slopes(np.asarray(heights, np.float32), cell), azimuth, altitude, exaggeration)


def _slopes(z: np.ndarray, cell: float) -> Tuple[np.ndarray, np.ndarray]:
    """How much a surface rises to the east and to the north, m a m, NaN where a height is missing."""
    good = np.isfinite(z)
    padded = np.pad(z, 1, mode="edge")
    rows, columns = z.shape

    def near(dr: int, dc: int) -> np.ndarray:
        other = padded[1 + dr : 1 + dr + rows, 1 + dc : 1 + dc + columns]
        return np.where(np.isfinite(other), other - z, np.float32(0))

    corners = [near(*corner) for corner in ((-1, 1), (1, -1), (1, 1), (-1, -1))]
    east = 2 * (near(0, 1) - near(0, -1)) + corners[0] - corners[1] + corners[2] - corners[3]
    north = 2 * (near(-1, 0) - near(1, 0)) + corners[0] - corners[1] - corners[2] + corners[3]
    unit = np.float32(8.0 * cell)
    return np.where(good, east / unit, np.float32(np.nan)), np.where(good, north / unit, np.float32(np.nan))


def _light(east: np.ndarray, north: np.ndarray, azimuth: float, altitude: float, exaggeration: float) -> np.ndarray:
    azimuth, altitude = np.radians(azimuth), np.radians(altitude)
    along = east * np.float32(exaggeration * np.sin(azimuth)) + north * np.float32(exaggeration * np.cos(azimuth))
    steep = np.sqrt(1 + np.float32(exaggeration**2) * (east**2 + north**2))
    return np.clip((np.float32(np.sin(altitude)) - np.float32(np.cos(altitude)) * along) / steep, 0, 1)


def shaded_relief(
    array: np.ndarray,
    cell: float,
    vmin: Optional[float] = None,
    vmax: Optional[float] = None,
    ramp: str = "elevation",
    exaggeration: Optional[float] = None,
) -> np.ndarray:
    """Elevation colours under two lights, (rows, columns, 4) uint8, transparent where there is no height.

    ``cell`` in metres. ``exaggeration`` None raises flat terrain until its slopes can be seen (at most 5 times).
    """
    z = np.asarray(array, np.float32)
    if exaggeration is None:
        slope = np.abs(np.diff(z, axis=1)) / cell
        steep = float(np.nanpercentile(slope, 75)) if np.isfinite(slope).any() else 1.0
        exaggeration = float(np.clip(0.25 / max(steep, 1e-6), 1.0, 5.0))
    slopes = _slopes(z, cell)
    light = 0.7 * _light(*slopes, 315, 45, exaggeration) + 0.3 * _light(*slopes, 270, 60, exaggeration)
    out = colour_map(z, vmin, vmax, ramp)
    # Flat ground (light about 0.76) keeps its colour; slopes to the sun brighten towards white, away darken.
    light = np.nan_to_num(light, nan=0.76)[..., None]
    colour = out[..., :3].astype(np.float32)
    dark = colour * (0.25 + 0.75 * np.clip(light / 0.76, 0, 1))
    bright = colour + (255 - colour) * np.clip((light - 0.76) / 0.24, 0, 1) * 0.55
    out[..., :3] = np.where(light < 0.76, dark, bright).round().astype(np.uint8)
    return out


def png_bytes(picture: np.ndarray) -> bytes:
    """A (rows, columns), (..., 3) or (..., 4) uint8 array as the bytes of a PNG. Raises ValueError for other arrays."""
    array = np.ascontiguousarray(picture)
    if (
        array.dtype != np.uint8
        or array.ndim not in (2, 3)
        or array.size == 0
        or (array.ndim == 3 and array.shape[2] > 4)
    ):
        raise ValueError(f"A picture must be uint8 (rows, columns[, 1..4]), not {array.dtype} {array.shape}.")
    planes = array[..., None] if array.ndim == 2 else array
    rows, columns, bands = planes.shape
    memory = gdal.GetDriverByName("MEM").Create("", columns, rows, bands, gdal.GDT_Byte)
    for index in range(bands):
        memory.GetRasterBand(index + 1).WriteArray(planes[..., index])
    name = f"/vsimem/repm_{uuid.uuid4().hex}.png"
    try:
        copy = gdal.GetDriverByName("PNG").CreateCopy(name, memory, options=[_PNG_LEVEL])
        if copy is None:
            raise ImageError(
                "GDAL could not make a PNG in memory: check that its PNG driver is there (gdalinfo --formats)."
            )
        copy = None  # noqa: F841 - closes and flushes the file
        return _read_memory_file(name)
    finally:
        memory = None  # noqa: F841
        for leftover in (name, name + ".aux.xml"):
            if gdal.VSIStatL(leftover) is not None:
                gdal.Unlink(leftover)


def _read_memory_file(name: str) -> bytes:
    size = gdal.VSIStatL(name).size
    stream = gdal.VSIFOpenL(name, "rb")
    try:
        return bytes(gdal.VSIFReadL(1, size, stream))
    finally:
        gdal.VSIFCloseL(stream)


def preview(path: PathLike, max_px: int = 1600, band: int = 1) -> Tuple[np.ndarray, float]:
    """Read a raster small, by averaging valid cells (from overviews where there are any).

    Returns
    -------
    (rows, columns) float32 with NaN for nodata, at most ``max_px`` on the longer side, and the size of its cells in
    metres (1 where the raster has no place on the ground).

    Raises ImageError where the raster cannot be read.
    """
    with raster.opened(os.fspath(path)) as dataset:
        columns, rows = dataset.RasterXSize, dataset.RasterYSize
        factor = max(1.0, max(columns, rows) / float(max(1, max_px)))
        size = (max(1, round(columns / factor)), max(1, round(rows / factor)))
        values = raster.read(dataset, band=band, size=None if factor == 1 else size)
        per_unit = metres_per_unit(Grid.of(dataset))
        cell = abs(dataset.GetGeoTransform()[1]) * per_unit[0]
        return values, cell * factor


def shaded_relief_png(dsm_path: PathLike, png_path: PathLike, max_px: int = 1600) -> None:
    """Write a shaded picture of a DSM. Raises ImageError where it cannot be read, WorkspaceError where not written."""
    heights, cell = preview(dsm_path, max_px)
    write_png(shaded_relief(heights, cell), png_path)


def write_png(picture: np.ndarray, path: PathLike) -> None:
    """Write a uint8 picture as PNG, whole or not at all. Raises WorkspaceError where it cannot be written."""
    with whole_file(os.fspath(path)) as temporary, open(temporary, "wb") as stream:
        stream.write(png_bytes(picture))
