"""From disparities to heights and ground positions: exact RPC geometry, tabulated on nodes of the rectified frame.

At each node the first image's ray is followed by its RPC (pointing included), and the places where the second RPC sees
its points give the disparities; a parabola through them is exact to a fraction of a millimetre. Between nodes the
parabolas are interpolated. So no error of the pinhole model reaches the DSM, whatever the refinement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ..contracts.arrays import Altitudes, FloatArray
from ..contracts.errors import EmptyResultError
from ..geometry.frames import projected_from_geodetic
from ..geometry.interpolation import interpolate_grid
from ..geometry.rectification import RectifiedPair
from ..scene import View
from .parameters import STEREO, StereoParameters


@dataclass(frozen=True)
class NodeTable:
    """A quantity as a parabola of a third variable on each node, bilinear between nodes.

    ``columns`` (n,) and ``rows`` (m,) are the evenly spaced places of the nodes; ``coefficients`` (3, m, n) belong to
    1, t, t^2 with t = (third - offset) / scale.
    """

    columns: FloatArray
    rows: FloatArray
    offset: float
    scale: float
    coefficients: FloatArray

    @classmethod
    def fit(
        cls, columns: FloatArray, rows: FloatArray, third: FloatArray, values: FloatArray
    ) -> Tuple["NodeTable", float]:
        """Least-squares parabolas through (levels, m, n) values of the third variable and the quantity.

        Also gives the largest remaining difference at the levels.
        """
        low, high = float(third.min()), float(third.max())
        offset, scale = (low + high) / 2, max((high - low) / 2, 1e-9)
        t = np.moveaxis((third - offset) / scale, 0, -1)
        design = np.stack([np.ones_like(t), t, t * t], axis=-1)
        target = np.moveaxis(values, 0, -1)[..., None]
        turned = np.swapaxes(design, -1, -2)  # the normal equations are well conditioned: t is -1 to 1
        solution = np.linalg.solve(turned @ design, turned @ target)
        left = float(np.abs(design @ solution - target).max())
        return cls(columns, rows, offset, scale, np.moveaxis(solution[..., 0], -1, 0)), left

    def on_grid(self, columns: FloatArray, rows: FloatArray, third: FloatArray) -> FloatArray:
        """(H, W) values on the grid of (W,) columns and (H,) rows, with (H, W) values of the third variable.

        Differences from a middle value are interpolated in single precision, which leaves less than 0.001 m on a tile.
        """
        u = (columns - self.columns[0]) / (self.columns[1] - self.columns[0])
        v = (rows - self.rows[0]) / (self.rows[1] - self.rows[0])
        t = ((third - self.offset) / self.scale).astype(np.float32)
        middle = float(self.coefficients[0].mean())
        constant, slope, bend = (self.coefficients - [[[middle]], [[0.0]], [[0.0]]]).astype(np.float32)
        value = interpolate_grid(bend, v, u)
        for coefficient in (slope, constant):
            value *= t
            value += interpolate_grid(coefficient, v, u)
        result: FloatArray = value.astype(np.float64) + middle
        return result


@dataclass(frozen=True)
class PairGeometry:
    """Heights and ground positions of the pixels of a rectified first image.

    ``height`` takes column, row, disparity (first minus second column, px) to metres above the ellipsoid, ``x`` and
    ``y`` take column, row, height to coordinates of a CRS, ``vertical_parallax`` to the row of the second image minus
    that of the first (px: what the pinhole model leaves; ``vertical_parallax_px`` is the largest). ``disparities`` is
    the range over the altitudes, ``metres_per_px`` the height for one px of disparity, ``error_m`` the largest error
    of the first three tables at their levels.
    """

    height: NodeTable
    x: NodeTable
    y: NodeTable
    vertical_parallax: NodeTable
    disparities: Tuple[float, float]
    metres_per_px: float
    error_m: float
    vertical_parallax_px: float

    @property
    def height_sign(self) -> float:
        """+1 where greater disparities are higher ground, -1 where lower."""
        return float(np.sign(np.mean(self.height.coefficients[1])))

    @property
    def relief_displacement(self) -> float:
        """Columns that a point moves in the first image if it rises by 1 px of disparity: its share of the parallax."""
        _, (columns_per_m, _) = verticals(self.x, self.y)
        return self.height_sign * columns_per_m * self.metres_per_px


def verticals(x: NodeTable, y: NodeTable) -> Tuple[Tuple[float, float], Tuple[float, float]]:
    """The lines of sight and the verticals in the middle of a frame, from tables of x and y by column, row, height.

    First x and y along a pixel's line of sight, m for each m of height; then column and row of a point that rises
    (relief displacement), px for each m. A satellite is so far away that they are valid for a whole tile.
    """
    ray = np.array([table.coefficients[1].mean() / table.scale for table in (x, y)])
    axes = ((1, x.columns[1] - x.columns[0]), (0, x.rows[1] - x.rows[0]))
    by_pixel = [[np.diff(table.coefficients[0], axis=axis).mean() / step for axis, step in axes] for table in (x, y)]
    displacement = -np.linalg.solve(np.array(by_pixel), ray)
    return (float(ray[0]), float(ray[1])), (float(displacement[0]), float(displacement[1]))


def pair_geometry(
    pair: RectifiedPair, first: View, second: View, altitudes: Altitudes, crs: str, stereo: StereoParameters = STEREO
) -> PairGeometry:
    """Tabulate the RPC intersection of two rectified views over an altitude range.

    Raises EmptyResultError where the views share no part of the frame.
    """
    columns, rows = (nodes(n, stereo.node_step_px) for n in pair.size)
    z, r, c = np.meshgrid(np.linspace(*altitudes, stereo.levels), rows, columns, indexing="ij")
    pixels = np.stack([c, r], axis=-1)
    ground = first.localise(pair.first_original(pixels), z)
    seen = pair.second_rectified(second.project(ground))
    if not (np.isfinite(seen).all() and np.isfinite(ground).all()):
        raise EmptyResultError(
            f"{first.name} and {second.name} share no ground within {altitudes[0]:.0f} to "
            f"{altitudes[1]:.0f} m: check ALTITUDE_MIN and ALTITUDE_MAX."
        )
    disparity = c - seen[..., 0]
    xy = projected_from_geodetic(crs, ground)
    height, error_h = NodeTable.fit(columns, rows, disparity, z)
    x, error_x = NodeTable.fit(columns, rows, z, xy[..., 0])
    y, error_y = NodeTable.fit(columns, rows, z, xy[..., 1])
    parallax, _ = NodeTable.fit(columns, rows, z, seen[..., 1] - r)
    slope = abs(float(np.mean(disparity[-1] - disparity[0]))) / (altitudes[1] - altitudes[0])
    ends, error_m = (float(disparity.min()), float(disparity.max())), max(error_h, error_x, error_y)
    parallax_px = float(np.abs(r - seen[..., 1]).max())
    return PairGeometry(height, x, y, parallax, ends, 1.0 / max(slope, 1e-9), error_m, parallax_px)


def nodes(size: int, step_px: int) -> FloatArray:
    """Evenly spaced positions from the first to the last pixel, at most ``step_px`` apart, at least two."""
    return np.linspace(0.0, max(size - 1, 1), max(2, -(-(size - 1) // step_px) + 1))
