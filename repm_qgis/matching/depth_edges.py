"""Correction of depth edges: each pixel near a step in height is assigned again to the upper or the lower surface.

Semi-global matching leaves steps a few pixels away from their place: roofs grow, their corners become round, alleys
are bridged. But both surfaces are known there, and only the surface that each pixel belongs to must be decided. Both
images decide it: the differences of intensity and gradient are compared for the two surfaces and averaged in a window
that ends at the image's edges (guided filter, He, Sun and Tang 2013; support weights are of Yoon and Kweon 2006).
"""

from __future__ import annotations

from typing import Callable, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask
from ..imagery.sampling import known_or_zero, mean_of_known
from ..imagery.warping import box_filter
from .parameters import MATCHING, EdgeParameters

_STRIP = 1024  # columns of a list that is folded to an image: OpenCV's maps may have no more than 32767 to a side


def correct_depth_edges(
    disparity: FloatImage,
    image: FloatImage,
    other: FloatImage,
    towards: Tuple[float, float],
    height_sign: float,
    parameters: EdgeParameters = MATCHING.edges,
) -> FloatImage:
    """Disparities without outliers, and with depth edges where the images have them.

    Parameters
    ----------
    disparity : (H, W) px, of ``image``; NaN where there is none, and it stays so.
    image, other : (H, W) and (H, V) intensity in 0..1, rows aligned.
    towards : factor and offset, so that column + factor * disparity + offset is the column of ``other``.
    height_sign : +1 if greater disparities are higher ground, -1 if lower.
    """
    known = np.isfinite(disparity)
    height = _without_gaps(np.float32(height_sign) * disparity, known, parameters.gap_window_px)
    surface = cv2.medianBlur(height, parameters.median_px)
    upper, lower, near = _surfaces(surface, parameters)
    near &= known
    chosen = surface
    if near.any():
        guide = known_or_zero(image)
        cost = _cost_of(guide, known_or_zero(other), near, towards, parameters)
        evidence = np.zeros_like(surface)
        evidence[near] = cost(height_sign * upper[near]) - cost(height_sign * lower[near])
        chosen = np.where(near, np.where(_guided(guide, evidence, parameters) < 0, upper, lower), surface)
    return np.where(known, np.float32(height_sign) * chosen, np.float32(np.nan)).astype(np.float32)


def _without_gaps(surface: FloatImage, known: Mask, window_px: int) -> FloatImage:
    """Unknown pixels take the mean of the known ones around them."""
    if known.all():
        return surface
    around, _ = mean_of_known(surface, known, box_filter(window_px), 1e-3)
    return np.where(known, surface, around).astype(np.float32)


def _surfaces(surface: FloatImage, parameters: EdgeParameters) -> Tuple[FloatImage, FloatImage, Mask]:
    """The upper and the lower surface around each pixel, its own value being one of them; and where there are two."""
    window = np.ones((2 * parameters.reach_px + 1, 2 * parameters.reach_px + 1), np.uint8)
    top, bottom = cv2.dilate(surface, window), cv2.erode(surface, window)
    near = top - bottom > parameters.step_px
    on_top = surface > (top + bottom) / 2
    above, some_above = _mean_where(surface, near & on_top, parameters.surface_window_px)
    below, some_below = _mean_where(surface, near & ~on_top, parameters.surface_window_px)
    upper, lower = np.where(on_top, surface, above), np.where(on_top, below, surface)
    return upper, lower, near & some_above & some_below & (upper - lower > parameters.step_px)


def _mean_where(surface: FloatImage, chosen: Mask, window_px: int) -> Tuple[FloatImage, Mask]:
    """The mean of the chosen pixels around each pixel, and whether there are any."""
    mean, share = mean_of_known(surface, chosen, box_filter(window_px), 1e-3)
    return mean, share > 0.5 / window_px**2


def _cost_of(
    image: FloatImage, other: FloatImage, near: Mask, towards: Tuple[float, float], parameters: EdgeParameters
) -> Callable[[FloatImage], FloatImage]:
    """A function that takes (N,) disparities of the pixels ``near`` to costs 0..1: how much the images differ there."""
    places, features = np.nonzero(near), _features(other)
    rows, columns = (place.astype(np.float32) for place in places)
    own, (factor, offset) = _features(image)[places], (np.float32(value) for value in towards)
    intensity_cap, gradient_cap = parameters.intensity_cap, parameters.gradient_cap

    def cost(disparity: FloatImage) -> FloatImage:
        there = _folded(columns + factor * disparity.astype(np.float32) + offset)
        found = cv2.remap(features, there, _folded(rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        off = np.abs(own - found.reshape(-1, 3)[: len(disparity)])
        intensity = np.minimum(off[:, 0], np.float32(intensity_cap)) / np.float32(2 * intensity_cap)
        gradient = np.minimum(off[:, 1] + off[:, 2], np.float32(gradient_cap)) / np.float32(2 * gradient_cap)
        total: FloatImage = intensity + gradient
        return total

    return cost


def _features(image: FloatImage) -> FloatImage:
    """(H, W, 3) intensity and its gradient along columns and rows, for each px."""
    across = cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=0.125)
    features: FloatImage = cv2.merge([image, across, cv2.Sobel(image, cv2.CV_32F, 0, 1, scale=0.125)])
    return features


def _folded(values: FloatImage) -> FloatImage:
    return np.pad(values, (0, -len(values) % _STRIP)).reshape(-1, _STRIP)


def _guided(guide: FloatImage, values: FloatImage, parameters: EdgeParameters) -> FloatImage:
    """Values averaged by the guided filter: the edges of the guide limit its window."""
    mean = box_filter(parameters.window_px)
    mean_guide, mean_values = mean(guide), mean(values)
    variance, covariance = (
        mean(guide * guide) - mean_guide * mean_guide,
        mean(guide * values) - mean_guide * mean_values,
    )
    slope = covariance / (variance + np.float32(parameters.contrast**2))
    return mean(slope) * guide + mean(mean_values - slope * mean_guide)
