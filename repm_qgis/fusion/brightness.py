"""The intensity of a DSM's cells: the median of several views, so that a shadow that moved has little weight. The
intensity of a cell does not depend on the block in which it is computed: each view has one range for the whole scene,
and values are interpolated on a lattice that is fixed on the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Iterator, Optional, Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray, FloatImage, Window
from ..geometry.cell_grid import CellGrid
from ..geometry.frames import geodetic_from_projected
from ..geometry.tiles import pixel_window
from ..imagery.enhancement import Stretch, view_stretch
from ..imagery.parameters import STRETCH, StretchParameters
from ..imagery.raster import opened_masked
from ..imagery.sampling import median_of_known
from ..imagery.warping import sample_source
from ..scene import Scene, View
from .parameters import FUSION, BrightnessParameters, VisibilityParameters
from .visible import blocked, line_of_sight, nadir_first, pixels_on


@dataclass(frozen=True)
class Witnesses:
    """The views that give the intensity of cells, the most vertical ones first, with their stretches and the slopes of
    their lines of sight (m east and north for each m up); the CRS of the cells, and the scene's altitudes."""

    views: Tuple[View, ...]
    stretches: Tuple[Stretch, ...]
    slopes: Tuple[FloatArray, ...]
    crs: str
    altitudes: Altitudes

    @classmethod
    def of(cls, scene: Scene, crs: str, parameters: StretchParameters = STRETCH) -> Witnesses:
        """All views of a scene whose images are there; raises ImageError where one cannot be read."""
        views = tuple(view for view in nadir_first(scene) if not view.missing)
        place, level = np.array([scene.frame.lon, scene.frame.lat]), sum(scene.altitudes) / 2
        stretches = tuple(view_stretch(v.image, v.band, v.mask, parameters, v.part) for v in views)
        return cls(views, stretches, tuple(line_of_sight(view, place, level) for view in views), crs, scene.altitudes)


def brightness(
    witnesses: Witnesses,
    grid: CellGrid,
    height: FloatImage,
    parameters: BrightnessParameters = FUSION.brightness,
    visibility: VisibilityParameters = FUSION.visibility,
) -> FloatImage:
    """(H, W) brightness of cells with their heights (m above the ellipsoid): 0 to 1 is the range of nearly all pixels
    of a view. NaN is unknown.

    The first views that show the grid are taken, as many as the parameters say; each counts where nothing higher within
    ``hidden_cells`` hides the cell from it.
    """
    seen = list(lights(witnesses, grid, height, parameters, visibility))
    return median_of_known(np.stack(seen)) if seen else np.full(grid.shape, np.nan, np.float32)


def lights(
    witnesses: Witnesses,
    grid: CellGrid,
    height: FloatImage,
    parameters: BrightnessParameters = FUSION.brightness,
    visibility: VisibilityParameters = FUSION.visibility,
    asked: Optional[Window] = None,
) -> Iterator[FloatImage]:
    """The brightness (H, W) that each of these views shows, NaN where it does not see a cell.

    With a window ``asked``, only of the cells in it; objects on the other cells may hide them.
    """
    known = np.isfinite(height)
    if not known.any():
        return
    count, part = 0, asked.slices if asked else (slice(None), slice(None))
    to_geodetic = partial(geodetic_from_projected, witnesses.crs)
    for view, stretch, slope in zip(witnesses.views, witnesses.stretches, witnesses.slopes):
        if count == parameters.views:
            return
        shown = pixel_window(
            view.project, to_geodetic, grid.bounds, altitudes=witnesses.altitudes, size=view.size, smallest=1
        )
        if shown is None:
            continue
        with opened_masked(view.image, view.mask) as dataset:
            # OpenCV resamples at 32nds of a pixel, counted from the window that is read: these are the same in any.
            pixels = pixels_on(view, grid, height, witnesses.crs, visibility, witnesses.altitudes)[part]
            values = sample_source(dataset, view.band, np.round(pixels * 32) / 32, "bilinear")
        hidden = blocked(slope, grid, height, visibility.clearance_m, parameters.hidden_cells)
        light = (values - np.float32(stretch.low)) / np.float32(stretch.high - stretch.low)
        count += 1
        yield np.where((known & ~hidden)[part], light, np.float32(np.nan))
