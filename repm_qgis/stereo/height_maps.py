"""Height maps on disk: heights in the geometry of one image of a tile, and how they are put on the ground."""

from __future__ import annotations

import json
import os
import zlib
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Iterable, Iterator, Optional, Tuple

import numpy as np
from osgeo import gdal

from ..contracts.arrays import Altitudes, Bounds, FloatArray, FloatImage, Mask, Size, Window
from ..contracts.errors import ImageError, SceneError
from ..contracts.records import GroundShift, HeightMapRecord
from ..geometry.interpolation import interpolate_grid
from ..imagery.raster import opened, read, write
from ..scene import Scene
from .triangulation import NodeTable, verticals
from .wave_change import WaveChange

_STRIP = 256  # rows, those of a block
_KEY = "REPM_FINGERPRINT"
_RECORD = "REPM_RECORD"
BANDS = ("height above the WGS 84 ellipsoid (m)", "matching score", "filled from the background (1)")


@dataclass(frozen=True)
class HeightMap:
    """Ground points of a height map: ``x``, ``y`` in a projected CRS, ``height``, ``score``; all (H, W), NaN = none.

    ``filled`` marks heights that were taken from the background of an occlusion. ``ray`` is how far x and y move along
    a pixel's line of sight, m for each m of height; ``relief_displacement`` how far column and row of a point move
    that rises, px for each m.
    """

    x: FloatArray
    y: FloatArray
    height: FloatArray
    score: FloatImage
    filled: Mask
    ray: Tuple[float, float] = (0.0, 0.0)
    relief_displacement: Tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class HeightSource:
    """A height map on disk, of which any part can be placed on the ground.

    ``x`` and ``y`` take column, row, height to coordinates of a projected CRS. ``part`` are the bounds of the tile and
    of the part of it that the map was made for, where tiles were matched in parts: heights on the rest of the tile are
    left out, because its other parts have maps of their own. ``offsets`` (m) on nodes over all pixels, if any, are
    added to the heights before these are placed: an error of parallax moves points along their lines of sight.
    ``shift`` is what was added to the ground since matching, ``waves`` are those of the views that were found since.
    """

    path: str
    x: NodeTable
    y: NodeTable
    size: Size
    altitudes: Altitudes
    part: Optional[Tuple[Bounds, Bounds]] = None
    offsets: Optional[FloatArray] = None
    shift: Optional[GroundShift] = None
    waves: Optional[WaveChange] = None

    def read(self, bounds: Optional[Bounds] = None, step: int = 1) -> HeightMap:
        """The rectangle of pixels that contains all points in ``bounds``; None takes all. Of them each ``step``-th in
        columns and rows.

        Raises SceneError where the file is missing or damaged.
        """
        if bounds is not None and self.shift is not None:
            bounds = self.shift.of_bounds(bounds, -1)
        col, row, width, height_px = window = Window(0, 0, *self.size) if bounds is None else self._window(bounds)
        if not (width and height_px):
            none = np.empty((0, 0))
            return HeightMap(none, none, none, none.astype(np.float32), none.astype(bool))
        with _opened_height_map(self.path) as dataset:
            height = read(dataset, window, 1)[::step, ::step].astype(np.float64)
            score = read(dataset, window, 2)[::step, ::step]
            filled = read(dataset, window, 3)[::step, ::step] > 0
        columns = np.arange(col, col + width, step, dtype=np.float64)
        rows = np.arange(row, row + height_px, step, dtype=np.float64)
        if self.offsets is not None:
            places = zip(self.offsets.shape, (rows, columns), self.size[::-1])
            at_row, at_column = (at * (n - 1) / max(px - 1, 1) for n, at, px in places)
            height += interpolate_grid(self.offsets, at_row, at_column)
        change = None
        if self.waves is not None:
            up, change = self.waves.of(columns, rows, height)
            height += up
        x, y = (table.on_grid(columns, rows, height) for table in (self.x, self.y))
        if change is not None:
            x, y = x + change[..., 0], y + change[..., 1]
        if self.part is not None:
            tile, own = self.part
            height = np.where(_inside(tile, x, y) & ~_inside(own, x, y), np.nan, height)
        if self.shift is not None:
            height = height + self.shift.up(x, y)
            x, y = x + self.shift.moved[0], y + self.shift.moved[1]
        ray, (right, down) = verticals(self.x, self.y)
        return HeightMap(x, y, height, score, filled, ray, (right / step, down / step))

    def _window(self, bounds: Bounds) -> Window:
        """The pixels between the nodes of the tables whose rays may cross the bounds."""
        columns, rows = self.x.columns, self.x.rows
        levels = [np.full((len(rows), len(columns)), z) for z in self.altitudes]
        ends = [[table.on_grid(columns, rows, level) for table in (self.x, self.y)] for level in levels]
        low, high = np.minimum(ends[0], ends[1]), np.maximum(ends[0], ends[1])
        # Between two nodes the ground continues by at most the distance between two of them.
        step = max(float(np.abs(np.diff(part, axis=axis)).max()) for part in (*ends[0], *ends[1]) for axis in (0, 1))
        near = np.all([(high[k] >= bounds[k] - step) & (low[k] <= bounds[k + 2] + step) for k in (0, 1)], axis=0)
        across, down = np.flatnonzero(near.any(axis=0)), np.flatnonzero(near.any(axis=1))
        if not across.size:
            return Window(0, 0, 0, 0)
        (left, right), (top, bottom) = columns[across[[0, -1]]], rows[down[[0, -1]]]
        return Window.spanning(int(left), int(top), int(right) + 1, int(bottom) + 1)


def _inside(bounds: Bounds, x: FloatArray, y: FloatArray) -> Mask:
    with np.errstate(invalid="ignore"):
        return (x >= bounds[0]) & (y >= bounds[1]) & (x < bounds[2]) & (y < bounds[3])


def write_height_map(
    path: str, key: str, record: HeightMapRecord, height: FloatImage, score: FloatImage, filled: Mask
) -> HeightMapRecord:
    """Write a height map with its fingerprint ``key``; gives its record, with the file and the numbers of pixels.

    The bands are the height in m above the ellipsoid, the matching score, and 1 where the height is a fill.
    """
    valid, (rows, columns) = int((np.isfinite(height) & ~filled).sum()), height.shape
    bands = [height, score, filled.astype(np.float32)]
    size, checksum = (columns, rows), checksum_of(bands)
    record = replace(record, size=size, valid=valid, filled=int(filled.sum()), checksum=checksum)
    tags = {_KEY: key, _RECORD: json.dumps(record.to_mapping())}
    remade = _is_damaged(path, key)
    write(path, bands, (0, 1, 0, 0, 0, 1), "", metadata=tags, descriptions=BANDS, own=True)
    return replace(record, file=path, remade=remade)


def checksum_of(parts: Iterable[FloatImage]) -> str:
    """The CRC-32 of values in their order, as they are read again; a value that is not finite is NaN."""
    crc = 0
    for values in parts:
        known = np.where(np.isfinite(values), values, np.float32(np.nan)).astype("<f4")
        crc = zlib.crc32(np.ascontiguousarray(known).data, crc)
    return f"{crc:08x}"


def _stored_values(dataset: gdal.Dataset) -> Iterator[FloatImage]:
    """The values of all bands, some rows at a time: whole maps would take more memory than fusion does."""
    width, height = dataset.RasterXSize, dataset.RasterYSize
    for band in range(1, len(BANDS) + 1):
        for row in range(0, height, _STRIP):
            yield read(dataset, Window(0, row, width, min(_STRIP, height - row)), band)


def _is_damaged(path: str, key: str) -> bool:
    """Whether a file is the height map with this fingerprint, but not as it was written."""
    if not os.path.exists(path) or finished_record(path, key) is not None:
        return False
    try:
        with opened(path) as dataset:
            return bool(dataset.GetMetadataItem(_KEY) == key)
    except ImageError:
        return True


def finished_record(path: str, key: str) -> Optional[HeightMapRecord]:
    """The record of a complete height map with this fingerprint; None where there is none."""
    if not os.path.exists(path):
        return None
    try:
        with opened(path) as dataset:
            if dataset.GetMetadataItem(_KEY) != key:
                return None
            record = HeightMapRecord.from_mapping(json.loads(dataset.GetMetadataItem(_RECORD)))
            if checksum_of(_stored_values(dataset)) != record.checksum:
                return None
    except (ImageError, KeyError, TypeError, ValueError):
        return None
    return replace(record, file=path, reused=True)


def has_key(path: str, key: str) -> bool:
    """Whether there is a height map with this fingerprint; its contents are not read."""
    try:
        with opened(path) as dataset:
            return bool(dataset.GetMetadataItem(_KEY) == key)
    except ImageError:
        return False


def is_whole(record: HeightMapRecord) -> bool:
    """Whether the file of a height map is there, and holds what was written."""
    try:
        with opened(record.file) as dataset:
            size = (dataset.RasterXSize, dataset.RasterYSize)
            return size == record.size and checksum_of(_stored_values(dataset)) == record.checksum
    except ImageError:
        return False


def require_whole(record: HeightMapRecord) -> None:
    """Raise SceneError where the file of a height map is missing or damaged."""
    if not is_whole(record):
        raise _damaged(record.file)


def _damaged(path: str) -> SceneError:
    remedy = "run 'Reconstruct heights' or 'Make a DSM' again, which make it again"
    return SceneError(f"The height map '{path}' is missing or damaged: {remedy}.")


@contextmanager
def _opened_height_map(path: str) -> Iterator[gdal.Dataset]:
    """A height map's raster; raises SceneError where it is missing or damaged."""
    try:
        with opened(path) as dataset:
            yield dataset
    except ImageError as error:
        raise _damaged(path) from error


def foreign_height_map(record: HeightMapRecord, scene: Scene) -> SceneError:
    """The error of a height map that does not fit its scene."""
    wrong = f"The height map '{record.file}' does not belong to the scene '{scene.path}'"
    return SceneError(f"{wrong}: run 'Reconstruct heights' again.")
