"""The map M from a pixel of the refined image to its pixel in the original image, and back.

Paper: Section 3.3 and Algorithm 2. The refined image is what a zero-skew pinhole camera would have seen; sampling
the original at M(p') gives it. Pixels are column, row with the first pixel's centre at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Callable, Dict, Mapping, Optional, Protocol, Tuple, Type, Union

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.checks import Array, Misfit, Number, member, shown, typed
from ..contracts.errors import OptionError
from ..contracts.record import Record
from .frames import EnuFrame
from .jitter import Jitter
from .pinhole import PinholeCamera, linear_transform
from .surface import Surface

# Iterations end long before these limits: they only bound the time on points where a model fails.
_STEPS = 20
_DIGITS = 6  # of pixels
_INVERSE_TOLERANCE_PX = 1e-7
_LEAST_DETERMINANT = 1e-9  # of maps that are almost the identity


@dataclass(frozen=True)
class HomographyMap(Record):
    """M as a homography (3, 3): the models ``none`` (an affinity that only takes the skew out) and ``homography``."""

    matrix: Annotated[FloatArray, Array((3, 3))]

    def contradiction(self) -> str:
        return "" if abs(np.linalg.det(self.matrix)) > _LEAST_DETERMINANT else "has a matrix without an inverse"

    def original_from_refined(self, points: FloatArray) -> FloatArray:
        return apply_homography(self.matrix, points)

    def refined_from_original(self, points: FloatArray) -> FloatArray:
        return apply_homography(np.linalg.inv(self.matrix), points)

    def moved(self, col: float, row: float) -> "HomographyMap":
        return HomographyMap(self.matrix @ translation(col, row))

    def to_mapping(self) -> dict[str, object]:
        return {"kind": "homography", **super().to_mapping()}


@dataclass(frozen=True)
class PolynomialMap(Record):
    """M as two polynomials of total degree ``order`` in normalised refined pixels (p - offset) / scale.

    ``coefficients`` (terms, 2) belong to :func:`polynomial_terms`; they give the *displacement* M(p) - p in px, so
    that rounding matters as little as the displacement itself.
    """

    order: Annotated[int, Number(1, 5, whole=True)]
    offset: Annotated[FloatArray, Array((2,))]
    scale: Annotated[float, Number(1e-6, 1e9, "px")]
    coefficients: Annotated[FloatArray, Array((-1, 2))]

    def contradiction(self) -> str:
        terms = polynomial_terms(np.zeros(2), self.order).size
        if len(self.coefficients) != terms:
            return f"has {len(self.coefficients)} coefficients: order {self.order} has {terms}"
        with np.errstate(all="ignore"):  # coefficients of a damaged file may be of any size
            invertible = abs(np.linalg.det(self._linear)) > _LEAST_DETERMINANT
            if invertible:
                around = self.offset + self.scale * np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])
                back = self.refined_from_original(self.original_from_refined(around))
                invertible = bool(np.isfinite(back).all())
        return "" if invertible else "has coefficients without an inverse"

    @property
    def _linear(self) -> FloatArray:
        return np.asarray(np.eye(2) + self.coefficients[1:3].T / self.scale)

    def original_from_refined(self, points: FloatArray) -> FloatArray:
        p = np.asarray(points, dtype=np.float64)
        terms = polynomial_terms((p - self.offset) / self.scale, self.order)
        pixels: FloatArray = p + terms @ self.coefficients
        return pixels

    def refined_from_original(self, points: FloatArray) -> FloatArray:
        """By fixed-point iteration, as M is almost the identity; NaN far outside the window that M was fitted to."""
        target = np.asarray(points, dtype=np.float64)
        # The linear part first: its inverse makes the rest a strong contraction.
        inverse = np.linalg.inv(self._linear)
        guess: FloatArray = (target - self.offset - self.coefficients[0]) @ inverse.T + self.offset
        error = np.full(target.shape[:-1], np.inf)
        for _ in range(_STEPS):
            residual = target - self.original_from_refined(guess)
            guess = guess + residual @ inverse.T
            error = np.abs(residual).max(axis=-1, initial=0.0)
            if not (error > _INVERSE_TOLERANCE_PX).any():
                break
        guess[~(error <= 1e-4)] = np.nan
        return guess

    def moved(self, col: float, row: float) -> "PolynomialMap":
        step = np.array([col, row], dtype=np.float64)
        coefficients = self.coefficients.copy()
        coefficients[0] += step
        return PolynomialMap(self.order, self.offset - step, self.scale, coefficients)

    def to_mapping(self) -> dict[str, object]:
        return {"kind": "polynomial", **super().to_mapping()}


class SensorModel(Protocol):
    """An image's exact model, such as its RPC: ground to pixel and back."""

    def project(self, lon_lat_h: FloatArray) -> FloatArray: ...

    def localise(self, col_row: FloatArray, height: FloatArray) -> FloatArray: ...


@dataclass(frozen=True)
class Terrain:
    """What the terrain-aware refinement needs: the image's exact model, the local frame, and a coarse surface."""

    sensor: SensorModel
    frame: EnuFrame
    surface: Surface

    def seen_at(self, col_row: FloatArray, above: FloatArray) -> FloatArray:
        """(..., 3) longitudes, latitudes, heights, so many metres above the surface, that are seen at (..., 2) pixels.

        ``above`` broadcasts with the pixels' shape.
        """

        def line(height: FloatArray) -> FloatArray:
            return self.sensor.localise(np.broadcast_to(col_row, height.shape + (2,)), height)

        return self.surface.met_by(line, np.zeros(col_row.shape[:-1]), above)


@dataclass(frozen=True)
class TerrainMap:
    """M through the ground: a refined pixel's ray meets a coarse surface, and the RPC projects that point.

    Ours; it goes beyond the paper. The error that the polynomial leaves is altitude parallax, which depends on the
    ground only: on the surface the equivalent error is zero, and it grows with the distance from it.
    """

    camera: PinholeCamera
    terrain: Terrain

    def original_from_refined(self, points: FloatArray) -> FloatArray:
        p = np.asarray(points, dtype=np.float64)
        homogeneous = np.concatenate([p, np.ones(p.shape[:-1] + (1,))], axis=-1)
        rays = homogeneous @ np.linalg.inv(self.camera.K @ self.camera.R).T
        centre, frame = self.camera.centre, self.terrain.frame

        def line(up: FloatArray) -> FloatArray:
            return frame.to_geodetic(centre + ((up - frame.height - centre[2]) / rays[..., 2])[..., None] * rays)

        return self.terrain.sensor.project(self.terrain.surface.met_by(line, np.zeros(p.shape[:-1]), np.zeros(())))

    def refined_from_original(self, points: FloatArray) -> FloatArray:
        p = np.asarray(points, dtype=np.float64)
        ground = self.terrain.seen_at(p, np.zeros(()))
        return self.camera.project(self.terrain.frame.from_geodetic(ground))

    def moved(self, col: float, row: float) -> "TerrainMap":
        return TerrainMap(self.camera.moved(col, row), self.terrain)

    def to_mapping(self) -> dict[str, object]:
        return {"kind": "terrain"}


@dataclass(frozen=True)
class JitteredMap:
    """M of an image whose attitude jitters: that of the steady image, and then the waves of its lines.

    The refined image is free of them, so that cameras, tables and matching need not know of jitter.
    """

    steady: Union[HomographyMap, PolynomialMap, TerrainMap]
    jitter: Jitter

    def original_from_refined(self, points: FloatArray) -> FloatArray:
        return self.jitter.added(self.steady.original_from_refined(points))

    def refined_from_original(self, points: FloatArray) -> FloatArray:
        return self.steady.refined_from_original(self.jitter.removed(np.asarray(points, dtype=np.float64)))

    def moved(self, col: float, row: float) -> "JitteredMap":
        return JitteredMap(self.steady.moved(col, row), self.jitter)

    def to_mapping(self) -> dict[str, object]:
        return {"kind": "jittered", "steady": self.steady.to_mapping(), "jitter": self.jitter.to_mapping()}


RefinementMap = Union[HomographyMap, PolynomialMap, TerrainMap, JitteredMap]
"""M; both directions take and give (..., 2) pixels. ``moved`` is M of the refined image that starts at (col, row)."""


def map_from_mapping(values: Any, camera: PinholeCamera, terrain: Callable[[], Optional[Terrain]]) -> RefinementMap:
    """The inverse of ``to_mapping``; raises Misfit for an unknown kind, or for values that are no map.

    A terrain map is made again from its camera and from ``terrain()``, which is called only then.
    """
    kind = values.get("kind") if isinstance(values, Mapping) else None
    if kind == "jittered":
        with member("to_original"):
            steady = map_from_mapping(values.get("steady"), camera, terrain)
            jitter = typed(Jitter, values.get("jitter"))
            if isinstance(steady, JitteredMap):
                raise Misfit("has jitter twice")
        return JitteredMap(steady, jitter)
    surroundings = terrain() if kind == "terrain" else None
    if surroundings is not None:
        return TerrainMap(camera, surroundings)
    maps: Dict[Any, Type[Union[HomographyMap, PolynomialMap]]]
    maps = {"homography": HomographyMap, "polynomial": PolynomialMap}
    if not isinstance(kind, str) or kind not in maps:
        raise Misfit(f"must be {', '.join(maps)} or terrain", shown(kind), ("to_original", "kind"))
    try:
        return maps[kind].from_mapping(values)
    except Misfit as misfit:
        raise misfit.in_member("to_original") from None


def translation(col: float, row: float) -> FloatArray:
    """(3, 3) homography that adds (col, row)."""
    return np.array([[1.0, 0.0, col], [0.0, 1.0, row], [0.0, 0.0, 1.0]])


def whole_pixels(low: FloatArray, high: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """The whole pixels at or before ``low`` and at or after ``high``, (2,) each. What lies on a whole one is there on
    every machine, whatever the last bits of its sums."""
    return np.floor(np.round(low, _DIGITS)), np.ceil(np.round(high, _DIGITS))


def apply_homography(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """(..., 2) points through a (3, 3) homography."""
    p = np.asarray(points, dtype=np.float64)
    homogeneous = p @ matrix[:, :2].T + matrix[:, 2]
    pixels: FloatArray = homogeneous[..., :2] / homogeneous[..., 2:]
    return pixels


def polynomial_terms(points: FloatArray, order: int) -> FloatArray:
    """(..., 2) x, y to (..., terms): 1, x, y, x y, x^2, y^2 for order 2, as the paper has them, then higher degrees."""
    x, y = points[..., 0], points[..., 1]
    terms = [np.ones_like(x), x, y]
    if order >= 2:
        terms += [x * y, x * x, y * y]
    for degree in range(3, order + 1):
        terms += [x ** (degree - k) * y**k for k in range(degree + 1)]
    return np.stack(terms, axis=-1)


def fit_map(
    model: str, refined: FloatArray, original: FloatArray, skew_affinity: FloatArray, order: int = 2
) -> RefinementMap:
    """Least-squares M from (N, 2) pixels of the pinhole camera and of the RPC (paper, Algorithm 2, step 3).

    ``skew_affinity`` (3, 3) puts the camera's skew back: all of M where the model is ``none``. ``order`` is the total
    degree of the polynomial. A :class:`TerrainMap` needs no fit.
    """
    if model == "none":
        return HomographyMap(skew_affinity)
    if model == "homography":
        H, _ = linear_transform(refined, original)
        return HomographyMap(H / H[2, 2])
    if model == "polynomial":
        offset = refined.mean(axis=0)
        scale = float(np.abs(refined - offset).max())
        terms = polynomial_terms((refined - offset) / scale, order)
        coefficients, *_ = np.linalg.lstsq(terms, original - refined, rcond=None)
        return PolynomialMap(order, offset, scale, coefficients)
    raise OptionError("MODEL", model, "must be none, homography or polynomial")
