"""The equivalent pinhole camera: fitted to 3-D to 2-D correspondences, and factorised to K, R, t.

Paper: Algorithm 1, steps 4 and 5. Pixels are column, row with the first pixel's centre at (0, 0); the world is a
local metric frame (ENU).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.checks import Array
from ..contracts.errors import RpcInvalidError
from ..contracts.record import Record


@dataclass(frozen=True)
class PinholeCamera(Record):
    """K (3, 3) upper triangular, R (3, 3) and t (3,): x ~ K (R X + t), depths positive.

    K[2, 2] = 1 and K[0, 0] > 0; K[1, 1] is negative where no rotation shows the image unmirrored (:func:`factorise`).
    """

    K: Annotated[FloatArray, Array((3, 3))]
    R: Annotated[FloatArray, Array((3, 3))]
    t: Annotated[FloatArray, Array((3,))]

    def contradiction(self) -> str:
        if np.tril(self.K, -1).any() or self.K[0, 0] <= 0 or self.K[1, 1] == 0 or self.K[2, 2] != 1:
            return "has a K that is not upper triangular with K[0, 0] > 0, K[1, 1] != 0 and K[2, 2] = 1"
        if np.abs(self.R @ self.R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(self.R) < 0:
            return "has an R that is not a rotation"
        return ""

    @property
    def P(self) -> FloatArray:
        """(3, 4) projection matrix K [R | t]."""
        return self.K @ np.column_stack([self.R, self.t])

    @property
    def centre(self) -> FloatArray:
        """(3,) projection centre in the world."""
        return -self.R.T @ self.t

    def project(self, xyz_m: FloatArray) -> FloatArray:
        """(..., 3) world points to (..., 2) column, row."""
        homogeneous = (np.asarray(xyz_m) @ self.R.T + self.t) @ self.K.T
        pixels: FloatArray = homogeneous[..., :2] / homogeneous[..., 2:]
        return pixels

    def depth(self, xyz_m: FloatArray) -> FloatArray:
        """(..., 3) world points to (...) depths in metres."""
        depths: FloatArray = np.asarray(xyz_m) @ self.R[2] + self.t[2]
        return depths

    def without_skew(self) -> "PinholeCamera":
        """The camera with the same pose, focal lengths and principal point whose pixels are not sheared."""
        K = self.K.copy()
        K[0, 1] = 0.0
        return PinholeCamera(K, self.R, self.t)

    def moved(self, col: float, row: float) -> "PinholeCamera":
        """The camera of an image whose pixel (0, 0) is this image's pixel (col, row)."""
        K = self.K.copy()
        K[0, 2] -= col
        K[1, 2] -= row
        return PinholeCamera(K, self.R, self.t)


def normaliser(points: FloatArray) -> FloatArray:
    """(d+1, d+1) similarity that brings points to mean 0 and mean distance sqrt(d)."""
    d = points.shape[1]
    mean = points.mean(axis=0)
    scale = np.sqrt(d) / np.linalg.norm(points - mean, axis=1).mean()
    matrix = np.diag([scale] * d + [1.0])
    matrix[:d, d] = -scale * mean
    return matrix


def linear_transform(source: FloatArray, target: FloatArray) -> Tuple[FloatArray, FloatArray]:
    """(3, d+1) projective map of (N, d) to (N, 2) points by the normalised direct linear transform; singular values.

    The design matrix's QR factor is decomposed instead of the matrix itself: same singular vectors, a hundredth of the
    work. Raises RpcInvalidError where points are not finite.
    """
    T1, T2 = normaliser(source), normaliser(target)
    X = np.column_stack([source, np.ones(len(source))]) @ T1.T
    x = np.column_stack([target, np.ones(len(target))]) @ T2.T
    zero = np.zeros_like(X)
    design = np.concatenate([np.hstack([X, zero, -x[:, :1] * X]), np.hstack([zero, X, -x[:, 1:2] * X])])
    if not np.isfinite(design).all():
        raise RpcInvalidError("the RPC gives no finite pixels over the window and altitude range.")
    _, values, vectors = np.linalg.svd(np.linalg.qr(design, mode="r"))
    return np.linalg.solve(T2, vectors[-1].reshape(3, -1) @ T1), values


def fit_projection(xyz_m: FloatArray, col_row: FloatArray) -> FloatArray:
    """(3, 4) projection matrix of N >= 6 points that do not lie in a plane, scaled to depths in metres, all positive.

    The normalised direct linear transform (Hartley and Zisserman, Multiple View Geometry, 2nd ed., algorithm 7.1).
    Raises RpcInvalidError where the points determine no camera.
    """
    P, values = linear_transform(xyz_m, col_row)
    if values[-2] < 1e-12 * values[0]:
        raise RpcInvalidError("the window and altitude range are too small to determine a camera.")
    P /= np.linalg.norm(P[2, :3])
    depths = xyz_m @ P[2, :3] + P[2, 3]
    return P if np.median(depths) > 0 else -P


def factorise(P: FloatArray) -> PinholeCamera:
    """K, R, t of a projection matrix (3, 4): RQ decomposition with det R = +1, and a positive diagonal of K.

    K[1, 1] is negative where the image is mirrored, as scans may be, and as tiles may seem that hardly determine from
    which side they are seen: rays through them are almost parallel. Raises RpcInvalidError where P is singular.
    """
    M = P[:, :3]
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ M).T)
    K, R = flip @ r.T @ flip, flip @ q.T
    signs = np.sign(np.diag(K))
    if (signs == 0).any() or not np.isfinite(K).all():
        raise RpcInvalidError("the fitted projection matrix is singular.")
    K, R = K * signs, signs[:, None] * R
    t = np.linalg.solve(K, P[:, 3])
    if np.linalg.det(R) < 0:
        # The rows of a scan may run so that the image is mirrored for a right-handed camera: turning the camera's row
        # axis keeps the zeros of K and every projection.
        mirror = np.diag([1.0, -1.0, 1.0])
        K, R, t = K @ mirror, mirror @ R, mirror @ t
    return PinholeCamera(K / K[2, 2], R, t)
