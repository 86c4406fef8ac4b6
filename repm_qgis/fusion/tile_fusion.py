"""Fusing the height maps of one tile into its cells of the DSM."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass, replace
from typing import List, Optional, Sequence, Tuple

import numpy as np

from ..contracts.arrays import Bounds, Floats, Mask, Window
from ..contracts.options import LEARNED
from ..contracts.record import Record
from ..contracts.records import FilePath, HeightMapRecord
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..geometry.gridding import grid_points, surface_step
from ..matching.backends import height_source
from ..matching.parameters import MATCHING, MatchingParameters
from ..runtime.spare_cores import side_by_side, spread
from ..runtime.workspace import whole_file, write_text
from ..scene import Scene
from ..stereo.height_maps import HeightMap, HeightSource, checksum_of, require_whole
from .aggregation import FIELDS, FusedCells, HeightLayer, aggregate, rim_cells
from .layout import own_cells
from .occluded import occluded_ground
from .outliers import radius_outliers, remove_isolated_points
from .parameters import FUSION, FusionParameters


@dataclass(frozen=True)
class FuseTask:
    """All a worker needs to fuse one tile.

    ``scene`` without its tiles; ``bounds`` are the tile's, ``window`` has the tile's cells in the whole ``grid``.
    ``method`` and ``fill`` are options, ``radius`` (m) is that of the outlier filter, 0 for none. Each ``step``-th
    pixel of the height maps is taken.
    """

    scene: Scene
    bounds: Bounds
    records: Tuple[HeightMapRecord, ...]
    grid: CellGrid
    window: Window
    crs: str
    method: str = "median"
    fill: str = "occlusions"
    radius: float = 0.0
    step: int = 1
    parameters: FusionParameters = FUSION
    matching: MatchingParameters = MATCHING


@dataclass(frozen=True)
class FusedTile:
    """A tile's own cells.

    ``removed`` cells had too few neighbours. ``wide`` are the heights with the margin for feathering,
    within the whole grid. ``own`` are the window's cells that belong to the tile; None stands for all.
    """

    fused: FusedCells
    removed: int
    wide: Floats
    own: Optional[Mask] = None


@dataclass(frozen=True)
class StoredTile(Record):
    """A fused tile on disk, and the facts that the layout of the DSM needs, which lie beside it.

    ``valid`` counts the cells with a height, ``cells`` the tile's own. ``known`` is the part of the window that holds
    all heights, None where there are none. ``wide_checksum`` is that of the heights with the margin; the other file has
    checksums of its own. ``reused``: an earlier, stopped run had fused the tile.
    """

    path: FilePath
    valid: int
    cells: int
    removed: int
    known: Optional[Window]
    wide_checksum: str
    reused: bool = False

    @classmethod
    def finished(cls, path: str) -> Optional[StoredTile]:
        """The tile that an earlier run has stored at a path; None where it is not there as a whole."""
        try:
            with open(_facts_file(path), encoding="utf-8") as stream:
                tile = replace(cls.from_mapping(json.load(stream)), path=path, reused=True)
            tile.load()  # which compares the checksums that the file has
            if checksum_of([np.asarray(tile.wide())]) != tile.wide_checksum:
                return None
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            return None
        return tile

    def load(self) -> FusedTile:
        """The tile's cells again, in the precision that products have."""
        with np.load(self.path, allow_pickle=False) as kept:
            fused, own = FusedCells.of(list(kept["cells"])), kept["own"] if "own" in kept.files else None
        return FusedTile(fused, self.removed, self.wide(), own)

    def wide(self) -> Floats:
        """The heights with the margin; they are read from the file only where they are used."""
        heights: Floats = np.load(wide_file(self.path), mmap_mode="r", allow_pickle=False)
        return heights


def wide_file(path: str) -> str:
    """The file that holds a stored tile's heights with the margin."""
    return path + ".wide.npy"


def _facts_file(path: str) -> str:
    """The file with the facts of a :class:`StoredTile`; it is written last, so that the other files are complete."""
    return path + ".json"


def fuse_to_disk(work: Tuple[FuseTask, str]) -> StoredTile:
    """Fuse a tile and keep it in a file, so that memory does not grow with the number of tiles.

    A tile that an earlier, stopped run has stored there is taken as it is.
    """
    task, path = work
    done = StoredTile.finished(path)
    if done is not None:
        return done
    tile = fuse_tile(task)
    known, own = np.isfinite(tile.fused.height), {} if tile.own is None else {"own": tile.own}
    wide = tile.wide.astype(np.float32)

    def keep_cells() -> None:
        with whole_file(path) as temporary, open(temporary, "wb") as stream:
            np.savez(stream, cells=np.stack(tile.fused.arrays()), **own)

    def keep_wide() -> None:
        with whole_file(wide_file(path)) as temporary, open(temporary, "wb") as stream:
            np.save(stream, wide)

    # The disk has both before the facts say so: after a power cut a file may be there and hold zeros.
    side_by_side(keep_cells, keep_wide)
    columns, rows = (np.flatnonzero(known.any(axis=axis)) for axis in (0, 1))
    ends = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1) if columns.size else ()
    stored = StoredTile(
        path,
        valid=int(known.sum()),
        cells=known.size if tile.own is None else int(tile.own.sum()),
        removed=tile.removed,
        known=Window.spanning(*map(int, ends)) if ends else None,
        wide_checksum=checksum_of([wide]),
    )
    write_text(_facts_file(path), json.dumps(stored.to_mapping()))
    return stored


def fuse_tile(task: FuseTask) -> FusedTile:
    """Grid each height map, aggregate, remove outliers, and cut the result to the tile's own cells."""
    wide = task.window.grown(task.parameters.feather_cells, task.grid.size)
    grid = task.grid.part(wide)
    if task.step == 1:  # where only some pixels are read, GDAL's own checks of the blocks that are read have to do
        spread(require_whole, task.records)
    sources = spread(lambda each: height_source(task.scene, task.bounds, each, task.crs, task.matching), task.records)
    fused = _fuse_blocks(task, grid, sources)
    if task.fill == "none":
        fused = fused.without_backgrounds()
    removed = 0
    if task.radius > 0:
        outliers = radius_outliers(fused.height, grid.cell, task.radius, task.parameters.outliers)
        removed = int(outliers.sum())
        fused = fused.without(outliers)
    inner = task.window.inside(wide)
    cut = FusedCells.of([values[inner] for values in fused.arrays()])
    own = own_cells(task.grid.part(task.window), task.crs, task.bounds, task.scene.crs)
    if own is not None:
        cut = cut.without(~own)
    return FusedTile(cut, removed, fused.height, own)


def _fuse_blocks(task: FuseTask, grid: CellGrid, sources: Sequence[HeightSource]) -> FusedCells:
    """The fused cells of a grid, in blocks that bound the memory and overlap by the reach of the aggregation."""
    parameters = task.parameters
    spacings = [task.step * task.scene.matched_gsd_m(record.pair) for record in task.records]
    sides = [task.step * task.scene.matched_side_m(record.pair) for record in task.records]
    rim = rim_cells(max(spacings, default=task.scene.gsd_m), grid.cell, parameters.evidence)
    most = max((record.alike for record in task.records), default=1.0)
    whole = np.empty((2 * FIELDS + 1, *grid.shape), np.float32)
    everything = Window(0, 0, *grid.size)

    def fuse(block: Tuple[Window, Window]) -> None:
        own, wide = block
        part = grid.part(wide)
        bounds = part.bounds.grown(part.cell)
        layers: List[HeightLayer] = []
        for source, record, spacing, apart in zip(sources, task.records, spacings, sides):
            heights = source.read(bounds, task.step)
            metres = task.step * record.metres_per_px
            alike = record.alike / most if record.cost == LEARNED else None
            layers.append(grid_height_map(part, heights, metres, spacing, parameters, apart, alike))
        fused = aggregate(layers, task.method, rim, parameters.evidence)
        inner, target = own.inside(wide), own.inside(everything)
        for array, values in zip(whole, fused.arrays()):
            array[target] = values[inner]

    spread(fuse, list(overlapping_blocks(grid.size, parameters.block_cells, rim)))
    return FusedCells.of(list(whole))


def grid_height_map(
    grid: CellGrid,
    heights: HeightMap,
    metres_per_px: float,
    spacing: float,
    parameters: FusionParameters,
    apart: float = 0.0,
    alike: Optional[float] = None,
) -> HeightLayer:
    """A height map on the cells: what was matched and, separately, the background where an occlusion hides it.
    ``spacing`` and ``apart`` are as of :func:`~repm_qgis.geometry.gridding.grid_points`.

    Cells that the background covers more than matched points do, and lies below these, have the background only.
    """
    filled = np.flatnonzero(heights.filled)
    own, gridding = np.where(heights.filled, np.nan, heights.height), parameters.gridding
    matched = remove_isolated_points(own, metres_per_px, parameters.isolated)
    distances = {"spacing": spacing, "apart": apart}
    height, score, covered = grid_points(
        grid, heights.x, heights.y, height=matched, score=heights.score, **distances, parameters=gridding
    )
    known = np.where(heights.filled, heights.height, matched)
    occluded = occluded_ground(replace(heights, height=known), parameters.step_px * metres_per_px)
    maps = (heights.x, heights.y, heights.height)
    x, y, z = (np.concatenate([part.ravel()[filled], more]) for part, more in zip(maps, occluded))
    half = parameters.covered * (grid.cell / spacing) ** 2
    if not z.size:
        return HeightLayer(
            height, score, np.full(grid.shape, np.nan), metres_per_px, spacing, covered < half, alike=alike
        )
    background, _, behind = grid_points(grid, x, y, height=z, score=np.zeros(len(z)), **distances, parameters=gridding)
    # A roof's last pixels reach into cells that are mostly occluded ground.
    with np.errstate(invalid="ignore"):
        mostly_behind = (behind > covered) & (height - background > surface_step(grid.cell, gridding))
    height[mostly_behind] = np.nan
    score[mostly_behind] = np.nan
    return HeightLayer(height, score, background, metres_per_px, spacing, covered < half, behind < half, alike)
