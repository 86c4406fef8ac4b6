"""Weak texture, such as that of snow: disparities of wide windows where single pixels show only noise.

The noise of an image falls with the number of pixels that are averaged, broad shading does not. So the pair is matched
again at a reduced resolution, with its local contrast made even: in eight bits, which the matcher takes, the shading
of bright snow is less than one step. Places that the reduced images do not support stay empty: water has no texture
that two views share, however wide the window.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask
from ..imagery.sampling import mean_of_known
from ..imagery.warping import box_filter, gaussian_mean, reduced
from .disparity_map import DisparityMap, PairMatcher, match_correlation
from .disparity_prior import ReducedPair
from .parameters import MatchingParameters, WideWindowParameters


def wide_match(
    pair: ReducedPair, height_sign: float, match: PairMatcher, parameters: MatchingParameters, missing: Mask
) -> DisparityMap:
    """Disparities of wide windows within a mask, NaN where the reduced images do not support them either; none is
    filled.

    ``pair`` is the whole images' pair, reduced by the prior's factor. Scores are those at which the matcher's own
    disparities err as much.
    """
    p, factor, high = parameters.wide, parameters.prior.factor, pair.disparities[1]
    small = (pair.first, pair.second)
    a, b = (even_contrast(image, p) for image in small)
    smooth = replace(parameters, subpixel=replace(parameters.subpixel, sigma_px=p.sigma_px))
    found = match(a, b, pair.disparities, height_sign, parameters=smooth)
    matched = np.isfinite(found.disparity) & ~found.filled
    # Disparities that may vary from pixel to pixel correlate with any noise; ground of weak texture is smooth.
    disparity = gaussian_mean(matched, p.smooth_px)(np.nan_to_num(found.disparity))
    disparity[~matched] = np.nan
    # Without the pixels around: the contrast of a bank, which both images show, would support the water beside it.
    inside = _shrunk(reduced(missing.astype(np.float32), factor) > 0.5, p.rim_px)
    own = np.where(inside, small[0], np.float32(np.nan))

    def support(moved: int) -> Tuple[FloatImage, Mask]:
        by = disparity + np.float32(moved)
        score, known = match_correlation(own, small[1], by, high, p.score_window_px, cv2.BORDER_REFLECT)
        return mean_of_known(score, known, box_filter(p.support_px), 1e-3)[0], known

    found_support, known = support(0)
    # Depth and mud shade a lake evenly, and even shading correlates at any disparity.
    lead = found_support - np.maximum(support(-p.beside_px)[0], support(p.beside_px)[0])
    kept = _wide(known & (found_support > p.least_support) & (lead > p.least_lead), p.narrowest_px)
    loss = p.score_loss[0] + p.score_loss[1] * (1 - found_support)
    places = _places(missing.shape, kept.shape, factor)
    disparity, score = (
        cv2.remap(np.where(kept, part, np.float32(np.nan)).astype(np.float32), *places, cv2.INTER_LINEAR)
        for part in (disparity * factor, np.clip(1 - loss, 0, 1))
    )
    return DisparityMap(disparity, score, np.zeros(missing.shape, dtype=bool))


def even_contrast(image: FloatImage, parameters: WideWindowParameters) -> FloatImage:
    """(H, W) intensities 0..1 with the same mean and deviation everywhere; NaN stays NaN."""
    known = np.isfinite(image)
    mean = gaussian_mean(known, parameters.contrast_px)
    off = np.where(known, image, np.float32(0)) - mean(np.where(known, image, np.float32(0)))
    deviation = np.sqrt(mean(off * off)) + np.float32(1e-6)
    even = np.clip(0.5 + np.float32(parameters.contrast) * off / deviation, 0, 1)
    return np.where(known, even, np.float32(np.nan)).astype(np.float32)


def _shrunk(mask: Mask, pixels: int) -> Mask:
    """A mask without its rim."""
    window = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
    inner: Mask = cv2.erode(mask.astype(np.uint8), window, borderValue=1) > 0
    return inner


def _wide(mask: Mask, narrowest_px: int) -> Mask:
    """A mask without what is narrower: windows reach from a bank over the water."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (narrowest_px, narrowest_px))
    wide: Mask = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, disc) > 0
    return wide


def _places(shape: Tuple[int, ...], small: Tuple[int, ...], factor: int) -> Tuple[FloatImage, FloatImage]:
    """Columns and rows of the reduced image at the pixels of the whole one."""
    rows, columns = (
        np.clip((np.arange(n) - (factor - 1) / 2) / factor, 0, m - 1).astype(np.float32) for n, m in zip(shape, small)
    )
    columns, rows = np.meshgrid(columns, rows)
    return columns, rows
