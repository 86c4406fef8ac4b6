"""Heights that other views look through.

Where a map has a height for a pixel, nothing stands on that pixel's line of sight above it. A fused height that lies on
lines of sight of other maps, above what these see there, cannot be right unless they are wrong; those that see the same
height there support it. Counting both is the stability of Merrell et al. 2007, "Real-time visibility-based fusion of
depth maps".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, FloatImage, Floats, IntArray
from ..geometry.cell_grid import CellGrid
from ..stereo.height_maps import HeightMap
from .parameters import FUSION, SightLineParameters

Counts = NDArray[np.int16]


@dataclass(frozen=True)
class SightLines:
    """What one map sees along its pixels' lines of sight.

    ``height`` (H, W) of its matched pixels, m, NaN = none; ``top`` is the highest of each pixel and those
    around it. ``to_pixel`` (6, 2) are the coefficients of a quadratic polynomial that takes the ground where a line of
    sight crosses the height ``level`` to column and row; ground is counted from ``origin``. ``ray`` is that of the map,
    and ``metres_per_px`` its height of one px of disparity.
    """

    height: FloatImage
    top: FloatImage
    to_pixel: FloatArray
    origin: Tuple[float, float]
    level: float
    ray: Tuple[float, float]
    metres_per_px: float

    @classmethod
    def of(
        cls, heights: HeightMap, metres_per_px: float, parameters: SightLineParameters = FUSION.sight_lines
    ) -> Optional[SightLines]:
        """Those of a height map's own matches; None where it has too few to tell where its lines of sight run."""
        rows, columns = np.nonzero(np.isfinite(heights.height) & ~heights.filled)
        if len(rows) < parameters.least_pixels:
            return None
        own = np.where(heights.filled, np.nan, heights.height).astype(np.float32)
        every = max(1, len(rows) // parameters.fitted_pixels)
        row, column = rows[::every], columns[::every]
        x, y, z = (values[row, column] for values in (heights.x, heights.y, heights.height))
        level, origin = float(z.mean()), (float(x.mean()), float(y.mean()))
        terms = _terms(x - origin[0] - (z - level) * heights.ray[0], y - origin[1] - (z - level) * heights.ray[1])
        scale = np.abs(terms).max(axis=0) + 1e-9
        fit = np.linalg.lstsq(terms / scale, np.column_stack([column, row]).astype(np.float64), rcond=None)[0]
        side = 2 * parameters.rim_px + 1
        top = cv2.dilate(np.where(np.isfinite(own), own, np.float32(-np.inf)), np.ones((side, side), np.uint8))
        return cls(own, top, fit / scale[:, None], origin, level, heights.ray, metres_per_px)

    def pixels(self, x: Floats, y: Floats, z: Floats) -> Tuple[IntArray, IntArray]:
        """(N,) column and row of the pixel that sees each of N ground points; -1 outside the map."""
        up = z.astype(np.float64) - self.level
        terms = _terms(x - self.origin[0] - up * self.ray[0], y - self.origin[1] - up * self.ray[1])
        column, row = np.rint(terms @ self.to_pixel).astype(np.int64).T
        outside = (column < 0) | (row < 0) | (column >= self.height.shape[1]) | (row >= self.height.shape[0])
        return np.where(outside, -1, column), np.where(outside, -1, row)


class Witnesses:
    """All maps of a grid as witnesses of its heights."""

    def __init__(
        self, grid: CellGrid, maps: Sequence[SightLines], parameters: SightLineParameters = FUSION.sight_lines
    ) -> None:
        self._maps, self._p = maps, parameters
        self._x, self._y = grid.centres()

    def counts(self, cells: IntArray, height: Floats) -> Tuple[Counts, Counts]:
        """(N,) by how many maps the heights (m) of N cells are seen, and how many look through them."""
        row, column = np.divmod(cells, len(self._x))
        x, y = self._x[column], self._y[row]
        seen, seen_through = np.zeros((2, len(cells)), np.int16)
        for one in self._maps:
            u, v = one.pixels(x, y, height)
            there, top = (np.where(u >= 0, values[v, u], np.float32(np.nan)) for values in (one.height, one.top))
            with np.errstate(invalid="ignore"):
                seen += np.abs(there - height) <= self._p.same_px * one.metres_per_px
                seen_through += np.isfinite(there) & (top < height - self._p.through_px * one.metres_per_px)
        return seen, seen_through


def _terms(x: Floats, y: Floats) -> FloatArray:
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
