"""Semi-global matching of a learned cost: images of different seasons, whose intensities say little.

Leaves, crops, snow and shadows change intensities, but less what is an edge, a corner, or even ground. Whether a
disparity is used depends on the chance that it is wrong: how clear its minimum is, how well matches around it agree in
both directions, and how alike the images are there, in one logistic rule. Depth edges stay where they are: intensities
of different seasons do not show them better.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

import numpy as np

from ..contracts.arrays import FloatImage, IntArray, Mask
from ..imagery.warping import box_filter
from .cost_volume import Winners, winners
from .disparity_checks import complete, speckle_filter, without_rim
from .disparity_map import DisparityMap, match_score
from .parameters import MATCHING, LearnedParameters, MatchingParameters
from .subpixel import subpixel_disparity


def match(
    first: FloatImage,
    second: FloatImage,
    disparities: Tuple[int, int],
    height_sign: float,
    relief_displacement: float = 0.0,
    parameters: MatchingParameters = MATCHING,
) -> DisparityMap:
    """Disparities of a rectified pair, as :class:`repm_qgis.matching.disparity_map.PairMatcher` describes."""
    (low, high), p = disparities, parameters.learned
    found = winners(first, second, high - low, p)
    agreed = _agreement(found)
    doubt = chance_of_error(found, agreed, p)
    first, second = (without_rim(image, parameters.sgm.rim_px) for image in (first, second))
    unchecked = np.where(np.isfinite(first), np.float32(high) - found.first, np.float32(np.nan))
    kept = (doubt < p.least_doubt) | (agreed & (doubt < p.most_doubt))
    disparity = speckle_filter(np.where(kept, unchecked, np.float32(np.nan)), low, np.zeros_like, parameters.sgm)
    disparity = subpixel_disparity(disparity, first, second, high, parameters.subpixel)
    score = match_score(first, second, disparity, high, p.score_window_px)
    dense = complete(disparity, unchecked, score, np.isfinite(first), height_sign, relief_displacement, parameters)
    clear = np.minimum(found.margin, np.float32(2)) / 2
    return replace(dense, support=np.float32(p.support) + clear - agreed)


def _agreement(found: Winners) -> Mask:
    """(H, W) whether the second image's pixel points back to within 1 px."""
    rows = np.arange(len(found.first))[:, None]
    columns: IntArray = np.arange(found.first.shape[1]) + np.rint(found.first).astype(np.int64)
    agreed: Mask = np.abs(found.second[rows, columns] - found.first) <= 1
    return agreed


def chance_of_error(found: Winners, agreed: Mask, parameters: LearnedParameters) -> FloatImage:
    """(H, W) the chance, 0..1, that a winner's height is wrong by more than 3 m."""
    p, odds = parameters, np.full(found.first.shape, parameters.odds[0], np.float32)
    near, wide = box_filter(p.mean_px), box_filter(p.agreement_px)
    terms = (near(found.margin), found.lead, wide(agreed.astype(np.float32)), near(found.cost))
    for weight, term in zip(p.odds[1:], terms):
        odds += np.float32(weight) * term
    chance: FloatImage = 1 / (1 + np.exp(-np.clip(odds, -30, 30)))
    return chance
