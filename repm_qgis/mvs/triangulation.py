"""From disparities to heights and ground positions: exact RPC geometry, tabulated as low polynomials.

Over a tile the map (column, row, disparity) -> height and the map (column, row, height) -> ground are so smooth
that cubic polynomials reproduce the RPCs' own answer to a millimetre; the fit says how well. So no error of the
pinhole model reaches the DSM.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Tuple

import numpy as np
from numpy.typing import NDArray

from ..errors import EmptyResultError
from ..geometry.frames import projected_from_geodetic
from ..scene import View
from .rectification import RectifiedPair

FloatArray = NDArray[np.float64]

_ORDER = 3
_NODES = (9, 9, 9)
_TERMS = [(i, j, k) for k in range(_ORDER + 1) for j in range(_ORDER + 1 - k) for i in range(_ORDER + 1 - k - j)]


@dataclass(frozen=True)
class GridPolynomial:
    """A cubic polynomial in column, row and a third variable, made for whole pixel grids.

    ``offset`` and ``scale`` (3,) normalise the variables; ``coefficients`` (4, 4, 4) belong to column^i row^j z^k.
    """

    offset: FloatArray
    scale: FloatArray
    coefficients: FloatArray

    @classmethod
    def fit(cls, variables: FloatArray, values: FloatArray) -> Tuple["GridPolynomial", float]:
        """Least squares from (N, 3) variables to (N,) values; also the largest error left."""
        low, high = variables.min(axis=0), variables.max(axis=0)
        offset, scale = (low + high) / 2, np.maximum((high - low) / 2, 1e-9)
        u = (variables - offset) / scale
        design = np.stack([u[:, 0] ** i * u[:, 1] ** j * u[:, 2] ** k for i, j, k in _TERMS], axis=1)
        solution, *_ = np.linalg.lstsq(design, values, rcond=None)
        coefficients = np.zeros((_ORDER + 1,) * 3)
        for (i, j, k), value in zip(_TERMS, solution):
            coefficients[i, j, k] = value
        return cls(offset, scale, coefficients), float(np.abs(design @ solution - values).max())

    def on_grid(self, columns: FloatArray, rows: FloatArray, third: FloatArray) -> FloatArray:
        """Values on the grid of (W,) columns and (H,) rows, with (H, W) values of the third variable."""
        u = np.vander((columns - self.offset[0]) / self.scale[0], _ORDER + 1, increasing=True)
        v = np.vander((rows - self.offset[1]) / self.scale[1], _ORDER + 1, increasing=True)
        w = (third - self.offset[2]) / self.scale[2]
        result = v @ self.coefficients[:, :, _ORDER].T @ u.T
        for k in range(_ORDER - 1, -1, -1):
            result = result * w + v @ self.coefficients[:, :, k].T @ u.T
        return result

    def at(self, points: FloatArray) -> FloatArray:
        """(N,) values at (N, 3) columns, rows and third variables."""
        u = (points - self.offset) / self.scale
        return sum(self.coefficients[i, j, k] * u[:, 0] ** i * u[:, 1] ** j * u[:, 2] ** k for i, j, k in _TERMS)

    def to_mapping(self) -> dict[str, Any]:
        return {"offset": self.offset.tolist(), "scale": self.scale.tolist(),
                "coefficients": self.coefficients.tolist()}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> "GridPolynomial":
        return cls(*(np.array(values[name], dtype=np.float64) for name in ("offset", "scale", "coefficients")))


@dataclass(frozen=True)
class PairGeometry:
    """Heights and ground positions of the pixels of a rectified first image.

    ``height`` takes column, row, disparity (first minus second column, px) to metres above the ellipsoid, ``x`` and
    ``y`` take column, row, height to coordinates of ``crs``. ``disparities`` is the range over the altitudes,
    ``metres_per_px`` the height that one px of disparity means, ``error_m`` the largest error of the three fits,
    ``row_px`` the largest row difference that the pinhole model leaves.
    """

    height: GridPolynomial
    x: GridPolynomial
    y: GridPolynomial
    crs: str
    disparities: Tuple[float, float]
    metres_per_px: float
    error_m: float
    row_px: float


def pair_geometry(pair: RectifiedPair, first: View, second: View, altitudes: Tuple[float, float],
                  crs: str) -> PairGeometry:
    """Tabulate the RPC intersection of two rectified views over an altitude range.

    The ray of each node of the first image is followed by its RPC (pointing included); where the second RPC sees its
    points gives the disparities. Raises EmptyResultError where the views share no part of the frame.
    """
    size = pair.size
    columns, rows, heights = np.meshgrid(
        np.linspace(0, size[0] - 1, _NODES[0]), np.linspace(0, size[1] - 1, _NODES[1]),
        np.linspace(*altitudes, _NODES[2]), indexing="ij")
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    z = heights.ravel()
    ground = first.localise(pair.first_original(pixels), z)
    seen = pair.second_rectified(second.project(ground))
    known = np.isfinite(seen).all(axis=1) & np.isfinite(ground).all(axis=1)
    if known.sum() < 100:
        raise EmptyResultError(f"{first.name} and {second.name} share no ground within {altitudes[0]:.0f} to "
                               f"{altitudes[1]:.0f} m: check ALTITUDE_MIN and ALTITUDE_MAX.")
    pixels, z, ground, seen = pixels[known], z[known], ground[known], seen[known]
    disparity = pixels[:, 0] - seen[:, 0]
    xy = projected_from_geodetic(crs, ground)
    height, error_h = GridPolynomial.fit(np.column_stack([pixels, disparity]), z)
    x, error_x = GridPolynomial.fit(np.column_stack([pixels, z]), xy[:, 0])
    y, error_y = GridPolynomial.fit(np.column_stack([pixels, z]), xy[:, 1])
    slope = abs(float(np.polyfit(z, disparity, 1)[0]))
    return PairGeometry(height, x, y, crs, (float(disparity.min()), float(disparity.max())),
                        1.0 / max(slope, 1e-9), max(error_h, error_x, error_y),
                        float(np.abs(pixels[:, 1] - seen[:, 1]).max()))
