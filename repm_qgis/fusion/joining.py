"""The tiles joined: their candidates on the cells of the whole DSM, and the ground on which shadows lie."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterator, List, Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatImage, Window
from ..contracts.errors import EmptyResultError
from ..contracts.options import DsmFuseOptions
from ..geometry.cell_grid import overlapping_blocks
from ..imagery.raster import RasterFrame, created, opened, read
from ..scene import Scene
from .aggregation import FIELDS, Candidate, FusedCells
from .feathering import feathered
from .layout import DsmLayout
from .parameters import FUSION, FusionParameters
from .shaded import Sun, halo, shaded_ground, support
from .tile_fusion import FusedTile, StoredTile


@dataclass(frozen=True)
class JoinedTiles:
    """The candidates of all tiles on the ``crop`` of the layout, blended along the seams: temporary rasters. Second
    candidates exist only where heights are chosen, and the ground in shadows only where the sun is known. ``removed``
    cells had too few neighbours."""

    crop: Window
    path: str
    removed: int
    shaded: str = ""

    def fused(self, window: Window) -> FusedCells:
        """The candidates of a window of the crop; heights in m above the ellipsoid."""
        with opened(self.path) as dataset:
            return FusedCells.of([read(dataset, window, band) for band in range(1, dataset.RasterCount + 1)])

    def first(self, window: Window) -> Candidate:
        """The first candidates of a window of the crop alone."""
        with opened(self.path) as dataset:
            return Candidate.of(read(dataset, window, band) for band in range(1, FIELDS + 1))

    def first_heights(self, window: Window) -> FloatImage:
        """(H, W) the initial heights: those of the first candidates, and in shadows the ground."""
        ground = self.ground(window)
        with opened(self.path) as dataset:
            return np.where(np.isfinite(ground), ground, read(dataset, window, 1))

    def ground(self, window: Window) -> FloatImage:
        """(H, W) the ground in shadows, for the cells of a window where shadows lie on it; NaN for others."""
        if not self.shaded:
            return np.full((window.height, window.width), np.nan, np.float32)
        with opened(self.shaded) as dataset:
            return read(dataset, window, 1)


def join_tiles(
    options: DsmFuseOptions,
    scene: Scene,
    layout: DsmLayout,
    *,
    stored: Sequence[StoredTile],
    folder: str,
    walls: bool,
    parameters: FusionParameters = FUSION,
) -> JoinedTiles:
    """Write the candidates of all tiles into one raster in ``folder``, and of a scene with ``walls`` the ground in
    shadows.

    Raises EmptyResultError where no cell has a height, WorkspaceError where a file cannot be written.
    """
    if not any(tile.valid for tile in stored):
        cells = sum(tile.cells for tile in stored)
        raise EmptyResultError(f"No cell of the DSM has a height (cells: {cells}): check the reconstruction's report.")
    crop, path, shaded = _known_part(layout, stored), f"{folder}/joined.tif", f"{folder}/shaded.tif"
    shape, count = (crop.height, crop.width), 2 * FIELDS + 1 if walls else FIELDS + 1
    with created(path, RasterFrame(shape, np.float32, count), compress=False) as raster:
        for window, result in _feathered(scene, layout, stored, parameters):
            common = window.common(crop)
            if common is None:
                continue
            place, inner = common.within(crop), common.inside(window)
            fused = result.fused
            for band, values in enumerate(fused.arrays() if walls else fused.without_choice(), start=1):
                part = values[inner]
                if result.own is not None:
                    part = np.where(result.own[inner], part, np.float32(np.nan))
                raster.write(part, place.col, place.row, band, result.own is not None)
    joined = JoinedTiles(crop, path, sum(tile.removed for tile in stored))
    sun = Sun.over(scene, layout.crs, parameters.shaded) if walls and options.fill != "none" else None
    if sun is None:
        return joined
    with created(shaded, RasterFrame(shape, np.float32), compress=False) as raster:
        cell, numbers = layout.grid.cell, parameters.shaded
        for own, wide in overlapping_blocks(
            (crop.width, crop.height), parameters.hole_block_cells, halo(cell, numbers)
        ):
            first = joined.first(wide)
            corner = layout.grid.part(crop).part(wide)
            origin = -round(corner.north / cell), round(corner.west / cell)
            found = shaded_ground(first.height, support(first, numbers), cell, sun, numbers, origin)
            raster.write(found[own.inside(wide)], own.col, own.row)
    return replace(joined, shaded=shaded)


def _feathered(
    scene: Scene, layout: DsmLayout, stored: Sequence[StoredTile], parameters: FusionParameters
) -> Iterator[Tuple[Window, FusedTile]]:
    """The window of each tile and the tile, its heights blended with its neighbours'."""
    metres = [record.metres_per_px for tile in scene.tiles for record in tile.heights]
    for index, (window, tile) in enumerate(zip(layout.windows, stored)):
        result = tile.load()
        # Turned tiles overlap in their windows: there each tile has only its own cells.
        if result.own is None:
            height = feathered(
                result.fused.height,
                index,
                layout.windows,
                stored=stored,
                size=layout.grid.size,
                tolerance=float(np.median(metres)),
                margin=parameters.feather_cells,
            )
            result = replace(result, fused=result.fused.with_height(height.astype(np.float32)))
        yield window, result


def _known_part(layout: DsmLayout, stored: Sequence[StoredTile]) -> Window:
    """The window of the grid that holds all heights: tiles extend beyond the area that the images see."""
    ends: List[Tuple[int, int, int, int]] = []
    for window, tile in zip(layout.windows, stored):
        if tile.known is not None:
            col, row = window.col + tile.known.col, window.row + tile.known.row
            ends.append((col, row, col + tile.known.width, row + tile.known.height))
    first_cols, first_rows, end_cols, end_rows = zip(*ends)
    return Window.spanning(min(first_cols), min(first_rows), max(end_cols), max(end_rows))
