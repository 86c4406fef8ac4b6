"""Epipolar rectification of two refined pinhole images by homographies, which the pinhole model makes possible.

After it, a ground point has the same row in both images, and its column difference (disparity, first minus second)
grows with its height and is about zero on the plane of the middle altitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Size
from ..contracts.errors import RpcInvalidError
from .equivalent_error import RefinedPinhole
from .pinhole import PinholeCamera
from .refinement import apply_homography, translation, whole_pixels

_SHEARS = 61  # shears that are tried: steps of a hundredth


@dataclass(frozen=True)
class RectifiedPair:
    """Homographies from refined to rectified pixels of both images, and the size of the common rectified frame."""

    first: RefinedPinhole
    second: RefinedPinhole
    h_first: FloatArray
    h_second: FloatArray
    size: Size

    def first_original(self, points: FloatArray) -> FloatArray:
        """(..., 2) original pixels of the first image from rectified ones."""
        return self.first.to_original.original_from_refined(apply_homography(np.linalg.inv(self.h_first), points))

    def second_original(self, points: FloatArray) -> FloatArray:
        """(..., 2) original pixels of the second image from rectified ones."""
        return self.second.to_original.original_from_refined(apply_homography(np.linalg.inv(self.h_second), points))

    def first_rectified(self, points: FloatArray) -> FloatArray:
        """(..., 2) rectified pixels of the first image from original ones."""
        return apply_homography(self.h_first, self.first.to_original.refined_from_original(points))

    def second_rectified(self, points: FloatArray) -> FloatArray:
        """(..., 2) rectified pixels of the second image from original ones."""
        return apply_homography(self.h_second, self.second.to_original.refined_from_original(points))

    def scaled(self, factor: float) -> "RectifiedPair":
        """The same pair with both images reduced by ``factor``, so that the areas of the pixels coincide."""
        half = (1.0 / factor - 1.0) / 2.0
        S = np.array([[1 / factor, 0, half], [0, 1 / factor, half], [0, 0, 1.0]])
        size = (int(np.ceil(self.size[0] / factor)), int(np.ceil(self.size[1] / factor)))
        return RectifiedPair(self.first, self.second, S @ self.h_first, S @ self.h_second, size)


def _aligning_rotation(first: PinholeCamera, second: PinholeCamera, target: FloatArray) -> FloatArray:
    """(3, 3) rotation with x along the baseline and z as close to the direction of the target as that allows."""
    baseline = second.centre - first.centre
    length = float(np.linalg.norm(baseline))
    if length < 1.0:
        raise RpcInvalidError("two images were taken from the same place: heights cannot be measured.")
    x = baseline / length
    if x @ first.R[0] < 0:  # keep the image's own sense of left and right
        x = -x
    z = target - (first.centre + second.centre) / 2
    z = z - (z @ x) * x
    z = z / np.linalg.norm(z)
    return np.array([x, np.cross(z, x), z])


def rectify(
    first: RefinedPinhole,
    second: RefinedPinhole,
    plane: FloatArray,
    tile: FloatArray,
    most_shear: float,
    reduction: float = 1.0,
) -> RectifiedPair:
    """Homographies that align the rows of two refined images.

    Parameters
    ----------
    first, second : zero-skew cameras in one local frame with their maps M.
    plane : (N, 3) points of the local frame at the middle altitude, where the disparity becomes as close to zero as
        an affine change of the second image's columns allows.
    tile : (M, 3) points of the local frame whose pixels in the first image the rectified frame must contain.
    reduction : pixels of the first image to one of the frame, where the second image is coarser.

    Notes
    -----
    Turning both cameras onto their common baseline (Fusiello, Trucco and Verri, A compact algorithm for
    rectification of stereo pairs, 2000) aligns the rows. One affine change of rows for both images and of columns for
    each is still free; it gives the first image the scale of its refined image, or that divided by ``reduction``, and
    shears its columns along its rows, by at most ``most_shear``, so that the tile fills the frame: what lies beside it
    is matched for nothing.
    """
    R = _aligning_rotation(first.camera, second.camera, plane.mean(axis=0))
    turn_first = _turn(first.camera, R)
    turn_second = _turn(second.camera, R)
    ground = first.camera.project(plane)
    centre = ground.mean(axis=0)
    J = _jacobian(turn_first, centre)
    row = J[1] / np.linalg.norm(J[1])
    across = np.array([row[1], -row[0]])
    if across @ np.linalg.inv(J)[:, 0] < 0:
        across = -across
    columns = across @ np.linalg.inv(J)
    A = np.array([[columns[0], columns[1], 0.0], [0.0, 1.0 / np.linalg.norm(J[1]), 0.0], [0.0, 0.0, 1.0]])
    A = _upright(apply_homography(A @ turn_first, first.camera.project(tile)), most_shear) @ A
    A = np.diag([1.0 / reduction, 1.0 / reduction, 1.0]) @ A
    h_first = A @ turn_first
    h_second = A @ turn_second
    h_second = _aligned_columns(h_first, h_second, ground, second.camera.project(plane)) @ h_second
    low, high = _frame(first, h_first, first.camera.project(tile), h_second, second)
    move = translation(-low[0], -low[1])
    size = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
    return RectifiedPair(first, second, move @ h_first, move @ h_second, size)


def _upright(shown: FloatArray, most: float) -> FloatArray:
    """(3, 3) shear of columns along rows, of at most so much, with which (N, 2) points fill the narrowest frame."""
    shears = np.linspace(-most, most, _SHEARS)
    columns = shown[:, 0] + shears[:, None] * shown[:, 1]
    return np.array([[1.0, shears[np.argmin(np.ptp(columns, axis=1))], 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def _frame(
    first: RefinedPinhole, h_first: FloatArray, tile: FloatArray, h_second: FloatArray, second: RefinedPinhole
) -> Tuple[FloatArray, FloatArray]:
    """Lowest and highest rectified pixel of the tile in the first image, in rows that the second image has too."""
    shown = apply_homography(h_first, tile)
    own = apply_homography(h_first, _corners(first.size))
    other = apply_homography(h_second, _corners(second.size))
    low = np.maximum(shown.min(axis=0), own.min(axis=0))
    high = np.minimum(shown.max(axis=0), own.max(axis=0))
    low[1], high[1] = max(low[1], other[:, 1].min()), min(high[1], other[:, 1].max())
    start, end = whole_pixels(low, high)
    return start, np.maximum(end, start)


def _corners(size: Size) -> FloatArray:
    return np.array([[0, 0], [size[0] - 1, 0], [0, size[1] - 1], [size[0] - 1, size[1] - 1]], dtype=np.float64)


def _turn(camera: PinholeCamera, R: FloatArray) -> FloatArray:
    """(3, 3) homography from a camera's pixels to those of the turned camera of unit focal length."""
    H = R @ np.linalg.inv(camera.K @ camera.R)
    return H / np.linalg.norm(H[2])


def _jacobian(H: FloatArray, point: FloatArray, delta: float = 1.0) -> FloatArray:
    """(2, 2) derivative of a homography at a point."""
    ends = apply_homography(H, point + delta * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    return np.column_stack([ends[0] - ends[1], ends[2] - ends[3]]) / (2 * delta)


def _aligned_columns(h_first: FloatArray, h_second: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """(3, 3) affine change of the second image's columns that brings them onto the first's, least squares."""
    a, b = apply_homography(h_first, first), apply_homography(h_second, second)
    design = np.column_stack([b, np.ones(len(b))])
    centre = design.mean(axis=0) * np.array([1, 1, 0])
    coefficients, *_ = np.linalg.lstsq(design - centre, a[:, 0], rcond=None)
    coefficients[2] -= coefficients[:2] @ centre[:2]
    return np.array([coefficients, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
