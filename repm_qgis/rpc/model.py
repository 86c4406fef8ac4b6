"""The rational polynomial camera (RPC): ground to image, and image to ground at a height.

Reference: NIMA STDI-0002, Controlled Extensions, Appendix E, RPC00B. Image coordinates are column, row of pixel
centres: the first pixel's centre is (0, 0). Ground coordinates are longitude and latitude in degrees (WGS 84) and
height in metres above its ellipsoid.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Mapping, Optional

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.checks import Misfit, Number
from ..contracts.errors import RpcInvalidError
from ..contracts.record import Record

_CHUNK = 1 << 14  # points a pass: 20 monomials of them stay in the second-level cache
_LOCALISE_TOLERANCE_PX = 3e-8  # rounding in images of 40000 px is about 1e-8 px: less would never be reached
_LOCALISE_STEPS = 20
# Terms 4 to 19 as products of two terms before them: LP, LH, PH, LL, PP, HH; then PLH, LLL, LPP, LHH, LLP, PPP ... HHH.
_SQUARES = ((1, 2), (1, 3), (2, 3), (1, 1), (2, 2), (3, 3))
_CUBES = ((4, 3), (7, 1), (1, 8), (1, 9), (7, 2), (8, 2), (2, 9), (7, 3), (8, 3), (9, 3))
_FACTORS = _SQUARES + _CUBES


def monomials(lon: FloatArray, lat: FloatArray, height: FloatArray, out: FloatArray) -> FloatArray:
    """RPC00B's twenty terms in normalised longitude L, latitude P and height H, as rows of ``out`` (20, n)."""
    out[0] = 1.0
    out[1], out[2], out[3] = lon, lat, height
    for term, (first, second) in enumerate(_FACTORS, start=4):
        np.multiply(out[first], out[second], out=out[term])
    return out


@dataclass(frozen=True)
class Rpc(Record):
    """One image's RPC: ten normalisers and four cubic polynomials of twenty coefficients.

    ``row_num / row_den`` give the normalised row, ``col_num / col_den`` the normalised column. Offsets and scales of
    rows and columns are in px, of ground coordinates in degrees and metres. ``accuracy_m`` is how far the vendor says
    that points on the ground may be off, one standard deviation in each direction (the root of ERR_BIAS² + ERR_RAND²
    of RPC00B); None where the file does not say. It is no part of the model: two RPCs are equal without it.
    """

    row_off: float
    row_scale: float
    col_off: float
    col_scale: float
    lat_off: float
    lat_scale: float
    lon_off: float
    lon_scale: float
    height_off: float
    height_scale: float
    row_num: tuple[float, ...]
    row_den: tuple[float, ...]
    col_num: tuple[float, ...]
    col_den: tuple[float, ...]
    accuracy_m: Optional[Annotated[float, Number(0, 1e4, "m")]] = field(default=None, compare=False)

    def __post_init__(self) -> None:
        for name in ("row", "col", "lat", "lon", "height"):
            off, scale = getattr(self, f"{name}_off"), getattr(self, f"{name}_scale")
            if not (np.isfinite(off) and abs(off) < 1e9):
                raise RpcInvalidError(f"the RPC's {name} offset is {off}: it must be a finite number.")
            if not (np.isfinite(scale) and 1e-12 < abs(scale) < 1e9):
                raise RpcInvalidError(f"the RPC's {name} scale is {scale}: it must be a finite number other than zero.")
        for name in ("row_num", "row_den", "col_num", "col_den"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.shape != (20,):
                raise RpcInvalidError(f"the RPC's {name} has {values.size} coefficients: it must have 20.")
            if not np.isfinite(values).all() or np.abs(values).max() > 1e30:
                raise RpcInvalidError(f"the RPC's {name} has a coefficient that is not a finite number.")
            if not values.any():
                raise RpcInvalidError(f"the RPC's {name} has only zero coefficients.")
            object.__setattr__(self, name, tuple(float(v) for v in values))
        if not (-90.0 <= self.lat_off <= 90.0 and -360.0 <= self.lon_off <= 360.0):
            place = f"longitude {self.lon_off}, latitude {self.lat_off}"
            raise RpcInvalidError(f"the RPC's centre is at {place}: that is not on the Earth.")

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> Rpc:
        """Raises RpcInvalidError for missing or wrong members."""
        try:
            return super().from_mapping(values)
        except Misfit as misfit:
            raise RpcInvalidError(f"the RPC record cannot be used: {misfit}.") from misfit

    @property
    def digest(self) -> str:
        """What distinguishes the model from another one, to the last bit of its numbers."""
        numbers = [getattr(self, each.name) for each in fields(self) if each.compare]
        return hashlib.sha256(json.dumps(numbers).encode()).hexdigest()[:24]

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest height that the RPC was made for, metres above the ellipsoid."""
        return self.height_off - abs(self.height_scale), self.height_off + abs(self.height_scale)

    def shifted(self, col: float, row: float) -> "Rpc":
        """The RPC of an image whose pixel (0, 0) is this image's pixel (col, row): a crop's RPC."""
        return replace(self, col_off=self.col_off - col, row_off=self.row_off - row)

    def resampled(self, col_step: float, row_step: float) -> "Rpc":
        """The RPC of an image whose pixels are so many of this image's pixels wide and high, from the same corner on.

        The corner is (-0.5, -0.5) in both: of steps of 2, the first pixel's centre is this image's (0.5, 0.5).
        """
        return replace(
            self,
            col_off=(self.col_off + 0.5) / col_step - 0.5,
            row_off=(self.row_off + 0.5) / row_step - 0.5,
            col_scale=self.col_scale / col_step,
            row_scale=self.row_scale / row_step,
        )

    def project(self, lon_lat_h: FloatArray) -> FloatArray:
        """(..., 3) degrees, degrees, metres above the ellipsoid to (..., 2) column, row; NaN in gives NaN out."""
        points = np.asarray(lon_lat_h, dtype=np.float64)
        flat = points.reshape(-1, 3)
        result = np.empty((flat.shape[0], 2))
        coefficients = np.array([self.col_num, self.col_den, self.row_num, self.row_den])
        terms = np.empty((20, min(_CHUNK, max(flat.shape[0], 1))))
        for start in range(0, flat.shape[0], _CHUNK):
            part = flat[start : start + _CHUNK]
            values = coefficients @ monomials(*self.normalised(part), terms[:, : part.shape[0]])
            with np.errstate(divide="ignore", invalid="ignore"):
                result[start : start + _CHUNK, 0] = values[0] / values[1] * self.col_scale + self.col_off
                result[start : start + _CHUNK, 1] = values[2] / values[3] * self.row_scale + self.row_off
        return result.reshape(points.shape[:-1] + (2,))

    def localise(
        self, col_row: FloatArray, height: FloatArray | float, near: Optional[FloatArray] = None
    ) -> FloatArray:
        """Find the ground points at given heights (m above the WGS 84 ellipsoid) that are seen at (..., 2) pixels.

        Gives (..., 3) longitude, latitude (degrees), height (m); NaN where the model has no answer there. Newton's
        method on the forward model with a Jacobian from central differences that is refreshed once; the model is so
        nearly affine that four passes reach 1e-8 px. ``near`` are (..., 2) longitudes and latitudes within some px of
        the points: from there one Jacobian serves them all, which takes a fifth of the time.
        """
        pixels = np.asarray(col_row, dtype=np.float64)
        flat = pixels.reshape(-1, 2)
        heights = np.broadcast_to(np.asarray(height, dtype=np.float64), pixels.shape[:-1]).reshape(-1)
        first = None if near is None else np.asarray(near, dtype=np.float64).reshape(-1, 2)
        ground = np.empty((flat.shape[0], 3))
        for start in range(0, flat.shape[0], _CHUNK):
            part = slice(start, start + _CHUNK)
            ground[part] = self._localise_part(flat[part], heights[part], None if first is None else first[part])
        return ground.reshape(pixels.shape[:-1] + (3,))

    def _localise_part(self, pixels: FloatArray, heights: FloatArray, near: Optional[FloatArray]) -> FloatArray:
        ground = np.empty((pixels.shape[0], 3))
        ground[:, 0], ground[:, 1], ground[:, 2] = self.lon_off, self.lat_off, heights
        refreshed = (1, 6)
        if near is not None:
            ground[:, :2], refreshed = near, (4, 9)
        error = np.full(pixels.shape[0], np.inf)
        for iteration in range(_LOCALISE_STEPS):
            residual = pixels - self.project(ground)
            error = np.abs(residual).max(axis=1, initial=0.0)
            finite = np.isfinite(error)
            if not finite.any() or error[finite].max() < _LOCALISE_TOLERANCE_PX:
                break
            if iteration == 0:  # all start at the same place, or in a small one
                middle = np.array([[self.lon_off, self.lat_off, self.height_off]])
                if near is not None:
                    middle = ground[finite][np.count_nonzero(finite) // 2][None]
                inverse = self._inverse_jacobian(middle)
            elif iteration in refreshed:
                inverse = self._inverse_jacobian(ground)
            step = np.einsum("nij,nj->ni", inverse, residual)
            # A step beyond the model's own domain would run into its poles.
            np.clip(step[:, 0], -2 * abs(self.lon_scale), 2 * abs(self.lon_scale), out=step[:, 0])
            np.clip(step[:, 1], -2 * abs(self.lat_scale), 2 * abs(self.lat_scale), out=step[:, 1])
            ground[:, :2] += step
        ground[~(error < 1e-5), :2] = np.nan
        return ground

    def _inverse_jacobian(self, ground: FloatArray) -> FloatArray:
        """(n, 2, 2) d(lon, lat) / d(col, row) at the points, by central differences."""
        jacobian = np.empty((ground.shape[0], 2, 2))
        for axis, delta in ((0, 1e-4 * self.lon_scale), (1, 1e-4 * self.lat_scale)):
            shift = np.zeros(3)
            shift[axis] = delta
            jacobian[:, :, axis] = (self.project(ground + shift) - self.project(ground - shift)) / (2 * delta)
        determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
        inverse = np.empty_like(jacobian)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse[:, 0, 0], inverse[:, 1, 1] = jacobian[:, 1, 1] / determinant, jacobian[:, 0, 0] / determinant
            inverse[:, 0, 1], inverse[:, 1, 0] = -jacobian[:, 0, 1] / determinant, -jacobian[:, 1, 0] / determinant
        return inverse

    def normalised(self, lon_lat_h: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The (N,) normalised longitudes, latitudes and heights of (N, 3) ground points."""
        lon = self._wrapped(lon_lat_h[:, 0]) / self.lon_scale
        lat = (lon_lat_h[:, 1] - self.lat_off) / self.lat_scale
        return lon, lat, (lon_lat_h[:, 2] - self.height_off) / self.height_scale

    def _wrapped(self, lon: FloatArray) -> FloatArray:
        """Longitude relative to the RPC's centre, across the date line too."""
        return (lon - self.lon_off + 180.0) % 360.0 - 180.0
