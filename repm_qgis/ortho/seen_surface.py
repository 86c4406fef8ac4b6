"""The finished DSM as views see it, block by block, on its own cells or on finer ones; and the raster that the blocks
of an orthophoto make."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Optional, Sequence, Tuple

import numpy as np
import pyproj

from ..contracts.arrays import Floats, Mask, Window
from ..fusion.finished import FinishedSurface
from ..fusion.visible import horizon, slope_over
from ..geometry.cell_grid import CellGrid
from ..geometry.finer_cells import FinerCells
from ..geometry.footprints import ray_slope
from ..geometry.frames import geodetic_from_projected
from ..geometry.gridding import surface_step
from ..imagery.raster import NODATA, RasterFrame, created, opened
from ..runtime.parallel import run_whole
from ..runtime.progress import Progress
from ..scene import View
from .parameters import ORTHO, OrthoParameters


@dataclass(frozen=True)
class SeenSurface:
    """A finished DSM and the ``cells`` of an orthophoto on it; the middle of its heights (``level``, m above its
    datum), and how many of the DSM's cells away its surface may hide something (``reach``)."""

    dsm: FinishedSurface
    cells: FinerCells
    level: float
    reach: int
    parameters: OrthoParameters = ORTHO

    @classmethod
    def of(
        cls, dsm: FinishedSurface, views: Sequence[View], parameters: OrthoParameters = ORTHO, cell: float = 0.0
    ) -> SeenSurface:
        """As far as the most oblique of these views needs it, or the parameters allow; on cells of a side (m), 0 for
        the DSM's own."""
        middle = geodetic_from_projected(dsm.layout.crs, np.array(dsm.grid.middle))
        low, high = dsm.levels()
        steepest = max(float(np.linalg.norm(ray_slope(view, middle, (low + high) / 2))) for view in views)
        reach = min(math.ceil((high - low) * steepest / dsm.grid.cell) + 1, parameters.reach_cells)
        return cls(dsm, FinerCells.over(dsm.grid, cell or dsm.grid.cell), (low + high) / 2, reach, parameters)

    @property
    def grid(self) -> CellGrid:
        """The orthophoto's cells."""
        return self.cells.fine

    @property
    def kernel(self) -> str:
        """How pixels are interpolated: nothing is lost of what cells of the images' own size can show."""
        return "bilinear" if self.cells.same else self.parameters.kernel

    def on_dsm(self) -> SeenSurface:
        """The same surface with the DSM's cells."""
        return replace(self, cells=FinerCells.over(self.dsm.grid, self.dsm.grid.cell))

    def heights(self, window: Window) -> Floats:
        """(H, W) heights of a window of the orthophoto's cells, m above the ellipsoid; NaN where the DSM has none."""
        place = self.cells.around(window)
        return self.cells.spread(self.dsm.heights(place), place, window, self._step)

    def seen(self, view: View, window: Window, height: Floats) -> Mask:
        """(H, W) the cells of a window of these heights (m above the ellipsoid) that nothing hides from a view, inside
        the window or around it.

        On finer cells than the DSM's, too, its own cells hide: their horizon is interpolated as the heights are.
        """
        grid, crs, place = self.dsm.grid, self.dsm.layout.crs, self.cells.around(window)
        middle = geodetic_from_projected(crs, np.array(grid.part(place).middle))
        east, north = ray_slope(view, middle, float(np.nanmedian(height)))
        steepness = max(math.hypot(east, north), 1e-9)
        right, up = (int(self.reach * way / steepness) for way in (east, north))
        wide = Window.spanning(
            max(place.col + min(right, 0), 0),
            max(place.row - max(up, 0), 0),
            min(place.col + place.width + max(right, 0), grid.size[0]),
            min(place.row + place.height - min(up, 0), grid.size[1]),
        )
        cells, heights = grid.part(wide), self.dsm.heights(wide)
        above = horizon(slope_over(view, cells, heights, crs), cells, heights)
        limit = self.cells.spread(above, wide, window, self._step)
        with np.errstate(invalid="ignore"):
            mask: Mask = np.isfinite(height) & ~(limit > height + self.parameters.visibility.clearance_m)
        return mask

    @property
    def _step(self) -> float:
        return surface_step(self.dsm.grid.cell, self.parameters.gridding)


@dataclass(frozen=True)
class Blocks:
    """An orthophoto in parts: the windows of its cells, and the files of (B, H, W) values that they have.

    ``names`` and ``kind`` are those of its bands and numbers, ``nodata`` None is that of rasters of heights;
    ``natural``: the first bands are red, green and blue.
    """

    dsm: FinishedSurface
    grid: CellGrid
    parts: Tuple[Tuple[Window, str], ...]
    names: Tuple[str, ...]
    kind: str = "float32"
    nodata: Optional[float] = None
    natural: bool = False


def write_blocks(path: str, blocks: Blocks, progress: Progress) -> None:
    """Put an orthophoto together. Raises WorkspaceError where the file cannot be written."""
    run_whole(_written, (path, blocks), progress, "writing the products")


def _written(task: Tuple[str, Blocks], progress: Progress) -> None:
    path, blocks = task
    dsm = blocks.dsm
    with opened(dsm.path) as dataset:
        metadata = dataset.GetMetadata()
    kept = {name: value for name, value in metadata.items() if name in ("REPM_SCENE", "REPM_ENGINE")}
    grid, wkt = blocks.grid, pyproj.CRS.from_user_input(dsm.layout.crs).to_wkt()
    frame = RasterFrame(grid.shape, blocks.kind, len(blocks.names), grid.geotransform, wkt)
    empty = NODATA if blocks.nodata is None else blocks.nodata
    with created(path, frame, nodata=empty, descriptions=blocks.names, metadata=kept, cog=True) as raster:
        if blocks.natural:
            raster.set_natural_colours()
        for own, file in blocks.parts:
            for band, values in enumerate(np.load(file, allow_pickle=False), start=1):
                raster.write(values, own.col, own.row, band)
