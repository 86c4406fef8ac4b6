"""Cameras rotated towards the middles of their images, as software expects that needs principal points inside."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatArray, Size
from .pinhole import PinholeCamera
from .refinement import apply_homography, whole_pixels


def centred(camera: PinholeCamera, size: Size) -> Tuple[PinholeCamera, Size]:
    """The camera rotated towards the middle of its image, with square pixels, and the size of its image.

    The projection centre stays, so that the image changes by a homography only and is as exact as before. Satellites'
    cameras fitted without it look straight down, with a principal point up to a million pixels outside.
    """
    middle = (np.array(size) - 1.0) / 2
    ray = np.linalg.solve(camera.K, [*middle, 1.0])
    R = _rotation_to(ray / np.linalg.norm(ray)) @ camera.R
    # One focal length that keeps the area of the pixels at the middle.
    shape = R @ np.linalg.inv(camera.K @ camera.R)
    steps = apply_homography(shape, middle + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    focal = abs(np.linalg.det([steps[0] - steps[1], steps[2] - steps[3]])) ** -0.5
    turned = PinholeCamera(np.diag([focal, focal, 1.0]), R, R @ camera.R.T @ camera.t)
    border = apply_homography(turned.K @ shape, image_nodes(size))
    low, high = whole_pixels(border.min(axis=0), border.max(axis=0))
    return turned.moved(float(low[0]), float(low[1])), (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)


def image_nodes(size: Size, side: int = 9) -> FloatArray:
    """(n, 2) pixels spread over an image, its corners included."""
    u, v = (np.linspace(0, length - 1, side) for length in size)
    return np.asarray(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))


def _rotation_to(direction: FloatArray) -> FloatArray:
    """(3, 3) the smallest rotation that brings a unit vector in front of a camera to its optical axis."""
    x, y, z = direction
    axis = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + axis + axis @ axis / (1.0 + z))
