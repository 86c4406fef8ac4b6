"""Checks of disparities, whatever their cost: image rims, speckles, and the filling of occlusions."""

from __future__ import annotations

from typing import Callable

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask
from .disparity_map import DisparityMap
from .occlusions import fill_occlusions
from .parameters import MatchingParameters, SgmParameters
from .subpixel import known_median

_STEPS = 16  # units of the speckle filter, which takes integers, for each px


def without_rim(image: FloatImage, rim_px: int) -> FloatImage:
    """The image without the pixels whose window contains pixels without data: their costs are meaningless."""
    missing = (~np.isfinite(image)).astype(np.uint8)
    return np.where(cv2.dilate(missing, np.ones((rim_px, rim_px), np.uint8)) > 0, np.float32(np.nan), image)


def speckle_filter(
    disparity: FloatImage, low: int, score: Callable[[FloatImage], FloatImage], parameters: SgmParameters
) -> FloatImage:
    """Disparities without small connected components; those of towers and chimneys stay if they match well."""
    components = _components(disparity, low, parameters.tower_px, parameters)
    with np.errstate(invalid="ignore"):
        good = score(components) > parameters.tower_score
    kept = np.isfinite(_components(components, low, parameters.speckle_px, parameters)) | good
    kept_components = np.where(kept, components, np.float32(np.nan))
    return _components(kept_components, low, parameters.tower_px, parameters)


def _components(disparity: FloatImage, low: int, pixels: int, parameters: SgmParameters) -> FloatImage:
    """Only connected components of more than so many pixels; a step of disparity between neighbours separates them."""
    steps = np.where(np.isfinite(disparity), (disparity - (low - 1)) * _STEPS, 0).astype(np.int16)
    cv2.filterSpeckles(steps, 0, pixels, int(_STEPS * parameters.speckle_step_px))
    return np.where(steps > 0, disparity, np.float32(np.nan)).astype(np.float32)


def complete(
    disparity: FloatImage,
    unchecked: FloatImage,
    score: FloatImage,
    known: Mask,
    height_sign: float,
    relief_displacement: float,
    parameters: MatchingParameters,
) -> DisparityMap:
    """The map of checked disparities (H, W), their occlusions filled; ``score`` is NaN where they have no match."""
    # Where the second image has no data, a disparity results from the smoothness term alone.
    disparity = np.where(np.isfinite(score), disparity, np.float32(np.nan))
    dense = fill_occlusions(disparity, height_sign, relief_displacement, unchecked, parameters.occlusions)
    dense[~known] = np.nan
    filled = np.isfinite(dense) & ~np.isfinite(disparity)
    dense = np.where(filled, known_median(dense, parameters.subpixel.median_px), dense)
    return DisparityMap(dense, np.where(np.isfinite(disparity), np.clip(score, 0, 1), np.float32(np.nan)), filled)
