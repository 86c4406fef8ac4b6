"""One pair of views over one tile: from two windows of the images to a height map on disk."""

from __future__ import annotations

import json
import math
import os
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Iterator, Optional, Tuple

import numpy as np
from numpy.typing import NDArray
from osgeo import gdal

from ..arrays import FloatImage
from ..errors import EmptyResultError, ImageError, SceneError
from ..geometry.refinement import translation
from ..imagery.enhancement import Stretch
from ..imagery.raster import opened, opened_masked, read, write
from ..imagery.warping import warp
from ..records import HeightMapRecord
from ..scene import Scene, View
from ..stereo.pairing import grown, rectified_pair
from ..stereo.rectification import RectifiedPair
from ..stereo.triangulation import PairGeometry, pair_geometry, verticals
from .backends import matcher_of
from .coarse import FACTOR, guide_of, sampled_on
from .matched import Matched
from .reliability import without_unsupported

Bounds = Tuple[float, float, float, float]

MARGIN_PX = 32  # matched beyond the tile's border, so that neighbours agree along it
_RANGE_MARGIN_PX = 6  # disparities searched beyond the altitude range
_SMALLEST_PX = 48
_KEY = "REPM_FINGERPRINT"
_RECORD = "REPM_RECORD"
_BANDS = ("height above the WGS 84 ellipsoid (m)", "matching score", "filled from the background (1)")


@dataclass(frozen=True)
class DenseTask:
    """All a worker needs: the scene without its tiles, the pair, the tile's ground and altitudes, where to write."""

    scene: Scene
    tile: str
    bounds: Tuple[float, float, float, float]
    altitudes: Tuple[float, float]
    first: str
    second: str
    stretches: Tuple[Stretch, Stretch]
    backend: str
    path: str
    key: str


def match_tile(task: DenseTask) -> Optional[HeightMapRecord]:
    """Rectify, match, and turn disparities into heights; gives the height map's record, None where nothing is shared.

    The file has three bands in the geometry of the rectified first image: height in metres above the ellipsoid, the
    matching score, and 1 where the height was not matched but taken from the background of an occlusion. A file
    that an earlier, stopped run has finished is taken as it is (``reused`` in the record).
    """
    done = finished(task.path, task.key)
    if done is not None:
        return done
    first, second = task.scene.view(task.first), task.scene.view(task.second)
    pair = _rectified(task.scene, first, second, task.bounds, task.altitudes)
    if pair is None or min(pair.size) < _SMALLEST_PX:
        return None
    try:
        geometry = pair_geometry(pair, first, second, task.altitudes, task.scene.crs)
    except EmptyResultError:
        return None
    matched = _match(task, pair, geometry, first, second)
    columns, rows = np.arange(pair.size[0], dtype=np.float64), np.arange(pair.size[1], dtype=np.float64)
    heights = geometry.height.on_grid(columns, rows, matched.disparity.astype(np.float64)).astype(np.float32)
    record = HeightMapRecord(
        tile=task.tile,
        backend=task.backend,
        pair=(task.first, task.second),
        file=task.path,
        size=pair.size,
        valid=int((np.isfinite(heights) & ~matched.filled).sum()),
        filled=int(matched.filled.sum()),
        metres_per_px=geometry.metres_per_px,
        vertical_parallax_px=geometry.row_px,
        table_error_m=geometry.error_m,
        altitudes=task.altitudes,
    )
    store(task.path, task.key, record, heights, matched.score, matched.filled)
    return record


def frame_size(task: DenseTask) -> Tuple[int, int]:
    """Width and height of the rectified frame that a tile is matched in; nothing where the views do not share it."""
    pair = _rectified(
        task.scene, task.scene.view(task.first), task.scene.view(task.second), task.bounds, task.altitudes
    )
    return pair.size if pair is not None else (0, 0)


def store(
    path: str, key: str, record: HeightMapRecord, height: FloatImage, score: FloatImage, filled: NDArray[np.bool_]
) -> None:
    """Write a height map with its record, and the key that says what it was made from."""
    write(
        path,
        [height, score, filled.astype(np.float32)],
        (0, 1, 0, 0, 0, 1),
        "",
        metadata={_KEY: key, _RECORD: json.dumps(record.to_mapping())},
        descriptions=_BANDS,
        own=True,
    )


def finished(path: str, key: str) -> Optional[HeightMapRecord]:
    """The record of a height map that is there, whole, and made from the very same things; else None."""
    if not os.path.exists(path):
        return None
    try:
        with opened(path) as dataset:
            if dataset.GetMetadataItem(_KEY) != key:
                return None
            record = HeightMapRecord.from_mapping(json.loads(dataset.GetMetadataItem(_RECORD)))
            for band in range(1, len(_BANDS) + 1):
                read(dataset, band=band)
    except (ImageError, KeyError, TypeError, ValueError):
        return None
    return replace(record, file=path, reused=True)


def _match(task: DenseTask, pair: RectifiedPair, geometry: PairGeometry, first: View, second: View) -> Matched:
    """Disparities of the pair, coarse to fine where that narrows the search."""
    low, high = _whole_range(geometry)
    width, height = pair.size
    shifted = RectifiedPair(pair.first, pair.second, pair.h_first, translation(high, 0) @ pair.h_second, pair.size)
    a = _brightness(first, task.stretches[0], pair.first_original, (width, height))
    b = _brightness(second, task.stretches[1], shifted.second_original, (width + high - low, height))
    match = matcher_of(task.backend)
    guide = guide_of(a, b, (low, high), geometry, match)
    if guide is None:
        matched = match(a, b, (low, high), geometry.nearer, geometry.lean)
    else:
        guided = _brightness(
            second,
            task.stretches[1],
            sampled_on(guide.second_original(pair, geometry)),
            (width + guide.high - guide.low, height),
        )
        matched = match(a, guided, (guide.low, guide.high), geometry.nearer, geometry.lean)
        matched = replace(matched, disparity=guide.whole(matched.disparity))
    # On whole disparities: a guide that lies on a cloud would hide how high it stands.
    return without_unsupported(matched, a, b, (low, high), geometry.nearer, geometry.metres_per_px)


def _whole_range(geometry: PairGeometry) -> Tuple[int, int]:
    """Disparities of all altitudes with their margin, in whole coarse pixels."""
    low = math.floor((geometry.disparities[0] - _RANGE_MARGIN_PX) / FACTOR) * FACTOR
    high = math.ceil((geometry.disparities[1] + _RANGE_MARGIN_PX) / FACTOR) * FACTOR
    return low, high


def _brightness(view: View, stretch: Stretch, to_original: Any, size: Tuple[int, int]) -> FloatImage:
    with opened_masked(view.image, view.mask) as dataset:
        return stretch.apply(warp(dataset, view.band, to_original, size, "cubic"))


@dataclass(frozen=True)
class HeightMap:
    """Ground points of a height map: ``x``, ``y`` in a projected CRS, ``height``, ``score``; all (H, W), NaN = none.

    ``filled`` says which heights were taken from the background of an occlusion. ``ray`` is how far x and y move along
    a pixel's line of sight, m for each m of height; ``lean`` how far column and row move up a vertical, px for each m.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    height: NDArray[np.float64]
    score: FloatImage
    filled: NDArray[np.bool_]
    ray: Tuple[float, float] = (0.0, 0.0)
    lean: Tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class HeightSource:
    """A height map on disk, of which any part can be placed on the ground.

    ``part`` are the bounds of the tile and of the part of it that the map was made for, where tiles were matched in
    parts: heights on the rest of the tile are left out, its own maps have them.
    """

    path: str
    geometry: PairGeometry
    size: Tuple[int, int]
    altitudes: Tuple[float, float]
    part: Optional[Tuple[Bounds, Bounds]] = None

    def within(self, bounds: Optional[Tuple[float, float, float, float]] = None) -> HeightMap:
        """The rectangle of pixels that holds all points in bounds (xmin, ymin, xmax, ymax); None takes all.

        Raises SceneError where the file is gone or damaged.
        """
        col, row, width, height_px = window = (0, 0, *self.size) if bounds is None else self._window(bounds)
        if not (width and height_px):
            nothing = np.empty((0, 0))
            return HeightMap(nothing, nothing, nothing, nothing.astype(np.float32), nothing.astype(bool))
        with _height_map(self.path) as dataset:
            height = read(dataset, window, 1).astype(np.float64)
            score = read(dataset, window, 2)
            filled = read(dataset, window, 3) > 0
        columns, rows = np.arange(col, col + width, dtype=np.float64), np.arange(row, row + height_px, dtype=np.float64)
        x, y = (table.on_grid(columns, rows, height) for table in (self.geometry.x, self.geometry.y))
        if self.part is not None:
            tile, own = self.part
            height = np.where(_inside(tile, x, y) & ~_inside(own, x, y), np.nan, height)
        return HeightMap(x, y, height, score, filled, *verticals(self.geometry.x, self.geometry.y))

    def _window(self, bounds: Tuple[float, float, float, float]) -> Tuple[int, int, int, int]:
        """Of the table's nodes, those whose ray may cross the bounds, and the pixels between them."""
        columns, rows = self.geometry.x.columns, self.geometry.x.rows
        ends = [
            [
                table.on_grid(columns, rows, np.full((len(rows), len(columns)), z))
                for table in (self.geometry.x, self.geometry.y)
            ]
            for z in self.altitudes
        ]
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
            return 0, 0, 0, 0
        c0, r0 = int(columns[across[0]]), int(rows[down[0]])
        return c0, r0, int(columns[across[-1]]) + 1 - c0, int(rows[down[-1]]) + 1 - r0


def _inside(bounds: Bounds, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        return (x >= bounds[0]) & (y >= bounds[1]) & (x < bounds[2]) & (y < bounds[3])


def height_source(
    scene: Scene, bounds: Tuple[float, float, float, float], record: HeightMapRecord, crs: str
) -> HeightSource:
    """A height map of the tile with these bounds, to be placed on the ground in any projected ``crs``.

    The rectification is made again from the scene: it is exact, costs a tenth of a second, and leaves nothing to
    store that could contradict it. Raises SceneError where the file is gone, or belongs to another scene.
    """
    if record.backend == "colmap":
        from ..colmap.backend import height_source as of_colmap

        return of_colmap(scene, bounds, record, crs)
    first, second = (scene.view(name) for name in record.pair)
    altitudes = record.altitudes
    pair = _rectified(scene, first, second, bounds, altitudes)
    size = map_size(record.file)
    if pair is None or pair.size != size:
        raise SceneError(
            f"The height map '{record.file}' does not belong to the scene '{scene.path}': run "
            "'Reconstruct heights' again."
        )
    return HeightSource(record.file, pair_geometry(pair, first, second, altitudes, crs), size, altitudes)


def map_size(path: str) -> Tuple[int, int]:
    """Width and height of a height map; raises SceneError where the file is gone or damaged."""
    with _height_map(path) as dataset:
        return dataset.RasterXSize, dataset.RasterYSize


@contextmanager
def _height_map(path: str) -> Iterator[gdal.Dataset]:
    """A height map's raster; raises SceneError where it is gone or damaged."""
    try:
        with opened(path) as dataset:
            yield dataset
    except ImageError as error:
        raise SceneError(
            f"The height map '{path}' is gone or damaged: delete what is left of it, and run 'Reconstruct "
            "heights' again."
        ) from error


def _rectified(
    scene: Scene, first: View, second: View, bounds: Tuple[float, float, float, float], altitudes: Tuple[float, float]
) -> Optional[RectifiedPair]:
    """The rectified pair that a tile is matched in: its ground with the matching margin."""
    return rectified_pair(scene, first, second, grown(bounds, MARGIN_PX * scene.gsd_m), altitudes)
