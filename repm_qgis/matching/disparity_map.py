"""The input and output of a matcher of rectified pairs, and how well the images agree on disparities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Protocol, Tuple

import cv2
import numpy as np

from ..contracts.arrays import FloatImage, Mask, Size, Window
from ..imagery.correlation import window_statistics
from ..imagery.warping import box_filter
from .parameters import MATCHING, MatchingParameters

_UNKNOWN = -9.0  # a column outside every image


@dataclass(frozen=True)
class DisparityMap:
    """Disparities of a rectified first image, all (H, W).

    ``disparity`` in px, first column minus second column, NaN where there is none. ``score`` is the correlation of the
    matched neighbourhoods, 0..1, NaN where nothing was matched. ``filled`` marks disparities that were not matched but
    taken from the background beside an occlusion. ``support``: what the matcher knows of how well the
    images support each pixel, to be added to correlations of their intensities.
    """

    disparity: FloatImage
    score: FloatImage
    filled: Mask
    support: Optional[FloatImage] = None

    def in_frame(self, window: Window, size: Size) -> DisparityMap:
        """The map of a whole frame of ``size`` (width, height), of which this is a part; NaN beside it."""
        part = window.inside(Window(0, 0, *size))
        disparity, score = (np.full(size[::-1], np.nan, dtype=np.float32) for _ in range(2))
        filled = np.zeros(size[::-1], dtype=bool)
        disparity[part], score[part], filled[part] = self.disparity, self.score, self.filled
        return DisparityMap(disparity, score, filled)


class PairMatcher(Protocol):
    """A function of a module (worker processes import it by its name) that matches a rectified pair."""

    def __call__(
        self,
        first: FloatImage,
        second: FloatImage,
        disparities: Tuple[int, int],
        height_sign: float,
        relief_displacement: float = 0.0,
        parameters: MatchingParameters = MATCHING,
    ) -> DisparityMap:
        """Disparities of a rectified pair.

        Parameters
        ----------
        first : (H, W) intensity in 0..1, NaN where there is none.
        second : (H, W + high - low), intensity; its column c shows the rectified column c - high.
        disparities : low, high: whole px, least and greatest first column minus second column.
        height_sign : +1 if greater disparities are higher ground, -1 if lower.
        relief_displacement : columns by which a point that rises by one px of disparity moves in the first image (0:
            it looks straight down).
        """


def matched_positions(disparity: FloatImage, high: int) -> Tuple[FloatImage, FloatImage]:
    """(H, W) columns and rows of the second image that the first image's pixels are matched to; outside if unknown."""
    columns = np.arange(disparity.shape[1], dtype=np.float32)[None, :] - disparity + np.float32(high)
    rows = np.repeat(np.arange(disparity.shape[0], dtype=np.float32)[:, None], disparity.shape[1], axis=1)
    columns[np.isnan(columns)] = _UNKNOWN
    return columns, rows


def match_correlation(
    first: FloatImage, second: FloatImage, disparity: FloatImage, high: int, window_px: int, border: int
) -> Tuple[FloatImage, Mask]:
    """(H, W) correlation of each pixel's window with the one it was matched to, and where both images have data.

    ``border`` says how OpenCV continues the images. Elsewhere the correlation has no meaning.
    """
    columns, rows = matched_positions(disparity, high)
    nothing = float("nan")
    matched = cv2.remap(second, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=nothing)
    known = np.isfinite(matched) & np.isfinite(first) & np.isfinite(disparity)
    return window_statistics(first, matched, known, box_filter(window_px, border)).correlation(), known


def match_score(first: FloatImage, second: FloatImage, disparity: FloatImage, high: int, window_px: int) -> FloatImage:
    """(H, W) correlation of each pixel's window with the one it was matched to; NaN without data."""
    score, known = match_correlation(first, second, disparity, high, window_px, cv2.BORDER_CONSTANT)
    return np.where(known, score, np.float32(np.nan)).astype(np.float32)
