"""Backend ``sgm``: semi-global matching on the CPU (Hirschmueller 2008, in OpenCV's implementation).

The images are matched in both directions, and in both results depth edges are moved to where the images have them.
The left-right consistency check removes disparities on which the two results differ, and the speckle filter removes
small components that do not match well. Then come subpixel disparities and the filling of occlusions.
"""

from __future__ import annotations

from typing import Callable, Tuple

import cv2
import numpy as np

from ..contracts.arrays import ByteImage, FloatImage
from ..imagery.sampling import known_or_zero
from ..runtime.spare_cores import side_by_side
from .depth_edges import correct_depth_edges
from .disparity_checks import complete, speckle_filter, without_rim
from .disparity_map import DisparityMap, match_score
from .pair_backend import PairBackend
from .parameters import MATCHING, MatchingParameters, SgmParameters
from .subpixel import subpixel_disparity

_STEPS = 16  # OpenCV's units for each px of disparity; it also searches whole multiples of 16 px
_MODES = {3: cv2.STEREO_SGBM_MODE_SGBM_3WAY, 5: cv2.STEREO_SGBM_MODE_SGBM, 8: cv2.STEREO_SGBM_MODE_HH}


def intensity_bytes(image: FloatImage) -> ByteImage:
    return (known_or_zero(image) * np.float32(255)).astype(np.uint8)


def match(
    first: FloatImage,
    second: FloatImage,
    disparities: Tuple[int, int],
    height_sign: float,
    relief_displacement: float = 0.0,
    parameters: MatchingParameters = MATCHING,
    to_bytes: Callable[[FloatImage], ByteImage] = intensity_bytes,
    correct_edges: Callable[..., FloatImage] = correct_depth_edges,
) -> DisparityMap:
    """Disparities of a rectified pair, as :class:`repm_qgis.matching.disparity_map.PairMatcher` describes.

    Studies may give other images to OpenCV (``to_bytes``) and correct depth edges by another function.
    """
    low, high = disparities
    sgm, edges = parameters.sgm, parameters.edges
    a, b = to_bytes(first), to_bytes(second)
    plain, back, turned = side_by_side(
        lambda: _left_to_right(a, b, low, high, sgm),
        lambda: _right_to_left(a, b, low, high, sgm),
        lambda: _upside_down(a, b, low, high, sgm),
    )
    images, towards = (first, second), ((-1.0, high), (1.0, -high))
    left, right = side_by_side(
        lambda: correct_edges(plain, *images, towards[0], height_sign, edges),
        lambda: correct_edges(back, *images[::-1], towards[1], height_sign, edges),
    )
    first, second = without_rim(first, sgm.rim_px), without_rim(second, sgm.rim_px)
    left[~np.isfinite(first)] = np.nan
    disparity = _agreed(left, right, high, sgm.left_right_px) + _drift(plain, turned, sgm)

    def score(found: FloatImage) -> FloatImage:
        return match_score(first, second, found, high, sgm.score_window_px)

    disparity = speckle_filter(disparity, low, score, sgm)
    disparity = subpixel_disparity(disparity, first, second, high, parameters.subpixel)
    return complete(disparity, left, score(disparity), np.isfinite(first), height_sign, relief_displacement, parameters)


BACKEND = PairBackend("sgm", match)


def _disparities(reference: ByteImage, other: ByteImage, count: int, parameters: SgmParameters) -> FloatImage:
    """(H, W) OpenCV's disparities from 0 to about ``count`` px, negative without one. Its own checks are off."""
    p, whole = parameters, -(-count // _STEPS) * _STEPS
    checks = {"disp12MaxDiff": -1, "uniquenessRatio": 0, "speckleWindowSize": 0}
    method = {"P1": p.p1, "P2": p.p2, "preFilterCap": p.prefilter_cap, "mode": _MODES[p.paths]}
    matcher = cv2.StereoSGBM_create(0, whole, p.block_px, **method, **checks)
    found: FloatImage = matcher.compute(reference, other) / np.float32(_STEPS)
    return found


def _left_to_right(first: ByteImage, second: ByteImage, low: int, high: int, parameters: SgmParameters) -> FloatImage:
    """(H, W) disparity of each pixel of the first image; NaN without one."""
    span = high - low
    padded = cv2.copyMakeBorder(first, 0, 0, span, 0, cv2.BORDER_CONSTANT)
    found = _disparities(padded, second, span, parameters)[:, span:]
    disparity = np.where(found >= 0, found, np.float32(np.nan)).astype(np.float32) + np.float32(low)
    disparity[disparity > high] = np.nan
    return disparity


def _right_to_left(first: ByteImage, second: ByteImage, low: int, high: int, parameters: SgmParameters) -> FloatImage:
    """(H, W + high - low) disparity of each pixel of the second image; NaN without one.

    Its column c shows the first image's column c - e with e = high - disparity, from 0 to high - low.
    """
    span = high - low
    margin = -(-span // _STEPS) * _STEPS
    a = cv2.copyMakeBorder(first, 0, 0, margin, second.shape[1] - first.shape[1], cv2.BORDER_CONSTANT)
    b = cv2.copyMakeBorder(second, 0, 0, margin, 0, cv2.BORDER_CONSTANT)
    found = _disparities(b, a, span, parameters)[:, margin:]
    return np.where(found >= 0, np.float32(high) - found, np.float32(np.nan)).astype(np.float32)


def _agreed(left: FloatImage, right: FloatImage, high: int, most_px: float) -> FloatImage:
    """Left-right consistency check: the means of both directions' disparities for pixels of the first image whose match
    in the second image points back to them, NaN for others.

    OpenCV rounds the vertices of its parabolas towards zero, and of several least costs it takes the one at the least
    disparity. In both directions it counts disparities from the same side, the second image's are taken from the
    highest: so the means have neither bias, which turned with the images.
    """
    rows = np.arange(left.shape[0])[:, None]
    columns = np.arange(left.shape[1], dtype=np.float32) - left + np.float32(high)
    columns[np.isnan(columns)] = -1.0
    target = np.rint(columns).astype(np.intp)
    inside = (target >= 0) & (target < right.shape[1])
    back = right[rows, np.where(inside, target, 0)]
    with np.errstate(invalid="ignore"):
        consistent = inside & (np.abs(back - left) <= most_px)
    return np.where(consistent, (left + back) * np.float32(0.5), np.float32(np.nan))


def _upside_down(first: ByteImage, second: ByteImage, low: int, high: int, parameters: SgmParameters) -> FloatImage:
    """What :func:`_left_to_right` gives where the images are matched upside down; where all eight paths are followed,
    nothing is asked of it, and all is NaN."""
    if parameters.paths == max(_MODES):
        return np.full(first.shape, np.float32(np.nan))
    one, other = (np.ascontiguousarray(image[::-1]) for image in (first, second))
    return _left_to_right(one, other, low, high, parameters)[::-1]


def _drift(disparity: FloatImage, turned: FloatImage, parameters: SgmParameters) -> FloatImage:
    """(H, W) px that are missing in the first image's disparities, 0 where that is not known.

    With fewer than eight paths OpenCV hands costs down from the top alone, so that surfaces move down by 0.1 to 0.3
    rows. Images that are matched upside down have the opposite error.
    """
    half = (turned - disparity) * np.float32(0.5)
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(half) <= np.float32(parameters.left_right_px / 2), half, np.float32(0))
