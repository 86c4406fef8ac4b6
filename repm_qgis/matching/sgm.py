"""Backend ``sgm``: semi-global matching on the CPU (Hirschmueller 2008, in OpenCV's implementation).

Both images are matched against each other, and in both results pixels near steps in height are given to the surface
that the images support (``edges``); what the two then disagree on by more than a pixel is dropped, small islands too
unless they match well. Disparities are sharpened on the brightness itself and smoothed, in turns (``subpixel``),
and what one image hides is filled from the background and marked (``occlusions``). Each choice was measured on
``truth_urban``, simulated towns and mountains and real pairs (docs/benchmarks.md).
"""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatImage
from .disparity_map import DisparityMap
from .edges import at_edges
from .occlusions import with_background
from .pair_backend import PairBackend
from .subpixel import median, positions, refined

# Blocks of one pixel keep steps sharp; the noise that they let through is taken out afterwards.
_BLOCK, _P1, _P2 = 1, 12, 48
_AGREE_PX = 1.0  # between the two directions
_ISLAND_PIXELS, _ISLAND_PX = 80, 1.0
_TOWER_PIXELS, _TOWER_SCORE = 12, 0.8  # islands as small as that stay if they match as well as that
_SCORE_WINDOW = 7
_RIM = 9  # px: block, pre-filter and median together reach 4 px to each side


def match(
    first: FloatImage, second: FloatImage, disparities: Tuple[int, int], nearer: float, lean: float = 0.0
) -> DisparityMap:
    """Disparities of a rectified pair, as :class:`repm_qgis.matching.disparity_map.PairMatcher` says."""
    low, high = disparities
    a, b = _grey(first), _grey(second)
    forth = at_edges(_forth(a, b, low, high), first, second, (-1.0, high), nearer)
    back = at_edges(_back(a, b, low, high), second, first, (1.0, -high), nearer)
    first, second = _without_rim(first), _without_rim(second)
    forth[~np.isfinite(first)] = np.nan
    disparity = np.where(_agree(forth, back, high), forth, np.float32(np.nan))
    disparity = _without_islands(disparity, first, second, low, high)
    disparity = refined(disparity, first, second, high)
    score = _score(first, second, disparity, high)
    # Where the second image has nothing, the matcher has only made something up.
    disparity[~np.isfinite(score)] = np.nan
    whole = with_background(disparity, nearer, lean, forth)
    whole[~np.isfinite(first)] = np.nan
    filled = np.isfinite(whole) & ~np.isfinite(disparity)
    whole = np.where(filled, median(whole), whole)
    return DisparityMap(whole, np.where(np.isfinite(disparity), np.clip(score, 0, 1), np.float32(np.nan)), filled)


BACKEND = PairBackend("sgm", match)


def _grey(image: FloatImage) -> NDArray[np.uint8]:
    return (np.nan_to_num(image, nan=0.0) * 255).astype(np.uint8)


def _without_rim(image: FloatImage) -> FloatImage:
    """The image without the pixels whose neighbourhood reaches beyond it: costs there compare with nothing."""
    missing = (~np.isfinite(image)).astype(np.uint8)
    return np.where(cv2.dilate(missing, np.ones((_RIM, _RIM), np.uint8)) > 0, np.float32(np.nan), image)


def _matcher(count: int) -> cv2.StereoSGBM:
    """Three-way aggregation: as good as eight ways here, in a quarter of the time. No checks: ours are stricter."""
    return cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=-(-count // 16) * 16,
        blockSize=_BLOCK,
        P1=_P1,
        P2=_P2,
        disp12MaxDiff=-1,
        preFilterCap=31,
        uniquenessRatio=0,
        speckleWindowSize=0,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )


def _forth(first: NDArray[np.uint8], second: NDArray[np.uint8], low: int, high: int) -> FloatImage:
    """(H, W) disparity of each pixel of the first image; NaN without one."""
    span = high - low
    padded = cv2.copyMakeBorder(first, 0, 0, span, 0, cv2.BORDER_CONSTANT)
    raw = _matcher(span).compute(padded, second)[:, span:]
    disparity = np.where(raw >= 0, raw / np.float32(16), np.float32(np.nan)).astype(np.float32) + np.float32(low)
    disparity[disparity > high] = np.nan
    return disparity


def _back(first: NDArray[np.uint8], second: NDArray[np.uint8], low: int, high: int) -> FloatImage:
    """(H, W + high - low) disparity of each pixel of the second image; NaN without one.

    Its column c meets the first image's column c - e with e = high - disparity, from 0 to high - low.
    """
    span = high - low
    margin = -(-span // 16) * 16
    a = cv2.copyMakeBorder(first, 0, 0, margin, second.shape[1] - first.shape[1], cv2.BORDER_CONSTANT)
    b = cv2.copyMakeBorder(second, 0, 0, margin, 0, cv2.BORDER_CONSTANT)
    raw = _matcher(span).compute(b, a)[:, margin:]
    return np.where(raw >= 0, np.float32(high) - raw / np.float32(16), np.float32(np.nan)).astype(np.float32)


def _agree(forth: FloatImage, back: FloatImage, high: int) -> NDArray[np.bool_]:
    """Pixels whose match in the second image points back to them."""
    rows = np.arange(forth.shape[0])[:, None]
    columns = np.arange(forth.shape[1], dtype=np.float32) - forth + np.float32(high)
    target = np.rint(np.nan_to_num(columns, nan=-1.0)).astype(np.intp)
    inside = (target >= 0) & (target < back.shape[1])
    with np.errstate(invalid="ignore"):
        return inside & (np.abs(back[rows, np.where(inside, target, 0)] - forth) <= _AGREE_PX)


def _without_islands(disparity: FloatImage, first: FloatImage, second: FloatImage, low: int, high: int) -> FloatImage:
    """Connected pieces of fewer than 80 px dropped; towers and chimneys of 12 px and more stay if they match well."""
    pieces = _pieces(disparity, low, _TOWER_PIXELS)
    with np.errstate(invalid="ignore"):
        well = _score(first, second, pieces, high) > _TOWER_SCORE
    kept = np.isfinite(_pieces(pieces, low, _ISLAND_PIXELS)) | well
    return _pieces(np.where(kept, pieces, np.float32(np.nan)), low, _TOWER_PIXELS)


def _pieces(disparity: FloatImage, low: int, pixels: int) -> FloatImage:
    """Only the connected pieces of at least so many pixels; a step between neighbours of over 1 px parts pieces."""
    steps = np.where(np.isfinite(disparity), (disparity - (low - 1)) * 16, 0).astype(np.int16)
    cv2.filterSpeckles(steps, 0, pixels, int(16 * _ISLAND_PX))
    return np.where(steps > 0, disparity, np.float32(np.nan)).astype(np.float32)


def _score(first: FloatImage, second: FloatImage, disparity: FloatImage, high: int) -> FloatImage:
    """Normalised cross-correlation of each pixel's neighbourhood with the one it was matched to; NaN without data."""
    columns, rows = positions(disparity, high)
    matched = cv2.remap(
        second, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
    )
    known = np.isfinite(matched) & np.isfinite(first) & np.isfinite(disparity)
    a, b = np.where(known, first, np.float32(0)), np.where(known, matched, np.float32(0))
    n = np.maximum(_box(known.astype(np.float32)), 1e-6)
    ma, mb = _box(a) / n, _box(b) / n
    va, vb = _box(a * a) / n - ma * ma, _box(b * b) / n - mb * mb
    covariance = _box(a * b) / n - ma * mb
    # 1e-6 of the full brightness range squared is below a 12-bit sensor's noise: no texture, no score.
    score = covariance / np.sqrt(np.maximum(va * vb, 1e-12))
    return np.where(known, score, np.float32(np.nan)).astype(np.float32)


def _box(image: FloatImage) -> FloatImage:
    return cv2.boxFilter(
        image, cv2.CV_32F, (_SCORE_WINDOW, _SCORE_WINDOW), normalize=True, borderType=cv2.BORDER_CONSTANT
    )
