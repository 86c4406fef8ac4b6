"""What multispectral images say of water: the index (fusion/water_index.py) of the cells of a DSM, from the images that
the orthophoto has its colours from, read in the same way."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterator, List, Tuple

import numpy as np

from ..contracts.arrays import FloatArray, FloatImage, Window
from ..fusion.parameters import FUSION, FusionParameters
from ..fusion.visible import blocked
from ..geometry.cell_grid import CellGrid
from ..geometry.footprints import ray_slope
from ..imagery.calibration import calibration
from ..imagery.raster import opened
from ..scene import Scene
from .colour_sources import ColourSource


@dataclass(frozen=True)
class Spectra:
    """The views with green and near infrared bands, the most vertical ones first, each with its line of sight (as in
    :class:`~repm_qgis.fusion.brightness.Witnesses`); the ``gains`` of a source are its calibration, which all have or
    none has."""

    sources: Tuple[ColourSource, ...]
    slopes: Tuple[FloatArray, ...]
    crs: str

    @classmethod
    def of(cls, scene: Scene, crs: str, sources: Tuple[ColourSource, ...]) -> Spectra:
        """Of sources whose bands are green and near infrared; those without a calibration go where others have one.

        Raises ImageError where an image cannot be opened.
        """
        found: List[ColourSource] = []
        for source in sources:
            path = source.coloured
            with opened(path) as dataset:
                known = calibration(dataset, path, dict(zip(("green", "near infrared"), source.bands)))
            if known is not None:
                found.append(replace(source, gains=known.gains, offsets=known.offsets))
        sources = tuple(found) or sources
        place, level = np.array([scene.frame.lon, scene.frame.lat]), sum(scene.altitudes) / 2
        return cls(sources, tuple(ray_slope(s.view, place, level) for s in sources), crs)

    @property
    def files(self) -> List[str]:
        """All images that are read."""
        return [path for source in self.sources for path in source.files]

    @property
    def calibrated(self) -> bool:
        """Whether an index of zero means that both bands reflect alike."""
        return all(source.gains for source in self.sources)

    def seen(
        self,
        grid: CellGrid,
        height: FloatImage,
        asked: Window,
        parameters: FusionParameters = FUSION,
    ) -> Iterator[Tuple[FloatImage, FloatImage, FloatImage]]:
        """The index, the near infrared, and the sum of both bands that each of the first views shows of the window
        ``asked`` of cells with these heights (m above the ellipsoid), NaN where it sees none. Raises ImageError where
        an image cannot be read.
        """
        p, count, own = parameters.brightness, 0, height[asked.slices]
        for source, slope in zip(self.sources, self.slopes):
            if count == p.views or not np.isfinite(own).any():
                return
            values = source.colours(grid.part(asked), own, self.crs, parameters.visibility)
            if not np.isfinite(values[0]).any():
                continue
            hidden = blocked(slope, grid, height, parameters.visibility.clearance_m, p.hidden_cells)[asked.slices]
            green, infrared = np.where(hidden, np.float32(np.nan), values)
            count += 1
            total = green + infrared
            with np.errstate(divide="ignore", invalid="ignore"):
                index = np.where(total > 0, (green - infrared) / total, np.float32(np.nan))
            yield index, infrared, total
