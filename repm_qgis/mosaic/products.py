"""The rasters of a mosaic, written by workers from its blocks: GeoTIFFs, or tiles and a VRT that shows them as one."""

from __future__ import annotations

import os
import re
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import ContextManager, Dict, Iterator, List, Sequence, Tuple

import numpy as np

from .. import __version__
from ..contracts.arrays import FloatImage, Window
from ..contracts.errors import WorkspaceError
from ..contracts.options import MosaicOptions
from ..contracts.products import product, tiles_folder
from ..geometry.cell_grid import CellGrid, overlapping_blocks
from ..geometry.vertical import TAG
from ..imagery.raster import RasterFrame, RasterWriter, created
from ..imagery.vrt import Mosaicked, vrt_text
from ..reports.styles import write_style
from ..runtime.parallel import run_tasks, run_whole
from ..runtime.progress import Part, Progress
from ..runtime.workspace import foreign_entries, whole_file, whole_folder
from .blocks import Block
from .inputs import Layout
from .parameters import MosaicParameters

SOURCE_BANDS = (
    "number of the DSM that the height is from, in the order given, from 1",
    "DSMs that have a height",
    "standard deviation between them (m)",
)
OVERVIEW_STEP = 16
"""How many cells of a tile one cell of the VRT's overview is wide: with it, and the tiles' own overviews, a map of any
scale reads few files. Blocks are whole multiples of it."""
_OURS = re.compile(r"[0-9a-f]{8}_(\d+_\d+|overview)\.tif(\.aux\.xml)?")

Stored = Tuple[Window, str]
"""The cells of a block in the mosaic, and its file."""


@dataclass(frozen=True)
class MosaicRaster:
    """One raster of a mosaic: the option that names it, its file, the blocks' ``arrays`` that its bands have, and the
    facts that :func:`~repm_qgis.imagery.raster.created` takes."""

    option: str
    path: str
    arrays: Tuple[str, ...]
    bands: Tuple[str, ...]
    crs: str
    metadata: Dict[str, object]
    unit: str = ""
    overviews: str = "AVERAGE"

    def created(self, path: str, grid: CellGrid) -> ContextManager[RasterWriter]:
        """The raster, or a part of it, on cells of its own."""
        return created(
            path,
            RasterFrame(grid.shape, np.float32, len(self.bands), grid.geotransform, self.crs),
            descriptions=self.bands,
            metadata=self.metadata,
            unit=self.unit,
            cog=True,
            overviews=self.overviews,
        )

    def values(self, path: str) -> Iterator[FloatImage]:
        """The bands of a block, NaN where it has no height."""
        with np.load(path, allow_pickle=False) as made:
            known = np.isfinite(made["height"])
            for name in self.arrays:
                values = made[name] + 1 if name == "source" else made[name]  # people count from 1
                yield np.where(known, values, np.nan).astype(np.float32)


def rasters_of(options: MosaicOptions, layout: Layout) -> List[MosaicRaster]:
    """The rasters that are asked for."""
    facts: Dict[str, object] = {"REPM_ENGINE": __version__, "REPM_MOSAIC": len(layout.dsms)}
    if layout.datum:
        facts[TAG] = layout.datum.name
    height = f"height above the {layout.datum.name} (m)" if layout.datum else "height (m)"
    found = [MosaicRaster("output", options.output, ("height",), (height,), layout.file_crs, facts, "m")]
    if options.sources:
        names = {f"DSM_{number}": dsm.name for number, dsm in enumerate(layout.dsms, start=1)}
        arrays, metadata = ("source", "count", "spread"), {**facts, **names}
        # Numbers of DSMs must not be averaged.
        found.append(
            MosaicRaster("sources", options.sources, arrays, SOURCE_BANDS, layout.crs, metadata, overviews="NEAREST")
        )
    return found


def require_tiles_place(path: str) -> None:
    """Check that the folder for a VRT's tiles, which is replaced, holds nothing else; raises WorkspaceError."""
    folder = Path(tiles_folder(path)) if tiles_folder(path) else None
    others = foreign_entries(folder, lambda name: bool(_OURS.fullmatch(name))) if folder else []
    if others:
        reason = f"holds '{others[0]}', which is no tile of a mosaic and would be lost"
        raise WorkspaceError(f"The folder '{folder}' for the tiles of '{path}' {reason}: choose another name.")


def write_mosaic(
    rasters: Sequence[MosaicRaster],
    grid: CellGrid,
    blocks: Sequence[Block],
    *,
    folder: str,
    workers: int,
    parameters: MosaicParameters,
    progress: Progress,
) -> None:
    """Write the rasters with their styles; they get their names when all of them are complete.

    ``folder`` is for what lies between, and its name is the fingerprint of the mosaic. Raises WorkspaceError.
    """
    stored = [(block.own, block.path) for block in blocks if block.path is not None]
    files = [raster for raster in rasters if not tiles_folder(raster.path)]
    vrts = [raster for raster in rasters if tiles_folder(raster.path)]
    with ExitStack() as stack:
        for index, raster in enumerate(vrts):
            part = Part(progress, index / len(rasters), (index + 1) / len(rasters))
            stack.enter_context(
                _tiled(raster, grid, stored, folder=folder, workers=workers, parameters=parameters, progress=part)
            )
        if files:
            rest = Part(progress, len(vrts) / len(rasters), 1.0)
            run_whole(_write_files, (files, grid, stored), rest, "writing the mosaic")
    run_whole(_write_styles, [(raster.option, raster.path) for raster in rasters], progress, "styles of the mosaic")


def _write_styles(made: Sequence[Tuple[str, str]], progress: Progress) -> None:
    for option, path in made:
        write_style(product("mosaic", option).style, path)


def _write_files(task: Tuple[Sequence[MosaicRaster], CellGrid, Sequence[Stored]], progress: Progress) -> None:
    """GeoTIFFs of all cells."""
    rasters, grid, blocks = task
    with ExitStack() as stack:
        files = [(raster, stack.enter_context(raster.created(raster.path, grid))) for raster in rasters]
        row = 0
        for index, (own, path) in enumerate(blocks):
            progress.check_cancelled()
            progress.step(index / len(blocks), "writing the mosaic")
            for raster, file in files:
                if own.row > row:
                    file.flush()  # so that GDAL's cache does not grow
                for band, values in enumerate(raster.values(path), start=1):
                    file.write(values, own.col, own.row, band)
            row = own.row


# A VRT and its tiles ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TileTask:
    """A tile of a raster: its file and cells, the mosaic's ``grid``, the blocks that it consists of, and the file for
    its share of the overview."""

    raster: MosaicRaster
    path: str
    window: Window
    grid: CellGrid
    blocks: Tuple[Stored, ...]
    reduced: str


@contextmanager
def _tiled(
    raster: MosaicRaster,
    grid: CellGrid,
    blocks: Sequence[Stored],
    *,
    folder: str,
    workers: int,
    parameters: MosaicParameters,
    progress: Progress,
) -> Iterator[None]:
    """A VRT and the folder of its tiles, which take their names after the block.

    At every moment there is a VRT whose tiles are all there: old and new tiles have different names, and both are in
    the folder until the VRT is replaced.
    """
    place = tiles_folder(raster.path)
    key = os.path.basename(folder)[:8]
    with whole_file(raster.path) as vrt, whole_folder(place) as new:
        tasks = _tile_tasks(raster, grid, blocks, folder, f"{new}/{key}", parameters)
        run_tasks(write_tile, tasks, workers, progress, lambda task: f"writing the tile {os.path.basename(task.path)}")
        overview = f"{new}/{key}_overview.tif"
        run_whole(_write_overview, (overview, raster, grid, tasks), progress, "writing the overview")
        names = [os.path.join(place, os.path.basename(task.path)) for task in tasks]
        shown = Mosaicked(
            grid.size,
            grid.geotransform,
            raster.crs,
            raster.bands,
            raster.metadata,
            raster.unit,
            [(name, task.window) for name, task in zip(names, tasks)],
            os.path.join(place, os.path.basename(overview)),
        )
        with open(vrt, "w", encoding="utf-8") as stream:
            stream.write(vrt_text(shown, os.path.dirname(raster.path)))
        yield
        older = [each.name for each in Path(place).glob("*") if not (new / each.name).exists()]
        for name in older:
            with suppress(OSError):  # a disk without links: the old VRT has its tiles until the folder is replaced
                os.link(os.path.join(place, name), new / name)
    for name in older:
        with suppress(OSError):
            os.unlink(os.path.join(place, name))


def _tile_tasks(
    raster: MosaicRaster,
    grid: CellGrid,
    blocks: Sequence[Stored],
    folder: str,
    stem: str,
    parameters: MosaicParameters,
) -> List[TileTask]:
    """The tiles with a height, row by row; ``stem`` begins their paths."""
    side = parameters.tile_blocks * parameters.block_cells
    inside: Dict[Tuple[int, int], List[Stored]] = {}
    for own, path in blocks:
        inside.setdefault((own.row // side, own.col // side), []).append((own, path))
    found = []
    for window, _ in overlapping_blocks(grid.size, side):
        row, col = window.row // side, window.col // side
        here = inside.get((row, col))
        if here:
            reduced = f"{folder}/{raster.option}_{row}_{col}.npy"
            found.append(TileTask(raster, f"{stem}_{row}_{col}.tif", window, grid, tuple(here), reduced))
    return found


def write_tile(task: TileTask) -> None:
    """Write a tile, and its share of the overview: of each band (rows, columns) with one cell for many."""
    window, step = task.window, OVERVIEW_STEP
    shape = len(task.raster.bands), -(-window.height // step), -(-window.width // step)
    reduced = np.full(shape, np.nan, np.float32)
    with task.raster.created(task.path, task.grid.part(window)) as file:
        for own, path in task.blocks:
            col, row = own.col - window.col, own.row - window.row
            for band, values in enumerate(task.raster.values(path), start=1):
                file.write(values, col, row, band)
                cells = _reduced(values, task.raster.overviews == "AVERAGE")
                top, left = row // step, col // step
                reduced[band - 1, top : top + cells.shape[0], left : left + cells.shape[1]] = cells
    np.save(task.reduced, reduced)


def _reduced(values: FloatImage, averaged: bool) -> FloatImage:
    """One cell for many: their mean, or the first of them."""
    step = OVERVIEW_STEP
    if not averaged:
        return values[::step, ::step]
    rows, columns = (-(-count // step) for count in values.shape)
    whole = np.full((rows * step, columns * step), np.nan, np.float32)
    whole[: values.shape[0], : values.shape[1]] = values
    parts = whole.reshape(rows, step, columns, step)
    known = np.isfinite(parts)
    count = known.sum(axis=(1, 3))
    total = np.where(known, parts, np.float32(0)).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _write_overview(task: Tuple[str, MosaicRaster, CellGrid, Sequence[TileTask]], progress: Progress) -> None:
    """All tiles in larger cells, as one file with overviews of its own."""
    path, raster, grid, tiles = task
    rows, columns = (-(-count // OVERVIEW_STEP) for count in grid.shape)
    with raster.created(path, CellGrid(grid.west, grid.north, grid.cell * OVERVIEW_STEP, (rows, columns))) as file:
        for tile in tiles:
            progress.check_cancelled()
            for band, values in enumerate(np.load(tile.reduced, allow_pickle=False), start=1):
                file.write(values, tile.window.col // OVERVIEW_STEP, tile.window.row // OVERVIEW_STEP, band)
            file.flush()
