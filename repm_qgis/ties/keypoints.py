"""Keypoints with descriptors: SIFT (Lowe 2004) of OpenCV, with RootSIFT descriptors.

Source of the descriptors: Arandjelovic and Zisserman, Three things everyone should know to improve object retrieval
(2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from ..contracts.arrays import ByteImage, FloatArray, FloatImage
from .parameters import TIES, KeypointParameters


@dataclass(frozen=True)
class Keypoints:
    """(N, 2) pixels column, row, where (0, 0) is the centre of the first one; (N, 128) descriptors of unit length."""

    points: FloatArray
    descriptors: FloatImage


Choice = Callable[[FloatArray, FloatArray], NDArray[np.intp]]
"""Indices of the keypoints to describe, by their (N, 2) places and (N,) strengths (of their contrast)."""


def everything(points: FloatArray, strength: FloatArray) -> NDArray[np.intp]:
    """All keypoints."""
    return np.arange(len(points))


def detect(
    grey: ByteImage,
    mask: ByteImage,
    most: int,
    *,
    choose: Choice = everything,
    parameters: KeypointParameters = TIES.keypoints,
) -> Keypoints:
    """Those keypoints of an image (rows, columns) that ``choose`` selects, each place once.

    Keypoints lie where the mask is not 0; ``choose`` gets the ``most`` with the strongest contrast.
    """
    # Without the precise doubling of the image, all keypoints lie a quarter of a pixel too far right and below.
    sift = cv2.SIFT_create(most, parameters.layers, contrastThreshold=parameters.contrast, enable_precise_upscale=True)
    points = sift.detect(grey, mask)
    if not points:
        return Keypoints(np.empty((0, 2)), np.empty((0, 128), np.float32))
    # SIFT returns a keypoint once for each of its orientations: one is enough for a tie.
    places, once = np.unique(np.array([p.pt for p in points], dtype=np.float64), axis=0, return_index=True)
    chosen = choose(places, np.array([points[i].response for i in once]))
    # Descriptors take most of the time: only those that are needed are computed.
    _, descriptors = sift.compute(grey, [points[i] for i in once[chosen]])
    return Keypoints(places[chosen], _roots(descriptors))


def _roots(descriptors: FloatImage) -> FloatImage:
    roots: FloatImage = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
    return roots.astype(np.float32)
