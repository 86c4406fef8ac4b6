"""Height maps on disk: heights in the geometry of one image of a tile, and how they are put on the ground."""

from __future__ import annotations

import json
import os
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Iterator, Optional, Tuple

import numpy as np
from osgeo import gdal

from ..arrays import Altitudes, Bounds, FloatArray, FloatImage, Mask, Size, Window
from ..errors import ImageError, SceneError
from ..imagery.raster import opened, read, write
from ..records import HeightMapRecord
from .triangulation import NodeTable, verticals

MARGIN_PX = 32  # matched beyond the tile's border, so that neighbours agree along it
_KEY = "REPM_FINGERPRINT"
_RECORD = "REPM_RECORD"
BANDS = ("height above the WGS 84 ellipsoid (m)", "matching score", "filled from the background (1)")


@dataclass(frozen=True)
class HeightMap:
    """Ground points of a height map: ``x``, ``y`` in a projected CRS, ``height``, ``score``; all (H, W), NaN = none.

    ``filled`` says which heights were taken from the background of an occlusion. ``ray`` is how far x and y move along
    a pixel's line of sight, m for each m of height; ``relief_displacement`` how far column and row move along a
    vertical, px for each m.
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
    left out, as its other parts have maps of their own.
    """

    path: str
    x: NodeTable
    y: NodeTable
    size: Size
    altitudes: Altitudes
    part: Optional[Tuple[Bounds, Bounds]] = None

    def within(self, bounds: Optional[Bounds] = None) -> HeightMap:
        """The rectangle of pixels that holds all points in bounds (xmin, ymin, xmax, ymax); None takes all.

        Raises SceneError where the file is gone or damaged.
        """
        col, row, width, height_px = window = Window(0, 0, *self.size) if bounds is None else self._window(bounds)
        if not (width and height_px):
            nothing = np.empty((0, 0))
            return HeightMap(nothing, nothing, nothing, nothing.astype(np.float32), nothing.astype(bool))
        with _opened_height_map(self.path) as dataset:
            height = read(dataset, window, 1).astype(np.float64)
            score = read(dataset, window, 2)
            filled = read(dataset, window, 3) > 0
        columns, rows = np.arange(col, col + width, dtype=np.float64), np.arange(row, row + height_px, dtype=np.float64)
        x, y = (table.on_grid(columns, rows, height) for table in (self.x, self.y))
        if self.part is not None:
            tile, own = self.part
            height = np.where(_inside(tile, x, y) & ~_inside(own, x, y), np.nan, height)
        return HeightMap(x, y, height, score, filled, *verticals(self.x, self.y))

    def _window(self, bounds: Bounds) -> Window:
        """Of the table's nodes, those whose ray may cross the bounds, and the pixels between them."""
        columns, rows = self.x.columns, self.x.rows
        levels = [np.full((len(rows), len(columns)), z) for z in self.altitudes]
        ends = [[table.on_grid(columns, rows, level) for table in (self.x, self.y)] for level in levels]
        low, high = np.minimum(*ends), np.maximum(*ends)
        # Between two nodes the ground goes on by at most one step of theirs.
        step = max(float(np.abs(np.diff(part, axis=axis)).max()) for part in (*ends[0], *ends[1]) for axis in (0, 1))
        near = (
            (high[0] >= bounds[0] - step)
            & (low[0] <= bounds[2] + step)
            & (high[1] >= bounds[1] - step)
            & (low[1] <= bounds[3] + step)
        )
        across, down = np.flatnonzero(near.any(axis=0)), np.flatnonzero(near.any(axis=1))
        if not across.size:
            return Window(0, 0, 0, 0)
        c0, r0 = int(columns[across[0]]), int(rows[down[0]])
        return Window(c0, r0, int(columns[across[-1]]) + 1 - c0, int(rows[down[-1]]) + 1 - r0)


def _inside(bounds: Bounds, x: FloatArray, y: FloatArray) -> Mask:
    with np.errstate(invalid="ignore"):
        return (x >= bounds[0]) & (y >= bounds[1]) & (x < bounds[2]) & (y < bounds[3])


def write_height_map(
    path: str, key: str, record: HeightMapRecord, height: FloatImage, score: FloatImage, filled: Mask
) -> None:
    """Write a height map with its record, and the key that says what it was made from."""
    write(
        path,
        [height, score, filled.astype(np.float32)],
        (0, 1, 0, 0, 0, 1),
        "",
        metadata={_KEY: key, _RECORD: json.dumps(record.to_mapping())},
        descriptions=BANDS,
        own=True,
    )


def finished_record(path: str, key: str) -> Optional[HeightMapRecord]:
    """The record of a height map that is there, whole, and made from the very same things; else None."""
    if not os.path.exists(path):
        return None
    try:
        with opened(path) as dataset:
            if dataset.GetMetadataItem(_KEY) != key:
                return None
            record = HeightMapRecord.from_mapping(json.loads(dataset.GetMetadataItem(_RECORD)))
            for band in range(1, len(BANDS) + 1):
                read(dataset, band=band)
    except (ImageError, KeyError, TypeError, ValueError):
        return None
    return replace(record, file=path, reused=True)


def map_size(path: str) -> Size:
    """Width and height of a height map; raises SceneError where the file is gone or damaged."""
    with _opened_height_map(path) as dataset:
        return dataset.RasterXSize, dataset.RasterYSize


@contextmanager
def _opened_height_map(path: str) -> Iterator[gdal.Dataset]:
    """A height map's raster; raises SceneError where it is gone or damaged."""
    try:
        with opened(path) as dataset:
            yield dataset
    except ImageError as error:
        raise SceneError(
            f"The height map '{path}' is gone or damaged: delete what is left of it, and run 'Reconstruct "
            "heights' again."
        ) from error
